/* GUARD: whether U of P is that of numerical predictions, and EXACT where it is not, or where these do not say.
 *
 * SHADOWS predictions by REFERENCE on a few intervals stand side by side. The first is the reference. With SIGNED the
 * others add the local error of each step, with a sign that differs from shadow to shadow and from interval to
 * interval, and two of them read u as rough as it is between the lines. How far they come apart in U is what the
 * reference may err by: the plant itself says how much an error grows, and errors of different intervals do not cancel in
 * all shadows. With gap = |U - R|, R extrapolated from U_0 of
 * this level and B of the one before, of half as many intervals, and spread = 2 max_k |U_k - U_0| + |U_0 - B|, P passes
 * where gap + spread is within the tolerance, EXACT answers where gap - spread is above it, and in between the next
 * level is asked.
 *
 * A grid reads u, whose nodes stand for the cells around them, by straight lines on its cells (ON_CELLS), or, where a
 * family of kernels reads values at nodes only, by the mean around each of its nodes.
 *
 * `guard` has the tolerance, the limit of the distance, how many levels there are and the intervals of each; then what
 * the distance from the data is made of. */
enum { TOLERANCE_AT, LIMIT_AT, LEVELS_AT, COUNTS_AT, HEAD = COUNTS_AT + LEVELS };
#define FEATURES (N + 1 + 3 * M + 2 * PHASED)
#define ROW (M + SIGNED) /* inputs of REFERENCE: the last is the sign of the local error */
#define BESIDE (ON_CELLS && SIGNED) /* the first level is a lane more of the second */
#define DOUBT 2.0
#define RESOLVED 0.1 /* share of the states' size by which shadows that are to be believed may come apart */

#ifdef FOREIGN /* the parts are called through the pointers that `work` begins with */
typedef void (*PART(_control_pointer))(Shape, const double *, const double *, const double *, double, const double *,
                                       double *, double *);
#define CONTROL (*(PART(_control_pointer) *)(work + 0))
#define EXACT (*(PART(_control_pointer) *)(work + 1))
#define REFERENCE (*(PART(_control_pointer) *)(work + 2))
#define POINTERS 3
#else
#define POINTERS 0
#endif

/* The sign of the local error of shadow k in an interval: none for the reference, then all of one sign, or random. */
static inline double PART(_sign)(int k, int interval)
{
    uint32_t bits = (uint32_t)(SHADOWS * interval + k) * 2654435769u;
    if (k < 3) {
        return (double)(2 * k - 3) * (double)(k > 0);
    }
    bits = (bits ^ (bits >> 16)) * 2246822507u;
    bits = (bits ^ (bits >> 13)) * 3266489909u;
    return bits >> 31 ? 1.0 : -1.0;
}

/* v (rows, ROW, side): the inputs of the shadows, from `lines` (rows, M), of which each interval has `ends`. */
static inline void PART(_read)(int rows, int ends, int side, const double *lines, double *v)
{
    for (int row = 0; row < rows; row++) {
        double *at = v + (ptrdiff_t)row * ROW * side;
        for (int c = 0; c < M; c++) {
            for (int k = 0; k < side; k++) {
                at[c * side + k] = lines[row * M + c];
            }
        }
        for (int k = 0; SIGNED && k < side; k++) {
            at[M * side + k] = PART(_sign)(k, row / ends);
        }
    }
}

/* Two shadows read u as rough as it is. A straight line loses the rest w of u on its cell, and the line of a finer grid may
 * lose it too, so that no difference of grids tells it. On two cells each the lines of these shadows rise and fall by a tilt
 * in turn, which has no mean and no lever there. Inside the cell w moves the states by its integral, at most h / (2 pi) |w|
 * in the mean square: with RK4 the steps of shadow 1 are the midpoint rule's, which it moves by h / 2 times its tilt. Where
 * f is not affine in u, w counts by its square: shadow 2 takes a third of the square of its tilt, and half of that of w is
 * due. rest (count, M): the integral of w² on each cell; overwritten. */
static inline void PART(_roughen)(int count, int side, double wide, double *rest, double *v)
{
    for (int pair = 0; pair < count / 2; pair++) { /* apart from the next loop, so that roots are taken side by side */
        for (int c = 0; c < M; c++) {
            rest[pair * M + c] = sqrt(0.5 / wide * (rest[2 * pair * M + c] + rest[(2 * pair + 1) * M + c]));
        }
    }
    for (int pair = 0; pair < count / 2; pair++) {
        for (int c = 0; c < M; c++) {
            const double tilts[] = {rest[pair * M + c] / 3.141592653589793, rest[pair * M + c] * 1.224744871391589};
            double *at = v + ((ptrdiff_t)4 * pair * ROW + c) * side + 1;
            for (int row = 0; row < 4; row++, at += ROW * side) {
                at[0] += row % 3 == 0 ? tilts[0] : -tilts[0];
                at[1] += row % 3 == 0 ? tilts[1] : -tilts[1];
            }
        }
    }
}

/* U (M, side) of the first `side` shadows Q (count + 1, N, side) on `count` intervals, from X (N) and u (nx, M) of one
 * lane. With `few` above 0 the last lane is instead the reference on so many intervals: it goes beside the first steps of
 * the shadows, and then stands still. Each step waits for the one before, so that a lane more takes no longer. */
static inline void PART(_shadows)(Shape one, int count, int few, int side, const double *X, const double *u,
                                  double D_hat, double t, const double *p, const double *mass, const double *turn,
                                  const double *square, double *U, double *Q, double *scratch, double *work)
{
    const int rows = ON_CELLS ? 2 * count : count + 1;
    const double share = (double)few / (double)count;
    double *lines = scratch, *rough = lines + rows * M, *v = rough + count * M, *x = v + rows * ROW * side;
    double *span = x + N * side, *rest = span + side;
    Shape grid = one;
    (void)work;
    grid.lanes = side;
    grid.m = ROW;
    if (ON_CELLS) {
        lines_on_cells(one, M, count, u, mass, turn, BESIDE ? square : NULL, lines, rough);
    } else {
        means_on_nodes(one, M, count, u, mass, lines);
    }
    PART(_read)(rows, ON_CELLS ? 2 : 1, side, lines, v);
    if (BESIDE) {
        PART(_roughen)(count, side, (double)(one.nx - 1) / (double)count, rough, v);
    }
    for (int k = 0; k < N * side; k++) {
        x[k] = X[k / side];
    }
    for (int k = 0; k < side; k++) {
        span[k] = share * D_hat;
    }
    if (few > 0) {
        span[side - 1] = D_hat;
        lines_on_cells(one, M, few, u, mass, turn, NULL, lines, NULL);
        for (int k = 0; k < 2 * few * ROW; k++) {
            v[k * side + side - 1] = k % ROW < M ? lines[k / ROW * M + k % ROW] : 0.0;
        }
        grid.nx = few + 1;
        REFERENCE(grid, x, v, span, t, p, Q, rest);
        for (int k = 0; k < N * side; k++) {
            x[k] = Q[few * N * side + k];
        }
    }
    for (int k = 0; k < side; k++) {
        span[k] = D_hat - span[k];
    }
    grid.nx = count - few + 1;
    REFERENCE(grid, x, v + 2 * few * ROW * side, span, t + share * D_hat, p, Q + few * N * side, rest);
    for (int row = 1; SIGNED && row < rows; row++) { /* the law reads the inputs alone */
        for (int k = 0; k < M * side; k++) {
            v[row * M * side + k] = v[row * ROW * side + k];
        }
    }
    for (int k = 0; k < side; k++) {
        span[k] = D_hat;
    }
    grid.nx = count + 1;
    grid.m = M;
    CONTROL(grid, Q, v, span, t, p, U, rest);
}

/* What the level after compares with: U and the last state of lane k. */
static inline void PART(_keep)(int k, int side, const double *A, const double *q, double *before, double *end)
{
    for (int c = 0; c < M; c++) {
        before[c] = A[c * side + k];
    }
    for (int c = 0; c < N; c++) {
        end[c] = q[c * side + k];
    }
}

/* How far the last states of the shadows are from those of the reference, and these from those of the level before, as a
 * share of their size: the largest. A law may be the same for states that differ wildly. */
static inline double PART(_apart)(int side, const double *q, const double *before, const double *bend)
{
    double largest = 0.0;
    for (int c = 0; c < N; c++) {
        const double *a = q + c * side;
        double apart = fabs(before[c] - a[0]);
        for (int k = 1; k < SHADOWS; k++) {
            apart = larger(apart, fabs(a[k] - a[0]));
        }
        largest = larger(largest, apart / (fabs(a[0]) + bend[c]));
    }
    return largest;
}

/* The judgement of U (M) by that of the shadows, and of the level before: 0 passes, 1 falls back, DOUBT is undecided. */
static inline double PART(_judged)(int lanes, int side, double tolerance, const double *U, const double *A, const double *before,
                                   double ratio, double *error)
{
    double certain = 0.0, more = 1.0;
    for (int k = 0; k < ORDER; k++) {
        more *= ratio;
    }
    more -= 1.0;
    *error = 0.0;
    for (int c = 0; c < M; c++) {
        const double *a = A + c * side, step = a[0] - before[c];
        const double gap = fabs(U[c * lanes] - a[0] - step / more);
        double spread = 0.0;
        for (int k = 1; k < SHADOWS; k++) {
            const double apart = fabs(a[k] - a[0]);
            spread = apart < INFINITY ? larger(spread, apart) : INFINITY; /* also of NaN */
        }
        spread = 2.0 * spread + fabs(step);
        *error = larger(*error, gap + spread < INFINITY ? gap + spread : INFINITY);
        certain = larger(certain, gap - spread < INFINITY ? gap - spread : 0.0);
    }
    return *error <= tolerance ? 0.0 : certain > tolerance ? 1.0 : DOUBT;
}

/* Whether one lane is further from the data than the limit, or out of the range of a feature. The features are those of npred.networks.domain: X bent, D_hat,
 * the first Legendre moments of each input, the phase. second (M): the integral of s² u. */
static inline int PART(_outside)(int last, const double *X, const double *u, double D_hat, double t, const double *guard,
                                 const double *mass, const double *turn, const double *second)
{
    const double *bend = guard + HEAD, *mean = bend + N, *middle = mean + FEATURES, *half = middle + FEATURES;
    const double *whiten = half + FEATURES, length = (double)last;
    double feature[FEATURES], component[FEATURES] = {0.0}, total = 0.0;
    int within = 1;
    for (int c = 0; c < N; c++) {
        feature[c] = asinh(X[c] / bend[c]);
    }
    feature[N] = D_hat;
    for (int c = 0; c < M; c++) {
        const double *v = u + c, begin = v[0], end = v[last * M];
        const double first = mass[(last + 1) * M + c] / length;
        const double lean = (turn[(last + 1) * M + c] + 0.125 * (end - begin)) / (length * length);
        feature[N + 1 + 3 * c] = first;
        feature[N + 2 + 3 * c] = 2.0 * lean - first;
        feature[N + 3 + 3 * c] = 6.0 * (second[c] / (length * length * length) - lean) + first;
    }
    if (PHASED) {
        const double angle = 2.0 * 3.141592653589793 * t / PERIOD;
        feature[FEATURES - 2] = cos(angle);
        feature[FEATURES - 1] = sin(angle);
    }
    for (int k = 0; k < FEATURES; k++) {
        for (int i = k; i < FEATURES; i++) {
            component[i] += whiten[k * FEATURES + i] * (feature[k] - mean[k]);
        }
        total += component[k] * component[k]; /* which is whole: whiten (transposed) is triangular */
    }
    for (int k = 0; k < FEATURES; k++) {
        within &= fabs(feature[k] - middle[k]) <= half[k];
    }
    return !(within && total <= guard[LIMIT_AT] * guard[LIMIT_AT]);
}

/* The judgement of lane l, whose X (N) and u (nx, M) are x and v. */
static inline double PART(_judge)(Shape one, int lanes, int l, const double *x, const double *v, double D_hat, double t,
                                  const double *p, const double *guard, const double *U, double *error, double *scratch,
                                  double *work)
{
    const int last = one.nx - 1, levels = (int)guard[LEVELS_AT];
    double *mass = scratch, *turn = mass + (one.nx + 1) * M, *square = turn + (one.nx + 1) * M;
    double *A = square + (one.nx + 1) * M, *Q = A + M * (SHADOWS + BESIDE);
    double *rest = Q + ((int)guard[COUNTS_AT + levels - 1] + 1) * N * (SHADOWS + BESIDE), before[M] = {0.0}, end[N], second[M];
    const int known = guard[LIMIT_AT] < INFINITY;
    double judgement = DOUBT;
    one.lanes = 1; /* as it is: here the compiler knows it */
    integrals(one, M, v, mass, turn, square, second);
    for (int level = BESIDE; level < levels && judgement == DOUBT; level++) {
        const int count = (int)guard[COUNTS_AT + level], few = BESIDE && level == 1 ? (int)guard[COUNTS_AT] : 0;
        const int side = few > 0 ? SHADOWS + 1 : level > 0 ? SHADOWS : 1; /* of a first level the reference */
        const double *q = Q + count * N * side;
        PART(_shadows)(one, count, few, side, x, v, D_hat, t, p, mass, turn, square, A, Q, rest, work);
        if (few > 0) {
            PART(_keep)(SHADOWS, side, A, q, before, end);
        }
        if (level > 0) {
            const double ratio = (double)count / guard[COUNTS_AT + level - 1];
            judgement = PART(_judged)(lanes, side, guard[TOLERANCE_AT], U + l, A, before, ratio, error);
            if (judgement == 0.0 && known) {
                const double apart = PART(_apart)(side, q, end, guard + HEAD) / RESOLVED;
                *error = larger(*error, apart * guard[TOLERANCE_AT]);
                judgement = apart <= 1.0 ? 0.0 : DOUBT;
            }
        }
        PART(_keep)(0, side, A, q, before, end);
    }
    if (known && PART(_outside)(last, x, v, D_hat, t, guard, mass, turn, second)) {
        return 1.0;
    }
    return judgement > 0.0 ? 1.0 : 0.0;
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p,
                   const double *guard, double *P, double *error, double *fallback, double *work)
{
    const int lanes = d.lanes;
    double *U = work + POINTERS, *own = U + M * lanes, *copy = own + N, *y = copy + d.nx * M, *rest = y + d.nx * N;
    Shape one = d;
    one.lanes = 1;
    CONTROL(d, P, u, D_hat, t, p, U, own);
    for (int l = 0; l < lanes; l++) {
        const double *x = lanes > 1 ? own : X, *v = lanes > 1 ? copy : u;
        for (int c = 0; lanes > 1 && c < N; c++) {
            own[c] = X[c * lanes + l];
        }
        for (int k = 0; lanes > 1 && k < d.nx * M; k++) {
            copy[k] = u[(ptrdiff_t)k * lanes + l];
        }
        fallback[l] = PART(_judge)(one, lanes, l, x, v, D_hat[l], t, p, guard, U, error + l, rest, work);
        if (fallback[l] > 0.0) {
            EXACT(one, x, v, D_hat + l, t, p, y, rest);
            for (int k = 0; k < d.nx * N; k++) {
                P[(ptrdiff_t)k * lanes + l] = y[k];
            }
        }
    }
}
#undef FEATURES
#undef ROW
#undef BESIDE
#undef DOUBT
#undef RESOLVED
#undef POINTERS
#ifdef FOREIGN
#undef CONTROL
#undef EXACT
#undef REFERENCE
#endif
