/* ADVANCE: X a control step further, the input U0 for the first `share` of it and U1 for the rest; STEP holds it. */
static inline void PART(_block)(int lanes, int width, double *X, const double *U0, const double *U1,
                                const double *share, double dt, double t, const double *p)
{
    double y[N * WIDE];
    int split = 0;
    LANES for (int l = 0; l < width; l++) {
        STEP(lanes, WIDE, X + l, U0 + l, t, share[l] * dt, p, y + l);
    }
    for (int c = 0; c < N; c++) {
        for (int l = 0; l < width; l++) {
            X[c * lanes + l] = y[c * WIDE + l];
        }
    }
    for (int l = 0; l < width; l++) {
        split |= share[l] < 1.0;
    }
    if (!split) {
        return;
    }
    LANES for (int l = 0; l < width; l++) {
        STEP(lanes, WIDE, X + l, U1 + l, t + share[l] * dt, (1.0 - share[l]) * dt, p, y + l);
    }
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
