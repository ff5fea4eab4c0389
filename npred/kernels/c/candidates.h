/* Which candidate of the delay is the best, by the errors of its observers: K candidates, n numbers that are compared, all
 * states or the outputs, m inputs. Of each candidate the squared errors are summed with two forgetting times, `lasting`
 * and `recent`.
 *
 * Costs, the sums over a unit, differ by chance too: with N samples in the memory and errors e of the best candidate that
 * are white, N (cost - smallest cost) is a difference of squares in variances of e; where e is not white, N is divided by
 * the long-run variance of e over its variance (`colour`). */
enum { K_AT, COMPARED, FIRST, INJECT, PUSH, LEAK, FADE, PATIENCE, LOW, HIGH, NUMBERS }; /* settings; then shifts, thetas */
#define SMALLEST 1e-12 /* of a state's largest value: errors below it are rounding */
#define DIFFER 4.0     /* the worst candidate's cost over the best one's from which on the estimate moves */
#define EVIDENCE 16.0  /* of candidates judged by outputs: that difference from which on the estimate moves */
#define CHANCE 8.0     /* that difference in the window, which is no news */
#define LEAST 0.02     /* of candidates judged by outputs: the slowest pace of the memory */
#define PLAUSIBLE 4.0  /* that difference, of two deviations, up to which a candidate may be the best */
#define STALE 40.0     /* lengths of the memory after which what it was told is too old to tell the delay */
#define RISES 4.0      /* the errors over their level, and over those of the best, from which on the delay has changed */
#define PACE 2.0       /* times what the window tells over what the memory tells is the pace of the memory, 1 at most */
#define FEW 20.0       /* samples that the window has at least: where they come more rarely, it and the memory are longer */
#define TIED 1.0001    /* costs this close to the smallest are as good */

/* What is remembered, lanes innermost. `gap` is the control steps since the last sample, `calls` those up to it. */
typedef struct {
    int K, n, judges; /* judges: whether outputs are compared */
    double *x, *push, *lasting, *recent; /* (K, n), (K, m), (K, n), (K, n) */
    double *floor, *level, *scale;       /* (n) */
    double *slow, *swing; /* (n) of the best candidate: its error without what is fast, and the sum of the squares of that */
    double *told, *white; /* samples in the memory, and what is slow of the power of white noise */
    double *age;          /* control steps since the memory was told what it knows */
    double *calls, *pace, *gap;
} Bank;

static inline Bank bank(Shape d, const double *law, double *memory)
{
    const int K = (int)law[K_AT], n = (int)law[COMPARED];
    const ptrdiff_t states = (ptrdiff_t)n * d.lanes, inputs = (ptrdiff_t)d.m * d.lanes;
    Bank b = {.K = K, .n = n, .judges = law[FIRST] > 0.0, .x = memory + (ptrdiff_t)law[FIRST] * d.lanes};
    b.push = b.x + K * states;
    b.lasting = b.push + K * inputs;
    b.recent = b.lasting + K * states;
    b.floor = b.recent + K * states;
    b.level = b.floor + states;
    b.scale = b.level + states;
    b.slow = b.scale + states;
    b.swing = b.slow + states;
    b.told = b.swing + states;
    b.white = b.told + d.lanes;
    b.age = b.white + d.lanes;
    b.calls = b.age + d.lanes;
    b.pace = b.calls + d.lanes;
    b.gap = b.pace + d.lanes;
    return b;
}

/* Start every observer of lane l at X, without errors. */
static inline void begin(Shape d, const Bank *b, int l, const double *X)
{
    const ptrdiff_t states = (ptrdiff_t)b->n * d.lanes;
    for (double *number = b->x + l; number < b->gap + d.lanes; number += d.lanes) {
        *number = 0.0;
    }
    for (ptrdiff_t a = l; a < states; a += d.lanes) {
        b->floor[a] = 1.0;
        b->scale[a] = fabs(X[a]);
        for (int i = 0; i < b->K; i++) {
            b->x[i * states + a] = X[a];
        }
    }
    b->calls[l] = b->pace[l] = 1.0;
}

/* Count a control step, and write the gains of lane l's sample: inject, push, leak, fade.
 *
 * With T the time since the sample before, the errors of x and d get the poles e^{sT}, s² + L s + L ω = 0:
 *     inject = 1 - e^{-LT},   push = (1 + e^{-LT} - 2 e^{-LT/2} cos(T √(L ω - L²/4))) / T,
 * of which L ω is the limit of push / T for small T. What is forgotten is that of the time T, but at most of a share
 * 1 / FEW of the window. A loop without a sample, NaN, or before its first one, forgets and corrects nothing. */
static inline void gains(Shape d, const Bank *b, int l, double X, double dt, const double *law, double *gain)
{
    const int lanes = d.lanes;
    double counted;
    b->gap[l] += 1.0;
    b->age[l] += 1.0;
    if (isnan(X) || isnan(b->gap[l])) {
        gain[l] = gain[lanes + l] = gain[2 * lanes + l] = 0.0;
        gain[3 * lanes + l] = 1.0;
        return;
    }
    for (int j = 0; j < 4; j++) {
        gain[j * lanes + l] = law[INJECT + j];
    }
    if (b->gap[l] > 1.0) {
        const double stay = exp(b->gap[l] * log(1.0 - law[INJECT])), T = b->gap[l] * dt;
        const double rate = log(1.0 - law[INJECT]) / dt, square = law[PUSH] / dt - rate * rate / 4.0;
        const double root = sqrt(fabs(square)) * T;
        const double swing = square > 0.0 ? cos(root) : 0.5 * (exp(root) + exp(-root));
        gain[l] = 1.0 - stay;
        gain[lanes + l] = (1.0 + stay - 2.0 * sqrt(stay) * swing) / T;
    }
    counted = smaller(b->gap[l], larger(law[PATIENCE] / (2.0 * FEW), 1.0));
    if (counted > 1.0) {
        gain[2 * lanes + l] = 1.0 - exp(counted * log(1.0 - law[LEAK]));
        gain[3 * lanes + l] = exp(counted * log(law[FADE]));
    }
    b->calls[l] += counted;
    b->gap[l] = 0.0;
}

/* The cost of candidate i in a lane. */
static inline double cost_of(Shape d, const Bank *b, const double *sums, const double *unit, int i)
{
    double cost = 0.0;
    for (int c = 0; c < b->n; c++) {
        cost += sums[((ptrdiff_t)i * b->n + c) * d.lanes] / unit[c * d.lanes];
    }
    return cost;
}

/* The cost (K) of the candidates in a lane, their sums over a unit; the best candidate, and the largest cost. */
static inline int compare(Shape d, const Bank *b, const double *sums, const double *unit, double *cost, double *largest)
{
    int best = 0;
    double lowest = INFINITY;
    *largest = 0.0;
    for (int i = 0; i < b->K; i++) {
        cost[i] = cost_of(d, b, sums, unit, i);
        *largest = larger(*largest, cost[i]);
        if (cost[i] < lowest) {
            best = i;
            lowest = cost[i];
        }
    }
    return best;
}

/* The minimum of the parabola through the best three candidates; of several as good, the one next to D_hat. */
static inline double parabola(int K, const double *cost, int best, const double *thetas, double D_hat)
{
    const double tied = TIED * cost[best], spacing = thetas[1] - thetas[0];
    double theta = INFINITY;
    if (0 < best && best < K - 1 && cost[best - 1] > tied && cost[best + 1] > tied) {
        const double a = cost[best - 1], b = cost[best], c = cost[best + 1];
        return thetas[best] + 0.5 * (a - c) / (a - 2.0 * b + c) * spacing;
    }
    for (int i = 0; i < K; i++) {
        if (cost[i] <= tied && fabs(thetas[i] - D_hat) < fabs(theta - D_hat)) {
            theta = thetas[i];
        }
    }
    return fabs(theta - D_hat) <= 0.5 * spacing ? D_hat : theta;
}

/* The units of the costs of lane l, by state: `floor`, the smallest of the lasting sums, and `level`. That is the mean
 * over the memory of the smallest recent sum, in which a value counts RISES times the level at most: after a jump of the
 * delay the errors of all candidates are large, before those of the right one are small again. */
static inline void weigh(Shape d, const Bank *b, int l, const double *X, int first, double leak)
{
    const ptrdiff_t states = (ptrdiff_t)b->n * d.lanes;
    for (int c = 0; c < b->n; c++) {
        const ptrdiff_t a = (ptrdiff_t)c * d.lanes + l;
        double lasting = INFINITY, error = INFINITY;
        b->scale[a] = larger(b->scale[a], fabs(X[a]));
        for (int i = 0; i < b->K; i++) {
            lasting = smaller(lasting, b->lasting[i * states + a]);
            error = smaller(error, b->recent[i * states + a]);
        }
        b->floor[a] = lasting + SMALLEST * b->scale[a] * (SMALLEST * b->scale[a]) + 1e-300;
        error = error + SMALLEST * b->scale[a] * (SMALLEST * b->scale[a]) + 1e-300;
        if (first) {
            b->level[a] = error;
        }
        b->level[a] += leak * (smaller(error, RISES * b->level[a]) - b->level[a]);
    }
}

/* How many times as uncertain the mean of the best candidate's errors is as that of white noise. */
SPARE static inline double colour(Shape d, const Bank *b, int l, int best)
{
    double excess = 1.0;
    for (int c = 0; c < b->n; c++) {
        const ptrdiff_t a = (ptrdiff_t)c * d.lanes + l;
        const double sum = b->lasting[(ptrdiff_t)best * b->n * d.lanes + a];
        excess = larger(excess, b->swing[a] / (b->white[l] * sum + 1e-300));
    }
    return excess;
}

/* Take down what the last sample says of lane l's noise, by the best candidate, and how old the memory is with `news`. */
static inline void listen(Shape d, const Bank *b, int l, const double *X, const double *gain, int best,
                          double news)
{
    const double leak = gain[2 * d.lanes + l] * b->pace[l], fade = gain[3 * d.lanes + l], left = 1.0 - gain[l];
    const double weight = b->judges ? 1.0 : b->pace[l];
    for (int c = 0; c < b->n; c++) {
        const ptrdiff_t a = (ptrdiff_t)c * d.lanes + l;
        const double moved = X[a] - b->x[(ptrdiff_t)best * b->n * d.lanes + a], e = left > 0.0 ? moved / left : 0.0;
        b->slow[a] += (1.0 - fade) * ((isnan(e) ? 0.0 : e) - b->slow[a]);
        b->swing[a] += weight * b->slow[a] * b->slow[a] - leak * b->swing[a];
    }
    b->white[l] = (1.0 - fade) / (1.0 + fade);
    b->told[l] += weight - leak * b->told[l];
    b->age[l] -= news * gain[2 * d.lanes + l] * b->age[l];
}

/* Move the estimate of lane l to the best candidate, where the candidates differ; its first sample starts its observers.
 *
 * What the errors tell is the largest cost, and `news` is how far it is beyond the smallest one and chance. Where the
 * window tells far less than the memory, the pace of the memory is slow; and where it tells about as much, errors far
 * above the level and above the best candidate's start it anew. Of outputs, whose noise may hide what a delay does, the
 * memory keeps what each sample tells, and forgets for news. */
static inline void choose(Shape d, const Bank *b, int l, const double *X, const double *gain, const double *law,
                          double *cost, double *D_hat)
{
    const double *thetas = law + NUMBERS + b->K * d.m, spacing = thetas[1] - thetas[0];
    const double leak = gain[2 * d.lanes + l], fade = gain[3 * d.lanes + l];
    const int first = b->calls[l] <= law[PATIENCE], K = b->K;
    double window, memory, largest, near = INFINITY, ratio, news;
    int best, k, risen;
    if (isnan(X[l]) || isnan(b->gap[l])) {
        if (!isnan(X[l])) {
            begin(d, b, l, X);
        }
        return;
    }
    weigh(d, b, l, X, first, leak);
    k = least(most((int)rint((D_hat[l] - thetas[0]) / spacing), 0), K - 1);
    best = compare(d, b, b->recent + l, b->level + l, cost, &window);
    news = window - cost[best];
    for (int i = most(k - 1, 0); i < least(k + 2, K); i++) {
        near = smaller(near, cost[i]);
    }
    risen = near > RISES * larger(cost[best], (double)b->n);
    k = compare(d, b, b->lasting + l, b->level + l, cost, &memory);
    news -= CHANCE * (1.0 - fade) * colour(d, b, l, k);
    news = news > 0.0 ? (1.0 - fade) / leak * news / (memory - cost[k]) : 0.0;
    ratio = b->judges ? news : (1.0 - fade) / leak * window / memory;
    b->pace[l] = PACE * ratio < 1.0 ? larger(PACE * ratio, b->judges ? LEAST : 0.0) : 1.0; /* and where neither tells anything */
    if (risen && DIFFER * ratio > 1.0 && !first) {
        for (int a = 0; a < K * b->n; a++) {
            b->lasting[(ptrdiff_t)a * d.lanes + l] = b->recent[(ptrdiff_t)a * d.lanes + l];
        }
        weigh(d, b, l, X, first, 0.0);
    }
    best = compare(d, b, b->lasting + l, b->floor + l, cost, &largest);
    listen(d, b, l, X, gain, best, smaller(PACE * news, 1.0));
    if (b->judges ? (largest - cost[best]) * b->told[l] > EVIDENCE * colour(d, b, l, best)
                  : largest > DIFFER * cost[best]) {
        D_hat[l] = smaller(larger(parabola(K, cost, best, thetas, D_hat[l]), law[LOW]), law[HIGH]);
    }
}

/* Half the range of the delays of lane l that D_hat may be taken for, NaN before the first sample: of D_hat and the
 * candidates whose costs noise may make of the best one's, a quarter of their distance at least. What the memory was told
 * longer ago than it is long counts less and less: then the range goes to that of the bounds. Where D_hat stands at a
 * bound, it is not half, but the whole range of the bounds. */
SPARE static inline double undecided(Shape d, const double *law, double *memory, const double *D_hat, int l)
{
    const Bank b = bank(d, law, memory);
    const double *thetas = law + NUMBERS + b.K * d.m, spacing = thetas[1] - thetas[0];
    double low = D_hat[l], high = D_hat[l], lowest = INFINITY, limit, old, half;
    int best = 0;
    if (isnan(b.gap[l])) {
        return NAN;
    }
    for (int i = 0; i < b.K; i++) {
        const double cost = cost_of(d, &b, b.lasting + l, b.floor + l, i);
        best = cost < lowest ? i : best;
        lowest = smaller(lowest, cost);
    }
    limit = lowest + PLAUSIBLE * colour(d, &b, l, best) / b.told[l];
    for (int i = 0; i < b.K; i++) {
        const double cost = cost_of(d, &b, b.lasting + l, b.floor + l, i);
        low = cost <= limit ? smaller(low, thetas[i]) : low;
        high = cost <= limit ? larger(high, thetas[i]) : high;
    }
    if (2.0 * larger(D_hat[l] - law[LOW], law[HIGH] - D_hat[l]) >= 2.0 * (law[HIGH] - law[LOW]) - spacing) {
        return law[HIGH] - law[LOW]; /* D_hat says nothing of how far beyond it the delay is */
    }
    half = 0.5 * larger(smaller(high, law[HIGH]) - larger(low, law[LOW]), 0.5 * spacing);
    old = larger(b.age[l] * law[LEAK] - 1.0, 0.0) / STALE;
    return half + (larger(0.5 * (law[HIGH] - law[LOW]), half) - half) * (1.0 - exp(-old));
}
