"""Damping of joints: against own equations of motion, in every position, and in linear models."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    cylindrical,
    describe,
    fixed,
    frequency_response,
    linearize,
    load,
    planar,
    prismatic,
    revolute,
    save,
    simulate,
    spherical,
    universal,
)

AXIS = np.array([2.0, -1.0, 2.0]) / 3
ACROSS = np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)
TIP = np.array([0.3, -0.2, 0.1])
INERTIA = np.array([[0.03, 0.004, -0.002], [0.004, 0.05, 0.003], [-0.002, 0.003, 0.04]])


def one_body(joint, sensors, actuators=(), **body):
    """A body of 2 kg on a joint to the ground."""
    ground = RigidBody("ground", {"pin": [0.1, 0.2, 0.3]}, fixed=True)
    options = {"inertia": INERTIA, "position": [0.1, 0.2, 0.3], **body}
    points = {"pin": np.array([0.1, 0.2, 0.3]) - options["position"], "tip": TIP}
    moving = RigidBody("body", points, 2.0, **options)
    return Scene("one", (ground, moving), (joint,), actuators, sensors, damping_ratio=0.0)


def run(scene, time, **signals):
    values = np.array(list(signals.values())).reshape(len(signals), len(time))
    history = TimeHistory(time, values, tuple(signals), ("",) * len(signals))
    options = {"start": "released", "spectral_radius": 0.95, "progress": False}
    return simulate(scene, history, time_step=time[1] - time[0], **options)


def test_a_damped_pendulum():
    """J theta'' = -m g l sin theta - c theta', from the horizontal through large angles."""
    down = np.cross(AXIS, ACROSS)
    centre = np.array([0.1, 0.2, 0.3]) + 0.4 * ACROSS
    joint = revolute("pin", "ground.pin", "body.pin", AXIS, damping=0.35)
    scene = one_body(joint, (AngleSensor("angle", "ground.pin", "body.pin", AXIS),), position=centre)
    scene = replace(scene, gravity=9.81 * down)
    time = np.arange(2001) * 1e-3
    inertia = AXIS @ INERTIA @ AXIS + 2.0 * 0.16

    def rate(_, y):
        return [y[1], (2.0 * 9.81 * 0.4 * np.cos(y[0]) - 0.35 * y[1]) / inertia]

    expected = scipy.integrate.solve_ivp(rate, (0, 2), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-12).y[0]
    assert expected.max() > 2.2
    np.testing.assert_allclose(run(scene, time)["angle"], expected, atol=4e-5)
    axis = ", ".join(f"{part:g}" for part in AXIS)
    assert f"pin: ground.pin to body.pin, turns about ({axis}); damping 0.35" in describe(scene)


def test_a_rotor_runs_down_through_many_turns():
    joint = cylindrical("pin", "ground.pin", "body.pin", AXIS, damping={"rz": 0.05})
    angle = AngleSensor("angle", "ground.pin", "body.pin", AXIS)
    spun = one_body(joint, (angle,), inertia=0.04 * np.eye(3), angular_velocity=40.0 * AXIS)
    time = np.arange(1501) * 1e-3
    expected = 40.0 * 0.04 / 0.05 * (1 - np.exp(-0.05 / 0.04 * time))
    assert expected.max() > 4 * np.pi
    np.testing.assert_allclose(run(spun, time)["angle"], expected, rtol=2e-4, atol=1e-6)


def test_a_damped_axle_between_two_wheels():
    """A torque on the first, on an axle without damping, drags the second along."""
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    first, second = (
        RigidBody(name, {"o": np.zeros(3)}, 1.0, own) for name, own in (("a", INERTIA), ("b", 2 * INERTIA))
    )
    axles = revolute("free", "ground.o", "a.o", AXIS), revolute("damped", "a.o", "b.o", AXIS, damping=0.3)
    torque, read = PointTorque("push", "a.o", AXIS, "torque"), AngleSensor("turn", "ground.o", "b.o", AXIS)
    scene = Scene("wheels", (ground, first, second), axles, (torque,), (read,), damping_ratio=0.0)
    inertia, s = AXIS @ INERTIA @ AXIS, 2j * np.pi * np.array([0.1, 1.0, 5.0])
    found = frequency_response(linearize(scene), s.imag / (2 * np.pi)).response("turn", "torque")
    expected = 0.3 / s / ((inertia * s + 0.3) * (2 * inertia * s + 0.3) - 0.3**2)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_damped_universal_joint():
    """Each arm with its own figure: q1 about the arm in the ground, q2 about the arm in the body, by Lagrange."""
    first, second = ACROSS, np.cross(AXIS, ACROSS)
    dampers = {"rx": 0.08, "ry": 0.2}
    joint = universal("pin", "ground.pin", "body.pin", first, second, damping=dampers)
    seen = tuple(Encoder(k, "ground.pin", "body.tip", k) for k in "xyz")
    start = 6.0 * first + 9.0 * second
    scene = one_body(joint, seen, angular_velocity=start)

    def matrices(q):
        """Turn of the body, and its angular velocity in its own axes per unit of the two rates."""
        turn = Rotation.from_rotvec(q[0] * first) * Rotation.from_rotvec(q[1] * second)
        return turn, np.column_stack([Rotation.from_rotvec(-q[1] * second).apply(first), second])

    def rate(_, y):
        q, v = y[:2], y[2:]
        _, rows = matrices(q)
        slope = (matrices([q[0], q[1] + 1e-6])[1] - matrices([q[0], q[1] - 1e-6])[1]) / 2e-6  # q1 leaves them alone
        spin, change = rows @ v, slope @ v * v[1]
        push = -rows.T @ (INERTIA @ change + np.cross(spin, INERTIA @ spin)) - np.array([0.08, 0.2]) * v
        return [*v, *np.linalg.solve(rows.T @ INERTIA @ rows, push)]

    time = np.arange(601) * 5e-4
    found = scipy.integrate.solve_ivp(rate, (0, 0.3), [0, 0, 6.0, 9.0], t_eval=time, rtol=1e-8, atol=1e-10).y
    assert np.abs(found[1]).max() > 0.8
    expected = np.array([matrices(q)[0].apply(TIP) - TIP for q in found[:2].T]).T
    np.testing.assert_allclose(run(scene, time).values, expected, atol=3e-5)


def test_a_damped_ball_joint():
    """Three figures about the ground's axes: J w' = -w x J w - R^T C R w in the body's."""
    joint = spherical("pin", "ground.pin", "body.pin", damping={"rx": 0.1, "ry": 0.02, "rz": 0.3})
    seen = tuple(Encoder(k, "ground.pin", "body.tip", k) for k in "xyz")
    scene = one_body(joint, seen, angular_velocity=[5.0, 12.0, -8.0])

    def rate(_, y):
        turn, spin = y[:9].reshape(3, 3), y[9:]
        moment = -turn.T @ np.diag([0.1, 0.02, 0.3]) @ turn @ spin
        slope = turn @ np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
        return [*slope.ravel(), *np.linalg.solve(INERTIA, moment - np.cross(spin, INERTIA @ spin))]

    time = np.arange(601) * 5e-4
    begin = [*np.eye(3).ravel(), 5.0, 12.0, -8.0]
    turns = scipy.integrate.solve_ivp(rate, (0, 0.3), begin, "DOP853", time, rtol=1e-9, atol=1e-11).y[:9]
    expected = np.einsum("ijn,j->in", turns.reshape(3, 3, -1), TIP) - TIP[:, None]
    np.testing.assert_allclose(run(scene, time).values, expected, atol=3e-5)


def test_a_damped_slide_on_an_arm_that_turns():
    """r'' = W^2 r - c r' / m along a slide that turns with its arm, far out."""
    along = np.cross(AXIS, [0.0, 0.6, 0.8])
    along /= np.linalg.norm(along)
    ground = RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    arm = RigidBody("arm", {"axle": np.zeros(3), "rail": 0.2 * along}, 1.0, INERTIA)
    load = RigidBody("load", {"seat": np.zeros(3)}, 0.8, 1e-4 * np.eye(3), 0.2 * along)
    scene = Scene(
        "arm",
        (ground, arm, load),
        (
            revolute("axle", "ground.axle", "arm.axle", AXIS, damping=0.7),
            prismatic("rail", "arm.rail", "load.seat", along, damping=4.0),
        ),
        (Drive("motor", "axle", "rz", speed=3.0),),
        (Encoder("r", "arm.rail", "load.seat", along, frame="arm.rail"),),
        damping_ratio=0.0,
    )
    time = np.arange(401) * 2e-3
    fast, slow = np.roots([1.0, 4.0 / 0.8, -9.0])
    expected = 0.2 * (fast * np.exp(slow * time) - slow * np.exp(fast * time)) / (fast - slow) - 0.2
    assert expected[-1] > 0.1
    np.testing.assert_allclose(run(scene, time)["r"], expected, atol=2e-5)
    spring = SpringDamper("spring", "arm.rail", "load.seat", along, 2000.0, frame="arm.rail")
    poles = linearize(replace(scene, springs=(spring,))).poles()
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(np.roots([0.8, 4.0, 2000.0 - 7.2])), rtol=1e-6)


def test_a_plane_and_a_slide_with_different_figures():
    """m x'' = F - c x' along each axis of a joint that stands askew."""
    joint = planar("pin", "ground.pin", "body.pin", AXIS, damping={"x": 3.0, "y": 9.0, "rz": 0.1})
    x, y = joint.axes[:, 0], joint.axes[:, 1]
    push = PointForce("push", "body.pin", 2 * x + y, "force")
    twist = PointTorque("twist", "body.pin", AXIS, "torque")
    sensors = (
        Encoder("x", "ground.pin", "body.pin", x),
        Encoder("y", "ground.pin", "body.pin", y),
        AngleSensor("angle", "ground.pin", "body.pin", AXIS),
    )
    scene = one_body(joint, sensors, (push, twist), inertia=0.04 * np.eye(3))
    time = np.arange(1001) * 1e-3
    step = np.ones(1001)
    found = run(scene, time, force=30.0 * step, torque=0.9 * step).values[2:]

    def moved(force, mass, damping):
        return force / damping * (time - mass / damping * (1 - np.exp(-damping / mass * time)))

    root = np.sqrt(5.0)
    expected = [moved(60 / root, 2.0, 3.0), moved(30 / root, 2.0, 9.0), moved(0.9, 0.04, 0.1)]
    assert expected[0][-1] > 1
    assert expected[2][-1] > np.pi
    np.testing.assert_allclose(found, expected, atol=2e-4)
    s = 2j * np.pi * 0.3
    a, b, c, d = linearize(scene).matrices
    linear = d + c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
    of_force = [2 / root / (2.0 * s**2 + 3.0 * s), 1 / root / (2.0 * s**2 + 9.0 * s), 0.0]
    np.testing.assert_allclose(linear, np.array([of_force, [0.0, 0.0, 1 / (0.04 * s**2 + 0.1 * s)]]).T, atol=1e-12)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_flexible_arm_on_a_damped_hinge(fidelity):
    """Linear model by the matrices of the body; exact steps and floating frames run as it does."""
    reduced = craig_bampton(lattice(stiffness=1e6), n_modes=2, progress=False)
    turn = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix()
    seat = turn @ reduced.point("left").position
    ground = RigidBody("ground", {"pin": seat}, fixed=True)
    damping = 2e-3
    scene = Scene(
        "arm",
        (ground, FlexibleBody("arm", reduced, rotation=turn, fidelity=fidelity)),
        (revolute("pin", "ground.pin", "arm.left", AXIS, damping=damping),),
        (PointForce("push", "arm.right", ACROSS, "force"),),
        (Encoder("tip", "ground.pin", "arm.right", ACROSS),),
        damping_ratio=0.0,
    )
    n, names = len(reduced.mass_matrix), list(reduced.point_names)
    left, right = 6 * names.index("left"), 6 * names.index("right")
    keep = np.zeros((n, n - 5))
    keep[left + 3 : left + 6, 0] = turn.T @ AXIS
    keep[np.r_[0:left, left + 6 : n], np.arange(1, n - 5)] = 1.0
    row = np.zeros(n)
    row[right : right + 3] = turn.T @ ACROSS
    for frequency in (3.0, 300.0):
        s = 2j * np.pi * frequency
        dynamic = keep.T @ (reduced.mass_matrix * s**2 + reduced.stiffness_matrix) @ keep
        dynamic[0, 0] += damping * s
        expected = row @ keep @ np.linalg.solve(dynamic, row @ keep)
        a, b, c, d = linearize(scene).matrices
        found = d + c @ np.linalg.solve(s * np.eye(len(a)) - a, b)
        np.testing.assert_allclose(found[0, 0], expected, rtol=1e-7)
    time = np.arange(401) * 2e-5
    force = 1e-4 * np.sin(np.pi * time / 4e-3) ** 2
    history = TimeHistory(time, force[None], ("force",), ("N",))
    twin = replace(scene, bodies=(ground, replace(scene.bodies[1], fidelity="linear")))
    exact = simulate(twin, history, time_step=2e-5, method="exact", progress=False)["tip"]
    found = simulate(scene, history, time_step=2e-5, progress=False)["tip"]
    np.testing.assert_allclose(found, exact, atol=2e-3 * np.abs(exact).max())


def test_figures_are_checked_and_kept(tmp_path):
    joint = universal("u", "a.o", "b.o", "x", "y", damping={"ry": 0.2})
    assert joint.damping == (0.0, 0.2)
    assert replace(joint, name="v").damping == (0.0, 0.2)
    assert replace(revolute("u", "a.o", "b.o"), free=()).damping == ()
    save(joint, tmp_path / "joint.h5")
    assert load(tmp_path / "joint.h5").damping == (0.0, 0.2)
    for make, message in (
        (lambda: fixed("f", "a.o", "b.o").__class__("f", "a.o", "b.o", damping=1.0), "free are none, got 1.0"),
        (lambda: cylindrical("f", "a.o", "b.o", damping=1.0), "free are z, rz, got 1.0"),
        (lambda: Joint("f", "a.o", "b.o", ("x",), damping=(1.0, 2.0)), "must be one figure where one direction is fre"),
        (lambda: revolute("f", "a.o", "b.o", damping={"z": 1.0}), "unknown free direction .* 'z'; known: rz"),
        (lambda: revolute("f", "a.o", "b.o", damping=-1.0), "damping of rz must not be negative, got -1 N m s/rad"),
        (lambda: prismatic("f", "a.o", "b.o", damping=np.inf), "NaN or infinite"),
        (lambda: revolute("f", "a.o", "b.o", damping="much"), "got 'much'"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
