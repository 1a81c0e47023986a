/* An instance of a model: variables by their value references, and its steps or rates. For FMI 2 and FMI 3.

   Value references count the time as 0, then the inputs, the outputs and, for model exchange, the states and their
   rates. All values are one plain struct, so saving the state of an instance is copying it, unless the model runs in a
   process of Python (MODEL_IN_PYTHON). Functions that may fail return what is wrong, or NULL. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <math.h>
#include <string.h>

#include "fmu.h" /* MODEL_EXCHANGE, MODEL_IN_PYTHON, FMU_TOKEN, and the functions of the model */

#define AT_LEAST_ONE(n) ((n) > 0 ? (n) : 1)
#define FIRST_INPUT 1
#define FIRST_OUTPUT (FIRST_INPUT + MODEL_INPUTS)
#define FIRST_STATE (FIRST_OUTPUT + MODEL_OUTPUTS)
#define FIRST_RATE (FIRST_STATE + MODEL_STATES)
#define WHOLE_STEPS 1e-4 /* how far a communication step may be from a whole number of steps */

typedef struct {
    double start_time, time;
    double u[AT_LEAST_ONE(MODEL_INPUTS)];
    double y[AT_LEAST_ONE(MODEL_OUTPUTS)];
#if MODEL_EXCHANGE
    double x[AT_LEAST_ONE(MODEL_STATES)];
    double size[AT_LEAST_ONE(MODEL_STATES)];
    double rate[AT_LEAST_ONE(MODEL_STATES)];
#else
    model_state state;
    double steps; /* since the start */
#endif
    int initialized;
    int fresh; /* whether y and the rates belong to the present state and inputs */
} model_values;

/* What keeps the model from going on, if anything */
static const char *failure_of(const model_values *v)
{
#if MODEL_IN_PYTHON
    return v->state.failure[0] ? v->state.failure : NULL;
#else
    (void)v;
    return NULL;
#endif
}

static void reset_values(model_values *v)
{
#if MODEL_IN_PYTHON
    model_state located;
    model_end(&v->state);
    located = v->state;
#endif
    memset(v, 0, sizeof *v);
#if MODEL_IN_PYTHON
    v->state = located;
#elif MODEL_EXCHANGE
    model_init(v->x, v->size);
#endif
}

/* Say where the resources of the FMU are. */
static void locate_resources(model_values *v, const char *resources)
{
#if MODEL_IN_PYTHON
    model_locate(&v->state, resources);
#else
    (void)v, (void)resources;
#endif
}

/* End the run; the values stay. */
static void finish_run(model_values *v)
{
#if MODEL_IN_PYTHON
    model_finish(&v->state);
#else
    (void)v;
#endif
}

/* Warnings of the run, to be emptied by who has taken them */
static char *warnings_of(model_values *v)
{
#if MODEL_IN_PYTHON
    return v->state.warnings;
#else
    (void)v;
    return NULL;
#endif
}

static void start_at(model_values *v, double time)
{
    v->start_time = v->time = time;
}

static const char *update_values(model_values *v)
{
    if (v->fresh)
        return NULL;
#if MODEL_EXCHANGE
    model_rates(v->x, v->u, v->rate);
    model_output(v->x, v->u, v->y);
#else
    if (!v->initialized)
        model_init(&v->state, v->u);
    if (failure_of(v))
        return failure_of(v);
    model_output(&v->state, v->u, v->y);
#endif
    v->fresh = 1;
    return NULL;
}

static const char *finish_initialization(model_values *v)
{
    const char *wrong = update_values(v);
    v->initialized = 1;
    return wrong;
}

static const char *get_value(model_values *v, unsigned int reference, double *value)
{
    const long k = (long)reference;
    const char *wrong = k < FIRST_OUTPUT ? NULL : update_values(v);
    if (wrong)
        return wrong;
    if (k == 0)
        *value = v->time;
    else if (k < FIRST_OUTPUT)
        *value = v->u[k - FIRST_INPUT];
    else if (k < FIRST_STATE)
        *value = v->y[k - FIRST_OUTPUT];
#if MODEL_EXCHANGE
    else if (k < FIRST_RATE)
        *value = v->x[k - FIRST_STATE];
    else if (k < FIRST_RATE + MODEL_STATES)
        *value = v->rate[k - FIRST_RATE];
#endif
    else
        return "there is no variable of this value reference";
    return NULL;
}

/* Set an input, or a state of model exchange. */
static const char *set_value(model_values *v, unsigned int reference, double value)
{
    const long k = (long)reference;
    if (!isfinite(value))
        return "only finite values can be set";
    if (k >= FIRST_INPUT && k < FIRST_OUTPUT)
        v->u[k - FIRST_INPUT] = value;
#if MODEL_EXCHANGE
    else if (k >= FIRST_STATE && k < FIRST_RATE)
        v->x[k - FIRST_STATE] = value;
#endif
    else
        return "only inputs and states can be set";
    v->fresh = 0;
    return NULL;
}

#if !MODEL_EXCHANGE
/* Go on by a communication step from a time. */
static const char *do_steps(model_values *v, double from, double size)
{
    const double ratio = size / MODEL_TIME_STEP;
    const double count = ratio > 0 && ratio < 1e15 ? (double)(long long)(ratio + 0.5) : 0;
    double k;
    if (fabs(from - v->time) > 0.5 * MODEL_TIME_STEP)
        return "the communication point is not where the last step has ended";
    if (count < 1 || fabs(ratio - count) > WHOLE_STEPS)
        return "the communication step must be a whole number of the model's time steps, see stepSize";
    for (k = 0; k < count; k++)
        model_step(&v->state, v->u);
    if (failure_of(v))
        return failure_of(v);
    v->steps += count;
    v->time = v->start_time + v->steps * MODEL_TIME_STEP;
    v->fresh = 0;
    return NULL;
}
#endif

#endif
