/* A controller on a real plant: one control step on its memory, with one lane, at the time of the call.
 *
 * Times are positions in the history of commands, in control steps. A call comes `gap` after the one before, 1 if it is
 * on time, and its sample was taken `age` before the call. The history stores the mean of the commands over each control
 * step of a regular clock; if all calls are on time, these means are the commands. */

/* Why a step gives no U; an export uses the same numbers. */
enum { OK, MEASUREMENT_NOT_FINITE, PREDICTION_NOT_FINITE, DELAY_TOO_LONG = 4, STATE_UNKNOWN = 6 };

#define PAUSE 4.0  /* lengths of the history: after a longer pause the controller expects nothing of the state */

/* What a controller with a history remembers, as npred/loop/clock.py declares it. */
typedef struct {
    double *stamp;             /* (STAMPS) */
    double *sent, *before, *D; /* (m) the last command, the mean in the control step before it, the delays of that call */
    double *now, *base;        /* (n) */
    double *refused;           /* (outputs) the first of the samples in a row in which the output was refused, else NaN */
} Clock;

static inline Clock clock_of(Shape d, double *memory)
{
    Clock c = {.stamp = memory, .sent = memory + STAMPS};
    c.before = c.sent + d.m;
    c.D = c.before + d.m;
    c.now = c.D + d.m;
    c.base = c.now + d.n;
    c.refused = c.base + d.n;
    return c;
}

static inline int all_finite(int count, const double *a)
{
    int all = 1;
    for (int i = 0; i < count; i++) {
        all = all && isfinite(a[i]);
    }
    return all;
}

static inline void copy(int count, const double *from, double *to)
{
    for (int i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

static inline void fill(int count, double value, double *to)
{
    for (int i = 0; i < count; i++) {
        to[i] = value;
    }
}

/* Expect nothing of the next sample, and treat the next call as the first. */
SPARE static inline void forget(Shape d, int output_count, Clock c)
{
    c.stamp[BASE_AT] = c.stamp[SAMPLE_AT] = c.stamp[RENEWED_AT] = c.stamp[TICK] = NAN;
    c.stamp[CALLS] = 0.0;
    fill(d.n, NAN, c.now);
    fill(d.n, NAN, c.base);
    fill(output_count, NAN, c.refused);
}

/* Restart the observer of the delay at the next sample, unless it has estimates of the state of its own. */
static inline void forget_delay(const Settings *s, State *z, Clock c)
{
    if (s->judges_outputs) {
        return;
    }
    fill(s->observer_count, NAN, z->observer);
    c.stamp[TICK] = NAN;
}

/* The longest delay by which a step can read the commands, also for the oldest sample that is used. */
static inline double longest(Shape d, const Settings *s)
{
    return ((double)(d.rows - 3) - s->oldest) * s->dt;
}

/* The control step of a position. */
static inline INDEX step_of(double at)
{
    return (INDEX)(at + ROUNDING);
}

/* Store U in the history from one position to another; `before` is the mean in the first control step up to there. */
static inline void book(Shape d, double from, double to, const double *before, const double *U, double *held, double *total)
{
    for (double at = from, end; at < to; at = end) {
        const INDEX i = step_of(at);
        const double part = larger(at - (double)i, 0.0);
        end = smaller((double)(i + 1), to);
        for (int c = 0; c < d.m; c++) {
            const int row = modulo(i, d.rows) * d.m + c, next = modulo(i + 1, d.rows) * d.m + c;
            held[row] = part > ROUNDING ? (part * before[c] + (end - at) * U[c]) / (part + end - at) : U[c];
            total[next] = total[row] + held[row];
        }
    }
}

/* Replace the last command, which is stored for one control step, by U. */
SPARE static inline void replace(Shape d, State *z, const double *U)
{
    const Clock c = clock_of(d, z->clock);
    copy(d.m, U, c.sent);
    book(d, c.stamp[AT], c.stamp[AT] + 1.0, c.before, c.sent, z->held, z->total);
}

/* Bring a filter's memory from one position to another. */
static inline void follow(Shape d, double from, double to, Moment now, const Parts *q, const Settings *s, const State *z,
                          double *filter, double *work)
{
    double *U0 = work, *U1 = U0 + d.m, *share = U1 + d.m, *rest = share + d.m;
    for (double at = from, end; at < to; at = end) {
        end = reached(d, 0, at, to, s->dt, clock_of(d, z->clock).D, z->held, NULL, U0, U1, share);
        q->follow(d, U0, U1, share, (end - at) * s->dt, time_at(now, at), s->p, s->sensing, filter, rest);
    }
}

/* Restart the filter at a position, from `filter`. */
static inline void renew(Shape d, double at, const double *filter, const Settings *s, State *z)
{
    const Clock c = clock_of(d, z->clock);
    copy(s->filter_count, filter, z->filter);
    c.stamp[RENEWED_AT] = at;
    c.stamp[RENEWED] += 1.0;
    forget_delay(s, z, c);
}

/* Move the state of the last sample to a position, by the model or by the filter. */
static inline void move_base(Shape d, double to, Moment now, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    if (!(c.stamp[BASE_AT] < to)) {
        return;
    }
    if (q->follow) {
        follow(d, c.stamp[BASE_AT], to, now, q, s, z, z->filter, work);
        if (!all_finite(s->filter_count, z->filter)) {
            renew(d, to, s->anew, s, z);
        }
        copy(d.n, z->filter, c.base);
    } else {
        onward(d, 0, c.stamp[BASE_AT], to, 1.0, now, c.D, z->held, NULL, q->model, s->p, c.base, work);
    }
    c.stamp[BASE_AT] = to;
}

/* Move the expected state from one position to another, by the model. */
static inline void expect(Shape d, double from, double to, Moment now, const Parts *q, const Settings *s, State *z,
                          double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double *push = s->offsets ? z->filter + d.n : NULL;
    if (all_finite(d.n, z->expected)) {
        onward(d, 0, larger(from, c.stamp[NOW_AT]), to, 1.0, now, c.D, z->held, push, q->model, s->p, z->expected, work);
    }
}

/* Go on to a call `gap` after the last one, step by step: the last command was held until now, the model follows the
 * commands that reached the plant, and D_hat its last rate. After a very long pause the controller starts anew. */
static inline void arrive(Shape d, double gap, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double since = c.stamp[CALLS] > 0.0 ? gap : 1.0, to = c.stamp[AT] + smaller(since, PAUSE * (double)d.rows);
    const Moment now = {to, t, s->dt};
    if (s->reads_commands) {
        copy(d.n, c.now, z->expected);
    }
    if (to < c.stamp[AT] + since) {
        fill(d.n, NAN, z->expected);
        fill(d.n, NAN, c.base);
        c.stamp[RENEWED_AT] = NAN;
        fill(s->output_count, NAN, c.refused);
    }
    for (double at = c.stamp[AT], end; at < to; at = end) {
        end = smaller((double)(step_of(at) + 1), to);
        book(d, at, end, c.before, c.sent, z->held, z->total);
        if (s->reads_commands) {
            expect(d, at, end, now, q, s, z, work);
            move_base(d, end - s->oldest, now, q, s, z, work);
        }
    }
    if (since != 1.0 && s->gamma_dt > 0.0 && isfinite(z->phi_before[0])) {
        const double moved = z->D_hat[0] + s->gamma_dt * (since - 1.0) * z->phi_before[0];
        z->D_hat[0] = smaller(larger(moved, s->bounds[0]), s->bounds[1]);
    }
    copy(d.m, z->held + modulo(step_of(to), d.rows) * d.m, c.before);
    c.stamp[AT] = to;
    c.stamp[CALLS] = 1.0;
}

/* Correct a filter, which is at the time of the sample, by the outputs that are not too far from its own. `fate` says of
 * each output whether it was used. */
static inline int correct(Shape d, double t, double gate, const Parts *q, const Settings *s, const State *z, double *filter,
                          double *innovation, double *fate, double *work)
{
    int all = 0;
    q->correct(d, z->sample, t, s->p, gate, s->sensing, filter, innovation, fate, work);
    for (int i = 0; i < s->output_count; i++) {
        const int far = !(fabs(innovation[i]) <= gate * fate[i]);
        const int what = isnan(z->sample[i]) ? 0 : far ? FAR : USED;
        fate[i] = (double)what;
        all |= what;
    }
    return all;
}

/* Take a new filter, wider by that factor, if it accepts an output that the present one has refused for D_hat: then the
 * present one is wrong. */
static inline int replace_filter(Shape d, double taken, double t, double gate, double wider, const Parts *q,
                                 const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    double *filter = work, *innovation = filter + s->filter_count, *fate = innovation + s->output_count;
    int all, helps = 0;
    for (int i = 0; i < s->filter_count; i++) {
        filter[i] = s->anew[i] * (s->widens[i] > 0.0 ? wider * wider : 1.0);
    }
    all = correct(d, t, gate, q, s, z, filter, innovation, fate, fate + s->output_count);
    for (int i = 0; i < s->output_count; i++) {
        const int late = believable(c.refused[i], c.stamp[RENEWED_AT], taken, s->dt, z->D_hat[0]) > 0.0;
        helps = helps || (late && (int)z->fate[i] == FAR && (int)fate[i] == USED);
    }
    if (!helps || !all_finite(s->filter_count, filter)) {
        return 0;
    }
    copy(s->output_count, innovation, z->innovation);
    copy(s->output_count, fate, z->fate);
    renew(d, taken, filter, s, z);
    return all;
}

/* Estimate the state from the outputs of a sample. */
static inline int estimate_state(Shape d, double taken, double gate, Moment now, const Parts *q, const Settings *s, State *z,
                                 double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double t = time_at(now, taken);
    double wider = 0.0;
    int all = correct(d, t, gate, q, s, z, z->filter, z->innovation, z->fate, work), other = 0;
    for (int i = 0; i < s->output_count; i++) {
        if ((int)z->fate[i] == FAR) {
            c.refused[i] = isnan(c.refused[i]) ? taken : c.refused[i];
            wider = larger(wider, believable(c.refused[i], c.stamp[RENEWED_AT], taken, s->dt, z->D_hat[0]));
        }
    }
    if (!all_finite(s->filter_count, z->filter)) {
        renew(d, taken, s->anew, s, z);
        all = FAR;
    } else if (wider > 0.0) {
        other = replace_filter(d, taken, t, gate, wider, q, s, z, work);
    }
    for (int i = 0; i < s->output_count; i++) {
        c.refused[i] = (int)z->fate[i] == USED ? NAN : c.refused[i];
    }
    copy(d.n, z->filter, c.base);
    return other ? other : all;
}

/* Take the sample Y as the state, unless it is too far from the model's value. */
static inline int compare_state(Shape d, double taken, Moment now, const Settings *s, State *z)
{
    const Clock c = clock_of(d, z->clock);
    const double *X = taken < now.at ? c.base : z->expected;
    const Gate g = {c.refused, c.stamp + RENEWED_AT, c.stamp + STRAY};
    int anew;
    const int what = judge(d, 0, taken, z->D_hat[0], s, z->Y, X, g, &anew);
    if (anew) {
        forget_delay(s, z, c);
    }
    for (int i = 0; i < d.n; i++) {
        z->innovation[i] = z->Y[i] - X[i];
        c.base[i] = what == USED ? z->Y[i] : c.base[i];
    }
    return what;
}

/* Use a sample that was taken at a position, unless it is too far from the expected one: then it is refused. Returns which
 * of both, of outputs maybe both, or 0 for a sample without a number; where it is used, `base` is the state there. */
static inline int learn(Shape d, double taken, Moment now, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double gate = s->gated && z->D_hat[0] > 0.0 ? s->gate : INFINITY;
    int what;
    if (q->correct || taken < now.at) {
        move_base(d, taken, now, q, s, z, work);
    }
    what = q->correct ? estimate_state(d, taken, gate, now, q, s, z, work) : compare_state(d, taken, now, s, z);
    if (what & FAR) {
        c.stamp[REFUSED] += 1.0;
        z->missed[0] += 1.0;
    } else if (what & USED) {
        z->missed[0] = 0.0;
    }
    if (what & USED) {
        c.stamp[BASE_AT] = c.stamp[SAMPLE_AT] = taken;
        c.stamp[RENEWED_AT] = isnan(c.stamp[RENEWED_AT]) ? taken : c.stamp[RENEWED_AT];
    }
    return what;
}

/* X_hat from the model's expectation and, if one came, from a sample of that age. Returns what `learn`
 * does, 0 for one that comes late. */
static inline int sense(Shape d, Moment now, int came, double age, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double taken = now.at - age, *push = s->offsets ? z->filter + d.n : NULL;
    const int late = age > s->oldest || taken <= c.stamp[SAMPLE_AT] + ROUNDING || taken < c.stamp[BASE_AT] - ROUNDING;
    int what = 0, used;
    if (came && late) {
        c.stamp[LATE] += 1.0;
    } else if (came) {
        what = learn(d, taken, now, q, s, z, work);
    }
    used = what & USED;
    copy(d.n, used ? c.base : z->expected, z->X_hat);
    if (s->pulls && c.stamp[BASE_AT] <= now.at && (used || all_finite(d.n, z->expected))) {
        copy(s->filter_count, z->filter, work);
        follow(d, c.stamp[BASE_AT], now.at, now, q, s, z, work, work + s->filter_count);
        copy(d.n, work, z->X_hat);
    } else if (used) {
        onward(d, 0, taken, now.at, 1.0, now, c.D, z->held, push, q->model, s->p, z->X_hat, work);
    }
    copy(d.n, z->X_hat, c.now);
    c.stamp[NOW_AT] = now.at;
    return what;
}

/* Bring the observer of the delay, which steps at the control steps of the history, up to the sample that was used.
 * Without one, go as near to now as no later sample can lie before. The sample is moved to the nearest of these steps. */
static inline void find_delay(Shape d, Moment now, int used, double taken, const Parts *q, const Settings *s, State *z,
                              double *work)
{
    const Clock c = clock_of(d, z->clock);
    const INDEX newest = step_of(now.at), nearest = step_of(taken + 0.5), at = nearest < newest ? nearest : newest;
    const INDEX last = used ? at : newest - (INDEX)c.stamp[LAG];
    const double gap = (double)at - taken, *push = s->offsets ? z->filter + d.n : NULL;
    double *U0 = work, *U1 = U0 + d.m, *share = U1 + d.m, *reading = share + d.m, *rest = reading + s->output_count + 1;
    if (used && !isnan(c.stamp[TICK]) && !all_finite(s->observer_count, z->observer)) {
        forget_delay(s, z, c);
    }
    if (used) {
        c.stamp[LAG] = larger(c.stamp[LAG], (double)(newest - at));
        c.stamp[TICK] = isnan(c.stamp[TICK]) ? (double)(at - 1) : c.stamp[TICK];
    }
    if (isnan(c.stamp[TICK])) { /* the observer starts at a sample */
        return;
    }
    for (INDEX i = step_of(c.stamp[TICK]) + 1; i <= last; i++) {
        fill(d.n, NAN, z->Y);
        if (s->judges_outputs) {
            fill(s->output_count, NAN, reading);
            copy(used && i == at ? s->output_count : 0, z->sample, reading);
            reading[s->output_count] = -gap;
        } else if (used && i == at) {
            copy(d.n, c.base, z->Y);
            if (gap != 0.0) {
                reached(d, 0, taken, taken + 1.0, s->dt, c.D, z->held, push, U0, U1, share);
                fill(d.m, 1.0, share);
                q->model(d, z->Y, U0, U1, share, gap * s->dt, time_at(now, taken), s->p, rest);
            }
        }
        q->observe(d, i, s->dt, s->judges_outputs ? reading : z->Y, z->held, time_at(now, (double)i), s->p, s->law,
                   z->observer, z->D_hat, rest);
        c.stamp[TICK] = (double)i;
    }
}

/* If no sample was used for longer than the watchdog waits, U is what the watchdog declares: the last U, numbers, or
 * another law of the prediction. While the watchdog takes over or hands back, U moves by at most `jump` in a call. */
static inline void hand_over(Shape d, Moment now, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double handed = !((now.at - c.stamp[SAMPLE_AT]) * s->dt <= s->after);
    int apart = 0;
    if (handed > 0.0 && q->watchdog_law) {
        q->watchdog_law(d, z->P, z->u, z->D_hat, now.t, s->p, z->U, work);
        clip(d, s->input_bounds, z->U);
    } else if (handed > 0.0) {
        copy(d.m, s->holds ? c.sent : s->rescue, z->U);
    }
    c.stamp[MOVING] = handed != c.stamp[HANDED] ? 1.0 : c.stamp[MOVING];
    c.stamp[HANDED] = handed;
    for (int i = 0; i < d.m && c.stamp[MOVING] > 0.0; i++) {
        const double way = z->U[i] - c.sent[i];
        if (fabs(way) > s->jump[i]) {
            z->U[i] = c.sent[i] + sign_of(way) * s->jump[i];
            apart = 1;
        }
    }
    c.stamp[MOVING] = apart ? 1.0 : 0.0;
}

/* U, P and the next D_hat of a controller that is given u. */
static inline int compute_measured(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    const int count = s->observer_count;
    if (!all_finite(d.n, z->Y) || !all_finite(d.nx * d.m, z->u) || !all_finite(d.nx * d.m, z->u_nodes)) {
        return MEASUREMENT_NOT_FINITE;
    }
    if (q->observe && !isnan(z->observer[count - 1]) && !all_finite(count, z->observer)) {
        fill(count, NAN, z->observer); /* restart */
    }
    if (q->observe) {
        q->observe(d, k, s->dt, z->Y, z->held, t, s->p, s->law, z->observer, z->D_hat, work);
    }
    decide(d, q, s, z, k, 0.0, t, work);
    return OK;
}

/* U, P and the next D_hat from the stored commands and, if one came, from a sample. */
static inline int compute_recalled(Shape d, double t, int came, double age, const Parts *q, const Settings *s, State *z,
                                   double *work)
{
    const Moment now = {clock_of(d, z->clock).stamp[AT], t, s->dt};
    const INDEX k = step_of(now.at);
    const int bad = came && !q->correct && !all_finite(d.n, z->Y);
    int what;
    double D_hat;
    for (int i = 0; i < s->output_count && q->correct; i++) {
        z->sample[i] = isfinite(z->sample[i]) ? z->sample[i] : NAN;
    }
    what = sense(d, now, came && !bad, age, q, s, z, work);
    if (q->observe && !bad) { /* one that judges by outputs judges those of refused samples too */
        find_delay(d, now, s->judges_outputs ? what : what & USED, now.at - age, q, s, z, work);
    }
    if (!s->watched && (bad || !all_finite(d.n, z->X_hat))) {
        return bad ? MEASUREMENT_NOT_FINITE : STATE_UNKNOWN;
    }
    D_hat = z->D_hat[0];
    decide(d, q, s, z, k, larger(now.at - (double)k, 0.0), t, work);
    if (!all_finite(d.n, z->X_hat)) { /* a declared delay is a function of the state, which is unknown */
        z->D_hat[0] = D_hat;
    }
    if (s->watched) {
        hand_over(d, now, q, s, z, work);
    }
    return OK;
}

/* U, P and the next D_hat; returns a code if they cannot be used. */
static inline int compute(Shape d, INDEX k, double t, int came, double age, const Parts *q, const Settings *s, State *z,
                          double *work)
{
    const int code = s->reads_commands ? compute_recalled(d, t, came, age, q, s, z, work)
                                : compute_measured(d, k, t, q, s, z, work);
    if (code != OK) {
        return code;
    }
    if (all_finite(d.n, z->X_hat)) { /* else U is the watchdog's */
        adapt(d, s->gamma_dt, s->bounds, z->phi, z->phi_before, z->D_hat);
    }
    if (!all_finite(d.m, z->U) || !isfinite(z->D_hat[0]) || isinf(z->phi_before[0])) {
        return PREDICTION_NOT_FINITE;
    }
    for (int c = 0; c < d.m && s->reads_commands; c++) {
        if (z->D_seen[c] > longest(d, s)) {
            return DELAY_TOO_LONG;
        }
    }
    return OK;
}

/* Store U as the command from now on, or the last one if the call was refused with a `code`. Positions and sums are
 * shifted to stay small, because large ones round. */
SPARE static inline void remember(Shape d, double t, int code, const Parts *q, const Settings *s, State *z, double *work)
{
    const Clock c = clock_of(d, z->clock);
    const double D_hat = z->D_hat[0];
    INDEX shift;
    if (code != OK && q->model_delay && s->reads_commands) {
        q->model_delay(d, z->X_hat, t, s->p, s->ratios, z->D_hat, z->D_seen, work);
        z->D_hat[0] = D_hat;
    } else if (code != OK && !q->model_delay) {
        own_history(d, s->ratios, z->D_hat, z->D_seen);
    }
    copy(code != OK ? d.m : 0, c.sent, z->U);
    for (int i = 0; i < d.m; i++) { /* the history has no command for a longer delay */
        c.D[i] = 0.0 <= z->D_seen[i] && z->D_seen[i] <= longest(d, s) ? z->D_seen[i] : 0.0;
    }
    copy(d.m, z->U, c.sent);
    book(d, c.stamp[AT], c.stamp[AT] + 1.0, c.before, c.sent, z->held, z->total);
    shift = ((step_of(c.stamp[AT]) + 1) / d.rows - 1) * d.rows;
    if (shift == 0) {
        return;
    }
    for (int i = AT; i <= TICK; i++) {
        c.stamp[i] -= (double)shift;
    }
    for (int i = 0; i < s->output_count; i++) {
        c.refused[i] -= (double)shift;
    }
    for (int i = 0; i < d.m; i++) {
        const double first = z->total[i];
        for (int row = 0; row < d.rows; row++) {
            z->total[row * d.m + i] -= first;
        }
    }
}

/* A call at time t, `gap` after the last one, with a sample of that age if one `came`, all in control steps. If it gives
 * no U, then D_hat, phi and the observer of the delay are as before, and the last U is stored again. */
static inline int call(Shape d, double t, double gap, int came, double age, const Parts *q, const Settings *s, State *z,
                       double *work)
{
    const int keeps = s->reads_commands || q->observe;
    double D_hat, phi_before, *const observer_before = work, *const rest = work + s->observer_count;
    INDEX k = 0;
    int code;
    if (keeps) {
        arrive(d, gap, t, q, s, z, work);
        k = step_of(clock_of(d, z->clock).stamp[AT]);
    }
    D_hat = z->D_hat[0];
    phi_before = z->phi_before[0];
    copy(s->observer_count, z->observer, observer_before);
    code = compute(d, k, t, came, age, q, s, z, rest);
    if (code != OK) {
        z->D_hat[0] = D_hat;
        z->phi_before[0] = phi_before;
        copy(s->observer_count, observer_before, z->observer);
    }
    if (keeps) {
        remember(d, t, code, q, s, z, work);
    }
    return code;
}
