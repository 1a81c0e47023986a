"""Measure time and memory of a step of exported C code, beside nassim's own exact steps.

The bench and the nano-hexapod with its loops closed follow noise. The C code is compiled by the machine's C compiler
with -O2. Times are CPU times. Those of `simulate` include its start, the others do not. The largest error of any output
is relative to the largest value of that output.
"""

import os
import subprocess
import tempfile
from dataclasses import replace

import numpy as np

from common.arguments import parser, run, whole
from common.costs import cpu_time
from common.report import print_table, write_summary
from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut
from nassim import Loop, ReducedBody, Scene, TimeHistory, simulate
from nassim.exchange import CCode, export_c
from nassim.exchange.c_compiler import find_compiler
from nassim.signals import band_limited_noise
from nassim.simulation import Simulation
from nassim.systems import decentralised, integral_force_feedback

RATE = 1e4
STRUT_CUTOFF = 600.0
STEPPED = 1000
"""Number of steps of the run that is stepped one by one."""
PROGRAM = """\
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "machine.h"

int main(int argc, char *argv[])
{
    const size_t n = (size_t)atol(argv[argc - 1]);
    machine_real *u = calloc(n * MACHINE_INPUTS, sizeof *u), *y = calloc(n * MACHINE_OUTPUTS, sizeof *y);
    machine_state state;
    clock_t start;
    size_t k;
    if (fread(u, sizeof *u, n * MACHINE_INPUTS, stdin) != n * MACHINE_INPUTS)
        return 1;
    machine_init(&state, u);
    start = clock();
    for (k = 0; k < n; k++) {
        machine_output(&state, u + k * MACHINE_INPUTS, y + k * MACHINE_OUTPUTS);
        machine_step(&state, u + k * MACHINE_INPUTS);
    }
    fprintf(stderr, "%.17g", (double)(clock() - start) / CLOCKS_PER_SEC);
    fwrite(y, sizeof *y, n * MACHINE_OUTPUTS, stdout);
    return 0;
}
"""

arguments = parser(__doc__, "benchmark_export")
arguments.add_argument("--steps", type=whole(2000), default=400000, help="steps of 0.1 ms (default: 400000)")
arguments.add_argument(
    "--turns", type=whole(1), default=3, help="repetitions, of which the fastest counts (default: 3)"
)
COLUMNS = {
    "us/step": "C_us_per_step:.2f",
    "single": "single_us_per_step:.2f",
    "simulate": "simulate_us_per_step:.1f",
    "Simulation": "Simulation_us_per_step:.0f",
    "constants [kB]": "constant_B*1e-3:.1f",
    "state, stack [B]": "changing_B:.0f",
    "error": "C_error:.0e",
    "error, single": "single_error:.0e",
}


def bench(apa: ReducedBody) -> Scene:
    """Return the bench with integral force feedback."""
    loop = Loop("iff", integral_force_feedback(20.0, sample_rate=RATE), "sensor_voltage", "actuator_voltage")
    return replace(make_bench(apa=apa, fidelity="linear"), loops=(loop,))


def hexapod(apa: ReducedBody) -> Scene:
    """Return the hexapod with six struts of finite elements, and a loop in each."""
    scene = make_nano_hexapod(fe_strut("linear", apa=apa), damping_ratio=0.01, cutoff_frequency=STRUT_CUTOFF)
    sensors, voltages = ([f"strut_{k}/{name}" for k in range(1, 7)] for name in ("sensor_voltage", "actuator_voltage"))
    controller = decentralised(*[integral_force_feedback(20.0, sample_rate=RATE)] * 6)
    return replace(scene, loops=(Loop("iff", controller, sensors, voltages),))


def run_code(code: CCode, inputs: np.ndarray, kind: type) -> tuple[np.ndarray, float]:
    """Compile and run C code; return its outputs, (outputs, n), and CPU time of a step [s]."""
    folder, n = code.header.parent, inputs.shape[1]
    (folder / "main.c").write_text(PROGRAM, encoding="utf-8")
    program = folder / ("main.exe" if os.name == "nt" else "main")
    subprocess.run([find_compiler(), "-O2", "-o", program, folder / "main.c", code.source], check=True)
    given = np.ascontiguousarray(inputs.T, dtype=kind).tobytes()
    done = subprocess.run([program, str(n)], input=given, capture_output=True, check=True)
    return np.frombuffer(done.stdout, dtype=kind).reshape(n, -1).T, float(done.stderr) / n


def stepped(scene: Scene, values: np.ndarray) -> float:
    """Return CPU time of a step of `Simulation` [s]."""
    with Simulation(scene, time_step=1 / RATE, method="exact", hold_order=0) as steps:
        given = [dict(zip(scene.inputs, row, strict=True)) for row in values[:, :STEPPED].T.tolist()]
        return cpu_time(lambda: [steps.step(inputs) for inputs in given])[1] / STEPPED


def simulated(scene: Scene, given: TimeHistory) -> tuple[TimeHistory, float]:
    """Simulate; return the record and CPU time of a step, with its share of the start [s]."""
    options = {"time_step": 1 / RATE, "method": "exact", "hold_order": 0, "progress": False}
    record, time = cpu_time(simulate, scene, given, **options)
    return record, time / len(given.time)


def measure(scene: Scene, steps: int, turns: int) -> dict[str, float]:
    """Measure time, memory and error of the exported steps of a scene; the fastest turn counts."""
    noise = [
        band_limited_noise((steps - 1) / RATE, RATE, cutoff_frequency=300.0, rms=1e-2, seed=k)
        for k in range(len(scene.inputs))
    ]
    units = tuple(map(scene.input_unit, scene.inputs))
    given = TimeHistory(noise[0].time, np.vstack([one.values for one in noise]), scene.inputs, units)
    runs = [simulated(scene, given) for _ in range(turns)]
    record = runs[0][0]
    expected = np.array([record[name] for name in (*scene.outputs, *scene.commands)])
    result = {
        "simulate_us_per_step": 1e6 * min(time for _, time in runs),
        "Simulation_us_per_step": 1e6 * min(stepped(scene, given.values) for _ in range(turns)),
    }
    for label, precision, kind in (("single", "single", np.float32), ("C", "double", np.float64)):
        with tempfile.TemporaryDirectory() as folder:
            code = export_c(scene, folder, "machine", precision=precision)
            done = [run_code(code, given.values, kind) for _ in range(turns)]
        errors = np.abs(done[0][0] - expected).max(axis=1) / np.abs(expected).max(axis=1)
        result |= {f"{label}_us_per_step": 1e6 * min(time for _, time in done), f"{label}_error": float(errors.max())}
    return result | {"constant_B": code.constant_bytes, "changing_B": code.state_bytes + code.stack_bytes}


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    machines = {"bench": bench(apa), "hexapod": hexapod(apa)}
    summary = {name: measure(scene, args.steps, args.turns) for name, scene in machines.items()}
    print_table("machine", summary, COLUMNS)
    write_summary(args.output, {"steps": args.steps, **summary})


if __name__ == "__main__":
    run(main)
