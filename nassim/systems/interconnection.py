"""Models connected by the names of their signals, and weighting filters."""

import math

import numpy as np
import scipy

from nassim.base.checks import finite_array, known, positive, unique, whole_number
from nassim.base.field_types import ArrayLike
from nassim.systems.linear_model import LinearModel, Names, names
from nassim.systems.state_space import StateSpace, cascade, sizes_without_units

ROUNDING = 1e-9


def interconnect(*models: LinearModel, inputs: Names, outputs: Names) -> LinearModel:
    """Connect models: an input of one that has the name of an output of another, or of its own, takes this output.

    Inputs of equal names are one input. An input that is named in `inputs` and has the name of an output takes the sum
    of both. Inputs that are neither connected nor named are zero.

    Args:
        models: linear models, all continuous or all with one time step; `static_gain` connects to either.
        inputs: inputs of the result.
        outputs: outputs of the result.

    Returns:
        Model with the states of all models in their order, and with their `unsupported` modes.

    Raises:
        ValueError: for unknown names, for outputs with one name, for different time steps, and where direct feedthrough
            around a loop leaves no solution.
    """
    if not models:
        raise ValueError("interconnect needs at least one model")
    # A model without states that is not sampled, such as a sum of signals, is the same at any time step.
    steps = {model.time_step for model in models if len(model.A) or model.time_step is not None}
    if len(steps) > 1:
        raise ValueError(f"models to connect must have one time step, got {sorted(map(str, steps))}")
    all_inputs = [name for model in models for name in model.inputs]
    all_outputs = unique("output", (name for model in models for name in model.outputs))
    units = [unit for model in models for unit in model.units]
    a, b, c, d = (scipy.linalg.block_diag(*part) for part in zip(*(m.matrices for m in models), strict=True))
    external = [known("input", name, all_inputs) for name in names("input", inputs)]
    rows = [all_outputs.index(known("output", name, all_outputs)) for name in names("output", outputs)]
    enter = np.array([[float(name == given) for given in external] for name in all_inputs])
    join = np.array([[float(name == given) for given in all_outputs] for name in all_inputs])
    loop = np.eye(len(all_inputs)) - join @ d
    sizes = sizes_without_units(loop)
    if sizes[-1] < ROUNDING * max(1.0, sizes[0]):
        raise ValueError("the direct feedthrough around a loop is 1, so that the loop has no solution")
    from_states, from_inputs = np.linalg.solve(loop, join @ c), np.linalg.solve(loop, enter)
    return LinearModel(
        a + b @ from_states,
        b @ from_inputs,
        (c + d @ from_states)[rows],
        (d @ from_inputs)[rows],
        tuple(external),
        tuple(all_outputs[row] for row in rows),
        tuple(units[row] for row in rows),
        next(iter(steps), None),
        np.concatenate([np.pad(m.unsupported, (0, len(m.A) - len(m.unsupported))) for m in models]),
    )


def static_gain(matrix: ArrayLike, *, inputs: Names, outputs: Names) -> LinearModel:
    """Return a model without states, such as a sum of signals for `interconnect`.

    Args:
        matrix: gains, (outputs, inputs).
        inputs: names of the inputs.
        outputs: names of the outputs.
    """
    given, taken = names("output", outputs), names("input", inputs)
    gains = finite_array("matrix", matrix, (len(given), len(taken)))
    return LinearModel(np.zeros((0, 0)), np.zeros((0, len(taken))), np.zeros((len(given), 0)), gains, taken, given)


def weighting_filter(
    frequency: float, *, low: float, high: float, gain: float = 1.0, order: int = 1, name: str = "weight"
) -> LinearModel:
    """Return a weight with given gains at low and high frequency and a slope of an order in between.

    W(s) = ((a s + (low/gain)^(1/n)) / (high^(-1/n) a s + gain^(-1/n)))^n, where n is the order and a follows from
    |W(j w)| = gain.

    Args:
        frequency: w / 2 pi [Hz].
        low: gain at zero frequency.
        high: gain at high frequency. One of low and high must lie above `gain` and the other below.
        gain: gain at `frequency`.
        order: order n of the filter.
        name: name of its input; its output is "weighted" and this name.

    Returns:
        Model with one input and one output.

    Raises:
        ValueError: for gains that are not in order, and for an order that is not a whole number from 1 on.

    Source: T. Dehaeze, M. Vermat, C. Collette, Complementary filters shaping using H-infinity synthesis, International
        Conference on Control, Mechatronics and Automation (2019).
    """
    omega = 2 * np.pi * positive("frequency", frequency, "Hz")
    low, high, gain = positive("low", low), positive("high", high), positive("gain", gain)
    if not (low < gain < high or low > gain > high):
        raise ValueError(f"gain must lie between low and high, got low {low:g}, gain {gain:g}, high {high:g}")
    power = 1 / whole_number("order", order, 1)
    a = math.sqrt((1 - (low / gain) ** (2 * power)) / (1 - (gain / high) ** (2 * power))) / omega
    # One factor (a s + b) / (c s + d) has the pole -d/c and the gain a/c at high frequency.
    b, c, d = (low / gain) ** power, high**-power * a, gain**-power
    factor: StateSpace = (
        np.array([[-d / c]]),
        np.ones((1, 1)),
        np.array([[(b - a * d / c) / c]]),
        np.array([[a / c]]),
    )
    system = factor
    for _ in range(int(order) - 1):
        system = cascade(system, factor)
    return LinearModel(*system, (name,), (f"weighted {name}",))
