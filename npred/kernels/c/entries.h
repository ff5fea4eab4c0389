/* What a controller in Python calls. */

/* A call by the addresses of shape, parts, settings, state and scratch memory, then of where P and U go if it gives them,
 * whether a part in Python has failed, and the numbers t, gap, came and age. */
int called(void *const *a)
{
    const Shape d = *(const Shape *)a[0];
    const State *z = a[3];
    const double *number = a[8];
    const int code = call(d, number[0], number[1], number[2] > 0.0, number[3], a[1], a[2], a[3], a[4]);
    if (code == OK && !*(const int *)a[7]) {
        copy(d.nx * d.n, z->P, a[5]);
        copy(d.m, z->U, a[6]);
    }
    return code;
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
