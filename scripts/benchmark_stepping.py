"""Time steps of the bench and of hexapods with loops, in every fidelity, beside limits, peers and the exact solution.

The limit is Exudyn's own step of the same model without loops, checks and records, or the matrix product that exact
steps require at least. Peers are SciPy's `lsim` and the usual Exudyn construction: the same reduced body, connected by
the mean motion of all nodes of its faces and driven by a connector with a force function. That construction simulates
the first 5 % of the steps only. All routes receive the same noise in turns in one run on one thread. Times are CPU
times.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
import scipy
from exudyn.rigidBodyUtilities import GetRigidBodyNode
from threadpoolctl import threadpool_limits

from common.arguments import parser, run, whole
from common.costs import cpu_time
from common.limits import bare_product, exudyns_steps
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut, two_mass_strut, with_own_damping
from nassim import Loop, ReducedBody, RigidBody, Scene, TimeHistory, describe, frequency_response, linearize, simulate
from nassim.signals import band_limited_noise
from nassim.simulation import assemble
from nassim.systems import integral_force_feedback

STEP, EXACT = 1e-4, "exact"
STRUT_CUTOFF = 600.0
COMPENSATED = (0.05, 0.1, 0.2, 0.4, 1.0)
"""Time steps of the bench [ms]."""
COMPENSATED_ROUTES = {
    "exact": ("linear", EXACT),
    "linear": ("linear", "generalized_alpha"),
    "ffrf": ("ffrf", "generalized_alpha"),
}
LONGER = {"exact": 10, "linear": 1, "ffrf": 0.1}
"""Factors on the number of steps, with which the start of these routes takes a small share of the time."""
Faces = Mapping[str, np.ndarray]
"""Surface nodes by remote point."""

CUTOFF = 1500.0
USUAL, LSIM = "usual construction", "SciPy's lsim"
ALPHA = "generalized_alpha"
IFF = Loop("iff", integral_force_feedback(20.0, sample_rate=1 / STEP), "sensor_voltage", "actuator_voltage")
LOOPS = {"exact, loop": IFF, "exact, coarse loop": replace(IFF, input_step=1e-8, output_step=1e-8)}
ROUTES: dict[str, tuple[dict[str, Any], str]] = {
    "ffrf": ({}, ALPHA),
    "ffrf, trimmed": ({"cutoff_frequency": CUTOFF}, ALPHA),
    "linear": ({"fidelity": "linear"}, ALPHA),
    "linear, trimmed": ({"fidelity": "linear", "cutoff_frequency": CUTOFF}, ALPHA),
    **dict.fromkeys(("exact", *LOOPS), ({"fidelity": "linear"}, "exact")),
}
"""Options of the bench and methods of the simulation."""
arguments = parser(__doc__, "benchmark_stepping")
arguments.add_argument(
    "--steps", type=whole(20), default=10000, help="steps of 0.1 ms per route and turn (default: 10000)"
)
arguments.add_argument(
    "--turns", type=whole(1), default=3, help="repetitions, of which the fastest counts (default: 3)"
)
COLUMNS = {
    "us/step": "us_per_step:.1f",
    "limit": "limit_us_per_step:.2f",
    "peer": "peer_us_per_step:.0f",
    "times peer": "speed_over_peer:.1f",
    "difference": "difference:.1e",
    "real time": "speed_over_real_time:.2f",
    "error of d_e [%]": "encoder_error*100:.3g",
}
REPORT = """(steps correct the period errors of their rule; nassim.simulation.period_errors gives the remaining errors)
FRFs of the trimmed bench up to 500 Hz: within {trimmed_frf_error*100:.2g} %
{trimmed_scene}"""


@dataclass(frozen=True)
class Route:
    """Route to samples of d_e.

    Attributes:
        work: function that returns d_e, (n_samples,)
        step: time between the samples [s]
        true: name of the reference route
        brief: the same work with few steps, whose time is subtracted
        limit: the work that the steps require at least
        peer: name of the route of another program
    """

    work: Callable[[], Any]
    step: float
    true: str
    brief: Callable[[], Any] | None = None
    limit: Callable[[], Any] | None = None
    peer: str = ""


def simulated(scene: Scene, excitation: TimeHistory, output: str, step: float, method: str) -> Callable[[], Any]:
    """Return a simulation that gives one output."""
    run = partial(simulate, scene, excitation, time_step=step, method=method, outputs=[output], progress=False)
    return lambda: run()[output]


def race(routes: Mapping[str, Route], turns: int) -> dict[str, dict[str, float | None]]:
    """Measure every route; the fastest of several turns counts.

    All routes run one after the other on one thread. Times are CPU times, so other work on the machine has little
    effect.
    """
    whole, start, bare = ({name: np.inf for name in routes} for _ in range(3))
    found, best = {}, {}
    for name, route in list(routes.items()) * turns:
        with threadpool_limits(1):
            begun, brief = cpu_time(route.brief) if route.brief else ([0.0], 0.0)
            found[name], took = cpu_time(route.work)
            whole[name], start[name] = min(whole[name], took), min(start[name], brief)
            # With few steps on a busy machine, the start may hide the time of the steps.
            best[name] = max(whole[name] - start[name], 1e-3 * took) / (len(found[name]) - len(begun))
            if route.limit:
                bare[name] = min(bare[name], cpu_time(route.limit)[1] / (len(found[name]) - 1))
    figures = {}
    for name, route in routes.items():
        peer = found.get(route.peer)
        figures[name] = {
            "step_s": route.step,
            "us_per_step": 1e6 * best[name],
            "limit_us_per_step": 1e6 * bare[name] if route.limit else None,
            "peer_us_per_step": None if peer is None else 1e6 * best[route.peer],
            "speed_over_peer": None if peer is None else best[route.peer] / best[name],
            "difference": None if peer is None else _deviation(found[name], peer),
            "steps_per_s": 1 / best[name],
            "speed_over_real_time": route.step / best[name],
            "encoder_error": _deviation(found[name], found[route.true]),
        }
    return figures


def _deviation(found: Any, true: Any) -> float:
    """Return the largest difference over the common samples, as a share of the largest value."""
    n = min(len(found), len(true))
    return float(np.abs(found[:n] - true[:n]).max() / np.abs(true[:n]).max())


def limit(scene: Scene, method: str, step: float, n_steps: int, inputs: int = 1) -> Callable[[], Any]:
    """Return the work that steps with this number of inputs and one output require at least."""
    if method != EXACT:
        return exudyns_steps(scene, step, n_steps)
    return bare_product(len(linearize(replace(scene, loops=())).A), inputs, 1, n_steps)


def compensated(apa: ReducedBody, steps: int) -> dict[str, Route]:
    """Simulate the bench with several time steps over the same time, with noise up to 80 Hz.

    The argument is the number of steps of 0.1 ms.
    """
    # The voltage is linear between multiples of 1 ms, so all time steps have the same voltage.
    noise = band_limited_noise(max(steps * STEP, 0.05), 1e3, cutoff_frequency=80.0, rms=1e-5)
    result = {}
    for step in (1e-3 * milliseconds for milliseconds in COMPENSATED):
        for name, (fidelity, method) in COMPENSATED_ROUTES.items():
            bench = make_bench(apa=apa, fidelity=fidelity)
            label = f"bench {name}, {1e3 * step:g} ms"
            work = simulated(bench, noise, "encoder", step, method)
            bare = limit(bench, method, step, round(noise.duration / step))
            result[label] = Route(work, step, f"bench {EXACT}, {1e3 * step:g} ms", limit=bare)
    return result


def hexapods(apa: ReducedBody, steps: int) -> dict[str, Route]:
    """Simulate trimmed hexapods with 2, 4 or 6 finite element struts, other two-mass struts and six loops."""
    pushes = band_limited_noise(LONGER[EXACT] * steps * STEP, 1 / STEP, cutoff_frequency=300.0, rms=1e-3)
    result = {}
    for count in (2, 4, 6):
        for name, (fidelity, method) in COMPENSATED_ROUTES.items():
            scene, n = _hexapod(apa, count, fidelity), max(100, round(steps * LONGER[name]))
            forces = [word for word in scene.inputs if word.startswith("payload")]
            values = np.outer([word == "payload_force_z" for word in forces], pushes.values[0])
            units = tuple(map(scene.input_unit, forces))
            work, brief = (
                simulated(
                    scene,
                    TimeHistory(pushes.time[:samples], values[:, :samples], tuple(forces), units),
                    "strut_1/encoder",
                    STEP,
                    method,
                )
                for samples in (n + 1, max(n // 5, 40) + 1)
            )
            bare = limit(scene, method, STEP, n, len(forces))
            result[f"{count} struts {name}"] = Route(work, STEP, f"{count} struts {EXACT}", brief, bare)
    return result


def _hexapod(apa: ReducedBody, count: int, fidelity: str) -> Scene:
    # The middle mass of the two-mass actuator has a mode at 21 kHz. Sampled loops make it unstable without damping.
    struts = [fe_strut(fidelity, apa=apa)] * count + [with_own_damping(two_mass_strut())] * (6 - count)
    # Floating frames realise modal damping only in part, so the scene has none; the loops damp its modes.
    hexapod = make_nano_hexapod(struts, damping_ratio=0.0, cutoff_frequency=STRUT_CUTOFF)
    iff = integral_force_feedback(20.0, sample_rate=1 / STEP)
    names = [f"strut_{k}" for k in range(1, 7)]
    wires = [(f"{name}/sensor_voltage", f"{name}/actuator_voltage") for name in names]
    loops = [Loop(name, iff, *wire) for name, wire in zip(names, wires, strict=True)]
    return replace(hexapod, loops=tuple(loops))


def add_flexible_body(mbs: Any, scene: Scene, faces: Faces) -> dict[str, int]:
    """Add the scene's flexible body in a floating frame; return a marker per face, at the mean of its nodes."""
    assembly, body = assemble(scene), scene.flexible_bodies[0]
    frame, reduced = assembly.coordinates.frames[body.name], body.reduced
    assert reduced.surface is not None
    assert reduced.surface_modes is not None
    chosen = np.concatenate(list(faces.values()))
    rows = reduced.surface_modes[chosen][:, :, frame.flexible].reshape(3 * len(chosen), -1)
    zero = [0.0] * rows.shape[1]
    node = mbs.AddNode(GetRigidBodyNode(exu.NodeType.RotationEulerParameters, position=list(frame.origin)))
    modes = mbs.AddNode(
        eii.NodeGenericODE2(
            numberOfODE2Coordinates=len(zero),
            referenceCoordinates=zero,
            initialCoordinates=zero,
            initialCoordinates_t=zero,
        )
    )
    number = mbs.AddObject(
        eii.ObjectFFRFreducedOrder(
            nodeNumbers=[node, modes],
            mass=frame.mass,
            inertia=frame.inertia,
            centerOfMass=frame.center_of_mass,
            massMatrixReduced=container_of(frame.mass_matrix),
            stiffnessMatrixReduced=container_of(frame.stiffness_matrix),
            dampingMatrixReduced=container_of(assembly.modal.damping.on_deformation()),
            mPhitTPsi=frame.translation_flexible,
            mPhitTPsiTilde=frame.translation_rotated,
            mXRefTildePsi=frame.position_flexible,
            mXRefTildePsiTilde=frame.position_rotated,
            mPsiTildePsi=frame.rotated_flexible,
            mPsiTildePsiTilde=frame.rotated_rotated,
            modeBasis=rows,
            referencePositions=(reduced.surface.points[chosen] - frame.origin).ravel(),
        )
    )
    markers, start = {}, 0
    for name, face in faces.items():
        kind = eii.MarkerSuperElementRigid if name in ("bottom", "top") else eii.MarkerSuperElementPosition
        nodes, weights = list(range(start, start + len(face))), [1 / len(face)] * len(face)
        markers[name] = mbs.AddMarker(kind(bodyNumber=number, meshNodeNumbers=nodes, weightingFactors=weights))
        start += len(face)
    return markers


def add_guided_mass(
    mbs: Any, payload: RigidBody, markers: Mapping[str, int], bottom: np.ndarray, top: np.ndarray
) -> int:
    """Clamp the body's bottom and guide a payload on its top along z; return the payload's object."""
    ground = mbs.AddObject(eii.ObjectGround())
    feet = [mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=ground, localPosition=list(p))) for p in (bottom, top)]
    node = mbs.AddNode(eii.NodeRigidBodyEP(referenceCoordinates=[*payload.position, 1.0, 0.0, 0.0, 0.0]))
    j = np.diag(np.asarray(payload.inertia))
    mass = mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=payload.mass, inertia=[*j, 0.0, 0.0, 0.0]))
    below = mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=mass, localPosition=list(top - payload.position)))
    for pair, axes in (
        ([feet[0], markers["bottom"]], [1] * 6),
        ([markers["top"], below], [1] * 6),
        ([feet[1], below], [1, 1, 0, 1, 1, 1]),
    ):
        mbs.AddObject(eii.ObjectJointGeneric(markerNumbers=pair, constrainedAxes=axes))
    return mass


def container_of(matrix: Any) -> Any:
    """Return a dense matrix as Exudyn's container."""
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result


def usual_construction(scene: Scene, noise: TimeHistory) -> Any:
    """Return the encoder signal of the bench, built as in Exudyn's examples, with steps of 0.1 ms."""
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    body, payload = scene.flexible_bodies[0], scene.bodies[2]
    assert isinstance(payload, RigidBody)
    faces = nodes_of_faces(body.reduced)
    markers = add_flexible_body(mbs, scene, faces)
    # The mean of the nodes is 0.2 mm from the remote point; a joint with this initial gap would dominate the response.
    bottom, top = (body.reduced.surface.points[faces[name]].mean(axis=0) for name in ("bottom", "top"))
    mass = add_guided_mass(mbs, payload, markers, bottom, top)
    actuator = scene.actuators[0]
    force = actuator.gain * actuator.force_per_volt
    volts = noise.values[0].tolist()
    mbs.AddObject(
        eii.ObjectConnectorSpringDamper(
            markerNumbers=[markers["junction"], markers["actuator_end"]],
            referenceLength=1.0,
            stiffness=1.0,
            springForceUserFunction=lambda _m, t, _n, _l, _v, _k, _d, _f: -force * volts[int(t / STEP + 0.5)],
        )
    )
    sensor = mbs.AddSensor(
        eii.SensorBody(
            bodyNumber=mass,
            localPosition=list(payload.points["bottom"]),
            outputVariableType=exu.OutputVariableType.Displacement,
            storeInternal=True,
            writeToFile=False,
        )
    )
    solve(mbs, len(volts) - 1)
    return mbs.GetSensorStoredData(sensor)[:, 3]


def nodes_of_faces(body: ReducedBody) -> dict[str, np.ndarray]:
    """Return the surface nodes within 12 mm of each remote point in the plane of its face."""
    assert body.surface is not None
    result = {}
    for point in body.remote_points:
        away = body.surface.points - point.position
        axis = 2 if point.name in ("bottom", "top") else 0
        result[point.name] = np.flatnonzero((np.abs(away[:, axis]) < 1e-7) & (np.linalg.norm(away, axis=1) < 12e-3))
    return result


def solve(mbs: Any, steps: int) -> None:
    """Integrate by generalized-alpha without numerical damping."""
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.numberOfSteps = steps
    settings.timeIntegration.endTime = steps * STEP
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    settings.solution.sensors.writePeriod = STEP
    mbs.SolveDynamic(settings)


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    # Amplitudes are nanometres, for which all fidelities must agree.
    noise = band_limited_noise(args.steps * STEP, 1 / STEP, cutoff_frequency=300.0, rms=1e-5)
    few = args.steps // 20 + 1
    start_only = TimeHistory(noise.time[:few], noise.values[:, :few], noise.names, noise.units)
    routes = {USUAL: Route(partial(usual_construction, make_bench(apa=apa), start_only), STEP, "exact")}
    for label, (options, method) in ROUTES.items():
        scene = replace(make_bench(apa=apa, **options), loops=(LOOPS[label],) if label in LOOPS else ())
        true = "exact, loop" if label in LOOPS else "exact"
        peer = USUAL if method == ALPHA else "" if label in LOOPS else LSIM
        bare = limit(scene, method, STEP, args.steps)
        routes[label] = Route(simulated(scene, noise, "encoder", STEP, method), STEP, true, None, bare, peer)
    model = linearize(make_bench(apa=apa, fidelity="linear")).matrices
    routes[LSIM] = Route(lambda: scipy.signal.lsim(model, noise.values[0], noise.time)[1][:, 1], STEP, "exact")
    figures = race(routes, args.turns)
    summary: dict[str, Any] = {"steps": args.steps, "time_step_s": STEP}
    for label, row in figures.items():
        for other, name in (("ffrf", "ffrf"), (USUAL, "usual")):
            row[f"speed_over_{name}"] = row["steps_per_s"] / figures[other]["steps_per_s"]
        summary |= with_prefix(label, row)
    others = {"steps": compensated(apa, args.steps), "trimmed, six loops": hexapods(apa, max(args.steps, 200))}
    for label, row in (pair for more in others.values() for pair in race(more, args.turns).items()):
        summary |= with_prefix(label, row)
    frequency = np.geomspace(1, 500, 500)
    trimmed = make_bench(apa=apa, cutoff_frequency=CUTOFF)
    full, cut = (frequency_response(linearize(b), frequency).values for b in (make_bench(apa=apa), trimmed))
    scale = np.maximum(np.abs(full), np.abs(full[:, :, :1]))
    summary["trimmed_frf_error"] = float(np.max(np.abs(cut - full) / scale))
    summary["trimmed_scene"] = describe(trimmed)

    print_table("", {name: rows_of(summary, [name])[name] for name in routes}, COLUMNS)
    for title, more in others.items():
        print_table(title, {name: rows_of(summary, [name])[name] for name in more}, COLUMNS)
    print_report(REPORT, summary)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
