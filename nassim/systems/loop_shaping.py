"""Controllers from what their loop is to do: crossover frequency and phase margin."""

import math
from dataclasses import replace

import numpy as np

from nassim.base.checks import not_negative, positive
from nassim.systems.controllers import Controller, by_tustin, lead, proportional, series
from nassim.systems.feedback import close_loop, open_loop
from nassim.systems.linear_model import LinearModel, unstable_poles

MOST_PER_LEAD = 65.0
"""Phase by one lead [deg]; beyond, two share it, as the gains far below and above would differ by more than twenty."""


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
    """Lead, integral and low-pass K = k lead(s) (s + w_i) / s * w_l / (s + w_l) with a wanted crossover, for one loop.

    model: the plant, continuous or sampled at the controller's rate, other loops closed (a machine damped by
        `integral_force_feedback`, say); it must be stable, except for motions at rest
    frequency: where |L| = 1 [Hz]; phase_margin: there [deg], with the delay and the hold; both are met exactly
    integral_frequency: w_i / 2 pi [Hz], below which the loop integrates; usual: a tenth of the crossover; 0: none
    low_pass_frequency: w_l / 2 pi [Hz]; usual: ten times the crossover; 0: none
    sample_rate [Hz], delay, limit: see `Controller`

    The lead has the phase that remains to be found, shared by two above 65 deg, and the sign that which makes the
    closed loop stable. The loop may cross 1 elsewhere too, at a resonance: look at its `margins`.

    Source: R. Munnig Schmidt, G. Schitter, A. Rankers, The Design of High Performance Mechatronics, 3rd ed. (2020),
    ch. 4. Raises ValueError where two leads are not enough, and where the closed loop is unstable with either sign.
    """
    centre = positive("frequency", frequency, "Hz")
    margin = positive("phase_margin", phase_margin, "deg")
    rest = _integral_and_low_pass(centre, integral_frequency, low_pass_frequency, sample_rate, delay)
    loop = complex(open_loop(model, rest, np.array([centre]), measured=measured, driven=driven).values[0, 0, 0])
    if loop == 0:
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
        "lower crossover or less phase margin, or damp or notch the resonance that grows"
    )


def _integral_and_low_pass(
    centre: float, integral_frequency: float, low_pass_frequency: float, sample_rate: float, delay: int
) -> Controller:
    numerator, denominator = [1.0], [1.0]
    integral = not_negative("integral_frequency", integral_frequency, "Hz")
    low_pass = not_negative("low_pass_frequency", low_pass_frequency, "Hz")
    half = positive("sample_rate", sample_rate, "Hz") / 2
    for name, corner in (("frequency", centre), ("low_pass_frequency", low_pass)):
        if corner >= half:
            raise ValueError(f"{name} must lie below half the sample rate, {half:g} Hz, got {corner:g} Hz")
    if integral:
        numerator, denominator = [1.0, 2 * np.pi * integral], [1.0, 0.0]
    if low_pass:
        numerator = [2 * np.pi * low_pass * x for x in numerator]
        denominator = [*np.polymul(denominator, [1.0, 2 * np.pi * low_pass])]
    if not (integral or low_pass):
        return proportional(1.0, sample_rate=sample_rate, delay=delay)
    return by_tustin(numerator, denominator, sample_rate, delay, math.inf)
