"""Static equilibrium of a scene under its loads: where its points are, and what its joints and springs bear."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.base.short_repr import short_repr
from nassim.scene.scene import Scene
from nassim.scene.terms import ForceLaw
from nassim.simulation.loaded.first_order_equilibrium import check_small, is_at_equilibrium
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.loaded.loads import static_loads
from nassim.simulation.loaded.settling import newton_equilibrium
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.displacement import displaced
from nassim.simulation.model.states import SceneState


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
    """Compute the static equilibrium under gravity, preload and constant inputs, and what the parts bear there.

    Bodies turn with their frames, and joints and springs with them; a column near its buckling load deflects
    accordingly. With motions that nothing holds, and for an unstable equilibrium, the result is of first order in the
    loads, about the reference configuration; such motions accelerate, and the forces are those during this
    acceleration.

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
    scene = assembly.scene
    loads = loaded_state(assembly, gravity=scene.gravity, inputs=inputs, checked=False)
    check_small(
        assembly.coordinates,
        assembly.modal.modes @ loads.equilibrium,
        "its loads",
        settled=is_at_equilibrium(assembly),
    )
    there = None if np.any(assembly.modal.rigid_modes) else newton_equilibrium(assembly, loads)
    if there:
        states, constraints = there.assembly.coordinates.states, there.assembly.constraints
        borne = there.borne
    else:
        values = {name: loads.constant_input(name) for name in scene.inputs}
        rest = static_loads(assembly, GeometricStiffness.of(assembly), np.asarray(scene.gravity), values)[1]
        states = displaced(assembly.coordinates, rest.displacement).states
        constraints, borne = assembly.constraints, rest.borne
    motions = {
        f"{body.name}.{point}": _motion(states[body.name], point)
        for body in scene.bodies
        if body.moves
        for point in body.point_names
    }
    springs: dict[str, dict[str, float]] = {}
    for part in scene.springs:
        laws = [term for term in part.terms(scene) if isinstance(term, ForceLaw)]
        for k, law in enumerate(laws, start=1):
            value = law.measure.evaluate(states)[0]
            force = law.static_resistance(value)
            names = law.measure.components if len(laws) == 1 else [f"{k}.{name}" for name in law.measure.components]
            springs.setdefault(part.name, {}).update(zip(names, force.tolist(), strict=True))
    return LoadedEquilibrium(motions, _joint_forces(constraints, borne), springs)


def _motion(state: SceneState, point: str) -> Array:
    """Return the displacement and the rotation vector of a point since the reference configuration, (6,)."""
    position, rotation = state.pose(point)
    return np.concatenate([position - state.reference(point), Rotation.from_matrix(rotation).as_rotvec()])


def _joint_forces(constraints: Constraints, borne: Array) -> dict[str, dict[str, float]]:
    """Split the forces that constraints bear, (n_all,), by joints and components."""
    coordinates, kept = constraints.coordinates, constraints.kept
    rows = constraints.rows / coordinates.scale
    size = np.linalg.norm(rows, axis=1)
    forces = np.linalg.lstsq((rows / size[:, None]).T, borne / coordinates.scale, rcond=None)[0] / size
    result: dict[str, dict[str, float]] = {name: {} for name in coordinates.scene.constraints}
    for (joint, component), force in zip(kept, forces[len(rows) - len(kept) :].tolist(), strict=True):
        result[joint.name][component] = force
    return result
