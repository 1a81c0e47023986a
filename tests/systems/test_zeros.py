"""Zeros of linear models against closed forms, structures held still, published numbers, SciPy and python-control."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal

from nassim.systems.control_conversion import to_control
from nassim.systems.linear_model import LinearModel, frequency_response, sampled, zeros
from nassim.systems.state_space import cascade, transmission_zeros


def platform(speed, *, damping=0.05, share=0.0):
    """A unit mass on two unit springs at right angles in a frame that turns at `speed` [rad/s], each with an actuator.

    Its force sensor carries the actuator and the spring but a share of it, which stands in parallel to both. Source:
    T. Dehaeze, C. Collette, Active damping of rotating platforms using integral force feedback, Engineering Research
    Express 3 (2021) 015036.
    """
    eye, turn = np.eye(2), np.array([[0.0, 1.0], [-1.0, 0.0]])
    state = np.block([[np.zeros((2, 2)), eye], [-(1 - speed**2) * eye, -damping * eye + 2 * speed * turn]])
    sensor = np.hstack([-(1 - share) * eye, -damping * eye])
    return LinearModel(state, np.vstack([np.zeros((2, 2)), eye]), sensor, eye, ("Fu", "Fv"), ("fu", "fv"), ("N", "N"))


def same(found, expected, rel):
    """Whether complex numbers are the same, in any order, each to a share of its own size."""
    found, expected = np.asarray(found), np.asarray(expected)
    if len(found) != len(expected):
        return False
    error = np.abs(found[:, None] - expected) / np.abs(expected)
    return error[scipy.optimize.linear_sum_assignment(error)].max(initial=0.0) < rel


def both_signs(*values):
    return [sign * value for value in values for sign in (1, -1)]


def test_rotating_platform_has_the_published_poles_and_zeros():
    one = {"inputs": "Fu", "outputs": "fu"}
    assert same(zeros(platform(0.1), **one), [-0.025009 + 1.014392j, -0.025009 - 1.014392j, 0.098067, -0.098048], 1e-5)
    for speed, expected in (
        (0.1, [-0.027501 + 1.099691j, -0.022499 + 0.899691j]),
        (0.7, [-0.042503 + 1.699841j, -0.007497 + 0.299841j]),
    ):
        assert same(platform(speed).poles(), [*expected, *np.conj(expected)], 1e-4)
    assert np.abs(platform(1.1).poles() - (0.002498 + 0.099934j)).min() < 1e-6
    static = frequency_response(platform(0.1), np.array([0.0])).response("fu", "Fu")[0]
    assert -static == pytest.approx(0.01 / 0.99, rel=1e-9), "the sensor is drawn by the centrifugal force"


@pytest.mark.parametrize("speed", [0.1, 0.35, 0.9])
def test_rotating_platform_in_closed_form(speed):
    root = np.sqrt(8 * speed**2 + 1) / 2
    one = both_signs(np.sqrt(root - speed**2 - 0.5), 1j * np.sqrt(root + speed**2 + 0.5))
    assert same(zeros(platform(speed, damping=0.0), inputs=["Fv"], outputs=["fv"]), one, 1e-9)
    for share in (0.05, 0.5):
        both = both_signs(1j * (np.sqrt(share) + speed), 1j * (np.sqrt(share) - speed))
        assert same(zeros(platform(speed, share=share)), both, 1e-9)


def chain(masses, springs, damping):
    """Mass, stiffness and damping of masses in a row, the first on the ground; damping: per stiffness [s]."""
    links = np.eye(len(masses)) - np.eye(len(masses), k=-1)
    stiffness = links.T @ np.diag(springs) @ links
    return np.diag(masses), stiffness, damping * stiffness


def first_order(mass, stiffness, damping):
    n = len(mass)
    return np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )


def pushed(matrices, driven, read, *, modal=False, rates=False, transform=None):
    """Model of forces on some masses to displacements, or velocities, of some, in physical or modal coordinates."""
    n = len(matrices[0])
    shapes = scipy.linalg.eigh(matrices[1], matrices[0])[1] if modal else np.eye(n)
    if transform is not None:
        shapes = shapes @ transform
    state = first_order(*(shapes.T @ matrix @ shapes for matrix in matrices))
    forces = np.linalg.solve(shapes.T @ matrices[0] @ shapes, shapes.T[:, driven])
    nothing, readings = np.zeros((len(read), n)), shapes[read]
    return LinearModel(
        state,
        np.vstack([np.zeros_like(forces), forces]),
        np.hstack([nothing, readings] if rates else [readings, nothing]),
        np.zeros((len(read), len(driven))),
        tuple(f"f{k}" for k in driven),
        tuple(f"y{k}" for k in read),
    )


@pytest.mark.parametrize("modal", [False, True])
@pytest.mark.parametrize("held", [[0], [6], [0, 6], [1, 2, 5]])
def test_zeros_are_the_poles_with_what_is_read_held_still(held, modal):
    random = np.random.default_rng(3)
    matrices = chain(random.uniform(0.5, 2.0, 7), random.uniform(1e2, 1e6, 7), 1e-5)
    model = pushed(matrices, held, held, modal=modal, transform=np.diag(10.0 ** random.uniform(-2, 2, 7)))
    free = np.setdiff1d(range(7), held)
    expected = np.linalg.eigvals(first_order(*(matrix[np.ix_(free, free)] for matrix in matrices)))
    assert same(zeros(model), expected, 1e-8)
    # Read in other units, or as velocities: the same, and one zero at rest for every reading.
    units = np.array([1e9, 1e-3, 40.0])[: len(held), None]
    scaled = LinearModel(model.A, 1e-6 * model.B, units * model.C, 1e-6 * units * model.D, model.inputs, model.outputs)
    assert same(zeros(scaled), expected, 1e-8)
    rates = zeros(pushed(matrices, held, held, modal=modal, rates=True))
    at_rest = np.abs(rates) < 1e-6 * np.abs(expected).min()
    assert at_rest.sum() == len(held)
    assert same(rates[~at_rest], expected, 1e-8)


@pytest.mark.parametrize("modal", [False, True])
@pytest.mark.parametrize("n", [3, 6, 10])
def test_a_chain_pushed_at_one_end_and_read_at_the_other_has_no_zero(n, modal):
    assert len(zeros(pushed(chain(np.ones(n), np.ones(n), 0.0), [0], [n - 1], modal=modal))) == 0


def wide_model(n):
    """Modes from 0.1 Hz to 1 MHz seen by one collocated pair, and its zeros.

    Without damping they solve sum phi^2 / (w^2 - x) = 0, one between two modes; with the damping alpha + beta w^2 of
    every mode each x gives s^2 + (alpha + beta x) s + x = 0.
    """
    random = np.random.default_rng(4)
    omega, shape = 2 * np.pi * np.geomspace(0.1, 1e6, n), random.uniform(0.3, 1.0, n)
    alpha, beta = 0.01, 1e-9
    zero = np.array([
        scipy.optimize.brentq(lambda x: np.sum(shape**2 / (omega**2 / x - 1)), low * (1 + 1e-14), high * (1 - 1e-14),
                              xtol=1e-300, rtol=1e-14)
        for low, high in zip(omega[:-1] ** 2, omega[1:] ** 2, strict=True)
    ])  # fmt: skip
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -np.diag(alpha + beta * omega**2)]])
    units = 10.0 ** random.uniform(-8, 8, n)  # of every mode's amplitude: a model says nothing about them
    forces, readings = np.concatenate([np.zeros(n), shape / units]), np.concatenate([shape * units, np.zeros(n)])
    model = LinearModel(state, forces[:, None], readings[None], np.zeros((1, 1)), ("f",), ("x",))
    return model, np.concatenate([np.roots([1.0, alpha + beta * x, x]) for x in zero])


@pytest.mark.parametrize("n", [5, 60, pytest.param(500, marks=pytest.mark.slow)])
def test_modes_from_a_tenth_of_a_hertz_to_a_megahertz(n):
    model, expected = wide_model(n)
    assert same(zeros(model), expected, 1e-8)


def random_model(n, m, *, direct):
    random = np.random.default_rng(n + m)
    a, b, c, d = (random.normal(size=shape) for shape in ((n, n), (n, m), (m, n), (m, m)))
    d[:, direct:] = 0.0
    signals = tuple(str(k) for k in range(m))
    return LinearModel(a, b, c, d, signals, signals)


@pytest.mark.parametrize(("n", "m", "direct"), [(6, 1, 0), (7, 2, 0), (7, 2, 1), (9, 3, 2), (12, 4, 4)])
def test_the_system_matrix_loses_rank_there(n, m, direct):
    """General matrices: n - m + the rank of D zeros, each a loss of rank; python-control finds the same."""
    model = random_model(n, m, direct=direct)
    found = zeros(model)
    assert len(found) == n - m + direct
    for zero in found:
        matrix = np.block([[model.A - zero * np.eye(n), model.B], [model.C, model.D]])
        assert np.linalg.svd(matrix, compute_uv=False)[-1] < 1e-10 * np.linalg.norm(matrix)
    control = pytest.importorskip("control")
    theirs = control.zeros(to_control(model))
    assert same(found, theirs[np.abs(theirs) < 1e3 * np.abs(found).max()], 1e-6)


def test_zeros_of_one_response_among_several_are_scipys():
    model = random_model(6, 3, direct=3)
    expected = scipy.signal.ss2zpk(model.A, model.B, model.C[[1]], model.D[[1]], input=2)[0]
    assert same(zeros(model, inputs="2", outputs="1"), expected, 1e-8)


def test_poles_that_nothing_drives_or_shows_are_zeros():
    """1/(s + 1) + 1/(s + 4) vanishes at -2.5; the third state, at -2, is not driven, or not seen."""
    state, some, every = np.diag([-1.0, -2.0, -4.0]), np.array([[1.0, 0.0, 1.0]]), np.ones((1, 3))
    for b, c in ((some.T, every), (every.T, some)):
        assert same(zeros(LinearModel(state, b, c, [[0.0]], ("u",), ("y",))), [-2.0, -2.5], 1e-10)


def test_zeros_of_sampled_models():
    """Of 1/s^2 and 1/s^3 behind a hold: z = -1, and -2 +- sqrt 3 (Astrom, Hagander, Sternby, Automatica 20 (1984))."""
    for n, expected in ((2, [-1.0]), (3, [-2 + np.sqrt(3), -2 - np.sqrt(3)])):
        steps = LinearModel(np.eye(n, k=1), np.eye(n)[:, -1:], np.eye(n)[:1], [[0.0]], ("u",), ("y",))
        found = zeros(sampled(steps, 100.0))
        assert same(np.exp(found / 100.0), expected, 1e-5)
    slow = platform(0.1)
    assert same(zeros(sampled(slow, 1e4), inputs="Fu", outputs="fu"), zeros(slow, inputs="Fu", outputs="fu"), 1e-3)


BAD = {
    "output": ({"outputs": "fx", "inputs": "Fu"}, "unknown output 'fx'; known: fu, fv"),
    "input": ({"outputs": "fu", "inputs": ["Fx"]}, "unknown input 'Fx'"),
    "not square": ({"outputs": "fu"}, "as many outputs as inputs, got 1 and 2"),
    "twice": ({"outputs": ["fu", "fu"]}, "used more than once"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named(case):
    names, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        zeros(platform(0.1), **names)


def test_a_response_that_vanishes_everywhere_has_no_zeros_to_tell():
    model = random_model(5, 2, direct=0)
    dependent = LinearModel(model.A, model.B, model.C[[0, 0]] * [[1.0], [3.0]], model.D, model.inputs, model.outputs)
    idle = LinearModel(model.A, model.B * [1.0, 0.0], model.C, model.D, model.inputs, model.outputs)
    apart = pushed(chain([1.0], [1.0], 0.0), [0], [0])
    unseen = LinearModel(apart.A, apart.B, np.zeros((1, 2)), apart.D, apart.inputs, apart.outputs)
    for singular in (dependent, idle, unseen):
        with pytest.raises(ValueError, match="every s is a zero"):
            zeros(singular)


@pytest.mark.parametrize("unit", [1.0, 1e7])
@pytest.mark.parametrize("share", [0.9, 1.1])
def test_feedthrough_below_two_parts_in_a_million_million_is_rounding(share, unit):
    """d + 1 / (s + 1) is zero at -1 - 1 / d, in any units."""
    direct = share * np.finfo(float).eps ** 0.75
    found = zeros(LinearModel([[-1.0]], [[unit]], [[1.0]], [[unit * direct]], ("u",), ("y",)))
    assert found == pytest.approx([-1 - 1 / direct] if share > 1 else [], rel=1e-6)


@pytest.mark.parametrize("size", [1.0, 1e6, 1e9])
def test_zeros_of_loops_in_metres_and_volts(size):
    """Three modes seen and driven at two places, behind lags (s + k) / (s + 50), in a unit of its own for each loop.

    Where both outputs stay zero, the one motion n across them is left: |n|^2 s^2 + n'(0.02 w n) s + n'(w^2 n) = 0.
    """
    omega, shapes = np.array([30.0, 50.0, 90.0]), np.array([[1.0, 0.3], [-0.4, 1.0], [0.5, 0.6]])
    unit = np.array([size, 1 / size])
    state = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(omega**2), -np.diag(0.02 * omega)]])
    plant = state, np.vstack([np.zeros((3, 2)), shapes]), unit[:, None] * np.hstack([shapes.T, np.zeros((2, 3))])
    lags = -50 * np.eye(2), np.eye(2), np.diag(np.array([5.0 - 50.0, 7.0 - 50.0]) / unit), np.diag(1 / unit)
    across = np.cross(*shapes.T)
    motion = np.roots([across @ across, across @ (0.02 * omega * across), across @ (omega**2 * across)])
    expected = np.array([*motion, -5.0, -7.0])
    found = transmission_zeros(cascade((*plant, np.zeros((2, 2))), lags))
    assert same(found, expected, 1e-7)
