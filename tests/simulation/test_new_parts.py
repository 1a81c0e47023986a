"""New kinds of parts, written here alone, in every engine; readings of velocity and acceleration."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from conftest import lattice

from nassim import (
    Bushing,
    Controller,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageSensor,
    craig_bampton,
    describe,
    linearize,
    simulate,
    static_response,
)
from nassim.base.checks import finite
from nassim.bodies.piezo import PortCoupling
from nassim.scene.measures import Displacement
from nassim.scene.part import Actuator, ForceElement, Sensor
from nassim.scene.terms import AppliedForce, Output, Spring
from nassim.simulation.linear.closed_linearization import linearize_closed
from nassim.simulation.linear.mode_motion import mode_motion

LINE = np.array([0.48, -0.6, 0.64])
STEP = 2e-5


@dataclass(frozen=True)
class Gap(Sensor):
    """How far two plates are apart along an inclined line."""

    name: str
    a: str
    b: str
    line: tuple = tuple(LINE)
    derivative: int = 0
    unit: str = field(default="m", init=False)

    def terms(self, scene):
        """It reads the motion of b against a along the line."""
        return (
            Output(
                self.name, self.unit, Displacement.between(self.a, self.b, np.array(self.line)), 1.0, self.derivative
            ),
        )


@dataclass(frozen=True)
class VoiceCoil(Actuator):
    """A current that pushes two points apart along an inclined line, through an amplifier."""

    name: str
    a: str
    b: str
    force_per_ampere: float
    input: str
    line: tuple = tuple(LINE)
    bandwidth: float = np.inf

    def terms(self, scene):
        """It pushes b against a."""
        row = Displacement.between(self.a, self.b, np.array(self.line))
        return (AppliedForce(self.input, "A", row, finite("force_per_ampere", self.force_per_ampere), self.bandwidth),)

    def describe(self):
        """Its constant."""
        return f"voice coil {self.name}: {self.force_per_ampere:g} N/A"


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)


def turned(axis, angle):
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


TURN = turned(np.array([2.0, -1.0, 2.0]) / 3, 0.7)


def scene(body, fidelity, **changes):
    """Two blocks on either end of a flexible body that stands askew on the ground; one end is held by the ground."""
    flexible = FlexibleBody("body", body, (0.1, -0.2, 0.3), TURN, fidelity)
    at = [flexible.point_position(name) for name in ("left", "right")]
    ground = RigidBody("ground", {"foot": at[0], "wall": np.array([0.2, 0.1, 0.3])}, fixed=True)
    askew = turned(np.array([0.6, 0.0, 0.8]), 0.4)
    inertia = askew @ np.diag([1.0, 2.0, 2.5]) @ askew.T
    block = RigidBody("block", {"mount": np.zeros(3), "corner": [0.02, 0.01, -0.015]}, 0.2, 1e-4 * inertia, at[1])
    parts = {
        "joints": (Joint("foot", "ground.foot", "body.left"), Joint("head", "body.right", "block.mount")),
        "actuators": (VoiceCoil("coil", "ground.wall", "block.corner", 3.0, "current"),),
        "sensors": (
            Gap("gap", "ground.wall", "block.corner"),
            *(Encoder(axis, "ground.wall", "block.corner", axis) for axis in "xyz"),
        ),
    }
    return Scene("new", (ground, flexible, block), **{**parts, "damping_ratio": 0.02, **changes})


def three_forces(one):
    """The same scene with the voice coil taken apart into forces along the world's axes."""
    return replace(one, actuators=tuple(PointForce(axis, "block.corner", axis, f"force_{axis}") for axis in "xyz"))


def pulse(names, strengths, n_steps=400):
    time = STEP * np.arange(n_steps + 1) + 3.0
    shape = np.sin(np.pi * np.minimum((time - 3.0) / (100 * STEP), 1.0)) ** 2
    return TimeHistory(time, np.outer(strengths, shape), names, tuple("" for _ in names))


ENGINES = [
    ("linear", {"method": "exact"}, {}),
    ("linear", {"method": "generalized_alpha"}, {}),
    ("ffrf", {"method": "generalized_alpha"}, {}),
    ("rigid", {"method": "generalized_alpha"}, {"joints": ()}),
    ("linear", {"method": "exact"}, {"cutoff_frequency": 2000.0}),
    ("ffrf", {"method": "generalized_alpha"}, {"cutoff_frequency": 2000.0}),
]


@pytest.mark.parametrize(("fidelity", "options", "changes"), ENGINES)
def test_a_sensor_and_an_actuator_written_here_run_in_every_engine(body, fidelity, options, changes):
    new = scene(body, fidelity, **changes)
    run = simulate(new, pulse(("current",), [2.0]), time_step=STEP, progress=False, **options)
    excitation = pulse(("force_x", "force_y", "force_z"), 6.0 * LINE)
    old = simulate(three_forces(new), excitation, time_step=STEP, progress=False, **options)
    gap = run.values[run.names.index("gap")]
    assert np.abs(gap).max() > 1e-6
    axes = np.array([old.values[old.names.index(axis)] for axis in "xyz"])
    np.testing.assert_allclose(gap, LINE @ axes, rtol=0, atol=1e-9 * np.abs(gap).max())


def test_the_linear_model_and_statics_know_them(body):
    new = scene(body, "linear")
    model, old = linearize(new), linearize(three_forces(new))
    frequency = 2j * np.pi * 70.0
    answers = []
    for a, b, c, d in (model.matrices, old.matrices):
        answers.append(c @ np.linalg.solve(frequency * np.eye(len(a)) - a, b) + d)
    np.testing.assert_allclose(answers[0][0, 0], 3 * LINE @ answers[1][1:] @ LINE, rtol=1e-9)
    for fidelity in ("linear", "ffrf"):
        found = static_response(scene(body, fidelity), {"current": 0.1})
        parts = static_response(three_forces(scene(body, fidelity)), dict(zip(old.inputs, 0.3 * LINE, strict=True)))
        assert found["gap"] == pytest.approx(LINE @ [parts[axis] for axis in "xyz"], rel=1e-6)
    assert "voice coil coil: 3 N/A" in describe(new)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_they_close_a_loop(body, fidelity):
    """A proportional loop on the gap stiffens as the linear closed loop says."""
    gain = Controller([[0.0]], [[0.0]], [[0.0]], [[-2e3]], 1 / STEP, delay=1)
    looped = scene(body, fidelity, loops=(Loop("stiff", gain, ("gap",), ("current",)),))
    run = simulate(looped, pulse(("current",), [0.1], 600), time_step=STEP, progress=False)
    model = linearize_closed(looped)
    x, found = np.zeros(len(model.A)), []
    for value in run.values[0]:
        found.append(model.C[0] @ x + model.D[0, 0] * value)
        x = model.A @ x + model.B[:, 0] * value
    expected, gap = np.array(found), run.values[run.names.index("gap")]
    open_gap = simulate(replace(looped, loops=()), pulse(("current",), [0.1], 600), time_step=STEP, progress=False)
    assert np.abs(open_gap.values[1] - gap).max() > 0.1 * np.abs(gap).max()
    np.testing.assert_allclose(gap, expected, rtol=0, atol=0.02 * np.abs(gap).max())


RATES = (Gap("gap", "ground.wall", "block.corner"), Gap("speed", "ground.wall", "block.corner", derivative=1))
RATES += (Gap("shock", "ground.wall", "block.corner", derivative=2),)


@pytest.mark.parametrize(("fidelity", "options", "changes"), ENGINES)
def test_readings_of_velocity_and_acceleration(body, fidelity, options, changes):
    """Against numerical derivatives of the displacement of the same run."""
    moved = scene(body, fidelity, sensors=RATES, **changes)
    run = simulate(moved, pulse(("current",), [2.0]), time_step=STEP, progress=False, **options)
    gap, speed, shock = run.values[1:]
    for rate, of in ((speed, gap), (shock, speed)):
        middle = (of[2:] - of[:-2]) / (2 * STEP)
        np.testing.assert_allclose(rate[1:-1], middle, rtol=0, atol=0.01 * np.abs(rate).max())
    assert speed[0] == 0.0
    assert shock[0] == pytest.approx(0.0, abs=1e-9 * np.abs(shock).max())


def test_acceleration_follows_force_at_once(body):
    """D is force over mass along the line, where nothing else is in the way: a free block pushed at its centre."""
    ground = RigidBody("ground", {"wall": np.zeros(3)}, fixed=True)
    block = RigidBody("block", {"centre": np.zeros(3)}, 0.4, np.diag([1e-4, 2e-4, 2.5e-4]))
    coil = VoiceCoil("coil", "ground.wall", "block.centre", 3.0, "current")
    sensor = Gap("a", "ground.wall", "block.centre", derivative=2)
    free = Scene("free", (ground, block), actuators=(coil,), sensors=(sensor,))
    assert linearize(free).D[0, 0] == pytest.approx(3.0 / 0.4)
    ways = scene(body, "linear", sensors=RATES)
    d = linearize(ways).D[:, 0]
    assert d[0] == d[1] == 0.0
    low = linearize(ways)
    at = 2j * np.pi * 1e7
    response = (low.C @ np.linalg.solve(at * np.eye(len(low.A)) - low.A, low.B) + low.D)[2, 0]
    assert d[2] == pytest.approx(response.real, rel=1e-6)
    assert d[2] > 0
    jump = TimeHistory(STEP * np.arange(4), np.ones((1, 4)), ("current",), ("A",))
    exact = simulate(ways, jump, time_step=STEP, method="exact", progress=False)
    assert exact.values[3, 0] == pytest.approx(d[2], rel=1e-9)


def test_a_loop_cannot_measure_what_its_command_moves_at_once(body):
    loop = Loop("a", Controller([[0.0]], [[0.0]], [[0.0]], [[1e-3]], 1 / STEP), ("shock",), ("current",))
    beside = Loop("b", loop.controller, ("gap",), ("current",))
    for loops in ((loop, beside), (beside, loop)):
        direct = scene(body, "linear", sensors=RATES, loops=loops)
        with pytest.raises(ValueError, match="loop 'a' measures 'shock', which follows what the loop drives at once"):
            simulate(direct, pulse(("current",), [1.0]), time_step=STEP, progress=False)
    slow = replace(direct.actuators[0], bandwidth=1e3)
    simulate(replace(direct, actuators=(slow,)), pulse(("current",), [1.0]), time_step=STEP, progress=False)


@dataclass(frozen=True)
class Nonsense(Sensor):
    """A part whose terms nobody knows."""

    name: str = "nonsense"

    def terms(self, scene):
        """Gibberish."""
        return ("abracadabra",)


@dataclass(frozen=True)
class Mistyped(Nonsense):
    """A part whose author wrote a field's name wrong."""

    def terms(self, scene):
        """Ask for what it lacks."""
        return (self.nonsuch,)


def test_unknown_terms_are_refused(body):
    with pytest.raises(TypeError, match="str is no term that engines know"):
        scene(body, "linear", sensors=(Nonsense(),))
    with pytest.raises(AttributeError, match="'Mistyped' object has no attribute 'nonsuch'"):
        scene(body, "linear", sensors=(Mistyped(),))


def test_summaries_tell_of_everything_that_damps(body):
    """Spring-dampers, bushings, joints, resistors across ports and loops; springs alone do not."""
    plain = scene(body, "linear", actuators=(), sensors=())
    gap = (Encoder("gap", "ground.wall", "block.corner"),)
    pushed = (PointForce("push", "block.corner", "z", "push"),)
    idle = Loop("idle", Controller([[0.0]], [[0.0]], [[0.0]], [[0.0]], 1e3), ("gap",), ("push",))
    port = PortCoupling("stack", body.stiffness_matrix[6], 1e-6)
    ported = replace(plain.bodies[1], reduced=replace(body, readouts={"stack": port}))
    wired = replace(plain, bodies=(plain.bodies[0], ported, plain.bodies[2]))
    pad = Bushing("pad", "ground.wall", "block.corner", np.ones(6))
    damped = (
        replace(plain, springs=(SpringDamper("d", "ground.wall", "block.corner", "line", 0.0, 2.0),)),
        replace(plain, springs=(replace(pad, damping=np.diag([0.0, 0, 0, 0, 0, 1e-3])),)),
        replace(plain, sensors=gap, actuators=pushed, loops=(idle,)),
        replace(wired, sensors=(VoltageSensor("voltage", "body.stack", 1e4),)),
    )
    springs = (pad, SpringDamper("d", "ground.wall", "block.corner", "line", 2.0))
    still = plain, replace(plain, springs=springs), replace(wired, sensors=(VoltageSensor("voltage", "body.stack"),))
    for told, scenes in ((True, damped), (False, still)):
        assert [("plus dampers and loops" in describe(one)) for one in scenes] == [told] * len(scenes)


@dataclass(frozen=True)
class Sprung:
    """What a part of each kind below does beside its spring."""

    name: str
    a: str
    b: str
    springs: bool = True

    def terms(self, scene):
        """A spring with a damper, and what the kind does."""
        row = Displacement.between(self.a, self.b, LINE)
        return (Spring(row, 3e4, 2.0),) * self.springs + self.own(row)


class SprungForce(Sprung, Actuator):
    """An actuator in its guide."""

    def own(self, row):
        """A force."""
        return (AppliedForce("current", "A", row, 3.0),)


class SprungGap(Sprung, Sensor):
    """A probe that touches."""

    def own(self, row):
        """A reading."""
        return (Output(self.name, "m", row),)


class SprungOnly(Sprung, ForceElement):
    """A spring."""

    def own(self, row):
        """Nothing."""
        return ()


def run(one, method):
    return simulate(one, pulse(("current",), [2.0], 50), time_step=STEP, method=method, progress=False)["gap"]


VERBS = {
    "linearize": lambda one: np.concatenate([part.ravel() for part in linearize(one).matrices]),
    "mode_motion": lambda one: np.array([mode_motion(one, number)[0] for number in (1, 2, 3)]),
    "static_response": lambda one: np.array(list(static_response(one, {"current": 0.1}).values())),
    "exact": lambda one: run(one, "exact"),
    "generalized_alpha": lambda one: run(one, "generalized_alpha"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_part_may_be_a_spring_beside_what_its_kind_does(body, verb):
    """As two parts of which each is one of them, in every verb; without the springs it is another scene."""
    ends = "ground.wall", "block.corner"
    kinds = {"actuators": SprungForce("push", *ends), "sensors": SprungGap("gap", *ends)}
    whole = scene(body, "linear", **{kind: (part,) for kind, part in kinds.items()})
    bare = scene(body, "linear", **{kind: (replace(part, springs=False),) for kind, part in kinds.items()})
    apart = replace(bare, springs=tuple(SprungOnly(name, *ends) for name in kinds))
    found, expected, without = (VERBS[verb](one) for one in (whole, apart, bare))
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)
    assert np.abs(without - expected).max() > 1e-6 * size
