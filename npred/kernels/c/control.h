/* CONTROL: U = kappa(P(1)) at the time when it acts, t + D_hat. */
static inline void KERNEL(Shape d, const double *P, const double *u, const double *D_hat, double t, const double *p, double *U,
                   double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const double *x = P + (ptrdiff_t)last * N * lanes;
    (void)u, (void)work;
    for (int l = 0; l < lanes; l++) {
        const double h = D_hat[l] / (double)last;
        KAPPA(lanes, x + l, t + (double)last * h, p, U + l);
    }
}
