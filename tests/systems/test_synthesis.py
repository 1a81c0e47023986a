"""H-infinity and H2 synthesis and LQG control, against closed forms, published figures and other controllers."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from nassim.systems import (
    LinearModel,
    close_loop,
    complementary_filters,
    controller_from_model,
    frequency_response,
    h2_complementary_filters,
    h2_norm,
    h2_synthesis,
    hinf_complementary_filters,
    hinf_norm,
    hinf_synthesis,
    interconnect,
    lqg,
    mixed_sensitivity,
    sampled,
    subsystem,
    weighting_filter,
)
from nassim.systems.riccati import care, check_regular

LOOP = {"measured": ["y1", "y2"], "driven": ["u1", "u2"]}


def scalar(a):
    """dx/dt = a x + w + u, with the errors x and u, and the measurement x + n."""
    return LinearModel(
        [[a]],
        [[1.0, 0.0, 1.0]],
        [[1.0], [0.0], [1.0]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        ("w", "n", "u"),
        ("x", "e", "y"),
    )


def general(seed, *, errors=False, through=False, a=None):
    """Five states; three disturbances and two drives; four errors and two measurements, with unequal feedthrough."""
    rng = np.random.default_rng(seed)
    d = np.zeros((6, 5))
    d[2:4, 3:] = [[1.3, 0.0], [0.2, 0.7]]
    d[4:, 1:3] = [[0.5, 0.0], [0.3, 0.9]]
    if errors:
        d[:4, :3] += 0.3 * rng.normal(size=(4, 3))
    if through:
        d[4:, 3:] = 0.4 * rng.normal(size=(2, 2))
    state = 30 * rng.normal(size=(5, 5)) if a is None else a
    names = ("w1", "w2", "w3", "u1", "u2"), ("z1", "z2", "z3", "z4", "y1", "y2")
    return LinearModel(state, rng.normal(size=(5, 5)), rng.normal(size=(6, 5)), d, *names)


@pytest.mark.parametrize("unit", [1.0, 1e-10, 1e-18, 1e12])
@pytest.mark.parametrize("a", [-2.0, 0.0, 0.7, 3.0])
def test_a_state_of_one_dimension_has_the_least_norms_of_its_quadratic_equations(a, unit):
    """2 a x + 1 - x^2 (1 - 1/g^2) = 0 is the Riccati equation of control and of estimation; at the best g, x = g.

    The errors have another unit, as those of displacements by forces.
    """
    least = 1.0 if a > 0 else (1 + a**2) ** -0.5
    best = scipy.optimize.brentq(lambda g: 1 / (np.sqrt(a**2 + 1 - g**-2) - a) - g, least * (1 + 1e-9), 1e3)
    sizes = np.array([[unit], [unit], [1.0]])
    plant = replace(scalar(a), C=sizes * scalar(a).C, D=sizes * scalar(a).D)
    found = hinf_synthesis(plant, measured="y", driven="u", tolerance=1e-6)
    assert best * (1 - 1e-6) < found.norm / unit < best * (1 + 2e-6)
    x = a + np.sqrt(a**2 + 1)  # both equations of H2, with q = 1
    optimal = h2_synthesis(plant, measured="y", driven="u")
    assert optimal.norm == pytest.approx(unit * np.sqrt(x + x**3), rel=1e-9)
    assert optimal.controller.A.item() == pytest.approx(a - 2 * x)


def test_complementary_filters_reach_the_published_norm():
    """T. Dehaeze, M. Vermat, C. Collette (2019): 1.0036, computed there to 0.001."""
    first = weighting_filter(11.0, low=0.1, high=1000.0, gain=0.5, order=2)
    second = weighting_filter(10.0, low=1000.0, high=0.1, gain=0.5, order=3)
    filters = hinf_complementary_filters(first, second)
    assert filters.norm == pytest.approx(1.0036, rel=1.5e-3)
    frequency = np.geomspace(1e-2, 1e4, 2000)
    h1, h2, w1, w2 = (
        frequency_response(model, frequency).values[0, 0] for model in (filters.first, filters.second, first, second)
    )
    assert h1 + h2 == pytest.approx(1.0)
    assert np.sqrt(np.abs(w1 * h1) ** 2 + np.abs(w2 * h2) ** 2).max() == pytest.approx(filters.norm, rel=1e-4)


@pytest.mark.parametrize("options", [{"through": True}, {"errors": True, "through": True}])
def test_closed_loops_keep_the_bound_and_no_controller_does_better(options):
    plant = general(4, **options)
    found = hinf_synthesis(plant, **LOOP, tolerance=1e-4)
    frequency = np.append(0.0, np.geomspace(1e-2, 1e5, 5_000))
    gains = np.linalg.svd(frequency_response(found.closed_loop, frequency).values.transpose(2, 0, 1), compute_uv=False)
    assert gains.max() == pytest.approx(found.norm, rel=1e-4)
    assert found.closed_loop.poles().real.max() < 0
    # The best loop amplifies alike at all frequencies up to those where errors cannot be influenced.
    assert gains[frequency < 1, 0].min() > 0.99 * found.norm
    assert (found.controller.inputs, found.controller.outputs) == (("y1", "y2"), ("u1", "u2"))
    if not options.get("errors"):
        rms = h2_synthesis(plant, **LOOP)
        assert h2_norm(found.closed_loop) > rms.norm
        assert hinf_norm(rms.closed_loop)[0] > found.norm
        rng = np.random.default_rng(0)
        ends = {"inputs": ["w1", "w2", "w3"], "outputs": ["z1", "z2", "z3", "z4"]}
        for _ in range(10):
            c = rms.controller.C * (1 + 1e-5 * rng.normal(size=(2, 5)))
            nearby = interconnect(plant, replace(rms.controller, C=c), **ends)
            assert h2_norm(nearby) > rms.norm


@pytest.mark.parametrize("seed", range(6))
def test_direct_feedthrough_of_the_drives_does_not_matter_to_the_least_rms(seed):
    """A controller knows what it drives and can subtract it from what it measures."""
    d = np.random.default_rng(seed).normal(size=(6, 5))
    d[:4, :3] = 0.0
    plant = replace(general(seed), D=d)
    d[4:, 3:] = 0.0
    found = h2_synthesis(plant, **LOOP)
    assert found.norm == pytest.approx(h2_synthesis(replace(plant, D=d), **LOOP).norm, rel=1e-6)
    assert not found.closed_loop.D.any()


def test_units_of_time_and_signals_do_not_matter():
    plant = general(5)
    into, out, rate = np.array([1, 1, 1, 1e4, 3e-5]), np.array([1, 1, 1, 1, 2e9, 1e-3]), 1e-4
    scaled = replace(plant, A=rate * plant.A, B=rate * plant.B * into, C=plant.C * out[:, None],
                     D=plant.D * into * out[:, None])  # fmt: skip
    for synthesis, factor in ((hinf_synthesis, 1.0), (h2_synthesis, np.sqrt(rate))):
        assert synthesis(scaled, **LOOP).norm == pytest.approx(factor * synthesis(plant, **LOOP).norm, rel=2e-3)


def stage():
    """Two masses on springs, a force on either, the first one's displacement with a small feedthrough, the second's."""
    m, c, k = np.diag([1.0, 3.0]), np.array([[30.0, -10], [-10, 10]]), np.array([[9e5, -4e5], [-4e5, 4e5]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(m, k), -np.linalg.solve(m, c)]])
    b = np.vstack([np.zeros((2, 2)), np.linalg.inv(m)])
    return LinearModel(a, b, np.eye(2, 4), [[2e-8, 0.0], [0.0, 0.0]], ("motor", "floor"), ("x1", "x2"), ("m", "m"))


SIZES = {
    "acceptable": {"x2": 1e-6, "x1": 5e-6},
    "effort": {"motor": 2.0},
    "disturbances": {"floor": 0.3, "motor": 0.01},
    "noise": {"x1": 1e-9, "x2": 2e-8},
}


def test_lqg_is_the_h2_controller_of_its_weights():
    model = stage()
    controller = lqg(model, **SIZES)
    scale = np.array([2.0, 1.0])  # the synthesis drives motor / 2 N
    d = np.zeros((5, 5))
    d[:2, 4], d[2, 4], d[3, 2], d[4, 3] = model.D[:, 0] * scale[0] / np.array([5e-6, 1e-6]), 1.0, 1e-9, 2e-8
    d[3:, 4] = model.D[:, 0] * scale[0]
    b = np.column_stack([0.3 * model.B[:, 1], 0.01 * model.B[:, 0], np.zeros((4, 2)), 2.0 * model.B[:, 0]])
    d[3:, 1] = 0.01 * model.D[:, 0]  # the motor's disturbance is measured at once too
    c = np.vstack([model.C / np.array([[5e-6], [1e-6]]), np.zeros((1, 4)), model.C])
    plant = LinearModel(model.A, b, c, d, ("w1", "w2", "n1", "n2", "u"), ("z1", "z2", "e", "y1", "y2"))
    expected = h2_synthesis(plant, measured=["y1", "y2"], driven="u").controller
    frequency = np.geomspace(1, 1e4, 50)
    found = frequency_response(controller, frequency)
    assert (found.outputs, found.inputs) == (("motor",), ("x1", "x2"))
    assert found.values == pytest.approx(2.0 * frequency_response(expected, frequency).values, rel=1e-6, abs=0)


def test_integrals_remove_the_offset_of_their_outputs_only():
    model = stage()
    for integral, outputs in (({"x2": 1e-7}, [False, True]), ({"x1": 1e-7}, [True, False])):
        closed = interconnect(model, lqg(model, **SIZES, integral=integral), inputs="floor", outputs=("x1", "x2"))
        assert closed.poles().real.max() < 0
        # The observer knows what the integrals drive: its poles are those of the Riccati equation without them.
        b, d = model.B * np.array([0.01, 0.3]), model.D * np.array([0.01, 0.3])
        noise, mixed = np.diag([1e-9, 2e-8]) ** 2 + d @ d.T, b @ d.T
        y = scipy.linalg.solve_continuous_are(model.A.T, model.C.T, b @ b.T, noise, s=mixed)
        observer = np.linalg.eigvals(model.A - np.linalg.solve(noise, model.C @ y + mixed.T).T @ model.C)
        # The other poles are those of a regulator that knows states and integrals.
        ((name, size),) = integral.items()
        shown, pushed = np.hstack([model.C, np.zeros((2, 1))]), model.D[:, :1]
        row = model.outputs.index(name)
        a = np.block([[model.A, np.zeros((len(model.A), 1))], [model.C[row], 0.0]])
        drive = np.append(model.B[:, 0], model.D[row, 0])[:, None]
        sizes = np.array([[SIZES["acceptable"].get(output, np.inf)] for output in model.outputs])
        cost = shown.T @ (shown / sizes**2) + np.diag([*np.zeros(len(model.A)), size**-2.0])
        effort = pushed.T @ (pushed / sizes**2) + SIZES["effort"]["motor"] ** -2.0
        cross = shown.T @ (pushed / sizes**2)
        x = scipy.linalg.solve_continuous_are(a, drive, cost, effort, s=cross)
        regulator = np.linalg.eigvals(a - drive @ np.linalg.solve(effort, drive.T @ x + cross.T))
        for pole in (*observer, *regulator):
            assert np.abs(closed.poles() - pole).min() < 1e-5 * abs(pole)
        static = closed.D[:, 0] - closed.C @ np.linalg.solve(closed.A, closed.B[:, 0])
        rigid = model.D[:, 1] - model.C @ np.linalg.solve(model.A, model.B[:, 1])
        assert [bool(abs(s) < 1e-9 * abs(r)) for s, r in zip(static, rigid, strict=True)] == outputs


def test_mixed_sensitivity_bounds_the_three_weighted_responses():
    model = stage()
    weights = {
        "performance": weighting_filter(60.0, low=300.0, high=0.5, order=1),
        "effort": weighting_filter(3e3, low=1e-8, high=1e-6, gain=1e-7),
        "robustness": weighting_filter(800.0, low=0.3, high=30.0, gain=1.0),
    }
    loop = {"measured": "x1", "driven": "motor"}
    found = mixed_sensitivity(model, **loop, **weights)
    frequency = np.geomspace(0.1, 1e5, 4000)
    g, k, w1, w2, w3 = (
        frequency_response(part, frequency).values[0, 0]
        for part in (subsystem(model, inputs="motor", outputs="x1"), found.controller, *weights.values())
    )
    s = 1 / (1 - g * k)
    stacked = np.sqrt(np.abs(w1 * s) ** 2 + np.abs(w2 * k * s) ** 2 + np.abs(w3 * (s - 1)) ** 2)
    assert stacked.max() == pytest.approx(found.norm, rel=1e-3)
    assert found.closed_loop.outputs == ("performance x1", "effort motor", "robustness x1")
    # Without the third weight the norm falls; a number is a weight too.
    two = {name: weights[name] for name in ("performance", "effort")}
    assert mixed_sensitivity(model, **loop, **two).norm < found.norm
    less = mixed_sensitivity(model, **loop, **{**two, "effort": 1e-7})
    assert less.closed_loop.outputs == ("performance x1", "effort motor")
    effort = frequency_response(less.closed_loop, frequency).response("effort motor", "disturbance at x1")
    k = frequency_response(less.controller, frequency).values[0, 0]
    assert effort == pytest.approx(1e-7 * k / (1 - g * k), rel=1e-6)


def test_a_tolerance_is_the_distance_from_the_least_norm():
    """In shares of it: also where the errors are small numbers, as displacements in metres are."""
    plant, small = general(4), np.array([1e-6] * 4 + [1.0] * 2)[:, None]
    first = weighting_filter(11.0, low=0.1, high=1000.0, gain=0.5, order=2)
    second = weighting_filter(10.0, low=1000.0, high=0.1, gain=0.5, order=3)
    bound = {
        "performance": weighting_filter(60.0, low=300.0, high=0.5),
        "effort": weighting_filter(3e3, low=1e-8, high=1e-6, gain=1e-7),
    }
    for synthesis in (
        lambda t: hinf_synthesis(plant, **LOOP, tolerance=t),
        lambda t: hinf_synthesis(replace(plant, C=small * plant.C, D=small * plant.D), **LOOP, tolerance=t),
        lambda t: hinf_complementary_filters(first, second, tolerance=t),
        lambda t: mixed_sensitivity(stage(), measured="x1", driven="motor", **bound, tolerance=t),
    ):
        loose, tight = synthesis(0.5).norm, synthesis(1e-4).norm
        assert 1.001 * tight < loose < 2.25 * tight
        for none in (-1.0, np.nan):
            with pytest.raises(ValueError, match="tolerance"):
                synthesis(none)


def test_a_synthesised_controller_is_sampled_and_closes_a_loop():
    model = stage()
    controller = lqg(model, **SIZES)
    continuous = interconnect(model, controller, inputs="floor", outputs="x2")
    digital = controller_from_model(controller, sample_rate=100e3, delay=0, limit=7.0)
    assert (digital.sample_rate, digital.delay, digital.limit) == (100e3, 0, 7.0)
    closed = close_loop(sampled(model, 100e3), digital, measured=["x1", "x2"], driven="motor")
    frequency = np.array([3.0, 80.0, 150.0])
    expected = frequency_response(continuous, frequency).response("x2", "floor")
    assert frequency_response(closed, frequency).response("x2", "floor") == pytest.approx(expected, rel=0.02)
    again = controller_from_model(sampled(controller, 1e3), sample_rate=1e3)
    assert np.array_equal(sampled(controller, 1e3).A, again.A)
    with pytest.raises(ValueError, match=r"time step, 0.001 s, is not the sample rate's, 0.002 s"):
        controller_from_model(sampled(controller, 1e3), sample_rate=500.0)


def test_closed_forms_of_complementary_filters():
    """With x = s/w: 1 / (x + 1), and (1 + 3 x) / (x + 1)^3."""
    frequency = np.array([0.4, 5.0, 60.0])
    x = 1j * frequency / 5.0
    for order, expected in ((1, 1 / (x + 1)), (2, (1 + 3 * x) / (x + 1) ** 3)):
        filters = complementary_filters(5.0, order=order)
        high, low = (frequency_response(h, frequency).values[0, 0] for h in (filters.first, filters.second))
        assert low == pytest.approx(expected)
        assert high == pytest.approx(1 - expected)
    n1, n2 = np.array([1.0, 2.0, 5.0]), np.array([4.0, 1.0, 0.5])
    assert filters.fused_noise(frequency, n1, n2) == pytest.approx(np.hypot(np.abs(high) * n1, np.abs(low) * n2))
    assert filters.fused_uncertainty(frequency, n1, n2) == pytest.approx(np.abs(high) * n1 + np.abs(low) * n2)


def test_no_filters_make_a_super_sensor_of_less_noise():
    drifting = LinearModel([[-0.3]], [[1.0]], [[2.0]], [[0.0]], ("w",), ("n",))
    noisy = LinearModel([[-50.0]], [[1.0]], [[-40.0]], [[1.0]], ("w",), ("n",))
    filters = h2_complementary_filters(drifting, noisy)
    frequency = np.append(0.0, np.geomspace(1e-4, 1e5, 60_000))
    n1, n2 = (np.abs(frequency_response(n, frequency).values[0, 0]) for n in (drifting, noisy))

    def rms(pair):  # of noises with a two-sided density of 1 unit^2/Hz
        return np.sqrt(2 * scipy.integrate.trapezoid(pair.fused_noise(frequency, n1, n2) ** 2, frequency))

    assert rms(filters) == pytest.approx(filters.norm, rel=1e-3)
    crossings = [rms(complementary_filters(f, order=1)) for f in np.geomspace(0.01, 10, 30)]
    assert filters.norm < min(crossings)
    assert min(crossings) < 1.3 * filters.norm


UNSEEN = np.diag([-1.0, -2.0, -3.0, -4.0, 5.0])


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"time_step": 0.1}, {}, "synthesis needs a continuous model, got one sampled every 0.1 s"),
        ({}, {"driven": ["u1", "u2", "w1", "w2", "w3"]}, "at least one disturbance"),
        ({}, {"measured": "q"}, "unknown output 'q'"),
        (
            {"D": np.where(np.arange(6)[:, None] < 4, 0.0, 1.0) * general(0).D},
            {},
            "every driven input must have its own",
        ),
        (
            {"D": np.where(np.arange(6)[:, None] < 4, 1.0, 0.0) * general(0).D},
            {},
            "every measured output must have its own",
        ),
        (
            {"A": UNSEEN, "B": np.vstack([general(0).B[:4], np.zeros((1, 5))])},
            {},
            "a drift that no driven inputs stabilise",
        ),
        ({"A": UNSEEN, "C": np.hstack([general(0).C[:, :4], np.zeros((6, 1))])}, {}, "no measured outputs stabilise"),
    ],
)
def test_plants_that_the_methods_exclude(change, options, message):
    plant = replace(general(0), **change)
    for synthesis in (hinf_synthesis, h2_synthesis):
        with pytest.raises(ValueError, match=message):
            synthesis(plant, **{**LOOP, **options})


@pytest.mark.parametrize("apart", [1e-6, 0.0])
def test_what_rounding_hides_from_a_controller_is_told(apart):
    """Two growing motions that differ by a millionth, or one with hardly any drive: in theory a controller exists."""
    plant = replace(scalar(1.0), B=[[1.0, 0.0, 1e-14]])
    if apart:
        twin = np.ones((2, 1))
        plant = replace(
            scalar(1.0), A=np.diag([1.0, 1.0 + apart]), B=twin * [1.0, 0.0, 1.0], C=[[1, 0], [0, 0], [1, 1]]
        )
    for synthesis in (hinf_synthesis, h2_synthesis):
        with pytest.raises(ValueError, match="rounding"):
            synthesis(plant, measured="y", driven="u")


def test_a_plant_without_states_has_the_best_gain():
    """x = w + u, e = u / 2, y = w + 0.3 n: the gain that SciPy finds."""
    nothing = np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0))
    direct = [[1, 0, 1], [0, 0, 0.5], [1, 0.3, 0]]
    found = hinf_synthesis(
        LinearModel(*nothing, direct, ("w", "n", "u"), ("x", "e", "y")), measured="y", driven="u", tolerance=1e-9
    )
    best = scipy.optimize.minimize_scalar(lambda k: np.linalg.norm([[1 + k, 0.3 * k], [0.5 * k, 0.15 * k]], 2))
    assert found.norm == pytest.approx(best.fun, rel=1e-6)
    assert pytest.approx(best.x, rel=2e-3) == found.controller.D


@pytest.mark.parametrize("unit", [1.0, 1e-12, 1e12])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_zeros_on_the_imaginary_axis_are_refused_with_their_own_feedthrough(sign, unit):
    """x' = A x + B u, y = C x + u: where y stays zero, u = -C x, so that zeros are the poles of A - B C."""
    zeros, b, c = np.array([[0.0, 1.0], [-9.0, 0.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 2.0]])
    plant = zeros + sign * b @ c, b * unit, c, np.eye(1) * unit
    if sign > 0:
        with pytest.raises(ValueError, match="an oscillation that no errors notice"):
            check_regular(*plant, "inputs", "errors")
    else:  # these zeros are damped
        check_regular(*plant, "inputs", "errors")


def test_a_free_motion_needs_a_disturbance_that_moves_it():
    free = LinearModel([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]], ("u",), ("y",))
    with pytest.raises(ValueError, match="a drift that no disturbances notice"):
        mixed_sensitivity(free, measured="y", driven="u", performance=weighting_filter(1, low=9, high=0.1), effort=1.0)
    with pytest.raises(ValueError, match="a weight has one input and one output, got 1 and 2"):
        mixed_sensitivity(
            stage(), measured="x1", driven="motor", performance=subsystem(stage(), inputs="motor"), effort=1
        )
    with pytest.raises(ValueError, match="direct feedthrough from a disturbance to an error"):
        h2_synthesis(general(1, errors=True), **LOOP)
    with pytest.raises(ValueError, match="does not read x1"):
        lqg(stage(), **{**SIZES, "noise": {"x2": 1e-9}}, integral={"x1": 1.0})
    with pytest.raises(ValueError, match=r"needs a continuous model, got one sampled every 0\.001 s"):
        lqg(sampled(stage(), 1e3), **SIZES)
    for name in SIZES:
        with pytest.raises(ValueError, match="need at least one signal each"):
            lqg(stage(), **{**SIZES, name: {}})
    with pytest.raises(ValueError, match="order must be a whole number of at least 1, got 0"):
        complementary_filters(5.0, order=0)


def test_a_riccati_equation_whose_eigenvalues_rounding_reorders_is_solved_without_balancing(monkeypatch):
    """Such failures, of one bound in hundreds, made norms several per cent too large."""
    solve = scipy.linalg.solve_continuous_are

    def fails_balanced(*args, balanced, **options):
        if balanced:
            raise ValueError("Reordering of (A, B) failed")
        return solve(*args, balanced=balanced, **options)

    monkeypatch.setattr(scipy.linalg, "solve_continuous_are", fails_balanced)
    one = np.eye(1)
    assert care(one, one, 3 * one, one, 0 * one)[0, 0] == pytest.approx(3.0)  # of 2 x - x^2 + 3 = 0
    assert care(one, 0 * one, one, one, 0 * one) is None
