/* The point nearest to 0 that keeps linear conditions: min ½ Σ (δ_c / w_c)² so that a_i δ >= b_i, i < ROWS.
 *
 * It is found in the dual, max bᵀλ - ½ λᵀ G λ for λ >= 0, G = A W² Aᵀ + diag(soft), δ = W² Aᵀ λ, by the active sets of
 * Lawson and Hanson (Solving Least Squares Problems, 1974, ch. 23), with rows of the length 1. With soft_i > 0 a
 * condition may be missed, by soft_i λ_i: where no point keeps all, their squares weighed by 1 / soft_i are least. Where
 * one does, those soft_i λ_i are small; they are solved for once more, which leaves about soft_i² λ_i. */
#define PRECISE(double_precision, single) (sizeof(double) > 4 ? (double_precision) : (single)) /* an export may have floats */
#define ROOM PRECISE(1e-6, 1e-4) /* of soft_i λ_i: above it no point keeps all */
typedef struct {
    int rows; /* conditions */
    double a[ROWS * VARIABLES], b[ROWS], soft[ROWS];
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
static inline double gram(const Conditions *q, const double *w, int i, int j)
{
    double sum = i == j ? q->soft[i] : 0.0;
    for (int c = 0; c < VARIABLES; c++) {
        sum += q->a[i * VARIABLES + c] * w[c] * w[c] * q->a[j * VARIABLES + c];
    }
    return sum;
}

/* δ of λ. */
static inline void primal(const Conditions *q, const double *w, const double *lambda, double *delta)
{
    for (int c = 0; c < VARIABLES; c++) {
        delta[c] = 0.0;
    }
    for (int i = 0; i < q->rows; i++) {
        for (int c = 0; c < VARIABLES && lambda[i] > 0.0; c++) {
            delta[c] += w[c] * w[c] * q->a[i * VARIABLES + c] * lambda[i];
        }
    }
}

static inline void nearest(const Conditions *q, const double *w, double *delta)
{
    double lambda[ROWS] = {0.0}, G[ACTIVE * ACTIVE], L[ACTIVE * ACTIVE], b[ACTIVE], y[ACTIVE];
    int active[ACTIVE], count = 0;
    for (int round = 0; round < 3 * ACTIVE && count < ACTIVE; round++) {
        double most_missed = PRECISE(1e-12, 1e-6);
        int worst = -1;
        primal(q, w, lambda, delta);
        for (int i = 0; i < q->rows; i++) {
            double missed = q->b[i] - q->soft[i] * lambda[i];
            for (int c = 0; c < VARIABLES; c++) {
                missed -= q->a[i * VARIABLES + c] * delta[c];
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
        for (int tries = 0; tries < ACTIVE; tries++) {
            double share = 1.0;
            int kept = 0;
            for (int i = 0; i < count; i++) {
                b[i] = q->b[active[i]];
                for (int j = 0; j < count; j++) {
                    G[i * ACTIVE + j] = gram(q, w, active[i], active[j]);
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
            G[i * ACTIVE + j] = gram(q, w, active[i], active[j]);
        }
    }
    if (most_left < ROOM) {
        solve_active(count, G, b, L, y);
        for (int i = 0; i < count; i++) {
            lambda[active[i]] += y[i];
        }
    }
    primal(q, w, lambda, delta);
}
