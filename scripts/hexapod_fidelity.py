"""Compare speed and error of the nano-hexapod in all fidelities, with a fixed base or on a rotating spindle.

Six noises drive the struts. The reference is the linear model of the whole machine with all coordinates of its
actuators, in exact steps; on a spindle it is expressed in the rotor frame. The errors are those of the struts'
reduction, of the time steps and, in floating frames, of nonlinear motion.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy

from common.arguments import not_negative, parser, positive, run
from common.costs import timed
from common.hexapod import ENCODERS, METHODS, SAMPLE_RATE, SENSORS, VOLTAGES, add_damping, add_machine, excite, hexapod
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from models.nano_hexapod import make_nano_hexapod
from models.strut import two_mass_strut
from nassim import LinearModel, TimeHistory, frequency_response, linearize, simulate
from nassim.signals import band_limited_noise
from nassim.systems import subsystem

FREQUENCY = np.geomspace(10.0, 500.0, 1000)

STEP = 1 / SAMPLE_RATE
ROWS: dict[str, tuple[str, float | None, int]] = {
    "exact": ("exact", None, 1),
    "exact, 1800 Hz": ("exact", 1800.0, 1),
    "exact, 600 Hz": ("exact", 600.0, 1),
    "linear": ("linear", None, 1),
    "linear, 600 Hz": ("linear", 600.0, 1),
    "ffrf": ("ffrf", None, 1),
    "ffrf, 1800 Hz": ("ffrf", 1800.0, 1),
    "ffrf, 600 Hz": ("ffrf", 600.0, 1),
    "ffrf, 600 Hz, 0.2 ms": ("ffrf", 600.0, 2),
}
"""Method, cut-off frequency of the struts, samples per time step."""
COLUMNS = {
    "states": "states:d",
    "us/step": "us_per_step:.0f",
    "times real time": "speed_over_real_time:.2g",
    "FRFs [%]": "frf_error*100:.3g",
    "forces [%]": "force_error*100:.3g",
    "lengths [%]": "length_error*100:.3g",
}
REPORT = """
{duration_s:g} s of noise up to 300 Hz, {payload_mass_kg:g} kg on the plate, {spindle_rpm:g} rpm. Errors over the \
largest value: of FRFs, 10 to 500 Hz, by the reduction of struts; of forces and lengths in the record, by all causes"""
arguments = parser(__doc__, "hexapod_fidelity")
add_machine(arguments, method=False)
arguments.add_argument("--duration", type=positive, default=0.5, help="length of the record [s] (default: 0.5)")
arguments.add_argument(
    "--spindle-rpm", type=not_negative, default=0.0, help="speed, in floating frames only [rpm] (default: 0)"
)


def responses(model: LinearModel) -> np.ndarray:
    """Return the FRFs from voltages to force sensors and encoders, (outputs, voltages, frequencies)."""
    return frequency_response(subsystem(model, inputs=VOLTAGES, outputs=[*SENSORS, *ENCODERS]), FREQUENCY).values


def frf_error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest difference of any FRF over its largest value [-]."""
    return float((np.abs(found - wanted).max(axis=2) / np.abs(wanted).max(axis=2)).max())


def record_error(record: TimeHistory, expected: Mapping[str, np.ndarray], outputs: Sequence[str], every: int) -> float:
    """Return the largest difference of outputs from their start values, over the largest expected value [-].

    Args:
        record: the simulated outputs
        expected: samples of each output at a higher rate, by name
        outputs: names of the outputs
        every: number of expected samples per sample of the record
    """
    wanted = np.array([expected[output][::every][: len(record.time)] for output in outputs])
    found = np.array([record[output] - record[output][0] for output in outputs])
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def main() -> None:
    args = arguments.parse_args()
    noises = [band_limited_noise(args.duration, SAMPLE_RATE, cutoff_frequency=300.0, rms=0.1, seed=k) for k in range(6)]
    drives, time = dict(zip(VOLTAGES, (noise.values[0] for noise in noises), strict=True)), noises[0].time
    scenes = {
        name: (
            hexapod(args, method=method, cutoff_frequency=cutoff, spindle_rpm=args.spindle_rpm),
            METHODS[method][1],
            steps,
        )
        for name, (method, cutoff, steps) in ROWS.items()
        if method == "ffrf" or not args.spindle_rpm
    }
    if not args.spindle_rpm:
        struts = add_damping(args, two_mass_strut())
        scenes["two masses, exact"] = make_nano_hexapod(struts, payload_mass=args.payload_mass), "exact", 1
    whole = linearize(scenes["ffrf"][0])
    given = excite(scenes["ffrf"][0], time, drives).values.T
    _, readings, _ = scipy.signal.lsim((whole.A, whole.B, whole.C, whole.D), given, time)
    expected, wanted = dict(zip(whole.outputs, readings.T, strict=True)), responses(whole)
    summary: dict[str, Any] = {"duration_s": args.duration, "payload_mass_kg": args.payload_mass}
    summary["spindle_rpm"] = args.spindle_rpm
    for name, (scene, method, steps) in scenes.items():
        wired = {"time_step": steps * STEP, "outputs": (*SENSORS, *ENCODERS), "method": method, "progress": False}
        record, wall = timed(simulate, scene, excite(scene, time, drives), **wired)
        model, per_step = linearize(scene), wall / (len(record.time) - 1)
        figures = {
            "states": len(model.A),
            "us_per_step": 1e6 * per_step,
            "speed_over_real_time": steps * STEP / per_step,
            "frf_error": frf_error(responses(model), wanted),
            "force_error": record_error(record, expected, SENSORS, steps),
            "length_error": record_error(record, expected, ENCODERS, steps),
        }
        summary |= with_prefix(name, figures)
    print_report(REPORT, summary)
    print_table("", rows_of(summary, scenes), COLUMNS)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
