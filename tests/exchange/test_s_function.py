"""The S-function of the how-to, with a stand-in for Simulink's headers."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiled_c import COMPILER, SANITIZED, STRICT, largest_error
from exported_scenes import excited, record, servoed

from nassim.exchange import export_c

PAGE = Path(__file__).parents[2] / "docs/howto/real_time.md"
HEADER = """\
#include <stdlib.h>
typedef int int_T;
enum { SS_DOUBLE };
typedef struct {
    int inputs, outputs, direct;
    size_t work;
    double step, *u, *y;
    void *memory;
} SimStruct;
#define ssSetNumSFcnParams(S, n) ((void)(S))
#define ssSetNumInputPorts(S, n) ((n) == 1)
#define ssSetNumOutputPorts(S, n) ((n) == 1)
#define ssSetInputPortWidth(S, k, n) ((S)->inputs = (n))
#define ssSetInputPortRequiredContiguous(S, k, is) ((void)(S))
#define ssSetInputPortDirectFeedThrough(S, k, is) ((S)->direct = (is))
#define ssSetOutputPortWidth(S, k, n) ((S)->outputs = (n))
#define ssSetNumSampleTimes(S, n) ((void)(S))
#define ssSetNumDWork(S, n) ((void)(S))
#define ssSetDWorkWidth(S, k, n) ((S)->work = (n))
#define ssSetDWorkDataType(S, k, kind) ((void)(S))
#define ssSetSampleTime(S, k, time) ((S)->step = (time))
#define ssSetOffsetTime(S, k, time) ((void)(S))
#define ssGetDWork(S, k) ((S)->memory)
#define ssGetInputPortRealSignal(S, k) ((const double *)(S)->u)
#define ssGetOutputPortRealSignal(S, k) ((S)->y)
"""
PROGRAM = """\
#include <stdio.h>

int main(void)
{
    SimStruct s = {0};
    mdlInitializeSizes(&s);
    mdlInitializeSampleTimes(&s);
    s.u = calloc((size_t)s.inputs, sizeof *s.u);
    s.y = calloc((size_t)s.outputs, sizeof *s.y);
    s.memory = calloc(s.work, sizeof(double));
    mdlStart(&s);
    while (s.direct && fread(s.u, sizeof *s.u, (size_t)s.inputs, stdin) == (size_t)s.inputs) {
        mdlOutputs(&s, 0);
        fwrite(s.y, sizeof *s.y, (size_t)s.outputs, stdout);
        mdlUpdate(&s, 0);
    }
    mdlTerminate(&s);
    free(s.u), free(s.y), free(s.memory);
    return s.step == STAGE_TIME_STEP ? 0 : 1;
}
"""


@pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")
def test_the_s_function_of_the_page_steps_as_nassim(tmp_path):
    scene = servoed()
    inputs = excited(scene)
    code = export_c(scene, tmp_path, "stage")
    (block,) = re.findall(r"^```c\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    for name, text in (("stage_sfun.c", block), ("simstruc.h", HEADER), ("cg_sfun.h", PROGRAM)):
        (tmp_path / name).write_text(text, encoding="utf-8")
    command = [COMPILER, *STRICT, *SANITIZED, "-Wno-unused-macros", "-o", "block", "stage_sfun.c", code.source]
    subprocess.run(command, cwd=tmp_path, check=True)
    given = np.ascontiguousarray(inputs.T).tobytes()
    run = subprocess.run([tmp_path / "block"], input=given, capture_output=True, check=True)
    found = np.frombuffer(run.stdout).reshape(inputs.shape[1], -1).T
    assert largest_error(found, record(scene, inputs, 0)) < 1e-12
