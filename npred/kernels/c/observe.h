/* OBSERVE: an observer of the state for each candidate of the delay, driven by the commands, late by that delay. STEP
 * writes y, Heun's step of x with the input held, the error e = X - y where there is a sample, and how d has to move. Of a
 * plant that is called, `work` begins with all that: (K, MOVED, lanes). */
static inline void PART(_candidate)(Shape d, const Bank *b, int i, INDEX k, const double *X, const double *held,
                                    double t, double dt, const double *p, const double *law, double *work)
{
    const int lanes = d.lanes;
    const ptrdiff_t states = (ptrdiff_t)N * lanes, inputs = (ptrdiff_t)M * lanes;
    double *x = b->x + i * states, *push = b->push + i * inputs;
    double *lasting = b->lasting + i * states, *recent = b->recent + i * states;
    const double *gain = work + (ptrdiff_t)b->K * MOVED * lanes;
    for (int from = 0; from < lanes; from += WIDE) {
        const int width = least(WIDE, lanes - from);
#if MOVED
        const int apart = lanes;
        const double *out = work + (ptrdiff_t)i * MOVED * lanes + from;
#else
        enum { apart = WIDE };
        double v[M * WIDE], out[(2 * N + M) * WIDE];
        for (int c = 0; c < M; c++) {
            const INDEX late = k - 1 - (INDEX)law[NUMBERS + i * M + c];
            const double *command = held + modulo(late, d.rows) * inputs + c * lanes + from;
            for (int l = 0; l < width; l++) {
                v[c * WIDE + l] = command[l] + push[c * lanes + from + l];
            }
        }
        LANES for (int l = 0; l < width; l++) {
            const int at = from + l;
            STEP(lanes, WIDE, x + at, v + l, X + at, b->floor + at, gain[at], t, dt, p, out + l);
        }
#endif
        for (int c = 0; c < N; c++) {
            for (int l = 0; l < width; l++) {
                const ptrdiff_t a = (ptrdiff_t)c * lanes + from + l;
                const double e = out[(N + c) * apart + l];
                lasting[a] += b->pace[from + l] * (e * e - gain[2 * lanes + from + l] * lasting[a]);
                recent[a] = gain[3 * lanes + from + l] * recent[a] + e * e;
                x[a] = out[c * apart + l] + gain[from + l] * e;
            }
        }
        for (int c = 0; c < M; c++) {
            for (int l = 0; l < width; l++) {
                push[c * lanes + from + l] += gain[lanes + from + l] * out[(2 * N + c) * apart + l];
            }
        }
    }
}

static inline void KERNEL(Shape d, INDEX k, double dt, const double *X, const double *held, double t, const double *p,
                   const double *law, double *memory, double *D_hat, double *work)
{
    const Bank b = bank(d, law, memory);
    double *gain = work + (ptrdiff_t)b.K * MOVED * d.lanes, *cost = gain + 4 * d.lanes;
    for (int l = 0; l < d.lanes; l++) {
        gains(d, &b, l, X[l], dt, law, gain);
    }
    for (int i = 0; i < b.K; i++) {
        PART(_candidate)(d, &b, i, k, X, held, t - dt, dt, p, law, work);
    }
    for (int l = 0; l < d.lanes; l++) {
        choose(d, &b, l, X, gain, law, cost, D_hat);
    }
}
