"""What force sensors tell is what moves the bodies: Newton's and Euler's laws on the motion of the same run."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import turned_by
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Encoder,
    ForceSensor,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    simulate,
    static_response,
)
from nassim.scene.measures import Distance
from nassim.scene.part import Actuator
from nassim.scene.springs import Bushing
from nassim.scene.terms import AppliedForce
from nassim.simulation.run.simulate import simulate_motion

STEP = 1e-4
MASSES = 0.8, 0.5


TURNS = turned_by(0.7, -0.4, 1.2), turned_by(-0.5, 0.9, 0.3)
INERTIAS = tuple(t @ np.diag(j) @ t.T for t, j in zip(TURNS, ([2e-3, 3e-3, 4e-3], [1e-3, 2.5e-3, 2e-3]), strict=True))
"""Along the bodies' own axes."""


def two_bodies(*, apart=(0.02, -0.05, 0.03), spins=((2.0, -3.0, 1.0), (-1.0, 2.5, 4.0))):
    """Free bodies that turn differently about odd axes, tied at points beside their centres."""
    at = np.array([0.3, -0.2, 0.4])
    arms = np.array([-0.04, 0.03, 0.02]), np.array([0.05, 0.01, -0.03])
    return tuple(
        RigidBody(
            name, {"tie": rotation.T @ arm, "c": np.zeros(3)}, mass, inertia, place - arm,
            rotation=rotation, angular_velocity=spin,
        )
        for name, rotation, arm, mass, inertia, place, spin in zip(
            ("a", "b"), TURNS[::-1], arms, MASSES, INERTIAS, (at, at + apart), spins, strict=True
        )
    )  # fmt: skip


def run(scene, n=400):
    time = 2.0 + STEP * np.arange(n + 1)
    nothing = TimeHistory(time, np.zeros((0, n + 1)), (), ())
    return simulate_motion(scene, nothing, time_step=STEP, frames=n + 1, progress=False)


def rates(values):
    """Central differences but for the ends, of (n, ...)."""
    return (values[2:] - values[:-2]) / (2 * STEP)


def momentum_rates(motion, bodies):
    """Of each body, from where it was: m a, (n, 3), and the rate of its spin's angular momentum, (n, 3)."""
    for body in bodies:
        places, turns = motion.positions[body.name], motion.rotations[body.name]
        spins = np.einsum("nij,nkj->nik", rates(turns), turns[1:-1])
        spin = np.column_stack([spins[:, 2, 1], spins[:, 0, 2], spins[:, 1, 0]])
        momenta = np.einsum("nij,jk,nlk,nl->ni", turns[1:-1], body.inertia, turns[1:-1], spin)
        yield body.mass * rates(rates(places)), rates(momenta)


@pytest.mark.parametrize("frame", ["a", "b", "line"])
def test_a_spring_pulls_with_what_its_sensor_tells(frame):
    """Along a direction that turns with either body, and along a line."""
    bodies = two_bodies(apart=(0.02, -0.3, 0.1))
    axis = np.array([2.0, -1.0, 2.0]) / 3
    options = {"axis": "line"} if frame == "line" else {"axis": 3 * axis, "frame": f"{frame}.tie"}
    spring = SpringDamper("spring", "a.tie", "b.tie", stiffness=900.0, damping=6.0, **options)
    scene = Scene("two", bodies, springs=(spring,), sensors=(ForceSensor("pull", "spring"),), damping_ratio=0.0)
    record, motion = run(scene)
    pull = record["pull"]
    if frame == "line":
        ends = [motion.positions[b.name] + motion.rotations[b.name] @ b.points["tie"] for b in bodies]
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0], axis=1)[:, None]
    else:
        body = bodies["ab".index(frame)]
        along = motion.rotations[frame] @ body.rotation.T @ axis
    expected = (pull[:, None] * along)[2:-2]
    (first, _), (second, _) = momentum_rates(motion, bodies)
    size = np.abs(pull).max()
    assert np.ptp(pull) > 0.5
    np.testing.assert_allclose(first, expected, atol=1e-3 * size)
    np.testing.assert_allclose(second, -expected, atol=1e-3 * size)


@pytest.mark.parametrize("held", ["", "a", "b"])
@pytest.mark.parametrize("apart", [(0.0, 0.0, 0.0), (0.02, -0.05, 0.03)])
def test_a_bushing_pulls_with_what_its_sensors_tell(apart, held):
    """All six, of a coupled bushing at the place of b, along axes halfway between two bodies; one may stand."""
    bodies = two_bodies(apart=apart)
    bodies = tuple(
        replace(b, fixed=True, angular_velocity=np.zeros(3), mass=None, inertia=None) if b.name == held else b
        for b in bodies
    )
    axes = turned_by(0.4, 0.8, -0.5)
    root = np.random.default_rng(3).normal(size=(6, 6)) * np.repeat([20.0, 1.5], 3)[:, None]
    stiffness = root @ root.T + np.diag([900.0, 700.0, 500.0, 4.0, 5.0, 6.0])
    damping = 5e-3 * stiffness + np.diag([1.0, 2.0, 3.0, 1e-2, 2e-2, 1e-2])
    bushing = Bushing("pad", "a.tie", "b.tie", stiffness, damping, axes)
    record, motion = run(
        Scene("two", bodies, springs=(bushing,), sensors=(ForceSensor("pull", "pad"),), damping_ratio=0.0)
    )
    first, second = (motion.rotations[b.name] @ b.rotation.T for b in bodies)
    between = Rotation.from_matrix(np.einsum("nji,njk->nik", first, second)).as_rotvec()
    halfway = first @ Rotation.from_rotvec(between / 2).as_matrix() @ axes
    force, moment = (
        np.einsum("nij,jn->ni", halfway, [record[f"pull.{kind}{letter}"] for letter in "xyz"])[2:-2] for kind in "fm"
    )
    end = (motion.positions["b"] + motion.rotations["b"] @ bodies[1].points["tie"])[2:-2]
    arms = [end - motion.positions[name][2:-2] for name in "ab"]
    free = [(body, arm, sign) for body, arm, sign in zip(bodies, arms, (1, -1), strict=True) if body.name != held]
    moved = momentum_rates(motion, [body for body, *_ in free])
    for (pushed, turned), (_, arm, sign) in zip(moved, free, strict=True):
        np.testing.assert_allclose(pushed, sign * force, atol=2e-3 * np.abs(force).max())
        whole = moment + np.cross(arm, force)
        np.testing.assert_allclose(turned, sign * whole, atol=0.01 * np.abs(whole).max())


@dataclass(frozen=True)
class Screw(Actuator):
    """A force along a line behind an amplifier."""

    name: str
    a: str
    b: str
    bandwidth: float

    def terms(self, scene):
        return (AppliedForce("push", "N", Distance(self.a, self.b), 2.5, self.bandwidth),)


def test_a_push_along_a_line_lags_behind_its_amplifier():
    """A free mass between the ends of two lines: the integrals of 1 - exp(-w t), from the first sample on."""
    ends = {"near": np.array([0.1, -0.2, 0.3]), "far": np.array([0.5, 0.6, 0.3])}
    along = np.array([0.4, 0.8, 0.0]) / np.hypot(0.4, 0.8)
    base = RigidBody("base", ends, fixed=True)
    load = RigidBody("load", {"c": np.zeros(3)}, 0.6, INERTIAS[0], (ends["near"] + ends["far"]) / 2)
    screws = Screw("front", "base.near", "load.c", 20.0), Screw("back", "load.c", "base.far", 20.0)
    sensors = Vibrometer("v", "load.c", along), Encoder("x", "base.near", "load.c", "line")
    time = 3.0 + STEP * np.arange(401)
    push = TimeHistory(time, np.full((1, 401), 0.7), ("push",), ("N",))
    one = Scene("one", (base, load), actuators=screws[:1], sensors=sensors)
    record = simulate(one, push, time_step=STEP, progress=False)
    t, rate, size = time - 3.0, 2 * np.pi * 20.0, 2.5 * 0.7 / 0.6
    speed = size * (t + np.expm1(-rate * t) / rate)
    np.testing.assert_allclose(record["v"], speed, atol=2e-4 * speed[-1])
    way = size * (t**2 / 2 - t / rate - np.expm1(-rate * t) / rate**2)
    np.testing.assert_allclose(record["x"], way, atol=2e-4 * way[-1])
    both = simulate(replace(one, actuators=screws), push, time_step=STEP, progress=False)
    np.testing.assert_allclose(both["v"], 0.0, atol=1e-9 * speed[-1])


@pytest.mark.parametrize("axis", [(-2.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, -1.0), "x"])
def test_springs_along_the_worlds_axes_have_no_sign(axis):
    """Between two free bodies, of which one is pushed: the step response of their distance."""
    unit = np.array([1.0, 0.0, 0.0]) if axis == "x" else np.array(axis) / np.linalg.norm(axis)
    bodies = tuple(RigidBody(n, {"c": (0, 0, 0)}, m, j) for n, m, j in zip("ab", MASSES, INERTIAS, strict=True))
    spring = SpringDamper("spring", "a.c", "b.c", axis, 900.0, 6.0)
    scene = Scene(
        "two", bodies, actuators=(PointForce("push", "b.c", axis, "push"),), springs=(spring,),
        sensors=(Encoder("gap", "a.c", "b.c", unit), ForceSensor("pull", "spring")), damping_ratio=0.0,
    )  # fmt: skip
    time = 1.0 + STEP * np.arange(1001)
    record = simulate(scene, TimeHistory(time, np.ones((1, 1001)), ("push",), ("N",)), time_step=STEP, progress=False)
    reduced = 0.8 * 0.5 / 1.3
    poles = np.roots([reduced, 6.0, 900.0])
    shares = [1 / (reduced * s * (s - other)) for s, other in zip(poles, poles[::-1], strict=True)]
    t = time - 1.0
    gap = reduced / 0.5 * (1 / 900.0 + np.real(np.exp(np.outer(t, poles)) @ shares))
    speed = reduced / 0.5 * np.real(np.exp(np.outer(t, poles)) @ (shares * poles))
    np.testing.assert_allclose(record["gap"], gap, atol=1e-4 * gap.max())
    pull = 900.0 * gap + 6.0 * speed
    np.testing.assert_allclose(record["pull"], pull, atol=1e-3 * pull.max())


def test_reach_of_a_machine_smaller_than_a_millimetre():
    """A bushing between points 50 micrometres apart turns what it hangs on by force times that arm."""
    far = np.array([5e-5, 0.0, 0.0])
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True)
    inertia = 1e-13 * np.diag([2.0, 3.0, 4.0])
    first = RigidBody("first", {"o": np.zeros(3)}, 1e-6, inertia)
    second = RigidBody("second", {"o": np.zeros(3)}, 1e-6, inertia, far)
    hinge = Bushing("hinge", "base.o", "first.o", [1e3, 1e3, 1e3, 1e-5, 1e-5, 1e-5])
    pad = Bushing("pad", "first.o", "second.o", [1e3, 1e3, 1e3, 1e-5, 1e-5, 1e-5])
    scene = Scene(
        "small", (base, first, second), springs=(hinge, pad), actuators=(PointForce("push", "second.o", "y", "push"),),
        sensors=(AngleSensor("turn", "base.o", "first.o"), Encoder("way", "base.o", "second.o", "y")),
    )  # fmt: skip
    found = static_response(scene, {"push": 1e-3})
    assert found["turn"] == pytest.approx(1e-3 * 5e-5 / 1e-5, rel=1e-3)
    assert found["way"] == pytest.approx(2 * 1e-3 / 1e3 + 5e-5 * 1e-3 * 5e-5 / 1e-5, rel=1e-3)
