"""Scenes: bodies, joints, stacks and sensors as pure data, connected by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from nassim.body import ReducedBody
from nassim.checks import (
    Array,
    finite,
    finite_array,
    freeze,
    frozen_mapping,
    known,
    not_negative,
    positive,
    unique,
)
from nassim.interface import DIRECTIONS
from nassim.trim import trim_body

FIDELITIES = ("rigid", "linear", "ffrf")
TOUCH_TOLERANCE = 1e-9
"""Largest gap [m] between the two points of a joint."""


@dataclass(frozen=True)
class RigidBody:
    """A rigid body.

    name: what the scene calls it
    mass: [kg]; inertia: about the centre of mass, shape (3, 3) [kg m2]; both may be None for a fixed body
    position: of the centre of mass at the start, in the world's frame [m]
    points: named points, relative to the centre of mass [m]
    fixed: True for a body that does not move, such as a granite base
    """

    name: str
    points: Mapping[str, Array]
    mass: float | None = None
    inertia: Array | None = None
    position: Array = field(default_factory=lambda: np.zeros(3))
    fixed: bool = False

    def __post_init__(self) -> None:
        label = f"rigid body {self.name!r}"
        points = {k: finite_array(f"{label}: point {k!r}", v, (3,)) for k, v in self.points.items()}
        freeze(
            self,
            points=frozen_mapping(points),
            position=finite_array(f"{label}: position", self.position, (3,)),
        )
        if self.fixed:
            return
        if self.mass is None or self.inertia is None:
            raise ValueError(f"{label} can move, so it needs a mass and an inertia (or fixed=True)")
        mass = positive(f"{label}: mass", self.mass, "kg")
        inertia = finite_array(f"{label}: inertia", self.inertia, (3, 3))
        if np.abs(inertia - inertia.T).max() > 1e-9 * np.abs(inertia).max() or np.linalg.eigvalsh(inertia)[0] <= 0:
            raise ValueError(f"{label}: inertia must be symmetric and positive definite")
        freeze(self, mass=mass, inertia=inertia)

    def point_position(self, point: str) -> Array:
        """Position of a named point at the start, world frame, shape (3,) [m]."""
        result: Array = self.position + self.points[known(f"point of {self.name!r}", point, self.points)]
        return result


@dataclass(frozen=True)
class FlexibleBody:
    """A reduced body in a scene.

    name: what the scene calls it; reduced: the body
    position: of the body's origin at the start, in the world's frame, shape (3,) [m]
    rotation: from the body's to the world's frame at the start, shape (3, 3)
    fidelity: "ffrf", a floating frame that may move far and turn; "linear", small motion about the start (rotations
        up to some 0.01 rad), twenty times as fast; "rigid", no deformation: its stacks then do and read nothing
    frame: remote point that the floating frame rides on (default: the first that a joint holds, else the first)
    angular_velocity: at the start, world frame, shape (3,) [rad/s]
    """

    name: str
    reduced: ReducedBody
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    fidelity: str = "ffrf"
    frame: str | None = None
    angular_velocity: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        label = f"flexible body {self.name!r}"
        rotation = finite_array(f"{label}: rotation", self.rotation, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0:
            raise ValueError(f"{label}: rotation must be a proper orthogonal matrix")
        known("fidelity", self.fidelity, FIDELITIES)
        if self.frame is not None:
            known("remote point", self.frame, self.reduced.point_names)
        if self.fidelity == "linear" and np.any(self.angular_velocity):
            raise ValueError(f'{label} spins, so it needs fidelity "ffrf" or "rigid": "linear" is for small rotation')
        freeze(
            self,
            position=finite_array(f"{label}: position", self.position, (3,)),
            rotation=rotation,
            angular_velocity=finite_array(f"{label}: angular_velocity", self.angular_velocity, (3,)),
        )

    def elongation(self, start: str, end: str) -> Array:
        """How much the distance between two points grows per unit of the reduced coordinates, shape (n,)."""
        axis = self.reduced.point(end).position - self.reduced.point(start).position
        axis = axis / np.linalg.norm(axis)
        result: Array = axis @ (self.reduced.motion(end) - self.reduced.motion(start))[:3]
        return result

    def point_position(self, point: str) -> Array:
        """Position of a remote point at the start, world frame, shape (3,) [m]."""
        result: Array = self.position + self.rotation @ self.reduced.point(point).position
        return result


Body = RigidBody | FlexibleBody


@dataclass(frozen=True)
class Joint:
    """Connects two points that coincide at the start.

    a, b: the points, "body.point"
    free: directions of the world's frame in which b may move against a: "x" "y" "z" "rx" "ry" "rz";
        none, the default, is a rigid connection
    """

    name: str
    a: str
    b: str
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        free = (self.free,) if isinstance(self.free, str) else tuple(self.free)
        for direction in free:
            known("direction", direction, DIRECTIONS)
        freeze(self, free=free)


@dataclass(frozen=True)
class StackActuator:
    """Piezo stacks that push two remote points of one flexible body apart.

    start, end: the remote points, "body.point"; the force acts along the line through them
    force_per_volt: blocked force per volt at the stack [N/V]; gain: amplifier, stack voltage per input [V/V]
    input: name of the scene's input [V]
    """

    name: str
    start: str
    end: str
    force_per_volt: float
    input: str
    gain: float = 1.0

    def __post_init__(self) -> None:
        freeze(self, force_per_volt=finite("force_per_volt", self.force_per_volt), gain=finite("gain", self.gain))


@dataclass(frozen=True)
class StackSensor:
    """A piezo stack as force sensor: its open-circuit voltage, positive in compression.

    name: of the scene's output [V]; start, end: remote points of one flexible body, "body.point"
    voltage_per_elongation: [V/m]
    """

    name: str
    start: str
    end: str
    voltage_per_elongation: float
    unit: str = field(default="V", init=False)

    def __post_init__(self) -> None:
        freeze(self, voltage_per_elongation=finite("voltage_per_elongation", self.voltage_per_elongation))


@dataclass(frozen=True)
class Encoder:
    """Displacement of point b against point a along one axis of the world's frame, zero at the unloaded start.

    name: of the scene's output [m]; a, b: "body.point" of rigid bodies; axis: "x", "y" or "z"
    """

    name: str
    a: str
    b: str
    axis: str = "z"
    unit: str = field(default="m", init=False)

    def __post_init__(self) -> None:
        known("axis", self.axis, ("x", "y", "z"))


Sensor = StackSensor | Encoder


@dataclass(frozen=True)
class Scene:
    """Everything that a simulation needs to know, as data.

    bodies, joints, actuators, sensors: the parts; names must differ within each kind
    damping_ratio: of every eigenmode of the assembled scene [-], one number or one per mode from the lowest (the
        remaining modes then have the last). It is realised as a damping of the flexible bodies' deformation.
    gravity: acceleration, world frame, shape (3,) [m/s2]; with any, simulations start in static equilibrium
    cutoff_frequency: what flexible bodies need below it is modelled only, see `trimmed`; take three times the highest
        frequency of interest [Hz]; None models all of each body

    Raises ValueError for unknown names and for joints whose points do not touch.
    """

    name: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...] = ()
    actuators: tuple[StackActuator, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    damping_ratio: ArrayLike = 0.01
    gravity: Array = field(default_factory=lambda: np.zeros(3))
    cutoff_frequency: float | None = None

    def __post_init__(self) -> None:
        positive("cutoff_frequency", 1.0 if self.cutoff_frequency is None else self.cutoff_frequency, "Hz")
        ratio = np.atleast_1d(np.array(self.damping_ratio, dtype=float))
        if ratio.size == 0:
            raise ValueError("damping_ratio needs at least one value; 0 for no damping")
        for value in ratio:
            not_negative("damping_ratio", value)
        freeze(
            self,
            bodies=tuple(self.bodies),
            joints=tuple(self.joints),
            actuators=tuple(self.actuators),
            sensors=tuple(self.sensors),
            damping_ratio=finite_array("damping_ratio", ratio, (None,)),
            gravity=finite_array("gravity", self.gravity, (3,)),
        )
        for kind, parts in (
            ("body", self.bodies),
            ("joint", self.joints),
            ("actuator", self.actuators),
            ("sensor", self.sensors),
        ):
            unique(kind, (part.name for part in parts))
        if not any(not isinstance(body, RigidBody) or not body.fixed for body in self.bodies):
            raise ValueError(f"scene {self.name!r} has no body that can move")
        for joint in self.joints:
            if joint.a == joint.b:
                raise ValueError(f"joint {joint.name!r} connects {joint.a!r} with itself")
            gap = float(np.linalg.norm(self.point_position(joint.b) - self.point_position(joint.a)))
            if gap > TOUCH_TOLERANCE:
                raise ValueError(
                    f"joint {joint.name!r}: {joint.a!r} and {joint.b!r} are {gap:.3g} m apart; they must coincide to "
                    f"{TOUCH_TOLERANCE:g} m: move one of the bodies"
                )
        for stack in self.stacks:
            self._check_stack(stack)
        for sensor in self.sensors:
            if isinstance(sensor, Encoder):
                for path in (sensor.a, sensor.b):
                    if not isinstance(self.split(path)[0], RigidBody):
                        raise ValueError(f"encoder {sensor.name!r}: {path!r} must be a point of a rigid body")
                    self.point_position(path)

    def _check_stack(self, part: StackActuator | StackSensor) -> None:
        (body, start), (other, end) = self.split(part.start), self.split(part.end)
        if body is not other or not isinstance(body, FlexibleBody) or start == end:
            raise ValueError(
                f"stack {part.name!r}: {part.start!r} and {part.end!r} must be two points of one flexible body"
            )
        if float(np.linalg.norm(body.point_position(start) - body.point_position(end))) < TOUCH_TOLERANCE:
            raise ValueError(f"stack {part.name!r}: its ends {part.start!r} and {part.end!r} lie in one place")

    def trimmed(self) -> "Scene":
        """The scene with bodies reduced further to what its joints and stacks need below the cut-off frequency.

        Remote points that no joint holds are no coordinates any more; static answers to the stacks stay exact.
        Without a cut-off frequency it is the same scene.
        """
        if self.cutoff_frequency is None:
            return self
        bodies = tuple(self._trim(body, self.cutoff_frequency) for body in self.bodies)
        return replace(self, bodies=bodies, cutoff_frequency=None)

    def _trim(self, body: Body, cutoff_frequency: float) -> Body:
        if not isinstance(body, FlexibleBody) or body.fidelity == "rigid":
            return body
        stacks = [stack for stack in self.stacks if self.split(stack.start)[0] is body]
        names = [(stack.start.partition(".")[2], stack.end.partition(".")[2]) for stack in stacks]
        loads = np.zeros((len(body.reduced.mass_matrix), len(stacks)))
        for k, (start, end) in enumerate(names):
            loads[:, k] = body.elongation(start, end)
        points = {self.frame_point(body), *self._jointed_points(body)}
        trimmed = trim_body(body.reduced, points=points, loads=loads, cutoff_frequency=cutoff_frequency)
        return replace(body, reduced=trimmed, frame=self.frame_point(body))

    def summary(self) -> str:
        """What is modelled of each body, with how many coordinates, and what is left out and why, as text."""
        lines = [f"scene {self.name!r}: inputs {', '.join(self.inputs) or 'none'}; outputs {', '.join(self.outputs)}"]
        for body, trimmed in zip(self.bodies, self.trimmed().bodies, strict=True):
            if isinstance(body, RigidBody):
                lines.append(f"  {body.name}: " + ("fixed" if body.fixed else "rigid, 6 coordinates"))
            elif body.fidelity == "rigid":
                lines.append(f"  {body.name}: rigid, 6 coordinates; the others left out by its fidelity")
            else:
                assert isinstance(trimmed, FlexibleBody)
                lines.extend(self._describe(body, trimmed.reduced))
        return "\n".join(lines)

    def _describe(self, body: FlexibleBody, trimmed: ReducedBody) -> list[str]:
        n, points, p = len(trimmed.mass_matrix), trimmed.point_names, trimmed.n_modes
        kind = "floating frame" if body.fidelity == "ffrf" else "linear"
        lines = [f"  {body.name}: {kind}, {n} coordinates: {', '.join(points)} x 6 + {p} modes and load shapes"]
        if len(body.reduced.mass_matrix) > n:
            idle = ", ".join(name for name in body.reduced.point_names if name not in points) or "none"
            lines.append(
                f"    left out: {len(body.reduced.mass_matrix) - n} coordinates: points that no joint holds ({idle}) "
                f"and modes above {self.cutoff_frequency:g} Hz; static answers to the stacks are kept"
            )
        ends = {path for stack in self.stacks for path in (stack.start, stack.end)}
        used = {*self._jointed_points(body), self.frame_point(body)}
        idle_points = [name for name in points if name not in used and f"{body.name}.{name}" not in ends]
        if idle_points and self.cutoff_frequency is None:
            lines.append(f"    nothing uses {', '.join(idle_points)}: a cutoff_frequency would condense them")
        return lines

    def _jointed_points(self, body: FlexibleBody) -> list[str]:
        paths = [path for joint in self.joints for path in (joint.a, joint.b)]
        return [path.partition(".")[2] for path in paths if self.split(path)[0] is body]

    @property
    def stacks(self) -> "tuple[StackActuator | StackSensor, ...]":
        """Actuators, then the sensors that are stacks."""
        return (*self.actuators, *(sensor for sensor in self.sensors if isinstance(sensor, StackSensor)))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs [V]."""
        return tuple(dict.fromkeys(a.input for a in self.actuators))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(sensor.name for sensor in self.sensors)

    @property
    def in_small_motion(self) -> bool:
        """Whether joints and bodies are taken in small motion: some body is "linear", none "ffrf", and none spins."""
        kinds = {body.fidelity for body in self.flexible_bodies}
        spins = any(np.any(body.angular_velocity) for body in self.flexible_bodies)
        return "linear" in kinds and "ffrf" not in kinds and not spins

    @property
    def flexible_bodies(self) -> tuple[FlexibleBody, ...]:
        """The flexible bodies, in order."""
        return tuple(body for body in self.bodies if isinstance(body, FlexibleBody))

    def split(self, path: str) -> tuple[Body, str]:
        """Body and point name of "body.point"; raises ValueError listing the known names."""
        body_name, dot, point = path.partition(".")
        if not dot:
            raise ValueError(f"a point is written 'body.point', got {path!r}")
        names = [body.name for body in self.bodies]
        return self.bodies[names.index(known("body", body_name, names))], point

    def point_position(self, path: str) -> Array:
        """Position of "body.point" at the start, world frame, shape (3,) [m]."""
        body, point = self.split(path)
        return body.point_position(point)

    def frame_point(self, body: FlexibleBody) -> str:
        """Remote point that carries a flexible body's floating frame."""
        if body.frame is not None:
            return body.frame
        return (self._jointed_points(body) or list(body.reduced.point_names))[0]
