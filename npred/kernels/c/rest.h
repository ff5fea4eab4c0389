/* SETTLE: z (N + M), the state X and the input U at rest for the parameters q, goes to their rest for the parameters p,
 * F(z; p) = (f(X, U), setpoint(X)) = 0, along
 *     F(z; q + s (p - q)) = (1 - s) F(z at the start; q),   s from 0 to 1.
 * So it stays on its branch of rests; from a z that is no rest, and with q = p, it is a search. At each s Newton's
 * method corrects z; SLOPE gives F and its change along v. Nothing is measured but corrections of z, in `units` (N + M),
 * so neither the unit of time nor those of the equations matter [Deuflhard, Newton Methods for Nonlinear Problems, 2011,
 * 2.1 and 5.1]. A step of s is halved where corrections do not halve, unless they are small, as next to a kink of f; it
 * is doubled where they do. *arrived is 1 where s came to 1 within CORRECTIONS, else 0; *kept is the smallest of SAFE
 * there, NaN where one is NaN, infinity where it has no LIMITS. */
#define SIZE (N + M)
#define CORRECTIONS 500 /* in all: what a call may cost */
#define TRIES 50        /* for one s */
#define SHORTEST 1e-6   /* step of s */
#define SMALL 0.01      /* correction, in units */
#define ASIDE 1e-3      /* units */
#define ARRIVED (sizeof(double) > 4 ? 1e-8 : 1e-3) /* a correction after which the next one is rounding */
#define SINGULAR (sizeof(double) > 4 ? 1e-11 : 1e-5) /* share of a row and a column */

/* v of A v = g, A (SIZE, SIZE) and g of which are changed, by elimination with the largest pivot of all, rows and columns
 * scaled to 1. What no equation moves gets 0. Gives the length of v and of what of g is left; NaN where A is not finite. */
static inline double PART(_solve)(double *A, double *g, double *v)
{
    double column[SIZE] = {0.0}, sum = 0.0;
    int order[SIZE], rank = 0;
    for (int i = 0; i < SIZE; i++) {
        double row = 0.0;
        for (int j = 0; j < SIZE; j++) {
            row = larger(row, fabs(A[i * SIZE + j]));
            sum += 0.0 * A[i * SIZE + j];
        }
        for (int j = 0; j < SIZE; j++) {
            A[i * SIZE + j] /= row > 0.0 ? row : 1.0;
            column[j] = larger(column[j], fabs(A[i * SIZE + j]));
        }
        g[i] = row > 0.0 ? g[i] / row : g[i] == 0.0 ? 0.0 : INFINITY;
        order[i] = i;
    }
    for (int k = 0; k < SIZE * SIZE; k++) {
        A[k] /= column[k % SIZE] > 0.0 ? column[k % SIZE] : 1.0;
    }
    for (; rank < SIZE; rank++) {
        int best = rank * SIZE + rank;
        for (int k = rank * SIZE; k < SIZE * SIZE; k++) {
            best = k % SIZE >= rank && fabs(A[k]) > fabs(A[best]) ? k : best;
        }
        if (!(fabs(A[best]) > SINGULAR)) {
            break;
        }
        const int row = best / SIZE, other = best % SIZE, moved = order[other];
        const double right = g[row];
        for (int j = 0; j < SIZE; j++) {
            const double held = A[row * SIZE + j];
            A[row * SIZE + j] = A[rank * SIZE + j];
            A[rank * SIZE + j] = held;
        }
        for (int i = 0; i < SIZE; i++) {
            const double held = A[i * SIZE + other];
            A[i * SIZE + other] = A[i * SIZE + rank];
            A[i * SIZE + rank] = held;
        }
        g[row] = g[rank], g[rank] = right;
        order[other] = order[rank], order[rank] = moved;
        for (int i = rank + 1; i < SIZE; i++) {
            const double share = A[i * SIZE + rank] / A[rank * SIZE + rank];
            for (int j = rank; j < SIZE; j++) {
                A[i * SIZE + j] -= share * A[rank * SIZE + j];
            }
            g[i] -= share * g[rank];
        }
    }
    for (int k = SIZE - 1; k >= 0; k--) {
        sum += k < rank ? 0.0 : g[k] * g[k];
        for (int j = k + 1; j < rank; j++) {
            g[k] -= A[k * SIZE + j] * g[j];
        }
        g[k] = k < rank ? g[k] / A[k * SIZE + k] : 0.0;
    }
    for (int k = 0; k < SIZE; k++) {
        v[order[k]] = k < rank ? g[k] / column[order[k]] : 0.0;
        sum += v[order[k]] * v[order[k]];
    }
    return sqrt(sum);
}

/* Newton's corrections of z towards F(z; p) = left * start. Gives 1 where they end in rounding, else 0; *spent counts. */
static inline int PART(_corrected)(const double *p, const double *start, double left, const double *units, double *z,
                                   int *spent)
{
    double A[SIZE * SIZE], g[SIZE], v[SIZE], slope[SIZE], before = INFINITY;
    for (int k = 0; k < TRIES && *spent < CORRECTIONS; k++) {
        for (int j = 0; j < SIZE; j++) {
            for (int i = 0; i < SIZE; i++) {
                v[i] = i == j ? units[i] : 0.0;
            }
            SLOPE(z, v, p, g, slope);
            for (int i = 0; i < SIZE; i++) {
                A[i * SIZE + j] = slope[i];
            }
        }
        for (int i = 0; i < SIZE; i++) {
            g[i] -= left * start[i];
        }
        const double size = PART(_solve)(A, g, v);
        ++*spent;
        const int halves = size <= 0.5 * before;
        if (!(size < INFINITY && (halves || size <= SMALL))) {
            return 0;
        }
        if (before <= ARRIVED && !(halves && size > 0.0)) {
            return 1;
        }
        for (int i = 0; i < SIZE; i++) {
            z[i] -= units[i] * v[i];
        }
        if (size <= ARRIVED && left > 0.0) { /* near enough on the way */
            return 1;
        }
        before = size;
    }
    return before <= ARRIVED;
}

static inline void KERNEL(Shape d, const double *q, const double *p, const double *units, double *z, double *arrived,
                          double *kept, double *work)
{
    double origin[SIZE], start[SIZE], none[SIZE] = {0.0}, next[SIZE], between[PARAMETERS], s = 0.0;
    int spent = 0;
    (void)d, (void)work;
    for (int i = 0; i < SIZE; i++) {
        origin[i] = z[i];
    }
    for (int turn = 0; turn < 2 && s < 1.0; turn++) { /* once more from aside: F may have no slope where it rests */
        double share = 1.0;
        for (int i = 0; i < SIZE; i++) {
            z[i] = origin[i] + (turn > 0 ? ASIDE : 0.0) * units[i];
        }
        SLOPE(z, none, q, start, next);
        s = 0.0;
        while (s < 1.0 && share > SHORTEST && spent < CORRECTIONS) {
            const double there = smaller(s + share, 1.0);
            for (int k = 0; k < PARAMETERS; k++) {
                between[k] = there < 1.0 ? q[k] + there * (p[k] - q[k]) : p[k];
            }
            for (int i = 0; i < SIZE; i++) {
                next[i] = z[i];
            }
            const int moved = PART(_corrected)(between, start, 1.0 - there, units, next, &spent);
            for (int i = 0; i < SIZE && moved; i++) {
                z[i] = next[i];
            }
            s = moved ? there : s;
            share = moved ? 2.0 * share : 0.5 * (there - s);
        }
    }
    *arrived = s < 1.0 ? 0.0 : 1.0;
    *kept = INFINITY;
#if LIMITS > 0
    double limits[LIMITS];
    SAFE(z, p, limits);
    for (int k = 0; k < LIMITS; k++) {
        *kept = isnan(limits[k]) ? NAN : limits[k] < *kept ? limits[k] : *kept;
    }
#endif
}
#undef SIZE
#undef CORRECTIONS
#undef TRIES
#undef SHORTEST
#undef SMALL
#undef ASIDE
#undef ARRIVED
#undef SINGULAR
