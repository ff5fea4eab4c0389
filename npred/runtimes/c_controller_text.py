"""The parts of a controller's C files that are the same for all: @ stands for the name, %% for it in capitals."""

HEADER = """\
/*
{about}
 *
 * C99, no library but libm, no allocation, no static variable that changes: each @_controller is on its own.
 * Compile it without -ffast-math: NaN has to stay visible.
 */
#ifndef %%_CONTROLLER_H
#define %%_CONTROLLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define %%_DIGEST "0000000000000000000000000000000000000000000000000000000000000000"

enum {
{sizes}
    %%_OK = 0,
    %%_MEASUREMENT_NOT_FINITE = 1, /* hold the last U, which the state has as sent, and measure again */
    %%_PREDICTION_NOT_FINITE = 2,  /* likewise */
    %%_STATE_REFUSED = 3,          /* of another controller, or out of range; the state stands as before */
    %%_DELAY_TOO_LONG = 4          /* for the commands that are kept; likewise hold the last U */
};

/* What a step remembers. */
typedef struct {
    uint32_t digest[4];
    uint32_t checksum; /* of all bytes after it, set by @_get_state */
    int32_t k;
    int64_t steps;
    double t0;
{saved}
} @_saved;

/* P, the prediction of the last step, is by nodes, then states; error and fallback are those of a guard. */
typedef struct {
    @_saved saved;
{scratch}
} @_controller;

{signatures}

#ifdef __cplusplus
}
#endif
#endif
"""

SHARED = """\
void @_init(@_controller *self);
void @_get_state(const @_controller *self, @_saved *state);
int @_set_state(@_controller *self, const @_saved *state);
int @_set_D_hat(@_controller *self, REAL D_hat); /* go on from an estimate, as from a first step */
int @_set_time(@_controller *self, double t);    /* go on from another time, likewise */
const char *@_version(void);
"""
MEASURED_SIGNATURES = """\
/* One control step: X (N_STATES), u (NX * M_INPUTS, by nodes, then inputs: the last row was sent just now), both
 * measured now; writes U (M_INPUTS). @_step_nodes takes the means over the nodes' cells and the values at the nodes. */
int @_step(@_controller *self, const REAL *X, const REAL *u, REAL *U);
int @_step_nodes(@_controller *self, const REAL *X, const REAL *u, const REAL *u_nodes, REAL *U);
"""
RECALLED_SIGNATURES = """\
/* One control step: X (N_STATES) measured now; writes U (M_INPUTS), which it remembers as sent. With a gate,
 * self->saved.missed counts the last samples in a row that were not believed: the model's state took their place. */
int @_step(@_controller *self, const REAL *X, REAL *U);
"""


APPLIED_SIGNATURE = """\
/* What the actuator got since the last step, where that was not its U, or not the one that was held. */
int @_applied(@_controller *self, const REAL *U);
"""


def signatures(recalls: bool, keeps: bool) -> list[str]:
    """The declarations of the functions."""
    text = SHARED + (APPLIED_SIGNATURE if keeps else "") + (RECALLED_SIGNATURES if recalls else MEASURED_SIGNATURES)
    return [str(line) for line in text.splitlines()]


SOURCE = """\
#include <string.h>

#include "@.h"

#ifdef __FAST_MATH__
#error "compile without -ffast-math"
#endif

static const uint32_t @_digest[4] = {DIGEST_WORDS};

{kernels}

{bodies}
{functions}

{test}
"""

BODIES = """\
static const Shape @_shape = {%%_NX, 1, <ROWS>, %%_N_STATES, %%_M_INPUTS};
static const Parts @_parts = {
    {parts}
};

/* Where the numbers of the state are, and what the step is set to. */
static inline State @_state(@_controller *self<MEASURED>)
{
    const State state = {
        {state}
    };
    return state;
}

static inline Settings @_settings(@_controller *self)
{
    const Settings settings = {
        {settings}
    };
    (void)self;
    return settings;
}

static void @_calculate(@_controller *self<MEASURED>, REAL t)
{
    State state = @_state(self<PASSED>);
    const Settings settings = @_settings(self);
    control_step(@_shape, self->saved.k, t, &@_parts, &settings, &state, self->work);
}
"""

BOOKING = """
static int32_t @_remember(@_controller *self, REAL t)
{
    State state = @_state(self<NONE>);
    const Settings settings = @_settings(self);
    return (int32_t)remember(@_shape, self->saved.k, t, &@_parts, &settings, &state, self->work);
}

static void @_hold(@_controller *self, REAL t)
{
    State state = @_state(self<NONE>);
    const Settings settings = @_settings(self);
    hold(@_shape, self->saved.k, t, &@_parts, &settings, &state, self->work);
}
"""

FUNCTIONS = """\
void @_init(@_controller *self)
{
    memset(self, 0, sizeof *self);
    memcpy(self->saved.digest, @_digest, sizeof @_digest);
    self->saved.phi_before[0] = NAN;
    {start}
}

const char *@_version(void)
{
    return %%_DIGEST;
}

/* FNV-1a: no single byte can change without it. */
static uint32_t @_checksum(const @_saved *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t sum = 2166136261u;
    for (size_t i = offsetof(@_saved, checksum) + sizeof sum; i < sizeof *state; i++) {
        sum = (sum ^ bytes[i]) * 16777619u;
    }
    return sum;
}

void @_get_state(const @_controller *self, @_saved *state)
{
    memcpy(state, &self->saved, sizeof *state);
    state->checksum = @_checksum(state);
}

int @_set_state(@_controller *self, const @_saved *state)
{
    const double now = state->t0 + (double)state->steps * <DT>;
    int fits = memcmp(state->digest, @_digest, sizeof @_digest) == 0 && state->checksum == @_checksum(state);
    fits = fits && isfinite(now) && state->steps >= 0;
    fits = fits && state->D_hat[0] >= (REAL)<LOW> && state->D_hat[0] <= (REAL)<HIGH> && !isinf(state->phi_before[0]);
    {check_commands}
    if (!fits) {
        return %%_STATE_REFUSED;
    }
    memcpy(&self->saved, state, sizeof *state);
    return %%_OK;
}

int @_set_D_hat(@_controller *self, REAL D_hat)
{
    if (!(D_hat >= (REAL)<LOW> && D_hat <= (REAL)<HIGH>)) {
        return %%_STATE_REFUSED;
    }
    self->saved.D_hat[0] = D_hat;
    self->saved.phi_before[0] = NAN;
    return %%_OK;
}

int @_set_time(@_controller *self, double t)
{
    if (!isfinite(t)) {
        return %%_STATE_REFUSED;
    }
    self->saved.t0 = t;
    self->saved.steps = 0;
    self->saved.phi_before[0] = NAN;
    {unknown}
    return %%_OK;
}

static int @_run(@_controller *self, const REAL *X<MEASURED>, REAL *U)
{
    {time}
    const REAL D_hat = self->saved.D_hat[0], phi_before = self->saved.phi_before[0];
    int finite = 1;
    {checks}
    int code = finite ? %%_OK : %%_MEASUREMENT_NOT_FINITE;
    {before}
    if (code == %%_OK) {
        memcpy(self->Y, X, sizeof self->Y);
        @_calculate(self<PASSED>, t);
        finite = isfinite(self->saved.D_hat[0]) != 0;
        for (int i = 0; i < %%_M_INPUTS; i++) {
            finite = finite && isfinite(self->U[i]);
        }
        code = finite ? %%_OK : %%_PREDICTION_NOT_FINITE;
        {reach}
    }
    if (code != %%_OK) {
        self->saved.D_hat[0] = D_hat;
        self->saved.phi_before[0] = phi_before;
        {after}
        {hold}
    } else {
        memcpy(U, self->U, sizeof self->U);
    }
    {keep}
    self->saved.steps++;
    return code;
}
"""
APPLIED = """
int @_applied(@_controller *self, const REAL *U)
{
    const int last = (self->saved.k - 1) % %%_ROWS, next = self->saved.k % %%_ROWS;
    int finite = 1;
    for (int i = 0; i < %%_M_INPUTS; i++) {
        finite = finite && isfinite(U[i]);
    }
    if (!finite) {
        return %%_STATE_REFUSED;
    }
    for (int i = 0; i < %%_M_INPUTS; i++) {
        self->saved.held[last * %%_M_INPUTS + i] = U[i];
        self->saved.total[next * %%_M_INPUTS + i] = self->saved.total[last * %%_M_INPUTS + i] + U[i];
    }
    return %%_OK;
}
"""
MEASURING = """
int @_step(@_controller *self, const REAL *X, const REAL *u, REAL *U)
{
    return @_run(self, X, u, u, U);
}

int @_step_nodes(@_controller *self, const REAL *X, const REAL *u, const REAL *u_nodes, REAL *U)
{
    return @_run(self, X, u, u_nodes, U);
}
"""
RECALLING = """
int @_step(@_controller *self, const REAL *X, REAL *U)
{
    return @_run(self, X, U);
}
"""


def finite(name: str, count: str) -> list[str]:
    """The lines that check the numbers of an array."""
    return [f"for (int i = 0; i < {count}; i++) {{", f"    finite = finite && isfinite({name}[i]);", "}"]


ARRAYS = "const REAL *X, const REAL *u, const REAL *u_nodes, "
MEASURED = """\
for (int i = 0; i < %%_NX * %%_M_INPUTS; i++) {
    finite = finite && isfinite(u[i]) && isfinite(u_nodes[i]);
}"""
TOO_LONG = """\
for (int i = 0; i < %%_M_INPUTS; i++) {
    code = code == %%_OK && self->D_seen[i] > (REAL)<REACH> ? %%_DELAY_TOO_LONG : code;
}"""
BEFORE = "memcpy(self->before, self->saved.observer, sizeof self->before);"
AFTER = "memcpy(self->saved.observer, self->before, sizeof self->before);"
COMMANDS = """\
for (int row = 0; row < %%_ROWS; row++) {
    for (int i = 0; i < %%_M_INPUTS; i++) {
        self->saved.held[row * %%_M_INPUTS + i] = u0[i];
        self->saved.total[row * %%_M_INPUTS + i] = (REAL)row * u0[i] - (REAL)<ORIGIN> * u0[i];
    }
}"""
OBSERVER = """\
for (int i = 0; i < %%_OBSERVER; i++) {
    self->saved.observer[i] = NAN;
}"""
UNKNOWN = """\
for (int i = 0; i < %%_N_STATES; i++) {
    self->saved.expected[i] = NAN;
}"""
FINITE_COMMANDS = """\
for (int i = 0; i < %%_ROWS * %%_M_INPUTS; i++) {
    fits = fits && isfinite(state->held[i]) && isfinite(state->total[i]);
}"""

TEST = """\
#ifdef %%_TEST
#include <stdio.h>

{vector}

int main(void)
{
    static @_controller c;
    double worst = 0;
    @_init(&c);
    for (int s = 0; s < <STEPS>; s++) {
        REAL U[%%_M_INPUTS];
        if (@_step(&c, test_X + s * %%_N_STATES, <U>U) != %%_OK) {
            return 2;
        }
        for (int i = 0; i < %%_M_INPUTS; i++) {
            worst = fmax(worst, fabs((double)U[i] - (double)test_U[s * %%_M_INPUTS + i]) / (double)test_size[i]);
        }
        worst = fmax(worst, fabs((double)c.saved.D_hat[0] - (double)test_D_hat[s]));
    }
    printf("largest difference: %.2e of each input's size, and of D_hat\\n", worst);
    return !(worst <= <LIMIT>);
}
#endif
"""
