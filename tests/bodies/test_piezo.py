"""Piezo stacks: actuator and sensor constants from a data sheet, in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from nassim import PiezoStack

SHEET = PiezoStack(
    free_stroke=20e-6,
    blocked_force=1000.0,
    voltage_range=200.0,
    stiffness=50e6,
    capacitance=5e-6,
    length=20e-3,
    area=25e-6,
)


def test_force_per_volt_is_blocked_force_over_voltage_range():
    assert SHEET.force_per_volt == pytest.approx(5.0)


def test_force_per_volt_is_stiffness_times_elongation_per_volt():
    elongation_per_volt = SHEET.free_stroke / SHEET.voltage_range
    assert SHEET.force_per_volt == pytest.approx(SHEET.stiffness * elongation_per_volt)


def test_voltage_per_elongation_follows_from_open_circuit():
    elongation = 1e-6
    force = SHEET.stiffness * elongation
    voltage = -(SHEET.free_stroke / SHEET.voltage_range) * force / SHEET.capacitance  # Q = d F + C V = 0
    assert -SHEET.voltage_per_elongation * elongation == pytest.approx(voltage)
    assert SHEET.voltage_per_elongation == pytest.approx(1e6)


def test_two_stacks_in_line_keep_their_force_per_volt():
    line = replace(SHEET, free_stroke=40e-6, stiffness=25e6, capacitance=10e-6, length=40e-3)
    assert line.force_per_volt == SHEET.force_per_volt
    assert line.voltage_per_elongation == pytest.approx(SHEET.voltage_per_elongation / 2)


@pytest.mark.parametrize(
    "name", ["free_stroke", "blocked_force", "voltage_range", "stiffness", "capacitance", "length", "area"]
)
@pytest.mark.parametrize(
    ("value", "problem"), [(0.0, "must be positive, got 0"), (-1.0, "must be positive"), (np.nan, "NaN")]
)
def test_every_figure_of_the_data_sheet_is_checked(name, value, problem):
    with pytest.raises(ValueError, match=f"piezo stack: {name} .*{problem}"):
        replace(SHEET, **{name: value})
