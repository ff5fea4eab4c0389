/* PROTECT: change U only if the loop that follows would break a limit, and then by the least that keeps all limits:
 * a predictive safety filter [Wabersich, Zeilinger, Automatica 129 (2021) 109597] around the plant's law, with
 * plans that end in a place where the loop stays for good.
 *
 * From each of the states `ends` that the plant may have when U acts, the loop is rolled out with U over the first
 * control step, then with kappa within its bounds. If every h stays above its floor, U is not changed. Otherwise a
 * plan adds v to kappa; see replan.h.
 *
 * The floor is the margin; if h is below it at `ends` already, the floor rises back to it at the rate alpha. A plan
 * has a reserve: it keeps h above its floor by TIGHT times the size of h or, if less is left at `ends`, returns to
 * that. A breach of up to LATER_BREACH times that size, the more the later it is, is left to later calls, which
 * predict it better. `kept` is the smallest h of `ends`, `filtered` is 1 if U was changed, `unkept` is 1 if no plan
 * has half the reserve.
 *
 * `promised` is 1 if U begins a plan that is known to keep all limits and to rest (resting.h): kappa alone, the
 * plan that changes U, or, after U over one control step, a brake, kappa + w, which rests near. This plan is
 * remembered with the parameters that it was made with. While it keeps the limits, and U begins no other, U is that
 * of this plan: the next call then finds it once more, wherever kappa or a set-point has gone. Set-points are so
 * approached as far as such plans reach (command governors: Garone, Di Cairano, Kolmanovsky, Automatica 75 (2017)
 * 306). */
#define ENOUGH (-0.5 * TIGHT) /* room of a plan that has half its reserve */
#define WORN (-TIGHT) /* room of a plan that is kept, which may use its reserve */
#define FOLLOWED PRECISE(1e-4, 1e-3) /* of the box: what a state may be off a plan that led to it */

/* The smallest room of plan b from all ends; one that breaks a limit has none, whatever its reserve. */
static inline double PART(_room)(const Rollouts *r, int b)
{
    double room = INFINITY;
    for (int e = b * ENDS; e < (b + 1) * ENDS; e++) {
        room = smaller(room, r->strict[e] >= 0.0 ? r->least[e] : OVERFLOWN);
    }
    return room;
}

/* Roll plans on until one rests, for at most TAIL steps in PARTS: the one of these with the most room, or -1. */
static INLINED int PART(_until_rest)(const int plans, int reserved, double room, const double *p, const double *s,
                                     const double *low, const double *high, Rollouts *r)
{
    for (int last = STEPS;; last += TAIL / PARTS) {
        int best = -1, left = 0;
        double most = room;
        for (int b = 0; b < plans; b++) {
            const double least_room = PART(_room)(r, b);
            int rests = 1;
            left += least_room > room;
            for (int e = 0; e < ENDS && rests; e++) {
                rests = least_room > most && PART(_rests)(b * ENDS + e, plans * ENDS, p, s, low, high, r);
            }
            if (rests) {
                best = b;
                most = least_room;
            }
        }
        if (best >= 0 || left == 0 || last >= STEPS + TAIL) {
            return best;
        }
        if (plans == 1) {
            PART(_roll_one)(reserved, room, last, last + TAIL / PARTS, p, s, low, high, r);
        } else {
            PART(_roll_many)(reserved, room, last, last + TAIL / PARTS, p, s, low, high, r);
        }
    }
}

/* The law alone, from all ends of `loops` loops from l on: the smallest room in the grid, the smallest h at `ends`, and
 * whether it rests there. */
static INLINED void PART(_alone)(const int loops, int lanes, int l, const double *ends, const double *moments,
                                 const double *p, const double *s, const double *low, const double *high,
                                 const double *U, double *room, double *kept, int *rests, Rollouts *r)
{
    const int count = ENDS * loops;
    r->lasts = s[LASTS];
    PART(_new)(s, &r->plan);
    for (int a = 0; a < VARIABLES * count; a++) {
        r->v[a] = 0.0;
    }
    for (int b = 0; b < loops; b++) {
        kept[b] = PART(_meet)(lanes, l + b, ends, moments, U, p, r);
        for (int e = 0; e < ENDS; e++) {
            PART(_begin)(count, b * ENDS + e, e, p, s, r->now, NULL, r);
        }
    }
    if (loops == 1) {
        PART(_roll_one)(0, 0.0, 0, STEPS, p, s, low, high, r);
    } else {
        PART(_roll_many)(0, 0.0, 0, STEPS, p, s, low, high, r);
    }
    for (int b = 0; b < loops; b++) {
        room[b] = INFINITY;
        for (int e = 0; e < ENDS; e++) {
            room[b] = smaller(room[b], r->least[b * ENDS + e]);
        }
        rests[b] = 0;
    }
    for (int last = STEPS, moves = s[STILL] > 0.0; moves; last += TAIL / PARTS) {
        moves = 0;
        for (int b = 0; b < loops; b++) {
            const int is_kept = room[b] >= 0.0 && !rests[b] && PART(_room)(r, b) > OVERFLOWN;
            rests[b] = rests[b] || is_kept;
            for (int e = 0; e < ENDS && is_kept; e++) {
                rests[b] = rests[b] && PART(_rests)(b * ENDS + e, count, p, s, low, high, r);
            }
            moves = moves || (is_kept && !rests[b]);
        }
        if (last >= STEPS + TAIL) {
            break;
        }
        if (moves && loops == 1) {
            PART(_roll_one)(0, 0.0, last, last + TAIL / PARTS, p, s, low, high, r);
        } else if (moves) {
            PART(_roll_many)(0, 0.0, last, last + TAIL / PARTS, p, s, low, high, r);
        }
    }
}

/* Remember r->plan, with w and p, as lane `at` of `count` has it. */
static inline void PART(_keep)(const double *w, int at, int count, const double *p, Rollouts *r)
{
    Memory *const memory = &r->memory;
    memory->promised = 1.0;
    memory->until = r->moments[0] + r->lasts;
    memory->turn = w ? r->moments[0] + r->turn[at] : NEVER;
    memory->kept = r->plan;
    for (int c = 0; c < M; c++) {
        memory->w[c] = w ? w[c] : 0.0;
        memory->later[c] = w ? r->later[c * count + at] : 0.0;
    }
    for (int i = 0; i < PARAMETERS; i++) {
        memory->p[i] = p[i];
    }
}

/* The U that holds a state best: least squares of the change of x in a control step, in units of the box; and the
 * rates. */
static inline void PART(_holding)(const double *x, double t, const double *p, const double *s, const double *low,
                                  const double *high, double *U, double *rate, Ball *b)
{
    double *const B = b->A, *const G = b->S, *const y = b->y, *const moved = b->x, *const unused = b->unused, g[M];
    STEP(1, x, U, t, s[STEP_LENGTH], p, y, unused);
    for (int c = 0; c < M; c++) {
        const double step = (U[c] + U[c] > low[c] + high[c] ? -MOVED : MOVED) * s[WIDTHS + c], before = U[c];
        U[c] += step;
        STEP(1, x, U, t, s[STEP_LENGTH], p, moved, unused);
        U[c] = before;
        for (int i = 0; i < N; i++) {
            B[i * M + c] = (moved[i] - y[i]) / step * s[WIDTHS + c] / BOX(s, i);
        }
    }
    for (int c = 0; c < M; c++) {
        g[c] = 0.0;
        for (int i = 0; i < N; i++) {
            g[c] -= B[i * M + c] * (y[i] - x[i]) / BOX(s, i);
        }
        for (int d = 0; d < M; d++) {
            G[c * M + d] = 0.0;
            for (int i = 0; i < N; i++) {
                G[c * M + d] += B[i * M + c] * B[i * M + d];
            }
        }
    }
    for (int c = 0; c < M; c++) { /* Gauss, without pivots: G is positive */
        const double pivot = larger(G[c * M + c], 1e-30);
        for (int d = c + 1; d < M; d++) {
            const double share = G[d * M + c] / pivot;
            for (int i = c; i < M; i++) {
                G[d * M + i] -= share * G[c * M + i];
            }
            g[d] -= share * g[c];
        }
    }
    for (int c = M - 1; c >= 0; c--) {
        for (int d = c + 1; d < M; d++) {
            g[c] -= G[c * M + d] * g[d];
        }
        g[c] /= larger(G[c * M + c], 1e-30);
        U[c] = within(U[c] + g[c] * s[WIDTHS + c], low[c], high[c]);
    }
    STEP(1, x, U, t, s[STEP_LENGTH], p, y, unused);
    for (int i = 0; i < N; i++) {
        rate[i] = (y[i] - x[i]) / s[STEP_LENGTH];
    }
}

/* Whether a brake keeps the limits, after U over one control step or, with `at_once`, from now on; it is kept, and
 * U is its first one. Brakes are kappa + w that hold, in place of the state, the one that it comes to in the times
 * AHEAD at its present rate; the first one is kappa itself. The last TURNING ones brake hard until they are slow, and
 * then rest there, or go on with kappa. Where kappa tracks, its time ends after U. */
static APART int PART(_brakes)(int at_once, const double *p, const double *s, const double *low, const double *high,
                               double *U, Rollouts *r)
{
    const int count = ENDS * MANY;
    double rate[N], hold[M], aim[N], w[M], first[M], law[M];
    int best;
    for (int c = 0; c < M; c++) {
        hold[c] = U[c];
    }
    PART(_holding)(r->ends, r->moments[0], p, s, low, high, hold, rate, &r->shared.ball);
    LAW(1, r->ends, r->moments[0], p, law);
    r->lasts = s[LASTS] > s[LATER] ? s[LASTS] : s[STEP_LENGTH];
    PART(_new)(s, &r->plan);
    for (int a = 0; a < VARIABLES * count; a++) {
        r->v[a] = 0.0;
    }
    for (int b = 0; b < MANY; b++) {
        for (int c = 0; c < N; c++) {
            aim[c] = r->ends[c] + s[AHEAD + b] * rate[c];
        }
        LAW(1, aim, r->moments[0], p, w);
        for (int c = 0; c < M; c++) {
            w[c] = b > 0 ? hold[c] - w[c] : 0.0;
            first[c] = at_once ? within(law[c] + w[c], low[c], high[c]) : U[c];
        }
        for (int e = 0; e < ENDS; e++) {
            PART(_begin)(count, b * ENDS + e, e, p, s, first, w, r);
            for (int c = 0; c < M; c++) {
                r->later[c * count + b * ENDS + e] = hold[c];
            }
        }
    }
    PART(_roll_many)(1, ENOUGH, 0, STEPS, p, s, low, high, r);
    best = PART(_until_rest)(MANY, 1, ENOUGH, p, s, low, high, r);
    for (int c = 0; c < M && best >= 0; c++) {
        w[c] = best < MANY - TURNING ? r->w[c * count + best * ENDS] : w[c];
        U[c] = at_once ? within(law[c] + w[c], low[c], high[c]) : U[c];
    }
    if (best >= 0) {
        PART(_keep)(w, best * ENDS, count, p, r);
    }
    return best >= 0;
}

/* Roll out r->plan, with w and the parameters p, after U: 1 if it keeps the limits with that room and rests, then it is
 * kept; 0.5 if it keeps them on the grid; else 0. */
static APART double PART(_holds)(const double *w, double room, const double *p, const double *s, const double *low,
                                 const double *high, const double *U, Rollouts *r)
{
    double least_room;
    PART(_begin_plan)(1, p, s, U, w, r);
    for (int e = 0; e < ENDS && w; e++) {
        r->turn[e] = r->memory.turn - r->moments[e];
        for (int c = 0; c < M; c++) {
            r->later[c * ENDS + e] = r->memory.later[c];
        }
    }
    PART(_roll_one)(1, room, 0, STEPS, p, s, low, high, r);
    least_room = PART(_room)(r, 0);
    if (PART(_until_rest)(1, 1, room, p, s, low, high, r) < 0) {
        return least_room > room ? 0.5 : 0.0;
    }
    PART(_keep)(w, 0, ENDS, p, r);
    return 1.0;
}

/* U in the first control step of r->plan, of kappa + w. */
static inline void PART(_first)(const Rollouts *r, const double *s, const double *low, const double *high,
                                const double *law, double *U)
{
    const double share = smaller(r->plan.edges[0] / s[STEP_LENGTH], 1.0);
    for (int c = 0; c < M; c++) {
        const double *const v = r->plan.v + c;
        const double added = share * v[0] + (share < 1.0 ? (1.0 - share) * v[M] : 0.0);
        U[c] = within(within(law[c], low[c], high[c]) + added, low[c], high[c]);
    }
}

/* Go on with the plan that is kept, if it still has room, which may be that of the margin; U is its first one. It is
 * promised if it rests, or was before and the state is the one that it led to: what is beyond the grid is known from
 * then. */
static APART int PART(_goes_on)(const double *s, const double *low, const double *high, double *U, Rollouts *r)
{
    const int turned = r->memory.turn < r->moments[0] + 0.5 * s[STEP_LENGTH];
    for (int c = 0; c < M && turned; c++) {
        r->memory.w[c] = r->memory.later[c];
    }
    r->memory.turn = turned ? NEVER : r->memory.turn;
    const Memory before = r->memory;
    double law[M], holds;
    int follows = before.promised >= 1.0;
    PART(_go_on)(s, &before.kept, &r->plan);
    LAW(1, r->ends, smaller(r->moments[0], before.until), before.p, law);
    r->lasts = before.until - r->moments[0];
    r->margin = 0.0;
    for (int c = 0; c < M; c++) {
        law[c] += before.w[c];
    }
    PART(_first)(r, s, low, high, law, U);
    holds = PART(_holds)(before.w, WORN, before.p, s, low, high, law, r);
    for (int c = 0; c < N; c++) {
        follows = follows && fabs(r->ends[c] - before.next[c]) <= FOLLOWED * BOX(s, c);
    }
    if (holds > 0.0) {
        PART(_keep)(before.w, 0, ENDS, before.p, r);
        r->memory.promised = follows ? 1.0 : holds;
    }
    return holds > 0.0;
}

/* Choose U of a loop that is within its limits, whose law alone has that room, and rests or not: U of a plan, or
 * else of the law, if it begins what is promised; else that of the plan that was promised, or of a brake; else none
 * is. Returns the room of what was chosen. */
static inline double PART(_choose)(double room, int rests, const double *p, const double *s, const double *low,
                                   const double *high, double *U, Rollouts *r)
{
    const int acts = room < 0.0, had = r->memory.promised > 0.0;
    double found = 0.0, other[M];
    r->lasts = s[LASTS];
    if (rests) {
        PART(_new)(s, &r->plan);
        PART(_keep)(NULL, 0, 1, p, r);
        return found;
    }
    if (acts) {
        found = PART(_plan)(p, s, low, high, r);
        r->plan = r->memory.last;
        PART(_first)(r, s, low, high, r->now, U);
        if (found > ENOUGH && s[STILL] > 0.0 && (PART(_holds)(NULL, ENOUGH, p, s, low, high, r->now, r) >= 1.0 ||
                               PART(_brakes)(0, p, s, low, high, U, r))) {
            return found;
        }
    }
    if (!(s[STILL] > 0.0)) {
        return found;
    }
    for (int c = 0; c < M; c++) {
        other[c] = within(r->now[c], low[c], high[c]);
    }
    if (!PART(_brakes)(0, p, s, low, high, other, r)) {
        const int goes_on = had && PART(_goes_on)(s, low, high, other, r);
        r->memory.promised = goes_on ? r->memory.promised : 0.0;
        if (r->memory.promised < 1.0) {
            r->margin = s[MARGIN];
            if (!PART(_brakes)(1, p, s, low, high, other, r) && !goes_on) {
                return found;
            }
        }
    }
    for (int c = 0; c < M; c++) {
        U[c] = other[c];
    }
    return 0.0;
}

static inline void KERNEL(Shape d, const double *ends, const double *moments, const double *p, const double *safety,
                          const double *low, const double *high, double *U, double *plan, double *kept,
                          double *filtered, double *unkept, double *promised,
                          double *withdrawn, double *work)
{
    const int lanes = d.lanes;
    double least_U[M], most_U[M], room[LOOPS], next[M];
    int rests[LOOPS];
    Rollouts *const r = (Rollouts *)work;
    for (int c = 0; c < M; c++) { /* the same in all lanes */
        least_U[c] = low[c * lanes];
        most_U[c] = high[c * lanes];
    }
    for (int l = 0, loops; l < lanes; l += loops) {
        loops = lanes - l >= LOOPS ? LOOPS : 1;
        r->margin = safety[MARGIN];
        if (loops == 1) {
            PART(_alone)(1, lanes, l, ends, moments, p, safety, least_U, most_U, U, room, kept + l, rests, r);
        } else {
            PART(_alone)(LOOPS, lanes, l, ends, moments, p, safety, least_U, most_U, U, room, kept + l, rests, r);
        }
        for (int b = l; b < l + loops; b++) {
            const int acts = room[b - l] < 0.0;
            double *const memory = (double *)&r->memory;
            double found, had;
            r->margin = safety[MARGIN];
            PART(_meet)(lanes, b, ends, moments, U, p, r);
            for (int i = 0; i < (int)REMEMBERED; i++) {
                memory[i] = plan[i * lanes + b];
            }
            had = r->memory.promised;
            for (int c = 0; c < M; c++) {
                next[c] = within(U[c * lanes + b], least_U[c], most_U[c]);
            }
            found = PART(_choose)(room[b - l], rests[b - l], p, safety, least_U, most_U, next, r);
            filtered[b] = 0.0;
            for (int c = 0; c < M; c++) {
                double *const now = U + c * lanes + b;
                if (next[c] != within(*now, least_U[c], most_U[c])) {
                    filtered[b] = 1.0;
                    *now = next[c];
                }
            }
            if (!acts) {
                r->memory.last.edges[0] = 0.0;
            }
            if (found < ENOUGH || !(kept[b] >= r->margin) || unkept[b] > 0.0) {
                r->memory.promised = 0.0;
            }
            unkept[b] = found < ENOUGH || !(kept[b] >= safety[MARGIN]) ? 1.0 : unkept[b];
            r->memory.withdrawn += ENDS == 1 && had >= 1.0 && r->memory.promised < 1.0 ? 1.0 : 0.0;
            promised[b] = ENDS == 1 && r->memory.promised >= 1.0 ? 1.0 : 0.0; /* kappa reads a wrong prediction else */
            STEP(1, r->ends, next, r->moments[0], safety[STEP_LENGTH], p, r->memory.next, r->y);
            withdrawn[b] = r->memory.withdrawn;
            for (int i = 0; i < (int)REMEMBERED; i++) {
                plan[i * lanes + b] = memory[i];
            }
        }
    }
}
