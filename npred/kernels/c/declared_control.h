/* CONTROL at the time s(1) when U acts, s = t + D(P(1), s): TIME is a step of Newton's method from s = t + D_hat. */
static inline void KERNEL(Shape d, const double *P, const double *u, const double *D_hat, double t, const double *p, double *U,
                   double *work)
{
    const double *x = P + (ptrdiff_t)(d.nx - 1) * N * d.lanes;
    (void)u, (void)work;
    for (int l = 0; l < d.lanes; l++) {
        double s = t + D_hat[l];
        for (int k = 0; k < STEPS; k++) {
            TIME(d.lanes, 1, x + l, s, t, p, &s);
        }
        LAW(d.lanes, x + l, s, p, U + l);
    }
}
