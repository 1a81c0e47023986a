"""Steps per second of the bench in every fidelity, side by side with the usual Exudyn construction.

The usual construction carries the same reduced body, but ties it by all nodes of the faces (mean of their motions) and
pushes it by a connector with a force function; it is so slow that it only takes the first 5 % of the steps. All
routes take the same record of noise, in one run, in turns.
"""

import time
from collections.abc import Callable
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from _common import parser, run, whole, write_summary
from exudyn.rigidBodyUtilities import GetRigidBodyNode

from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import RigidBody, Scene, TimeHistory, frequency_response, linearize, simulate
from nassim.signals import band_limited_noise
from nassim.simulation import assemble, deformation_damping

CUTOFF = 1500.0
USUAL = "usual construction"
ROUTES: dict[str, dict[str, Any]] = {
    "ffrf": {},
    "ffrf, trimmed": {"cutoff_frequency": CUTOFF},
    "linear": {"fidelity": "linear"},
    "linear, trimmed": {"fidelity": "linear", "cutoff_frequency": CUTOFF},
    "exact": {"fidelity": "linear", "method": "exact"},
}

arguments = parser(__doc__, "benchmark_stepping")
arguments.add_argument("--steps", type=whole(20), default=10000, help="of 0.1 ms, per route and turn (default: 10000)")
arguments.add_argument("--turns", type=whole(1), default=3, help="the fastest of which counts (default: 3)")


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    # Nanometres: where the fidelities must agree.
    noise = band_limited_noise(args.steps * 1e-4, 1e4, cutoff_frequency=300.0, rms=1e-5)
    few = args.steps // 20
    start_only = TimeHistory(noise.time[: few + 1], noise.values[:, : few + 1], noise.names, noise.units)
    runs: dict[str, Callable[[], Any]] = {USUAL: lambda: usual_construction(make_bench(apa=apa), start_only)}
    for label, options in ROUTES.items():
        method = options.get("method", "generalized_alpha")
        scene = make_bench(apa=apa, **{key: value for key, value in options.items() if key != "method"})
        runs[label] = lambda scene=scene, method=method: simulate(
            scene, noise, time_step=1e-4, method=method, progress=False
        )["encoder"]
    per_step = dict.fromkeys(runs, np.inf)
    records = {}
    for _ in range(args.turns):
        for label, route in runs.items():
            start = time.perf_counter()
            records[label] = route()
            steps = len(records[label]) - 1
            per_step[label] = min(per_step[label], (time.perf_counter() - start) / steps)

    exact = records["exact"]
    print(f"\n{'':<22}us/step  steps/s  times ffrf  times usual  real time   error of d_e against exact")
    summary: dict[str, Any] = {"steps": args.steps, "time_step_s": 1e-4}
    for label, wall in per_step.items():
        ratios = per_step["ffrf"] / wall, per_step[USUAL] / wall
        part = exact[: len(records[label])]
        error = float(np.abs(records[label] - part).max() / np.abs(part).max())
        print(
            f"  {label:<18}{1e6 * wall:9.1f} {1 / wall:9.0f} {ratios[0]:9.2f} {ratios[1]:12.1f} "
            f"{1e-4 / wall:10.2f} {100 * error:12.3g} %"
        )
        key = label.replace(",", "").replace(" ", "_")
        summary |= {f"{key}_us_per_step": 1e6 * wall, f"{key}_steps_per_s": 1 / wall}
        summary |= {f"{key}_speed_over_real_time": 1e-4 / wall, f"{key}_speed_over_ffrf": ratios[0]}
        summary |= {f"{key}_speed_over_usual": ratios[1], f"{key}_encoder_error": error}
    print("(the steps' error is that of the integrator, which lengthens periods)")

    frequency = np.geomspace(1, 500, 500)
    full, trimmed = (
        frequency_response(linearize(make_bench(apa=apa, cutoff_frequency=f)), frequency).values for f in (None, CUTOFF)
    )
    scale = np.maximum(np.abs(full), np.abs(full[:, :, :1]))
    summary["trimmed_frf_error"] = float(np.max(np.abs(trimmed - full) / scale))
    print(f"FRFs of the trimmed bench up to 500 Hz: within {100 * summary['trimmed_frf_error']:.2g} %")
    summary["trimmed_scene"] = make_bench(apa=apa, cutoff_frequency=CUTOFF).summary()
    print(summary["trimmed_scene"])
    write_summary(args.output, summary)


def usual_construction(scene: Scene, noise: TimeHistory) -> Any:
    """Encoder signal of the bench built as Exudyn's examples do."""
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    assembly = assemble(scene)
    body, payload = scene.flexible_bodies[0], scene.bodies[2]
    assert isinstance(payload, RigidBody)
    frame, reduced = assembly.frames[body.name], body.reduced
    assert reduced.surface is not None
    assert reduced.surface_modes is not None
    points = reduced.surface.points
    faces = {}
    for point in reduced.remote_points:
        away = points - point.position
        axis = 2 if point.name in ("bottom", "top") else 0
        faces[point.name] = np.flatnonzero((np.abs(away[:, axis]) < 1e-7) & (np.linalg.norm(away, axis=1) < 12e-3))
    chosen = np.concatenate(list(faces.values()))
    rows = reduced.surface_modes[chosen][:, :, frame.flexible].reshape(3 * len(chosen), -1)
    n = rows.shape[1]
    node = mbs.AddNode(GetRigidBodyNode(exu.NodeType.RotationEulerParameters, position=list(frame.origin)))
    zero = [0.0] * n
    modes = mbs.AddNode(
        eii.NodeGenericODE2(
            numberOfODE2Coordinates=n, referenceCoordinates=zero, initialCoordinates=zero, initialCoordinates_t=zero
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
            dampingMatrixReduced=container_of(deformation_damping(assembly)),
            mPhitTPsi=frame.translation_flexible,
            mPhitTPsiTilde=frame.translation_rotated,
            mXRefTildePsi=frame.position_flexible,
            mXRefTildePsiTilde=frame.position_rotated,
            mPsiTildePsi=frame.rotated_flexible,
            mPsiTildePsiTilde=frame.rotated_rotated,
            modeBasis=rows,
            referencePositions=(points[chosen] - frame.origin).ravel(),
        )
    )
    markers, start = {}, 0
    for name, face in faces.items():
        kind = eii.MarkerSuperElementRigid if name in ("bottom", "top") else eii.MarkerSuperElementPosition
        nodes = list(range(start, start + len(face)))
        markers[name] = mbs.AddMarker(
            kind(bodyNumber=number, meshNodeNumbers=nodes, weightingFactors=[1 / len(face)] * len(face))
        )
        start += len(face)
    ground = mbs.AddObject(eii.ObjectGround())
    # The mean of the nodes lies 0.2 mm beside the remote point; joints that start open there would swamp the answer.
    bottom, top = (points[faces[name]].mean(axis=0) for name in ("bottom", "top"))
    feet = [mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=ground, localPosition=list(p))) for p in (bottom, top)]
    mass_node = mbs.AddNode(eii.NodeRigidBodyEP(referenceCoordinates=[*payload.position, 1.0, 0.0, 0.0, 0.0]))
    j = np.diag(np.asarray(payload.inertia))
    mass = mbs.AddObject(eii.ObjectRigidBody(nodeNumber=mass_node, mass=payload.mass, inertia=[*j, 0.0, 0.0, 0.0]))
    below = mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=mass, localPosition=list(top - payload.position)))
    for pair, axes in (
        ([feet[0], markers["bottom"]], [1] * 6),
        ([markers["top"], below], [1] * 6),
        ([feet[1], below], [1, 1, 0, 1, 1, 1]),
    ):
        mbs.AddObject(eii.ObjectJointGeneric(markerNumbers=pair, constrainedAxes=axes))
    actuator = scene.actuators[0]
    force = actuator.gain * actuator.force_per_volt
    volts = noise.values[0].tolist()
    mbs.AddObject(
        eii.ObjectConnectorSpringDamper(
            markerNumbers=[markers["junction"], markers["actuator_end"]],
            referenceLength=1.0,
            stiffness=1.0,
            springForceUserFunction=lambda _m, t, _n, _l, _v, _k, _d, _f: -force * volts[int(t / 1e-4 + 0.5)],
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
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.numberOfSteps = len(volts) - 1
    settings.timeIntegration.endTime = (len(volts) - 1) * 1e-4
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    settings.solution.sensors.writePeriod = 1e-4
    mbs.SolveDynamic(settings)
    return mbs.GetSensorStoredData(sensor)[:, 3]


def container_of(matrix: Any) -> Any:
    """A dense matrix as Exudyn takes it."""
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result


if __name__ == "__main__":
    run(main)
