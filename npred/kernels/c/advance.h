/* ADVANCE: X a control step further, the input U0 for the first `share` of it and U1 for the rest; STEP holds it. */
static inline void PART(_held)(int lanes, int width, const double *X, const double *U, const double *t, const double *h,
                               const double *p, double *y)
{
    int first = 0;
#if CALLS && GROUP > 1
    for (; first + GROUP <= width; first += GROUP) {
        JOIN(STEP, _of)(GROUP, lanes, WIDE, X + first, U + first, t + first, h + first, p, y + first);
    }
#endif
    LANES for (int l = first; l < width; l++) {
        STEP(lanes, WIDE, X + l, U + l, t[l], h[l], p, y + l);
    }
}

static inline void PART(_block)(int lanes, int width, double *X, const double *U0, const double *U1,
                                const double *share, double dt, double t, const double *p)
{
    double y[N * WIDE], now[WIDE] = {0.0}, h[WIDE] = {0.0}; /* 0 for a compiler that knows no least width */
    int split = 0;
    for (int l = 0; l < width; l++) {
        now[l] = t;
        h[l] = share[l] * dt;
        split |= share[l] < 1.0;
    }
    PART(_held)(lanes, width, X, U0, now, h, p, y);
    for (int c = 0; c < N; c++) {
        for (int l = 0; l < width; l++) {
            X[c * lanes + l] = y[c * WIDE + l];
        }
    }
    if (!split) {
        return;
    }
    for (int l = 0; l < width; l++) {
        now[l] = t + share[l] * dt;
        h[l] = (1.0 - share[l]) * dt;
    }
    PART(_held)(lanes, width, X, U1, now, h, p, y);
    for (int c = 0; c < N; c++) {
        for (int l = 0; l < width; l++) {
            X[c * lanes + l] = share[l] < 1.0 ? y[c * WIDE + l] : X[c * lanes + l];
        }
    }
}

static inline void KERNEL(Shape d, double *X, const double *U0, const double *U1, const double *share, double dt, double t,
                   const double *p, double *work)
{
    (void)work;
    for (int l = 0; l < d.lanes; l += WIDE) {
        PART(_block)(d.lanes, least(WIDE, d.lanes - l), X + l, U0 + l, U1 + l, share + l, dt, t, p);
    }
}
