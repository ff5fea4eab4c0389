/* What the controller sees of the plant, and the state that it believes between samples. Random numbers are a function
 * of the seed, the loop, the sample and the state: they depend neither on the batch nor on the order of evaluation. */
enum { NOISE = 1, GAP = 2, DROP = 3, ABSOLUTE = 4 }; /* what a random number is for */

/* A number of (0, 1) that those five decide: SplitMix64 [Steele, Lea, Flood 2014], a round for each. */
static inline double uniform(int64_t seed, int64_t loop, int64_t number, int64_t state, int64_t purpose)
{
    const int64_t parts[] = {seed, loop, number, state, purpose};
    uint64_t z = 0x9E3779B97F4A7C15u;
    for (int k = 0; k < 5; k++) {
        z = (z ^ (uint64_t)parts[k]) + 0x9E3779B97F4A7C15u;
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
        z = z ^ (z >> 31);
    }
    return ((double)(z >> 11) + 0.5) / 9007199254740992.0; /* 2^53 */
}

/* A standard normal number [Box and Muller 1958]. */
static inline double normal(int64_t seed, int64_t loop, int64_t number, int64_t state, int64_t purpose)
{
    const double radius = sqrt(-2.0 * log(uniform(seed, loop, number, state, purpose)));
    return radius * cos(2.0 * 3.141592653589793 * uniform(seed, loop, number, state, -purpose));
}

/* What sensors make of `count` components of x, one lane of `lanes`, in sample `number` of a loop:
 * y = q(x (1 + noise ξ) + absolute η + bias), where q rounds to the nearest multiple of the resolution, half to even.
 * IEEE 754's remainder is exact, where a quotient would be rounded first. */
static inline void sense(int count, int lanes, const Settings *s, int64_t loop, int64_t number, const double *x, double *y)
{
    for (int c = 0; c < count; c++) {
        double value = x[c * lanes];
        if (s->noise[c] != 0.0) {
            value *= 1.0 + s->noise[c] * normal(s->seed, loop, number, c, NOISE);
        }
        if (s->absolute[c] != 0.0) {
            value += s->absolute[c] * normal(s->seed, loop, number, c, ABSOLUTE);
        }
        value += s->bias[c];
        y[c * lanes] = s->resolution[c] > 0.0 ? value - remainder(value, s->resolution[c]) : value;
    }
}

/* The samples Y that arrive at control step k, NaN in the loops where none does. `past` keeps the last age + 1 states,
 * `due` has when the next sample is taken, `number` how many were. */
static inline void sample(Shape d, INDEX k, const Settings *s, const double *X, double *past, double *due, int64_t *number,
                   double *Y)
{
    const int rows = (int)s->age + 1, lanes = d.lanes;
    const ptrdiff_t row = (ptrdiff_t)d.n * lanes;
    const INDEX taken = k - s->age;
    for (ptrdiff_t a = 0; a < row; a++) {
        past[modulo(k, rows) * row + a] = X[a];
        Y[a] = NAN;
    }
    for (int l = 0; l < lanes; l++) {
        const int64_t loop = s->first + l, j = number[l];
        if (k != 0 && !(taken >= 0 && (double)taken >= due[l] - ROUNDING)) {
            continue;
        }
        if (k == 0 || uniform(s->seed, loop, j, 0, DROP) >= s->drop) {
            sense(d.n, lanes, s, loop, j, (k == 0 ? X : past + modulo(taken, rows) * row) + l, Y + l);
        }
        if (k == 0 || taken > 0) {
            const double gap = s->period * (1.0 + s->jitter * (2.0 * uniform(s->seed, loop, j, 0, GAP) - 1.0));
            due[l] += larger(gap, 1.0);
        }
        number[l]++;
    }
}

/* X_hat at control step k: from the sample that arrived now, or from the last estimate, forward by the model. */
static inline void estimate(Shape d, INDEX k, INDEX origin, double dt, INDEX age, const double *D, const double *held,
                     const double *Y, double *X_hat, Advance model, double *p, double *work)
{
    const int lanes = d.lanes;
    double *x = work, *rest = x + d.n;
    for (int l = 0; l < lanes; l++) {
        const int arrived = !isnan(Y[l]);
        const INDEX from = k == 0 ? k : arrived ? k - age : k - 1;
        for (int c = 0; c < d.n; c++) {
            x[c] = (arrived ? Y : X_hat)[c * lanes + l];
        }
        const Moment begin = {(double)origin, 0.0, dt};
        onward(d, l, (double)(origin + from), (double)(origin + k), begin, D, held, NULL, model, p, x, rest);
        for (int c = 0; c < d.n; c++) {
            X_hat[c * lanes + l] = x[c];
        }
    }
}
