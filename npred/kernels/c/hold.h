/* The simulated actuator, which no controller has: it holds U over a control step, and hands it on after the delay. */

/* Hold U over control step k, and say what leaves the delay meanwhile: U0 for the first `share` of it, then U1. */
static inline void actuate(Shape d, INDEX k, double dt, const double *D, const double *U, double *held, double *total,
                           double *U0, double *U1, double *share)
{
    const ptrdiff_t row = (ptrdiff_t)d.m * d.lanes;
    const ptrdiff_t now = modulo(k, d.rows) * row, next = modulo(k + 1, d.rows) * row;
    for (ptrdiff_t a = 0; a < row; a++) {
        const INDEX i = leaving((double)k, dt, D[a], share + a);
        held[now + a] = U[a];
        total[next + a] = total[now + a] + U[a];
        U0[a] = held[modulo(i, d.rows) * row + a];
        U1[a] = held[modulo(i + 1, d.rows) * row + a];
    }
}

/* The same where the delay changes during the step: phi(t) = t - D passes the commands at that speed. The first switch
 * comes when phi has passed the rest of its control step; all that follows it is U1, the mean of the commands over what
 * is left. A speed that is not positive, at a jump of the delay say, holds U0. */
static inline void retime(Shape d, INDEX k, double dt, const double *D, const double *speed, const double *held,
                          double *U1, double *share)
{
    const ptrdiff_t row = (ptrdiff_t)d.m * d.lanes;
    for (ptrdiff_t a = 0; a < row; a++) {
        double rest, left, total = 0.0, mean;
        INDEX i = leaving((double)k, dt, D[a], &rest);
        share[a] = 1.0;
        if (!(speed[a] > rest)) {
            continue;
        }
        share[a] = rest / speed[a];
        left = speed[a] - rest;
        i++;
        mean = held[modulo(i < k ? i : k, d.rows) * row + a];
        while (left > 1.0 && i < k) {
            total += held[modulo(i, d.rows) * row + a];
            left -= 1.0;
            i++;
            mean = (total + left * held[modulo(i, d.rows) * row + a]) / (speed[a] - rest);
        }
        U1[a] = mean;
    }
}
