"""Machines of which a part spins and a part stands: whirl against closed forms, own matrices and runs in time."""

from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg
from conftest import Given, make_bar
from test_spinning import hexapod

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    Joint,
    LinearActuator,
    Material,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    build_fe_model,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    revolute,
    simulate,
)
from nassim.base.modal import decay_poles
from nassim.base.rigid_motion import axes_along, rigid_transfer, skew
from nassim.scene.measures import Displacement, PointVelocity
from nassim.scene.part import ForceElement, Sensor
from nassim.scene.terms import NonlinearSpring, Output, Spring
from nassim.simulation.linear.linearization import spinning_equilibrium
from nassim.simulation.loaded.rotor_stator import stator_bodies
from nassim.simulation.model.assembly import assemble
from nassim.systems.linear_model import unstable_poles

AXIS = np.array([2.0, -1.0, 2.0]) / 3
YOUNG, SIDE, HALF = 200e9, 0.01, 0.15
"""Of the shafts: modulus [Pa], side of the square [m], length of a half [m]."""
BENDING, SHEAR = YOUNG * SIDE**4 / 12, 5 / 6 * YOUNG / 2.6 * SIDE**2


@pytest.fixture(scope="module")
def shaft():
    """A square bar along x that weighs next to nothing: its bending is the same in all directions."""
    with pytest.warns(UserWarning, match="speed of sound"):
        light = Material("light", young_modulus=YOUNG, poisson_ratio=0.3, density=1.0)
    model = build_fe_model(make_bar(HALF, SIDE, light), element_size=0.02, order=3, progress=False)
    return craig_bampton(model, n_modes=2, progress=False)


def tip_stiffness(length):
    """Of a clamped Timoshenko beam of this length, on displacement and slope of its other end, (2, 2)."""
    flexibility = [
        [length**3 / (3 * BENDING) + length / SHEAR, length**2 / (2 * BENDING)],
        [length**2 / (2 * BENDING), length / BENDING],
    ]
    return np.linalg.inv(flexibility)


def disc(mass, transverse, polar, points, position, axis):
    """A rigid body that is the same all around its axis."""
    inertia = transverse * np.eye(3) + (polar - transverse) * np.outer(axis, axis)
    return RigidBody("disc", points, mass, inertia, position)


def whirl(matrices):
    """Poles of M v'' + C v' + K v = 0 with complex v = x + i y, one rotating vector each."""
    mass, damping, stiffness = (np.atleast_2d(m) for m in matrices)
    n, inverse = len(mass), np.linalg.inv(mass)
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]]))


def assert_whirls(found, speed, expected):
    """Poles in the rotor frame, seen from the ground, hold all of these to 0.5 %."""
    for pole in expected:
        assert np.abs(found + 1j * speed - pole).min() < 5e-3 * abs(pole)


def overhung(shaft, speed, seat=None):
    """A disc at the end of a shaft along x in a driven spindle, whose housing is fixed or stands on a bushing."""
    inertia = 8e-3 * np.eye(3)
    housing = RigidBody("housing", {"p": np.zeros(3)}, 5.0, inertia, fixed=seat is None)
    bodies = (
        RigidBody("ground", {"p": np.zeros(3), "disc": [HALF, 0, 0]}, fixed=True),
        housing,
        RigidBody("hub", {"p": np.zeros(3)}, 1.0, 1e-3 * np.eye(3)),
        FlexibleBody("shaft", shaft),
        disc(2.0, 4e-3, 7.5e-3, {"p": np.zeros(3)}, [HALF, 0, 0], np.eye(3)[0]),
    )
    joints = (
        revolute("spindle", "housing.p", "hub.p", "x"),
        fixed("l", "hub.p", "shaft.left"),
        fixed("r", "shaft.right", "disc.p"),
    )
    standing = () if seat is None else (Bushing("seat", "ground.p", "housing.p", *seat, axes_along("x")),)
    drive = Drive("motor", "spindle", "rz", speed=speed)
    return Scene("overhung", bodies, joints, (drive,), springs=standing, damping_ratio=0.0)


@pytest.mark.filterwarnings("ignore:body 'shaft'")
@pytest.mark.parametrize("speed", [-150.0, 2000.0])
def test_an_overhung_disc_whirls(shaft, speed):
    """m, J of displacement and slope, - i Jp W of the slope's rate; below and above its critical speed."""
    poles = linearize(overhung(shaft, speed)).poles()
    expected = whirl([np.diag([2.0, 4e-3]), np.diag([0.0, -1j * 7.5e-3 * speed]), tip_stiffness(HALF)])
    assert_whirls(poles, speed, expected)
    slowest = np.min(np.abs(expected[expected.imag * speed > 0]))
    assert (slowest > abs(speed)) == (abs(speed) < 200.0)


@pytest.fixture(scope="module")
def plate():
    """A square plate of steel, on whose faces the points are."""
    model = build_fe_model(make_bar(0.012, 0.12), element_size=0.06, progress=False)
    return craig_bampton(model, n_modes=2, progress=False)


@pytest.mark.filterwarnings("ignore:body ", "ignore:the preload in body 'disc'")
def test_a_reduced_disc_on_a_reduced_shaft(shaft, plate):
    """The disc's centre stands off from the shaft's end by half its thickness."""
    speed = 600.0
    scene = overhung(shaft, speed)
    bodies = (*scene.bodies[:4], FlexibleBody("disc", plate, [HALF, 0, 0]))
    scene = replace(scene, bodies=bodies, joints=(*scene.joints[:2], fixed("r", "shaft.right", "disc.left")))
    mass = 7800 * 0.012 * 0.12**2
    polar, transverse = mass * 0.12**2 / 6, mass * (0.12**2 + 0.012**2) / 12
    lever = np.array([[1.0, 0.006], [0.0, 1.0]])
    matrices = [np.diag([mass, transverse]), np.diag([0.0, -1j * polar * speed])]
    expected = whirl([*(lever.T @ m @ lever for m in matrices), tip_stiffness(HALF)])
    assert_whirls(linearize(scene).poles(), speed, expected)


def jeffcott(shaft, speed, *, ratio=0.0, drag=0.0, offset=0.0):
    """A disc between two halves of a shaft along x, held in two bearings that let it tilt; dampers stand beside it."""
    places = {"left": np.zeros(3), "middle": [HALF, 0, 0], "right": [2 * HALF, 0, 0]}
    ground = RigidBody("ground", places, fixed=True)
    halves = [FlexibleBody("one", shaft), FlexibleBody("two", shaft, [HALF, 0, 0])]
    load = disc(2.0, 4e-3, 7.5e-3, {"p": [0, 0, -offset]}, [HALF, 0, offset], np.eye(3)[0])
    along_x = axes_along("x")
    return Scene(
        "jeffcott",
        (ground, *halves, load),
        (
            Joint("left", "ground.left", "one.left", ("rx", "ry", "rz"), along_x),
            Joint("right", "ground.right", "two.right", ("z", "rx", "ry", "rz"), along_x),
            fixed("to", "one.right", "disc.p"),
            fixed("from", "disc.p", "two.left"),
        ),
        (Drive("motor", "left", "rz", speed=speed), PointForce("push", "disc.p", "x", "push")),
        (Encoder("way", "ground.middle", "disc.p", "x"),),
        tuple(SpringDamper(axis, "ground.middle", "disc.p", axis, damping=drag) for axis in "yz") if drag else (),
        damping_ratio=ratio,
    )


def jeffcott_stiffness():
    """Of the disc's displacement and of its slope: two cantilevers from it to the bearings, which hold no moment."""
    pin = 1 / (HALF**3 / (3 * BENDING) + HALF / SHEAR)
    return 2 * pin, 2 * pin * HALF**2


@pytest.mark.filterwarnings("ignore:body ")
@pytest.mark.parametrize("speed", [100.0, 900.0])
def test_jeffcott_rotor_below_and_above_its_critical_speed(shaft, speed):
    model = linearize(jeffcott(shaft, speed))
    force, moment = jeffcott_stiffness()
    bounce = whirl([2.0, 0.0, force])
    tilt = whirl([4e-3, -1j * 7.5e-3 * speed, moment])
    assert 100.0 < abs(bounce[0]) < 900.0
    assert_whirls(model.poles(), speed, [*bounce, *tilt])
    a, b, c, _ = model.matrices
    assert (c @ np.linalg.solve(-a, b))[0, 0] == pytest.approx(HALF / (YOUNG * SIDE**2), rel=5e-3)


@pytest.mark.filterwarnings("ignore:body ", "ignore:damping_ratio")
def test_rotating_damping_drives_a_jeffcott_rotor_beyond_its_threshold(shaft):
    """W = w0 (1 + c_ext / c_int): what damps in the shaft turns, what damps beside it stands."""
    ratio, first = 0.01, np.sqrt(jeffcott_stiffness()[0] / 2.0)
    inner = 2 * ratio * first * 2.0
    for outer in (0.4 * inner, 1.3 * inner):
        threshold = first * (1 + outer / inner)
        below, above = (linearize(jeffcott(shaft, s * threshold, ratio=ratio, drag=outer)) for s in (0.99, 1.01))
        assert not unstable_poles(below)
        (growing,) = unstable_poles(above)
        assert 2 * np.pi * growing.frequency == pytest.approx(1.01 * threshold - first, rel=0.01)
        rate = (inner * 0.01 * threshold / first) / (2 * 2.0)
        assert growing.growth_rate == pytest.approx(rate, rel=0.5)  # the threshold within a few per mille


SEAT = np.array([2e5, 2e5, 5e5, 3e3, 3e3, 9e3])
"""Of a housing: across the axis twice, along it; tilts, turn [N/m, N m/rad]."""


def housed(speed, drag):
    """Matrices of displacement and slope of the housing with its hub, then of the disc, as rotating vectors."""
    lever = np.array([[1.0, HALF], [0.0, 1.0]])
    apart = np.hstack([-lever, np.eye(2)])
    foot = np.diag([1.0, 1.0, 0, 0])
    mass = np.diag([6.0, 9e-3, 2.0, 4e-3])
    gyro = -1j * speed * np.diag([0, 1e-3, 0, 7.5e-3])
    stiffness = apart.T @ tip_stiffness(HALF) @ apart + foot * [SEAT[0], SEAT[3], 0, 0]
    return mass, gyro + foot * [drag[0], drag[3], 0, 0], stiffness


@pytest.mark.filterwarnings("ignore:body ")
@pytest.mark.parametrize("speed", [-200.0, 700.0])
def test_a_spindle_whose_housing_stands_on_a_bushing(shaft, speed):
    """Whirl of shaft and housing together, and what the seat damps: it stands."""
    drag = 2e-3 * SEAT
    poles = linearize(overhung(shaft, speed, (SEAT, drag))).poles()
    assert_whirls(poles, speed, whirl(housed(speed, drag)))


POINT = np.array([0.3, -0.2, 0.1])
"""Of the axis along AXIS."""


def rigid_machine(speed, *, k=(4e5, 4e5), arms=3, wobble=0.0, transverse=0.03, turned=0.0, signals=(), point=POINT):
    """A rotor in two bearings of a foundation that stands on three legs, about an odd axis; no drive turns it."""
    axes = axes_along(AXIS)
    around = 2 * np.pi / arms * np.arange(arms)
    legs = {f"leg {j}": 0.2 * np.array([np.cos(t), np.sin(t), -0.3]) for j, t in enumerate(around)}
    bearings = {"low": np.array([0, 0, 0.05]), "high": np.array([0, 0, 0.25])}
    middle, centre = np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.0, 0.12])
    places = {name: point + axes @ at for name, at in legs.items()}
    ground = RigidBody("ground", {**places, "top": point + 0.3 * AXIS}, fixed=True)
    inertia = axes @ np.diag([0.2, 0.2 * (1 + wobble), 0.3]) @ axes.T
    held = {name: axes @ (at - middle) for name, at in (legs | bearings).items()}
    foundation = RigidBody("foundation", held, 8.0, inertia, point + axes @ middle)
    spread = axes @ np.diag([transverse, transverse * (1 + turned), 0.045]) @ axes.T
    spots = {name: axes @ (at - centre) for name, at in bearings.items()}
    rotor = RigidBody(
        "rotor", {**spots, "top": 0.18 * AXIS, "rim": 0.1 * axes[:, 0]}, 3.0, spread, point + axes @ centre
    )
    feet = []
    for j, t in enumerate(around):
        turn = np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1.0]])
        figures = np.array([2e5, 3e5, 6e5, 200.0, 300.0, 150.0])
        feet.append(Bushing(f"leg {j}", f"ground.leg {j}", f"foundation.leg {j}", figures, 1e-4 * figures, axes @ turn))
    springs = [
        SpringDamper(f"{name} {j}", *ends, axis, stiffness, 2e-4 * stiffness, frame=ends[0])
        for name in bearings
        for ends in [(f"foundation.{name}", f"rotor.{name}")]
        for j, (axis, stiffness) in enumerate(zip(axes.T, (*k, 5e5), strict=True))
    ]
    scene = Scene("machine", (ground, foundation, rotor), springs=(*feet, *springs), sensors=signals, damping_ratio=0.0)
    return scene, {"angular_velocity": speed * AXIS, "axis_point": point, "stator": ("ground", "foundation")}


def own_matrices(speed, k, arms=3, wobble=0.0):
    """Foundation, then rotor, as six motions each of their centres of mass, axis along z; as the ground sees them."""
    mass = scipy.linalg.block_diag(
        8.0 * np.eye(3), np.diag([0.2, 0.2 * (1 + wobble), 0.3]), 3.0 * np.eye(3), np.diag([0.03, 0.03, 0.045])
    )
    damping, stiffness = np.zeros((12, 12)), np.zeros((12, 12))
    damping[9:, 9:] = -0.045 * speed * skew(np.array([0, 0, 1.0]))  # H = A theta' + C W (z + theta x z)
    middle, centre = np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.0, 0.12])
    for t in 2 * np.pi / arms * np.arange(arms):
        turn = np.kron(np.eye(2), [[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1.0]])
        rows = np.zeros((6, 12))
        rows[:, :6] = turn.T @ rigid_transfer(0.2 * np.array([np.cos(t), np.sin(t), -0.3]) - middle)
        law = rows.T @ np.diag([2e5, 3e5, 6e5, 200.0, 300.0, 150.0]) @ rows
        stiffness, damping = stiffness + law, damping + 1e-4 * law
    for z in (0.05, 0.25):
        at = np.array([0.0, 0.0, z])
        rows = np.hstack([-rigid_transfer(at - middle)[:3], rigid_transfer(at - centre)[:3]])
        law = rows.T @ np.diag([*k, 5e5]) @ rows
        stiffness, damping = stiffness + law, damping + 2e-4 * law
    return mass, damping, stiffness


def own_poles(mass, damping, stiffness):
    inverse, n = np.linalg.inv(mass), len(mass)
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]]))


def assert_same_poles(found, expected, rtol=1e-7):
    """Each of these among those, but for the rotor's free turn, a double pole at rest."""
    assert len(found) == len(expected)
    for pole in expected[np.abs(expected) > 1e-2]:
        assert np.abs(found - pole).min() < rtol * abs(pole)


@pytest.mark.parametrize(("speed", "k", "arms", "wobble"), [(-90.0, (4e5, 7e5), 3, 0.0), (700.0, (4e5, 6e5), 2, 0.4)])
def test_a_rigid_rotor_in_the_standing_frame(speed, k, arms, wobble):
    """What stands may differ across the axis where what turns does not: equations of Newton and Euler."""
    scene, spin = rigid_machine(speed, k=k, arms=arms, wobble=wobble)
    found = linearize(scene, **spin, frame="stator").poles()
    assert_same_poles(found, own_poles(*own_matrices(speed, k, arms, wobble)))


@pytest.mark.parametrize(("speed", "arms"), [(-90.0, 3), (700.0, 4)])
def test_a_rigid_rotor_in_the_turning_frame(speed, arms):
    """The same equations as seen by what turns: u = R v per vector. A weight across the axis has no mean there."""
    scene, spin = rigid_machine(speed, arms=arms)
    scene = replace(scene, gravity=1e3 * np.cross(AXIS, np.eye(3)[0]))
    mass, damping, stiffness = own_matrices(speed, (4e5, 4e5), arms)
    turn = np.kron(np.eye(4), speed * skew(np.array([0, 0, 1.0])))
    turned = mass, damping + 2 * mass @ turn, stiffness + damping @ turn + mass @ turn @ turn
    assert_same_poles(linearize(scene, **spin).poles(), own_poles(*turned))


@pytest.mark.filterwarnings("ignore:body ")
@pytest.mark.parametrize("kind", ["ffrf", "rigid"])
def test_whirl_in_time(shaft, kind):
    """Free motion after a push, as the ground sees it: all whirl frequencies of the linear model to 0.5 %."""
    speed, step, drag = 300.0, 2e-4, 2e-5 * SEAT
    scene = overhung(shaft, speed, (SEAT, drag))
    # All that turns starts at speed, or the motor's start would turn the housing back.
    bodies = [replace(body, angular_velocity=(speed, 0, 0)) for body in scene.bodies[2:]]
    if kind == "rigid":
        bodies[1] = replace(bodies[1], fidelity="rigid")
    scene = replace(scene, bodies=(*scene.bodies[:2], *bodies))
    time = step * np.arange(1000)
    push = np.where(time < 0.003, np.sin(np.pi * time / 0.003) ** 2, 0.0)
    run = simulate(
        replace(
            scene,
            actuators=(*scene.actuators, PointForce("push", "disc.p", "y", "push")),
            sensors=tuple(Encoder(axis, "ground.disc", "disc.p", axis) for axis in "yz"),
        ),
        TimeHistory(time, push[None], ("push",), ("N",)),
        time_step=step,
        spectral_radius=0.9,
        progress=False,
    )
    expected = linearize(scene).poles() + 1j * speed
    if kind == "ffrf":
        whirls = [expected[np.argmin(np.abs(expected - pole))] for pole in whirl(housed(speed, drag))]
    else:
        whirls = whirl(rigidly_housed(speed, drag))
        assert all(np.abs(expected - pole).min() < 1e-3 * abs(pole) for pole in whirls)
    found = decay_poles(run.values[1:, 20:], step, n_poles=2 * len(whirls))
    swings = 2 / step * np.tan(np.abs(found.imag) * step / 2)  # the run's own steps lengthen periods
    for pole in whirls:
        assert np.abs(swings - abs(pole.imag)).min() < 5e-3 * abs(pole)


def rigidly_housed(speed, drag):
    """As `housed`, with a shaft that does not bend."""
    together = np.vstack([np.eye(2), [[1.0, HALF], [0.0, 1.0]]])
    mass, gyro, stiffness = (together.T @ m @ together for m in housed(speed, drag))
    return mass, gyro, stiffness


def strutted(speed, seat=1e6, **changes):
    """A published platform of six struts on a spindle, in a granite on three feet; read and pushed along the axis."""
    inner = hexapod()
    base, plate, load = inner.bodies
    feet = {f"foot {j}": [0.3 * np.cos(t), 0.3 * np.sin(t), -0.1] for j, t in enumerate(2 * np.pi / 3 * np.arange(3))}
    places = {"axle": np.zeros(3), **feet}
    ground = RigidBody("ground", {**feet, "probe": [0, 0, 0.4]}, fixed=True)
    granite = RigidBody("granite", places, 300.0, np.diag([9.0, 9.0, 14.0]))
    table = RigidBody("table", {**base.points, "axle": np.zeros(3)}, 20.0, np.diag([0.2, 0.2, 0.3]))
    springs = [Bushing(n, f"ground.{n}", f"granite.{n}", seat * np.array([1, 1, 2, 0.01, 0.01, 0.01])) for n in feet]
    scene = replace(
        inner,
        bodies=(ground, granite, table, plate, load),
        joints=(revolute("spindle", "granite.axle", "table.axle"), *inner.joints),
        actuators=(Drive("motor", "spindle", "rz", speed=speed), PointForce("lift", "plate.top", "z", "lift")),
        sensors=(Encoder("height", "ground.probe", "load.foot", "z"),),
        springs=(
            *(SpringDamper(f"strut {k}", f"table.a{k}", f"plate.b{k}", "line", 1.846e6) for k in range(6)),
            *springs,
        ),
    )
    return replace(scene, **changes)


def test_a_machine_on_a_spindle_in_a_granite_on_feet():
    """On feet that hardly give, its published frequencies; on soft ones, either frame says the same."""
    speed = 2 * np.pi
    stiff = linearize(strutted(speed, 1e13)).poles()
    for frequency in (10.4091, 12.1414, 36.9134, 46.7331, 74.4199, 75.7247):
        assert np.abs(np.abs(stiff) / (2 * np.pi) - frequency).min() < 1e-4
    turning, standing = linearize(strutted(speed)), linearize(strutted(speed), frame="stator")
    for pole in turning.poles():
        shifted = pole + 1j * speed * np.array([-1, 0, 1])
        assert np.abs(standing.poles()[:, None] - shifted).min() < 1e-6 * abs(pole)
    assert np.abs(np.abs(turning.poles()) / (2 * np.pi) - 10.4091).min() > 1e-2
    frequency = np.array([0.0, 3.0, 30.0, 300.0])
    heights = [frequency_response(model, frequency).values[0, 0] for model in (turning, standing)]
    np.testing.assert_allclose(heights[0], heights[1], rtol=1e-7)
    struts = tuple(LinearActuator(f"F{k}", f"table.a{k}", f"plate.b{k}", f"F{k}") for k in range(6))
    lengths = tuple(Encoder(f"d{k}", f"table.a{k}", f"plate.b{k}", "line") for k in range(6))
    legs = strutted(speed, sensors=lengths, actuators=(*strutted(speed).actuators, *struts))
    a, b, c, _ = linearize(legs).matrices
    # Pushed and read in pairs, all around alike: the feet are alike in all directions, too.
    answer = (c @ np.linalg.solve(40j * np.eye(len(a)) - a, b))[:, 1:]
    np.testing.assert_allclose(answer[2:, 2:], answer[:-2, :-2], rtol=1e-6, atol=1e-9 * np.abs(answer).max())
    with pytest.raises(ValueError, match="input 'F0': in the stator frame"):
        linearize(legs, frame="stator")


def test_angles_are_read_against_the_steady_turn():
    """Of a rotor whose drive stands on a foundation that can twist: torque turns both together."""
    scene = strutted(2.0, sensors=(AngleSensor("twist", "ground.probe", "plate.top"),))
    seized = (fixed("spindle", "granite.axle", "table.axle"), scene.joints[1])
    torque = PointTorque("turn", "plate.top", "z", "turn")
    scene = replace(scene, actuators=(scene.actuators[0], torque))
    a, b, c, _ = linearize(scene).matrices
    expected = linearize(replace(scene, actuators=(torque,), joints=seized))
    still = expected.C @ np.linalg.solve(-expected.A, expected.B)
    np.testing.assert_allclose(c @ np.linalg.solve(-a, b), still, rtol=1e-7)
    assert np.abs(still).min() > 1e-9


CHANGES = {
    "legs": (
        {"arms": 2},
        "the force law between ground.leg 0 and foundation.leg 0, the force law between ground.leg 1",
    ),
    "bearing": (
        {"k": (4e5, 5e5)},
        "the force law between foundation.low and rotor.low, the force law between foundation.high and",
    ),
    "foundation": ({"wobble": 0.1}, "body 'foundation': in the rotor frame, this changes by"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_what_changes_as_a_part_turns_is_named(case):
    changes, message = CHANGES[case]
    scene, spin = rigid_machine(50.0, **changes)
    with pytest.raises(ValueError, match=message):
        linearize(scene, **spin)
    linearize(scene, **spin, frame="stator")
    uneven, spin = rigid_machine(50.0, turned=0.2)
    with pytest.raises(ValueError, match="body 'rotor': in the stator frame, this changes by 1"):
        linearize(uneven, **spin, frame="stator")
    linearize(uneven, **spin)
    scene, spin = rigid_machine(50.0)
    beside = replace(scene.bodies[2], position=scene.bodies[2].position + 0.001 * axes_along(AXIS)[:, 0])
    with pytest.raises(ValueError, match=r"body 'rotor' rotates with its centre of mass 0\.001 m beside the axis"):
        linearize(replace(scene, bodies=(*scene.bodies[:2], beside)), **spin, frame="stator")


@pytest.mark.parametrize(("share", "told"), [(0.9, False), (1.1, True)])
def test_rounding_of_what_must_not_change_is_one_in_ten_million(share, told):
    """Of an inertia diag(a, a (1 + w), c), which turns by sqrt(2) a w sin(angle), and of the radius of inertia."""
    inertia = np.array([0.2, 0.2, 0.3])
    wobble = share * 1e-7 * np.linalg.norm(inertia) / (np.sqrt(2) * 0.2 * np.sin(1.0))
    scene, spin = rigid_machine(50.0)
    rotor = scene.bodies[2]
    beside = share * 1e-7 * np.sqrt(rotor.inertia[0, 0] / rotor.mass) * axes_along(AXIS)[:, 0]
    points = {name: at - beside for name, at in rotor.points.items()}
    rotor = replace(rotor, position=rotor.position + beside, points=points)
    moved = replace(scene, bodies=(*scene.bodies[:2], rotor))
    uneven, _ = rigid_machine(50.0, wobble=wobble)
    with pytest.raises(ValueError, match="body 'foundation': in the rotor") if told else nullcontext():
        linearize(uneven, **spin)
    message = "with its centre of mass" if told else "the force law between"  # the arms of the bearings change too
    with pytest.raises(ValueError, match=message):
        linearize(moved, **spin, frame="stator")


def test_signals_that_change_as_a_part_turns_are_named():
    across = axes_along(AXIS)[:, 0]
    cases = [
        (Encoder("x", "ground.top", "rotor.top", across), "rotor", "output 'x'"),
        (Encoder("x", "ground.top", "rotor.top", across, frame="rotor.top"), "stator", "output 'x'"),
    ]
    for sensor, frame, message in cases:
        scene, spin = rigid_machine(50.0, signals=(sensor,))
        with pytest.raises(ValueError, match=f"{message}: in the {frame} frame"):
            linearize(scene, **spin, frame=frame)
        linearize(scene, **spin, frame={"rotor": "stator", "stator": "rotor"}[frame])
    scene, spin = rigid_machine(50.0)
    for push, message in (
        (PointForce("f", "rotor.top", across, "f"), "'f'"),
        (GroundAcceleration("g", across, "g"), "'g'"),
    ):
        with pytest.raises(ValueError, match=f"input {message}: in the rotor frame"):
            linearize(replace(scene, actuators=(push,)), **spin)
        linearize(replace(scene, actuators=(push,)), **spin, frame="stator")


def test_a_ground_that_shakes_along_axes_of_the_rotor_does_so_at_shifted_frequencies():
    """What turns forward at s in fixed axes does so at s - j W in the rotor's: in the one frame and in the other."""
    axes, speed = axes_along(AXIS)[:, :2].T, 50.0
    points, found = np.array([3.0 + 40j, 5.0 - 130j, 2.0 + 400j]), []
    for frame, turning, shift in (("stator", "", 0.0), ("rotor", "rotor.top", 1j * speed)):
        signals = [Encoder(c, "ground.top", "rotor.top", a, frame=turning) for c, a in zip("xy", axes, strict=True)]
        scene, spin = rigid_machine(speed, signals=tuple(signals))
        shakers = tuple(GroundAcceleration(f"g{c}", a, f"g{c}", turning) for c, a in zip("xy", axes, strict=True))
        model = linearize(replace(scene, actuators=shakers), **spin, frame=frame)
        rows, columns = [model.outputs.index(c) for c in "xy"], [model.inputs.index(f"g{c}") for c in "xy"]
        a, b, c, d = model.A, model.B[:, columns], model.C[rows], model.D[np.ix_(rows, columns)]
        g = np.array([c @ np.linalg.solve((s - shift) * np.eye(len(a)) - a, b) + d for s in points])
        found.append(0.5 * (g[:, 0, 0] + g[:, 1, 1] + 1j * (g[:, 1, 0] - g[:, 0, 1])))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8)


def test_a_ground_that_turns_is_for_small_motion_alone():
    scene, _ = rigid_machine(50.0)
    across = axes_along(AXIS)[:, 0]
    shaken = replace(scene, actuators=(*scene.actuators, GroundAcceleration("g", across, "g", "rotor.top")))
    rest = TimeHistory([0.0, 1e-3, 2e-3], np.zeros((len(shaken.inputs), 3)), shaken.inputs)
    with pytest.raises(
        ValueError, match="large motion: the BaseAcceleration of GroundAcceleration 'g' turns with a body"
    ):
        simulate(shaken, rest, time_step=1e-3, progress=False)


@dataclass(frozen=True)
class Mark(Sensor):
    """Reads how far a point of the rotor is from the world's origin, along the rotor's axis."""

    def terms(self, scene):
        """A displacement of one point along axes that turn."""
        return (Output(self.name, "m", Displacement((("rotor.rim", AXIS),), "rotor.top")),)


def test_a_velocity_along_axes_that_tilt_reads_the_speed_of_the_rotation_across_them():
    """A torque t tilts a block at p on a rotor by e = t / k; along its own axis d, it then reads d . ((W x p) x e)."""
    axes, stiffness, speed = axes_along(AXIS), 50.0, 30.0
    place = axes @ [0.2, 0.1, 0.05]
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    hub = RigidBody("hub", {"o": np.zeros(3), "seat": place}, 1.0, 1e-2 * np.eye(3))
    block = RigidBody("block", {"c": np.zeros(3)}, 0.5, 1e-3 * np.eye(3), place)
    scene = Scene(
        "tilting",
        (ground, hub, block),
        (revolute("axle", "ground.o", "hub.o", AXIS),),
        (
            Drive("motor", "axle", "rz", speed=speed),
            *(PointTorque(f"t{k}", "block.c", tuple(axes[:, k]), f"t{k}", "block.c") for k in range(3)),
        ),
        tuple(Vibrometer(f"v{k}", "block.c", tuple(axes[:, k]), "block.c") for k in range(3)),
        (Bushing("mount", "hub.seat", "block.c", [1e9] * 3 + [stiffness] * 3),),
        damping_ratio=0.0,
    )
    a, b, c, d = linearize(scene).matrices
    moving = np.cross(speed * AXIS, place)
    expected = [[along @ np.cross(moving, about) / stiffness for about in axes.T] for along in axes.T]
    np.testing.assert_allclose(d - c @ np.linalg.solve(a, b), expected, atol=1e-6 * np.abs(expected).max())


def test_places_seen_from_the_rotor_turn_about_its_axis():
    """A tilt of axes that turn moves what is read from an origin beside the axis, and the more so the more it is."""
    scene, spin = rigid_machine(50.0, signals=(Mark("mark"),), point=np.zeros(3))
    linearize(scene, **spin)
    scene, spin = rigid_machine(50.0, signals=(Mark("mark"),))
    with pytest.raises(ValueError, match="output 'mark': in the rotor frame, this changes by"):
        linearize(scene, **spin)


def test_what_cannot_stand_beside_what_turns_is_refused(shaft):
    scene, spin = rigid_machine(50.0)
    wound = SpringDamper("wire", "foundation.leg 1", "rotor.rim", "line", 10.0)
    half = Bushing("half", "ground.top", "rotor.top", np.array([1, 1, 1, 0, 0, 0]), np.array([1, 1, 1, 0, 0, 0]))
    clutch = Bushing("clutch", "foundation.low", "rotor.low", np.ones(6))
    refused = {
        "the force law between foundation.leg 1 and rotor.rim resists the rotation of the rotor about its axis": (
            *scene.springs,
            wound,
        ),
        "does not know whether the damping of a bushing between rotor and stator rotates": (*scene.springs, half),
        "the force law between foundation.low and rotor.low resists the rotation": (*scene.springs, clutch),
    }
    for message, springs in refused.items():
        with pytest.raises(ValueError, match=message):
            linearize(replace(scene, springs=springs), **spin)
    with pytest.raises(ValueError, match="unknown frame 'stander'"):
        linearize(scene, **spin, frame="stander")
    with pytest.raises(ValueError, match="unknown body 'granite'"):
        linearize(scene, angular_velocity=(0, 0, 1.0), stator=["granite"])
    with pytest.raises(
        ValueError, match="body 'shaft' of the rotor is a reduced body, which a model in the stator frame"
    ):
        linearize(overhung(shaft, 10.0), frame="stator")


def test_friction_of_a_bushing_stands_with_the_ground_too():
    """A bushing that damps nothing but turns about the axis ties the table to the ground, as a spring-damper does."""
    scene = strutted(2.0)
    brake = Bushing("brake", "ground.p", "table.axle", np.zeros(6), [0, 0, 0, 0, 0, 1e-3])
    ground = replace(scene.bodies[0], points={**scene.bodies[0].points, "p": scene.point_position("table.axle")})
    assert ground.fixed
    assert not ground.position.any()
    braked = replace(scene, bodies=(ground, *scene.bodies[1:]), springs=(*scene.springs, brake))
    linearize(replace(braked, springs=scene.springs))
    with pytest.raises(ValueError, match="needs a fixed body on one side"):
        linearize(braked)


def test_a_force_sensor_of_a_bearing_is_named_where_its_reading_turns():
    """The force along the world's x axis changes as the frame that turns sees it."""
    inertia = 1e-3 * np.diag([2.0, 2.0, 3.0])
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    rotor = RigidBody("rotor", {"p": np.zeros(3)}, 1.0, inertia)
    guide = Joint("guide", "ground.p", "rotor.p", free=("x", "y", "rz"))
    springs = tuple(SpringDamper(a, "ground.p", "rotor.p", a, 500.0) for a in "xy")
    scene = Scene(
        "r", (ground, rotor), (guide,), sensors=(ForceSensor("pull", "x"),), springs=springs, damping_ratio=0.0
    )
    spin = {"angular_velocity": (0, 0, 5.0), "stator": ["ground"]}
    linearize(scene, **spin, frame="stator")
    with pytest.raises(ValueError, match="output 'pull': in the rotor frame, this changes by"):
        linearize(scene, **spin)


def test_who_stands_is_said_or_asked():
    """What hangs between both sides by what lets it turn."""
    scene = strutted(2.0)
    ring = RigidBody("ring", {"p": np.zeros(3)}, 1.0, np.eye(3), [0, 0, 0.0])
    ties = [Bushing(f"to {b}", f"{b}.axle", "ring.p", [1e3, 1e3, 1e3, 0, 0, 0]) for b in ("granite", "table")]
    hung = replace(scene, bodies=(*scene.bodies, ring), springs=(*scene.springs, *ties))
    with pytest.raises(ValueError, match="body 'ring' is tied to the rotor and to the stator"):
        linearize(hung)
    # Tied to one side, also by way of another one: it belongs there.
    other = RigidBody("other", {"p": np.zeros(3)}, 0.5, 2 * np.eye(3), [0, 0, 0.0])
    chain = Bushing("chain", "ring.p", "other.p", [2e3, 2e3, 2e3, 0, 0, 0])
    standing = ["ground", "granite"]
    both = [*standing, "ring", "other"]
    for tie, own, wrong in ((ties[0], both, standing), (ties[1], standing, both)):
        one_side = replace(hung, bodies=(*scene.bodies, other, ring), springs=(*scene.springs, chain, tie))
        poles, expected = (linearize(one_side, **options).poles() for options in ({}, {"stator": own}))
        np.testing.assert_array_equal(poles, expected)
        assert np.abs(linearize(one_side, stator=wrong).poles() - expected).max() > 1e-3
    linearize(hung, stator=[*standing, "ring"])
    linearize(hung, stator=standing)
    with pytest.raises(ValueError, match="joint 'spindle': a drive that turns far needs a stator"):
        linearize(scene, stator=["ground", "granite", "table"])
    with pytest.raises(ValueError, match="joint 'spindle': a drive that turns far needs a fixed body on one side"):
        linearize(replace(scene, springs=scene.springs[:6]))


@pytest.mark.filterwarnings("ignore:body ", "ignore:damping_ratio")
def test_an_unstable_rotor_has_a_model_and_no_equilibrium(shaft):
    force, _ = jeffcott_stiffness()
    speed = 1.5 * np.sqrt(force / 2.0)
    scene = jeffcott(shaft, speed, ratio=0.01, offset=1e-5)
    (pole,) = unstable_poles(linearize(scene))
    with pytest.raises(ValueError, match=rf"is unstable: an oscillation at {pole.frequency:.4g} Hz that grows e-fold"):
        spinning_equilibrium(scene)
    steady = spinning_equilibrium(jeffcott(shaft, speed, ratio=0.01, drag=20.0, offset=1e-5))
    assert set(steady) == {"way"}


@pytest.mark.filterwarnings("ignore:body ")
def test_unbalance_against_what_stands_and_damps(shaft):
    """Deflection e m W^2 / (k - m W^2 + i c W), as the disc sees it: a damper that stands turns it back."""
    force, _ = jeffcott_stiffness()
    drag, offset, speed = 60.0, 2e-5, 1.05 * np.sqrt(force / 2.0)
    spots = tuple(Encoder(axis, "one.left", "disc.q", axis, frame="one.left") for axis in "yz")
    scene = jeffcott(shaft, speed, drag=drag, offset=offset)
    load = scene.bodies[3]
    scene = replace(
        scene, bodies=(*scene.bodies[:3], replace(load, points={**load.points, "q": load.points["p"]})), sensors=spots
    )
    found = spinning_equilibrium(scene)
    expected = offset * 2.0 * speed**2 / (force - 2.0 * speed**2 + 1j * drag * speed) * 1j
    expected *= 1 - 1.5  # read along axes of the shaft's end, whose slope is 1.5 times the deflection over its length
    assert abs(found["y"] + 1j * found["z"] - expected) < 0.03 * abs(expected)


def test_damping_of_modes_is_one_of_deformation():
    """Rigid bodies have none, and a bearing's must not turn with the rotor; a warning tells of the loss."""
    scene, spin = rigid_machine(90.0)
    with pytest.warns(UserWarning, match="damping_ratio acts through deformation only"):
        damped = linearize(replace(scene, damping_ratio=0.05), **spin).poles()
    assert_same_poles(damped, linearize(scene, **spin).poles(), 1e-9)


def test_a_single_spring_to_the_ground_keeps_modes_of_a_rotor_from_damping():
    """Beside springs within the rotor; without the one, all modes turn with it and keep their damping."""
    moments = 1e-2 * np.diag([1.0, 1.0, 1.5])
    ground, wheel, ring = (
        RigidBody("ground", {"o": (0, 0, 0)}, fixed=True),
        RigidBody("wheel", {"o": (0, 0, 0)}, 2.0, moments),
        RigidBody("ring", {"o": (0, 0, 0)}, 1.0, moments),
    )
    springs = (
        Bushing("bearing", "ground.o", "wheel.o", [3e5, 3e5, 4e5, 2e3, 2e3, 0.0]),
        Bushing("seat", "wheel.o", "ring.o", [2e5, 3e5, 1e5, 900.0, 800.0, 700.0]),
    )
    scene = Scene("wheel", (ground, wheel, ring), springs=springs, damping_ratio=0.05, gravity=np.zeros(3))
    spin = {"angular_velocity": (0, 0, 40.0), "stator": ["ground"]}
    with pytest.warns(UserWarning, match="damping_ratio acts through deformation only"):
        found = linearize(scene, **spin).poles()
    assert_same_poles(found, linearize(replace(scene, damping_ratio=0.0), **spin).poles(), 1e-9)
    loose = linearize(replace(scene, springs=springs[1:]), **spin).poles()
    assert np.count_nonzero(loose.real < -0.02 * np.abs(loose)) >= 8


@dataclass(frozen=True)
class Friction(ForceElement):
    """Viscous friction about x between two points."""

    name: str
    a: str
    b: str

    def terms(self, scene):
        """It brakes the turn of b against a."""
        return (
            Spring(PointVelocity(((self.a, -np.eye(3)[0]), (self.b, np.eye(3)[0])), self.a, angular=True), 0.0, 0.3),
        )


@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_the_friction_of_another_joint_takes_its_body_along(friction):
    """A disc on a bearing of the rotor and on springs of the stator; where all let it turn, its side is not known."""
    bodies = [RigidBody(name, {"c": np.zeros(3)}, 1.0, 0.01 * np.eye(3)) for name in ("table", "disc")]
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    axle = revolute("axle", "ground.c", "table.c", AXIS)
    bearing = revolute("bearing", "table.c", "disc.c", AXIS, damping=friction)
    feet = Bushing("feet", "ground.c", "disc.c", [1e4, 1e4, 1e4, 10.0, 10.0, 0.0], axes=axes_along(AXIS))
    scene = Scene("disc", (ground, *bodies), (axle, bearing), (Drive("motor", "axle", "rz", speed=3.0),), (), (feet,))
    assembly = assemble(scene)
    if friction:
        assert stator_bodies(assembly, scene.constraints["axle"], AXIS) == {"ground"}
    else:
        with pytest.raises(ValueError, match="'disc' is tied to the rotor and to the stator"):
            stator_bodies(assembly, scene.constraints["axle"], AXIS)


def test_a_drive_bears_the_friction_of_its_joint(shaft):
    scene = overhung(shaft, 100.0)
    rubbing = replace(scene, springs=(Friction("grease", "housing.p", "hub.p"),))
    np.testing.assert_allclose(linearize(rubbing).A, linearize(scene).A, rtol=1e-12, atol=1e-9)
    seal = replace(scene, springs=(Friction("seal", "ground.disc", "disc.p"),))
    with pytest.raises(ValueError, match=r"the force law between ground\.disc and disc\.p resists the rotation"):
        linearize(seal, stator=["ground", "housing"])


@dataclass(frozen=True)
class OwnLaws(ForceElement):
    """A part with laws of one's own in the places of its springs, of the same tangents."""

    part: ForceElement

    def terms(self, scene):
        return tuple(self.own(term) if isinstance(term, Spring) else term for term in self.part.terms(scene))

    @staticmethod
    def own(spring):
        stiffness, damping = spring.matrices
        return NonlinearSpring(
            spring.measure,
            force=lambda value, rate: stiffness @ value + damping @ rate,
            tangent=lambda _value, _rate: (stiffness, damping),
        )


@pytest.mark.filterwarnings("ignore:body ")
@pytest.mark.parametrize(
    "make",
    [
        lambda shaft: (jeffcott(shaft, 300.0, drag=20.0), {}),
        lambda shaft: (overhung(shaft, 400.0, (SEAT, 2e-3 * SEAT)), {}),
        lambda _: (strutted(20.0), {"frame": "stator"}),
        lambda _: rigid_machine(300.0),
    ],
    ids=["dampers beside a shaft", "a seat that damps", "struts that turn", "bearings that damp"],
)
def test_laws_of_ones_own_count_as_springs_of_their_tangents(shaft, make):
    scene, options = make(shaft)
    own = replace(scene, springs=tuple(OwnLaws(part.name, part) for part in scene.springs))
    expected, found = (linearize(one, **options) for one in (scene, own))
    for a, b in zip(found.matrices, expected.matrices, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(b).max(initial=0.0))


def test_accelerations_of_a_rotor_in_the_frame_of_its_stator():
    """On the axis of the rotor, they are derivatives of motions against the ground."""
    way = (0.3, 0.5, 0.2)
    turn = PointVelocity((("rotor.top", np.array(way)),), angular=True)
    rates = Given("rates", tuple(Output(f"w{n}", "", turn, derivative=n) for n in (1, 2)))
    signals = (Encoder("x", "ground.top", "rotor.top", way), Accelerometer("a", "rotor.top", way))
    scene, spin = rigid_machine(-90.0, k=(4e5, 7e5), signals=signals)
    push = PointForce("push", "rotor.top", (1, 2, 0.5), "push")
    scene = replace(scene, actuators=(push,), springs=(*scene.springs, rates))
    frequency = np.array([3.0, 20.0, 90.0])
    found = frequency_response(linearize(scene, **spin, frame="stator"), frequency)
    x, a, angular, rate = (found.response(name, "push") for name in ("x", "a", "w1", "w2"))
    np.testing.assert_allclose(a, (2j * np.pi * frequency) ** 2 * x, rtol=1e-9)
    np.testing.assert_allclose(rate, 2j * np.pi * frequency * angular, rtol=1e-9)
