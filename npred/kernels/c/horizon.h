/* HORIZON: the delay that the plant declares, of each input, and as D_hat. */
static inline void KERNEL(Shape d, const double *X, double t, const double *p, const double *ratios, double *D_hat, double *D,
                   double *work)
{
    (void)ratios, (void)work;
    for (int l = 0; l < d.lanes; l++) {
        VALUE(d.lanes, 1, X + l, t, p, D_hat + l);
        for (int c = 0; c < M; c++) {
            D[c * d.lanes + l] = D_hat[l];
        }
    }
}
