"""How bodies move, kept in a run: against what the sensors of that run read, integrations by hand and each other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import lattice, turned_by
from newton_euler import integrate, wrench
from scipy.spatial.transform import Rotation

from nassim import (
    Bushing,
    Controller,
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
    simulate,
    simulate_motion,
    trim_scene,
)
from nassim.bodies import trim_body
from nassim.scene import Drive, point_motion
from nassim.scene.joints import prismatic, revolute, spherical
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.terms import Output, OutputFilter
from nassim.simulation import mode_motion, scene_modes, traced
from nassim.simulation.model.recorded_motion import recorded_steps

TILT, ODD = turned_by(0.4, -1.0, 0.3), turned_by(-0.7, 0.2, 1.9)
TOWARDS = {"one": (1.0, -0.4, 0.3), "other": (0.2, 0.9, -0.7), "third": (-0.5, 0.1, 0.8)}
INERTIA = turned_by(0.3, 0.5, -0.2) @ np.diag([2e-3, 3e-3, 4e-3]) @ turned_by(0.3, 0.5, -0.2).T
FEW = np.array([0.0, 3e-4, 7e-4, 2.3e-3, 1.11e-2, 1.57e-2, 2e-2])
"""Times of frames [s], unevenly spread."""


@pytest.fixture(scope="module")
def soft():
    return craig_bampton(lattice(stiffness=1e6), n_modes=5, progress=False)


def at(time, **pushes):
    return TimeHistory(time, np.array(list(pushes.values())).reshape(-1, len(time)), tuple(pushes), ())


@pytest.fixture(scope="module")
def soft_end(soft):
    """The same with a free end, whose motion is all in modal coordinates."""
    return trim_body(soft, points=["left"], loads=np.zeros((len(soft.mass_matrix), 0)), cutoff_frequency=1e5)


def tower(body, fidelities, upper=None, **options):
    """Two flexible bodies at odd angles with a rigid one between them; the end of the upper one is free."""
    left, right = body.point("left").position, body.point("right").position
    foot, seat = np.array([0.01, -0.02, 0.015]), np.array([-0.01, 0.02, 0.02])
    place = TILT @ (right - left) - ODD @ foot
    bodies = (
        RigidBody("base", {"o": np.zeros(3)}, fixed=True),
        FlexibleBody("lower", body, -TILT @ left, TILT, fidelity=fidelities[0]),
        RigidBody("middle", {"foot": foot, "seat": seat}, 0.3, 0.1 * INERTIA, place, rotation=ODD),
        FlexibleBody("upper", upper or body, place + ODD @ seat - left, fidelity=fidelities[1]),
    )
    joints = (
        Joint("a", "base.o", "lower.left"),
        Joint("b", "lower.right", "middle.foot"),
        Joint("c", "middle.seat", "upper.left"),
    )
    actuators = PointForce("f", "upper.right", TOWARDS["other"], "f"), PointForce("g", "middle.seat", "x", "g")
    points = "lower.right", "middle.seat", "upper.left", "upper.right"
    sensors = tuple(
        Encoder(f"{point} {name}", "base.o", point, axis) for point in points for name, axis in TOWARDS.items()
    )
    return Scene("tower", bodies, joints, actuators, sensors, **{"gravity": [0.5, -2.0, -4.0], **options})


def read(scene, motion, encoder):
    """What an encoder reads of the bodies' motion: its distance now less that as drawn."""
    (a, _), (b, _) = (point_motion(scene, motion, path) for path in (encoder.a, encoder.b))
    axis = np.asarray(encoder.axis) / np.linalg.norm(encoder.axis)
    return (b - a) @ axis - (scene.point_position(encoder.b) - scene.point_position(encoder.a)) @ axis


def check_sensors(scene, record, motion, *, within):
    """All encoders, at all frames, within a share of the largest reading."""
    places = np.searchsorted(record.time, motion.time - 1e-9)
    np.testing.assert_allclose(record.time[places], motion.time, atol=1e-12)
    encoders = [sensor for sensor in scene.sensors if isinstance(sensor, Encoder)]
    largest = max(np.abs(record[e.name]).max() for e in encoders)
    for encoder in encoders:
        expected = record[encoder.name][places]
        np.testing.assert_allclose(read(scene, motion, encoder), expected, rtol=0, atol=within * largest)
    return largest


def run_tower(scene, frames=FEW, **options):
    time = np.arange(201) * 1e-4
    pushes = {"f": 0.02 * np.sin(2 * np.pi * 190 * time), "g": 0.1 - 0.1 * np.cos(2 * np.pi * 80 * time)}
    options = {"time_step": 1e-4, **options}
    return simulate_motion(scene, at(time, **pushes), frames=frames, progress=False, **options)


SMALL = {"exact": {"method": "exact"}, "implicit": {}, "explicit": {"method": "explicit", "time_step": 2e-5}}
SMALL["held"] = {"method": "exact", "hold_order": 0}
SMALL["fine"] = {"method": "exact", "time_step": 1.25e-6}


@pytest.mark.parametrize("upper", ["linear", "rigid"])
@pytest.mark.parametrize(("method", "cutoff"), zip(SMALL, (1000.0, None, 1000.0, None, None), strict=True))
def test_small_motion_is_what_encoders_read(soft, soft_end, method, cutoff, upper):
    """Also of bodies of which less is modelled. The first frame sags; a rigid body's turn is kept as a finite one."""
    scene = tower(soft, ("linear", upper), soft_end, cutoff_frequency=cutoff)
    record, motion = run_tower(scene, **SMALL[method])
    np.testing.assert_allclose(motion.time, FEW, atol=1e-12)
    largest = check_sensors(scene, record, motion, within=1e-4)
    assert np.abs([record[e.name][0] for e in scene.sensors]).max() > 0.1 * largest > 1e-7
    assert set(motion.positions) == {"base", "lower", "middle", "upper"}
    for body in (scene.bodies[0], *scene.flexible_bodies):  # whose frames stay
        np.testing.assert_array_equal(motion.positions[body.name][-1], body.position)
        np.testing.assert_array_equal(motion.rotations[body.name][-1], body.rotation)


@pytest.mark.parametrize(
    ("lower", "upper", "cutoff"),
    [("ffrf", "ffrf", None), ("linear", "ffrf", 1000.0), ("ffrf", "linear", 1000.0), ("ffrf", "rigid", None)],
)
def test_motion_in_floating_frames_is_what_encoders_read(soft, soft_end, lower, upper, cutoff):
    scene = tower(soft, (lower, upper), soft_end, cutoff_frequency=cutoff)
    record, motion = run_tower(scene)
    check_sensors(scene, record, motion, within=1e-9)
    moves = np.ptp(motion.positions["upper"], axis=0).max()
    assert moves == 0 if upper == "linear" else moves > 1e-8


def test_parts_trimmed_before_may_remember_what_they_were(soft):
    """Motion of the machine as it was drawn with whole bodies, told by one that was trimmed."""
    whole = tower(soft, ("linear", "linear"))
    trimmed = trim_scene(traced(replace(whole, cutoff_frequency=1000.0)))
    n = len(soft.mass_matrix)
    assert all(len(body.reduced.mass_matrix) < n for body in trimmed.flexible_bodies)
    record, motion = run_tower(trimmed, method="exact")
    assert {rows.shape[1] for rows in motion.coordinates.values()} == {n}
    check_sensors(whole, record, motion, within=1e-4)
    base, lower, middle, upper = trimmed.bodies
    bodies = base, replace(lower, fidelity="ffrf"), middle, replace(upper, fidelity="rigid")
    _, motion = run_tower(replace(trimmed, bodies=bodies))
    assert {rows.shape for rows in motion.coordinates.values()} == {(len(FEW), n)}
    assert not motion.coordinates["upper"].any()


def test_methods_agree_on_all_points_of_a_surface(soft):
    """Wherever a frame rides: of any field of displacements, here that of a mode and the motions of its points."""
    runs = {
        "exact": (("linear", "linear"), {"method": "exact"}),
        "implicit": (("linear", "linear"), {}),
        "floating": (("ffrf", "ffrf"), {}),
        "mixed": (("ffrf", "linear"), {}),
        "trimmed": (("linear", "linear"), {"method": "exact"}),
    }
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 0.03, (20, 3))
    n = len(soft.mass_matrix)
    # Fields that hold the rigid motions exactly, as every body's surface does, and any others beside.
    rigid = np.concatenate(
        [np.tile(np.eye(3), (20, 1, 1)), -np.cross(points[:, None], np.eye(3)).swapaxes(1, 2)], axis=2
    )
    motions = np.zeros((n, 6))
    for k, point in enumerate(soft.remote_points):
        motions[6 * k : 6 * k + 3, :3] = motions[6 * k + 3 : 6 * k + 6, 3:] = np.eye(3)
        motions[6 * k : 6 * k + 3, 3:] = -np.cross(point.position, np.eye(3)).T
    modes = rng.standard_normal((20, 3, n)) * np.repeat([0.3, 1e-3], [12, n - 12])
    modes += (rigid - modes @ motions) @ np.linalg.pinv(motions)
    np.testing.assert_allclose(modes @ motions, rigid, atol=1e-12)
    found = {}
    for name, (kinds, options) in runs.items():
        cutoff = 1300.0 if name == "trimmed" else None
        scene = tower(soft, kinds, cutoff_frequency=cutoff, gravity=np.zeros(3))
        _, motion = run_tower(scene, **options)
        shapes = points + np.einsum("pik,nk->npi", modes, motion.coordinates["upper"])
        turned = np.einsum("nij,npj->npi", motion.rotations["upper"], shapes)
        found[name] = turned + motion.positions["upper"][:, None]
    size = np.abs(found["exact"] - found["exact"][0]).max()
    for name, places in found.items():
        np.testing.assert_allclose(places, found["exact"], atol=(2e-2 if name == "trimmed" else 2e-3) * size)


@dataclass(frozen=True)
class SlowSensor(Sensor):
    """Displacement of a point along x, through a low-pass of 500 Hz."""

    name: str
    point: str

    def terms(self, scene):
        row = Displacement(((self.point, np.eye(3)[0]),))
        return Output(self.name, "m", row), OutputFilter(self.name, "low", 500.0)


def follower(body, delay, **converters):
    """A weight on a spring is measured, and a slide with a beam on it follows that by a stiff motor."""
    left = body.point("left").position
    bodies = (
        RigidBody("base", {"o": np.zeros(3), "p": (0.0, 0.2, 0.0)}, fixed=True),
        RigidBody("slide", {"c": np.zeros(3)}, 0.4, INERTIA, rotation=ODD),
        FlexibleBody("beam", body, -TILT @ left, TILT, fidelity="linear"),
        RigidBody("weight", {"c": np.zeros(3)}, 0.5, INERTIA, (0.0, 0.2, 0.0)),
    )
    axis = TOWARDS["one"]
    joints = (
        prismatic("guide", "base.o", "slide.c", axis),
        Joint("seat", "slide.c", "beam.left"),
        prismatic("other", "base.p", "weight.c", "x"),
    )
    actuators = Drive("motor", "guide", "z", "where"), PointForce("push", "weight.c", "x", "f")
    sensors = (
        SlowSensor("weight", "weight.c"),
        Encoder("slide", "base.o", "slide.c", axis),
        Encoder("tip", "base.o", "beam.right", axis),
    )
    springs = (SpringDamper("spring", "base.p", "weight.c", "x", 2e4, 5.0),)
    control = Controller([[0.3]], [[1.0]], [[0.5]], [[0.2]], 2500.0, delay=delay)
    loop = Loop("follow", control, "weight", "where", **converters)
    return Scene("follower", bodies, joints, actuators, sensors, springs, (loop,), damping_ratio=0.01)


@pytest.mark.parametrize(("delay", "converters"), [(0, {}), (1, {"output_step": 1e-6}), (0, {"input_limit": 1e-5})])
def test_what_a_loop_moves_at_once_moves(soft, delay, converters):
    """Steps of a command are displacements here, which no state of the scene holds."""
    time = np.arange(201) * 1e-4
    scene = follower(soft, delay, **converters)
    excitation = at(time, f=np.sin(2 * np.pi * 40 * time), where=1e-5 * np.sin(2 * np.pi * 90 * time))
    for method in ("exact", "generalized_alpha"):
        record, motion = simulate_motion(scene, excitation, time_step=1e-4, method=method, frames=97, progress=False)
        assert len(motion.time) == 97
        assert np.ptp(record["slide"]) > 5e-6
        check_sensors(scene, record, motion, within=1e-9)


def test_a_tumbling_body_and_a_pendulum_of_large_motion():
    """Unequal inertias about odd axes, against Newton's and Euler's equations by SciPy."""
    gravity, spin = np.array([1.5, -2.0, -9.0]), np.array([3.0, 40.0, -5.0])
    arm = np.array([0.03, -0.05, 0.2])
    bodies = (
        RigidBody("ground", {"o": np.zeros(3)}, fixed=True),
        RigidBody("stone", {"c": np.zeros(3)}, 0.8, INERTIA, (0.3, 0.1, -0.2), rotation=ODD, angular_velocity=spin),
        RigidBody("bob", {"top": -arm}, 0.5, 0.3 * INERTIA, TILT @ arm, rotation=TILT),
    )
    scene = Scene("both", bodies, (spherical("pin", "ground.o", "bob.top"),), gravity=gravity)
    time = np.array([0.0, 0.4])
    _, motion = simulate_motion(
        scene, at(time), time_step=1e-4, frames=9, start="released", spectral_radius=0.9, progress=False
    )
    inertia = ODD @ INERTIA @ ODD.T
    free = integrate(
        [0.8], [inertia], [bodies[1].position], [spin], motion.time, lambda _, m: [wrench(0.8 * gravity, m[0].p, m[0])]
    )
    for k, (stone,) in enumerate(free):
        np.testing.assert_allclose(motion.positions["stone"][k], stone.p, atol=1e-6)
        np.testing.assert_allclose(motion.rotations["stone"][k], stone.R @ ODD, atol=1e-4)

    def fall(_, motions):
        return [wrench(0.5 * gravity, motions[0].p, motions[0])]

    def pinned(motions):
        reach = motions[0].R @ (-TILT @ arm)
        cross = np.array([[0, -reach[2], reach[1]], [reach[2], 0, -reach[0]], [-reach[1], reach[0], 0]])
        return np.hstack([np.eye(3), -cross])

    swung = integrate(
        [0.5], [0.3 * TILT @ INERTIA @ TILT.T], [bodies[2].position], [np.zeros(3)], motion.time, fall, pinned
    )
    for k, (bob,) in enumerate(swung):
        np.testing.assert_allclose(motion.positions["bob"][k], bob.p, atol=2e-5)
        np.testing.assert_allclose(motion.rotations["bob"][k], bob.R @ TILT, atol=1e-4)
    assert np.linalg.norm(swung[-1][0].p - swung[0][0].p) > 0.2


@pytest.mark.parametrize("fidelity", ["ffrf", "rigid"])
def test_a_spinning_machine_turns_with_its_table(fidelity):
    """By w t about the spindle, beams at odd places on it too, and what stands stays; beams stretch by a trifle."""
    stiff = craig_bampton(lattice(stiffness=1e7), n_modes=1, progress=False)
    axis, centre, speed = np.array([0.48, -0.6, 0.64]), np.array([0.1, -0.2, 0.05]), 12.0
    at_rim, left = np.array([0.2, 0.1, -0.1]), stiff.point("left").position
    bodies = (
        RigidBody("base", {"bearing": centre, "lamp": (0.5, 0.0, 0.0)}, fixed=True),
        RigidBody("table", {"hub": ODD.T @ (centre - 0.1), "rim": at_rim}, 3.0, INERTIA, (0.1, 0.1, 0.1), rotation=ODD),
        FlexibleBody("beam", stiff, ODD @ at_rim + 0.1 - TILT @ left, TILT, fidelity=fidelity),
        RigidBody("lamp", {"c": np.zeros(3)}, 1.0, INERTIA, (0.5, 0.0, 0.0)),
    )
    joints = (
        revolute("spindle", "base.bearing", "table.hub", axis),
        Joint("foot", "table.rim", "beam.left"),
        spherical("hook", "base.lamp", "lamp.c"),
    )
    scene = Scene("machine", bodies, joints, (Drive("motor", "spindle", "rz", speed=speed),))
    _, motion = simulate_motion(scene, at(np.array([0.0, 0.9])), time_step=1e-3, frames=10, progress=False)
    assert speed * motion.time[-1] > 3 * np.pi
    for k, time in enumerate(motion.time):
        turned = turned_by(*(speed * time * axis))
        for body in bodies[1:3]:
            np.testing.assert_allclose(motion.rotations[body.name][k], turned @ body.rotation, atol=1e-5)
            np.testing.assert_allclose(
                motion.positions[body.name][k], centre + turned @ (body.position - centre), atol=1e-5
            )
        np.testing.assert_allclose(motion.positions["lamp"][k], [0.5, 0, 0], atol=1e-9)
    stretch = np.abs(motion.coordinates["beam"]).max(axis=1)
    assert np.all(stretch > 1e-7) if fidelity == "ffrf" else not stretch.any()


def test_frames_that_a_run_does_not_have_are_refused(soft):
    scene = tower(soft, ("linear", "linear"))
    for frames, said in (
        (1, r"frames must be 2 \.\.\. 201 in this run, or times; got 1"),
        (202, r"frames must be 2 \.\.\. 201"),
        ([0.0, 0.0201], r"frames must be at least 2 times within 0 \.\.\. 0\.02 s, .* got 2 from 0 s to 0\.0201 s"),
        ([-1e-4, 0.01], "frames must be at least 2 times within"),
        ([0.01, 0.01001], "a time step apart"),
        ([], "got 0 from"),
    ):
        with pytest.raises(ValueError, match=said):
            run_tower(scene, frames, method="exact")


def test_what_is_kept_changes_nothing_else(soft):
    scene = tower(soft, ("linear", "ffrf"))
    record, motion = run_tower(scene, [0.0, 0.005, 0.0101])
    same = simulate(scene, record.select(("f", "g")), time_step=1e-4, progress=False)
    np.testing.assert_array_equal(record.values, same.values)
    np.testing.assert_allclose(motion.time, record.time[[0, 50, 101]])


@pytest.mark.parametrize("cutoff", [None, 1000.0])
def test_modes_of_a_scene_are_those_of_its_mass_and_stiffness(soft, soft_end, cutoff):
    """Rayleigh's quotient of bodies put side by side, points that meet, and unit modal mass; springs of bodies only."""
    scene = tower(soft, ("linear", "linear"), soft_end, cutoff_frequency=cutoff)
    frequency, shapes = scene_modes(scene, n=5)
    lower, middle, upper = scene.bodies[1:]
    mass = stiffness = 0.0
    for body in (lower, upper):
        q = shapes[body.name]
        mass = mass + q.T @ body.reduced.mass_matrix @ q
        stiffness = stiffness + q.T @ body.reduced.stiffness_matrix @ q
    q, turned = shapes["middle"], middle.rotation @ middle.inertia @ middle.rotation.T
    mass = mass + middle.mass * q[:3].T @ q[:3] + q[3:].T @ turned @ q[3:]
    np.testing.assert_allclose(mass, np.eye(5), atol=1e-8)
    np.testing.assert_allclose(stiffness, np.diag((2 * np.pi * frequency) ** 2), atol=1e-6 * stiffness.max())
    assert frequency[0] == pytest.approx(85.65, rel=1e-3)
    foot = middle.rotation @ middle.points["foot"]
    meets = lower.rotation @ (lower.reduced.motion("right") @ shapes["lower"])[:3]
    np.testing.assert_allclose(q[:3] + np.cross(q[3:].T, foot).T, meets, atol=1e-9 * np.abs(meets).max())


@pytest.mark.parametrize("number", [1, 2])
def test_a_mode_of_what_turns_whirls(number):
    """A weight on equal springs on a table: circles against the turn at w + W, with it at w - W, seen on the table."""
    stiffness, mass, spin = 4e4, 0.5, 60.0
    weight = RigidBody("weight", {"c": np.zeros(3)}, mass, INERTIA, (0.0, 0.1, 0.0), rotation=ODD)
    base = RigidBody("base", {"o": (0.0, 0.1, 0.0)}, fixed=True)
    guide = Joint("guide", "base.o", "weight.c", free=("x", "y"))
    springs = tuple(SpringDamper(a, "base.o", "weight.c", a, stiffness, frame="base.o") for a in "xy")
    scene = Scene("whirl", (base, weight), (guide,), springs=springs, damping_ratio=0.0)
    turning = {"angular_velocity": [0, 0, spin], "axis_point": [0, 0.1, 0]}
    pole, motion = mode_motion(scene, number, frames=9, **turning)
    natural = np.sqrt(stiffness / mass)
    assert pole.imag == pytest.approx(natural + (spin if number == 2 else -spin), rel=1e-9)
    assert abs(pole.real) < 1e-9 * natural
    np.testing.assert_allclose(motion.time, np.linspace(0, 2 * np.pi / pole.imag, 9))
    x, y, z = (motion.positions["weight"] - weight.position).T
    assert np.abs(z).max() < 1e-9 * np.abs(x).max()
    angle = np.unwrap(np.arctan2(y, x))
    np.testing.assert_allclose(np.hypot(x, y), np.hypot(x, y)[0], rtol=1e-6)
    np.testing.assert_allclose(angle - angle[0], (-1) ** (number + 1) * np.linspace(0, 2 * np.pi, 9), atol=1e-6)
    with pytest.raises(ValueError, match=r"oscillations 1 \.\.\. 2, got 3"):
        mode_motion(scene, 3, **turning)


def test_a_strongly_damped_mode_is_shown_for_its_own_period():
    """The slowest first, however it decays; as large as a thousandth of the scene's points and largest body."""
    masses, rates, ratios = (0.5, 0.2), (30.0, 40.0), (0.6, 0.01)
    bodies, guides, springs = [], [], []
    for k, (mass, rate, ratio) in enumerate(zip(masses, rates, ratios, strict=True)):
        place = np.array([0.1, 0.3 * k, 0.2])
        bodies.append(RigidBody(f"m{k}", {"c": np.zeros(3), "far": [0.0, 0.4, 0.0]}, mass, INERTIA, place))
        guides.append(Joint(f"g{k}", f"base.m{k}", f"m{k}.c", free="x"))
        figures = mass * rate**2, 2 * ratio * rate * mass
        springs.append(SpringDamper(f"s{k}", f"base.m{k}", f"m{k}.c", "x", *figures, frame=f"base.m{k}"))
    base = RigidBody("base", {body.name: body.position for body in bodies}, fixed=True)
    scene = Scene("two", (base, *bodies), tuple(guides), springs=tuple(springs), damping_ratio=0.0)
    size = 0.7 + np.sqrt(np.trace(INERTIA) / 0.2)
    for number, (rate, ratio) in enumerate(zip(rates, ratios, strict=True), start=1):
        pole, motion = mode_motion(scene, number, frames=25)
        swinging = rate * np.sqrt(1 - ratio**2)
        assert pole == pytest.approx(complex(-ratio * rate, swinging), rel=1e-9)
        np.testing.assert_allclose(motion.time, np.linspace(0, 2 * np.pi / swinging, 25))
        ways = [np.abs(motion.positions[body.name] - body.position).max() for body in bodies]
        assert ways[number - 1] == pytest.approx(1e-3 * size, rel=0.01)
        assert ways[2 - number] < 1e-9 * ways[number - 1]


def test_a_damped_mode_swings_as_if_it_did_not_decay():
    """A weight on a rail, damped to 0.6: its period is that of the damped swing, which ends where it begins."""
    stiffness, mass, ratio = 4e4, 0.5, 0.6
    axis = np.array(TOWARDS["one"]) / np.linalg.norm(TOWARDS["one"])
    bodies = (
        RigidBody("base", {"o": np.zeros(3), "far": [0, 0.12, 0.16]}, fixed=True),
        RigidBody("weight", {"c": np.zeros(3)}, mass, INERTIA, rotation=ODD),
    )
    spring = SpringDamper("spring", "base.o", "weight.c", axis, stiffness, 2 * ratio * np.sqrt(stiffness * mass))
    rail = prismatic("rail", "base.o", "weight.c", axis)
    pole, motion = mode_motion(Scene("slide", bodies, (rail,), springs=(spring,), damping_ratio=0.0), 1, frames=9)
    natural = np.sqrt(stiffness / mass)
    assert pole == pytest.approx(natural * complex(-ratio, np.sqrt(1 - ratio**2)), rel=1e-9)
    np.testing.assert_allclose(motion.time, np.linspace(0, 2 * np.pi / (0.8 * natural), 9))
    x = motion.positions["weight"] @ axis
    np.testing.assert_allclose(motion.positions["weight"], np.outer(x, axis), atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(x[4:], -x[:5], atol=1e-9 * np.abs(x).max())
    amplitude = np.hypot(x[0], x[2])
    np.testing.assert_allclose(np.hypot(x[:6], x[2:8]), amplitude)
    size = 0.2 + np.sqrt(np.trace(INERTIA) / mass)  # of all points, and of the largest body
    assert amplitude * np.abs(axis).max() == pytest.approx(1e-3 * size)


def test_a_mode_that_only_turns_stays_small():
    """A wheel on a bushing that is soft about one axis: a thousandth of a radian, however large the scene is."""
    bodies = (
        RigidBody("base", {"o": np.zeros(3), "far": [0, 0, 0.05]}, fixed=True),
        RigidBody("wheel", {"c": np.zeros(3)}, 1.0, INERTIA),
    )
    hub = Bushing("hub", "base.o", "wheel.c", [1e6, 1e6, 1e6, 1e4, 1e4, 10.0], axes=TILT)
    _, motion = mode_motion(Scene("wheel", bodies, springs=(hub,), damping_ratio=0.0), 1, frames=49)
    turns = Rotation.from_matrix(motion.rotations["wheel"].copy()).as_rotvec()  # SciPy before 1.12 writes there
    assert np.abs(turns).max() == pytest.approx(1e-3, rel=3e-3)


def test_a_swing_outwards_from_a_spindle_depends_on_the_spindles_place():
    """A pendulum hinged at a radius r from the spindle, parallel to it: w^2 = W^2 m r l / (J + m l^2)."""
    mass, arm, radius, spin = 0.5, 0.06, 0.3, 40.0
    hinge, out, along = TILT @ [0.1, 0.2, -0.1], TILT[:, 0], TILT[:, 2]
    bob = RigidBody("bob", {"eye": [-arm, 0, 0]}, mass, np.diag([1e-3, 2e-3, 2.5e-3]), hinge + arm * out, rotation=TILT)
    base = RigidBody("base", {"o": hinge}, fixed=True)
    scene = Scene("swing", (base, bob), (revolute("hinge", "base.o", "bob.eye", along),), damping_ratio=0.0)
    turning = {"angular_velocity": spin * along, "axis_point": hinge - radius * out}
    pole, motion = mode_motion(scene, 1, **turning)
    assert pole.imag == pytest.approx(spin * np.sqrt(mass * radius * arm / (2.5e-3 + mass * arm**2)), rel=1e-9)
    moved = (motion.positions["bob"] - bob.position) @ TILT
    assert np.abs(moved[:, [0, 2]]).max() < 1e-6 * np.abs(moved[:, 1]).max()
    with pytest.raises(ValueError, match=r"oscillations 1 \.\.\. 1, got 0"):
        mode_motion(scene, 0, **turning)


def test_frames_are_the_nearest_steps():
    np.testing.assert_array_equal(recorded_steps(4, 10, 0.1), [0, 3, 7, 10])
    np.testing.assert_array_equal(recorded_steps(11, 10, 0.1), np.arange(11))
    np.testing.assert_array_equal(recorded_steps(np.array([0.04, 0.26, 1.0]), 10, 0.1), [0, 3, 10])


def test_a_mode_at_rest_is_that_of_mass_and_stiffness(soft):
    """Its shape, whatever its size and the trimming, with damping too small to matter; all within a thousandth."""
    scene = tower(soft, ("linear", "linear"), cutoff_frequency=1000.0, damping_ratio=1e-6)
    scene = replace(scene, gravity=np.zeros(3))
    frequency, shapes = scene_modes(scene, n=3)
    pole, motion = mode_motion(scene, 2)
    assert abs(pole) == pytest.approx(2 * np.pi * frequency[1], rel=1e-6)
    assert pole.real == pytest.approx(-1e-6 * abs(pole), rel=1e-3)
    expected, found = shapes["upper"][:, 1], motion.coordinates["upper"]
    largest = found[np.argmax(np.abs(found).max(axis=1))]
    scale = (largest @ expected) / (expected @ expected)
    np.testing.assert_allclose(largest, scale * expected, atol=1e-4 * np.abs(largest).max())
    tips = [point_motion(scene, motion, "upper.right")[0], point_motion(scene, motion, "middle.seat")[0]]
    span = 0.1
    assert 1e-6 < max(np.abs(tip - tip.mean(axis=0)).max() for tip in tips) < 1.1e-3 * span
