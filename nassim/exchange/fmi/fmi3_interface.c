/* FMI 3.0 interface of a model, for co-simulation or model exchange (MODEL_EXCHANGE). */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "instance.h"

typedef struct {
    model_values values;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
} instance;

static fmi3Status failed(instance *m, fmi3Status status, const char *message)
{
    if (m->log)
        m->log(m->environment, status, status == fmi3Error ? "logStatusError" : "logStatusDiscard", message);
    return status;
}

/* Log the warnings of a call, and what was wrong, if anything: a failure of the run, or something of another status. */
static fmi3Status outcome(instance *m, fmi3Status status, const char *wrong)
{
    char *warnings = warnings_of(&m->values);
    if (warnings && *warnings && m->log)
        m->log(m->environment, fmi3Warning, "logStatusWarning", warnings);
    if (warnings)
        *warnings = 0;
    if (!wrong)
        return fmi3OK;
    return failed(m, failure_of(&m->values) ? fmi3Error : status, wrong);
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

static fmi3Instance created(int fits, fmi3String token, fmi3String resources, fmi3InstanceEnvironment environment,
                            fmi3LogMessageCallback log)
{
    const char *wrong = NULL;
    instance *m;
    if (!token || strcmp(token, FMU_TOKEN) != 0)
        wrong = "the instantiation token is not that of this FMU";
    else if (!fits)
        wrong = MODEL_EXCHANGE ? "this FMU is for model exchange only" : "this FMU is for co-simulation only";
    if (wrong) {
        if (log)
            log(environment, fmi3Error, "logStatusError", wrong);
        return NULL;
    }
    m = calloc(1, sizeof *m);
    if (!m)
        return NULL;
    m->log = log;
    m->environment = environment;
    reset_values(&m->values);
    locate_resources(&m->values, resources);
    return m;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    (void)name, (void)visible, (void)logging;
    return created(MODEL_EXCHANGE, token, resources, environment, log);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n_required,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)visible, (void)logging, (void)events, (void)early, (void)required;
    (void)n_required, (void)update;
    return created(!MODEL_EXCHANGE, token, resources, environment, log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    return created(0, token, resources, environment, log);
}

void fmi3FreeInstance(fmi3Instance c)
{
    if (c)
        reset_values(&((instance *)c)->values);
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    start_at(&((instance *)c)->values, start);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    return outcome(c, fmi3Error, finish_initialization(&((instance *)c)->values));
}

/* Changes of mode that need nothing */
#define NOTHING(name)                                                                                                  \
    fmi3Status name(fmi3Instance c)                                                                                    \
    {                                                                                                                  \
        (void)c;                                                                                                       \
        return fmi3OK;                                                                                                 \
    }

NOTHING(fmi3EnterEventMode)
NOTHING(fmi3EvaluateDiscreteStates)
NOTHING(fmi3EnterContinuousTimeMode)
NOTHING(fmi3EnterStepMode)
NOTHING(fmi3EnterConfigurationMode)
NOTHING(fmi3ExitConfigurationMode)

fmi3Status fmi3Terminate(fmi3Instance c)
{
    finish_run(&((instance *)c)->values);
    return outcome(c, fmi3Error, failure_of(&((instance *)c)->values));
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    reset_values(&((instance *)c)->values);
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t n_values)
{
    instance *m = c;
    size_t k;
    const char *wrong = NULL;
    if (n != n_values)
        return failed(m, fmi3Error, "all variables are scalars: as many values as value references");
    for (k = 0; k < n && !wrong; k++)
        wrong = get_value(&m->values, vr[k], &values[k]);
    return outcome(m, fmi3Error, wrong);
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[],
                          size_t n_values)
{
    instance *m = c;
    size_t k;
    const char *wrong = NULL;
    if (n != n_values)
        return failed(m, fmi3Error, "all variables are scalars: as many values as value references");
    for (k = 0; k < n && !wrong; k++)
        wrong = set_value(&m->values, vr[k], values[k]);
    return outcome(m, fmi3Error, wrong);
}

/* Variables of other types: there are none. */
#define NONE(name, type)                                                                                               \
    fmi3Status name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type values[], size_t n_values)           \
    {                                                                                                                  \
        (void)vr, (void)values, (void)n_values;                                                                        \
        return n ? failed(c, fmi3Error, "all variables are Float64") : fmi3OK;                                         \
    }

NONE(fmi3GetFloat32, fmi3Float32)
NONE(fmi3GetInt8, fmi3Int8)
NONE(fmi3GetUInt8, fmi3UInt8)
NONE(fmi3GetInt16, fmi3Int16)
NONE(fmi3GetUInt16, fmi3UInt16)
NONE(fmi3GetInt32, fmi3Int32)
NONE(fmi3GetUInt32, fmi3UInt32)
NONE(fmi3GetInt64, fmi3Int64)
NONE(fmi3GetUInt64, fmi3UInt64)
NONE(fmi3GetBoolean, fmi3Boolean)
NONE(fmi3GetString, fmi3String)
NONE(fmi3SetFloat32, const fmi3Float32)
NONE(fmi3SetInt8, const fmi3Int8)
NONE(fmi3SetUInt8, const fmi3UInt8)
NONE(fmi3SetInt16, const fmi3Int16)
NONE(fmi3SetUInt16, const fmi3UInt16)
NONE(fmi3SetInt32, const fmi3Int32)
NONE(fmi3SetUInt32, const fmi3UInt32)
NONE(fmi3SetInt64, const fmi3Int64)
NONE(fmi3SetUInt64, const fmi3UInt64)
NONE(fmi3SetBoolean, const fmi3Boolean)
NONE(fmi3SetString, const fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary values[],
                         size_t n_values)
{
    (void)vr, (void)sizes, (void)values, (void)n_values;
    return n ? failed(c, fmi3Error, "all variables are Float64") : fmi3OK;
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[],
                         const fmi3Binary values[], size_t n_values)
{
    (void)vr, (void)sizes, (void)values, (void)n_values;
    return n ? failed(c, fmi3Error, "all variables are Float64") : fmi3OK;
}

/* What this FMU does not provide */
#define REFUSED(name, parameters, unused)                                                                              \
    fmi3Status name parameters                                                                                         \
    {                                                                                                                  \
        unused;                                                                                                        \
        return failed(c, fmi3Error, #name " is not provided");                                                         \
    }

REFUSED(fmi3GetClock, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]),
        ((void)vr, (void)n, (void)values))
REFUSED(fmi3SetClock, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[]),
        ((void)vr, (void)n, (void)values))
REFUSED(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference vr, size_t *n), ((void)vr, (void)n))
REFUSED(fmi3GetVariableDependencies,
        (fmi3Instance c, fmi3ValueReference vr, size_t elements[], fmi3ValueReference independents[],
         size_t elements_of_independents[], fmi3DependencyKind kinds[], size_t n),
        ((void)vr, (void)elements, (void)independents, (void)elements_of_independents, (void)kinds, (void)n))
REFUSED(fmi3GetDirectionalDerivative,
        (fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
         size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[], size_t n_found),
        ((void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)found,
         (void)n_found))
REFUSED(fmi3GetAdjointDerivative,
        (fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknowns, const fmi3ValueReference knowns[],
         size_t n_knowns, const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[], size_t n_found),
        ((void)unknowns, (void)n_unknowns, (void)knowns, (void)n_knowns, (void)seed, (void)n_seed, (void)found,
         (void)n_found))
REFUSED(fmi3GetIntervalDecimal,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 intervals[],
         fmi3IntervalQualifier qualifiers[]),
        ((void)vr, (void)n, (void)intervals, (void)qualifiers))
REFUSED(fmi3GetIntervalFraction,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
         fmi3IntervalQualifier qualifiers[]),
        ((void)vr, (void)n, (void)counters, (void)resolutions, (void)qualifiers))
REFUSED(fmi3GetShiftDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[]),
        ((void)vr, (void)n, (void)shifts))
REFUSED(fmi3GetShiftFraction,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 counters[], fmi3UInt64 resolutions[]),
        ((void)vr, (void)n, (void)counters, (void)resolutions))
REFUSED(fmi3SetIntervalDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[]),
        ((void)vr, (void)n, (void)intervals))
REFUSED(fmi3SetIntervalFraction,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
         const fmi3UInt64 resolutions[]),
        ((void)vr, (void)n, (void)counters, (void)resolutions))
REFUSED(fmi3SetShiftDecimal, (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[]),
        ((void)vr, (void)n, (void)shifts))
REFUSED(fmi3SetShiftFraction,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 counters[],
         const fmi3UInt64 resolutions[]),
        ((void)vr, (void)n, (void)counters, (void)resolutions))
REFUSED(fmi3GetOutputDerivatives,
        (fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 orders[], fmi3Float64 values[],
         size_t n_values),
        ((void)vr, (void)n, (void)orders, (void)values, (void)n_values))
REFUSED(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time),
        ((void)clock, (void)time))

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    instance *m = c;
    if (MODEL_IN_PYTHON)
        return failed(m, fmi3Error, "the state of a run in Python cannot be saved");
    if (!*state)
        *state = calloc(1, sizeof m->values);
    if (!*state)
        return failed(m, fmi3Error, "out of memory");
    memcpy(*state, &m->values, sizeof m->values);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    instance *m = c;
    memcpy(&m->values, state, sizeof m->values);
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    (void)c, (void)state;
    *size = sizeof(model_values);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (size < sizeof(model_values))
        return failed(c, fmi3Error, "too few bytes for a state");
    memcpy(bytes, state, sizeof(model_values));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (MODEL_IN_PYTHON || size != sizeof(model_values))
        return failed(c, fmi3Error, "these bytes are no state of this FMU");
    if (!*state)
        *state = calloc(1, size);
    if (!*state)
        return failed(c, fmi3Error, "out of memory");
    memcpy(*state, bytes, size);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *need_update, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                    fmi3Boolean *next_event_defined, fmi3Float64 *next_event)
{
    (void)c;
    *need_update = *terminate = *nominals_changed = *states_changed = *next_event_defined = fmi3False;
    *next_event = 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set, fmi3Boolean *event, fmi3Boolean *terminate)
{
    (void)c, (void)no_set;
    *event = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    ((instance *)c)->values.time = time;
    return fmi3OK;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n)
{
    (void)c, (void)indicators;
    return n ? fmi3Error : fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    (void)c;
    *n = MODEL_EXCHANGE ? MODEL_STATES : 0;
    return fmi3OK;
}

#if MODEL_EXCHANGE
static fmi3Status copied(fmi3Instance c, double *to, const double *from, size_t n)
{
    if (n != MODEL_STATES)
        return failed(c, fmi3Error, "wrong number of states");
    memcpy(to, from, n * sizeof *to);
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{
    instance *m = c;
    m->values.fresh = 0;
    return copied(c, m->values.x, x, n);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 rates[], size_t n)
{
    instance *m = c;
    update_values(&m->values);
    return copied(c, rates, m->values.rate, n);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n)
{
    return copied(c, x, ((instance *)c)->values.x, n);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominal[], size_t n)
{
    return copied(c, nominal, ((instance *)c)->values.size, n);
}
#else
REFUSED(fmi3SetContinuousStates, (fmi3Instance c, const fmi3Float64 x[], size_t n), ((void)x, (void)n))
REFUSED(fmi3GetContinuousStateDerivatives, (fmi3Instance c, fmi3Float64 rates[], size_t n), ((void)rates, (void)n))
REFUSED(fmi3GetContinuousStates, (fmi3Instance c, fmi3Float64 x[], size_t n), ((void)x, (void)n))
REFUSED(fmi3GetNominalsOfContinuousStates, (fmi3Instance c, fmi3Float64 x[], size_t n), ((void)x, (void)n))
#endif

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 from, fmi3Float64 size, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last_time)
{
    (void)no_set;
    *event = *terminate = *early = fmi3False;
#if MODEL_EXCHANGE
    (void)from, (void)size, (void)last_time;
    return failed(c, fmi3Error, "this FMU is for model exchange only");
#else
    const char *wrong = do_steps(&((instance *)c)->values, from, size);
    *last_time = ((instance *)c)->values.time;
    return outcome(c, fmi3Discard, wrong);
#endif
}
