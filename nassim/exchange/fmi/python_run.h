/* A run of nassim in a process of Python, with the functions of a model in C. */
#ifndef PYTHON_RUN_H
#define PYTHON_RUN_H

#define PATH_BYTES 4096
#define TEXT_BYTES 2048

typedef struct {
    double y[MODEL_OUTPUTS > 0 ? MODEL_OUTPUTS : 1];
    long process; /* 0 for none */
    int channel;
    char resources[PATH_BYTES]; /* folder of the scene and its options */
    char warnings[TEXT_BYTES];  /* of the last calls, until somebody has taken them */
    char failure[TEXT_BYTES];   /* what keeps the run from going on; empty for none */
} model_state;

/* Say where the resources of the FMU are, by a path or a URI. */
void model_locate(model_state *s, const char *resources);

/* Begin, with the inputs of the start. */
void model_init(model_state *s, const double u[]);

/* Give the outputs of the last step. */
void model_output(const model_state *s, const double u[], double y[]);

/* Go on by one time step, in which the inputs run to these values. */
void model_step(model_state *s, const double u[]);

/* End the run, which then gives its last warnings. */
void model_finish(model_state *s);

/* End the process, if there is one. */
void model_end(model_state *s);

#endif
