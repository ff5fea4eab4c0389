/* CONTROL: U = kappa(P(1)) at the time s when it acts, t + D_hat. Where the plant declares its delay, s(1) = t + D(P(1), s)
 * is found from there by STEPS of Newton's method, each of them TIME. */
static inline void KERNEL(Shape d, const double *P, const double *u, const double *D_hat, double t, const double *p, double *U,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const double *x = P + (ptrdiff_t)last * N * lanes;
    (void)u, (void)work;
    for (int l = 0; l < lanes; l++) {
#ifdef TIME
        double s = t + D_hat[l];
        for (int k = 0; k < STEPS; k++) {
            TIME(lanes, 1, x + l, s, t, p, &s);
        }
#else
        const double h = D_hat[l] / (double)last, s = t + (double)last * h;
#endif
        KAPPA(lanes, x + l, s, p, U + l);
    }
}
