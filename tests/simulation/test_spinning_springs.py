"""What springs of every kind and joints of any axes bear in spinning scenes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nassim import Bushing, Encoder, Joint, RigidBody, Scene, SpringDamper, linearize, placed, revolute
from nassim.systems import damping

SPEED, RADIUS, HUB = 9.0, 0.5, 0.2
LENGTH = RADIUS - HUB
INERTIA = np.diag([2e-3, 3e-3, 4e-3])
SKEW = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
SKEW *= np.linalg.det(SKEW)


def wire(spring, free=("x", "y", "z")):
    """A mass that may shift but not turn, on a radial spring so stiff that it keeps its length."""
    table = RigidBody("table", {"hub": [HUB, 0, 0], "rail": [RADIUS, 0, 0]}, fixed=True)
    mass = RigidBody("mass", {"c": np.zeros(3)}, 0.7, INERTIA, [RADIUS, 0, 0])
    joints = (Joint("rail", "table.rail", "mass.c", free),)
    return Scene("wire", (table, mass), joints, springs=(spring,), damping_ratio=0.0)


def frequencies(scene, angular_velocity=(0, 0, SPEED), point=(0, 0, 0)):
    return np.sort(damping(linearize(scene, angular_velocity=angular_velocity, axis_point=point))[0]) * 2 * np.pi


def test_a_mass_on_a_radial_wire_swings_like_a_pendulum():
    """Out of the plane W sqrt(r / l), in it W sqrt(hub / l), as its tension m W^2 r turns with it."""
    found = frequencies(wire(SpringDamper("wire", "table.hub", "mass.c", "line", 1e9)))
    expected = SPEED * np.sqrt([HUB / LENGTH, RADIUS / LENGTH])
    np.testing.assert_allclose(found[:2], expected, rtol=1e-4)


def test_a_spring_along_a_direction_of_the_table_bears_nothing_across():
    """Its direction does not follow the mass: neutral out of the plane, unstable in it."""
    for spring in (
        SpringDamper("s", "table.hub", "mass.c", "x", 1e9),
        SpringDamper("s", "table.hub", "mass.c", (1.0, 0, 0), 1e9, frame="table.hub"),
    ):
        model = linearize(wire(spring), angular_velocity=(0, 0, SPEED))
        assert model.poles().real.max() == pytest.approx(SPEED, rel=1e-4)


def test_a_spring_that_turns_with_the_mass():
    """A stiff spring along axes of a mass that may turn about z: the force m W^2 r stays on the mass's own line."""
    stiff = SpringDamper("s", "table.hub", "mass.c", (1.0, 0, 0), 1e9, frame="mass.c")
    line = SpringDamper("l", "table.hub", "mass.c", "line", 1e9)
    # Held at the hub by its own axes, the mass turns as a pendulum whose arm reaches there; a bar with a hinge does so.
    table = RigidBody("table", {"hub": [HUB, 0, 0]}, fixed=True)
    bar = RigidBody("mass", {"hub": [-LENGTH, 0, 0]}, 0.7, INERTIA, [RADIUS, 0, 0])
    hinged = Scene("bar", (table, bar), (revolute("hinge", "table.hub", "mass.hub", "z"),), damping_ratio=0.0)
    expected = SPEED * np.sqrt(0.7 * HUB * LENGTH / (INERTIA[2, 2] + 0.7 * LENGTH**2))
    np.testing.assert_allclose(frequencies(hinged)[:1], [expected], rtol=1e-9)
    across = SpringDamper("t", "table.hub", "mass.c", (0, 1.0, 0), 1e9, frame="mass.c")
    held = Scene("held", wire(line).bodies, (Joint("flat", "table.rail", "mass.c", ("x", "y", "rz")),),
                 springs=(stiff, across), damping_ratio=0.0)  # fmt: skip
    np.testing.assert_allclose(frequencies(held)[:1], [expected], rtol=1e-4)


def test_a_stiff_bushing_is_a_joint():
    """Of a bar hinged beside the axis about an odd axis, on a soft torsion spring."""
    table = RigidBody("table", {"hub": [HUB, 0.05, 0.03]}, fixed=True)
    bar = RigidBody("bar", {"hub": [-LENGTH, 0, 0.02]}, 0.7, INERTIA, [RADIUS, 0.05, 0.01])
    soft = Bushing("hub", "table.hub", "bar.hub", [0, 0, 0, 0, 0, 40.0], axes=SKEW)
    stiff = Bushing("hub", "table.hub", "bar.hub", [1e9, 1e9, 1e9, 1e7, 1e7, 40.0], axes=SKEW)
    hinge = Joint("hub", "table.hub", "bar.hub", ("rz",), SKEW)
    found, expected = (
        frequencies(Scene("hub", (table, bar), joints, springs=(spring,), damping_ratio=0.0))
        for joints, spring in (((), stiff), ((hinge,), soft))
    )
    np.testing.assert_allclose(found[:1], expected[:1], rtol=1e-4)


def test_a_spinning_scene_turned_as_a_whole_has_the_same_poles():
    table = RigidBody("table", {"hub": [HUB, 0.05, 0.03], "wall": [0.1, 0.4, 0.2]}, fixed=True)
    bar = RigidBody(
        "bar",
        {"hub": [-LENGTH, 0, 0.02], "tip": [0.1, 0.05, 0]},
        0.7,
        INERTIA,
        [RADIUS, 0.05, 0.01],
        rotation=np.eye(3),
    )
    scene = Scene(
        "machine",
        (table, bar),
        (Joint("hub", "table.hub", "bar.hub", ("rz", "ry")),),
        (),
        (Encoder("e", "table.wall", "bar.tip", "x"),),
        (
            SpringDamper("leg", "table.wall", "bar.tip", "line", 4e3, 1.0),
            SpringDamper("rail", "table.wall", "bar.tip", (0.0, 0.6, 0.8), 2e3, 2.0, frame="table.wall"),
            Bushing(
                "rubber",
                "table.hub",
                "bar.hub",
                np.diag([0, 0, 0, 10.0, 20.0, 30.0]),
                np.diag([0, 0, 0, 0.01, 0.02, 0.03]),
            ),
        ),
        damping_ratio=0.0,
    )
    turned = placed(scene, "there", position=(0.3, -0.2, 0.1), rotation=SKEW)
    velocity = np.array([2.0, -1.0, 7.0])
    found = linearize(turned, angular_velocity=SKEW @ velocity, axis_point=(0.3, -0.2, 0.1)).poles()
    expected = linearize(scene, angular_velocity=velocity).poles()
    for pole in expected:
        assert np.abs(found - pole).min() < 1e-7 * np.abs(pole)
    assert np.abs(expected - linearize(scene).poles()[:, None]).min(axis=0).max() > 0.05


def cloud(mass, inertia):
    """Six point masses with a mass and an inertia about their centre: masses (6,), places (6, 3)."""
    moments, axes = np.linalg.eigh(inertia)
    reach = np.sqrt(3 * (moments.sum() / 2 - moments) / mass)
    return np.full(6, mass / 6), np.vstack([axes.T * reach[:, None], -axes.T * reach[:, None]])


def turn(vector):
    return Rotation.from_rotvec(vector).as_matrix()


def test_bushings_that_bear_force_and_moment():
    """Two bodies in a chain, each free to tilt on a bushing that else is stiff, whose points lie apart.

    They lie in a plane across the axis, so that the stiff directions bear all. Against Lagrange's equations of point
    masses: energies of finite rotations, differentiated numerically, twice Coriolis, the turn at which moments act.
    """
    spin, inertias = 12.0, [np.diag([2e-3, 3e-3, 4e-3]), np.diag([1e-3, 2.5e-3, 2e-3])]
    masses, centres = (0.6, 0.9), np.array([[0.25, 0.1, 0.0], [0.4, 0.3, 0.0]])
    ties = np.array([[[0.2, 0.0, 0.0], [0.22, 0.05, 0.0]], [[0.26, 0.15, 0.0], [0.33, 0.24, 0.0]]])
    soft = np.array([[[60.0, 15.0], [15.0, 40.0]], [[30.0, -8.0], [-8.0, 50.0]]])
    stiff = 1e6
    matrices = [np.diag([1e11, 1e11, 1e11, stiff, stiff, stiff]) for _ in soft]
    for matrix, tilts in zip(matrices, soft, strict=True):
        matrix[3:5, 3:5] = tilts
    bodies = [RigidBody("table", {"a": SKEW @ ties[0, 0]}, fixed=True)]
    for k, name in enumerate(("first", "second")):
        points = {"b": ties[k, 1] - centres[k], "a": ties[1, 0] - centres[k]}
        bodies.append(RigidBody(name, points, masses[k], inertias[k], SKEW @ centres[k], rotation=SKEW))
    pads = tuple(
        Bushing(b, f"{a}.a", f"{b}.b", k, axes=SKEW)
        for a, b, k in zip(("table", "first"), ("first", "second"), matrices, strict=True)
    )
    scene = Scene("chain", tuple(bodies), springs=pads, damping_ratio=0.0)
    found = np.sort(linearize(scene, angular_velocity=spin * SKEW[:, 2]).poles().imag)
    clouds = [cloud(m, j) for m, j in zip(masses, inertias, strict=True)]
    weights = np.concatenate([w for w, _ in clouds])

    def positions(q):
        one, two = turn(q[:3]), turn(q[3:])
        at = ties[0, 1] + one @ (centres[0] - ties[0, 1])
        end = ties[0, 1] + one @ (ties[1, 1] - ties[0, 1])
        other = end + two @ (centres[1] - ties[1, 1])
        return np.vstack([at + clouds[0][1] @ one.T, other + clouds[1][1] @ two.T])

    def energy(q):
        one, two = turn(q[:3]), turn(q[3:])
        twists = q[:3], Rotation.from_matrix(one.T @ two).as_rotvec()
        strained = sum(0.5 * t @ k[3:, 3:] @ t for t, k in zip(twists, matrices, strict=True))
        return strained - 0.5 * spin**2 * weights @ np.sum(positions(q)[:, :2] ** 2, axis=1)

    step, n = 3e-5, 6
    each, rest = step * np.eye(n), np.zeros(n)
    for _ in range(2):
        slope = np.array([energy(rest + e) - energy(rest - e) for e in each]) / (2 * step)
        corners = [
            [sum(i * j * energy(rest + i * a + j * b) for i in (1, -1) for j in (1, -1)) for a in each] for b in each
        ]
        curvature, at = np.array(corners) / (4 * step**2), rest
        rest = rest - np.linalg.solve(curvature, slope)
    assert 1 < stiff * np.abs(rest).max() < 20, "the moment that the stiff direction bears"
    np.testing.assert_allclose(rest, at, atol=1e-9)
    moving = np.array([(positions(rest + e) - positions(rest - e)) / (2 * step) for e in each])
    mass = np.einsum("jpa,p,kpa->jk", moving, weights, moving)
    coriolis = 2 * np.einsum("jpa,p,kpa->jk", moving, weights, np.cross([0, 0, spin], moving))
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ curvature, -inverse @ coriolis]])
    expected = np.sort(np.linalg.eigvals(state).imag)[n : n + 4]
    still = np.sort(linearize(scene).poles().imag)
    assert np.all(np.abs(expected / still[12:16] - 1) > 3e-4)
    np.testing.assert_allclose(found[12:16], expected, rtol=2e-5)
