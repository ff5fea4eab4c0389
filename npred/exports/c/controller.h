/*
#include "about.h"
 *
 * C99. It needs only libm, allocates nothing, and has no static variable that changes: any number of npred_controller
 * can run side by side. Do not compile it with -ffast-math, which hides NaN. In double precision, with
 * -ffp-contract=off (gcc: -std=c99), it gives the same numbers as the controller in Python, to the bit if libm is the
 * same; only the sums of a network may round differently.
 */
#ifndef NPRED_CONTROLLER_H
#define NPRED_CONTROLLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define NPRED_DIGEST "0000000000000000000000000000000000000000000000000000000000000000"

/* The time of a control step, in the unit of t. */
#include "period.h"

enum {
#include "sizes.h"
    NPRED_OK = 0,
    /* After 1, 2, 4 and 6: keep the actuator at the last U (the controller assumes so), and pass the next sample. */
    NPRED_MEASUREMENT_NOT_FINITE = 1,
    NPRED_PREDICTION_NOT_FINITE = 2,
    NPRED_STATE_REFUSED = 3,    /* an argument is out of range, or from another controller; nothing has changed */
    NPRED_DELAY_TOO_LONG = 4,   /* D_hat is longer than the stored history of commands */
    /* Not finite, or its rest is not found, or needs a state or a U outside the bounds: nothing has changed. */
    NPRED_SETPOINT_REFUSED = 5,
    NPRED_STATE_UNKNOWN = 6,    /* no sample yet that could be used, or none since a very long pause */
    NPRED_SETPOINT_UNSAFE = 7   /* a warning: it is set, but its rest breaks a limit that the plant declares as safe */
};

/* All that a step needs from the steps before it. */
typedef struct {
    uint32_t digest[4];
    uint32_t checksum; /* covers all bytes after it; npred_get_state sets it */
    int64_t steps;
    double t0;
    npred_real D_hat[1], phi_before[1];
#if KEEPS_COMMANDS
    npred_real held[NPRED_ROWS * NPRED_M_INPUTS], total[NPRED_ROWS * NPRED_M_INPUTS];
    npred_real clock[NPRED_CLOCK];
#endif
#if WATCHES
    npred_real observer[NPRED_OBSERVER];
#endif
#if READS_COMMANDS
    npred_real missed[1];
#endif
#if FILTERS
    npred_real filter[NPRED_FILTER];
#endif
#if PROTECTS
    npred_real plan[NPRED_PLAN];
#endif
#if SETS
    npred_real p[NPRED_NUMBERS]; /* the parameters, then the rest that belongs to the set-point */
#endif
} npred_saved;

/* P is the prediction of the last step: element (node j, state c) is P[j * N_STATES + c]. A guard sets error and
 * fallback. */
typedef struct {
    npred_saved saved;
    npred_real P[NPRED_NX * NPRED_N_STATES];
    npred_real error[1], fallback[1], phi[1], N[1];
    npred_real Y[NPRED_N_STATES];
    npred_real U[NPRED_M_INPUTS], D_seen[NPRED_M_INPUTS];
#if READS_COMMANDS
    npred_real u[NPRED_NX * NPRED_M_INPUTS], u_nodes[NPRED_NX * NPRED_M_INPUTS];
#endif
#if READS_COMMANDS
    npred_real X_hat[NPRED_N_STATES], expected[NPRED_N_STATES], innovation[NPRED_N_OUTPUTS];
#endif
#if FILTERS
    npred_real sample[NPRED_N_OUTPUTS], fate[NPRED_N_OUTPUTS];
#endif
#if PROTECTS
    npred_real kept[1], filtered[1], unkept[1], promised[1], withdrawn[1];
    npred_real low[NPRED_M_INPUTS], high[NPRED_M_INPUTS], D_moved[NPRED_M_INPUTS];
    npred_real ends[NPRED_ENDS * NPRED_N_STATES], moments[NPRED_ENDS];
#endif
#if TUNABLE
    struct {
        npred_real gamma_dt, guard[NPRED_GUARD];
    } settings; /* npred_init sets the first values */
#endif
    npred_real work[NPRED_WORK];
} npred_controller;

#if READS_COMMANDS
/* The result of the last call.
 * D_hat: the estimate of the delay; D_hat_spread: half the range of the delays that it may be taken for, at a bound the
 * whole range of the bounds.
 * at_bound: 1 if D_hat stands at a bound of its law: the delay may lie outside.
 * age: the age of the last sample that was used, infinity before the first.
 * innovation: the last sample minus the model's value.
 * late: number of samples that were too old, or came after a newer one. They were not used.
 * refused: number of samples too far from the model's value to be plausible; missed: the latest of these in a row.
 * renewed: how often the observer of the state restarted; offset: its estimate of a constant that is added to U.
 * handed_over: 1 if the watchdog gives U.
 * fallback: 1 if the guard replaced the network's answer; error: the guard's estimate of the error of U.
 * filtered: 1 if the safety filter changed U; unkept: 1 if it found no U within the bounds that keeps all limits;
 * kept: the smallest limit h of the state that is predicted for the time when U acts;
 * promised: 1 if U begins a plan that keeps all limits for good; withdrawn: how often that ended. */
typedef struct {
    npred_real D_hat, D_hat_spread, error;
    double age;
    npred_real innovation[NPRED_N_OUTPUTS], offset[NPRED_M_INPUTS];
    int32_t late, refused, missed, renewed, handed_over, fallback, filtered, unkept, promised, withdrawn, at_bound;
    npred_real kept;
} npred_status;
#endif

void npred_init(npred_controller *self);
void npred_get_state(const npred_controller *self, npred_saved *state);
int npred_set_state(npred_controller *self, const npred_saved *state);
int npred_set_D_hat(npred_controller *self, npred_real D_hat); /* restart the estimate of the delay at this value */
int npred_set_time(npred_controller *self, double t); /* the time of the next step, which counts as a first one */
const char *npred_version(void);
#if SETS
/* Set all parameters of plant and law that can be set, in the order of the functions below; the next step uses them.
 * The rest of a new set-point is followed from the present one here, by at most 500 of Newton's corrections. Returns
 * NPRED_OK; NPRED_SETPOINT_UNSAFE, and it is set; or NPRED_SETPOINT_REFUSED: then nothing has changed. npred_init sets
 * the first values. */
int npred_set_parameters(npred_controller *self, const npred_real *values);
/* The same for a single parameter, which may be the set-point. */
#include "setters.h"
#endif
#if KEEPS_COMMANDS
/* Tell the controller, before its first step, which U the actuator has had so far; npred_init assumes the one that is
 * named above. Returns NPRED_STATE_REFUSED if it is not finite, out of the declared bounds, or too late. */
int npred_set_u0(npred_controller *self, const npred_real *U);
/* Tell the controller which U the actuator really got since the last step, if it was not the U that the step gave. */
int npred_applied(npred_controller *self, const npred_real *U);
#endif
#if READS_COMMANDS
/* One control step, to be called every DT. Pass the sample X (N_OUTPUTS) that is measured now. It writes U (M_INPUTS),
 * and assumes that you send it. A sample too far from the model's value is refused: see npred_get_status. */
int npred_step(npred_controller *self, const npred_real *X, npred_real *U);
/* The same at any time t after the last call, with a sample that was taken at `sampled_at`, or NULL for no sample: then
 * the model predicts X. Returns NPRED_STATE_REFUSED if a time is impossible; then nothing has changed. */
int npred_step_at(npred_controller *self, double t, const npred_real *X, double sampled_at, npred_real *U);
void npred_get_status(const npred_controller *self, npred_status *status);
#else
/* One control step. Pass the state X (N_STATES) and the commands under way u (NX * M_INPUTS), both measured now:
 * element (node j, input c) is u[j * M_INPUTS + c], and the last row was sent just now. It writes U (M_INPUTS).
 * npred_step_nodes takes the mean of u over each node's cell, and the value of u at each node. */
int npred_step(npred_controller *self, const npred_real *X, const npred_real *u, npred_real *U);
int npred_step_nodes(npred_controller *self, const npred_real *X, const npred_real *u, const npred_real *u_nodes,
                     npred_real *U);
#endif

#ifdef __cplusplus
}
#endif
#endif
