/* PREDICT by two chains of steps over the same nodes: STEP advances both, the state x (2 N); P is twice the second
 * less the first, of which STEP writes both the chains and P. `width` lanes fill a vector of SIDES, the last one all
 * that are left of it. */
static inline void PART(_block)(int nx, int lanes, int width, const double *X, const double *u, const double *D_hat,
                                double t, const double *p, double *P)
{
    const int last = nx - 1;
    double x[2 * N * SIDES], y[2 * N * SIDES], in[3 * M * SIDES], h[SIDES];
    for (int l = 0; l < SIDES; l++) {
        const int lane = least(l, width - 1);
        h[l] = D_hat[lane] / (double)last;
        for (int c = 0; c < N; c++) {
            x[c * SIDES + l] = x[(N + c) * SIDES + l] = P[c * lanes + lane] = X[c * lanes + lane];
        }
    }
    for (int j = 0; j < last; j++) {
        const double *a = u + (ptrdiff_t)(CELLS ? 2 * j : j) * M * lanes;
        double *after = P + (ptrdiff_t)(j + 1) * N * lanes;
        for (int k = 0; k < M * SIDES; k++) { /* at the begin, in the middle and at the end of the cell */
            const double *v = a + k / SIDES * lanes + least(k % SIDES, width - 1);
            in[k] = v[0];
            in[2 * M * SIDES + k] = v[M * lanes];
            in[M * SIDES + k] = 0.5 * (v[0] + v[M * lanes]);
        }
        LANES for (int l = 0; l < SIDES; l++) {
            STEP(SIDES, x + l, in + l, in + M * SIDES + l, in + 2 * M * SIDES + l, t + (double)j * h[l], h[l], p, y + l);
        }
        for (int c = 0; c < N; c++) {
            for (int l = 0; l < width; l++) {
                after[c * lanes + l] = 2.0 * y[(N + c) * SIDES + l] - y[c * SIDES + l];
            }
        }
        for (int k = 0; k < 2 * N * SIDES; k++) {
            x[k] = y[k];
        }
    }
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l += SIDES) {
        PART(_block)(d.nx, d.lanes, least(SIDES, d.lanes - l), X + l, u + l, D_hat + l, t, p, P + l);
    }
}
