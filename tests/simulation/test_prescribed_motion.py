"""Drives that follow inputs, in small motion: against closed forms and assemblies of the tests' own."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Controller,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    linearize,
    prismatic,
    revolute,
    simulate,
    spherical,
    static_response,
)
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.terms import Output
from nassim.simulation import exudyn_eigenfrequencies, linearize_closed

AXIS = np.array([2.0, -1.0, 2.0]) / 3
TURN = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix()
RATIO = 0.02


def transfer(model, frequency):
    """Outputs per input, (outputs, inputs), at a frequency [Hz]."""
    a, b, c, d = model.matrices
    return d + c @ np.linalg.solve(2j * np.pi * frequency * np.eye(len(a)) - a, b)


def shaker(stiffness=900.0, damping=2.5, **drive):
    """A payload of 0.7 kg on a spring on a driven slide along an odd axis."""
    base = RigidBody("base", {"rail": np.zeros(3)}, fixed=True)
    inertia = np.diag([1e-3, 2e-3, 2.5e-3])
    sledge = RigidBody("sledge", {"rail": np.zeros(3), "seat": np.zeros(3)}, 3.0, inertia)
    load = RigidBody("load", {"seat": np.zeros(3)}, 0.7, inertia)
    return Scene(
        "shaker",
        (base, sledge, load),
        (prismatic("rail", "base.rail", "sledge.rail", AXIS), prismatic("seat", "sledge.seat", "load.seat", AXIS)),
        (Drive("shaker", "rail", "z", "way", **drive),),
        (Encoder("load", "base.rail", "load.seat", AXIS), Encoder("sledge", "base.rail", "sledge.rail", AXIS)),
        (SpringDamper("spring", "sledge.seat", "load.seat", AXIS, stiffness, damping, frame="sledge.seat"),),
        damping_ratio=0.0,
    )


@pytest.mark.parametrize("frequency", [0.5, 5.7, 40.0])
def test_transmissibility_of_a_payload_on_a_shaken_base(frequency):
    s = 2j * np.pi * frequency
    model = linearize(shaker())
    assert len(model.A) == 2  # the sledge moves as it is told
    found = transfer(model, frequency)
    np.testing.assert_allclose(found[:, 0], [(2.5 * s + 900) / (0.7 * s**2 + 2.5 * s + 900), 1.0], rtol=1e-9)
    lag = transfer(linearize(shaker(bandwidth=8.0)), frequency)
    np.testing.assert_allclose(lag, found / (1 + 1j * frequency / 8.0), rtol=1e-9)


def test_a_damper_alone_drags_what_floats():
    """A free payload, which no spring holds: c / (m s + c)."""
    s = 2j * np.pi * 0.8
    np.testing.assert_allclose(transfer(linearize(shaker(0.0, 2.5)), 0.8)[0, 0], 2.5 / (0.7 * s + 2.5), rtol=1e-9)


@pytest.fixture(scope="module")
def reduced():
    return craig_bampton(lattice(stiffness=1e6), n_modes=3, progress=False)


def cantilever(reduced, turns, fidelity="linear", **drive):
    """A turned flexible body clamped to a table that is driven along or about an odd axis, off its clamp."""
    base = RigidBody("base", {"axle": [0.01, 0.02, -0.03]}, fixed=True)
    left = TURN @ reduced.point("left").position
    points = {"axle": [-0.01, 0.0, 0.0], "seat": left - [0.02, 0.02, -0.03]}
    table = RigidBody("table", points, 0.5, 1e-4 * np.diag([1.0, 2.0, 2.5]), [0.02, 0.02, -0.03])
    body = FlexibleBody("body", reduced, rotation=TURN, fidelity=fidelity)
    joint = (revolute if turns else prismatic)("drive", "base.axle", "table.axle", AXIS)
    return Scene(
        "cantilever",
        (base, table, body),
        (joint, Joint("clamp", "table.seat", "body.left")),
        (Drive("drive", "drive", "rz" if turns else "z", "input", **drive),),
        tuple(Encoder(a, "base.axle", "body.right", a) for a in "xyz"),
        damping_ratio=RATIO,
    )


def own_assembly(reduced, turns):
    """Frequencies of the clamped body, how the drive's acceleration pushes its modes, the tip's motion by both.

    From the body's matrices alone: rigid motion with the table, and clamped modes beside it.
    """
    names = list(reduced.point_names)
    n, clamp, tip = len(reduced.mass_matrix), 6 * names.index("left"), 6 * names.index("right")
    rigid = np.zeros(n)
    for k, name in enumerate(names):
        arm = TURN @ reduced.point(name).position - [0.01, 0.02, -0.03]
        motion = [np.cross(AXIS, arm), AXIS] if turns else [AXIS, np.zeros(3)]
        rigid[6 * k : 6 * k + 6] = np.concatenate([TURN.T @ v for v in motion])
    inner = np.r_[0:clamp, clamp + 6 : n]
    mass, stiffness = reduced.mass_matrix, reduced.stiffness_matrix
    values, shapes = scipy.linalg.eigh(stiffness[np.ix_(inner, inner)], mass[np.ix_(inner, inner)])
    pushes = -shapes.T @ (mass @ rigid)[inner]
    place = list(inner).index(tip)
    return np.sqrt(values), pushes, TURN @ rigid[tip : tip + 3], TURN @ shapes[place : place + 3]


@pytest.mark.parametrize("turns", [False, True])
def test_a_driven_cantilever_against_an_own_assembly(reduced, turns):
    omega, pushes, rigid, rows = own_assembly(reduced, turns)
    model = linearize(cantilever(reduced, turns))
    assert len(model.A) == 2 * len(omega)
    np.testing.assert_allclose(np.sort(np.abs(model.poles()))[::2], omega, rtol=1e-7)
    for frequency in np.array([0.3 * omega[0], 1.01 * omega[0], 0.97 * omega[3]]) / (2 * np.pi):
        s = 2j * np.pi * frequency
        expected = rigid + rows @ (pushes * s**2 / (s**2 + 2 * RATIO * omega * s + omega**2))
        np.testing.assert_allclose(transfer(model, frequency)[:, 0], expected, rtol=1e-7, atol=1e-9)


def history(time, **signals):
    return TimeHistory(time, np.array(list(signals.values())), tuple(signals), ("",) * len(signals))


@pytest.mark.usefixtures("plain_steps")
@pytest.mark.parametrize("turns", [False, True])
def test_a_driven_cantilever_in_time(reduced, turns):
    """In small motion to the integrator's error, in floating frames to the motion's smallness."""
    omega, pushes, rigid, rows = own_assembly(reduced, turns)
    step = 2 * np.pi / omega[0] / 200
    time = np.arange(401) * step
    w = omega[0] / 2.3
    way = 1e-5 * np.sin(w * time) ** 4
    push = 1e-5 * w**2 * (12 * np.sin(w * time) ** 2 * np.cos(w * time) ** 2 - 4 * np.sin(w * time) ** 4)
    expected = np.outer(rigid, way)
    for k, frequency in enumerate(omega):
        system = ([[0, 1], [-(frequency**2), -2 * RATIO * frequency]], [[0], [pushes[k]]], [[1, 0]], [[0]])
        fine = np.linspace(0, time[-1], 4 * 400 + 1)
        _, answer, _ = scipy.signal.lsim(system, np.interp(fine, time, push), fine)
        expected += np.outer(rows[:, k], answer[::4])
    bent = np.abs(expected - np.outer(rigid, way)).max()
    assert bent > 1e-7
    scene, excitation = cantilever(reduced, turns), history(time, input=way)
    exact = simulate(scene, excitation, time_step=step, method="exact", progress=False).values[1:]
    np.testing.assert_allclose(exact, expected, atol=2e-3 * bent)
    stepped = simulate(scene, excitation, time_step=step, progress=False).values[1:]
    np.testing.assert_allclose(stepped, exact, atol=2e-3 * bent)
    floating = cantilever(reduced, turns, "ffrf")
    large = simulate(floating, excitation, time_step=step, progress=False).values[1:]
    np.testing.assert_allclose(large, exact, atol=2e-3 * bent)
    np.testing.assert_allclose(large, stepped, atol=1e-4 * bent)


FIRM = np.diag([3e5, 2e5, 4e5, 60.0, 80.0, 50.0])
VISCOUS = np.diag([30.0, 50.0, 20.0, 4e-3, 3e-3, 8e-3])
HELD = Rotation.from_rotvec([-0.4, 0.3, 0.9]).as_matrix()


def squeezed(reduced, fidelity="linear", damping=None, **changes):
    """A turned flexible body on a bushing at one end, whose other end a drive moves: following strains it."""
    right = TURN @ reduced.point("right").position
    base = RigidBody("base", {"seat": TURN @ reduced.point("left").position, "rail": right}, fixed=True)
    table = RigidBody("table", {"rail": np.zeros(3), "seat": np.zeros(3)}, 0.02, 1e-6 * np.diag([1.0, 2.0, 2.5]), right)
    bushing = Bushing("bushing", "base.seat", "body.left", FIRM, np.zeros(6) if damping is None else damping, HELD)
    return Scene(
        "squeezed",
        (base, table, FlexibleBody("body", reduced, rotation=TURN, fidelity=fidelity, frame="left")),
        (prismatic("rail", "base.rail", "table.rail", AXIS), Joint("clamp", "table.seat", "body.right")),
        (Drive("drive", "rail", "z", "way"),),
        tuple(Encoder(a, "base.seat", "body.left", a) for a in "xyz"),
        (bushing,),
        **{"damping_ratio": 0.0, **changes},
    )


def saddle(reduced, frequency, *, viscous, proportional):
    """Motion of the left end per unit of the drive's, along the world's axes, (3,), from the body's matrices alone."""
    names = list(reduced.point_names)
    n, left, right = len(reduced.mass_matrix), 6 * names.index("left"), 6 * names.index("right")
    to_world = np.kron(np.eye(2), TURN)
    held = np.kron(np.eye(2), HELD)
    rows = np.zeros((6, n))
    rows[:, left : left + 6] = held.T @ to_world
    stiffness = reduced.stiffness_matrix + rows.T @ FIRM @ rows
    s = 2j * np.pi * frequency
    dynamic = reduced.mass_matrix * s**2 + stiffness * (1 + proportional * s) + s * rows.T @ viscous @ rows
    motion = to_world.T @ np.concatenate([AXIS, np.zeros(3)])
    inner = np.r_[0:right, right + 6 : n]
    answer = np.linalg.solve(dynamic[np.ix_(inner, inner)], -dynamic[inner, right : right + 6] @ motion)
    place = list(inner).index(left)
    return TURN @ answer[place : place + 3]


def test_following_that_strains_and_dampers_in_it(reduced):
    model = linearize(squeezed(reduced, damping=VISCOUS))
    first = np.abs(model.poles()).min() / (2 * np.pi)
    for frequency in np.array([0.2, 0.98, 3.3]) * first:
        expected = saddle(reduced, frequency, viscous=VISCOUS, proportional=0.0)
        np.testing.assert_allclose(transfer(model, frequency)[:, 0], expected, rtol=1e-7, atol=1e-9)


def test_ratios_of_modes_damp_what_strains_beside_the_quasi_static_following(reduced):
    """Ratios in proportion to the frequencies are a damping in proportion to the stiffness, drives or not."""
    omega = np.sort(np.abs(linearize(squeezed(reduced)).poles()))[::2]
    share = 1.9 / omega[-1]
    scene = squeezed(reduced, damping_ratio=share * omega / 2)
    for frequency in np.array([0.2, 0.98, 3.3]) * omega[0] / (2 * np.pi):
        expected = saddle(reduced, frequency, viscous=np.zeros((6, 6)), proportional=share)
        np.testing.assert_allclose(transfer(linearize(scene), frequency)[:, 0], expected, rtol=1e-7, atol=1e-9)


@pytest.mark.usefixtures("plain_steps")
def test_following_that_strains_in_time(reduced):
    """Small motion stepped and exact, and floating frames, with the same damping of modes and bodies."""
    omega = np.sort(np.abs(linearize(squeezed(reduced)).poles()))[::2]
    step = 2 * np.pi / omega[0] / 100
    time = np.arange(301) * step
    excitation = history(time, way=1e-6 * np.sin(omega[0] / 2.3 * time) ** 4)
    plain = squeezed(reduced, damping=VISCOUS)
    hinged = replace(
        plain,
        joints=(*plain.joints, spherical("hinge", "base.seat", "body.left")),
        springs=(),
        sensors=tuple(AngleSensor(a, "base.seat", "body.left", a) for a in "xyz"),
        damping_ratio=0.05,
    )
    damped = (*plain.bodies[:2], replace(plain.bodies[2], damping_ratio=0.1))
    for scene in (hinged, replace(plain, bodies=damped)):
        runs = [simulate(scene, excitation, time_step=step, method="exact", progress=False).values[1:]]
        runs.append(simulate(scene, excitation, time_step=step, progress=False).values[1:])
        floating = [replace(body, fidelity="ffrf") if body.name == "body" else body for body in scene.bodies]
        runs.append(simulate(replace(scene, bodies=floating), excitation, time_step=step, progress=False).values[1:])
        moved = np.abs(runs[0]).max()
        np.testing.assert_allclose(runs[1], runs[0], atol=2e-3 * moved)
        np.testing.assert_allclose(runs[2], runs[1], atol=1e-4 * moved)


@pytest.mark.parametrize("trimmed", [False, True])
def test_static_following(reduced, trimmed):
    scene = squeezed(reduced, cutoff_frequency=5e3 if trimmed else None)
    expected = saddle(reduced, 0.0, viscous=VISCOUS, proportional=0.0) * 1e-6
    np.testing.assert_allclose(list(static_response(scene, {"way": 1e-6}).values()), expected, rtol=1e-6)
    heavy = replace(scene, gravity=[3.0, 0.0, -9.81])
    rest, moved = (np.array(list(static_response(heavy, {"way": way}).values())) for way in (0.0, 1e-6))
    model = linearize(heavy)
    way = model.inputs.index("way")
    expected = (model.D - model.C @ np.linalg.solve(model.A, model.B))[:, way] * 1e-6
    np.testing.assert_allclose(moved - rest, expected, rtol=1e-7)
    assert np.any(rest)


def test_a_driven_slide_on_a_spinning_table():
    """v'' + c v' + (k - W^2) v = -2 W u', of a unit mass on a spring across a driven slide on a turntable."""
    speed, stiffness, damping = 0.7, 2.0, 0.05
    along = np.array([0.6, 0.0, 0.8])
    axes = np.column_stack([along, np.cross(AXIS, along), AXIS])
    axes[:, 0] = np.cross(axes[:, 1], AXIS)
    axes /= np.linalg.norm(axes, axis=0)
    light = 1e-6 * np.diag([1.0, 1.0, 1.5])
    ground = RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    table = RigidBody("table", {"axle": np.zeros(3)}, 1.0, np.diag([1.0, 1.0, 1.5]))
    slide = RigidBody("slide", {"rail": np.zeros(3)}, 1e-6, light)
    mass = RigidBody("mass", {"seat": np.zeros(3)}, 1.0, light)
    scene = Scene(
        "platform",
        (ground, table, slide, mass),
        (
            revolute("spindle", "ground.axle", "table.axle", AXIS),
            Joint("u", "table.axle", "slide.rail", ("x",), axes),
            Joint("v", "slide.rail", "mass.seat", ("x", "y"), axes),
        ),
        (Drive("spindle", "spindle", "rz", speed=speed), Drive("slide", "u", "x", "way")),
        (
            Encoder("u", "table.axle", "mass.seat", axes[:, 0], frame="table.axle"),
            Encoder("v", "table.axle", "mass.seat", axes[:, 1], frame="table.axle"),
        ),
        tuple(
            SpringDamper(f"spring {k}", "slide.rail", "mass.seat", axes[:, k], stiffness, damping, frame="slide.rail")
            for k in range(2)
        ),
        damping_ratio=0.0,
    )
    s = 0.9j
    own, cross = s**2 + damping * s + stiffness - speed**2, 2 * speed * s
    expected = np.linalg.solve([[own, -cross], [cross, own]], [damping * s + stiffness, 0.0])
    np.testing.assert_allclose(transfer(linearize(scene), 0.9 / (2 * np.pi))[:, 0], expected, rtol=1e-4)
    stuck = replace(scene, joints=(*scene.joints[:2], Joint("v", "slide.rail", "mass.seat", ("y",), axes)))
    expected = [1.0, -cross / own]
    np.testing.assert_allclose(transfer(linearize(stuck), 0.9 / (2 * np.pi))[:, 0], expected, rtol=1e-4)


def test_a_servo_in_every_engine(reduced):
    omega, *_ = own_assembly(reduced, True)
    step = 2 * np.pi / omega[0] / 100
    scene = cantilever(reduced, True, bandwidth=0.3 * omega[0] / (2 * np.pi))
    time = np.arange(301) * step
    excitation = history(time, input=1e-5 * np.sin(omega[0] / 2.3 * time) ** 2)
    model = linearize(scene).matrices
    expected = scipy.signal.lsim(model, excitation.values[0], time)[1].T
    exact = simulate(scene, excitation, time_step=step, method="exact", progress=False).values[1:]
    np.testing.assert_allclose(exact, expected, atol=1e-9 * np.abs(expected).max())
    for fidelity in ("linear", "ffrf"):
        scene = cantilever(reduced, True, fidelity, bandwidth=0.3 * omega[0] / (2 * np.pi))
        stepped = simulate(scene, excitation, time_step=step, progress=False).values[1:]
        np.testing.assert_allclose(stepped, exact, atol=2e-3 * np.abs(exact).max())
    held = cantilever(reduced, True)
    assert np.abs(simulate(held, excitation, time_step=step, progress=False).values[1:] - exact).max() > 1e-6


def test_velocities_of_what_follows_at_once_are_refused():
    """The sledge's velocity is the input's derivative; the payload's holds it through the damper at most."""

    @dataclass(frozen=True)
    class Rate(Sensor):
        point: str
        derivative: int
        sign: float = 1.0

        def terms(self, scene):
            way = Displacement(((self.point, self.sign * AXIS),))
            return (Output(self.name, "", way, derivative=self.derivative),)

    def seen(point, derivative, damping=2.5, **drive):
        return linearize(replace(shaker(damping=damping, **drive), sensors=(Rate("seen", point, derivative),)))

    s = 2j * np.pi * 5.0
    payload = (2.5 * s + 900) / (0.7 * s**2 + 2.5 * s + 900)
    np.testing.assert_allclose(transfer(seen("load.seat", 1), 5.0), s * payload, rtol=1e-9)
    free = 900 * s**2 / (0.7 * s**2 + 900)
    np.testing.assert_allclose(transfer(seen("load.seat", 2, damping=0.0), 5.0), free, rtol=1e-9)
    with pytest.raises(
        ValueError, match=r"'seen' reads a velocity that follows a derivative of input 'way' at once.*give the"
    ):
        seen("sledge.seat", 1)
    with pytest.raises(
        ValueError, match=r"'seen' reads an acceleration that follows a derivative of input 'way'.*give the"
    ):
        seen("load.seat", 2)
    with pytest.raises(
        ValueError, match=r"'seen' reads an acceleration .*bandwidth, of first order, smooths velocities"
    ):
        seen("sledge.seat", 2, bandwidth=8.0)
    against, push = Rate("seen", "load.seat", 2, -1.0), PointForce("push", "load.seat", AXIS, "force")
    pushed = replace(shaker(), sensors=(against,), actuators=(push, *shaker().actuators))
    with pytest.raises(ValueError, match="a derivative of input 'way' at once"):
        linearize(pushed)
    lag = 1 / (1 + 5.0j / 8.0)
    np.testing.assert_allclose(transfer(seen("sledge.seat", 1, bandwidth=8.0), 5.0), s * lag, rtol=1e-9)
    found = transfer(seen("load.seat", 2, bandwidth=8.0), 5.0)
    np.testing.assert_allclose(found, s**2 * payload * lag, rtol=1e-9)


def test_a_loop_that_commands_a_drive(reduced):
    """Active isolation of a shaken tip: the sampled closed model, exact steps, and the stepped engines."""
    omega, *_ = own_assembly(reduced, False)
    rate = 20 * omega[0] / (2 * np.pi)
    gain = Controller([[0.9]], [[0.1]], [[-0.8]], [[-0.1]], rate, delay=1)
    time = np.arange(81) / rate
    excitation = history(time, input=1e-6 * np.sin(omega[0] / 2.3 * time) ** 2)

    def scene(fidelity, **drive):
        plain = cantilever(reduced, False, fidelity, **drive)
        return replace(plain, loops=(Loop("iso", gain, "x", "input"),))

    lag = {"bandwidth": 2 * omega[0] / (2 * np.pi)}
    a, b, c, d = linearize_closed(scene("linear", **lag)).matrices
    state, expected = np.zeros(len(a)), []
    for u in excitation.values[0]:
        expected.append(c @ state + d[:, 0] * u)
        state = a @ state + b[:, 0] * u
    options = {"method": "exact", "hold_order": 0}
    exact = simulate(scene("linear", **lag), excitation, time_step=1 / rate, progress=False, **options)
    np.testing.assert_allclose(exact.values[1:4].T, np.array(expected)[:, :3], atol=1e-9 * np.abs(expected).max())
    fine = simulate(scene("linear", **lag), excitation, time_step=0.2 / rate, method="exact", progress=False)
    alone = simulate(cantilever(reduced, False, **lag), excitation, time_step=0.2 / rate, progress=False)
    assert np.abs(alone["x"] - fine["x"]).max() > 0.05 * np.abs(fine["x"]).max()
    for fidelity in ("linear", "ffrf"):
        found = simulate(scene(fidelity, **lag), excitation, time_step=0.2 / rate, progress=False)
        np.testing.assert_allclose(found.values[1:], fine.values[1:], atol=5e-3 * np.abs(fine.values[1:]).max())
    for method in ("exact", "generalized_alpha"):
        with pytest.raises(ValueError, match="give the sensor, amplifier or drive a bandwidth"):
            simulate(scene("linear"), excitation, time_step=1 / rate, method=method, progress=False)


def test_what_small_motion_cannot_do_with_drives(reduced):
    time = np.arange(101) * 1e-6
    scene = cantilever(reduced, False)
    with pytest.raises(ValueError, match='method "explicit" cannot let joints follow inputs; take another'):
        simulate(scene, history(time, input=0 * time), time_step=1e-6, method="explicit", progress=False)
    for method in ("exact", "generalized_alpha"):
        with pytest.raises(ValueError, match=r"it must start at 0, not at 1 m"):
            simulate(scene, history(time, input=0 * time + 1), time_step=1e-6, method=method, progress=False)
    run = history(np.arange(101) * 1e-2, input=np.linspace(0, 0.05, 101))
    with pytest.warns(UserWarning, match="turned by up to 0.046 rad, where small motion is wrong"):
        simulate(cantilever(reduced, True), run, time_step=1e-2, method="exact", progress=False)
    still = exudyn_eigenfrequencies(scene)
    np.testing.assert_allclose(still, own_assembly(reduced, False)[0] / (2 * np.pi), rtol=1e-6)
