"""The end-station: granite, translation, tilt, spindle, micro-hexapod, the nano-hexapod on top, and its metrology.

Stages are rigid bodies on bushings. The world's origin is F of the nano-hexapod; the stages are below it, and the
spindle turns about z. Few values of the real machine are public:

| value | source |
|---|---|
| order of the stages; payloads of 1 to 50 kg; spindle up to 60 rpm | published |
| travel of translation (5 mm) and tilt (51 mrad); range of the metrology across the beam (0.5 mm) | published |
| axis of the tilt stage, through the point of interest | assumed |
| geometry of the nano-hexapod and masses of its plates (`models.hexapods`, `models.nano_hexapod`) | published |
| stiffness of spindle (radial, axial), tilt stage (each of four guides) and legs of the micro-hexapod | U, unverified |
| masses, sizes, heights, other stiffnesses and damping of the stages; share of the tilt guides | assumed |
| speed of translation and tilt; accelerations of all drives | assumed |
| spectra of floor, runout, stages and electronics | not here: a noise budget has them |

Values marked U belong to an early model (2018) that has been superseded: they are no reference. Those marked "assumed"
are ours; they give modes at frequencies that are usual for such machines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim import Bushing, Drive, GroundAcceleration, RigidBody, Scene, fixed, register, revolute
from nassim.base.checks import Array, finite, finite_array, freeze, known, positive
from nassim.base.field_types import ArrayLike
from nassim.base.rigid_motion import unit_vector
from nassim.kinematics import StewartPlatform, stiffness_matrix
from nassim.scene import (
    Actuator,
    AppliedForce,
    Direction,
    Displacement,
    Measure,
    Output,
    Path,
    PointVelocity,
    RotationAngle,
    RotationDeviation,
    Sensor,
    Signal,
)
from nassim.scene.axes_and_points import axis_text
from nassim.signals import DriveLimits
from nassim.simulation.model.assembly import assemble

from .apa300ml import STEEL
from .hexapods import NANO_HEXAPOD
from .nano_hexapod import BASE_MASS, PLATE_RADIUS, make_nano_hexapod
from .strut import two_mass_strut, with_own_damping

SIX = ("ux", "uy", "uz", "rx", "ry", "rz")
DAMPING_RATIO, DAMPING_FREQUENCY = 0.02, 100.0
"""Kelvin-Voigt damping of the stages' bushings: damping ratio of a mode [-] at this frequency [Hz], assumed."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A rigid stage on a bushing.

    Attributes:
        mass: mass [kg]
        size: sides x y z of a homogeneous box with its inertia [m]
        foot: height of its bushing, from F of the nano-hexapod [m]
        centre: height of its centre of mass, from F of the nano-hexapod [m]
        stiffness: stiffness of the bushing, ux uy uz rx ry rz: diagonal (6,) or matrix (6, 6) [N/m, N m/rad]
        damping_ratio: damping ratio of a mode at `DAMPING_FREQUENCY` on this bushing alone [-]
    """

    mass: float
    size: tuple[float, float, float]
    foot: float
    centre: float
    stiffness: Array
    damping_ratio: float = DAMPING_RATIO

    def __post_init__(self) -> None:
        given = np.asarray(self.stiffness, dtype=float)
        shape = (6,) if given.ndim == 1 else (6, 6)
        freeze(
            self, mass=positive("mass of a stage", self.mass, "kg"), stiffness=finite_array("stiffness", given, shape)
        )

    @property
    def inertia(self) -> Array:
        """Inertia about the centre of mass, shape (3, 3) [kg m2]."""
        squares = np.square(self.size)
        return self.mass / 12 * np.diag(squares.sum() - squares)

    def alike(self) -> "Stage":
        """Return the stage with equal properties in all directions across z: means of size and stiffness of x and y."""
        x, y, z = self.size
        across = (x + y) / 2
        if self.stiffness.ndim == 2:
            raise ValueError(
                "only a bushing with six values can be averaged across z; give the diagonal of its stiffness"
            )
        ux, uy, uz, rx, ry, rz = self.stiffness
        k, c = (ux + uy) / 2, (rx + ry) / 2
        return replace(self, size=(across, across, z), stiffness=np.array([k, k, uz, c, c, rz]))


def four_corners(each: ArrayLike, along_x: float, along_y: float) -> Array:
    """Return the stiffness of four bearings at +- along_x, +- along_y from the centre [m], (6,) [N/m, N m/rad]."""
    x, y, z = 4 * np.asarray(each, dtype=float)
    return np.array([x, y, z, z * along_y**2, z * along_x**2, x * along_y**2 + y * along_x**2])


MICRO_HEXAPOD = StewartPlatform.from_angles(
    height=0.25,
    base_radius=0.18,
    base_angles=(-15, 15, 105, 135, 225, 255),
    base_height=0.03,
    platform_radius=0.15,
    platform_angles=(-45, 45, 75, 165, 195, -75),
    platform_depth=0.03,
)
"""Geometry of the micro-hexapod [m], assumed."""
LEG_STIFFNESS = 5e7
"""Stiffness of each leg of the micro-hexapod [N/m]; U, unverified."""

END_STATION: dict[str, Stage] = {
    # All masses, sizes and heights are assumed.
    "granite": Stage(
        mass=2500.0,
        size=(2.0, 2.0, 0.4),
        foot=-1.2,
        centre=-1.0,
        stiffness=np.array([8e8, 8e8, 1.5e9, 1e9, 1e9, 8e8]),  # feet, assumed
    ),
    "translation": Stage(
        mass=800.0,
        size=(0.9, 1.0, 0.25),
        foot=-0.8,
        centre=-0.7,
        stiffness=np.array([8e8, 4e8, 1.2e9, 1.5e8, 1.2e8, 1e8]),  # guides, and the motor along y, assumed
    ),
    "tilt": Stage(
        mass=400.0,
        size=(0.7, 0.6, 0.2),
        foot=-0.55,
        centre=-0.45,
        stiffness=four_corners((555e6, 357e6, 238e6), 0.25, 0.25),  # U, unverified, each of four; positions assumed
    ),
    "spindle": Stage(
        mass=150.0,
        size=(0.45, 0.45, 0.3),
        foot=-0.4,
        centre=-0.4,
        # Bearing: 7e8 radial, 2e9 axial, U, unverified; tilt and the motor's stiffness about z are assumed.
        stiffness=np.array([7e8, 7e8, 2e9, 1e8, 1e8, 1e8]),
    ),
    "micro_hexapod": Stage(
        mass=40.0,
        size=(0.4, 0.4, 0.05),
        foot=-0.03,
        centre=-0.02,
        stiffness=stiffness_matrix(MICRO_HEXAPOD, LEG_STIFFNESS),
    ),
}
"""Stages from the floor up. The bearing of the spindle is the bushing below its stator, see `make_nass`."""
ROTOR_MASS, ROTOR_SIZE, ROTOR_CENTRE = 120.0, (0.4, 0.4, 0.2), -0.32
"""Mass [kg], size [m] and height of the centre [m] of the spindle's rotor below the micro-hexapod, assumed."""
DISTURBANCES: dict[str, tuple[str, str]] = {
    "runout_x": ("spindle", "ux"),
    "runout_y": ("spindle", "uy"),
    "runout_z": ("spindle", "uz"),
    "translation_y": ("translation", "uy"),
    "translation_z": ("translation", "uz"),
    "tilt_ry": ("tilt", "ry"),
}
"""Inputs that move the rest position of a stage's bushing, with the stage and the direction."""
ROTOR_DISTURBANCES = {**DISTURBANCES, "translation_x": ("translation", "ux"), "tilt_rx": ("tilt", "rx")}
"""The same in the frame "rotor", where a direction across the axis of the spindle needs the other one."""
FIXED_PAIRS = (("floor_x", "floor_y"), ("translation_x", "translation_y"), ("tilt_rx", "tilt_ry"))
"""Inputs along x and y of the world, which in the frame "rotor" are along axes that turn with the rotor."""
POSE_PAIRS = (("metrology.ux", "metrology.uy"), ("metrology.rx", "metrology.ry"))
"""Outputs across the axis, likewise."""
DRIVES = {
    "spindle_angle": DriveLimits(travel=np.inf, speed=2 * np.pi, acceleration=10.0),  # 60 rpm
    "translation_y": DriveLimits(travel=5e-3, speed=10e-3, acceleration=0.1),
    "tilt_angle": DriveLimits(travel=51e-3, speed=50e-3, acceleration=0.5),
}
"""What the drives can do, by input; their travels and the speed of the spindle are published, the others assumed."""
GUIDES_SHARE = 0.25
"""Share of the tilt stage's mass that does not tilt, where its drive moves it: its guides, assumed."""
METROLOGY_RANGE = DriveLimits(travel=0.5e-3, speed=np.inf, acceleration=np.inf)
"""Published range of the metrology across the beam [m]."""


@register
@dataclass(frozen=True)
class Offset(Actuator):
    """Displacement of a spring's rest position by an input: runout of a bearing, noise of a stage's motor or guide.

    Attributes:
        name: name of the part
        a: "body.point" of the spring
        b: "body.point" of the spring
        axis: direction along which, or about which, b moves relative to a
        input: name of the scene's input [m], or [rad] for a rotation
        stiffness: stiffness of the spring [N/m] or [N m/rad]
        turns: whether the motion is a rotation
        frame: "" or a point with whose body the axis turns
    """

    name: str
    a: Path
    b: Path
    axis: Direction
    input: Signal
    stiffness: float
    turns: bool = False
    frame: Path = ""

    def terms(self, scene: Scene) -> tuple[AppliedForce]:
        """Return the force of the spring on b and a: its stiffness times the input."""
        _check_points(scene, self.a, self.b, self.frame)
        axis = unit_vector(self.axis)
        measure = PointVelocity(((self.a, -axis), (self.b, axis)), self.frame, angular=self.turns)
        return (AppliedForce(self.input, "rad" if self.turns else "m", measure, self.stiffness),)

    def describe(self) -> str:
        """Name the points, the axis and the input."""
        way = f"{'about' if self.turns else 'along'} {axis_text(self.axis, self.frame)}"
        return (
            f"offset {self.name}: of {self.b} against {self.a} {way}, by {self.input} [{'rad' if self.turns else 'm'}]"
        )


@register
@dataclass(frozen=True)
class Metrology(Sensor):
    """Six outputs: displacement and rotation of point b relative to point a, along the world's axes or those of a body.

    The rotation is a rotation vector beside the turn of the spindle, which its encoder reads: the deviation from the
    ideal pose at any angle. Along the world's axes, "name.rz" is the whole angle.

    Attributes:
        name: prefix of the outputs "name.ux" ... [m] and "name.rx" ... [rad]
        a: "body.point"
        b: "body.point"
        frame: "" for the world's axes, or a point with whose body the axes turn, as on a spindle
        encoder: points on the stator and on the rotor of the spindle; none for a machine without one
    """

    name: str
    a: Path
    b: Path
    frame: Path = ""
    encoder: tuple[Path, ...] = ()

    def terms(self, scene: Scene) -> tuple[Output, ...]:
        """Return the six components of the motion of b relative to a."""
        _check_points(scene, self.a, self.b, self.frame, *self.encoder)
        return tuple(Output(f"{self.name}.{six}", "rad" if six[0] == "r" else "m", self._component(six)) for six in SIX)

    def describe(self) -> str:
        """Name the points and the axes."""
        axes = f"axes that rotate with {self.frame}" if self.frame else "the world's axes"
        return f"metrology {self.name} [m], [rad]: {self.b} against {self.a}, along {axes}"

    def _component(self, six: str) -> Measure:
        axis, turning = unit_vector(six[1]), bool(self.frame)
        if six[0] == "u":
            return Displacement.between(self.a, self.b, axis, axes_of=self.frame)
        if six == "rz" and not turning:
            return RotationAngle(self.b, axis, self.a)
        c, d = self.encoder or (self.a, self.a)
        return RotationDeviation(self.a, self.b, axis, c, d, unit_vector("z"), turning)


def make_nass(
    struts: Scene | Sequence[Scene] | None = None,
    *,
    stages: Mapping[str, Stage] | None = None,
    platform: StewartPlatform = NANO_HEXAPOD,
    payload_mass: float = 10.0,
    payload_centre: ArrayLike | None = None,
    payload_inertia: ArrayLike | None = None,
    spindle_rpm: float = 0.0,
    spindle_input: str = "",
    tilt_input: str = "",
    frame: str = "stator",
) -> Scene:
    """Make the end-station as a scene: bodies "granite" ... "micro_hexapod", "rotor" and those of `make_nano_hexapod`.

    Inputs, in addition to those of the hexapod, are "floor_x" ... "floor_z", the acceleration of the ground [m/s2], and
    those of `DISTURBANCES` [m], [rad]. Outputs, in addition to those of the hexapod, are "metrology.ux" ...
    "metrology.rz", the pose of the sample at its point of interest relative to the ground.

    While the spindle turns, a linear time-invariant model exists only if all signals across its axis are along axes of
    the rotor. In the frame "rotor", all inputs across the axis are therefore along axes that turn with it, those of
    floor and stages too, which come in pairs, `FIXED_PAIRS`: turn their signals by `nassim.signals.turned`. For the
    same reason `linearize` refuses stages whose properties differ across the axis, as those of the real machine do. Use
    `alike_across`, which averages these properties, or a spindle that does not turn.

    A simulation in floating frames with a turning spindle begins with a transient, because it has no steady initial
    state for a spindle on a moving body. The nano-hexapod twists by some milliradians, far beyond nanometres; this has
    to die out first. Exact steps, of stages alike across the axis, start in the steady state.

    Args:
        struts: struts of the nano-hexapod (default: `two_mass_strut` with damping of its parts)
        stages: stages from the floor up, with the names of `END_STATION`, which is the default
        platform: see `make_nano_hexapod`
        payload_mass: see `make_nano_hexapod`
        payload_centre: see `make_nano_hexapod`
        payload_inertia: see `make_nano_hexapod`
        spindle_rpm: speed of the spindle [1/min]; 0 for a locked spindle
        spindle_input: name of an input [rad] that the angle of the spindle follows; "" for a constant speed
        tilt_input: name of an input [rad] that the angle of the tilt stage follows; "" for a locked stage. It tilts
            about the line along y through the point of interest, as its curved guides make it, and what is above it
            stands on a body "tilt_guides".
        frame: "stator" for a locked spindle and for simulations in large motion; "rotor" for linear models of a spindle
            that turns, whose metrology and disturbances have axes that turn with it. The angle of a `spindle_input` is
            a path in the world: only metrology and runout turn with the rotor, and floor and stages do not.

    Raises:
        ValueError: for other names of stages or frames, and as in `make_nano_hexapod`
    """
    stages = END_STATION if stages is None else stages
    if tuple(stages) != tuple(END_STATION):
        raise ValueError(f"stages must be {', '.join(END_STATION)}, in this order, got {', '.join(stages) or 'none'}")
    hexapod = make_nano_hexapod(
        with_own_damping(two_mass_strut()) if struts is None else struts,
        platform=platform,
        payload_mass=payload_mass,
        payload_centre=payload_centre,
        payload_inertia=payload_inertia,
    )
    known("frame", frame, ("stator", "rotor"))
    speed, in_rotor = 2 * np.pi * finite("spindle_rpm", spindle_rpm) / 60, frame == "rotor"
    sample = hexapod.point_position("payload.target")
    ground = RigidBody("ground", {"floor": (0, 0, stages["granite"].foot), "sample": sample}, fixed=True)
    base = _loose(hexapod.body("base"))
    others = (body for body in hexapod.bodies if body.name != "base")
    turns = bool(speed or spindle_input)
    bearing = revolute if turns else fixed
    drives: tuple[Drive, ...] = (Drive("spindle", "spindle", "rz", input=spindle_input, speed=speed),) if turns else ()
    rotor = "rotor.foot" if in_rotor else ""
    across = "" if spindle_input else rotor
    encoder = ("spindle.head", "rotor.foot")
    supports, tilted = _supports(stages), []
    if tilt_input:
        supports["tilt"] = supports["tilt"][0], "tilt_guides.foot"
        tilted = [revolute("tilt", "tilt_guides.axis", "tilt.axis", "y")]
        drives += (Drive("tilt", "tilt", "rz", input=tilt_input),)
    floor = tuple(GroundAcceleration(f"floor_{c}", c, f"floor_{c}", "" if c == "z" else across) for c in "xyz")
    return replace(
        hexapod,
        name="nass",
        bodies=(ground, *_stage_bodies(stages, sample if tilt_input else None), base, *others),
        joints=(
            *hexapod.joints,
            *tilted,
            bearing("spindle", "spindle.head", "rotor.foot"),
            fixed("nano_hexapod", "micro_hexapod.head", "base.centre"),
        ),
        springs=(*hexapod.springs, *_bushings(stages, supports)),
        actuators=(*hexapod.actuators, *drives, *floor, *_offsets(stages, supports, rotor, across)),
        sensors=(
            *hexapod.sensors,
            Metrology("metrology", "ground.sample", "payload.target", "base.centre" if in_rotor else "", encoder),
        ),
    )


def alike_across(stages: Mapping[str, Stage] | None = None) -> dict[str, Stage]:
    """Return the stages with means of the properties along x and y below the spindle, for linear models with rotation.

    Args:
        stages: stages from the floor up (default: `END_STATION`)
    """
    stages = END_STATION if stages is None else stages
    return {name: stage if name == "micro_hexapod" else stage.alike() for name, stage in stages.items()}


def suspension(scene: Scene, highest: float = 150.0) -> list[tuple[float, dict[str, float]]]:
    """Compute the modes below a frequency, with the largest shares of bodies in the kinetic energy first.

    The modes are undamped. The scene must have no loops and a spindle that does not turn. Bodies of struts are summed
    up as "struts".

    Args:
        scene: the end-station
        highest: the frequency [Hz]

    Returns:
        Per mode: frequency [Hz] and shares of bodies in the kinetic energy [-].
    """
    assembly = assemble(replace(scene, loops=()))
    motions = assembly.modal.modes
    found = []
    for frequency, motion in zip(assembly.modal.frequency, motions.T, strict=True):
        if 0 < frequency < highest:
            shares: dict[str, float] = {}
            for name, place in assembly.coordinates.slices.items():
                group = "struts" if name.startswith("strut_") else name
                energy = motion[place] @ scene.body(name).mass_matrix @ motion[place]
                shares[group] = shares.get(group, 0.0) + float(energy)
            total = sum(shares.values())
            ordered = sorted(shares, key=lambda name: -shares[name])
            found.append((float(frequency), {name: shares[name] / total for name in ordered}))
    return sorted(found, key=lambda mode: mode[0])


def _check_points(scene: Scene, *paths: Path) -> None:
    for path in filter(None, paths):
        scene.point_position(path)


def _loose(base: RigidBody) -> RigidBody:
    """Return the base as a free body: a steel disc below F."""
    height = BASE_MASS / (STEEL.density * np.pi * PLATE_RADIUS**2)
    at = np.array([0, 0, -height / 2])
    across, about = BASE_MASS * (PLATE_RADIUS**2 / 4 + height**2 / 12), BASE_MASS * PLATE_RADIUS**2 / 2
    points = {name: place - at for name, place in base.points.items()}
    return RigidBody("base", points, BASE_MASS, np.diag([across, across, about]), at)


def _stage_bodies(stages: Mapping[str, Stage], tilt_centre: Array | None) -> list[RigidBody]:
    """Return the bodies with a point "foot" at their bushing and a point "head" at the next stage's.

    tilt_centre: a point of the axis of the tilt stage, (3,) [m], which splits its body; None: it is locked
    """
    rotor = Stage(
        mass=ROTOR_MASS, size=ROTOR_SIZE, foot=stages["spindle"].foot, centre=ROTOR_CENTRE, stiffness=np.zeros(6)
    )
    order = list(stages.items())
    order.insert(list(stages).index("spindle") + 1, ("rotor", rotor))
    feet = [stage.foot for _, stage in order] + [0.0]
    bodies = [
        RigidBody(
            name,
            {"foot": (0, 0, stage.foot - stage.centre), "head": (0, 0, head - stage.centre)},
            stage.mass,
            stage.inertia,
            (0, 0, stage.centre),
        )
        for (name, stage), head in zip(order, feet[1:], strict=True)
    ]
    if tilt_centre is None:
        return bodies
    place, whole = list(stages).index("tilt"), stages["tilt"]
    return [*bodies[:place], *_tilting(bodies[place], whole, tilt_centre), *bodies[place + 1 :]]


def _tilting(tilt: RigidBody, stage: Stage, centre: Array) -> list[RigidBody]:
    """Return the two bodies of a tilt stage that moves, whose sum is the locked one: guides, and what tilts on them."""
    points = {**tilt.points, "axis": centre - tilt.position}
    shares = {"tilt_guides": GUIDES_SHARE, "tilt": 1 - GUIDES_SHARE}
    return [
        RigidBody(name, points, share * stage.mass, share * stage.inertia, tilt.position)
        for name, share in shares.items()
    ]


def _supports(stages: Mapping[str, Stage]) -> dict[str, tuple[str, str]]:
    """Return the two points that the bushing of each stage connects."""
    below = {"granite": "ground.floor", "micro_hexapod": "rotor.head"}
    names = list(stages)
    return {name: (below.get(name, f"{names[k - 1]}.head"), f"{name}.foot") for k, name in enumerate(names)}


def _bushings(stages: Mapping[str, Stage], supports: Mapping[str, tuple[str, str]]) -> list[Bushing]:
    time = {name: stage.damping_ratio / (np.pi * DAMPING_FREQUENCY) for name, stage in stages.items()}
    return [
        Bushing(name, *ends, stages[name].stiffness, time[name] * stages[name].stiffness)
        for name, ends in supports.items()
    ]


def _offsets(
    stages: Mapping[str, Stage], supports: Mapping[str, tuple[str, str]], of_runout: Path, of_stages: Path
) -> list[Offset]:
    """Return the disturbances; points with whose bodies the axes of runout and stages across z turn, or ""."""
    result = []
    for name, (stage, six) in (ROTOR_DISTURBANCES if of_stages else DISTURBANCES).items():
        a, b = supports[stage]
        stiffness = float(stages[stage].stiffness[SIX.index(six)])
        frame = (of_runout if stage == "spindle" else of_stages) * (six[1] != "z")
        result.append(
            Offset(name=name, a=a, b=b, axis=six[1], input=name, stiffness=stiffness, turns=six[0] == "r", frame=frame)
        )
    return result
