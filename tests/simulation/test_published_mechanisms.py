"""Closed mechanisms of rigid bodies in large motion, of the literature: a squeezer, a linkage, a row of four-bars.

Squeezer (Andrews): E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section VI.9; figures at 0.03 s:
Test set for initial value problem solvers, University of Bari. Linkage (R. Bricard, 1897): six equal links, of which
the count of constraints says that they cannot move; for angles a and b of neighbouring joints, cos a + cos b + cos a
cos b is 0. Row: a benchmark of IFToMM's library for multibody dynamics; it can branch where all bars lie in one line.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Drive,
    FlexibleBody,
    Joint,
    PointTorque,
    RigidBody,
    Scene,
    Simulation,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    fixed,
    revolute,
    simulate,
)
from nassim.simulation.exudyn.held_directions import HeldDirections

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
START = {
    "beta": -0.0617138900142764496,
    "theta": 0.0,
    "gamma": 0.455279819163070380,
    "phi": 0.222668390165885884,
    "delta": 0.487364979543842550,
    "omega": -0.222668390165885884,
    "epsilon": 1.23054744454982119,
}
END = {
    "beta": 15.81077119629904,
    "theta": -15.75637105984298,
    "gamma": 0.04082224013073101,
    "phi": -0.5347301163226948,
    "delta": 0.5244099658805304,
    "omega": 0.5347301163226948,
    "epsilon": 1.048080741042263,
}


def polar(angle):
    """A unit vector in the plane and the one a quarter turn on, (2, 2)."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def in_space(point):
    return TURN @ np.append(point, 0.0)


def squeezer():
    """Seven bodies on ten revolute joints, turned about an odd axis."""
    beta, theta, gamma, phi, delta, omega, epsilon = START.values()
    turns = [beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon]
    (crank, _), (rod, _), (x3, y3), (_, y4), (x5, y5), (x6, _), (x7, y7) = map(polar, turns)
    a, b, c, o = np.array([-69.34, -2.27]), np.array([-36.35, 32.73]), np.array([14.0, 72.0]), np.zeros(2)
    pin = 7.0 * crank
    middle = pin - 28.0 * rod
    centres = [
        0.92 * crank,
        pin - 11.5 * rod,
        b + 10.43 * x3 - 18.74 * y3,
        a + 40.0 * x5 - (20.0 - 14.21) * y4,
        a + 23.08 * x5 + 9.16 * y5,
        a - 40.0 * y7 + (20.0 - 14.21) * x6,
        a - 4.49 * x7 - 12.28 * y7,
    ]
    points = [
        {"o": o, "p": pin},
        {"p": pin, "q": middle},
        {"b": b, "q": middle, "d": b + 20.0 * x3 - 18.0 * y3},
        {"e": a + 40.0 * x5, "q": middle},
        {"a": a, "e": a + 40.0 * x5},
        {"f": a - 40.0 * y7, "q": middle},
        {"a": a, "f": a - 40.0 * y7},
    ]
    masses = [43.25, 3.65, 23.73, 7.06, 70.50, 7.06, 54.98]  # g
    inertias = [2.194, 0.441, 5.255, 0.5667, 11.69, 0.5667, 19.12]  # kg mm2
    bodies = [
        RigidBody("ground", {n: 1e-3 * in_space(p) for n, p in zip("oabc", (o, a, b, c), strict=True)}, fixed=True)
    ]
    for k in range(7):
        own = {name: 1e-3 * np.append(polar(turns[k]) @ (point - centres[k]), 0.0) for name, point in points[k].items()}
        inertia = 1e-6 * inertias[k] * np.diag([0.6, 0.7, 1.0])
        rotation = TURN @ Rotation.from_euler("z", turns[k]).as_matrix()
        pose = {"position": 1e-3 * in_space(centres[k]), "rotation": rotation}
        bodies.append(RigidBody(f"k{k + 1}", own, 1e-3 * masses[k], inertia, **pose))
    axis = in_space(o) + TURN[:, 2]
    pairs = {
        "beta": ("ground.o", "k1.o"),
        "theta": ("k1.p", "k2.p"),
        "gamma": ("ground.b", "k3.b"),
        "phi": ("k5.e", "k4.e"),
        "delta": ("ground.a", "k5.a"),
        "omega": ("k7.f", "k6.f"),
        "epsilon": ("ground.a", "k7.a"),
    }
    loops = {"3": ("k2.q", "k3.q"), "4": ("k2.q", "k4.q"), "6": ("k2.q", "k6.q")}
    length = np.linalg.norm(points[2]["d"] - c)
    return Scene(
        "squeezer",
        bodies,
        [revolute(name, *pair, axis) for name, pair in (pairs | loops).items()],
        [PointTorque("motor", "k1.o", axis, "torque")],
        [AngleSensor(name, *pair, axis) for name, pair in pairs.items()],
        [SpringDamper("spring", "ground.c", "k3.d", "line", 4530.0, preload=4.530 * (length - 77.85))],
        damping_ratio=0.0,
    )


def test_andrews_squeezer_arrives_where_it_was_published():
    """The crank turns 15.9 rad in 0.03 s. The errors are those of the time steps: half the step leaves a quarter."""
    time = np.arange(1001) * 3e-5
    torque = TimeHistory(time, np.full((1, 1001), 0.033), ("torque",), ("N m",))
    record = simulate(squeezer(), torque, time_step=3e-5, start="released", progress=False)
    errors = {name: abs(START[name] + record[name][-1] - end) for name, end in END.items()}
    assert max(errors["beta"], errors["theta"]) < 2e-3
    assert max(error for name, error in errors.items() if name not in ("beta", "theta")) < 3e-5


def linkage(order):
    """Bricard's linkage along six edges of a cube, one of them fixed; its joints in some order."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1], [0, 0, 1.0]])
    axes = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
    names = ["ground", *(f"link{k}" for k in range(1, 6))]
    bodies = [RigidBody("ground", {"j0": TURN @ corners[0], "j1": TURN @ corners[1]}, fixed=True)]
    for k in range(1, 6):
        start, end = corners[k], corners[(k + 1) % 6]
        along = end - start
        own = np.column_stack([along, np.roll(along, 1), np.cross(along, np.roll(along, 1))])
        points = {f"j{k}": [-0.5, 0, 0], f"j{(k + 1) % 6}": [0.5, 0, 0]}
        pose = {"position": TURN @ (start + end) / 2, "rotation": TURN @ own}
        bodies.append(RigidBody(names[k], points, 1.0, np.diag([6e-3, 0.09, 0.085]), **pose))
    pairs = [(f"{names[k - 1]}.j{k}", f"{names[k]}.j{k}", TURN @ axes[k]) for k in range(6)]
    return Scene(
        "linkage",
        bodies,
        [revolute(f"j{k}", *pairs[k]) for k in order],
        sensors=[AngleSensor(f"angle{k}", *pairs[k]) for k in range(6)],
        gravity=TURN @ [0, -9.81, 0.3],
        damping_ratio=0.0,
    )


FALL = {"time_step": 2e-3, "start": "released", "progress": False}


@pytest.mark.parametrize("order", ["012345", "140532", "354021"])
def test_bricards_linkage_moves_and_closes(order):
    """No choice of 29 of its 30 held directions stays independent, in the latter orders to 1.2 and 0.9 s."""
    record = simulate(linkage(map(int, order)), None, duration=4.0, **FALL)
    angles = [record[f"angle{k}"] for k in range(6)]
    assert min(map(np.ptp, angles)) > np.pi
    for angle, sign, like in zip(angles[2:], (-1, -1, -1, 1), (0, 1, 0, 1), strict=True):
        np.testing.assert_allclose(angle, sign * angles[like], atol=1e-7)
    cosines = np.cos(np.pi / 2 - angles[0]), np.cos(np.pi / 2 + angles[1])
    np.testing.assert_allclose(sum(cosines) + np.prod(cosines, axis=0), 0.0, atol=1e-7)


@pytest.mark.parametrize(("order", "driven"), [("012345", 0), ("543210", 0), ("203145", 3)])
def test_bricards_linkage_is_driven(order, driven, monkeypatch):
    """The direction that the drive moves is never left out, and the others are chosen to be independent of it too."""
    choose, shares = HeldDirections._best, []

    def choose_and_compare(self, rows):
        """Compare the least singular value with those of all choices that leave out one direction that may be."""
        chosen = choose(self, rows)
        all_of_them = (*self._free, *self._bound)
        others = (
            {n: tuple(c for joint, c in all_of_them if joint == n and (n, c) != out) for n in self._joints}
            for out in self._free
        )
        most = max(self._independence(rows, one) for one in others)
        shares.append(self._independence(rows, chosen) / most)
        return chosen

    monkeypatch.setattr(HeldDirections, "_best", choose_and_compare)
    time = np.arange(501) * 2e-3
    turn = 2.5 * np.sin(np.pi / 2 * np.minimum(time, 1.0)) ** 2
    scene = replace(linkage(map(int, order)), actuators=[Drive("motor", f"j{driven}", "rz", input="turn")])
    record = simulate(scene, TimeHistory(time, [turn], ("turn",), ("rad",)), time_step=2e-3, progress=False)
    np.testing.assert_allclose(record[f"angle{driven}"], turn, atol=1e-7)
    cosines = np.cos(np.pi / 2 - record["angle0"]), np.cos(np.pi / 2 + record["angle1"])
    np.testing.assert_allclose(sum(cosines) + np.prod(cosines, axis=0), 0.0, atol=1e-7)
    assert min(shares, default=1.0) > 0.5


@pytest.mark.parametrize("order", ["012345", "354021"])
def test_a_body_that_deforms_between_joints_keeps_its_directions_beside_a_linkage(order):
    """A bar on a hinge whose other end is held too: only its deformation tells the eleven directions apart."""
    bar = craig_bampton(lattice(stiffness=1e7), n_modes=0, progress=False)
    ends = {name: TURN @ bar.point(name).position for name in ("left", "right")}
    along = Rotation.align_vectors([ends["right"] - ends["left"]], [[1.0, 0, 0]])[0].as_matrix()
    joints = [
        revolute("hinge", "wall.left", "bar.left", along[:, 0]),
        Joint("end", "wall.right", "bar.right", ("x", "z", "rx", "ry", "rz"), along),
    ]
    alone = linkage(map(int, order))
    flexible = FlexibleBody("bar", bar, rotation=TURN, fidelity="ffrf")
    bodies = (*alone.bodies, RigidBody("wall", ends, fixed=True), flexible)
    beside = replace(alone, bodies=bodies, joints=(*alone.joints, *joints))
    first, second = (simulate(scene, None, duration=2.0, **FALL) for scene in (alone, beside))
    assert np.ptp(first["angle0"]) > np.pi
    np.testing.assert_allclose(second["angle0"], first["angle0"], atol=1e-6)


def test_a_body_that_carries_a_link_is_held_twice():
    """A bar on two points of a link, which it carries as its second joint holds it through its deformation alone."""
    bar = craig_bampton(lattice(stiffness=1e7), n_modes=0, progress=False)
    ends = {name: bar.point(name).position for name in ("left", "right")}
    alone = linkage([3, 5, 4, 0, 2, 1])
    link = alone.body("link2")
    flexible = FlexibleBody("bar", bar, position=link.position, rotation=link.rotation, fidelity="ffrf")
    link = replace(link, points={**link.points, **ends})
    bodies = [link if body.name == "link2" else body for body in alone.bodies]
    glued = [fixed(name, f"link2.{name}", f"bar.{name}") for name in ends]
    scene = replace(alone, bodies=(*bodies, flexible), joints=(*alone.joints, *glued))
    record = simulate(scene, None, duration=4.0, **FALL)
    assert np.ptp(record["angle0"]) > np.pi
    cosines = np.cos(np.pi / 2 - record["angle0"]), np.cos(np.pi / 2 + record["angle1"])
    np.testing.assert_allclose(sum(cosines) + np.prod(cosines, axis=0), 0.0, atol=1e-6)


def test_a_run_goes_on_with_the_directions_that_it_held():
    scene = linkage([3, 5, 4, 0, 2, 1])
    with Simulation(scene, time_step=2e-3, start="released") as run:
        for _ in range(600):
            run.step()
        state = run.state
        for _ in range(100):
            run.step()
        last = run.outputs
    with Simulation(scene, time_step=2e-3, start="released") as again:
        again.restore(state)
        for _ in range(100):
            again.step()
        assert again.outputs == last


def test_a_row_of_four_bars_passes_where_it_could_branch():
    """Three cranks and two rods of one metre and one kilogram; the cranks stand, and their tops start at 1 m/s."""
    bar, axis = np.array([1 / 12, 1e-3, 1 / 12]), TURN[:, 2]
    bodies = [RigidBody("ground", {f"o{k}": in_space([k, 0]) for k in range(3)}, fixed=True)]
    joints = []
    for k in range(3):
        pose = {"position": in_space([k, 0.5]), "rotation": TURN, "angular_velocity": -axis}
        bodies.append(RigidBody(f"crank{k}", {"o": [0, -0.5, 0], "t": [0, 0.5, 0]}, 1.0, np.diag(bar), **pose))
        joints.append(revolute(f"o{k}", f"ground.o{k}", f"crank{k}.o", axis))
    for k in range(2):
        pose = {"position": in_space([k + 0.5, 1.0]), "rotation": TURN}
        bodies.append(RigidBody(f"rod{k}", {"l": [-0.5, 0, 0], "r": [0.5, 0, 0]}, 1.0, np.diag(bar[[1, 0, 2]]), **pose))
        joints.append(revolute(f"l{k}", f"crank{k}.t", f"rod{k}.l", axis))
        joints.append(revolute(f"r{k}", f"rod{k}.r", f"crank{k + 1}.t", axis))
    sensors = [AngleSensor(f"angle{k}", f"ground.o{k}", f"crank{k}.o", axis) for k in range(3)]
    scene = Scene("row", bodies, joints, (), sensors, gravity=in_space([0, -9.81]), damping_ratio=0.0)
    record = simulate(scene, None, duration=2.0, time_step=4e-3, start="released", progress=False)
    # Cranks turn about their ends, rods translate.
    pull, inertia = 9.81 * (3 / 2 + 2), 3 / 3 + 2
    fall = solve_ivp(lambda _, y: [y[1], pull * np.sin(y[0]) / inertia], (0, 2), [0.0, -1.0], rtol=1e-10, atol=1e-12)
    assert fall.y[0, -1] < -1.5 * np.pi
    for k in range(3):
        assert record[f"angle{k}"][-1] == pytest.approx(fall.y[0, -1], rel=1e-3)
