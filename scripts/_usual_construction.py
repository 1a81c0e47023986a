"""The bench as Exudyn's examples build it, to measure against, for benchmark_stepping.py.

The reduced body is the same, but tied by all nodes of its faces (mean of their motions) and pushed by a connector with
a force function.
"""

from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from _usual_items import add_flexible_body, add_guided_mass

from nassim import ReducedBody, RigidBody, Scene, TimeHistory

STEP = 1e-4


def usual_construction(scene: Scene, noise: TimeHistory) -> Any:
    """Encoder signal of the bench built as Exudyn's examples do, in steps of 0.1 ms."""
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    body, payload = scene.flexible_bodies[0], scene.bodies[2]
    assert isinstance(payload, RigidBody)
    faces = nodes_of_faces(body.reduced)
    markers = add_flexible_body(mbs, scene, faces)
    # The mean of the nodes lies 0.2 mm beside the remote point; joints that start open there would swamp the answer.
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
    """The skin's nodes within 12 mm of each remote point in the plane of its face."""
    assert body.surface is not None
    result = {}
    for point in body.remote_points:
        away = body.surface.points - point.position
        axis = 2 if point.name in ("bottom", "top") else 0
        result[point.name] = np.flatnonzero((np.abs(away[:, axis]) < 1e-7) & (np.linalg.norm(away, axis=1) < 12e-3))
    return result


def solve(mbs: Any, steps: int) -> None:
    """Generalized-alpha without numerical damping."""
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.numberOfSteps = steps
    settings.timeIntegration.endTime = steps * STEP
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    settings.solution.sensors.writePeriod = STEP
    mbs.SolveDynamic(settings)
