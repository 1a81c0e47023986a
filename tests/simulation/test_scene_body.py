"""A scene as one body: alone, in larger scenes, in small and in large motion the same as the scene itself."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import OwnReadout, lattice

import nassim
from nassim import (
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
    joined,
    linearize,
    placed,
    reduce_scene,
    revolute,
    simulate,
    static_response,
)
from nassim.base.rigid_motion import axes_along
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.readouts import PassivePoint, Picture, Surface, by_name
from nassim.bodies.remote_points import RemotePoint
from nassim.bodies.stress import StressField
from nassim.scene.measures import Displacement
from nassim.scene.part import Connection, ForceElement
from nassim.scene.terms import Spring
from nassim.simulation.model.assembly import assemble
from nassim.systems import damping

OBLIQUE, ODD = axes_along((1.0, -2.0, 0.7), (0.3, 0.2, 1.0)), axes_along((-0.4, 1.0, 0.8), (1.0, 0.3, -0.2))
PLACE, TURN = np.array([0.3, -0.1, 0.2]), axes_along((0.5, 0.4, -1.0), (1.0, 1.0, 0.3))
SOFT = np.diag([3e5, 2e5, 6e5, 8.0, 5.0, 20.0])
POINTS = {"low": "foot.low", "high": "head.high"}
PASSIVE = {"ruler": "bar.right", "reader": "foot.side"}


@pytest.fixture(scope="module")
def bar():
    """A lattice with two ports, whose forces are in equilibrium."""
    body = craig_bampton(lattice(), n_modes=4, progress=False)
    wishes = np.random.default_rng(5).standard_normal((2, len(body.mass_matrix)))
    forces = wishes @ body.stiffness_matrix * 1e-9
    return replace(body, readouts=by_name(PortCoupling(n, f, 1e-10) for n, f in zip("ab", forces, strict=True)))


def strut(bar, fidelity="linear", stiffer=1.0, ratio=None, **options):
    """Foot, bushing, lattice, a pin with springs for what it leaves free, head; all lie obliquely, some dampers."""
    origin = np.array([0.02, -0.01, 0.03])
    body = FlexibleBody("bar", bar, position=origin, rotation=OBLIQUE, fidelity=fidelity, damping_ratio=ratio)
    left, right = body.point_position("left"), body.point_position("right")
    inertia = np.array([[3e-5, 4e-6, -2e-6], [4e-6, 4e-5, 5e-6], [-2e-6, 5e-6, 5e-5]])
    low, high = left - [0.012, 0.0, 0.004], right + np.array([0.006, 0.013, 0.002])
    foot = RigidBody(
        "foot",
        {"low": ODD.T @ [-0.01, 0.004, 0], "up": ODD.T @ (left - low), "side": (0, 0.02, 0)},
        0.05,
        inertia,
        low,
        rotation=ODD,
    )
    head = RigidBody("head", {"down": right - high, "high": np.array([0.01, 0.01, 0.0])}, 0.08, 2 * inertia, high)
    springs = (
        Bushing("flexor", "foot.up", "bar.left", stiffer * SOFT, 1e-4 * SOFT, axes=ODD),
        SpringDamper("brace", "foot.side", "bar.right", "line", 3e4 * stiffer),
        SpringDamper("rail", "bar.right", "head.down", OBLIQUE[:, 0], 2e5 * stiffer, frame="bar.right"),
        Bushing("hinge", "bar.right", "head.down", stiffer * np.diag([0, 0, 0, 6.0, 9.0, 7.0]), axes=OBLIQUE),
    )
    pin = Joint("pin", "bar.right", "head.down", ("x", "rx", "ry", "rz"), axes=OBLIQUE)
    return Scene("strut", (foot, body, head), (pin,), springs=springs, damping_ratio=0.0, **options)


def machine(part, names, gravity=(0, 0, 0)):
    """A strut, whole or as one body, somewhere in the world: foot on a bushing, a load at its head, its ports wired."""
    low, high, ruler, reader, port = names
    ground_point, load_place = part.point_position(low), part.point_position(high) + np.array([0.01, 0.02, -0.01])
    ground = RigidBody("ground", {"o": ground_point}, fixed=True)
    load = RigidBody(
        "load", {"o": part.point_position(high) - load_place}, 0.4, np.diag([1e-3, 2e-3, 2.5e-3]), load_place
    )
    return joined(
        "machine",
        part,
        bodies=(ground, load),
        joints=(Joint("on", high, "load.o"),),
        springs=(Bushing("mount", "ground.o", low, 30 * SOFT, axes=OBLIQUE),),
        actuators=(VoltageDrive("drive", f"{port}a", "voltage"), PointForce("push", ruler, (1, 2, -1), "force")),
        sensors=(
            VoltageSensor("sensed", f"{port}b"),
            Encoder("encoder", reader, ruler, OBLIQUE[:, 0], reader),
            Pose("pose", "ground.o", "load.o"),
        ),
        gravity=gravity,
    )


WHOLE = tuple(f"s/{path}" for path in (*POINTS.values(), *PASSIVE.values(), "bar."))
ONE = tuple(f"one.{name}" for name in (*POINTS, *PASSIVE, ""))


def both(bar, fidelity="linear", stiffer=1.0, ratio=None, **options):
    """The machine with the strut itself and with the body that it becomes."""
    body = reduce_scene(strut(bar, stiffer=stiffer, ratio=ratio), "strut", points=POINTS, passive=PASSIVE, **options)
    one = FlexibleBody("one", body, position=PLACE, rotation=TURN, fidelity=fidelity)
    scene = Scene("one", (one,), damping_ratio=0.0)
    return placed(strut(bar, fidelity, stiffer, ratio), "s", position=PLACE, rotation=TURN), scene


def response(scene, frequency):
    model = linearize(scene)
    eye = np.eye(len(model.A))
    return np.array([model.D + model.C @ np.linalg.solve(2j * np.pi * f * eye - model.A, model.B) for f in frequency])


def test_a_body_of_a_scene_becomes_itself_again(bar):
    """Turned and reduced once more, with the dampers that it has of its own: the same rates of decay."""
    body = both(bar)[1].bodies[0]
    again = reduce_scene(Scene("again", (body,), damping_ratio=0.0), "again", points={n: f"one.{n}" for n in POINTS})
    found, expected = (
        np.linalg.eigvals(np.linalg.solve(b.mass_matrix, b.damping_matrix)).real for b in (again, body.reduced)
    )
    np.testing.assert_allclose(np.sort(found), np.sort(expected), rtol=1e-8, atol=1e-8 * expected.max())


@pytest.mark.parametrize(("ratio", "first"), [(None, 0), (0.03, 1)])
def test_modes_and_responses_are_the_scene_s(bar, ratio, first):
    """A voltage sensor, the first sensor, would change the modes to which the bar's ratio belongs."""
    parts = zip(both(bar, ratio=ratio), (WHOLE, ONE), strict=True)
    scenes = (machine(part, names) for part, names in parts)
    whole, one = (replace(scene, sensors=scene.sensors[first:]) for scene in scenes)
    expected, found = (np.sort(damping(linearize(scene))) for scene in (whole, one))
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    frequency = [0.0, 31.0, 170.0, 900.0, 4000.0]
    expected, found = response(whole, frequency), response(one, frequency)
    size = np.abs(expected).max(axis=0)
    assert size.min() > 0
    assert (np.abs(found - expected).max(axis=0) / size).max() < 1e-8


def test_sensors_and_drives_are_left_out(bar):
    """An open port stiffens the scene that measures it, not the body, whose ports are wired anew."""
    wired = (VoltageSensor("v", "bar.b"), Encoder("e", "foot.low", "bar.right", "line"))
    scene = replace(strut(bar), sensors=wired, actuators=(VoltageDrive("d", "bar.a", "u"),), gravity=(0, 0, -9))
    found, expected = (reduce_scene(s, "strut", points=POINTS) for s in (scene, strut(bar)))
    np.testing.assert_array_equal(found.stiffness_matrix, expected.stiffness_matrix)
    stiffened, bare = (assemble(s).modal.frequency[6:] for s in (scene, strut(bar)))
    assert np.abs(stiffened / bare - 1).max() > 0.01


def test_statics_under_gravity(bar):
    """In small motion, of every output at rest, under little weight: the joints in one body do not turn with it."""
    parts = both(bar)
    whole, one = (
        static_response(machine(p, names, (1e-5, 2e-5, -9e-5))) for p, names in zip(parts, (WHOLE, ONE), strict=True)
    )
    assert min(map(abs, whole.values())) > 0
    assert one == {name: pytest.approx(value, rel=2e-5) for name, value in whole.items()}


def test_a_cut_off_keeps_statics(bar):
    full = reduce_scene(strut(bar), "strut", points=POINTS)
    for cut in (
        reduce_scene(strut(bar), "strut", points=POINTS, passive=PASSIVE, cutoff_frequency=700.0),
        reduce_scene(strut(bar, cutoff_frequency=700.0), "strut", points=POINTS, passive=PASSIVE),
    ):
        assert full.n_modes > cut.n_modes > 2
        assert cut.enriched.n_modes == full.n_modes
        one = Scene("one", (FlexibleBody("one", cut, PLACE, TURN, "linear"),), damping_ratio=0.0)
        scenes = machine(both(bar)[0], WHOLE), machine(one, ONE)
        expected, found = (response(scene, [0.0, 90.0]) for scene in scenes)
        # The push at a passive point is no load that the trimming was told of.
        off = np.abs(found - expected)[:, :, 0] / np.abs(expected)[:, :, 0]
        assert off[0].max() < 1e-8
        assert 1e-9 < off[1].max() < 0.02


def test_inertia_of_the_whole(bar):
    """Composed here of the parts'; every rigid motion's field is what its coordinates say, to the last integral."""
    scene = strut(bar)
    body = reduce_scene(scene, "strut", points=POINTS)
    figures = [part.rigid_inertia for part in scene.bodies]
    mass = sum(m for m, _, _ in figures)
    centre = sum(m * c for m, c, _ in figures) / mass
    inertia = sum(
        i + m * ((c - centre) @ (c - centre) * np.eye(3) - np.outer(c - centre, c - centre)) for m, c, i in figures
    )
    found = FlexibleBody("one", body).rigid_inertia
    for one, expected in zip(found, (mass, centre, inertia), strict=True):
        np.testing.assert_allclose(one, expected, rtol=1e-7, atol=1e-9)
    n = len(body.mass_matrix)
    pairs = body.gram[4:].reshape(n, 3, -1)
    np.testing.assert_allclose(np.einsum("jckc->jk", pairs[:, :, 4:].reshape(n, 3, n, 3)), body.mass_matrix, atol=1e-10)
    rigid = np.zeros((6, n))
    for k, place in enumerate(body.positions):
        rigid[:3, 6 * k : 6 * k + 3] = rigid[3:, 6 * k + 3 : 6 * k + 6] = np.eye(3)
        rigid[3:, 6 * k : 6 * k + 3] = np.cross(np.eye(3), place)
    fields = np.zeros((6, 3, 4))  # of a rigid motion, along each axis: weights on 1, x, y, z
    for axis in range(3):
        fields[axis, axis, 0] = 1.0
        fields[3 + axis, :, 1:] = np.cross(np.eye(3)[axis], np.eye(3)).T
    found, expected = np.einsum("mj,jck->mck", rigid, pairs), fields @ body.gram[:4]
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("fidelity", "pull", "spin"),
    [("linear", 60.0, 0.0), ("ffrf", 60.0, 0.0), ("linear", -60.0, 0.0), ("linear", 60.0, 11.0)],
)
def test_a_body_of_rigid_parts_is_softer_upright_and_stiffer_hanging(fidelity, pull, spin):
    """A top on a hinge with a spring, placed obliquely with its weight along it and a spin about it.

    J w^2 = k - m g r - W^2 (J_y - J_z), all moments of inertia about the hinge.
    """
    arm, mass, inertia, stiffness = 0.12, 0.8, 2e-3, 40.0
    foot = RigidBody("foot", {"low": np.zeros(3), "up": np.array([0.05, 0, 0.1])}, 0.5, np.diag([1e-3, 1.2e-3, 1.5e-3]))
    top = RigidBody("top", {"down": (0, 0, -arm)}, mass, np.diag([inertia, 2.2e-3, 1.5e-3]), (0.05, 0, 0.1 + arm))
    hinge, spring = (
        revolute("hinge", "foot.up", "top.down", "x"),
        Bushing("k", "foot.up", "top.down", [0, 0, 0, stiffness, 0, 0]),
    )
    body = reduce_scene(Scene("top", (foot, top), (hinge,), springs=(spring,)), "top", points={"low": "foot.low"})
    whole = FlexibleBody("whole", body, position=PLACE, rotation=TURN, fidelity=fidelity)
    ground = RigidBody("ground", {"low": PLACE}, fixed=True)
    clamp = Joint("clamp", "ground.low", "whole.low")
    held = Scene("held", (ground, whole), (clamp,), gravity=TURN @ (0, 0, -pull))
    about = {"angular_velocity": spin * TURN[:, 2], "axis_point": PLACE + 0.05 * TURN[:, 0]}
    found = damping(linearize(held, **about)).frequency
    left = stiffness - mass * pull * arm - spin**2 * (2.2e-3 + mass * arm**2 - 1.5e-3)
    expected = np.sqrt(left / (inertia + mass * arm**2)) / (2 * np.pi)
    np.testing.assert_allclose(found, [expected], rtol=1e-9)


def test_a_free_body_has_the_scene_s_modes(bar):
    body = reduce_scene(strut(bar), "strut", points=POINTS)
    np.testing.assert_allclose(body.eigenfrequencies()[6:], assemble(strut(bar)).modal.frequency[6:], rtol=1e-8)
    assert (body.eigenfrequencies()[:6] == 0).all()


def test_soft_joints_beside_stiff_ones_by_closed_form():
    """A rigid rod between flexible joints, figures of a real strut: 94e6 N/m along, 4.83 N m/rad across."""
    length, axial, shear, bending = 0.0824, 93.96e6, 12.71e6, 4.83
    joint = np.diag([shear, shear, axial, bending, bending, 260.2])
    low, high = np.array([0.1, 0.0, -0.2]), np.array([0.1, 0.0, -0.2]) + length * ODD[:, 2]
    ends = [RigidBody(n, {"o": np.zeros(3)}, 0.015, 1e-6 * np.eye(3), at) for n, at in (("foot", low), ("head", high))]
    half = np.array([0, 0, length / 2])
    rod = RigidBody("rod", {"a": -half, "b": half}, 0.2, np.diag([1e-4, 1e-4, 2e-5]), (low + high) / 2, rotation=ODD)
    springs = (Bushing("1", "foot.o", "rod.a", joint, axes=ODD), Bushing("2", "rod.b", "head.o", joint, axes=ODD))
    body = reduce_scene(
        Scene("strut", (*ends, rod), springs=springs), "strut", points={"low": "foot.o", "high": "head.o"}
    )
    turn = np.kron(np.eye(2), ODD)
    found = turn.T @ body.compliance(fixed=["low"])[6:, 6:] @ turn
    assert found[2, 2] == pytest.approx(2 / axial, rel=1e-8)
    for k in (0, 1):
        assert found[k, k] == pytest.approx(2 / shear + length**2 / bending, rel=1e-8)
        assert found[3 + k, 3 + k] == pytest.approx(2 / bending, rel=1e-8)
    frequency = np.sqrt(2 * np.array([bending + shear * length**2 / 4] * 2 + [axial / 0.2 * 1e-4]) / 1e-4) / (2 * np.pi)
    held = body.eigenfrequencies(fixed=["low", "high"])
    for one in frequency:
        assert np.abs(held / one - 1).min() < 1e-8


def swinging(part, names):
    """A driven hinge turns the strut's foot by 1.5 rad, a load at its head."""
    low, high, ruler, reader, port = names
    ground = RigidBody("ground", {"o": part.point_position(low)}, fixed=True)
    place = part.point_position(high) + np.array([0.01, 0.02, -0.01])
    load = RigidBody("load", {"o": part.point_position(high) - place}, 0.4, np.diag([1e-3, 2e-3, 2.5e-3]), place)
    return joined(
        "swinging",
        part,
        bodies=(ground, load),
        joints=(Joint("on", high, "load.o"), revolute("hinge", "ground.o", low, (1, 1, 0.2))),
        actuators=(VoltageDrive("drive", f"{port}a", "voltage"), Drive("motor", "hinge", "rz", "angle")),
        sensors=(
            *(Encoder(axis, "ground.o", high, axis) for axis in "xyz"),
            VoltageSensor("sensed", f"{port}b"),
            Encoder("encoder", reader, ruler, OBLIQUE[:, 0], reader),
            Pose("bent", low, high),
        ),
        gravity=(1, 2, -9),
    )


def test_large_motion_is_the_scene_s(bar):
    """Parts are a thousand times as stiff, so that the square of deformation, by which the two differ, is small."""
    stiffer = 1e3
    stiff = replace(bar, stiffness_matrix=stiffer * bar.stiffness_matrix, enriched=None, released_stiffness=None)
    time = np.arange(201) * 1e-3
    pushes = np.array([0.02 * np.sin(60 * time) ** 4, 1.5 * np.sin(np.pi * time / 0.4) ** 4])
    pushes = TimeHistory(time, pushes, ("voltage", "angle"), ("V", "rad"))
    whole, one = (
        simulate(swinging(part, names), pushes, time_step=1e-3, progress=False, spectral_radius=0.7).values[2:]
        for part, names in zip(both(stiff, "ffrf", stiffer), (WHOLE, ONE), strict=True)
    )
    off = np.abs(one - whole).max(axis=1) / np.abs(whole).max(axis=1)
    assert off[:3].max() < 1e-7
    assert off[3:].max() < 2e-3
    assert (np.ptp(whole[:3], axis=1) > 0.01).all()


def pictured(bar):
    n = len(bar.mass_matrix)
    points = np.array([[0.0, 0.01, 0.01], [0.03, 0.01, 0.01], [0.03, 0.01, 0.01]])
    surface = Surface(points, np.array([[0, 1, 2]]), np.array([[0, 1]]), ("side",))
    modes = np.stack([np.eye(3, n), np.eye(3, n, 6), np.eye(3, n, 6)])
    return replace(bar, readouts={**bar.readouts, "surface": Picture(surface, modes)})


def test_ports_and_pictures_of_several_bodies(bar):
    """Ports that share a name are told apart; pictures and own read-outs move as their points do."""
    extension = OwnReadout("extension", bar.motion("right")[0] - bar.motion("left")[0])
    read = replace(pictured(bar), readouts={**pictured(bar).readouts, "extension": extension})
    first = FlexibleBody("first", read, rotation=OBLIQUE)
    second = FlexibleBody(
        "second", pictured(bar), position=first.point_position("right") - ODD @ bar.point("left").position, rotation=ODD
    )
    scene = Scene("two", (first, second), springs=(Bushing("between", "first.right", "second.left", SOFT),))
    body = reduce_scene(
        scene, "two", points={"in": "first.left", "out": "second.right"}, passive={"mid": "first.right"}
    )
    assert {port.name for port in body.ports} == {"first/a", "first/b", "second/a", "second/b"}
    np.testing.assert_allclose(body.surface.points[3:], second.position + body_points(second), atol=1e-15)
    np.testing.assert_array_equal(body.surface.triangles, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(body.surface.edges, [[0, 1], [3, 4]])
    np.testing.assert_allclose(body.surface_modes[0], body.motion("in")[:3], atol=1e-12)
    np.testing.assert_allclose(body.surface_modes[1], body.motion("mid")[:3], atol=1e-9)
    np.testing.assert_allclose(body.surface_modes[5], body.motion("out")[:3], atol=1e-12)
    along = OBLIQUE[:, 0] @ (body.motion("mid") - body.motion("in"))[:3]
    np.testing.assert_allclose(body.readouts["extension"].row, along, atol=1e-9)
    assert not body.all_point_names[3:]


def tensor(stress):
    """Of the components xx, yy, zz, xy, yz, xz."""
    xx, yy, zz, xy, yz, xz = stress
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("port", ["second/a", "a"])
def test_voltages_stress_a_body_of_a_scene_as_they_stressed_its_parts(bar, port):
    """Along the scene's axes, by the new names of ports; one part lies along these axes, the other does not."""
    by_volt = np.random.default_rng(2).standard_normal((2, 6))
    rows = np.zeros((1, 6, len(bar.mass_matrix)))
    surface = Surface([[0.0, 0.0, 0.0]], [[0, 0, 0]], [[0, 0]], ("bar",))
    spot = StressField("spot", np.zeros((1, 3)), rows, rows, {"a": by_volt[:1], "b": by_volt[1:]}, surface)
    bar = replace(bar, readouts={**bar.readouts, "spot": spot})
    first = FlexibleBody("first", bar if "/" in port else replace(bar, readouts={}))
    at = first.point_position("right") - ODD @ bar.point("left").position
    second = FlexibleBody("second", bar, position=at, rotation=ODD)
    scene = Scene("two", (first, second), springs=(Bushing("between", "first.right", "second.left", SOFT),))
    body = reduce_scene(scene, "two", points={"in": "first.left", "out": "second.right"})
    still = np.zeros(len(body.mass_matrix))
    names = ("second/spot", "second/b") if "/" in port else ("spot", "b")
    moved = body.readouts[names[0]]
    np.testing.assert_allclose([*moved.positions, *moved.surface.points], [at, at], atol=1e-12)
    for name, stress in zip((port, names[1]), by_volt, strict=True):
        found = moved.stress(still, {name: 3.0})[0]
        np.testing.assert_allclose(tensor(found), 3.0 * ODD @ tensor(stress) @ ODD.T, atol=1e-12)
        if "/" in port:
            other = body.readouts["first/spot"]
            assert not np.any(other.stress(still, {name: 3.0}))
            found = other.stress(still, {name.replace("second", "first"): 3.0})[0]
            np.testing.assert_allclose(found, 3.0 * stress, atol=1e-12)


def test_ports_of_a_rigid_body_have_no_effect(bar):
    body = reduce_scene(strut(bar, "rigid"), "strut", points=POINTS)
    assert [port.name for port in body.ports] == ["a", "b"]
    assert all(np.abs(port.forces).max() < 1e-9 * np.abs(bar.port(port.name).forces).max() for port in body.ports)


def test_a_port_lies_where_it_lay(bar):
    """In the middle of three points whose weighted sum it is, also where the new body lies obliquely."""
    weights, side = {"left": 0.3, "right": 1.1, "side": -0.4}, RemotePoint("side", (), (0.01, 0.02, -0.03))
    place = 0.3 * bar.point("left").position + 1.1 * bar.point("right").position - 0.4 * np.array(side.position)
    ports = replace(bar.ports[0], place=place), bar.ports[1]
    bar = replace(bar, readouts=by_name([PassivePoint(side, bar.motion("left")), *ports]))
    body = reduce_scene(strut(bar), "strut", points=POINTS, passive={name: f"bar.{name}" for name in weights})
    assert body.ports[1].place is None
    one = FlexibleBody("one", body, position=PLACE, rotation=TURN)
    whole = placed(strut(bar), "s", position=PLACE, rotation=TURN)
    np.testing.assert_allclose(
        one.position + one.rotation @ body.ports[0].place,
        sum(weight * whole.point_position(f"s/bar.{name}") for name, weight in weights.items()),
        atol=1e-14,
    )


def test_one_guess_makes_the_whole_a_guess(bar):
    """Integrals are complete where those of all bodies are."""
    for guesses, complete in (((), True), ((0,), False), ((1,), False), ((0, 1), False)):
        bars = [replace(bar, full_integrals=k not in guesses) for k in range(2)]
        first = FlexibleBody("first", bars[0], rotation=OBLIQUE)
        at = first.point_position("right") - ODD @ bar.point("left").position
        second = FlexibleBody("second", bars[1], position=at, rotation=ODD)
        scene = Scene("two", (first, second), springs=(Bushing("between", "first.right", "second.left", SOFT),))
        body = reduce_scene(scene, "two", points={"in": "first.left", "out": "second.right"})
        assert body.full_integrals is complete


def body_points(body):
    return body.reduced.surface.points @ body.rotation.T


def test_a_reduced_scene_is_saved(bar, tmp_path):
    body = reduce_scene(strut(bar), "strut", points=POINTS, passive=PASSIVE)
    nassim.save(body, tmp_path / "body.h5")
    np.testing.assert_array_equal(nassim.load(tmp_path / "body.h5").gram, body.gram)


@dataclass(frozen=True)
class Tie(ForceElement):
    """A spring between a point and its place at the start, along an axis that turns with the point."""

    point: str

    def terms(self, scene):
        return (Spring(Displacement(((self.point, np.array([0.0, 0.6, 0.8])),), self.point), 1e3),)


@dataclass(frozen=True)
class Rubber(Connection):
    """A joint that holds nothing, with a spring along an axis of the world."""

    a: str
    b: str

    def terms(self, scene):
        return (Spring(Displacement.between(self.a, self.b, np.array([0.0, 0.0, 1.0])), 5.0),)


GROUND = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda s: replace(s, bodies=(*s.bodies, GROUND)), r"fixed bodies \(ground\)"),
        (lambda s: replace(s, springs=(*s.springs, Tie("tie", "foot.up"))), "ties it to the world"),
        (lambda s: replace(s, springs=(*s.springs[:2], s.springs[3], Tie("tie", "foot.up"))), "ties it to the world"),
        (lambda s: replace(s, springs=s.springs[:-1]), "9 rigid-body modes"),
        (
            lambda s: replace(s, springs=(*s.springs, SpringDamper("w", "foot.up", "bar.right", "z", 5.0))),
            "'w' acts along an axis of the world",
        ),
        (
            lambda s: replace(s, joints=(*s.joints, Rubber("rubber", "foot.up", "bar.right"))),
            "'rubber' acts along an axis of the world",
        ),
        (lambda s: replace(s, actuators=(Drive("motor", "pin", "x", "u"),)), r"drives of joints \(pin\)"),
        (
            lambda s: replace(
                s, springs=(*s.springs, SpringDamper("p", "foot.up", "bar.right", "line", 5.0, preload=1.0))
            ),
            "spring 'p' is not linear; add it to the new body",
        ),
        (lambda s: replace(s, bodies=(replace(s.bodies[0], angular_velocity=(0, 0, 1)), *s.bodies[1:])), "spinning"),
    ],
)
def test_scenes_that_are_no_body(bar, change, text):
    with pytest.raises(ValueError, match=text):
        reduce_scene(change(strut(bar)), "strut", points=POINTS)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ({"a": "foot.low", "b": "foot.side"}, "a, b of body 'strut' do not move independently"),
        ({"a": "bar.right", "b": "head.down", "c": "head.high"}, "do not move independently"),
        ({}, "at least one point"),
        ({"a": "foot.nowhere"}, "nowhere"),
        ({"ruler": "foot.low"}, "used more than once: ruler"),
    ],
)
def test_points_that_cannot_stay(bar, points, text):
    with pytest.raises(ValueError, match=text):
        reduce_scene(strut(bar), "strut", points=points, passive=PASSIVE)


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_points_of_two_rigid_bodies_can_stay_and_those_of_one_cannot(size):
    """Whatever their size: motions of unit energy are small in large bodies, in metres more than in radians."""
    points = {"a": np.zeros(3), "b": size * np.array([0.1, 0.2, 0.3])}
    first, second = (RigidBody(name, points, 2.0 * size**3, 1e-2 * size**5 * np.eye(3)) for name in ("block", "other"))
    spring = Bushing("between", "block.b", "other.b", size * SOFT)
    both = Scene("block", (first, second), springs=(spring,))
    for scene in (Scene("block", (first,)), both):
        with pytest.raises(ValueError, match="a, b of body 'block' do not move independently"):
            reduce_scene(scene, "block", points={"a": "block.a", "b": "block.b"})
    body = reduce_scene(both, "block", points={"a": "block.a", "b": "other.b"})
    assert body.mass == pytest.approx(4.0 * size**3)
