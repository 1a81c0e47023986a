"""Fatigue against closed forms: a sine, blocks of two amplitudes, a Rayleigh distribution, and a long record."""

from math import gamma

import numpy as np
import pytest

from nassim.systems import NoiseBudget, StressCycles, WoehlerLine, count_cycles, damage_rate

EXPONENT = 5.0
LINE = WoehlerLine([1e4, 1e4 * 10**EXPONENT], [400e6, 40e6])
"""N = 1e4 (S / 400 MPa)^-5."""


def budget(frequency, *densities, units=("Pa",)):
    """A budget of one output and a disturbance for each density."""
    names = tuple(f"d{k}" for k in range(len(densities)))
    return NoiseBudget(frequency, np.array([densities]), ("stress",), names, units)


def test_a_line_is_straight_between_its_points_and_beyond():
    line = WoehlerLine([1e3, 1e5, 1e6], [500e6, 200e6, 150e6], endurance_limit=50e6)
    np.testing.assert_allclose(line.cycles_to_failure([500e6, 200e6, 150e6]), [1e3, 1e5, 1e6], rtol=1e-12)
    np.testing.assert_allclose(
        line.cycles_to_failure([np.sqrt(500e6 * 200e6), 112.5e6, 60e6][:2]), [1e4, 1e7], rtol=1e-9
    )
    assert np.isinf(line.cycles_to_failure([0.0, 50e6])).all()
    given = WoehlerLine([1e3, 1e6], [2e8, 1e8])
    assert not given.cycles.flags.writeable
    assert not given.amplitudes.flags.writeable
    assert LINE.cycles_to_failure(4e9) == pytest.approx(0.1)
    for amplitude, message in (
        (-1.0, "amplitude must not be negative, got -1 Pa"),
        ([1.0, np.nan], "amplitude holds 1"),
    ):
        with pytest.raises(ValueError, match=message):
            given.cycles_to_failure(amplitude)
    static = WoehlerLine([1.0, 1e4], [400.0, 0.04])  # from a single cycle on, for amplitudes in any unit
    assert static.cycles_to_failure(4.0) == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("cycles", "amplitudes", "message"),
    [
        ([1e4, 1e6], [100e6, 200e6], "must fall"),
        ([1e4, 1e6], [100e6, 100e6], "horizontal end as endurance_limit"),
        ([1e6, 1e4], [100e6, 200e6], "must fall"),
        ([1e4, 1e5, 1e6], [300e6, 100e6, 200e6], "must fall"),
        ([1e4, 1e6, 1e5], [300e6, 200e6, 100e6], "must fall"),
        ([1e4], [100e6], "at least two points"),
        ([1e4, 1e6], [100e6, 0.0], "positive"),
        ([0.0, 1e6], [200e6, 100e6], "positive"),
        ([1e4, 1e6, 1e7], [2e8, 1e8], "amplitudes of a Woehler line"),
    ],
)
def test_a_line_that_does_not_fall_is_refused(cycles, amplitudes, message):
    with pytest.raises(ValueError, match=message):
        WoehlerLine(cycles, amplitudes)


def test_a_sine_does_the_damage_of_its_cycles():
    """50 cycles of 100 MPa about a mean of 30 MPa, from a minimum to a minimum."""
    pytest.importorskip("rainflow", reason="the extra fatigue is not installed")
    phase = np.arange(50 * 20 + 1) / 20
    cycles = count_cycles(30e6 - 100e6 * np.cos(2 * np.pi * phase))
    assert cycles.counts.sum() == pytest.approx(50.0)
    np.testing.assert_allclose(cycles.means, 30e6, rtol=1e-9)
    assert cycles.damage(LINE) == pytest.approx(50 / (1e4 * 4**EXPONENT), rel=1e-9)
    assert cycles.damage(WoehlerLine(LINE.cycles, LINE.amplitudes, endurance_limit=101e6)) == 0.0
    assert len(count_cycles(np.full(9, 3e6)).counts) <= 1
    half = count_cycles([1e6, 3e6])
    assert (half.amplitudes, half.means, half.counts) == ([1e6], [2e6], [0.5])
    assert len(count_cycles([1e6]).counts) == len(count_cycles([]).counts) == 0


def test_small_cycles_within_a_large_one_are_counted_beside_it():
    """The example of ASTM E1049-85, figure 6: -2 1 -3 5 -1 3 -4 4 -2, in its table of ranges."""
    pytest.importorskip("rainflow", reason="the extra fatigue is not installed")
    cycles = count_cycles([-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0])
    counted = {r: float(cycles.counts[np.isclose(2 * cycles.amplitudes, r)].sum()) for r in (3, 4, 6, 8, 9)}
    assert counted == {3: 0.5, 4: 1.5, 6: 0.5, 8: 1.0, 9: 0.5}
    ones = WoehlerLine([1.0, 0.5e3], [1.0, 1e-3])
    by_hand = sum(count / ones.cycles_to_failure(r / 2) for r, count in counted.items())
    assert cycles.damage(ones) == pytest.approx(by_hand)
    assert StressCycles(np.array([2.0]), np.zeros(1), np.array([3.0])).damage(ones) == pytest.approx(
        3 / ones.cycles_to_failure(2.0)
    )


def test_narrow_noise_has_amplitudes_of_rayleigh():
    """D / t = f (sqrt(2) rms)^k Gamma(1 + k/2) / C by J. W. Miles (1954); two disturbances share the spectrum."""
    pytest.importorskip("FLife", reason="the extra fatigue is not installed")
    frequency = np.linspace(99.5, 100.5, 101)
    psd = np.full(101, (20e6) ** 2)
    narrow = budget(frequency, 0.25 * psd, 0.75 * psd)
    expected = 100.0 * (np.sqrt(2) * 20e6 / 400e6) ** EXPONENT * gamma(1 + EXPONENT / 2) / 1e4
    assert damage_rate(narrow, LINE, method="narrowband") == pytest.approx(expected, rel=1e-4)
    assert damage_rate(narrow, LINE, output="stress") == pytest.approx(expected, rel=0.03)
    limited = WoehlerLine(LINE.cycles, LINE.amplitudes, endurance_limit=1e9)
    assert damage_rate(narrow, limited) == pytest.approx(0.0, abs=1e-12 * expected)


def test_dirlik_gives_the_damage_of_a_long_record():
    """White noise from 20 to 120 Hz, counted over 200 s with 30 samples a period."""
    pytest.importorskip("FLife", reason="the extra fatigue is not installed")
    sample_rate, n = 4096.0, 800_000
    lines = np.fft.rfftfreq(n, 1 / sample_rate)
    psd = np.where((lines >= 20) & (lines <= 120), (2e6) ** 2, 0.0)
    noise = np.random.default_rng(11).standard_normal((2, len(lines)))
    record = np.fft.irfft(np.sqrt(psd * sample_rate * n / 4) * (noise[0] + 1j * noise[1]), n)
    counted = count_cycles(record).damage(LINE) / (n / sample_rate)
    below = budget(lines[lines < 150], psd[lines < 150])
    assert damage_rate(below, LINE) == pytest.approx(counted, rel=0.05)
    assert damage_rate(below, LINE, method="narrowband") > 1.08 * counted


def test_a_damage_that_grows_with_the_highest_frequency_is_told():
    """Stress in two modes under a white force falls as f^-4, so peaks by the fourth moment grow with the band."""
    pytest.importorskip("FLife", reason="the extra fatigue is not installed")

    def modes(highest):
        f = np.geomspace(0.05, highest, 4000)
        stress = sum(g / (1 - (f / c) ** 2 + 2j * z * f / c) for g, c, z in ((1, 7, 0.05), (0.2, 60, 0.02)))
        return budget(f, (15e6 * np.abs(stress)) ** 2)

    with pytest.warns(UserWarning, match="above 112.2 Hz, which hold a thousandth of the mean square, it is 0.6 "):
        long = damage_rate(modes(5000.0), LINE)
    with pytest.warns(UserWarning, match="above 111.* it is 0.8"):
        assert long > 1.3 * damage_rate(modes(480.0), LINE)
    bound = damage_rate(modes(480.0), LINE, method="narrowband")
    assert damage_rate(modes(5000.0), LINE, method="narrowband") == pytest.approx(bound, rel=0.01)
    assert bound > long


def test_spectra_that_are_no_stress_are_refused():
    frequency = np.linspace(1.0, 2.0, 5)
    noise = budget(frequency, np.ones(5))
    with pytest.raises(ValueError, match="unit m; give a stress in Pa"):
        damage_rate(budget(frequency, np.ones(5), units=("m",)), LINE)
    with pytest.raises(ValueError, match="unknown output 'strain'; known: stress"):
        damage_rate(noise, LINE, output="strain")
    with pytest.raises(ValueError, match="unknown method 'steinberg'; known: dirlik, narrowband"):
        damage_rate(noise, LINE, method="steinberg")
    with pytest.raises(ValueError, match="has no noise"):
        damage_rate(budget(frequency, np.zeros(5)), LINE)
    two = NoiseBudget(frequency, np.ones((2, 1, 5)), ("a", "b"), ("d",))
    with pytest.raises(ValueError, match="a, b: give one of them"):
        damage_rate(two, LINE)


def test_without_the_extra_there_is_a_cure(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rainflow", None)
    with pytest.raises(ImportError, match=r'pip install "nassim\[fatigue\]"'):
        count_cycles([1.0, 2.0])
