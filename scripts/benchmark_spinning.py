"""Time steps of the hexapod with six loops, at rest and on its spindle: exact ones, and floating frames by Exudyn.

The six struts are of finite elements, trimmed to 600 Hz, and to 1800 Hz for exact steps. Steps are 0.1 ms. Every route
runs in processes of its own, in turns, on one thread. Times are CPU times, without the start. --other compares with
another version of nassim, given by a folder with its packages nassim and models.
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from common.arguments import not_negative, parser, run, whole
from common.costs import cpu_time
from common.report import print_table, write_summary
from models.apa300ml import reduced_apa300ml
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut
from nassim import Loop, Scene, TimeHistory, load, save, simulate
from nassim.signals import band_limited_noise
from nassim.systems import integral_force_feedback

STEP, CUTOFF, FEW = 1e-4, 600.0, 40
EXACT_CUTOFF, EXACT_STEPS, TEN_MINUTES = 1800.0, 100, 600.0
"""Of exact steps: cut-off frequency [Hz], how many for each one of floating frames; a time of the machine [s]."""
KEPT = 20_000
"""Number of samples that are compared."""
OUTPUTS = ("strut_1/encoder", "pose.uz")
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NASSIM_THREADS")
COLUMNS = {
    "us/step at rest": "at_rest_us_per_step:.0f",
    "us/step turning": "turning_us_per_step:.0f",
    "share of the reference": "at_rest_share:.2f",
    "turning": "turning_share:.2f",
    "difference at rest": "at_rest_difference:.0e",
    "difference turning": "turning_difference:.0e",
}

arguments = parser(__doc__, "benchmark_spinning")
arguments.add_argument("--steps", type=whole(10), default=1000, help="timed steps (default: 1000)")
arguments.add_argument("--speed", type=not_negative, default=60.0, help="speed of the spindle [rpm] (default: 60)")
arguments.add_argument(
    "--turns", type=whole(1), default=3, help="repetitions, of which the fastest counts (default: 3)"
)
arguments.add_argument("--other", type=Path, help="folder of another version of nassim, the reference (default: none)")
arguments.add_argument(
    "--child", nargs=4, metavar=("FILE", "RPM", "STEPS", "METHOD"), help="one route: for the script itself"
)


def hexapod(body: Path, speed: float, cutoff: float, fidelity: str) -> Scene:
    """The machine, on a spindle where it has a speed [rpm]."""
    struts = [fe_strut(fidelity, apa=load(body))] * 6
    scene = make_nano_hexapod(struts, damping_ratio=0.0, cutoff_frequency=cutoff, spindle_rpm=speed)
    iff = integral_force_feedback(20.0, sample_rate=1 / STEP)
    names = [f"strut_{k}" for k in range(1, 7)]
    loops = [Loop(name, iff, f"{name}/sensor_voltage", f"{name}/actuator_voltage") for name in names]
    return replace(scene, loops=tuple(loops))


def measure(scene: Scene, steps: int, method: str) -> dict[str, Any]:
    """Time of a step, and outputs by name."""
    forces = tuple(name for name in scene.inputs if name.startswith("payload"))
    noise = band_limited_noise(max((steps + FEW) * STEP, 0.05), 1 / STEP, cutoff_frequency=300.0, rms=1e-3)
    values = np.outer([name == "payload_force_z" for name in forces], noise.values[0])
    units = tuple(map(scene.input_unit, forces))
    times = []
    for n in (FEW, steps + FEW):
        push = TimeHistory(noise.time[: n + 1], values[:, : n + 1], forces, units)
        record, seconds = cpu_time(
            simulate, scene, push, time_step=STEP, outputs=OUTPUTS, method=method, progress=False
        )
        times.append(seconds)
    return {
        "us_per_step": 1e6 * (times[1] - times[0]) / steps,
        **{name: record[name][:KEPT].tolist() for name in OUTPUTS},
    }


def in_own_process(
    root: Path, module: str, body: Path, speed: float, steps: int, method: str = "generalized_alpha"
) -> dict[str, Any]:
    """What `measure` gives with the nassim of a folder and a module of Exudyn, "fast" or ""."""
    given = {"PYTHONPATH": str(root), "EXUDYN_MODULE": module, **dict.fromkeys(THREADS, "1")}
    command = [sys.executable, "-W", "ignore", __file__, "--child", str(body), str(speed), str(steps), method]
    child = subprocess.run(command, env={**os.environ, **given}, capture_output=True, text=True, check=False)
    if child.returncode:
        raise RuntimeError(f"nassim of {root} failed: {(child.stderr.strip() or 'nothing said').splitlines()[-1]}")
    result: dict[str, Any] = json.loads(child.stdout.strip().splitlines()[-1])
    return result


def difference(found: dict[str, Any], right: dict[str, Any]) -> float:
    """Largest difference of the motion since the start, as a share of the largest motion of each output."""
    shares = []
    for name in OUTPUTS:
        x, y = (np.subtract(record[name], record[name][0]) for record in (found, right))
        shares.append(np.abs(x - y).max() / np.abs(y).max())
    return float(max(shares))


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        body, speed, steps, method = args.child
        exact = method == "exact"
        fidelity = "linear" if exact and not float(speed) else "ffrf"
        scene = hexapod(Path(body), float(speed), EXACT_CUTOFF if exact else CUTOFF, fidelity)
        print(json.dumps(measure(scene, int(steps), method)))
        return
    here = Path(__file__).resolve().parents[1]
    routes = {} if args.other is None else {"other version": (args.other.resolve(), "")}
    routes |= {"nassim": (here, ""), "nassim, fast module": (here, "fast")}
    speeds = {"at_rest": 0.0, "turning": args.speed}
    with tempfile.TemporaryDirectory() as folder:
        body = Path(folder) / "apa.h5"
        save(reduced_apa300ml(), body)
        found = {
            (name, label): [in_own_process(*route, body, speed, args.steps) for _ in range(args.turns)]
            for name, route in routes.items()
            for label, speed in speeds.items()
        }
        n = EXACT_STEPS * args.steps
        exact = {
            label: min(in_own_process(here, "", body, speed, n, "exact")["us_per_step"] for _ in range(args.turns))
            for label, speed in speeds.items()
        }
    reference, rows = next(iter(routes)), {}
    for name in routes:
        rows[name] = {}
        for label in speeds:
            best, right = (min(turn["us_per_step"] for turn in found[key, label]) for key in (name, reference))
            rows[name] |= {f"{label}_us_per_step": best, f"{label}_share": best / right}
            rows[name][f"{label}_difference"] = difference(found[name, label][0], found[reference, label][0])
    print_table("", rows, COLUMNS)
    ten_minutes = 1e-6 * exact["turning"] * TEN_MINUTES / STEP
    print(
        f"exact steps: {exact['at_rest']:.3g} us at rest, {exact['turning']:.3g} us turning; "
        f"ten minutes of the machine take {ten_minutes:.3g} s"
    )
    summary = {"steps": args.steps, "speed_rpm": args.speed, "reference": reference, "routes": rows}
    summary |= {f"exact_{label}_us_per_step": us for label, us in exact.items()}
    write_summary(args.output, {**summary, "exact_ten_minutes_s": ten_minutes})


if __name__ == "__main__":
    run(main)
