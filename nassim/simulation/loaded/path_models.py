"""Models of small motion along the path of one drive that turns a joint far: one model at each of several angles.

The rotor's bodies are described along axes that turn with it, the others along those of the ground. So all coordinates
keep their mass M and the stiffness and damping of their bodies. A model at an angle has orthonormal modes B (B^T M B =
1) of the motions that constraints leave there. Let w be the speed of the path and a its acceleration, K and C stiffness
and damping of the scene, G, K_s and f_s Coriolis matrix, stiffness and forces of the rotor's bodies at unit speed, K_a
and f_a stiffness and forces of their unit acceleration, and x0 the static displacement under gravity at each angle.
With x = x0 + B z and ' the derivative with respect to the angle, along which the modes keep their directions as far as
they can (B^T M B' = 0),

    z'' + [B^T C B + w B^T G B] z'
        + [B^T K B + w B^T (C B' + R B) + w^2 (B^T K_s B + B^T G B' - B'^T M B') + a B^T K_a B] z
        = B^T [f + w^2 f_s + a f_a - M x0'' - (C + w G) x0' - (w R + w^2 K_s + a K_a) x0]  (x0'' and x0' in time)

A damper with the rows d(angle) on the turning coordinates resists d x' + w d' x, so its force is -C x' - w R x: R is
the sum of d^T c d' over the dampers. It matters for dampers between rotor and stator.

The scene is assembled at several angles. Between them, the matrices follow a parabola through three neighbours, along
the modes of the nearest. Several models at such angles hold in turn, until the path passes the middle to the next one.
Where the nearest angle of assembly changes, the state goes to its modes by the orthogonal matrix that is next to
B_next^T M B, which keeps energy.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.scene.field_kinds import body_of
from nassim.scene.rotation_measures import RotationAngle
from nassim.scene.terms import Output, SpringForce
from nassim.simulation.loaded.geometric_stiffness import is_preloaded
from nassim.simulation.loaded.path_comparison import ASKEW, PathDifferences, compared_points, path_differences
from nassim.simulation.loaded.path_curves import PathSpline, parabola
from nassim.simulation.loaded.path_knots import ROUNDED_SLOPE, PathKnot, make_knot, transition, turning_rows
from nassim.simulation.loaded.path_loads import PathLoads
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.steady_rotation import turned_poses

LARGEST_ERROR = 0.01
"""Largest relative error of transfer functions between angles, at twice the distance of the angles."""
LARGEST_CHANGE = 0.02
"""Largest relative difference of the transfer functions of neighbouring models."""
LARGEST_TILT, TILT = 0.1, 0.0025
"""Largest angle between the motions that constraints leave at neighbouring angles, and in neighbouring models [rad]."""
SAME = 1e-7
"""Difference of both up to which a model does not depend on the angle."""
FEWEST, MOST = 8, 512
"""Numbers of angles at which the scene is assembled."""
PARALLEL = 1e-9
"""Angle between axes that are parallel [rad]."""
NEGLIGIBLE = 1e-9
"""Share of the largest static displacement that is left out."""


@dataclass(frozen=True)
class PathModels:
    """Models of a scene along the path of a drive.

    Attributes:
        start: assembly in the reference configuration.
        partition: the rotor, with unit speed about the axis, and the stator.
        drive: index of the drive among those that follow inputs.
        loads: inertia of the rotor along the path.
        angles: angles of the models, evenly spaced, (k,) [rad].
        knots: models at these angles.
        closed: whether the angles go around, so that the first follows the last.
        differences: of the models at these angles.
    """

    start: Assembly
    partition: RotorPartition
    drive: int
    loads: PathLoads
    angles: Array
    knots: tuple[PathKnot, ...]
    closed: bool
    differences: PathDifferences
    _transitions: dict[tuple[int, int], Array] = field(default_factory=dict, init=False, compare=False)

    @property
    def input(self) -> str:
        """Name of the input that is the path."""
        return self.start.scene.prescribed[self.drive].input

    def poses(self, angle: Array, coordinates: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Find the poses of the bodies' own frames at angles of the path.

        Args:
            angle: the angles, (n,) [rad].
            coordinates: small motion along axes that turn with the rotor, by name of the body, (n, n_own) each.

        Returns:
            Positions (n, 3) [m] and rotations to the world's axes (n, 3, 3), by name of the body.
        """
        scene, partition = self.start.scene, self.partition
        turned = Rotation.from_rotvec(np.outer(angle, partition.relative_velocity)).as_matrix()
        still = np.broadcast_to(np.eye(3), turned.shape)
        rotor = self.start.coordinates.slices.keys() - partition.stator
        turns = {body.name: turned if body.name in rotor else still for body in scene.bodies}
        return turned_poses(scene, partition.point, turns, turns, coordinates)

    @property
    def spacing(self) -> float:
        """Distance between neighbours [rad]."""
        return float(self.angles[1] - self.angles[0])

    @property
    def is_one(self) -> bool:
        """Whether one model serves for all angles."""
        return max(self.differences.change, self.differences.tilt) <= SAME

    @property
    def description(self) -> str:
        """Description of the models for the user: their spacing and their largest differences."""
        if self.is_one:
            return f"small motion about the path of {self.input}: one model, which does not depend on its angle"
        change, error = 100 * self.differences.change / self.steps, 100 * self.differences.error
        return (
            f"small motion about the path of {self.input}: models {self.distance:.3g} rad apart, whose transfer "
            f"functions differ by up to {change:.2g} % from one to the next, between {len(self.knots)} angles, from "
            f"which they are up to {error:.1g} % wrong"
        )

    @property
    def distance(self) -> float:
        """Distance between models [rad]."""
        return self.spacing / self.steps

    @property
    def steps(self) -> int:
        """Number of models for each angle of assembly."""
        return int(np.ceil(max(1.0, self.differences.change / LARGEST_CHANGE, self.differences.tilt / TILT)))

    def nearest(self, angle: Array) -> tuple[Array, Array]:
        """Return the nearest of the angles of assembly, (n,), and the number of the model about it, for angles (n,)."""
        if self.is_one:
            return np.zeros(len(angle), dtype=int), np.zeros(len(angle), dtype=int)
        places = (angle - self.angles[0]) / self.spacing
        found = np.rint(places).astype(int)
        steps = np.clip(np.floor((places - found + 0.5) * self.steps), 0, self.steps - 1).astype(int)
        return found % len(self.knots), steps

    def weights(self, index: int, step: int) -> dict[int, float]:
        """Return the weights of the knots whose parabola gives a model, by their index; arguments as by `nearest`."""
        if self.is_one:
            return {index: 1.0}
        return parabola(index, (step + 0.5) / self.steps - 0.5, len(self.knots), closed=self.closed)

    def weight_slopes(self, index: int, step: int) -> dict[int, float]:
        """Return the derivatives of `weights` with respect to the angle [1/rad]; none of one model for all angles."""
        if self.is_one:
            return {index: 0.0}
        place = (step + 0.5) / self.steps - 0.5
        before, after = (parabola(index, place + side, len(self.knots), closed=self.closed) for side in (-0.5, 0.5))
        return {k: (after[k] - before[k]) / self.spacing for k in after}

    def angle(self, index: int, step: int) -> float:
        """Return the angle of a model [rad]; arguments as by `nearest`."""
        return float(self.angles[index]) + ((step + 0.5) / self.steps - 0.5) * self.spacing

    def transition(self, first: int, second: int) -> Array:
        """Return modal amplitudes of one model per unit of those of another, orthogonal (n, n)."""
        if (first, second) not in self._transitions:
            self._transitions[first, second] = transition(self.knots[first], self.knots[second])[0]
        return self._transitions[first, second]

    def slope(self, index: int) -> Array:
        """Return B' at a model, (n_all, n), by its neighbours."""
        modes, n = self.knots[index].modes, len(self.knots)
        if self.is_one:
            return np.zeros_like(modes)
        ends = [index - 1, index + 1]
        ends = [k % n for k in ends] if self.closed else [max(0, ends[0]), min(n - 1, ends[1])]
        width = self.spacing * (2 if self.closed else ends[1] - ends[0])
        before, after = (self.knots[k].modes @ self.transition(index, k) for k in ends)
        slope: Array = (after - before) / width
        mass = self.start.coordinates.mass
        return slope - modes @ (modes.T @ mass @ slope)

    def assembly(self, index: int, speed: float, acceleration: float) -> Assembly:
        """Return the assembly of small motion at a model, a speed [rad/s] and an acceleration [rad/s2] of the path."""
        knot, loads = self.knots[index], self.loads
        modes, mass = knot.modes, self.start.coordinates.mass
        slope, signals = self.slope(index), knot.assembly.signals
        turned = loads.gyroscopic @ modes
        stiffness = knot.at_start + acceleration * modes.T @ loads.of_acceleration[0] @ modes
        stiffness += speed**2 * (
            modes.T @ (loads.of_speed[0] @ modes + loads.gyroscopic @ slope) - slope.T @ mass @ slope
        )
        stiffness += speed * modes.T @ (knot.damping @ slope + knot.rotating_damping @ modes)
        added = loads.at_start + speed**2 * loads.of_speed[0] + acceleration * loads.of_acceleration[0]
        followed = signals.prescribed.motion
        empty = np.zeros(modes.shape[1])
        state = LoadedState(
            speed * modes.T @ turned,
            stiffness,
            empty,
            empty,
            speed * modes.T @ loads.gyroscopic @ followed,
            modes.T @ added @ followed,
        )
        drift = speed * slope @ modes.T @ mass  # rates of all coordinates, as the modes turn, per unit of them
        signals = replace(signals, output_matrix=signals.output_matrix + signals.velocity_matrix @ drift)
        return replace(knot.assembly, loads=state, signals=signals)

    @cached_property
    def bent(self) -> tuple[Array, PathSpline]:
        """Static displacements of the models as few shapes, (n_all, r), and their amplitudes over the angle, (3, r)."""
        return self._in_shapes(np.array([knot.bent for knot in self.knots]), self.start.coordinates.scale)

    @cached_property
    def resisted(self) -> tuple[Array, PathSpline]:
        """Forces of dampers on the r shapes of the static displacement, as few fields, (n_all, p).

        Their amplitudes over the angle, (2 r, p), are those of unit rates, then of unit displacements at unit speed.
        """
        shapes = self.bent[0]
        forces = [np.hstack([knot.damping @ shapes, knot.rotating_damping @ shapes]).T for knot in self.knots]
        return self._in_shapes(np.array(forces), 1 / self.start.coordinates.scale)

    def _in_shapes(self, found: Array, weights: Array) -> tuple[Array, PathSpline]:
        """Join vectors of the models, (k, j, n_all), into few shapes, (n_all, r), with amplitudes (j, r) by angle.

        The factors `weights`, (n_all,), make entries comparable.
        """
        sizes = np.abs(found * weights).max(axis=(0, 2))
        rows = (found * weights / np.where(sizes > 0, sizes, 1.0)[:, None]).reshape(-1, len(weights))
        _, shares, shapes = np.linalg.svd(rows, full_matrices=False)
        shapes = shapes[shares > NEGLIGIBLE * shares.max(initial=0.0)]
        amplitudes = (found * weights) @ shapes.T
        return shapes.T / weights[:, None], PathSpline.of(self.angles, amplitudes, closed=self.closed)


def path_models(
    assembly: Assembly,
    partition: RotorPartition,
    drive: int,
    ends: tuple[float, float],
    constant_inputs: Mapping[str, float],
    highest: float,
) -> PathModels:
    """Make models along the path of a drive, so close that neighbours differ by `LARGEST_CHANGE` at most.

    Args:
        assembly: the assembled scene.
        partition: the rotor, with unit speed about the axis of the drive in the stator's frame, and the stator.
        drive: index of the drive among those that follow inputs.
        ends: least and largest angle of the path [rad].
        constant_inputs: constant values of inputs, by name.
        highest: highest frequency at which models are compared [Hz].

    Returns:
        The models.

    Raises:
        ValueError: for parts that resist the path, for outputs that read velocities or accelerations on the rotor, for
            a path through a position that is singular or unstable, and where more than `MOST` models would be needed.
    """
    _check_parts(assembly)
    _check_outputs(assembly, partition)
    if max(np.abs(ends)) >= np.pi:
        _check_angles(assembly, partition)
    loads = PathLoads.of(assembly, partition, constant_inputs)
    knot = cache(lambda angle: make_knot(assembly, partition, drive, loads, angle, constant_inputs))
    points = compared_points(knot(ends[0]), highest)
    closed, n = ends[1] - ends[0] >= 2 * np.pi * (1 - 1 / FEWEST), 2 * FEWEST
    while n <= MOST:
        angles = ends[0] + 2 * np.pi * np.arange(n) / n if closed else np.linspace(*ends, n + 1)
        knots = tuple(knot(angle) for angle in angles.tolist())
        beside = knot(float(angles[0] + 2 * ASKEW * (angles[1] - angles[0])))
        found = path_differences(knots, beside, loads, points, closed=closed)
        if found.error <= LARGEST_ERROR and found.tilt <= LARGEST_TILT:
            return PathModels(
                start=assembly,
                partition=partition,
                drive=drive,
                loads=loads,
                angles=angles,
                knots=knots,
                closed=closed,
                differences=found,
            )
        n *= 2
    raise ValueError(
        f'method "exact": scene {assembly.scene.name!r} changes too fast along the path of its drive: between {MOST} '
        f"angles, transfer functions are up to {100 * found.error:.2g} % wrong; take generalized_alpha"
    )


def _check_parts(assembly: Assembly) -> None:
    """Refuse preloaded springs, whose forces change along the path, coils, and scenes without other motion."""
    if not assembly.modal.modes.shape[1]:
        raise ValueError(
            f'method "exact": nothing moves in scene {assembly.scene.name!r} but what the drive of the path turns: '
            "take generalized_alpha"
        )
    if is_preloaded(assembly.tangents):
        raise ValueError(
            f'method "exact": scene {assembly.scene.name!r} has preloaded springs, whose forces change along the path '
            "of its drive; take generalized_alpha"
        )
    if coils := [circuit.coil.name for circuit in assembly.signals.circuits if circuit.coil]:
        raise ValueError(
            f'method "exact": scene {assembly.scene.name!r} has the coil {coils[0]!r}, whose current is not modelled '
            "along the path of a drive; take generalized_alpha"
        )


def _check_outputs(assembly: Assembly, partition: RotorPartition) -> None:
    """Refuse outputs of accelerations, of velocities on the rotor and of dampers across, which contain the path's."""
    view = FrameView(assembly, partition)
    for force in assembly.scene.terms_of(SpringForce):
        still = np.zeros(len(force.spring.measure.components))
        damping = force.spring.tangents(still, still)[1][force.spring.measure.components.index(force.component)]
        pulls = [damping @ turning_rows(view, force.spring, angle) for angle in (0.0, 1.0, 2.0)]
        if np.ptp(pulls, axis=0).max() > ROUNDED_SLOPE * np.abs(pulls).max():
            raise ValueError(
                f'method "exact": output {force.name!r} reads the force of a damper between rotor and stator, which '
                "contains the speed of the path: let a sensor read a spring without damping, or take generalized_alpha"
            )
    for term in assembly.terms:
        if not isinstance(term, Output) or not term.derivative:
            continue
        if term.derivative == 2:
            raise ValueError(
                f'method "exact": output {term.name!r} reads an acceleration, which models along the path of a drive '
                "do not have: read a velocity (Vibrometer), or take generalized_alpha"
            )
        if not partition.stator.issuperset(term.measure.bodies):
            raise ValueError(
                f'method "exact": output {term.name!r} reads a velocity on what the drive of the path turns, which '
                "contains that of the path: read a displacement or an angle, or take generalized_alpha"
            )


def _check_angles(assembly: Assembly, partition: RotorPartition) -> None:
    """Refuse outputs of angles across the axis between rotor and stator, which half a turn leaves undefined."""
    for term in assembly.scene.terms_of(Output):
        for _, measure in term.measure.point_measures:
            if not isinstance(measure, RotationAngle):
                continue
            sides = {not path or body_of(path) in partition.stator for path in (measure.a, measure.b)}
            off = np.linalg.norm(np.cross(measure.axis, partition.velocity))
            if len(sides) > 1 and off > PARALLEL * np.linalg.norm(measure.axis):
                raise ValueError(
                    f'method "exact": output {term.name!r} reads an angle across the axis of the drive of the path, '
                    "which half a turn leaves undefined: read it about the axis, or a RotationDeviation"
                )
