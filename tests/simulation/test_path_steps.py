"""Exact steps along the path of a drive: against floating frames, steps about a steady rotation, and themselves."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from conftest import Given, lattice
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    Simulation,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    VoiceCoil,
    VoltageSensor,
    craig_bampton,
    fixed,
    revolute,
    simulate,
    simulate_motion,
)
from nassim.bodies import PortCoupling
from nassim.bodies.readouts import by_name
from nassim.scene.rotation_measures import RotationAngle
from nassim.scene.terms import Feedthrough, Output, Spring
from nassim.simulation.linear import path_steps
from nassim.simulation.linear.path_changes import path_changes
from nassim.simulation.linear.path_steps import Path, PathRun
from nassim.simulation.loaded import path_comparison, path_knots, path_models
from nassim.simulation.loaded.path_curves import PathSpline, parabola
from nassim.simulation.model.initial_velocities import initial_twists
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.run.checks import check_exact, path_drive
from nassim.systems import PythonController, proportional

TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
ACROSS, OTHER, AXIS = TURN.T
GRAVITY = np.array([0.9, -3.5, -7.7])
CONTROLLER = proportional(5e3, sample_rate=500.0)
STIFFNESS = np.array([1e6, 2e6, 3e6, 3e3, 4e3, 5e3])
BASE_POINTS = {"p": (0, 0, 0), "hub": TURN @ [0, 0, 0.04], "side": TURN @ [0, 0.11, 0.04]}


def stage(*, base=True, even=False, gravity=GRAVITY, sensors=(), **drive):
    """A stage of odd inertia on an axle askew, with a mass on six springs; its base is on six others.

    An even base is equal in all directions across the axle, and soft.
    """
    ground = RigidBody("ground", {"p": (0, 0, 0)}, fixed=True)
    below = RigidBody("base", BASE_POINTS, 20.0, [[0.2, 0.01, 0], [0.01, 0.3, 0], [0, 0, 0.25]])
    centre, top = TURN @ [0.02, 0.05, 0.01], TURN @ [0.02, 0.11, 0.04]
    middle = RigidBody("stage", {"axle": -centre, "top": top - centre}, 5.0,
                       [[0.02, 0.003, 0], [0.003, 0.03, 0.001], [0, 0.001, 0.025]], centre)  # fmt: skip
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 2.0, [[0.004, 5e-4, 0], [5e-4, 0.006, 0], [0, 0, 0.005]], top)
    springs = [Bushing("mount", "stage.top", "mass.c", STIFFNESS, 5e-5 * STIFFNESS, TURN)]
    if even:
        below = replace(below, inertia=0.3 * np.eye(3))
        springs.append(Bushing("foot", "ground.p", "base.p", EVEN, 0.003 * EVEN, TURN))
    elif base:
        springs.append(Bushing("foot", "ground.p", "base.p", 20 * STIFFNESS, 2e-3 * STIFFNESS, TURN))
    low = "base.p" if base else "ground.p"
    angle = Drive("tilt", "axle", "rz", **(drive or {"input": "angle"}))
    push = PointForce("push", "mass.c", tuple(ACROSS), "force", frame="stage.top")
    encoders = [
        Encoder(name, "stage.top", "mass.c", tuple(a), frame="stage.top")
        for name, a in zip("xy", (ACROSS, OTHER), strict=True)
    ]
    if base and not even:
        encoders += [Encoder(name, "ground.p", p, tuple(OTHER)) for name, p in (("far", "mass.c"), ("low", "base.p"))]
    return Scene("stage", (ground, *[below] * base, middle, mass), (revolute("axle", low, "stage.axle", AXIS),),
                 (angle, push), (*encoders, AngleSensor("turn", low, "stage.axle", tuple(AXIS)), *sensors),
                 tuple(springs), damping_ratio=0.0, gravity=gravity)  # fmt: skip


EVEN = np.array([5e5, 5e5, 9e5, 9e3, 9e3, 7e3])


def history(step, angle, force=0.0):
    time = step * np.arange(len(angle))
    return TimeHistory(time, np.vstack([angle, force + 0 * angle]), ("angle", "force"))


def smooth(n):
    """From 0 to 1 with two derivatives that vanish at both ends."""
    x = np.linspace(0, 1, n)
    return 10 * x**3 - 15 * x**4 + 6 * x**5


def along(scene, angle, force=0.0, step=1e-3, **options):
    return simulate(scene, history(step, angle, force), time_step=step, progress=False, method="exact", **options)


ACROSS_BASE = Encoder("runout", "ground.p", "mass.c", tuple(OTHER))
"""It reads an unbalanced rotor across its axle, from the ground."""
TILT = AngleSensor("across", "mass.c", "base.p", tuple(ACROSS))
"""It reads an angle across the axle, which the turn about that changes."""


@pytest.mark.slow
def test_a_soft_base_under_a_rotor_moves_as_about_a_steady_rotation():
    """Weight across the axle, and a base that swings at 20 Hz under three turns a second: after a while both agree.

    Models along the path read the rotor from the ground. Steps about the steady rotation give its motion in the world.
    """
    step, speed, n = 5e-4, 20.0, 1600
    even = TimeHistory(step * np.arange(n + 1), np.zeros((1, n + 1)), ("force",), ("N",))
    late = slice(n - 200, None)
    steady, motion = simulate_motion(stage(even=True, speed=speed), even, time_step=step, progress=False,
                                     method="exact", frames=step * np.arange(n + 1)[late])  # fmt: skip
    found = along(stage(even=True, sensors=(ACROSS_BASE,), input="angle"), speed * step * np.arange(n + 1), step=step)
    for name in "xy":
        assert np.abs(found[name] - steady[name])[late].max() < 5e-3 * np.abs(steady[name]).max(), name
    moved = motion.positions["mass"] @ OTHER - 0.11  # from its place in the reference configuration
    assert np.abs(found["runout"][late] - moved).max() < 1e-4 * np.ptp(moved)


@pytest.mark.parametrize("base", [True, False])
def test_floating_frames_tell_of_a_rotor_that_starts_without_its_whirl(capsys, base):
    """On a base that moves, not on the ground, where the rotor starts in equilibrium under centrifugal forces.

    The mass on springs turns with the stage, and the base stands still.
    """
    none = TimeHistory(1e-4 * np.arange(2), np.zeros((1, 2)), ("force",), ("N",))
    scene, away = stage(base=base, gravity=0 * AXIS, speed=20.0), TURN @ [0.0, 0.02, 0.01]
    *others, mass = scene.bodies
    mass = replace(mass, points={"c": -away}, position=mass.position + away)  # its centre is farther out than its point
    scene = replace(scene, bodies=(*others, mass))
    for name, twist in initial_twists(scene).items():
        np.testing.assert_allclose(twist, np.zeros(6) if name == "base" else [0, 0, 0, *(20.0 * AXIS)], atol=1e-12)
    simulate(scene, none, time_step=1e-4, progress=False)
    told = " ".join(capsys.readouterr().out.split())
    assert ("'axle' moves is no steady rotation against the ground" in told) == base
    pulled = 20.0**2 * np.linalg.norm(np.cross(AXIS, mass.position))
    assert (f"up to {pulled:.3g} m/s2 at points of the bodies" in told) == base


def test_what_changes_as_the_rotor_turns_is_refused_with_the_methods_that_can():
    """From the ground, an unbalanced rotor is no model that is constant in either frame; along a path it is read."""
    even = TimeHistory(1e-3 * np.arange(9), np.zeros((1, 9)), ("force",), ("N",))
    with pytest.raises(ValueError, match=r"output 'runout'.*body 'stage'.*let the drive follow an input.*or take gene"):
        simulate(stage(even=True, sensors=(ACROSS_BASE,), speed=20.0), even, time_step=1e-3, method="exact")


def test_a_tilt_moves_as_by_floating_frames(monkeypatch, capsys):
    """The base bends under the stage's inertia and weight; outputs, and positions and rotations of all bodies.

    Models are five times as close as usual, for the error falls with their distance. Floating frames take a third of
    the step.
    """
    monkeypatch.setattr(path_models, "LARGEST_CHANGE", 0.004)
    step, samples, thirds = 5e-4, np.arange(81), np.arange(241) / 3
    angle, force = 0.3 * smooth(81), 3 * np.sin(0.15 * samples) * smooth(81)
    between = CubicSpline(samples, angle)(thirds), np.interp(thirds, samples, force)
    (exact, moved), (other, expected) = (
        simulate_motion(
            stage(sensors=(TILT,)), history(h, *given), time_step=h, frames=5, method=method, progress=False
        )
        for method, h, given in (("exact", step, (angle, force)), ("generalized_alpha", step / 3, between))
    )
    told = " ".join(capsys.readouterr().out.split())
    assert "from one to the next, between 17 angles, from which they are" in told
    between_angles = 0.3 / 16 / float(told.split("models ")[1].split()[0])  # so many models from angle to angle
    assert between_angles > 5
    assert between_angles == pytest.approx(round(between_angles), rel=1e-3)
    for name in ("x", "y", "far"):
        assert np.abs(exact[name] - other[name][::3]).max() < 0.003 * np.ptp(other["x"]), name
    assert np.abs(exact["across"] - other["across"][::3]).max() < 0.01 * np.ptp(other["across"])
    assert np.abs(exact["low"] - other["low"][::3]).max() < 0.01 * np.ptp(other["low"])
    assert exact["turn"] == pytest.approx(angle, abs=1e-9)
    for name, share in (("base", 5e-3), ("stage", 1e-4), ("mass", 1e-4)):
        way = np.linalg.norm(np.ptp(expected.positions[name], axis=0))
        assert np.abs(moved.positions[name] - expected.positions[name]).max() < share * way, name
        apart = Rotation.from_matrix(moved.rotations[name].swapaxes(1, 2) @ expected.rotations[name]).magnitude()
        assert apart.max() < 1e-4, name
    assert np.array_equal(moved.positions["ground"], expected.positions["ground"])


MASS, BEARING, WEIGHT = 3.0, 2e6, 9.81
"""Of a shaft [kg], in its bearings [N/m], and the acceleration across it [m/s2]."""


def shaft(resistances, offset=0.0, weight=WEIGHT):
    """A shaft in two bearings on the ground, with films across it and its centre of mass beside its axis."""
    places = {"seat": 0 * AXIS, "low": -0.1 * AXIS, "high": 0.1 * AXIS}
    ground = RigidBody("ground", places, fixed=True)
    rotor = RigidBody("rotor", {name: place - offset * ACROSS for name, place in places.items()}, MASS,
                      0.01 * np.eye(3), offset * ACROSS)  # fmt: skip
    bearings = [Bushing(name, f"ground.{name}", f"rotor.{name}", BEARING / 2 * np.array([1, 1, 1, 0, 0, 0]), axes=TURN)
                for name in ("low", "high")]  # fmt: skip
    films = [SpringDamper(f"film_{k}", "ground.seat", "rotor.seat", tuple(axis), damping=c)
             for k, (axis, c) in enumerate(zip((ACROSS, OTHER), resistances, strict=True))]  # fmt: skip
    free = Joint("axle", "ground.seat", "rotor.seat", ("x", "y", "z", "rx", "ry", "rz"), TURN)
    sensors = [Encoder(name, "ground.seat", "rotor.seat", tuple(a)) for name, a in (("low", OTHER), ("wide", ACROSS))]
    return Scene("shaft", (ground, rotor), (free,), (Drive("motor", "axle", "rz", input="angle"),), sensors,
                 (*bearings, *films), damping_ratio=0.0, gravity=-weight * OTHER)  # fmt: skip


def turning(angle, step):
    return TimeHistory(step * np.arange(len(angle)), angle[None], ("angle",), ("rad",))


def test_dampers_on_the_stator_leave_a_shaft_at_rest_where_its_weight_puts_it():
    """Rows of a damper turn in the axes of the shaft: what hangs still in the world moves there, without resistance."""
    step = 5e-4
    record = simulate(shaft((2e3, 4e3)), turning(30.0 * step * np.arange(81), step), time_step=step, method="exact",
                      progress=False)  # fmt: skip
    sag, late = MASS * WEIGHT / BEARING, record.after(0.03)
    assert np.abs(late["low"] + sag).max() < 1e-3 * sag
    assert np.abs(late["wide"]).max() < 1e-3 * sag


@pytest.mark.parametrize(("method", "share"), [("exact", 0.002), ("generalized_alpha", 0.002)])
def test_an_unbalanced_shaft_whirls_as_in_closed_form_from_the_start_in_long_steps(method, share):
    """A step passes four models, and to half turns exactly; shares are of the motion about the static displacement."""
    speed, offset, resistance = 1.5 * np.sqrt(BEARING / MASS), 1e-6, 2e3
    step, n = np.pi / 40 / speed, 60
    record = simulate(shaft((resistance, resistance), offset, 0.0), turning(np.pi / 40 * np.arange(n), step),
                      time_step=step, method=method, progress=False)  # fmt: skip
    pull = MASS * speed**2
    static = offset * pull / BEARING
    whirl = static * BEARING / (BEARING - pull + 1j * speed * resistance) * np.exp(1j * record["angle"])
    for name, expected in (("wide", whirl.real), ("low", whirl.imag)):
        assert np.abs(record[name] - expected).max() < share * np.abs(whirl - static).max(), name


HELD, TURNED, SOFT = 4e6, np.array([6e6, 1e6]), np.array([3e4, 5e4])
"""Of a mass of 1.5 kg on the ground, by a bushing on a rotor, of one of 0.8 kg on that [N/m]."""
FORCED = np.array([0, 0, 0, 0, 0, 1 / 1.5, 1 / 0.8, 0])
"""Accelerations by a unit of the force."""


def on_a_turned_spring():
    """A mass that a rotor holds by a bushing, whose axes turn with it; another mass on that."""
    bodies = [RigidBody(name, {"c": (0, 0, 0)}, mass, 0.01 * np.eye(3))
              for name, mass in (("rotor", 1.0), ("low", 1.5), ("high", 0.8))]  # fmt: skip
    springs = [Bushing("foot", "ground.c", "low.c", [HELD] * 3 + [1e4] * 3, axes=TURN),
               Bushing("key", "rotor.c", "low.c", [*TURNED, 0, 0, 0, 0], axes=TURN),
               Bushing("soft", "low.c", "high.c", [*SOFT, 1e5, 1e3, 1e3, 1e3], axes=TURN)]  # fmt: skip
    return Scene("turned spring", (RigidBody("ground", {"c": (0, 0, 0)}, fixed=True), *bodies),
                 (revolute("axle", "ground.c", "rotor.c", AXIS),),
                 (Drive("motor", "axle", "rz", input="angle"), PointForce("push", "high.c", tuple(ACROSS), "force"),
                  PointForce("beside", "low.c", tuple(OTHER), "force")),
                 [Encoder(name, "ground.c", "low.c", tuple(a)) for name, a in (("x", ACROSS), ("y", OTHER))],
                 springs, damping_ratio=0.0)  # fmt: skip


def test_modes_follow_a_stiffness_that_turns_without_ringing():
    """Two modes at 260 and 410 Hz under forces of 35 Hz on them and on slower ones, in models 0.03 rad apart."""
    time = 5e-4 * np.arange(201)
    angle, force = 0.15 * smooth(201), 3 * np.sin(70 * np.pi * time) * smooth(201)
    spline = CubicSpline(time, angle)

    def rates(now, state):
        (low, high), turn = state[:4].reshape(2, 2), spline(now)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        pull = SOFT * (high - low)
        on_low = pull - HELD * low - axes @ (TURNED * (axes.T @ low))
        own = np.concatenate([state[4:], on_low / 1.5, -pull / 0.8])
        return own + np.interp(now, time, force) * FORCED

    expected = solve_ivp(rates, time[[0, -1]], np.zeros(8), t_eval=time, method="DOP853", rtol=1e-6,
                         atol=1e-9, max_step=5e-4).y  # fmt: skip
    found = along(on_a_turned_spring(), angle, force, step=5e-4)
    for name, row, share in (("x", 0, 5e-4), ("y", 1, 1.5e-3)):
        assert np.abs(found[name] - expected[row]).max() < share * np.ptp(expected[row]), name


def test_a_damper_on_a_rotor_turns_with_it_on_a_base_that_moves():
    """A mass on a rotor; their damper resists what moves in the rotor's axes, where the base's motion turns back."""
    time, feet, mount, resistance = 5e-4 * np.arange(81), np.array([3e4, 5e4]), 4e4, 60.0
    angle, force = 0.7 * smooth(81), 3 * np.sin(70 * np.pi * time)
    bodies = [RigidBody(name, {"c": (0, 0, 0)}, mass, 0.01 * np.eye(3))
              for name, mass in (("base", 0.7), ("rotor", 1.0), ("mass", 0.8))]  # fmt: skip
    held, damped = [mount] * 3 + [1e3] * 3, [resistance] * 3 + [0] * 3
    springs = [Bushing("foot", "ground.c", "base.c", [*feet, 1e6, 1e4, 1e4, 1e4], axes=TURN),
               Bushing("mount", "rotor.c", "mass.c", held, damped, TURN)]  # fmt: skip
    scene = Scene("damped rotor", (RigidBody("ground", {"c": (0, 0, 0)}, fixed=True), *bodies),
                  (revolute("axle", "base.c", "rotor.c", AXIS),),
                  (Drive("motor", "axle", "rz", input="angle"), PointForce("push", "base.c", tuple(ACROSS), "force")),
                  [Encoder(name, "ground.c", "base.c", tuple(a)) for name, a in (("x", ACROSS), ("y", OTHER))],
                  springs, damping_ratio=0.0)  # fmt: skip
    speed = CubicSpline(time, angle).derivative()

    def rates(now, state):
        low, high, low_rate, high_rate = state.reshape(4, 2)
        apart, turned = high - low, speed(now) * np.array([low[1] - high[1], high[0] - low[0]])
        pull = mount * apart + resistance * (high_rate - low_rate - turned)
        on_low = pull - feet * low + [np.interp(now, time, force), 0.0]
        return np.concatenate([low_rate, high_rate, on_low / 1.7, -pull / 0.8])

    expected = solve_ivp(rates, time[[0, -1]], np.zeros(8), "DOP853", time, rtol=1e-5, atol=1e-9, max_step=5e-4).y
    found = along(scene, angle, force, step=5e-4)
    for name, row in (("x", 0), ("y", 1)):
        assert np.abs(found[name] - expected[row]).max() < 0.02 * np.ptp(expected[row]), name


def test_an_even_turn_is_that_of_a_constant_speed():
    """A rotor on the ground under gravity along its axis, closed by a loop: one model, whose speed is rounded.

    Centrifugal forces stretch a tie, which then resists motions across it.
    """
    step, speed, n = 1e-3, 30.0, 250
    loop = Loop("hold", CONTROLLER, "x", "force")
    tie = SpringDamper("tie", "stage.axle", "mass.c", "line", 5e5)
    stages = [stage(base=False, gravity=4 * AXIS, **drive) for drive in ({"speed": speed}, {"input": "angle"})]
    scenes = [replace(scene, loops=(loop,), springs=(*scene.springs, tie)) for scene in stages]
    even = TimeHistory(step * np.arange(n + 1), np.zeros((0, n + 1)), (), ())
    steady = simulate(scenes[0], even, time_step=step, progress=False, method="exact")
    found = along(scenes[1], speed * step * np.arange(n + 1))
    for name in scenes[0].outputs:
        assert found[name] == pytest.approx(steady[name], rel=2e-5, abs=1e-12), name
    assert np.ptp(found["x"]) > 0


class _Law:
    def output(self, measured, time):
        return 0.0 * measured


RADIAL = SpringDamper("tie", "base.hub", "stage.top", tuple(TURN @ [0.02, 0.11, 0]), 1e4)
"""It resists no rotation at the start."""
TANGENT = replace(RADIAL, a="base.side", axis="line")


SPINDLE = revolute("more", "stage.top", "mass.c", AXIS)


@dataclass(frozen=True)
class Pull(Spring):
    """A linear law that pulls where it is drawn."""

    def resistance(self, value, rate):
        return super().resistance(value, rate) + 1.0


class Pulling(SpringDamper):
    """A spring with such a law."""

    def terms(self, scene):
        (law,) = super().terms(scene)
        return (Pull(law.measure, law.stiffness, law.damping),)


def driven_by(scene, actuator):
    """The scene with another actuator for its second input."""
    return replace(scene, actuators=(scene.actuators[0], actuator))


def mast():
    """A mast m g l = 1.96 N m on a turntable, both on hinges of 3 N m/rad: about x below the table, about y above it.

    The hinges together have the compliance (1 + sin angle) / 3 about one axis: it falls from asin(3 / m g l - 1) on,
    0.56 rad.
    """
    middle = {"p": (0, 0, 0)}
    ground = RigidBody("ground", middle, fixed=True)
    base, stage = (RigidBody(name, middle, 0.2, 1e-3 * np.eye(3)) for name in ("base", "stage"))
    post = RigidBody("post", {"p": (0, 0, -0.1)}, 2.0, 1e-3 * np.eye(3), (0, 0, 0.1))
    hinges = (
        Bushing(name, a, b, (1e6, 1e6, 1e6, *turns))
        for name, a, b, turns in (
            ("foot", "ground.p", "base.p", (3.0, 1e3, 1e3)),
            ("head", "stage.p", "post.p", (1e3, 3.0, 1e3)),
        )
    )
    return Scene(
        "mast",
        (ground, base, stage, post),
        (revolute("axle", "base.p", "stage.p"),),
        (Drive("tilt", "axle", "rz", "angle"), PointForce("push", "post.p", "z", "force")),
        (Encoder("x", "base.p", "post.p"),),
        tuple(hinges),
        gravity=(0, 0, -9.81),
    )


def rail():
    """A slider on a turntable, which a guide on the ground stops until the rail is across the guide."""
    ground = RigidBody("ground", {"p": (0, 0, 0)}, fixed=True)
    stage, slider, mass = (RigidBody(name, {"p": (0, 0, 0)}, 1.0, np.eye(3)) for name in ("stage", "slider", "mass"))
    joints = (
        revolute("axle", "ground.p", "stage.p"),
        Joint("rail", "stage.p", "slider.p", free=("x",)),
        Joint("guide", "ground.p", "slider.p", free=("y", "z", "rx", "ry", "rz")),
    )
    return Scene(
        "rail",
        (ground, stage, slider, mass),
        joints,
        (Drive("tilt", "axle", "rz", "angle"), PointForce("push", "mass.p", "z", "force")),
        (Encoder("x", "stage.p", "mass.p"),),
        (Bushing("mount", "stage.p", "mass.p", STIFFNESS),),
    )


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda s: replace(s, springs=(*s.springs, TANGENT)), "no such tie on the other"),
        (lambda s: replace(s, springs=(*s.springs, RADIAL)), "at 0.*resists the motion of the drive"),
        (lambda s: stage(sensors=(Vibrometer("v", "mass.c", "x"),)), "output 'v' reads a velocity"),
        (lambda s: replace(stage(input="angle", bandwidth=20.0), loops=(Loop("hold", CONTROLLER, "x", "angle"),)),
         "a loop drives 'angle', so its path is not known"),
        (lambda s: replace(s, loops=(Loop("own", PythonController(_Law(), sample_rate=100.0), "x", "force"),)),
         "need linear controllers"),
        (lambda s: stage(input="angle", bandwidth=20.0), "through a servo"),
        (lambda s: replace(s, springs=(*s.springs, Pulling("pull", "ground.p", "base.p", "x", 1e4))),
         "preloaded springs"),
        (lambda s: replace(s, springs=s.springs[1:]), "at 0.* rad of the path .*has a motion that nothing holds"),
        (lambda s: driven_by(s, VoiceCoil("coil", "stage.top", "mass.c", tuple(AXIS), 3.0, 2.0, 1e-3, "force")),
         "has the coil 'coil', whose current is not modelled"),
        (lambda s: stage(sensors=(Accelerometer("a", "base.p"),)), "output 'a' reads an acceleration"),
        (lambda s: replace(s, joints=(*s.joints, SPINDLE), springs=s.springs[1:],
                           actuators=(*s.actuators, Drive("spin", "more", "rz", speed=1.0))),
         r"several turn joints \(angle, constant speed of more\)"),
        (lambda s: replace(s, joints=(*s.joints, fixed("l", "ground.p", "base.p"), fixed("h", "stage.top", "mass.c"))),
         "nothing moves in scene 'stage'"),
        (lambda s: stage(gravity=3e4 * ACROSS), "under its loads, body 'mass' .* which is no small motion"),
        (lambda s: mast(), r"at 0\.589 rad of the path .* unstable under its loads"),
        (lambda s: rail(), r"at 1\.571 rad of the path .* singular position"),
    ],
)  # fmt: skip
def test_what_a_path_cannot_have_is_refused_before_the_run(change, reason):
    with pytest.raises(ValueError, match=reason):
        along(change(stage()), np.pi / 2 * smooth(61))


def test_an_angle_across_the_axis_of_a_path_is_read_up_to_half_a_turn():
    with pytest.raises(ValueError, match="output 'across' reads an angle across the axis of the drive"):
        along(stage(sensors=(TILT,)), -3.15 * smooth(61))


def test_an_angle_in_another_unit_is_read_beyond_half_a_turn():
    geared = Output("geared", "", RotationAngle("stage.axle", 2.5 * AXIS, "ground.p"))
    scene = stage(base=False)
    record = along(replace(scene, springs=(*scene.springs, Given("gear", (geared,)))), 3.4 * smooth(61))
    np.testing.assert_allclose(record["geared"], 2.5 * record["turn"], rtol=0, atol=1e-6)
    assert record["turn"][-1] > 3.3


@pytest.mark.parametrize("component", ["rx", "ry"])
def test_a_hinge_turns_a_quarter_about_any_of_its_axes(component):
    """Its drive is that of the axis z of another one."""
    scene, angle = stage(base=False), np.pi / 2 * smooth(61)
    drive, push = scene.actuators
    axes = np.roll(TURN, 1 + "xyz".index(component[1]), axis=1)
    turned = replace(
        scene,
        joints=(Joint("axle", "ground.p", "stage.axle", (component,), axes),),
        actuators=(replace(drive, direction=component), push),
    )
    expected, found = along(scene, angle), along(turned, angle)
    for name in "xy":
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=1e-3 * np.ptp(expected[name]))


def test_a_force_of_a_damper_across_a_path_is_refused_and_that_of_a_spring_is_read():
    """The damper's force contains the speed of the path."""
    whole = shaft((30.0, 40.0))
    angle = turning(3.0 * smooth(61), 1e-3)
    with pytest.raises(ValueError, match="output 'pull' reads the force of a damper"):
        simulate(replace(whole, sensors=(ForceSensor("pull", "film_1"),)), angle, time_step=1e-3, method="exact")
    read = replace(whole, sensors=(ForceSensor("pull", "low"),))
    found = simulate(read, angle, time_step=1e-3, method="exact", progress=False)
    assert np.hypot(found["pull.fx"], found["pull.fy"]) == pytest.approx(0.5 * MASS * WEIGHT, rel=1e-4)


def test_a_scene_that_changes_too_fast_along_a_path_is_refused(monkeypatch):
    """Between up to twice as many angles each time. The drive holds the rate of its angle at all of them alike."""
    tried, found, compare, scene = [], [], path_models.path_differences, stage()
    post = RigidBody("post", {"p": (0, 0, 0)}, 1.0, np.eye(3))
    scene = replace(scene, bodies=(*scene.bodies, post), joints=(fixed("held", "base.p", "post.p"), *scene.joints))

    def compared(knots, *rest, **options):
        tried.append(len(knots) - 1)
        places = [knot.assembly.coordinates for knot in knots]
        assert {place.joint.name for place in places} == {"axle"}
        held = [place.jacobian(place.joint.measure)[5] for place in places]
        np.testing.assert_allclose(np.linalg.norm(held, axis=1), np.sqrt(2), rtol=1e-9)
        found.append(compare(knots, *rest, **options))
        return found[-1]

    monkeypatch.setattr(path_models, "LARGEST_ERROR", 0.0)
    monkeypatch.setattr(path_models, "FEWEST", 4)
    monkeypatch.setattr(path_models, "MOST", 16)
    monkeypatch.setattr(path_models, "path_differences", compared)
    with pytest.raises(ValueError, match="fast along the path of its drive: between 16 angles") as told:
        along(scene, 0.5 * smooth(21))
    assert f"are up to {100 * found[-1].error:.2g} % wrong" in str(told.value)
    assert tried == [8, 16]


def test_models_along_a_path_are_compared_by_their_transfer_functions():
    """C (K + s D + s^2)^-1 B, with a damping ratio of 5 % beside D, by the square root of K."""
    random, points = np.random.default_rng(3), np.array([0.2 + 3j, 1j, -0.5 + 0.3j])
    root, damping = random.standard_normal((2, 4, 4))
    stiffness, damping = root @ root.T, 0.1 * damping @ damping.T
    read, given = random.standard_normal((2, 4)), random.standard_normal((4, 3))
    found, _ = path_comparison._transfer((stiffness, damping, read, given), points)
    damping = damping + 2 * 0.05 * scipy.linalg.sqrtm(stiffness)
    for s, matrix in zip(points, found, strict=True):
        expected = read @ np.linalg.solve(stiffness + s * damping + s**2 * np.eye(4), given)
        np.testing.assert_allclose(matrix, expected, rtol=1e-9)


def test_a_whole_turn_may_begin_anywhere(monkeypatch):
    """Models around it differ as much from whichever one the comparison begins, over the end of the turn too."""

    class Compared(Exception):
        """The arguments of a comparison."""

    def stop(*given, **_):
        raise Compared(*given)

    monkeypatch.setattr(path_models, "path_differences", stop)
    monkeypatch.setattr(path_models, "FEWEST", 4)
    monkeypatch.setattr(path_comparison, "COMPARED", 4)
    monkeypatch.setattr(path_comparison, "ASKEW", 0.0)  # the further model is then the first one
    with pytest.raises(Compared) as caught:
        along(stage(), 2 * np.pi * smooth(61))
    knots, _, loads, points = caught.value.args
    turns = [(*knots[k:], *knots[:k]) for k in range(len(knots))]
    found = [path_comparison.path_differences(turn, turn[0], loads, points, closed=True) for turn in turns]
    assert len(found) == 8
    np.testing.assert_allclose([one.tilt for one in found], found[0].tilt, rtol=1e-6)
    differences = np.array([(one.change, one.error) for one in found])
    for every_other in (differences[::2], differences[1::2]):
        np.testing.assert_allclose(every_other, every_other[[0] * 4], rtol=1e-6)
    # A scene may be the same at all of these angles, and another one at the further model.
    same, other = (path_comparison.path_differences(knots[:1] * 8, k, loads, points, closed=True) for k in knots[:2])
    assert same.change < 1e-9
    assert other.change == other.error > 0.1 * found[0].change


@pytest.mark.parametrize("order", [1, 2, 3])
def test_between_changes_of_the_model_no_course_passes_more_than_one(order):
    """Even speed, acceleration and jerk: the angle, the speed and the acceleration each limit the block in turn."""
    start = SimpleNamespace(scene=SimpleNamespace(loops=()))
    knot = SimpleNamespace(assembly=SimpleNamespace(modal=SimpleNamespace(frequency=np.array([10.0]))))
    models = SimpleNamespace(is_one=False, distance=0.1, knots=(knot,), start=start)
    angle = (200.0, 150.0, 3e3)[order - 1] * (1e-4 * np.arange(50)) ** order
    run = PathRun(models, angle, 1e-4, hold_order=1, released=False)
    limits = 0.1, 0.002 * 20 * np.pi, 0.002 * (20 * np.pi) ** 2
    courses = run.path.angle, run.path.speed, run.path.acceleration

    def passed(samples):
        return [np.abs(c[samples:] - c[:-samples]).max() / most for c, most in zip(courses, limits, strict=True)]

    assert max(passed(run._block)) < 1 < max(passed(2 * run._block))
    assert np.argmax(passed(run._block)) == order - 1


@pytest.mark.parametrize("n", [2, 3])
def test_a_path_of_few_samples_is_a_line_or_a_parabola(n):
    time = 0.5 * np.arange(n)
    path = Path.of((3 * time + (n - 2) * time**2), 0.5)
    np.testing.assert_allclose(path.speed, 3 + 2 * (n - 2) * time)
    np.testing.assert_allclose(path.acceleration, 2.0 * (n - 2), atol=1e-12)


@pytest.fixture(scope="module")
def short():
    """A closed loop on a tilting stage over a few models: the scene, its inputs, and the outputs of its run."""
    scene = replace(stage(), loops=(Loop("hold", CONTROLLER, "x", "force"),))
    record = history(1e-3, 0.2 * smooth(31), 2 * np.sin(0.2 * np.arange(31)))
    return scene, record, simulate(scene, record, time_step=1e-3, progress=False, method="exact")


def test_steps_along_a_path_one_by_one_are_those_of_a_whole_run(short):
    """To the last bit, from a saved state on too; the drive's input is the path, and no step goes beyond that."""
    scene, record, whole = short
    path = TimeHistory(record.time, record.values[:1], ("angle",), ("rad",))
    options = {"time_step": 1e-3, "method": "exact", "path": path}
    with Simulation(scene, **options) as run, Simulation(scene, **options) as second:
        for k in range(1, 31):
            outputs = run.step({"force": record["force"][k]})
            assert outputs == {name: whole[name][k] for name in outputs}, k
            if k == 20:
                kept = run.state
        assert np.array_equal(run.record["angle"], record["angle"])
        with pytest.raises(ValueError, match=r"the path of input 'angle' ends at 0\.03 s"):
            run.step()
        run.restore(kept)
        second.restore(kept)
        for k in range(21, 31):  # by turns, from one state
            outputs = run.step({"force": record["force"][k]})
            assert outputs == {name: whole[name][k] for name in outputs}, k
            second.step({"force": -3.0})
        with pytest.raises(ValueError, match="'angle' follows the path"):
            run.step({"angle": 0.1})
    other = TimeHistory(record.time, 1.1 * record.values[:1], ("angle",), ("rad",))
    beside = pytest.raises(ValueError, match="the state is of a run along another path")
    with Simulation(scene, time_step=1e-3, method="exact", path=other) as run, beside:
        run.restore(kept)


def test_models_that_memory_does_not_hold_are_made_again(monkeypatch):
    """On the way back, with the same numbers to the last digit."""
    records, kept, make = [], [], PathRun._make
    monkeypatch.setattr(PathRun, "_make", lambda run, key: kept.append(len(run._made)) or make(run, key))
    for memory in (path_steps.MEMORY, 0):
        kept.clear()
        monkeypatch.setattr(path_steps, "MEMORY", memory)
        records.append(along(stage(base=False), 0.11 * np.append(smooth(12), smooth(12)[::-1]), 0.3).values)
        assert (max(kept) > 2) == bool(memory)
    np.testing.assert_array_equal(*records)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"method": "generalized_alpha"}, "takes every input step by step"),
        ({"record": history(1e-3, 0.5 * smooth(21))}, "the signal of one input"),
    ],
)
def test_paths_that_single_steps_cannot_follow(options, reason):
    record = TimeHistory(1e-3 * np.arange(21), 0.5 * smooth(21)[None], ("angle",), ("rad",))
    given = {"method": "exact", "record": record} | options
    with pytest.raises(ValueError, match=reason):
        Simulation(stage(), time_step=1e-3, method=given["method"], path=given["record"])


def test_single_steps_refuse_a_drive_that_turns_far_without_its_path():
    """Either way, and the run can go on; Exudyn's steps take it."""
    with Simulation(stage(), time_step=1e-3, method="exact") as run:
        run.step({"angle": 1e-3})
        for angle in (0.11, -0.11):
            with pytest.raises(ValueError, match=rf"input 'angle' would turn joint 'axle' by {angle} rad.*path="):
                run.step({"angle": angle})
        run.step({"angle": 2e-3})
        assert run.time == 2e-3
        assert run.record["angle"].tolist() == [0.0, 1e-3, 2e-3]
    with Simulation(stage(), time_step=1e-3) as run:
        run.step({"angle": 0.11})


@dataclass(frozen=True)
class SlowForce(PointForce):
    """A force through an amplifier."""

    def terms(self, scene):
        return tuple(replace(term, bandwidth=40.0) for term in super().terms(scene))


@pytest.fixture(scope="module")
def on_a_bar():
    """A function of a sensor of the port of a bar, which carries the stage and bends under it."""
    plain = craig_bampton(lattice(stiffness=1e7), n_modes=2, progress=False)
    forces = np.zeros(len(plain.mass_matrix))
    forces[6], forces[0], forces[12:] = 300.0, -300.0, [20.0, -10.0]
    body = replace(plain, readouts=by_name([PortCoupling("v", forces, 1e-3)]))
    bar = FlexibleBody("bar", body, -TURN @ body.point("right").position, TURN)

    def make(*sensors, push=PointForce, **options):
        scene = stage(base=False, **options)
        ground = RigidBody("ground", {"p": (0, 0, 0), "foot": bar.point_position("left")}, fixed=True)
        low = Encoder("low", "ground.p", "bar.right", tuple(OTHER))
        force = push("push", "mass.c", tuple(ACROSS), "force", frame="stage.top")
        joints = (fixed("foot", "ground.foot", "bar.left"), revolute("axle", "bar.right", "stage.axle", AXIS))
        return replace(scene, bodies=(ground, bar, *scene.bodies[1:]), joints=joints,
                       actuators=(scene.actuators[0], force), sensors=(*scene.sensors[:2], low, *sensors))  # fmt: skip

    return make


@pytest.mark.parametrize(("resistance", "gravity"), [(1e-3, GRAVITY), (1e9, np.zeros(3))], ids=["short", "open"])
def test_a_port_with_a_resistance_is_shorted_or_open_at_the_ends_of_its_range(
    monkeypatch, on_a_bar, resistance, gravity
):
    """Along a path, with a constant force through an amplifier. The charge of a short one has left at the start."""
    monkeypatch.setattr(path_models, "FEWEST", 4)
    short = resistance < 1
    angle = 0.15 * smooth(41 if short else 61)
    leaky = on_a_bar(VoltageSensor("v", "bar.v", resistance, 1e-3, -2.5), push=SlowForce, gravity=gravity)
    other = on_a_bar(*[] if short else [VoltageSensor("v", "bar.v", capacitance=1e-3)], gravity=gravity)
    found, expected = (along(scene, angle, constant_inputs={"force": 5.0 * short}) for scene in (leaky, other))
    for name in ("x", "y", "low", *["v"] * (not short)):
        gained = expected[name] * (-2.5 if name == "v" else 1.0)
        assert np.abs(found[name] - gained).max() < 0.01 * np.ptp(gained), name


@dataclass(frozen=True)
class Sum(Encoder):
    """An encoder to whose output a force adds at once and behind an amplifier."""

    def terms(self, scene):
        return (*super().terms(scene), Feedthrough("sum", "force", 2e-4), Feedthrough("sum", "force", -5e-5, 40.0))


def test_drives_beside_that_of_a_path_keep_their_servos_and_effects():
    """Those of three drives in another order, the one without a servo left out."""
    random = np.random.default_rng(5)
    matrices = [random.standard_normal((n, 3)) for n in (6, 4, 4, 6)]
    found = PrescribedMotions((4, 1, 3), (np.inf, 5.0, 7.0), *matrices).chosen([2, 1])
    assert found.inputs == (3, 1)
    assert found.rates == (7.0, 5.0)
    for own, whole in zip((found.motion, found.momentum, found.damping, found.residual), matrices, strict=True):
        np.testing.assert_array_equal(own, whole[:, [2, 1]])


def test_constant_inputs_and_others_add_to_outputs_along_a_path(monkeypatch):
    """What adds behind an amplifier is its response to the excitation, and all of a constant input from the start."""
    monkeypatch.setattr(path_models, "FEWEST", 4)
    step, force = 1e-3, 3 * np.sin(0.2 * np.arange(41))
    added = Sum("sum", "stage.top", "mass.c", tuple(ACROSS), frame="stage.top")
    scene = stage(base=False, sensors=(added,))
    found = along(scene, 0.15 * smooth(41), force, step, constant_inputs={"force": 5.0})
    slow = scipy.signal.lsim(([1.0], [1 / (2 * np.pi * 40), 1.0]), force, step * np.arange(41))[1]
    expected = 2e-4 * (5 + force) - 5e-5 * (5 + slow)
    np.testing.assert_allclose(found["sum"] - found["x"], expected, atol=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_path_turns_far_in_either_direction(sign):
    for share, found in ((0.9, None), (1.1, 0)):
        angle = sign * share * 0.1 * smooth(21)
        assert path_drive(stage(), {"angle": angle, "force": 0 * angle}) == found


def test_a_path_of_nanoradians_moves_a_bar_as_one_of_milliradians_does(on_a_bar):
    """In proportion: the models of a narrow path are no nearer to each other than rounding lets them be."""
    tiny, small = (along(on_a_bar(), size * smooth(81)) for size in (1e-9, 1e-3))
    for name in ("x", "y", "low"):
        moved = 1e6 * (tiny[name] - tiny[name][0])
        np.testing.assert_allclose(moved, small[name] - small[name][0], atol=0.02 * np.ptp(small[name]))


@pytest.mark.parametrize("moved", [0, 1])
def test_a_drive_at_rest_turns_no_floating_body(moved):
    """Beside another: one that turns a little has a path of its own, and two are one too many.

    Beside a drive of constant speed, a little turn is small motion about the rotation.
    """
    body = craig_bampton(lattice(), n_modes=0, progress=False)
    hand = FlexibleBody("hand", body, fidelity="ffrf")
    at = body.point("left").position
    ground = RigidBody("ground", {"p": at}, fixed=True)
    arm = RigidBody("arm", {"p": at}, 1.0, 1e-3 * np.eye(3))
    axles = revolute("low", "ground.p", "arm.p", "z"), revolute("high", "arm.p", "hand.left", "x")
    drives = Drive("one", "low", input="0"), Drive("two", "high", input="1")
    scene = Scene("two axles", (ground, arm, hand), axles, drives)
    little, none = 0.01 * smooth(21), np.zeros(21)
    assert path_drive(scene, {"0": none, "1": none}) is None
    assert path_drive(scene, {f"{moved}": little, f"{1 - moved}": none}) == moved
    with pytest.raises(ValueError, match="path of one drive, and several turn joints"):
        path_drive(scene, {"0": little, "1": little})
    servos = replace(scene, actuators=[replace(drive, bandwidth=50.0) for drive in drives])
    assert path_drive(servos, {"0": little, "1": little}) is None  # refused as any floating body
    spinning = replace(scene, actuators=(drives[moved], Drive("spin", ("high", "low")[moved], speed=3.0)))
    assert path_drive(spinning, {f"{moved}": little}) is None
    turned = replace(scene, bodies=(ground, replace(arm, angular_velocity=(0, 0, 1.0)), hand))
    with pytest.raises(ValueError, match="body 'arm' spins without a drive of constant speed"):  # the bar may float
        check_exact(turned, {f"{moved}": little, f"{1 - moved}": none})


@pytest.mark.parametrize("closed", [True, False])
def test_functions_of_the_angle_repeat_on_a_closed_path_only(closed):
    """Waves of the angle and their derivatives, from values at even angles; parabolas between three of these."""
    n = 96
    angles = 0.3 + 2 * np.pi / n * np.arange(n)
    spline = PathSpline.of(angles, np.column_stack([np.cos(2 * angles), np.sin(angles)]), closed=closed)
    asked = np.linspace(-30.0, 30.0, 400) if closed else np.linspace(angles[0], angles[-1], 400)
    for derivative in range(3):
        ahead = derivative * np.pi / 2
        expected = np.column_stack([2.0**derivative * np.cos(2 * asked + ahead), np.sin(asked + ahead)])
        np.testing.assert_allclose(spline.at(asked, derivative), expected, atol=1e-3)
    for index in (0, 1, 20, n - 2, n - 1):
        weights = parabola(index, 0.3, n, closed=closed)
        apart = np.array([(k - index + n // 2) % n - n // 2 if closed else k - index for k in weights])
        for power in range(3):
            assert sum(apart**power * list(weights.values())) == pytest.approx(0.3**power, abs=1e-12)
        assert (n - 1 in weights) == (index >= n - 2 or (closed and index == 0))


def test_the_first_and_last_samples_of_a_path_are_accelerated_as_their_neighbours():
    """A static displacement t^2: the second derivative is 2 at all samples, also at the ends."""
    time, step = np.arange(5) * 0.1, 0.1
    run = SimpleNamespace(
        _courses=np.ones((5, 1)),
        models=SimpleNamespace(bent=(None, SimpleNamespace(at=lambda angle: angle[:, None, None] ** 2))),
        path=SimpleNamespace(angle=time),
        time_step=step,
    )
    value, first, second = PathRun.bent.func(run)
    np.testing.assert_allclose(value[:, 0], time**2)
    np.testing.assert_allclose(first[1:-1, 0], 2 * time[1:-1])
    np.testing.assert_allclose(second[:, 0], 2.0)


@pytest.mark.parametrize("closed", [True, False])
def test_the_model_of_an_angle_is_the_nearest(closed):
    """Three models for each of eight angles; those of an open path end at its ends."""
    spacing, steps = 2 * np.pi / 8, 3
    angles = 0.3 + spacing * np.arange(8 if closed else 9)
    models = SimpleNamespace(is_one=False, angles=angles, spacing=spacing, steps=steps, knots=angles, closed=closed)
    asked = np.linspace(-7.0, 9.0, 500) if closed else np.linspace(angles[0], angles[-1], 500)
    knot, step = path_models.PathModels.nearest(models, asked)
    off = asked - angles[knot] - spacing * ((step + 0.5) / steps - 0.5)
    if closed:
        off = (off + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off).max() < spacing / (2 * steps) * (1 + 1e-9)


def test_modes_follow_a_change_of_stiffness_whatever_the_axes_of_their_amplitudes():
    """By the formulas along the modes, and along axes turned by a random rotation."""
    rng, omega, duration = np.random.default_rng(2), np.array([3.0, 7.0, 40.0]), 0.4
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    slope, push, pushed = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(3, 2))
    slope += slope.T

    def s(v):
        return (1 - np.sin(v * duration / 2) / (v * duration / 2)) / v if v else 0.0

    apart, together = ([[s(a + sign * b) for b in omega] for a in omega] for sign in (-1, 1))
    of_place = -slope * np.add(apart, together) / (2 * omega[:, None])
    of_rate = -slope * np.subtract(apart, together) / (2 * omega)
    rest = push / omega[:, None] ** 2
    follows = np.array([s(w) / w for w in omega])[:, None] * (pushed - slope @ rest) - of_place @ rest
    expected = np.block([[of_place, np.zeros((3, 3)), follows], [np.zeros((3, 3)), of_rate, np.zeros((3, 2))]])

    def system(stiffness, force):
        zero, still = np.zeros((3, 3)), np.zeros((3, 2))
        return np.block([[zero, np.eye(3)], [-turn @ stiffness @ turn.T, zero]]), np.vstack([still, turn @ force])

    found = path_changes(system(np.diag(omega**2), push), system(slope, pushed), 3, duration)
    back = scipy.linalg.block_diag(turn, turn)
    np.testing.assert_allclose(back.T @ found @ scipy.linalg.block_diag(back, np.eye(2)), expected, atol=1e-12)


def test_modes_along_a_path_do_not_change_along_themselves():
    """A mode that turns in the plane of two coordinates, by a general mass matrix: at the path's start, its forward
    difference has a part along the mode itself, which is left out."""
    spacing, mass = 0.3, np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]])
    to_unit = np.linalg.inv(np.linalg.cholesky(mass)).T
    knots = [SimpleNamespace(modes=to_unit @ [[np.cos(a)], [np.sin(a)], [0.0]]) for a in spacing * np.arange(4)]
    models = SimpleNamespace(
        knots=knots,
        is_one=False,
        closed=False,
        spacing=spacing,
        transition=lambda *_: np.eye(1),
        start=SimpleNamespace(coordinates=SimpleNamespace(mass=mass)),
    )
    expected = to_unit @ [[0.0], [np.sin(spacing) / spacing], [0.0]]
    np.testing.assert_allclose(path_models.PathModels.slope(models, 0), expected, atol=1e-12)


@pytest.mark.parametrize("turn", [0.7, 1e-9])
def test_the_angle_between_two_models_is_that_of_their_motions(turn):
    """One mode turned in the plane of two coordinates of 4 kg, small angles to all digits."""
    mass, scale = np.diag([4.0, 4.0]), np.array([2.0, 2.0])
    assembly = SimpleNamespace(coordinates=SimpleNamespace(mass=mass, scale=scale))
    first, second = (
        SimpleNamespace(modes=0.5 * np.array([[np.cos(a)], [np.sin(a)]]), assembly=assembly) for a in (0.2, 0.2 + turn)
    )
    change, angle = path_knots.transition(first, second)
    assert angle == pytest.approx(turn, rel=1e-6)
    np.testing.assert_allclose(np.abs(change), 1.0)
