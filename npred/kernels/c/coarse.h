/* PREDICT by SWEEP on COUNT cells, whatever nx is; between their ends P is interpolated linearly. */
static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    const int last = d.nx - 1;
    const ptrdiff_t row = (ptrdiff_t)M * d.lanes, states = (ptrdiff_t)N * d.lanes;
    double *mass = work, *turn = mass + (d.nx + 1) * row, *v = turn + (d.nx + 1) * row, *Q = v + 2 * COUNT * row;
    Shape coarse = d;
    coarse.nx = COUNT + 1;
    integrals(d, M, u, mass, turn, NULL, NULL);
    lines_on_cells(d, M, COUNT, u, mass, turn, NULL, v, NULL);
    SWEEP(coarse, X, v, D_hat, t, p, Q, Q + (COUNT + 1) * states);
    for (int j = 0; j < d.nx; j++) {
        const double place = (double)j * (double)COUNT / (double)last;
        const int cell = least((int)place, COUNT - 1);
        const double share = place - (double)cell, *begin = Q + cell * states, *end = begin + states;
        for (ptrdiff_t k = 0; k < states; k++) {
            P[j * states + k] = begin[k] + share * (end[k] - begin[k]);
        }
    }
}
