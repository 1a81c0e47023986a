"""Modes beyond what reductions hold: static where they would fold; against closed forms and richer bodies."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from conftest import lattice

from models.bench import full_bench_response, make_bench
from nassim import (
    Accelerometer,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    condense,
    craig_bampton,
    describe,
    estimate_frf,
    frequency_response,
    linearize,
    load,
    save,
    simulate,
)
from nassim.bodies.projection import trim_body
from nassim.fem.modes import fixed_interface_modes
from nassim.scene.placement import joined, placed
from nassim.signals.excitations import band_limited_noise
from nassim.simulation import linearize_closed, static_response
from nassim.simulation.linear.exact_steps import exact_response
from nassim.simulation.model.assembly import assemble
from nassim.systems import (
    PythonController,
    folding_modes,
    integral_force_feedback,
    largest_stable_gain,
    notch,
    proportional,
    sampled,
    series,
)
from nassim.systems.linear_model import LinearModel
from nassim.systems.state_space import quasi_static
from nassim.systems.transfer_matrices import transfer_matrix

WIRES = {"measured": "sensor_voltage", "driven": "actuator_voltage"}


@pytest.fixture(scope="module")
def condensed():
    return condense(lattice(), progress=False)


@pytest.fixture(scope="module")
def crude(condensed):
    """One fixed-interface mode; the lattice's first are at 1.7 kHz and beyond."""
    return craig_bampton(condensed, n_modes=1, progress=False)


def held(body, *, name="lattice", **options):
    """A lattice that is clamped at its left end; forces and displacements along x and y at its right end."""
    ground = RigidBody("ground", {"foot": body.point("left").position, "eye": [0.05, 0.02, 0.01]}, fixed=True)
    end = f"{name}.right"
    return Scene(
        "held",
        (ground, FlexibleBody(name, body, fidelity="linear")),
        (Joint("clamp", "ground.foot", f"{name}.left"),),
        actuators=(PointForce("push", end, "x", "force"), PointForce("shove", end, "y", "side")),
        sensors=(Encoder("along", "ground.eye", end, "x"), Encoder("across", "ground.eye", end, "y")),
        **options,
    )


@pytest.mark.parametrize("n_modes", [0, 1, 6])
def test_a_body_is_valid_up_to_the_first_mode_that_it_leaves_out(condensed, n_modes, tmp_path):
    first_left_out = fixed_interface_modes(condensed, n_modes=n_modes + 1)[0][-1]
    body = craig_bampton(condensed, n_modes=n_modes, progress=False)
    assert body.valid_frequency == pytest.approx(first_left_out, rel=1e-9)
    save(body, tmp_path / "body.h5")
    assert load(tmp_path / "body.h5").valid_frequency == body.valid_frequency
    assert replace(body, enriched=None).valid_frequency == np.inf, "of an imported body nobody knows"
    loads = np.zeros((len(body.mass_matrix), 0))
    trimmed = trim_body(body, points=["left", "right"], loads=loads, cutoff_frequency=1400.0)
    assert trimmed.valid_frequency == pytest.approx(min(first_left_out, 1427.738), rel=1e-6)


def test_states_that_follow_at_once_are_the_limit_of_fast_ones():
    """Of any linear system, coupled and damped: with the fast states a million times as fast."""
    random = np.random.default_rng(4)
    state, inputs, fast = random.normal(size=(7, 7)), random.normal(size=(7, 2)), np.arange(7) % 3 == 1
    state -= 6 * np.eye(7)
    slow, drives, kept, taken = quasi_static(state, inputs, fast)
    speed = np.where(fast, 1e6, 1.0)[:, None]
    points = np.array([0.0, 0.3j, 2j, 9j])
    limit = transfer_matrix((speed * state, speed * inputs, np.eye(7), np.zeros((7, 2))), points)
    found = transfer_matrix((slow, drives, kept, taken), points)
    assert np.abs(found - limit).max() < 1e-4 * np.abs(limit).max()
    statics = -np.linalg.solve(state, inputs)
    np.testing.assert_allclose(found[..., 0].real, statics, rtol=1e-12)


def test_accelerations_of_a_loop_are_those_of_its_commands_without_delay():
    """Quasi-static modes take their share off a direct acceleration; it is not extrapolated from earlier commands."""
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    blocks = [RigidBody(name, {"o": np.zeros(3)}, 1.0, 1e-3 * np.eye(3)) for name in "ab"]
    guides = [Joint(f"guide_{name}", "ground.o", f"{name}.o", free=("x",)) for name in "ab"]
    springs = SpringDamper("low", "ground.o", "a.o", "x", 4e3), SpringDamper("high", "a.o", "b.o", "x", 4e9)
    free = Scene("pair", (ground, *blocks), tuple(guides), (PointForce("push", "a.o", "x", "force"),),
                 (Encoder("x", "ground.o", "a.o", "x"), Accelerometer("rate", "a.o", "x")), springs,
                 damping_ratio=0.02, quasi_static_above=1e3)  # fmt: skip
    loop = Loop("loop", proportional(3.0, sample_rate=1e4), "x", "force", reference="aim")
    time = 1e-4 * np.arange(200)
    aim = TimeHistory(time, np.sin(np.pi * time / 0.02)[None] ** 2, ("aim",), ("m",))
    closed = simulate(replace(free, loops=(loop,)), aim, time_step=1e-4, method="exact", progress=False)
    command = closed["loop"]
    record = TimeHistory(time, command[None], ("force",), ("N",))
    found = simulate(free, record, time_step=1e-4, method="exact", hold_order=0, progress=False)
    # At a sample an input acts already, a new command not yet: on both blocks together, of 2 kg.
    late = 0.5 * np.diff(command, prepend=command[0])
    np.testing.assert_allclose(closed["rate"], found["rate"] - late, rtol=0, atol=1e-6)
    assert np.abs(late).max() > 1e-3


def two_modes(high, *, share=1.0, ratio=0.01):
    """A force sensor's response with one mode at 100 Hz and one of a static share that nobody answers for."""
    omega, gains = 2 * np.pi * np.array([100.0, high]), np.array([-0.6, share])
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -2 * ratio * np.diag(omega)]])
    readings = np.hstack([gains * omega**2, [0.0, 0.0]])[None]
    drives, direct = np.array([[0.0], [0.0], [1.0], [1.0]]), np.zeros((1, 1))
    names = ("actuator_voltage",), ("sensor_voltage",)
    return LinearModel(state, drives, readings, direct, *names, unsupported=[0.0, high, 0.0, high])


def test_a_sampled_model_has_the_static_share_of_what_would_fold():
    """In closed form; at low frequencies as what is held and lightly damped, half a sample late."""
    rate, high = 10e3, 13e3
    model, frequency = two_modes(high, share=0.8), np.array([0.0, 20.0, 100.0, 400.0])
    found = frequency_response(sampled(model, rate), frequency).values[0, 0]
    alone = replace(two_modes(high, share=0.0), unsupported=[])
    z = np.exp(2j * np.pi * frequency / rate)
    expected = frequency_response(sampled(alone, rate), frequency).values[0, 0] + 0.8 * (1.5 / z - 0.5 / z**2)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    x = 1j * np.pi * frequency / rate
    held = np.exp(-x) * np.sinc(frequency / rate) * 0.8
    assert np.abs(found - expected + 0.8 * (1.5 / z - 0.5 / z**2) - held).max() < 0.6 * np.abs(2 * x[-1]) ** 2 * 0.8
    above = sampled(model, 2.1 * high)
    assert len(above.A) == 4, "a mode below half of the sample rate does not fold and stays"
    np.testing.assert_allclose(above.A, sampled(replace(model, unsupported=[]), 2.1 * high).A)


def iff(rate, *, delay=1, gain=1.0):
    return integral_force_feedback(gain, sample_rate=rate, corner_frequency=2.0, delay=delay)


def edge(model, rate, delay=1):
    return largest_stable_gain(sampled(model, rate), iff(rate, delay=delay), np.geomspace(100.0, 3e4, 16), **WIRES)


@pytest.mark.parametrize("share", [0.45, 0.55])
def test_a_mode_folds_that_has_most_of_its_motion_beyond_what_holds(share):
    """Two equal masses, one of them beyond: of each mode it has a share, which decides for one of the two."""
    frequency, rate = np.array([700.0, 900.0]), 1e3
    turn = np.sqrt([[share, 1 - share], [1 - share, share]]) * [[1, -1], [1, 1]]
    stiffness = turn @ np.diag((2 * np.pi * frequency) ** 2) @ turn.T
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -10.0 * np.eye(2)]])
    drive, show = np.array([[0.0, 0, 1, 0.3]]).T, np.array([[1.0, 0.2, 0, 0]])
    beyond = np.array([800.0, 0.0, 800.0, 0.0])
    model = LinearModel(state, drive, show, np.zeros((1, 1)), ("u",), ("y",), unsupported=beyond)
    (mode,) = folding_modes(model, proportional(1.0, sample_rate=rate), measured="y", driven="u")
    assert mode.frequency == pytest.approx(frequency[0] if share > 0.5 else frequency[1], rel=1e-4)


@pytest.mark.parametrize(("apart", "n"), [(0.9e-3, 1), (1.1e-3, 2)])
def test_modes_fold_as_one_up_to_a_thousandth_of_their_frequency(apart, n):
    """Listed from the largest loop gain down."""
    omega = 2 * np.pi * 900.0 * np.array([1.0, 1.0 + apart])
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -10.0 * np.eye(2)]])
    drive, show = np.array([[0.0, 0, 1, 5]]).T, np.array([[1.0, 1.0, 0, 0]])
    beyond = np.full(4, 800.0)
    model = LinearModel(state, drive, show, np.zeros((1, 1)), ("u",), ("y",), unsupported=beyond)
    found = folding_modes(model, proportional(1.0, sample_rate=1e3), measured="y", driven="u")
    assert len(found) == n
    assert found[0].loop_gain == max(mode.loop_gain for mode in found)
    assert found[0].frequency == pytest.approx(900.0 * (1 + apart * (n - 1)), rel=1e-4 if n > 1 else 1e-3)


@pytest.mark.parametrize("ratios", [(0.002, 0.2), (0.2, 0.002), (0.01, 0.0), (0.0, 0.01)], ids=str)
def test_modes_of_one_frequency_ring_by_their_own_dampings(ratios):
    """2 R / (1 - |exp(p T)|) of each, summed where both fold to half the sample rate; endless without damping.

    There the samples of a mode's step are R (1 - (-r)^k), with the response R (1 - (z - 1) / (z + r)).
    """
    omega, rate = 2 * np.pi * 900.0 * np.array([1.0, 1.0001]), 1e3
    state = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -np.diag(2 * omega * ratios)]])
    drive, show = np.array([[0.0, 0, 1, 1]]).T, np.array([[1.0, 3.0, 0, 0]])
    model = LinearModel(state, drive, show, np.zeros((1, 1)), ("u",), ("y",), unsupported=np.full(4, 800.0))
    (mode,) = folding_modes(model, proportional(7.0, sample_rate=rate), measured="y", driven="u")
    with np.errstate(divide="ignore"):
        each = 14.0 * np.array([1.0, 3.0]) / omega**2 / -np.expm1(-omega * ratios / rate)
    assert mode.loop_gain == pytest.approx(each.sum(), rel=1e-3)


@pytest.mark.parametrize("kind", ["proportional", "integral", "resonant"])
@pytest.mark.parametrize("ratio", [1e-3, 1e-2])
def test_up_to_the_safe_gain_a_mode_is_stable_wherever_it_folds(ratio, kind):
    """Against the poles of the loop around the mode itself, in its place: also where it meets its mirror image."""
    rate, near = 1e3, [21.0, 51.0, 230.0, 420.0, 491.0, 498.0, 499.8, 500.0]
    unit = proportional(-1.0, sample_rate=rate, delay=0)
    if kind == "integral":
        unit = integral_force_feedback(100.0, sample_rate=rate, corner_frequency=2.0)
    elif kind == "resonant":  # narrower than the steps of the angles, in phase
        peak = notch(230.0, zero_damping=1.0, pole_damping=1e-3, sample_rate=rate, delay=5)
        unit = series(proportional(-1.0, sample_rate=rate, delay=5), peak)

    def mode(folded):
        omega = 2 * np.pi * (1e3 + folded)
        state = [[0.0, 1.0], [-(omega**2), -2 * ratio * 2 * np.pi * 1.3e3]]  # of one decay, wherever it is
        return LinearModel(state, [[0.0], [omega**2]], [[1.0, 0.0]], [[0.0]], ("u",), ("y",))

    beyond = replace(mode(300.0), unsupported=[1.3e3, 1.3e3])
    safe = 1 / folding_modes(beyond, unit, measured="y", driven="u")[0].loop_gain
    wires = {"measured": "y", "driven": "u"}
    edges = [
        largest_stable_gain(sampled(mode(folded), rate), unit, safe * np.linspace(0, 4, 33), **wires) for folded in near
    ]
    assert 0.99 * safe < min(edges) < 1.2 * safe


def test_a_mode_without_damping_folds_with_any_gain():
    state = np.array([[0.0, 1.0], [-((2 * np.pi * 900.0) ** 2), 0.0]])
    matrices = state, [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]
    model = LinearModel(*matrices, ("u",), ("y",), unsupported=[900.0, 900.0])
    with pytest.raises(ValueError, match="takes the continuous model"):
        folding_modes(sampled(model, 1e3), proportional(1.0, sample_rate=1e3), measured="y", driven="u")
    (mode,) = folding_modes(model, proportional(1e-9, sample_rate=1e3), measured="y", driven="u")
    assert mode.loop_gain == np.inf
    assert folding_modes(model, proportional(0.0, sample_rate=1e3), measured="y", driven="u")[0].loop_gain == 0.0


def test_gains_vary_smoothly_with_the_sample_rate_and_folding_modes_tell_which_are_safe():
    """With the mode in its place the edge jumps with where it folds, by its frequency and the sample rate.

    It never falls below the safe gain, and comes near that where the mode folds.
    """
    rates = np.array([8e3, 11e3, 14e3, 17e3, 20e3])
    smooth = np.array([edge(two_modes(13e3), rate) for rate in rates]) / rates
    assert np.ptp(smooth[rates < 26e3]) < 0.01 * smooth[0]
    edges = {high: [edge(replace(two_modes(high), unsupported=[]), rate) for rate in rates] for high in (13e3, 15.3e3)}
    assert max(edges[13e3] / rates) > 1.8 * min(edges[13e3] / rates)
    for high, found in edges.items():
        loops = [folding_modes(two_modes(high), iff(rate), **WIRES) for rate in rates]
        safe = np.array([1 / mode.loop_gain for (mode,) in loops])
        assert np.all(found > 0.95 * safe)
        assert np.min(found / safe) < 1.5
        assert loops[0][0].frequency == pytest.approx(high)
        assert loops[0][0].folded == pytest.approx(min(high % 8e3, 8e3 - high % 8e3), rel=1e-6)
    assert folding_modes(two_modes(13e3), iff(27e3), **WIRES) == ()
    assert folding_modes(two_modes(13e3, ratio=1.5), iff(8e3), **WIRES) == (), "what does not ring does not fold"
    one, three = (folding_modes(two_modes(13e3), iff(8e3), gain=gain, **WIRES)[0].loop_gain for gain in (1.0, 3.0))
    assert three == pytest.approx(3 * one)
    model = two_modes(13e3)
    state, turn = np.zeros((6, 6)), [0.6, 0.8]
    state[:4, :4], state[4, 5], state[5, 4:] = model.A, 1.0, model.A[3, 1::2]
    twice = replace(
        model,
        A=state,
        B=np.vstack([model.B[:3], turn[0] * model.B[3:], [[0.0]], turn[1] * model.B[3:]]),
        C=np.hstack([model.C * [[1.0, turn[0], 1.0, 1.0]], turn[1] * model.C[:, 1:2], [[0.0]]]),
        unsupported=[*model.unsupported, 13e3, 13e3],
    )
    (pair,) = folding_modes(twice, iff(8e3), **WIRES)
    assert pair.loop_gain == pytest.approx(one), "modes of one frequency are one, however their shapes are turned"
    with pytest.raises(ValueError, match="takes the continuous model"):
        folding_modes(sampled(two_modes(13e3), 8e3), iff(8e3), **WIRES)


def test_modes_are_static_by_where_their_energy_is(condensed, crude):
    """Of two lattices in line: not those above the crude one's limit that the finer one has."""
    fine = craig_bampton(condensed, n_modes=12, progress=False)
    scene = held(crude)
    there = crude.point("right").position - fine.point("left").position
    scene = replace(
        scene,
        bodies=(*scene.bodies, FlexibleBody("fine", fine, position=there, fidelity="linear")),
        joints=(*scene.joints, Joint("weld", "lattice.right", "fine.left")),
    )
    assembly = assemble(scene)
    modes = assembly.modal.modes
    share = np.zeros(len(assembly.modal.frequency))
    for name, body in (("lattice", crude), ("fine", fine)):
        own = modes[assembly.coordinates.slices[name]]
        energy = np.einsum("ik,ij,jk->k", own, body.stiffness_matrix, own) / (2 * np.pi * assembly.modal.frequency) ** 2
        share += energy * (assembly.modal.frequency > body.valid_frequency)
    np.testing.assert_array_equal(assembly.modal.unsupported, share > 0.5)
    beyond = assembly.modal.frequency > crude.valid_frequency
    assert 0 < np.count_nonzero(assembly.modal.unsupported) < np.count_nonzero(beyond)
    assert f"complete up to {crude.valid_frequency:.4g} Hz" in " ".join(describe(scene).split())
    chosen = assemble(replace(scene, quasi_static_above=500.0))
    np.testing.assert_array_equal(chosen.modal.unsupported, chosen.modal.frequency > 500.0)
    assert not assemble(replace(scene, quasi_static_above=np.inf)).modal.unsupported.any()
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="quasi_static_above must be positive"):
            replace(scene, quasi_static_above=bad)


def test_placed_and_joined_scenes_keep_where_modes_are_static(crude):
    alone = held(crude, quasi_static_above=500.0)
    pair = [placed(alone, name, position=[x, 0, 0]) for name, x in (("a", 0.0), ("b", 1.0))]
    assert joined("both", *pair).quasi_static_above == 500.0
    assert joined("both", *pair, quasi_static_above=900.0).quasi_static_above == 900.0
    with pytest.raises(ValueError, match="quasi_static_above is 500"):
        joined("both", pair[0], replace(pair[1], quasi_static_above=None))


def static_shares(scene):
    """Of the modes that are quasi-static: displacements per force, (outputs, inputs), from the modes themselves."""
    a = assemble(scene)
    modes = a.modal.modes[:, a.modal.unsupported] / (2 * np.pi * a.modal.frequency[a.modal.unsupported])
    return a.signals.output_matrix @ modes @ modes.T @ a.signals.input_matrix


def test_exact_runs_between_samples(crude):
    """Straight inputs: the slow modes by SciPy, and the static share at once; at fine steps all modes as ever."""
    scene = held(crude, quasi_static_above=900.0)
    time = np.arange(400) / 2e3
    forces = band_limited_noise(time[-1], 2e3, cutoff_frequency=100.0, rms=1.0, seed=3).values[0, : len(time)]
    given = TimeHistory(time, [forces, np.roll(forces, 7)], ("force", "side"))
    record = simulate(scene, given, time_step=1 / 2e3, method="exact", progress=False)
    model, slow = linearize(scene), np.flatnonzero(np.tile(~assemble(scene).modal.unsupported, 2))
    system = model.A[np.ix_(slow, slow)], model.B[slow], model.C[:, slow], static_shares(scene)
    scale = np.concatenate([np.ones(len(slow) // 2), np.full(len(slow) // 2, 1e3)])
    system = (system[0] * scale / scale[:, None], system[1] / scale[:, None], system[2] * scale, system[3])
    expected = scipy.signal.lsim(system, given.values.T, time)[1].T
    found = record.select(["along", "across"]).values
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
    assert static_shares(scene)[0, 0] > 0.05 * static_response(scene, {"force": 1.0})["along"]
    fine, usual = (
        simulate(replace(scene, quasi_static_above=above), given, time_step=1 / 8e3, method="exact", progress=False)
        for above in (np.inf, None)
    )
    np.testing.assert_array_equal(fine.values, usual.values)


def test_bodies_move_as_outputs_read(crude):
    """With a damper that couples the modes, so that those that are quasi-static follow the slow ones too."""
    damper = SpringDamper("damper", "ground.eye", "lattice.right", "x", damping=4.0)
    a = assemble(held(crude, quasi_static_above=900.0, springs=(damper,)))
    forces = np.random.default_rng(2).normal(size=(2, 40)).cumsum(axis=1)
    outputs, _, _, coordinates = exact_response(a, forces, 1e-3, kept=[0, 7, 31])
    np.testing.assert_allclose(a.signals.output_matrix @ coordinates, outputs[:, [0, 7, 31]], rtol=1e-9)


def looped(body, rate, share, *, delay=1, **options):
    """A proportional loop of a share of the lattice's stiffness against its end's displacement."""
    stiffness = 1 / static_response(held(body), {"force": 1.0})["along"]
    controller = proportional(-share * stiffness, sample_rate=rate, delay=delay)
    loop = Loop("hold", controller, "along", "force")
    return held(body, loops=(loop,), **{"quasi_static_above": 900.0} | options)


@pytest.mark.parametrize("delay", [0, 2])
def test_loops_run_as_the_sampled_model_says(crude, delay):
    """Held inputs, sample by sample; and in thirds of the sample, where the same loop is fed by gravity."""
    scene = looped(crude, 1e3, 0.4, delay=delay, damping_ratio=0.2)
    time = np.arange(60) / 1e3
    given = TimeHistory(time, np.sin(2 * np.pi * 40 * time)[None] * [[1.0], [-0.6]], ("force", "side"))
    record = simulate(scene, given, time_step=1e-3, method="exact", hold_order=0, progress=False)
    model = linearize_closed(scene)
    x, expected = np.zeros(len(model.A)), []
    for u in given.values.T:
        expected.append(model.C @ x + model.D @ u)
        x = model.A @ x + model.B @ u
    found = record.select(["along", "across"]).values.T
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())
    falling = replace(scene, gravity=[3.0, -8.0, 5.0])
    runs = [
        simulate(falling, replace(given, values=0 * given.values), time_step=step, method="exact", **RELEASED)
        for step in (1e-3, 1e-3 / 3)
    ]
    coarse, thirds = (run.select(["along", "across", "hold"]).values for run in runs)
    np.testing.assert_allclose(thirds[:2, ::3], coarse[:2], atol=1e-9 * np.abs(coarse[:2]).max())
    np.testing.assert_allclose(thirds[2, ::3], coarse[2], atol=1e-9 * np.abs(coarse[2]).max())


RELEASED = {"start": "released", "progress": False}


class Gain:
    """A proportional controller in Python."""

    def __init__(self, gain):
        self.gain = gain

    def output(self, measured, _time):
        return self.gain @ measured


@pytest.mark.parametrize("steps", [3, 5])
def test_quasi_static_modes_show_a_controller_in_python_the_same(crude, steps):
    """As the linear one of the same gain, at all samples and between them, through several pieces of a run."""
    linear = looped(crude, 1e3, 0.4, gravity=[3.0, -8.0, 5.0], damping_ratio=0.2)
    (loop,) = linear.loops
    python = replace(loop, controller=PythonController(Gain(loop.controller.D), 1e3))
    still = TimeHistory(np.arange(61) / 1e3, np.zeros((2, 61)), ("force", "side"))
    expected, found = (
        simulate(scene, still, time_step=1e-3 / steps, method="exact", **RELEASED).values[2:]
        for scene in (linear, replace(linear, loops=(python,)))
    )
    assert np.all(np.abs(found - expected).max(axis=1) < 1e-9 * np.abs(expected).max(axis=1))


def test_equilibrium_is_whole(crude):
    """Statics lose nothing: against Exudyn's equilibrium, before, during and after a constant push."""
    scene = held(crude, gravity=(3.0, -8.0, 5.0), quasi_static_above=500.0, damping_ratio=0.2)
    time = np.arange(200) / 1e3
    still, at_rest = TimeHistory(time, np.zeros((2, 200)), ("force", "side")), static_response(scene)
    for order in (0, 1):
        record = simulate(scene, still, time_step=1e-3, hold_order=order, **EXACT)
        for name in ("along", "across"):
            np.testing.assert_allclose(record[name], at_rest[name], rtol=1e-6)
    pushed = simulate(
        replace(scene, gravity=np.zeros(3)),
        TimeHistory(time, [np.full(200, 3.0), np.zeros(200)], ("force", "side")),
        time_step=1e-3,
        **EXACT,
        hold_order=0,
    )
    assert pushed["along"][-1] == pytest.approx(static_response(held(crude), {"force": 3.0})["along"], rel=1e-6)
    held_model = sampled(linearize(scene), 1e3)
    gain = frequency_response(held_model, np.zeros(1)).response("along", "force")[0].real
    assert gain == pytest.approx(static_response(held(crude), {"force": 1.0})["along"], rel=1e-6)


EXACT = {"method": "exact", "progress": False}


def test_accelerations_lose_what_is_quasi_static(crude):
    """At once, of what acts now, as before: an accelerometer feels the slow modes' masses only."""
    scene = held(crude, quasi_static_above=900.0)
    scene = replace(scene, sensors=(Accelerometer("a", "lattice.right", "x"),))
    a = assemble(scene)
    modes = a.modal.modes[:, ~a.modal.unsupported]
    model = sampled(linearize(scene), 1e3)
    np.testing.assert_allclose(
        model.D, a.signals.acceleration_matrix @ modes @ modes.T @ a.signals.input_matrix, rtol=1e-8
    )
    assert len(model.A) == 2 * modes.shape[1]


def test_loops_that_may_be_unstable_where_modes_fold_are_told(crude):
    """By name, and with the factor that would do: the same loop, that much weaker, is silent."""
    scene = looped(crude, 1e3, 1.0, damping_ratio=0.005)
    time = np.arange(20) / 1e3
    still = TimeHistory(time, np.zeros((2, 20)), ("force", "side"))
    for verb in (linearize_closed, lambda s: simulate(s, still, time_step=1e-3, **EXACT)):
        with pytest.warns(UserWarning, match="loop 'hold' may be unstable on modes that are quasi-static") as told:
            verb(scene)
        assert len(told) == 1
    (loop,) = scene.loops
    modes = folding_modes(linearize(scene), loop.controller, measured="along", driven="force")
    assert f"{modes[0].frequency:.4g} (folds to {modes[0].folded:.4g})" in str(told[0].message)
    assert f"gain on them is up to {modes[0].loop_gain:.3g}: give" in str(told[0].message)
    factor = 1.1 / modes[1].loop_gain  # two modes are told, and the gain on the one of the larger
    with pytest.warns(UserWarning, match=f"up to {factor * modes[0].loop_gain:.3g}: give the actuator"):
        linearize_closed(looped(crude, 1e3, factor, damping_ratio=0.005))
    weaker, stronger = (looped(crude, 1e3, g / modes[0].loop_gain, damping_ratio=0.005) for g in (0.99, 1.01))
    with pytest.warns(UserWarning, match="loop 'hold' may be unstable on modes that are quasi-static"):
        linearize_closed(stronger)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linearize_closed(weaker)
        linearize_closed(scene, continuous=True)
        linearize_closed(replace(scene, quasi_static_above=np.inf))


RATES = np.array([8e3, 12e3, 15e3, 20e3, 30e3])


def test_gains_of_the_bench_with_ports_vary_smoothly_with_the_sample_rate(apa_with_ports):
    """Load shapes of the stacks at 11 to 194 kHz no longer decide; where they might, `folding_modes` tells."""
    scene = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    assembly, plant = assemble(scene), linearize(scene)
    np.testing.assert_array_equal(assembly.modal.unsupported, assembly.modal.frequency > apa_with_ports.valid_frequency)
    smooth = np.array([edge(plant, rate) for rate in RATES]) / RATES
    assert np.ptp(smooth) < 0.1 * smooth.mean()
    folded = np.array([edge(replace(plant, unsupported=[]), rate) for rate in RATES]) / RATES
    assert folded.max() > 3 * folded.min()


@pytest.mark.slow
def test_the_bench_with_ports_against_many_more_modes_and_the_full_model(apa_with_ports, apa_with_ports_condensed):
    """A reduction with all modes up to 58 kHz, of which the first 40 or so fold, and the FE model without reduction.

    The true edge is where these modes put it, with the damping that is assumed of them: not below the safe gain, not
    above the smooth one by more than a quarter. Behind an amplifier of 1 kHz both agree to 12 %. What a run identifies
    of V/V is right, where it was degrees off.
    """
    scene = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    rich = craig_bampton(apa_with_ports_condensed, n_modes=60, progress=False)
    plant = linearize(scene)
    reference = make_bench(apa=rich, fidelity="linear", resistance=np.inf)
    edges, smooth = (np.array([edge(model, rate) for rate in RATES]) for model in (linearize(reference), plant))
    safe = np.array([1 / folding_modes(plant, iff(rate), **WIRES)[0].loop_gain for rate in RATES])
    assert np.all(safe < edges)
    assert np.all(edges < 1.25 * smooth)
    slower = [replace(s, actuators=(replace(s.actuators[0], bandwidth=1e3),)) for s in (reference, scene)]
    edges, smooth = (np.array([edge(linearize(s), rate) for rate in RATES]) for s in slower)
    np.testing.assert_allclose(smooth, edges, rtol=0.12)
    rate = 22e3
    noise = band_limited_noise(4.0, rate, cutoff_frequency=1550.0, rms=0.1)
    points = np.array([1500.0, 2000.0])
    truth = full_bench_response(apa_with_ports_condensed, points, resistance=np.inf, progress=False)
    off = {}
    for above in (None, np.inf):
        record = simulate(replace(scene, quasi_static_above=above), noise, time_step=1 / rate, **EXACT)
        frf = estimate_frf(record, inputs=["actuator_voltage"], outputs=["sensor_voltage"], segment_duration=0.5)
        found = frf.values[0, 0, np.searchsorted(frf.frequency, points)]
        off[above] = np.abs(np.degrees(np.angle(found / truth.response("sensor_voltage", "actuator_voltage"))))
    assert off[None].max() < 0.3
    assert off[np.inf].max() > 5.0
