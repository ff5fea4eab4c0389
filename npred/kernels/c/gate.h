/* The gate: whether a controller uses a sample, or refuses it as too far from what the model expects. Positions are times
 * in control steps. */

#define AROUND 6.0 /* half widths of the box: a state that jumps farther is accepted later */
#define DOUBTFUL 0.5 /* share of the distance at which a sample is refused, beyond which one that is taken may be wrong */
#define MOST 1e12  /* largest factor by which that grows */
#define NEARLY 1e-3 /* control steps: a wait that is so close to D_hat has lasted, also in float */

/* Whether a sample is used, or too far from the expected one. */
enum { USED = 1, FAR = 2 };

/* What the gate remembers of a loop: the first of the samples in a row that were refused, else NaN; the first sample of
 * all, or one that was doubtful; 1 if a state far from the box was accepted. */
typedef struct {
    double *refused, *since, *stray;
} Gate;

/* The factor by which a sample may be farther from the expected one if all samples from `refused` on were refused: 0 for
 * less than D_hat, or for less than they had been believed `since` the first or a doubtful one, or since the filter is
 * new; then 1, and ten times as much after each further D_hat. */
static inline double believable(double refused, double since, double taken, double dt, double D_hat)
{
    const double waited = taken - refused, lived = refused - since;
    const double times = larger(waited * dt / larger(D_hat, dt) - 1.0, 0.0);
    return waited + NEARLY < smaller(D_hat / dt, lived) ? 0.0 : smaller(pow(10.0, times), MOST);
}

/* Whether the sample Y of lane l is near the box of the state, or `wider` times as far. */
static inline int is_near(Shape d, int l, const Settings *s, const double *Y, double wider)
{
    int near = 1;
    for (int c = 0; c < d.n; c++) {
        near = near && fabs(Y[c * d.lanes + l] - s->anew[c]) <= wider * AROUND * s->reach[c];
    }
    return near;
}

/* Whether the sample Y of lane l is farther from the model's value X than that share of half the box, and of the smaller
 * of both: by the larger one a right sample would be too far from a wrong one that was taken, but not the reverse. */
static inline int is_far(Shape d, int l, const Settings *s, double share, const double *Y, const double *X)
{
    int far = 0;
    for (int c = 0; c < d.n; c++) {
        const double x = X[c * d.lanes + l], y = Y[c * d.lanes + l];
        far = far || fabs(y - x) > share * larger(s->reach[c], s->gate * smaller(fabs(x), fabs(y)));
    }
    return far;
}

/* Judge the sample Y of lane l, taken at a position, by X, what the model expects there; without a delay nothing is far.
 * If samples are refused for a time of D_hat, the next is accepted: the state has jumped. `anew` is 1 then, and where the
 * state comes back into the box: what an observer of the delay saw before is of no use to it. */
static inline int judge(Shape d, int l, double taken, double D_hat, const Settings *s, const double *Y, const double *X,
                        Gate g, int *anew)
{
    const int gated = s->gated && D_hat > 0.0;
    const double first = isnan(*g.refused) ? taken : *g.refused;
    const int near = is_near(d, l, s, Y, 1.0), far = gated && is_far(d, l, s, 1.0, Y, X);
    const int jumped = far && is_near(d, l, s, Y, believable(first, *g.since, taken, s->dt, D_hat)), used = !far || jumped;
    *anew = jumped || (used && near && *g.stray > 0.0);
    if (*anew) {
        *g.stray = near ? 0.0 : 1.0;
    }
    if (used && (isnan(*g.since) || (gated && is_far(d, l, s, DOUBTFUL, Y, X)))) {
        *g.since = taken; /* if the next is refused, then a doubtful one may be the wrong one */
    }
    *g.refused = used ? NAN : first;
    return used ? USED : FAR;
}
