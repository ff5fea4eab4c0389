/* PREDICT by successive approximations: P <- X + the integral of D_hat f(P, u) by the trapezoidal rule, until it changes
 * by no more than TOLERANCE of its size; NaN where SWEEPS of them do not do. */
static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    const int nx = d.nx, lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        const double h = D_hat[l] / (double)(nx - 1);
        int near = 0;
        for (int row = 0; row < nx * N; row++) {
            P[(ptrdiff_t)row * lanes + l] = X[row % N * lanes + l];
        }
        for (int k = 0; k < SWEEPS && !near; k++) {
            double total[N], before[N], f[N], change = 0.0, size = 0.0;
            for (int j = 0; j < nx; j++) {
                double *x = P + (ptrdiff_t)j * N * lanes + l;
                F(lanes, 1, x, u + (ptrdiff_t)j * M * lanes + l, t + (double)j * h, p, f);
                for (int c = 0; c < N; c++) {
                    const double y = j == 0 ? X[c * lanes + l] : total[c] + h / 2 * (before[c] + f[c]);
                    change = larger(change, fabs(y - x[c * lanes]));
                    size = larger(size, fabs(y));
                    total[c] = x[c * lanes] = y;
                    before[c] = f[c];
                }
            }
            near = change <= TOLERANCE * (1.0 + size);
        }
        for (int row = 0; !near && row < nx * N; row++) {
            P[(ptrdiff_t)row * lanes + l] = NAN;
        }
    }
}
