/* PREDICT where the plant declares its delay: FLOW steps the state and the time s at which the input acts, both along x,
 * and MARGIN is 1 - D_X f - D_t; where that is not positive, P is NaN from the next node on. With TIMED, s is the last
 * state of X and P. */
#define STATES (N + TIMED)
static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        double x[N + 1], y[N + 2], q[M * WIDE], begin[M * WIDE], half[M * WIDE], end[M * WIDE], margin = 1.0;
        for (int c = 0; c < STATES; c++) {
            x[c] = P[c * lanes + l] = X[c * lanes + l];
        }
        x[N] = t;
        for (int j = 0; j < last; j++) {
            double *now = P + (ptrdiff_t)(j + 1) * STATES * lanes + l;
            if (MIDDLE) {
                line(M, j, last, lanes, 1, WIDE, u + l, q, begin, half, end);
            }
            for (int c = 0; !MIDDLE && c < M; c++) {
                begin[c * WIDE] = u[(ptrdiff_t)(j * M + c) * lanes + l];
                end[c * WIDE] = u[(ptrdiff_t)((j + 1) * M + c) * lanes + l];
            }
            STEP(1, WIDE, x, begin, half, end, D_hat[l] / (double)last, p, y);
            margin = margin > 0.0 ? y[N + 1] : margin;
            for (int c = 0; c < STATES; c++) {
                x[c] = y[c];
                now[c * lanes] = margin > 0.0 ? y[c] : NAN;
            }
            x[N] = y[N];
        }
    }
}
#undef STATES
