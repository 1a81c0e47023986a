"""Static stress of a scene's bodies, and the largest load that keeps a limit of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from nassim.base.checks import Array, finite, finite_array, known
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import mute_warnings, warn
from nassim.bodies.stress import StressField, largest_factor
from nassim.scene.motion import Motion
from nassim.scene.port_voltages import known_voltages, static_voltages
from nassim.scene.scene import Scene
from nassim.scene.stress_peaks import place_text, stress_fields, stressed_body, warn_of_mesh_error
from nassim.scene.terms import PrescribedMotion
from nassim.simulation.loaded.first_order_equilibrium import check_small, moved_by_drives
from nassim.simulation.loaded.loaded_state import NO_LOAD, loaded_state
from nassim.simulation.loaded.stability import describe_instability
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.recorded_motion import original_coordinates, recorded_motion, traced

State = tuple[Array, Mapping[str, float]]
"""Coordinates of a body, (n,), and voltages of its ports, by name [V]."""
CONVERGED, DOUBLINGS = 1e-4, 30
"""Relative change of a factor at which its search ends, and the doublings from 1 within which it is looked for."""


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

    The result is about the reference configuration, with the stiffness that loads, strokes and spin add.
    Motions that nothing holds accelerate: the deformation is that during this acceleration.

    Args:
        scene: the scene; its loops are open.
        inputs: constant values of inputs, by name; others are zero. Drives may be among them: strokes and angles.
        angular_velocity: constant angular velocity of the scene, along its axes, (3,) [rad/s].
        axis_point: a point of the axis, (3,) [m].
        gravity: whether the scene's gravity acts.

    Returns:
        The motion, with the coordinates of `FlexibleBody.reduced`.

    Raises:
        ValueError: for unknown inputs, for an equilibrium beyond small motion, and for a scene with a part that turns
            at constant speed without an angular_velocity.
    """
    _check_spin(scene, angular_velocity)
    assembly = assemble(traced(scene))
    displacement, loads = _rest(assembly, inputs or {}, angular_velocity, axis_point, gravity=gravity)
    check_small(assembly.coordinates, displacement, "its loads")
    strained = _strained(assembly, displacement, loads)
    own = {name: strained[None, place] for name, place in assembly.coordinates.slices.items()}
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

    Stress grows in proportion to the inputs, and to the square of the speed; gravity and preload stay as they are.
    Where loads or a spin stiffen or soften, as along a slender column, and where springs are nonlinear, the factor is
    that of the loads at the limit. A payload is a `PointForce` of its weight, a stroke the input of a `Drive`.

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
            alone exceeds the limit; also for a limit that is reached beyond small motion only, where the stress is so
            far from proportional to the loads that no factor is found, and for a scene with a part that turns, as
            `static_motion`.

    Warns:
        UserWarning: for a limit that is reached near the limit of small motion, for an estimated error of the mesh
            above a tenth of the stress, and for loads at the limit that make the equilibrium unstable.
    """
    if bool(inputs) == bool(np.any(angular_velocity)):
        raise ValueError("give either inputs or an angular_velocity: the loads that the factor multiplies")
    _check_spin(scene, angular_velocity)
    part = stressed_body(scene, body)
    stress_fields(part, place)
    assembly = assemble(traced(scene))
    loads = _GrowingLoads(assembly, dict(inputs or {}), np.asarray(angular_velocity, dtype=float), axis_point)
    constant = _strained(assembly, *loads.rest(0.0))

    def limit_by(scale: float) -> tuple[LoadLimit, bool]:
        """Return the limit by the growth of the stress up to the loads times a number, and whether these are stable."""
        displacement, state = loads.rest(scale)
        grown = (_strained(assembly, displacement, state) - constant) / scale**loads.power
        rest, unit = (original_coordinates(assembly, shape[:, None])[body][:, 0] for shape in (constant, grown))
        at_rest = static_voltages(scene, part, rest, {})
        growing = static_voltages(scene, part, unit, loads.inputs, voltages)
        found = min(
            (_limit_of(field, limit, (rest, at_rest), (unit, growing)) for field in stress_fields(part, place)),
            key=lambda one: one.factor,
        )
        factor = found.factor ** (1 / loads.power)
        stable = loads.spin or not describe_instability(assembly, state.stiffness)
        return replace(found, factor=factor, loads=loads.sizes(factor), units=loads.units), stable

    def factor_by(scale: float) -> tuple[float, bool]:
        found, stable = limit_by(scale)
        return found.factor, stable

    least, _ = limit_by(_settled(factor_by, limit))
    if np.isfinite(least.factor):
        reached, state = loads.rest(least.factor)
        check_small(assembly.coordinates, reached, "the loads at the limit")
        if not loads.spin and (instability := describe_instability(assembly, state.stiffness)):
            warn(f"the loads at the limit exceed a buckling load: {instability}")
        warn_of_mesh_error(body, least.place, least.position, limit, least.mesh_error * limit)
    return least


@dataclass(frozen=True)
class _GrowingLoads:
    """Loads of a scene that grow by a factor, inputs or the speed of a spin, beside gravity and preload, which stay.

    Attributes:
        assembly: the assembled scene.
        inputs: values of the inputs, by name; none for a spin.
        velocity: angular velocity, (3,) [rad/s]; zero for inputs.
        axis_point: a point of the axis, (3,) [m].
    """

    assembly: Assembly
    inputs: Mapping[str, float]
    velocity: Array
    axis_point: ArrayLike

    @property
    def spin(self) -> bool:
        """Whether a speed grows, and not inputs."""
        return bool(self.velocity.any())

    @property
    def power(self) -> int:
        """Power of the factor in proportion to which stress grows."""
        return 2 if self.spin else 1

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `sizes`."""
        return ("rad/s",) if self.spin else tuple(map(self.assembly.scene.input_unit, self.inputs))

    def sizes(self, factor: float) -> dict[str, float]:
        """Return the inputs, or the "angular velocity", times a factor, by name."""
        if self.spin:
            return {"angular velocity": factor * float(np.linalg.norm(self.velocity))}
        return {name: factor * value for name, value in self.inputs.items()}

    def rest(self, factor: float) -> tuple[Array, LoadedState]:
        """Return the displacement at rest under the loads times a factor, (n_all,), and the effect of the loads."""
        inputs = {name: factor * value for name, value in self.inputs.items()}
        return _rest(self.assembly, inputs, factor * self.velocity, self.axis_point, gravity=True)


def _check_spin(scene: Scene, angular_velocity: ArrayLike) -> None:
    """Refuse a scene with a part that turns where no angular_velocity is given."""
    turning = [*(drive.constraint for drive in scene.speeds if drive.unit == "rad"), *scene.spinning]
    if turning and not np.any(angular_velocity):
        raise ValueError(
            f"scene {scene.name!r} turns ({', '.join(turning)}), and its state at rest has no centrifugal forces: give "
            "the angular_velocity with which all of it turns, and axis_point, or look for the peak in a run"
        )


def _limit_of(field: StressField, limit: float, stays: State, grows: State) -> LoadLimit:
    """Find the smallest factor over the points of a stress on what grows, without the loads and their units."""
    (rest, _), (unit, _) = stays, grows
    factors = largest_factor(field.stress(*stays), field.stress(*grows), limit)
    k = int(np.argmin(factors))
    factor = float(factors[k])
    reached = rest + factor * unit if np.isfinite(factor) else rest
    error = float(field.mesh_error(reached)[k]) / limit
    return LoadLimit(factor, limit, {}, (), field.name, field.positions[k], error)


def _settled(factor_by: Callable[[float], tuple[float, bool]], limit: float) -> float:
    """Find the factor on loads whose stress is not proportional to them: that by the loads of this factor itself.

    Args:
        factor_by: function of a number that returns the factor by the stress under the loads times this number, and
            whether the equilibrium there is stable.
        limit: the limit, for the message [Pa].

    Returns:
        The factor. Where loads make the equilibrium unstable before they reach the limit, it is one beyond.

    Raises:
        ValueError: if none is found.
    """

    def excess(scale: float) -> float:
        factor, stable = factor_by(scale)
        return 1 - scale / factor if stable else -1.0

    with mute_warnings():
        factor, stable = factor_by(1.0)
        if not 0 < factor < np.inf:
            return 1.0
        if stable and abs(excess(factor)) <= CONVERGED:
            return factor
        low = high = 1.0
        for _ in range(DOUBLINGS):
            if excess(low) > 0:
                break
            low /= 2
        for _ in range(DOUBLINGS):
            if excess(high) < 0:
                break
            high *= 2
        if excess(low) < 0 or excess(high) > 0:
            raise ValueError(
                f"the stress is far from proportional to the loads, and no factor on them from {low:.2g} to {high:.2g} "
                f"gives {1e-6 * limit:.4g} MPa: look for it by static_motion"
            )
        root = float(scipy.optimize.brentq(excess, low, high, rtol=CONVERGED))
        reached = abs(excess(root)) < 10 * CONVERGED
        return root if reached else factor_by(high)[0]


def _rest(
    assembly: Assembly,
    inputs: Mapping[str, float],
    angular_velocity: ArrayLike,
    axis_point: ArrayLike,
    *,
    gravity: bool,
) -> tuple[Array, LoadedState]:
    """Return the displacement of an assembled scene at rest under loads, (n_all,), and the effect of the loads."""
    scene = assembly.scene
    values = {known("input", name, scene.inputs): finite(name, value) for name, value in inputs.items()}
    pull = np.asarray(scene.gravity) * gravity
    velocity = finite_array("angular_velocity", np.asarray(angular_velocity, dtype=float), (3,))
    turning = bool(velocity.any())
    still = replace(assembly, terms=tuple(term for term in assembly.terms if not isinstance(term, PrescribedMotion)))
    moved = np.zeros(assembly.coordinates.size) if turning else moved_by_drives(assembly, values)
    state = loaded_state(
        assembly if turning else still,
        moved=moved,
        gravity=pull,
        inputs=values,
        angular_velocity=velocity,
        axis_point=axis_point,
        checked=turning,
    )
    return moved + assembly.modal.modes @ state.equilibrium, state


def _strained(assembly: Assembly, displacement: Array, loads: LoadedState) -> Array:
    """Return the coordinates that strain the bodies' material at a displacement, (n_all,)."""
    result = displacement.copy()
    for name, place in assembly.coordinates.slices.items():
        result[place] = loads.elastic(name, displacement[place])
    return result
