"""The nano-hexapod as scripts drive it: its scene, the names of its struts' signals, what moves it."""

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
"""Fidelity of the struts' bodies and method of `simulate` by the name that arguments know."""
HIGHEST = 600.0
"""Of the frequencies that are looked at [Hz]; bodies keep what they need below three times that."""
SAMPLE_RATE = 10e3
"""Of the real machine's control system and of all records [Hz]."""


def add_machine(arguments: ArgumentParser, *, method: bool = True) -> None:
    """Arguments that say which hexapod, and how it is simulated unless a script does it in all ways."""
    arguments.add_argument("--payload-mass", type=positive, default=10.0, help="on the top plate [kg] (default: 10)")
    arguments.add_argument(
        "--damping-ratio", type=fraction, default=0.01, help="of a mode at 100 Hz, others in proportion (default: 0.01)"
    )
    arguments.add_argument("--coarse", action="store_true", help="actuators of tetrahedra of 8 mm, for a quick look")
    if method:
        arguments.add_argument(
            "--method", choices=METHODS, default="exact", help="exact or integrated linear bodies, or floating frames"
        )


def hexapod(
    args: Namespace,
    *,
    method: str | None = None,
    spindle_rpm: float = 0.0,
    cutoff_frequency: float | None = 3 * HIGHEST,
) -> Scene:
    """The hexapod of the arguments, its six struts trimmed, None: not, and damped part by part.

    Trimmed struts remember their coordinates, so that their motion is that of the whole ones.
    """
    fidelity, _ = METHODS[method or args.method]
    whole = fe_strut(fidelity, apa=_actuator(args.coarse))
    strut = trim_scene(replace(traced(whole), cutoff_frequency=cutoff_frequency))
    return make_nano_hexapod(add_damping(args, strut), payload_mass=args.payload_mass, spindle_rpm=spindle_rpm)


def add_damping(args: Namespace, strut: Scene) -> Scene:
    """A strut with the damping of the arguments."""
    return with_own_damping(strut, args.damping_ratio) if args.damping_ratio else replace(strut, damping_ratio=0.0)


@cache
def _actuator(coarse: bool) -> ReducedBody:
    return reduced_apa300ml(ports=PORTS, **(COARSE if coarse else {}))


def excite(scene: Scene, time: np.ndarray, signals: Mapping[str, np.ndarray]) -> TimeHistory:
    """Signals, (n,), as excitation of all of a scene's inputs; those not given are zero."""
    values = [signals.get(name, np.zeros(len(time))) for name in scene.inputs]
    return TimeHistory(time, values, scene.inputs, tuple(map(scene.input_unit, scene.inputs)))


def settling_time(model: LinearModel, left: float) -> float:
    """Time after which the slowest motion of a stable model has this share of its size [s]."""
    return float(np.log(left) / model.poles().real.max())
