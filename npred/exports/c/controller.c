#include <string.h>

#include "npred.h"

#ifdef __FAST_MATH__
#error "compile without -ffast-math"
#endif

static const uint32_t npred_digest[4] = {0x00000000u, 0x00000000u, 0x00000000u, 0x00000000u};

#define WIDE 1 /* lane */
#define LANES
#define INDEX int
#include "kernels.h"

#include "settings.h"

/* Pointers to the parts of the state. A step reads u and u_nodes if they are measured; otherwise it writes them. */
static inline State npred_state(npred_controller *self, const npred_real *u, const npred_real *u_nodes)
{
    State state = {
        .D_hat = self->saved.D_hat, .phi_before = self->saved.phi_before, .D_seen = self->D_seen,
        .u = (npred_real *)u, .u_nodes = (npred_real *)u_nodes, .X_hat = self->Y, .Y = self->Y, .P = self->P,
        .U = self->U, .phi = self->phi, .N = self->N, .error = self->error, .fallback = self->fallback,
    };
#if KEEPS_COMMANDS
    state.held = self->saved.held;
    state.total = self->saved.total;
    state.clock = self->saved.clock;
#endif
#if WATCHES
    state.observer = self->saved.observer;
#endif
#if READS_COMMANDS
    state.X_hat = self->X_hat;
    state.expected = self->expected;
    state.missed = self->saved.missed;
    state.innovation = self->innovation;
#endif
#if FILTERS
    state.filter = self->saved.filter;
    state.sample = self->sample;
    state.fate = self->fate;
#endif
#if PROTECTS
    state.kept = self->kept;
    state.filtered = self->filtered;
    state.unkept = self->unkept;
    state.promised = self->promised;
    state.withdrawn = self->withdrawn;
    state.low = self->low;
    state.high = self->high;
    state.D_moved = self->D_moved;
    state.ends = self->ends;
    state.moments = self->moments;
    state.plan = self->saved.plan;
#endif
    return state;
}

/* Copy a table of constants one number at a time: gcc 12 with AVX-512 compiles a whole copy of them wrongly. */
SPARE static void npred_set(int count, const volatile npred_real *from, npred_real *to)
{
    for (int i = 0; i < count; i++) {
        to[i] = from[i];
    }
}

#if KEEPS_COMMANDS
/* Fill the stored commands with U. */
static void npred_assume(npred_controller *self, const npred_real *U)
{
    const npred_real first = (npred_real)(NPRED_ROWS - 1);
    const Clock clock = clock_of(the_shape, self->saved.clock);
    for (int row = 0; row < NPRED_ROWS; row++) {
        for (int i = 0; i < NPRED_M_INPUTS; i++) {
            self->saved.held[row * NPRED_M_INPUTS + i] = U[i];
            self->saved.total[row * NPRED_M_INPUTS + i] = (npred_real)row * U[i] - first * U[i];
        }
    }
    copy(NPRED_M_INPUTS, U, clock.sent);
    copy(NPRED_M_INPUTS, U, clock.before);
}
#endif

void npred_init(npred_controller *self)
{
    memset(self, 0, sizeof *self);
    memcpy(self->saved.digest, npred_digest, sizeof npred_digest);
    self->saved.phi_before[0] = self->error[0] = NAN;
    self->saved.D_hat[0] = (npred_real)NPRED_D_HAT;
    self->saved.t0 = NPRED_T0;
#if WATCHES
    for (int i = 0; i < NPRED_OBSERVER; i++) {
        self->saved.observer[i] = NAN;
    }
#endif
#if KEEPS_COMMANDS
    npred_set(NPRED_CLOCK, the_clock, self->saved.clock);
    npred_assume(self, the_u0);
#endif
#if READS_COMMANDS
    for (int i = 0; i < NPRED_N_OUTPUTS; i++) {
        self->innovation[i] = NAN;
    }
#endif
#if FILTERS
    npred_set(NPRED_FILTER, the_filter, self->saved.filter);
#endif
#if SETS
    npred_set(NPRED_NUMBERS, the_p, self->saved.p);
#endif
#if TUNABLE
    npred_set(NPRED_GUARD, the_guard, self->settings.guard);
    self->settings.gamma_dt = the_settings.gamma_dt;
#endif
}

const char *npred_version(void)
{
    return NPRED_DIGEST;
}

/* FNV-1a: it changes with every change of a single byte. */
static uint32_t npred_checksum(const npred_saved *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t sum = 2166136261u;
    for (size_t i = offsetof(npred_saved, checksum) + sizeof sum; i < sizeof *state; i++) {
        sum = (sum ^ bytes[i]) * 16777619u;
    }
    return sum;
}

/* The time of the next step. */
static double npred_time(const npred_saved *state)
{
    return state->t0 + (double)state->steps * NPRED_DT;
}

static int npred_within(npred_real D_hat)
{
    return D_hat >= (npred_real)NPRED_D_HAT_LOW && D_hat <= (npred_real)NPRED_D_HAT_HIGH;
}

void npred_get_state(const npred_controller *self, npred_saved *state)
{
    memcpy(state, &self->saved, sizeof *state);
    state->checksum = npred_checksum(state);
}

int npred_set_state(npred_controller *self, const npred_saved *state)
{
    int fits = memcmp(state->digest, npred_digest, sizeof npred_digest) == 0;
    fits = fits && state->checksum == npred_checksum(state);
    fits = fits && isfinite(npred_time(state)) && state->steps >= 0;
    fits = fits && npred_within(state->D_hat[0]) && !isinf(state->phi_before[0]);
#if KEEPS_COMMANDS
    fits = fits && state->clock[AT] >= NPRED_ROWS - 2 && state->clock[AT] < 2 * NPRED_ROWS;
    fits = fits && isfinite(state->clock[LAG]);
#endif
#if SETS
    fits = fits && all_finite(NPRED_NUMBERS, state->p);
#endif
#if FILTERS
    fits = fits && all_finite(NPRED_FILTER, state->filter);
#endif
#if PROTECTS
    fits = fits && all_finite(NPRED_PLAN, state->plan);
#endif
#if KEEPS_COMMANDS
    fits = fits && all_finite(NPRED_ROWS * NPRED_M_INPUTS, state->held);
    fits = fits && all_finite(NPRED_ROWS * NPRED_M_INPUTS, state->total);
#endif
    if (!fits) {
        return NPRED_STATE_REFUSED;
    }
    memcpy(&self->saved, state, sizeof *state);
    return NPRED_OK;
}

#if SETS
int npred_set_parameters(npred_controller *self, const npred_real *values)
{
    npred_real p[NPRED_NUMBERS];
    int same = 1, code = NPRED_OK;
    memcpy(p, self->saved.p, sizeof p);
    for (int i = 0; i < NPRED_PARAMETERS; i++) {
        same = same && p[the_places[i]] == values[i];
        p[the_places[i]] = values[i];
    }
    if (same || !all_finite(NPRED_PARAMETERS, values)) {
        return same ? NPRED_OK : NPRED_SETPOINT_REFUSED;
    }
#if SETTLES
    npred_real *rest = p + NPRED_NUMBERS - NPRED_N_STATES - NPRED_M_INPUTS, arrived[1], kept[1];
    the_settle(the_shape, self->saved.p, p, the_units, rest, arrived, kept, NULL);
    int fits = arrived[0] > 0;
    for (int i = 0; i < NPRED_N_STATES + NPRED_M_INPUTS; i++) { /* NaN does not fit */
        fits = fits && rest[i] >= the_rest_bounds[2 * i] && rest[i] <= the_rest_bounds[2 * i + 1];
    }
    if (!fits) {
        return NPRED_SETPOINT_REFUSED;
    }
    code = kept[0] >= 0 ? NPRED_OK : NPRED_SETPOINT_UNSAFE; /* NaN is not kept */
#endif
    memcpy(self->saved.p, p, sizeof p);
    return code;
}

/* Set parameter `number` of those that can be set. */
static int npred_set_one(npred_controller *self, int number, npred_real value)
{
    npred_real values[NPRED_PARAMETERS];
    for (int i = 0; i < NPRED_PARAMETERS; i++) {
        values[i] = i == number ? value : self->saved.p[the_places[i]];
    }
    return npred_set_parameters(self, values);
}

#include "set.h"

#endif
int npred_set_D_hat(npred_controller *self, npred_real D_hat)
{
    if (!npred_within(D_hat)) {
        return NPRED_STATE_REFUSED;
    }
    self->saved.D_hat[0] = D_hat;
    self->saved.phi_before[0] = NAN;
    return NPRED_OK;
}

int npred_set_time(npred_controller *self, double t)
{
    if (!isfinite(t)) {
        return NPRED_STATE_REFUSED;
    }
    self->saved.t0 = t;
    self->saved.steps = 0;
    self->saved.phi_before[0] = NAN;
#if KEEPS_COMMANDS
    const Clock clock = clock_of(the_shape, self->saved.clock);
    forget(the_shape, NPRED_N_OUTPUTS, clock);
#endif
#if READS_COMMANDS
    self->saved.missed[0] = 0;
#endif
    return NPRED_OK;
}

/* A call at time t, `gap` control steps after the last one. X is a sample, `age` control steps old, or NULL. */
static int npred_call(npred_controller *self, double t, double gap, const npred_real *X, double age, const npred_real *u,
                      const npred_real *u_nodes, npred_real *U)
{
#if REPEATS
    /* reduced to one period: a float cannot resolve the phase of a large time */
    const npred_real now = (npred_real)fmod(t, NPRED_PERIOD);
#else
    const npred_real now = (npred_real)t;
#endif
    Settings settings = the_settings;
#if SETS
    settings.p = self->saved.p;
#endif
#if TUNABLE
    settings.gamma_dt = self->settings.gamma_dt;
    settings.guard = self->settings.guard;
#endif
    State state = npred_state(self, u, u_nodes);
    if (X != NULL) {
#if FILTERS
        memcpy(self->sample, X, sizeof self->sample);
#else
        memcpy(self->Y, X, sizeof self->Y);
#endif
    }
    const int code = call(the_shape, now, (npred_real)gap, X != NULL, (npred_real)age, &the_parts, &settings, &state,
                          self->work);
    if (code == NPRED_OK) {
        memcpy(U, self->U, sizeof self->U);
    }
    self->saved.steps++;
    return code;
}

#if KEEPS_COMMANDS
int npred_set_u0(npred_controller *self, const npred_real *U)
{
    int fits = all_finite(NPRED_M_INPUTS, U);
    fits = fits && !(self->saved.clock[CALLS] > 0) && (INDEX)self->saved.clock[AT] == NPRED_ROWS - 2;
    for (int i = 0; i < NPRED_M_INPUTS; i++) {
        fits = fits && U[i] >= the_u0_bounds[2 * i] && U[i] <= the_u0_bounds[2 * i + 1];
    }
    if (!fits) {
        return NPRED_STATE_REFUSED;
    }
    npred_assume(self, U);
    return NPRED_OK;
}

int npred_applied(npred_controller *self, const npred_real *U)
{
    if (!all_finite(NPRED_M_INPUTS, U)) {
        return NPRED_STATE_REFUSED;
    }
    State state = npred_state(self, NULL, NULL);
    replace(the_shape, &state, U);
    return NPRED_OK;
}
#endif

#if READS_COMMANDS
int npred_step(npred_controller *self, const npred_real *X, npred_real *U)
{
    return npred_call(self, npred_time(&self->saved), 1.0, X, 0.0, self->u, self->u_nodes, U);
}

/* A number of control steps, rounded if it is nearly whole. */
static double npred_snapped(double steps)
{
    return fabs(steps - rint(steps)) <= NPRED_SNAP ? rint(steps) : steps;
}

int npred_step_at(npred_controller *self, double t, const npred_real *X, double sampled_at, npred_real *U)
{
    const double next = npred_time(&self->saved), last = next - NPRED_DT, age = (t - sampled_at) / NPRED_DT;
    const int first = !(self->saved.clock[CALLS] > 0), regular = fabs(t - next) <= NPRED_SNAP * NPRED_DT;
    if (!isfinite(t) || (!first && !(t > last)) || (X != NULL && !(age >= -1.0 && isfinite(age)))) {
        return NPRED_STATE_REFUSED;
    }
    if (!regular) {
        self->saved.t0 = t;
        self->saved.steps = 0;
    }
    return npred_call(self, t, first || regular ? 1.0 : npred_snapped((t - last) / NPRED_DT), X,
                      X != NULL ? fmax(npred_snapped(age), 0.0) : 0.0, self->u, self->u_nodes, U);
}

void npred_get_status(const npred_controller *self, npred_status *status)
{
    const npred_real *stamp = self->saved.clock;
    const double age = ((double)stamp[AT] - (double)stamp[SAMPLE_AT]) * NPRED_DT;
    memset(status, 0, sizeof *status);
    status->D_hat = self->saved.D_hat[0];
    status->D_hat_spread = NAN;
#if WATCHES
    status->D_hat_spread = undecided(the_shape, the_law, (npred_real *)self->saved.observer, self->saved.D_hat, 0);
#endif
    status->at_bound = status->D_hat <= (npred_real)NPRED_D_HAT_FIRST || status->D_hat >= (npred_real)NPRED_D_HAT_LAST;
    status->age = isnan(age) ? (double)INFINITY : age;
    memcpy(status->innovation, self->innovation, sizeof status->innovation);
#if OFFSETS
    memcpy(status->offset, self->saved.filter + NPRED_N_STATES, sizeof status->offset);
#endif
    status->late = (int32_t)stamp[LATE];
    status->refused = (int32_t)stamp[REFUSED];
    status->missed = (int32_t)self->saved.missed[0];
    status->renewed = (int32_t)stamp[RENEWED];
    status->handed_over = stamp[HANDED] > 0;
    status->fallback = self->fallback[0] > 0;
    status->error = self->error[0];
    status->kept = NAN;
#if PROTECTS
    status->filtered = self->filtered[0] > 0;
    status->unkept = self->unkept[0] > 0;
    status->promised = self->promised[0] > 0;
    status->withdrawn = (int32_t)self->withdrawn[0];
    status->kept = self->kept[0];
#endif
}
#else
int npred_step(npred_controller *self, const npred_real *X, const npred_real *u, npred_real *U)
{
    return npred_call(self, npred_time(&self->saved), 1.0, X, 0.0, u, u, U);
}

int npred_step_nodes(npred_controller *self, const npred_real *X, const npred_real *u, const npred_real *u_nodes,
                     npred_real *U)
{
    return npred_call(self, npred_time(&self->saved), 1.0, X, 0.0, u, u_nodes, U);
}
#endif

#ifdef NPRED_TEST
#include <stdio.h>

#include "test.h"

enum { TEST_SAMPLED = 1, TEST_STAMPED = 2, TEST_APPLIED = 4, TEST_SAVED = 8, TEST_ESTIMATE = 16, TEST_TIME = 32,
       TEST_ANEW = 64, TEST_SET = 128 };

/* Make call s of the test, and return its code. */
static int test_call(npred_controller *c, int s, npred_real *U)
{
    static npred_saved saved;
    const int does = test_does[s];
#if READS_COMMANDS
    const npred_real *X = does & TEST_SAMPLED ? test_X + s % TEST_ROWS * NPRED_N_OUTPUTS : NULL;
#else
    const npred_real *X = test_X + s % TEST_ROWS * NPRED_N_STATES;
    const npred_real *u = test_u + s % TEST_U_ROWS * NPRED_NX * NPRED_M_INPUTS;
    const npred_real *u_nodes = test_u + (s + 1) % TEST_U_ROWS * NPRED_NX * NPRED_M_INPUTS;
#endif
    if (does & TEST_ANEW) {
        npred_init(c);
    }
#if SETS
    if (does & TEST_SET) {
        test_set(c);
    }
#endif
    if (does & TEST_SAVED) {
        npred_get_state(c, &saved);
        npred_init(c);
        if (npred_set_state(c, &saved) != NPRED_OK) {
            return NPRED_STATE_REFUSED;
        }
    }
    if (does & TEST_ESTIMATE) {
        npred_set_D_hat(c, (npred_real)NPRED_D_HAT);
    }
    if (does & TEST_TIME) {
        npred_set_time(c, test_t[s]);
    }
#if READS_COMMANDS
    if (does & TEST_APPLIED) {
        npred_real applied[NPRED_M_INPUTS];
        for (int i = 0; i < NPRED_M_INPUTS; i++) {
            applied[i] = (npred_real)0.5 * c->U[i];
        }
        npred_applied(c, applied);
    }
    return does & TEST_STAMPED ? npred_step_at(c, test_t[s], X, test_taken[s], U) : npred_step(c, X, U);
#else
    return does & TEST_STAMPED ? npred_step_nodes(c, X, u, u_nodes, U) : npred_step(c, X, u, U);
#endif
}

#if PROTECTS
/* Ask the filter alone, with the memory of case s: how many of its answers differ by more than rounding. */
static int test_filter(npred_controller *c, int s)
{
    enum { N = NPRED_N_STATES, M = NPRED_M_INPUTS };
    static npred_real safety[sizeof the_safety / sizeof *the_safety];
    const npred_real *margin = test_arguments + s * TEST_ARGUMENTS, *low = margin + 1, *ends = low + 2 * M;
    const npred_real *moments = ends + NPRED_ENDS * N;
    npred_real got[M + NPRED_PLAN + 5] = {0}, *const results = got + M + NPRED_PLAN;
    int off = 0;
    memcpy(got, moments + NPRED_ENDS, (M + NPRED_PLAN) * sizeof *got);
    memcpy(safety, the_safety, sizeof safety);
    safety[N] = *margin;
    the_parts.protect(the_shape, ends, moments, the_settings.p, safety, low, low + M, got, got + M, results, results + 1,
                      results + 2, results + 3, results + 4, c->work);
    for (int i = 0; i < M + NPRED_PLAN + 5; i++) {
        const int place = s * (M + NPRED_PLAN + 5) + i;
        off += !(fabs((double)got[i] - (double)test_answers[place]) <= ldexp(1.0, test_rounds[place])); /* NaN is off */
    }
    return off;
}
#endif

int main(void)
{
    static npred_controller c;
    double worst = 0, apart;
    int passed = 1;
    npred_init(&c);
    for (int s = 0; s < TEST_CALLS; s++) {
        const npred_real *expected = test_U + s * NPRED_M_INPUTS;
        npred_real U[NPRED_M_INPUTS];
        const int code = test_call(&c, s, U);
#if PROTECTS
        const int lost = test_filtered[s] > 1; /* rounding errors decide it */
        const int acts = lost || c.filtered[0] > 0 || test_filtered[s] > 0; /* test_filter looks at its plans */
        if (code == NPRED_OK && !isnan(expected[0])) {
            apart = fabs((double)c.kept[0] - (double)test_kept[s]) / TEST_H;
            passed = passed && (lost || apart <= TEST_COARSE);
        }
        for (int i = 0; i < NPRED_M_INPUTS && !isnan(expected[0]) && acts; i++) {
            passed = passed && (lost || (U[i] >= the_input_bounds[2 * i] && U[i] <= the_input_bounds[2 * i + 1]));
            U[i] = c.U[i] = expected[i];
        }
        if (!isnan(expected[0]) && acts) { /* from here on with the same commands */
            npred_applied(&c, expected);
        }
        if (lost) {
            continue;
        }
#endif
        if ((code != NPRED_OK) != isnan(expected[0])) {
            printf("call %d: expected %s, got code %d\n", s, code ? "a command" : "a refusal", code);
            return 2;
        }
        for (int i = 0; i < NPRED_M_INPUTS && code == NPRED_OK; i++) {
            apart = fabs((double)U[i] - (double)expected[i]) / (double)test_size[i];
            worst = fmax(worst, apart);
            passed = passed && apart <= TEST_LIMIT; /* NaN fails */
        }
        apart = fabs((double)c.saved.D_hat[0] - (double)test_D_hat[s]) / (double)test_size[NPRED_M_INPUTS];
        worst = fmax(worst, apart);
        passed = passed && apart <= TEST_LIMIT;
    }
#if PROTECTS
    int astray = 0;
    for (int s = 0; s < TEST_CASES; s++) {
        const int off = test_filter(&c, s);
        if (off > 0) {
            printf("case %d of the filter: %d answers differ by more than rounding\n", s, off);
        }
        astray += off > 0;
    }
#if defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF)
    passed = passed && 32 * astray <= TEST_CASES; /* multiply-adds may choose another plan */
#else
    passed = passed && astray == 0;
#endif
#endif
    printf("largest difference: %.2e of the size of an input or of D_hat\n", worst);
    return !passed;
}
#endif
