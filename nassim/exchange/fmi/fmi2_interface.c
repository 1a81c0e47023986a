/* FMI 2.0 interface of a model, for co-simulation or model exchange (MODEL_EXCHANGE). */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "instance.h"

typedef struct {
    model_values values;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
    fmi2CallbackFreeMemory release;
    fmi2CallbackAllocateMemory allocate;
    char name[128];
} instance;

static fmi2Status failed(instance *m, fmi2Status status, const char *message)
{
    if (m->log)
        m->log(m->environment, m->name, status, status == fmi2Error ? "logStatusError" : "logStatusDiscard", message);
    return status;
}

/* Log the warnings of a call, and what was wrong, if anything: a failure of the run, or something of another status. */
static fmi2Status outcome(instance *m, fmi2Status status, const char *wrong)
{
    char *warnings = warnings_of(&m->values);
    if (warnings && *warnings && m->log)
        m->log(m->environment, m->name, fmi2Warning, "logStatusWarning", warnings);
    if (warnings)
        *warnings = 0;
    if (!wrong)
        return fmi2OK;
    return failed(m, failure_of(&m->values) ? fmi2Error : status, wrong);
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    const char *wrong = NULL;
    instance *m;
    (void)visible, (void)logging;
    if (!guid || strcmp(guid, FMU_TOKEN) != 0)
        wrong = "the GUID is not that of this FMU";
    else if (type != (MODEL_EXCHANGE ? fmi2ModelExchange : fmi2CoSimulation))
        wrong = MODEL_EXCHANGE ? "this FMU is for model exchange only" : "this FMU is for co-simulation only";
    if (wrong) {
        if (functions && functions->logger)
            functions->logger(functions->componentEnvironment, name, fmi2Error, "logStatusError", wrong);
        return NULL;
    }
    m = functions && functions->allocateMemory ? functions->allocateMemory(1, sizeof *m) : calloc(1, sizeof *m);
    if (!m)
        return NULL;
    if (functions) {
        m->log = functions->logger;
        m->environment = functions->componentEnvironment;
        m->allocate = functions->allocateMemory;
        m->release = functions->freeMemory;
    }
    if (name)
        strncpy(m->name, name, sizeof m->name - 1);
    reset_values(&m->values);
    locate_resources(&m->values, resources);
    return m;
}

static void *allocated(instance *m, size_t size)
{
    return m->allocate ? m->allocate(1, size) : calloc(1, size);
}

static void release(instance *m, void *memory)
{
    if (m->allocate && m->release)
        m->release(memory);
    else if (!m->allocate)
        free(memory);
}

void fmi2FreeInstance(fmi2Component c)
{
    if (c) {
        reset_values(&((instance *)c)->values);
        release(c, c);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    start_at(&((instance *)c)->values, start);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return outcome(c, fmi2Error, finish_initialization(&((instance *)c)->values));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    finish_run(&((instance *)c)->values);
    return outcome(c, fmi2Error, failure_of(&((instance *)c)->values));
}

fmi2Status fmi2Reset(fmi2Component c)
{
    reset_values(&((instance *)c)->values);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    instance *m = c;
    size_t k;
    const char *wrong = NULL;
    for (k = 0; k < n && !wrong; k++)
        wrong = get_value(&m->values, vr[k], &value[k]);
    return outcome(m, fmi2Error, wrong);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    instance *m = c;
    size_t k;
    const char *wrong = NULL;
    for (k = 0; k < n && !wrong; k++)
        wrong = set_value(&m->values, vr[k], value[k]);
    return outcome(m, fmi2Error, wrong);
}

/* Variables of other types: there are none. */
#define NONE(name, type)                                                                                               \
    fmi2Status name(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[])                            \
    {                                                                                                                  \
        (void)vr, (void)value;                                                                                         \
        return n ? failed(c, fmi2Error, "all variables are Real") : fmi2OK;                                            \
    }

NONE(fmi2GetInteger, fmi2Integer)
NONE(fmi2GetBoolean, fmi2Boolean)
NONE(fmi2GetString, fmi2String)
NONE(fmi2SetInteger, const fmi2Integer)
NONE(fmi2SetBoolean, const fmi2Boolean)
NONE(fmi2SetString, const fmi2String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *m = c;
    if (MODEL_IN_PYTHON)
        return failed(m, fmi2Error, "the state of a run in Python cannot be saved");
    if (!*state)
        *state = allocated(m, sizeof m->values);
    if (!*state)
        return failed(m, fmi2Error, "out of memory");
    memcpy(*state, &m->values, sizeof m->values);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    instance *m = c;
    memcpy(&m->values, state, sizeof m->values);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (state && *state) {
        release(c, *state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(model_values);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < sizeof(model_values))
        return failed(c, fmi2Error, "too few bytes for a state");
    memcpy(bytes, state, sizeof(model_values));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (MODEL_IN_PYTHON || size != sizeof(model_values))
        return failed(c, fmi2Error, "these bytes are no state of this FMU");
    if (!*state)
        *state = allocated(c, size);
    if (!*state)
        return failed(c, fmi2Error, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real given[],
                                        fmi2Real found[])
{
    (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)given, (void)found;
    return failed(c, fmi2Error, "directional derivatives are not provided");
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)c;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set, fmi2Boolean *event, fmi2Boolean *terminate)
{
    (void)c, (void)no_set;
    *event = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ((instance *)c)->values.time = time;
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    (void)c, (void)indicators;
    return n ? fmi2Error : fmi2OK;
}

#if MODEL_EXCHANGE
static fmi2Status copied(fmi2Component c, double *to, const double *from, size_t n)
{
    if (n != MODEL_STATES)
        return failed(c, fmi2Error, "wrong number of states");
    memcpy(to, from, n * sizeof *to);
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    instance *m = c;
    m->values.fresh = 0;
    return copied(c, m->values.x, x, n);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real rates[], size_t n)
{
    instance *m = c;
    update_values(&m->values);
    return copied(c, rates, m->values.rate, n);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    return copied(c, x, ((instance *)c)->values.x, n);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t n)
{
    return copied(c, nominal, ((instance *)c)->values.size, n);
}
#else
#define NO_STATES(name, type)                                                                                          \
    fmi2Status name(fmi2Component c, type x[], size_t n)                                                               \
    {                                                                                                                  \
        (void)x, (void)n;                                                                                              \
        return failed(c, fmi2Error, "this FMU is for co-simulation only");                                             \
    }

NO_STATES(fmi2SetContinuousStates, const fmi2Real)
NO_STATES(fmi2GetDerivatives, fmi2Real)
NO_STATES(fmi2GetContinuousStates, fmi2Real)
NO_STATES(fmi2GetNominalsOfContinuousStates, fmi2Real)
#endif

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real from, fmi2Real size, fmi2Boolean no_set)
{
    (void)no_set;
#if MODEL_EXCHANGE
    (void)from, (void)size;
    return failed(c, fmi2Error, "this FMU is for model exchange only");
#else
    const char *wrong = do_steps(&((instance *)c)->values, from, size);
    return outcome(c, fmi2Discard, wrong);
#endif
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return failed(c, fmi2Error, "no step is pending");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return failed(c, fmi2Error, "derivatives of inputs are not used");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)n, (void)order, (void)value;
    return failed(c, fmi2Error, "derivatives of outputs are not provided");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind;
    *value = fmi2OK;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    *value = ((instance *)c)->values.time;
    return kind == fmi2LastSuccessfulTime ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c;
    *value = fmi2False;
    return kind == fmi2Terminated ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind;
    *value = "";
    return fmi2Discard;
}
