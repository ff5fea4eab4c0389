/* What the controller sees of the plant, and the state that it believes between samples. */

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
            read_sensors(d.n, lanes, s, loop, j, (k == 0 ? X : past + modulo(taken, rows) * row) + l, Y + l);
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
        onward(d, l, (double)(origin + from), (double)(origin + k), 1.0, begin, D, held, NULL, model, p, x, rest);
        for (int c = 0; c < d.n; c++) {
            X_hat[c * lanes + l] = x[c];
        }
    }
}
