/* What a controller in Python calls. */

/* Why a step gives no U to send. */
enum { OK, MEASUREMENT_NOT_FINITE, PREDICTION_NOT_FINITE, DELAY_TOO_LONG };

static inline int finite(int count, const double *a)
{
    int all = 1;
    for (int i = 0; i < count; i++) {
        all = all && isfinite(a[i]);
    }
    return all;
}

/* A control step, unless what is measured is not finite. Of a step that gives no U, D_hat and phi stand as before; the
 * commands are kept for `longest` seconds. */
INDEX step(Shape d, INDEX k, double t, double longest, const Parts *q, const Settings *s, State *z, double *work)
{
    const double D_hat = z->D_hat[0], phi_before = z->phi_before[0];
    const int measured = s->recalls ? 0 : d.nx * d.m;
    if (!finite(d.n, z->Y) || !finite(measured, z->u) || !finite(measured, z->u_nodes)) {
        return MEASUREMENT_NOT_FINITE;
    }
    control_step(d, k, t, q, s, z, work);
    int code = finite(d.m, z->U) && isfinite(z->D_hat[0]) ? OK : PREDICTION_NOT_FINITE;
    for (int c = 0; c < d.m && s->recalls; c++) {
        code = code == OK && z->D_seen[c] > longest ? DELAY_TOO_LONG : code;
    }
    if (code != OK) {
        z->D_hat[0] = D_hat;
        z->phi_before[0] = phi_before;
    }
    return code;
}

INDEX remembered(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    return remember(d, k, t, q, s, z, work);
}

void held(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    hold(d, k, t, q, s, z, work);
}
