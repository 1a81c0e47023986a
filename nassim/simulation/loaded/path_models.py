"""Models of small motion along the path of one drive that turns a joint far: one model at each of several angles.

The rotor's bodies are described along axes that turn with it, the others along those of the ground. So all coordinates
keep their mass M and the stiffness and damping of their bodies. A model at an angle has orthonormal modes B (B^T M B =
1) of the motions that constraints leave there. Let w be the speed of the path and a its acceleration, K and C stiffness
and damping of the scene, G, K_s and f_s Coriolis matrix, stiffness and forces of the rotor's bodies at unit speed, K_a
and f_a stiffness and forces of their unit acceleration, and x0 the static displacement under gravity at each angle.
With x = x0 + B z and ' the derivative with respect to the angle, along which the modes keep their directions as far as
they can (B^T M B' = 0),

    z'' + [B^T C B + w B^T G B] z' + [B^T K B + w B^T C B' + w^2 (B^T K_s B + B^T G B' - B'^T M B') + a B^T K_a B] z
        = B^T [f + w^2 f_s + a f_a - M x0'' - (C + w G) x0' - (w^2 K_s + a K_a) x0]       (x0'' and x0' in time)

The scene is assembled at several angles. Between them, the matrices follow a parabola through three neighbours, along
the modes of the nearest. Several models at such angles hold in turn, until the path passes the middle to the next one.
Where the nearest angle of assembly changes, the state goes to its modes by the orthogonal matrix that is next to
B_next^T M B, which keeps energy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.scene.bodies import RigidBody
from nassim.scene.terms import BaseAcceleration, Constraint, ForceLaw, Output
from nassim.simulation.loaded.equilibrium import balance, check_small
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness, is_preloaded
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.loaded.rotor_frame import FrameView, RotorPartition
from nassim.simulation.loaded.rotor_stator import Tie, label_of, rotation_about, term_rows
from nassim.simulation.loaded.spinning import body_force_terms, inertia_terms, integrals
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.constraints import Constraints
from nassim.simulation.model.effect_of_loads import LoadedState
from nassim.simulation.model.modal_model import ModalModel, Structure
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.prescribed_motion import PrescribedMotions, cleared
from nassim.simulation.model.signals import Signals
from nassim.simulation.model.tangents import law_tangents

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
SMOOTHED = 0.05
"""Damping ratio that transfer functions are compared with: sharp resonances shift by more than they matter."""
COMPARED = 24
"""Number of frequencies at which transfer functions are compared."""
ROUNDING = 1e3
"""Times that a part of a mode in a signal must exceed `MODE_ROUNDING`: constraints of turned joints have more of it."""
LEAST = 0.1
"""Least size of a transfer function over the geometric mean of those at its two ends."""
NEGLIGIBLE = 1e-9
"""Share of the largest static displacement that is left out."""
PULLS = 1e-7
"""Share of its largest part on a mode that a force along the path may have by rounding."""
ASKEW = 0.37
"""Share of the spacing at which one more model is compared: a scene may repeat itself at all angles."""
READ_SPACING = 0.02
"""Distance of angles at which readings of the path itself are evaluated [rad]; splines of order 5 join them."""


Parts = tuple[Array, ...]
"""Matrices of a model, see `PathKnot.parts`."""


@dataclass(frozen=True)
class PathLoads:
    """Inertia of the rotor along its path, on all coordinates, which turn with it.

    Attributes:
        rotation: motion of all coordinates per radian, (n_all,).
        gyroscopic: Coriolis matrix G per unit of speed, (n_all, n_all).
        of_speed: stiffness K_s per square of the speed, (n_all, n_all), and force f_s, (n_all,).
        of_acceleration: stiffness K_a per unit of acceleration, (n_all, n_all), and force f_a, (n_all,).
        at_start: stiffness of gravity, preload and constant inputs in the reference configuration, (n_all, n_all).
    """

    rotation: Array
    gyroscopic: Array
    of_speed: tuple[Array, Array]
    of_acceleration: tuple[Array, Array]
    at_start: Array

    @classmethod
    def of(cls, assembly: Assembly, partition: RotorPartition, inputs: Mapping[str, float]) -> "PathLoads":
        """Collect the inertia of a rotor; partition: of unit speed; inputs: constant values by name."""
        coordinates, scene = assembly.coordinates, assembly.scene
        geometric = GeometricStiffness.of(assembly)
        rotor = [name for name in coordinates.slices if name not in partition.stator]
        axis = partition.velocity
        rotation = rotation_about(coordinates, rotor, axis, partition.point)
        size = coordinates.size
        gyroscopic, by_speed, by_acceleration = np.zeros((3, size, size))
        centrifugal = np.zeros(size)
        for name in rotor:
            place, body = coordinates.slices[name], scene.split(f"{name}.")[0]
            frame = geometric.frames[name]
            terms = inertia_terms(body, frame, place, axis, partition.point)
            gyroscopic[place, place], by_speed[place, place] = terms.coriolis, terms.stiffness
            centrifugal[place] = terms.force
            turn, origin, _ = integrals(body)
            shift = np.hstack([-(turn.T @ (partition.point - origin))[:, None], np.eye(3)])
            euler = body_force_terms(body, frame, place, -skew(turn.T @ axis) @ shift)[1]
            by_acceleration[place, place] = 0.5 * terms.coriolis + euler
        pushed = -coordinates.mass @ rotation
        for force, stiffness in ((centrifugal, by_speed), (pushed, by_acceleration)):
            borne = balance(assembly, force)
            stiffness[:] += geometric.of_springs(borne.displacement) + geometric.of_joints(borne.borne)
        state = loaded_state(assembly, gravity=scene.gravity, inputs=inputs, checked=False)
        modes = coordinates.mass @ assembly.modal.modes
        return cls(
            rotation,
            gyroscopic,
            (by_speed, centrifugal),
            (by_acceleration, pushed),
            modes @ state.stiffness @ modes.T,
        )


@dataclass(frozen=True)
class PathKnot:
    """The scene at one angle of the path.

    Attributes:
        assembly: assembly there; its coordinates turn with the rotor, the drive of the path has no effect on it.
        damping: damping matrix of all coordinates, (n_all, n_all).
        bent: static displacements under gravity and constant inputs, and under the inertia of the path per square of
            its speed and per acceleration, (3, n_all).
        at_start: stiffness of the loads at the start on the modal amplitudes, (n, n).
    """

    assembly: Assembly
    damping: Array
    bent: Array
    at_start: Array

    @property
    def modes(self) -> Array:
        """Modes B in all coordinates, (n_all, n)."""
        return self.assembly.modal.modes

    @cached_property
    def stiffness(self) -> Array:
        """Stiffness of the modal amplitudes at rest, with charges that stay, (n, n)."""
        return np.diag((2 * np.pi * self.assembly.modal.frequency) ** 2) + self.at_start

    def parts(self, loads: PathLoads) -> "Parts":
        """Return stiffness and damping (n, n), readings (outputs, n) and forces (n, inputs + 2) in modal amplitudes.

        Readings are those of displacements, velocities and accelerations alike; the last two forces are the inertia of
        the path per square of its speed and per acceleration.
        """
        signals, modes, scale = self.assembly.signals, self.modes, self.assembly.coordinates.scale[:, None]
        through = [amplifier.forces[:, None] for amplifier in signals.amplifiers]
        inertia = loads.of_speed[1][:, None], loads.of_acceleration[1][:, None]
        given = np.hstack([signals.input_matrix, *through, *inertia])
        read = signals.output_matrix + signals.velocity_matrix + signals.acceleration_matrix
        return (
            self.stiffness,
            self.assembly.modal.damping.of_modes,
            cleared(read @ modes, ROUNDING * np.linalg.norm(read.T / scale, axis=0)[:, None]),
            cleared(modes.T @ given, ROUNDING * np.linalg.norm(given / scale, axis=0)),
        )


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
        change: largest relative difference of transfer functions of neighbours.
        error: largest relative error of transfer functions between them.
        tilt: largest angle between the motions that constraints leave in neighbours [rad].
    """

    start: Assembly
    partition: RotorPartition
    drive: int
    loads: PathLoads
    angles: Array
    knots: tuple[PathKnot, ...]
    closed: bool
    change: float
    error: float
    tilt: float

    @property
    def spacing(self) -> float:
        """Distance between neighbours [rad]."""
        return float(self.angles[1] - self.angles[0])

    @property
    def is_one(self) -> bool:
        """Whether one model serves for all angles."""
        return max(self.change, self.tilt) <= SAME

    @property
    def description(self) -> str:
        """Description of the models for the user: their spacing and their largest differences."""
        drive = self.start.scene.prescribed[self.drive].input
        if self.is_one:
            return f"small motion about the path of {drive}: one model, which does not depend on its angle"
        return (
            f"small motion about the path of {drive}: models {self.distance:.3g} rad apart, whose transfer "
            f"functions differ by up to {100 * self.change / self.steps:.2g} % from one to the next, between "
            f"{len(self.knots)} angles, from which they are up to {100 * self.error:.1g} % wrong"
        )

    @property
    def distance(self) -> float:
        """Distance between models [rad]."""
        return self.spacing / self.steps

    @property
    def steps(self) -> int:
        """Number of models for each angle of assembly."""
        return 1 if self.is_one else int(np.ceil(max(1.0, self.change / LARGEST_CHANGE, self.tilt / TILT)))

    def nearest(self, angle: Array) -> tuple[Array, Array]:
        """Return the nearest of the angles of assembly, (n,), and the number of the model about it, for angles (n,)."""
        if self.is_one:
            return np.zeros(len(angle), dtype=int), np.zeros(len(angle), dtype=int)
        places = (angle - self.angles[0]) / self.spacing
        found = np.rint(places).astype(int)
        steps = np.clip(np.floor((places - found + 0.5) * self.steps), 0, self.steps - 1).astype(int)
        return (found % len(self.knots) if self.closed else np.clip(found, 0, len(self.knots) - 1)), steps

    def weights(self, index: int, step: int) -> dict[int, float]:
        """Return the weights of the knots whose parabola gives a model, by their index; arguments as by `nearest`."""
        if self.is_one:
            return {index: 1.0}
        return _parabola(index, (step + 0.5) / self.steps - 0.5, len(self.knots), closed=self.closed)

    def transition(self, first: int, second: int) -> Array:
        """Return modal amplitudes of one model per unit of those of another, orthogonal (n, n)."""
        return _transition(self.knots[first], self.knots[second])[0]

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
        stiffness += speed * modes.T @ knot.damping @ slope
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
        velocities, accelerations = signals.velocity_matrix, signals.acceleration_matrix
        signals = replace(
            signals,
            output_matrix=signals.output_matrix + velocities @ drift,
            velocity_matrix=velocities + 2 * accelerations @ drift,
        )
        return replace(knot.assembly, loads=state, signals=signals)

    @cached_property
    def bent(self) -> tuple[Array, "PathSpline"]:
        """Static displacements of the models as few shapes, (n_all, r), and their amplitudes over the angle, (3, r)."""
        found = np.array([knot.bent for knot in self.knots])
        scale = self.start.coordinates.scale
        sizes = np.abs(found * scale).max(axis=(0, 2))
        rows = (found * scale / np.where(sizes > 0, sizes, 1.0)[:, None]).reshape(-1, len(scale))
        _, shares, shapes = np.linalg.svd(rows, full_matrices=False)
        shapes = shapes[shares > NEGLIGIBLE * shares.max(initial=0.0)]
        amplitudes = (found * scale) @ shapes.T
        return shapes.T / scale[:, None], PathSpline.of(self.angles, amplitudes, closed=self.closed)


@dataclass(frozen=True)
class PathSpline:
    """A function of the path's angle, joined by splines of order 5.

    Attributes:
        spline: the spline over the angle.
        turn: start of a turn after which it repeats [rad]; None where it does not.
    """

    spline: BSpline
    turn: float | None

    @classmethod
    def of(cls, angles: Array, values: Array, *, closed: bool) -> "PathSpline":
        """Join values (k, ...) at evenly spaced angles (k,); closed: whether the first follows the last."""
        first = float(angles[0])
        if closed:  # a spline over more than a turn, of which the middle is used
            n, step, more = len(angles), float(angles[1] - angles[0]), 8
            places = np.arange(-more, n + more + 1)
            angles, values = first + step * places, values[places % n]
        return cls(make_interp_spline(angles, values, k=5), first if closed else None)

    def at(self, angle: Array, derivative: int = 0) -> Array:
        """Evaluate the function, or a derivative with respect to the angle, at angles (n,); shape (n, ...)."""
        if self.turn is not None:
            angle = self.turn + np.mod(angle - self.turn, 2 * np.pi)
        found: Array = self.spline(angle, derivative)
        return found


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
    _check_outputs(assembly, partition)
    loads = PathLoads.of(assembly, partition, constant_inputs)
    found: dict[float, PathKnot] = {}

    def knot(angle: float) -> PathKnot:
        if angle not in found:
            found[angle] = _knot(assembly, partition, drive, loads, angle, constant_inputs)
        return found[angle]

    first = knot(ends[0])
    lowest = float(first.assembly.modal.frequency[0])
    top = max(min(highest, 2 * float(first.assembly.modal.frequency[-1])), 2 * lowest)
    points = 2 * np.pi * np.geomspace(lowest / 3, top, COMPARED) * (1j - SMOOTHED)
    closed, n = ends[1] - ends[0] >= 2 * np.pi * (1 - 1 / FEWEST), 2 * FEWEST
    error = np.inf
    while n <= MOST:
        angles = ends[0] + 2 * np.pi * np.arange(n) / n if closed else np.linspace(*ends, n + 1)
        knots = [knot(angle) for angle in angles.tolist()]
        beside = knot(float(angles[0] + 2 * ASKEW * (angles[1] - angles[0])))
        parts = [one.parts(loads) for one in (*knots, beside)]
        exact = [_transfer(one, points) for one in parts]
        size = np.max([np.abs(size) for _, size in exact], axis=0)
        size[size == 0] = 1.0
        coarse, tested = knots[::2], [(k, 0.5, 2 * k + 1) for k in range(n // 2)] + [(0, ASKEW, len(knots))]
        error = 0.0
        for k, share, place in tested:
            middle = _joined(coarse, parts[:-1:2], _parabola(k, share, len(coarse), closed=closed), k)
            error = max(
                error, float(np.max(np.abs(_transfer(middle, points)[0] - exact[place][0]) / size, initial=0.0))
            )
        around = (*knots, *knots[:1] * closed)
        tilt = max(_transition(one, other)[1] for one, other in pairwise(around))
        if error <= LARGEST_ERROR and tilt <= LARGEST_TILT:
            found_all = [found for found, _ in (*exact[:-1], *exact[:1] * closed)]
            steps = [float(np.max(np.abs(one - other) / size, initial=0.0)) for one, other in pairwise(found_all)]
            return PathModels(
                assembly, partition, drive, loads, angles, tuple(knots), closed, max(*steps, error), error, tilt
            )
        n *= 2
    raise ValueError(
        f'method "exact": scene {assembly.scene.name!r} changes too fast along the path of its drive: between {MOST} '
        f"angles, transfer functions are up to {100 * error:.2g} % wrong; take generalized_alpha"
    )


def _transfer(parts: Parts, points: Array) -> tuple[Array, Array]:
    """Compute transfer functions from the forces of a model to its readings, at points s, complex (k,) [1/s].

    Returns:
        The transfer functions, complex (k, outputs, inputs), and their sizes: the sum of the absolute shares of the
        modes, but at least `LEAST` of the geometric mean of the same for a motion that all modes have in phase.
    """
    stiffness, resistance, read, given = parts
    squares, shapes = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    damping = shapes.T @ resistance @ shapes + 2 * SMOOTHED * np.diag(np.sqrt(np.abs(squares)))
    left, right = read @ shapes, shapes.T @ given
    dynamic = np.array([np.diag(squares + s**2) + s * damping for s in points])
    found = left @ np.linalg.solve(dynamic, right[None])
    alone = np.abs(1 / np.einsum("kmm->km", dynamic))
    shares = np.einsum("om,km,mi->koi", np.abs(left), alone, np.abs(right), optimize=True)
    seen, moved = alone @ left.T**2, alone @ right**2
    return found, np.maximum(shares, LEAST * np.sqrt(seen[:, :, None] * moved[:, None, :]))


def _parabola(index: int, share: float, n: int, *, closed: bool) -> dict[int, float]:
    """Return weights of three of n knots for the value at a share of the spacing beside one of them, by their index."""
    middle = index if closed else int(np.clip(index, 1, n - 2))
    x = share + index - middle
    weights = {-1: 0.5 * x * (x - 1), 0: 1 - x**2, 1: 0.5 * x * (x + 1)}
    return {(middle + k) % n: weight for k, weight in weights.items()}


def _joined(knots: Sequence[PathKnot], parts: Sequence[Parts], weights: Mapping[int, float], index: int) -> Parts:
    """Return a weighted sum of the matrices of models, along the modes of one of them, by its index."""
    result = [np.zeros_like(part) for part in parts[index]]
    for k, weight in weights.items():
        turn = _transition(knots[k], knots[index])[0]
        stiffness, damping, read, given = parts[k]
        moved = turn @ stiffness @ turn.T, turn @ damping @ turn.T, read @ turn.T, turn @ given
        result = [total + weight * part for total, part in zip(result, moved, strict=True)]
    return tuple(result)


def _transition(first: PathKnot, second: PathKnot) -> tuple[Array, float]:
    """Return modal amplitudes of one model per unit of those of another, orthogonal (n, n), and the angle between them.

    The angle [rad] is the largest between the motions that constraints leave in both.
    """
    u, cosines, v = np.linalg.svd(second.modes.T @ first.assembly.coordinates.mass @ first.modes)
    # Sines from what is left: cosines near one have lost half of their digits.
    left = first.modes - second.modes @ (second.modes.T @ first.assembly.coordinates.mass @ first.modes)
    sine = np.linalg.norm(left * first.assembly.coordinates.scale[:, None], 2)
    return u @ v, float(np.arctan2(sine, cosines[-1]))


def path_readings(models: PathModels) -> tuple[PathSpline, Array]:
    """Return readings of the path itself by the outputs, without small motion.

    Returns:
        A function of the angle, of shape (outputs,), and readings per radian that add to it, (outputs,).
    """
    scene, view = models.start.scene, FrameView(models.start, models.partition)
    first, width = float(models.angles[0]), models.spacing * (len(models.angles) - (not models.closed))
    n = max(12, int(np.ceil(width / READ_SPACING)))
    angles = first + width * np.arange(n + 1) / n
    values = np.zeros((n + 1, len(scene.outputs)))
    for term in models.start.terms:
        if isinstance(term, Output) and not term.derivative and term.measure.has_value:
            read = np.array([term.measure.evaluate(view.states(float(angle)))[0][0] for angle in angles])
            if term.measure.period:
                read = np.unwrap(read, period=term.measure.period)
            values[:, scene.outputs.index(term.name)] += term.gain * read
    slopes = (values[-1] - values[0]) / width * models.closed
    values -= np.outer(angles, slopes)
    last = n if models.closed else n + 1
    return PathSpline.of(angles[:last], values[:last], closed=models.closed), slopes


def _check_outputs(assembly: Assembly, partition: RotorPartition) -> None:
    """Refuse outputs of velocities and accelerations on the rotor, which contain the path's own."""
    turning = [term.input for term in assembly.scene.terms_of(BaseAcceleration) if term.axes_of]
    for term in assembly.terms:
        if turning and isinstance(term, Output) and term.inertial:
            raise ValueError(
                f'method "exact": output {term.name!r} reads the acceleration of the ground by {turning[0]!r}, whose '
                "axis turns along the path: take the world's axes for the ground"
            )
        if isinstance(term, Output) and term.derivative and not partition.stator.issuperset(term.measure.bodies):
            raise ValueError(
                f'method "exact": output {term.name!r} reads a velocity or an acceleration on what the drive of the '
                "path turns, which contains that of the path: read a displacement or an angle, or take "
                "generalized_alpha"
            )


def _check_free(term: Tie, coordinates: MovedCoordinates, rotation: Array, modal: ModalModel, where: str) -> None:
    """Refuse a joint or a spring that resists the path with forces that move something."""
    rows = term_rows(coordinates, term)
    if isinstance(term, Constraint):
        met = np.abs(rows @ rotation)
        size = np.abs(rows) @ (np.abs(rotation) + 1e-3)
    else:
        if term.measure.within:
            return
        value, still = term.measure.evaluate(coordinates.moved)[0], np.zeros(len(rows))
        forces = np.column_stack(
            [rows.T @ term.resistance(value, still), rows.T @ term.resistance(still, rows @ rotation)]
        )
        stiffness, damping = (np.abs(part) for part in term.tangents(still, still))
        most = np.abs(rows).T @ (stiffness + damping) @ np.abs(rows) @ (np.abs(rotation) + 1e-3)
        met, size = np.abs(modal.modes.T @ forces).max(axis=1), np.abs(modal.modes).T @ most
    if np.any(met > PULLS * size):
        raise ValueError(
            f"{where}: {label_of(term)} resists the motion of the drive, so its force changes along the path: let its "
            "axes turn with the rotor, or take generalized_alpha"
        )


def _without(prescribed: PrescribedMotions, drive: int) -> PrescribedMotions:
    """Return the effect of the drives but one, by its index."""
    kept = [k for k in range(len(prescribed.inputs)) if k != drive]
    return PrescribedMotions(
        tuple(prescribed.inputs[k] for k in kept),
        tuple(prescribed.rates[k] for k in kept),
        prescribed.motion[:, kept],
        prescribed.momentum[:, kept],
        prescribed.damping[:, kept],
        prescribed.residual[:, kept],
    )


def _knot(
    assembly: Assembly,
    partition: RotorPartition,
    drive: int,
    loads: PathLoads,
    angle: float,
    constant_inputs: Mapping[str, float],
) -> PathKnot:
    """Make the model at an angle [rad]; arguments as of `path_models`."""
    scene, start = assembly.scene, assembly.coordinates
    path = scene.prescribed[drive]
    joint = next(joint for joint in scene.terms_of(Constraint) if joint.name == path.constraint)
    turned = np.eye(start.size)
    for name, place in start.slices.items():
        if name not in partition.stator and isinstance(scene.split(f"{name}.")[0], RigidBody):
            turned[place, place] = np.kron(np.eye(2), partition.rotation_at(angle))
    states = FrameView(assembly, partition).states(angle)
    coordinates = MovedCoordinates(scene, start.slices, start.mass, states, turned, joint, path.component)
    constraints = Constraints.of(coordinates)
    tangents = law_tangents(coordinates, assembly.terms, constraints.basis)
    structure = Structure.of(coordinates, tangents)
    modal = ModalModel.of(
        constraints, structure, {body.name: body.reduced.valid_frequency for body in scene.flexible_bodies}
    )
    own = assembly.modal.damping.of_deformation.own
    modal = replace(modal, damping=replace(modal.damping, ratio=np.zeros(len(modal.frequency)), own=own))
    where = f'method "exact": at {angle:.4g} rad of the path of drive {path.input!r}, scene {scene.name!r}'
    if modal.modes.shape != assembly.modal.modes.shape:
        raise ValueError(f"{where} is in a singular position: joints leave other motions than at the start")
    if np.any(modal.rigid_modes):
        raise ValueError(f"{where} has a motion that nothing holds: add a spring or a joint, or take generalized_alpha")
    for term in scene.terms:
        if isinstance(term, (ForceLaw, Constraint)):
            _check_free(term, coordinates, loads.rotation, modal, where)
    prescribed = _without(PrescribedMotions.of(constraints, structure, modal), drive)
    signals = Signals.of(coordinates, assembly.terms, tangents, prescribed)
    now = replace(
        assembly,
        coordinates=coordinates,
        constraints=constraints,
        tangents=tuple(tangents),
        modal=modal,
        signals=signals,
    )
    knot = PathKnot(
        now,
        structure.damping_forces(np.eye(start.size)),
        np.zeros((3, start.size)),
        modal.modes.T @ loads.at_start @ modal.modes,
    )
    given = np.array([constant_inputs.get(name, 0.0) for name in scene.inputs])
    force = signals.weight + signals.input_matrix @ given
    stiffness = knot.stiffness
    for amplifier in signals.amplifiers:
        force = force + amplifier.forces * given[amplifier.input]
    for circuit in signals.circuits:
        pull = modal.modes.T @ circuit.forces
        stiffness = stiffness - np.outer(pull, pull) / circuit.storage
    squares = np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))
    if squares[0] <= 0:
        raise ValueError(f"{where} is unstable under its loads: take generalized_alpha, or another path")
    forces = np.column_stack([force, loads.of_speed[1], loads.of_acceleration[1]])
    bent = modal.modes @ np.linalg.solve(stiffness, modal.modes.T @ forces)
    check_small(coordinates, bent[:, 0], "its loads")
    return replace(knot, bent=bent.T)
