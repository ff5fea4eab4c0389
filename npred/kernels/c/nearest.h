/* The point nearest to 0 that keeps linear conditions: min ½ Σ (δ_c / w_c)² so that a_i δ >= b_i, i < ROWS.
 *
 * It is found in the dual, max bᵀλ - ½ λᵀ G λ for λ >= 0, G = A W² Aᵀ + diag(soft), δ = W² Aᵀ λ, by the active sets of
 * Lawson and Hanson (Solving Least Squares Problems, 1974, ch. 23), with rows of the length 1. With soft_i > 0 a
 * condition may be missed, by soft_i λ_i: where no point keeps all, their squares weighed by 1 / soft_i are least. Where
 * one does, those soft_i λ_i are small; they are solved for once more, which leaves about soft_i² λ_i. */
#define PRECISE(double_precision, single) (sizeof(double) > 4 ? (double_precision) : (single)) /* an export may have floats */
#define ROOM PRECISE(1e-6, 1e-4) /* of soft_i λ_i: above it no point keeps all */
#define SOLVES (3 * ACTIVE) /* systems of active conditions that are solved at most */
#define SIDE (VARIABLES + 1) /* of a row: b, then a */
typedef struct {
    double soft[ROWS], lambda[ROWS], G[ACTIVE * ACTIVE], L[ACTIVE * ACTIVE], b[ACTIVE], y[ACTIVE];
    int rows, active[ACTIVE]; /* conditions */
} Conditions;

/* λ of the active conditions, by Cholesky's factors of their G. */
static inline void solve_active(int count, const double *G, const double *b, double *L, double *y)
{
    for (int i = 0; i < count; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = G[i * ACTIVE + j];
            for (int k = 0; k < j; k++) {
                sum -= L[i * ACTIVE + k] * L[j * ACTIVE + k];
            }
            L[i * ACTIVE + j] = i == j ? sqrt(larger(sum, 1e-30)) : sum / L[j * ACTIVE + j];
        }
    }
    for (int i = 0; i < count; i++) {
        y[i] = b[i];
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

/* Element (i, j) of G, in the weights w. */
static inline double gram(const Conditions *q, const double *rows, const double *w, int i, int j)
{
    double sum = i == j ? q->soft[i] : 0.0;
    for (int c = 0; c < VARIABLES; c++) {
        sum += rows[i * SIDE + 1 + c] * w[c] * w[c] * rows[j * SIDE + 1 + c];
    }
    return sum;
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
    double *const lambda = q->lambda, *const G = q->G, *const L = q->L, *const b = q->b, *const y = q->y;
    int *const active = q->active, count = 0, solves = 0;
    for (int i = 0; i < q->rows; i++) {
        lambda[i] = 0.0;
    }
    while (solves < SOLVES && count < ACTIVE) {
        double most_missed = PRECISE(1e-12, 1e-6);
        int worst = -1;
        primal(q, rows, w, delta);
        for (int i = 0; i < q->rows; i++) {
            double missed = rows[i * SIDE] - q->soft[i] * lambda[i];
            for (int c = 0; c < VARIABLES; c++) {
                missed -= rows[i * SIDE + 1 + c] * delta[c];
            }
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
                for (int j = 0; j < count; j++) {
                    G[i * ACTIVE + j] = gram(q, rows, w, active[i], active[j]);
                }
            }
            solve_active(count, G, b, L, y);
            for (int i = 0; i < count; i++) {
                const double now = lambda[active[i]];
                share = y[i] <= 0.0 ? smaller(share, now / (now - y[i])) : share;
            }
            for (int i = 0; i < count; i++) {
                double *const value = lambda + active[i];
                *value += share * (y[i] - *value);
                if (share < 1.0 && *value <= 1e-14) {
                    *value = 0.0;
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
        b[i] = q->soft[active[i]] * lambda[active[i]];
        most_left = larger(most_left, b[i]);
        for (int j = 0; j < count; j++) {
            G[i * ACTIVE + j] = gram(q, rows, w, active[i], active[j]);
        }
    }
    if (most_left < ROOM) {
        solve_active(count, G, b, L, y);
        for (int i = 0; i < count; i++) {
            lambda[active[i]] += y[i];
        }
    }
    primal(q, rows, w, delta);
}
