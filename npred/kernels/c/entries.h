/* What a controller in Python calls. */

int called(Shape d, double t, double gap, int came, double age, const Parts *q, const Settings *s, State *z, double *work)
{
    return call(d, t, gap, came, age, q, s, z, work);
}

void replaced(Shape d, State *z, const double *U)
{
    replace(d, z, U);
}

void spreads(Shape d, const double *law, double *memory, const double *D_hat, double *out)
{
    for (int l = 0; l < d.lanes; l++) {
        out[l] = undecided(d, law, memory, D_hat, l);
    }
}
