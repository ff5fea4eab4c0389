/* What a controller in Python calls. */

int stepped(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    return control_step(d, k, t, q, s, z, work);
}

INDEX remembered(Shape d, INDEX k, double t, int code, const Parts *q, const Settings *s, State *z, double *work)
{
    return remember(d, k, t, code, q, s, z, work);
}
