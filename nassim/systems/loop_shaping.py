"""Controllers designed for a crossover frequency and a phase margin."""

import math
from dataclasses import replace

import numpy as np

from nassim.base.checks import below_nyquist, not_negative, positive
from nassim.systems.controllers import Controller, by_tustin, lead, proportional, series
from nassim.systems.feedback import close_loop, open_loop
from nassim.systems.linear_model import LinearModel, subsystem, unstable_poles, z_plane
from nassim.systems.state_space import balanced_system

MOST_PER_LEAD = 65.0
"""Largest phase of one lead [deg]. Two leads share a larger phase, as the gains far below and far above would differ by
more than a factor of twenty.
"""
NO_RESPONSE = 1e-12
"""Response over the size of the states and of the output's weights on them, in balanced states, below which it is
rounding.
"""


def crossover_controller(
    model: LinearModel,
    *,
    measured: str,
    driven: str,
    frequency: float,
    phase_margin: float,
    sample_rate: float,
    integral_frequency: float = 0.0,
    low_pass_frequency: float = 0.0,
    delay: int = 1,
    limit: float = math.inf,
) -> Controller:
    """Design the lead, integral and low-pass controller of one loop for a crossover frequency and a phase margin.

    The controller is K = k lead(s) (s + w_i) / s * w_l / (s + w_l). The lead supplies the phase that the other factors
    leave open; two leads share it above 65 deg. The sign is the one that makes the closed loop stable. The loop may
    also cross 1 elsewhere, such as at a resonance; check its `margins`. Leads are for plants that behave as a mass at
    the crossover; one that behaves as a spring, such as a piezo stage below its first mode, takes an integrator, see
    `pid`.

    Args:
        model: plant, continuous or sampled at the rate of the controller. Its other loops are closed already, such as
            active damping by `integral_force_feedback`. It must be stable, except for rigid-body motion.
        measured: output that the controller reads.
        driven: input to which the output of the controller is added.
        frequency: crossover frequency, where |L| = 1, met exactly [Hz].
        phase_margin: phase margin at the crossover, including the delay and the hold, met exactly [deg].
        sample_rate: see `Controller` [Hz].
        integral_frequency: w_i / 2 pi, below which the loop integrates; usually a tenth of the crossover; 0 for no
            integrator [Hz].
        low_pass_frequency: w_l / 2 pi; usually ten times the crossover; 0 for no low-pass [Hz].
        delay: see `Controller`.
        limit: see `Controller`.

    Returns:
        Controller with one input and one output.

    Raises:
        ValueError: where the input does not move the output but by rounding, where two leads are not enough, and where
            the closed loop is unstable with either sign.

    Source: R. Munnig Schmidt, G. Schitter, A. Rankers, The Design of High Performance Mechatronics, 3rd ed. (2020), ch.
        4.
    """
    centre = positive("frequency", frequency, "Hz")
    margin = positive("phase_margin", phase_margin, "deg")
    rest = _integral_and_low_pass(centre, integral_frequency, low_pass_frequency, sample_rate, delay)
    loop = complex(open_loop(model, rest, np.array([centre]), measured=measured, driven=driven).values[0, 0, 0])
    if not _reaches(model, measured, driven, centre):
        raise ValueError(f"{driven!r} does not move {measured!r} at {centre:g} Hz")
    refused = []
    for sign in (1.0, -1.0):
        phase = (margin - math.degrees(np.angle(sign * loop))) % 360 - 180
        if abs(phase) > 2 * MOST_PER_LEAD:
            refused.append(f"a phase of {phase:.0f} deg would be needed")
            continue
        n = 1 if abs(phase) <= MOST_PER_LEAD else 2
        leads = n * [lead(centre, phase=phase / n, sample_rate=sample_rate, delay=delay)]
        shaped = series(*leads, rest)
        controller = replace(shaped, C=sign / abs(loop) * shaped.C, D=sign / abs(loop) * shaped.D, limit=limit)
        growing = unstable_poles(close_loop(model, controller, measured=measured, driven=driven))
        if not growing:
            return controller
        refused.append(f"{growing[0]} with a phase of {phase:.0f} deg")
    raise ValueError(
        f"no lead gives {measured!r} a stable loop with {margin:g} deg at {centre:g} Hz ({'; '.join(refused)}): take a "
        "lower crossover or less phase margin, damp or notch the resonance that grows, or, where the plant follows its "
        "drive as a spring does, take an integrator, pid(0, ki=...), in place of a lead"
    )


def _reaches(model: LinearModel, measured: str, driven: str, frequency: float) -> bool:
    """Whether the response at a frequency [Hz] is more than rounding."""
    a, b, c, d = subsystem(model, inputs=driven, outputs=measured).matrices
    a, b, c = balanced_system(a, b, c)
    point = z_plane(np.array(2j * np.pi * frequency), model.time_step)
    states, weights = np.linalg.solve(point * np.eye(len(a)) - a, b[:, 0]), c[0]
    size = np.linalg.norm(weights) * np.linalg.norm(states) + abs(d[0, 0])
    return bool(abs(weights @ states + d[0, 0]) > NO_RESPONSE * size)


def _integral_and_low_pass(
    centre: float, integral_frequency: float, low_pass_frequency: float, sample_rate: float, delay: int
) -> Controller:
    numerator, denominator = [1.0], [1.0]
    below_nyquist("frequency", centre, sample_rate)
    integral = not_negative("integral_frequency", integral_frequency, "Hz")
    low_pass = below_nyquist("low_pass_frequency", low_pass_frequency, sample_rate, zero=True)
    if integral:
        numerator, denominator = [1.0, 2 * np.pi * integral], [1.0, 0.0]
    if low_pass:
        numerator = [2 * np.pi * low_pass * x for x in numerator]
        denominator = [*np.polymul(denominator, [1.0, 2 * np.pi * low_pass])]
    if not (integral or low_pass):
        return proportional(1.0, sample_rate=sample_rate, delay=delay)
    return by_tustin(numerator, denominator, sample_rate, delay, math.inf)
