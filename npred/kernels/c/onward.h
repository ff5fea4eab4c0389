/* The model of the plant, driven by the commands in the history. */

/* A position in the history, in control steps, the time there, and the length of a step. */
typedef struct {
    double at, t, dt;
} Moment;

static inline double time_at(Moment of, double at)
{
    return of.t + (at - of.at) * of.dt;
}

/* The input of lane l from position `at` to the end of its control step, or to `to` where that is earlier: U0 for the
 * first `share` of the time, then U1, with `push` (m) added, where there is one. Returns the end. */
SPARE static inline double reached(Shape d, int l, double at, double to, double dt, const double *D, const double *held,
                                   const double *push, double *U0, double *U1, double *share)
{
    const INDEX now = (INDEX)(at + ROUNDING);
    const double end = smaller((double)(now + 1), to), width = end - at;
    for (int c = 0; c < d.m; c++) {
        const INDEX i = leaving(at, dt, D[c * d.lanes + l], share + c), next = i + 1 < now ? i + 1 : now;
        const double added = push ? push[c] : 0.0;
        share[c] = smaller(share[c] / width, 1.0);
        U0[c] = held[((ptrdiff_t)modulo(i, d.rows) * d.m + c) * d.lanes + l] + added;
        U1[c] = held[((ptrdiff_t)modulo(next, d.rows) * d.m + c) * d.lanes + l] + added;
    }
    return end;
}

/* x, a state of lane l, from one position to another, by the model and the commands that reach the plant meanwhile, in
 * steps of up to `longest` control steps. */
SPARE static inline void onward(Shape d, int l, double from, double to, double longest, Moment of, const double *D, const double *held,
                                const double *push, Advance model, const double *p, double *x, double *work)
{
    double *U0 = work, *U1 = U0 + d.m, *share = U1 + d.m, *rest = share + d.m;
    Shape one = d;
    one.lanes = 1;
    for (double at = from, end; at < to; at = end) {
        end = reached(d, l, at, smaller(at + longest, to), of.dt, D, held, push, U0, U1, share);
        model(one, x, U0, U1, share, (end - at) * of.dt, time_at(of, at), p, rest);
    }
}
