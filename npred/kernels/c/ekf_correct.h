/* CORRECT_BY, of an extended Kalman filter; its memory is that of ekf_follow.h. One output after the other, none of which
 * needs an inverse, by Bierman's update of the factors [Factorization Methods, 1977, ch. V]. All are linearised at the
 * state before the sample, so that the result is that of the formula with matrices. `law` begins with R. With GAINS the
 * memory ends with what each innovation moved, (SIZE, OUTPUTS). */
/* The variance of output i, h z, with h its derivative by z: R_i + h P h'; f = U' h' and v = D f, on the way. */
static inline double PART(_variance)(const double *h, double R, const double *factors, double *f, double *v)
{
    double variance = R;
    for (int j = 0; j < SIZE; j++) {
        f[j] = h[j];
        for (int i = 0; i < j; i++) {
            f[j] += factors[i * SIZE + j] * h[i];
        }
        v[j] = factors[j * SIZE + j] * f[j];
        variance += f[j] * v[j];
    }
    return variance;
}

/* P less what the output tells, and the gain K. */
static inline void PART(_learn)(const double *h, double R, double *factors, double *K)
{
    double f[SIZE], v[SIZE], variance = R;
    PART(_variance)(h, R, factors, f, v);
    for (int j = 0; j < SIZE; j++) {
        const double before = variance, along = -f[j] / before;
        variance += f[j] * v[j];
        factors[j * SIZE + j] *= before / variance;
        K[j] = v[j];
        for (int i = 0; i < j; i++) {
            const double u = factors[i * SIZE + j];
            factors[i * SIZE + j] = u + along * K[i];
            K[i] += v[j] * u;
        }
    }
    for (int j = 0; j < SIZE; j++) {
        K[j] /= variance;
    }
}

static inline void KERNEL(Shape d, const double *Y, double t, const double *p, double gate, const double *law,
                          double *memory, double *innovation, double *spread, double *work)
{
    double *z = memory, *factors = memory + N + M, y[OUTPUTS], by_x[OUTPUTS * N], h[OUTPUTS * SIZE] = {0.0};
    double moved[SIZE] = {0.0}, f[SIZE], v[SIZE], K[SIZE];
#if GAINS
    double *gains = factors + SIZE * SIZE;
    for (int c = 0; c < SIZE * OUTPUTS; c++) {
        gains[c] = 0.0;
    }
#endif
    (void)d, (void)work;
    OUTPUT(z, t, p, y, by_x);
    for (int i = 0; i < OUTPUTS; i++) {
        for (int c = 0; c < N; c++) {
            h[i * SIZE + c] = by_x[i * N + c];
        }
        innovation[i] = Y[i] - y[i];
        spread[i] = sqrt(PART(_variance)(h + i * SIZE, law[i], factors, f, v));
    }
    for (int i = 0; i < OUTPUTS; i++) {
        double rest = innovation[i];
        if (!(fabs(rest) <= gate * spread[i])) { /* missing, too, as NaN */
            continue;
        }
        PART(_learn)(h + i * SIZE, law[i], factors, K);
        for (int c = 0; c < SIZE; c++) {
            rest -= h[i * SIZE + c] * moved[c];
        }
        for (int c = 0; c < SIZE; c++) {
            moved[c] += K[c] * rest;
        }
#if GAINS
        for (int j = 0; j <= i; j++) {
            double left = i == j ? 1.0 : 0.0;
            for (int c = 0; c < SIZE; c++) {
                left -= h[i * SIZE + c] * gains[c * OUTPUTS + j];
            }
            for (int c = 0; c < SIZE; c++) {
                gains[c * OUTPUTS + j] += K[c] * left;
            }
        }
#endif
    }
    for (int c = 0; c < SIZE; c++) {
        z[c] += moved[c];
    }
    STOP(z, p, z);
}
