/* Rollouts of the loop under plans, side by side. A plan is U = clip(clip(kappa(x, t) + w) + v): w is constant, v in
 * each of BLOCKS, and the last block lasts. The grid of time has STEPS steps; the steps beyond it are as long as the
 * loop allows. kappa is constant over each of the first HELD steps, and continuous on the longer ones that follow. Its
 * time ends when the plan `lasts` no more: a law that tracks so comes to a rest. */
#define LOOPS (WIDE > 1 ? MANY : 1) /* loops whose law is rolled out side by side; of plans it is MANY */
#define SIDED (SIDE + ENDS - 1) /* rollouts of a plan: from each end, and from the first with each variable moved */
#define ABREAST (SIDED > ENDS * MANY ? SIDED : ENDS * MANY)
#define AT(side, e) ((e) > 0 ? (side) - 1 + (e) : 0) /* the lane of a plan from an end */
#define TIGHT 2e-3
#define LATER_BREACH 5e-4
#define DIP 5e-3           /* of the size of h: without alpha kappa may break a broken limit by this, a tenth more */
#define OVERFLOWN -1e6     /* sizes of h: the room of a rollout that is not finite */
#define NEVER 1e30         /* a time */
#define BOX(s, c) (1e6 * (s)[c]) /* the width of the box; s has what a predicted state may err by */
enum { MARGIN = N, STEP_LENGTH, LONGEST, LATER, STILL, LASTS, WIDTHS, SIZES = WIDTHS + M, AHEAD = SIZES + K,
       LENGTHS = AHEAD + MANY, DECAYS = LENGTHS + STEPS, RAMPS = DECAYS + STEPS, EDGES = RAMPS + STEPS };
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

/* What a loop remembers: the plan that its next search begins with, and the one that is kept: 1 if it is promised,
 * 0.5 if it only has room, 0 if there is none; how often a promise ended; its blocks, when the time of its kappa ends,
 * when its w becomes the later one, both w, its parameters, and the next state. */
typedef struct {
    Plan last;
    double promised, withdrawn;
    Plan kept;
    double until, turn, w[M], later[M], p[PARAMETERS + 1], next[N];
} Memory;
#define REMEMBERED (sizeof(Memory) / sizeof(double))

/* Rollouts side by side, lanes innermost: the states, which go on, their first times, U of the step, v and w. They
 * lie in the scratch memory of the kernel: they are too large for the stack. */
typedef struct {
    double x[N * ABREAST], t[ABREAST], U[M * ABREAST], v[VARIABLES * ABREAST], w[M * ABREAST];
    double turn[ABREAST], later[M * ABREAST], speed[ABREAST]; /* when w becomes the later one; the last speed */
    double below[K * ABREAST], spent[K * ABREAST]; /* how far h is below the margin at `ends`, and below the reserve */
    double rate[N * ABREAST];                      /* rates of the states in the last step */
    double y[N * ABREAST], middle[N * ABREAST], added[M * ABREAST];        /* the end and the middle of a step, its v */
    double h[K * ABREAST], before[K * ABREAST], between[K * ABREAST];      /* h there, before it and in its middle */
    double other[TIMED * K * ABREAST + 1];
    double least[ABREAST], strict[ABREAST]; /* of rollouts without rows the smallest room, and without a reserve */
    int idle[ABREAST]; /* lanes that need not go on: they are as the first of their end, or of no use */
    double rows[ROWS * SIDE]; /* the smallest room of all ends, and what lanes differ by; then conditions made of it */
    double law[BLOCKS * M * 2]; /* the smallest and largest kappa in each block, for the plan that is not moved */
    double moved[VARIABLES], weights[VARIABLES], next[VARIABLES], a[VARIABLES];
    double ends[N * ENDS], moments[ENDS], now[M]; /* of the loop that is planned for: its ends, and U */
    double elapsed, lasts, margin;
    Plan plan;
    Memory memory;
    union {
        Ball ball;
        Conditions q;
    } shared; /* never both at once */
} Rollouts;
#define IDLE(l) (WIDE == 1 && r->idle[l]) /* where lanes share instructions, all go on */
typedef char PART(_fits)[sizeof(Rollouts) <= WORK * sizeof(double) ? 1 : -1];

/* Clip U to its bounds. */
static INLINED double within(double U, double low, double high)
{
    return smaller(larger(U, low), high);
}

/* The rooms of element a, a limit in a lane, at the end of step i and in its middle: the minimum of the parabola
 * through h before, in and after it, or for a plan with `side` lanes a bound of it that is linear in them. Returns
 * the reserve that they lack. */
static INLINED double PART(_reserve)(const int count, const int side, int reserved, const double *restrict s, int i,
                                     int a, const Rollouts *r, double *rooms)
{
    const double size = s[SIZES + a / count], decay = s[DECAYS + i], returned = 1.0 - s[RAMPS + i];
    const double halfway = sqrt((i > 0 ? s[DECAYS + i - 1] : 1.0) * decay); /* in the middle of the step */
    const double before = r->before[a], middle = r->between[a], end = r->h[a], below = r->below[a];
    const double dip = below > 0.0 && decay == 1.0 ? DIP + 0.1 * below / size : 0.0;
    const double reserve = reserved ? TIGHT - r->spent[a] * returned : LATER_BREACH * (returned - 1.0) - dip;
    const double floor = r->margin - below * decay + reserve * size;
    const double floor_inside = r->margin - below * halfway + reserve * size;
    const double rise = 0.5 * (end - before), bend = end + before - 2.0 * middle;
    const double vertex = bend > fabs(rise) ? middle - 0.5 * rise * rise / bend : end;
    const double lower = larger(bend, 0.0) / 8.0;
    const double at_end = side ? end - lower : smaller(end, vertex), inside = middle - (side ? lower : 0.0);
    rooms[0] = end == end ? (at_end - floor) / size : OVERFLOWN;
    rooms[1] = end == end ? (inside - floor_inside) / size : OVERFLOWN;
    return reserve;
}

/* The rooms of a step become rows, with what the lanes that have `begun` differ by, or count in `least`. */
static INLINED void PART(_rooms)(const int count, const int side, int begun, int reserved, const double *restrict s,
                                 int step, Rollouts *r)
{
    const int i = least(step, STEPS - 1);
    double rooms[2];
    for (int row = 0; row < ROOMS * ENDS && side; row++) {
        const int half = row / ENDS % 2, first_a = row / ENDS / 2 * count, a = first_a + AT(side, row % ENDS);
        double *const slot = r->rows + (i * ROOMS + row / ENDS) * SIDE;
        PART(_reserve)(count, side, reserved, s, i, a, r, rooms);
        if (!(rooms[half] < slot[0])) {
            continue;
        }
        slot[0] = rooms[half];
        PART(_reserve)(count, side, reserved, s, i, first_a, r, rooms);
        const double unmoved = rooms[half];
        for (int j = 1; j < side; j++) { /* from all ends it moves alike */
            if (j < begun) {
                PART(_reserve)(count, side, reserved, s, i, first_a + j, r, rooms);
            }
            slot[j] = j < begun ? rooms[half] - unmoved : 0.0;
        }
    }
    for (int a = 0; a < K * count; a++) {
        if (IDLE(a % count)) {
            continue;
        }
        if (!side) {
            const double reserve = PART(_reserve)(count, side, reserved, s, i, a, r, rooms);
            const double room = smaller(rooms[0], rooms[1]);
            r->least[a % count] = smaller(r->least[a % count], room);
            r->strict[a % count] = smaller(r->strict[a % count], room + reserve);
        }
        r->before[a] = r->h[a];
    }
}

/* Limits that depend on time may have their worst between two samples of step i: `strict` counts them for neighbouring
 * states and times. */
static INLINED void PART(_between)(const int count, int i, double begin, double end, const double *restrict p,
                                   const double *restrict s, Rollouts *r)
{
    const double *const states[] = {r->x, r->middle, r->middle, r->y}, middle = 0.5 * (begin + end);
    const double decay = s[DECAYS + least(i, STEPS - 1)];
    for (int j = 0; j < 4; j++) {
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, states[j] + l, r->t[l] + (j == 1 ? begin : j == 2 ? end : middle), p, r->other + l);
        }
        for (int a = 0; a < K * count; a++) {
            const double room = (r->other[a] - r->margin + r->below[a] * decay) / s[SIZES + a / count];
            r->strict[a % count] = smaller(r->strict[a % count], room);
        }
    }
}

/* Let those lanes of a plan go on that v moves from this block on; how many from the first end do. */
static INLINED int PART(_begun)(const int count, const int side, int block, Rollouts *r)
{
    const int begun = least(1 + (block + 1) * M, side);
    for (int l = 1; l < begun; l++) {
        for (int c = 0; c < N && IDLE(l); c++) {
            r->x[c * count + l] = r->x[c * count];
            r->rate[c * count + l] = r->rate[c * count];
        }
        for (int k = 0; k < K && IDLE(l); k++) {
            r->before[k * count + l] = r->before[k * count];
        }
        r->idle[l] = 0;
    }
    return begun;
}

/* Let plans of `loops` that are only looked at, and have less room than asked for, go on no more; how many do. */
static INLINED int PART(_left)(const int loops, double room, Rollouts *r)
{
    int left = 0;
    for (int b = 0; b < loops; b++) {
        int idle = 0;
        for (int e = b * ENDS; e < (b + 1) * ENDS; e++) {
            idle = idle || r->least[e] < room;
        }
        for (int e = b * ENDS; e < (b + 1) * ENDS && idle; e++) {
            r->idle[e] = 1;
            r->least[e] = OVERFLOWN;
        }
        left += !idle;
    }
    return left;
}

/* Let brakes that wait for it turn when they no longer become slower: to a w that holds them where they are, the last
 * one to kappa. */
static INLINED void PART(_turn)(const int count, double elapsed, const double *p, const double *s, Rollouts *r)
{
    for (int l = (MANY - TURNING) * ENDS; l < count; l++) {
        double speed = 0.0;
        for (int c = 0; c < N; c++) {
            speed += r->rate[c * count + l] / BOX(s, c) * r->rate[c * count + l] / BOX(s, c);
        }
        if (r->turn[l] >= NEVER && speed > r->speed[l]) {
            LAW(count, r->x + l, r->t[l] + smaller(elapsed, r->lasts), p, r->U + l);
            for (int c = 0; c < M; c++) {
                r->later[c * count + l] -= l < count - ENDS ? r->U[c * count + l] : r->later[c * count + l];
            }
            r->turn[l] = elapsed;
        }
        r->speed[l] = speed;
    }
}

/* Roll `count` lanes from step `first` to step `last`: lanes of a plan with `side` for the first end, or, with side
 * = 0, of plans that are only looked at while they have that room. A plan keeps its reserve if it is `reserved`. */
static INLINED void PART(_roll)(const int count, const int side, int reserved, double room, int first, int last,
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
            r->idle[l] = l > 0 && l < side;
        }
        for (int row = 0; row < STEPS * ROOMS && side; row++) {
            r->rows[row * SIDE] = INFINITY;
        }
        for (int a = 0; a < BLOCKS * M; a++) {
            r->law[2 * a] = INFINITY;
            r->law[2 * a + 1] = -INFINITY;
        }
    }
    for (int i = first; i < last; i++) {
        const double length = s[i < STEPS ? LENGTHS + i : LONGEST];
        double share;
        int begun;
        while (block + 1 < BLOCKS && r->plan.edges[block] <= elapsed + PRECISE(1e-9, 1e-4) * length) {
            block++;
        }
        share = block + 1 < BLOCKS ? smaller((r->plan.edges[block] - elapsed) / length, 1.0) : 1.0;
        begun = side ? PART(_begun)(count, side, block + (share < 1.0), r) : 0;
        for (int a = 0; a < M * count && reserved && !side; a++) {
            r->w[a] = elapsed + 0.5 * length > r->turn[a % count] ? r->later[a] : r->w[a];
        }
        for (int a = 0; a < M * count; a++) { /* the mean over the step */
            const double *const now = r->v + block * M * count + a;
            v[a] = share < 1.0 ? share * now[0] + (1.0 - share) * now[M * count] : now[0];
        }
        if (i > 0 && (i < HELD || side || ranged)) {
            LANES for (int l = 0; l < count; l++) {
                if (!IDLE(l) && (WIDE > 1 || i < HELD || l == 0 || l >= side)) { /* or its U is not read */
                    LAW(count, r->x + l, r->t[l] + smaller(elapsed, r->lasts), p, r->U + l);
                }
            }
            for (int a = 0; a < M * count; a++) {
                r->U[a] += r->w[a];
            }
        }
        for (int c = 0; c < M; c++) {
            double *const range = r->law + 2 * (block * M + c), *const U = r->U + c * count;
            for (int l = 0; l < count && ranged; l = l ? l + 1 : most(side, 1)) {
                range[0] = smaller(range[0], within(U[l], low[c], high[c]));
                range[1] = larger(range[1], within(U[l], low[c], high[c]));
            }
            LANES for (int l = 0; l < count; l++) {
                U[l] = within(within(U[l], low[c], high[c]) + v[c * count + l], low[c], high[c]);
            }
        }
        if (i < HELD) {
            LANES for (int l = 0; l < count; l++) {
                if (IDLE(l)) {
                    continue;
                }
                STEP(count, r->x + l, r->U + l, r->t[l] + elapsed, length, p, y + l, middle + l);
            }
        } else {
            LANES for (int l = 0; l < count; l++) {
                if (IDLE(l)) {
                    continue;
                }
                ALONG(count, r->x + l, r->w + l, v + l, r->rate + l, low, high, 0.5 * s[STEP_LENGTH],
                      r->t[l] + r->lasts, r->t[l] + elapsed, length, p, y + l, middle + l);
            }
        }
        LANES for (int l = 0; l < count; l++) {
            if (IDLE(l)) {
                continue;
            }
            LIMITS(count, middle + l, r->t[l] + elapsed + 0.5 * length, p, r->between + l);
        }
        elapsed += length;
        LANES for (int l = 0; l < count; l++) {
            if (IDLE(l)) {
                continue;
            }
            LIMITS(count, y + l, r->t[l] + elapsed, p, r->h + l);
        }
        if (TIMED && !side) {
            PART(_between)(count, i, elapsed - length, elapsed, p, s, r);
        }
        for (int a = 0; a < N * count; a++) {
            if (IDLE(a % count)) {
                continue;
            }
            r->rate[a] = (y[a] - r->x[a]) / length;
            r->x[a] = y[a];
        }
        if (ENDS == 1 && count == MANY && reserved && !side && i > 0) {
            PART(_turn)(count, elapsed, p, s, r);
        }
        PART(_rooms)(count, side, begun, reserved, s, i, r);
        if (!side && PART(_left)(count / ENDS, room, r) == 0) {
            break;
        }
    }
    r->elapsed = elapsed;
}

/* One plan from all ends, and MANY of them. */
static APART void PART(_roll_one)(int reserved, double room, int first, int last, const double *p, const double *s,
                                  const double *low, const double *high, Rollouts *r)
{
    PART(_roll)(ENDS, 0, reserved, room, first, last, p, s, low, high, r);
}

static APART void PART(_roll_many)(int reserved, double room, int first, int last, const double *p, const double *s,
                                   const double *low, const double *high, Rollouts *r)
{
    PART(_roll)(ENDS * MANY, 0, reserved, room, first, last, p, s, low, high, r);
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
        r->below[k * count + at] = larger(r->margin - h[k], 0.0);
        r->spent[k * count + at] = within(TIGHT - (h[k] - r->margin) / s[SIZES + k], 0.0, TIGHT);
    }
    for (int c = 0; c < N; c++) {
        r->x[c * count + at] = x[c];
    }
    for (int c = 0; c < M; c++) {
        r->U[c * count + at] = U[c];
        r->w[c * count + at] = w ? w[c] : 0.0;
    }
    r->t[at] = r->moments[e];
    r->turn[at] = NEVER;
    r->speed[at] = INFINITY;
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

/* Start the rollouts of r->plan from all ends, `side` from the first, with U first, then kappa + w. */
static inline void PART(_begin_plan)(int side, const double *p, const double *s, const double *U, const double *w,
                                     Rollouts *r)
{
    const int count = side + ENDS - 1;
    for (int at = 0; at < count; at++) {
        PART(_begin)(count, at, most(at - side + 1, 0), p, s, U, w, r);
        for (int j = 0; j < VARIABLES; j++) {
            r->v[j * count + at] = r->plan.v[j];
        }
    }
}
