/* PREDICT by a one-step method: P(0) = X, then STEP from node to node. With CELLS the rows of u are the begin and the
 * end of each cell, between which it is a straight line. A method that reads u in the MIDDLE of a cell gets the line of
 * reading.h; one that does not gets the nodes, whose trapezoidal sum has the mean of u too. */
#define READS (MIDDLE && !CELLS)
static inline void PART(_inputs)(int j, int last, int lanes, int width, const double *u, double *q,
                                 double *begin, double *half, double *end)
{
    const double *a = u + (ptrdiff_t)2 * j * M * lanes, *b = a + M * lanes;
    if (READS) {
        line(M, j, last, lanes, width, WIDE, u, q, begin, half, end);
    }
    for (int c = 0; MIDDLE && CELLS && c < M; c++) {
        for (int l = 0; l < width; l++) {
            half[c * WIDE + l] = 0.5 * (a[c * lanes + l] + b[c * lanes + l]);
        }
    }
}

/* One lane: its state stays in registers. */
static inline void PART(_one)(int nx, const double *X, const double *u, double D_hat, double t, const double *p, double *P)
{
    const int last = nx - 1;
    const double h = D_hat / (double)last;
    double x[N], y[N], q[M * WIDE], begin[M * WIDE], half[M * WIDE], end[M * WIDE];
    for (int c = 0; c < N; c++) {
        x[c] = P[c] = X[c];
    }
    for (int j = 0; j < last; j++) {
        const double *a = u + (ptrdiff_t)(CELLS ? 2 * j : j) * M;
        PART(_inputs)(j, last, 1, 1, u, q, begin, half, end);
        STEP(1, WIDE, x, READS ? begin : a, half, READS ? end : a + M, t + (double)j * h, h, p, y);
        for (int c = 0; c < N; c++) {
            x[c] = P[(j + 1) * N + c] = y[c];
        }
    }
}

static inline void PART(_block)(int nx, int lanes, int width, const double *restrict X, const double *restrict u,
                                const double *restrict D_hat, double t, const double *restrict p, double *restrict P)
{
    const int last = nx - 1;
    double q[M * WIDE], begin[M * WIDE], half[M * WIDE], end[M * WIDE];
    for (int c = 0; c < N; c++) {
        for (int l = 0; l < width; l++) {
            P[c * lanes + l] = X[c * lanes + l];
        }
    }
    for (int j = 0; j < last; j++) {
        const double *x = P + (ptrdiff_t)j * N * lanes, *a = u + (ptrdiff_t)(CELLS ? 2 * j : j) * M * lanes;
        double *y = P + (ptrdiff_t)(j + 1) * N * lanes;
        PART(_inputs)(j, last, lanes, width, u, q, begin, half, end);
        int first = 0;
#if CALLS && GROUP > 1
        for (; first + GROUP <= width; first += GROUP) {
            double h[GROUP], now[GROUP];
            for (int l = 0; l < GROUP; l++) {
                h[l] = D_hat[first + l] / (double)last;
                now[l] = t + (double)j * h[l];
            }
            JOIN(STEP, _of)(GROUP, lanes, WIDE, x + first, (READS ? begin : a) + first, half + first,
                            (READS ? end : a + M * lanes) + first, now, h, p, y + first);
        }
#endif
        LANES for (int l = first; l < width; l++) {
            const double h = D_hat[l] / (double)last;
            STEP(lanes, WIDE, x + l, (READS ? begin : a) + l, half + l, (READS ? end : a + M * lanes) + l,
                 t + (double)j * h, h, p, y + l);
        }
    }
}

static inline void KERNEL(Shape d, const double *X, const double *u, const double *D_hat, double t, const double *p, double *P,
                   double *work)
{
    (void)work;
    if (d.lanes == 1) {
        PART(_one)(d.nx, X, u, D_hat[0], t, p, P);
        return;
    }
    for (int l = 0; l < d.lanes; l += WIDE) {
        PART(_block)(d.nx, d.lanes, least(WIDE, d.lanes - l), X + l, u + l, D_hat + l, t, p, P + l);
    }
}
#undef READS
