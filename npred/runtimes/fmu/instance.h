/*
 * One instance of the controller with the values of its variables: what FMI 2.0 and FMI 3.0 have in common.
 *
 * variables.h, made by the export, has the controller's names, the table of variables and their places in `values`.
 * A control step is due at start + k STEP; what is due within [t, t + h) runs with the inputs as they stand. An
 * importer's sum of steps rounds, and some make a step of one rounding error: a control step waits SLACK STEP for that.
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

/* `size` numbers from values[first]; low and high are what a parameter may be set to. */
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
    SAVED saved;
    double values[VALUES];
    double start;
    int64_t steps; /* control steps since start */
    int32_t mode;
    uint32_t checksum; /* of all bytes before it, where the state is saved */
} State;

typedef struct Instance Instance;
struct Instance {
    CONTROLLER controller;
    State now;
    REAL X[N_STATES];
#ifdef AT_ACTUATOR
    REAL u[NX * M_INPUTS];
#endif
    void *environment;
    void (*log)(Instance *self, int status, const char *message);
    void (*callback)(void);
    char *name;
};

static const char *category(int status)
{
    return status == WARNING ? "logStatusWarning" : status == DISCARD ? "logStatusDiscard" : "logStatusError";
}

/* Report in one line; gives the status. */
static int report(Instance *self, int status, const char *format, ...)
{
    char line[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    self->log(self, status, line);
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
    CORE(init)(&self->controller);
}

/* A new instance, NULL for another token or where there is no memory. */
static Instance *create(const char *name, const char *token)
{
    if (token == NULL || strcmp(token, TOKEN) != 0) {
        return NULL;
    }
    Instance *self = calloc(1, sizeof *self);
    char *copy = calloc(name == NULL ? 1 : strlen(name) + 1, 1);
    if (self == NULL || copy == NULL) {
        free(self);
        free(copy);
        return NULL;
    }
    self->name = name == NULL ? copy : strcpy(copy, name);
    reset(self);
    return self;
}

static void destroy(Instance *self)
{
    if (self != NULL) {
        free(self->name);
        free(self);
    }
}

/* The variable of a value reference, NULL where there is none of that type. */
static const Variable *variable(uint32_t reference, int boolean)
{
    if (reference >= VARIABLES || variables[reference].boolean != boolean) {
        return NULL;
    }
    return &variables[reference];
}

/* How many numbers variables have; -1 where one is unknown. */
static long long count(const uint32_t *references, size_t many, int boolean)
{
    long long numbers = 0;
    for (size_t i = 0; i < many; i++) {
        const Variable *v = variable(references[i], boolean);
        if (v == NULL) {
            return -1;
        }
        numbers += v->size;
    }
    return numbers;
}

static int get_values(Instance *self, const uint32_t *references, size_t many, double *values, size_t size)
{
    if (count(references, many, 0) != (long long)size) {
        return report(self, ERROR, "get: expected known real variables with as many values, got others");
    }
    for (size_t i = 0; i < many; i++) {
        const Variable *v = variable(references[i], 0);
        memcpy(values, self->now.values + v->first, (size_t)v->size * sizeof *values);
        values += v->size;
    }
    return OK;
}

/* Whether a variable may be set to these values now. What an input is set to is judged when a step reads it. */
static int settable(Instance *self, const Variable *v, const double *values)
{
    const int early = self->now.mode != STEPPING;
    if (v->role == OUTPUT || v->role == INDEPENDENT || (v->role == FIXED && !early)) {
        report(self, ERROR, "set: expected an input or a parameter that may be set now, got another variable");
        return ERROR;
    }
    for (int i = 0; v->role != INPUT && i < v->size; i++) {
        if (!(values[i] >= v->low && values[i] <= v->high)) {
            return report(self, DISCARD, "set: expected a parameter of %g to %g, got %g; it stays as it was", v->low,
                          v->high, values[i]);
        }
    }
    return OK;
}

static int set_values(Instance *self, const uint32_t *references, size_t many, const double *values, size_t size)
{
    if (count(references, many, 0) != (long long)size) {
        return report(self, ERROR, "set: expected known real variables with as many values, got others");
    }
    const double *next = values;
    for (size_t i = 0; i < many; next += variables[references[i]].size, i++) {
        const int status = settable(self, variable(references[i], 0), next);
        if (status != OK) {
            return status;
        }
    }
    for (size_t i = 0; i < many; values += variables[references[i]].size, i++) {
        const Variable *v = &variables[references[i]];
        memcpy(self->now.values + v->first, values, (size_t)v->size * sizeof *values);
    }
#ifdef AT_D_HAT_START
    if (self->now.mode != STEPPING) {
        self->now.values[AT_D_HAT] = self->now.values[AT_D_HAT_START];
    }
#endif
    return OK;
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
    int code = CORE(set_time)(&self->controller, self->now.start);
#ifdef AT_D_HAT_START
    code = code == CODE(OK) ? CORE(set_D_hat)(&self->controller, (REAL)self->now.values[AT_D_HAT_START]) : code;
#endif
    self->now.mode = STEPPING;
    return code == CODE(OK) ? OK : report(self, ERROR, "start: expected a D_hat_start within its bounds, got another");
}

/* The inputs and parameters into the controller. */
static void write_inputs(Instance *self)
{
    const double *values = self->now.values;
    for (int i = 0; i < N_STATES; i++) {
        self->X[i] = (REAL)values[AT_X + i];
    }
#ifdef AT_ACTUATOR
    for (int i = 0; i < NX * M_INPUTS; i++) {
        self->u[i] = (REAL)values[AT_ACTUATOR + i];
    }
#endif
#ifdef AT_PARAMETERS
    for (int i = 0; i < PARAMETERS; i++) {
        self->controller.settings.p[i] = (REAL)values[AT_PARAMETERS + i];
    }
#endif
#ifdef AT_GAMMA
    self->controller.settings.gamma_dt[0] = (REAL)(values[AT_GAMMA] * STEP);
#endif
#ifdef AT_TOLERANCE
    self->controller.settings.guard_settings[0] = (REAL)(values[AT_TOLERANCE] * GUARD_PASSES);
#endif
}

/* U and what is known about it, after a control step. */
static void read_outputs(Instance *self, const REAL *U)
{
    double *values = self->now.values;
    for (int i = 0; i < M_INPUTS; i++) {
        values[AT_U + i] = (double)U[i];
    }
    for (int i = 0; i < N_STATES; i++) {
        values[AT_P + i] = (double)self->controller.P[(NX - 1) * N_STATES + i];
    }
    values[AT_D_HAT] = (double)self->controller.saved.D_hat[0];
#ifdef AT_FALLBACK
    values[AT_FALLBACK] = (double)self->controller.fallback[0];
    values[AT_ERROR] = (double)self->controller.error[0];
#endif
}

static int control_step(Instance *self)
{
    REAL U[M_INPUTS];
    write_inputs(self);
#ifdef AT_ACTUATOR
    const int code = CORE(step)(&self->controller, self->X, self->u, U);
#else
    const int code = CORE(step)(&self->controller, self->X, U);
#endif
    if (code == CODE(OK)) {
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
    return code == CODE(MEASUREMENT_NOT_FINITE)    ? "expected finite inputs, got one that is not"
           : code == CODE(PREDICTION_NOT_FINITE) ? "the prediction from these inputs is not finite"
                                                 : "the delay is above what the commands are kept for";
}

/* The control steps that are due within [t, t + h). One that is refused holds U, as an actuator does meanwhile. */
static int advance(Instance *self, double t, double h)
{
    if (!isfinite(t + h) || !(h >= 0)) {
        return report(self, ERROR, "step: expected finite times and a step of 0 or more, got %g and %g", t, h);
    }
    if (!(fabs(t - self->now.values[AT_TIME]) <= SLACK * STEP)) {
        return report(self, ERROR, "step: expected to go on from %.17g, got %.17g", self->now.values[AT_TIME], t);
    }
    const double end = t + h - SLACK * STEP;
    int status = OK;
    for (double due = due_time(self); due < end; due = due_time(self)) {
        const int code = control_step(self);
        if (code != CODE(OK)) {
            status = report(self, WARNING, "step at %g " TIME_UNIT ": %s; U is held", due, reason(code));
        }
    }
    self->now.values[AT_TIME] = t + h;
    return status;
}

/* FNV-1a: no single byte can change without it. */
static uint32_t checksum(const State *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t sum = 2166136261u;
    for (size_t i = 0; i < offsetof(State, checksum); i++) {
        sum = (sum ^ bytes[i]) * 16777619u;
    }
    return sum;
}

/* A copy of the state, in *copy or, where that is NULL, in new memory. */
static int get_state(Instance *self, void **copy)
{
    if (*copy == NULL) {
        *copy = malloc(sizeof(State));
    }
    if (*copy == NULL) {
        return report(self, ERROR, "state: expected %zu bytes of memory, got none", sizeof(State));
    }
    CORE(get_state)(&self->controller, &self->now.saved);
    self->now.checksum = checksum(&self->now);
    memcpy(*copy, &self->now, sizeof(State));
    return OK;
}

/* Whether a state may be one that get_state wrote. */
static int sound(const State *state)
{
    const int mode = state->mode, one_mode = mode == 1 || mode == 2 || mode == 4 || mode == 8;
    int fits = state->checksum == checksum(state) && one_mode && state->steps >= 0 && isfinite(state->start) && isfinite(state->values[AT_TIME]);
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
    if (saved == NULL || !sound(saved) || CORE(set_state)(&self->controller, &saved->saved) != CODE(OK)) {
        return report(self, ERROR, "state: expected one of this FMU, got another; nothing changed");
    }
    memcpy(&self->now, saved, sizeof self->now);
    return OK;
}

static void free_state(void **state)
{
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
}

static int serialize(Instance *self, const void *state, void *bytes, size_t size)
{
    if (state == NULL || size != sizeof(State)) {
        return report(self, ERROR, "state: expected %zu bytes, got %zu", sizeof(State), size);
    }
    memcpy(bytes, state, size);
    return OK;
}

static int deserialize(Instance *self, const void *bytes, size_t size, void **state)
{
    if (size != sizeof(State)) {
        return report(self, ERROR, "state: expected %zu bytes, got %zu", sizeof(State), size);
    }
    if (*state == NULL) {
        *state = malloc(size);
    }
    if (*state == NULL) {
        return report(self, ERROR, "state: expected %zu bytes of memory, got none", size);
    }
    memcpy(*state, bytes, size);
    return OK;
}

static int unsupported(Instance *self, const char *call, size_t many)
{
    return many == 0 ? OK : report(self, ERROR, "%s: expected nothing, for the FMU has no such variable", call);
}

#endif
