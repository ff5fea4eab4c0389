/* PREDICT where the plant declares its delay: FLOW steps the state and the time s at which the input acts, both along x,
 * and MARGIN is 1 - D_X f - D_t; where that is not positive, P is NaN from the next node on. With TIMED, s is the last
 * state of X and P. */
#define STATES (N + TIMED)
static inline void PART(_lane)(int nx, int lanes, const double *X, const double *u, double D_hat, double t,
                               const double *p, double *P)
{
    const int last = nx - 1;
    double x[N + 1], y[N + 2], q[M * WIDE], begin[M * WIDE], half[M * WIDE], end[M * WIDE];
    for (int c = 0; c < STATES; c++) {
        P[c * lanes] = X[c * lanes];
    }
    for (int c = 0; c < N; c++) {
        x[c] = X[c * lanes];
    }
    x[N] = t;
    for (int j = 0; j < last; j++) {
        double *now = P + (ptrdiff_t)(j + 1) * STATES * lanes;
        if (MIDDLE) {
            line(M, j, last, lanes, 1, WIDE, u, q, begin, half, end);
        }
        for (int c = 0; !MIDDLE && c < M; c++) {
            begin[c * WIDE] = u[(ptrdiff_t)(j * M + c) * lanes];
            end[c * WIDE] = u[(ptrdiff_t)((j + 1) * M + c) * lanes];
        }
        STEP(1, WIDE, x, begin, half, end, D_hat / (double)last, p, y);
        for (int c = 0; c < STATES; c++) {
            now[c * lanes] = x[c] = y[c];
        }
        x[N] = y[N];
        if (!(y[N + 1] > 0.0)) {
            for (int row = 0; row < (last - j) * STATES; row++) {
                now[(ptrdiff_t)row * lanes] = NAN;
            }
            return;
        }
    }
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l++) {
        PART(_lane)(d.nx, d.lanes, X + l, u + l, D_hat[l], t, p, P + l);
    }
}
#undef STATES
