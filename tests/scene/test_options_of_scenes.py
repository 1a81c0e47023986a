"""Optional arguments of scenes' verbs that no other test would miss."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import lattice

from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    VoltageDrive,
    craig_bampton,
    fixed,
    frequency_response,
    joined,
    linearize,
    placed,
)
from nassim.bodies.piezo import PortCoupling
from nassim.scene import Displacement, Output, OutputFilter, Sensor
from nassim.simulation import linearize_closed, mode_motion, trim_scene, truncation_error
from nassim.systems import damping, proportional

MASS, STIFFNESS, GAIN = 2.0, 3e4, 5e4


def block():
    """A mass on a spring along an odd direction, pushed and read along it; weak springs across."""
    axis = (0.6, 0.0, 0.8)
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    body = RigidBody("block", {"p": np.zeros(3)}, MASS, np.eye(3))
    return Scene(
        "block",
        (ground, body),
        actuators=(PointForce("push", "block.p", axis, "push"),),
        sensors=(Encoder("way", "ground.p", "block.p", axis),),
        springs=(SpringDamper("k", "ground.p", "block.p", axis, STIFFNESS),),
        damping_ratio=0.0,
    )


def test_loops_of_a_joined_scene_run():
    """Two masses, each held by a loop that reads the other, which couples them.

    K = [[k, g], [g, k]] has the eigenvalues k + g and k - g.
    """
    gain, rate = 0.4 * STIFFNESS, 1e5
    loops = tuple(
        Loop(f"{y} to {u}", proportional(-gain, sample_rate=rate, delay=0), f"{y}/way", f"{u}/push")
        for y, u in ("ab", "ba")
    )
    both = joined("both", placed(block(), "a"), placed(block(), "b", position=(1, 0, 0)), loops=loops)
    poles = linearize_closed(both, continuous=True).poles()
    for k in (STIFFNESS + gain, STIFFNESS - gain):
        nearest = poles[np.argmin(np.abs(poles - 1j * np.sqrt(k / MASS)))]
        assert nearest.imag == pytest.approx(np.sqrt(k / MASS), rel=1e-4)


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=2, progress=False)


END = Encoder("x", "ground.b", "b.right", (0.6, 0.0, 0.8))


def clamped(bar, ratios, **options):
    """Two equal bars, each clamped at its left end, with damping ratios of their own."""
    places = {"a": np.zeros(3), "b": np.array([0.0, 0.5, 0.0])}
    left = bar.point("left").position
    ground = RigidBody("ground", {name: place + left for name, place in places.items()}, fixed=True)
    bodies = [
        FlexibleBody(n, bar, places[n], fidelity="linear", damping_ratio=r) for n, r in zip("ab", ratios, strict=True)
    ]
    joints = tuple(fixed(name, f"ground.{name}", f"{name}.left") for name in places)
    return Scene("bars", (ground, *bodies), joints, **options)


@pytest.mark.parametrize("ratios", [(0.02, None), (None, 0.02)])
def test_one_body_with_damping_of_its_own_is_enough(bar, ratios):
    """The other bar's modes then have none, where a scene without any such body has the usual one per cent."""
    frequency, found = damping(linearize(clamped(bar, ratios)))
    np.testing.assert_allclose(np.sort(found[:2]), [0.0, 0.02], atol=1e-9)
    assert frequency[0] == pytest.approx(frequency[1], rel=1e-3)
    assert damping(linearize(clamped(bar, (None, None))))[1][:2] == pytest.approx(0.01)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_both_ends_of_a_bushing_stay_when_bodies_are_trimmed(bar, order):
    """Of two clamped bars whose free ends a bushing ties: near its static response, nothing is lost."""
    ends = ("a.right", "b.right")[order]
    figures = [4e4, 5e4, 6e4, 3.0, 2.0, 1.0]
    scene = clamped(bar, (None, None), cutoff_frequency=1e3, springs=(Bushing("tie", *ends, figures),))
    push, read = (
        PointForce("push", "a.right", (0.2, 0.5, -0.4), "push"),
        Encoder("way", "b.left", "b.right", (0.4, -0.2, 0.8)),
    )
    scene = replace(scene, actuators=(push,), sensors=(read,))
    kept = {body.name: body.reduced.point_names for body in trim_scene(scene).flexible_bodies}
    assert kept == {"a": ("left", "right"), "b": ("left", "right")}
    whole, trimmed = (
        frequency_response(linearize(each), np.array([0.0, 20.0])).values
        for each in (replace(scene, cutoff_frequency=None), scene)
    )
    np.testing.assert_allclose(trimmed, whole, rtol=1e-3)
    assert abs(whole[0, 0, 0]) > 1e-9


@dataclass(frozen=True)
class Mixture(Sensor):
    """Accelerations of two points through a low-pass, one of them against inertial space."""

    point: str = "block.p"
    second: bool = True

    def terms(self, scene):
        """Two readings of one output, and a filter."""
        row = Displacement(((self.point, np.array([0.6, 0.0, 0.8])),))
        return (
            Output(self.name, "m/s2", row, derivative=2),
            Output(self.name, "m/s2", row, derivative=2, inertial=self.second),
            OutputFilter(self.name, "low", 100.0),
        )


def test_a_filter_starts_on_one_kind_of_value():
    Scene("s", block().bodies, sensors=(Mixture("mixed", second=False),), springs=block().springs)
    with pytest.raises(ValueError, match="output 'mixed' adds outputs of several derivatives and passes a filter"):
        Scene("s", block().bodies, sensors=(Mixture("mixed"),), springs=block().springs)


def test_equal_bodies_in_equal_use_are_trimmed_once(bar):
    """Two bars share one reduced body, until a force acts on one of them alone, or on both in other directions."""
    scene = clamped(bar, (None, None), cutoff_frequency=1e3)
    push, pull = PointForce("push", "b.right", (0.6, 0.0, 0.8), "push"), PointForce("pull", "a.right", "y", "pull")
    for actuators, shared in (((), True), ((push,), False), ((push, pull), False)):
        a, b = trim_scene(replace(scene, actuators=actuators)).flexible_bodies
        assert (a.reduced is b.reduced) == shared
    port = PortCoupling("v", np.eye(len(bar.mass_matrix))[-1], 1e-6)
    wired = clamped(replace(bar, readouts={**bar.readouts, "v": port}), (None, None), cutoff_frequency=1e3)
    a, b = trim_scene(replace(wired, actuators=(VoltageDrive("amplifier", "b.v", "volts"),))).flexible_bodies
    assert [len(body.reduced.ports) for body in (a, b)] == [0, 1]  # each keeps the ports that are wired
    pushed = frequency_response(linearize(replace(scene, actuators=actuators, sensors=(END,))), np.array([0.0]))
    whole = replace(scene, cutoff_frequency=None, actuators=actuators, sensors=(END,))
    expected = frequency_response(linearize(whole), np.array([0.0]))
    np.testing.assert_allclose(pushed.values, expected.values, rtol=1e-9)


def test_a_frame_that_nothing_else_holds_stays_when_a_body_is_trimmed(bar):
    scene = clamped(bar, (None, None), cutoff_frequency=1e3)
    riding = replace(scene, bodies=(scene.bodies[0], replace(scene.bodies[1], frame="right"), scene.bodies[2]))
    kept = {body.name: (body.reduced.point_names, body.frame) for body in trim_scene(riding).flexible_bodies}
    assert kept == {"a": (("left", "right"), "right"), "b": (("left",), "left")}
    frequency = damping(linearize(riding))[0]
    assert frequency[:4] == pytest.approx(damping(linearize(scene))[0][:4], rel=1e-2)


def test_a_cutoff_keeps_the_modes_that_have_ratios_of_their_own(bar):
    """Three modes are kept: three ratios and that of all others, but not one more."""
    frequency = bar.eigenfrequencies(fixed=["left"])
    cutoff = {"cutoff_frequency": 0.5 * (frequency[2] + frequency[3])}
    trim_scene(clamped(bar, ([0.01, 0.02, 0.03, 0.04], None), **cutoff))
    with pytest.raises(ValueError, match="body 'a' has damping ratios by mode, and cutoff_frequency removes its modes"):
        trim_scene(clamped(bar, ([0.01, 0.02, 0.03, 0.04, 0.05], None), **cutoff))


def test_what_a_cutoff_leaves_out_counts_as_truncation(bar):
    """The better model is the one with all that the bodies know, not one trimmed again; one input pushes both."""
    pushes = (PointForce(f"push {name}", f"{name}.right", axis, "push") for name, axis in (("a", "y"), ("b", "z")))
    reads = (Encoder(name, f"ground.{name}", f"{name}.right", axis) for name, axis in (("a", "y"), ("b", "z")))
    whole = replace(clamped(bar, (None, None)), actuators=tuple(pushes), sensors=tuple(reads))
    first = damping(linearize(whole))[0][0]
    scene, frequency = replace(whole, cutoff_frequency=1.2 * first), first * np.array([0.1, 0.6, 3.0])
    richest = [replace(b, reduced=b.reduced.enriched) if b.name in "ab" else b for b in whole.bodies]
    exact = frequency_response(linearize(replace(whole, bodies=tuple(richest))), frequency).values
    expected = np.abs(frequency_response(linearize(scene), frequency).values / exact - 1)
    np.testing.assert_allclose(truncation_error(scene, frequency), expected, rtol=1e-6)
    assert expected[:, 0, -1].min() > 1e-3


def test_modes_are_counted_by_their_natural_frequency():
    """As `damping` lists them: one that swings more slowly because it is nearly critical comes by its stiffness."""
    scene = block()
    axis, across = scene.springs[0].axis, (0.8, 0.0, -0.6)
    spring = SpringDamper("along", "ground.p", "block.p", axis, 1.2e4 * MASS, 2 * 0.8 * np.sqrt(1.2e4) * MASS)
    other = SpringDamper("across", "ground.p", "block.p", across, 1e4 * MASS)
    damped = replace(scene, springs=(spring, other))
    first, second = (mode_motion(damped, number)[0] for number in (1, 2))
    assert first == pytest.approx(100j, rel=1e-9)
    assert second == pytest.approx(np.sqrt(1.2e4) * (-0.8 + 0.6j), rel=1e-9)
    assert second.imag < first.imag


@dataclass(frozen=True)
class Claim(Sensor):
    """Reads the block, and claims an electrical port."""

    port: str = "block.port"

    def terms(self, scene):
        """A displacement."""
        return (Output(self.name, "m", Displacement((("block.p", np.array([0.0, 0.0, 1.0])),))),)

    @property
    def claims(self):
        """Its port."""
        return (self.port,)


def test_a_port_belongs_to_one_part():
    scene = block()
    replace(scene, sensors=(Claim("a"), Claim("b", "block.other")))
    with pytest.raises(
        ValueError, match=r"electrical port 'block\.port' is used more than once; drive it or measure it"
    ):
        replace(scene, sensors=(Claim("a"), Claim("b")))


def test_a_loop_has_the_signals_of_its_controller():
    two = proportional([[1.0, 2.0]], sample_rate=1e3)
    Loop("l", two, ("a", "b"), "u")
    for measured, driven in ((("a",), ("u",)), (("a", "b"), ("u", "v")), (("a", "b", "c"), ("u",))):
        with pytest.raises(ValueError, match=r"loop 'l': its controller has 2 input\(s\) and 1 output\(s\), but it"):
            Loop("l", two, measured, driven)
    for repeated, signals in (
        ("measured", (("a", "a"), "u")),
        ("driven", ("a", ("u", "u"))),
        ("reference and noise", (("a", "b"), "u", 0.0, np.inf, 0.0, ("r", "r"))),
    ):
        controller = proportional([[1.0], [2.0]], sample_rate=1e3) if repeated == "driven" else two
        with pytest.raises(ValueError, match=f"loop 'l': {repeated} names must differ; used more than once"):
            Loop("l", controller, *signals)
