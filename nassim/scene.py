"""Scenes: parts connected by name, as pure data."""

import warnings
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from nassim.body import ReducedBody
from nassim.checks import Array, finite_array, freeze, instances, known, not_negative, positive, unique
from nassim.parts import (
    Actuator,
    Body,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Sensor,
    SpringDamper,
    StackActuator,
    StackSensor,
    VoltageDrive,
    VoltageSensor,
)
from nassim.trim import keep_ports, trim_body

KINDS: dict[str, tuple[type, ...]] = {
    "bodies": get_args(Body),
    "joints": (Joint,),
    "actuators": get_args(Actuator),
    "sensors": get_args(Sensor),
    "springs": (SpringDamper,),
    "loops": (Loop,),
}
TOUCH_TOLERANCE = 1e-9
"""Largest gap [m] between the two points of a joint."""


@dataclass(frozen=True)
class Scene:
    """Everything that a simulation needs to know, as data.

    bodies, joints, actuators, sensors: the parts; names must differ within each kind. An electrical port that is
        neither driven nor measured is short-circuited.
    springs: spring-dampers; loops: digital controllers, which run in `simulate`
    damping_ratio: of every elastic eigenmode of the assembled scene [-], one number or one per mode from the lowest
        (the remaining modes then have the last); free motions, which strain nothing, have none. It is realised as a
        damping of the flexible bodies' deformation, so in floating frames motion that only springs hold keeps their
        own damping, of which a warning tells.
    gravity: acceleration, world frame, shape (3,) [m/s2]; with any, simulations start in equilibrium,
        all inputs at zero; controllers start at rest, on the offsets that their signals then have
    cutoff_frequency: what flexible bodies need below it is modelled only, see `trimmed`; take three times the highest
        frequency of interest [Hz]; None models all of each body

    Raises ValueError for unknown names and for joints whose points do not touch.
    """

    name: str
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    springs: tuple[SpringDamper, ...] = ()
    loops: tuple[Loop, ...] = ()
    damping_ratio: ArrayLike = 0.01
    gravity: Array = field(default_factory=lambda: np.zeros(3))
    cutoff_frequency: float | None = None

    def __post_init__(self) -> None:
        unique("scene", (self.name,))
        positive("cutoff_frequency", 1.0 if self.cutoff_frequency is None else self.cutoff_frequency, "Hz")
        ratio = finite_array("damping_ratio", np.atleast_1d(self.damping_ratio), (None,))
        if ratio.size == 0:
            raise ValueError("damping_ratio needs at least one value; 0 for no damping")
        for value in ratio:
            not_negative("damping_ratio", value)
        if ratio.max() >= 1:
            warnings.warn(
                f"damping_ratio {ratio.max():g} is critical damping or more, in which nothing swings: one percent is "
                "the ratio 0.01",
                stacklevel=3,
            )
        kinds = {
            label: instances(f"scene {self.name!r}: {label}", getattr(self, label), KINDS[label]) for label in KINDS
        }
        freeze(self, **kinds, damping_ratio=ratio, gravity=finite_array("gravity", self.gravity, (3,)))
        for kind, named in (
            ("body", self.bodies),
            ("joint", self.joints),
            ("actuator", self.actuators),
            ("sensor", self.sensors),
            ("spring", self.springs),
            ("loop", self.loops),
        ):
            unique(kind, (part.name for part in named))
        dotted = [body.name for body in self.bodies if "." in body.name]
        if dotted:
            raise ValueError(f"body {dotted[0]!r}: no dot in a body's name, because points are written 'body.point'")
        if not any(not isinstance(body, RigidBody) or not body.fixed for body in self.bodies):
            raise ValueError(f"scene {self.name!r} has no body that can move")
        for joint in self.joints:
            if joint.a == joint.b:
                raise ValueError(f"joint {joint.name!r} connects {joint.a!r} with itself")
            for path in (joint.a, joint.b):
                self._check_held(joint.name, path)
            gap = float(np.linalg.norm(self.point_position(joint.b) - self.point_position(joint.a)))
            if gap > TOUCH_TOLERANCE:
                raise ValueError(
                    f"joint {joint.name!r}: {joint.a!r} and {joint.b!r} are {gap:.3g} m apart; they must coincide to "
                    f"{TOUCH_TOLERANCE:g} m: move one of the bodies"
                )
        for stack in self.stacks:
            self._check_stack(stack)
        self._check_ports()
        self._check_points()
        self._check_inputs()

    def _check_held(self, joint: str, path: str) -> None:
        """A point that only moves along, as trimming leaves some, is no coordinate that a joint could hold."""
        body, point = self.split(path)
        if not isinstance(body, FlexibleBody) or body.fidelity == "rigid":
            return
        if point in [passive.name for passive in body.reduced.passive_points]:
            raise ValueError(
                f"joint {joint!r}: {path!r} is a passive point, which moves along with the body but cannot be held: "
                "use the body before it was trimmed, or name the point in trim_body(points=...)"
            )

    def _check_points(self) -> None:
        for part in (*self.springs, *self.actuators, *self.sensors):
            if isinstance(part, (Encoder, SpringDamper, PointForce)):
                for path in (part.point,) if isinstance(part, PointForce) else (part.a, part.b):
                    body = self.split(path)[0]
                    if not isinstance(body, RigidBody):
                        raise ValueError(f"{part.name!r}: {path!r} must be a point of a rigid body")
                    if isinstance(part, PointForce) and body.fixed:
                        raise ValueError(f"{part.name!r}: {path!r} belongs to a fixed body, which no force moves")
                    self.point_position(path)
        for spring in self.springs:
            if self.split(spring.a)[0] is self.split(spring.b)[0]:
                raise ValueError(f"spring {spring.name!r}: {spring.a!r} and {spring.b!r} belong to one rigid body")

    def _check_inputs(self) -> None:
        for actuator in self.actuators:
            if actuator.unit != self.input_unit(actuator.input):
                raise ValueError(
                    f"input {actuator.input!r} cannot be both {actuator.unit} and {self.input_unit(actuator.input)}"
                )
        unique("signal (input, output, loop)", (*self.inputs, *self.outputs, *self.commands))
        for loop in self.loops:
            for name in loop.measured:
                known("output", name, self.outputs)
            for name in loop.driven:
                known("input", name, self.inputs)

    def _check_ports(self) -> None:
        paths = [part.port for part in self.port_parts]
        for path in paths:
            body, port = self.split(path)
            if not isinstance(body, FlexibleBody):
                raise ValueError(f"electrical port {path!r}: body {body.name!r} is rigid and has none")
            body.reduced.port(port)
            if paths.count(path) > 1:
                raise ValueError(f"electrical port {path!r} is used more than once; drive it or measure it, once")

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
        loads = [np.zeros((len(body.reduced.mass_matrix), 0)), *(self.body_row(stack)[1] for stack in stacks)]
        points = {self.frame_point(body), *self._jointed_points(body)}
        used = {part.port.partition(".")[2] for part in self.port_parts if self.split(part.port)[0] is body}
        reduced = keep_ports(body.reduced, used)
        trimmed = trim_body(reduced, points=points, loads=np.column_stack(loads), cutoff_frequency=cutoff_frequency)
        return replace(body, reduced=trimmed, frame=self.frame_point(body))

    def summary(self) -> str:
        """What is modelled of each body, with how many coordinates, what is left out and why; the wiring; as text."""
        lines = [f"scene {self.name!r}: inputs {', '.join(self.inputs) or 'none'}; outputs {', '.join(self.outputs)}"]
        for body, trimmed in zip(self.bodies, self.trimmed().bodies, strict=True):
            if isinstance(body, RigidBody):
                lines.append(f"  {body.name}: " + ("fixed" if body.fixed else "rigid, 6 coordinates"))
            elif body.fidelity == "rigid":
                lines.append(f"  {body.name}: rigid, 6 coordinates; the others left out by its fidelity")
            else:
                assert isinstance(trimmed, FlexibleBody)
                lines.extend(self._describe(body, trimmed.reduced))
                lines.extend(f"    port {port.name}: {self._wiring(body, port.name)}" for port in body.reduced.ports)
        lines.extend(f"  {line}" for line in self._describe_mechanics())
        for loop in self.loops:
            c = loop.controller
            lines.append(
                f"  loop {loop.name}: {', '.join(loop.measured)} to {', '.join(loop.driven)} at {c.sample_rate:g} Hz, "
                f"{c.delay} sample(s) of delay"
            )
        return "\n".join(lines)

    def _describe_mechanics(self) -> list[str]:
        """Joints, springs, damping and gravity, a line each."""
        lines = [
            f"joint {j.name}: {j.a} to {j.b}, " + (f"free in {', '.join(j.free)}" if j.free else "rigid")
            for j in self.joints
        ]
        lines += [
            f"spring {s.name}: {s.a} to {s.b} along {s.axis}, {s.stiffness:g} N/m, {s.damping:g} N s/m"
            for s in self.springs
        ]
        percent = [f"{100 * ratio:g} %" for ratio in np.atleast_1d(self.damping_ratio)]
        if len(percent) > 1:
            modes = f"{', '.join(percent)} of critical in the first elastic modes, {percent[-1]} in all others"
        else:
            modes = f"{percent[0]} of critical in every elastic mode" if np.any(self.damping_ratio) else "none in modes"
        lines.append(f"damping: {modes}" + ("; dampers and loops beside it" if self._damped_beside() else ""))
        pull = " ".join(f"{g:g}" for g in self.gravity)
        return [*lines, f"gravity: {pull} m/s2" if np.any(self.gravity) else "gravity: none"]

    def _damped_beside(self) -> bool:
        leaks = any(isinstance(part, VoltageSensor) and np.isfinite(part.resistance) for part in self.sensors)
        return leaks or bool(self.loops) or any(spring.damping for spring in self.springs)

    def _wiring(self, body: FlexibleBody, port: str) -> str:
        for part in self.port_parts:
            if part.port == f"{body.name}.{port}":
                if isinstance(part, VoltageDrive):
                    return f"driven by {part.input}"
                return "measured, " + ("open" if np.isinf(part.resistance) else f"{part.resistance:g} Ohm")
        return "short-circuited"

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
        parts: tuple[Actuator | Sensor, ...] = (*self.actuators, *self.sensors)
        return tuple(part for part in parts if isinstance(part, (StackActuator, StackSensor)))

    @property
    def port_parts(self) -> "tuple[VoltageDrive | VoltageSensor, ...]":
        """Drives, then the sensors at electrical ports."""
        parts: tuple[Actuator | Sensor, ...] = (*self.actuators, *self.sensors)
        return tuple(part for part in parts if isinstance(part, (VoltageDrive, VoltageSensor)))

    def body_row(self, part: StackActuator | VoltageDrive | StackSensor | VoltageSensor) -> tuple[FlexibleBody, Array]:
        """The flexible body that a part belongs to, and its row over the reduced coordinates, shape (n,).

        Of an actuator: forces on the coordinates per unit input; of a sensor: its output per unit of the coordinates,
        at a port without charge.
        """
        if isinstance(part, (StackActuator, StackSensor)):
            body, start = self.split(part.start)
            assert isinstance(body, FlexibleBody)
            row = body.elongation(start, part.end.partition(".")[2])
            if isinstance(part, StackSensor):
                return body, -part.voltage_per_elongation * row
            return body, part.gain * part.force_per_volt * row
        body, name = self.split(part.port)
        assert isinstance(body, FlexibleBody)
        port = body.reduced.port(name)
        if isinstance(part, VoltageDrive):
            return body, part.gain * port.forces
        return body, -part.gain / (port.blocked_capacitance + part.capacitance) * port.forces

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(dict.fromkeys(a.input for a in self.actuators))

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of what the loops' controllers put out."""
        return tuple(name for loop in self.loops for name in loop.commands)

    def input_unit(self, name: str) -> str:
        """Unit of an input."""
        return next(a.unit for a in self.actuators if a.input == name)

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
        if not isinstance(path, str) or "." not in path:
            raise ValueError(f"a point is written 'body.point', got {path!r}")
        body_name, _, point = path.partition(".")
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
        names = body.reduced.point_names
        return next((name for name in self._jointed_points(body) if name in names), names[0])
