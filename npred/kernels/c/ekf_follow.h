/* A piece of FOLLOW, of an extended Kalman filter. Its memory: x (N), d (M), then U (SIZE, SIZE), unit upper triangular,
 * with D as its diagonal: the covariance of z, the
 * first SIZE of (x, d), is P = U D U'. With Phi the
 * derivative of the step by z,
 *     x <- the step,   P <- Phi (P + Q h / 2) Phi' + Q h / 2,
 * of order 2 in h. The new factors come from W = [Phi U, Phi U_Q, U_Q] by the modified weighted Gram-Schmidt method
 * [Thornton; Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. VI], so that P stays symmetric
 * and positive. */
/* The columns of Phi U, and their weights scale D, of factors U D. */
static inline void PART(_columns)(const double *Phi, const double *factors, double scale, double *W, double *weights)
{
    for (int c = 0; c < SIZE; c++) {
        weights[c] = scale * factors[c * SIZE + c];
        for (int i = 0; i < SIZE; i++) {
            double sum = Phi[i * SIZE + c];
            for (int k = 0; k < c; k++) {
                sum += Phi[i * SIZE + k] * factors[k * SIZE + c];
            }
            W[i * WIDTH + c] = sum;
        }
    }
}

/* U D with U D U' = W diag(weights) W'. W is overwritten. */
static inline void PART(_factors)(double *W, const double *weights, double *factors)
{
    for (int j = SIZE - 1; j >= 0; j--) {
        const double *last = W + j * WIDTH;
        double length = 0.0;
        for (int c = 0; c < WIDTH; c++) {
            length += last[c] * weights[c] * last[c];
        }
        factors[j * SIZE + j] = length;
        for (int i = 0; i < j; i++) {
            double *row = W + i * WIDTH, product = 0.0;
            for (int c = 0; c < WIDTH; c++) {
                product += row[c] * weights[c] * last[c];
            }
            product = length > 0.0 ? product / length : 0.0;
            for (int c = 0; c < WIDTH; c++) {
                row[c] -= product * last[c];
            }
            factors[i * SIZE + j] = product;
        }
    }
}

/* Go on by h with the input U; `law` ends with the factors of Q. */
static inline void PART(_piece)(const double *U, double t, double h, const double *p, const double *law, double *memory)
{
    const double *noise = law + OUTPUTS;
    double *x = memory, *d = memory + N, *factors = d + M;
    double Phi[SIZE * SIZE], one[SIZE * SIZE], W[SIZE * WIDTH], weights[WIDTH], u[M], y[N];
    for (int c = 0; c < M; c++) {
        u[c] = U[c] + d[c];
    }
    for (int k = 0; k < SIZE; k++) {
        double along[N + M] = {0.0}, change[N];
        along[k] = 1.0;
        STEP(x, u, along, along + N, t, h, p, y, change);
        for (int i = 0; i < SIZE; i++) {
            one[i * SIZE + k] = i == k ? 1.0 : 0.0;
            Phi[i * SIZE + k] = i < N ? change[i] : one[i * SIZE + k];
        }
    }
    PART(_columns)(Phi, factors, 1.0, W, weights);
    PART(_columns)(Phi, noise, 0.5 * h, W + SIZE, weights + SIZE);
    PART(_columns)(one, noise, 0.5 * h, W + 2 * SIZE, weights + 2 * SIZE);
    PART(_factors)(W, weights, factors);
    for (int c = 0; c < N; c++) {
        x[c] = y[c];
    }
}
