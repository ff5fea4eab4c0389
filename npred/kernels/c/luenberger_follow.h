/* A piece of FOLLOW, of a Luenberger observer. Its memory: x (N), d (M), the outputs w (OUTPUTS), which go on from the
 * last sample by the plant, and the variances of their samples,
 *     x' = f(x, U + d) + L_x (w - y),   d' = L_d (w - y),   w' = y_x f(x, U + d) + y_t,   y = output(x).
 * `law` has the longest step of RK4, then L (SIZE, OUTPUTS) and those variances. */
static inline void PART(_piece)(const double *U, double t, double h, const double *p, const double *law, double *memory)
{
    const int steps = 1 + (int)smaller(h / law[0], 1000.0);
    const double part = h / (double)steps;
    for (int s = 0; s < steps; s++) {
        STEP(memory, U, law + 1, t + (double)s * part, part, p, memory);
    }
}
