"""Characteristic values of benches, with units in their keys: pole, zero, static gains, effect of the circuit."""

import math

import numpy as np

from nassim import FRF, LinearModel, ReducedBody, frequency_response, open_circuit
from nassim.base.checks import Array
from nassim.bodies.remote_points import free_coordinates
from nassim.systems import damping, zeros

from .apa300ml import STACK, axial_stiffness
from .bench import AMPLIFIER_GAIN, BENCH_CONDITIONS, sensor_span_constant


def pole_and_zero(model: LinearModel) -> dict[str, float]:
    """Return the natural frequencies of the first pole of V_s/V_a above 10 Hz and of the zero below it [Hz], or NaN."""
    frequency, ratio = damping(model)
    pole = min(f for f, zeta in zip(frequency, ratio, strict=True) if f > 10.0 and zeta < 0.9)
    dips = zeros(model, inputs="actuator_voltage", outputs="sensor_voltage")
    below = np.abs(dips[dips.imag > 0]) / (2 * np.pi)
    below = below[(below > 10.0) & (below < pole)]
    return {"pole_Hz": float(pole), "zero_Hz": float(below.max()) if below.size else math.nan}


def pole_zero_level(model: LinearModel) -> dict[str, float]:
    """Return `pole_and_zero`, with the level of V_s/V_a between this pole and the next one [V/V]."""
    pole, zero = pole_and_zero(model).values()
    between = 3 * pole
    response = frequency_response(model, np.array([between])).response("sensor_voltage", "actuator_voltage")
    level = float(np.abs(response[0]) * abs(pole**2 - between**2) / abs(zero**2 - between**2))
    return {"pole_Hz": pole, "zero_Hz": zero, "level_between_modes_V_per_V": level}


def peak_and_dip(frf: FRF) -> dict[str, float]:
    """Return pole and zero as seen in an FRF: frequencies of the largest and smallest |V_s/V_a|, 10 to 300 Hz [Hz].

    Both are those of the parabola through the level at three lines, so that the lines' distance does not round them.
    """
    band = frf.band(10, 300)
    level = np.log(np.abs(band.response("sensor_voltage", "actuator_voltage")))
    return {"pole_Hz": _top(band.frequency, level), "zero_Hz": _top(band.frequency, -level)}


def _top(frequency: Array, level: Array) -> float:
    middle = int(np.argmax(level))
    if middle in (0, len(level) - 1):
        return float(frequency[middle])
    near = slice(middle - 1, middle + 2)
    curve, slope, _ = np.polyfit(frequency[near] - frequency[middle], level[near], 2)
    return float(frequency[middle] - slope / (2 * curve))


def static_gains(model: LinearModel, *, frequency: float = 1e-6) -> dict[str, float]:
    """Return |V_s/V_a| [V/V] and |d_e/V_a| [m/V] at a frequency so low that inertia has no effect.

    Args:
        model: linear model of the bench
        frequency: the frequency [Hz]; not zero, because a sensor with a resistance gives no voltage at 0 Hz
    """
    sensor, encoder = np.abs(frequency_response(model, np.array([frequency])).values[:2, 0, 0])
    return {"static_gain_V_per_V": float(sensor), "static_gain_m_per_V": float(encoder)}


def figures_by_circuit(apa: ReducedBody, *, payload_mass: float = 5.0) -> dict[str, float]:
    """Return axial stiffness and first undamped eigenfrequency on the bench, with the sensor shorted and open."""
    conditions = BENCH_CONDITIONS | {"masses": {"top": payload_mass}}
    opened = open_circuit(apa, {"sensor": 0.0})
    first = [float(body.eigenfrequencies(**conditions)[0]) for body in (apa, opened)]
    return {
        "axial_stiffness_shorted_N_per_m": axial_stiffness(apa),
        "axial_stiffness_open_N_per_m": axial_stiffness(opened),
        "first_eigenfrequency_shorted_Hz": first[0],
        "first_eigenfrequency_open_Hz": first[1],
        "open_over_shorted_pole_percent": 100 * (first[1] / first[0] - 1),
    }


def gains_of_a_soft_sensor(apa: ReducedBody) -> tuple[float, float]:
    """Return the static V_s/V_a of a sensor as soft as a shorted one: by its charge, and by its elongation."""
    free = free_coordinates(apa.point_names, **BENCH_CONDITIONS)
    free = np.concatenate([free, np.arange(6 * len(apa.point_names), len(apa.mass_matrix))])
    motion = np.zeros(len(apa.mass_matrix))
    drive = AMPLIFIER_GAIN * apa.port("actuator").forces[free]
    motion[free] = np.linalg.solve(apa.stiffness_matrix[np.ix_(free, free)], drive)
    elongation = (apa.motion("junction") - apa.motion("sensor_end"))[0] @ motion
    charge = apa.port("sensor").forces @ motion
    return float(-charge / STACK.capacitance), float(-sensor_span_constant() * elongation)
