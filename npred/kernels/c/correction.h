/* CORRECT: P = P_hat - e, with e' = D_hat f_P e + the defect of P_hat, e by Heun's method. */
static inline void PART(_lane)(int nx, int lanes, const double *P_hat, const double *X, const double *u, double D_hat,
                               double t, const double *p, double *P)
{
    const double h = D_hat / (double)(nx - 1);
    double e[N], f[N], g[N], y[N], slope[N];
    for (int c = 0; c < N; c++) {
        e[c] = P_hat[c * lanes] - X[c * lanes];
        P[c * lanes] = X[c * lanes];
    }
    F(lanes, 1, P_hat, u, t + 0.0 * h, p, f);
    for (int j = 1; j < nx; j++) {
        const double *before = P_hat + (ptrdiff_t)(j - 1) * N * lanes, *now = before + N * lanes;
        const double *u_before = u + (ptrdiff_t)(j - 1) * M * lanes, *u_now = u_before + M * lanes;
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
            P[((ptrdiff_t)j * N + c) * lanes] = now[c * lanes] - e[c];
        }
    }
}

static inline void KERNEL(Shape d, const double *P_hat, const double *X, const double *u, const double *D_hat, double t,
                   const double *p, double *P, double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l++) {
        PART(_lane)(d.nx, d.lanes, P_hat + l, X + l, u + l, D_hat[l], t, p, P + l);
    }
}
