"""Controllers as linear models with their delay, and linear models as controllers."""

import math

import numpy as np
import scipy

from nassim.base.checks import of_kind, positive, whole_number
from nassim.systems.controllers import Controller
from nassim.systems.linear_model import LinearModel, Names, names
from nassim.systems.state_space import StateSpace, cascade, inverse_tustin, tustin

DELAY_ORDER = 4
RELATIVE_ROUNDING = 1e-9


def controller_model(
    controller: Controller,
    *,
    inputs: Names,
    outputs: Names,
    time_step: float | None = None,
    delay_order: int = DELAY_ORDER,
) -> LinearModel:
    """Return a controller with its delay, and without its limit, as a linear model.

    Args:
        controller: the controller.
        inputs: names of the signals that the controller measures.
        outputs: names of the signals that the controller drives.
        time_step: time step of the controller, for a sampled model with the delay as states; None for the continuous
            equivalent by the inverse of Tustin's rule [s].
        delay_order: order of Pade's approximation to the delay plus half a sample of the hold in the continuous
            equivalent; 0 omits both.

    Raises:
        ValueError: when the number of names differs from the number of signals, when the time step is not that of the
            controller, and for a pole at z = -1 in the continuous case.
    """
    of_kind("controller", controller, Controller, "of a Loop take its linear_controller")
    inputs, outputs = names("controller's input", inputs), names("controller's output", outputs)
    if controller.D.shape != (len(outputs), len(inputs)):
        n_out, n_in = controller.D.shape
        raise ValueError(
            f"the controller has {n_in} input(s) and {n_out} output(s), but is to measure {', '.join(inputs)} "
            f"and to drive {', '.join(outputs)}"
        )
    check_time_step(time_step, controller)
    delay_order = whole_number("delay_order", delay_order, 0)
    period = 1 / controller.sample_rate
    if time_step is not None:
        system, late = controller.matrices, _shift(controller.delay)
    else:
        system = inverse_tustin(controller.matrices, period)
        late = _pade((controller.delay + 0.5) * period, delay_order)
    each = np.eye(len(outputs))
    a, b, c, d = (np.kron(part, each) for part in late)
    return LinearModel(*cascade(system, (a, b, c, d)), inputs, outputs, time_step=time_step)


def controller_from_model(
    model: LinearModel, *, sample_rate: float, delay: int = 1, limit: float = math.inf
) -> Controller:
    """Return a linear model, such as the result of a synthesis, as a controller u = excitation + K y.

    Args:
        model: K; a continuous one is sampled by Tustin's rule, a sampled one must have the controller's time step.
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.

    Raises:
        ValueError: for another time step than that of `sample_rate`.
    """
    period = 1 / positive("sample_rate", sample_rate, "Hz")
    if model.time_step is None:
        matrices = tustin(model.matrices, period)
    elif abs(model.time_step / period - 1) > RELATIVE_ROUNDING:
        raise ValueError(f"the model's time step, {model.time_step:g} s, is not the sample rate's, {period:g} s")
    else:
        matrices = model.matrices
    return Controller(*matrices, sample_rate, delay=delay, limit=limit)


def check_time_step(time_step: float | None, controller: Controller) -> None:
    """Raise ValueError for a sampled model whose time step is not that of the controller."""
    if time_step is not None and abs(time_step * controller.sample_rate - 1) > RELATIVE_ROUNDING:
        raise ValueError(
            f"the model is sampled at {1 / time_step:g} Hz and the controller at {controller.sample_rate:g} Hz; "
            "sample the model at the controller's rate"
        )


def _shift(delay: int) -> StateSpace:
    """Return the state space of a delay of whole samples, for one signal."""
    first, last = np.eye(1, delay), np.eye(1, delay, delay - 1)
    return np.eye(delay, k=-1), first.T, last, np.full((1, 1), float(delay == 0))


def _pade(delay: float, order: int) -> StateSpace:
    """Return Pade's approximation of equal orders to a delay [s], for one signal; order 0 is no delay.

    Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed. (2013), sec. 9.3.
    """
    if order == 0:
        return _shift(0)
    # Coefficients of rising powers of s times the delay, which keeps the numbers near 1.
    weights = [1.0]
    for k in range(order):
        weights.append(weights[-1] * (order - k) / ((2 * order - k) * (k + 1)))
    falling = np.array(weights[::-1])
    a, b, c, d = scipy.signal.tf2ss(falling * (-1.0) ** np.arange(order, -1, -1), falling)
    return a / delay, b / delay, c, d
