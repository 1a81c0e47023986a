"""Static stress of a scene's bodies, and the largest load that keeps a limit of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, known
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.bodies.stress import largest_factor
from nassim.scene.bodies import FlexibleBody
from nassim.scene.motion import Motion
from nassim.scene.port_voltages import known_voltages, static_voltages
from nassim.scene.scene import Scene
from nassim.scene.stress_peaks import place_text, stress_fields, warn_of_mesh_error
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.loaded.equilibrium import balance, check_small
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loaded_state import NO_LOAD, loaded_state, static_loads
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.recorded_motion import original_coordinates, recorded_motion, traced


@dataclass(frozen=True)
class LoadLimit:
    """The largest factor on loads for which the von Mises stress of a body keeps a limit.

    Attributes:
        factor: factor on the inputs, or on the angular velocity [-]; inf where no factor reaches the limit
        limit: the limit [Pa]
        loads: values of the inputs at the limit, by name, or the size of the "angular velocity"
        units: units of the loads
        place: name of the stress surface or point where the limit is reached
        position: the point in the body's frame, (3,) [m]
        mesh_error: estimated error of the stress there by the finite elements, relative to the limit [-]
    """

    factor: float
    limit: float
    loads: Mapping[str, float]
    units: tuple[str, ...]
    place: str
    position: Array
    mesh_error: float

    __repr__ = short_repr

    def __str__(self) -> str:
        """Describe the limit, with units."""
        if not np.isfinite(self.factor):
            return f"no load reaches {1e-6 * self.limit:.4g} MPa von Mises"
        pairs = zip(self.loads.items(), self.units, strict=True)
        loads = ", ".join(f"{name} {value:.4g} {unit}" for (name, value), unit in pairs)
        stress, error = f"{1e-6 * self.limit:.4g} MPa von Mises", f"(mesh: +-{100 * self.mesh_error:.2g} %)"
        return f"{loads} for {stress} at {self.place!r}{place_text(self.position)} {error}"


def static_motion(
    scene: Scene,
    *,
    inputs: Mapping[str, float] | None = None,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    gravity: bool = True,
) -> Motion:
    """Compute the bodies at rest under gravity, constant inputs and a spin of the scene, as a motion of one time.

    The result is of first order in gravity and inputs, about the reference configuration. Motions that nothing holds
    accelerate: the deformation is that during this acceleration. The spin, if any, also stiffens and softens.

    Args:
        scene: the scene; its loops are open.
        inputs: constant values of inputs, by name; others are zero. Drives may be among them: strokes and angles.
        angular_velocity: constant angular velocity of the scene, along its axes, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
        gravity: whether the scene's gravity acts.

    Returns:
        The motion, with the coordinates of `FlexibleBody.reduced`.

    Raises:
        ValueError: for unknown inputs, and for an equilibrium beyond small motion.
    """
    assembly = assemble(traced(scene))
    displacement = _rest(assembly, inputs or {}, angular_velocity, axis_point, gravity=gravity)
    check_small(assembly.coordinates, displacement, "its loads")
    own = {name: displacement[None, place] for name, place in assembly.coordinates.slices.items()}
    motion = recorded_motion(assembly.scene, np.zeros(1), own, {})
    voltages: dict[str, dict[str, Array]] = {}
    for body, port, voltage in known_voltages(scene):
        at_rest = voltage.at_rest(motion.coordinates[body.name][0], inputs or {})
        voltages.setdefault(body.name, {})[port] = np.array([at_rest])
    return replace(motion, voltages=voltages)


def load_limit(
    scene: Scene,
    limit: float,
    *,
    body: str,
    inputs: Mapping[str, float] | None = None,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    voltages: Mapping[str, float] | None = None,
    place: str | None = None,
) -> LoadLimit:
    """Find the largest factor on inputs, or on a speed, for which the von Mises stress of a body keeps a limit.

    Stress grows in proportion to the inputs, and to the square of the speed; gravity stays as it is. A payload is a
    `PointForce` of its weight, a stroke the input of a `Drive`.

    Args:
        scene: the scene.
        limit: largest von Mises stress allowed [Pa].
        body: name of the flexible body.
        inputs: values of inputs that grow together, by name: forces, voltages, strokes.
        angular_velocity: angular velocity of the whole scene that grows, (3,) [rad/s]; instead of inputs.
        axis_point: a point of the axis, (3,) [m].
        voltages: voltages of the body's electrical ports that grow with the inputs, by name [V], in place of those that
            the scene's amplifiers and open circuits give them: they stress the stacks themselves.
        place: name of the body's stress surface or point (default: all of them).

    Returns:
        The limit.

    Raises:
        ValueError: for both or neither of inputs and angular_velocity, for a body that keeps no stress, and if gravity
            alone exceeds the limit; also for a limit that is reached beyond small motion only.

    Warns:
        UserWarning: for a limit that is reached near the limit of small motion, and for an estimated error of the mesh
            above a tenth of the stress.
    """
    spin = np.any(angular_velocity)
    if bool(inputs) == bool(spin):
        raise ValueError("give either inputs or an angular_velocity: the loads that the factor multiplies")
    part, _ = scene.split(f"{body}.")
    if not isinstance(part, FlexibleBody):
        raise ValueError(f"body {body!r} is rigid, so it has no stress")
    fields = stress_fields(part, place)
    assembly = assemble(traced(scene))
    constant = _rest(assembly, {}, NO_LOAD, axis_point, gravity=True)
    grown = _rest(assembly, inputs or {}, angular_velocity, axis_point, gravity=False)
    rest, unit = (original_coordinates(assembly, shape[:, None])[body][:, 0] for shape in (constant, grown))
    at_rest = static_voltages(scene, part, rest, {})
    growing = static_voltages(scene, part, unit, inputs or {}, voltages)
    size = {"angular velocity": float(np.linalg.norm(angular_velocity))} if spin else dict(inputs or {})
    units = ("rad/s",) if spin else tuple(scene.input_unit(name) for name in size)
    found = []
    for field in fields:
        factors = largest_factor(field.stress(rest, at_rest), field.stress(unit, growing), limit)
        k = int(np.argmin(factors))
        factor = float(factors[k])
        reached = rest + factor * unit if np.isfinite(factor) else rest
        error = float(field.mesh_error(reached)[k]) / limit
        grows = float(np.sqrt(factor)) if spin else factor
        loads = {name: grows * value for name, value in size.items()}
        found.append(LoadLimit(grows, limit, loads, units, field.name, field.positions[k], error))
    least = min(found, key=lambda one: one.factor)
    if np.isfinite(least.factor):
        reached = constant + (least.factor**2 if spin else least.factor) * grown
        check_small(assembly.coordinates, reached, "the loads at the limit")
        warn_of_mesh_error(body, least.place, least.position, limit, least.mesh_error * limit)
    return least


def _rest(
    assembly: Assembly,
    inputs: Mapping[str, float],
    angular_velocity: ArrayLike,
    axis_point: ArrayLike,
    *,
    gravity: bool,
) -> Array:
    """Return the displacement of an assembled scene at rest under loads, in all coordinates, (n_all,)."""
    scene = assembly.scene
    values = {known("input", name, scene.inputs): finite(name, value) for name, value in inputs.items()}
    pull = np.asarray(scene.gravity) * gravity
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    if not velocity.any():
        return _moved_by_drives(assembly, values) + _under_forces(assembly, pull, values)
    state = loaded_state(assembly, gravity=pull, inputs=values, angular_velocity=velocity, axis_point=axis_point)
    result: Array = assembly.modal.modes @ state.equilibrium
    return result


def _moved_by_drives(assembly: Assembly, values: Mapping[str, float]) -> Array:
    """Return the displacement at rest by drives that follow inputs, in all coordinates, (n_all,)."""
    drives, names = assembly.signals.prescribed, assembly.scene.inputs
    moved: Array = drives.motion @ [values.get(names[index], 0.0) for index in drives.inputs]
    if not moved.any():
        return moved
    if not all(tangent.law.is_linear for tangent in assembly.tangents):
        raise ValueError(
            "a stroke is a load of linear scenes only, and this one has a nonlinear spring: let a force act in place "
            "of the drive, and scale by the displacement that it causes"
        )
    # The motion keeps the charge of ports with a resistance, which is gone at rest.
    circuits = assembly.signals.port_circuits
    charged = sum((one.forces * (one.forces @ moved) / one.storage for one in circuits), np.zeros(len(moved)))
    return moved + balance(assembly, charged).displacement


def _under_forces(assembly: Assembly, gravity: Array, values: Mapping[str, float]) -> Array:
    """Return the displacement at rest by gravity and by inputs that move no drive, in all coordinates, (n_all,)."""
    still = replace(assembly, terms=tuple(term for term in assembly.terms if not isinstance(term, PrescribedMotion)))
    return static_loads(still, GeometricStiffness.of(still), gravity, values)[1].displacement
