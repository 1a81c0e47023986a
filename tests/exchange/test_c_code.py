"""C code: equal to exact steps, strict C99 under sanitizers, in double and single precision; what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from compiled_c import COMPILER, largest_error, run_c
from conftest import lattice
from exported_scenes import STEP, excited, hanging, record, servoed, turning

from nassim import (
    Accelerometer,
    FlexibleBody,
    LinearModel,
    Loop,
    PointForce,
    PythonController,
    craig_bampton,
    linearize,
)
from nassim.exchange import export_c
from nassim.exchange.c_tables import CNumbers, CTables
from nassim.simulation.run.scene_program import scene_program, scene_rates
from nassim.systems import proportional, sampled
from nassim.systems.state_space import balanced_states
from nassim.systems.step_program import Converter, rate_program, run_program, step_program
from nassim.systems.uncoupled_states import block_diagonal, refined_eigenvectors, uncoupled_rates, uncoupled_steps

compiled = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


@compiled
@pytest.mark.parametrize(("make", "hold_order"), [(hanging, 1), (servoed, 1), (turning, 0)])
def test_c_code_equals_exact_steps(make, hold_order, tmp_path):
    scene = make()
    inputs = excited(scene)
    code = export_c(scene, tmp_path, "by", time_step=STEP, hold_order=hold_order)  # as the tables of the steps
    expected = record(scene, inputs, hold_order)
    assert largest_error(run_c(code, inputs), expected) < 1e-12
    if scene.loops:  # the run meets what it is to show
        assert np.abs(expected[2:]).max(axis=1) == pytest.approx([30.0, 20.0], rel=1e-4)


def test_a_loop_that_reads_more_signals_than_it_drives_stops_at_its_limit():
    """With its anti-windup, as a program; an input moves one of the signals at once."""
    scene = servoed()
    fast, slow = scene.loops
    law, shares = slow.controller, [0.2, 1.0, 1e-5]
    every = replace(law, B=law.B * shares, D=law.D * shares)
    signals = {"measured": ("x", "y", "a"), "reference": ("x_set", "y_set", "a_set")}
    scene = replace(
        scene,
        actuators=(*scene.actuators, PointForce("bump", "x_carriage.rail", "x", "bump")),
        sensors=(*scene.sensors, Accelerometer("a", "x_carriage.rail", "x")),
        loops=(fast, replace(slow, controller=every, **signals)),
    )
    inputs = excited(scene)
    expected = record(scene, inputs, 0)
    assert np.any(law.anti_windup)
    assert np.abs(expected[4]).max() == pytest.approx(20.0, rel=1e-4)
    assert largest_error(run_program(scene_program(scene, STEP), inputs), expected) < 1e-12


OPTIONS = ({"start": "released"}, {"constant_inputs": {"force": 70.0}})


@compiled
@pytest.mark.parametrize("options", OPTIONS, ids=("released", "constant"))
def test_c_code_starts_as_runs_do(options, tmp_path):
    scene = hanging()
    inputs = excited(scene)
    found = run_c(export_c(scene, tmp_path, "model", time_step=STEP, **options), inputs)
    assert largest_error(found, record(scene, inputs, 0, **options)) < 1e-12
    assert largest_error(found, record(scene, inputs, 0)) > 1e-2


@compiled
def test_single_precision_tells_its_error(tmp_path):
    scene = hanging()
    code = export_c(scene, tmp_path, "model", time_step=STEP, precision="single")
    noise = 1.0 + np.random.default_rng(3).normal(size=(2, 2000))
    expected = run_program(scene_program(scene, STEP), noise)
    errors = np.abs(run_c(code, noise, np.float32) - expected).max(axis=1) / np.abs(expected).max(axis=1)
    assert np.all(errors < 3 * np.array(list(code.errors.values())))
    assert 1e-7 < max(code.errors.values()) < 1e-3
    told = str(replace(code, errors={"x": 3e-6, "y": 2e-6}))
    assert "single precision: errors up to 3e-06 of the largest value, of x" in told
    counts = {"step_operations": 31, "output_operations": 17}
    told = str(replace(code, **counts, constant_bytes=900, state_bytes=80, stack_bytes=40))
    assert told.splitlines()[0] == (
        f"model.h, model.c in {tmp_path}: at most 31 multiplications and as many additions a step, 17 an output; "
        "900 bytes of constants, 80 of state, 40 of stack"
    )
    double = export_c(scene, tmp_path, "other", time_step=STEP)
    assert not double.errors
    assert double.state_bytes > 1.5 * code.state_bytes


def test_sizes_of_inputs_are_those_of_the_run_that_tells_the_error(tmp_path):
    """References of metres drive a command into its limit at every sample, which hides its error.

    Converters round by a shift beyond which numbers of single precision have no fraction, and tell whole ones apart.
    """
    scene, sizes = servoed(), {"x_set": 1e-5, "y_set": 1e-5, "x_noise": 1e-7}
    hidden, shown = (
        export_c(scene, tmp_path, "model", precision="single", input_sizes=given).errors["x_servo"]
        for given in ({}, sizes)
    )
    assert hidden < 1e-7 < shown
    shift = np.float32(re.search(r"shifted = value \+ (\S+)f;", (tmp_path / "model.c").read_text())[1])
    values = np.array([0.5, 1.5, 2.5, 1e6 + 0.7, -3.2], np.float32)
    np.testing.assert_array_equal((values + shift) - shift, [0, 2, 2, 1e6 + 1, -3])


@pytest.mark.filterwarnings("error")
def test_an_output_that_stays_zero_has_no_error(tmp_path):
    model = LinearModel([[-1.0]], [[1.0]], [[1.0], [0.0]], [[0.0], [0.0]], ("u",), ("y", "none"))
    errors = export_c(model, tmp_path, "model", time_step=STEP, precision="single").errors
    assert errors["none"] == 0.0 < errors["y"]


def test_the_numbers_of_operations_are_those_of_the_tables(tmp_path):
    code = export_c(servoed(), tmp_path, "model")
    text = code.source.read_text()
    tables = dict(re.findall(r"real (\w+)_value_(?:\d+)\[(\d+)\]", text))
    called = re.findall(r"add_product\(&(\w+)\[", text.split("model_step")[1])
    busy = re.findall(r"add_product\(&(\w+)\[", text.split("static void take_sample")[1].split("model_init")[0])
    assert {"by_states", "by_converted", "by_input", "by_excess"} == set(called)
    most = {name: max(int(n) for n in re.findall(rf"real {name}_value_\d\[(\d+)\]", text)) for name in tables}
    assert code.step_operations == sum(most[name] for name in [*called, *busy]) + 2 * 5
    assert f"At most {code.step_operations} multiplications" in code.header.read_text()


def test_the_header_names_signals_units_and_parts(tmp_path):
    scene = hanging()
    code = export_c(scene, tmp_path, "tower", time_step=STEP)
    header = code.header.read_text()
    assert "#define TOWER_U_N_2ND_FORCE 1  /* 2nd force [N]: PointForce pull */" in header
    assert "#define TOWER_Y_TOWER_WAY 0  /* tower/way [m]: Encoder tower/way */" in header
    assert "#define TOWER_TIME_STEP 0.0002 " in header
    assert {path.name for path in tmp_path.iterdir()} == {"tower.c", "tower.h"}


def test_names_that_would_be_the_same_or_end_a_comment(tmp_path):
    names = ("a b", "a/b", "int", "x */ 1 //", "été\n", "A_B")
    model = LinearModel(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((6, 0)), np.zeros((6, 0)), (), names)
    header = export_c(model, tmp_path, "model", time_step=1.0).header.read_text(encoding="utf-8")
    found = re.findall(r"#define MODEL_Y_(\w+) \d  /\* (.*) \*/", header)
    assert [name for name, _ in found] == ["A_B", "A_B_2", "INT_", "X____1___", "N_T__", "A_B_3"]
    assert found[3][1] == "x * / 1 //"
    assert found[4][1] == "été"


def small(state, **options):
    """A model with one input and one output."""
    n = len(state)
    return LinearModel(state, np.ones((n, 1)), np.ones((1, n)), np.zeros((1, 1)), ("u",), ("y",), **options)


def test_what_is_refused(tmp_path):
    stable = small(np.array([[-1.0]]))
    for name in ("2nd", "", "a-b", "while", "_x"):
        with pytest.raises(ValueError, match="name must be an identifier of C"):
            export_c(stable, tmp_path, name, time_step=STEP)
    with pytest.raises(ValueError, match="needs time_step"):
        export_c(stable, tmp_path, "m")
    with pytest.raises(ValueError, match="unknown precision 'half'; known: double, single"):
        export_c(stable, tmp_path, "m", time_step=STEP, precision="half")
    with pytest.raises(ValueError, match=r"the model is sampled every 0\.001 s, not every 0\.0002 s"):
        export_c(sampled(stable, 1e3), tmp_path, "m", time_step=STEP)
    with pytest.raises(ValueError, match="hold_order=1 needs a continuous model"):
        export_c(sampled(stable, 1e3), tmp_path, "m", hold_order=1)
    with pytest.raises(ValueError, match="hold_order must be 0 or 1"):
        export_c(stable, tmp_path, "m", time_step=STEP, hold_order=2)
    with pytest.raises(ValueError, match="a LinearModel starts at rest"):
        export_c(stable, tmp_path, "m", time_step=STEP, start="released")
    with pytest.raises(ValueError, match="takes a LinearModel or a Scene, got a float"):
        export_c(1.0, tmp_path, "m", time_step=STEP)
    with pytest.raises(ValueError, match="too large for single precision"):
        export_c(replace(stable, B=[[1e50]]), tmp_path, "m", time_step=STEP, precision="single")
    assert not any(tmp_path.iterdir())


def test_growing_models_are_refused_and_drifting_ones_are_not(tmp_path):
    growing = small(np.array([[0.0, 1.0], [1e4, 0.0]]))
    with pytest.raises(ValueError, match=r"unstable: a drift that grows e-fold in 0\.01 s; .* allow_unstable=True"):
        export_c(growing, tmp_path, "m", time_step=STEP)
    export_c(growing, tmp_path, "meant", time_step=STEP, allow_unstable=True)
    export_c(small(np.array([[0.0, 1.0], [0.0, 0.0]])), tmp_path, "free", time_step=STEP)
    scene = servoed()
    wrong = replace(scene.loops[0].controller, C=-scene.loops[0].controller.C, D=-scene.loops[0].controller.D)
    with pytest.raises(ValueError, match="the model is unstable"):
        export_c(replace(scene, loops=(replace(scene.loops[0], controller=wrong),)), tmp_path, "m")


def test_scenes_without_a_program_are_refused(body, tmp_path):
    scene = servoed()
    law = PythonController(type("Law", (), {"output": lambda *_: 0.0})(), 1 / STEP)
    with pytest.raises(ValueError, match="loop 'own': its controller, a Law in Python"):
        export_c(replace(scene, loops=(Loop("own", law, "x", "x_force"),)), tmp_path, "m")
    with pytest.raises(ValueError, match=r"scene 'servoed' has no loop that sets the time step"):
        export_c(replace(scene, loops=()), tmp_path, "m")
    floating = replace(scene, bodies=(*scene.bodies, FlexibleBody("bar", body, fidelity="ffrf")))
    with pytest.raises(ValueError, match="body 'bar' has fidelity \"ffrf\""):
        export_c(floating, tmp_path, "m")
    assert not any(tmp_path.iterdir())


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(), n_modes=2, remote_points=["right", "left"], progress=False)


def damped_chain():
    """Five masses on springs with dampers that couple the modes, and its state space."""
    n = 5
    springs = 1e5 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    dampers = np.diag([0.0, 30.0, 0.0, 5.0, 1.0])
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-springs, -dampers]])
    drives, shows = np.zeros((2 * n, 2)), np.zeros((3, 2 * n))
    drives[[n, 2 * n - 2], [0, 1]] = 1.0
    shows[[0, 1, 2], [1, 4, n + 2]] = 1.0
    direct = np.zeros((3, 2))
    return LinearModel(state, drives, shows, direct, ("a", "b"), ("x", "y", "v"))


@pytest.mark.parametrize("order", [0, 1])
def test_programs_of_linear_models_step_exactly(order):
    """Against SciPy's steps, with inputs that do not start at zero."""
    model, noise = damped_chain(), np.random.default_rng(2).normal(size=(2, 50))
    time = STEP * np.arange(50)
    _, expected, _ = scipy.signal.lsim(model.matrices, noise.T, time, interp=bool(order))
    found = run_program(step_program(model, STEP, hold_order=order), noise)
    np.testing.assert_allclose(found, expected.T, atol=1e-12 * np.abs(expected).max())
    if order == 0:
        program = step_program(sampled(model, 1 / STEP))
        assert run_program(program, noise, precision=np.float32).dtype == np.float32
        assert program.time_step == pytest.approx(STEP, rel=1e-15)
        np.testing.assert_allclose(run_program(program, noise), expected.T, atol=1e-12 * np.abs(expected).max())


def test_programs_leave_out_what_swings_beyond_half_the_sample_rate_and_beyond_the_mesh():
    """Two oscillators of unit stiffness: one follows its input at once, the other swings."""
    state, places = np.zeros((4, 4)), ([0, 1], [2, 3])
    noise = np.random.default_rng(4).normal(size=(1, 30))
    frequencies = np.array([0.55, 0.45]) / STEP
    for place, omega in zip(places, 2 * np.pi * frequencies, strict=True):
        state[np.ix_(place, place)] = [[0.0, 1.0], [-(omega**2), 0.0]]
    drives, shows = -state[:, [0]] - state[:, [2]], np.eye(4)[[0, 2]]
    unsupported = np.repeat(frequencies, 2)
    model = LinearModel(state, drives, shows, np.zeros((2, 1)), ("u",), ("high", "low"), unsupported=unsupported)
    high, low = run_program(step_program(model, STEP, hold_order=1), noise)
    np.testing.assert_allclose(high, noise[0], atol=1e-12)
    assert np.abs(low - noise[0]).max() > 1.0


def test_states_become_uncoupled_and_outputs_stay():
    model = damped_chain()
    for order in (0, 1):
        program = replace(step_program(model, STEP, hold_order=order), start=np.linspace(-1.0, 2.0, 10))
        other = uncoupled_steps(program)
        assert np.count_nonzero(program.samples[0].state) == 100
        assert np.count_nonzero(other.samples[0].state) == 20
        noise = np.random.default_rng(1).normal(size=(2, 2000))
        assert largest_error(run_program(other, noise), run_program(program, noise)) < 1e-12
    holder = Loop("holder", proportional(2e4, sample_rate=1 / STEP, limit=5.0, delay=0), "tower/gap", "2nd force")
    scene = replace(hanging(), loops=(holder,))
    closed = scene_program(scene, STEP)
    other, plant = uncoupled_steps(closed), (slice(closed.commands.start),) * 2
    assert np.count_nonzero(other.samples[0].state[plant]) < np.count_nonzero(closed.samples[0].state[plant])
    inputs = excited(scene)
    assert largest_error(run_program(other, inputs), run_program(closed, inputs)) < 1e-12
    nearly_equal = [[-1.0, 1.0, 0.0], [0.0, -1.00001, 1.0], [0.0, 0.0, -3.0]]
    program = step_program(LinearModel(nearly_equal, np.eye(3)[:, 2:], np.eye(3)[:1], [[0.0]], ("u",), ("y",)), 0.1)
    assert largest_error(run_program(uncoupled_steps(program), noise[:1]), run_program(program, noise[:1])) < 1e-12
    rates = uncoupled_rates(rate_program(model))
    a, b, c, _ = rates.matrices
    assert np.count_nonzero(a) == 20
    s = 2j * np.pi * 37.0
    expected = model.C @ np.linalg.solve(s * np.eye(10) - model.A, model.B)
    np.testing.assert_allclose(c @ np.linalg.solve(s * np.eye(10) - a, b), expected, rtol=1e-10)


def test_eigenvectors_are_refined_to_the_last_digits():
    """Of a chain of springs without damping: 2 sqrt(k / m) sin(r pi / 2 (n + 1)) and sin(r j pi / (n + 1))."""
    n, k = 40, 1e5
    springs = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    state, scale = balanced_states(np.block([[np.zeros((n, n)), np.eye(n)], [-springs, np.zeros((n, n))]]))
    poles, vectors = refined_eigenvectors(state)
    order, numbers = np.argsort(poles.imag)[n:], np.arange(1, n + 1)
    expected = 2 * np.sqrt(k) * np.sin(numbers * np.pi / (2 * n + 2))
    np.testing.assert_allclose(poles[order].imag, expected, rtol=2e-15)
    assert np.abs(poles.real).max() < 1e-20 * expected.max()
    left = np.abs(state.astype(np.longdouble) @ vectors - vectors * poles)
    assert left.max() < 1e-16 * expected.max()
    shapes = np.sin(np.outer(numbers, numbers) * np.pi / (n + 1))
    cosines = np.abs(np.sum((scale[:n, None] * vectors[:n, order]) * shapes, axis=0))
    sizes = np.linalg.norm(scale[:n, None] * vectors[:n, order], axis=0) * np.linalg.norm(shapes, axis=0)
    np.testing.assert_allclose(cosines, sizes, rtol=1e-14)


def test_tables_tell_their_size():
    """Four bytes for each index, eight for each number."""
    matrices = np.zeros((2, 3, 5))
    matrices[0, [0, 2, 2], [1, 0, 4]], matrices[1, 1, 2] = [1.5, -2.0, 3.0], 7.0
    tables = CTables.of("table", matrices, CNumbers("double"))
    sizes = re.findall(r"const (int|real) \w+\[(\d+)\]", tables.text)
    assert len(sizes) == 6
    assert tables.bytes == sum({"int": 4, "real": 8}[kind] * int(n) for kind, n in sizes)


def test_programs_hold_inputs_or_join_them_by_lines():
    with pytest.raises(ValueError, match="hold_order must be 0 or 1, got 2"):
        scene_program(hanging(), STEP, hold_order=2)


def test_states_that_cannot_be_uncoupled_stay():
    """A mass that a constant force drives: its three states are one Jordan block."""
    state = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    to_x, to_z, blocks = block_diagonal(state)
    np.testing.assert_array_equal(blocks, state)
    np.testing.assert_array_equal(to_x @ to_z, np.eye(3))


def test_continuous_programs_hold_loads_and_leave_out_modes_beyond_the_mesh():
    scene = hanging()
    rates = scene_rates(scene)
    a, _, c, _ = rates.matrices
    assert np.abs(a @ rates.start).max() < 1e-9 * np.abs(a).max() * np.abs(rates.start).max()
    sag = c @ rates.start
    assert sag[:2] == pytest.approx([-6 * 9.81 / 4e5, -2 * 9.81 / 4e5], rel=1e-9)
    model = linearize(scene)
    unsupported = np.r_[np.zeros(1), 900.0, 0.0, 900.0]
    left = rate_program(replace(model, unsupported=unsupported)).matrices
    assert len(left[0]) == len(model.A) - 2
    still = model.C @ np.linalg.solve(-model.A, model.B)
    np.testing.assert_allclose(left[2] @ np.linalg.solve(-left[0], left[1]) + left[3], still, atol=1e-12)


def test_converters_round_to_even_and_stop_at_their_largest_count():
    values = np.array([0.5, 1.5, 2.5, -0.5, 7.3, -9.9, np.nan])
    found = Converter(1.0, 5.7)(values)
    np.testing.assert_array_equal(found, [0.0, 2.0, 2.0, -0.0, 5.0, -5.0, np.nan])
    np.testing.assert_array_equal(Converter(0.0, 5.7)(values), [0.5, 1.5, 2.5, -0.5, 5.7, -5.7, np.nan])
