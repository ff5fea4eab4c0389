/* The observers of a plant that is called, not traced: what is the same for all plants. */
#if BEFORE /* count a control step, and write the gains (4, lanes) of its samples; at first, start the observers */
static inline void KERNEL(Shape d, double dt, const double *X, const double *law, double *memory, double *gain, double *work)
{
    const Bank b = bank(d, law, memory);
    (void)work;
    if (isnan(b.gap[0])) {
        begin_bank(d, &b, X);
        return;
    }
    for (int l = 0; l < d.lanes; l++) {
        gains(d, &b, l, X[l], dt, law, gain);
    }
}
#else /* move the estimates */
static inline void KERNEL(Shape d, const double *X, const double *law, double *memory, const double *gain, double *D_hat,
                   double *work)
{
    const Bank b = bank(d, law, memory);
    for (int l = 0; l < d.lanes; l++) {
        choose(d, &b, l, X, gain, law, work, D_hat);
    }
}
#endif
