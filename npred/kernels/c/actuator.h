/* The actuator state u(x, t) = U(t + D (x - 1)). U is held over each control step, so the history is piecewise constant
 * and everything here is exact. Row k of the ring buffers, modulo `rows`: held has U on [k dt, (k + 1) dt), total the
 * sum of U over the steps before k. */
#define ROUNDING 1e-9 /* of a control step: positions this close to a step's start are on it */

/* The integral of U over time up to position s, in control steps. */
static inline double sum_to(double s, int c, int l, Shape d, INDEX wrap, const double *held, const double *total)
{
    const INDEX i = (INDEX)(s + ROUNDING);
    const INDEX row = i >= wrap ? i - wrap : i - wrap + d.rows;
    const ptrdiff_t at = ((ptrdiff_t)row * d.m + c) * d.lanes + l;
    return total[at] + larger(s - (double)i, 0.0) * held[at];
}

/* u at `part` of control step k, for the delays D (m, lanes). The predictor integrates u: `u` has the mean over each
 * node's cell, and the trapezoidal rule on cell means is the integral of the held input on any grid. The update law
 * compares u with kappa(P): `u_nodes`, where it is asked for, has values at the nodes, linear between the starts of
 * control steps, where U = kappa(P(1)) was commanded; the held value lags behind by half a step on average. At x = 1 it is
 * the newest U, from the left. */
static INLINED void transport(Shape d, INDEX k, double part, double dt, const double *D, const double *held,
                              const double *total, double *u, double *u_nodes)
{
    const int last = d.nx - 1;
    const INDEX wrap = k - k % d.rows, newest = part > 0.0 ? k : k - 1;
    const double now = (double)k + part;
    const ptrdiff_t newest_row = modulo(newest, d.rows);
    for (int c = 0; c < d.m; c++) {
        for (int from = 0; from < d.lanes; from += WIDE) {
            const int width = least(WIDE, d.lanes - from);
            double span[WIDE], before[WIDE] = {0.0}, sum_before[WIDE] = {0.0};
            for (int l = 0; l < width; l++) {
                const double longest = (double)(k < d.rows - 1 ? k : d.rows - 1), steps = D[c * d.lanes + from + l] / dt;
                span[l] = steps > 0.0 ? smaller(steps, longest) : 0.0; /* NaN, of a loop that ended, reads 0 */
                before[l] = now - span[l];
                sum_before[l] = sum_to(before[l], c, from + l, d, wrap, held, total);
            }
            for (int j = 0; j < d.nx; j++) {
                const double node = 1.0 - (double)j / (double)last, edge = larger(1.0 - ((double)j + 0.5) / (double)last, 0.0);
                const ptrdiff_t row = ((ptrdiff_t)j * d.m + c) * d.lanes + from;
                for (int l = 0; l < width; l++) {
                    const double s = now - edge * span[l], position = now - node * span[l];
                    const double sum_s = sum_to(s, c, from + l, d, wrap, held, total);
                    INDEX i = (INDEX)(position + ROUNDING), after;
                    i = i < newest ? i : newest;
                    after = i < newest ? i + 1 : newest;
                    u[row + l] = s > before[l]
                                     ? (sum_s - sum_before[l]) / (s - before[l])
                                     : held[(newest_row * d.m + c) * d.lanes + from + l];
                    before[l] = s;
                    sum_before[l] = sum_s;
                    if (u_nodes) {
                        const INDEX here = i < wrap ? i - wrap + d.rows : i - wrap;
                        const double begin = held[((ptrdiff_t)here * d.m + c) * d.lanes + from + l];
                        after = after < wrap ? after - wrap + d.rows : after - wrap;
                        u_nodes[row + l] =
                            begin + larger(position - (double)i, 0.0) *
                                        (held[((ptrdiff_t)after * d.m + c) * d.lanes + from + l] - begin);
                    }
                }
            }
        }
    }
}

/* The step whose command leaves a delay D at a time, in control steps, and for how much of a step it does. */
static inline INDEX leaving(double at, double dt, double D, double *share)
{
    const double s = isfinite(D) ? at - D / dt : at; /* that of a loop that ended is NaN */
    const double i = floor(s + ROUNDING);
    *share = s - i > ROUNDING ? 1.0 - (s - i) : 1.0;
    return (INDEX)i;
}
