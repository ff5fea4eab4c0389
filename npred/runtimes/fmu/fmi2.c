/* The functions of FMI 2.0 for co-simulation around one instance of the controller. */
#include <stddef.h>
#include <stdint.h>

#include "instance.h"

#ifndef fmi2Functions_h /* without the standard's header these are its types, as far as they are used here */
typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;
typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    fmi2CallbackLogger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
#ifdef FMI2_FUNCTION_PREFIX /* of an FMU that is linked from its sources */
#define JOINED_(a, b) a##b
#define JOINED(a, b) JOINED_(a, b)
#define NAMED(name) JOINED(FMI2_FUNCTION_PREFIX, name)
#else
#define NAMED(name) name
#endif
#else
#define NAMED(name) name
#endif

#define STATUS(name) EXPORTED fmi2Status NAMED(name)
#define ASK(modes, call)                                                                                               \
    if (!allowed(self, modes, call)) {                                                                                 \
        return fmi2Error;                                                                                              \
    }

EXPORTED const char *NAMED(fmi2GetVersion)(void)
{
    return "2.0";
}

EXPORTED const char *NAMED(fmi2GetTypesPlatform)(void)
{
    return "default";
}

/* The message is a format too, and has no % of its own: some importers do not fill one in. */
static void log_2(Instance *self, int status, const char *message)
{
    if (self->callback != NULL) {
        ((fmi2CallbackLogger)self->callback)(self->environment, self->name, (fmi2Status)status,
                                             category(status), message);
    }
}

STATUS(fmi2SetDebugLogging)(fmi2Component self, fmi2Boolean on, size_t many, const fmi2String categories[])
{
    (void)on, (void)many, (void)categories;
    return self == NULL ? fmi2Error : fmi2OK;
}

EXPORTED fmi2Component NAMED(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                              fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    const fmi2CallbackLogger log = functions == NULL ? NULL : functions->logger;
    Instance *self = type == fmi2CoSimulation ? create(name, token) : NULL;
    if (self != NULL) {
        self->environment = functions == NULL ? NULL : functions->componentEnvironment;
        self->callback = (void (*)(void))log;
        self->log = log_2;
    } else if (log != NULL) {
        log(functions->componentEnvironment, name, fmi2Error, "logStatusError",
            "instantiate: expected co-simulation and this FMU's guid");
    }
    return self;
}

EXPORTED void NAMED(fmi2FreeInstance)(fmi2Component self)
{
    destroy(self);
}

STATUS(fmi2SetupExperiment)(fmi2Component self, fmi2Boolean tolerates, fmi2Real tolerance, fmi2Real start,
                            fmi2Boolean stops, fmi2Real stop)
{
    (void)tolerates, (void)tolerance, (void)stops, (void)stop;
    ASK(INSTANTIATED, "fmi2SetupExperiment")
    ((Instance *)self)->now.start = start;
    return fmi2OK;
}

STATUS(fmi2EnterInitializationMode)(fmi2Component self)
{
    ASK(INSTANTIATED, "fmi2EnterInitializationMode")
    return (fmi2Status)enter_initialization(self, ((Instance *)self)->now.start);
}

STATUS(fmi2ExitInitializationMode)(fmi2Component self)
{
    ASK(INITIALIZATION, "fmi2ExitInitializationMode")
    return (fmi2Status)exit_initialization(self);
}

STATUS(fmi2Terminate)(fmi2Component self)
{
    ASK(STEPPING, "fmi2Terminate")
    ((Instance *)self)->now.mode = TERMINATED;
    return fmi2OK;
}

STATUS(fmi2Reset)(fmi2Component self)
{
    ASK(ALWAYS, "fmi2Reset")
    reset(self);
    return fmi2OK;
}

STATUS(fmi2DoStep)(fmi2Component self, fmi2Real t, fmi2Real h, fmi2Boolean forward)
{
    (void)forward;
    ASK(STEPPING, "fmi2DoStep")
    return (fmi2Status)advance(self, t, h);
}

STATUS(fmi2CancelStep)(fmi2Component self)
{
    ASK(0, "fmi2CancelStep")
    return fmi2Error;
}

STATUS(fmi2GetReal)(fmi2Component self, const fmi2ValueReference references[], size_t many, fmi2Real values[])
{
    ASK(ALWAYS, "fmi2GetReal")
    return (fmi2Status)get_values(self, references, many, values, many);
}

STATUS(fmi2SetReal)(fmi2Component self, const fmi2ValueReference references[], size_t many, const fmi2Real values[])
{
    ASK(INSTANTIATED | INITIALIZATION | STEPPING, "fmi2SetReal")
    return (fmi2Status)set_values(self, references, many, values, many);
}

STATUS(fmi2GetBoolean)(fmi2Component self, const fmi2ValueReference references[], size_t many, fmi2Boolean values[])
{
    ASK(ALWAYS, "fmi2GetBoolean")
    if (count(references, many, 1) != (long long)many) {
        return (fmi2Status)report(self, ERROR, "get: expected known Boolean variables, got others");
    }
    for (size_t i = 0; i < many; i++) {
        values[i] = ((Instance *)self)->now.values[variables[references[i]].first] > 0;
    }
    return fmi2OK;
}

#define NONE(call, Values)                                                                                             \
    STATUS(call)(fmi2Component self, const fmi2ValueReference references[], size_t many, Values values[])              \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return self == NULL ? fmi2Error : (fmi2Status)unsupported(self, #call, many);                                  \
    }
NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetString, const fmi2String)
NONE(fmi2SetBoolean, const fmi2Boolean)

#define NO_DERIVATIVE(call, Values)                                                                                    \
    STATUS(call)(fmi2Component self, const fmi2ValueReference references[], size_t many, const fmi2Integer orders[],   \
                 Values values[])                                                                                      \
    {                                                                                                                  \
        (void)references, (void)orders, (void)values;                                                                  \
        return self == NULL ? fmi2Error : (fmi2Status)unsupported(self, #call, many);                                  \
    }
NO_DERIVATIVE(fmi2SetRealInputDerivatives, const fmi2Real)
NO_DERIVATIVE(fmi2GetRealOutputDerivatives, fmi2Real)

STATUS(fmi2GetDirectionalDerivative)(fmi2Component self, const fmi2ValueReference unknowns[], size_t many,
                                     const fmi2ValueReference knowns[], size_t of, const fmi2Real seed[],
                                     fmi2Real values[])
{
    (void)unknowns, (void)many, (void)knowns, (void)of, (void)seed, (void)values;
    return self == NULL ? fmi2Error : (fmi2Status)unsupported(self, "fmi2GetDirectionalDerivative", 1);
}

STATUS(fmi2GetFMUstate)(fmi2Component self, fmi2FMUstate *state)
{
    ASK(ALWAYS, "fmi2GetFMUstate")
    return (fmi2Status)get_state(self, state);
}

STATUS(fmi2SetFMUstate)(fmi2Component self, fmi2FMUstate state)
{
    ASK(ALWAYS, "fmi2SetFMUstate")
    return (fmi2Status)set_state(self, state);
}

STATUS(fmi2FreeFMUstate)(fmi2Component self, fmi2FMUstate *state)
{
    free_state(state);
    return self == NULL ? fmi2Error : fmi2OK;
}

STATUS(fmi2SerializedFMUstateSize)(fmi2Component self, fmi2FMUstate state, size_t *size)
{
    ASK(ALWAYS, "fmi2SerializedFMUstateSize")
    (void)state;
    *size = sizeof(State);
    return fmi2OK;
}

STATUS(fmi2SerializeFMUstate)(fmi2Component self, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    ASK(ALWAYS, "fmi2SerializeFMUstate")
    return (fmi2Status)serialize(self, state, bytes, size);
}

STATUS(fmi2DeSerializeFMUstate)(fmi2Component self, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    ASK(ALWAYS, "fmi2DeSerializeFMUstate")
    return (fmi2Status)deserialize(self, bytes, size, state);
}

STATUS(fmi2GetRealStatus)(fmi2Component self, const fmi2StatusKind kind, fmi2Real *value)
{
    ASK(ALWAYS, "fmi2GetRealStatus")
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = ((Instance *)self)->now.values[AT_TIME];
    return fmi2OK;
}

STATUS(fmi2GetBooleanStatus)(fmi2Component self, const fmi2StatusKind kind, fmi2Boolean *value)
{
    ASK(ALWAYS, "fmi2GetBooleanStatus")
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = 0; /* a refused step ends nothing */
    return fmi2OK;
}

#define NO_STATUS(call, Value)                                                                                         \
    STATUS(call)(fmi2Component self, const fmi2StatusKind kind, Value *value)                                          \
    {                                                                                                                  \
        (void)kind, (void)value;                                                                                       \
        return self == NULL ? fmi2Error : fmi2Discard; /* no step runs beside its call */                              \
    }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)
