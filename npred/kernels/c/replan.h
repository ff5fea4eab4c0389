/* The plan within the limits with the least Σ ∫ (v / width)² dt, from the rest of the last one. It is sought by up to
 * PASSES programmes that are linear around the last plan; their slopes are differences of rollouts side by side. */
#define PASSES 2
#define MOVED PRECISE(1e-4, 1e-3) /* of the width of an input: how far a variable is moved */
#define SETTLED 1e-4 /* of that width: a plan that changes by less is final */
#define LESS 0.999   /* of the cost of a plan: a new plan has to cost less than this share */
#define MISSED 1e-5  /* of the size of h */

/* Add a condition a δ >= b on variables with the weights w, as a row of length 1. */
static inline void condition(Conditions *q, double *rows, const double *w, const double *a, double b)
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
    q->rows++;
}

/* How long a block lasts. */
static inline double PART(_length)(const Rollouts *r, int block)
{
    return r->plan.edges[block] - (block > 0 ? r->plan.edges[block - 1] : 0.0);
}

/* The next plan, from conditions that are linear around v; r has the rollouts of v, and the conditions take the place
 * of their rooms. Returns its distance from v. */
static inline double PART(_replan)(Rollouts *r, const double *s, const double *low, const double *high, double *v)
{
    double *const w = r->weights, *const next = r->next, *const a = r->a, farthest = 0.0;
    r->shared.q.rows = 0;
    for (int j = 0; j < VARIABLES; j++) {
        w[j] = s[WIDTHS + j % M] / sqrt(PART(_length)(r, j / M));
    }
    for (int row = 0; row < STEPS * ROOMS; row++) {
        const double *const room = r->rows + row * SIDE;
        double b = -room[0], reach = 0.0;
        for (int j = 0; j < VARIABLES; j++) {
            a[j] = room[j + 1] / r->moved[j];
            b += a[j] * v[j];
            reach += fabs(a[j]) * s[WIDTHS + j % M];
        }
        if (room[0] < reach && room[0] > 0.5 * OVERFLOWN) {
            condition(&r->shared.q, r->rows, w, a, b);
        }
    }
    r->shared.q.states = r->shared.q.rows;
    for (int j = 0; j < VARIABLES; j++) { /* beyond a bound of U, v has no effect */
        for (int c = 0; c < VARIABLES; c++) {
            a[c] = 0.0;
        }
        a[j] = 1.0;
        if (isfinite(low[j % M])) {
            condition(&r->shared.q, r->rows, w, a, smaller(low[j % M] - r->law[2 * j + 1], 0.0));
        }
        a[j] = -1.0;
        if (isfinite(high[j % M])) {
            condition(&r->shared.q, r->rows, w, a, smaller(r->law[2 * j] - high[j % M], 0.0));
        }
    }
    nearest(&r->shared.q, r->rows, w, next);
    for (int j = 0; j < VARIABLES; j++) {
        farthest = larger(farthest, fabs(next[j] - v[j]) / s[WIDTHS + j % M]);
        v[j] = next[j];
    }
    return farthest;
}

/* A plan one control step later. When a block is over, the block that is longest relative to its start is split into
 * two. */
static inline void PART(_go_on)(const double *s, const Plan *last, Plan *now)
{
    double *const edges = now->edges, *const v = now->v;
    *now = *last;
    for (int j = 0; j < BLOCKS; j++) {
        edges[j] -= s[STEP_LENGTH];
    }
    edges[BLOCKS - 1] = s[EDGES + BLOCKS - 1];
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

/* Which way variable j is moved: off the bound that kappa is clipped at in its block, else off that which v goes to. */
static inline double PART(_moved)(const Rollouts *r, const double *s, const double *low, const double *high, int j)
{
    const int at_high = r->law[2 * j + 1] >= high[j % M], at_low = r->law[2 * j] <= low[j % M];
    const int down = at_high != at_low ? at_high : r->plan.v[j] > 0.0;
    return (down ? -MOVED : MOVED) * s[WIDTHS + j % M];
}

/* The smallest room of a plan that was rolled out with its sides. */
static inline double PART(_smallest)(const Rollouts *r)
{
    double room = INFINITY;
    for (int row = 0; row < STEPS * ROOMS; row++) {
        room = smaller(room, r->rows[row * SIDE]);
    }
    return room;
}

/* The plan, from the rest of the last one, in r->memory.last; r->plan is overwritten. Returns its smallest room. */
static APART double PART(_plan)(const double *p, const double *s, const double *low, const double *high, Rollouts *r)
{
    double *const v = r->plan.v, *const found = r->memory.last.v;
    double room, best = -INFINITY, least_cost = INFINITY, farthest = INFINITY;
    if (r->memory.last.edges[0] > 0.0) {
        PART(_go_on)(s, &r->memory.last, &r->plan);
    } else {
        PART(_new)(s, &r->plan);
    }
    r->memory.last = r->plan;
    PART(_begin_plan)(1, p, s, r->now, NULL, r);
    PART(_roll_one)(1, -INFINITY, 0, STEPS, p, s, low, high, r);
    for (int pass = 0; pass <= PASSES; pass++) {
        double cost = 0.0;
        for (int j = 0; j < VARIABLES; j++) {
            r->moved[j] = PART(_moved)(r, s, low, high, j);
        }
        if (pass == PASSES || farthest < SETTLED) { /* the last one is not moved */
            PART(_begin_plan)(1, p, s, r->now, NULL, r);
            PART(_roll)(ENDS, 1, 1, 0.0, 0, STEPS, p, s, low, high, r);
        }
        if (pass < PASSES && (farthest >= SETTLED || PART(_smallest)(r) <= -MISSED)) {
            PART(_begin_plan)(SIDE, p, s, r->now, NULL, r);
            for (int j = 0; j < VARIABLES; j++) {
                r->v[j * SIDED + j + 1] += r->moved[j];
            }
            PART(_roll)(SIDED, SIDE, 1, 0.0, 0, STEPS, p, s, low, high, r);
        }
        room = PART(_smallest)(r);
        for (int j = 0; j < VARIABLES; j++) {
            const double share = v[j] / s[WIDTHS + j % M];
            cost += share * share * PART(_length)(r, j / M);
        }
        if (room > -MISSED ? cost < LESS * least_cost || best <= -MISSED : room > best) {
            best = room;
            least_cost = room > -MISSED ? cost : INFINITY;
            for (int j = 0; j < VARIABLES; j++) {
                found[j] = v[j];
            }
        }
        if (pass == PASSES || (room > -MISSED && farthest < SETTLED)) {
            break;
        }
        if (room <= 0.5 * OVERFLOWN && pass > 0) { /* go back half the way to a better plan */
            for (int j = 0; j < VARIABLES; j++) {
                v[j] = 0.5 * (v[j] + found[j]);
            }
            continue;
        }
        farthest = PART(_replan)(r, s, low, high, v);
    }
    return best;
}
