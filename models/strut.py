"""Struts of a hexapod: flexible joint, actuator, flexible joint. Each strut is a scene that `placed` puts anywhere.

A strut stands on the origin along its z axis, with the actuator's bottom towards the base. Every strut has the bodies
"bottom" and "top". Each has a point "end" at the centre of its joint, which is rigidly connected to a plate. The output
"encoder" is the change of the distance between the two ends [m].

    fe_strut        finite element APA300ML, linear or in a floating frame
    two_mass_strut  the APA300ML as three springs: a fast model, rigid except along the strut
    imported_strut  a reduced body of any origin, of a whole strut or of an actuator
    spring_strut    a spring between ideal joints, for closed forms and published cases

Actuators have the input "actuator_voltage" (DAC) [V] and the output "sensor_voltage" [V], positive in compression. A
spring strut has the input "actuator_force" [N] and the output "sensor_force" [N], positive in tension. Source of the
joints' values: a reduced flexible joint of T. Dehaeze's group (MIT licence), unless marked "assumed".
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from nassim import (
    Bushing,
    Controller,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Joint,
    LinearActuator,
    LinearModel,
    ReducedBody,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    fixed,
    prismatic,
    register,
    spherical,
    universal,
)
from nassim.base.checks import Array, known, positive
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import axes_along
from nassim.kinematics import strut_lengths
from nassim.scene import Actuator, AppliedForce, Distance, Output, Path, Sensor, Signal
from nassim.simulation.model.damping import held_alone

from .apa300ml import PORTS, STACK, reduced_apa300ml
from .bench import AMPLIFIER_GAIN, electrical_ports, force_pair, sensor_span_constant
from .hexapods import NANO_HEXAPOD
from .two_mass import APA300ML, TwoMassActuator

LENGTH = float(strut_lengths(NANO_HEXAPOD)[0])
"""Distance of the joints' centres in the nano-hexapod [m]: 82.485 mm, including 30 mm of the actuator."""
JOINT_STIFFNESS = (12.71e6, 12.71e6, 93.96e6, 4.83, 4.83, 260.2)
"""Stiffness of one flexible joint, z along the strut: two shear, axial [N/m], two bending, torsion [N m/rad]."""
JOINT_MASS = 29.2e-3
"""Mass of one flexible joint [kg], half of it on each side; assumed to be at its centre."""
JOINT_SIDE = 12e-3
"""Side of a steel cube with half that mass [m], assumed for the inertia of the halves."""
WEIGHTLESS = 1e-9
"""Mass of ends without mass [kg], because a body needs a mass."""
APA_HEIGHT = 30e-3
APA_SIZE = np.array([78.79e-3, 20e-3, APA_HEIGHT])
HALF_LENGTH, HALF_RADIUS = 50e-3, 5e-3
"""Length and radius of the two cylinders of the published spring strut with masses [m]."""
SWINGING = 0.9
"""Largest damping ratio of a body's own modes; above it, modes hardly oscillate."""
REACH = 1e-6
"""Largest distance between a remote point and a position that identifies it [m]."""


@register
@dataclass(frozen=True)
class LineDrive(Actuator):
    """A voltage that pushes two points apart along the line between them.

    Attributes:
        name: name of the part
        a: "body.point"
        b: "body.point"
        input: name of the scene's input [V]
        gain: force per voltage [N/V]
    """

    name: str
    a: Path
    b: Path
    input: Signal
    gain: float
    factor = "gain"

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the force along the line."""
        return (AppliedForce(self.input, "V", Distance(self.a, self.b), self.gain),)

    def describe(self) -> str:
        """Name the points, the input and the gain."""
        return f"line drive {self.name}: pushes {self.a} and {self.b} apart, {self.gain:.4g} N/V, by {self.input} [V]"


@register
@dataclass(frozen=True)
class LineSensor(Sensor):
    """A voltage that measures the change of the distance between two points since the start.

    Attributes:
        name: name of the scene's output [V]
        a: "body.point"
        b: "body.point"
        gain: voltage per change of the distance [V/m]
    """

    name: str
    a: Path
    b: Path
    gain: float
    factor = "gain"

    def terms(self, scene: Scene) -> tuple[Output]:
        """Return the change of the line's length."""
        return (Output(self.name, "V", Distance(self.a, self.b), self.gain),)

    def describe(self) -> str:
        """Name the points and the gain."""
        return f"line sensor {self.name} [V]: distance of {self.a} and {self.b}, {self.gain:.4g} V/m"


def fe_strut(
    fidelity: str = "linear",
    *,
    apa: ReducedBody | None = None,
    length: float = LENGTH,
    joint_stiffness: ArrayLike = JOINT_STIFFNESS,
    damping_ratio: float = 0.01,
) -> Scene:
    """Make a strut with flexible joints and the finite element actuator, with stacks wired as on the paper's bench.

    Args:
        fidelity: fidelity of the actuator, see `FlexibleBody`
        apa: a reduced APA300ML (default: `reduced_apa300ml` with `PORTS`, from the cache); one without ports is driven
            by a pair of forces, see `make_bench`
        length: distance of the joints' centres [m]
        joint_stiffness: six values, as `JOINT_STIFFNESS`
        damping_ratio: damping ratio of the modes of the strut as a scene of its own, see `Scene`
    """
    body = reduced_apa300ml(ports=PORTS) if apa is None else apa
    middle = (body.point("bottom").position + body.point("top").position) / 2
    actuator = FlexibleBody("apa", body, np.array([0, 0, length / 2]) - middle, np.eye(3), fidelity, "bottom")
    drive, sensor = electrical_ports() if body.ports else force_pair()
    core = Scene("strut", (actuator,), (), (drive,), (sensor,), damping_ratio=damping_ratio)
    return _with_ends(core, "apa.bottom", "apa.top", length, joint_stiffness)


def imported_strut(
    body: ReducedBody,
    *,
    bottom: str | ArrayLike | None = None,
    top: str | ArrayLike | None = None,
    fidelity: str = "linear",
    length: float | None = None,
    joint_stiffness: ArrayLike | None = None,
    stacks: tuple[str, str] | None = None,
    sensor: tuple[str, str] | None = None,
    damping_ratio: float = 0.01,
) -> Scene:
    """Make a strut from a reduced body of any origin: of a whole strut or, with joint_stiffness, of an actuator.

    The line between the ends becomes the axis of the strut. The body is turned there by the smallest rotation.

    Args:
        body: the reduced body
        bottom: lower end, a remote point by its name or by its position in the body's frame [m]; may be omitted for a
            body with two points, whose order then counts
        top: upper end, likewise
        fidelity: fidelity of the body, see `FlexibleBody`
        length: distance of the joints' centres [m] (default: that of the body); rigid ends of equal length fill the
            difference
        joint_stiffness: stiffness of flexible joints to be added, such as `JOINT_STIFFNESS` (default: no joints are
            added)
        stacks: two remote points that the two actuator stacks of an APA300ML push apart (default: electrical port
            "actuator", if the body has it)
        sensor: two remote points between which its third stack measures (default: electrical port "sensor", if the body
            has it)
        damping_ratio: damping ratio of the modes of the strut as a scene of its own, see `Scene`

    Raises:
        ValueError: for ends that are not found, not given or in the same place
    """
    first, last = _ends_of(body, bottom, top)
    low, high = body.point(first).position, body.point(last).position
    turn = _upright(high - low, body.name)
    whole = float(np.linalg.norm(high - low)) if length is None else length
    place = np.array([0, 0, whole / 2]) - turn @ (low + high) / 2
    strut = FlexibleBody("apa", body, place, turn, fidelity, first)
    core = Scene("strut", (strut,), (), *_wiring(body, stacks, sensor), damping_ratio=damping_ratio)
    return _with_ends(core, f"apa.{first}", f"apa.{last}", whole, joint_stiffness)


def two_mass_strut(
    actuator: TwoMassActuator = APA300ML,
    *,
    length: float = LENGTH,
    joint_stiffness: ArrayLike = JOINT_STIFFNESS,
    damping_ratio: float = 0.01,
) -> Scene:
    """Make a strut with flexible joints and an actuator of two sliding halves, with the springs of `TwoMassActuator`.

    The sensor is open. On the bench, a resistance discharges it below 1 Hz.

    Args:
        actuator: values of the actuator
        length: distance of the joints' centres [m]
        joint_stiffness: six values, as `JOINT_STIFFNESS`
        damping_ratio: damping ratio of the modes of the strut as a scene of its own, see `Scene`
    """
    low, high = length / 2 - APA_HEIGHT / 2, length / 2 + APA_HEIGHT / 2
    # Each half is a block with the actuator's outline and half its height. Only the mass of the middle matters.
    size = APA_SIZE * [1, 1, 0.5]
    bodies = [
        RigidBody(
            name,
            {"end": (0, 0, end - at), "slide": (0, 0, length / 2 - at)},
            mass,
            mass / 12 * np.diag(size @ size - size**2),
            (0, 0, at),
        )
        for name, mass, end, at in (
            ("lower", actuator.lower_mass, low, low + APA_HEIGHT / 4),
            ("upper", actuator.upper_mass, high, high - APA_HEIGHT / 4),
        )
    ]
    little = actuator.middle_mass * JOINT_SIDE**2 / 6 * np.eye(3)
    bodies.append(RigidBody("middle", {"slide": np.zeros(3)}, actuator.middle_mass, little, (0, 0, length / 2)))
    force_per_volt = AMPLIFIER_GAIN * actuator.force_per_volt
    core = Scene(
        "strut",
        tuple(bodies),
        (prismatic("guide", "lower.slide", "upper.slide"), prismatic("rail", "lower.slide", "middle.slide")),
        (LineDrive("actuator_stacks", "middle.slide", "upper.end", "actuator_voltage", force_per_volt),),
        (LineSensor("sensor_voltage", "lower.end", "middle.slide", actuator.voltage_per_elongation),),
        (
            SpringDamper("shell", "lower.end", "upper.end", "line", actuator.shell),
            SpringDamper("sensor", "lower.end", "middle.slide", "line", actuator.sensor),
            SpringDamper("drive", "middle.slide", "upper.end", "line", actuator.drive),
        ),
        damping_ratio=damping_ratio,
    )
    return _with_ends(core, "lower.end", "upper.end", length, joint_stiffness)


def spring_strut(
    stiffness: float,
    *,
    damping: float = 0.0,
    parallel_stiffness: float = 0.0,
    mass: float = 0.0,
    length: float = LENGTH,
) -> Scene:
    """Make a strut of spring, damper and force between ideal joints: universal at the bottom, spherical at the top.

    "sensor_force" is the tension in spring and damper. See `sensors_in_line` and `controller_in_line` for a sensor that
    also measures the actuator's force.

    Args:
        stiffness: stiffness of the spring, whose force the sensor measures [N/m]
        damping: damping of the damper, whose force the sensor measures [N s/m]
        parallel_stiffness: stiffness of a parallel spring [N/m]
        mass: mass of two cylinders that slide in each other, half of it each [kg]; 0 for none
        length: distance of the joints' centres [m]
    """
    bodies, joints = (_end("bottom", 0.0), _end("top", length)), ()
    if mass:
        bodies, joints = (*bodies, *_halves(mass, length)), _ideal_joints()
    ends = ("bottom.end", "top.end")
    parallel = (SpringDamper("beside", *ends, "line", parallel_stiffness),) if parallel_stiffness else ()
    return Scene(
        "strut",
        bodies,
        joints,
        (LinearActuator("actuator", *ends, "actuator_force"),),
        (ForceSensor("sensor_force", "spring"), Encoder("encoder", *ends, "line")),
        (SpringDamper("spring", *ends, "line", stiffness, damping), *parallel),
        damping_ratio=0.0,
    )


def with_own_damping(strut: Scene, ratio: float = 0.01, *, frequency: float = 100.0) -> Scene:
    """Return the strut with Kelvin-Voigt damping, proportional to its parts' stiffness, instead of modal damping.

    A mode of the machine at the given frequency then has the given ratio, and the ratios of other modes are
    proportional to their frequencies. The damping is valid in every fidelity and position. Modal damping of a scene
    acts in floating frames on the deformation of bodies only, which is not the dominant motion of bodies on flexible
    joints. The bodies must be in their final form: trim them before, not by a cutoff_frequency of the machine.

    Args:
        strut: the strut
        ratio: damping ratio [-]
        frequency: frequency of this ratio [Hz]
    """
    time = positive("damping ratio", ratio) / (math.pi * positive("frequency", frequency, "Hz"))

    def damped(body: FlexibleBody) -> FlexibleBody:
        frequencies = body.reduced.eigenfrequencies(fixed=held_alone(strut, body))
        return replace(body, damping_ratio=np.minimum(math.pi * time * frequencies[frequencies > 0], SWINGING))

    bodies = [damped(body) if isinstance(body, FlexibleBody) else body for body in strut.bodies]
    springs = [replace(spring, damping=time * spring.stiffness) for spring in strut.springs]
    return replace(strut, bodies=tuple(bodies), springs=tuple(springs), damping_ratio=0.0)


def sensors_in_line(model: LinearModel) -> LinearModel:
    """Return the linear model of spring struts whose sensors are in series with spring, damper and actuator.

    Each "sensor_force" is then the tension in spring and damper minus the "actuator_force" of the strut.

    Args:
        model: linear model of the machine
    """
    direct = model.D.copy()
    for row, output in enumerate(model.outputs):
        if output.endswith("sensor_force"):
            direct[row, model.inputs.index(output.removesuffix("sensor_force") + "actuator_force")] -= 1.0
    return replace(model, D=direct)


def controller_in_line(controller: Controller) -> Controller:
    """Return the controller for "sensor_force" equivalent to a controller of a sensor in series with the actuator.

    It does for a simulation in time what `sensors_in_line` does for a linear model. The sensor in series measures the
    actuator's force too, which the controller knows, because nothing else drives the actuator. Each output belongs to
    the input with the same number.

    Args:
        controller: controller of the sensor in series

    Raises:
        ValueError: for a delay other than one sample, because the force during sampling is then not the last output
    """
    if controller.delay != 1:
        raise ValueError(f"a controller of a sensor in line needs a delay of 1 sample here, got {controller.delay}")
    a, b, c, d = controller.matrices
    return replace(controller, A=np.block([[a, -b], [c, -d]]), B=np.vstack([b, d]), C=np.hstack([c, -d]))


def _wiring(
    body: ReducedBody, stacks: tuple[str, str] | None, sensor: tuple[str, str] | None
) -> tuple[tuple[Actuator, ...], tuple[Sensor, ...]]:
    """Return actuators and sensors of an imported body "apa"."""
    drives: tuple[Actuator, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    if {"actuator", "sensor"} <= {port.name for port in body.ports}:
        drive, measure = electrical_ports()
        drives, sensors = (drive,), (measure,)
    if stacks is not None:
        a, b = (f"apa.{name}" for name in stacks)
        drives = (StackActuator("actuator_stacks", a, b, STACK.force_per_volt, "actuator_voltage", AMPLIFIER_GAIN),)
    if sensor is not None:
        a, b = (f"apa.{name}" for name in sensor)
        sensors = (StackSensor("sensor_voltage", a, b, sensor_span_constant()),)
    return drives, sensors


def _with_ends(core: Scene, bottom: str, top: str, length: float, joint_stiffness: ArrayLike | None) -> Scene:
    """Make a strut from a core between two points on its axis, with flexible joints or rigid ends."""
    bodies: list[RigidBody] = []
    joints: list[Joint] = []
    springs: list[Bushing] = []
    for name, path, height in (("bottom", bottom, 0.0), ("top", top, length)):
        reach = core.point_position(path) - [0, 0, height]
        if joint_stiffness is None:
            bodies.append(_end(name, height, {"actuator": reach}))
            joints.append(fixed(f"{name}_mount", path, f"{name}.actuator"))
            continue
        inertia = JOINT_MASS / 2 * JOINT_SIDE**2 / 6 * np.eye(3)
        for half, points in ((name, {"end": np.zeros(3)}), (f"{name}_flange", {"end": np.zeros(3), "actuator": reach})):
            bodies.append(RigidBody(half, points, JOINT_MASS / 2, inertia, (0, 0, height)))
        joints.append(fixed(f"{name}_mount", path, f"{name}_flange.actuator"))
        ends = (f"{name}.end", f"{name}_flange.end")
        springs.append(Bushing(f"{name}_joint", *(ends if name == "bottom" else ends[::-1]), joint_stiffness))
    return replace(
        core,
        bodies=(*core.bodies, *bodies),
        joints=(*core.joints, *joints),
        springs=(*core.springs, *springs),
        sensors=(*core.sensors, Encoder("encoder", "bottom.end", "top.end", "line")),
    )


def _end(name: str, height: float, points: dict[str, Array] | None = None) -> RigidBody:
    inertia = WEIGHTLESS * JOINT_SIDE**2 / 6 * np.eye(3)
    return RigidBody(name, {"end": np.zeros(3)} | (points or {}), WEIGHTLESS, inertia, (0, 0, height))


def _halves(mass: float, length: float) -> tuple[RigidBody, RigidBody]:
    half, to_middle = mass / 2, length / 2 - HALF_LENGTH / 2
    across, about = half * (HALF_RADIUS**2 / 4 + HALF_LENGTH**2 / 12), half * HALF_RADIUS**2 / 2
    inertia = np.diag([across, across, about])
    lower = {"end": (0, 0, -HALF_LENGTH / 2), "slide": (0, 0, to_middle)}
    upper = {"end": (0, 0, HALF_LENGTH / 2), "slide": (0, 0, -to_middle)}
    return (
        RigidBody("lower", lower, half, inertia, (0, 0, HALF_LENGTH / 2)),
        RigidBody("upper", upper, half, inertia, (0, 0, length - HALF_LENGTH / 2)),
    )


def _ideal_joints() -> tuple[Joint, ...]:
    return (
        universal("bottom_joint", "bottom.end", "lower.end", "x", "y"),
        prismatic("slide", "lower.slide", "upper.slide"),
        spherical("top_joint", "upper.end", "top.end"),
    )


def _ends_of(body: ReducedBody, bottom: str | ArrayLike | None, top: str | ArrayLike | None) -> tuple[str, str]:
    if bottom is None and top is None:
        if len(body.point_names) != 2:
            raise ValueError(
                f"body {body.name!r} has {len(body.point_names)} remote points ({', '.join(body.point_names)}); say "
                "which are its ends: bottom=..., top=..."
            )
        return body.point_names[0], body.point_names[1]
    if bottom is None or top is None:
        raise ValueError(f"body {body.name!r}: give both ends, bottom and top, or neither")
    return _point_at(body, bottom), _point_at(body, top)


def _point_at(body: ReducedBody, end: str | ArrayLike) -> str:
    if isinstance(end, str):
        return known(f"point of {body.name!r}:", end, body.point_names)
    apart = np.linalg.norm(body.positions - np.asarray(end, dtype=float), axis=1)
    near = int(np.argmin(apart))
    if apart[near] > REACH:
        places = "; ".join(f"{p.name} {np.array2string(p.position, separator=', ')}" for p in body.remote_points)
        raise ValueError(
            f"body {body.name!r} has no remote point within {REACH:g} m of {end}; it has {places}; is that in metres?"
        )
    return body.point_names[near]


def _upright(line: Array, name: str) -> Array:
    """Return the smallest rotation that turns a line to z; it is about x if the line points down."""
    if np.linalg.norm(line) < REACH:
        raise ValueError(f"body {name!r}: its ends are in the same place; a strut needs two different ends")
    z = line / np.linalg.norm(line)
    if np.hypot(z[0], z[1]) < 1e-12:
        return np.diag([1.0, np.sign(z[2]), np.sign(z[2])])
    across = np.cross(z, [0, 0, 1.0])
    before, after = axes_along(across, z), axes_along(across, (0, 0, 1))
    return after @ before.T
