/* Rollouts of the loop under plans, side by side. A plan is U = clip(clip(kappa(x, t) + w) + v): w is constant, v in each
 * of BLOCKS, and the last block lasts. The grid of time has STEPS steps; the steps beyond it are as long as the loop allows. kappa is
 * constant over each of the first HELD steps, and continuous on the longer ones that follow. */
#define LOOPS (WIDE > 1 ? MANY : 1) /* loops whose law is rolled out side by side; of plans it is MANY */
#define ABREAST (ENDS * SIDE)       /* SIDE rollouts of a plan: itself, then one for each variable, which is moved there */
#define TIGHT 2e-3
#define LATER_BREACH 5e-4
#define DIP 5e-3           /* of the size of h: without alpha, kappa may break a broken limit by this and a tenth more */
#define OVERFLOWN -1e6     /* sizes of h: the room of a rollout that is not finite */
#define BOX(s, c) (1e6 * (s)[c]) /* the width of the box; s has what a predicted state may err by */
enum { MARGIN = N, STEP_LENGTH, LONGEST, LATER, STILL, WIDTHS, SIZES = WIDTHS + M, AHEAD = SIZES + K, LENGTHS = AHEAD + MANY,
       DECAYS = LENGTHS + STEPS, RAMPS = DECAYS + STEPS, EDGES = RAMPS + STEPS };
#define ROOMS (2 * K)      /* of the limits at the end and in the middle of a step */
#define POINTS (2 * N + 1) /* a point and two beside it in each direction */

#define SQUARE (N > M ? N * N : M * M)

/* The ball of resting.h: points, their next states, and matrices. */
typedef struct {
    double x[N * POINTS], y[N * POINTS], U[M * POINTS], law[M * POINTS], h[K * POINTS], unused[N * POINTS];
    double A[SQUARE], S[SQUARE], T[N * N], power[N * N], change[N * N], v[M], w[M];
} Ball;

/* The blocks of a plan: where they end, as times from now on, the last at the horizon; and v. */
typedef struct {
    double edges[BLOCKS], v[VARIABLES];
} Plan;

/* What a loop remembers: the plan that its next search begins with, and the one that is kept: 1 if it is promised, 0.5 if
 * it only has room, 0 if there is none; how often a promise ended; its blocks, its w, its parameters, and the next state. */
typedef struct {
    Plan last;
    double promised, withdrawn;
    Plan kept;
    double w[M], p[PARAMETERS + 1], next[N];
} Memory;
#define REMEMBERED (sizeof(Memory) / sizeof(double))

/* Rollouts side by side, lanes innermost: the states, which go on, their first times, U of the step, v and w. They lie in
 * the scratch memory of the kernel: they are too large for the stack. */
typedef struct {
    double x[N * ABREAST], t[ABREAST], U[M * ABREAST], v[VARIABLES * ABREAST], w[M * ABREAST];
    double below[K * ABREAST], spent[K * ABREAST]; /* how far h is below the margin at `ends`, and below the reserve */
    double rate[N * ABREAST];                      /* rates of the states in the last step */
    double y[N * ABREAST], middle[N * ABREAST], added[M * ABREAST];        /* the end and the middle of a step, its v */
    double h[K * ABREAST], before[K * ABREAST], between[K * ABREAST];      /* h there, before it and in its middle */
    double other[TIMED * K * ABREAST + 1];
    double least[ABREAST], strict[ABREAST]; /* of rollouts without rows the smallest room so far, and without a reserve */
    double room[ROWS * SIDE]; /* h minus its floor, in its sizes, in each step; then the conditions made of it */
    double law[BLOCKS * M * 2]; /* the smallest and largest kappa in each block, for the plan that is not moved */
    double moved[VARIABLES], weights[VARIABLES], next[VARIABLES], a[VARIABLES];
    double ends[N * ENDS], moments[ENDS], now[M], elapsed; /* of the loop that is planned for: its ends, and U */
    Plan plan;
    Memory memory;
    Ball ball;
    Conditions q;
} Rollouts;
typedef char PART(_fits)[sizeof(Rollouts) <= WORK * sizeof(double) ? 1 : -1];

/* Clip U to its bounds. */
static INLINED double within(double U, double low, double high)
{
    return smaller(larger(U, low), high);
}

/* The rooms of step i, from h before it, in its middle and at its end: the minimum of the parabola through these, or for
 * a plan with `side` lanes a bound of it that is linear in them. They become rows, or count in `least`. */
static INLINED void PART(_rooms)(const int count, const int side, int reserved, const double *restrict s, int step,
                                 Rollouts *r)
{
    const int i = least(step, STEPS - 1);
    const double decay = s[DECAYS + i], returned = 1.0 - s[RAMPS + i];
    const double halfway = sqrt((i > 0 ? s[DECAYS + i - 1] : 1.0) * decay); /* in the middle of the step */
    double *const before = r->before, *const middle = r->between, *const end = r->h;
    for (int a = 0; a < K * count; a++) {
        const double size = s[SIZES + a / count];
        const double dip = r->below[a] > 0.0 && decay == 1.0 ? DIP + 0.1 * r->below[a] / size : 0.0;
        const double reserve = reserved ? TIGHT - r->spent[a] * returned : LATER_BREACH * (returned - 1.0) - dip;
        const double floor = s[MARGIN] - r->below[a] * decay + reserve * size;
        const double floor_inside = s[MARGIN] - r->below[a] * halfway + reserve * size;
        const double rise = 0.5 * (end[a] - before[a]), bend = end[a] + before[a] - 2.0 * middle[a];
        const double vertex = bend > fabs(rise) ? middle[a] - 0.5 * rise * rise / bend : end[a];
        const double below = larger(bend, 0.0) / 8.0;
        const double at_end = side ? end[a] - below : smaller(end[a], vertex);
        const double inside = middle[a] - (side ? below : 0.0);
        const double one = end[a] == end[a] ? (at_end - floor) / size : OVERFLOWN;
        const double two = end[a] == end[a] ? (inside - floor_inside) / size : OVERFLOWN;
        before[a] = end[a];
        if (side) {
            double *const room = r->room + (i * ROOMS + 2 * (a / count)) * count + a % count;
            room[0] = one;
            room[count] = two;
        } else {
            const double room = smaller(one, two);
            r->least[a % count] = smaller(r->least[a % count], room);
            r->strict[a % count] = smaller(r->strict[a % count], room + reserve);
        }
    }
}

/* Limits that depend on time may have their worst between two samples of step i: `strict` counts them for neighbouring
 * states and times. */
static INLINED void PART(_between)(const int count, int i, double begin, double end, const double *restrict p,
                                   const double *restrict s, Rollouts *r)
{
    const double *const states[] = {r->x, r->middle, r->middle, r->y}, middle = 0.5 * (begin + end);
    const double decay = s[DECAYS + least(i, STEPS - 1)];
    for (int j = 0; j < 4 && TIMED; j++) {
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, states[j] + l, r->t[l] + (j == 1 ? begin : j == 2 ? end : middle), p, r->other + l);
        }
        for (int a = 0; a < K * count; a++) {
            const double room = (r->other[a] - s[MARGIN] + r->below[a] * decay) / s[SIZES + a / count];
            r->strict[a % count] = smaller(r->strict[a % count], room);
        }
    }
}

/* Roll `count` lanes from step `first` to step `last`: lanes of a plan with `side` for each end, or, with side = 0, of
 * plans that are only looked at. A plan keeps its reserve if it is `reserved`. */
static INLINED void PART(_roll)(const int count, const int side, int reserved, int first, int last,
                                const double *restrict p, const double *restrict s, const double *restrict low,
                                const double *restrict high, Rollouts *r)
{
    double *const y = r->y, *const middle = r->middle, *const v = r->added, elapsed = first ? r->elapsed : 0.0;
    const int ranged = side || (reserved && count == ENDS); /* the ranges of kappa are those of one plan */
    int block = 0;
    if (first == 0) {
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, r->x + l, r->t[l], p, r->before + l);
            r->least[l] = r->strict[l] = INFINITY;
        }
        for (int a = 0; a < BLOCKS * M; a++) {
            r->law[2 * a] = INFINITY;
            r->law[2 * a + 1] = -INFINITY;
        }
    }
    for (int i = first; i < last; i++) {
        const double length = s[i < STEPS ? LENGTHS + i : LONGEST];
        double share;
        while (block + 1 < BLOCKS && r->plan.edges[block] <= elapsed + PRECISE(1e-9, 1e-4) * length) {
            block++;
        }
        share = block + 1 < BLOCKS ? smaller((r->plan.edges[block] - elapsed) / length, 1.0) : 1.0;
        for (int a = 0; a < M * count; a++) { /* the mean over the step */
            const double *const now = r->v + block * M * count + a;
            v[a] = share < 1.0 ? share * now[0] + (1.0 - share) * now[M * count] : now[0];
        }
        if (i > 0 && (i < HELD || side || ranged)) {
            LANES for (int l = 0; l < count; l++) {
                LAW(count, r->x + l, r->t[l] + elapsed, p, r->U + l);
            }
            for (int a = 0; a < M * count; a++) {
                r->U[a] += r->w[a];
            }
        }
        for (int c = 0; c < M; c++) {
            double *const range = r->law + 2 * (block * M + c), *const U = r->U + c * count;
            for (int l = 0; l < count && ranged; l += side ? side : 1) {
                range[0] = smaller(range[0], within(U[l], low[c], high[c]));
                range[1] = larger(range[1], within(U[l], low[c], high[c]));
            }
            LANES for (int l = 0; l < count; l++) {
                U[l] = within(within(U[l], low[c], high[c]) + v[c * count + l], low[c], high[c]);
            }
        }
        if (i < HELD) {
            LANES for (int l = 0; l < count; l++) {
                STEP(count, r->x + l, r->U + l, r->t[l] + elapsed, length, p, y + l, middle + l);
            }
        } else {
            LANES for (int l = 0; l < count; l++) {
                ALONG(count, r->x + l, r->w + l, v + l, r->rate + l, low, high, 0.5 * s[STEP_LENGTH],
                      r->t[l] + elapsed, length, p, y + l, middle + l);
            }
        }
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, middle + l, r->t[l] + elapsed + 0.5 * length, p, r->between + l);
        }
        elapsed += length;
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, y + l, r->t[l] + elapsed, p, r->h + l);
        }
        PART(_between)(count, i, elapsed - length, elapsed, p, s, r);
        for (int a = 0; a < N * count; a++) {
            r->rate[a] = (y[a] - r->x[a]) / length;
            r->x[a] = y[a];
        }
        PART(_rooms)(count, side, reserved, s, i, r);
    }
    r->elapsed = elapsed;
}

/* One plan from all ends, and MANY of them. */
static APART void PART(_roll_one)(int reserved, int first, int last, const double *p, const double *s,
                                  const double *low, const double *high, Rollouts *r)
{
    PART(_roll)(ENDS, 0, reserved, first, last, p, s, low, high, r);
}

static APART void PART(_roll_many)(int reserved, int first, int last, const double *p, const double *s,
                                   const double *low, const double *high, Rollouts *r)
{
    PART(_roll)(ENDS * MANY, 0, reserved, first, last, p, s, low, high, r);
}

/* Meet loop l: take its ends, U and memory out of the lanes. Returns the smallest h at the ends. */
static inline double PART(_meet)(int lanes, int l, const double *ends, const double *moments, const double *U,
                                 const double *p, Rollouts *r)
{
    double least_h = INFINITY;
    for (int e = 0; e < ENDS; e++) {
        r->moments[e] = moments[e * lanes + l];
        for (int c = 0; c < N; c++) {
            r->ends[e * N + c] = ends[((ptrdiff_t)e * N + c) * lanes + l];
        }
        LIMITS(1, r->ends + e * N, r->moments[e], p, r->h);
        for (int k = 0; k < K; k++) {
            least_h = smaller(least_h, r->h[k]);
        }
    }
    for (int c = 0; c < M; c++) {
        r->now[c] = U[c * lanes + l];
    }
    return least_h;
}

/* Start the rollout in lane `at` of `count` at end e, with U first, then kappa + w. */
static inline void PART(_begin)(int count, int at, int e, const double *p, const double *s, const double *U,
                                const double *w, Rollouts *r)
{
    const double *const x = r->ends + e * N;
    double *const h = r->h;
    LIMITS(1, x, r->moments[e], p, h);
    for (int k = 0; k < K; k++) {
        r->below[k * count + at] = larger(s[MARGIN] - h[k], 0.0);
        r->spent[k * count + at] = within(TIGHT - (h[k] - s[MARGIN]) / s[SIZES + k], 0.0, TIGHT);
    }
    for (int c = 0; c < N; c++) {
        r->x[c * count + at] = x[c];
    }
    for (int c = 0; c < M; c++) {
        r->U[c * count + at] = U[c];
        r->w[c * count + at] = w ? w[c] : 0.0;
    }
    r->t[at] = r->moments[e];
}

/* A new plan: v = 0 in blocks that grow with time. */
static inline void PART(_new)(const double *s, Plan *plan)
{
    for (int j = 0; j < BLOCKS; j++) {
        plan->edges[j] = s[EDGES + j];
    }
    for (int j = 0; j < VARIABLES; j++) {
        plan->v[j] = 0.0;
    }
}

/* Start the rollouts of r->plan from all ends, `side` at each, with U first, then kappa + w. */
static inline void PART(_begin_plan)(int side, const double *p, const double *s, const double *U, const double *w,
                                     Rollouts *r)
{
    for (int at = 0; at < side * ENDS; at++) {
        PART(_begin)(side * ENDS, at, at / side, p, s, U, w, r);
    }
    for (int j = 0; j < VARIABLES; j++) {
        for (int at = 0; at < side * ENDS; at++) {
            r->v[j * side * ENDS + at] = r->plan.v[j];
        }
    }
}
