/* FOLLOW: the pieces of a step, in each of which the input is held, as in per_input_advance.h. */
static inline void KERNEL(Shape d, const double *U0, const double *U1, const double *share, double dt, double t,
                          const double *p, const double *law, double *memory, double *work)
{
    (void)d, (void)work;
    for (double begin = 0.0, end; begin < 1.0; begin = end) {
        double U[M];
        end = 1.0;
        for (int c = 0; c < M; c++) {
            end = begin < share[c] && share[c] < end ? share[c] : end;
            U[c] = (begin < share[c] ? U0 : U1)[c];
        }
        PART(_piece)(U, t + begin * dt, (end - begin) * dt, p, law, memory);
    }
}
