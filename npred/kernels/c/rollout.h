/* ROLLOUT: from X through pieces of time, in each of which the input is held; P has the state at the end of each piece.
 * Each lane has pieces of its own: `spans` are their lengths, 0 where a lane has fewer, `moments` their begins. A piece
 * is k steps. */
static inline void PART(_block)(int rows, int lanes, int width, int steps, const double *restrict X,
                                const double *restrict held, const double *restrict spans,
                                const double *restrict moments, const double *restrict p, double *restrict P)
{
    double x[N * WIDE], y[N * WIDE];
    for (int c = 0; c < N; c++) {
        for (int l = 0; l < width; l++) {
            x[c * WIDE + l] = X[c * lanes + l];
        }
    }
    for (int j = 0; j < rows; j++) {
        const double *u = held + (ptrdiff_t)j * M * lanes, *span = spans + (ptrdiff_t)j * lanes;
        const double *begin = moments + (ptrdiff_t)j * lanes;
        double *end = P + (ptrdiff_t)j * N * lanes;
        for (int s = 0; s < steps; s++) {
            LANES for (int l = 0; l < width; l++) {
                const double h = span[l] / (double)steps;
                STEP(WIDE, lanes, x + l, u + l, begin[l] + (double)s * h, h, p, y + l);
            }
            for (int c = 0; c < N; c++) {
                for (int l = 0; l < width; l++) {
                    x[c * WIDE + l] = y[c * WIDE + l];
                }
            }
        }
        for (int c = 0; c < N; c++) {
            for (int l = 0; l < width; l++) {
                end[c * lanes + l] = x[c * WIDE + l];
            }
        }
    }
}

static inline void KERNEL(Shape d, INDEX k, const double *X, const double *held, const double *spans,
                          const double *moments, const double *p, double *P, double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l += WIDE) {
        PART(_block)(d.nx, d.lanes, least(WIDE, d.lanes - l), (int)k, X + l, held + l, spans + l, moments + l, p, P + l);
    }
}
