"""Linear models about loaded equilibria: published machines under gravity and spin, hung and standing bars."""

import re
import warnings
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import scipy
from conftest import lattice, make_bar, meshed
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    Joint,
    Loop,
    Material,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    Simulation,
    SpringDamper,
    StackActuator,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    revolute,
    simulate,
    simulate_motion,
    spherical,
    static_motion,
    static_response,
    universal,
)
from nassim.base.rigid_motion import skew
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import keep_modes, trim_body
from nassim.bodies.readouts import by_name
from nassim.bodies.stress import StressField
from nassim.bodies.stress_stiffness import StressStiffness
from nassim.fem.meshing import generate_mesh
from nassim.scene.joints import planar, prismatic
from nassim.scene.measures import Combination, Displacement, Distance
from nassim.scene.part import ForceElement
from nassim.scene.terms import NonlinearSpring
from nassim.simulation import (
    assemble,
    buckling_factors,
    exudyn_eigenfrequencies,
    linearize_closed,
    loaded_equilibrium,
    loaded_state,
    reduce_scene,
    truncation_error,
)
from nassim.simulation.loaded.present_stress import PresentStress, stress_under
from nassim.simulation.loaded.rotor_frame import RotorPartition
from nassim.simulation.model.axial_preload import axial_forces_under
from nassim.simulation.run.loaded_start import assemble_small_motion
from nassim.systems import damping, proportional, unstable_poles

GRAVITY = (0, 0, -9.81)
DOWN = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float)
"""Axes in which a bar along x hangs."""
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()


def squares(model):
    """Squares of the angular frequencies of an undamped model at rest, ascending, (n,) [rad2/s2]."""
    n = len(model.A) // 2
    return np.sort(np.linalg.eigvals(-model.A[n:, :n]).real)


def frequencies(scene, **options):
    """Frequencies [Hz], negative for real poles."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = squares(linearize(replace(scene, damping_ratio=0.0), **options))
    return np.sign(found) * np.sqrt(np.abs(found)) / (2 * np.pi)


@pytest.fixture(scope="module")
def gravimeter():
    """A published gravimeter in its plane: a mass on three springs, whose lengths are those under its weight."""
    mass_points = {"c": (0, 0, 0), "h": (0, 0, -1.7), "v": (-0.5, 0, -1.7), "w": (0.5, 0, -1.7)}
    ground_points = {"c": (0, 0, 0), "h": (-0.2, 0, -1.7), "v": (-0.5, 0, -1.9), "w": (0.5, 0, -1.9)}
    mass = RigidBody("mass", mass_points, 400.0, 115 * np.eye(3))
    borne = {"h": 0.0, "v": -400.0 * 9.80665 / 2, "w": -400.0 * 9.80665 / 2}
    springs = tuple(SpringDamper(k, f"ground.{k}", f"mass.{k}", "line", 15e3, 0.03, preload=borne[k]) for k in "hvw")
    plane = planar("plane", "ground.c", "mass.c", "y")
    ground = RigidBody("ground", ground_points, fixed=True)
    return Scene("gravimeter", (ground, mass), (plane,), springs=springs, gravity=(0, 0, -9.80665))


def test_gravimeter(gravimeter):
    """Its three modes, without and with gravity, which makes one of them two real poles."""
    assert 2 * np.pi * frequencies(gravimeter, loaded=False) == pytest.approx([2.27025, 8.65936, 21.7596], rel=5e-3)
    assert 2 * np.pi * frequencies(gravimeter) == pytest.approx([-10.984, 0.83296, 8.65963], rel=5e-3)


def test_unstable_equilibria_are_told_with_their_pole(gravimeter):
    with pytest.warns(UserWarning, match=r"scene 'gravimeter' under its loads is unstable: .* pole \+10\.997 rad/s"):
        model = linearize(replace(gravimeter, damping_ratio=0.0))
    (pole,) = unstable_poles(model)
    assert pole.growth_rate == pytest.approx(10.984, rel=5e-3)


@pytest.mark.parametrize("dampers", [(0.0, 0.0), (0.05, 0.0), (0.0, 0.05), (0.05, 0.05)])
def test_a_torque_that_keeps_its_direction_lets_a_ball_flutter_unless_both_its_tilts_are_damped(dampers):
    """Tilts with springs k and dampers c, which it couples: (I s^2 + c1 s + k) (I s^2 + c2 s + k) + T^2 / 4 = 0."""
    inertia, stiffness, torque = 0.01, 100.0, 0.5
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    ball = RigidBody("ball", {"c": np.zeros(3)}, 1.0, inertia * np.diag([1.0, 1.0, 2.0]))
    springs = Bushing("springs", "ground.c", "ball.c", [0, 0, 0, *3 * [stiffness]], [0, 0, 0, *dampers, 0])
    scene = Scene(
        "ball",
        (ground, ball),
        (spherical("bearing", "ground.c", "ball.c"),),
        (PointTorque("twist", "ball.c", "z", "torque"),),
        springs=(springs,),
        damping_ratio=0.0,
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        model = linearize(scene, constant_inputs={"torque": torque})
    tilts = np.polymul(*([inertia, c, stiffness] for c in dampers))
    expected = np.roots(np.polyadd(tilts, [torque**2 / 4]))
    assert model.poles().real.max() == pytest.approx(max(expected.real.max(), 0.0), abs=1e-5)
    assert bool(told) == (expected.real.max() > 0) == (0.0 in dampers)


@pytest.mark.parametrize("turn", [np.eye(3), TURN], ids=["along z", "anyhow"])
def test_pendulums_swing_and_stand(turn):
    """1.2 kg at 2.3 m, described along any axes: 0.328693 Hz, and a pole of the same size where it stands."""
    ball = RigidBody("ball", {"hinge": turn @ [0, 0, 2.3]}, 1.2, 1e-9 * np.eye(3), turn @ [0, 0, -2.3])
    wall = RigidBody("wall", {"o": np.zeros(3)}, fixed=True)
    scene = Scene("pendulum", (wall, ball), (revolute("hinge", "wall.o", "ball.hinge", turn[:, 1]),))
    assert frequencies(replace(scene, gravity=turn @ GRAVITY)) == pytest.approx([0.328693], rel=1e-6)
    assert frequencies(replace(scene, gravity=-turn @ GRAVITY)) == pytest.approx([-0.328693], rel=1e-6)
    assert frequencies(replace(scene, gravity=turn @ GRAVITY), loaded=False) == pytest.approx([0.0], abs=1e-9)


def test_a_loop_holds_a_pendulum_that_stands():
    """It leans by a torque over what the loop resists beyond m g l; without the loop the run is refused."""
    ball = RigidBody("ball", {"hinge": TURN @ [0, 0, -2.3]}, 1.2, 1e-9 * np.eye(3), TURN @ [0, 0, 2.3])
    wall = RigidBody("wall", {"o": np.zeros(3)}, fixed=True)
    axis = TURN[:, 1]
    scene = Scene(
        "balance",
        (wall, ball),
        (revolute("hinge", "wall.o", "ball.hinge", axis),),
        (PointTorque("motor", "ball.hinge", axis, "torque"),),
        (AngleSensor("angle", "wall.o", "ball.hinge", axis),),
        (Bushing("oil", "wall.o", "ball.hinge", np.zeros(6), [0, 0, 0, 0, 20, 0], TURN),),
        gravity=TURN @ GRAVITY,
    )
    torque = TimeHistory(np.arange(1000) * 0.02, np.full((1, 1000), 0.1), ("torque",), ("N m",))
    with pytest.raises(ValueError, match=r"scene 'balance' under its loads is unstable: .* pole \+2\.0"):
        simulate(scene, torque, time_step=0.02, method="exact", progress=False)
    held = replace(scene, loops=(Loop("hold", proportional(-60.0, sample_rate=50.0), "angle", "torque"),))
    with pytest.warns(UserWarning, match="only its loops can hold it"):
        record = simulate(held, torque, time_step=0.02, method="exact", progress=False)
    assert record["angle"][-1] == pytest.approx(0.1 / (60.0 - 1.2 * 9.81 * 2.3), rel=1e-6)


def test_a_pendulum_hangs_on_a_spindle_until_the_spin_throws_it_out():
    """In the frame that turns about the vertical: g / l - W^2; gravity across the axis is not constant there."""
    ball = RigidBody("ball", {"hinge": TURN @ [0, 0, 2.3]}, 1.2, 1e-9 * np.eye(3), TURN @ [0, 0, -2.3])
    bodies = RigidBody("wall", {"o": np.zeros(3)}, fixed=True), ball
    hinge = revolute("hinge", "wall.o", "ball.hinge", TURN[:, 1])
    for sideways in (0.0, 5.0):
        scene = Scene("spindle", bodies, (hinge,), gravity=TURN @ [sideways, 0, -9.81], damping_ratio=0.0)
        for rate in (0.5, 1.9, 3.0):
            (square, _) = linearize(scene, angular_velocity=rate * TURN[:, 2]).poles() ** 2
            assert square == pytest.approx(rate**2 - 9.81 / 2.3, rel=1e-6)


def test_constant_forces_load_a_scene_that_spins():
    """The same pendulum under a force along the axis instead of its weight."""
    ball = RigidBody("ball", {"hinge": TURN @ [0, 0, 2.3], "c": (0, 0, 0)}, 1.2, 1e-9 * np.eye(3), TURN @ [0, 0, -2.3])
    bodies = RigidBody("wall", {"o": np.zeros(3)}, fixed=True), ball
    hinge, down = revolute("hinge", "wall.o", "ball.hinge", TURN[:, 1]), PointForce("down", "ball.c", -TURN[:, 2], "f")
    scene = Scene("spindle", bodies, (hinge,), (down,), damping_ratio=0.0)
    model = linearize(scene, angular_velocity=1.9 * TURN[:, 2], constant_inputs={"f": 1.2 * 9.81})
    assert model.poles() ** 2 == pytest.approx(2 * [1.9**2 - 9.81 / 2.3], rel=1e-6)


def test_a_body_on_two_links():
    """R. Gasch, K. Knothe, Strukturdynamik: rigid links, and line springs of the same length, hold a square body."""
    a, m = 1.75, 8.8
    inertia = 2 / 3 * m * a**2 * np.eye(3)
    ground = RigidBody("ground", {"l": (-3 * a, 0, 3 * a), "r": (3 * a, 0, 3 * a)}, fixed=True)
    mass = RigidBody("mass", {"l": (-a, 0, a), "r": (a, 0, a)}, m, inertia)
    bodies, joints = [ground, mass], []
    for name, half in (("l", np.array([-a, 0, a])), ("r", np.array([a, 0, a]))):
        bodies.append(RigidBody(name, {"up": half, "low": -half}, 1e-7, 1e-9 * np.eye(3), 2 * half))
        joints.append(universal(f"{name}_up", f"ground.{name}", f"{name}.up", "y", np.cross(half, (0, 1, 0))))
        joints.append(spherical(f"{name}_low", f"{name}.low", f"mass.{name}"))
    expected = [0.208787, 0.565232, 0.588976, 0.799359]
    links = Scene("links", tuple(bodies), tuple(joints), gravity=GRAVITY)
    assert frequencies(links)[:4] == pytest.approx(expected, rel=1e-5)
    springs = tuple(SpringDamper(k, f"ground.{k}", f"mass.{k}", "line", 1e9) for k in "lr")
    stiff = Scene("springs", (ground, mass), springs=springs, gravity=GRAVITY)
    assert frequencies(stiff)[:4] == pytest.approx(expected, rel=1e-5)


def test_free_bodies_fall_without_stress_and_stiffness(hung):
    """Far from any joint, a reduced body in gravity has the modes of one in space."""
    scene = Scene("fall", (FlexibleBody("bar", hung, rotation=TURN),), gravity=GRAVITY)
    np.testing.assert_allclose(frequencies(scene)[6:], frequencies(scene, loaded=False)[6:], rtol=1e-9)
    assert np.abs(frequencies(scene)[:6]).max() < 1e-3


STEEL = Material("steel", 200e9, 0.3, 7800.0)


@pytest.fixture(scope="module")
def hung():
    """A bar of 2 m x 4 mm x 4 mm."""
    solid = make_bar(length=2.0, side=4e-3, material=STEEL)
    mesh = generate_mesh(solid, element_size=8e-3, layer_thickness=0.25, extrude="x")
    return craig_bampton(meshed(mesh, solid, 3), n_modes=8, geometric_stiffness=True, progress=False)


def hanging(body, **more):
    wall = RigidBody("wall", {"c": np.zeros(3)}, fixed=True)
    hinge = revolute("hinge", "wall.c", "bar.left", "y")
    return Scene("hung", (wall, FlexibleBody("bar", body, rotation=DOWN, **more)), (hinge,), gravity=GRAVITY)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_a_hung_bar(hung, frame):
    """A beam with tension: the same with the frame on either end."""
    found = frequencies(hanging(hung, frame=frame))[[0, 2]]
    assert found == pytest.approx([0.43116, 3.74295], rel=2e-4)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_a_bar_that_swings_down_to_hang_is_not_bent_there(hung, frame):
    """Drawn 10 mrad beside its equilibrium, on a soft spring: to first order, its weight bends it by 6 mm."""
    scene = hanging(keep_modes(hung, 4), frame=frame)
    ground, bar = scene.bodies
    scene = replace(scene, springs=(Bushing("spring", "wall.c", "bar.left", stiffness=(0, 0, 0, 0, 0.01, 0)),))
    beside = replace(bar, rotation=Rotation.from_rotvec([0, 0.01, 0]).as_matrix() @ bar.rotation)
    expected, found = (frequencies(replace(scene, bodies=(ground, body)))[:5] for body in (bar, beside))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_a_hung_bar_swings_in_time_as_in_the_linear_model(hung, frame):
    """Its weight is slightly beside its axis: the first swing about the equilibrium, from the reference."""
    scene = replace(hanging(keep_modes(hung, 2), frame=frame), gravity=(0.02, 0, -9.81), damping_ratio=0.0)
    sensor = Encoder("tip", "wall.c", "bar.right", "x")
    rest = TimeHistory(np.arange(260) * 0.01, np.zeros((0, 260)), (), ())
    told = simulate(replace(scene, sensors=(sensor,)), rest, time_step=0.01, start="released", progress=False)
    tip = told.values[0]
    swing = scipy.optimize.curve_fit(lambda t, f, a: a * (1 - np.cos(2 * np.pi * f * t)), told.time, tip, [0.43, 2e-3])
    assert swing[0][0] == pytest.approx(0.43116, rel=3e-3)


def test_a_prestressed_bar_has_its_second_mode_in_time(hung):
    """Without its stress 3.37 Hz, as the weight on its bent shape has less to do than the tension."""
    scene = hanging(keep_modes(hung, 4), frame="right")
    push, tip = PointForce("push", "bar.right", "x", "f"), Encoder("tip", "wall.c", "bar.right", "x")
    scene = replace(scene, actuators=(push,), sensors=(tip,), damping_ratio=0.0)
    time = np.arange(1000) * 4e-3
    pulse = TimeHistory(time, 1e-4 * (time < 0.05)[None], ("f",), ("N",))
    record = simulate(scene, pulse, time_step=4e-3, progress=False).values[1, 50:]
    window = np.hanning(len(record)) * (record - record.mean())
    tried = np.linspace(3.2, 4.0, 1601)
    spectrum = np.abs(np.exp(-2j * np.pi * np.outer(tried, time[50:])) @ window)
    assert tried[np.argmax(spectrum)] == pytest.approx(3.74295, rel=2e-3)


@pytest.mark.parametrize(("method", "error"), [("exact", 1e-5), ("generalized_alpha", 2e-4)])
def test_runs_in_small_motion_are_those_of_the_linear_model(hung, method, error):
    """A hung bar that swings after a push across; its weight beside its axis moves it from the reference."""
    push, tip = PointForce("push", "bar.right", (1, 0.3, 0), "f"), Encoder("tip", "wall.c", "bar.right", (1, 0.2, 0))
    scene = replace(hanging(hung, fidelity="linear"), actuators=(push,), sensors=(tip,))
    body = replace(scene.bodies[1], rotation=Rotation.from_rotvec([0, 1e-3, 0]).as_matrix() @ DOWN)
    spring = Bushing("spring", "wall.c", "bar.left", stiffness=(0, 0, 0, 0, 0.1, 0))
    scene = replace(scene, bodies=(scene.bodies[0], body), springs=(spring,))
    time = np.arange(400) * 5e-3
    pulse = TimeHistory(time, 1e-3 * (np.sin(np.pi * time / 0.3) * (time < 0.3))[None], ("f",), ("N",))
    record = simulate(scene, pulse, time_step=5e-3, method=method, progress=False).values[1]
    model, rest = linearize(scene), static_response(scene)["tip"]
    expected = scipy.signal.lsim(model.matrices, pulse.values[0], time)[1] + rest
    assert np.abs(record - expected).max() < error * np.ptp(expected)
    without = scipy.signal.lsim(linearize(scene, loaded=False).matrices, pulse.values[0], time)[1]
    assert np.abs(record - rest - without).max() > 0.1 * np.ptp(expected)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_all_engines_have_the_same_frequencies_under_load(hung, strip, frame):
    """A hung bar, and a strip at half of its buckling load: those of the linear model, of small motion and of Exudyn's
    floating frames, by differences of its forces."""
    strut = standing(strip, frame=frame)
    factor = buckling_factors(replace(strut, gravity=-TURN[:, 0]))[0][0]
    for scene in (hanging(keep_modes(hung, 4), frame=frame), replace(strut, gravity=-0.5 * factor * TURN[:, 0])):
        expected, without = frequencies(scene), frequencies(scene, loaded=False)
        assert abs(expected[0] - without[0]) > 0.2 * expected[0]
        for fidelity in ("linear", "ffrf"):
            body = replace(scene.bodies[1], fidelity=fidelity)
            found = exudyn_eigenfrequencies(replace(scene, bodies=(scene.bodies[0], body)), loaded=True)
            np.testing.assert_allclose(found[:6], expected[:6], rtol=1e-3, err_msg=fidelity)


def test_bodies_in_small_motion_beside_floating_ones_have_their_stress(hung, strip):
    """A hung bar that swings, and a strip at half of its buckling load, with a floating strip on the same ground."""
    strut = standing(strip)
    factor = buckling_factors(replace(strut, gravity=-TURN[:, 0]))[0][0]
    for scene in (hanging(keep_modes(hung, 2)), replace(strut, gravity=-0.5 * factor * TURN[:, 0])):
        ground, body = scene.bodies
        other = FlexibleBody("other", keep_modes(strip, 0), rotation=body.rotation)
        joints = (*scene.joints, fixed("other", f"{ground.name}.c", "other.left"))
        mixed = replace(scene, bodies=(ground, replace(body, fidelity="linear"), other), joints=joints)
        found = exudyn_eigenfrequencies(mixed, loaded=True)
        np.testing.assert_allclose(found[:6], frequencies(mixed)[:6], rtol=1e-6)


@pytest.mark.parametrize(
    ("capped", "hung", "frame"),
    [(True, True, "left"), (True, False, "right"), (False, True, "right"), (False, False, "left")],
    ids=["capped-hung", "capped-standing", "open-hung", "open-standing"],
)
def test_a_reduced_scene_holds_the_geometric_stiffness_of_its_parts(strip, capped, hung, frame):
    """Two bars that are not in line, with a block between them that is welded to one and soft to the other.

    Where both ends are capped by rigid bodies, forces on the caps' ends turn with these, and so do those of the welds.
    Both models are of the stiffness alone, in the reference configuration: the coordinates of one body have no place
    for what turns within it.
    """
    bar, skewed = keep_modes(strip, 2), Rotation.from_rotvec([0.3, 0.2, -0.1]).as_matrix()
    first = FlexibleBody("a", bar, frame=frame)
    last = FlexibleBody("b", bar, [SLENDER + 0.03, 0.01, 0.02], skewed, frame=frame)
    ends = {"p": [-0.015, -0.005, -0.01], "q": [0.015, 0.005, 0.01]}
    block = RigidBody("block", ends, 0.3, 1e-3 * np.diag([1.0, 1.2, 0.7]), [SLENDER + 0.015, 0.005, 0.01])
    weld, soft = fixed("weld", "a.right", "block.p"), [4e5, 3e5, 5e5, 90.0, 150.0, 120.0]
    parts = Scene("parts", (first, block, last), (weld,), springs=(Bushing("soft", "block.q", "b.left", soft),))
    if capped:  # both ends are points of rigid bodies far from the bars
        caps = [
            RigidBody(name, {"c": -half, "end": half}, 0.1, 1e-4 * np.eye(3), parts.point_position(path) + half)
            for name, path, half in (
                ("foot", "a.left", np.array([-0.05, 0.01, 0.025])), ("tip", "b.right", np.array([0.075, 0.05, -0.025]))
            )
        ]  # fmt: skip
        clamps = (fixed("low", "foot.c", "a.left"), fixed("high", "tip.c", "b.right"))
        parts = replace(parts, bodies=(*parts.bodies, *caps), joints=(weld, *clamps))
    low, high = ("foot.end", "tip.end") if capped else ("a.left", "b.right")
    whole = reduce_scene(parts, "whole", points={"left": low, "right": high})
    ground = RigidBody("ground", {"c": parts.point_position(low)}, fixed=True)

    def held(path):
        return revolute("foot", "ground.c", path, "y") if hung else fixed("foot", "ground.c", path)

    load = {"gravity": (1.0 if hung else -1.0) * np.array([1.0, 0.02, 0.01]), "damping_ratio": 0.0}
    one = Scene("one", (ground, FlexibleBody("whole", whole, frame=frame)), (held("whole.left"),), **load)
    many = replace(parts, bodies=(ground, *parts.bodies), joints=(*parts.joints, held(low)), **load)

    def as_drawn(scene):
        assembly = assemble(scene)
        loaded = (
            np.diag((2 * np.pi * assembly.modal.frequency) ** 2)
            + loaded_state(assembly, gravity=scene.gravity).stiffness
        )
        return np.sqrt(np.sort(np.linalg.eigvals(loaded).real)[:count]) / (2 * np.pi)

    count = 2 if capped else 4
    expected, without = as_drawn(many), frequencies(many, loaded=False)[:count]
    assert (np.abs(as_drawn(one) - expected) < 0.1 * np.abs(without - expected)).all()


def test_a_bent_bar_with_a_block_at_its_end(strip):
    """Against the energies in the bar's own coordinates, which the block follows; its foot is clamped.

    What is left out is of second order in the angle of the bar's tip, for which a bar is stiff along its axis. Models
    about the reference configuration are wrong by a tenth of the load's effect, however small the load is.
    """
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    block = RigidBody("block", {"p": [-0.015, -0.005, -0.01]}, 0.3, 1e-3 * np.diag([1.0, 1.2, 0.7]))
    block = replace(block, position=np.array([SLENDER, 0, 0]) - block.points["p"])
    bar = FlexibleBody("bar", keep_modes(strip, 2), frame="left")
    joints = fixed("foot", "ground.c", "bar.left"), fixed("weld", "bar.right", "block.p")
    scene = Scene("s", (ground, bar, block), joints, gravity=8 * np.array([-1.0, 0.3, 0.2]), damping_ratio=0.0)
    stress = loaded_state(assemble(scene), gravity=scene.gravity).stress["bar"].stiffness
    free = np.arange(len(stress)) >= 6  # its left point has the first six coordinates
    assert bar.reduced.point_names[0] == "left"
    tip, weight = bar.motion("right")[:, free], bar.weight(scene.gravity)[free]
    mass, elastic, stress = (m[np.ix_(free, free)] for m in (bar.mass_matrix, bar.reduced.stiffness_matrix, stress))

    def rows_of_block(values):
        vector = tip[3:] @ values
        rotation, angle = Rotation.from_rotvec(vector).as_matrix(), np.linalg.norm(vector)
        turn, size = skew(vector), max(angle, 1e-9)
        left = np.eye(3) + (1 - np.cos(size)) / size**2 * turn + (size - np.sin(size)) / size**3 * turn @ turn
        spin = left @ tip[3:]
        return tip[:3] + skew(rotation @ block.points["p"]) @ spin, spin, rotation

    def left(values):
        return elastic @ values - weight - block.mass * rows_of_block(values)[0].T @ scene.gravity

    rest = np.linalg.solve(elastic, weight)
    for _ in range(20):
        rest = rest - np.linalg.solve(elastic, left(rest))
    steps = 1e-3 * np.abs(rest).max() * np.eye(len(rest))
    curvature = np.array([(left(rest + step) - left(rest - step)) / (2 * step.max()) for step in steps])
    velocity, spin, rotation = rows_of_block(rest)
    inertia = rotation @ block.inertia @ rotation.T
    kinetic = mass + block.mass * velocity.T @ velocity + spin.T @ inertia @ spin
    squares = scipy.linalg.eigh(0.5 * (curvature + curvature.T) + 0.5 * (stress + stress.T), kinetic)[0][:4]
    expected, without = np.sqrt(squares) / (2 * np.pi), frequencies(scene, loaded=False)[:4]
    assert np.abs(without / expected - 1).max() > 1e-3
    np.testing.assert_allclose(frequencies(scene)[:4], expected, rtol=1.2e-6)


def test_a_trimmed_hung_bar_keeps_its_stress(hung):
    """Its free end is no coordinate any more, and no load of its own weight is asked for."""
    trimmed = trim_body(hung, points=["left"], loads=np.zeros((len(hung.mass_matrix), 0)), cutoff_frequency=60.0)
    assert len(trimmed.mass_matrix) < len(hung.mass_matrix)
    found = frequencies(hanging(trimmed))[[0, 2]]
    assert found == pytest.approx([0.43116, 3.74295], rel=1e-3)


def test_truncation_errors_hold_under_load(hung):
    """Estimates compare with the enriched body, which has the stress too."""
    scene = replace(hanging(keep_modes(hung, 1)), damping_ratio=0.01)
    push, tip = PointForce("push", "bar.right", "x", "f"), Encoder("tip", "wall.c", "bar.right", "x")
    scene = replace(scene, actuators=(push,), sensors=(tip,))
    body = scene.bodies[1]
    richer = replace(scene, bodies=(scene.bodies[0], replace(body, reduced=body.reduced.enriched)))
    assert frequencies(richer)[2] == pytest.approx(3.74295, rel=2e-4)
    frequency = np.array([3.0, 3.5])
    coarse, fine = (frequency_response(linearize(s), frequency).values for s in (scene, richer))
    np.testing.assert_allclose(truncation_error(scene, frequency), np.abs(coarse / fine - 1), rtol=1e-6)


def test_bodies_without_geometric_stiffness_are_estimated_and_told(hung):
    bare = replace(hung, readouts={})
    with pytest.warns(UserWarning, match=r"stress in body 'bar' under load changes the mode at .* Hz by some \+"):
        linearize(hanging(bare))
    for frame in ("left", "right"):  # 2.6 Hz without the estimate, with the frame at the right
        assert frequencies(hanging(bare, frame=frame))[2] == pytest.approx(3.743, rel=0.11), frame


HEIGHT = np.sqrt(12) / 70
UNIT = np.sqrt(STEEL.young_modulus * HEIGHT**2 / 12 / STEEL.density)
"""sqrt(E I / (rho A L^4)) of the blade [rad/s]."""


@pytest.fixture(scope="module")
def blade():
    """A blade of slenderness 70, 1 m long."""
    solid = make_bar(length=1.0, side=HEIGHT, material=STEEL, coupling="rbe2")
    mesh = generate_mesh(solid, element_size=2 * HEIGHT, layer_thickness=0.125, extrude="x")
    return craig_bampton(meshed(mesh, solid, 4), n_modes=12, geometric_stiffness=True, progress=False)


@pytest.mark.filterwarnings("ignore:under the spin", "error:body 'blade'")
def test_rotating_cantilevers(blade):
    """Flap and chord at some speeds: A. Hamza Cherif and A. Houmat. No stiffening is left out, so none is told."""
    hub = RigidBody("hub", {"c": np.zeros(3)}, fixed=True)
    bodies, root = (hub, FlexibleBody("blade", blade, rotation=TURN)), fixed("root", "hub.c", "blade.left")
    scene = Scene("blade", bodies, (root,), damping_ratio=0.0)
    for speed, chord, flap in ((2, 3.6195, 4.1373), (6, 4.2393, 7.3603), (10, 4.97, 11.2023)):
        poles = np.linalg.eigvals(linearize(scene, angular_velocity=speed * UNIT * TURN[:, 2]).A)
        found = np.sort(poles.imag[poles.imag > 0])[:2] / UNIT
        assert found == pytest.approx([chord, flap], rel=3e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:under the spin", "ignore:body 'blade' turns at")
def test_a_prestressed_blade_on_a_drive_in_time(blade):
    """After a pulse across and along the axis, at a speed of 6; without its stress it is refused as unstable."""
    ground, shaft = (
        RigidBody("ground", {"c": np.zeros(3)}, fixed=True),
        revolute("shaft", "ground.c", "blade.left", "z"),
    )
    push = PointForce("push", "blade.right", (0, 1, 1), "f", "blade.right")
    sensors = tuple(Encoder(axis, "blade.left", "blade.right", axis, "blade.left") for axis in "yz")
    motor = Drive("motor", "shaft", "rz", speed=6 * UNIT)
    body = FlexibleBody("blade", blade)
    scene = Scene("blade", (ground, body), (shaft,), (motor, push), sensors, damping_ratio=0.0)
    step = 2 * np.pi / (4.24 * UNIT) / 90
    time = np.arange(1500) * step
    pulse = TimeHistory(time, 100.0 * (time < 5 * step)[None], ("f",), ("N",))
    bare = replace(scene, bodies=(ground, replace(body, reduced=replace(blade, readouts={}))))
    with pytest.raises(ValueError, match="unstable: a drift"):
        simulate(bare, pulse, time_step=step, progress=False)
    record = simulate(scene, pulse, time_step=step, progress=False)
    for axis, expected in (("y", 4.2393), ("z", 7.3603)):
        signal = record.values[record.names.index(axis), 20:]
        tried = expected * np.linspace(0.9, 1.1, 801)
        waves = np.exp(-1j * UNIT * np.outer(tried, time[20:]))
        found = tried[np.argmax(np.abs(waves @ ((signal - signal.mean()) * np.hanning(len(signal)))))]
        assert found == pytest.approx(expected, rel=3e-3)


def shaken(blade, speeds, plateau=0.15, ramp=0.3, step=2.5e-4):
    """A blade on a drive, shaken across the plane of rotation, run up to some speeds; its excitation and plateaus."""
    ground, shaft = RigidBody("ground", {"c": np.zeros(3)}, fixed=True), TURN[:, 2]
    hinge, motor = revolute("shaft", "ground.c", "blade.left", shaft), Drive("motor", "shaft", "rz", input="angle")
    push, tip = PointForce("push", "blade.right", shaft, "f"), Encoder("tip", "ground.c", "blade.right", shaft)
    body = FlexibleBody("blade", blade, rotation=TURN)
    scene = Scene("blade", (ground, body), (hinge,), (motor, push), (tip,), damping_ratio=0.0)
    share, speed, plateaus = np.linspace(0, 1, round(ramp / step)), np.zeros(0), []
    for before, after in zip((0, *speeds), speeds, strict=False):
        speed = np.append(speed, before + (after - before) * share**2 * (3 - 2 * share))
        plateaus.append(slice(len(speed), len(speed) + round(plateau / step)))
        speed = np.append(speed, np.full(round(plateau / step), float(after)))
    angle = np.concatenate([[0.0], np.cumsum(0.5 * step * UNIT * (speed[1:] + speed[:-1]))])
    time = np.arange(len(speed)) * step
    force = 20.0 * np.sin(np.pi * np.clip(time / 0.01, 0, 1))
    return scene, TimeHistory(time, np.vstack([angle, force]), ("angle", "f"), ("rad", "N")), plateaus


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:body 'blade' is deformed by up to 8.7 %")
def test_a_blade_that_runs_up_stiffens_in_time(blade):
    """Flap at speeds of 4 and 8 in one run: A. Hamza Cherif and A. Houmat; 3.516 at rest."""
    scene, excitation, plateaus = shaken(keep_modes(blade, 3), (4, 8))
    record = simulate(scene, excitation, time_step=2.5e-4, stress="present", progress=False)
    for plateau, flap in zip(plateaus, (5.5850, 9.2568), strict=True):
        signal, tried = record["tip"][plateau], np.linspace(0.95, 1.05, 401) * flap
        waves = np.exp(-1j * UNIT * np.outer(tried, record.time[plateau]))
        found = tried[np.argmax(np.abs(waves @ (signal * np.hanning(len(signal)))))]
        assert found == pytest.approx(flap, rel=3e-3)


def test_the_present_stress_is_that_of_the_scene_in_its_present_position(blade):
    """A quarter and some of a turn later, at another speed, with gravity across the axis and a pull that goes along.

    The blade's end carries a head. What is expected is the stress of a linear model in that position.
    """
    scene, _, _ = shaken(keep_modes(blade, 2), (1,))
    ground, body = scene.bodies
    axis, turn = TURN[:, 2], Rotation.from_rotvec(2.0 * TURN[:, 2]).as_matrix()
    gravity, stator = np.array([3.0, -5.0, 8.0]), frozenset(["ground"])

    def pulled(rotation):
        pull = PointForce("pull", "blade.right", rotation @ (0.6, 0.48, 0.64), "pull", "blade.right")
        place, inertia = np.array([1.2, -0.05, -0.1]), 0.1 * np.eye(3)
        head = RigidBody("head", {"seat": [1, 0, 0] - place}, 3.0, inertia, rotation @ place, rotation=rotation)
        carried = replace(
            scene,
            gravity=gravity,
            actuators=(*scene.actuators, pull),
            bodies=(ground, replace(body, rotation=rotation), head),
            joints=(*scene.joints, fixed("seat", "blade.right", "head.seat")),
        )
        return assemble(carried)

    still, later = pulled(TURN), pulled(turn @ TURN)
    still = still.under(loaded_state(still, inputs={"pull": 10.0}))
    present = PresentStress.of(still, ["blade"], axis, np.zeros(3), stator, 0.0)
    start = stress_under(still, gravity)["blade"].added_to(body.reduced.strain)
    spin = {"angular_velocity": 7.0 * axis, "partition": RotorPartition(7.0 * axis, np.zeros(3), stator)}
    loads = loaded_state(later, gravity=gravity, inputs={"pull": 10.0}, **spin)
    expected = loads.stress["blade"].stiffness + loads.carried["blade"]
    change = present.change("blade", turn, 7.0 * axis)
    np.testing.assert_allclose(start + change, expected, atol=1e-9 * np.abs(expected).max())
    assert np.abs(start - expected).max() > 0.4 * np.abs(expected).max()


def test_the_present_stress_of_a_run_follows_its_drive(blade, monkeypatch):
    """By the turn of the blade since the start, about the shaft, and by its speed there, however the blade stands."""
    seen, step = [], 2.5e-4
    monkeypatch.setattr(PresentStress, "change", lambda *motion: seen.append(motion[2:]) or np.zeros((13, 13)))
    scene, excitation, _ = shaken(keep_modes(blade, 1), (2,), plateau=0.0, ramp=0.15)
    simulate(scene, excitation, time_step=step, stress="present", start="released", progress=False)
    angle, (turns, velocities) = excitation["angle"], map(np.array, zip(*seen, strict=True))
    assert angle[-2] > 0.3
    expected = Rotation.from_rotvec(angle[:-1, None] * TURN[:, 2]).as_matrix()
    np.testing.assert_allclose(turns[-len(expected) :], expected, atol=1e-6)
    speeds = np.gradient(angle, step)[1:-1, None] * TURN[:, 2]
    np.testing.assert_allclose(velocities[1 - len(expected) :], speeds, atol=0.02 * np.abs(speeds).max())


def test_runs_stepped_one_by_one_have_the_same_present_stress(blade):
    """They leave no stiffening out, so none is told, as it is of a run with the stress of the start."""
    scene, excitation, _ = shaken(keep_modes(blade, 1), (0.3,), plateau=0.0, ramp=0.05)
    options = {"time_step": 2.5e-4, "start": "released"}

    def at_once(stress):
        return simulate(scene, excitation, progress=False, stress=stress, **options)["tip"]

    def stepped(stress):
        rates = {"angle": excitation["angle"][1] / 2.5e-4}
        with Simulation(scene, input_rates=rates, stress=stress, **options) as run:
            for angle, force in excitation.values.T[1:]:
                run.step({"angle": angle, "f": force})
        return run.record["tip"]

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(stepped("present"), at_once("present"))
    assert not [one for one in told if "centrifugal stiffening" in str(one.message)]
    for run in (at_once, stepped):
        with pytest.warns(UserWarning, match="body 'blade' turns at .*: centrifugal stiffening, which the run leaves"):
            run("start")


def test_at_a_constant_speed_the_present_stress_is_that_of_the_start(blade):
    """Without gravity, which would turn against the blade; also where no linear model tells that of the start.

    The blade's end carries a head, whose centrifugal force has an arm from it. Without a linear model the head is a
    body of its own, and the run does not start in equilibrium, so what counts is the response to the push.
    """
    scene, excitation, _ = shaken(keep_modes(blade, 1), (4,), plateau=0.0, ramp=0.03)
    motor, tip = Drive("motor", "shaft", "rz", speed=4 * UNIT), scene.point_position("blade.right")
    head = RigidBody("head", {"seat": -0.3 * TURN[:, 0]}, 5.0, 0.1 * np.eye(3), tip + 0.3 * TURN[:, 0])
    scene = replace(
        scene,
        bodies=(*scene.bodies, head),
        joints=(*scene.joints, fixed("seat", "blade.right", "head.seat")),
        actuators=(motor, *scene.actuators[1:]),
    )
    push = replace(excitation, values=excitation.values[1:], names=("f",), units=("N",))

    def response(scene, stress):
        still = replace(push, values=np.zeros_like(push.values))
        pushed, alone = (
            simulate(scene, one, time_step=2.5e-4, stress=stress, progress=False)["tip"] for one in (push, still)
        )
        return pushed - alone

    start = response(scene, "start")
    np.testing.assert_allclose(response(scene, "present"), start, rtol=0, atol=1e-3 * np.ptp(start))
    sledge = RigidBody("sledge", {"c": np.zeros(3)}, 1.0, np.eye(3))
    beside = replace(
        scene,
        bodies=(*scene.bodies, sledge),  # elastic along one axis that does not turn
        joints=(*scene.joints, prismatic("guide", "ground.c", "sledge.c", "x")),
        springs=(SpringDamper("spring", "ground.c", "sledge.c", "x", 1e4),),
    )
    with pytest.raises(ValueError, match="this changes by"):
        linearize(beside)
    np.testing.assert_allclose(response(beside, "present"), start, rtol=0, atol=2e-3 * np.ptp(start))


def test_present_stress_is_refused_where_nothing_follows_it(blade, strip):
    scene, excitation, _ = shaken(keep_modes(blade, 1), (4,), plateau=0.01, ramp=0.02)
    options = {"time_step": 2.5e-4, "stress": "present", "progress": False}
    ground, body = scene.bodies
    with pytest.raises(ValueError, match=r"it has 1 such drives and 0 such bodies: leave stress"):
        simulate(replace(scene, bodies=(ground, replace(body, fidelity="rigid"))), excitation, **options)
    with pytest.raises(ValueError, match="by method 'generalized_alpha' has the stress of the start"):
        simulate(replace(scene, bodies=(ground, replace(body, fidelity="linear"))), excitation, **options)
    with pytest.raises(ValueError, match="unknown stress 'now'"):
        simulate(scene, excitation, **options | {"stress": "now"})
    rest = TimeHistory(np.arange(3) * 1e-3, np.zeros((1, 3)), ("force",), ("N",))
    for run in (simulate, partial(simulate_motion, frames=2)):
        with pytest.raises(ValueError, match="it has 0 such drives and 1 such bodies"):
            run(standing(strip), rest, time_step=1e-3, stress="present", progress=False)


SLENDER = 0.5
"""Length of a standing strip [m], 10 mm wide and thick."""


@pytest.fixture(scope="module")
def strip():
    solid = make_bar(length=SLENDER, side=0.01, material=STEEL)
    mesh = generate_mesh(solid, element_size=0.02, layer_thickness=0.125, extrude="x")
    return craig_bampton(meshed(mesh, solid, 3), n_modes=4, geometric_stiffness=True, progress=False)


def standing(strip, gravity=0.0, frame=None):
    """A strip clamped at its foot, with a force at its top, in no particular direction of the world."""
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    body = FlexibleBody("strip", strip, rotation=TURN, frame=frame)
    push = PointForce("push", "strip.right", TURN[:, 0], "force")
    foot = fixed("foot", "ground.c", "strip.left")
    return Scene("standing", (ground, body), (foot,), (push,), damping_ratio=0.0, gravity=-gravity * TURN[:, 0])


@pytest.mark.parametrize("frame", ["left", "right"])
@pytest.mark.parametrize("along", [-600.0, 600.0])
def test_the_tension_of_a_bent_strip_is_the_force_along_its_frame(strip, frame, along):
    """At rest under a force at its top, whether the frame of the strip stands at its foot or turns with the top."""
    scene, aside = standing(strip, frame=frame), PointForce("aside", "strip.right", TURN[:, 1], "aside")
    body = replace(scene.bodies[1], fidelity="linear")
    scene = replace(scene, bodies=(scene.bodies[0], body), actuators=(*scene.actuators, aside))
    across = 40.0 if along > 0 else 8.0
    assembly = assemble_small_motion(scene, inputs={"force": along, "aside": across})
    loads, coordinates = assembly.loads, assembly.coordinates
    rest = assembly.modal.modes @ loads.equilibrium + (0.0 if loads.offset is None else loads.offset)
    rows, constant = axial_forces_under(assembly, assembly.scene.bodies[1])
    axis = coordinates.states["strip"].pose(frame)[1] @ TURN[:, 0]
    expected = axis @ TURN @ (along, across, 0.0)
    np.testing.assert_allclose(rows @ rest[coordinates.slices["strip"]] + constant, [expected], rtol=1e-6)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_buckling_factors_of_columns(strip, frame):
    """Euler's load with Engesser's shear, and Greenhill's own weight, with the frame on either end."""
    bending = STEEL.young_modulus * 0.01**4 / 12
    euler = np.pi**2 * bending / (4 * SLENDER**2)
    euler /= 1 + euler / (5 / 6 * STEEL.young_modulus / 2.6 * 0.01**2)
    factors, shapes = buckling_factors(standing(strip, frame=frame), inputs={"force": -100.0}, n=2)
    assert factors == pytest.approx(2 * [euler / 100], rel=1e-3)
    sway, turn = (np.linalg.norm(shapes["strip"][place], axis=0) for place in (slice(7, 9), slice(10, 12)))
    np.testing.assert_allclose(turn / sway, np.pi / (2 * SLENDER), rtol=5e-3)  # 1 - cos(pi x / 2 l)
    greenhill = 7.8373 * bending / (STEEL.density * 0.01**2 * SLENDER**3)
    factors, _ = buckling_factors(standing(strip, 9.81, frame))
    assert factors == pytest.approx([greenhill / 9.81], rel=2e-3)
    pulled = standing(strip, frame=frame)
    idle, held = replace(pulled.bodies[1], name="idle"), fixed("held", "ground.c", "idle.left")
    pulled = replace(pulled, bodies=(*pulled.bodies, idle), joints=(*pulled.joints, held))
    assert not buckling_factors(pulled, inputs={"force": 100.0}, n=9)[0].size


def test_modes_that_miss_the_shape_of_buckling_are_told():
    """Prandtl's cantilever, bent about its stiff axis, twists as it buckles; none of its first three modes does."""
    length, thickness, height = 0.3, 1.5e-3, 0.02
    solid = make_bar(length, thickness, STEEL, height=height)
    mesh = generate_mesh(solid, element_size=0.01, layer_thickness=0.03, extrude="x")
    rich = craig_bampton(meshed(mesh, solid, 3), n_modes=12, geometric_stiffness=True, progress=False)
    bending = STEEL.young_modulus * height * thickness**3 / 12
    shear = STEEL.young_modulus / (2 * (1 + STEEL.poisson_ratio))
    torsion = shear * height * thickness**3 / 3 * (1 - 0.63 * thickness / height)
    push = PointForce("push", "strip.right", TURN[:, 2], "force")
    scenes = [replace(standing(body), actuators=(push,)) for body in (rich, keep_modes(rich, 3))]
    (factor,), _ = buckling_factors(scenes[0], inputs={"force": 1.0})
    assert factor == pytest.approx(4.0126 * np.sqrt(bending * torsion) / length**2, rel=0.01)
    with pytest.warns(UserWarning, match=r"leave out raise buckling factors by 3\d\.\d % \(estimate\)") as told:
        (stiff,), _ = buckling_factors(scenes[1], inputs={"force": 1.0})
    error = float(re.search(r"by ([\d.]+) %", str(told[0].message))[1])
    assert error == pytest.approx(100 * (stiff / factor - 1), abs=1)


@pytest.mark.parametrize("force", [-1.0, 1.0])
def test_what_only_rounding_softens_does_not_buckle(strip, force):
    """A force across a strip whose stress is estimated from forces along it."""
    pushed = standing(keep_modes(replace(strip, readouts={}), 3))
    pushed = replace(pushed, actuators=(PointForce("push", "strip.right", TURN[:, 2], "force"),))
    assert not buckling_factors(pushed, inputs={"force": force}, n=4)[0].size


def test_errors_of_buckling_factors_are_told_one_by_one(strip):
    """Of a column with its first modes, by the factors of one with more; that its stress is estimated is told once."""
    press = {"inputs": {"force": -100.0}, "n": 4}
    few, estimated = (standing(keep_modes(body, 2)) for body in (strip, replace(strip, readouts={})))
    with pytest.warns(UserWarning, match="buckling factors") as told:
        errors = 100 * (buckling_factors(few, **press)[0] / buckling_factors(standing(strip.enriched), **press)[0] - 1)
    assert f"by {', '.join(f'{error:.1f} %' for error in errors)} (estimate)" in str(told[0].message)
    with pytest.warns(UserWarning, match="the stress in body 'strip'") as told:
        buckling_factors(estimated, **press)
    assert [str(one.message).count("the stress in body") for one in told] == [1, 0]


def test_constant_inputs_soften_as_they_press(strip):
    """Half of Euler's load leaves 0.7 of the frequency of a column, a little more as the two shapes differ."""
    scene = standing(strip)
    factor = buckling_factors(scene, inputs={"force": -1.0})[0][0]
    free, pressed = (frequencies(scene, constant_inputs={"force": -share * factor})[0] for share in (0.0, 0.5))
    assert (pressed / free) ** 2 == pytest.approx(0.5, abs=0.02)
    tip = Encoder("tip", "ground.c", "strip.right", TURN[:, 2])
    looped = replace(scene, sensors=(tip,), loops=(Loop("loop", proportional(1.0, sample_rate=1e3), "tip", "force"),))
    closed = linearize_closed(looped, loops=(), continuous=True, constant_inputs={"force": -0.5 * factor})
    assert np.abs(closed.poles()).min() / (2 * np.pi) == pytest.approx(pressed, rel=1e-9)
    with pytest.warns(UserWarning, match=r"under its loads is unstable: .* pole \+"):
        linearize(scene, constant_inputs={"force": -1.01 * factor})


@pytest.mark.parametrize(
    ("fidelity", "method", "error"),
    [("linear", "exact", 1e-5), ("linear", "generalized_alpha", 2e-3), ("ffrf", "generalized_alpha", 1e-2)],
)
def test_runs_under_constant_inputs_are_about_their_equilibrium(strip, fidelity, method, error):
    """A column under half of its buckling load, held aside by a force, and pushed: the linear model and its rest."""
    scene = standing(strip)
    half = -0.5 * buckling_factors(scene, inputs={"force": -1.0})[0][0]
    side, tip = (
        PointForce("side", "strip.right", TURN[:, 2], "side"),
        Encoder("tip", "ground.c", "strip.right", TURN[:, 2]),
    )
    body = replace(scene.bodies[1], fidelity=fidelity)
    scene = replace(scene, bodies=(scene.bodies[0], body), actuators=(*scene.actuators, side), sensors=(tip,))
    constant, time = {"force": half, "side": 0.5}, np.arange(400) * 5e-4
    push = np.sin(np.pi * np.clip(time / 0.02, 0, 1))
    excitation = TimeHistory(time, np.vstack([0 * time, push]), ("force", "side"), ("N", "N"))
    options = {"time_step": 5e-4, "method": method, "constant_inputs": constant}
    record = simulate(scene, excitation, progress=False, **options)["tip"]
    rest = TURN[:, 2] @ loaded_equilibrium(scene, inputs=constant).motions["strip.right"][:3]
    assert record[0] == pytest.approx(rest, rel=1e-6)
    model = linearize(scene, constant_inputs=constant)
    expected = scipy.signal.lsim(model.matrices, excitation.values.T, time)[1] + rest
    assert np.abs(record - expected).max() < error * np.ptp(expected)
    with Simulation(scene, **options) as run:
        assert run.outputs["tip"] == record[0]
    start = TimeHistory(time[:2], excitation.values[:, :2], ("force", "side"), ("N", "N"))
    again, motion = simulate_motion(scene, start, frames=2, progress=False, **options)
    assert again["tip"][0] == record[0]
    # What strains the material at the start is what strains it at rest: without the shortening of a bent strip.
    strained = (moved.coordinates["strip"][0] for moved in (motion, static_motion(scene, inputs=constant)))
    energy, expected = (float(q @ strip.stiffness_matrix @ q) for q in strained)
    assert energy == pytest.approx(expected, rel=1e-6)


def test_constant_inputs_that_load_no_run_are_refused():
    ball = RigidBody("ball", {"c": np.zeros(3)}, 2.0, 1e-3 * np.eye(3))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    slide, push = Joint("slide", "ground.o", "ball.c", free=("x",)), PointForce("push", "ball.c", "x", "force")
    scene = Scene("slide", (ground, ball), (slide,), (push,))
    rest = TimeHistory(np.arange(3) * 1e-3, np.zeros((1, 3)), ("force",), ("N",))
    for method in ("exact", "generalized_alpha"):
        with pytest.raises(RuntimeError, match="no static equilibrium"):
            simulate(scene, rest, time_step=1e-3, method=method, constant_inputs={"force": 1.0}, progress=False)
    with pytest.raises(ValueError, match="unknown input 'push'"):
        simulate(scene, rest, time_step=1e-3, constant_inputs={"push": 1.0}, progress=False)
    moved = replace(
        scene, actuators=(Drive("push", "slide", "x", input="force"), GroundAcceleration("quake", "x", "shake"))
    )
    for name in ("force", "shake"):
        with pytest.raises(ValueError, match=f"input '{name}' moves a drive or the base"):
            simulate(moved, rest, time_step=1e-3, constant_inputs={name: 1.0}, progress=False)


@dataclass(frozen=True)
class Softening(ForceElement):
    """A force k (v - v^3 / 3 c^2), largest at the travel v = c."""

    name: str

    def terms(self, scene):
        def force(value, _):
            return 1e3 * (value - value**3 / (3 * 0.01**2))

        return (NonlinearSpring(Displacement.between("ground.c", "block.c", np.array([1.0, 0, 0])), force=force),)


@pytest.mark.parametrize("travel", [0.009, 0.011])
def test_a_spring_that_constant_inputs_push_beyond_its_largest_force_has_no_linear_model(travel):
    """A second spring beside it holds the block there."""
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    scene = Scene(
        "softening",
        (ground, RigidBody("block", {"c": np.zeros(3)}, 2.0, 1e-3 * np.eye(3))),
        (prismatic("guide", "ground.c", "block.c", "x"),),
        (PointForce("push", "block.c", "x", "force"),),
        (Encoder("e", "ground.c", "block.c", "x"),),
        (Softening("soft"), SpringDamper("stay", "ground.c", "block.c", "x", 500.0, 1.0)),
    )
    push = 500.0 * travel + 1e3 * (travel - travel**3 / (3 * 0.01**2))
    assert loaded_equilibrium(scene, inputs={"force": push}).motions["block.c"][0] == pytest.approx(travel, rel=1e-6)
    if travel > 0.01:
        with pytest.raises(
            ValueError, match=r"NonlinearSpring between ground\.c, block\.c pushes away from equilibrium"
        ):
            linearize(scene, constant_inputs={"force": push})
    else:
        found = linearize(scene, constant_inputs={"force": push})
        stiffness = 500.0 + 1e3 * (1 - (travel / 0.01) ** 2)
        assert frequency_response(found, [1e-6]).values[0, 0, 0] == pytest.approx(1 / stiffness, rel=1e-4)


def test_a_body_that_does_not_deform_bears_what_is_bolted_to_it(strip):
    """The forces that keep it in shape are none of the joint's."""
    tip, up, stiff = TURN @ [SLENDER, 0, 0], np.array([0.0, 0.0, 0.2]), np.full(6, 1e7)
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    block = RigidBody("block", {"a": -up}, 0.3, 1e-3 * np.eye(3), tip + up)
    scene = Scene(
        "bolted",
        (ground, FlexibleBody("strip", strip, rotation=TURN, fidelity="rigid"), block),
        joints=(fixed("bolt", "strip.right", "block.a"),),
        springs=(Bushing("foot", "ground.c", "strip.left", stiff),),
        sensors=(Encoder("e", "ground.c", "block.a", "z"),),
        gravity=(2.0, -3.0, -9.0),
    )
    found = loaded_equilibrium(scene)
    weight = 0.3 * scene.gravity
    expected = np.concatenate([weight, np.cross(up, weight)])
    np.testing.assert_allclose([*found.joint_forces["bolt"].values()], expected, rtol=1e-4, atol=1e-4)
    pressed = np.array([*found.spring_forces["foot"].values()])[:3]
    np.testing.assert_allclose(pressed, weight + strip.mass * scene.gravity, rtol=1e-4)


def test_forces_of_joints_and_springs_balance_the_loads(strip):
    """A strip welded to the ground bears a block that also hangs on a preloaded spring; anyhow in space."""
    skewed, along = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix(), np.array([2.0, -1.0, 2.0]) / 3
    tip, arm = TURN @ [SLENDER, 0, 0], np.array([0.1, 0.05, -0.2])
    ground = RigidBody("ground", {"c": np.zeros(3), "hook": tip + arm}, fixed=True)
    block = RigidBody("block", {"a": arm, "b": [-0.03, 0.2, 0.1]}, 0.3, 1e-3 * np.eye(3), tip - arm)
    bolt = Joint("bolt", "strip.right", "block.a", axes=skewed)
    spring = SpringDamper("spring", "ground.hook", "block.b", along, stiffness=4e3, preload=2.5)
    push = PointForce("push", "block.b", skewed[:, 1], "force")
    sensors = (Encoder("e", "ground.c", "block.b", along), ForceSensor("f", "spring"))
    scene = standing(strip, 0.3)
    scene = replace(
        scene,
        bodies=(ground, scene.bodies[1], block),
        joints=(Joint("foot", "ground.c", "strip.left", axes=TURN), bolt),
        actuators=(push,),
        springs=(spring,),
        sensors=sensors,
        gravity=np.array(GRAVITY) / 20,
    )
    found = loaded_equilibrium(scene, inputs={"force": 0.2})
    names = ("x", "y", "z", "rx", "ry", "rz")
    foot, bolted = (np.array([found.joint_forces[name][c] for c in names]) for name in ("foot", "bolt"))
    turned = (
        Rotation.from_rotvec(found.motions["strip.right"][3:]).as_matrix() @ skewed
    )  # the joint turns with the strip
    foot, bolted = (np.concatenate([a @ f[:3], a @ f[3:]]) for a, f in ((TURN, foot), (turned, bolted)))
    sprung = found.spring_forces["spring"]["value"] * along
    applied = 0.2 * skewed[:, 1] - sprung
    np.testing.assert_allclose(applied + 0.3 * scene.gravity, bolted[:3], rtol=1e-9)
    turn = Rotation.from_rotvec(found.motions["block.b"][3:]).as_matrix()
    moments = np.cross(turn @ block.points["b"], applied) - np.cross(turn @ block.points["a"], bolted[:3])
    np.testing.assert_allclose(moments, bolted[3:], rtol=1e-9)
    weight = strip.mass * scene.gravity
    np.testing.assert_allclose(bolted[:3] + weight, foot[:3], rtol=1e-9)
    moved = found.motions["strip.right"][:3]
    center = TURN @ strip.center_of_mass + 3 / 8 * moved  # of a cantilever that a force bends at its tip
    borne = bolted[3:] + np.cross(tip + moved, bolted[:3]) + np.cross(center, weight)
    np.testing.assert_allclose(borne, foot[3:], rtol=0, atol=0.1 * np.linalg.norm(weight) * np.linalg.norm(moved))
    rest = static_response(scene, {"force": 0.2})
    assert along @ found.motions["block.b"][:3] == pytest.approx(rest["e"], rel=1e-2)  # large deflections, by Exudyn
    assert found.spring_forces["spring"]["value"] == pytest.approx(rest["f"], rel=1e-2)


@pytest.mark.parametrize(("frame", "left"), [("", 1.0), ("rod.tip", 0.0)], ids=["dead", "follower"])
def test_forces_that_follow_a_point_are_told_from_dead_ones(frame, left):
    """On a rod with a torsion spring at its hinge: a dead force P takes P L from it, one along the rod nothing."""
    rod = RigidBody("rod", {"foot": 0.4 * TURN[:, 0], "tip": -0.4 * TURN[:, 0]}, 1.5, 0.02 * np.eye(3))
    ground = RigidBody("ground", {"o": 0.4 * TURN[:, 0]}, fixed=True)
    hinge = revolute("hinge", "ground.o", "rod.foot", TURN[:, 1])
    torsion = Bushing("torsion", "ground.o", "rod.foot", [0.0] * 3 + [50.0] * 3)
    push = PointForce("push", "rod.tip", TURN[:, 0], "force", frame)
    scene = Scene("rod", (ground, rod), (hinge,), (push,), springs=(torsion,))
    inertia = 0.02 + 1.5 * 0.4**2
    for force in (20.0, -20.0):
        expected = np.sqrt((50.0 - left * force * 0.8) / inertia) / (2 * np.pi)
        assert frequencies(scene, constant_inputs={"force": force}) == pytest.approx([expected], rel=1e-6)


def test_equilibria_far_away_are_refused_and_found_in_large_motion():
    """A rod on a torsion spring at its hinge sinks by k a = m g l cos(a), and swings about that by k + m g l sin(a)."""
    rod = RigidBody("rod", {"foot": 0.4 * TURN[:, 0]}, 1.5, 0.02 * np.eye(3))
    ground = RigidBody("ground", {"o": 0.4 * TURN[:, 0]}, fixed=True)
    hinge = revolute("hinge", "ground.o", "rod.foot", TURN[:, 1])
    torsion = Bushing("torsion", "ground.o", "rod.foot", [0.0] * 3 + [20.0] * 3)
    sensors = (AngleSensor("angle", "ground.o", "rod.foot", TURN[:, 1]),)
    scene = Scene("rod", (ground, rod), (hinge,), sensors=sensors, springs=(torsion,), gravity=50.0 * TURN[:, 2])
    with pytest.raises(ValueError, match=r"rotated by 1\.4 rad .* static_response finds it"):
        loaded_equilibrium(scene)
    angle, moment = static_response(scene)["angle"], 1.5 * 50.0 * 0.4
    assert 20.0 * angle == pytest.approx(moment * np.cos(angle), rel=1e-6)
    expected = np.sqrt((20.0 + moment * np.sin(angle)) / (0.02 + 1.5 * 0.4**2)) / (2 * np.pi)
    assert exudyn_eigenfrequencies(scene, loaded=True) == pytest.approx([expected], rel=1e-5)


def test_zieglers_column_flutters_beyond_its_follower_load():
    """H. Ziegler (1952): two links, masses 2 m and m at their ends, (7/2 - sqrt(2)) k / l; dead loads fall aside."""
    length, stiffness = 0.5, 10.0
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    ends = {"foot": (-length, 0, 0), "tip": (0, 0, 0)}
    links = [
        RigidBody(name, ends, mass, 1e-9 * np.eye(3), (k * length, 0, 0))
        for k, name, mass in ((1, "lower", 2.0), (2, "upper", 1.0))
    ]
    pairs = (("ground.o", "lower.foot"), ("lower.tip", "upper.foot"))
    joints = tuple(revolute(f"hinge_{k}", a, b, "z") for k, (a, b) in enumerate(pairs))
    springs = tuple(Bushing(f"k_{k}", a, b, [0.0] * 3 + [stiffness] * 3) for k, (a, b) in enumerate(pairs))
    push = PointForce("push", "upper.tip", "x", "force", "upper.tip")
    scene = Scene("column", (ground, *links), joints, (push,), springs=springs, damping_ratio=0.0)
    critical = (3.5 - np.sqrt(2)) * stiffness / length
    below, above = (
        linearize(scene, constant_inputs={"force": -share * critical}).poles().real.max() for share in (0.995, 1.005)
    )
    assert below < 1e-4
    assert above > 0.1


def test_what_cannot_load_a_scene_is_refused(strip):
    scene = standing(strip)
    with pytest.raises(ValueError, match="no load that could grow"):
        buckling_factors(scene)
    with pytest.raises(ValueError, match="no load that could grow"):
        buckling_factors(scene, inputs={"force": 0.0})
    hung = hanging(strip)
    spun = replace(hung, actuators=(Drive("motor", "hinge", speed=300.0),))
    thrown = replace(hung, bodies=(hung.bodies[0], replace(hung.bodies[1], angular_velocity=(0.0, 300.0, 0.0))))
    for turns in (spun, thrown):
        with pytest.raises(ValueError, match="buckling is one of a scene at rest"):
            buckling_factors(turns)
    turning = replace(scene.actuators[0], frame="strip.right")  # Beck's column, which flutters
    with pytest.raises(ValueError, match=r"a force that turns with a body.* unstable_poles"):
        buckling_factors(replace(scene, actuators=(turning,)), inputs={"force": -100.0})
    with pytest.raises(ValueError, match="unknown input 'push'"):
        linearize(scene, constant_inputs={"push": 1.0})
    with pytest.raises(ValueError, match="constant_inputs are loads"):
        linearize(scene, constant_inputs={"force": 1.0}, loaded=False)
    with pytest.raises(ValueError, match=r"under its loads, .*no small motion: start nearer"):
        linearize(replace(scene, gravity=3e3 * TURN[:, 2]))


@dataclass(frozen=True)
class Hardening(ForceElement):
    """A spring that hardens, between ground and ball."""

    def terms(self, scene):
        along = Displacement.between("ground.o", "ball.c", np.array([1.0, 0.0, 0.0]))
        return (NonlinearSpring(along, force=lambda v, _: 1e3 * v + 1e8 * v**3),)


def test_a_constant_force_moves_along_a_springs_law():
    """Its tangent is that of the equilibrium, where both the linear and the cubic part carry."""
    ball = RigidBody("ball", {"c": np.zeros(3)}, 2.0, 1e-3 * np.eye(3))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    slide, push = Joint("slide", "ground.o", "ball.c", free=("x",)), PointForce("push", "ball.c", "x", "force")
    scene = Scene("hardening", (ground, ball), (slide,), (push,), springs=(Hardening("spring"),))
    stretch = 2e-3
    found = frequencies(scene, constant_inputs={"force": 1e3 * stretch + 1e8 * stretch**3})
    assert found == pytest.approx([np.sqrt((1e3 + 3e8 * stretch**2) / 2.0) / (2 * np.pi)], rel=1e-5)
    driven = replace(scene, actuators=(Drive("motor", "slide", input="stroke"),))
    with pytest.raises(ValueError, match="a stroke is a load of linear scenes only"):
        static_motion(driven, inputs={"stroke": stretch})


def strung(tension, axis, **more):
    """A point mass of 2 kg between two springs along an axis, 0.3 m each, under tension as drawn."""
    ball = RigidBody("ball", {"c": np.zeros(3)}, 2.0, 1e-3 * np.eye(3))
    ground = RigidBody("ground", {"a": -0.3 * axis, "b": 0.3 * axis}, fixed=True)
    springs = tuple(SpringDamper(k, f"ground.{k}", "ball.c", "line", 5e3, preload=tension) for k in "ab")
    return Scene("strung", (ground, ball), springs=springs, damping_ratio=0.0, **more)


def test_a_string_under_tension_holds_its_mass_sideways():
    """By 2 T / L, in the linear model and in time, and falls aside where it is pressed."""
    sideways = np.sqrt(2 * 60.0 / (0.3 * 2.0)) / (2 * np.pi)
    axial = np.sqrt(2 * 5e3 / 2.0) / (2 * np.pi)
    scene = strung(60.0, TURN[:, 0])
    assert frequencies(scene)[3:] == pytest.approx([sideways, sideways, axial], rel=1e-6)
    assert frequencies(strung(-60.0, TURN[:, 0]))[:2] == pytest.approx([-sideways, -sideways], rel=1e-6)
    assert frequencies(scene, loaded=False)[:5] == pytest.approx(np.zeros(5), abs=1e-6)
    weighed = strung(
        60.0, TURN[:, 0], gravity=0.01 * TURN[:, 2], sensors=(Encoder("u", "ground.a", "ball.c", TURN[:, 2]),)
    )
    time = np.arange(200) * 2e-3
    rest = TimeHistory(time, np.zeros((0, 200)), (), ())
    found = simulate(weighed, rest, time_step=2e-3, start="released", progress=False).values[0]
    swing = 0.01 / (2 * np.pi * sideways) ** 2 * (1 - np.cos(2 * np.pi * sideways * time))
    np.testing.assert_allclose(found, swing, atol=2e-3 * swing.max())


def test_a_rope_of_unequal_turns_holds_its_mass():
    """T + k v on v = sum of f |x - p|: k r r^T + T sum of f (1 - u u^T) / |x - p|, with r the sum of f u."""

    class Rope(ForceElement):
        def terms(self, scene):
            lengths = [Distance(f"ground.p{k}", "mass.c") for k in range(3)]
            rope = Combination(((2.0, lengths[0]), (-0.7, Combination(((1.5, lengths[1]), (-2.0, lengths[2]))))))
            return (NonlinearSpring(rope, force=lambda v, _: 40.0 + 300.0 * v, tangent=lambda _v, _w: (300.0, 0.0)),)

    ends, turns = np.random.default_rng(5).normal(size=(3, 3)), np.array([2.0, -0.7 * 1.5, 0.7 * 2.0])
    lengths = np.linalg.norm(ends, axis=1)
    along = -ends / lengths[:, None]
    pull = turns @ along
    ground = RigidBody("ground", {"o": np.zeros(3)} | {f"p{k}": end for k, end in enumerate(ends)}, fixed=True)
    mass = RigidBody("mass", {"c": np.zeros(3)}, 1.7, np.eye(3))
    springs = (
        Rope("rope"),
        Bushing("hold", "ground.o", "mass.c", [500.0] * 3 + [0.0] * 3, preload=[*(-40.0 * pull), 0, 0, 0]),
    )
    scene = Scene(
        "rope", (ground, mass), (Joint("slide", "ground.o", "mass.c", free=("x", "y", "z")),), springs=springs
    )
    stiffness = 500.0 * np.eye(3) + 300.0 * np.outer(pull, pull)
    for turn, unit, length in zip(turns, along, lengths, strict=True):
        stiffness += 40.0 * turn * (np.eye(3) - np.outer(unit, unit)) / length
    expected = np.sqrt(np.linalg.eigvalsh(stiffness) / 1.7) / (2 * np.pi)
    assert frequencies(scene) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("kind", ["spring", "bushing"])
def test_a_preload_that_bears_a_weight_leaves_it_as_drawn(kind):
    """It pulls with -m g; relaxed springs sag by m g / k and then pull as much."""

    def resting(preload):
        mass = RigidBody("mass", {"c": np.zeros(3)}, 3.0, 1e-2 * np.eye(3))
        ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
        if kind == "spring":
            held = SpringDamper("k", "ground.o", "mass.c", "z", 2e3, preload=preload)
            joints = (Joint("slide", "ground.o", "mass.c", free=("z",)),)
        else:
            held = Bushing("k", "ground.o", "mass.c", [2e3] * 3 + [10.0] * 3, preload=[0, 0, preload, 0, 0, 0])
            joints = ()
        sensors = (Encoder("z", "ground.o", "mass.c", "z"), ForceSensor("f", "k"))
        return static_response(Scene("held", (ground, mass), joints, sensors=sensors, springs=(held,), gravity=GRAVITY))

    force = "f" if kind == "spring" else "f.fz"
    drawn, relaxed = resting(-3.0 * 9.81), resting(0.0)
    assert (drawn["z"], relaxed["z"]) == (pytest.approx(0.0, abs=1e-9), pytest.approx(-3.0 * 9.81 / 2e3, rel=1e-6))
    assert drawn[force] == pytest.approx(-3.0 * 9.81, rel=1e-6)
    assert relaxed[force] == pytest.approx(-3.0 * 9.81, rel=1e-6)


@pytest.mark.parametrize("kind", ["spring", "bushing"])
def test_a_preload_leaves_the_damper_as_it_is(kind):
    """A mass on a damped spring along an axis of the world: d / (2 sqrt(k m)) with and without preload."""
    mass = RigidBody("mass", {"c": np.zeros(3)}, 3.0, 1e-2 * np.eye(3))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    slide = Joint("slide", "ground.o", "mass.c", free=("z",))
    for preload in (0.0, 7.0):
        if kind == "spring":
            held = SpringDamper("k", "ground.o", "mass.c", "z", 2e3, 11.0, preload=preload)
        else:
            along = np.eye(6)[2]
            held = Bushing("k", "ground.o", "mass.c", 2e3 * along, 11.0 * along, preload=preload * along)
        model = linearize(Scene("held", (ground, mass), (slide,), springs=(held,), damping_ratio=0.0))
        assert damping(model)[1] == pytest.approx([11.0 / (2 * np.sqrt(2e3 * 3.0))])


def test_runs_start_where_preload_is_balanced():
    """A spring that pushes by 10 N as drawn has moved its mass by 10 N over its stiffness."""
    mass, ground = (
        RigidBody("mass", {"c": np.zeros(3)}, 3.0, np.eye(3)),
        RigidBody("ground", {"o": (0, 0, 0)}, fixed=True),
    )
    spring = SpringDamper("k", "ground.o", "mass.c", "z", 5e3, preload=-10.0)
    slide, sensor = Joint("slide", "ground.o", "mass.c", free=("z",)), Encoder("z", "ground.o", "mass.c", "z")
    scene = Scene("pushed", (ground, mass), (slide,), sensors=(sensor,), springs=(spring,))
    rest = TimeHistory(np.arange(20) * 2e-3, np.zeros((0, 20)), (), ())
    assert simulate(scene, rest, time_step=2e-3, progress=False)["z"] == pytest.approx(np.full(20, 2e-3), rel=1e-6)


def test_a_free_body_on_a_preloaded_spring_is_neutral_within_rounding():
    """Its spring is without force at rest, so nothing pushes its five other motions, whatever the direction."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k, along in enumerate(np.random.default_rng(0).normal(size=(8, 3))):
            ground = RigidBody("ground", {"o": (0.1, -0.2, 0.05)}, fixed=True)
            end = ground.points["o"] + 0.1 * along
            body = RigidBody("body", {"o": end}, 2.0, np.diag([0.01, 0.02, 0.03]), end - [0.02, 0.01, 0.03])
            spring = SpringDamper("k", "ground.o", "body.o", along, stiffness=10.0 ** (5 + k % 4), preload=5.0)
            linearize(Scene("free", (ground, body), springs=(spring,)))


def test_the_gravimeter_with_relaxed_springs(gravimeter):
    """It rests 13 cm lower, where its horizontal spring of 20 cm has another direction."""
    relaxed = tuple(replace(spring, preload=0.0) for spring in gravimeter.springs)
    with pytest.raises(ValueError, match=r"joints and springs change by up to 5\d %, which is no small motion"):
        linearize(replace(gravimeter, springs=relaxed))


@pytest.fixture(scope="module")
def wired():
    """A body with a port and any geometric stiffness, clamped at its left, with the port driven or open."""
    rng, plain = np.random.default_rng(7), craig_bampton(lattice(), n_modes=2, progress=False)
    n = len(plain.mass_matrix)
    forces = np.zeros(n)
    forces[6], forces[0], forces[12:] = 3.0, -3.0, [0.2, -0.1]
    matrices = rng.standard_normal((12 + 12 + 1, n, n))
    rows = np.eye(25, n) * (np.arange(25) < 12)[:, None]
    symmetric = matrices + matrices.transpose(0, 2, 1)
    stress = StressStiffness(rows, symmetric, 0 * matrices, ("v",), 0.3 * symmetric[:1])
    body = replace(plain, readouts=by_name([PortCoupling("v", forces, 1e-3), stress]))
    ground = RigidBody("ground", {"o": body.point("left").position}, fixed=True)
    return Scene("wired", (ground, FlexibleBody("bar", body)), (fixed("clamp", "ground.o", "bar.left"),))


class TwoInputs(VoltageDrive):
    """An amplifier that adds half of a second input, which acts on a combination."""

    def terms(self, scene):
        (first,) = super().terms(scene)
        return first, replace(first, input="more", measure=Combination(((0.3, first.measure), (0.2, first.measure))))


def test_constant_voltages_load_a_body(wired):
    drive = TwoInputs("drive", "bar.v", "volts", gain=2.0)
    assembly = assemble(replace(wired, actuators=(drive,)))
    body, voltage = wired.bodies[1].reduced, 2.0 * (3.0 + 0.5 * 4.0)
    found = loaded_state(assembly, inputs={"volts": 3.0, "more": 4.0}, checked=False).stress["bar"].stiffness[6:, 6:]
    static = np.zeros(len(body.mass_matrix))
    static[6:] = np.linalg.solve(body.stiffness_matrix[6:, 6:], voltage * body.port("v").forces[6:])
    expected = body.stress_stiffness.stiffness(static, voltages={"v": voltage})[6:, 6:]
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_pairs_of_forces_in_a_body_add_up(wired):
    """Two stacks between the same points press as one with the sum of their forces."""
    pairs = [StackActuator(name, "bar.left", "bar.right", 10.0, name) for name in "ab"]
    whole, parts = (
        loaded_state(assemble(replace(wired, actuators=pairs)), inputs=given, checked=False).stress["bar"].stiffness
        for given in ({"a": 5.0}, {"a": 2.0, "b": 3.0})
    )
    assert np.abs(whole).max() > 0
    np.testing.assert_allclose(parts, whole, atol=1e-9 * np.abs(whole).max())


def test_estimated_stress_is_told_beside_a_spin(strip):
    """A strip that hangs from a slow turntable, before a run in floating frames; the spin itself stresses it little."""
    scene = standing(replace(strip, readouts={}), -250.0)
    motor, table = Drive("motor", "foot", "rz", speed=1.0), revolute("foot", "ground.c", "strip.left", TURN[:, 0])
    with pytest.warns(UserWarning, match="stress in body 'strip' .* which is only estimated") as told:
        static_response(replace(scene, joints=(table,), actuators=(motor,)))
    assert len(told) == 1


def test_the_mode_that_a_pressed_strip_is_told_to_lose_is_its_lowest(strip):
    """Pressure lowers all modes of bending, the first one most: by its frequencies without and with the stress."""
    scene = standing(replace(strip, readouts={}))
    with pytest.warns(UserWarning, match="the stress in body 'strip'") as told:
        pressed = linearize(scene, constant_inputs={"force": -100.0})
    before, after = (np.sort(np.abs(model.poles()))[0] / (2 * np.pi) for model in (linearize(scene), pressed))
    frequency, change = re.search(r"the mode at ([\d.]+) Hz by some ([-+\d.e]+) %", str(told[0].message)).groups()
    assert float(frequency) == pytest.approx(before, rel=1e-3)
    assert float(change) == pytest.approx(50 * (after**2 / before**2 - 1), rel=0.06)


def test_a_reduced_scene_holds_the_stress_of_ports(wired):
    """Of one body: its own, along the axes of the scene."""
    body = wired.bodies[1].reduced
    scene = Scene("alone", (FlexibleBody("bar", body, [1.0, 2.0, 3.0], TURN),))
    whole = reduce_scene(scene, "whole", points={name: f"bar.{name}" for name in body.point_names})
    turned = scipy.linalg.block_diag(*4 * [TURN.T])
    expected = body.stress_stiffness.stiffness(np.zeros(len(body.mass_matrix)), voltages={"v": 3.0})[:12, :12]
    found = whole.stress_stiffness.stiffness(np.zeros(len(whole.mass_matrix)), voltages={"v": 3.0})[:12, :12]
    np.testing.assert_allclose(found, turned.T @ expected @ turned, atol=1e-9 * np.abs(expected).max())
    blocked, found = (one.stress_stiffness.of_voltages({"v": 3.0})[:12, :12] for one in (body, whole))
    np.testing.assert_allclose(found, turned.T @ blocked @ turned, atol=1e-9 * np.abs(blocked).max())
    bare = replace(body, readouts=by_name(body.ports))
    second = replace(scene.bodies[0], name="bare", reduced=bare)
    scene = replace(scene, bodies=(*scene.bodies, second), joints=(fixed("weld", "bar.left", "bare.left"),))
    assert reduce_scene(scene, "one bare", points={"left": "bar.left"}).stress_stiffness is None


@pytest.mark.filterwarnings("ignore:body 'strip' turns at")
def test_a_spin_without_loads_leaves_out_the_stress_inside(strip):
    """As of a body that does not hold its geometric stiffness; with it the same spin stiffens."""
    bare = replace(strip, readouts={n: r for n, r in strip.readouts.items() if not isinstance(r, StressStiffness)})
    spin = {"angular_velocity": 100.0 * TURN[:, 2], "loaded": False}
    found, expected = (np.sort(np.abs(linearize(standing(body), **spin).poles())) for body in (strip, bare))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    loaded = np.sort(np.abs(linearize(standing(strip), angular_velocity=spin["angular_velocity"]).poles()))
    assert loaded[0] > 1.05 * found[0]


def test_the_voltage_of_an_open_port_loads_its_body(wired):
    """By geometric stiffness, and by stress at a place."""
    random, sensor = np.random.default_rng(8), VoltageSensor("read", "bar.v", capacitance=2e-3)
    body = wired.bodies[1].reduced
    n = len(body.mass_matrix)
    rows, by_voltage = random.standard_normal((1, 6, n)), random.standard_normal((1, 6))
    place = StressField("place", np.zeros((1, 3)), rows, 0 * rows, {"v": by_voltage})
    body = replace(body, readouts={**body.readouts, "place": place})
    scene = replace(wired, bodies=(wired.bodies[0], replace(wired.bodies[1], reduced=body)), sensors=(sensor,))
    modelled, q = assemble(scene).scene.bodies[1].reduced, random.standard_normal(n)
    voltage = -body.port("v").forces @ q / 3e-3
    expected = body.stress_stiffness.stiffness(q, voltages={"v": voltage})
    found = modelled.stress_stiffness.stiffness(q)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(modelled.readouts["place"].stress(q), rows @ q + voltage * by_voltage, rtol=1e-9)


def test_a_port_with_a_resistance_has_no_voltage_at_rest(wired):
    sensor = VoltageSensor("read", "bar.v", resistance=1e5, capacitance=2e-3)
    scene = replace(wired, sensors=(sensor,), gravity=GRAVITY)
    body = wired.bodies[1]
    found = loaded_state(assemble(scene), gravity=GRAVITY, checked=False).stress["bar"].stiffness[6:, 6:]
    static = np.zeros(len(body.mass_matrix))
    static[6:] = np.linalg.solve(body.reduced.stiffness_matrix[6:, 6:], body.weight(np.array(GRAVITY))[6:])
    field = np.column_stack([GRAVITY, np.zeros((3, 3))])
    expected = body.reduced.stress_stiffness.stiffness(static, field)[6:, 6:]
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_stress_belongs_to_deformation_not_to_where_a_body_sags(wired):
    """A soft foot lets the body turn, but the body's own deformation under its weight is the same."""
    soft = replace(wired, joints=(), springs=(Bushing("foot", "ground.o", "bar.left", [1e3] * 3 + [1.0] * 3),))
    found = [
        loaded_state(assemble(scene), gravity=GRAVITY, checked=False).stress["bar"].stiffness
        for scene in (replace(wired, gravity=GRAVITY), replace(soft, gravity=GRAVITY))
    ]
    np.testing.assert_allclose(*found, atol=1e-6 * np.abs(found[0]).max())
