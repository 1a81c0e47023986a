"""The nano-hexapod of scripts: scene, signal names of its struts, excitation."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from common.arguments import fraction, positive
from models.apa300ml import COARSE, PORTS, reduced_apa300ml
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut, with_own_damping
from nassim import LinearModel, ReducedBody, Scene, TimeHistory
from nassim.simulation import traced, trim_scene

VOLTAGES, SENSORS, ENCODERS = (
    tuple(f"strut_{k}/{name}" for k in range(1, 7)) for name in ("actuator_voltage", "sensor_voltage", "encoder")
)
METHODS = {
    "exact": ("linear", "exact"),
    "linear": ("linear", "generalized_alpha"),
    "ffrf": ("ffrf", "generalized_alpha"),
}
"""Fidelity of the struts' bodies and method of `simulate`, by values of the argument."""
HIGHEST = 600.0
"""Highest frequency of interest [Hz]; bodies keep their modes up to three times that."""
SAMPLE_RATE = 10e3
"""Sample rate of the real machine's control system and of all records [Hz]."""


def add_machine(arguments: ArgumentParser, *, method: bool = True) -> None:
    """Add arguments that choose the hexapod and, for scripts without comparison of methods, its simulation."""
    arguments.add_argument(
        "--payload-mass", type=positive, default=10.0, help="payload on the top plate [kg] (default: 10)"
    )
    arguments.add_argument(
        "--damping-ratio",
        type=fraction,
        default=0.01,
        help="ratio of a mode at 100 Hz, others in proportion (default: 0.01)",
    )
    arguments.add_argument("--coarse", action="store_true", help="actuator mesh of 8 mm, for a quick look")
    if method:
        arguments.add_argument(
            "--method", choices=METHODS, default="exact", help="linear bodies, exact or integrated, or floating frames"
        )


def hexapod(
    args: Namespace,
    *,
    method: str | None = None,
    spindle_rpm: float = 0.0,
    cutoff_frequency: float | None = 3 * HIGHEST,
) -> Scene:
    """Make the hexapod of the arguments, with six struts that are trimmed (None: not) and have their own damping.

    Trimmed struts keep a trace of their coordinates, so their motion can be expanded to that of the original ones.
    """
    fidelity, _ = METHODS[method or args.method]
    whole = fe_strut(fidelity, apa=_actuator(args.coarse))
    strut = trim_scene(replace(traced(whole), cutoff_frequency=cutoff_frequency))
    return make_nano_hexapod(add_damping(args, strut), payload_mass=args.payload_mass, spindle_rpm=spindle_rpm)


def add_damping(args: Namespace, strut: Scene) -> Scene:
    """Return a strut with the damping of the arguments."""
    return with_own_damping(strut, args.damping_ratio) if args.damping_ratio else replace(strut, damping_ratio=0.0)


@cache
def _actuator(coarse: bool) -> ReducedBody:
    return reduced_apa300ml(ports=PORTS, **(COARSE if coarse else {}))


def excite(scene: Scene, time: np.ndarray, signals: Mapping[str, np.ndarray]) -> TimeHistory:
    """Return signals, (n,), as excitation of all inputs of a scene; inputs without a signal are zero."""
    values = [signals.get(name, np.zeros(len(time))) for name in scene.inputs]
    return TimeHistory(time, values, scene.inputs, tuple(map(scene.input_unit, scene.inputs)))


def settling_time(model: LinearModel, left: float) -> float:
    """Return the time after which the slowest motion of a stable model has decayed to a share [s]."""
    return float(np.log(left) / model.poles().real.max())
