"""Excitations at the time steps: pulses, starts after zero, units, durations, options; a guided mass in closed form."""

import re

import numpy as np
import pytest

from nassim import Encoder, Joint, PointForce, RigidBody, Scene, TimeHistory, simulate, static_response

MASS = 2.0
GUIDED = Scene(
    "guided",
    (
        RigidBody("ground", {"top": np.zeros(3)}, fixed=True),
        RigidBody("mass", {"centre": np.zeros(3)}, MASS, 0.01 * np.eye(3)),
    ),
    (Joint("guide", "ground.top", "mass.centre", free="x"),),
    (PointForce("push", "mass.centre", "x", "force"),),
    (Encoder("position", "ground.top", "mass.centre", "x"),),
    damping_ratio=0.0,
)


def force(values, time, unit="N"):
    return TimeHistory(time, values, ("force",), (unit,))


def run(excitation, time_step, **options):
    return simulate(GUIDED, excitation, time_step=time_step, progress=False, **options)


@pytest.mark.parametrize("start", [3.7e-5, 5e-3, 9.93e-3])
def test_a_pulse_between_two_steps_is_not_lost(start):
    """1 kN for 10 us: refused where the steps miss it, and at the step that the message names, p = F t."""
    time = np.arange(10_001) * 1e-6
    pulse = force(1e3 * ((time >= start) & (time < start + 9.5e-6)), time)
    with pytest.raises(ValueError, match=r"is too long: .*take at most") as caught:
        run(pulse, 1e-4)
    record = run(pulse, float(re.search(r"at most (\S+) s", str(caught.value)).group(1)))
    after = record.time > start + 2e-5
    expected = 1e3 * 10e-6 / MASS * (record.time[after] - start - 4.5e-6)
    assert np.allclose(record["position"][after], expected, rtol=0.02, atol=1e-9)


def test_a_step_of_one_sample_loses_nothing():
    """A triangle of one sample, at the first steps, with steps of a sample: impulse F h."""
    time = np.arange(101) * 1e-3
    values = np.zeros(101)
    values[1] = 4.0
    record = run(force(values, time), 1e-3)
    assert record["position"][-1] == pytest.approx(4.0 * 1e-3 / MASS * 99e-3, rel=1e-6)


@pytest.mark.parametrize("time_step", [1e-3, 0.4e-3])
def test_an_excitation_that_starts_after_zero(time_step):
    """A force that rises from its first sample on, at 3.7 s: x = a t^3 / 6 m, with t from there."""
    t = np.arange(201) * 1e-3
    record = run(force(8.0 * t, 3.7 + t), time_step)
    assert record.time[0] == 0.0
    assert np.allclose(record["force"], 8.0 * record.time, atol=1e-9)
    assert np.allclose(record["position"], 8.0 * record.time**3 / (6 * MASS), atol=1e-4 * 8.0 * 0.2**3 / (6 * MASS))


def test_seconds_since_1970_jitter_no_excitation():
    """Their rounding, a five-hundredth of a step here, moves no sample against its neighbours."""
    t = np.arange(7021) * 1e-4
    values = np.sin(2 * np.pi * 300 * t)
    near, late = (run(force(values, first + t), 1e-4) for first in (0.0, 1.7e9))
    assert np.array_equal(late.time, near.time)
    assert np.array_equal(run(force(values, 1.7e9 + t), 1e-4, duration=0.702).time, near.time)
    off = late["force"] - near["force"]  # a step that is too short by 1e-7 of the record
    assert np.abs(off).max() < 3e-4
    assert np.abs(np.diff(off, 2)).max() < 2e-5


@pytest.mark.parametrize(("unit", "factor"), [("", 1.0), ("N", 1.0), ("mN", 1e-3), ("kN", 1e3)])
def test_units_are_converted(unit, factor):
    time = np.arange(101) * 1e-3
    record = run(force(np.full(101, 3.0), time, unit), 1e-3)
    assert record.units[0] == "N"
    assert np.all(record["force"] == 3.0 * factor)
    assert record["position"][-1] == pytest.approx(3.0 * factor / MASS * 0.1**2 / 2, rel=1e-6)


@pytest.mark.parametrize("unit", ["V", "m/s2", "newton", "N/m"])
def test_other_units_are_refused(unit):
    with pytest.raises(ValueError, match=f"input 'force' is in N, the excitation in '{unit}'"):
        run(force(np.zeros(11), np.arange(11) * 1e-3, unit), 1e-3)


def test_a_duration_is_a_whole_number_of_steps():
    time = np.arange(101) * 1e-3
    with pytest.raises(ValueError, match=r"duration 0\.01 s is 14\.2857 time steps of 0\.0007 s; take 0\.0098 s"):
        run(force(np.zeros(101), time), 0.7e-3, duration=0.01)
    assert run(force(np.zeros(101), time), 0.7e-3, duration=0.0098).time[-1] == pytest.approx(0.0098)
    assert run(force(np.zeros(101), time), 0.7e-3).time[-1] == pytest.approx(142 * 0.7e-3), "within the excitation"
    assert len(run(force(np.zeros(101), time), 0.1 / 3, duration=0.1).time) == 4
    assert run(force(np.zeros(101), time), 1e-3, duration=0.005 * (1 + 9e-7)).duration == pytest.approx(0.005)
    with pytest.raises(ValueError, match=r"duration .* time steps of 0\.001 s; take 0\.005 s or"):
        run(force(np.zeros(101), time), 1e-3, duration=0.005 * (1 + 11e-7))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "exact", "spectral_radius": 0.9}, "spectral_radius is of .*'exact' has none"),
        ({"method": "explicit", "spectral_radius": 1.0}, "spectral_radius is of .*'explicit' has none"),
        ({"method": "explicit", "hold_order": 1}, "holds inputs from step to step"),
        ({"hold_order": 0}, 'hold_order=0 needs "exact"'),
        ({"hold_order": 2}, "hold_order must be 0 or 1, got 2"),
        ({"spectral_radius": 1.1}, r"must lie in 0 \.\.\. 1, got 1\.1"),
        ({"spectral_radius": -0.1}, r"must lie in 0 \.\.\. 1, got -0\.1"),
        ({"spectral_radius": np.nan}, "spectral_radius must lie in"),
        ({"time_step": np.nan}, "time_step holds 1 value"),
        ({"duration": np.nan}, "duration holds 1 value"),
    ],
)
def test_options_that_a_method_ignores_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        run(force(np.zeros(11), np.arange(11) * 1e-3), **({"time_step": 1e-3} | options))


def test_static_inputs_are_numbers():
    with pytest.raises(ValueError, match="input 'force' holds 1 value"):
        static_response(GUIDED, {"force": np.nan})
