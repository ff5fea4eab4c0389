/* UPDATE, the L1 law: w = u - kappa(P) and q3 = kappa_P f(P(0), u(0)) at the nodes (NODE writes both); their derivatives
 * by central differences, one-sided at the ends. */
static inline void KERNEL(Shape d, const double *P, const double *X, const double *u, const double *D_hat, double t,
                   const double *p, double b, double *phi, double *N_, double *work)
{
    const int last = d.nx - 1, lanes = d.lanes;
    const double dx = 1.0 / (double)last;
    double *wq = work; /* (nx, 2 M): w, then q */
    (void)X, (void)b;
    for (int l = 0; l < lanes; l++) {
        double total = 0.0;
        for (int j = 0; j <= last; j++) {
            const double *x = P + (ptrdiff_t)j * N * lanes + l, *now = u + (ptrdiff_t)j * M * lanes + l;
            NODE(lanes, 1, x, now, P + l, u + l, t + (double)j * (D_hat[l] / (double)last), t, p, wq + 2 * M * j);
        }
        for (int c = 0; c < M; c++) {
            double w_x = 0.0;
            for (int j = 0; j <= last; j++) {
                const int a = most(j - 1, 0), z = least(j + 1, last);
                const double *at = wq + 2 * M * j + c, *before = wq + 2 * M * a + c, *after = wq + 2 * M * z + c;
                const double q_x = (after[M] - before[M]) / ((double)(z - a) * dx);
                const double weight = (1.0 + (double)j * dx) * dx * (j == 0 || j == last ? 0.5 : 1.0);
                w_x = (after[0] - before[0]) / ((double)(z - a) * dx);
                total += weight * (at[M] * at[0] / (fabs(at[0]) + EPSILON) + q_x * w_x / (fabs(w_x) + EPSILON));
            }
            total += 2.0 * w_x / (fabs(w_x) + EPSILON) * wq[2 * M * last + M + c];
        }
        phi[l] = total;
        N_[l] = NAN;
    }
}
