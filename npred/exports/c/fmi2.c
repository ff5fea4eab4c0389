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
#ifdef FMI2_FUNCTION_PREFIX
#define PREFIXED FMI2_FUNCTION_PREFIX
#endif
#endif

#define FMI(name) fmi2##name
#define COMPONENT fmi2Component
#define STATE(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate
#include "calls.h"

EXPORTED const char *NAMED(fmi2GetVersion)(void)
{
    return "2.0";
}

EXPORTED const char *NAMED(fmi2GetTypesPlatform)(void)
{
    return "default";
}

/* The message is passed as the format, and contains no %: some importers do not fill a format in. */
static void log_2(Instance *self, int status, const char *message)
{
    const fmi2CallbackLogger log = (fmi2CallbackLogger)self->callback;
    log(self->environment, self->name, (fmi2Status)status, category(status), message);
}

EXPORTED fmi2Component NAMED(fmi2Instantiate)(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                              fmi2Boolean logging)
{
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

STATUS(fmi2SetupExperiment)(fmi2Component self, fmi2Boolean tolerates, fmi2Real tolerance, fmi2Real start,
                            fmi2Boolean stops, fmi2Real stop)
{
    ASK(INSTANTIATED)
    ((Instance *)self)->now.start = start;
    return fmi2OK;
}

STATUS(fmi2EnterInitializationMode)(fmi2Component self)
{
    ASK(INSTANTIATED)
    return (fmi2Status)enter_initialization(self, ((Instance *)self)->now.start);
}

STATUS(fmi2DoStep)(fmi2Component self, fmi2Real t, fmi2Real h, fmi2Boolean forward)
{
    ASK(STEPPING)
    return (fmi2Status)advance(self, t, h);
}

STATUS(fmi2CancelStep)(fmi2Component self)
{
    ASK(0)
    return fmi2Error;
}

STATUS(fmi2GetReal)(fmi2Component self, const fmi2ValueReference references[], size_t many, fmi2Real values[])
{
    ASK(ALWAYS)
    return (fmi2Status)get_values(self, references, many, values, many);
}

STATUS(fmi2SetReal)(fmi2Component self, const fmi2ValueReference references[], size_t many, const fmi2Real values[])
{
    ASK(INSTANTIATED | INITIALIZATION | STEPPING)
    return (fmi2Status)set_values(self, references, many, values, many);
}

STATUS(fmi2GetBoolean)(fmi2Component self, const fmi2ValueReference references[], size_t many, fmi2Boolean values[])
{
    ASK(ALWAYS)
    return get_flags(self, references, many, values, many);
}

/* The status of a step that runs in the background; here none does. */
STATUS(fmi2GetRealStatus)(fmi2Component self, const fmi2StatusKind kind, fmi2Real *value)
{
    ASK(ALWAYS)
    if (kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = ((Instance *)self)->now.values[AT_TIME];
    return fmi2OK;
}

STATUS(fmi2GetBooleanStatus)(fmi2Component self, const fmi2StatusKind kind, fmi2Boolean *value)
{
    ASK(ALWAYS)
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = 0; /* a refused step ends nothing */
    return fmi2OK;
}

#define NO_STATUS(name, Value)                                                                                         \
    STATUS(name)(fmi2Component self, const fmi2StatusKind kind, Value *value)                                          \
    {                                                                                                                  \
        return self == NULL ? fmi2Error : fmi2Discard;                                                                 \
    }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetStringStatus, fmi2String)

#define REFERENCES fmi2Component self, const fmi2ValueReference references[], size_t many
UNSUPPORTED(fmi2GetInteger, many, REFERENCES, fmi2Integer values[])
UNSUPPORTED(fmi2SetInteger, many, REFERENCES, const fmi2Integer values[])
UNSUPPORTED(fmi2GetString, many, REFERENCES, fmi2String values[])
UNSUPPORTED(fmi2SetString, many, REFERENCES, const fmi2String values[])
UNSUPPORTED(fmi2SetBoolean, many, REFERENCES, const fmi2Boolean values[])
UNSUPPORTED(fmi2SetRealInputDerivatives, many, REFERENCES, const fmi2Integer orders[], const fmi2Real values[])
UNSUPPORTED(fmi2GetRealOutputDerivatives, many, REFERENCES, const fmi2Integer orders[], fmi2Real values[])
UNSUPPORTED(fmi2GetDirectionalDerivative, 1, REFERENCES, const fmi2ValueReference knowns[], size_t of,
            const fmi2Real seed[], fmi2Real values[])
