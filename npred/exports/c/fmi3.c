/* The functions of FMI 3.0 for co-simulation around one instance of the controller. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "instance.h"

#ifndef fmi3Functions_h /* without the standard's header these are its types, as far as they are used here */
typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8, fmi3Byte;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef const uint8_t *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent
} fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3ClockUpdateCallback)(fmi3InstanceEnvironment);
typedef void (*fmi3LockPreemptionCallback)(void);
typedef void (*fmi3UnlockPreemptionCallback)(void);
typedef void (*fmi3IntermediateUpdateCallback)(fmi3InstanceEnvironment, fmi3Float64, fmi3Boolean, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean *, fmi3Float64 *);
#ifdef FMI3_FUNCTION_PREFIX
#define PREFIXED FMI3_FUNCTION_PREFIX
#endif
#endif

#define FMI(name) fmi3##name
#define COMPONENT fmi3Instance
#define STATE(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState
#include "calls.h"

EXPORTED const char *NAMED(fmi3GetVersion)(void)
{
    return "3.0";
}

static void log_3(Instance *self, int status, const char *message)
{
    const fmi3LogMessageCallback log = (fmi3LogMessageCallback)self->callback;
    log(self->environment, (fmi3Status)status, category(status), message);
}

EXPORTED fmi3Instance NAMED(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference intermediate[], size_t many,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    Instance *self = many == 0 ? create(name, token) : NULL;
    if (self != NULL) {
        self->environment = environment;
        self->callback = (void (*)(void))log;
        self->log = log_3;
    } else if (log != NULL) {
        log(environment, fmi3Error, "logStatusError",
            "instantiate: expected this FMU's token and no intermediate access");
    }
    return self;
}

EXPORTED fmi3Instance NAMED(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                          fmi3Boolean visible, fmi3Boolean logging,
                                                          fmi3InstanceEnvironment environment,
                                                          fmi3LogMessageCallback log)
{
    if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", "instantiate: this FMU is for co-simulation");
    }
    return NULL;
}

EXPORTED fmi3Instance NAMED(fmi3InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    return NAMED(fmi3InstantiateModelExchange)(name, token, resources, visible, logging, environment, log);
}

STATUS(fmi3EnterInitializationMode)(fmi3Instance self, fmi3Boolean tolerates, fmi3Float64 tolerance, fmi3Float64 start,
                                    fmi3Boolean stops, fmi3Float64 stop)
{
    ASK(INSTANTIATED)
    return (fmi3Status)enter_initialization(self, start);
}

STATUS(fmi3DoStep)(fmi3Instance self, fmi3Float64 t, fmi3Float64 h, fmi3Boolean forward, fmi3Boolean *events,
                   fmi3Boolean *terminates, fmi3Boolean *early, fmi3Float64 *reached)
{
    ASK(STEPPING)
    const int status = advance(self, t, h);
    *events = *terminates = *early = false;
    *reached = ((Instance *)self)->now.values[AT_TIME];
    return (fmi3Status)status;
}

#define REFERENCES fmi3Instance self, const fmi3ValueReference references[], size_t many
STATUS(fmi3GetFloat64)(REFERENCES, fmi3Float64 values[], size_t size)
{
    ASK(ALWAYS)
    return (fmi3Status)get_values(self, references, many, values, size);
}

STATUS(fmi3SetFloat64)(REFERENCES, const fmi3Float64 values[], size_t size)
{
    ASK(INSTANTIATED | INITIALIZATION | STEPPING)
    return (fmi3Status)set_values(self, references, many, values, size);
}

STATUS(fmi3GetBoolean)(REFERENCES, fmi3Boolean values[], size_t size)
{
    ASK(ALWAYS)
    return get_flags(self, references, many, values, size);
}

#define NO_TYPE(Type)                                                                                                  \
    UNSUPPORTED(fmi3Get##Type, many + size, REFERENCES, fmi3##Type values[], size_t size)                              \
    UNSUPPORTED(fmi3Set##Type, many + size, REFERENCES, const fmi3##Type values[], size_t size)
NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(Int64)
NO_TYPE(UInt64)
NO_TYPE(String)
UNSUPPORTED(fmi3SetBoolean, many + size, REFERENCES, const fmi3Boolean values[], size_t size)
UNSUPPORTED(fmi3GetBinary, many + size, REFERENCES, size_t sizes[], fmi3Binary values[], size_t size)
UNSUPPORTED(fmi3SetBinary, many + size, REFERENCES, const size_t sizes[], const fmi3Binary values[], size_t size)

UNSUPPORTED(fmi3GetClock, many, REFERENCES, fmi3Clock values[])
UNSUPPORTED(fmi3SetClock, many, REFERENCES, const fmi3Clock values[])
UNSUPPORTED(fmi3GetIntervalDecimal, many, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
UNSUPPORTED(fmi3SetIntervalDecimal, many, REFERENCES, const fmi3Float64 intervals[])
UNSUPPORTED(fmi3GetIntervalFraction, many, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
            fmi3IntervalQualifier qualifiers[])
UNSUPPORTED(fmi3SetIntervalFraction, many, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
UNSUPPORTED(fmi3GetShiftDecimal, many, REFERENCES, fmi3Float64 shifts[])
UNSUPPORTED(fmi3SetShiftDecimal, many, REFERENCES, const fmi3Float64 shifts[])
UNSUPPORTED(fmi3GetShiftFraction, many, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
UNSUPPORTED(fmi3SetShiftFraction, many, REFERENCES, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

UNSUPPORTED(fmi3GetNumberOfVariableDependencies, 1, fmi3Instance self, fmi3ValueReference reference, size_t *many)
UNSUPPORTED(fmi3GetVariableDependencies, 1, fmi3Instance self, fmi3ValueReference dependent, size_t elements[],
            fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[], size_t many)
UNSUPPORTED(fmi3GetDirectionalDerivative, 1, REFERENCES, const fmi3ValueReference of[], size_t knowns,
            const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetAdjointDerivative, 1, REFERENCES, const fmi3ValueReference of[], size_t knowns,
            const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetOutputDerivatives, many, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3EvaluateDiscreteStates, 1, fmi3Instance self)
UNSUPPORTED(fmi3UpdateDiscreteStates, 1, fmi3Instance self, fmi3Boolean *again, fmi3Boolean *terminates,
            fmi3Boolean *nominals, fmi3Boolean *states, fmi3Boolean *defined, fmi3Float64 *next)

/* Functions of the other kinds of FMU: some importers look up all functions before they call one. */
#define NO_MODE(name)                                                                                                  \
    STATUS(name)(fmi3Instance self)                                                                                    \
    {                                                                                                                  \
        ASK(0)                                                                                                         \
        return fmi3Error;                                                                                              \
    }
NO_MODE(fmi3EnterEventMode)
NO_MODE(fmi3EnterStepMode)
NO_MODE(fmi3EnterConfigurationMode)
NO_MODE(fmi3ExitConfigurationMode)
UNSUPPORTED(fmi3EnterContinuousTimeMode, 1, fmi3Instance self)
UNSUPPORTED(fmi3CompletedIntegratorStep, 1, fmi3Instance self, fmi3Boolean forward, fmi3Boolean *events,
            fmi3Boolean *terminates)
UNSUPPORTED(fmi3SetTime, 1, fmi3Instance self, fmi3Float64 time)
UNSUPPORTED(fmi3SetContinuousStates, size, fmi3Instance self, const fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetContinuousStateDerivatives, size, fmi3Instance self, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetEventIndicators, size, fmi3Instance self, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetContinuousStates, size, fmi3Instance self, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates, size, fmi3Instance self, fmi3Float64 values[], size_t size)
UNSUPPORTED(fmi3ActivateModelPartition, 1, fmi3Instance self, fmi3ValueReference clock, fmi3Float64 time)

#define NO_COUNT(name)                                                                                                 \
    STATUS(name)(fmi3Instance self, size_t *size)                                                                      \
    {                                                                                                                  \
        *size = 0;                                                                                                     \
        return self == NULL ? fmi3Error : fmi3OK;                                                                      \
    }
NO_COUNT(fmi3GetNumberOfEventIndicators)
NO_COUNT(fmi3GetNumberOfContinuousStates)
