/* PROTECT: U as near to what it is as keeps h >= 0, in every state of `ends` that the plant may have when U acts.
 *
 * BARRIER says of a state x, at its time, the K values of h, of φ(x, U) = ψ' + α ψ, of a = φ_U and of pull = φ_x f_U; ψ is
 * h, or, where U acts on a higher derivative alone, ψ' + α ψ of the one before. φ >= margin keeps ψ from falling faster
 * than α ψ. φ is held to that at both ends of the control step over which U is held: the second state is a step of Heun's
 * method further, so that it is met to second order in the step. U moves it too, so that the conditions are made linear
 * around the last U until that no longer moves. `kept` is the least h of `ends`; `filtered` is 1 where U was changed, and
 * `unkept` where no U in its bounds meets the conditions. */
enum { ALPHA, MARGIN, STEP_LENGTH, WIDTHS };
#define SOFT 1e-9   /* of conditions on states, whose rows have the length 1 */
#define BOUND 1e-13 /* of the bounds of U */
#define PASSES 4    /* solutions of the linear conditions; the error of one is multiplied by about (alpha dt)² */
#define SETTLED 1e-9
#define MISSED 1e-6

/* Add a condition a δ >= b, in rows of the length 1; one that no input moves is left out. Gives by how much δ misses it. */
static inline double condition(Conditions *q, const double *w, const double *a, double b, const double *delta, double soft)
{
    double length = 0.0;
    for (int c = 0; c < M; c++) {
        length += a[c] * w[c] * a[c] * w[c];
        b -= a[c] * delta[c];
    }
    length = sqrt(length);
    if (!(length > 1e-12)) {
        return b;
    }
    double *const row = q->a + q->rows * M, *const bound = q->b + q->rows;
    *bound = b / length;
    for (int c = 0; c < M; c++) {
        row[c] = a[c] / length;
        *bound += row[c] * delta[c];
    }
    q->soft[q->rows++] = soft;
    return b / length;
}

/* The conditions of all ends on δ, linear around U + δ, of one lane, and the least h. Gives the most that U + δ misses. */
static inline double PART(_conditions)(int lanes, const double *ends, const double *moments, const double *p,
                                       const double *safety, const double *now, const double *delta, Conditions *q,
                                       double *least_h)
{
    const double step = safety[STEP_LENGTH];
    double missed = 0.0, U[M];
    for (int c = 0; c < M; c++) {
        U[c] = now[c] + delta[c];
    }
    for (int e = 0; e < ENDS; e++) {
        const double t = moments[e * lanes];
        double x[N], h[K], phi[K], a[K * M], pull[K * M];
        for (int c = 0; c < N; c++) {
            x[c] = ends[(e * N + c) * (ptrdiff_t)lanes];
        }
        for (int later = 0; later < 2; later++) {
            if (later) { /* a step of Heun's method, U held */
                double rate[N], second[N], trial[N];
                FLOW(1, 1, x, U, t, p, rate);
                for (int c = 0; c < N; c++) {
                    trial[c] = x[c] + step * rate[c];
                }
                FLOW(1, 1, trial, U, t + step, p, second);
                for (int c = 0; c < N; c++) {
                    x[c] += 0.5 * step * (rate[c] + second[c]);
                }
            }
            BARRIER(1, 1, x, U, t + (double)later * step, safety[ALPHA], p, h, phi, a, pull);
            for (int k = 0; k < K; k++) {
                double b = safety[MARGIN] - phi[k];
                for (int c = 0; c < M; c++) {
                    a[k * M + c] += (double)later * step * pull[k * M + c];
                    b += a[k * M + c] * delta[c];
                }
                *least_h = later ? *least_h : smaller(*least_h, h[k]);
                missed = larger(missed, condition(q, safety + WIDTHS, a + k * M, b, delta, SOFT));
            }
        }
    }
    return missed;
}

/* Find δ anew around the last one, within the bounds of U of one lane. Gives how far it moved, in widths of these. */
static inline double PART(_solve)(int lanes, const double *w, const double *low, const double *high, const double *now,
                                  Conditions *q, double *delta)
{
    double next[M], moved = 0.0;
    for (int c = 0; c < 2 * M; c++) {
        const int i = c / 2, upper = c % 2;
        const double room = upper ? now[i] - high[i * lanes] : low[i * lanes] - now[i];
        double unit[M] = {0.0};
        unit[i] = upper ? -1.0 : 1.0;
        if (isfinite(room)) {
            condition(q, w, unit, room, delta, BOUND);
        }
    }
    nearest(q, w, next);
    for (int c = 0; c < M; c++) {
        next[c] = smaller(larger(now[c] + next[c], low[c * lanes]), high[c * lanes]) - now[c];
        moved = larger(moved, fabs(next[c] - delta[c]) / w[c]);
        delta[c] = next[c];
    }
    return moved;
}

static inline void KERNEL(Shape d, const double *ends, const double *moments, const double *p, const double *safety,
                          const double *low, const double *high, double *U, double *kept, double *filtered, double *unkept,
                          double *work)
{
    const int lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        double now[M], within[M], delta[M], missed = 0.0, moved = INFINITY;
        filtered[l] = 0.0;
        for (int c = 0; c < M; c++) { /* what is beyond the bounds is not sent: it keeps nothing */
            now[c] = U[c * lanes + l];
            within[c] = delta[c] = smaller(larger(now[c], low[c * lanes + l]), high[c * lanes + l]) - now[c];
        }
        for (int pass = 0; pass <= PASSES; pass++) {
            Conditions q = {.rows = 0};
            kept[l] = INFINITY;
            missed = PART(_conditions)(lanes, ends + l, moments + l, p, safety, now, delta, &q, kept + l);
            if ((pass == 0 && !(missed > 0.0)) || moved < SETTLED || pass == PASSES) {
                break;
            }
            moved = PART(_solve)(lanes, safety + WIDTHS, low + l, high + l, now, &q, delta);
        }
        for (int c = 0; c < M; c++) {
            filtered[l] = delta[c] != within[c] ? 1.0 : filtered[l];
        }
        for (int c = 0; c < M && filtered[l] > 0.0; c++) {
            U[c * lanes + l] += delta[c];
        }
        unkept[l] = missed > MISSED ? 1.0 : 0.0;
    }
}
