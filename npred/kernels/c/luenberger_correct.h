/* CORRECT_BY, of a Luenberger observer; its memory is that of luenberger_follow.h. What is measured takes the place of what
 * was expected, unless it is far from that: by its usual deviation, or by twice the last difference that was taken, so that
 * a right sample after a wrong one is taken. `spread` is 0 where it is far, else infinite. */
static inline void KERNEL(Shape d, const double *Y, double t, const double *p, double gate, const double *law,
                          double *memory, double *innovation, double *spread, double *work)
{
    double y[OUTPUTS], by_x[OUTPUTS * N], *w = memory + N + M, *variance = w + OUTPUTS;
    const double *usual = law + 1 + SIZE * OUTPUTS;
    (void)d, (void)work;
    OUTPUT(memory, t, p, y, by_x);
    for (int i = 0; i < OUTPUTS; i++) {
        const double away = 2.0 * (Y[i] - w[i]) / gate;
        const int far = fabs(Y[i] - w[i]) > gate * sqrt(variance[i]);
        innovation[i] = Y[i] - y[i];
        spread[i] = far ? 0.0 : INFINITY;
        if (!far && !isnan(Y[i])) {
            w[i] = Y[i];
            variance[i] = usual[i] + away * away;
        }
    }
}
