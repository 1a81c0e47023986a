"""Measure what the stiffness of loads costs, in a reduction, in steps of floating frames and in linear models.

The bench and the nano-hexapod stand under gravity; a blade turns on a drive. Runs with and without this
stiffness alternate, on one thread, and the fastest counts. Times are CPU times.
"""

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import netgen.occ as occ
import numpy as np

from common.arguments import parser, run, whole
from common.costs import compared
from common.report import print_table, write_summary
from models.apa300ml import COARSE, PORTS, make_apa300ml, reduced_apa300ml
from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut
from nassim import (
    Drive,
    FEModel,
    FlexibleBody,
    Material,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    TimeHistory,
    build_fe_model,
    condense,
    craig_bampton,
    linearize,
    revolute,
    simulate,
)

STEP = 1e-4
SPEED = 10.0
"""Of the blade [rad/s]."""
LENGTH, WIDTH, THICKNESS = 0.3, 0.03, 5e-3
"""Of the blade [m]."""
CUTOFF = 600.0
"""Of the hexapod's struts [Hz]."""
arguments = parser(__doc__, "benchmark_loaded")
arguments.add_argument("--steps", type=whole(20), default=2000, help="steps of 0.1 ms (default: 2000)")
arguments.add_argument(
    "--turns", type=whole(1), default=5, help="repetitions, of which the fastest counts (default: 5)"
)
COLUMNS = {"without [ms]": "without_s*1e3:.3g", "with [ms]": "with_s*1e3:.3g", "ratio": "ratio:.2f"}


def reduction(model: FEModel, geometric_stiffness: bool) -> ReducedBody:
    """The body of an FE model, from the mesh."""
    condensed = condense(model, progress=False)
    return craig_bampton(condensed, geometric_stiffness=geometric_stiffness, progress=False)


def run_in_time(scene: Scene, n_steps: int, stress: str = "start") -> TimeHistory:
    """Steps of a scene with one input, which stays small."""
    time = np.arange(n_steps + 1) * STEP
    if scene.prescribed:
        values, unit = SPEED * time, "rad"
    else:
        values, unit = 1e-3 * np.sin(2 * np.pi * 50 * time), "V"
    excitation = TimeHistory(time, values[None], scene.inputs, (unit,))
    return simulate(scene, excitation, time_step=STEP, stress=stress, progress=False)


def turning_blade() -> Scene:
    """A blade on a drive that follows an angle."""
    shape = occ.Box(occ.Pnt(0, -WIDTH / 2, -THICKNESS / 2), occ.Pnt(LENGTH, WIDTH / 2, THICKNESS / 2))
    shape.name = "blade"
    shape.faces.Min(occ.X).name = "root"
    steel = Material("steel", 200e9, 0.3, 7800.0)
    solid = Solid("blade", shape, {"blade": steel}, (RemotePoint("root", "root", np.zeros(3), "rbe2"),))
    model = build_fe_model(solid, element_size=WIDTH / 2, order=3)
    body = FlexibleBody("blade", craig_bampton(model, n_modes=6, geometric_stiffness=True))
    ground, shaft = (
        RigidBody("ground", {"c": np.zeros(3)}, fixed=True),
        revolute("shaft", "ground.c", "blade.root", "z"),
    )
    return Scene("blade", (ground, body), (shaft,), (Drive("motor", "shaft", "rz", input="angle"),))


def main() -> None:
    args = arguments.parse_args()
    model = build_fe_model(make_apa300ml(ports=PORTS), element_size=COARSE["element_size"], order=COARSE["order"])
    plain, stiffened = (reduced_apa300ml(ports=PORTS, geometric_stiffness=kind, **COARSE) for kind in (False, True))
    benches = [make_bench(apa=apa, gravity=True) for apa in (plain, stiffened)]
    strut = fe_strut(apa=stiffened, fidelity="linear")
    hexapod = make_nano_hexapod(strut, payload_mass=50.0, gravity=True, cutoff_frequency=CUTOFF)
    blade = turning_blade()
    ways: dict[str, tuple[Callable[[], Any], Callable[[], Any], int]] = {
        "reduction of the actuator": (partial(reduction, model, False), partial(reduction, model, True), 1),
        "step of the bench": (*(partial(run_in_time, bench, args.steps) for bench in benches), args.steps),
        "step of a blade, present stress": (
            partial(run_in_time, blade, args.steps, "start"),
            partial(run_in_time, blade, args.steps, "present"),
            args.steps,
        ),
        "linear model of the bench": (*(partial(linearize, benches[1], loaded=kind) for kind in (False, True)), 1),
        "linear model of the hexapod": (*(partial(linearize, hexapod, loaded=kind) for kind in (False, True)), 1),
    }
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*which is only estimated|.*that its finite elements leave")
        rows = {name: compared(*work, args.turns) for name, work in ways.items()}
    print_table("under gravity or a spin", rows, COLUMNS)
    write_summary(args.output, rows)


if __name__ == "__main__":
    run(main)
