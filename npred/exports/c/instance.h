/*
 * One instance of the controller with the values of its variables. FMI 2.0 and FMI 3.0 share this file.
 *
 * The export writes variables.h: the controller's names, the table of variables and their places in `values`.
 * A control step is due at start + k STEP. DoStep runs the control steps that are due within [t, t + h), with the
 * present inputs. An importer's times have rounding errors: a control step due within SLACK STEP of the end waits.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef enum { INPUT, TUNABLE, FIXED, OUTPUT, INDEPENDENT } Role;

/* `size` numbers from values[first]; a parameter may be set to numbers from low to high. */
typedef struct {
    int first, size;
    Role role;
    int boolean;
    double low, high;
} Variable;

#include "variables.h"

#if defined _WIN32
#define EXPORTED __declspec(dllexport)
#elif defined __GNUC__
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

#define SLACK 1e-3

enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 }; /* the same numbers in both versions */
enum { INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, ALWAYS = 15 };

/* All that an importer may save and set again. */
typedef struct {
    npred_saved saved;
    double values[VALUES];
    double start;
    int64_t steps; /* control steps since start */
    int32_t mode;
    uint32_t checksum; /* covers all bytes before it; get_state sets it */
} State;

typedef struct Instance Instance;
struct Instance {
    npred_controller controller;
    State now;
    npred_real X[NPRED_N_OUTPUTS];
#ifdef AT_ACTUATOR
    npred_real u[NPRED_NX * NPRED_M_INPUTS];
#endif
    void *environment;
    void (*log)(Instance *self, int status, const char *message); /* passes it to the callback, if there is one */
    void (*callback)(void);
    char name[];
};

static const char *category(int status)
{
    return status == WARNING ? "logStatusWarning" : status == DISCARD ? "logStatusDiscard" : "logStatusError";
}

/* Log one line, and return the status. */
static int report(Instance *self, int status, const char *format, ...)
{
    char line[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    if (self->callback != NULL) {
        self->log(self, status, line);
    }
    return status;
}

/* Whether the instance is in one of the modes. */
static int allowed(Instance *self, int modes, const char *call)
{
    if (self == NULL) {
        return 0;
    }
    if (!(self->now.mode & modes)) {
        report(self, ERROR, "%s: expected another mode of the instance; call it where FMI allows it", call);
        return 0;
    }
    return 1;
}

static void reset(Instance *self)
{
    memset(&self->now, 0, sizeof self->now);
    memcpy(self->now.values, start_values, sizeof start_values);
    self->now.mode = INSTANTIATED;
    npred_init(&self->controller);
}

/* A new instance; NULL if the token is another one, or if there is no memory. */
static Instance *create(const char *name, const char *token)
{
    if (token == NULL || strcmp(token, TOKEN) != 0) {
        return NULL;
    }
    name = name == NULL ? "" : name;
    Instance *self = calloc(1, sizeof *self + strlen(name) + 1);
    if (self != NULL) {
        strcpy(self->name, name);
        reset(self);
    }
    return self;
}

/* How many numbers the variables have; -1 if one is unknown or has another type. */
static long long count(const uint32_t *references, size_t many, int boolean)
{
    long long numbers = 0;
    for (size_t i = 0; i < many; i++) {
        if (references[i] >= VARIABLES || variables[references[i]].boolean != boolean) {
            return -1;
        }
        numbers += variables[references[i]].size;
    }
    return numbers;
}

static int get_values(Instance *self, const uint32_t *references, size_t many, double *values, size_t size)
{
    if (count(references, many, 0) != (long long)size) {
        return report(self, ERROR, "get: expected real variables of this FMU and room for their values, got others");
    }
    for (size_t i = 0; i < many; i++) {
        const Variable *v = &variables[references[i]];
        memcpy(values, self->now.values + v->first, (size_t)v->size * sizeof *values);
        values += v->size;
    }
    return OK;
}

/* Whether a variable may be set to these values now. The values of inputs are checked when a step reads them. */
static int settable(Instance *self, const Variable *v, const double *values)
{
    const int early = self->now.mode != STEPPING;
    if (v->role == OUTPUT || v->role == INDEPENDENT || (v->role == FIXED && !early)) {
        return report(self, ERROR, "set: expected an input, or a parameter that may be set now, got another variable");
    }
    for (int i = 0; v->role != INPUT && i < v->size; i++) {
        if (!(values[i] >= v->low && values[i] <= v->high)) {
            return report(self, DISCARD, "set: expected a parameter from %g to %g, got %g; the old one stays", v->low,
                          v->high, values[i]);
        }
    }
    return OK;
}

static void copy_in(npred_real *to, const double *from, int numbers)
{
    for (int i = 0; i < numbers; i++) {
        to[i] = (npred_real)from[i];
    }
}

#ifdef AT_PARAMETERS
/* Pass the parameters among these values to the controller: all of them or, if one is refused, none. */
static int set_parameters(Instance *self, const uint32_t *references, size_t many, const double *values)
{
    npred_real p[NPRED_PARAMETERS];
    copy_in(p, self->now.values + AT_PARAMETERS, NPRED_PARAMETERS);
    for (size_t i = 0; i < many; values += variables[references[i]].size, i++) {
        const int place = variables[references[i]].first - AT_PARAMETERS;
        if (place >= 0 && place < NPRED_PARAMETERS) {
            p[place] = (npred_real)values[0];
        }
    }
    const int code = npred_set_parameters(&self->controller, p);
    if (code == NPRED_SETPOINT_UNSAFE) {
        return report(self, WARNING, "set: expected a set-point whose rest is safe, got another; it is set");
    }
    if (code != NPRED_OK) {
        return report(self, DISCARD, "set: expected a set-point with a rest within its bounds, got another; the old one "
                                     "stays");
    }
    return OK;
}
#endif

static int set_values(Instance *self, const uint32_t *references, size_t many, const double *values, size_t size)
{
    if (count(references, many, 0) != (long long)size) {
        return report(self, ERROR, "set: expected real variables of this FMU and all their values, got others");
    }
    const double *next = values;
    for (size_t i = 0; i < many; next += variables[references[i]].size, i++) {
        const int allowed = settable(self, &variables[references[i]], next);
        if (allowed != OK) {
            return allowed;
        }
    }
    int status = OK;
#ifdef AT_PARAMETERS
    status = set_parameters(self, references, many, values);
    if (status > WARNING) {
        return status;
    }
#endif
    for (size_t i = 0; i < many; values += variables[references[i]].size, i++) {
        const Variable *v = &variables[references[i]];
        memcpy(self->now.values + v->first, values, (size_t)v->size * sizeof *values);
    }
#ifdef AT_D_HAT0
    if (self->now.mode != STEPPING) {
        self->now.values[AT_D_HAT] = self->now.values[AT_D_HAT0];
    }
#endif
#ifdef AT_U0
    if (self->now.mode != STEPPING) {
        memcpy(self->now.values + AT_U, self->now.values + AT_U0, NPRED_M_INPUTS * sizeof *self->now.values);
    }
#endif
    return status;
}

static int enter_initialization(Instance *self, double start)
{
    if (!isfinite(start)) {
        return report(self, ERROR, "start: expected a finite time, got %g", start);
    }
    self->now.start = self->now.values[AT_TIME] = start;
    self->now.mode = INITIALIZATION;
    return OK;
}

static int exit_initialization(Instance *self)
{
    int code = npred_set_time(&self->controller, self->now.start);
#ifdef AT_D_HAT0
    code = code == NPRED_OK ? npred_set_D_hat(&self->controller, (npred_real)self->now.values[AT_D_HAT0]) : code;
#endif
#ifdef AT_U0
    npred_real u0[NPRED_M_INPUTS];
    copy_in(u0, self->now.values + AT_U0, NPRED_M_INPUTS);
    code = code == NPRED_OK ? npred_set_u0(&self->controller, u0) : code;
#endif
    self->now.mode = STEPPING;
    return code == NPRED_OK ? OK : report(self, ERROR, "start: expected D_hat0 and u0 within their bounds, got others");
}

static void copy_out(double *to, const npred_real *from, int numbers)
{
    for (int i = 0; i < numbers; i++) {
        to[i] = (double)from[i];
    }
}

/* Copy the inputs and parameters into the controller. */
static void write_inputs(Instance *self)
{
    const double *values = self->now.values;
    copy_in(self->X, values + AT_X, NPRED_N_OUTPUTS);
#ifdef AT_ACTUATOR
    copy_in(self->u, values + AT_ACTUATOR, NPRED_NX * NPRED_M_INPUTS);
#endif
#ifdef AT_GAMMA
    self->controller.settings.gamma_dt = (npred_real)(values[AT_GAMMA] * STEP);
#endif
#ifdef AT_TOLERANCE
    self->controller.settings.guard[0] = (npred_real)(values[AT_TOLERANCE] * GUARD_PASSES);
#endif
}

/* Copy U, P, D_hat and the guard's results out of the controller. */
static void read_outputs(Instance *self, const npred_real *U)
{
    double *values = self->now.values;
    copy_out(values + AT_U, U, NPRED_M_INPUTS);
    copy_out(values + AT_P, self->controller.P + (NPRED_NX - 1) * NPRED_N_STATES, NPRED_N_STATES);
    copy_out(values + AT_D_HAT, self->controller.saved.D_hat, 1);
#ifdef AT_FALLBACK
    copy_out(values + AT_FALLBACK, self->controller.fallback, 1);
    copy_out(values + AT_ERROR, self->controller.error, 1);
#endif
}

#ifdef AT_AGE
/* Copy the status out of the controller, also after a step that was refused. */
static void read_status(Instance *self)
{
    double *values = self->now.values;
    npred_status status;
    npred_get_status(&self->controller, &status);
    values[AT_AGE] = isfinite(status.age) ? status.age : -1.0;
    values[AT_LATE] = status.late;
    values[AT_REFUSED] = status.refused;
#ifdef AT_AT_BOUND
    values[AT_AT_BOUND] = status.at_bound;
#endif
#ifdef AT_SPREAD
    values[AT_SPREAD] = (double)status.D_hat_spread;
#endif
#ifdef AT_RENEWED
    values[AT_RENEWED] = status.renewed;
#endif
#ifdef AT_HANDED_OVER
    values[AT_HANDED_OVER] = status.handed_over;
#endif
#ifdef AT_FILTERED
    values[AT_FILTERED] = status.filtered;
    values[AT_UNKEPT] = status.unkept;
    values[AT_PROMISED] = status.promised;
    values[AT_WITHDRAWN] = status.withdrawn;
    values[AT_KEPT] = (double)status.kept;
#endif
#ifdef AT_OFFSET
    copy_out(values + AT_OFFSET, status.offset, NPRED_M_INPUTS);
#endif
}
#endif

/* Run the control step that is due now. */
static int control_step(Instance *self, double due)
{
    npred_real U[NPRED_M_INPUTS];
    write_inputs(self);
#ifdef AT_ACTUATOR
    (void)due;
    const int code = npred_step(&self->controller, self->X, self->u, U);
#else
    const double age = self->now.values[AT_SAMPLE_AGE];
    const int code = npred_step_at(&self->controller, due, age < 0 ? NULL : self->X, due - age, U); /* NaN is refused */
    read_status(self);
#endif
    if (code == NPRED_OK) {
        read_outputs(self, U);
    }
    self->now.steps++;
    return code;
}

/* The time of the next control step. */
static double due_time(const Instance *self)
{
    return self->now.start + (double)self->now.steps * STEP;
}

static const char *reason(int code)
{
    return code == NPRED_MEASUREMENT_NOT_FINITE  ? "expected finite inputs, got one that is not"
           : code == NPRED_PREDICTION_NOT_FINITE ? "the prediction from these inputs is not finite"
           : code == NPRED_STATE_REFUSED         ? "expected a finite sample_age, got another"
           : code == NPRED_STATE_UNKNOWN         ? "expected a sample that can be used, got none so far or since a long pause; "
                                                   "give one with a sample_age of at most " OLDEST
                                                 : "the delay is longer than the stored history of commands";
}

/* Run the control steps that are due within [t, t + h). If one is refused, U keeps its value. */
static int advance(Instance *self, double t, double h)
{
    if (!isfinite(t + h) || !(h >= 0)) {
        return report(self, ERROR, "step: expected finite times and a step of 0 or more, got %g and %g", t, h);
    }
    if (!(fabs(t - self->now.values[AT_TIME]) <= SLACK * STEP)) {
        return report(self, ERROR, "step: expected t = %.17g, the end of the last step, got %.17g",
                      self->now.values[AT_TIME], t);
    }
    const double end = t + h - SLACK * STEP;
    int status = OK;
    for (double due = due_time(self); due < end; due = due_time(self)) {
        const int code = control_step(self, due);
        if (code != NPRED_OK) {
            status = report(self, WARNING, "step at %g " TIME_UNIT ": %s; U keeps its value", due, reason(code));
        }
    }
    self->now.values[AT_TIME] = t + h;
    return status;
}

/* FNV-1a: it changes with every change of a single byte. */
static uint32_t checksum(const State *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t sum = 2166136261u;
    for (size_t i = 0; i < offsetof(State, checksum); i++) {
        sum = (sum ^ bytes[i]) * 16777619u;
    }
    return sum;
}

/* Copy the bytes of a state to *copy or, if that is NULL, to new memory. */
static int copy_state(Instance *self, const void *bytes, void **copy)
{
    if (*copy == NULL) {
        *copy = malloc(sizeof(State));
    }
    if (*copy == NULL) {
        return report(self, ERROR, "state: expected %zu bytes of memory, got none", sizeof(State));
    }
    memcpy(*copy, bytes, sizeof(State));
    return OK;
}

static int get_state(Instance *self, void **copy)
{
    npred_get_state(&self->controller, &self->now.saved);
    self->now.checksum = checksum(&self->now);
    return copy_state(self, &self->now, copy);
}

/* Whether get_state can have written this state. */
static int sound(const State *state)
{
    const int mode = state->mode, one_mode = mode == 1 || mode == 2 || mode == 4 || mode == 8;
    int fits = state->checksum == checksum(state) && one_mode && state->steps >= 0;
    fits = fits && isfinite(state->start) && isfinite(state->values[AT_TIME]);
    fits = fits && fabs(state->start + (double)state->steps * STEP - state->values[AT_TIME]) <= 2 * STEP;
    for (int i = 0; i < VARIABLES; i++) {
        const Variable *v = &variables[i];
        for (int k = v->first; (v->role == TUNABLE || v->role == FIXED) && k < v->first + v->size; k++) {
            fits = fits && state->values[k] >= v->low && state->values[k] <= v->high;
        }
    }
    return fits;
}

static int set_state(Instance *self, const void *state)
{
    const State *saved = state;
    if (saved == NULL || !sound(saved) || npred_set_state(&self->controller, &saved->saved) != NPRED_OK) {
        return report(self, ERROR, "state: expected a state that this FMU saved, got another; nothing has changed");
    }
    memcpy(&self->now, saved, sizeof self->now);
    return OK;
}

/* Whether there is a state, and it has this number of bytes. */
static int sized(Instance *self, const void *state, size_t size)
{
    const int fits = state != NULL && size == sizeof(State);
    return fits ? OK : report(self, ERROR, "state: expected %zu bytes, got %zu", sizeof(State), size);
}

static int serialize(Instance *self, const void *state, void *bytes, size_t size)
{
    if (sized(self, state, size) != OK) {
        return ERROR;
    }
    memcpy(bytes, state, size);
    return OK;
}

static int deserialize(Instance *self, const void *bytes, size_t size, void **state)
{
    return sized(self, bytes, size) == OK ? copy_state(self, bytes, state) : ERROR;
}

/* Refuse a call about `many` variables of a kind that the FMU does not have. */
static int unsupported(Instance *self, const char *call, size_t many)
{
    if (self == NULL) {
        return ERROR;
    }
    return many == 0 ? OK : report(self, ERROR, "%s: expected no variables, for this FMU has none of that kind", call);
}

#endif
