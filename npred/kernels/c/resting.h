/* Whether a rollout has come to a place where it stays for good.
 *
 * F(x) is the state one control step later, under kappa + w, clipped, plus v of the last block, clipped. Around a
 * state x is the ball |y - x|_S <= r, |d|_S² = dᵀ S d, with S - Aᵀ S A = 1 for the slopes A of F in units of the
 * box (Smith's doubling, SIAM J. Appl. Math. 16 (1968) 198). There |A d|_S² = |d|_S² - |d|² <= (1 - 1 / trace S)
 * |d|_S². If F(y) - A y changes by at most q |y - x|_S, q = 1 / (4 trace S), F contracts by 1 - q at least; with r
 * >= |F(x) - x|_S / q it maps the ball into itself, and has a rest there, which all its states go to (Banach). The
 * limits hold for good if they hold on the ball. U is to be clipped on all of it or nowhere. What F, kappa and h do
 * on the ball is measured at the ends of its axes, of which the root of the sum of squares is the largest change of
 * a linear function, times SURE.
 *
 * Where the plant, kappa or a limit depends on time, TIMES moments up to LATER are looked at; kappa does not once its
 * time has ended. A loop that never comes to rest even so is not STILL. */
#define DOUBLINGS 24 /* of the number of control steps that S sums over: none more would be a rest */
#define SURE 1.5
#define NEARBY PRECISE(1e-4, 1e-2)   /* of the box: for slopes */
#define TINIEST PRECISE(1e-6, 1e-2) /* radius of a ball */
#define WIDEST 0.5                  /* the same; where the loop moves with time, more is no rest */

/* F, kappa + w and h at the points of the ball, at time t; the time of kappa ends at `until`. */
static INLINED void PART(_onward)(const int count, double t, double until, const double *p, const double *s,
                                  const double *low, const double *high, Ball *b)
{
    LANES for (int l = 0; l < count; l++) {
        LAW(count, b->x + l, smaller(t, until), p, b->law + l);
        LIMITS(count, b->x + l, t, p, b->h + l);
    }
    for (int a = 0; a < M * count; a++) {
        const int c = a / count;
        b->law[a] += b->w[c];
        b->U[a] = within(within(b->law[a], low[c], high[c]) + b->v[c], low[c], high[c]);
    }
    LANES for (int l = 0; l < count; l++) {
        STEP(count, b->x + l, b->U + l, t, s[STEP_LENGTH], p, b->y + l, b->unused + l);
    }
}

/* C (+)= Aᵀ B, or A B. */
static inline void PART(_product)(const double *A, int turned, const double *B, double *C)
{
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++) {
            double sum = 0.0;
            for (int k = 0; k < N; k++) {
                sum += (turned ? A[k * N + i] : A[i * N + k]) * B[k * N + j];
            }
            C[i * N + j] = sum;
        }
    }
}

/* S of A; false where F does not contract. */
static inline int PART(_contracts)(Ball *b)
{
    double *const S = b->S, *const T = b->T, *const power = b->power, largest = INFINITY;
    for (int a = 0; a < N * N; a++) {
        S[a] = a % (N + 1) ? 0.0 : 1.0;
        power[a] = b->A[a];
    }
    for (int round = 0; round < DOUBLINGS && largest > PRECISE(1e-8, 1e-4); round++) {
        PART(_product)(S, 0, power, T);
        PART(_product)(power, 1, T, b->change);
        PART(_product)(power, 0, power, T);
        largest = 0.0;
        for (int a = 0; a < N * N; a++) {
            S[a] += b->change[a];
            power[a] = T[a];
            largest = larger(largest, fabs(T[a]));
        }
        if (!(largest < 1e6)) {
            return 0;
        }
    }
    return largest <= PRECISE(1e-8, 1e-4);
}

/* |d|_S of the difference of two columns of y, in units of the box, minus A times the way between them. */
static inline double PART(_distance)(const Ball *b, const double *s, const double *d)
{
    double sum = 0.0;
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < N; j++) {
            sum += d[i] / BOX(s, i) * b->S[i * N + j] * d[j] / BOX(s, j);
        }
    }
    return sqrt(larger(sum, 0.0));
}

/* How much a row of numbers at the points differs from its value at the first one. */
static inline double PART(_spread)(const double *row)
{
    double sum = 0.0;
    for (int i = 0; i < N; i++) {
        const double change = larger(fabs(row[1 + i] - row[0]), fabs(row[1 + N + i] - row[0]));
        sum += change * change;
    }
    return SURE * sqrt(sum);
}

/* Put the points at x and at x ± `step` (N, N) times the box, by columns. */
static inline void PART(_surround)(Ball *b, const double *s, const double *x, const double *step, double length)
{
    for (int c = 0; c < N; c++) {
        double *const row = b->x + c * POINTS;
        row[0] = x[c];
        for (int i = 0; i < N; i++) {
            row[1 + i] = x[c] + length * step[c * N + i] * BOX(s, c);
            row[1 + N + i] = x[c] - length * step[c * N + i] * BOX(s, c);
        }
    }
}

/* The axes of the ball: columns z with Lᵀ z = 1, S = L Lᵀ; T is overwritten by them. */
static inline void PART(_axes)(Ball *b)
{
    double *const L = b->power, *const z = b->T;
    for (int i = 0; i < N; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = b->S[i * N + j];
            for (int k = 0; k < j; k++) {
                sum -= L[i * N + k] * L[j * N + k];
            }
            L[i * N + j] = i == j ? sqrt(larger(sum, 1e-30)) : sum / L[j * N + j];
        }
    }
    for (int j = 0; j < N; j++) {
        for (int i = N - 1; i >= 0; i--) {
            double sum = i == j ? 1.0 : 0.0;
            for (int k = i + 1; k < N; k++) {
                sum -= L[k * N + i] * z[k * N + j];
            }
            z[i * N + j] = sum / L[i * N + i];
        }
    }
}

/* Whether kappa + w, and with v, is clipped on all of the ball or nowhere. */
static inline int PART(_clips_evenly)(const Ball *b, const double *low, const double *high)
{
    for (int c = 0; c < M; c++) {
        const double *const law = b->law + c * POINTS, change = PART(_spread)(law);
        const int beyond = law[0] - change >= high[c] || law[0] + change <= low[c];
        const double left = beyond ? 0.0 : change, U = within(law[0], low[c], high[c]) + b->v[c];
        if (!beyond && (law[0] + change > high[c] || law[0] - change < low[c])) {
            return 0;
        }
        if (!(U - left >= high[c] || U + left <= low[c]) && (U + left > high[c] || U - left < low[c])) {
            return 0;
        }
    }
    return 1;
}

/* The largest change of F(y) - A y over the ball. */
static inline double PART(_bend)(const Ball *b, const double *s, double radius)
{
    double sum = 0.0;
    for (int i = 0; i < N; i++) {
        double most = 0.0;
        for (int side = 0; side < 2; side++) {
            double d[N];
            for (int c = 0; c < N; c++) {
                const double *const y = b->y + c * POINTS;
                d[c] = y[1 + side * N + i] - y[0];
                for (int k = 0; k < N; k++) {
                    d[c] -= (side ? -radius : radius) * b->A[c * N + k] * b->T[k * N + i] * BOX(s, c);
                }
            }
            most = larger(most, PART(_distance)(b, s, d));
        }
        sum += most * most;
    }
    return SURE * sqrt(sum);
}

/* Whether lane `at` of `count` rollouts stays where it is, within its limits, under the last block of its plan. */
static APART int PART(_rests)(int at, int count, const double *p, const double *s, const double *low,
                              const double *high, Rollouts *r)
{
    Ball *const b = &r->shared.ball;
    const double t = r->t[at] + r->elapsed, until = r->t[at] + r->lasts;
    const int times = MOVES || r->lasts > s[LATER] ? TIMES : 1;
    const double gap = s[LATER] / (double)most(times - 1, 1);
    double x[N], trace = 0.0, radius = TINIEST, slack;
    for (int c = 0; c < N; c++) {
        x[c] = r->x[c * count + at];
        if (!isfinite(x[c])) {
            return 0;
        }
        for (int i = 0; i < N; i++) {
            b->T[c * N + i] = c == i ? 1.0 : 0.0;
        }
    }
    for (int c = 0; c < M; c++) {
        b->v[c] = r->v[((BLOCKS - 1) * M + c) * count + at];
        b->w[c] = r->w[c * count + at];
    }
    PART(_surround)(b, s, x, b->T, NEARBY);
    PART(_onward)(POINTS, t, until, p, s, low, high, b);
    for (int a = 0; a < N * N; a++) {
        const double *const y = b->y + a / N * POINTS;
        b->A[a] = (y[1 + a % N] - y[1 + N + a % N]) / (2.0 * NEARBY * BOX(s, a / N));
    }
    if (!PART(_contracts)(b)) {
        return 0;
    }
    for (int c = 0; c < N; c++) {
        trace += b->S[c * N + c];
    }
    slack = 1.0 / (4.0 * trace);
    for (int i = 0; i < times; i++) {
        double d[N];
        if (i > 0) {
            PART(_onward)(1, t + gap * (double)i, until, p, s, low, high, b);
        }
        for (int c = 0; c < N; c++) {
            d[c] = b->y[i > 0 ? c : c * POINTS] - x[c];
            b->x[c] = x[c];
        }
        radius = larger(radius, PART(_distance)(b, s, d) / slack);
    }
    if (times > 1 && !(radius <= WIDEST)) {
        return 0;
    }
    PART(_axes)(b);
    PART(_surround)(b, s, x, b->T, radius);
    for (int i = 0; i < times; i++) {
        PART(_onward)(POINTS, t + gap * (double)i, until, p, s, low, high, b);
        if (!(PART(_bend)(b, s, radius) <= slack * radius) || !PART(_clips_evenly)(b, low, high)) {
            return 0;
        }
        for (int k = 0; k < K; k++) {
            const double *const h = b->h + k * POINTS;
            if (!(h[0] - PART(_spread)(h) >= r->margin)) {
                return 0;
            }
        }
    }
    return 1;
}
