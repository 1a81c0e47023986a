"""Starts in motion and released, joints that others imply: against closed forms and integrations by SciPy."""

import re
import warnings
from dataclasses import replace

import exudyn as exu
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from conftest import lattice, make_bar
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    build_fe_model,
    craig_bampton,
    revolute,
    simulate,
)
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.initial_velocities import has_free_rotation, initial_twists

OUTPUT = exu.OutputVariableType

LENGTH = 0.1
MASS = 7800 * LENGTH * 0.01**2
CROSSWISE = MASS * (LENGTH**2 + 0.01**2) / 12
"""Moment of inertia of the bar about its centre, across its axis."""
IDENTITY = np.eye(3)
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(build_fe_model(make_bar(), element_size=0.02, order=2, progress=False), progress=False)


def quiet(duration, time_step):
    time = np.arange(round(duration / time_step) + 1) * time_step
    return TimeHistory(time, np.zeros((0, len(time))), (), ())


def run(scene, duration, time_step, **options):
    return simulate(scene, quiet(duration, time_step), time_step=time_step, progress=False, **options)


def encoders(path):
    return tuple(Encoder(axis, "base.origin", path, axis) for axis in "xyz")


def base(**points):
    return RigidBody("base", {"origin": np.zeros(3), **points}, fixed=True)


def flag(position):
    """Hardly any mass, to read where a point of a flexible body is."""
    return RigidBody("flag", {"pole": np.zeros(3)}, 1e-6, 1e-12 * np.eye(3), position)


def swinging_bar(bar, fidelity, free, spin, turn=IDENTITY, frame=None):
    """A bar that a joint at the origin holds at its left end, with a flag at its right one."""
    body = FlexibleBody("bar", bar, rotation=turn, fidelity=fidelity, angular_velocity=spin, frame=frame)
    joints = (Joint("pin", "base.origin", "bar.left", free=free), Joint("mast", "bar.right", "flag.pole"))
    scene = Scene("swing", (base(), body, flag(turn @ [LENGTH, 0, 0])), joints, damping_ratio=0.0)
    return replace(scene, sensors=encoders("flag.pole"))


@pytest.mark.usefixtures("plain_steps")
@pytest.mark.parametrize(("fidelity", "frame"), [("rigid", None), ("ffrf", "left"), ("ffrf", "right")])
def test_a_pinned_bar_turns_as_asked(bar, fidelity, frame):
    """10 rad/s for 0.25 s: 2.5 rad, on a circle."""
    spin = np.array([0.0, -10.0, 0.0])
    record = run(swinging_bar(bar, fidelity, ("ry",), spin, frame=frame), 0.25, 5e-4)
    angle = 10.0 * record.time
    assert np.abs(record["x"] - LENGTH * (np.cos(angle) - 1)).max() < 2e-4 * LENGTH
    assert np.abs(record["z"] - LENGTH * np.sin(angle)).max() < 2e-4 * LENGTH
    assert np.abs(record["y"]).max() < 1e-9


@pytest.mark.parametrize("fidelity", ["rigid", "ffrf"])
def test_a_turned_bar_on_a_ball_follows_eulers_equations(bar, fidelity):
    """Any axis, unequal inertias: the rate in the bar's axes by SciPy, and from it the path of its end."""
    spin = np.array([3.0, -6.0, 5.0])
    record = run(swinging_bar(bar, fidelity, ("rx", "ry", "rz"), spin, TURN), 0.2, 2.5e-4)
    inertia = np.diag([MASS * 0.01**2 / 6, *[CROSSWISE + MASS * LENGTH**2 / 4] * 2])

    def rate(_t, state):
        turn, omega = state[:9].reshape(3, 3), state[9:]
        turning = turn @ np.cross(np.eye(3), omega).T.T
        return np.hstack([turning.ravel(), np.linalg.solve(inertia, np.cross(inertia @ omega, omega))])

    start = np.hstack([TURN.ravel(), TURN.T @ spin])
    found = scipy.integrate.solve_ivp(rate, (0, 0.2), start, t_eval=record.time, rtol=1e-10, atol=1e-12)
    path = LENGTH * found.y[:9:3] - LENGTH * TURN[:, :1]
    assert np.abs(path).max() > LENGTH
    assert np.abs(record.values - path).max() < 2e-4 * LENGTH


@pytest.mark.parametrize("fidelity", ["rigid", "ffrf"])
def test_double_pendulum_started_by_one_of_its_arms(bar, fidelity):
    """In the plane, no weight; the second arm starts as the blow on its hinge throws it."""
    mass, inertia, arm = 0.2, 3e-4, 0.04
    spin = np.array([0.0, -12.0, 0.0])
    joints = (
        Joint("pin", "base.origin", "bar.left", free="ry"),
        Joint("elbow", "bar.right", "second.hinge", free="ry"),
    )
    points = {"hinge": (0, 0, arm), "end": (0, 0, -arm)}
    second = RigidBody("second", points, mass, np.diag([1e-4, inertia, 2e-4]), (LENGTH, 0, -arm))
    body = FlexibleBody("bar", bar, fidelity=fidelity, angular_velocity=spin)
    scene = Scene("double", (base(), body, second), joints, damping_ratio=0.0, sensors=encoders("second.end"))
    record = run(scene, 0.2, 5e-4, spectral_radius=0.9)

    # Angles against the x axis, towards z; the second arm starts at -90 degrees.
    first_inertia = CROSSWISE + MASS * LENGTH**2 / 4 + mass * LENGTH**2

    def rate(_t, state):
        a, b, da, db = state
        coupling = mass * LENGTH * arm
        matrix = [[first_inertia, coupling * np.cos(a - b)], [coupling * np.cos(a - b), inertia + mass * arm**2]]
        return [da, db, *np.linalg.solve(matrix, coupling * np.sin(a - b) * np.array([-(db**2), da**2]))]

    # Velocity of the hinge is along z, along the second arm, so the blow does not turn it.
    start = [0.0, -np.pi / 2, 12.0, 0.0]
    found = scipy.integrate.solve_ivp(rate, (0, 0.2), start, t_eval=record.time, rtol=1e-10, atol=1e-12)
    a, b = found.y[:2]
    assert np.ptp(b) > 1.0
    assert np.abs(record["x"] - (LENGTH * np.cos(a) + 2 * arm * np.cos(b) - LENGTH)).max() < 1e-3 * LENGTH
    assert np.abs(record["z"] - (LENGTH * np.sin(a) + 2 * arm * np.sin(b) + 2 * arm)).max() < 1e-3 * LENGTH


def test_a_jointed_free_body_is_thrown_as_by_a_blow(bar):
    """In line with the bar: the blow J at the hinge has rate arm / 2 = J (1 / m1 + 1 / m2 + c^2 / I)."""
    mass, inertia, arm, spin = 0.2, 3e-4, 0.04, 7.0
    second = RigidBody("second", {"hinge": (-arm, 0, 0)}, mass, inertia * np.eye(3), (LENGTH + arm, 0, 0))
    body = FlexibleBody("bar", bar, angular_velocity=np.array([0, 0, spin]))
    scene = Scene("thrown", (body, second), (Joint("hinge", "bar.right", "second.hinge", free="rz"),))
    twists = initial_twists(scene)
    blow = spin * LENGTH / 2 / (1 / MASS + 1 / mass + arm**2 / inertia)
    assert np.allclose(twists["bar"][3:], [0, 0, spin], rtol=1e-12)
    assert np.allclose(twists["second"][3:], [0, 0, -blow * arm / inertia], rtol=1e-9)
    middle = twists["bar"][1] + spin * LENGTH / 2
    assert middle == pytest.approx(-blow / MASS, rel=1e-9)
    assert twists["second"][1] + twists["second"][5] * (LENGTH + arm) == pytest.approx(blow / mass, rel=1e-9)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_turned_body_is_thrown_by_its_inertia(bar, fidelity):
    """The blow at a ball joint takes both points there to one velocity; the second body's inertia over its masses."""
    model, spin = lattice(), np.array([2.0, -5.0, 7.0])
    block = craig_bampton(model, n_modes=1, progress=False)
    hinge = np.array([LENGTH, 0, 0])
    place = hinge - TURN @ block.point("left").position
    second = FlexibleBody("second", block, place, TURN, fidelity=fidelity)
    body = FlexibleBody("bar", bar, angular_velocity=spin)
    joint = Joint("ball", "bar.right", "second.left", free=("rx", "ry", "rz"))
    scene = Scene("thrown", (body, second), (joint,))
    twists = initial_twists(scene)

    masses = model.scalar_mass_matrix.diagonal()
    spots = place + model.fields[1:].T @ TURN.T
    centre = masses @ spots / masses.sum()
    arms = np.cross(np.eye(3)[:, None], spots - centre)  # velocities by a turn about each axis
    inertia = np.einsum("n,ina,jna->ij", masses, arms, arms)
    arm = np.cross(np.eye(3), hinge - centre)
    yielding = np.eye(3) * (1 / MASS + 1 / masses.sum()) + arm.T @ np.linalg.solve(inertia, arm)
    blow = np.linalg.solve(yielding, np.cross(spin, hinge / 2))
    assert np.allclose(twists["bar"][3:], spin, rtol=1e-12)
    rate = np.linalg.solve(inertia, np.cross(hinge - centre, blow))
    assert np.allclose(twists["second"][3:], rate, rtol=1e-6, atol=1e-6 * np.abs(rate).max())
    velocity = twists["second"][:3] + np.cross(rate, centre)
    assert np.allclose(velocity, blow / masses.sum(), atol=1e-6 * np.abs(velocity).max())

    system = build_system(assemble(scene))
    nodes = system.flexible["second"].nodes[:2] if fidelity == "linear" else [(system.nodes["second"], 6)]
    for (node, _), point in zip(nodes, block.point_names, strict=False):
        found = [system.mbs.GetNodeOutput(node, kind) for kind in (OUTPUT.Velocity, OUTPUT.AngularVelocity)]
        moves = blow / masses.sum() + np.cross(rate, second.point_position(point) - centre)
        assert np.allclose(found, [moves, rate], atol=1e-6 * np.abs(rate).max())


def test_a_free_body_turns_about_its_centre_of_mass(bar):
    twist = initial_twists(Scene("free", (FlexibleBody("bar", bar, angular_velocity=np.array([1.0, 2.0, 3.0])),)))
    assert np.allclose(twist["bar"][:3] + np.cross([1, 2, 3], [LENGTH / 2, 0, 0]), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("free", "spin", "left"),
    [
        ((), [0, 0, 9.0], "(0, 0, 0)"),
        (("rz",), [0, 4.0, 9.0], "(0, 0, 9)"),
        (("x",), [3.0, 4.0, 9.0], "(0, 0, 0)"),
    ],
)
def test_a_turn_that_joints_do_not_allow_is_refused(bar, free, spin, left):
    with pytest.raises(ValueError, match=rf"'bar' cannot start to turn at .* leave {re.escape(left)} rad/s"):
        run(swinging_bar(bar, "ffrf", free, np.array(spin)), 0.01, 1e-3)


def test_three_bodies_start_with_a_spin_each():
    """On ball joints: their spins are as asked, points there have one velocity, and nothing moves on the whole."""
    random, bodies = np.random.default_rng(2), []
    for k in range(3):
        place, p, q = random.normal(size=(3, 3))
        if bodies:
            p = bodies[-1].position + bodies[-1].points["q"] - place
        inertia = TURN @ np.diag([1.0, 1.5, 2.0]) @ TURN.T
        spin = random.normal(size=3)
        bodies.append(RigidBody(f"b{k}", {"p": p, "q": q}, 1.0 + k, inertia, place, angular_velocity=spin))
    joints = tuple(Joint(f"j{k}", f"b{k}.q", f"b{k + 1}.p", free=("rx", "ry", "rz")) for k in range(2))
    twists = initial_twists(Scene("chain", tuple(bodies), joints))
    velocity = [twists[b.name][:3] + np.cross(b.angular_velocity, b.position) for b in bodies]
    for body in bodies:
        np.testing.assert_allclose(twists[body.name][3:], body.angular_velocity, rtol=1e-10)
    for a, b, u, v in zip(bodies, bodies[1:], velocity, velocity[1:], strict=False):
        before, after = np.cross(a.angular_velocity, a.points["q"]), np.cross(b.angular_velocity, b.points["p"])
        np.testing.assert_allclose(u + before, v + after, atol=1e-10)
    np.testing.assert_allclose(sum(b.mass * v for b, v in zip(bodies, velocity, strict=True)), 0.0, atol=1e-10)


@pytest.mark.parametrize("free", [[0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 0]], ids=["friction", "bearing"])
@pytest.mark.parametrize("order", [1, -1])
def test_what_lets_a_rotor_turn_does_not_tie_it_to_its_stator(free, order):
    """A foundation on springs stays at rest, and a wheel on a shaft's springs turns with the shaft."""
    axis, place = TURN[:, 2], np.array([0.3, -0.2, 0.1])
    spots = {name: place + height * axis for name, height in (("seat", 0.0), ("spindle", 0.1), ("wheel", 0.2))}
    bodies = [base(foot=place - 0.1 * axis, bearing=spots["wheel"])]
    bodies += [RigidBody(name, {"c": (0, 0, 0)}, 2.0, 0.01 * IDENTITY, spot) for name, spot in spots.items()]
    bodies[1] = replace(bodies[1], points={"c": (0, 0, 0), "hub": 0.1 * axis})
    springs = [
        Bushing("feet", "base.foot", "seat.c", np.full(6, 1e5)),
        Bushing("shaft", "spindle.c", "wheel.c", np.full(6, 1e5)),
        Bushing("bearing", "base.bearing", "wheel.c", 1e4 * np.array(free), axes=TURN),
    ]
    joint = revolute("axle", *("seat.hub", "spindle.c")[::order], axis, damping=0.3)
    scene = Scene("rotor", bodies, (joint,), (Drive("motor", "axle", speed=7.0),), springs=springs[: 2 + any(free)])
    for name, twist in initial_twists(scene).items():
        speed = order * 7.0 * (name != "seat")
        np.testing.assert_allclose(twist, [*np.cross(place, speed * axis), *(speed * axis)], atol=1e-9)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_of_several_spins_the_one_that_a_hinge_does_not_allow_is_named(place):
    """Beside free bodies, wherever it stands among them."""
    bodies = [
        RigidBody(name, {"c": (0, 0, 0)}, 1.0, IDENTITY, angular_velocity=spin)
        for name, spin in (("one", (1.0, 2, 3)), ("two", (-3.0, 2, 5)))
    ]
    bodies.insert(place, RigidBody("hung", {"c": (0, 0, 0)}, 1.0, IDENTITY, angular_velocity=(0, 4.0, 9.0)))
    scene = Scene("three", (base(), *bodies), (Joint("hinge", "base.origin", "hung.c", free="rz"),))
    told = r"'hung' cannot start to turn at \(0, 4, 9\) .* leave \(0, 0, 9\) rad/s, .* differs by 4;"
    with pytest.raises(ValueError, match=told):
        initial_twists(scene)


@pytest.mark.parametrize(("rate", "told"), [(400.0, True), (40.0, False)])
def test_a_body_that_is_taken_along_is_told_of_its_spin(bar, rate, told):
    """A bar of 817 Hz bolted to one that is asked to turn, at 64 and 6.4 Hz."""
    second = FlexibleBody("second", bar, position=(LENGTH, 0, 0))
    scene = Scene(
        "two",
        (FlexibleBody("bar", bar, fidelity="rigid", angular_velocity=(0, 0, rate)), second),
        (Joint("bolt", "bar.right", "second.left"),),
        damping_ratio=0.0,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run(scene, 1e-4, 1e-5, spectral_radius=0.8)
    assert sum(f"'second' turns at {rate / 2 / np.pi:.3g} Hz" in str(w.message) for w in caught) == told, "once"


def in_a_slot(bar, fidelity):
    """A bar pinned at its left end; its right end, free to turn, may move in a slot across the bar."""
    body = FlexibleBody("bar", bar, fidelity=fidelity, angular_velocity=np.array([0, 0, 1.0]))
    joints = (
        Joint("pin", "base.origin", "bar.left", free="rz"),
        Joint("slot", "base.slot", "bar.right", free=("y", "rz")),
    )
    return Scene("locked", (base(slot=[LENGTH, 0, 0]), body), joints, damping_ratio=0.0)


def test_a_bar_locked_in_a_slot_is_refused(bar):
    """Along the bar the slot's hold is the pin's, to first order only: a circle is no straight line."""
    with pytest.raises(ValueError, match="joint 'slot': at the start other joints imply what it holds along x, but"):
        run(in_a_slot(bar, "rigid"), 0.1, 1e-3)


@pytest.mark.filterwarnings("ignore:the strain of body 'bar' depends on the point")
def test_a_bar_that_stretches_lets_two_guides_that_are_one_move(bar):
    """Across the bar, which a rigid one would lock: the block and a third of the bar's mass are pushed."""
    block = RigidBody("block", {"end": np.zeros(3), "other": (0, 0, 0.05)}, 0.2, 1e-4 * IDENTITY, (LENGTH, 0, 0))
    ground = base(low=(LENGTH, 0, 0), high=(LENGTH, 0, 0.05))
    joints = (
        Joint("pin", "base.origin", "bar.left", free=("ry", "rz")),
        Joint("end", "bar.right", "block.end", free=("rx", "ry", "rz")),
        Joint("one", "base.low", "block.end", free="y"),
        Joint("two", "base.high", "block.other", free="y"),
    )
    push, sensor = PointForce("push", "block.end", "y", "push"), Encoder("y", "base.low", "block.end", "y")
    scene = Scene("guided", (ground, FlexibleBody("bar", bar), block), joints, (push,), (sensor,))
    time = 1e-3 * np.arange(11)
    force = TimeHistory(time, np.full((1, 11), 0.5), ("push",), ("N",))
    found = simulate(scene, force, time_step=1e-3, progress=False, start="released")["y"][-1]
    assert found == pytest.approx(0.5 * 0.5 / (0.2 + CROSSWISE / LENGTH**2 + MASS / 4) * 0.01**2, rel=0.01)


def door(bar, second):
    """A bar on two hinges in line, the second of which holds what is given."""
    low, high = np.array([0.02, 0.03, 0.0]), np.array([0.02, 0.03, 0.05])
    leaf = RigidBody("leaf", {"low": low, "high": high, "edge": (0.1, 0.03, 0)}, 1.0, np.diag([1e-3, 2e-3, 3e-3]))
    weight = FlexibleBody("bar", bar, position=(0.1, 0.03, 0), fidelity="rigid", angular_velocity=(0, 0, 4.0))
    joints = (
        Joint("first", "base.low", "leaf.low", free="rz"),
        Joint("second", "base.high", "leaf.high", free=second),
        Joint("bolt", "leaf.edge", "bar.left"),
    )
    scene = Scene("door", (base(low=low, high=high), leaf, weight), joints, damping_ratio=0.0)
    return replace(scene, sensors=encoders("leaf.edge"))


@pytest.mark.parametrize("second", [("rz",), ("z", "rz"), ("rx", "ry", "rz")])
def test_two_hinges_in_line_are_one(bar, second):
    record = run(door(bar, second), 0.4, 1e-3)
    angle = 4.0 * record.time
    assert np.abs(record["x"] - 0.08 * (np.cos(angle) - 1)).max() < 2e-4 * 0.08
    assert np.abs(record["y"] - 0.08 * np.sin(angle)).max() < 2e-4 * 0.08


@pytest.mark.parametrize(("turned", "locks"), [(0.0, False), (0.25 * np.pi, True)])
def test_turns_that_joints_hold_alike_at_the_start_only(turned, locks):
    """Two universal joints at one centre: with arms along the same axes they are one, with other arms they lock."""
    post = RigidBody("post", {"o": np.zeros(3)}, fixed=True)
    block = RigidBody("block", {"o": np.zeros(3)}, 0.5, 1e-3 * np.diag([2.0, 3.0, 4.0]))
    axes = Rotation.from_rotvec([0, 0, turned]).as_matrix()
    tilt = Rotation.from_rotvec([0.4, -0.3, 0.8]).as_matrix()
    joints = (
        Joint("one", "post.o", "block.o", ("rx", "ry"), tilt),
        Joint("two", "post.o", "block.o", ("rx", "ry"), tilt @ axes),
    )
    scene = Scene("cross", (post, block), joints, gravity=(0.0, 0.0, -9.81))
    if locks:
        with pytest.raises(ValueError, match="joint 'two': at the start other joints imply what it holds along rz"):
            run(scene, 0.01, 1e-3)
    else:
        run(scene, 0.01, 1e-3)


def four_bar(bar, coupler=0.25):
    """Two cranks of one length, hinged to the ground and a coupler: over-constrained in space, with one freedom."""
    far = np.array([coupler, 0, 0])
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    crank = FlexibleBody("crank", bar, rotation=turn, fidelity="rigid", angular_velocity=(0, 0, -3.0))
    follower = RigidBody(
        "follower", {"low": (0, -0.05, 0), "high": (0, 0.05, 0)}, 0.1, 1e-4 * np.eye(3), (*far[:1], 0.05, 0)
    )
    ends = {"left": (-coupler / 2, 0, 0), "right": (coupler / 2, 0, 0)}
    rod = RigidBody("rod", ends, 0.3, 2e-3 * np.eye(3), (coupler / 2, LENGTH, 0))
    joints = (
        Joint("a", "base.origin", "crank.left", free="rz"),
        Joint("b", "base.far", "follower.low", free="rz"),
        Joint("c", "crank.right", "rod.left", free="rz"),
        Joint("d", "follower.high", "rod.right", free="rz"),
    )
    scene = Scene("four-bar", (base(far=far), crank, follower, rod), joints, damping_ratio=0.0)
    return replace(scene, sensors=encoders("rod.right"))


def test_a_closed_linkage_of_rigid_bodies_moves(bar):
    """A parallelogram turns evenly: its coupler goes round without turning."""
    record = run(four_bar(bar), 0.5, 1e-3)
    angle = 3.0 * record.time
    assert np.abs(record["x"] - LENGTH * np.sin(angle)).max() < 2e-4 * LENGTH
    assert np.abs(record["y"] - LENGTH * (np.cos(angle) - 1)).max() < 2e-4 * LENGTH
    assert np.abs(record["z"]).max() < 1e-9


def test_a_third_crank_of_a_parallelogram_is_redundant_in_motion_too(bar):
    """In the plane it holds one direction too many at the start, and in every other position."""
    scene = four_bar(bar)
    at = np.array([0.08, 0, 0])
    third = RigidBody("third", {"low": (0, -0.05, 0), "high": (0, 0.05, 0)}, 0.1, 1e-4 * np.eye(3), (at[0], 0.05, 0))
    ground, crank, follower, rod = scene.bodies
    ground = replace(ground, points={**ground.points, "middle": at})
    rod = replace(rod, points={**rod.points, "middle": np.array([at[0], LENGTH, 0]) - rod.position})
    joints = (
        *scene.joints,
        Joint("e", "base.middle", "third.low", free="rz"),
        Joint("f", "third.high", "rod.middle", free="rz"),
    )
    record = run(replace(scene, bodies=(ground, crank, follower, rod, third), joints=joints), 0.3, 1e-3)
    assert np.abs(record["x"] - LENGTH * np.sin(3.0 * record.time)).max() < 2e-4 * LENGTH


GRAVITY = np.array([0.0, 0.0, -9.81])


def pendulum(bar, fidelity, angle):
    """The bar on a hinge at the origin, hanging at an angle [rad] against the vertical, with a flag at its end."""
    turn = Rotation.from_euler("y", np.pi / 2 + angle).as_matrix()
    return replace(swinging_bar(bar, fidelity, ("ry",), np.zeros(3), turn), gravity=GRAVITY)


def swing(angle, time):
    """theta'' = -(m g l / 2) / I sin(theta) from rest, by SciPy."""
    inertia = CROSSWISE + MASS * LENGTH**2 / 4

    def rate(_t, state):
        return [state[1], -MASS * 9.81 * LENGTH / 2 / inertia * np.sin(state[0])]

    found = scipy.integrate.solve_ivp(rate, (0, time[-1]), [angle, 0.0], t_eval=time, rtol=1e-10, atol=1e-12).y[0]
    assert np.ptp(found) > 1.5 * abs(angle)
    return found


@pytest.mark.parametrize(("fidelity", "angle"), [("rigid", 0.5), ("ffrf", -2.0)])
def test_a_released_pendulum_swings(bar, fidelity, angle):
    record = run(pendulum(bar, fidelity, angle), 0.4, 5e-4, start="released", spectral_radius=0.9)
    found = swing(angle, record.time)
    assert np.abs(record["x"] + LENGTH * (np.sin(found) - np.sin(angle))).max() < 1e-3 * LENGTH
    assert np.abs(record["z"] + LENGTH * (np.cos(found) - np.cos(angle))).max() < 1e-3 * LENGTH


def test_a_pendulum_swings_beside_a_body_in_small_motion(bar):
    """A bar that is clamped to the same base, along x, keeps the floating one from no large motion."""
    scene = pendulum(bar, "ffrf", -2.0)
    beside = FlexibleBody("beside", bar, fidelity="linear")
    clamp = Joint("clamp", "base.origin", "beside.left")
    scene = replace(scene, bodies=(*scene.bodies, beside), joints=(*scene.joints, clamp))
    record = run(scene, 0.4, 1e-3, start="released", spectral_radius=0.8)
    found = swing(-2.0, record.time)
    assert np.abs(record["x"] + LENGTH * (np.sin(found) - np.sin(-2.0))).max() < 5e-3 * LENGTH
    assert np.abs(record["z"] + LENGTH * (np.cos(found) - np.cos(-2.0))).max() < 5e-3 * LENGTH


def test_a_pendulum_out_of_equilibrium_needs_a_choice(bar):
    with pytest.raises(RuntimeError, match=r'no static equilibrium.*start="released"'):
        run(pendulum(bar, "rigid", np.pi / 2), 0.1, 1e-3)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        record = run(pendulum(bar, "ffrf", 0.5), 0.1, 1e-3)
    message = r"'bar' turned by 0\.5 rad from its reference configuration.*start=\"released\""
    assert [bool(re.search(message, str(warning.message))) for warning in told] == [True]
    assert record["z"][0] == pytest.approx(LENGTH * (np.cos(0.5) - 1), rel=1e-3)
    assert np.ptp(record["z"]) < 1e-6 * LENGTH
    with pytest.raises(ValueError, match="unknown start 'rest'; known: equilibrium, released"):
        run(pendulum(bar, "rigid", 0.5), 0.1, 1e-3, start="rest")


def sliding(bar, fidelity, mass=0.5):
    """The bar on a slide along x, flat, with a block at its end that a force pushes."""
    body = FlexibleBody("bar", bar, fidelity=fidelity)
    block = RigidBody("block", {"hook": (-0.01, 0, 0)}, mass, 1e-4 * np.eye(3), (LENGTH + 0.01, 0, 0))
    joints = (
        Joint("slide", "base.origin", "bar.left", free="x"),
        Joint("bolt", "bar.right", "block.hook"),
    )
    push = PointForce("push", "block.hook", "x", "force")
    scene = Scene("slide", (base(), body, block), joints, (push,), encoders("block.hook"), damping_ratio=0.0)
    return replace(scene, gravity=GRAVITY)


@pytest.mark.parametrize(
    ("fidelity", "method"),
    [
        ("rigid", "generalized_alpha"),
        ("ffrf", "generalized_alpha"),
        ("linear", "generalized_alpha"),
        ("linear", "exact"),
    ],
)
def test_a_block_free_to_slide_rests_and_can_be_pushed(bar, fidelity, method):
    """Neutral equilibrium: sagging by the weight, then x = F t^2 / 2 m."""
    mass, force, time = 0.5, 0.02, np.arange(401) * 5e-4
    both = TimeHistory(time, np.full((1, 401), force), ("force",), ("N",))
    record = simulate(sliding(bar, fidelity), both, time_step=5e-4, method=method, progress=False)
    expected = 0.5 * force / (MASS + mass) * time**2
    assert np.abs(record["x"] - record["x"][0] - expected).max() < 1e-3 * expected[-1]
    modulus, area_moment = 200e9, 0.01**4 / 12
    tip, uniform = mass * 9.81, MASS * 9.81 / LENGTH
    sag = (tip * LENGTH**3 / 3 + tip * 0.01 * LENGTH**2 / 2 + uniform * LENGTH**4 / 8) / (modulus * area_moment)
    assert record["z"][0] == pytest.approx(0.0 if fidelity == "rigid" else -sag, rel=0.02, abs=1e-15)
    assert np.ptp(record["z"]) < 1e-3 * sag


MASS_ON_SPRING, SPRING = 2.0, 5e5


def sprung(bar, damping):
    """A mass on a relaxed spring, also free to fall sideways; beside it a flexible body, for the method."""
    body = RigidBody("mass", {"c": np.zeros(3)}, MASS_ON_SPRING, 1e-2 * np.eye(3))
    beside = FlexibleBody("beside", bar, position=(1, 0, 0), fidelity="linear")
    return Scene(
        "sprung",
        (base(side=(1.0, 0, 0)), body, beside),
        (Joint("guide", "base.origin", "mass.c", free=("x", "z")), Joint("held", "base.side", "beside.left")),
        sensors=encoders("mass.c"),
        springs=(SpringDamper("spring", "base.origin", "mass.c", "z", SPRING, damping),),
        damping_ratio=0.0,
        gravity=np.array([3.0, 0.0, -9.81]),
        cutoff_frequency=3e3,
    )


def test_explicit_steps_end_at_the_pole_of_a_heavy_damper(bar):
    """2 kg on 2e6 N s/m fall back at 1e6 1/s, beyond all modes; accelerations are those before an input changes."""
    scene = sprung(bar, 1e6 * MASS_ON_SPRING)
    assert np.ptp(run(scene, 2.5e-4, 2.5e-6, method="explicit", start="released")["z"]) < 1e-8
    with pytest.raises(ValueError, match=r"limit of 2\.6e-06 s"):
        run(scene, 2.7e-4, 2.7e-6, method="explicit", start="released")
    felt = replace(scene, sensors=(Accelerometer("felt", "mass.c"),))
    with pytest.raises(ValueError, match="accelerations before an input changes, so output 'felt'"):
        run(felt, 2.5e-4, 2.5e-6, method="explicit", start="released")


@pytest.mark.parametrize(("method", "step"), [("exact", 1e-4), ("generalized_alpha", 2e-5), ("explicit", 4e-6)])
@pytest.mark.parametrize("damping", [0.0, 80.0])
def test_a_released_spring_overshoots_its_sag(bar, method, step, damping):
    """A mass on a relaxed spring, let go."""
    mass, stiffness = MASS_ON_SPRING, SPRING
    record = run(sprung(bar, damping), 0.02, step, method=method, start="released")
    sag, decay, time = mass * 9.81 / stiffness, damping / (2 * mass), record.time
    omega = np.sqrt(stiffness / mass - decay**2)
    expected = -sag * (1 - np.exp(-decay * time) * (np.cos(omega * time) + decay / omega * np.sin(omega * time)))
    assert expected.min() < -1.5 * sag
    assert np.abs(record["z"] - expected).max() < 1e-3 * sag
    assert np.allclose(record["x"], 1.5 * record.time**2, rtol=1e-3, atol=1e-9)


def test_dampers_bear_nothing_in_the_equilibrium_from_which_a_body_starts_to_turn():
    """An arm on a spiral spring sags under its weight; its angular velocity neither shifts the sag nor changes."""
    turn = TURN
    axis, spiral, speed = turn[:, 2], np.diag([0, 0, 0, 0, 0, 20.0]), 2.0
    ground = RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    points, inertia = {"axle": [-0.2, 0, 0], "tip": [0.1, 0.05, 0]}, np.diag([1e-3, 1e-2, 1e-2])
    arm = RigidBody("arm", points, 1.0, inertia, 0.2 * turn[:, 0], rotation=turn, angular_velocity=speed * axis)
    scene = Scene(
        "arm",
        (ground, arm),
        (revolute("axle", "ground.axle", "arm.axle", axis, damping=1.0),),
        sensors=(AngleSensor("angle", "ground.axle", "arm.axle", axis), Vibrometer("fast", "arm.tip", turn[:, 1])),
        springs=(Bushing("spiral", "ground.axle", "arm.axle", spiral, 0.1 * spiral, turn),),
        gravity=-30.0 * turn[:, 1],
        damping_ratio=0.0,
    )
    record = simulate(scene, None, time_step=1e-4, duration=1e-3, progress=False)
    sag = scipy.optimize.brentq(lambda angle: 20.0 * angle + 0.2 * 30.0 * np.cos(angle), -1.0, 0.0)
    assert record["angle"][0] == pytest.approx(sag, rel=1e-7)
    assert record["fast"][0] == pytest.approx(speed * (0.3 * np.cos(sag) - 0.05 * np.sin(sag)), rel=1e-7)


def test_one_body_that_can_turn_is_enough_for_a_radius_that_holds_for_turns():
    """A wheel beside a sled, whichever is listed first."""
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    sled, wheel = (RigidBody(name, {"o": np.zeros(3)}, 1.0, np.eye(3)) for name in ("sled", "wheel"))
    slide, hinge = Joint("slide", "ground.o", "sled.o", "x"), revolute("hinge", "ground.o", "wheel.o", "z")
    scenes = [
        Scene("sled", (ground, *bodies), joints)
        for bodies, joints in (((sled, wheel), (slide, hinge)), ((wheel, sled), (hinge, slide)), ((sled,), (slide,)))
    ]
    assert [has_free_rotation(scene) for scene in scenes] == [True, True, False]
    time = np.arange(41) * 1e-3
    kick = TimeHistory(time, np.sin(np.pi * np.minimum(time / 0.02, 1.0))[None], ("push",), ("N",))
    for scene, radius in zip(scenes, (0.9, 0.9, 1.0), strict=True):
        sprung = replace(
            scene,
            actuators=(PointForce("push", "sled.o", "x", "push"),),
            springs=(SpringDamper("spring", "ground.o", "sled.o", "x", 4e4),),
            sensors=(Encoder("x", "ground.o", "sled.o", "x"),),
        )
        usual, same, other = (
            simulate(sprung, kick, time_step=1e-3, progress=False, **given)["x"]
            for given in ({}, {"spectral_radius": radius}, {"spectral_radius": 1.9 - radius})
        )
        np.testing.assert_array_equal(usual, same)
        assert np.abs(usual - other).max() > 1e-6 * np.abs(usual).max()
