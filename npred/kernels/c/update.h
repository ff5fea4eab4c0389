/* UPDATE, the paper's law: phi = -∫ (1+x) q1 w dx / N, N = 1 + V + b ∫ (1+x) w² dx by the trapezoidal rule. FIRST and
 * NODE write r = f(P(0), u(0)) and its transition to the next node, and the products q1 w and w². */
static inline void PART(_block)(int nx, int lanes, int width, const double *restrict P, const double *restrict X,
                                const double *restrict u, const double *restrict D_hat, double t,
                                const double *restrict p, double b, double *restrict phi, double *restrict N_)
{
    const int last = nx - 1;
    double r[N * WIDE], s[N * WIDE], products[2 * WIDE], I1[WIDE], I2[WIDE], v[WIDE];
    LANES for (int l = 0; l < width; l++) {
        FIRST(lanes, WIDE, P + l, u + l, t + 0.0 * (D_hat[l] / (double)last), D_hat[l] / (double)last, p, r + l, s + l, products + l);
        I1[l] = 0.5 * products[l];
        I2[l] = 0.5 * products[WIDE + l];
    }
    for (int j = 1; j < nx; j++) {
        const double weight = (1.0 + (double)j / (double)last) * (j == last ? 0.5 : 1.0);
        const double *x = P + (ptrdiff_t)j * N * lanes, *now = u + (ptrdiff_t)j * M * lanes;
        LANES for (int l = 0; l < width; l++) {
            const double h = D_hat[l] / (double)last;
            NODE(lanes, WIDE, x + l, now + l, r + l, s + l, t + (double)j * h, h, p, r + l, s + l, products + l);
            I1[l] += weight * products[l];
            I2[l] += weight * products[WIDE + l];
        }
    }
    for (int l = 0; l < width; l++) {
        VALUE(lanes, WIDE, X + l, t, p, v + l);
        N_[l] = 1.0 + v[l] + b * I2[l] / (double)last;
        phi[l] = -I1[l] / (double)last / N_[l];
    }
}

static inline void KERNEL(Shape d, const double *P, const double *X, const double *u, const double *D_hat, double t,
                   const double *p, double b, double *phi, double *N_, double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l += WIDE) {
        const int width = least(WIDE, d.lanes - l);
        PART(_block)(d.nx, d.lanes, width, P + l, X + l, u + l, D_hat + l, t, p, b, phi + l, N_ + l);
    }
}
