/* A controller on a real plant: a control step on its memory, with one lane. */

/* Why a step gives no U to send; an export numbers them the same. */
enum { OK, MEASUREMENT_NOT_FINITE, PREDICTION_NOT_FINITE, DELAY_TOO_LONG = 4 };

static inline int all_finite(int count, const double *a)
{
    int all = 1;
    for (int i = 0; i < count; i++) {
        all = all && isfinite(a[i]);
    }
    return all;
}

/* The longest delay by which a step can read the commands. */
static inline double longest(Shape d, double dt)
{
    return (double)(d.rows - 3) * dt;
}

/* The sample Y is what the controller believes, X_hat, unless it is further from what the model expects than the gate:
 * then that is, and Y is NaN, no sample. After such samples for D_hat the state has jumped. */
static inline void screen(Shape d, const Settings *s, State *z)
{
    int far = 0;
    for (int c = 0; c < d.n; c++) {
        const double reach = larger(s->reach[c], s->gate * fabs(z->expected[c]));
        far = far || fabs(z->Y[c] - z->expected[c]) > reach;
    }
    far = far && z->missed[0] * s->dt < z->D_hat[0];
    z->missed[0] = far ? z->missed[0] + 1.0 : 0.0;
    for (int c = 0; c < d.n; c++) {
        z->expected[c] = z->X_hat[c] = far ? z->expected[c] : z->Y[c];
        z->Y[c] = far ? NAN : z->Y[c];
    }
}

/* U, P and the next D_hat from the sample Y, and from u or the commands before step k, and what is wrong with them. */
static inline int compute(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    const int measured = s->recalls ? 0 : d.nx * d.m;
    if (!all_finite(d.n, z->Y) || !all_finite(measured, z->u) || !all_finite(measured, z->u_nodes)) {
        return MEASUREMENT_NOT_FINITE;
    }
    if (s->gated) {
        screen(d, s, z);
    }
    if (q->observe) { /* which learns from samples only, and else goes on by the commands */
        q->observe(d, k, s->dt, z->Y, z->held, t, s->p, s->law, z->observer, z->D_hat, work);
    }
    decide(d, q, s, z, k, t, work);
    adapt(d, s->gamma_dt, s->bounds, z->phi, z->phi_before, z->D_hat);
    if (!all_finite(d.m, z->U) || !isfinite(z->D_hat[0])) {
        return PREDICTION_NOT_FINITE;
    }
    for (int c = 0; c < d.m && s->recalls; c++) {
        if (z->D_seen[c] > longest(d, s->dt)) {
            return DELAY_TOO_LONG;
        }
    }
    return OK;
}

/* The same, with D_hat, phi and the observer as before where that gives no U to send. */
static inline int control_step(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    const double D_hat = z->D_hat[0], phi_before = z->phi_before[0];
    double *const observer_before = work;
    for (int i = 0; i < s->observer_count; i++) {
        observer_before[i] = z->observer[i];
    }
    const int code = compute(d, k, t, q, s, z, work + s->observer_count);
    if (code != OK) {
        z->D_hat[0] = D_hat;
        z->phi_before[0] = phi_before;
        for (int i = 0; i < s->observer_count; i++) {
            z->observer[i] = observer_before[i];
        }
    }
    return code;
}

/* The U of a step that was refused: the last one, which the actuator holds. */
static inline void hold(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    if (q->believe && s->gated) {
        q->believe(d, z->expected, t, s->p, s->ratios, z->D_hat, z->D_seen, work);
    }
    for (int c = 0; c < d.m; c++) {
        z->U[c] = z->held[modulo(k - 1, d.rows) * d.m + c];
        if (!q->believe) {
            z->D_seen[c] = s->ratios[c] * z->D_hat[0];
        }
    }
}

/* Keep U as the command of step k, or the last one where the step was refused for a `code`; the next step's number. It
 * and the sums stay small, for large ones round. */
SPARE static inline INDEX remember(Shape d, INDEX k, double t, int code, const Parts *q, const Settings *s, State *z,
                                   double *work)
{
    if (code != OK) {
        hold(d, k, t, q, s, z, work);
    }
    for (int c = 0; c < d.m; c++) {
        if (!(0.0 <= z->D_seen[c] && z->D_seen[c] <= longest(d, s->dt))) { /* no command that is kept acts so late */
            z->D_seen[c] = 0.0;
        }
    }
    actuate(d, k, s->dt, z->D_seen, z->U, z->held, z->total, z->U0, z->U1, z->share);
    if (s->gated) {
        q->model(d, z->expected, z->U0, z->U1, z->share, s->dt, t, s->p, work);
    }
    if (k + 1 < 2 * (INDEX)d.rows) {
        return k + 1;
    }
    for (int c = 0; c < d.m; c++) {
        const double first = z->total[c];
        for (int row = 0; row < d.rows; row++) {
            z->total[row * d.m + c] -= first;
        }
    }
    return d.rows;
}
