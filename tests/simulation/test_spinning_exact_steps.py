"""Exact steps about a steady rotation, against floating frames, own equations in the inertial frame, and themselves."""

import warnings
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import scipy.integrate
from conftest import Given
from scipy.spatial.transform import Rotation
from test_across_a_spindle import AXES as SPINDLE, POINT, unbalanced
from test_path_steps import stage
from test_spinning_response import rigid
from test_spinning_start import ACROSS, AXIS, CENTRE, INERTIA, blade, platform, run, turntable

from models.hexapods import DEFAULT_PLATFORM
from models.nano_hexapod import make_nano_hexapod
from models.strut import controller_in_line, fe_strut, spring_strut
from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    Geophone,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    cylindrical,
    frequency_response,
    linearize,
    revolute,
    simulate,
    simulate_motion,
)
from nassim.kinematics import strut_lengths
from nassim.scene.measures import PointVelocity
from nassim.scene.part import Sensor
from nassim.scene.terms import Output
from nassim.simulation import Simulation, linearize_closed
from nassim.systems import integral_force_feedback, proportional

OTHER = np.cross(AXIS, ACROSS)


def waves(*amplitudes):
    """Smooth inputs that start at zero."""
    return [lambda t, a=a, k=k: a * np.sin((60.0 + 25.0 * k) * t) ** 2 for k, a in enumerate(amplitudes)]


def assert_alike(exact, other, names, share, *, fine):
    """Outputs are alike within a share of the largest of their kind."""
    units = dict(zip(other.names, other.units, strict=True))
    for name in names:
        size = max(np.ptp(other[n]) for n in names if units[n] == units[name])
        assert np.abs(exact[name] - other[name][::fine]).max() < share * size, name


PLACES = np.array([[4e-3, -7e-3, 0.05], [-6e-3, 3e-3, 0.17]])
"""Centres of mass from the axle, along ACROSS, OTHER and AXIS [m]."""
TENSORS = np.array([INERTIA, [[5e-3, -3e-4, 2e-4], [-3e-4, 2e-3, 4e-4], [2e-4, 4e-4, 4e-3]]])
GRAVITY, SPEED, STIFFNESS, DRAG = np.array([0.9, -0.5, -0.7]), 9.0, 4e5, 30.0
TURNED = np.column_stack([ACROSS, OTHER, AXIS])
ALONG = np.array([np.roll([0.95, 0.3, -0.1], k // 2) for k in range(6)] * 2) @ TURNED.T
ALONG /= np.linalg.norm(ALONG, axis=1, keepdims=True)
SPOTS = np.array([0.1 * (-1) ** k * np.roll([0.2, 0.3, 1.0], k // 2) for k in range(6)] * 2) @ TURNED.T
"""Directions of twelve springs, and where each acts on the upper of its two bodies, from that one's centre [m]."""
PUSHED = np.array([0.02, 0.04, -0.03])


def two_masses():
    """Two bodies of odd inertias one above the other, each on six damped springs along the table's axes."""
    centres = CENTRE + PLACES @ TURNED.T
    below = np.repeat([CENTRE, centres[0]], 6, axis=0)
    (ground, table), spindle, drive = turntable(SPEED)
    arms = SPOTS + np.repeat(centres, 6, axis=0) - below
    table = replace(table, points={**table.points, **{f"s{k}": arms[k] for k in range(6)}})
    masses = [
        RigidBody("one", {"c": (0, 0, 0), **{f"s{k}": (SPOTS, arms)[k // 6][k] for k in range(12)}}, 1.0, TENSORS[0],
                  centres[0], angular_velocity=SPEED * AXIS),
        RigidBody("two", {"c": (0, 0, 0), "p": PUSHED, **{f"s{k}": SPOTS[k] for k in range(6, 12)}},
                  1.0, TENSORS[1], centres[1], angular_velocity=SPEED * AXIS),
    ]  # fmt: skip
    ends = ("table", "one", "two")
    springs = tuple(
        SpringDamper(f"s{k}", f"{ends[k // 6]}.s{k}", f"{ends[k // 6 + 1]}.s{k}", tuple(ALONG[k]), STIFFNESS, DRAG,
                     frame="table.axle") for k in range(12)
    )  # fmt: skip
    push = PointForce("push", "two.p", tuple(OTHER), "push", frame="two.c")
    sensors = tuple(Encoder(f"{name} {k}", "table.axle", f"{name}.c", tuple(np.eye(3)[k]), frame="table.axle")
                    for name in ends[1:] for k in range(3))  # fmt: skip
    return Scene("two masses", (ground, table, *masses), (spindle,), (drive, push), sensors, springs,
                 damping_ratio=0.0, gravity=GRAVITY)  # fmt: skip


def own_run(time, force):
    """Newton and Euler in the inertial frame, large motion: displacements of both bodies along the table's axes."""
    centres = CENTRE + PLACES @ TURNED.T
    lower, upper = np.repeat([0, 1], 6), np.repeat([1, 2], 6)
    below = np.vstack([CENTRE, centres])[lower]
    arms = SPOTS + centres[upper - 1] - below

    def rates(t, y):
        table = Rotation.from_rotvec(SPEED * t * AXIS).as_matrix()
        x, quaternion, v, w = np.split(y.reshape(2, 13), [3, 7, 10], axis=1)
        turn = np.concatenate([table[None], Rotation.from_quat(quaternion).as_matrix()])
        x, v = np.vstack([CENTRE, x]), np.vstack([np.zeros(3), v])
        w = np.vstack([SPEED * AXIS, w])
        low, high = (np.einsum("kab,kb->ka", turn[at], arm) for at, arm in ((lower, arms), (upper, SPOTS)))
        apart = x[upper] + high - x[lower] - low
        faster = v[upper] + np.cross(w[upper], high) - v[lower] - np.cross(w[lower], low)
        d = ALONG @ table.T
        pull = STIFFNESS * (
            np.sum(d * apart, axis=1) - np.sum(ALONG * (SPOTS + centres[upper - 1] - arms - below), axis=1)
        )
        pull += DRAG * np.sum(d * faster + np.cross(SPEED * AXIS, d) * apart, axis=1)
        forces, moments = np.zeros((2, 3, 3))
        for at, arm, sign in ((lower, low, 1.0), (upper, high, -1.0)):
            np.add.at(forces, at, sign * pull[:, None] * d)
            np.add.at(moments, at, sign * pull[:, None] * np.cross(arm, d))
        acting = force(t) * turn[2] @ OTHER
        forces[2] += acting
        moments[2] += np.cross(turn[2] @ PUSHED, acting)
        tensors = turn[1:] @ TENSORS @ turn[1:].swapaxes(1, 2)
        gyroscopic = np.cross(w[1:], np.einsum("kab,kb->ka", tensors, w[1:]))
        turning = np.linalg.solve(tensors, (moments[1:] - gyroscopic)[:, :, None])[:, :, 0]
        vector, scalar = quaternion[:, :3], quaternion[:, 3:]
        spin = 0.5 * np.hstack(
            [w[1:] * scalar + np.cross(w[1:], vector), -np.sum(w[1:] * vector, axis=1, keepdims=True)]
        )
        return np.hstack([v[1:], spin, forces[1:] + GRAVITY, turning]).ravel()

    start = np.hstack([centres, np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1)), np.tile(SPEED * AXIS, (2, 1))])
    found = scipy.integrate.solve_ivp(rates, (0, time[-1]), start.ravel(), "DOP853", time, rtol=1e-6, atol=1e-9)
    back = Rotation.from_rotvec(-SPEED * np.outer(time, AXIS)).as_matrix()
    places = found.y.reshape(2, 13, -1)[:, :3] - CENTRE[:, None]
    return np.einsum("tab,kbt->kat", back, places) - (centres - CENTRE)[:, :, None]


class SlowForce(PointForce):
    """A force through an amplifier."""

    def terms(self, scene):
        return tuple(replace(term, bandwidth=40.0) for term in super().terms(scene))


def test_amplifiers_and_inertial_sensors_turn_with_the_rotor():
    """A slow amplifier, an accelerometer and a geophone askew on a mass that tilts, as in floating frames."""
    scene, step = stage(base=False, gravity=np.zeros(3), speed=40.0), 5e-4
    askew = tuple(0.6 * ACROSS + 0.5 * OTHER + 0.3 * AXIS)
    sensors = (Accelerometer("a", "mass.c", askew, "mass.c", resonance=180.0, damping_ratio=0.5),
               Geophone("g", "mass.c", tuple(OTHER), "mass.c"), scene.sensors[0])  # fmt: skip
    push = SlowForce("push", "mass.c", askew, "force", frame="stage.top")
    scene = replace(scene, actuators=(scene.actuators[0], push), sensors=sensors)
    time = step / 3 * np.arange(151)
    inputs = TimeHistory(time, 20 * np.sin(250 * time)[None] ** 2, ("force",), ("N",))
    exact = simulate(scene, inputs, time_step=step, method="exact", progress=False)
    other = simulate(scene, inputs, time_step=step / 3, spectral_radius=0.8, period_correction=False, progress=False)
    assert exact["a"][0] == pytest.approx(other["a"][0], rel=1e-3)  # centrifugal
    for name in ("a", "g", "x"):
        assert np.abs(exact[name] - other[name][::3]).max() < 0.01 * np.ptp(other[name]), name


def test_two_masses_move_as_by_newton_and_euler():
    """Released under gravity askew to the axis: bodies on springs alone turn about their own centres at first."""

    def force(t):
        return np.sin(200.0 * t) ** 2

    time = np.arange(21) * 1e-3
    record = run(two_masses(), 0.02, 1e-3, signals={"push": force}, method="exact", start="released")
    for name, ways in zip(("one", "two"), own_run(time, force), strict=True):
        for k, way in enumerate(ways):
            assert np.abs(record[f"{name} {k}"] - way).max() < 4e-3 * np.ptp(ways)


def looped(rate=1e3, *, delay=1, **converters):
    """A mass on a turntable at 25 rad/s with a loop along each of two springs."""
    loops = tuple(
        Loop(n, proportional(-900.0, sample_rate=rate, delay=delay, limit=0.8), f"d{n}", f"F{n}", **converters)
        for n in "uv"
    )
    return replace(rigid(25.0), loops=loops)


def test_loops_with_delay_and_limits_act_as_in_floating_frames():
    signals = dict(zip(("Fu", "Fv"), waves(1.0, 0.7), strict=True))
    exact = run(looped(), 0.1, 1e-3, signals=signals, method="exact")
    floating = run(looped(), 0.1, 5e-4, signals=signals)
    assert np.abs(exact["u"]).max() == 0.8
    assert np.abs(exact["v"]).max() < 0.8
    assert exact["du"][0] == pytest.approx(floating["du"][0], rel=1e-6)  # centrifugal forces
    assert_alike(exact, floating, ("du", "dv", "u", "v"), 3e-3, fine=2)


def test_rates_in_a_linear_model_are_those_against_the_ground():
    """A mass on unequal springs in a table that turns at W; along its axes it moves at (x' - W y, y' + W x)."""
    speed, ground = 7.0, RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    table = RigidBody("table", {"axle": np.zeros(3)}, 1.0, np.diag([1.0, 1.0, 1.5]))
    mass = RigidBody("mass", {"seat": np.zeros(3)}, 2.0, 1e-3 * np.diag([1.0, 1.0, 1.5]))
    feedback = proportional([[-4.0, 30.0]], sample_rate=100.0, delay=1)
    scene = Scene(
        "velocities",
        (ground, table, mass),
        (revolute("spindle", "ground.axle", "table.axle"), Joint("flat", "table.axle", "mass.seat", ("x", "y"))),
        (Drive("motor", "spindle", speed=speed), PointForce("push", "mass.seat", "x", "force", frame="mass.seat")),
        [kind(f"{name}{a}", "mass.seat", a, frame="table.axle")
         for name, kind in (("v", Vibrometer), ("a", Accelerometer)) for a in "xy"],
        [SpringDamper(f"k{a}", "table.axle", "mass.seat", a, k, 3.0, frame="table.axle")
         for a, k in (("x", 600.0), ("y", 900.0))],
        damping_ratio=0.0,
        loops=(Loop("loop", feedback, ("vx", "vy"), "force"),),
    )  # fmt: skip
    frequency = np.array([0.1, 1.0, 3.0])
    found = frequency_response(linearize(scene), frequency).values[:, 0]
    for s, values in zip(2j * np.pi * frequency, found.T, strict=True):
        one = 2.0 * (s**2 - speed**2) + 3.0 * s
        x, y = np.linalg.solve([[one + 600.0, -4.0 * speed * s], [4.0 * speed * s, one + 900.0]], [1.0, 0.0])
        vx, vy = s * x - speed * y, s * y + speed * x
        np.testing.assert_allclose(values, [vx, vy, s * vx - speed * vy, s * vy + speed * vx], rtol=1e-9)
    time = np.arange(41) * 0.01
    push = TimeHistory(time, np.sin(9.0 * time), ("force",), ("N",))
    record = simulate(scene, push, time_step=0.01, method="exact", hold_order=0, progress=False)
    closed = linearize_closed(scene)
    state = np.zeros(len(closed.A))
    for k, value in enumerate(push.values[0]):
        read = closed.C @ state + closed.D[:, 0] * value
        np.testing.assert_allclose([record["vx"][k], record["vy"][k]], read[:2], rtol=0, atol=1e-9)
        state = closed.A @ state + closed.B[:, 0] * value


def test_a_damping_ratio_does_not_damp_rigid_bodies_on_springs_that_turn():
    """It acts through deformation only, as in floating frames."""
    signals = dict(zip(("Fu", "Fv"), waves(1.0, 0.7), strict=True))
    with pytest.warns(UserWarning, match="damping_ratio acts through deformation only"):
        damped = run(replace(rigid(25.0), damping_ratio=0.3), 0.05, 1e-3, signals=signals, method="exact")
    plain = run(rigid(25.0), 0.05, 1e-3, signals=signals, method="exact")
    np.testing.assert_allclose(damped.values, plain.values, rtol=0, atol=1e-9 * np.abs(plain.values).max())


@pytest.mark.parametrize("delay", [0, 2])
def test_steps_one_by_one_are_the_same_to_the_last_bit(delay):
    """With converters that round, and back from a saved state."""
    scene = looped(500.0, delay=delay, input_step=1e-5, output_step=1e-3)
    time = np.arange(101) * 1e-3
    values = np.array([wave(time) for wave in waves(1.0, 0.7)])
    record = run(scene, 0.1, 1e-3, signals=dict(zip(("Fu", "Fv"), waves(1.0, 0.7), strict=True)), method="exact")
    rows = np.array([record[name] for name in ("du", "dv", "u", "v")])
    with Simulation(scene, time_step=1e-3, method="exact") as stepped:
        found, saved = [list(stepped.outputs.values())], None
        for k in range(1, 101):
            if k == 45:
                saved = stepped.state
            found.append(list(stepped.step(dict(zip(("Fu", "Fv"), values[:, k], strict=True))).values()))
        stepped.restore(saved)
        again = list(stepped.step(dict(zip(("Fu", "Fv"), values[:, 45], strict=True))).values())
    np.testing.assert_array_equal(np.transpose(found), rows)
    assert again == found[45]


def test_a_stage_that_follows_a_path_on_the_rotor():
    """Its rails turn, so Coriolis and centrifugal forces act on what it carries."""
    scene = rigid(25.0)
    stage = Drive("stage", "u", "z", "path", bandwidth=60.0)
    scene = replace(scene, springs=scene.springs[1:], actuators=(scene.actuators[0], scene.actuators[2], stage))
    signals = {"Fv": waves(1.0)[0], "path": lambda t: 5e-3 * np.sin(20.0 * t) ** 2}
    exact = run(scene, 0.06, 1e-3, signals=signals, method="exact")
    assert_alike(exact, run(scene, 0.06, 2e-4, signals=signals), ("du", "dv"), 3e-3, fine=5)


def test_a_flexible_blade_rings_when_it_is_released():
    """In equilibrium it does not, and is where floating frames have it."""
    scene = blade(10.0)
    exact = run(scene, 0.01, 2e-4, method="exact", start="released")
    assert_alike(exact, run(scene, 0.01, 5e-5, start="released"), exact.names, 1e-3, fine=4)
    still = run(scene, 0.02, 2e-4, method="exact")
    assert np.ptp(still.values, axis=1).max() < 1e-12 * np.abs(still.values).max()
    slow = blade(2.0)  # where the square of the deformation is rounding
    start = run(slow, 2e-4, 2e-4, method="exact").values[:, 0]
    np.testing.assert_allclose(start, run(slow, 2e-4, 2e-4).values[:, 0], rtol=1e-9)


def six_loops(scene, each, sensor, actuator):
    """A hexapod with the same controller in every strut, and pushes of its payload in 30 ms, of 8 ms width."""
    pairs = [(f"strut_{k}/{sensor}", f"strut_{k}/{actuator}") for k in range(1, 7)]
    scene = replace(scene, loops=tuple(Loop(f"loop {k}", each, *pair) for k, pair in enumerate(pairs)))
    shares = {"force_x": 5.0, "force_y": 2.5, "force_z": 1.5, "torque_x": 0.0, "torque_y": 0.0, "torque_z": 0.25}
    signals = {f"payload_{k}": lambda t, a=a: a * np.exp(-(((t - 0.012) / 0.004) ** 2)) for k, a in shares.items()}
    return scene, signals


def test_a_hexapod_with_six_loops_turns_as_in_floating_frames():
    strut = spring_strut(9e5, parallel_stiffness=9e5, length=float(strut_lengths(DEFAULT_PLATFORM)[0]))
    scene = make_nano_hexapod(strut, platform=DEFAULT_PLATFORM, payload_mass=10.0, spindle_rpm=60.0)
    each = controller_in_line(integral_force_feedback(-100.0, sample_rate=5e3, corner_frequency=1.0))
    scene, signals = six_loops(scene, each, "sensor_force", "actuator_force")
    exact = run(scene, 0.03, 2e-4, signals=signals, method="exact")
    assert_alike(exact, run(scene, 0.03, 1e-4, signals=signals), (*scene.outputs, *scene.commands), 3e-3, fine=2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:damping_ratio acts through deformation only")
@pytest.mark.parametrize(("corrected", "share"), [(True, 3e-3), (False, 3e-4)])
def test_a_hexapod_of_finite_elements_turns_as_in_floating_frames(corrected, share):
    """What is left comes from the correction of masses for their steps. At 20 kHz no mode of the mesh folds."""
    scene = make_nano_hexapod(fe_strut("ffrf"), payload_mass=5.0, spindle_rpm=60.0, cutoff_frequency=1800.0)
    each = integral_force_feedback(30.0, sample_rate=2e4, corner_frequency=1.0)
    scene, signals = six_loops(scene, each, "sensor_voltage", "actuator_voltage")
    exact = run(scene, 0.03, 5e-5, signals=signals, method="exact")
    floating = run(scene, 0.03, 2.5e-5, signals=signals, period_correction=corrected)
    assert_alike(exact, floating, (*scene.outputs, *scene.commands), share, fine=2)


class Difference(AngleSensor):
    """An angle less half of it: an output of two terms."""

    def terms(self, scene):
        """They add up."""
        (angle,) = super().terms(scene)
        return angle, replace(angle, gain=-0.5)


def instruments():
    """Sensors that read the rotation itself: angles, speeds of points, along axes of the table or along the spindle."""
    tilted = tuple(0.6 * AXIS + 0.8 * OTHER)
    return (
        AngleSensor("angle", "ground.axle", "mass.c", tuple(2.0 * AXIS)),
        AngleSensor("back", "mass.c", "ground.axle", tuple(AXIS)),
        Difference("half", "ground.axle", "mass.c", tuple(AXIS)),
        AngleSensor("tilt", "table.axle", "mass.c", tilted),
        Encoder("height", "ground.axle", "mass.c", tuple(AXIS)),
        Vibrometer("swift", "mass.c", tilted, frame="table.axle"),
        Vibrometer("own", "mass.c", tuple(OTHER), frame="mass.c"),
        Vibrometer("up", "mass.c", tuple(AXIS)),
    )


def loose(speed):
    """The mass of `rigid` on a bushing beside, which lets it tilt."""
    scene = rigid(speed)
    seat = Bushing("seat", "slide.c", "mass.c", [9e3, 6e3, 8e3, 400.0, 500.0, 600.0], [9.0, 9.0, 9.0, 0.1, 0.1, 0.1])
    return replace(scene, joints=scene.joints[:2], springs=(*scene.springs[:1], seat))


def test_outputs_read_the_rotation_itself():
    """As in floating frames: the rotor's angle, and speeds of points that circle."""
    scene = replace(loose(12.0), sensors=instruments())
    signals = dict(zip(("Fu", "Fv"), waves(0.3, 0.2), strict=True))
    exact, floating = run(scene, 0.06, 1e-3, signals=signals, method="exact"), run(scene, 0.06, 2e-4, signals=signals)
    assert exact["angle"][-1] == pytest.approx(0.72, abs=1e-3)
    for name in scene.outputs:
        other = floating[name][::5]
        moved = other - other[0] - (other[-1] - other[0]) / 0.06 * exact.time
        assert np.abs(exact[name] - other).max() < 0.02 * np.abs(moved).max() + 3e-7, name


@dataclass(frozen=True)
class Gyroscope(Sensor):
    """The angular velocity of a point along an axis of the world or of a point, its integral or its rate."""

    name: str
    point: str
    axis: tuple
    unit: str = field(default="rad/s", init=False)
    derivative: int = 1
    frame: str = ""

    def terms(self, scene):
        """It reads an angle, its rate or its second rate."""
        measure = PointVelocity(((self.point, np.array(self.axis)),), self.frame, angular=True)
        return (Output(self.name, ("rad", "rad/s", "rad/s2")[self.derivative], measure, derivative=self.derivative),)


def test_an_integrated_angular_velocity_is_the_angle_of_small_motion_beside_the_rotation():
    twist = AngleSensor("twist", "table.axle", "mass.c", tuple(AXIS))
    integral = Gyroscope("integral", "mass.c", tuple(AXIS), 0)
    signals = dict(zip(("Fu", "Fv"), waves(0.3, 0.2), strict=True))
    found = run(replace(loose(12.0), sensors=(twist, integral)), 0.02, 1e-3, signals=signals, method="exact")
    expected = found["twist"] - found["twist"][0]  # the integral begins at the start
    np.testing.assert_allclose(found["integral"], expected, atol=2e-3 * np.ptp(expected))


@pytest.mark.parametrize("frame", ["rotor", "stator"])
def test_a_stator_on_springs_and_its_images(frame):
    """In the frame of that side which may be odd: bodies are where floating frames have them, in the world."""
    scene = unbalanced()
    ground, stator, rotor = scene.bodies
    sensors = (
        *scene.sensors,
        Vibrometer("v", "stator.on", tuple(SPINDLE[:, 0]), frame="rotor.on"),
        Accelerometer("a", "stator.on", tuple(SPINDLE[:, 0]), frame="rotor.on"),
        *(Gyroscope(f"{side}'", f"{side}.on", tuple(SPINDLE[:, 0]), 2, "rotor.on") for side in ("stator", "rotor")),
    )
    if frame == "stator":
        stator = replace(stator, inertia=SPINDLE @ np.diag([0.05, 0.07, 0.08]) @ SPINDLE.T)
        rotor = replace(rotor, position=POINT, points={"on": np.zeros(3)})
        sensors = tuple(Encoder(f"{k}", "ground.on", "stator.rim", tuple(SPINDLE[:, k])) for k in range(2))
        sensors += (
            Gyroscope("w", "rotor.on", tuple(SPINDLE[:, 0])),
            Gyroscope("w'", "rotor.on", tuple(SPINDLE[:, 1]), 2),
            Accelerometer("b", "rotor.on", tuple(SPINDLE[:, 0]), resonance=60.0, damping_ratio=1.0),
            Accelerometer("a", "stator.rim", "z", resonance=60.0, damping_ratio=1.0),
        )
    else:  # beside the bearing, where its unbalance tilts the stator
        arm = 0.05 * SPINDLE[:, 2]
        rotor = replace(rotor, position=rotor.position + arm, points={"on": rotor.points["on"] - arm})
    rotor = replace(rotor, angular_velocity=40.0 * AXIS)  # or the motor's start would turn the stator back
    ways = {"rotor": ("stator.on", SPINDLE[:, 2]), "stator": ("stator.rim", SPINDLE @ [0.6, 0.0, 0.8])}
    push = PointForce("push", ways[frame][0], tuple(ways[frame][1]), "push")
    scene = replace(scene, bodies=(ground, stator, rotor), sensors=sensors,
                    actuators=(Drive("motor", "hinge", "rz", speed=40.0), push))  # fmt: skip
    time = np.arange(101) * 5e-4
    history = TimeHistory(time, [5.0 * np.sin(60.0 * time) ** 2], ("push",), ("N",))
    options = {"frames": 6, "progress": False, "start": "released"}
    exact, seen = simulate_motion(scene, history, time_step=5e-4, method="exact", **options)
    # Accelerations ring from step to step at the start, longer at larger radii.
    floating, expected = simulate_motion(scene, history, time_step=1e-4, spectral_radius=0.7, **options)
    assert_alike(exact, floating, scene.outputs, 3e-3, fine=5)
    for name in ("stator", "rotor"):
        np.testing.assert_allclose(seen.positions[name], expected.positions[name], atol=1e-7)
        np.testing.assert_allclose(seen.rotations[name], expected.rotations[name], atol=1e-6)


def test_images_of_a_flexible_body_turn_with_its_rotor():
    scene, history = blade(10.0), TimeHistory(np.arange(101) * 2e-4, np.zeros((0, 101)), (), ())
    (_, seen), (_, expected) = (
        simulate_motion(scene, history, time_step=2e-4, frames=3, progress=False, method=method)
        for method in ("exact", "generalized_alpha")
    )
    bar = scene.bodies[2].reduced
    for end in (bar.point("left"), bar.point("right")):
        at, other = (
            m.positions["bar"]
            + (m.rotations["bar"] @ (end.position + m.coordinates["bar"] @ bar.motion(end.name)[:3].T)[:, :, None])[
                ..., 0
            ]
            for m in (seen, expected)
        )
        np.testing.assert_allclose(at, other, atol=2e-7)
        assert np.ptp(at, axis=0).max() > 0.01


def test_weight_across_a_spindle_hangs_at_rest_in_the_world():
    """x = m g / (k - i c W) in the world, c turning along: a steady start, of no transient, over a turn."""
    speed = 0.3
    scene = replace(platform(speed, offset=0.0), gravity=0.02 * (0.6 * ACROSS - 0.8 * OTHER + AXIS))
    record = run(scene, 20.0, 0.1, signals={"push": lambda t: 0.0 * t}, method="exact")
    hung = 0.02 * (0.6 - 0.8j) / (1.0 - 0.05j * speed)
    seen = hung * np.exp(-1j * speed * record.time)
    np.testing.assert_allclose(record["du"] + 1j * record["dv"], seen, atol=1e-5 * abs(hung))  # the slide's mass


def test_a_horizontal_spindle_runs_as_in_floating_frames():
    scene = replace(loose(25.0), gravity=np.array([0.0, 0.0, -9.81]), damping_ratio=0.0)
    scene = replace(scene, bodies=tuple(replace(b, angular_velocity=25.0 * AXIS * b.moves) for b in scene.bodies))
    options = {"signals": dict(zip(("Fu", "Fv"), waves(0.3, 0.2), strict=True)), "start": "released"}
    exact = run(scene, 0.1, 1e-3, method="exact", **options)
    assert_alike(exact, run(scene, 0.1, 2.5e-4, **options), scene.outputs, 3e-3, fine=4)


def test_gravity_that_stiffens_by_turns_is_told():
    """By its largest effect as the rotor turns, so by as much wherever it points at the start."""
    scene, told = loose(5.0), set()
    soft = scene.springs[0], replace(scene.springs[1], stiffness=[9e3, 6e3, 8e3, 1.0, 1.0, 1.0])
    for direction in (ACROSS, OTHER):
        low = replace(scene, springs=soft, gravity=9.81 * direction)
        with pytest.warns(UserWarning, match="gravity across the axis changes the stiffness of modes by") as found:
            run(low, 2e-3, 1e-3, signals=dict(zip(("Fu", "Fv"), waves(0.0, 0.0), strict=True)), method="exact",
                start="released")  # fmt: skip
        told |= {str(one.message) for one in found if "across the axis" in str(one.message)}
    assert len(told) == 1


@pytest.mark.parametrize("slow", [True, False])
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_gravity_is_told_from_a_hundredth_of_the_stiffness_or_of_that_of_the_rotation(share, slow):
    """An arm on a hinge along the axis: its weight has the stiffness m g r, its spring k and the rotation I W^2."""
    mass, arm, speed = 0.5, 0.1, 20.0
    inertia = 1e-4 + mass * arm**2
    stiffness = (0.2 if slow else 4.0) * inertia * speed**2
    gravity = 0.01 * share * max(stiffness, inertia * speed**2) / (mass * arm)
    bodies, spindle, motor = turntable(speed)
    pendulum = RigidBody("arm", {"hinge": -arm * ACROSS}, mass, 1e-4 * np.eye(3), CENTRE + arm * ACROSS)
    joints = (spindle, Joint("pivot", "table.axle", "arm.hinge", ("rz",), TURNED))
    spring = Bushing("spring", "table.axle", "arm.hinge", [0, 0, 0, 0, 0, stiffness], axes=TURNED)
    scene = Scene("arm", (*bodies, pendulum), joints, (motor,), springs=(spring,), gravity=gravity * OTHER)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run(scene, 2e-3, 1e-3, signals={}, method="exact", start="released")
    assert any("gravity across the axis" in str(one.message) for one in found) == (share > 1)


def cases():
    """What exact steps refuse, and why."""
    scene = rigid(25.0)
    ground, table, *others = scene.bodies
    aside = RigidBody("ground", {**ground.points, "side": np.array([1.0, 0, 0])}, fixed=True)
    rotor = RigidBody("rotor", {"c": (0, 0, 0)}, 1.0, INERTIA, (1.0, 0, 0))
    hinge = Joint("bearing", "ground.side", "rotor.c", ("rz",), np.eye(3))
    second = replace(scene, bodies=(aside, table, *others, rotor), joints=(*scene.joints, hinge),
                     actuators=(*scene.actuators, Drive("other", "bearing", "rz", speed=3.0)))  # fmt: skip
    follows = replace(scene, actuators=(Drive("motor", "spindle", "rz", "angle"), *scene.actuators[1:]),
                      bodies=(ground, replace(table, angular_velocity=25.0 * AXIS), *others))  # fmt: skip
    odd = replace(others[1], angular_velocity=10.0 * AXIS)
    drive = (Drive("motor", "hinge", "rz", speed=40.0),)
    held = replace(unbalanced(), actuators=drive)
    spin = 40.0 * held.joints[0].axes[:, 2]
    bodies = tuple(replace(b, angular_velocity=spin) if b.name == "stator" else b for b in held.bodies)
    return [
        (replace(held, bodies=bodies), "body 'stator' has an angular_velocity other than"),
        (second, "one drive that turns at constant speed; or take generalized_alpha"),
        (follows, "body 'table' spins without a drive of constant speed; take generalized_alpha"),
        (replace(scene, bodies=(ground, table, others[0], odd)), "body 'mass' has an angular_velocity other than"),
        (
            replace(unbalanced(lopsided=0.2), actuators=drive),
            "frame of the rotor or of the stator .body 'stator'.*; body 'rotor'.*; let the drive follow an input",
        ),
        (replace(scene, sensors=(Encoder("x", "ground.axle", "mass.c", "x"),)), "output 'x'.*take generalized_alpha"),
        (replace(scene, sensors=(AngleSensor("x", "mass.c", "ground.axle", tuple(ACROSS)),)), "'x' changes with"),
        (platform(1.1, offset=0.0), r"unstable: an oscillation at 0\.01591 Hz .*start=\"released\""),
    ]


@pytest.mark.parametrize(("scene", "reason"), cases())
def test_what_exact_steps_cannot_do_is_refused_before_the_run(scene, reason):
    time = np.arange(3) * 1e-3
    history = TimeHistory(time, np.zeros((len(scene.inputs), 3)), scene.inputs, ())
    with pytest.raises(ValueError, match=reason):
        simulate(scene, history, time_step=1e-3, method="exact", progress=False)
    with pytest.raises(ValueError, match=reason), Simulation(scene, time_step=1e-3, method="exact"):
        pass


@pytest.mark.parametrize(("along", "stiffness", "body"), [(ACROSS, 0.0, "slide"), (AXIS, 1.0, "table")])
def test_what_weight_moves_and_nothing_holds_has_no_equilibrium(along, stiffness, body):
    """Across the axis, or along it on a spindle that may slide; released, it falls."""
    loose = platform(0.5, offset=0.0, stiffness=stiffness)
    scene = replace(loose, gravity=9.81 * along, sensors=(Encoder("fall", "ground.axle", "table.axle", tuple(AXIS)),),
                    joints=(cylindrical("spindle", "ground.axle", "table.axle", AXIS), *loose.joints[1:]))  # fmt: skip
    still = {"push": lambda t: 0.0 * t}
    with pytest.raises(RuntimeError, match=f"no equilibrium to start from as it turns: .* body '{body}' in a motion"):
        run(scene, 0.1, 0.01, signals=still, method="exact")
    record = run(scene, 0.1, 0.01, signals=still, method="exact", start="released")
    np.testing.assert_allclose(record["fall"], 0.5 * 9.81 * (along @ AXIS) * record.time**2, atol=1e-9)


def test_an_unstable_rotation_runs_when_released_and_with_a_loop():
    scene = platform(1.1, offset=0.0)
    record = run(scene, 60.0, 0.1, signals={"push": lambda t: 1e-3 + 0.0 * t}, method="exact", start="released")
    assert record["du"][-1] > 1e-4
    held = replace(scene, loops=(Loop("hold", proportional(-1.0, sample_rate=100.0), "du", "push"),))
    with pytest.warns(UserWarning, match="unstable: .*only its loops can hold it"):
        run(held, 0.1, 0.01, method="exact")


def test_angular_accelerations_of_a_rotor_are_rates_of_its_angular_velocities():
    """About axes of the body itself, whose own rotation adds nothing: d(w . n)/dt = w' . n, with Coriolis' part."""
    place = CENTRE + np.array([0.03, 0.03, -0.015])
    bodies, spindle, drive = turntable(25.0, seat=place)
    top = RigidBody("top", {"c": np.zeros(3), "rim": (0.01, 0.02, -0.03)}, 1.0, INERTIA, place)
    figures = np.array([4e5, 3e5, 5e5, 40.0, 50.0, 70.0]), np.array([20.0, 30.0, 10.0, 0.02, 0.01, 0.03])
    axes = np.array([ACROSS, OTHER, 0.6 * ACROSS + 0.8 * AXIS])
    turns = [PointVelocity((("top.c", axis),), "top.c", angular=True) for axis in axes]
    readings = [Output(f"{n}{k}", "", turn, derivative=n) for n in (1, 2) for k, turn in enumerate(turns)]
    scene = Scene(
        "top",
        (*bodies, top),
        (spindle,),
        (drive, PointForce("push", "top.rim", ACROSS + OTHER, "push", "top.rim")),
        springs=(Bushing("seat", "table.seat", "top.c", *figures), Given("gyroscopes", tuple(readings))),
        damping_ratio=0.0,
    )
    record = run(scene, 0.2, 2e-4, signals={"push": lambda t: 0.1 * np.sin(90.0 * t) ** 2}, method="exact")
    velocities, accelerations = np.split(record.values[-6:], 2)
    rates = np.gradient(velocities, 2e-4, axis=1)[:, 1:-1]
    np.testing.assert_allclose(rates, accelerations[:, 1:-1], rtol=0, atol=1e-3 * np.ptp(accelerations, axis=1).min())
