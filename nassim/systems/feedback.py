"""Feedback loops of controllers around linear models: the closed loop, the open loop, its sensitivity.

A loop is sampled or continuous like its model. A loop around a sampled model (`nassim.systems.sampled`) is exact: it
predicts a simulation or a computer at that sample rate, except for saturation. In a loop around a continuous model, a
continuous equivalent replaces the controller. Such a loop serves for design, with the branches and zeros of textbooks,
and for FRFs between samples up to a tenth of the sample rate. A plant that responds to its input within one sample
(direct feedthrough, modes above half the sample rate) answers a held input in steps. Only the sampled model tells
whether a sample sees the new step or the old one. The continuous model is wrong by up to half a sample of delay in that
case.
"""

from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, known, of_kind, unique
from nassim.base.field_types import ArrayLike
from nassim.signals.frf import FRF, ComplexArray
from nassim.systems.controller_models import DELAY_ORDER, RELATIVE_ROUNDING, check_time_step, controller_model
from nassim.systems.controllers import Controller, controller_response
from nassim.systems.linear_model import LinearModel, Names, names, response_values
from nassim.systems.state_space import EPSILON, sizes_without_units


def close_loop(
    model: LinearModel,
    controller: Controller,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    delay_order: int = DELAY_ORDER,
    noise: bool | Names = False,
    reference: Names = (),
) -> LinearModel:
    """Close the loop u = excitation + gain * K y, or K (y - r) with references r, around a linear model.

    The result has the inputs and outputs of the model, and the states of the model and of the controller. Several loops
    can be closed one after the other, or all at once with `nassim.systems.decentralised`.

    Args:
        model: the linear model.
        controller: the controller K.
        measured: output, or outputs, that the controller reads.
        driven: input, or inputs, to which the output of the controller is added.
        gain: factor on the whole controller [-].
        delay_order: see `controller_model`. It has no effect for a sampled model, whose delay is exact.
        noise: names of inputs, one for each measured output, or True for "y noise" of each measured output y. They add
            to the signal that the controller reads and not to the output itself, like the noise of sensors and
            converters. Loops may share them.
        reference: names of references, one for each measured output, or none; they become inputs, which loops may
            share.

    Returns:
        Model of the closed loop.

    Raises:
        ValueError: for unknown names, for references and noise that share a name or that the loop itself drives, for a
            sampled model whose time step is not that of the controller, and when the direct feedthrough of an undelayed
            controller and of the model leave no solution.
    """
    measured, reference = names("measured signal", measured), names("reference", reference)
    noise = [f"{name} noise" for name in measured if noise] if isinstance(noise, bool) else names("noise", noise)
    for kind, given in (("references", reference), ("noise inputs", noise)):
        if given and len(given) != len(measured):
            raise ValueError(f"{len(measured)} measured signal(s) need as many {kind}, got {len(given)}")
    rows, _ = loop_indices(model, measured, driven)
    if own := {*unique("reference and noise", (*reference, *noise))} & {*names("driven signal", driven)}:
        raise ValueError(f"the loop drives {', '.join(sorted(own))}, so this input is no reference or noise of it")
    new = [name for name in (*noise, *reference) if name not in model.inputs]
    model = replace(
        model,
        B=np.pad(model.B, ((0, 0), (0, len(new)))),
        D=np.pad(model.D, ((0, 0), (0, len(new)))),
        inputs=(*model.inputs, *new),
    )
    direct = model.D[rows]
    for signals, sign in ((noise, 1.0), (reference, -1.0)):
        for row, name in zip(direct, signals, strict=False):
            row[model.inputs.index(name)] += sign
    read = model.C[rows], direct
    return close_around(model, controller, read, measured=measured, driven=driven, gain=gain, delay_order=delay_order)


def close_around(
    model: LinearModel,
    controller: Controller,
    read: tuple[Array, Array],
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    delay_order: int = DELAY_ORDER,
) -> LinearModel:
    """Close the loop of a controller that reads any combinations of states and inputs; others as of `close_loop`.

    Args:
        model: the linear model.
        controller: the controller.
        read: what it reads per unit of the states, (measured, n), and of the inputs, (measured, inputs).
        measured: names of what it reads, for messages.
        driven: inputs to which its output is added.
        gain: factor on the whole controller [-].
        delay_order: see `controller_model`.
    """
    _, columns = loop_indices(model, (), driven)
    k = controller_model(
        controller, inputs=measured, outputs=driven, time_step=model.time_step, delay_order=delay_order
    )
    (a, b, c, d), (read_c, read_d) = model.matrices, read
    drive = np.zeros((len(model.inputs), len(columns)))
    drive[columns, range(len(columns))] = finite("gain", gain)
    loop = np.eye(len(read_d)) - read_d @ drive @ k.D
    sizes = sizes_without_units(loop)
    if sizes[-1] < RELATIVE_ROUNDING * max(1.0, sizes[0]):
        raise ValueError("the loop has no solution within a sample: direct feedthrough times gain is 1; add a delay")
    # Signals that the controller reads, y = y_x x + y_k x_k + y_u u, and inputs of the model including its outputs.
    y_x, y_k, y_u = (np.linalg.solve(loop, part) for part in (read_c, read_d @ drive @ k.C, read_d))
    u_x, u_k, u_u = drive @ k.D @ y_x, drive @ (k.C + k.D @ y_k), np.eye(len(model.inputs)) + drive @ k.D @ y_u
    return replace(
        model,
        A=np.block([[a + b @ u_x, b @ u_k], [k.B @ y_x, k.A + k.B @ y_k]]),
        B=np.vstack([b @ u_u, k.B @ y_u]),
        C=np.hstack([c + d @ u_x, d @ u_k]),
        D=d @ u_u,
    )


def open_loop(
    model: LinearModel,
    controller: Controller,
    frequency: ArrayLike,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    label: str = "open loop",
) -> FRF:
    """Compute the FRF of the loop cut at the measured signals, L = -gain * G K.

    The minus sign follows textbooks: the critical point is L = -1. For a continuous model the delay and the zero-order
    hold are exact, and aliasing is neglected. `loop_response` takes the FRF of a plant, such as an estimated one, in
    place of a model.

    Args:
        model: the linear model G.
        controller: the controller K.
        frequency: (n,) [Hz].
        measured: see `close_loop`.
        driven: see `close_loop`.
        gain: see `close_loop`.
        label: label of the FRF.

    Returns:
        FRF with values (measured, measured, n).

    Warns:
        UserWarning: for a sampled model and frequencies above half its sample rate.
    """
    loop_indices(model, measured, driven)
    check_time_step(model.time_step, controller)
    points = finite_array("frequency", frequency, (None,))
    plant = FRF(points, response_values(model, points), model.outputs, model.inputs)
    hold = model.time_step is None
    return loop_response(plant, controller, measured=measured, driven=driven, gain=gain, hold=hold, label=label)


def loop_response(
    plant: FRF,
    controller: Controller,
    *,
    measured: Names,
    driven: Names,
    gain: float = 1.0,
    hold: bool = True,
    label: str = "open loop",
) -> FRF:
    """Compute the open loop L = -gain * G K from the FRF of the plant, at the frequencies of that FRF.

    Args:
        plant: FRF of G, computed or estimated from records.
        controller: the controller K.
        measured: see `close_loop`.
        driven: see `close_loop`.
        gain: see `close_loop`.
        hold: include the zero-order hold of the controller; False when the FRF of the plant is from sample to sample.
        label: label of the FRF.

    Returns:
        FRF with values (measured, measured, n).

    Warns:
        UserWarning: without the hold, for frequencies above half the sample rate of the controller.
    """
    measured, driven = names("measured signal", measured), names("driven signal", driven)
    k = controller_response(controller, plant.frequency, hold=hold)
    if k.values.shape[:2] != (len(driven), len(measured)):
        n_out, n_in = k.values.shape[:2]
        raise ValueError(f"the controller has {n_in} input(s) and {n_out} output(s); name as many signals")
    g = np.array([[plant.response(y, u) for u in driven] for y in measured])
    return FRF(
        plant.frequency, -finite("gain", gain) * np.einsum("yuf,uzf->yzf", g, k.values), measured, measured, None, label
    )


def sensitivity(loop: FRF) -> tuple[FRF, FRF]:
    """Compute the sensitivity S = (1 + L)^-1 and the complementary sensitivity T = 1 - S of an open loop L.

    S is the ratio of a disturbance at the measured signals with the loop closed to that with the loop open. The loop
    amplifies the disturbance where |S| > 1.

    Args:
        loop: open loop L, see `open_loop`.

    Returns:
        S and T, FRFs of the shape of L.

    Raises:
        ValueError: for an FRF whose inputs differ from its outputs, and where det(1 + L) = 0.
    """
    of_kind("loop", loop, FRF, "open_loop computes one")
    if loop.inputs != loop.outputs:
        raise ValueError("an open loop has the same inputs as outputs; see open_loop")
    one = np.eye(len(loop.outputs))
    difference = one + loop.values.transpose(2, 0, 1)
    for line in np.flatnonzero(np.linalg.matrix_rank(difference) < len(one)):
        sizes = sizes_without_units(difference[line])
        if sizes[-1] <= len(one) * EPSILON * sizes[0]:
            raise ValueError(
                f"the loop oscillates at {loop.frequency[line]:g} Hz, where det(1 + L) = 0: lower the gain"
            )
    s: ComplexArray = np.linalg.inv(difference).astype(complex)
    return (
        replace(loop, values=s.transpose(1, 2, 0), label="sensitivity"),
        replace(loop, values=(one - s).transpose(1, 2, 0), label="complementary sensitivity"),
    )


def loop_at_a_time(loop: FRF, signal: str) -> FRF:
    """Compute the open loop cut at one signal while all other loops are closed, 1 / S_ii - 1 of the sensitivity S.

    The `margins` of the result tell by how much this loop alone may change. The largest of the `singular_values` of the
    sensitivity covers changes in several loops at once.

    Args:
        loop: open loop with several signals, see `open_loop`.
        signal: name of the signal at which the loop is cut.

    Returns:
        FRF with values (1, 1, n).
    """
    of_kind("loop", loop, FRF, "open_loop computes one")
    row = loop.outputs.index(known("signal", signal, loop.outputs))
    own = sensitivity(loop)[0].values[row, row]
    return FRF(loop.frequency, (1 / own - 1)[None, None], (signal,), (signal,), None, f"{signal}, others closed")


def singular_values(frf: FRF) -> Array:
    """Compute the singular values of an FRF matrix at each frequency.

    The largest singular value of a sensitivity is the factor by which the loops amplify the worst combination of
    disturbances. Its inverse is the distance of all loops together from instability. Singular values depend on the
    units of the signals: compare signals of one kind, or scale them first (`nassim.systems.with_outputs`).

    Args:
        frf: FRF with n frequencies.

    Returns:
        Singular values, the largest first, (min(outputs, inputs), n).

    Source: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. (2005), sec. 3.3.
    """
    of_kind("frf", frf, FRF, "`sensitivity` returns two, S and T")
    return np.linalg.svd(frf.values.transpose(2, 0, 1), compute_uv=False).T


def loop_indices(model: LinearModel, measured: Names, driven: Names) -> tuple[list[int], list[int]]:
    """Return the indices of measured outputs and driven inputs of a model; raise ValueError for unknown names."""
    rows = [model.outputs.index(known("output", n, model.outputs)) for n in names("measured signal", measured)]
    columns = [model.inputs.index(known("input", n, model.inputs)) for n in names("driven signal", driven)]
    return rows, columns
