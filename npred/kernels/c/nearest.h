/* The point nearest to 0 that keeps linear conditions: min ½ Σ (δ_c / w_c)² so that a_i δ >= b_i, i < ROWS.
 *
 * It is found in the dual, max bᵀλ - ½ λᵀ G λ for λ >= 0, G = A W² Aᵀ + diag(soft), δ = W² Aᵀ λ, by the active sets
 * of Lawson and Hanson (Solving Least Squares Problems, 1974, ch. 23), with rows of the length 1. With soft_i > 0 a
 * condition may be missed, by soft_i λ_i: where no point keeps all, their squares weighed by 1 / soft_i are least.
 * Where one does, those soft_i λ_i are small; they are solved for once more, which leaves about soft_i² λ_i. */
#define PRECISE(precise, single) (sizeof(double) > 4 ? (precise) : (single)) /* an export may have floats */
#define ROOM PRECISE(1e-6, 1e-4) /* of soft_i λ_i: above it no point keeps all */
#define SOFT PRECISE(1e-9, 1e-5)   /* of conditions on states, whose rows have the length 1 */
#define BOUND PRECISE(1e-13, 1e-6) /* of those on v itself */
#define SOLVES (3 * ACTIVE) /* systems of active conditions that are solved at most */
#define SIDE (VARIABLES + 1) /* of a row: b, then a */
typedef struct {
    double seen[ROWS], lambda[ROWS], L[ACTIVE * ACTIVE], b[ACTIVE], y[ACTIVE], last[VARIABLES];
    int rows, states, active[ACTIVE]; /* conditions, of which the first ones are on states */
} Conditions;

static inline double soft(const Conditions *q, int i)
{
    return i < q->states ? SOFT : BOUND;
}

/* Element (i, j) of G, in the weights w. */
static inline double gram(const Conditions *q, const double *rows, const double *w, int i, int j)
{
    double sum = i == j ? soft(q, i) : 0.0;
    for (int c = 0; c < VARIABLES; c++) {
        sum += rows[i * SIDE + 1 + c] * w[c] * w[c] * rows[j * SIDE + 1 + c];
    }
    return sum;
}

/* y with G y = b for the active conditions, by Cholesky's factors, whose rows are known up to `known`. */
static inline void solve_active(Conditions *q, const double *rows, const double *w, int known, int count)
{
    double *const L = q->L, *const y = q->y;
    for (int i = known; i < count; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = gram(q, rows, w, q->active[i], q->active[j]);
            for (int k = 0; k < j; k++) {
                sum -= L[i * ACTIVE + k] * L[j * ACTIVE + k];
            }
            L[i * ACTIVE + j] = i == j ? sqrt(larger(sum, 1e-30)) : sum / L[j * ACTIVE + j];
        }
    }
    for (int i = 0; i < count; i++) {
        y[i] = q->b[i];
        for (int k = 0; k < i; k++) {
            y[i] -= L[i * ACTIVE + k] * y[k];
        }
        y[i] /= L[i * ACTIVE + i];
    }
    for (int i = count - 1; i >= 0; i--) {
        for (int k = i + 1; k < count; k++) {
            y[i] -= L[k * ACTIVE + i] * y[k];
        }
        y[i] /= L[i * ACTIVE + i];
    }
}

/* δ of λ. */
static inline void primal(const Conditions *q, const double *rows, const double *w, double *delta)
{
    for (int c = 0; c < VARIABLES; c++) {
        delta[c] = 0.0;
    }
    for (int i = 0; i < q->rows; i++) {
        for (int c = 0; c < VARIABLES && q->lambda[i] > 0.0; c++) {
            delta[c] += w[c] * w[c] * rows[i * SIDE + 1 + c] * q->lambda[i];
        }
    }
}

static inline void nearest(Conditions *q, const double *rows, const double *w, double *delta)
{
    double *const lambda = q->lambda, *const b = q->b, *const y = q->y;
    double way = 0.0; /* of δ so far */
    int *const active = q->active, count = 0, solves = 0, known = 0;
    for (int i = 0; i < q->rows; i++) {
        lambda[i] = 0.0;
        q->seen[i] = rows[i * SIDE];
    }
    for (int c = 0; c < VARIABLES; c++) {
        q->last[c] = 0.0;
    }
    while (solves < SOLVES && count < ACTIVE) {
        double most_missed = PRECISE(1e-12, 1e-6), step = 0.0;
        int worst = -1;
        primal(q, rows, w, delta);
        for (int c = 0; c < VARIABLES; c++) {
            const double part = (delta[c] - q->last[c]) / w[c];
            step += part * part;
            q->last[c] = delta[c];
        }
        way += sqrt(step) * (1.0 + PRECISE(1e-9, 1e-4));
        for (int i = 0; i < q->rows; i++) {
            if (!(q->seen[i] + way > most_missed)) { /* its length is 1: δ has not come so far */
                continue;
            }
            double missed = rows[i * SIDE] - soft(q, i) * lambda[i];
            for (int c = 0; c < VARIABLES; c++) {
                missed -= rows[i * SIDE + 1 + c] * delta[c];
            }
            q->seen[i] = missed + soft(q, i) * lambda[i] - way;
            if (!(lambda[i] > 0.0) && missed > most_missed) {
                most_missed = missed;
                worst = i;
            }
        }
        if (worst < 0) {
            break;
        }
        active[count++] = worst;
        for (; solves < SOLVES; solves++) {
            double share = 1.0;
            int kept = 0;
            for (int i = 0; i < count; i++) {
                b[i] = rows[active[i] * SIDE];
            }
            solve_active(q, rows, w, known, count);
            known = count;
            for (int i = 0; i < count; i++) {
                const double now = lambda[active[i]];
                share = y[i] <= 0.0 ? smaller(share, now / (now - y[i])) : share;
            }
            for (int i = 0; i < count; i++) {
                double *const value = lambda + active[i];
                *value += share * (y[i] - *value);
                if (share < 1.0 && *value <= 1e-14) {
                    *value = 0.0;
                    known = least(known, kept);
                } else {
                    active[kept++] = active[i];
                }
            }
            if (share >= 1.0 || kept == count) {
                solves++;
                break;
            }
            count = kept;
        }
    }
    double most_left = 0.0;
    for (int i = 0; i < count; i++) {
        b[i] = soft(q, active[i]) * lambda[active[i]];
        most_left = larger(most_left, b[i]);
    }
    if (most_left < ROOM) {
        solve_active(q, rows, w, known, count);
        for (int i = 0; i < count; i++) {
            lambda[active[i]] += y[i];
        }
    }
    primal(q, rows, w, delta);
}
