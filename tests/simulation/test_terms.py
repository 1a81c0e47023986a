"""Terms one by one: against dense algebra, closed forms and derivatives of records, in every engine."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice

from nassim import (
    Bushing,
    Controller,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.fem.fe_model import make_coupling
from nassim.scene.measures import BodyCoordinates, Combination, Displacement, PointVelocity
from nassim.scene.part import Actuator, ForceElement, Sensor
from nassim.scene.rotation_measures import RotationAngle
from nassim.scene.terms import AppliedForce, Output, Shunt, Spring

STEP = 2e-5
LINE = np.array([0.48, -0.6, 0.64])
TURN = scipy.linalg.expm(0.7 / 3 * np.array([[0.0, -2, -1], [2, 0, -2], [1, 2, 0]]))
GROUND = RigidBody("ground", {"foot": np.zeros(3), "wall": np.array([0.05, 0.1, -0.04])}, fixed=True)
ENGINES = [("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")]


@dataclass(frozen=True)
class Meter(Sensor):
    """A sensor of given terms."""

    given: tuple = ()

    def terms(self, scene):
        """Them."""
        return self.given


@dataclass(frozen=True)
class Strut(ForceElement):
    """A spring of given terms."""

    given: tuple = ()

    def terms(self, scene):
        """Them."""
        return self.given


@dataclass(frozen=True)
class Pusher(Actuator):
    """An actuator of given terms."""

    given: tuple = ()

    def terms(self, scene):
        """Them."""
        return self.given


@dataclass(frozen=True)
class InnerStrut(ForceElement):
    """A spring between two points inside a body."""

    def terms(self, scene):
        """Of the body as it is, trimmed or not."""
        return (Spring(BodyCoordinates.between(scene.split("body.left")[0], "left", "middle", np.eye(3)[0]), 3e5),)


def meter(name, row, gain=1.0, derivative=0):
    return Meter(name, (Output(name, "", row, gain, derivative),))


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)


GAP = Displacement.between("ground.wall", "block.corner", LINE)


HEAD = Joint("head", "body.right", "block.mount")


def held(body, fidelity, **parts):
    """A flexible body that stands askew on the ground and carries a block."""
    flexible = FlexibleBody("body", body, -TURN @ body.point("left").position, TURN, fidelity)
    at = flexible.point_position("right")
    inertia = 1e-4 * TURN @ np.diag([1.0, 2.0, 2.5]) @ TURN.T
    block = RigidBody("block", {"mount": np.zeros(3), "corner": [0.02, 0.01, -0.015]}, 0.2, inertia, at)
    joints = (Joint("foot", "ground.foot", "body.left"), HEAD)
    push = Pusher("push", (AppliedForce("u", "N", GAP),))
    options = {"joints": joints, "actuators": (push,), "sensors": (meter("gap", GAP),), "damping_ratio": 0.02}
    return Scene("terms", (GROUND, flexible, block), **{**options, **parts})


def pulse(scene, n_steps=400):
    time = STEP * np.arange(n_steps + 1)
    shape = np.sin(np.pi * np.minimum(time / (100 * STEP), 1.0)) ** 2
    return TimeHistory(time, np.tile(shape, (len(scene.inputs), 1)), scene.inputs, ("",) * len(scene.inputs))


def run(scene, method, excitation=None, **options):
    """Outputs and commands by name."""
    given = pulse(scene) if excitation is None else excitation
    record = simulate(scene, given, time_step=STEP, method=method, progress=False, **options)
    return dict(zip(record.names, record.values, strict=True))


def stretch(body):
    """Weights of a body's elongation on its own coordinates."""
    return body.motion("right")[0] - body.motion("left")[0]


def elongation(body, factor=1.0):
    return BodyCoordinates("body", factor * stretch(body), ("body.left", "body.right"))


def test_a_force_on_axes_of_a_body_in_small_motion_beside_a_floating_one(body):
    """At rest, a point's axes are the world's; and turns count by the size of their weights."""
    other = FlexibleBody("other", body, -body.point("left").position, fidelity="ffrf")
    found = []
    for frame, size in (("", 1.0), ("body.right", 2.5)):
        push = Pusher("push", (AppliedForce("u", "N", PointVelocity((("body.right", LINE),), frame)),))
        turn = meter("turn", RotationAngle("block.mount", size * np.array([0.6, 0.0, 0.8])))
        scene = held(body, "linear", actuators=(push,), sensors=(meter("gap", GAP), turn))
        joints = (*scene.joints, Joint("beside", "ground.foot", "other.left"))
        found.append(static_response(replace(scene, bodies=(*scene.bodies, other), joints=joints), {"u": 1e-4}))
    assert found[1]["gap"] == pytest.approx(found[0]["gap"], rel=1e-4)
    assert found[1]["turn"] == pytest.approx(2.5 * found[0]["turn"], rel=1e-4)
    assert abs(found[0]["gap"]) > 1e-12 < abs(found[0]["turn"])


def test_a_force_between_a_body_in_small_motion_and_a_free_one(body):
    """It moves the first as a force on that alone, the other by Newton's second law; a floating body stands by."""
    mass, end = 0.3, Displacement((("body.right", LINE),))
    free = RigidBody("free", {"centre": np.zeros(3)}, mass, 1e-4 * np.eye(3), [0.1, 0.2, 0.3])
    floating = FlexibleBody("floating", body, np.array([1.0, 0.0, 0.0]), fidelity="ffrf")
    found = []
    for measure in (Displacement.between("free.centre", "body.right", LINE), end):
        push = Pusher("push", (AppliedForce("u", "N", measure, 1e-4),))
        sensors = (meter("end", end), meter("way", Displacement((("free.centre", LINE),))))
        scene = held(body, "linear", actuators=(push,), sensors=sensors)
        found.append(
            run(replace(scene, bodies=(*scene.bodies, free, floating)), "generalized_alpha", pulse(scene, 200))
        )
    size = np.abs(found[1]["end"]).max()
    np.testing.assert_allclose(found[0]["end"], found[1]["end"], atol=1e-6 * size)
    assert size > 1e-12
    # The pulse is sin^2(pi t / T); its double integral to its end is T^2 / 4, and its integral is T / 2.
    duration = 100 * STEP
    way = -1e-4 / mass * LINE @ LINE * (duration**2 / 4 + duration / 2 * 100 * STEP)
    assert found[0]["way"][-1] == pytest.approx(way, rel=1e-3)


def test_a_spring_across_two_bodies_is_one_of_their_common_stiffness(body):
    """And a damper likewise: poles by dense algebra on all coordinates but those that are held."""
    rows = (2.0 * stretch(body), -0.5 * stretch(body))
    two = tuple(FlexibleBody(name, body, -body.point("left").position, fidelity="linear") for name in ("one", "two"))
    joints = tuple(Joint(name, "ground.foot", f"{name}.left") for name in ("one", "two"))
    row = Combination(tuple((1.0, BodyCoordinates(name, row)) for name, row in zip(("one", "two"), rows, strict=True)))
    r = np.concatenate([row[6:] for row in rows])  # the left point's six come first
    mass, stiffness = (scipy.linalg.block_diag(m, m) for m in (body.mass_matrix[6:, 6:], body.stiffness_matrix[6:, 6:]))
    for k, c in ((4e5, 0.0), (3e5, 200.0)):
        strut = Strut("strut", (Spring(row, k, c),))
        scene = Scene("two", (GROUND, *two), joints, springs=(strut,), sensors=(meter("x", row),), damping_ratio=0.0)
        right = np.linalg.solve(mass, np.hstack([stiffness + k * np.outer(r, r), c * np.outer(r, r)]))
        n = len(mass)
        expected = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-right]]))
        found = linearize(scene).poles()
        np.testing.assert_allclose(np.sort(found.imag), np.sort(expected.imag), rtol=1e-6, atol=1e-3)
        np.testing.assert_allclose(np.sort(found.real), np.sort(expected.real), rtol=1e-6, atol=1e-3)


def test_engines_agree_on_terms_about_the_inside_of_a_body(body):
    """Forces, dampers and readings of a body's deformation, beside amplifiers at points of rigid ones."""

    def scene(fidelity, damping=150.0):
        row = elongation(body)
        return held(
            body,
            fidelity,
            springs=(Strut("strut", (Spring(elongation(body), 2e5, damping),)),),
            actuators=(
                Pusher("inside", (AppliedForce("inside", "V", row, 2.5, 300.0),)),
                Pusher("outside", (AppliedForce("outside", "A", GAP, -3.0, 200.0),)),
            ),
            sensors=(meter("inner", elongation(body), -1.5), meter("gap", GAP, 4.0)),
        )

    runs = [run(scene(fidelity), method) for fidelity, method in ENGINES]
    undamped = run(scene("linear", damping=1e-3), "exact")
    assert np.abs(undamped["inner"] - runs[0]["inner"]).max() > 0.05 * np.abs(undamped["inner"]).max()
    for name in ("inner", "gap"):
        expected = runs[0][name]
        size = np.abs(expected).max()
        for other in runs[1:]:
            np.testing.assert_allclose(other[name], expected, rtol=0, atol=0.01 * size)
    swinging = replace(scene("rigid"), joints=(Joint("foot", "ground.foot", "body.left", free=("rx",)), HEAD))
    without, idle = (run(one, "generalized_alpha")["gap"] for one in (replace(swinging, springs=()), swinging))
    assert np.ptp(idle) > 1e-6
    np.testing.assert_array_equal(idle, without)


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
@pytest.mark.parametrize("inside", [True, False])
def test_outputs_have_their_gain_and_derivative(body, inside, fidelity, method):
    row = elongation(body) if inside else GAP
    sensors = (meter("x", row), *(meter(f"d{k}", row, -2.5, k) for k in range(3)))
    found = run(held(body, fidelity, sensors=sensors), method)
    np.testing.assert_allclose(found["d0"], -2.5 * found["x"], rtol=1e-9, atol=1e-12 * np.abs(found["x"]).max())
    for of, rate in (("d0", "d1"), ("d1", "d2")):
        middle = (found[of][2:] - found[of][:-2]) / (2 * STEP)
        np.testing.assert_allclose(found[rate][1:-1], middle, rtol=0, atol=0.02 * np.abs(middle).max())


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
def test_a_row_between_two_points_of_a_body_counts_both(body, fidelity, method):
    """Whichever of them is held: b against a along a line is a against b along the opposite one."""
    back = BodyCoordinates("body", body.motion("left")[0] * -1 + body.motion("right")[0])
    found = run(held(body, fidelity, sensors=(meter("there", elongation(body)), meter("back", back))), method)
    size = np.abs(found["there"]).max()
    assert size > 1e-8
    np.testing.assert_allclose(found["back"], found["there"], rtol=0, atol=1e-9 * size)


def test_frequency_responses_of_derivatives_are_powers_of_i_omega(body):
    """With dampers, an amplifier and the charge of a port that leaks, all of which accelerate."""
    c, own = 1e-6, elongation(body, 0.5)
    leaking = Meter("v", (Output("v", "V", own, -1 / c), Spring(own, 1 / c), Shunt("v", own, c, 2e3, 1.0)))
    meters = tuple(meter(f"d{k}", GAP, 2.0, k) for k in range(3))
    amplifier = Pusher("slow", (AppliedForce("slow", "N", GAP, 2.0, 80.0),))
    direct = Pusher("push", (AppliedForce("u", "N", GAP),))
    damper = Strut("damper", (Spring(GAP, 1e3, 5.0),))
    scene = held(body, "linear", sensors=(leaking, *meters), actuators=(direct, amplifier), springs=(damper,))
    frequency = np.geomspace(1.0, 3e3, 40)
    response = frequency_response(linearize(scene), frequency).values[1:]
    for k in (1, 2):
        expected = (2j * np.pi * frequency) ** k * response[0]
        np.testing.assert_allclose(response[k], expected, rtol=1e-6)


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
def test_a_leaking_sensor_has_its_gain(body, fidelity, method):
    own, c = elongation(body, 0.5), 1e-6
    runs = []
    for gain in (1.0, -3.0):
        terms = (Output("v", "V", own, -gain / c), Spring(own, 1 / c), Shunt("v", own, c, 1e3, gain))
        runs.append(run(held(body, fidelity, sensors=(Meter("v", terms),)), method)["v"])
    assert np.abs(runs[0]).max() > 1e-3
    np.testing.assert_allclose(runs[1], -3.0 * runs[0], rtol=0, atol=1e-6 * np.abs(runs[0]).max())


def test_dampers_act_along_their_axis(body):
    def scene(fidelity, damping):
        damper = SpringDamper("damper", "ground.wall", "block.corner", "x", 10.0, damping)
        return held(body, fidelity, springs=(damper,))

    runs = [run(scene(fidelity, 20.0), method)["gap"] for fidelity, method in ENGINES]
    size = np.abs(runs[0]).max()
    assert np.abs(run(scene("linear", 0.0), "exact")["gap"] - runs[0]).max() > 0.05 * size
    for other in runs[1:]:
        np.testing.assert_allclose(other, runs[0], rtol=0, atol=0.01 * size)


def test_points_of_flexible_bodies_move_along_the_worlds_axes(body):
    """In small motion a flexible body's end is read as the block that is fixed to it."""
    sensors = (meter("end", Displacement.between("ground.foot", "body.right", LINE)),)
    sensors += tuple(Encoder(axis, "ground.foot", "block.mount", axis) for axis in "xyz")
    found = run(held(body, "linear", sensors=sensors), "exact")
    expected = LINE @ [found[axis] for axis in "xyz"]
    np.testing.assert_allclose(found["end"], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_nothing_accelerates_in_equilibrium_under_gravity(body, method):
    scene = held(
        body, "linear", sensors=(meter("a", GAP, 1.0, 2), meter("b", elongation(body), 1.0, 2)), gravity=(1, -2, -9.81)
    )
    still = TimeHistory(STEP * np.arange(9), np.zeros((1, 9)), ("u",), ("N",))
    found = run(scene, method, still)
    assert np.abs(found["a"]).max() < 1e-4
    assert np.abs(found["b"]).max() < 1e-4


def test_a_released_body_accelerates_with_gravity_at_once(body):
    """A block that nothing holds, beside a body in small motion."""
    held_body = held(body, "linear", sensors=(meter("a", GAP, 1.0, 2),), gravity=(1, -2, -9.81))
    still = TimeHistory(STEP * np.arange(9), np.zeros((1, 9)), ("u",), ("N",))
    found = run(replace(held_body, joints=held_body.joints[:1]), "exact", still, start="released")
    np.testing.assert_allclose(found["a"], LINE @ [1, -2, -9.81], rtol=1e-9)


def test_a_record_of_acceleration_holds_what_the_loop_drives(body):
    """A free block is pushed by the excitation and by the loop's command of the sample before."""
    centre = Displacement.between("ground.wall", "block.mount", LINE)
    gain = Controller([[0.0]], [[0.0]], [[0.0]], [[-1e5]], 1 / STEP)
    free = held(
        body,
        "linear",
        actuators=(Pusher("push", (AppliedForce("u", "N", centre),)),),
        sensors=(meter("x", centre), meter("a", centre, 1.0, 2)),
        loops=(Loop("hold", gain, ("x",), ("u",)),),
    )
    free = replace(free, joints=free.joints[:1])
    found = run(free, "exact", hold_order=0)
    command = np.concatenate([[0.0], found["hold"][:-1]])
    assert np.abs(command).max() > 0.1
    np.testing.assert_allclose(found["a"], (found["u"] + command) / 0.2, rtol=0, atol=1e-9)


def test_trimming_keeps_what_a_spring_between_inner_points_needs():
    """Its point is no coordinate any more and no other part uses it, but the static answer stays."""
    plain = lattice(n=5, stiffness=1e5)
    layer = np.flatnonzero(np.abs(plain.fields[1] - 0.02) < 1e-9)
    point = RemotePoint("middle", "middle", [0.02, 0.01, 0.01])
    middle = make_coupling(point, layer, plain.fields[:, layer], plain.fields[:, layer])
    body = craig_bampton(replace(plain, couplings=(*plain.couplings, middle)), n_modes=3, progress=False)
    strut = InnerStrut("strut")
    full, soft = held(body, "linear", springs=(strut,)), held(body, "linear")
    found = [static_response(s, {"u": 1.0})["gap"] for s in (full, replace(full, cutoff_frequency=5.0), soft)]
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert abs(found[2] / found[0] - 1) > 1e-4


def test_inclined_springs_in_every_engine(body):
    strut = Strut("strut", (Spring(GAP, 1e3, 2.0),))
    found, expected, without = (
        run(held(body, fidelity, springs=springs), method)
        for fidelity, method, springs in (
            ("ffrf", "generalized_alpha", (strut,)),
            ("linear", "exact", (strut,)),
            ("linear", "exact", ()),
        )
    )
    for name in found:
        size = np.abs(expected[name]).max()
        assert np.abs(found[name] - expected[name]).max() < 1e-3 * size
    assert any(np.abs(without[name] - expected[name]).max() > 0.01 * np.abs(expected[name]).max() for name in found)


def test_the_ground_shakes_linear_bodies_beside_floating_ones(body):
    """Both stretch as where all is linear."""

    def two(fidelity):
        place = -body.point("left").position
        bodies = (
            FlexibleBody("one", body, place, np.eye(3), "linear"),
            FlexibleBody("two", body, place, TURN, fidelity),
        )
        bodies = (bodies[0], replace(bodies[1], position=TURN @ place))
        joints = tuple(Joint(name, "ground.foot", f"{name}.left") for name in ("one", "two"))
        rows = [BodyCoordinates.between(one, "left", "right", np.eye(3)[0]) for one in bodies]
        sensors = tuple(meter(n, row) for n, row in zip(("one", "two"), rows, strict=True))
        return Scene("two", (GROUND, *bodies), joints, (GroundAcceleration("shaker", "x", "a"),), sensors)

    found, expected = run(two("ffrf"), "generalized_alpha"), run(two("linear"), "exact")
    for name in ("one", "two"):
        size = np.abs(expected[name]).max()
        assert size > 1e-8
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=0.01 * size)


@pytest.mark.parametrize("point", ["body.left", "body.right"])
def test_points_of_a_spinning_flexible_body_accelerate_as_they_move(body, point):
    """One of them carries its frame; against differences of displacement and velocity."""
    spinning = FlexibleBody("body", body, (0.1, 0.0, -0.2), TURN, "ffrf", angular_velocity=(15.0, -10.0, 20.0))
    sensors = tuple(meter(f"d{k}", Displacement(((point, LINE),)), 1.0, k) for k in range(3))
    scene = Scene("free", (spinning,), (), (PointForce("push", "body.right", "x", "u"),), sensors, damping_ratio=0.02)
    found = run(scene, "generalized_alpha", spectral_radius=0.8)
    for of, rate in (("d0", "d1"), ("d1", "d2")):
        middle = (found[of][2:] - found[of][:-2]) / (2 * STEP)
        np.testing.assert_allclose(found[rate][1:-1], middle, rtol=0, atol=2e-3 * np.abs(middle).max())
    assert np.ptp(found["d2"]) > 5.0


def test_a_bushing_between_free_bodies_by_dense_algebra():
    """In small motion: at points apart, whose axes turn with bodies; a force and readings along turning axes beside."""
    random = np.random.default_rng(6)
    names, masses, centres = "ab", (0.7, 1.3), np.array([[0.1, 0.02, -0.03], [-0.05, 0.2, 0.1]])
    places, tips = random.uniform(-0.3, 0.3, (2, 3)), random.uniform(-0.3, 0.3, (2, 3))
    inertias = [TURN @ np.diag(moments) @ TURN.T for moments in ([2e-3, 3e-3, 4e-3], [9e-3, 5e-3, 7e-3])]
    root = random.standard_normal((6, 6)) * ([100.0] * 3 + [10.0] * 3)
    stiffness, other = root.T @ root, random.standard_normal((6, 6))
    damping = 0.02 * other.T @ other
    bodies = tuple(
        RigidBody(name, {"o": place - centre, "tip": tip - centre}, mass, inertia, centre)
        for name, place, tip, mass, inertia, centre in zip(names, places, tips, masses, inertias, centres, strict=True)
    )
    seen = Displacement.between("a.tip", "b.tip", LINE, axes_of="a.tip")
    scene = Scene(
        "free",
        bodies,
        actuators=(PointForce("push", "b.tip", LINE, "push", frame="b.tip"),),
        sensors=(
            meter("seen", seen),
            meter("rate", PointVelocity((("a.tip", -LINE), ("b.tip", LINE)), "a.tip"), 1.0, 1),
        ),
        springs=(Bushing("bushing", "a.o", "b.o", stiffness, damping, TURN),),
        damping_ratio=0.0,
    )

    def motions(at):
        """Of both bodies at a place, by their centres' motions, each (6, 6)."""
        arms = [at - centre for centre in centres]
        return [np.block([[np.eye(3), -np.cross(np.eye(3), a)], [np.zeros((3, 3)), np.eye(3)]]) for a in arms]

    first, second = motions(places[1])
    gap = np.kron(np.eye(2), TURN.T) @ np.hstack([-first, second])
    mass = scipy.linalg.block_diag(masses[0] * np.eye(3), inertias[0], masses[1] * np.eye(3), inertias[1])
    push = np.concatenate([np.zeros(6), LINE @ motions(tips[1])[1][:3]])
    against_a = np.concatenate([-LINE @ motions(tips[1])[0][:3], push[6:]])
    against_space = np.concatenate([-LINE @ motions(tips[0])[0][:3], push[6:]])
    frequency = np.geomspace(1.0, 300.0, 15)
    found = frequency_response(linearize(scene), frequency)
    for k, s in enumerate(2j * np.pi * frequency):
        answer = np.linalg.solve(s**2 * mass + gap.T @ (stiffness + s * damping) @ gap, push)
        assert found.response("seen", "push")[k] == pytest.approx(against_a @ answer, rel=1e-6)
        assert found.response("rate", "push")[k] == pytest.approx(s * against_space @ answer, rel=1e-6)


def test_commands_are_named_by_what_they_drive(body):
    both = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((2, 0)), [[-1e3], [500.0]], 1 / STEP)
    actuators = (Pusher("push", (AppliedForce("u", "N", GAP),)), Pusher("pull", (AppliedForce("v", "N", GAP),)))
    scene = held(body, "linear", actuators=actuators, loops=(Loop("hold", both, ("gap",), ("u", "v")),))
    found = run(scene, "exact")
    np.testing.assert_allclose(found["hold.v"], -0.5 * found["hold.u"], rtol=1e-12)
    assert scene.commands == ("hold.u", "hold.v")
