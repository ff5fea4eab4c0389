/* SETTLE: z (N + M), the state X and the input U, to the rest of the set-point that p says, by Newton's method from where
 * z is: f(X, U) = 0 and setpoint(X) = 0. SLOPE gives these and their change along v. A step is halved while they do not
 * fall, and none is taken that does not make them fall. *arrived is 1 where they are 0 in the end, else 0. */
#define SIZE (N + M)
#define STEPS 100
#define SHORTEST 1e-8 /* share of a step */
#define LEFT (sizeof(double) > 4 ? 1e-9 : 1e-4) /* residual relative to max(1, |z|); in float it is rounding */
static inline double PART(_norm)(const double *a)
{
    double sum = 0.0;
    for (int i = 0; i < SIZE; i++) {
        sum += a[i] * a[i];
    }
    return sqrt(sum);
}

/* v of A v = g, of which A (SIZE, SIZE) is changed, by elimination with the largest pivot. Gives 0 where there is none. */
static inline int PART(_solve)(double *A, const double *g, double *v)
{
    for (int i = 0; i < SIZE; i++) {
        v[i] = g[i];
    }
    for (int k = 0; k < SIZE; k++) {
        int best = k;
        for (int i = k + 1; i < SIZE; i++) {
            best = fabs(A[i * SIZE + k]) > fabs(A[best * SIZE + k]) ? i : best;
        }
        if (!(fabs(A[best * SIZE + k]) > 0.0)) {
            return 0;
        }
        for (int j = 0; j <= SIZE; j++) {
            double *one = j < SIZE ? A + k * SIZE + j : v + k, *other = j < SIZE ? A + best * SIZE + j : v + best;
            const double held = *one;
            *one = *other;
            *other = held;
        }
        for (int i = k + 1; i < SIZE; i++) {
            const double share = A[i * SIZE + k] / A[k * SIZE + k];
            for (int j = k; j < SIZE; j++) {
                A[i * SIZE + j] -= share * A[k * SIZE + j];
            }
            v[i] -= share * v[k];
        }
    }
    for (int k = SIZE - 1; k >= 0; k--) {
        for (int j = k + 1; j < SIZE; j++) {
            v[k] -= A[k * SIZE + j] * v[j];
        }
        v[k] /= A[k * SIZE + k];
    }
    return 1;
}

static inline void KERNEL(Shape d, const double *p, double *z, double *arrived, double *work)
{
    double A[SIZE * SIZE], g[SIZE], v[SIZE] = {0.0}, slope[SIZE], next[SIZE], there[SIZE], size, share;
    (void)d, (void)work;
    SLOPE(z, v, p, g, slope);
    size = PART(_norm)(g);
    for (int k = 0; k < STEPS && size > 0.0; k++) {
        for (int j = 0; j < SIZE; j++) {
            for (int i = 0; i < SIZE; i++) {
                v[i] = i == j ? 1.0 : 0.0;
            }
            SLOPE(z, v, p, g, slope);
            for (int i = 0; i < SIZE; i++) {
                A[i * SIZE + j] = slope[i];
            }
        }
        if (!PART(_solve)(A, g, v)) {
            break;
        }
        for (share = 1.0; share > SHORTEST; share *= 0.5) {
            for (int i = 0; i < SIZE; i++) {
                next[i] = z[i] - share * v[i];
            }
            SLOPE(next, v, p, there, slope);
            if (PART(_norm)(there) < size) {
                break;
            }
        }
        if (!(share > SHORTEST)) {
            break;
        }
        size = PART(_norm)(there);
        for (int i = 0; i < SIZE; i++) {
            z[i] = next[i];
        }
    }
    *arrived = size <= LEFT * larger(1.0, PART(_norm)(z)) ? 1.0 : 0.0;
}
#undef SIZE
#undef STEPS
#undef SHORTEST
#undef LEFT
