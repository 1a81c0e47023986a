"""Hexapods made of words: published figures of a Stewart platform, and six different bodies however they are turned.

Geometry and figures: the Stewart platform model of T. Dehaeze and others (MIT licence), default set.
"""

from dataclasses import replace

import numpy as np
import pytest

from nassim import (
    Bushing,
    Encoder,
    LinearActuator,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    frequency_response,
    joined,
    linearize,
    placed,
    prismatic,
    spherical,
    universal,
)
from nassim.base.rigid_motion import axes_along
from nassim.systems import damping

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


def half_struts(stiffness, rate=0.0):
    """A strut along z: two halves of 0.1 kg that slide in each other, a spring and a force between their ends."""
    across, about = 0.1 * (0.005**2 / 4 + 0.05**2 / 12), 0.1 * 0.005**2 / 2
    inertia = np.diag([across, across, about])
    length = np.linalg.norm(HEADS[0] - FEET[0])
    lower = {"foot": (0, 0, -0.025), "slide": (0, 0, length / 2 - 0.025)}
    upper = {"head": (0, 0, 0.025), "slide": (0, 0, 0.025 - length / 2)}
    bodies = (
        RigidBody("lower", lower, 0.1, inertia, (0, 0, 0.025)),
        RigidBody("upper", upper, 0.1, inertia, (0, 0, length - 0.025)),
    )
    ends = ("lower.foot", "upper.head")
    return Scene(
        "strut",
        bodies,
        (prismatic("slide", "lower.slide", "upper.slide", "z"),),
        (LinearActuator("stack", *ends, "force"),),
        (Encoder("length", *ends, "line"),),
        (SpringDamper("spring", *ends, "line", stiffness, rate),),
        damping_ratio=0.0,
    )


def strut_axes():
    """Of each strut: z from foot to head, x across the world's y and z."""
    for line in HEADS - FEET:
        z = line / np.linalg.norm(line)
        x = np.cross([0, 1, 0], z)
        x /= np.linalg.norm(x)
        yield np.column_stack([x, np.cross(z, x), z])


def with_masses(stiffness=STIFFNESS, rate=0.0):
    """The same strut, placed six times."""
    strut = half_struts(stiffness, rate)
    struts = [placed(strut, f"strut_{k}", position=FEET[k], rotation=axes) for k, axes in enumerate(strut_axes())]
    joints = []
    for k, axes in enumerate(strut_axes()):
        joints.append(universal(f"u{k}", f"base.f{k}", f"strut_{k}/lower.foot", axes[:, 0], axes[:, 1]))
        joints.append(spherical(f"s{k}", f"strut_{k}/upper.head", f"plate.h{k}"))
    return joined("hexapod", *struts, bodies=plates(FEET, HEADS), joints=joints)


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
    frequency = np.geomspace(10, 3e3, 60)
    found, expected = (frequency_response(linearize(s), frequency) for s in (with_masses(rate=20.0), by_hand()))
    assert (found.inputs[3], found.outputs[3]) == ("strut_3/force", "strut_3/length")
    scale = np.abs(expected.values).max(axis=2, keepdims=True)
    np.testing.assert_allclose(found.values / scale, expected.values / scale, rtol=0, atol=1e-9)


MODES = np.array([780.60, 780.60, 903.89, 1061.43, 1061.43, 1269.66])


def test_modes_and_dampings_with_the_struts_masses():
    frequency, ratio = damping(linearize(with_masses(rate=20.0)))
    np.testing.assert_allclose(np.sort(frequency)[-6:], MODES, atol=0.006)
    order = np.argsort(frequency)[-6:]
    np.testing.assert_allclose(100 * ratio[order], [0.245, 0.245, 0.284, 0.333, 0.333, 0.399], atol=6e-4)


def force_feedback(model, in_series, gain):
    """Poles with a force F in each strut, driven by the integral of what it measures: F' = -g (F - k_a length)."""
    n = len(model.A)
    state = np.zeros((n + 6, n + 6))
    state[:n, :n], state[:n, n:] = model.A, model.B
    state[n:, :n], state[n:, n:] = gain * in_series * model.C, -gain * np.eye(6)
    poles = np.linalg.eigvals(state)
    return poles[poles.imag >= 0]


def test_integral_force_feedback_damps_every_mode_critically():
    """The sensors in all of the struts: mode by mode s^2 + g s + w^2 = 0, critical at g = 2 w."""
    model = linearize(with_masses())
    modes = np.sort(damping(model)[0])
    for gain, omega in zip([9809, 11359, 13338, 15955], 2 * np.pi * modes[[0, 2, 3, 5]], strict=True):
        assert 2 * omega == pytest.approx(gain, rel=5e-5)
        poles = force_feedback(model, STIFFNESS, 2 * omega)
        met = np.abs(poles + omega) < 1e-3 * omega
        assert np.count_nonzero(met) >= 1
        slower = force_feedback(model, STIFFNESS, 1.9 * omega)
        near = slower[np.argmin(np.abs(np.abs(slower) - omega) + 1e6 * (slower.imag < 1e-6 * omega))]
        assert -near.real / abs(near) == pytest.approx(0.95, rel=1e-6)


def test_integral_force_feedback_beside_a_parallel_spring():
    """A quarter of the stiffness beside the sensors: 0.5 at most, at g = w sqrt(2), as (w - z) / (2 z) says."""
    scene = with_masses(15e6)
    beside = [SpringDamper(f"p{k}", f"strut_{k}/lower.foot", f"strut_{k}/upper.head", "line", 5e6) for k in range(6)]
    model = linearize(replace(scene, springs=(*scene.springs, *beside)))
    modes = np.sort(damping(model)[0])
    np.testing.assert_allclose(modes, MODES, atol=0.006)
    for gain, omega in zip([6936, 8032, 9432, 11282], 2 * np.pi * modes[[0, 2, 3, 5]], strict=True):
        assert np.sqrt(2) * omega == pytest.approx(gain, rel=1e-4)
        largest = []
        for factor in (0.97, 1.0, 1.03):
            poles = force_feedback(model, 15e6, factor * np.sqrt(2) * omega)
            expected = np.roots([1, factor * np.sqrt(2) * omega, omega**2, factor * np.sqrt(2) * omega**3 / 4])
            pole = expected[np.argmax(expected.imag)]
            found = poles[np.argmin(np.abs(poles - pole))]
            assert found == pytest.approx(pole, rel=1e-6)
            largest.append(-found.real / abs(found))
        assert largest[1] == pytest.approx(0.5, rel=1e-6)
        assert largest[1] > max(largest[0], largest[2])


def test_struts_push_as_a_wrench_from_outside_on_a_fixed_base_only():
    """Forces J^-T w of the struts and the wrench w move the plate alike, unless the base gives way to the former."""
    along = np.linalg.inv(jacobian(FEET, HEADS, HEIGHT + 0.045)).T
    scene = on_springs(FEET, HEADS, STIFFNESS, point=0.045)
    pushes = tuple(LinearActuator(f"a{k}", f"base.f{k}", f"plate.h{k}", f"a{k}") for k in range(6))
    scene = replace(scene, actuators=(*scene.actuators, *pushes))
    loose = plates(FEET, HEADS, point=0.045, fixed=False)
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    feet = Bushing("feet", "ground.o", "base.o", [3e7, 3e7, 3e7, 3e5, 3e5, 3e5])
    flexible = replace(
        scene,
        bodies=(ground, *loose),
        springs=(*scene.springs, feet),
        sensors=(Pose("pose", "ground.o", "plate.b"),),
    )
    frequency = np.geomspace(10, 2e3, 40)
    differences = []
    for machine in (scene, flexible):
        values = frequency_response(linearize(machine), frequency).values
        outside, inside = values[:, :6], np.einsum("yaf,aw->ywf", values[:, 6:], along)
        scale = np.abs(outside).max(axis=2, keepdims=True)
        scale = np.sqrt(np.einsum("iif->if", scale)[:, None] * np.einsum("iif->if", scale)[None])
        differences.append(np.abs((inside - outside) / scale).max())
    assert differences[0] < 1e-10
    assert differences[1] > 0.1
