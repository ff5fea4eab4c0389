/* Loops of the plant and its controller, side by side, in control steps; npred/kernels/c/clocked.h is one on a clock. */

/* D at control step k, and the speed of phi(t) = t - D during it, of delays that are a function of time. */
static inline void tabulated(Shape d, INDEX k, double dt, const double *delays, double *D, double *speed)
{
    const ptrdiff_t row = (ptrdiff_t)d.m * d.lanes;
    for (ptrdiff_t a = 0; a < row; a++) {
        D[a] = delays[k * row + a];
        speed[a] = 1.0 - (delays[(k + 1) * row + a] - delays[k * row + a]) / dt;
    }
}

/* Add a disturbance (m, width) to what leaves the actuator: of each lane, or, where width is 1, the same for all. */
static inline void disturb(Shape d, int width, const double *push, double *U0, double *U1)
{
    for (int c = 0; c < d.m; c++) {
        for (int l = 0; l < d.lanes; l++) {
            const double added = push[c * width + (width > 1 ? l : 0)];
            U0[c * d.lanes + l] += added;
            U1[c * d.lanes + l] += added;
        }
    }
}

/* Copy lane l of `count` rows. */
static inline void copy_lane(int count, int lanes, int l, const double *from, double *to)
{
    for (int a = 0; a < count; a++) {
        to[(ptrdiff_t)a * lanes + l] = from[(ptrdiff_t)a * lanes + l];
    }
}

/* Mark the loops in which 1 - D_X f - D_t <= 0, in the plant or along the prediction; they are NaN from there on. So
 * are those whose delay is negative, or in one step came to be longer than the history of commands, `longest`. A
 * prediction that ends there has its last finite node as state, with the input there; what it was made from is the last
 * of the samples, and says when that node comes. */
static inline void mark_infeasible(Shape d, INDEX k, double t, double longest, int predicts, const Settings *s,
                                   State *z, Record *out)
{
    const int lanes = d.lanes, last = d.nx - 1;
    const ptrdiff_t states = (ptrdiff_t)d.n * lanes, inputs = (ptrdiff_t)d.m * lanes;
    for (int l = 0; l < lanes; l++) {
        const int lost = predicts && isnan(z->P[last * states + l]) && !isnan(z->X_hat[l]);
        const int runs = z->speed[l] > 0.0 && 0.0 <= z->D[l] && z->D[l] <= longest;
        const double *X = z->X, *U = z->U0;
        if (out->infeasible[l] >= 0 || !isfinite(z->X[l]) || !(lost || !runs)) {
            continue;
        }
        out->infeasible[l] = k;
        if (lost) {
            int j = 0;
            while (j < last - 1 && !isnan(z->P[(j + 1) * states + l])) {
                j++;
            }
            X = z->P + j * states;
            U = z->u + j * inputs;
            copy_lane(d.n, lanes, l, z->X_hat, out->sample_X + s->sample_count * states);
            copy_lane(d.nx * d.m, lanes, l, z->u, out->sample_u + s->sample_count * d.nx * inputs);
            out->sample_D_hat[s->sample_count * lanes + l] = z->D_hat[l];
        }
        copy_lane(d.n, lanes, l, X, out->breach);
        copy_lane(d.m, lanes, l, U, out->breach + states);
        out->breach[states + inputs + l] = t;
        for (int c = 0; c < d.n; c++) {
            z->X[c * lanes + l] = NAN;
        }
        for (int c = 0; c < d.m; c++) {
            z->speed[c * lanes + l] = 0.0;
        }
    }
}

/* Sum over inputs of ∫ (U_c - U_c*)² ds from t - D_c to t, by the trapezoidal rule on u; where the controller reads u by
 * another delay than the true one, over the commands that are held. */
static inline void energy(Shape d, INDEX k, double dt, const double *u_star, const State *z, double *out)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const ptrdiff_t inputs = (ptrdiff_t)d.m * lanes;
    for (int l = 0; l < lanes; l++) {
        out[l] = 0.0;
        for (int j = 0; j < d.nx; j++) {
            for (int c = 0; c < d.m; c++) {
                const double D = z->D[c * lanes + l], D_seen = z->D_seen[c * lanes + l];
                if (!(D >= 0.0 && D != D_seen)) {
                    const double gap = z->u[j * inputs + c * lanes + l] - u_star[c];
                    out[l] += D_seen / last * (j == 0 || j == last ? 0.5 : 1.0) * (gap * gap);
                }
            }
        }
        for (int c = 0; c < d.m; c++) {
            const double D = z->D[c * lanes + l];
            if (D >= 0.0 && D != z->D_seen[c * lanes + l]) {
                double left = smaller(D / dt, d.rows - 1);
                for (INDEX i = k - 1; left > 0.0; i--, left -= 1.0) {
                    const double gap = z->held[modulo(i, d.rows) * inputs + c * lanes + l] - u_star[c];
                    out[l] += smaller(left, 1.0) * dt * (gap * gap);
                }
            }
        }
    }
}

/* Write step k to the record: every `every`-th state, the samples asked for, the first step that is not finite. */
static inline void keep(Shape d, INDEX k, INDEX origin, const Settings *s, State *z, Record *out)
{
    const int lanes = d.lanes;
    const ptrdiff_t states = (ptrdiff_t)d.n * lanes, inputs = (ptrdiff_t)d.m * lanes;
    for (int l = 0; l < lanes; l++) {
        for (INDEX i; (i = z->drawn[l]) < s->sample_count && s->samples[i * lanes + l] == k; z->drawn[l]++) {
            copy_lane(d.n, lanes, l, z->X, out->sample_X + i * states);
            copy_lane(d.nx * d.m, lanes, l, z->u, out->sample_u + i * d.nx * inputs);
            out->sample_D_hat[i * lanes + l] = z->D_hat[l];
        }
        if (isfinite(z->X[l])) {
            mark_step(k, lanes, l, s, z, out);
        }
        for (int c = 0; c < d.n; c++) {
            if (out->escaped[l] < 0 && !isfinite(z->X[c * lanes + l])) {
                out->escaped[l] = k;
            }
        }
    }
    if (k % s->every == 0) {
        const INDEX row = k / s->every;
        for (ptrdiff_t a = 0; a < states; a++) {
            out->X[row * states + a] = z->X[a];
            out->P[row * states + a] = z->P[(d.nx - 1) * states + a];
        }
        for (ptrdiff_t a = 0; a < inputs; a++) {
            out->U[row * inputs + a] = z->U[a];
        }
        for (int l = 0; l < lanes; l++) {
            out->D_hat[row * lanes + l] = z->D_hat[l];
            out->N[row * lanes + l] = z->N[l];
        }
        energy(d, origin + k, s->dt, s->u_star, z, out->energy + row * lanes);
    }
}

/* X_hat at control step k from samples of it: Y, or what the model expects where there is none, or where Y is too far
 * from that; then Y is none too. The expected state follows from the last one by the commands, as the controller
 * believes. */
static APART void believe(Shape d, INDEX k, INDEX origin, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    const double *Y = s->senses ? z->Y : z->X;
    const int lanes = d.lanes;
    const double at = (double)(origin + k - 1);
    double *U0 = work, *U1 = U0 + d.m, *share = U1 + d.m;
    for (int l = 0; l < lanes && k > 0; l++) {
        reached(d, l, at, at + 1.0, s->dt, z->D_seen, z->held, NULL, U0, U1, share);
        for (int c = 0; c < d.m; c++) {
            z->U0[c * lanes + l] = U0[c];
            z->U1[c * lanes + l] = U1[c];
            z->share[c * lanes + l] = share[c];
        }
    }
    if (k > 0) {
        q->model(d, z->X_hat, z->U0, z->U1, z->share, s->dt, t - s->dt, s->p, work);
    }
    for (int l = 0; l < lanes; l++) {
        const Gate g = {z->first_refused + l, z->believed_since + l, z->stray + l};
        int anew = 0;
        const int used = !isnan(Y[l]) && judge(d, l, (double)k, k > 0 ? z->D_hat[l] : 0.0, s, Y, z->X_hat, g, &anew) == USED;
        for (int c = 0; c < d.n; c++) {
            const int i = c * lanes + l;
            z->X_hat[i] = used ? Y[i] : z->X_hat[i];
            z->Y[i] = used ? Y[i] : NAN;
        }
        for (int i = 0; i < s->observer_count && anew; i++) {
            z->observer[(ptrdiff_t)i * lanes + l] = NAN;
        }
    }
}

/* Let the observer of the delay start again in the lanes where it began, and has come to numbers that are not finite. */
static APART void restart_lost(Shape d, const Settings *s, double *observer, double *work)
{
    const ptrdiff_t lanes = d.lanes, last = (s->observer_count - 1) * lanes;
    double *nought = work; /* NaN in a lane with a number that is not finite */
    for (int l = 0; l < lanes; l++) {
        nought[l] = 0.0;
    }
    for (int i = 0; i < s->observer_count; i++) {
        for (int l = 0; l < lanes; l++) {
            nought[l] += 0.0 * observer[i * lanes + l];
        }
    }
    for (int l = 0; l < lanes; l++) {
        for (int i = 0; i < s->observer_count && isnan(nought[l]) && !isnan(observer[last + l]); i++) {
            observer[i * lanes + l] = NAN;
        }
    }
}

/* Control steps start … stop - 1 [DAPF, eqs. 6-14]; `origin` is the ring buffers' number of step 0. The plant advances by
 * `advance`, what the controller believes of it by `model`. A part in Python that fails ends the loop by `failed`. */
void run(Shape d, INDEX origin, INDEX start, INDEX stop, const Parts *q, const Settings *s, State *z, Record *out,
         const volatile int *failed, double *work)
{
    for (INDEX k = start; k < stop && !*failed; k++) {
        const double t = (double)k * s->dt;
        const INDEX late = k - s->late, taken = late > 0 ? late : 0;
        if (s->tabulates) {
            tabulated(d, k, s->dt, s->delays, z->D, z->speed);
        }
        if (q->horizon) {
            q->horizon(d, z->X, t, s->truth_p, s->ratios, z->longest, z->D, work);
        }
        if (s->senses) {
            sample(d, k, s, z->X, z->past, z->due, z->sampled, z->Y);
            if (q->observer) {
                q->observer(d, k, origin, s->dt, z->D_seen, z->held, z->Y, z->X_hat, work);
            } else if (!s->gated) {
                estimate(d, k, origin, s->dt, s->age, z->D_seen, z->held, z->Y, z->X_hat, q->model, s->p, work);
            }
        }
        if (s->gated) {
            believe(d, k, origin, t, q, s, z, work);
        }
        if (q->observe && (k == 0 || taken > 0)) { /* the first sample arrives at once */
            restart_lost(d, s, z->observer, work);
            q->observe(d, origin + taken, s->dt, z->Y, z->held, (double)taken * s->dt, s->p, s->law, z->observer, z->D_hat, work);
        }
        decide(d, q, s, z, origin + k, 0.0, t, work);
        if (*failed) {
            return;
        }
        keep(d, k, origin, s, z, out);
        adapt(d, s->gamma_dt, s->bounds, z->phi, z->phi_before, z->D_hat);
        actuate(d, origin + k, s->dt, z->D, z->U, z->held, z->total, z->U0, z->U1, z->share);
        if (s->moves) {
            q->delay_speed(d, z->X, z->U0, t, s->truth_p, z->speed, work);
            mark_infeasible(d, k, t, (double)(origin + k) * s->dt, q->predict && q->model_delay, s, z, out);
        }
        if (s->moves || s->tabulates) {
            retime(d, origin + k, s->dt, z->D, z->speed, z->held, z->U1, z->share);
        }
        if (s->disturbed) {
            disturb(d, s->disturbed, s->disturbance + k * d.m * s->disturbed, z->U0, z->U1);
        }
        q->advance(d, z->X, z->U0, z->U1, z->share, s->dt, t, s->truth_p, work);
    }
}
