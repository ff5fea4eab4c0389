/* SPEED: of phi(t) = t - D with U acting, 1 - D_X f - D_t. */
static inline void KERNEL(Shape d, const double *X, const double *U, double t, const double *p, double *speed, double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l++) {
        double value;
        VALUE(d.lanes, 1, X + l, U + l, t, p, &value);
        for (int c = 0; c < M; c++) {
            speed[c * d.lanes + l] = value;
        }
    }
}
