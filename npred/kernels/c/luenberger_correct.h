/* CORRECT_BY, of a Luenberger observer: what is measured takes the place of what was expected. It knows no spread. */
static inline void KERNEL(Shape d, const double *Y, double t, const double *p, double gate, const double *law,
                          double *memory, double *innovation, double *spread, double *work)
{
    double y[OUTPUTS], by_x[OUTPUTS * N], *w = memory + N + M;
    (void)d, (void)gate, (void)law, (void)work;
    OUTPUT(memory, t, p, y, by_x);
    for (int i = 0; i < OUTPUTS; i++) {
        innovation[i] = Y[i] - y[i];
        spread[i] = INFINITY;
        w[i] = isnan(Y[i]) ? w[i] : Y[i];
    }
}
