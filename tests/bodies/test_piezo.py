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


def test_a_data_sheet_becomes_a_stack():
    """Length first, then the sides of the cross-section; the range from lowest to highest, or as one figure."""
    sheet = {"free_stroke": 20e-6, "blocked_force": 1000.0, "capacitance": 5e-6, "size": (20e-3, 4e-3, 6e-3)}
    stack = PiezoStack.from_datasheet(**sheet, voltage_range=(-30.0, 120.0), stiffness=45e6, transverse_ratio=-0.4)
    assert (stack.length, stack.area, stack.voltage_range) == pytest.approx((20e-3, 24e-6, 150.0))
    assert (stack.stiffness, stack.transverse_ratio) == (45e6, -0.4)
    assert PiezoStack.from_datasheet(**sheet, voltage_range=150.0).stiffness == pytest.approx(50e6)


def test_a_force_that_no_ceramic_bears_is_refused():
    """A section in mm2 taken for m2, or in m2 for what it is."""
    with pytest.raises(ValueError, match=r"blocked_force of 1000 N on 1e-06 m2 is 1e\+03 MPa; ceramics give 30 to 50"):
        replace(SHEET, area=1e-6)
    assert replace(SHEET, area=2.1e-6).area == 2.1e-6


STRONG = {"blocked_force": 500e6 * 25e-6, "stiffness": 500e6 * 25e-6 / 20e-6, "capacitance": 1.0}
LONG = {"free_stroke": 5e-3 * 20e-3, "stiffness": 1000.0 / (5e-3 * 20e-3)}
LEAST = 50e6 * (20e-6 / 200.0) ** 2
LIMITS = {
    "stroke over length": (lambda share: {**LONG, "length": 20e-3 / share}, "ceramics reach 0.2 %"),
    "stress": (lambda share: {**STRONG, "area": 25e-6 / share}, "ceramics give 30 to 50"),
    "stiffness, high": (lambda share: {"stiffness": share * 100e6, "capacitance": 1.0}, "does not agree with"),
    "stiffness, low": (lambda share: {"stiffness": 25e6 / share}, "does not agree with"),
    "capacitance": (lambda share: {"capacitance": LEAST / share}, f"stroke and stiffness need more than {LEAST:.3g} F"),
    "across": (lambda share: {"transverse_ratio": -0.6 * share}, "from -0.6 to 0"),
}


@pytest.mark.parametrize("name", LIMITS)
def test_data_sheets_are_taken_up_to_their_limits(name):
    change, message = LIMITS[name]
    replace(SHEET, **change(0.9))
    with pytest.raises(ValueError, match=message):
        replace(SHEET, **change(1.1))
    with pytest.raises(ValueError, match=r"from -0\.6 to 0"):
        replace(SHEET, transverse_ratio=0.01)


@pytest.mark.parametrize(
    ("factor", "verdict"),
    [(0.9 * 0.65, "low: are there"), (1.1 * 0.65, "usual"), (0.9 * 0.78, "usual"), (1.1 * 0.78, "high: stroke")],
)
def test_the_coupling_factor_is_compared_with_those_of_ceramics(factor, verdict):
    """k33^2 = k d^2 / C, so the capacitance says which."""
    stack = replace(SHEET, capacitance=50e6 * (20e-6 / 200) ** 2 / factor**2)
    assert stack.coupling_factor == pytest.approx(factor)
    assert f"k33 {factor:.3f} (ceramics: 0.65 to 0.78; {verdict}" in stack.consistency()


def test_figures_of_a_data_sheet_are_compared():
    """A stack stiffer by a quarter than its blocked force over its stroke."""
    stack = replace(SHEET, stiffness=1.25 * SHEET.blocked_force / SHEET.free_stroke)
    modulus = stack.stiffness * SHEET.length / SHEET.area
    strain, stress = SHEET.free_stroke / SHEET.length, SHEET.blocked_force / SHEET.area
    stiffness, along, over, _ = stack.consistency().splitlines()
    assert stiffness == (
        f"stiffness {1e-6 * stack.stiffness:.4g} N/um; blocked force / free stroke: "
        f"{1e-6 * SHEET.blocked_force / SHEET.free_stroke:.4g} N/um (+25.0 %)"
    )
    assert along == f"Young's modulus along the stack {1e-9 * modulus:.4g} GPa"
    assert over == f"strain over the voltage range {100 * strain:.3g} %, blocked stress {1e-6 * stress:.3g} MPa"
