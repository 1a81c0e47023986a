"""Machines of which a part spins and a part stands: whirl against closed forms, own matrices and runs in time."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import make_bar

from nassim import (
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    Material,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    fixed,
    linearize,
    revolute,
    simulate,
)
from nassim.base.modal import decay_poles
from nassim.base.rigid_motion import axes_along, rigid_transfer, skew
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


def assert_among(expected, found, rtol):
    for pole in expected:
        nearest = found[np.argmin(np.abs(found - pole))]
        assert abs(nearest - pole) < rtol * abs(pole), (pole, nearest)


def seen_turning(poles, speed):
    """Of rotating vectors, as a frame that turns along sees them, with their conjugates."""
    moved = np.asarray(poles) - 1j * speed
    return np.concatenate([moved, moved.conj()])


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
@pytest.mark.parametrize("speed", [-150.0, 150.0, 600.0, 2000.0])
def test_an_overhung_disc_whirls(shaft, speed):
    """m, J of displacement and slope, - i Jp W of the slope's rate; critical speed near 350 rad/s."""
    poles = linearize(overhung(shaft, speed)).poles()
    expected = whirl([np.diag([2.0, 4e-3]), np.diag([0.0, -1j * 7.5e-3 * speed]), tip_stiffness(HALF)])
    assert_among(seen_turning(expected, speed), poles, 5e-3)
    # In the standing frame too, where a quarter of a per cent may be less of the pole.
    for pole in expected:
        assert np.abs(poles + 1j * speed - pole).min() < 5e-3 * abs(pole)


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
    for pole in (*bounce, *tilt):
        assert np.abs(model.poles() + 1j * speed - pole).min() < 5e-3 * abs(pole)
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


def housed(speed, seat=SEAT, drag=np.zeros(6)):
    """Matrices of displacement and slope of the housing with its hub, then of the disc, as rotating vectors."""
    lever = np.array([[1.0, HALF], [0.0, 1.0]])
    apart = np.hstack([-lever, np.eye(2)])
    foot = np.diag([1.0, 1.0, 0, 0])
    mass = np.diag([6.0, 9e-3, 2.0, 4e-3])
    gyro = -1j * speed * np.diag([0, 1e-3, 0, 7.5e-3])
    stiffness = apart.T @ tip_stiffness(HALF) @ apart + foot * [seat[0], seat[3], 0, 0]
    return mass, gyro + foot * [drag[0], drag[3], 0, 0], stiffness


@pytest.mark.filterwarnings("ignore:body ")
@pytest.mark.parametrize("speed", [-200.0, 700.0])
def test_a_spindle_whose_housing_stands_on_a_bushing(shaft, speed):
    """Whirl of shaft and housing together, and what the seat damps: it stands."""
    drag = 2e-3 * SEAT
    poles = linearize(overhung(shaft, speed, (SEAT, drag))).poles()
    for pole in whirl(housed(speed, drag=drag)):
        assert np.abs(poles + 1j * speed - pole).min() < 5e-3 * abs(pole)


POINT = np.array([0.3, -0.2, 0.1])
"""Of the axis along AXIS."""


def rigid_machine(speed, *, k=(4e5, 4e5), arms=3, wobble=0.0, transverse=0.03, turned=0.0, signals=()):
    """A rotor in two bearings of a foundation that stands on three legs, about an odd axis; no drive turns it."""
    axes = axes_along(AXIS)
    around = 2 * np.pi / arms * np.arange(arms)
    legs = {f"leg {j}": 0.2 * np.array([np.cos(t), np.sin(t), -0.3]) for j, t in enumerate(around)}
    bearings = {"low": np.array([0, 0, 0.05]), "high": np.array([0, 0, 0.25])}
    middle, centre = np.array([0.0, 0.0, -0.02]), np.array([0.0, 0.0, 0.12])
    places = {name: POINT + axes @ at for name, at in legs.items()}
    ground = RigidBody("ground", {**places, "top": POINT + 0.3 * AXIS}, fixed=True)
    inertia = axes @ np.diag([0.2, 0.2 * (1 + wobble), 0.3]) @ axes.T
    held = {name: axes @ (at - middle) for name, at in (legs | bearings).items()}
    foundation = RigidBody("foundation", held, 8.0, inertia, POINT + axes @ middle)
    spread = axes @ np.diag([transverse, transverse * (1 + turned), 0.045]) @ axes.T
    spots = {name: axes @ (at - centre) for name, at in bearings.items()}
    rotor = RigidBody(
        "rotor", {**spots, "top": 0.18 * AXIS, "rim": 0.1 * axes[:, 0]}, 3.0, spread, POINT + axes @ centre
    )
    feet = []
    for j, t in enumerate(around):
        turn = np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1.0]])
        figures = np.array([2e5, 3e5, 6e5, 200.0, 300.0, 150.0])
        feet.append(Bushing(f"leg {j}", f"ground.leg {j}", f"foundation.leg {j}", figures, 1e-4 * figures, axes @ turn))
    springs = [
        Bushing(
            name, f"foundation.{name}", f"rotor.{name}", [*k, 5e5, 0, 0, 0], 2e-4 * np.array([*k, 5e5, 0, 0, 0]), axes
        )
        for name in bearings
    ]
    scene = Scene("machine", (ground, foundation, rotor), springs=(*feet, *springs), sensors=signals, damping_ratio=0.0)
    return scene, {"angular_velocity": speed * AXIS, "axis_point": POINT, "standing": ("ground", "foundation")}


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


@pytest.mark.parametrize("speed", [-90.0, 40.0, 700.0])
@pytest.mark.parametrize(("k", "arms", "wobble"), [((4e5, 4e5), 3, 0.0), ((4e5, 7e5), 3, 0.0), ((4e5, 6e5), 2, 0.4)])
def test_a_rigid_rotor_in_the_standing_frame(speed, k, arms, wobble):
    """What stands may differ across the axis where what turns does not: equations of Newton and Euler."""
    scene, spin = rigid_machine(speed, k=k, arms=arms, wobble=wobble)
    found = linearize(scene, **spin, frame="standing").poles()
    assert_same_poles(found, own_poles(*own_matrices(speed, k, arms, wobble)))


@pytest.mark.parametrize("speed", [-90.0, 40.0, 700.0])
@pytest.mark.parametrize("arms", [3, 4])
def test_a_rigid_rotor_in_the_turning_frame(speed, arms):
    """The same equations as seen by what turns: u = R v per vector."""
    scene, spin = rigid_machine(speed, arms=arms)
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
    bodies = [
        replace(body, angular_velocity=(speed, 0, 0)) for body in scene.bodies[2:]
    ]  # not the housing, by reaction
    if kind == "rigid":
        bodies[1] = replace(bodies[1], fidelity="rigid")
    scene = replace(scene, bodies=(*scene.bodies[:2], *bodies))
    time = step * np.arange(2000)
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
        whirls = [expected[np.argmin(np.abs(expected - pole))] for pole in whirl(housed(speed, drag=drag))]
    else:
        whirls = [
            pole for pole in whirl(rigidly_housed(speed, drag)) if np.abs(expected - pole).min() < 1e-3 * abs(pole)
        ]
        assert len(whirls) == 4
    found = decay_poles(run.values[1:, 20:], step, n_poles=2 * len(whirls))
    swings = 2 / step * np.tan(np.abs(found.imag) * step / 2)  # the run's own steps lengthen periods
    for pole in whirls:
        assert np.abs(swings - abs(pole.imag)).min() < 5e-3 * abs(pole)


def rigidly_housed(speed, drag):
    """As `housed`, with a shaft that does not bend."""
    together = np.vstack([np.eye(2), [[1.0, HALF], [0.0, 1.0]]])
    mass, gyro, stiffness = (together.T @ m @ together for m in housed(speed, drag=drag))
    return mass, gyro, stiffness
