/* PREDICT by two chains of steps over the same nodes: STEP advances both, the state x (2 N); P is twice the second
 * less the first, of which STEP writes both the chains and P. */
static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        const double h = D_hat[l] / (double)last;
        double x[2 * N], y[2 * N];
        for (int c = 0; c < N; c++) {
            x[c] = x[N + c] = P[c * lanes + l] = X[c * lanes + l];
        }
        for (int j = 0; j < last; j++) {
            const double *a = u + (ptrdiff_t)(CELLS ? 2 * j : j) * M * lanes + l;
            STEP(1, lanes, x, a, a + M * lanes, t + (double)j * h, h, p, y);
            for (int c = 0; c < N; c++) {
                P[((ptrdiff_t)(j + 1) * N + c) * lanes + l] = 2.0 * y[N + c] - y[c];
            }
            for (int c = 0; c < 2 * N; c++) {
                x[c] = y[c];
            }
        }
    }
}
