/* TRANSPORT, ACTUATE and the input that acts during a control step, for callers in Python. */
#if WHICH == 0
static inline void KERNEL(Shape d, INDEX k, double dt, double *D, double *held, double *total, double *u, double *u_nodes,
                   double *work)
{
    (void)work;
    transport(d, k, 0.0, dt, D, held, total, u, u_nodes);
}
#elif WHICH == 1
static inline void KERNEL(Shape d, INDEX k, double dt, double *D, double *U, double *held, double *total, double *U0,
                   double *U1, double *share, double *work)
{
    (void)work;
    actuate(d, k, dt, D, U, held, total, U0, U1, share);
}
#else
static inline void KERNEL(Shape d, INDEX k, double dt, double *D, double *held, double *U, double *work)
{
    (void)work;
    for (int a = 0; a < d.m * d.lanes; a++) {
        double share;
        const INDEX i = leaving((double)k, dt, D[a], &share), next = i + 1 < k ? i + 1 : k;
        const ptrdiff_t row = (ptrdiff_t)d.m * d.lanes;
        U[a] = share * held[modulo(i, d.rows) * row + a] + (1.0 - share) * held[modulo(next, d.rows) * row + a];
    }
}
#endif
