/* PROTECT: change U only if the loop that follows would break a limit, and then by the least that keeps all limits:
 * a predictive safety filter [Wabersich, Zeilinger, Automatica 129 (2021) 109597] around the plant's own law.
 *
 * From each of the states `ends` that the plant may have when U acts, the loop is rolled out over a grid of STEPS: with
 * U over the first control step, then with kappa within its bounds. kappa is constant over each of the first HELD steps,
 * and continuous on the longer ones that follow. If every h stays above its floor, U is not changed. Otherwise a plan
 * adds v to kappa, constant in each of BLOCKS: the plan with the least Σ ∫ (v / width)² dt that keeps h. It is sought by
 * up to PASSES programmes that are linear around the last plan; their slopes are differences of rollouts side by side.
 * The next call starts from the rest of this plan.
 *
 * The floor is the margin; if h is below it at `ends` already, the floor rises back to it at the rate alpha. A plan has a
 * reserve: it keeps h above its floor by TIGHT times the size of h or, if less is left at `ends`, returns to that. A
 * breach of up to SLACK times that size, the more the later it is, is left to later calls, which predict it better.
 * `kept` is the smallest h of `ends`, `filtered` is 1 if U was changed, `unkept` is 1 if no plan has half the reserve. */
/* SIDE rollouts of a plan: itself, then one for each variable, which is moved there */
#define LOOPS (WIDE > 1 ? 8 : 1) /* loops whose law is rolled out side by side: no more than SIDE */
#define ABREAST (ENDS * SIDE)
#define PASSES 2
#define TIGHT 2e-3
#define SLACK 5e-4
#define DIP 5e-3     /* of the size of h: without alpha, kappa may break a broken limit by this and a tenth more */
#define MOVED PRECISE(1e-4, 1e-3) /* of the width of an input: how far a variable is moved */
#define SETTLED 1e-4 /* of that width: a plan that changes by less is final */
#define LESS 0.999   /* of the cost of a plan: a new plan has to cost less than this share */
#define MISSED 1e-5  /* of the size of h */
#define SOFT PRECISE(1e-9, 1e-5)   /* of conditions on states, whose rows have the length 1 */
#define BOUND PRECISE(1e-13, 1e-6) /* of the bounds of v */
#define OVERFLOWN -1e6 /* sizes of h: the room of a rollout that is not finite */
enum { MARGIN = N, STEP_LENGTH, WIDTHS, SIZES = WIDTHS + M, LENGTHS = SIZES + K, DECAYS = LENGTHS + STEPS,
       RAMPS = DECAYS + STEPS, EDGES = RAMPS + STEPS };
#define ROOMS (2 * K) /* of the limits at the end and in the middle of a step */

/* Rollouts side by side, lanes innermost: the states, which go on, their first times, U of the step, and v. It lies in
 * the scratch memory of the kernel: it is too large for the stack. */
typedef struct {
    double x[N * ABREAST], t[ABREAST], U[M * ABREAST], v[VARIABLES * ABREAST];
    double below[K * ABREAST], spent[K * ABREAST]; /* how far h is below the margin at `ends`, and below the reserve */
    double rate[N * ABREAST];                      /* rates of the states in the last step */
    double y[N * ABREAST], middle[N * ABREAST], added[M * ABREAST];        /* the end and the middle of a step, its v */
    double h[K * ABREAST], before[K * ABREAST], between[K * ABREAST];      /* h there, before it and in its middle */
    double room[ROWS * SIDE]; /* h minus its floor, in its sizes, in each step; then the conditions made of it */
    double law[BLOCKS * M * 2]; /* the smallest and largest kappa in each block, for the plan that is not moved */
    double edges[BLOCKS];       /* the ends of the blocks, as times from now on; the last is that of the horizon */
    double plan[VARIABLES], moved[VARIABLES], w[VARIABLES], next[VARIABLES], a[VARIABLES];
    Conditions q;
} Rollouts;
typedef char PART(_fits)[sizeof(Rollouts) <= WORK * sizeof(double) ? 1 : -1];

/* The rooms of step i, from h before it, in its middle and at its end: the minimum of the parabola through these, or for
 * a plan a bound of it that is linear in them. */
static INLINED void PART(_rooms)(const int count, const int side, const double *restrict s, int i,
                                 double *restrict before, const double *restrict middle, const double *restrict end,
                                 Rollouts *r)
{
    const double decay = s[DECAYS + i], returned = 1.0 - s[RAMPS + i];
    const double halfway = sqrt((i > 0 ? s[DECAYS + i - 1] : 1.0) * decay); /* in the middle of the step */
    for (int a = 0; a < K * count; a++) {
        double *const room = r->room + (i * ROOMS + 2 * (a / count)) * count + a % count, size = s[SIZES + a / count];
        const double dip = r->below[a] > 0.0 && decay == 1.0 ? DIP + 0.1 * r->below[a] / size : 0.0;
        const double reserve = side ? TIGHT - r->spent[a] * returned : SLACK * (returned - 1.0) - dip;
        const double floor = s[MARGIN] - r->below[a] * decay + reserve * size;
        const double floor_inside = s[MARGIN] - r->below[a] * halfway + reserve * size;
        const double rise = 0.5 * (end[a] - before[a]), bend = end[a] + before[a] - 2.0 * middle[a];
        const double vertex = bend > fabs(rise) ? middle[a] - 0.5 * rise * rise / bend : end[a];
        const double below = larger(bend, 0.0) / 8.0;
        const double at_end = side ? end[a] - below : smaller(end[a], vertex);
        const double inside = middle[a] - (side ? below : 0.0);
        before[a] = end[a];
        room[0] = end[a] == end[a] ? (at_end - floor) / size : OVERFLOWN;
        room[count] = end[a] == end[a] ? (inside - floor_inside) / size : OVERFLOWN;
    }
}

/* Roll out `count` lanes: of the law alone, or of a plan with `side` lanes for each end. */
static INLINED void PART(_roll)(const int count, const int side, const double *restrict p, const double *restrict s,
                                const double *restrict low, const double *restrict high, Rollouts *r)
{
    double *const y = r->y, *const middle = r->middle, *const v = r->added, elapsed = 0.0;
    double *const h = r->h, *const before = r->before, *const between = r->between;
    int block = 0;
    LANES for (int l = 0; l < count; l++) {
        LIMITS(count, r->x + l, r->t[l], p, before + l);
    }
    for (int a = 0; a < BLOCKS * M; a++) {
        r->law[2 * a] = INFINITY;
        r->law[2 * a + 1] = -INFINITY;
    }
    for (int i = 0; i < STEPS; i++) {
        const double length = s[LENGTHS + i];
        double share;
        while (block + 1 < BLOCKS && r->edges[block] <= elapsed + PRECISE(1e-9, 1e-4) * length) {
            block++;
        }
        share = block + 1 < BLOCKS ? smaller((r->edges[block] - elapsed) / length, 1.0) : 1.0;
        for (int a = 0; a < M * count; a++) { /* the mean over the step */
            const double *const now = r->v + block * M * count + a;
            v[a] = share < 1.0 ? share * now[0] + (1.0 - share) * now[M * count] : now[0];
        }
        if (i > 0 && (i < HELD || side)) {
            LANES for (int l = 0; l < count; l++) {
                LAW(count, r->x + l, r->t[l] + elapsed, p, r->U + l);
            }
        }
        for (int c = 0; c < M; c++) {
            double *const range = r->law + 2 * (block * M + c), *const U = r->U + c * count;
            for (int l = 0; side && l < count; l += side) {
                range[0] = smaller(range[0], U[l]);
                range[1] = larger(range[1], U[l]);
            }
            LANES for (int l = 0; l < count; l++) {
                U[l] = smaller(larger(U[l] + v[c * count + l], low[c]), high[c]);
            }
        }
        if (i < HELD) {
            LANES for (int l = 0; l < count; l++) {
                STEP(count, r->x + l, r->U + l, r->t[l] + elapsed, length, p, y + l, middle + l);
            }
        } else {
            LANES for (int l = 0; l < count; l++) {
                ALONG(count, r->x + l, v + l, r->rate + l, low, high, 0.5 * s[STEP_LENGTH], r->t[l] + elapsed, length,
                      p, y + l, middle + l);
            }
        }
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, middle + l, r->t[l] + elapsed + 0.5 * length, p, between + l);
        }
        elapsed += length;
        LANES for (int l = 0; l < count; l++) {
            LIMITS(count, y + l, r->t[l] + elapsed, p, h + l);
        }
        for (int a = 0; a < N * count; a++) {
            r->rate[a] = (y[a] - r->x[a]) / length;
            r->x[a] = y[a];
        }
        PART(_rooms)(count, side, s, i, before, between, h, r);
    }
}

/* Start the rollout in lane `at` of `count` at end e of loop l. Returns the smallest h there. */
static inline double PART(_begin)(int count, int at, int lanes, const double *ends, const double *moments, int e, int l,
                                  const double *p, const double *s, const double *U, Rollouts *r)
{
    double *const x = r->y, *const h = r->h, least_h = INFINITY;
    for (int c = 0; c < N; c++) {
        x[c] = r->x[c * count + at] = ends[((ptrdiff_t)e * N + c) * lanes + l];
    }
    r->t[at] = moments[e * lanes + l];
    for (int c = 0; c < M; c++) {
        r->U[c * count + at] = U[c * lanes + l];
    }
    LIMITS(1, x, r->t[at], p, h);
    for (int k = 0; k < K; k++) {
        r->below[k * count + at] = larger(s[MARGIN] - h[k], 0.0);
        r->spent[k * count + at] = smaller(larger(TIGHT - (h[k] - s[MARGIN]) / s[SIZES + k], 0.0), TIGHT);
        least_h = smaller(least_h, h[k]);
    }
    return least_h;
}

/* The smallest room of `loops` loops from l on, with the law alone from all their ends, and the smallest h there. */
static INLINED void PART(_alone)(const int loops, int lanes, int l, const double *ends, const double *moments,
                                 const double *p, const double *s, const double *low, const double *high,
                                 const double *U, double *room, double *kept, Rollouts *r)
{
    const int count = ENDS * loops;
    for (int a = 0; a < VARIABLES * count; a++) {
        r->v[a] = 0.0;
    }
    for (int j = 0; j < BLOCKS; j++) {
        r->edges[j] = s[EDGES + j];
    }
    for (int b = 0; b < loops; b++) {
        kept[b] = room[b] = INFINITY;
        for (int e = 0; e < ENDS; e++) {
            const double least_h = PART(_begin)(count, b * ENDS + e, lanes, ends, moments, e, l + b, p, s, U, r);
            kept[b] = smaller(kept[b], least_h);
        }
    }
    PART(_roll)(count, 0, p, s, low, high, r);
    for (int a = 0; a < STEPS * ROOMS * count; a++) {
        room[a % count / ENDS] = smaller(room[a % count / ENDS], r->room[a]);
    }
}

/* Add a condition a δ >= b on variables with the weights w, as a row of length 1. */
static inline void condition(Conditions *q, double *rows, const double *w, const double *a, double b, double soft)
{
    double *const row = rows + q->rows * SIDE, length = 0.0;
    for (int c = 0; c < VARIABLES; c++) {
        length += a[c] * w[c] * a[c] * w[c];
    }
    length = sqrt(length);
    if (!(length > 1e-12)) {
        return;
    }
    row[0] = b / length;
    for (int c = 0; c < VARIABLES; c++) {
        row[1 + c] = a[c] / length;
    }
    q->soft[q->rows++] = soft;
}

/* How long a block lasts. */
static inline double PART(_length)(const Rollouts *r, int block)
{
    return r->edges[block] - (block > 0 ? r->edges[block - 1] : 0.0);
}

/* The next plan, from conditions that are linear around v; r has the rollouts of v, and the conditions take the place of
 * their rooms. Returns its distance from v. */
static inline double PART(_replan)(Rollouts *r, const double *s, const double *low, const double *high,
                                   const double *moved, double *v)
{
    double *const w = r->w, *const next = r->next, *const a = r->a, farthest = 0.0;
    r->q.rows = 0;
    for (int j = 0; j < VARIABLES; j++) {
        w[j] = s[WIDTHS + j % M] / sqrt(PART(_length)(r, j / M));
    }
    for (int row = 0; row < STEPS * ROOMS * ENDS; row++) {
        const double *const room = r->room + row * SIDE;
        double b = -room[0], reach = 0.0;
        for (int j = 0; j < VARIABLES; j++) {
            a[j] = (room[j + 1] - room[0]) / moved[j];
            b += a[j] * v[j];
            reach += fabs(a[j]) * s[WIDTHS + j % M];
        }
        if (room[0] < reach && room[0] > 0.5 * OVERFLOWN) {
            condition(&r->q, r->room, w, a, b, SOFT);
        }
    }
    for (int j = 0; j < VARIABLES; j++) { /* beyond a bound of U, v has no effect */
        for (int c = 0; c < VARIABLES; c++) {
            a[c] = 0.0;
        }
        a[j] = 1.0;
        if (isfinite(low[j % M])) {
            condition(&r->q, r->room, w, a, smaller(low[j % M] - r->law[2 * j + 1], 0.0), BOUND);
        }
        a[j] = -1.0;
        if (isfinite(high[j % M])) {
            condition(&r->q, r->room, w, a, smaller(r->law[2 * j] - high[j % M], 0.0), BOUND);
        }
    }
    nearest(&r->q, r->room, w, next);
    for (int j = 0; j < VARIABLES; j++) {
        farthest = larger(farthest, fabs(next[j] - v[j]) / s[WIDTHS + j % M]);
        v[j] = next[j];
    }
    return farthest;
}

/* The edges and v of a plan one control step later. When a block is over, the block that is longest relative to its start
 * is split into two. A new plan is 0, in blocks that grow with time. */
static inline void PART(_go_on)(int lanes, const double *s, const double *plan, double *edges, double *v)
{
    const int is_new = !(plan[0] > 0.0);
    for (int j = 0; j < BLOCKS; j++) {
        edges[j] = is_new ? s[EDGES + j] : plan[j * lanes] - s[STEP_LENGTH];
    }
    edges[BLOCKS - 1] = s[EDGES + BLOCKS - 1];
    for (int j = 0; j < VARIABLES; j++) {
        v[j] = is_new ? 0.0 : plan[(BLOCKS + j) * lanes];
    }
    while (edges[0] < 0.5 * s[STEP_LENGTH]) {
        double most = 0.0;
        int split = 1;
        for (int j = 1; j < BLOCKS; j++) {
            const double ratio = edges[j] / larger(edges[j - 1], s[EDGES]);
            split = ratio > most ? j : split;
            most = larger(most, ratio);
        }
        for (int j = 0; j < split; j++) {
            edges[j] = j + 1 < split ? edges[j + 1] : sqrt(larger(edges[j], s[EDGES]) * edges[split]);
            for (int c = 0; c < M; c++) {
                v[j * M + c] = v[(j + 1) * M + c];
            }
        }
    }
}

/* The plan of loop l, from the rest of the last one. Returns its smallest room. */
static APART double PART(_plan)(int lanes, int l, const double *ends, const double *moments, const double *p,
                                const double *s, const double *low, const double *high, const double *U, double *plan,
                                Rollouts *r)
{
    const int count = ENDS * SIDE;
    double *const v = r->plan, *const moved = r->moved, best = -INFINITY, least_cost = INFINITY, farthest = INFINITY;
    PART(_go_on)(lanes, s, plan, r->edges, v);
    for (int pass = 0; pass <= PASSES; pass++) {
        double room = INFINITY, cost = 0.0;
        for (int e = 0; e < ENDS; e++) {
            for (int k = 0; k < SIDE; k++) {
                PART(_begin)(count, e * SIDE + k, lanes, ends, moments, e, l, p, s, U, r);
            }
        }
        for (int j = 0; j < VARIABLES; j++) {
            moved[j] = v[j] > 0.0 ? -MOVED * s[WIDTHS + j % M] : MOVED * s[WIDTHS + j % M];
            for (int k = 0; k < count; k++) {
                r->v[j * count + k] = v[j] + (k % SIDE == j + 1 ? moved[j] : 0.0);
            }
        }
        PART(_roll)(count, SIDE, p, s, low, high, r);
        for (int a = 0; a < STEPS * ROOMS * ENDS; a++) {
            room = smaller(room, r->room[a * SIDE]);
        }
        for (int j = 0; j < VARIABLES; j++) {
            const double share = v[j] / s[WIDTHS + j % M];
            cost += share * share * PART(_length)(r, j / M);
        }
        if (room > -MISSED ? cost < LESS * least_cost || best <= -MISSED : room > best) {
            best = room;
            least_cost = room > -MISSED ? cost : INFINITY;
            for (int j = 0; j < VARIABLES; j++) {
                plan[(BLOCKS + j) * lanes] = v[j];
            }
        }
        if (pass == PASSES || (room > -MISSED && farthest < SETTLED)) {
            break;
        }
        if (room <= 0.5 * OVERFLOWN && pass > 0) { /* go back half the way to a better plan */
            for (int j = 0; j < VARIABLES; j++) {
                v[j] = 0.5 * (v[j] + plan[(BLOCKS + j) * lanes]);
            }
            continue;
        }
        farthest = PART(_replan)(r, s, low, high, moved, v);
    }
    return best;
}

static inline void KERNEL(Shape d, const double *ends, const double *moments, const double *p, const double *safety,
                          const double *low, const double *high, double *U, double *plan, double *kept,
                          double *filtered, double *unkept, double *work)
{
    const int lanes = d.lanes;
    double least_U[M], most_U[M], room[LOOPS];
    Rollouts *const r = (Rollouts *)work;
    for (int c = 0; c < M; c++) { /* the same in all lanes */
        least_U[c] = low[c * lanes];
        most_U[c] = high[c * lanes];
    }
    for (int l = 0, loops; l < lanes; l += loops) {
        loops = lanes - l >= LOOPS ? LOOPS : 1;
        if (loops == 1) {
            PART(_alone)(1, lanes, l, ends, moments, p, safety, least_U, most_U, U, room, kept + l, r);
        } else {
            PART(_alone)(LOOPS, lanes, l, ends, moments, p, safety, least_U, most_U, U, room, kept + l, r);
        }
        for (int b = l; b < l + loops; b++) {
            const int acts = room[b - l] < 0.0;
            double found = 0.0;
            if (acts) {
                found = PART(_plan)(lanes, b, ends, moments, p, safety, least_U, most_U, U, plan + b, r);
            }
            filtered[b] = 0.0;
            for (int j = 0; j < BLOCKS; j++) {
                plan[j * lanes + b] = acts ? r->edges[j] : 0.0;
            }
            for (int c = 0; c < M && acts; c++) {
                const double *const v = plan + (BLOCKS + c) * lanes + b;
                const double share = smaller(plan[b] / safety[STEP_LENGTH], 1.0);
                double *const now = U + c * lanes + b;
                const double added = share * v[0] + (share < 1.0 ? (1.0 - share) * v[M * lanes] : 0.0);
                const double next = smaller(larger(*now + added, least_U[c]), most_U[c]);
                filtered[b] = next != smaller(larger(*now, least_U[c]), most_U[c]) ? 1.0 : filtered[b];
                *now = next;
            }
            unkept[b] = found < -0.5 * TIGHT || kept[b] < safety[MARGIN] ? 1.0 : unkept[b];
        }
    }
}
