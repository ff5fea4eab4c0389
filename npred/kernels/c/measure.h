/* OUTPUT: what the plant's sensors would show without errors. */
static inline void KERNEL(Shape d, const double *X, double t, const double *p, double *Y, double *work)
{
    (void)d, (void)work;
    SHOWN(X, t, p, Y);
}
