/* GUARD: the estimate of the error of P in U, whether the input is where the data were, and EXACT where it is not to be
 * trusted. With A = kappa of REFERENCE, of order 2, on a grid and B of that on a coarser one, Richardson's extrapolation
 * is R = A + (A - B) / (ratio² - 1), and the estimate |kappa(P) - R| + |A - B|: where the reference itself is inaccurate,
 * it doubts. Where that is above the tolerance, and |kappa(P) - R| - |A - B| is not, the reference may be to blame: then
 * it is taken on twice as many steps, a few times.
 *
 * A grid reads u, whose nodes stand for the cells around them, either by straight lines on its cells (ON_CELLS), or, where
 * a family of kernels reads values at nodes only, by the mean around each of its nodes. With DEFECT the reference is P less
 * its defect carried along.
 *
 * `guard` has the tolerance, the intervals of the two grids, whether to correct P, the limit of the distance, the
 * refinements; then what the distance from the data is made of. */
enum { TOLERANCE_AT, FINE_AT, COARSE_AT, CORRECT_AT, LIMIT_AT, REFINEMENTS_AT, HEAD };
#define FEATURES (N + 1 + 3 * M + 2 * PHASED)
#define DOUBT 2.0

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

/* The judgement of lane l by U of P, and A and B of the two grids: 0 passes, 1 falls back, DOUBT is undecided. */
static inline double PART(_judged)(int l, int lanes, double tolerance, double ratio, const double *U, const double *A,
                                   const double *B, double *error)
{
    double certain = 0.0;
    *error = 0.0;
    for (int c = 0; c < M; c++) {
        const int k = c * lanes + l;
        const double R = A[k] + (A[k] - B[k]) / (ratio * ratio - 1.0);
        const double gap = fabs(U[k] - R), noise = fabs(A[k] - B[k]);
        *error = larger(*error, gap + noise < INFINITY ? gap + noise : INFINITY); /* also of NaN */
        certain = larger(certain, gap - noise < INFINITY ? gap - noise : 0.0);
    }
    return *error <= tolerance ? 0.0 : certain > tolerance ? 1.0 : DOUBT;
}

/* Subtract the error that the defect says, linear between the nodes of the grid. */
static inline void PART(_correct)(Shape d, int count, const double *Q, const double *R, double *P)
{
    const int stride = (d.nx - 1) / count;
    const ptrdiff_t states = (ptrdiff_t)N * d.lanes;
    for (int j = 0; j < d.nx; j++) {
        const int J = least(j / stride, count - 1);
        const double share = (double)j / (double)stride - (double)J;
        const double *q = Q + J * states, *r = R + J * states;
        for (ptrdiff_t k = 0; k < states; k++) {
            P[j * states + k] += (1.0 - share) * (q[k] - r[k]) + share * (q[states + k] - r[states + k]);
        }
    }
}

/* Whether lane l is further from the data than the limit, or its u is rougher than theirs. The features are those of
 * npred.data.domain: X bent, D_hat, the first Legendre moments of each input, the phase. */
static inline int PART(_outside)(Shape d, int l, const double *X, const double *u, double D_hat, double t, const double *guard,
                          const double *mass, const double *turn)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const ptrdiff_t row = (ptrdiff_t)M * lanes;
    const double *bend = guard + HEAD, *mean = bend + N, *whiten = mean + FEATURES;
    const double *roughest = whiten + FEATURES * FEATURES, length = (double)last;
    double feature[FEATURES], total = 0.0;
    int rough = 0;
    for (int c = 0; c < N; c++) {
        feature[c] = asinh(X[c * lanes + l] / bend[c]);
    }
    feature[N] = D_hat;
    for (int c = 0; c < M; c++) {
        const double *v = u + c * lanes + l;
        const ptrdiff_t k = d.nx * row + c * lanes + l;
        const double first = mass[k] / length;
        const double second = (turn[k] + 0.125 * (v[last * row] - v[0])) / (length * length);
        double square = 0.5 * length * length * v[last * row], kinks = 0.0;
        for (int j = 1; j < last - 1; j++) {
            square += (double)j * (double)j * v[j * row];
            kinks += fabs(v[(j - 1) * row] - v[j * row] - v[(j + 1) * row] + v[(j + 2) * row]);
        }
        square += (length - 1) * (length - 1) * v[(last - 1) * row];
        if (d.nx > 3) { /* how differently a line and a cubic read u between nodes */
            kinks += fabs(3.0 * v[0] - 7.0 * v[row] + 5.0 * v[2 * row] - v[3 * row]);
            kinks += fabs(3.0 * v[last * row] - 7.0 * v[(last - 1) * row] + 5.0 * v[(last - 2) * row] -
                          v[(last - 3) * row]);
        }
        feature[N + 1 + 3 * c] = first;
        feature[N + 2 + 3 * c] = 2.0 * second - first;
        feature[N + 3 + 3 * c] = 6.0 * (square / (length * length * length) - second) + first;
        rough = rough || !(D_hat * kinks <= 24.0 * length * roughest[c]);
    }
    if (PHASED) {
        const double angle = 2.0 * 3.141592653589793 * t / PERIOD;
        feature[FEATURES - 2] = cos(angle);
        feature[FEATURES - 1] = sin(angle);
    }
    for (int i = 0; i < FEATURES; i++) {
        double component = 0.0;
        for (int k = 0; k <= i; k++) {
            component += whiten[i * FEATURES + k] * (feature[k] - mean[k]);
        }
        total += component * component;
    }
    return rough || !(total <= guard[LIMIT_AT] * guard[LIMIT_AT]);
}

/* P of lane l by the numerical predictor. */
static inline void PART(_fall_back)(Shape d, int l, const double *X, const double *u, const double *D_hat, double t,
                             const double *p, double *P, double *scratch, double *work)
{
    const int lanes = d.lanes;
    double *x1 = scratch, *u1 = x1 + N, *P1 = u1 + (ptrdiff_t)d.nx * M;
    Shape one = d;
    one.lanes = 1;
    (void)work;
    for (int c = 0; c < N; c++) {
        x1[c] = X[c * lanes + l];
    }
    for (int k = 0; k < d.nx * M; k++) {
        u1[k] = u[(ptrdiff_t)k * lanes + l];
    }
    EXACT(one, x1, u1, D_hat + l, t, p, P1, P1 + (ptrdiff_t)d.nx * N);
    for (int k = 0; k < d.nx * N; k++) {
        P[(ptrdiff_t)k * lanes + l] = P1[k];
    }
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p,
                   const double *guard, double *P, double *error, double *fallback, double *work)
{
    const int lanes = d.lanes, fine = (int)guard[FINE_AT], coarse = (int)guard[COARSE_AT];
    const int finest = fine << (int)guard[REFINEMENTS_AT];
    const ptrdiff_t row = (ptrdiff_t)M * lanes, states = (ptrdiff_t)N * lanes;
    double *U = work + POINTERS, *A = U + row, *B = A + row, *mass = B + row, *turn = mass + (d.nx + 1) * row;
    double *v = turn + (d.nx + 1) * row, *R = v + 2 * (finest + 1) * row, *Q = R + (DEFECT ? (finest + 1) * states : 0);
    double *rest = Q + (finest + 1) * states;
    int doubts = 1;
    integrals(d, M, u, mass, turn);
    for (int l = 0; l < lanes; l++) {
        fallback[l] = DOUBT;
    }
    for (int level = -1; level <= (int)guard[REFINEMENTS_AT] && doubts; level++) {
        const int count = level < 0 ? coarse : fine << level;
        Shape grid = d;
        grid.nx = count + 1;
        if (level >= 0) {
            double *const finer = B;
            B = A;
            A = finer;
        }
        if (ON_CELLS) {
            lines_on_cells(d, M, count, u, mass, turn, v);
        } else {
            means_on_nodes(d, N, M, count, u, mass, P, v, DEFECT ? R : Q);
        }
#if DEFECT
        REFERENCE(grid, R, X, v, D_hat, t, p, Q, rest);
#else
        REFERENCE(grid, X, v, D_hat, t, p, Q, rest);
#endif
        CONTROL(grid, Q, v, D_hat, t, p, A, rest);
        if (level == 0) {
            if (DEFECT && guard[CORRECT_AT] > 0.0) {
                PART(_correct)(d, count, Q, R, P);
            }
            CONTROL(d, P, u, D_hat, t, p, U, rest);
        }
        if (level >= 0) {
            doubts = 0;
            for (int l = 0; l < lanes; l++) {
                if (fallback[l] == DOUBT) {
                    fallback[l] = PART(_judged)(l, lanes, guard[TOLERANCE_AT], (double)fine / (double)coarse, U, A, B, error + l);
                    doubts += fallback[l] == DOUBT;
                }
            }
        }
    }
    for (int l = 0; l < lanes; l++) {
        const int known = guard[LIMIT_AT] < INFINITY;
        const int outside = known && PART(_outside)(d, l, X, u, D_hat[l], t, guard, mass, turn);
        fallback[l] = outside || fallback[l] > 0.0;
        if (fallback[l] > 0.0) {
            PART(_fall_back)(d, l, X, u, D_hat, t, p, P, rest, work);
        }
    }
}
#undef FEATURES
#undef DOUBT
#undef POINTERS
#ifdef FOREIGN
#undef CONTROL
#undef EXACT
#undef REFERENCE
#endif
