/*
 * The functions that FMI 2.0 and FMI 3.0 have in common. Before they include it, fmi2.c and fmi3.c define how they
 * spell names: FMI(name), COMPONENT for the type, STATE(before, after) around the word for the state, DESERIALIZE, and
 * PREFIXED where the FMU is linked from its sources.
 */
#ifdef PREFIXED
#define JOINED_(a, b) a##b
#define JOINED(a, b) JOINED_(a, b)
#define NAMED(name) JOINED(PREFIXED, name)
#else
#define NAMED(name) name
#endif

#define STATUS(name) EXPORTED FMI(Status) NAMED(name)
#define ASK(modes)                                                                                                     \
    if (!allowed(self, modes, __func__)) {                                                                             \
        return FMI(Error);                                                                                             \
    }
/* A function for a feature that the FMU does not have. `asked` is the number of variables in the call. */
#define UNSUPPORTED(name, asked, ...)                                                                                  \
    STATUS(name)(__VA_ARGS__)                                                                                          \
    {                                                                                                                  \
        return (FMI(Status))unsupported(self, __func__, asked);                                                        \
    }

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* the standard passes many that a controller does not need */
#endif

STATUS(FMI(SetDebugLogging))(COMPONENT self, FMI(Boolean) on, size_t many, const FMI(String) categories[])
{
    return self == NULL ? FMI(Error) : FMI(OK);
}

EXPORTED void NAMED(FMI(FreeInstance))(COMPONENT self)
{
    free(self);
}

STATUS(FMI(ExitInitializationMode))(COMPONENT self)
{
    ASK(INITIALIZATION)
    return (FMI(Status))exit_initialization(self);
}

STATUS(FMI(Terminate))(COMPONENT self)
{
    ASK(STEPPING)
    ((Instance *)self)->now.mode = TERMINATED;
    return FMI(OK);
}

STATUS(FMI(Reset))(COMPONENT self)
{
    ASK(ALWAYS)
    reset(self);
    return FMI(OK);
}

static FMI(Status) get_flags(Instance *self, const FMI(ValueReference) references[], size_t many,
                             FMI(Boolean) values[], size_t size)
{
    if (count(references, many, 1) != (long long)size) {
        return (FMI(Status))report(self, ERROR, "get: expected Boolean variables of this FMU, got others");
    }
    for (size_t i = 0; i < many; i++) {
        values[i] = self->now.values[variables[references[i]].first] > 0;
    }
    return FMI(OK);
}

STATUS(STATE(Get, ))(COMPONENT self, STATE(, ) *state)
{
    ASK(ALWAYS)
    return (FMI(Status))get_state(self, state);
}

STATUS(STATE(Set, ))(COMPONENT self, STATE(, ) state)
{
    ASK(ALWAYS)
    return (FMI(Status))set_state(self, state);
}

STATUS(STATE(Free, ))(COMPONENT self, STATE(, ) *state)
{
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
    return self == NULL ? FMI(Error) : FMI(OK);
}

STATUS(STATE(Serialized, Size))(COMPONENT self, STATE(, ) state, size_t *size)
{
    ASK(ALWAYS)
    *size = sizeof(State);
    return FMI(OK);
}

STATUS(STATE(Serialize, ))(COMPONENT self, STATE(, ) state, FMI(Byte) bytes[], size_t size)
{
    ASK(ALWAYS)
    return (FMI(Status))serialize(self, state, bytes, size);
}

STATUS(DESERIALIZE)(COMPONENT self, const FMI(Byte) bytes[], size_t size, STATE(, ) *state)
{
    ASK(ALWAYS)
    return (FMI(Status))deserialize(self, bytes, size, state);
}
