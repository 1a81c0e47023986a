"""Static equilibrium of a scene under its loads: where its points rest, and what its joints and springs bear."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array, finite, known
from nassim.base.short_repr import short_repr
from nassim.scene.scene import Scene
from nassim.scene.terms import Constraint, ForceLaw, PrescribedMotion
from nassim.simulation.loaded.equilibrium import check_small
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loaded_state import static_loads
from nassim.simulation.model.assembly import Assembly, assemble


@dataclass(frozen=True)
class LoadedEquilibrium:
    """A scene at rest under constant loads.

    Forces are positive where they resist a positive value of their measure, as `ForceSensor` reads them: they pull the
    first point along the component's axis and the second point against it.

    Attributes:
        motions: displacement and rotation of each point of the bodies that move, from the reference configuration along
            the world's axes, by "body.point", (6,) [m, rad].
        joint_forces: forces and torques in the components that each joint or its drive holds, by name of joint and
            component [N, N m]. Components that other joints hold already are left out: their share is not determined.
        spring_forces: forces and torques of each part with springs, by name of part and component [N, N m]. Components
            of a part with several force laws begin with their number, as in "2.value".
    """

    motions: dict[str, Array]
    joint_forces: dict[str, dict[str, float]]
    spring_forces: dict[str, dict[str, float]]
    __repr__ = short_repr


def loaded_equilibrium(scene: Scene, *, inputs: Mapping[str, float] | None = None) -> LoadedEquilibrium:
    """Compute where a scene rests under gravity, preload and constant inputs, and what its parts bear.

    The result is of first order in the loads, about the reference configuration, as that of `linearize`. Motions that
    nothing holds accelerate, and the forces are those during this acceleration.

    Args:
        scene: the scene; its drives are at rest.
        inputs: constant values of inputs, by name; others are zero.

    Returns:
        The equilibrium.

    Raises:
        ValueError: for unknown inputs, and for an equilibrium beyond small motion.

    Warns:
        UserWarning: for an equilibrium near the limit of small motion.
    """
    assembly = assemble(scene)
    scene, coordinates = assembly.scene, assembly.coordinates
    values = {known("input", name, scene.inputs): finite(name, value) for name, value in (inputs or {}).items()}
    _, rest = static_loads(assembly, GeometricStiffness.of(assembly), np.asarray(scene.gravity), values)
    check_small(coordinates, rest.displacement, "its loads")
    motions = {
        f"{body.name}.{point}": body.motion(point) @ rest.displacement[coordinates.slices[body.name]]
        for body in scene.bodies
        if body.moves
        for point in body.point_names
    }
    springs: dict[str, dict[str, float]] = {}
    for part in scene.springs:
        laws = [term for term in part.terms(scene) if isinstance(term, ForceLaw)]
        for k, law in enumerate(laws, start=1):
            value = coordinates.jacobian(law.measure) @ rest.displacement
            force = law.resistance(value, np.zeros(len(value)))
            names = law.measure.components if len(laws) == 1 else [f"{k}.{name}" for name in law.measure.components]
            springs.setdefault(part.name, {}).update(zip(names, force.tolist(), strict=True))
    return LoadedEquilibrium(motions, _joint_forces(assembly, rest.borne), springs)


def _joint_forces(assembly: Assembly, borne: Array) -> dict[str, dict[str, float]]:
    """Split the forces that constraints bear, (n_all,), by joints and components."""
    constraints, scene = assembly.constraints, assembly.scene
    held = {joint.name: joint.held for joint in scene.terms_of(Constraint)}
    labels = [(name, c) for name, own in constraints.enforced.items() for c in own if c in held[name]]
    labels += [(drive.constraint, drive.component) for drive in scene.terms_of(PrescribedMotion)]
    rows = constraints.rows / assembly.coordinates.scale
    size = np.linalg.norm(rows, axis=1)
    forces = np.linalg.lstsq((rows / size[:, None]).T, borne / assembly.coordinates.scale, rcond=None)[0] / size
    result: dict[str, dict[str, float]] = {name: {} for name in held}
    for (name, component), force in zip(labels, forces[len(rows) - len(labels) :].tolist(), strict=True):
        result[name][component] = force
    return result
