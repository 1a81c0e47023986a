"""Every limit that tells rounding from physics, from both sides: at 0.9 of it there is nothing, at 1.1 there is."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import assert_limit
from scipy.spatial.transform import Rotation
from test_large_motion import INERTIA, ground

from nassim import (
    Bushing,
    Drive,
    Encoder,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    frequency_response,
    linearize,
    revolute,
    simulate,
)
from nassim.scene.joints import prismatic
from nassim.scene.measures import Combination
from nassim.scene.part import ForceElement
from nassim.scene.rotation_measures import RelativePose, RotationAngle
from nassim.scene.terms import Constraint, NonlinearSpring, Spring, Term
from nassim.simulation import Simulation, spinning_equilibrium
from nassim.simulation.exudyn.items import offset_of
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.rounding import rounding_of_springs
from nassim.simulation.exudyn.small_motion_system import _Modes
from nassim.simulation.exudyn.steady_state import _growing, _Motion
from nassim.simulation.linear.exact_steps import exact_response
from nassim.simulation.loaded.rotor_stator import resists, rotation_about
from nassim.simulation.loaded.scene_body import _condensed
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.damping import Damping
from nassim.simulation.model.initial_velocities import initial_twists
from nassim.simulation.model.modal_model import _unsupported_modes
from nassim.simulation.model.prescribed_motion import cleared, product

SIDES = np.array([0.9, 1.1])
ODD = Rotation.from_rotvec([0.5, -0.7, 0.4]).as_matrix()


def block(*joints, spin=(0.0, 0, 0), **parts):
    body = RigidBody("block", {"c": (0, 0, 0)}, 2.0, INERTIA, angular_velocity=spin)
    return Scene("block", (ground(), body), joints, **parts)


def test_growth_about_a_steady_rotation_is_rounding_below_a_thousandth_of_its_speed():
    """Or below 1e-5 of the pole itself, and 10 roots of the last digit of the fastest pole."""
    for speed, pole in ((20.0, 1e-3 * 20.0), (1e-3, 1e-5 + 1j), (1e-9, 10 * np.sqrt(np.finfo(float).eps))):
        poles = [np.array([side * pole.real + 1j * pole.imag, -1.0]) for side in SIDES]
        assert [len(_growing(found, speed)) for found in poles] == [0, 1]


def shifted(stiffness, push, highest=0.0):
    """Newton's step of a motion beside a stiff one, at a spin of 1 rad/s and an energy of one."""
    matrix = np.diag([stiffness, highest])
    motion = _Motion(np.eye(2), np.zeros(2), 0.0, np.array([push, 0.0]), matrix, np.diag(matrix))
    return motion.step(1.0, 1.0)[0][0]


def test_a_motion_about_a_steady_rotation_is_held_from_a_millionth_of_the_spins_stiffness_on():
    """Against a push above a millionth of the largest; beside 1e12, a stiffness of 1e3 counts as one of the spin."""
    assert shifted(1.1e-6, 1e-3) == pytest.approx(1e-3 / 1.1e-6)
    assert shifted(0.9e-6, 0.9e-6) == 0.0
    for stiffness, push in ((0.9e-6, 1e-3), (0.0, 1.1e-6)):
        with pytest.raises(RuntimeError, match="drive a motion that nothing holds"):
            shifted(stiffness, push)
    assert [shifted(side * 1e-3, 1e-6, 1e12) > 0 for side in SIDES] == [False, True]


def test_points_coincide_up_to_a_billionth_of_a_millimetre():
    scene = block()
    for side, expected in zip(SIDES, (False, True), strict=True):
        assert any(offset_of(scene, "block.c", np.array([0, -side * 1e-12, 0]))) == expected


def test_points_move_independently_from_a_billionth_on():
    """Two rows at a small angle have the singular value sin(angle / 2) sqrt(2)."""

    def condensed(share):
        angle = 2 * np.arcsin(1e-9 / share / np.sqrt(2))
        return _condensed(np.ones(3), np.array([[1.0, 0, 0], [np.cos(angle), np.sin(angle), 0]]), "points")

    assert_limit(condensed, "do not move independently")


def test_a_tangent_pushes_away_from_a_hundred_billionth_of_the_largest_on():
    class Law(ForceElement):
        least = 0.0

        def terms(self, scene):
            stiffness = np.diag([100.0, 100.0, 100.0, 100.0, 100.0, self.least])
            pose = RelativePose("ground.o", "block.c")
            return (
                NonlinearSpring(pose, force=lambda v, _: stiffness @ v, tangent=lambda *_: (stiffness, 0 * stiffness)),
            )

    def model(share):
        law = Law("law")
        law.least = -1e-9 * share
        return linearize(block(springs=(law,)), loaded=False)

    assert_limit(model, "pushes away from equilibrium")


@dataclass(frozen=True)
class Given(ForceElement):
    """A spring of given terms."""

    law: Term

    def terms(self, scene):
        return (self.law,)


def test_springs_of_any_law_round():
    """By their stiffness where they are relaxed."""
    pose = RelativePose("ground.o", "block.c")
    cubic = NonlinearSpring(pose, force=lambda v, _: 3e5 * v + v**3)
    found = [rounding_of_springs(block(springs=(Given("law", law),))) for law in (Spring(pose, 3e5), cubic)]
    assert found[1] == pytest.approx(found[0], rel=1e-5)
    assert found[0] > 0
    angle, geared = (RotationAngle("block.c", size * np.array([0.6, 0.0, 0.8]), "ground.o") for size in (1.0, -20.0))
    levered = (Combination(((-20.0, angle),)), geared)
    found = [rounding_of_springs(block(springs=(Given("law", Spring(one, 3e5)),))) for one in levered]
    assert found[0] == pytest.approx(found[1], rel=1e-9, abs=0.0)
    assert found[0] > 0


@pytest.mark.parametrize("side", SIDES)
def test_dampers_leave_a_rigid_motion_alone_up_to_a_billionth(side):
    """Between two masses: rounding d of one entry is d / 2 of their common motion, whose terms add up to 2."""
    shapes = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    dampers = np.array([[1 + side * 4e-9, -1.0], [-1.0, 1.0]])
    nothing = np.zeros((0, 2)), np.zeros((0, 0)), np.zeros((0, 0))
    damping = Damping(np.array([0.0, 1.0]), shapes, np.zeros(2), *nothing, dampers).of_modes
    assert (damping[0, 0] == 0.0, damping[0, 1] == 0.0) == 2 * (side < 1,)
    assert damping[1, 1] == pytest.approx(2.0)


@pytest.mark.parametrize("units", [(1e-13, 1, 1), (1e13, 1, 1), (1, 1e-4, 1), (1, 1e4, 1), (1, 1, 1e-6), (1, 1, 1e6)])
def test_limits_know_no_unit_of_mass_length_or_time(units):
    """A carriage on a drive with a payload on an askew bushing: responses of motion to motion."""

    def response(mass, length, time):
        inertia = mass * length**2 * 1e-3 * ODD @ np.diag([1.0, 2.0, 2.5]) @ ODD.T
        place = length * np.array([0.03, -0.02, 0.05])
        ends = {"c": np.zeros(3), "tip": length * np.array([0.1, 0.02, -0.04])}
        cart = RigidBody("cart", {"o": np.zeros(3), "p": place}, 0.3 * mass, inertia)
        load = RigidBody("load", ends, 0.7 * mass, inertia, place)
        sizes = mass * np.repeat([1.0, length**2], 3)
        stiffness, damping = (
            [4e3, 3e3, 5e3, 9.0, 15.0, 12.0] * sizes / time**2,
            np.repeat([2.0, 0.01], 3) * sizes / time,
        )
        scene = Scene(
            "stage",
            (ground(), cart, load),
            (prismatic("slide", "ground.o", "cart.o", (1, 2, 3)),),
            (Drive("drive", "slide", input="path"),),
            (Encoder("tip", "ground.o", "load.tip", (1.0, 0.3, 0.2)),),
            (Bushing("soft", "cart.p", "load.c", stiffness, damping),),
            damping_ratio=0.01,
        )
        return frequency_response(linearize(scene), np.geomspace(0.3, 300.0, 30) / time).values

    expected = response(1.0, 1.0, 1.0)
    assert np.ptp(np.abs(expected)) > 1
    np.testing.assert_allclose(response(*units), expected, rtol=1e-9)


def test_spins_are_followed_to_a_billionth():
    """About an axis beside that of the only hinge."""
    hinge = revolute("hinge", "ground.o", "block.c", "z")
    assert_limit(lambda x: initial_twists(block(hinge, spin=(5e-9 * x, 0, 5.0))), "cannot start to turn")


def test_redundant_constraints_stay_redundant_to_a_ten_thousandth_of_the_squared_motion():
    """A third crank, longer than two parallel ones by a share d: at an angle a it is d a^2 / 2 of its length off."""
    length, apart = 0.1, 0.15

    def start(share):
        longer = 1 + 2e-4 * share * 2 * apart / length
        lengths, bodies, joints, places, ends = (length, length, length * longer), [], [], {}, {}
        for k, own in enumerate(lengths):
            top = np.array([k * apart, length, 0.0])
            places[f"p{k}"], ends[f"p{k}"] = top - [0, own, 0], top - [apart, length, 0]
            arm = np.array([0, own / 2, 0])
            bodies.append(RigidBody(f"crank{k}", {"low": -arm, "high": arm}, 0.1, 1e-3 * np.eye(3), top - arm))
            joints.append(revolute(f"low{k}", f"ground.p{k}", f"crank{k}.low"))
            joints.append(revolute(f"high{k}", f"crank{k}.high", f"rod.p{k}"))
        rod = RigidBody("rod", ends, 0.2, 1e-3 * np.eye(3), np.array([apart, length, 0]), angular_velocity=(0, 0, 0))
        scene = Scene("cranks", (ground(**places), *bodies, rod), tuple(joints))
        return simulate(scene, rest(2), time_step=1e-3, progress=False)

    assert_limit(start, "at the start other joints imply")


def rest(n_steps):
    return TimeHistory(1e-3 * np.arange(n_steps + 1), np.zeros((0, n_steps + 1)), (), ())


@pytest.mark.parametrize("side", SIDES)
def test_a_mode_is_unsupported_from_half_of_its_energy_on(side):
    """In a body beyond the frequency that its reduction holds."""
    scene = SimpleNamespace(quasi_static_above=None)
    strain = SimpleNamespace(root=np.array([[2 * np.pi * 30.0 * np.sqrt(0.5 * side)]]))
    for valid, beyond in ((29.0, True), (31.0, False)):
        found = _unsupported_modes(scene, {"bar": valid}, {"bar": strain}, np.array([30.0]), np.eye(1))
        assert found.tolist() == [beyond and side > 1]


def test_sums_and_parts_of_modes_are_rounding_up_to_their_limits():
    """A billionth of the sum of absolute terms; 1e-12 of the size of a row."""
    ones = np.ones((2, 1))
    assert [product(np.array([[1.0, -1.0 + 2e-9 * side]]), ones)[0, 0] != 0 for side in SIDES] == [False, True]
    assert [cleared(np.array([3e-12 * side]), np.array([3.0]))[0] != 0 for side in SIDES] == [False, True]


def test_weight_does_work_on_a_free_motion_from_a_billionth_of_it_on():
    """Of a block on a guide that is nearly level, by exact steps."""

    def start(share):
        scene = block(prismatic("guide", "ground.o", "block.c", "x"), gravity=(1e-9 * share, 0, -1.0))
        return simulate(scene, rest(2), time_step=1e-3, method="exact", progress=False)

    start(0.9)
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        start(1.1)


def test_a_spin_is_critical_within_a_billionth():
    """A block beside the axis on a radial spring: 1 - m W^2 / k."""
    body = RigidBody("block", {"c": (0, 0, 0)}, 2.0, 1e-12 * np.eye(3), (1e-3, 0, 0))
    guide = prismatic("guide", "ground.o", "block.c", "x")
    spring = SpringDamper("spring", "ground.o", "block.c", "x", 8e4, frame="ground.o")
    scene = Scene(
        "block", (ground(o=(1e-3, 0, 0)), body), (guide,), sensors=(Encoder("x", "ground.o", "block.c", "x"),)
    )
    scene = Scene(scene.name, scene.bodies, scene.joints, (), scene.sensors, (spring,))

    def stretch(share):
        return spinning_equilibrium(scene, angular_velocity=(0, 0, 200.0 * np.sqrt(1 - 1e-9 / share)))["x"]

    assert stretch(0.9) == pytest.approx(1e-3 * 0.9e9, rel=1e-5)
    assert_limit(stretch, "no spinning equilibrium")


@pytest.mark.parametrize("arm", [1e-3, 5.0])
def test_a_spin_drives_a_free_motion_from_a_billionth_of_the_largest_force_on(arm):
    """A block of m at r on a guide that is nearly along the axis: its share of m r W^2 is the guide's slope."""
    body = RigidBody("block", {"c": (0, 0, 0)}, 2.0, 1e-18 * np.eye(3), (arm, 0, 0))

    def rest(share):
        guide = prismatic("guide", "ground.o", "block.c", (1e-9 * share, 0, 1.0))
        scene = Scene("block", (ground(o=(arm, 0, 0)), body), (guide,))
        return linearize(scene, angular_velocity=(0, 0, 30.0))

    assert_limit(rest, "no spinning equilibrium")


@pytest.mark.parametrize("side", SIDES)
def test_a_tie_resists_a_rotation_from_a_billionth_of_a_millimetres_turn_on(side):
    """A hinge whose axis is nearly that of the spin."""
    tilt = side * 1e-12
    hinge = revolute("hinge", "ground.o", "block.c", (tilt, 0, 1.0))
    assembly = assemble(block(hinge))
    (joint,) = (term for term in assembly.terms if isinstance(term, Constraint))
    rotation = rotation_about(assembly.coordinates, ["block"], np.eye(3)[2], np.zeros(3))
    assert resists(assembly, joint, rotation) == (side > 1)


def test_runs_are_looked_at_some_two_hundred_times(monkeypatch):
    """Whatever the engine; a short run every 25 steps, one that is stepped by its user every 50, and all at the end."""
    looks = []
    seen = Monitor.look
    monkeypatch.setattr(Monitor, "look", lambda self, sample: looks.append(sample) or seen(self, sample))
    scene = block(prismatic("guide", "ground.o", "block.c", "x"))
    simulate(scene, rest(6000), time_step=1e-3, progress=False)
    assert len(looks) == pytest.approx(200, abs=10)
    looks.clear()
    simulate(scene, rest(60), time_step=1e-3, progress=False)
    assert looks == [24, 49, 60]
    looks.clear()
    with Simulation(scene, time_step=1e-3) as run:
        for _ in range(110):
            run.step()
    assert looks == [50, 100, 110]
    *_, coordinates, _ = exact_response(assemble(scene), np.zeros((0, 1001)), 1e-3)
    assert 120 < coordinates.shape[1] < 220  # at the first samples of blocks


def test_equal_modes_that_a_load_couples_stay_coupled():
    """A circulatory load on two undamped modes of one frequency: they flutter at the least load."""
    load = np.array([[0.0, 1e-6], [-1e-6, 0.0]])
    modal = SimpleNamespace(omega=np.array([60.0, 60.0]), damping=SimpleNamespace(of_modes=np.zeros((2, 2))))
    found = _Modes.of(SimpleNamespace(modal=modal, loads=SimpleNamespace(stiffness=load)))
    np.testing.assert_allclose(np.abs(found.stiffness - np.diag(np.diag(found.stiffness))), np.abs(load))
