"""Conversion of linear models and controllers to and from python-control, an optional dependency."""

import math
from typing import Any

import numpy as np

from nassim.base.checks import positive, unique
from nassim.systems.controller_models import controller_from_model
from nassim.systems.controllers import Controller
from nassim.systems.linear_model import LinearModel
from nassim.systems.state_space import StateSpace


def to_control(model: LinearModel) -> Any:
    """Convert a linear model to a StateSpace of python-control, with the same matrices, time step and signal names.

    Dots in names become underscores, because python-control does not accept dots.

    Args:
        model: the linear model.

    Returns:
        StateSpace of python-control.

    Raises:
        ImportError: without python-control.
        ValueError: for names that differ by dots and underscores only.
    """
    control = _control()
    dt = 0 if model.time_step is None else model.time_step
    inputs = unique("python-control's input", (name.replace(".", "_") for name in model.inputs))
    outputs = unique("python-control's output", (name.replace(".", "_") for name in model.outputs))
    return control.ss(*model.matrices, dt, inputs=list(inputs), outputs=list(outputs))


def model_from_control(system: Any) -> LinearModel:
    """Convert a StateSpace or TransferFunction of python-control to a linear model with its time step and signal names.

    Args:
        system: StateSpace or TransferFunction of python-control.

    Returns:
        Linear model, continuous for a time step of 0.

    Raises:
        ImportError: without python-control.
        ValueError: for an unspecified time step, for a transfer function that is not proper, and for several transfer
            functions at once where python-control cannot convert them.
    """
    matrices, dt, inputs, outputs = _state_space(system)
    if dt is True or (dt is None and len(matrices[0])):
        raise ValueError("the system's time step is unspecified; give it one, 0 for continuous time")
    return LinearModel(*matrices, inputs, outputs, time_step=dt or None)


def controller_from_control(system: Any, *, sample_rate: float, delay: int = 1, limit: float = math.inf) -> Controller:
    """Convert a StateSpace or TransferFunction of python-control to a controller, for u = excitation + K y.

    A continuous system is sampled by Tustin's rule. A discrete system must have the period of `sample_rate`, or an
    unspecified one.

    Args:
        system: StateSpace or TransferFunction of python-control.
        sample_rate: see `Controller` [Hz].
        delay: see `Controller`.
        limit: see `Controller`.

    Returns:
        Controller with the matrices of the sampled system.

    Raises:
        ImportError: without python-control.
        ValueError: for another time step than that of `sample_rate`, and in the cases of `model_from_control`.
    """
    matrices, dt, inputs, outputs = _state_space(system)
    if dt is None and len(matrices[0]):
        raise ValueError("the system's time step is unspecified; give it one, 0 for continuous time")
    period = 1 / positive("sample_rate", sample_rate, "Hz")
    time_step = period if dt is None or dt is True else dt or None
    model = LinearModel(*matrices, inputs, outputs, time_step=time_step)
    return controller_from_model(model, sample_rate=sample_rate, delay=delay, limit=limit)


def _state_space(system: Any) -> tuple[StateSpace, Any, tuple[str, ...], tuple[str, ...]]:
    control = _control()
    if not isinstance(system, (control.StateSpace, control.TransferFunction)):
        raise ValueError(f"give python-control's StateSpace or TransferFunction, got {type(system).__name__}")
    try:
        found = control.ss(system)
    except control.ControlMIMONotImplemented as error:
        raise ValueError(
            "python-control cannot convert several transfer functions at once; give a StateSpace"
        ) from error
    a, b, c, d = (np.asarray(part, dtype=float) for part in (found.A, found.B, found.C, found.D))
    return (a, b, c, d), found.dt, tuple(found.input_labels), tuple(found.output_labels)


def _control() -> Any:
    try:
        import control  # noqa: PLC0415 -- optional, and slow to import
    except ImportError as error:
        raise ImportError('this needs python-control: pip install "nassim[control]"') from error
    return control
