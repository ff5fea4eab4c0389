/* One control step of the controller [DAPF, eqs. 9-14], in a simulated loop and on a real plant. */

/* The controller reads its own commands by its estimate of the delay. */
static inline void own_history(Shape d, const double *ratios, const double *D_hat, double *D_seen)
{
    for (int c = 0; c < d.m; c++) {
        for (int l = 0; l < d.lanes; l++) {
            D_seen[c * d.lanes + l] = ratios[c] * D_hat[l];
        }
    }
}

/* Clip U to its bounds; NaN stays NaN. */
static inline void clip(Shape d, const double *bounds, double *U)
{
    for (int c = 0; c < d.m; c++) {
        for (int l = 0; l < d.lanes; l++) {
            double *const value = U + c * d.lanes + l;
            *value = *value < bounds[2 * c] ? bounds[2 * c] : *value > bounds[2 * c + 1] ? bounds[2 * c + 1] : *value;
        }
    }
}

/* D_hat += gamma dt Proj{D_hat, phi}: clipping to the bounds is the projection [DAPF, eq. 11] in discrete time. phi is
 * taken at the middle of the step, from this value and the one before: the method of Adams and Bashforth of order 2
 * (Hairer, Nørsett, Wanner, III.1.5). A first step, which has none before, is Euler's. */
static inline void adapt(Shape d, double gamma_dt, const double *bounds, const double *phi, double *phi_before, double *D_hat)
{
    if (!(gamma_dt > 0.0)) {
        return;
    }
    for (int l = 0; l < d.lanes; l++) {
        const double rate = isnan(phi_before[l]) ? phi[l] : 1.5 * phi[l] - 0.5 * phi_before[l];
        D_hat[l] = smaller(larger(D_hat[l] + gamma_dt * rate, bounds[0]), bounds[1]);
        phi_before[l] = phi[l];
    }
}

/* Add `sign` times the offset (m), which an observer of the state estimates, to `rows` rows of inputs. */
static inline void offset(Shape d, int rows, double sign, const double *found, double *U)
{
    for (int j = 0; j < rows; j++) {
        for (int c = 0; c < d.m; c++) {
            U[j * d.m + c] += sign * found[c];
        }
    }
}

/* End e of lane l: the state when U acts, if the delay is D_hat + `moved`, by the model and the commands themselves. They
 * are integrated over whole control steps, then halves, quarters, …, until the difference is within `error` (n).
 * Returns whether that is reached. */
#define FINEST 16.0 /* parts of a control step */
static inline int predict_end(Shape d, int e, int l, double moved, double at, double t, const Parts *q, const Settings *s,
                              State *z, double *work)
{
    const int lanes = d.lanes;
    const Moment now = {at, t, s->dt};
    double *x = work, *coarse = x + d.n, *rest = coarse + d.n, D = 0.0, excess = INFINITY;
    for (int c = 0; c < d.m; c++) {
        D = larger(z->D_seen[c * lanes + l] + moved, 0.0);
        z->D_moved[c * lanes + l] = D;
    }
    for (double parts = 1.0; parts <= FINEST && excess > 1.0; parts *= 2.0) {
        for (int c = 0; c < d.n; c++) {
            coarse[c] = x[c];
            x[c] = z->X_hat[c * lanes + l];
        }
        onward(d, l, at, at + D / s->dt, 1.0 / parts, now, z->D_moved, z->held, s->offsets ? z->filter + d.n : NULL,
               q->model, s->p, x, rest);
        excess = parts > 1.0 ? 0.0 : INFINITY;
        for (int c = 0; c < d.n && parts > 1.0; c++) { /* the error of a method of order 4 */
            excess = larger(excess, fabs(x[c] - coarse[c]) / (15.0 * s->safety[c]));
        }
    }
    for (int c = 0; c < d.n; c++) {
        z->ends[((ptrdiff_t)e * d.n + c) * lanes + l] = x[c];
    }
    z->moments[e * lanes + l] = t + D;
    return excess <= 1.0;
}

/* Change U if the loop would break a limit. With an offset at the inputs, U includes it here. */
static inline void protect(Shape d, INDEX k, double part, double t, const Parts *q, const Settings *s, State *z,
                           double *work)
{
    for (int c = 0; c < d.m; c++) {
        const double added = s->offsets ? z->filter[d.n + c] : 0.0;
        for (int l = 0; l < d.lanes; l++) {
            z->low[c * d.lanes + l] = s->input_bounds[2 * c] + added;
            z->high[c * d.lanes + l] = s->input_bounds[2 * c + 1] + added;
        }
    }
    for (int l = 0; l < d.lanes; l++) {
        z->unkept[l] = 0.0;
        for (int e = 0; e < s->end_count; e++) {
            const double moved = e == 0 ? 0.0 : e == 1 ? -s->uncertain : s->uncertain;
            const int is_exact = predict_end(d, e, l, moved, (double)k + part, t, q, s, z, work);
            z->unkept[l] = is_exact ? z->unkept[l] : 1.0;
        }
    }
    q->protect(d, z->ends, z->moments, s->p, s->safety, z->low, z->high, z->U, z->plan, z->kept, z->filtered, z->unkept,
               z->promised, z->withdrawn, work);
}

/* U and phi at `part` of control step k and time t, from X_hat and from u, which is measured or read from the stored
 * commands. An offset acts on the plant: the prediction includes it, and U is reduced by it. */
static inline void decide(Shape d, const Parts *q, const Settings *s, State *z, INDEX k, double part, double t, double *work)
{
    if (q->model_delay) {
        q->model_delay(d, z->X_hat, t, s->p, s->ratios, z->D_hat, z->D_seen, work);
    } else if (s->reads_commands) {
        own_history(d, s->ratios, z->D_hat, z->D_seen);
    }
    if (s->stores_commands) {
        transport(d, k, part, s->dt, z->D_seen, z->held, z->total, z->u, q->update ? z->u_nodes : NULL);
    }
    if (s->offsets) {
        offset(d, d.nx, 1.0, z->filter + d.n, z->u);
        offset(d, q->update ? d.nx : 0, 1.0, z->filter + d.n, z->u_nodes);
    }
    if (q->predict) {
        q->predict(d, z->X_hat, z->u, z->D_hat, t, s->p, z->P, work);
    }
    if (q->guard) {
        q->guard(d, z->X_hat, z->u, z->D_hat, t, s->p, s->guard, z->P, z->error, z->fallback, work);
    }
    if (q->control) {
        q->control(d, z->P, z->u, z->D_hat, t, s->p, z->U, work);
    }
    if (q->protect) {
        protect(d, k, part, t, q, s, z, work);
    }
    if (s->offsets) {
        offset(d, 1, -1.0, z->filter + d.n, z->U);
    }
    clip(d, s->input_bounds, z->U);
    if (q->update) {
        q->update(d, z->P, z->X_hat, z->u_nodes, z->D_hat, t, s->p, s->b, z->phi, z->N, work);
    }
}
