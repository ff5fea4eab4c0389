/* OBSERVE of a controller that estimates its state from outputs: X are a sample of the outputs (OUTPUTS), NaN where one is
 * missing, and how many control steps after the step k it was taken, -1/2 to 1/2.
 *
 * Each candidate of the delay has its own state x and offset d, which the commands, late by that delay, and the sample
 * move. They share the gain of one extended Kalman filter, that of the best candidate; `lead` is its memory. What is
 * compared are the differences of the sample and the outputs, in their standard deviations by that filter. One of more
 * than FAR counts as FAR. Where the filter is not finite, the next step starts all of that anew. In `memory` stand (x, d)
 * of all candidates, `lead`, then the Bank; in `law`, after the thetas, the filter's settings and its memory at the
 * start. */
#define FAR 6.0
#define WHOLE (N + M) /* numbers of a candidate */
#define SETTINGS (OUTPUTS + SIZE * SIZE)
#define LEAD (WHOLE + SIZE * SIZE + SIZE * OUTPUTS)

/* The gain of a sample, by the filter of the best candidate i, and the deviations of its outputs. */
static inline void PART(_lead)(Shape d, const double *v, double dt, const double *X, double t, const double *p,
                               const double *settings, const double *z, double *lead, double *spread, double *work)
{
    double whole[M], innovation[OUTPUTS];
    for (int c = 0; c < M; c++) {
        whole[c] = 1.0;
    }
    for (int c = 0; c < WHOLE; c++) {
        lead[c] = z[c];
    }
    FOLLOWED(d, v, v, whole, dt, t - dt, p, settings, lead, work);
    CORRECTED(d, X, t, p, INFINITY, settings, lead, innovation, spread, work);
}

static inline void KERNEL(Shape d, INDEX k, double dt, const double *X, const double *held, double t, const double *p,
                          const double *law, double *memory, double *D_hat, double *work)
{
    const Bank b = bank(d, law, memory);
    const double *settings = law + NUMBERS + b.K * (M + 1), *start = settings + SETTINGS;
    double *lead = memory + b.K * WHOLE, *gains_of = lead + WHOLE + SIZE * SIZE, *cost = work;
    double gain[4], spread[OUTPUTS], e[OUTPUTS], v[M], Y[OUTPUTS], largest, came = NAN;
    int best, finite = 1;
    if (isnan(b.gap[0])) {
        for (int c = 0; c < LEAD; c++) {
            lead[c] = c < WHOLE + SIZE * SIZE ? start[c] : 0.0;
        }
        for (int i = 0; i < b.K; i++) {
            for (int c = 0; c < WHOLE; c++) {
                memory[i * WHOLE + c] = start[c];
            }
        }
        for (int c = 0; c < OUTPUTS; c++) {
            Y[c] = 0.0;
        }
        begin(d, &b, 0, Y);
    }
    best = compare(d, &b, b.lasting, b.floor, cost, &largest);
    for (int c = 0; c < M; c++) {
        v[c] = held[modulo(k - 1 - (INDEX)law[NUMBERS + best * M + c], d.rows) * M + c];
    }
    PART(_lead)(d, v, dt, X, t, p, settings, memory + best * WHOLE, lead, spread, work + b.K);
    for (int c = 0; c < LEAD + OUTPUTS; c++) {
        finite = finite && isfinite(c < LEAD ? lead[c] : spread[c - LEAD]);
    }
    if (!finite) {
        b.gap[0] = NAN;
        return;
    }
    for (int c = 0; c < OUTPUTS; c++) {
        Y[c] = X[c] / spread[c];
        came = isnan(X[c]) ? came : 0.0;
    }
    gains(d, &b, 0, came, dt, law, gain);
    for (int i = 0; i < b.K; i++) {
        double *z = memory + i * WHOLE, out[N + OUTPUTS];
        finite = 1;
        for (int c = 0; c < M; c++) {
            v[c] = held[modulo(k - 1 - (INDEX)law[NUMBERS + i * M + c], d.rows) * M + c] + z[N + c];
        }
        STEP(z, v, t - dt, dt, X[OUTPUTS], p, out);
        for (int c = 0; c < N + OUTPUTS; c++) {
            finite = finite && isfinite(out[c]);
        }
        for (int c = 0; c < OUTPUTS; c++) {
            const int a = i * OUTPUTS + c;
            const double limit = FAR * spread[c];
            double scaled;
            e[c] = isnan(X[c]) ? 0.0 : finite ? smaller(larger(X[c] - out[N + c], -limit), limit) : limit;
            scaled = e[c] / spread[c];
            b.lasting[a] += scaled * scaled - b.pace[0] * gain[2] * b.lasting[a];
            b.recent[a] = gain[3] * b.recent[a] + scaled * scaled;
            b.x[a] = Y[c] - scaled;
        }
        for (int c = 0; c < WHOLE; c++) {
            z[c] = !finite ? lead[c] : c < N ? out[c] : z[c];
            for (int o = 0; o < OUTPUTS && finite && c < SIZE; o++) {
                z[c] += gains_of[c * OUTPUTS + o] * e[o];
            }
        }
    }
    gain[0] = 0.0;
    Y[0] = isnan(came) ? NAN : isnan(Y[0]) ? 0.0 : Y[0];
    choose(d, &b, 0, Y, gain, law, cost, D_hat);
}
#undef FAR
#undef WHOLE
#undef SETTINGS
#undef LEAD
