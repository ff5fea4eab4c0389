/* CORRECT: P = P_hat - e, with e' = D_hat f_P e + the defect of P_hat, e by Heun's method. */
static inline void KERNEL(Shape d, const double *P_hat, const double *X, const double *u, const double *D_hat, double t,
                   const double *p, double *P, double *work)
{
    const int lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        const double h = D_hat[l] / (double)(d.nx - 1);
        double e[N], f[N], g[N], y[N], slope[N];
        for (int c = 0; c < N; c++) {
            e[c] = P_hat[c * lanes + l] - X[c * lanes + l];
            P[c * lanes + l] = X[c * lanes + l];
        }
        F(lanes, 1, P_hat + l, u + l, t + 0.0 * h, p, f);
        for (int j = 1; j < d.nx; j++) {
            const double *before = P_hat + (ptrdiff_t)(j - 1) * N * lanes + l, *now = before + N * lanes;
            const double *u_before = u + (ptrdiff_t)(j - 1) * M * lanes + l, *u_now = u_before + M * lanes;
            SLOPE(lanes, 1, before, u_before, e, t + (double)(j - 1) * h, p, slope);
            F(lanes, 1, now, u_now, t + (double)j * h, p, y);
            for (int c = 0; c < N; c++) {
                g[c] = slope[c];
                e[c] += h * slope[c] + now[c * lanes] - before[c * lanes] - 0.5 * h * (f[c] + y[c]);
            }
            SLOPE(lanes, 1, now, u_now, e, t + (double)j * h, p, slope);
            for (int c = 0; c < N; c++) {
                e[c] += 0.5 * h * (slope[c] - g[c]);
                f[c] = y[c];
                P[((ptrdiff_t)j * N + c) * lanes + l] = now[c * lanes] - e[c];
            }
        }
    }
}
