"""To and from python-control, exactly; and what is said without it."""

import sys
from importlib.util import find_spec

import numpy as np
import pytest
import scipy.signal

from nassim.systems.control_conversion import controller_from_control, model_from_control, to_control
from nassim.systems.controllers import integral_force_feedback
from nassim.systems.linear_model import LinearModel, frequency_response, sampled

pytestmark = pytest.mark.skipif(find_spec("control") is None, reason="needs python-control: pip install control")
RATE = 2000.0


def random_model(**options):
    random = np.random.default_rng(3)
    a, b, c, d = (random.normal(size=shape) for shape in ((5, 5), (5, 2), (3, 5), (3, 2)))
    return LinearModel(a, b, c, d, ("force", "voltage"), ("x", "y", "charge"), **options)


@pytest.mark.parametrize("time_step", [None, 1e-3])
def test_models_go_there_and_back_exactly(time_step):
    model = random_model(time_step=time_step)
    system = to_control(model)
    assert system.dt == (time_step or 0)
    assert (system.input_labels, system.output_labels) == (list(model.inputs), list(model.outputs))
    back = model_from_control(system)
    assert (back.inputs, back.outputs, back.time_step) == (model.inputs, model.outputs, time_step)
    assert all(np.array_equal(a, b) for a, b in zip(back.matrices, model.matrices, strict=True))


def test_both_agree_on_frequency_response_and_sampling():
    model, frequency = random_model(), np.array([0.1, 0.4, 3.0])
    discrete = sampled(model, 20.0)
    theirs = to_control(model).sample(1 / 20.0, method="zoh")
    for ours, other in ((model, to_control(model)), (discrete, theirs)):
        values = other(np.exp(2j * np.pi * frequency / 20) if other.dt else 2j * np.pi * frequency)
        assert frequency_response(ours, frequency).values == pytest.approx(values, rel=1e-9)


def test_controllers_from_transfer_functions():
    import control

    formula = integral_force_feedback(30.0, sample_rate=RATE, corner_frequency=5.0, delay=2, limit=3.0)
    taken = controller_from_control(control.tf([-30.0], [1.0, 2 * np.pi * 5.0]), sample_rate=RATE, delay=2, limit=3.0)
    assert (taken.delay, taken.limit, taken.sample_rate) == (2, 3.0, RATE)
    for a, b in zip(taken.matrices, formula.matrices, strict=True):
        assert a == pytest.approx(b, rel=1e-12)


def test_controllers_from_state_space():
    import control

    model = random_model()
    matrices = scipy.signal.cont2discrete(model.matrices, 1 / RATE, method="bilinear")[:4]
    continuous = controller_from_control(to_control(model), sample_rate=RATE)
    same_rate = controller_from_control(control.ss(*matrices, 1 / RATE), sample_rate=RATE)
    any_rate = controller_from_control(control.ss(*matrices, True), sample_rate=RATE)
    for taken in (same_rate, any_rate):
        assert all(np.array_equal(a, b) for a, b in zip(taken.matrices, matrices, strict=True))
    # States may be scaled otherwise; what the controller does is the same.
    z = np.exp(2j * np.pi * np.array([0.003, 0.2, 0.46]))
    expected = control.ss(*matrices, 1 / RATE)(z)
    assert control.ss(*continuous.matrices, 1 / RATE)(z) == pytest.approx(expected, rel=1e-10)
    constant = control.tf([2.0], [4.0])  # without a time step
    assert controller_from_control(constant, sample_rate=RATE).D.item() == model_from_control(constant).D.item() == 0.5


def test_wrong_systems_are_named():
    import control

    matrices = random_model().matrices
    with pytest.raises(ValueError, match=r"0\.001 s, is not the sample rate's, 0\.0005 s"):
        controller_from_control(control.ss(*matrices, 1e-3), sample_rate=RATE)
    with pytest.raises(ValueError, match=r"1 s, is not the sample rate's, 0\.0005 s"):  # and not True, which equals 1
        controller_from_control(control.ss(*matrices, 1.0), sample_rate=RATE)
    for take in (model_from_control, lambda system: controller_from_control(system, sample_rate=RATE)):
        with pytest.raises(ValueError, match="unspecified"):
            take(control.ss(*matrices, None))
        with pytest.raises(ValueError, match="StateSpace or TransferFunction, got float"):
            take(1.0)
        with pytest.raises(ValueError, match="non-proper"):
            take(control.tf([1.0, 0.0], [1.0]))
        with pytest.raises(ValueError, match="several transfer functions at once; give a StateSpace"):
            take(control.tf([[[1.0], [2.0]]], [[[1.0, 1.0], [1.0, 2.0]]]))
    with pytest.raises(ValueError, match="unspecified"):
        model_from_control(control.ss(*matrices, True))


def test_without_python_control_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    for use in (lambda: to_control(random_model()), lambda: model_from_control(object())):
        with pytest.raises(ImportError, match=r'pip install "nassim\[control\]"'):
            use()


def test_dots_in_names_become_underscores():
    model = LinearModel(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), ("force",), ("payload.z",))
    assert to_control(model).output_labels == ["payload_z"]


def test_names_that_become_one_are_refused():
    with pytest.raises(ValueError, match="python-control's input names must differ; used more than once: top_x"):
        to_control(LinearModel([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]], ("top.x", "top_x"), ("y",)))
