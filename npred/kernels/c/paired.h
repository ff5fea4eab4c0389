/* PREDICT by two chains of steps over the same nodes: STEP advances both, the state x (2 N); P is twice the second
 * less the first, of which STEP writes both the chains and P. */
static inline void PART(_lane)(int nx, int lanes, const double *X, const double *u, double D_hat, double t,
                               const double *p, double *P)
{
    const int last = nx - 1;
    const double h = D_hat / (double)last;
    double x[2 * N], y[2 * N];
    for (int c = 0; c < N; c++) {
        x[c] = x[N + c] = P[c * lanes] = X[c * lanes];
    }
    for (int j = 0; j < last; j++) {
        const double *a = u + (ptrdiff_t)(CELLS ? 2 * j : j) * M * lanes;
        STEP(1, lanes, x, a, a + M * lanes, t + (double)j * h, h, p, y);
        for (int c = 0; c < N; c++) {
            P[((ptrdiff_t)(j + 1) * N + c) * lanes] = 2.0 * y[N + c] - y[c];
        }
        for (int c = 0; c < 2 * N; c++) {
            x[c] = y[c];
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
