"""Hexapods made of words: published figures of a Stewart platform, and its struts part by part.

Geometry and figures: the Stewart platform model of T. Dehaeze and others (MIT licence), default set.
"""

import numpy as np
import pytest

from models.hexapods import DEFAULT_PLATFORM
from models.nano_hexapod import make_nano_hexapod, rigid_plate
from models.strut import spring_strut
from nassim import (
    Encoder,
    LinearActuator,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    frequency_response,
    linearize,
    prismatic,
    spherical,
    universal,
)
from nassim.base.rigid_motion import axes_along
from nassim.kinematics import strut_lengths

HEIGHT, DROP = 0.09, 0.015
BASE_ANGLES, TOP_ANGLES = (-10, 10, 110, 130, 230, 250), (-50, 50, 70, 170, 190, -70)
STIFFNESS = 20e6
DISC = 0.1**2 / 4 + 0.01**2 / 12, 0.1**2 / 2
"""Moments of the plate of 1 kg, radius 100 mm, height 10 mm, across and about its axis [kg m2]."""
CENTRE = np.array([0, 0, -0.005])
"""Of its mass, from M."""
SIX = ("ux", "uy", "uz", "rx", "ry", "rz")


def ring(radius, degrees, height):
    angles = np.deg2rad(degrees)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(6, height)])


FEET = ring(0.115, BASE_ANGLES, DROP)
HEADS = ring(0.09, TOP_ANGLES, HEIGHT - DROP)


def plates(feet, heads, *, point=0.0, centre=CENTRE, height=HEIGHT, fixed=True):
    """The base and the top plate, whose point "b" lies so high above M."""
    at = np.array([0, 0, height]) + centre
    top = {f"h{k}": head - at for k, head in enumerate(heads)} | {"b": np.array([0, 0, height + point]) - at}
    base = RigidBody("base", {f"f{k}": foot for k, foot in enumerate(feet)} | {"o": np.zeros(3)}, fixed=True)
    if not fixed:
        bottom = {name: place for name, place in base.points.items()}
        base = RigidBody("base", bottom, 4.0, np.diag([0.02, 0.02, 0.04]))
    return base, RigidBody("plate", top, 1.0, np.diag([DISC[0], DISC[0], DISC[1]]), at)


def wrench():
    forces = (PointForce(f"f{axis}", "plate.b", axis, f"f{axis}") for axis in "xyz")
    return (*forces, *(PointTorque(f"t{axis}", "plate.b", axis, f"t{axis}") for axis in "xyz"))


def on_springs(feet, heads, stiffness, **options):
    """Struts that are springs without mass."""
    springs = tuple(SpringDamper(f"s{k}", f"base.f{k}", f"plate.h{k}", "line", stiffness) for k in range(6))
    pose = Pose("pose", "base.o", "plate.b")
    bodies = plates(feet, heads, **options)
    return Scene("platform", bodies, (), wrench(), (pose,), springs, damping_ratio=0.0)


def static_gain(scene):
    model = linearize(scene)
    return model.D - model.C @ np.linalg.solve(model.A, model.B)


def jacobian(feet, heads, height):
    lines = (heads - feet) / np.linalg.norm(heads - feet, axis=1)[:, None]
    return np.hstack([lines, np.cross(heads - [0, 0, height], lines)])


def test_compliance_of_the_default_platform():
    """At a point 45 mm above the plate."""
    found = static_gain(on_springs(FEET, HEADS, STIFFNESS, point=0.045))
    expected = np.diag([4.7500e-8, 4.7500e-8, 2.0990e-8, 5.1863e-6, 5.1863e-6, 1.7073e-6])
    expected[[0, 4], [4, 0]], expected[[1, 3], [3, 1]] = 3.2093e-7, -3.2093e-7
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, rtol=2.4e-5, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(HEADS - FEET, axis=1), 0.0952254, atol=5e-8)


@pytest.mark.parametrize(("point", "turning", "coupling"), [(-0.05, 0.015, 0.0), (0.02, 0.0248, -0.14)])
def test_stiffness_of_the_cubic_platform(point, turning, coupling):
    """Struts of 1 N/m along the six middle edges of a cube that stands on its corner, its centre half way up.

    The published cube is given by the height of these edges, 100 mm: its own edge is sqrt(3) as long.
    """
    upright = axes_along((1, 1, 1)).T
    corners = {c: upright @ (0.1 * np.sqrt(3) * (np.array(c) - 0.5)) for c in np.ndindex(2, 2, 2)}
    edges = [
        (corners[a], corners[b])
        for a in corners
        for b in corners
        if sum(a) == 1 and sum(b) == 2 and sum(np.abs(np.subtract(a, b))) == 1
    ]
    assert len(edges) == 6

    def cut(low, high, z):
        return low + (high - low) * (z - low[2]) / (high[2] - low[2]) + [0, 0, 0.05]

    feet = np.array([cut(low, high, -0.025) for low, high in edges])
    heads = np.array([cut(low, high, 0.025) for low, high in edges])
    scene = on_springs(feet, heads, 1.0, point=point, height=0.1)
    found = np.linalg.inv(static_gain(scene))
    expected = np.diag([2, 2, 2, turning, turning, 0.06])
    expected[[0, 4], [4, 0]], expected[[1, 3], [3, 1]] = coupling, -coupling
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def strut_axes():
    """Of each strut: z from foot to head, x across the world's y and z."""
    for line in HEADS - FEET:
        z = line / np.linalg.norm(line)
        x = np.cross([0, 1, 0], z)
        x /= np.linalg.norm(x)
        yield np.column_stack([x, np.cross(z, x), z])


def by_hand():
    """The six struts part by part, nothing placed: every body where it is, every joint along its own axes."""
    base, plate = plates(FEET, HEADS)
    bodies, joints, springs, pushes, lengths = [base, plate], [], [], [], []
    across, about = 0.1 * (0.005**2 / 4 + 0.05**2 / 12), 0.1 * 0.005**2 / 2
    for k, (foot, head, axes) in enumerate(zip(FEET, HEADS, strut_axes(), strict=True)):
        line, middle = axes[:, 2], (foot + head) / 2
        inertia = across * np.eye(3) + (about - across) * np.outer(line, line)
        for name, end, centre in ("l", foot, foot + 0.025 * line), ("u", head, head - 0.025 * line):
            bodies.append(RigidBody(f"{name}{k}", {"end": end - centre, "mid": middle - centre}, 0.1, inertia, centre))
        ends = f"l{k}.end", f"u{k}.end"
        joints += [
            universal(f"b{k}", f"base.f{k}", ends[0], axes[:, 0], axes[:, 1]),
            prismatic(f"p{k}", f"l{k}.mid", f"u{k}.mid", line),
            spherical(f"t{k}", ends[1], f"plate.h{k}"),
        ]
        springs.append(SpringDamper(f"s{k}", *ends, line, STIFFNESS, 20.0, frame=ends[0]))
        pushes.append(LinearActuator(f"a{k}", *ends, f"a{k}"))
        lengths.append(Encoder(f"e{k}", *ends, line, frame=ends[0]))
    return Scene("by hand", bodies, joints, pushes, lengths, springs, damping_ratio=0.0)


def test_a_strut_placed_six_times_is_six_struts():
    """The public model's, of two halves with masses; its other cases stand beside it in tests/models."""
    disc = rigid_plate(DEFAULT_PLATFORM, mass=1.0, radius=0.1, height=0.01)
    strut = spring_strut(STIFFNESS, damping=20.0, mass=0.2, length=float(strut_lengths(DEFAULT_PLATFORM)[0]))
    model = make_nano_hexapod(strut, platform=DEFAULT_PLATFORM, plate=disc, payload_mass=0.0, damping_ratio=0.0)
    frequency = np.geomspace(10, 3e3, 60)
    found, expected = (frequency_response(linearize(s), frequency) for s in (model, by_hand()))
    picked = np.ix_(
        *(
            [names.index(f"strut_{k}/{signal}") for k in range(1, 7)]
            for names, signal in ((found.outputs, "encoder"), (found.inputs, "actuator_force"))
        )
    )
    scale = np.abs(expected.values).max(axis=2, keepdims=True)
    np.testing.assert_allclose(found.values[picked] / scale, expected.values / scale, rtol=0, atol=1e-6)
