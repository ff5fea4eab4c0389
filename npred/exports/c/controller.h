/*
#include "about.h"
 *
 * C99, no library but libm, no allocation, no static variable that changes: each npred_controller is on its own.
 * Compile it without -ffast-math: NaN has to stay visible. In double precision, with -ffp-contract=off (gcc: -std=c99),
 * it computes what npred.controller does, to the bit where libm is the same; a network's sums may round otherwise.
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
    NPRED_MEASUREMENT_NOT_FINITE = 1, /* hold the last U, which the state has as sent, and measure again */
    NPRED_PREDICTION_NOT_FINITE = 2,  /* likewise */
    NPRED_STATE_REFUSED = 3,          /* of another controller, or out of range; the state stands as before */
    NPRED_DELAY_TOO_LONG = 4,         /* for the commands that are kept; likewise hold the last U */
    NPRED_SETPOINT_REFUSED = 5        /* not finite, or without a rest within the bounds of U; the old one stays */
};

/* What a step remembers. */
typedef struct {
    uint32_t digest[4];
    uint32_t checksum; /* of all bytes after it, set by npred_get_state */
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
    npred_real p[NPRED_NUMBERS]; /* the parameters, and the rest of a set-point */
#endif
} npred_saved;

/* P, the prediction of the last step, is by nodes, then states; error and fallback are those of a guard. */
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
    npred_real kept[1], filtered[1], unkept[1], low[NPRED_M_INPUTS], high[NPRED_M_INPUTS], D_moved[NPRED_M_INPUTS];
    npred_real ends[NPRED_ENDS * NPRED_N_STATES], moments[NPRED_ENDS];
#endif
#if TUNABLE
    struct {
        npred_real gamma_dt, guard[NPRED_GUARD];
    } settings; /* set by npred_init */
#endif
    npred_real work[NPRED_WORK];
} npred_controller;

#if READS_COMMANDS
/* What happened in the last call. `age` is how old the last used sample is, infinity before the first; `innovation` what
 * that differed from what the model said; `late` counts the samples that were not used, for they came after a newer one
 * or were too old, `refused` those that were not believed, `missed` the last of these in a row, `renewed` how often
 * the observer of the state began anew. `filtered` is 1 where a safety filter changed U, `unkept` where it found no
 * plan that keeps the limits, of which `kept` is the least when U acts. */
typedef struct {
    npred_real D_hat, D_hat_spread, error;
    double age;
    npred_real innovation[NPRED_N_OUTPUTS], offset[NPRED_M_INPUTS];
    int32_t late, refused, missed, renewed, handed_over, fallback, filtered, unkept;
    npred_real kept;
} npred_status;
#endif

void npred_init(npred_controller *self);
void npred_get_state(const npred_controller *self, npred_saved *state);
int npred_set_state(npred_controller *self, const npred_saved *state);
int npred_set_D_hat(npred_controller *self, npred_real D_hat); /* go on from an estimate, as from a first step */
int npred_set_time(npred_controller *self, double t); /* go on from another time, likewise */
const char *npred_version(void);
#if SETS
/* Set parameters of plant and law, from the next step on: all that can be set, in the order of the functions below. The
 * rest of a set-point follows. NPRED_OK, or NPRED_SETPOINT_REFUSED: then all stays. npred_init sets the first values. */
int npred_set_parameters(npred_controller *self, const npred_real *values);
/* The same for one of them, which may be the set-point. */
#include "setters.h"
#endif
#if KEEPS_COMMANDS
/* What the actuator got since the last step, where that was not its U, or not the one that was held. */
int npred_applied(npred_controller *self, const npred_real *U);
#endif
#if READS_COMMANDS
/* One control step, each DT: the sample X (N_OUTPUTS) measured now; writes U (M_INPUTS), which it remembers as sent. A
 * sample that the model says cannot be is not believed: npred_get_status. */
int npred_step(npred_controller *self, const npred_real *X, npred_real *U);
/* The same at any time t, later than the last one: with a sample that was taken at `sampled_at`, or NULL. Between
 * samples the model says what X is. NPRED_STATE_REFUSED for times that cannot be; nothing changed then. */
int npred_step_at(npred_controller *self, double t, const npred_real *X, double sampled_at, npred_real *U);
void npred_get_status(const npred_controller *self, npred_status *status);
#else
/* One control step: X (N_STATES), u (NX * M_INPUTS, by nodes, then inputs: the last row was sent just now), both
 * measured now; writes U (M_INPUTS). npred_step_nodes takes the means over the nodes' cells and the values at the
 * nodes. */
int npred_step(npred_controller *self, const npred_real *X, const npred_real *u, npred_real *U);
int npred_step_nodes(npred_controller *self, const npred_real *X, const npred_real *u, const npred_real *u_nodes,
                     npred_real *U);
#endif

#ifdef __cplusplus
}
#endif
#endif
