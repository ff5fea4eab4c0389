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
#ifdef FMI3_FUNCTION_PREFIX /* of an FMU that is linked from its sources */
#define JOINED_(a, b) a##b
#define JOINED(a, b) JOINED_(a, b)
#define NAMED(name) JOINED(FMI3_FUNCTION_PREFIX, name)
#else
#define NAMED(name) name
#endif
#else
#define NAMED(name) name
#endif

#define STATUS(name) EXPORTED fmi3Status NAMED(name)
#define ASK(modes, call)                                                                                               \
    if (!allowed(self, modes, call)) {                                                                                 \
        return fmi3Error;                                                                                              \
    }

#define REFUSED(call) return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, call, 1);

EXPORTED const char *NAMED(fmi3GetVersion)(void)
{
    return "3.0";
}

static void log_3(Instance *self, int status, const char *message)
{
    if (self->callback != NULL) {
        ((fmi3LogMessageCallback)self->callback)(self->environment, (fmi3Status)status,
                                                 category(status), message);
    }
}

STATUS(fmi3SetDebugLogging)(fmi3Instance self, fmi3Boolean on, size_t many, const fmi3String categories[])
{
    (void)on;
    (void)many;
    (void)categories;
    return self == NULL ? fmi3Error : fmi3OK;
}

EXPORTED fmi3Instance NAMED(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference intermediate[], size_t many,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)intermediate, (void)update;
    Instance *self = many == 0 ? create(name, token) : NULL;
    if (self != NULL) {
        self->environment = environment;
        self->callback = (void (*)(void))log;
        self->log = log_3;
    } else if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", "instantiate: expected this FMU's token and no intermediate access");
    }
    return self;
}

EXPORTED fmi3Instance NAMED(fmi3InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                                          fmi3Boolean visible, fmi3Boolean logging,
                                                          fmi3InstanceEnvironment environment,
                                                          fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
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
    (void)update, (void)lock, (void)unlock;
    return NAMED(fmi3InstantiateModelExchange)(name, token, resources, visible, logging, environment, log);
}

EXPORTED void NAMED(fmi3FreeInstance)(fmi3Instance self)
{
    destroy(self);
}

STATUS(fmi3EnterInitializationMode)(fmi3Instance self, fmi3Boolean tolerates, fmi3Float64 tolerance, fmi3Float64 start,
                                    fmi3Boolean stops, fmi3Float64 stop)
{
    (void)tolerates, (void)tolerance, (void)stops, (void)stop;
    ASK(INSTANTIATED, "fmi3EnterInitializationMode")
    return (fmi3Status)enter_initialization(self, start);
}

STATUS(fmi3ExitInitializationMode)(fmi3Instance self)
{
    ASK(INITIALIZATION, "fmi3ExitInitializationMode")
    return (fmi3Status)exit_initialization(self);
}

STATUS(fmi3EnterEventMode)(fmi3Instance self)
{
    ASK(0, "fmi3EnterEventMode")
    return fmi3Error;
}

STATUS(fmi3EnterStepMode)(fmi3Instance self)
{
    ASK(0, "fmi3EnterStepMode")
    return fmi3Error;
}

STATUS(fmi3EnterConfigurationMode)(fmi3Instance self)
{
    ASK(0, "fmi3EnterConfigurationMode")
    return fmi3Error;
}

STATUS(fmi3ExitConfigurationMode)(fmi3Instance self)
{
    ASK(0, "fmi3ExitConfigurationMode")
    return fmi3Error;
}

STATUS(fmi3Terminate)(fmi3Instance self)
{
    ASK(STEPPING, "fmi3Terminate")
    ((Instance *)self)->now.mode = TERMINATED;
    return fmi3OK;
}

STATUS(fmi3Reset)(fmi3Instance self)
{
    ASK(ALWAYS, "fmi3Reset")
    reset(self);
    return fmi3OK;
}

STATUS(fmi3DoStep)(fmi3Instance self, fmi3Float64 t, fmi3Float64 h, fmi3Boolean forward, fmi3Boolean *events,
                   fmi3Boolean *terminates, fmi3Boolean *early, fmi3Float64 *reached)
{
    (void)forward;
    ASK(STEPPING, "fmi3DoStep")
    const int status = advance(self, t, h);
    *events = *terminates = *early = false;
    *reached = ((Instance *)self)->now.values[AT_TIME];
    return (fmi3Status)status;
}

STATUS(fmi3GetFloat64)(fmi3Instance self, const fmi3ValueReference references[], size_t many, fmi3Float64 values[],
                       size_t size)
{
    ASK(ALWAYS, "fmi3GetFloat64")
    return (fmi3Status)get_values(self, references, many, values, size);
}

STATUS(fmi3SetFloat64)(fmi3Instance self, const fmi3ValueReference references[], size_t many,
                       const fmi3Float64 values[], size_t size)
{
    ASK(INSTANTIATED | INITIALIZATION | STEPPING, "fmi3SetFloat64")
    return (fmi3Status)set_values(self, references, many, values, size);
}

STATUS(fmi3GetBoolean)(fmi3Instance self, const fmi3ValueReference references[], size_t many, fmi3Boolean values[],
                       size_t size)
{
    ASK(ALWAYS, "fmi3GetBoolean")
    if (count(references, many, 1) != (long long)size) {
        return (fmi3Status)report(self, ERROR, "get: expected known Boolean variables, got others");
    }
    for (size_t i = 0; i < many; i++) {
        values[i] = ((Instance *)self)->now.values[variables[references[i]].first] > 0;
    }
    return fmi3OK;
}

#define NONE(call, Values)                                                                                             \
    STATUS(call)(fmi3Instance self, const fmi3ValueReference references[], size_t many, Values values[], size_t size)  \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, many + size);                           \
    }
#define NO_GET_OR_SET(Type) NONE(fmi3Get##Type, fmi3##Type) NONE(fmi3Set##Type, const fmi3##Type)
NO_GET_OR_SET(Float32)
NO_GET_OR_SET(Int8)
NO_GET_OR_SET(UInt8)
NO_GET_OR_SET(Int16)
NO_GET_OR_SET(UInt16)
NO_GET_OR_SET(Int32)
NO_GET_OR_SET(UInt32)
NO_GET_OR_SET(Int64)
NO_GET_OR_SET(UInt64)
NO_GET_OR_SET(String)
NONE(fmi3SetBoolean, const fmi3Boolean)

#define NO_BINARY(call, Sizes, Values)                                                                                 \
    STATUS(call)(fmi3Instance self, const fmi3ValueReference references[], size_t many, Sizes sizes[],                 \
                 Values values[], size_t size)                                                                         \
    {                                                                                                                  \
        (void)references, (void)sizes, (void)values;                                                                   \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, many + size);                           \
    }
NO_BINARY(fmi3GetBinary, size_t, fmi3Binary)
NO_BINARY(fmi3SetBinary, const size_t, const fmi3Binary)

#define NO_CLOCK(call, Values)                                                                                         \
    STATUS(call)(fmi3Instance self, const fmi3ValueReference references[], size_t many, Values values[])               \
    {                                                                                                                  \
        (void)references, (void)values;                                                                                \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, many);                                  \
    }
#define NO_CLOCKS(call, A, B)                                                                                          \
    STATUS(call)(fmi3Instance self, const fmi3ValueReference references[], size_t many, A a[], B b[])                  \
    {                                                                                                                  \
        (void)references, (void)a, (void)b;                                                                            \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, many);                                  \
    }
NO_CLOCK(fmi3GetClock, fmi3Clock)
NO_CLOCK(fmi3SetClock, const fmi3Clock)
NO_CLOCKS(fmi3GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_CLOCK(fmi3GetShiftDecimal, fmi3Float64)
NO_CLOCKS(fmi3GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCK(fmi3SetIntervalDecimal, const fmi3Float64)
NO_CLOCKS(fmi3SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCK(fmi3SetShiftDecimal, const fmi3Float64)
NO_CLOCKS(fmi3SetShiftFraction, const fmi3UInt64, const fmi3UInt64)

STATUS(fmi3GetIntervalFraction)(fmi3Instance self, const fmi3ValueReference references[], size_t many,
                                fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)references, (void)counters, (void)resolutions, (void)qualifiers;
    return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, "fmi3GetIntervalFraction", many);
}

STATUS(fmi3GetNumberOfVariableDependencies)(fmi3Instance self, fmi3ValueReference reference, size_t *many)
{
    (void)reference, (void)many;
    REFUSED("fmi3GetNumberOfVariableDependencies")
}

STATUS(fmi3GetVariableDependencies)(fmi3Instance self, fmi3ValueReference dependent, size_t elements[],
                                    fmi3ValueReference independents[], size_t others[], fmi3DependencyKind kinds[],
                                    size_t many)
{
    (void)dependent, (void)elements, (void)independents, (void)others, (void)kinds, (void)many;
    REFUSED("fmi3GetVariableDependencies")
}

#define NO_DERIVATIVE(call)                                                                                            \
    STATUS(call)(fmi3Instance self, const fmi3ValueReference unknowns[], size_t many, const fmi3ValueReference of[],   \
                 size_t knowns, const fmi3Float64 seed[], size_t seeds, fmi3Float64 values[], size_t size)             \
    {                                                                                                                  \
        (void)unknowns, (void)many, (void)of, (void)knowns, (void)seed, (void)seeds, (void)values, (void)size;         \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, 1);                                     \
    }
NO_DERIVATIVE(fmi3GetDirectionalDerivative)
NO_DERIVATIVE(fmi3GetAdjointDerivative)

STATUS(fmi3GetOutputDerivatives)(fmi3Instance self, const fmi3ValueReference references[], size_t many,
                                 const fmi3Int32 orders[], fmi3Float64 values[], size_t size)
{
    (void)references, (void)orders, (void)values, (void)size;
    return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, "fmi3GetOutputDerivatives", many);
}

STATUS(fmi3EvaluateDiscreteStates)(fmi3Instance self)
{
    REFUSED("fmi3EvaluateDiscreteStates")
}

STATUS(fmi3UpdateDiscreteStates)(fmi3Instance self, fmi3Boolean *again, fmi3Boolean *terminates, fmi3Boolean *nominals,
                                 fmi3Boolean *states, fmi3Boolean *defined, fmi3Float64 *next)
{
    (void)again, (void)terminates, (void)nominals, (void)states, (void)defined, (void)next;
    REFUSED("fmi3UpdateDiscreteStates")
}


STATUS(fmi3GetFMUState)(fmi3Instance self, fmi3FMUState *state)
{
    ASK(ALWAYS, "fmi3GetFMUState")
    return (fmi3Status)get_state(self, state);
}

STATUS(fmi3SetFMUState)(fmi3Instance self, fmi3FMUState state)
{
    ASK(ALWAYS, "fmi3SetFMUState")
    return (fmi3Status)set_state(self, state);
}

STATUS(fmi3FreeFMUState)(fmi3Instance self, fmi3FMUState *state)
{
    free_state(state);
    return self == NULL ? fmi3Error : fmi3OK;
}

STATUS(fmi3SerializedFMUStateSize)(fmi3Instance self, fmi3FMUState state, size_t *size)
{
    ASK(ALWAYS, "fmi3SerializedFMUStateSize")
    (void)state;
    *size = sizeof(State);
    return fmi3OK;
}

STATUS(fmi3SerializeFMUState)(fmi3Instance self, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    ASK(ALWAYS, "fmi3SerializeFMUState")
    return (fmi3Status)serialize(self, state, bytes, size);
}

STATUS(fmi3DeserializeFMUState)(fmi3Instance self, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    ASK(ALWAYS, "fmi3DeserializeFMUState")
    return (fmi3Status)deserialize(self, bytes, size, state);
}

/* Those of the other kinds of FMU: some importers look all functions up before they call any. */
STATUS(fmi3EnterContinuousTimeMode)(fmi3Instance self)
{
    REFUSED("fmi3EnterContinuousTimeMode")
}

STATUS(fmi3CompletedIntegratorStep)(fmi3Instance self, fmi3Boolean forward, fmi3Boolean *events,
                                    fmi3Boolean *terminates)
{
    (void)forward, (void)events, (void)terminates;
    REFUSED("fmi3CompletedIntegratorStep")
}

STATUS(fmi3SetTime)(fmi3Instance self, fmi3Float64 time)
{
    (void)time;
    REFUSED("fmi3SetTime")
}

#define NO_STATES(call, Values)                                                                                        \
    STATUS(call)(fmi3Instance self, Values values[], size_t size)                                                      \
    {                                                                                                                  \
        (void)values;                                                                                                  \
        return self == NULL ? fmi3Error : (fmi3Status)unsupported(self, #call, size);                                  \
    }
NO_STATES(fmi3SetContinuousStates, const fmi3Float64)
NO_STATES(fmi3GetContinuousStateDerivatives, fmi3Float64)
NO_STATES(fmi3GetEventIndicators, fmi3Float64)
NO_STATES(fmi3GetContinuousStates, fmi3Float64)
NO_STATES(fmi3GetNominalsOfContinuousStates, fmi3Float64)

#define NO_COUNT(call)                                                                                                 \
    STATUS(call)(fmi3Instance self, size_t *size)                                                                      \
    {                                                                                                                  \
        *size = 0;                                                                                                     \
        return self == NULL ? fmi3Error : fmi3OK;                                                                      \
    }
NO_COUNT(fmi3GetNumberOfEventIndicators)
NO_COUNT(fmi3GetNumberOfContinuousStates)

STATUS(fmi3ActivateModelPartition)(fmi3Instance self, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    REFUSED("fmi3ActivateModelPartition")
}
