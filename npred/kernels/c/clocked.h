/* One loop of a controller on its own clock: the plant goes on by itself, with the commands that reached the actuator at
 * the times at which they did. Positions are times since the loop's start, in control steps. */

/* Where input c stands in the commands at a position of control step k: that less the delay, which is linear over the
 * step where it is a function of time; and how fast it goes on. */
static inline double leaves(Shape d, INDEX k, int c, double at, const Settings *s, const State *z, double *speed)
{
    double D = z->D[c];
    *speed = 1.0;
    if (s->tabulates) {
        const double rise = (s->delays[(k + 1) * d.m + c] - s->delays[k * d.m + c]) / s->dt;
        D = s->delays[k * d.m + c] + rise * (at - (double)k) * s->dt;
        *speed = 1.0 - rise;
    }
    return at - D / s->dt;
}

/* The newest command that had reached the actuator at a position, from the number of another one on. */
static inline int64_t newest(const Events *e, int64_t i, double position)
{
    i = i < e->sent_count[0] ? i : e->sent_count[0] - 1;
    while (i + 1 < e->sent_count[0] && e->sent_at[i + 1] <= position + ROUNDING) {
        i++;
    }
    while (i > 0 && e->sent_at[i] > position + ROUNDING) {
        i--;
    }
    return i;
}

/* U, what acts on the plant at a position, until a command comes or the control step ends: gives when. */
static inline double acts(Shape d, double at, double to, const Settings *s, const State *z, Events *e, double *U)
{
    const INDEX k = step_of(at);
    double end = smaller((double)(k + 1), to);
    for (int c = 0; c < d.m; c++) {
        double speed;
        const double position = leaves(d, k, c, at, s, z, &speed);
        const int64_t i = newest(e, e->acting[c], position);
        e->acting[c] = i;
        U[c] = e->sent[i * d.m + c] + (s->disturbed ? s->disturbance[k * d.m + c] : 0.0);
        if (i + 1 < e->sent_count[0] && speed > 0.0) {
            const double next = at + (e->sent_at[i + 1] - position) / speed;
            end = smaller(end, larger(next, at + ROUNDING));
        }
    }
    return (double)(k + 1) - end < ROUNDING ? (double)(k + 1) : end;
}

/* Write the plant's state at control step k. */
static inline void show(Shape d, INDEX k, const Settings *s, const State *z, Record *out)
{
    if (k % s->every == 0 && k / s->every < s->row_count) {
        copy(d.n, z->X, out->X + k / s->every * d.n);
    }
    if (out->escaped[0] < 0 && !all_finite(d.n, z->X)) {
        out->escaped[0] = k;
    }
}

/* Bring the plant to a position. */
static inline void go(Shape d, double to, const Parts *q, const Settings *s, State *z, Events *e, Record *out, double *work)
{
    double *U = work, *whole = U + d.m, *rest = whole + d.m;
    fill(d.m, 1.0, whole);
    for (double at = e->at_plant[0], end; at < to; at = e->at_plant[0] = end) {
        end = acts(d, at, to, s, z, e, U);
        q->advance(d, z->X, U, U, whole, (end - at) * s->dt, at * s->dt, s->truth_p, rest);
        if (end == (double)step_of(end)) {
            show(d, step_of(end), s, z, out);
        }
    }
}

/* Take the samples up to a position, of the outputs or of the state. */
static inline void take(Shape d, double to, const Parts *q, const Settings *s, State *z, Events *e, Record *out,
                        double *work)
{
    const int width = s->output_count;
    for (int64_t j; (j = e->taken_count[0]) < e->sample_count && e->taken[j] <= to + ROUNDING; e->taken_count[0]++) {
        double *Y = work, *rest = work + width;
        go(d, e->taken[j], q, s, z, e, out, work);
        copy(q->output ? 0 : width, z->X, Y);
        if (q->output) {
            q->output(d, z->X, e->taken[j] * s->dt, s->truth_p, Y, rest);
        }
        read_sensors(width, 1, s, s->first, e->number[j], Y, e->values + j * width);
    }
}

/* The call of control step k, and its command on the way to the actuator. */
static inline void do_call(Shape d, INDEX k, const Parts *q, const Settings *s, State *z, Events *e, Record *out,
                           double *work)
{
    const int64_t row = e->sample[k], last = e->sent_count[0] - 1;
    int code;
    take(d, e->at[k], q, s, z, e, out, work);
    go(d, e->at[k], q, s, z, e, out, work);
    if (row >= 0) {
        copy(s->output_count, e->values + row * s->output_count, q->correct ? z->sample : z->Y);
    }
    if (e->unsaid[0] && e->tells) {
        replace(d, z, e->sent + last * d.m);
    }
    code = call(d, e->at[k] * s->dt, e->gap[k], row >= 0, e->age[k], q, s, z, work);
    e->refusals[0] += code != OK;
    e->unsaid[0] = code == OK && e->lost[k];
    if (code == OK && !e->lost[k]) {
        while (e->sent_at[e->sent_count[0] - 1] >= e->reaches[k]) { /* still under way: this one overtakes it */
            e->sent_count[0]--;
        }
        e->sent_at[e->sent_count[0]] = e->reaches[k];
        copy(d.m, z->U, e->sent + e->sent_count[0]++ * d.m);
    }
}

/* Write what the controller says after control step k. */
static inline void note(Shape d, INDEX k, const Settings *s, const State *z, Events *e, Record *out)
{
    const Clock c = clock_of(d, z->clock);
    const INDEX row = k / s->every;
    double D_hat = 0.0;
    for (int i = 0; i < d.m; i++) {
        D_hat = larger(D_hat, z->D_seen[i]); /* the one that it read the commands by: the next one is in z->D_hat */
    }
    for (int64_t i; (i = z->drawn[0]) < s->sample_count && s->samples[i] == k; z->drawn[0]++) {
        copy(d.n, z->X, out->sample_X + i * d.n);
        copy(d.nx * d.m, z->u, out->sample_u + i * d.nx * d.m);
        out->sample_D_hat[i] = D_hat;
    }
    if (!e->skipped[k]) {
        mark_step(k, 1, 0, s, z, out);
    }
    if (k % s->every == 0) {
        copy(d.n, z->P + (d.nx - 1) * d.n, out->P + row * d.n);
        copy(d.m, z->U, out->U + row * d.m);
        copy(d.n, z->X_hat, e->X_hat + row * d.n);
        out->D_hat[row] = D_hat;
        out->N[row] = z->N[0];
        e->age_then[row] = isnan(c.stamp[SAMPLE_AT]) ? INFINITY : (c.stamp[AT] - c.stamp[SAMPLE_AT]) * s->dt;
        e->handed_over[row] = c.stamp[HANDED] > 0.0;
    }
}

/* The control steps start … stop - 1 of a loop of `count`, and the plant up to the call of step `stop`, or to the last of
 * all steps. A part in Python that fails ends it by `failed`. */
void run_clocked(Shape d, INDEX start, INDEX stop, INDEX count, const Parts *q, const Settings *s, State *z, Record *out, Events *e,
                 const volatile int *failed, double *work)
{
    if (start == 0) {
        show(d, 0, s, z, out);
    }
    for (INDEX k = start; k < stop && !*failed; k++) {
        if (!e->skipped[k]) {
            do_call(d, k, q, s, z, e, out, work);
        }
        note(d, k, s, z, e, out);
    }
    const double end = stop < count ? smaller(e->at[stop], (double)stop) : (double)(stop - 1);
    if (stop < count) {
        take(d, end, q, s, z, e, out, work);
    }
    go(d, end, q, s, z, e, out, work);
}
