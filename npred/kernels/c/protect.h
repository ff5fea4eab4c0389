/* PROTECT: U as near to what it is as keeps h >= 0, in every state of `ends` that the plant may have when U acts.
 *
 * BARRIER says of such a state x, at its time, the K values of h, of φ(x, U) = ψ' + α ψ, of a = φ_U, and of the change of
 * φ with U held; ψ is h, or, where U acts on a higher derivative alone, ψ' + α ψ of the one before. φ >= margin keeps ψ
 * from falling faster than α ψ. φ is held to that now and at the end of the control step. `kept` is the least h. */
enum { ALPHA, MARGIN, STEP_LENGTH, WIDTHS };
#define SOFT 1e-9   /* of conditions on states, whose rows have the length 1 */
#define BOUND 1e-13 /* of the bounds of U */

/* Add a condition a δ >= b, in rows of the length 1; one that no input moves is left out. */
static inline void condition(Conditions *q, const double *w, const double *a, double b, double soft)
{
    double length = 0.0;
    for (int c = 0; c < M; c++) {
        length += a[c] * w[c] * a[c] * w[c];
    }
    length = sqrt(length);
    if (!(length > 1e-12)) {
        return;
    }
    for (int c = 0; c < M; c++) {
        q->a[q->rows * M + c] = a[c] / length;
    }
    q->b[q->rows] = b / length;
    q->soft[q->rows] = soft;
    q->rows++;
}

/* The conditions of all ends, of lane l, and the least h. Gives 1 where U as it is misses one. */
static inline int PART(_conditions)(int lanes, int count, const double *ends, const double *moments, const double *p,
                                    const double *safety, const double *U, Conditions *q, double *least_h)
{
    const double *w = safety + WIDTHS;
    int missed = 0;
    for (int e = 0; e < count; e++) {
        double h[K], phi[K], a[K * M], change[K];
        BARRIER(lanes, 1, ends + (ptrdiff_t)e * N * lanes, U, moments[e * lanes], safety[ALPHA], p, h, phi, a, change);
        for (int k = 0; k < K; k++) {
            const double b = safety[MARGIN] + larger(-safety[STEP_LENGTH] * change[k], 0.0) - phi[k];
            *least_h = smaller(*least_h, h[k]);
            missed = missed || b > 0.0;
            condition(q, w, a + k * M, b, SOFT);
        }
    }
    return missed;
}

static inline void KERNEL(Shape d, const double *ends, const double *moments, const double *p, const double *safety,
                          const double *low, const double *high, double *U, double *kept, double *filtered, double *work)
{
    const int lanes = d.lanes;
    (void)work;
    for (int l = 0; l < lanes; l++) {
        Conditions q = {.rows = 0, .size = M};
        double delta[M], unit[M], missed = 0.0;
        kept[l] = INFINITY;
        filtered[l] = 0.0;
        if (!PART(_conditions)(lanes, ENDS, ends + l, moments + l, p, safety, U + l, &q, kept + l)) {
            continue;
        }
        const int states = q.rows;
        for (int c = 0; c < 2 * M; c++) {
            const int i = c / 2, upper = c % 2;
            const double now = U[i * lanes + l], room = upper ? now - high[i * lanes + l] : low[i * lanes + l] - now;
            for (int k = 0; k < M; k++) {
                unit[k] = k == i ? (upper ? -1.0 : 1.0) : 0.0;
            }
            if (isfinite(room)) {
                condition(&q, safety + WIDTHS, unit, room, BOUND);
            }
        }
        nearest(&q, safety + WIDTHS, delta);
        for (int c = 0; c < M; c++) {
            double *const value = U + c * lanes + l;
            delta[c] = smaller(larger(*value + delta[c], low[c * lanes + l]), high[c * lanes + l]) - *value;
            *value += delta[c];
        }
        for (int i = 0; i < states; i++) {
            double left = q.b[i];
            for (int c = 0; c < M; c++) {
                left -= q.a[i * M + c] * delta[c];
            }
            missed = larger(missed, left);
        }
        filtered[l] = missed > 1e-6 ? 2.0 : 1.0;
    }
}
