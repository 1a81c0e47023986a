"""Loops of a hexapod: gains from one locus, standing and spinning; two sets of loops in one scene, inside and outside.

Geometry: test_hexapod; figures of the spinning one were computed elsewhere by two routes.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from conftest import lattice
from test_hexapod import FEET, HEADS, HEIGHT, STIFFNESS, by_hand, jacobian, on_springs
from test_spinning import hexapod, spun

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    LinearActuator,
    LinearModel,
    Loop,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
)
from nassim.signals import low_pass
from nassim.simulation import linearize_closed
from nassim.simulation.model.digital_controllers import RunningControllers
from nassim.systems import (
    close_loop,
    crossover_controller,
    damping,
    decentralised,
    decoupled,
    integral_force_feedback,
    largest_stable_gain,
    lead,
    loop_at_a_time,
    margins,
    noise_budget,
    open_loop,
    optimum_gain,
    proportional,
    sensitivity,
    singular_values,
    unstable_poles,
    with_inputs,
    with_outputs,
)

STRUTS = tuple(f"f{k}" for k in range(6))
SIX = decentralised(*6 * [integral_force_feedback(1.0, sample_rate=1e6)])


def with_masses(stiffness=STIFFNESS):
    """Struts of two halves, part by part, without dampers."""
    scene = by_hand()
    return replace(scene, springs=tuple(replace(s, stiffness=stiffness, damping=0.0) for s in scene.springs))


def with_force_sensors(model, in_series):
    """Instead of six lengths, what the struts bear: the actuator's force less the tension of the spring beside it."""
    return LinearModel(model.A, model.B[:, :6], -in_series * model.C[:6], np.eye(6), model.inputs[:6], STRUTS)


def wires(model):
    return {"measured": STRUTS, "driven": model.inputs, "delay_order": 0}


GAINS = np.linspace(0.0, 17e3, 35)


@pytest.fixture(scope="module")
def sensed_whole():
    """Sensors in all of the struts, and the natural frequencies [Hz]."""
    model = with_force_sensors(linearize(with_masses()), STIFFNESS)
    return model, np.sort(damping(model)[0])


@pytest.fixture(scope="module")
def sensed_beside():
    """A quarter of the stiffness beside the sensors."""
    scene = with_masses(15e6)
    beside = [SpringDamper(f"p{k}", f"l{k}.end", f"u{k}.end", "line", 5e6) for k in range(6)]
    model = with_force_sensors(linearize(replace(scene, springs=(*scene.springs, *beside))), 15e6)
    return model, np.sort(damping(model)[0])


@pytest.mark.parametrize(("mode", "gain"), [(0, 9809), (2, 11359), (3, 13338), (5, 15955)])
def test_every_modes_best_gain_by_public_verbs(sensed_whole, mode, gain):
    """Critical at g = 2 w, each mode by itself though all six loops share the gain."""
    model, modes = sensed_whole
    found = optimum_gain(model, SIX, GAINS, **wires(model), frequency=modes[mode])
    assert found.gain == pytest.approx(gain, rel=5e-5)
    assert found.damping_ratio == pytest.approx(1.0, abs=1e-5)


def test_the_gain_that_damps_all_modes_best(sensed_whole):
    """The last mode to become critical, the others being so already."""
    model, modes = sensed_whole
    assert optimum_gain(model, SIX, GAINS, **wires(model), frequency=modes).gain == pytest.approx(15955, rel=5e-5)


@pytest.mark.parametrize(("mode", "gain"), [(0, 6936), (2, 8032), (3, 9432), (5, 11282)])
def test_every_modes_best_gain_beside_parallel_springs(sensed_beside, mode, gain):
    """One half of critical damping at g = w sqrt(2)."""
    model, modes = sensed_beside
    found = optimum_gain(model, SIX, GAINS, **wires(model), frequency=modes[mode])
    assert found.gain == pytest.approx(gain, rel=3e-4)
    assert found.damping_ratio == pytest.approx(0.5, rel=1e-6)


def test_spinning_hexapod_by_public_verbs():
    """At 60 rpm: pure integrators are unstable with any gain, leaky ones up to one, with parallel springs never."""
    stiffness, gains = 1.846e6, np.concatenate([[0.0], np.geomspace(1.0, 1e5, 30)])
    model = with_force_sensors(spun(hexapod(), (0, 0, 2 * np.pi)), stiffness)
    assert largest_stable_gain(model, SIX, gains, **wires(model)) == pytest.approx(0.0, abs=1e-6)
    pure = close_loop(model, SIX, **wires(model), gain=100.0)
    assert max(pole.growth_rate for pole in unstable_poles(pure)) == pytest.approx(0.552, abs=6e-4)
    leaky = decentralised(*6 * [integral_force_feedback(1.0, sample_rate=1e6, corner_frequency=1.0)])
    _, ratio = damping(close_loop(model, leaky, **wires(model), gain=100.0))
    assert ratio.min() == pytest.approx(0.104, abs=6e-4)
    edge = largest_stable_gain(model, leaky, gains, **wires(model))
    for share, grows in ((0.999, False), (1.001, True)):
        assert bool(unstable_poles(close_loop(model, leaky, **wires(model), gain=share * edge))) == grows
    scene = hexapod()
    beside = [SpringDamper(f"p{k}", f"table.a{k}", f"plate.b{k}", "line", 0.1 * stiffness) for k in range(6)]
    carried = replace(scene, springs=(*scene.springs, *beside))
    held = with_force_sensors(spun(carried, (0, 0, 2 * np.pi)), stiffness)
    assert largest_stable_gain(held, SIX, gains, **wires(held)) == np.inf
    softly = replace(scene, springs=(*scene.springs, *(replace(s, stiffness=1e-3 * stiffness) for s in beside)))
    softly = with_force_sensors(spun(softly, (0, 0, 2 * np.pi)), stiffness)
    assert largest_stable_gain(softly, SIX, gains, **wires(softly)) < 1e-6


RATE = 8e3
JACOBIAN = jacobian(FEET, HEADS, HEIGHT + 0.02)
MEASURE, DRIVE = np.linalg.inv(JACOBIAN), np.linalg.inv(JACOBIAN).T
LENGTHS, PUSHES = tuple(f"e{k}" for k in range(6)), tuple(f"a{k}" for k in range(6))
CARTESIAN = [
    lead(250.0 + 40 * k, phase=50.0, gain=-gain, sample_rate=RATE)
    for k, gain in enumerate([2e5, 2.5e5, 5e5, 2e3, 1.8e3, 5e3])
]
INNER = lead(600.0, phase=70.0, gain=-3e5, sample_rate=RATE)
"""Of each strut: mostly its rate, which damps."""


def machine(*, beside=False):
    """The platform on springs with encoders along its struts, six loops inside and a Cartesian one outside.

    beside: with a flexible body, of which exact steps need one.
    """
    scene = on_springs(FEET, HEADS, 2e6, point=0.02)
    ends = [(f"base.f{k}", f"plate.h{k}") for k in range(6)]
    scene = replace(
        scene,
        actuators=(*scene.actuators, *(LinearActuator(f"a{k}", *end, f"a{k}") for k, end in enumerate(ends))),
        sensors=(*scene.sensors, *(Encoder(f"e{k}", *end, "line") for k, end in enumerate(ends))),
        loops=(
            Loop("damper", decentralised(*6 * [INNER]), LENGTHS, PUSHES),
            Loop("hold", decoupled(*CARTESIAN, measure=MEASURE, drive=DRIVE), LENGTHS, PUSHES),
        ),
        damping_ratio=0.002,
    )
    if not beside:
        return scene
    bar = craig_bampton(lattice(), n_modes=0, progress=False)
    base, plate = scene.bodies
    base = replace(base, points={**base.points, "beside": bar.point("left").position})
    lump = FlexibleBody("beside", bar, fidelity="linear", frame="left")
    return replace(scene, bodies=(base, plate, lump), joints=(Joint("clamp", "base.beside", "beside.left"),))


def test_loops_inside_and_outside_of_one_scene():
    scene = machine()
    inner, outer = scene.loops
    frequency = np.geomspace(5.0, 3.9e3, 400)
    plant = linearize_closed(scene, loops=())
    assert plant.time_step == 1 / RATE
    damped = linearize_closed(scene, loops=["damper"])
    by_hand = close_loop(plant, inner.controller, measured=LENGTHS, driven=PUSHES)
    np.testing.assert_allclose(damped.A, by_hand.A, atol=1e-12 * np.abs(by_hand.A).max())
    assert damping(damped)[1][:6].min() > 2 * damping(plant)[1][:6].min()
    closed = linearize_closed(scene)
    assert not unstable_poles(closed)
    loop = open_loop(damped, outer.controller, frequency, measured=LENGTHS, driven=PUSHES)
    s = sensitivity(loop)[0]
    before, after = (frequency_response(model, frequency) for model in (damped, closed))
    rows = [closed.outputs.index(name) for name in LENGTHS]
    expected = np.einsum("abf,bcf->acf", s.values, before.values[rows])
    scale = np.abs(after.values[rows]).max(axis=2, keepdims=True)
    np.testing.assert_allclose(after.values[rows] / scale, expected / scale, atol=1e-8)
    # By how much each strut's own loop may grow while the others run, and what all at once have left.
    worst = singular_values(s)[0].max()
    single = [margins(loop_at_a_time(loop, name)).modulus_margin for name in LENGTHS]
    assert min(single) > 1 / worst > 0.1
    with pytest.raises(ValueError, match="unknown loop 'outer'; known: damper, hold"):
        linearize_closed(scene, loops=["outer"])
    with pytest.raises(ValueError, match="must be a list"):
        linearize_closed(scene, loops="hold")


def test_noise_of_a_scenes_encoders_is_shared_by_its_loops():
    scene = machine()
    model = linearize_closed(scene, noise=True)
    assert model.inputs == (*scene.inputs, *(f"{name} noise" for name in LENGTHS))
    frequency = np.array([3.0, 200.0, 1500.0])
    k = sum(open_loop_controller(loop.controller, frequency) for loop in scene.loops)
    g = frequency_response(linearize_closed(scene, loops=()), frequency)
    g = np.array([[g.response(y, u) for u in PUSHES] for y in LENGTHS]).transpose(2, 0, 1)
    expected = np.linalg.solve(np.eye(6) - g @ k, g @ k)
    found = frequency_response(model, frequency)
    found = np.array([[found.response(y, f"{n} noise") for n in LENGTHS] for y in LENGTHS]).transpose(2, 0, 1)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def open_loop_controller(controller, frequency):
    """Its response from its matrices, (n, 6, 6)."""
    z = np.exp(2j * np.pi * frequency / RATE)
    n = len(controller.A)
    return np.array(
        [(controller.C @ np.linalg.solve(x * np.eye(n) - controller.A, controller.B) + controller.D) / x for x in z]
    )


FINER = 4
WRENCH = {"fx": 5.0, "fy": 2.0, "fz": 7.0, "tx": 0.1, "ty": 0.3, "tz": 0.2}


@pytest.fixture(scope="module")
def push():
    """Forces and torques that vary smoothly, in steps of a quarter of a sample period, (6, n)."""
    noise = np.random.default_rng(2).normal(size=(6, 240 * FINER + 1))
    return low_pass(noise, cutoff_frequency=150.0, sample_rate=RATE * FINER) * np.array([[*WRENCH.values()]]).T


@pytest.mark.parametrize(("method", "steps"), [("exact", 1), ("generalized_alpha", FINER)])
def test_cartesian_loops_in_time(push, method, steps):
    """Commands by six controllers written out between J^-1 and J^-T; motions by the closed linear model."""
    scene = machine(beside=True)
    values = push[:, :: FINER // steps]
    history = TimeHistory(
        np.arange(240 * steps + 1) / (RATE * steps), values, tuple(WRENCH), (*3 * ("N",), *3 * ("N m",))
    )
    options = {"hold_order": 0} if method == "exact" else {}
    record = simulate(scene, history, time_step=1 / (RATE * steps), method=method, progress=False, **options)
    sampled_at = slice(None, None, steps)
    lengths = np.array([record[name][sampled_at] for name in LENGTHS])
    command = np.array([record[f"hold.{name}"][sampled_at] for name in PUSHES])
    expected = np.zeros_like(command)
    states = [np.zeros(len(c.A)) for c in CARTESIAN]
    for n, motion in enumerate((MEASURE @ lengths).T[:-1]):
        force = np.zeros(6)
        for k, c in enumerate(CARTESIAN):
            force[k] = (c.C @ states[k] + c.D[:, 0] * motion[k]).item()
            states[k] = c.A @ states[k] + c.B[:, 0] * motion[k]
        expected[:, n + 1] = DRIVE @ force
    np.testing.assert_allclose(command, expected, atol=1e-9 * np.abs(expected).max())

    model = linearize_closed(scene)
    inputs = np.zeros((241, len(model.inputs)))
    held = push[:, ::FINER]
    if method != "exact":  # the mean over a sample period of what varies within it
        held = (held + np.roll(held, -1, axis=1)) / 2
    inputs[:, [model.inputs.index(name) for name in WRENCH]] = held.T
    _, predicted, _ = scipy.signal.dlsim((*model.matrices, 1 / RATE), inputs)
    rows = [model.outputs.index(name) for name in LENGTHS]
    error = np.abs(lengths - predicted.T[rows]).max() / np.abs(predicted[:, rows]).max()
    assert error < (1e-8 if method == "exact" else 0.01)


def test_converters_and_limits_act_on_sensors_and_actuators():
    """Readings are rounded before they become coordinates, commands limited and rounded after."""
    gains = (proportional(gain, sample_rate=RATE, delay=0) for gain in (2.0, -1.0))
    controller = decoupled(*gains, measure=[[1.0, 1.0], [1.0, -1.0]], drive=[[1.0, 0.0], [1.0, 1.0]], limit=3.1)
    loop = Loop("l", controller, ("a", "b"), ("u", "v"), input_step=0.5, input_limit=4.0, output_step=0.2)
    step = RunningControllers(loop)
    # Read as 0.5 and 0, coordinates 0.5 and 0.5, their controllers 1.0 and -0.5, commands 1.0 and 0.5.
    np.testing.assert_allclose(step(np.array([0.7, 0.2]))[0], [1.0, 0.4])
    # Read as 4 and -1.5: 2.5 and 5.5, 5.0 and -5.5, commands 5.0 and -0.5.
    np.testing.assert_allclose(step(np.array([5.0, -1.6]))[0], [3.0, -0.4])


AXES, WRENCHES = tuple(f"motion {k}" for k in range(6)), tuple(f"wrench {k}" for k in range(6))


def soft_machine():
    """The platform on soft springs with dampers' loops: a plant like a mass, for a crossover above its modes."""
    scene = machine()
    springs = [replace(spring, stiffness=2e4) for spring in scene.springs]
    inner = Loop("damper", decentralised(*6 * [lead(60.0, phase=60.0, gain=-4e3, sample_rate=RATE)]), LENGTHS, PUSHES)
    return replace(scene, springs=tuple(springs), loops=(inner,))


def test_a_high_authority_loop_is_designed_axis_by_axis():
    """Plant with its dampers, Cartesian signals, six crossovers, one controller: from public verbs alone."""
    plant = linearize_closed(soft_machine())
    model = with_outputs(plant, AXES, MEASURE, of=LENGTHS, units=(*3 * ("m",), *3 * ("rad",)))
    model = with_inputs(model, WRENCHES, DRIVE, of=PUSHES)
    asked = {"frequency": 150.0, "phase_margin": 50.0, "integral_frequency": 12.0, "sample_rate": RATE}
    six = [crossover_controller(model, measured=y, driven=u, **asked) for y, u in zip(AXES, WRENCHES, strict=True)]
    outer = decoupled(*six, measure=MEASURE, drive=DRIVE)
    frequency = np.geomspace(50.0, 1e3, 600)
    loop = open_loop(model, decentralised(*six), frequency, measured=AXES, driven=WRENCHES)
    for name in AXES:
        alone = margins(replace(loop, values=loop.response(name, name)[None, None], outputs=(name,), inputs=(name,)))
        assert alone.phase_margin == pytest.approx(50.0, abs=0.1)
        assert alone.phase_margin_frequency == pytest.approx(150.0, rel=1e-3)
        assert margins(loop_at_a_time(loop, name)).modulus_margin > 0.3
    scene = soft_machine()
    scene = replace(scene, loops=(*scene.loops, Loop("hold", outer, LENGTHS, PUSHES)))
    closed = linearize_closed(scene, noise=True)
    assert not unstable_poles(closed)
    # What the loops leave of slow forces: the integrators hold the plate.
    before, after = (frequency_response(m, np.array([1.0])).response("pose.ux", "fx") for m in (plant, closed))
    assert abs(after[0]) < 0.03 * abs(before[0])

    power = {"fx": 1e-4, "ty": 1e-7, "e2 noise": 1e-18}
    budget = noise_budget(closed, power, np.linspace(0.0, RATE / 2, 1500), outputs=("pose.ux", "pose.rz"))
    rows = [closed.outputs.index(output) for output in budget.outputs]
    for k, (name, density) in enumerate(power.items()):
        x, column = closed.B[:, closed.inputs.index(name)], closed.inputs.index(name)
        squares = closed.D[rows, column] ** 2
        for _ in range(4000):  # of the impulse response, sample by sample
            squares, x = squares + (closed.C[rows] @ x) ** 2, closed.A @ x
        exact = np.sqrt(squares * density * RATE / 2)
        np.testing.assert_allclose(budget.rms()[:, k], exact, rtol=1e-3, atol=1e-14)
