/* What Python calls of the engine. */
void step(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    control_step(d, k, t, q, s, z, work);
}

INDEX remembered(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    return remember(d, k, t, q, s, z, work);
}

void held(Shape d, INDEX k, double t, const Parts *q, const Settings *s, State *z, double *work)
{
    hold(d, k, t, q, s, z, work);
}
