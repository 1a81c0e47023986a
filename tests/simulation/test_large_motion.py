"""Mechanisms in large motion, each against an integration by SciPy of equations written here, or a closed form."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.integrate
from conftest import lattice, turned_by
from newton_euler import integrate, point_rows, wrench
from scipy.spatial.transform import Rotation

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    simulate,
)
from nassim.scene.forces import LinearActuator, PointTorque
from nassim.scene.instruments import ForceSensor
from nassim.scene.joints import prismatic, revolute, spherical, universal
from nassim.scene.measures import Displacement, Distance, PointVelocity
from nassim.scene.motion_sensors import AngleSensor, Pose
from nassim.scene.part import Actuator, Sensor
from nassim.scene.rotation_measures import RotationAngle
from nassim.scene.springs import Bushing
from nassim.scene.terms import AppliedForce, Output


@dataclass(frozen=True)
class Motions(Sensor):
    """Three outputs "name.x" ...: displacement, velocity or acceleration of a point, or of its turn."""

    name: str
    point: str
    derivative: int = 0
    frame: str = ""
    turns: bool = False

    def terms(self, scene):
        return tuple(
            Output(
                f"{self.name}.{letter}",
                "",
                self.measure(axis),
                derivative=self.derivative,
            )
            for letter, axis in zip("xyz", np.eye(3), strict=True)
        )

    def measure(self, axis):
        if self.derivative:
            return PointVelocity(((self.point, axis),), self.frame, angular=self.turns)
        return RotationAngle(self.point, axis) if self.turns else Displacement(((self.point, axis),), self.frame)


def three(record, name):
    return np.column_stack([record[f"{name}.{letter}"] for letter in "xyz"])


def run(scene, duration, time_step, inputs=None, **options):
    time = np.arange(round(duration / time_step) + 1) * time_step
    values = {name: np.broadcast_to(f(time), time.shape) for name, f in (inputs or {}).items()}
    excitation = TimeHistory(time, np.reshape(list(values.values()), (len(values), len(time))), tuple(values), ())
    return simulate(scene, excitation, time_step=time_step, progress=False, **options)


def ground(**points):
    return RigidBody("ground", points or {"o": np.zeros(3)}, fixed=True)


IDENTITY = np.eye(3)
SKEWED = turned_by(0.7, -0.4, 1.2)
"""Of a body in the world."""
INERTIA = turned_by(0.3, 0.5, -0.2) @ np.diag([2e-3, 3e-3, 4e-3]) @ turned_by(0.3, 0.5, -0.2).T
"""Of a body along its own axes."""
GRAVITY = np.array([1.5, -2.0, -9.0])


def test_spherical_double_pendulum():
    """Unequal inertias, turned bodies: paths, energy, and angular momentum about the direction of weight."""
    top, elbow, end = np.array([0.01, 0.02, 0.1]), np.array([-0.02, 0.01, -0.12]), np.array([0.03, 0.0, -0.08])
    other = turned_by(-0.5, 0.9, 0.3)
    first = RigidBody(
        "first", {"top": top, "elbow": elbow, "c": (0, 0, 0)}, 0.8, INERTIA, -SKEWED @ top, rotation=SKEWED
    )
    hinge = SKEWED @ (elbow - top)
    points = {"top": -end, "end": end, "c": (0, 0, 0)}
    second = RigidBody("second", points, 0.5, 0.6 * INERTIA, hinge + other @ end, rotation=other)
    joints = spherical("pin", "ground.o", "first.top"), spherical("elbow", "first.elbow", "second.top")
    sensors = (
        Motions("end", "second.end"),
        *(Motions(f"{b}.v", f"{b}.c", 1) for b in ("first", "second")),
        *(Motions(f"{b}.u", f"{b}.c") for b in ("first", "second")),
        *(Motions(f"{b}.w", f"{b}.c", 1, f"{b}.c", turns=True) for b in ("first", "second")),
        *(Motions(f"{b}.R", f"{b}.c", turns=True) for b in ("first", "second")),
    )
    scene = Scene("double", (ground(), first, second), joints, sensors=sensors, gravity=GRAVITY)
    record = run(scene, 0.4, 1.5e-4, start="released")

    inertias = SKEWED @ INERTIA @ SKEWED.T, other @ (0.6 * INERTIA) @ other.T
    arms = {"top": SKEWED @ top, "elbow": SKEWED @ elbow, "hinge": -other @ end}

    def rows(motions):
        a, b = motions
        meet = point_rows(2, 1, b, arms["hinge"]) + point_rows(2, 0, a, arms["elbow"], -1)
        return np.vstack([point_rows(2, 0, a, arms["top"]), meet])

    def weights(_t, _motions):
        return [np.concatenate([m * GRAVITY, np.zeros(3)]) for m in (0.8, 0.5)]

    found = integrate(
        (0.8, 0.5), inertias, (first.position, second.position), np.zeros((2, 3)), record.time[::100], weights, rows
    )
    path = np.array([b.at(other @ end) for _, b in found])
    moved = three(record, "end")[::100]
    assert np.ptp(path, axis=0).min() > 0.1
    assert np.abs(moved - (path - path[0])).max() < 1e-5 * 0.3

    energy, momentum = 0.0, 0.0
    for body, mass, inertia in ((first, 0.8, inertias[0]), (second, 0.5, inertias[1])):
        v, u, w, g = (three(record, f"{body.name}.{kind}") for kind in "vuwR")
        # Twists about three axes are twice the arcs whose tangents are Rodrigues' parameters.
        turned = Rotation.from_quat(np.column_stack([np.tan(g / 2), np.ones(len(g))])).apply(w @ inertia)
        momentum += (mass * np.cross(body.position + u, v) + turned) @ GRAVITY
        energy += 0.5 * mass * (v**2).sum(axis=1) + 0.5 * np.einsum("ni,ij,nj->n", w, inertia, w) - mass * u @ GRAVITY
    assert np.ptp(energy) < 1e-5 * np.abs(u @ GRAVITY).max()
    assert np.ptp(momentum) < 1e-5 * 0.05 * 9


NORMAL = np.array([1.0, 2.0, -2.0]) / 3
"""Of a plane, in which FIRST and SECOND are perpendicular."""
FIRST = np.array([2.0, 1.0, 2.0]) / 3
SECOND = np.cross(NORMAL, FIRST)


def test_slider_crank():
    """Planar, along odd axes: one equation for the crank's angle, from kinetic energy; three constraints too many."""
    radius, rod, angle, rate = 0.05, 0.13, 0.4, -15.0
    inertias = INERTIA, 2 * INERTIA, 0.5 * INERTIA
    masses = 0.3, 0.4, 0.6

    def places(theta):
        """Of pin and slider, along FIRST and SECOND."""
        pin = radius * np.array([np.cos(theta), np.sin(theta)])
        return pin, np.array([pin[0] + np.sqrt(rod**2 - pin[1] ** 2), 0 * theta])

    pin, slider = (FIRST * p[0] + SECOND * p[1] for p in places(angle))
    rotation = turned_by(0.2, 0.4, -0.8)
    crank = RigidBody(
        "crank", {"o": -rotation.T @ pin / 2, "pin": rotation.T @ pin / 2}, masses[0], inertias[0], pin / 2,
        rotation=rotation, angular_velocity=rate * NORMAL,
    )  # fmt: skip
    half = (slider - pin) / 2
    conrod = RigidBody("conrod", {"pin": -half, "end": half}, masses[1], inertias[1], pin + half)
    piston = RigidBody("piston", {"c": (0, 0, 0)}, masses[2], inertias[2], slider)
    joints = (
        revolute("bearing", "ground.o", "crank.o", NORMAL),
        revolute("crankpin", "crank.pin", "conrod.pin", 2 * NORMAL),
        revolute("wristpin", "conrod.end", "piston.c", -NORMAL),
        prismatic("guide", "ground.slider", "piston.c", FIRST),
    )
    sensors = (
        AngleSensor("angle", "ground.o", "crank.o", NORMAL),
        Encoder("slider", "ground.slider", "piston.c", tuple(FIRST)),
        Encoder("aside", "ground.slider", "piston.c", tuple(SECOND + NORMAL)),
        Motions("rod", "conrod.pin", 1),
    )
    bodies = ground(o=(0, 0, 0), slider=slider), crank, conrod, piston
    scene = Scene("crank", bodies, joints, sensors=sensors, gravity=GRAVITY)
    record = run(scene, 0.6, 2e-4, start="released", spectral_radius=0.9)

    about = rotation @ inertias[0] @ rotation.T, inertias[1]
    spin_inertia = [NORMAL @ j @ NORMAL for j in about]

    def kinetic(theta):
        """Twice the kinetic energy per squared rate, and the potential energy."""
        p, s = places(theta + 1e-20j)
        dp, ds = p.imag / 1e-20, s.imag / 1e-20
        p, s = p.real, s.real
        middle, slope = (dp + ds) / 2, ((ds - dp)[1] * (s - p)[0] - (ds - dp)[0] * (s - p)[1]) / rod**2
        twice = spin_inertia[0] + spin_inertia[1] * slope**2
        twice += masses[0] * dp @ dp / 4 + masses[1] * middle @ middle + masses[2] * ds @ ds
        weight = np.array([FIRST @ GRAVITY, SECOND @ GRAVITY])
        return twice, -weight @ (masses[0] * p / 2 + masses[1] * (p + s) / 2 + masses[2] * s)

    def equation(_t, y):
        (up, v_up), (down, v_down) = kinetic(y[0] + 1e-5), kinetic(y[0] - 1e-5)
        return y[1], (-(v_up - v_down) - (up - down) * y[1] ** 2 / 2) / 2e-5 / kinetic(y[0])[0]

    found = scipy.integrate.solve_ivp(
        equation, (0, 0.6), [angle, rate], t_eval=record.time, method="DOP853", rtol=1e-10, atol=1e-12
    )
    assert abs(found.y[0, -1] - angle) > 2 * np.pi
    path = np.array([places(theta)[1][0] for theta in found.y[0]])
    assert np.abs(record["angle"] - (found.y[0] - angle)).max() < 1e-5 * np.ptp(found.y[0])
    assert np.abs(record["slider"] - (path - path[0])).max() < 1e-5 * rod
    assert np.abs(record["aside"]).max() < 1e-9
    speed = radius * found.y[1, :, None] * (np.cos(found.y[:1].T) * SECOND - np.sin(found.y[:1].T) * FIRST)
    assert np.abs(three(record, "rod") - speed).max() < 3e-5 * np.abs(speed).max()


@pytest.mark.parametrize("swapped", [False, True])
def test_universal_joint(swapped):
    """The driven shaft runs at cos b / (1 - sin^2 b cos^2 a), a the angle of the driving arm from the shafts' plane."""
    bend, start, rate = 0.6, 0.3, 20.0
    axes = turned_by(0.3, -1.1, 0.6)
    driving, driven = axes[:, 2], axes @ [np.sin(bend), 0, np.cos(bend)]
    arm = axes @ [np.cos(start), np.sin(start), 0]
    angle = np.arctan2(np.sin(start), np.cos(bend) * np.cos(start))
    other = axes @ [-np.sin(angle) * np.cos(bend), np.cos(angle), np.sin(angle) * np.sin(bend)]

    def shaft(name, axis, rotation):
        inertia = 1e-4 * np.eye(3) + 0.8e-4 * np.outer(rotation.T @ axis, rotation.T @ axis)
        return RigidBody(name, {"o": (0, 0, 0)}, 0.5, inertia, rotation=rotation)

    a, b = shaft("a", driving, IDENTITY), shaft("b", driven, SKEWED)
    heavy = RigidBody(
        "a", a.points, 50.0, 1e6 * np.asarray(a.inertia), angular_velocity=rate * driving
    )  # a flywheel, which keeps its speed
    cross = ("b.o", "a.o", other, arm) if swapped else ("a.o", "b.o", arm, other)
    joints = (
        Joint("first", "ground.o", "a.o", ("rz",), revolute("", "", "", driving).axes),
        Joint("second", "ground.o", "b.o", ("rz",), revolute("", "", "", driven).axes),
        universal("cross", *cross),
    )
    sensors = (
        AngleSensor("driving", "ground.o", "a.o", driving),
        AngleSensor("driven", "ground.o", "b.o", driven),
        Motions("rate", "b.o", 1, turns=True),
    )
    record = run(Scene("cardan", (ground(), heavy, b), joints, sensors=sensors), 0.35, 1.5e-4, spectral_radius=0.9)
    along = start + record["driving"]
    assert np.abs(record["driving"] - rate * record.time).max() < 1e-4
    ratio = np.cos(bend) / (1 - np.sin(bend) ** 2 * np.cos(along) ** 2)
    assert np.ptp(ratio) > 0.3
    assert np.abs(three(record, "rate") - rate * ratio[:, None] * driven).max() < 2e-5 * rate
    expected = np.unwrap(np.arctan2(np.sin(along), np.cos(bend) * np.cos(along))) - angle
    assert np.abs(record["driven"] - expected).max() < 1e-5
    assert record["driven"][-1] > 2 * np.pi


def test_steady_precession_of_a_top():
    """I1 p^2 cos t - I3 s p + m g l = 0 for precession p, spin s about the top's axis and tilt t; I1 about the tip."""
    mass, reach, tilt, spin, g = 0.5, 0.06, 0.5, 150.0, 9.81
    across, along = 4e-4, 6e-4
    i1 = across + mass * reach**2
    roots = np.roots([i1 * np.cos(tilt), -along * spin, mass * g * reach])
    precession = roots.real.min()
    up = np.array([0.0, 0, 1])
    axis = np.array([np.sin(tilt) * 0.6, np.sin(tilt) * 0.8, np.cos(tilt)])
    rotation = turned_by(0.9, 0.2, -0.3)
    inertia = across * np.eye(3) + (along - across) * np.outer(rotation.T @ axis, rotation.T @ axis)
    omega = precession * up + (spin - precession * np.cos(tilt)) * axis
    top = RigidBody(
        "top", {"tip": -reach * (rotation.T @ axis), "c": (0, 0, 0)}, mass, inertia, reach * axis,
        rotation=rotation, angular_velocity=omega,
    )  # fmt: skip
    joints = (spherical("pivot", "ground.o", "top.tip"),)
    sensors = Motions("c", "top.c"), Motions("w", "top.c", 1, "top.c", turns=True)
    scene = Scene("top", (ground(), top), joints, sensors=sensors, gravity=-g * up)
    record = run(scene, 0.25, 5e-5, start="released", spectral_radius=0.9)
    turned = precession * record.time
    path = reach * np.column_stack(
        [
            axis[0] * np.cos(turned) - axis[1] * np.sin(turned),
            axis[0] * np.sin(turned) + axis[1] * np.cos(turned),
            np.full_like(turned, axis[2]),
        ]
    )
    assert turned[-1] > 0.75
    assert np.abs(three(record, "c") - (path - path[0])).max() < 1e-5 * reach
    assert np.abs(three(record, "w") @ axis - spin).max() < 1e-5 * spin


STIFF = np.diag([2e4, 3e4, 4e4, 20.0, 30.0, 25.0])
STIFF[:3, 3:] = [[0, 200.0, 30], [-150, 0, 10], [20, 0, 50]]
STIFF[3:, :3] = STIFF[:3, 3:].T
STIFF[0, 1] = STIFF[1, 0] = 5e3
BUSHING_AXES = turned_by(0.5, 0.2, -1.0)


def bushing_force(motions, starts, position, axes, stiffness, damping):
    """On two bodies, that a bushing holds together at a position, along axes halfway between them, at their middle."""
    a, b = motions
    here, there = (m.at(position - start) for m, start in zip(motions, starts, strict=True))
    turned = Rotation.from_matrix(axes.T @ a.R.T @ b.R @ axes).as_rotvec()
    now = a.R @ axes @ turned_by(*turned / 2)
    displacement = np.concatenate([now.T @ (there - here), turned])
    slip = b.v + np.cross(b.w, (here + there) / 2 - b.p) - a.v - np.cross(a.w, (here + there) / 2 - a.p)
    pull = -stiffness @ displacement - damping @ np.concatenate([now.T @ slip, now.T @ (b.w - a.w)])
    moment = np.concatenate([np.zeros(3), now @ pull[3:]])
    return [sign * (wrench(now @ pull[:3], (here + there) / 2, m) + moment) for sign, m in ((-1, a), (1, b))]


def test_a_bearing_keeps_the_axes_of_its_housing_as_the_shaft_turns():
    """Softer along one direction: the weight of the shaft, which turns by two turns, deflects it as at rest.

    The seal brakes the shaft.
    """
    axes = turned_by(0.4, -0.7, 0.2)
    stiffness = np.array([1e4, 4e4, 9e4, 40.0, 60.0, 0.0])
    shaft = RigidBody("shaft", {"o": (0, 0, 0)}, 0.5, 1e-3 * IDENTITY, angular_velocity=40.0 * axes[:, 2])
    damping = 6e-3 * stiffness + [0, 0, 0, 0, 0, 1e-3]
    bearing = Bushing("bearing", "ground.o", "shaft.o", stiffness, damping, axes)
    sensors = Pose("pose", "ground.o", "shaft.o", axes), ForceSensor("pull", "bearing")
    scene = Scene("rotor", (ground(), shaft), springs=(bearing,), sensors=sensors, gravity=GRAVITY, damping_ratio=0.0)
    record = run(scene, 0.3, 1e-3).after(0.2)
    weight = axes.T @ (0.5 * GRAVITY)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(record[f"pose.u{axis}"], weight[k] / stiffness[k], rtol=1e-4)
        np.testing.assert_allclose(record[f"pull.f{axis}"], weight[k], rtol=1e-4)
    np.testing.assert_allclose(record["pull.mz"], 1e-3 * 40.0 * np.exp(-record.time), rtol=1e-4)


@pytest.mark.slow
def test_a_bushing_between_free_spinning_bodies():
    """Both spin about odd axes, whole turns, ends apart; paths by SciPy, momentum kept though the bushing damps."""
    place, starts = np.array([0.06, -0.02, 0.03]), (np.zeros(3), np.array([0.1, 0.0, 0.05]))
    spin = np.array([2.5, -4.0, 3.0])
    points = {"o": SKEWED.T @ (place - np.array([0.04, 0.05, -0.03])), "c": (0, 0, 0)}
    base = RigidBody("base", points, 2.0, 5 * INERTIA, rotation=SKEWED, angular_velocity=spin)
    points = {"o": place - starts[1], "c": (0, 0, 0)}
    load = RigidBody("load", points, 0.7, INERTIA, starts[1], angular_velocity=spin)
    springs = (Bushing("bushing", "base.o", "load.o", 4 * STIFF, 4e-4 * STIFF, BUSHING_AXES),)
    sensors = Motions("c", "load.c"), Motions("base", "base.c")
    scene = Scene("bushed", (base, load), springs=springs, sensors=sensors, damping_ratio=0.0)
    record = run(scene, 0.15, 5e-5)

    def forces(_t, motions):
        return bushing_force(motions, starts, place, BUSHING_AXES, 4 * STIFF, 4e-4 * STIFF)

    inertias = SKEWED @ (5 * INERTIA) @ SKEWED.T, INERTIA
    found = integrate((2.0, 0.7), inertias, starts, [spin, spin], record.time[::50], forces)
    path = np.array([b.p for _, b in found]) - starts[1]
    assert np.abs(2.0 * three(record, "base") + 0.7 * three(record, "c")).max() < 1e-12
    assert np.abs(three(record, "c")[::50] - path).max() < 1e-5 * 0.1


def test_a_bushing_on_a_spinning_base_does_not_notice_the_turns():
    """Steady spin about an odd axis: deflection K q = centrifugal wrench, which stays; damping takes no spin away."""
    rate, mass = 30.0, 0.4
    centre = np.array([0.08, 0.01, -0.04])
    place = centre + np.array([0.01, -0.02, 0.015])
    joint = np.array([0.03, 0.04, -0.01])
    base = RigidBody("base", {"c": (0, 0, 0), "joint": joint}, 5.0, 20 * INERTIA, angular_velocity=rate * NORMAL)
    inertia = SKEWED @ (0.2 * INERTIA) @ SKEWED.T
    points = {"o": SKEWED.T @ (place - centre), "c": (0, 0, 0)}
    load = RigidBody("load", points, mass, 0.2 * INERTIA, centre, rotation=SKEWED)
    joints = (revolute("bearing", "ground.o", "base.c", NORMAL),)
    springs = (Bushing("bushing", "base.joint", "load.o", 10 * STIFF, 0.05 * STIFF, BUSHING_AXES),)
    # A turn of the load about the normal that the base passes on at the start; the rest settles.
    load = replace(load, angular_velocity=rate * NORMAL)
    sensors = Pose("pose", "base.joint", "load.o", BUSHING_AXES), AngleSensor("angle", "ground.o", "base.c", NORMAL)
    scene = Scene("carousel", (ground(), base, load), joints, springs=springs, sensors=sensors, damping_ratio=0.0)
    record = run(scene, 0.4, 4e-4, spectral_radius=0.9)
    pose = record.values[:6]
    assert record["angle"][-1] > 3 * np.pi
    late = record.time > 0.18
    assert np.ptp(record["angle"][late]) > 2 * np.pi
    speed = np.diff(record["angle"][late]) / 4e-4
    assert np.ptp(speed) < 1e-6 * speed[0]
    steady = pose[:, -1]
    assert np.abs(pose[:, late] - steady[:, None]).max() < 1e-6 * np.abs(steady).max()

    # In the base's axes at the start: the load moves rigidly by `steady` about its held place.
    turned = turned_by(*(BUSHING_AXES @ steady[3:]))
    held = place + BUSHING_AXES @ steady[:3]
    at = held + turned @ (centre - place)
    omega = speed[-1] * NORMAL
    force = -mass * np.cross(omega, np.cross(omega, at))
    spread = turned @ inertia @ turned.T
    moment = np.cross(at - held, force) - np.cross(omega, spread @ omega)
    wrench_ = np.concatenate([BUSHING_AXES.T @ force, BUSHING_AXES.T @ moment])
    expected = np.linalg.solve(10 * STIFF, wrench_)
    for part in (slice(3), slice(3, 6)):
        assert np.abs(steady - expected)[part].max() < 2e-3 * np.abs(expected[part]).max()


@pytest.mark.slow
def test_a_spring_along_a_direction_of_a_turning_body():
    """It may be drawn out far: its force acts on that body where the other one is, and its damper feels no turn."""
    stiffness, damping = 40.0, 0.3
    axis = np.array([0.6, -0.5, 0.7])
    along = axis / np.linalg.norm(axis)
    starts = np.zeros(3), np.array([0.1, 0.05, 0.0])
    hook, eye = np.array([0.03, 0.02, -0.04]), np.array([0.02, -0.06, 0.03])
    spins = [np.array([4.0, 5.0, -6.0]), np.array([-3.0, 2.0, 8.0])]
    a = RigidBody(
        "a", {"c": (0, 0, 0), "hook": SKEWED.T @ hook}, 0.9, INERTIA, rotation=SKEWED, angular_velocity=spins[0]
    )
    b = RigidBody("b", {"c": (0, 0, 0), "eye": eye}, 0.6, 0.7 * INERTIA, starts[1], angular_velocity=spins[1])
    springs = (SpringDamper("rail", "b.eye", "a.hook", axis, stiffness, damping, frame="a.hook"),)
    sensors = Motions("a", "a.c"), Motions("b", "b.c"), Encoder("drawn", "a.hook", "b.eye", axis, "a.hook")
    sensors = (*sensors, Motions("push", "b.eye", 2, "a.hook"), Motions("speed", "b.eye", 1, "a.hook"))
    record = run(Scene("rail", (a, b), springs=springs, sensors=sensors, damping_ratio=0.0), 0.8, 2e-4)

    def drawn(motions):
        return along @ (motions[0].R.T @ (motions[1].at(eye) - motions[0].at(hook)) - (starts[1] + eye - hook))

    def forces(_t, motions):
        first, second = motions
        now, there = first.R @ along, second.at(eye)
        rate = now @ (second.speed(eye) - first.v - np.cross(first.w, there - first.p))
        pull = -(stiffness * drawn(motions) + damping * rate) * now
        return wrench(-pull, there, first), wrench(pull, there, second)

    inertias = SKEWED @ INERTIA @ SKEWED.T, 0.7 * INERTIA
    found = integrate((0.9, 0.6), inertias, starts, spins, record.time[::100], forces)
    lengths = np.array([drawn(m) for m in found])
    assert np.ptp(lengths) > 0.08
    assert np.abs(record["drawn"][::100] - lengths).max() < 1e-5 * np.ptp(lengths)
    for k, name in enumerate("ab"):
        path = np.array([m[k].p for m in found]) - starts[k]
        assert np.abs(three(record, name)[::100] - path).max() < 1e-5 * 0.3
    speed = np.array([m[0].R.T @ m[1].speed(eye) for m in found])
    assert np.abs(three(record, "speed")[::100] - speed).max() < 1e-5 * np.abs(speed).max()
    along_a = np.array([m[0].R.T @ push_of_eye(m, forces(0, m)[1], eye, 0.6, 0.7 * INERTIA) for m in found])
    assert np.abs(three(record, "push")[::100] - along_a).max() < 2e-5 * np.abs(along_a).max()


def push_of_eye(motions, force, arm, mass, inertia):
    """Acceleration of a point of the second body under a force and moment about its centre, world frame."""
    m = motions[1]
    spread, at = m.R @ inertia @ m.R.T, m.R @ arm
    turning = np.linalg.solve(spread, force[3:] - np.cross(m.w, spread @ m.w))
    return force[:3] / mass + np.cross(turning, at) + np.cross(m.w, np.cross(m.w, at))


@dataclass(frozen=True)
class Speed(Sensor):
    """How fast two points move apart."""

    name: str
    a: str
    b: str

    def terms(self, scene):
        return (Output(self.name, "m/s", Distance(self.a, self.b), derivative=1),)


def test_a_platform_on_legs():
    """Springs and pushing legs along lines that turn: a body on three springs and one actuator, paths and lengths."""
    feet = {"f1": (0.2, 0.0, 0.3), "f2": (-0.1, 0.15, 0.3), "f3": (-0.1, -0.2, 0.25), "f4": (0.25, 0.3, 0.0)}
    feet = {name: np.array(at) for name, at in feet.items()}
    corners = {
        "p1": (0.05, 0.0, 0.02),
        "p2": (-0.03, 0.05, 0.01),
        "p3": (-0.02, -0.04, 0.03),
        "p4": (0.04, 0.02, -0.03),
    }
    corners = {name: np.array(at) for name, at in corners.items()}
    points = {"c": np.zeros(3), **{name: SKEWED.T @ at for name, at in corners.items()}}
    body = RigidBody("body", points, 0.7, INERTIA, rotation=SKEWED)
    springs = tuple(SpringDamper(f"s{k}", f"ground.f{k}", f"body.p{k}", "line", 30.0 * k, 0.05 * k) for k in (1, 2, 3))
    leg = LinearActuator("leg", "ground.f4", "body.p4", "push")
    sensors = (
        Motions("c", "body.c"),
        Encoder("length", "ground.f4", "body.p4", "line"),
        Speed("speed", "body.p1", "ground.f1"),
    )
    parts = {"springs": springs, "actuators": (leg,), "sensors": sensors}
    scene = Scene("platform", (ground(**feet), body), **parts, gravity=GRAVITY, damping_ratio=0.0)

    def push(t):
        return 4.0 * np.sin(8.0 * t)

    record = run(scene, 0.5, 2e-4, {"push": push}, start="released")

    def forces(t, motions):
        (m,) = motions
        total = np.concatenate([0.7 * GRAVITY, np.zeros(3)])
        for k in (1, 2, 3, 4):
            at = m.at(corners[f"p{k}"])
            line = at - feet[f"f{k}"]
            length = np.linalg.norm(line)
            drawn = length - np.linalg.norm(corners[f"p{k}"] - feet[f"f{k}"])
            speed = line @ m.speed(corners[f"p{k}"]) / length
            size = push(t) if k == 4 else -30.0 * k * drawn - 0.05 * k * speed
            total = total + wrench(size * line / length, at, m)
        return [total]

    inertia = SKEWED @ INERTIA @ SKEWED.T
    found = [m for (m,) in integrate([0.7], [inertia], np.zeros((1, 3)), np.zeros((1, 3)), record.time[::100], forces)]
    path = np.array([m.p for m in found])
    assert np.ptp(path, axis=0).max() > 0.1
    assert np.abs(three(record, "c")[::100] - path).max() < 1e-5 * 0.3
    length = np.array([np.linalg.norm(m.at(corners["p4"]) - feet["f4"]) for m in found])
    assert np.abs(record["length"][::100] - (length - length[0])).max() < 1e-5 * 0.3
    line = np.array([m.at(corners["p1"]) - feet["f1"] for m in found])
    speed = [a @ m.speed(corners["p1"]) / np.linalg.norm(a) for a, m in zip(line, found, strict=True)]
    assert np.abs(record["speed"][::100] - speed).max() < 2e-5 * np.abs(speed).max()


def test_forces_and_torques_that_turn_with_their_body():
    """A free body pushed beside its centre and turned about an axis of its own, beside those along the world's axes."""
    nose = np.array([0.05, -0.02, 0.04])
    body = RigidBody("body", {"c": (0, 0, 0), "nose": SKEWED.T @ nose}, 0.7, INERTIA, rotation=SKEWED)
    jet, twist, wind, torque = (np.array(v) for v in ([1.0, 2, -1], [0.5, -1, 0.3], [-1.0, 0, 2], [0, 1.0, 0]))
    actuators = (
        PointForce("jet", "body.nose", jet, "jet", frame="body.nose"),
        PointTorque("twist", "body.nose", twist, "twist", frame="body.nose"),
        PointForce("wind", "body.nose", wind, "wind"),
        PointTorque("torque", "body.c", "y", "torque"),
    )
    inputs = {
        "jet": lambda t: 2.0 * np.cos(3 * t),
        "twist": lambda t: 0.06 * np.sin(4 * t),
        "wind": lambda t: 0.8 * np.sin(2 * t),
        "torque": lambda t: 0.04 * np.cos(5 * t),
    }
    sensors = Motions("nose", "body.nose"), Motions("a", "body.nose", 2), Motions("w", "body.c", 1, turns=True)
    record = run(Scene("jet", (body,), actuators=actuators, sensors=sensors), 0.6, 2e-4, inputs)

    def forces(t, motions):
        (m,) = motions
        jets, twists, winds, torques = (f(t) for f in inputs.values())
        force = m.R @ jet / np.linalg.norm(jet) * jets + wind / np.linalg.norm(wind) * winds
        moment = m.R @ twist / np.linalg.norm(twist) * twists + torque * torques
        return [wrench(force, m.at(nose), m) + np.concatenate([np.zeros(3), moment])]

    inertia = SKEWED @ INERTIA @ SKEWED.T
    found = [m for (m,) in integrate([0.7], [inertia], np.zeros((1, 3)), np.zeros((1, 3)), record.time[::100], forces)]
    path = np.array([m.at(nose) for m in found])
    assert np.abs(path - path[0]).max() > 0.2
    assert np.abs(three(record, "nose")[::100] - (path - path[0])).max() < 1e-5
    rates = np.array([m.w for m in found])
    assert np.abs(three(record, "w")[::100] - rates).max() < 1e-5 * np.abs(rates).max()
    pushed = [
        push_of_eye((None, m), *forces(t, (m,)), nose, 0.7, inertia)
        for t, m in zip(record.time[::100], found, strict=True)
    ]
    assert np.abs(three(record, "a")[::100] - pushed).max() < 2e-5 * np.abs(pushed).max()


@dataclass(frozen=True)
class Twist(Actuator):
    """A torque about an axis along the axes of any body."""

    name: str
    point: str
    axis: np.ndarray
    frame: str

    def terms(self, scene):
        about = PointVelocity(((self.point, self.axis),), self.frame, angular=True)
        return (AppliedForce(self.name, "N m", about),)


def test_torques_on_a_floating_body_along_axes_of_three_kinds():
    """Of the world, of the bar, too stiff to bend and free, and of a top that spins beside it: Euler's equations."""
    model = lattice(stiffness=1e6)
    bar = craig_bampton(model, n_modes=1, progress=False)
    masses, spots = model.scalar_mass_matrix.diagonal(), model.fields[1:].T
    centre = masses @ spots / masses.sum()
    arms = (spots - centre) @ SKEWED.T
    inertia = (masses @ (arms**2).sum(axis=1)) * IDENTITY - arms.T @ (masses[:, None] * arms)
    body = FlexibleBody("bar", bar, -SKEWED @ centre, SKEWED, frame="right")
    spin = np.array([6.0, -4.0, 8.0])
    top = RigidBody("top", {"c": (0, 0, 0)}, 1.0, 1e-2 * IDENTITY, (1.0, 0, 0), angular_velocity=spin)
    own, still, other = np.array([[2.0, 1, -2], [-1, 2, 2], [2, -2, 1]]) / 3
    actuators = (
        PointTorque("own", "bar.right", own, "own", frame="bar.right"),
        PointTorque("still", "bar.right", still, "still"),
        Twist("other", "bar.left", other, "top.c"),
    )
    inputs = {
        "own": lambda t: 0.06 * np.sin(12 * t) ** 2,
        "still": lambda t: 0.06 * np.sin(18 * t) ** 2,
        "other": lambda t: -0.06 * np.sin(15 * t) ** 2,
    }
    scene = Scene("torques", (body, top), (), actuators, (Motions("w", "bar.left", 1, turns=True),), damping_ratio=0.0)
    record = run(scene, 0.1, 2e-3, inputs)

    def forces(t, motions):
        (m,) = motions
        sizes = [f(t) for f in inputs.values()]
        axes = m.R @ own, still, turned_by(*(t * spin)) @ other
        return [np.concatenate([np.zeros(3), sum(size * axis for size, axis in zip(sizes, axes, strict=True))])]

    found = integrate([masses.sum()], [inertia], np.zeros((1, 3)), np.zeros((1, 3)), record.time[::10], forces)
    rates = np.array([m.w for (m,) in found])
    assert Rotation.from_matrix(found[-1][0].R).magnitude() > 2.0
    assert np.abs(three(record, "w")[::10] - rates).max() < 3e-3 * np.abs(rates).max()
