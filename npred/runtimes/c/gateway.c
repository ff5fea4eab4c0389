/*
 * The controller as a function of MATLAB and GNU Octave; mex npred_mex.c npred.c compiles it.
 *
 *   c = npred_mex('new')                                   a controller; any number of them
 *   [U, D_hat, P, fallback, error] = npred_mex('step', c, X[, u])   a control step: U (m, 1), P (nx, n); u (nx, m)
 *   [U, ...] = npred_mex('step_at', c, t, X, sampled_at)     the same at a time t; [] for X where no sample came
 *   s = npred_mex('status', c)                               what happened in it, a struct
 *   s = npred_mex('state', c), npred_mex('restore', c, s)    what a step remembers, as bytes
 *   npred_mex('set_D_hat', c, D_hat), npred_mex('set_time', c, t)
 *   npred_mex('delete', c)
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "mex.h"
#include "npred.h"

#if RECALLS
enum { GIVEN = 1 }; /* to a step: X */
#else
enum { GIVEN = 2 }; /* to a step: X and u */
#endif

static npred_controller **controllers; /* those that were made, NULL where deleted; a handle is the place, from 1 */
static size_t made;

static void delete_all(void)
{
    for (size_t i = 0; i < made; i++) {
        free(controllers[i]);
    }
    free(controllers);
    controllers = NULL;
    made = 0;
}

static void complain(const char *what, const char *message)
{
    char id[64] = "npred:";
    strncat(id, what, sizeof id - strlen(id) - 1);
    mexErrMsgIdAndTxt(id, "%s", message);
}

static double *numbers(const mxArray *value, size_t count, const char *message)
{
    if (!mxIsDouble(value) || mxIsComplex(value) || mxIsSparse(value) || mxGetNumberOfElements(value) != count) {
        complain("argument", message);
    }
    return mxGetPr(value);
}

static size_t place(const mxArray *handle)
{
    const double number = *numbers(handle, 1, "expected a controller of 'new', got another value");
    if (!(number >= 1 && number <= (double)made) || controllers[(size_t)number - 1] == NULL) {
        complain("handle", "expected a controller of 'new' that is not deleted, got another number");
    }
    return (size_t)number - 1;
}

static mxArray *new_controller(void)
{
    npred_controller *controller = malloc(sizeof *controller);
    npred_controller **longer = realloc(controllers, (made + 1) * sizeof *longer);
    controllers = longer == NULL ? controllers : longer;
    if (longer == NULL || controller == NULL) {
        free(controller);
        complain("memory", "expected memory for a controller, got none");
    }
    npred_init(controller);
    controllers[made] = controller;
    made++;
    mexAtExit(delete_all);
    return mxCreateDoubleScalar((double)made);
}

static void refuse(int code)
{
    const char *messages[] = {"", "expected finite X and u, got one that is not; hold the last U and measure again",
                              "the prediction from X and u is not finite; hold the last U and measure again",
                              "expected a state of this controller, a number within its bounds or a time that can be, got another",
                              "the delay is above what the commands are kept for"};
    if (code != 0) {
        complain("refused", messages[code]);
    }
}

/* An array of results, columns of `columns` from rows that lie one after the other. */
static mxArray *matrix(const npred_real *rows, size_t count, size_t columns)
{
    mxArray *value = mxCreateDoubleMatrix(count, columns, mxREAL);
    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < columns; j++) {
            mxGetPr(value)[i + j * count] = (double)rows[i * columns + j];
        }
    }
    return value;
}

/* A sample X into npred_real. */
static void read_sample(const mxArray *value, npred_real *X)
{
    const double *measured = numbers(value, NPRED_N_OUTPUTS, "expected X with one number per state or observed output");
    for (int i = 0; i < NPRED_N_OUTPUTS; i++) {
        X[i] = (npred_real)measured[i];
    }
}

/* U and what is known about it, as many results as are asked for. */
static void give(const npred_controller *controller, const npred_real *U, int results, mxArray *result[])
{
    result[0] = matrix(U, NPRED_M_INPUTS, 1);
    if (results > 1) {
        result[1] = mxCreateDoubleScalar((double)controller->saved.D_hat[0]);
    }
    if (results > 2) {
        result[2] = matrix(controller->P, NPRED_NX, NPRED_N_STATES);
    }
    if (results > 3) {
        result[3] = mxCreateLogicalScalar(controller->fallback[0] > 0);
    }
    if (results > 4) {
        result[4] = mxCreateDoubleScalar((double)controller->error[0]);
    }
}

static void step(npred_controller *controller, int results, mxArray *result[], const mxArray *argument[])
{
    npred_real X[NPRED_N_OUTPUTS], U[NPRED_M_INPUTS];
    read_sample(argument[0], X);
#if RECALLS
    refuse(npred_step(controller, X, U));
#else
    static npred_real u[NPRED_NX * NPRED_M_INPUTS]; /* of this call alone */
    const size_t size = (size_t)NPRED_NX * NPRED_M_INPUTS;
    const double *columns = numbers(argument[1], size, "expected u (nx, m), nodes by inputs");
    for (int j = 0; j < NPRED_NX; j++) {
        for (int c = 0; c < NPRED_M_INPUTS; c++) {
            u[j * NPRED_M_INPUTS + c] = (npred_real)columns[j + c * NPRED_NX];
        }
    }
    refuse(npred_step(controller, X, u, U));
#endif
    give(controller, U, results, result);
}

#if RECALLS
static void step_at(npred_controller *controller, int results, mxArray *result[], const mxArray *argument[])
{
    npred_real X[NPRED_N_OUTPUTS], U[NPRED_M_INPUTS];
    const double t = *numbers(argument[0], 1, "expected a number"), at = *numbers(argument[2], 1, "expected a number");
    const int came = mxGetNumberOfElements(argument[1]) > 0;
    if (came) {
        read_sample(argument[1], X);
    }
    refuse(npred_step_at(controller, t, came ? X : NULL, at, U));
    give(controller, U, results, result);
}

static mxArray *status(const npred_controller *controller)
{
    const char *names[] = {"D_hat", "D_hat_spread", "age", "late", "refused", "missed", "renewed", "handed_over",
                           "fallback", "error", "filtered", "unkept", "kept", "innovation", "offset"};
    npred_status of;
    npred_get_status(controller, &of);
    const double values[] = {(double)of.D_hat, (double)of.D_hat_spread, of.age, of.late, of.refused, of.missed,
                             of.renewed, of.handed_over, of.fallback, (double)of.error, of.filtered, of.unkept, (double)of.kept};
    mxArray *fields = mxCreateStructMatrix(1, 1, 15, names);
    for (int i = 0; i < 13; i++) {
        mxSetField(fields, 0, names[i], mxCreateDoubleScalar(values[i]));
    }
    mxSetField(fields, 0, "innovation", matrix(of.innovation, NPRED_N_OUTPUTS, 1));
    mxSetField(fields, 0, "offset", matrix(of.offset, NPRED_M_INPUTS, 1));
    return fields;
}
#endif

static mxArray *state(const npred_controller *controller)
{
    mxArray *bytes = mxCreateNumericMatrix(sizeof(npred_saved), 1, mxUINT8_CLASS, mxREAL);
    npred_saved saved;
    npred_get_state(controller, &saved);
    memcpy(mxGetData(bytes), &saved, sizeof saved);
    return bytes;
}

static void restore(npred_controller *controller, const mxArray *bytes)
{
    npred_saved saved;
    if (!mxIsUint8(bytes) || mxGetNumberOfElements(bytes) != sizeof saved) {
        complain("argument", "expected the bytes of 'state', got another value");
    }
    memcpy(&saved, mxGetData(bytes), sizeof saved);
    refuse(npred_set_state(controller, &saved));
}

/* The words with the arguments that follow the controller, and the results that may be asked for, of some in vain. */
static const struct {
    const char *word;
    int arguments, results;
} calls[] = {{"new", -1, 1},      {"step", GIVEN, 5}, {"state", 0, 1}, {"restore", 1, 1},
             {"set_D_hat", 1, 1}, {"set_time", 1, 1}, {"delete", 0, 1},
#if RECALLS
             {"step_at", 3, 5},   {"status", 0, 1},
#endif
};
enum { NEW, STEP, STATE, RESTORE, SET_D_HAT, SET_TIME, DELETE, STEP_AT, STATUS };
enum { CALLS = sizeof calls / sizeof calls[0] };

static int find(int results, int arguments, const mxArray *argument[])
{
    char word[16] = "";
    if (arguments > 0 && mxIsChar(argument[0])) {
        mxGetString(argument[0], word, sizeof word);
    }
    for (int call = 0; call < CALLS; call++) {
        const int fits = arguments == calls[call].arguments + 2 && results <= calls[call].results;
        if (fits && strcmp(word, calls[call].word) == 0) {
            return call;
        }
    }
    complain("call", "expected new, step, state, restore, set_D_hat, set_time, delete, step_at or status and their arguments");
    return CALLS;
}

void mexFunction(int results, mxArray *result[], int arguments, const mxArray *argument[])
{
    const int call = find(results, arguments, argument);
    if (call == NEW) {
        result[0] = new_controller();
        return;
    }
    const size_t at = place(argument[1]);
    npred_controller *controller = controllers[at];
    switch (call) {
    case STEP:
        step(controller, results, result, argument + 2);
        break;
    case STATE:
        result[0] = state(controller);
        break;
    case RESTORE:
        restore(controller, argument[2]);
        break;
    case SET_D_HAT:
        refuse(npred_set_D_hat(controller, (npred_real)*numbers(argument[2], 1, "expected a number")));
        break;
    case SET_TIME:
        refuse(npred_set_time(controller, *numbers(argument[2], 1, "expected a number")));
        break;
#if RECALLS
    case STEP_AT:
        step_at(controller, results, result, argument + 2);
        break;
    case STATUS:
        result[0] = status(controller);
        break;
#endif
    case DELETE:
        free(controller);
        controllers[at] = NULL;
        break;
    default:
        break;
    }
}
