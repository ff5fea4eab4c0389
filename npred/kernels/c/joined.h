/* JOINED: states of segments that go on from one to the next, as affine functions of theta, of COLUMNS columns.
 *
 * Segment s has the normal equations A dx = B of its own samples; F and `step` bring dx to the next begin, `Q` is the
 * variance of what happens there, and `follows` is 0 where the segment begins anew. By Kalman's filter forwards and by
 * the adjoint backwards: Z is dx by all samples before, K its variance by those of the segment too, `all` is dx by all
 * samples, and `size` the logarithm of the determinant of a segment's variance over that of its noise. */
static inline double PART(_solve)(double *restrict M, double *restrict K)
{
    double size = 0.0;
    for (int i = 0; i < N; i++) {
        int top = i;
        for (int r = i + 1; r < N; r++) {
            top = fabs(M[r * N + i]) > fabs(M[top * N + i]) ? r : top;
        }
        for (int c = 0; c < N; c++) {
            double m = M[i * N + c], k = K[i * N + c];
            M[i * N + c] = M[top * N + c], K[i * N + c] = K[top * N + c];
            M[top * N + c] = m, K[top * N + c] = k;
        }
        size += log(fabs(M[i * N + i]));
        for (int r = 0; r < N; r++) {
            const double share = r == i ? 0.0 : M[r * N + i] / M[i * N + i];
            for (int c = 0; c < N; c++) {
                M[r * N + c] -= share * M[i * N + c], K[r * N + c] -= share * K[i * N + c];
            }
        }
    }
    for (int r = 0; r < N; r++) {
        for (int c = 0; c < N; c++) {
            K[r * N + c] /= M[r * N + r];
        }
    }
    return size;
}

static inline void PART(_add)(int rows, int inner, int columns, int turned, const double *restrict a,
                              const double *restrict b, double sign, double *restrict y)
{
    for (int r = 0; r < rows; r++) { /* y + sign a b, or a' b */
        for (int i = 0; i < inner; i++) {
            for (int c = 0; c < columns; c++) {
                y[r * columns + c] += sign * (turned ? a[i * rows + r] : a[r * inner + i]) * b[i * columns + c];
            }
        }
    }
}

static inline void KERNEL(Shape d, INDEX k, const double *follows, const double *A, const double *B, const double *F,
                          const double *step, const double *Q, double *Z, double *K, double *all, double *size,
                          double *work)
{
    enum { NN = N * N, NC = N * COLUMNS };
    double P[NN], M[NN], R[NC], Y[NC], L[NC];
    (void)d, (void)work;
    for (INDEX s = 0; s < k; s++) {
        const double *a = A + s * NN, *f = F + (s - 1) * NN;
        double *z = Z + s * NC, *v = K + s * NN;
        for (int i = 0; i < NN; i++) {
            const double unit = i % (N + 1) == 0;
            P[i] = follows[s] != 0.0 ? unit * Q[i / N] : unit;
            M[i] = follows[s] != 0.0 ? unit : 0.0;
            v[i] = 0.0;
        }
        for (int i = 0; i < NC; i++) {
            z[i] = follows[s] != 0.0 ? step[(s - 1) * NC + i] : 0.0;
        }
        if (follows[s] != 0.0) {
            PART(_add)(N, N, COLUMNS, 0, f, Y, 1.0, z);
            PART(_add)(N, N, N, 0, f, v - NN, 1.0, v); /* F K, then F K F' + Q */
            for (int i = 0; i < NN; i++) {
                for (int j = 0; j < N; j++) {
                    P[i] += v[i / N * N + j] * f[i % N * N + j];
                }
            }
            PART(_add)(N, N, N, 0, P, a, 1.0, M);
        } else {
            for (int i = 0; i < NN; i++) {
                M[i] = a[i];
            }
        }
        for (int i = 0; i < NN; i++) {
            v[i] = P[i];
        }
        size[s] = PART(_solve)(M, v); /* K = (1 + P A)^-1 P, or A^-1 */
        for (int i = 0; i < NC; i++) {
            R[i] = B[s * NC + i], Y[i] = z[i];
        }
        PART(_add)(N, N, COLUMNS, 0, a, z, -1.0, R);
        PART(_add)(N, N, COLUMNS, 0, v, R, 1.0, Y);
    }
    for (INDEX s = k - 1; s >= 0; s--) {
        const double *a = A + s * NN, *v = K + s * NN;
        for (int i = 0; i < NC; i++) {
            R[i] = B[s * NC + i], Y[i] = Z[s * NC + i];
        }
        PART(_add)(N, N, COLUMNS, 0, a, Y, -1.0, R);
        if (s + 1 < k && follows[s + 1] != 0.0) {
            PART(_add)(N, N, COLUMNS, 1, F + s * NN, L, 1.0, R);
        }
        PART(_add)(N, N, COLUMNS, 0, v, R, 1.0, Y);
        for (int i = 0; i < NC; i++) {
            all[s * NC + i] = Y[i], L[i] = R[i], R[i] = 0.0;
        }
        PART(_add)(N, N, COLUMNS, 0, v, L, 1.0, R); /* L = (1 - A K) L */
        PART(_add)(N, N, COLUMNS, 0, a, R, -1.0, L);
    }
}
