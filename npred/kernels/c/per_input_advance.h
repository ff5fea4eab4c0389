/* ADVANCE where each input switches from U0 to U1 at a moment of its own: STEP reads U, held, from switch to switch. */
static inline void KERNEL(Shape d, double *X, const double *U0, const double *U1, const double *share, double dt, double t,
                   const double *p, double *work)
{
    const int lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        for (double begin = 0.0, end; begin < 1.0; begin = end) {
            double U[M];
            end = 1.0;
            for (int c = 0; c < M; c++) {
                const double at = share[c * lanes + l];
                end = begin < at && at < end ? at : end;
                U[c] = (begin < at ? U0 : U1)[c * lanes + l];
            }
            STEP(lanes, 1, X + l, U, t + begin * dt, (end - begin) * dt, p, X + l);
        }
    }
}
