/* What a controller computes in a control step [DAPF, eqs. 9-14], in a simulated loop and on a real plant. */

/* The controller reads its own commands by its estimate of the delay. */
static inline void own_history(Shape d, const double *ratios, const double *D_hat, double *D_seen)
{
    for (int c = 0; c < d.m; c++) {
        for (int l = 0; l < d.lanes; l++) {
            D_seen[c * d.lanes + l] = ratios[c] * D_hat[l];
        }
    }
}

/* U to its bounds; NaN stays NaN. */
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

/* Add `sign` times the offset (m) that an observer of the state finds at the inputs to `rows` of them. */
static inline void offset(Shape d, int rows, double sign, const double *found, double *U)
{
    for (int j = 0; j < rows; j++) {
        for (int c = 0; c < d.m; c++) {
            U[j * d.m + c] += sign * found[c];
        }
    }
}

/* The state when U acts if the delay is D_hat + `moved`, by the predictor `exact`, as number e of the ends. */
static inline void predict_end(Shape d, int e, double moved, INDEX k, double part, double t, const Parts *q,
                               const Settings *s, State *z, double *work)
{
    const int lanes = d.lanes;
    const ptrdiff_t states = (ptrdiff_t)d.n * lanes;
    double *D_hat = z->moments + e * lanes; /* scratch, until the moment is written to it */
    const double *u = z->u, *P = z->P;
    for (int l = 0; l < lanes; l++) {
        D_hat[l] = larger(z->D_hat[l] + moved, 0.0);
    }
    if (moved != 0.0) {
        own_history(d, s->ratios, D_hat, z->D_moved);
        transport(d, k, part, s->dt, z->D_moved, z->held, z->total, z->u_moved, NULL);
        if (s->offsets) {
            offset(d, d.nx, 1.0, z->filter + d.n, z->u_moved);
        }
        u = z->u_moved;
    }
    if (q->exact) {
        q->exact(d, z->X_hat, u, D_hat, t, s->p, z->P_moved, work);
        P = z->P_moved;
    }
    for (ptrdiff_t a = 0; a < states; a++) {
        z->ends[e * states + a] = P[(d.nx - 1) * states + a];
    }
    for (int l = 0; l < lanes; l++) {
        D_hat[l] += t;
    }
}

/* U as near to what it is as keeps the limits, within its bounds; with an offset at the inputs U is what the plant gets. */
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
    for (int e = 0; e < s->end_count; e++) {
        const double moved = e == 0 ? 0.0 : e == 1 ? -s->uncertain : s->uncertain;
        predict_end(d, e, moved, k, part, t, q, s, z, work);
    }
    q->protect(d, z->ends, z->moments, s->p, s->safety, z->low, z->high, z->U, z->kept, z->filtered, z->unkept,
               work);
}

/* U and phi at `part` of control step k and time t from X_hat, and from u where it is measured, else from the commands
 * before. An offset of the inputs acts on the plant too, so that the law gets the prediction with it, and U is less. */
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
