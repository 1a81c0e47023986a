"""A program in C that steps an FMU in co-simulation: without Python, with the FMU's library or its sources."""

import subprocess
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
from compiled_c import COMPILER, SANITIZED, STRICT

PROGRAM = """\
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#if FMI == 2
#include "fmi2Functions.h"
#define OK fmi2OK

static void tell(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String text, ...)
{
    va_list more;
    (void)e, (void)name, (void)status;
    va_start(more, text);
    fprintf(stderr, "%s: ", category);
    vfprintf(stderr, text, more);
    va_end(more);
}

static fmi2CallbackFunctions functions = {tell, calloc, free, NULL, NULL};
#define START(token, folder) fmi2Instantiate("one", fmi2CoSimulation, token, folder, &functions, 0, 0)
#define BEGIN(c, time) (fmi2SetupExperiment(c, 0, 0.0, time, 0, 0.0) || fmi2EnterInitializationMode(c))
#define BEGUN fmi2ExitInitializationMode
#define PUT(c, vr, n, x) fmi2SetReal(c, vr, n, x)
#define TAKE(c, vr, n, x) fmi2GetReal(c, vr, n, x)
#define STEP(c, time, step) fmi2DoStep(c, time, step, fmi2True)
#define STOP fmi2Terminate
#define FREE fmi2FreeInstance
#else
#include "fmi3Functions.h"
#define OK fmi3OK

static void tell(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String text)
{
    (void)e, (void)status;
    fprintf(stderr, "%s: %s", category, text);
}

static fmi3Status step_by(fmi3Instance c, double time, double step)
{
    bool event, terminate, early;
    double last;
    return fmi3DoStep(c, time, step, 1, &event, &terminate, &early, &last);
}

#define START(token, folder) \\
    fmi3InstantiateCoSimulation("one", token, folder, 0, 0, 0, 0, NULL, 0, NULL, tell, NULL)
#define BEGIN(c, time) fmi3EnterInitializationMode(c, 0, 0.0, time, 0, 0.0)
#define BEGUN fmi3ExitInitializationMode
#define PUT(c, vr, n, x) fmi3SetFloat64(c, vr, n, x, n)
#define TAKE(c, vr, n, x) fmi3GetFloat64(c, vr, n, x, n)
#define STEP step_by
#define STOP fmi3Terminate
#define FREE fmi3FreeInstance
#endif

/* Arguments: token, folder of resources, numbers of inputs and outputs, time step, time at the start. */
int main(int argc, char *argv[])
{
    static double u[100], y[100];
    static unsigned int in[100], out[100];
    const unsigned int n_in = (unsigned)atoi(argv[3]), n_out = (unsigned)atoi(argv[4]);
    const double step = atof(argv[5]), start = atof(argv[6]);
    unsigned int k;
    void *c = START(argv[1], argv[2]);
    (void)argc;
    for (k = 0; k < 100; k++)
        in[k] = 1 + k, out[k] = 1 + n_in + k;
    if (!c || BEGIN(c, start))
        return 2;
    for (k = 0; fread(u, sizeof *u, n_in, stdin) == n_in; k++) {
        if (PUT(c, in, n_in, u) != OK || (k == 0 && BEGUN(c) != OK) || TAKE(c, out, n_out, y) != OK)
            return 3;
        fwrite(y, sizeof *y, n_out, stdout);
        if (STEP(c, start + k * step, step) != OK)
            return 4;
    }
    if (STOP(c) != OK)
        return 5;
    FREE(c);
    return 0;
}
"""


def run_program(path, folder, inputs, *, start=0.0, sanitized=False, environment=None):
    """Step an FMU through inputs, (inputs, n).

    The program is linked with the FMU's library, or with its sources under sanitizers. Its environment is empty unless
    given, so that it finds no Python.

    Returns outputs, (outputs, n), the exit code and what was logged.
    """
    zipfile.ZipFile(path).extractall(folder)
    root = ET.parse(folder / "modelDescription.xml").getroot()
    version = root.get("fmiVersion")[0]
    variables = [v.get("causality") for v in root.find("ModelVariables")]
    token = root.get("guid") or root.get("instantiationToken")
    step = root.find("DefaultExperiment").get("stepSize")
    main, program = folder / "main.c", folder / "main"
    main.write_text(PROGRAM, encoding="utf-8")
    linked = sorted((folder / "sources").glob("*.c")) if sanitized else sorted(folder.glob("binaries/*/*"))
    options = [f"-DFMI={version}", f"-I{folder / 'sources'}", *(SANITIZED if sanitized else ())]
    subprocess.run([COMPILER, *STRICT, *options, "-o", program, main, *linked], check=True)
    resources = (folder / "resources").as_uri() if version == "2" else folder / "resources"
    counts = [str(variables.count(causality)) for causality in ("input", "output")]
    arguments = [program, token, resources, *counts, step, repr(start)]
    given = np.ascontiguousarray(inputs.T).tobytes()
    options = {"capture_output": True, "env": environment or {}, "cwd": folder, "timeout": 120}
    run = subprocess.run(arguments, input=given, check=False, **options)
    return np.frombuffer(run.stdout).reshape(-1, int(counts[1])).T, run.returncode, run.stderr.decode()
