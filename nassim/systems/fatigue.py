"""Fatigue: cycles of a stress history, and the damage that a history or a spectrum of stress does per Woehler line.

The cycles are counted by the package `rainflow`, the amplitudes under noise follow from the package `FLife`; the extra
"fatigue" installs both. Damage adds up linearly (Palmgren, Miner): a part fails at a sum of 1.
Sources: ASTM E1049-85 (2011), section 5.4.4; T. Dirlik, Application of computers in fatigue analysis, PhD thesis,
University of Warwick (1985).
"""

import importlib
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, not_negative
from nassim.base.field_types import ArrayLike
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.systems.noise_budgets import NoiseBudget

METHODS = {"dirlik": "Dirlik", "narrowband": "Narrowband"}
"""Names of the spectral methods and their classes in FLife."""
LARGEST_AMPLITUDE, N_AMPLITUDES = 40.0, 16001
"""Amplitude over the rms at which the integral over amplitudes ends, and its number of points."""
TOP_SHARE = 1e-3
"""Share of the mean square in the highest frequencies, without which the damage should be nearly the same."""
DAMAGE_CHANGE_WARNED = 0.1
"""Relative change of the damage by these frequencies above which a warning is given."""


@dataclass(frozen=True)
class WoehlerLine:
    """Numbers of cycles to failure over amplitudes of stress: straight lines between points on logarithmic axes.

    The first and the last line continue beyond the points. The line holds for one ratio of mean stress and amplitude;
    means are not corrected.

    Attributes:
        cycles: numbers of cycles of the points, ascending, shape (n,), n >= 2 [-]
        amplitudes: amplitudes of stress of the points, falling, shape (n,) [Pa]
        endurance_limit: amplitude up to which cycles do no damage [Pa]; 0 for none
    """

    cycles: ArrayLike
    amplitudes: ArrayLike
    endurance_limit: float = 0.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        cycles = finite_array("cycles of a Woehler line", self.cycles, (None,))
        amplitudes = finite_array("amplitudes of a Woehler line", self.amplitudes, (len(cycles),))
        if len(cycles) < 2 or min(cycles.min(), amplitudes.min()) <= 0:
            raise ValueError(
                f"a Woehler line needs at least two points of positive cycles and amplitudes, got cycles {cycles} and "
                f"amplitudes {amplitudes} Pa"
            )
        if np.any(np.diff(cycles) <= 0) or np.any(np.diff(amplitudes) >= 0):
            raise ValueError(
                "a Woehler line must fall: give points of ascending cycles and falling amplitudes, got cycles "
                f"{cycles} and amplitudes {amplitudes} Pa; give a horizontal end as endurance_limit"
            )
        limit = not_negative("endurance_limit", self.endurance_limit, "Pa")
        freeze(self, cycles=cycles, amplitudes=amplitudes, endurance_limit=limit)

    def cycles_to_failure(self, amplitude: ArrayLike) -> Array:
        """Return the number of cycles to failure, inf up to the endurance limit, shape (...) [-].

        Args:
            amplitude: amplitudes of stress, not negative, shape (...) [Pa]

        Raises:
            ValueError: for negative amplitudes and NaN
        """
        size = finite_array("amplitude", amplitude, (None,) * np.ndim(amplitude))
        if size.min(initial=0.0) < 0:
            raise ValueError(f"amplitude must not be negative, got {size.min():g} Pa")
        points, numbers = np.log(np.asarray(self.amplitudes)[::-1]), np.log(np.asarray(self.cycles)[::-1])
        damaging = size > self.endurance_limit
        x = np.log(np.where(damaging, size, 1.0))
        part = np.clip(np.searchsorted(points, x) - 1, 0, len(points) - 2)
        slope = np.diff(numbers)[part] / np.diff(points)[part]
        # Beyond any double the number is inf, as it is meant.
        with np.errstate(over="ignore"):
            result: Array = np.where(damaging, np.exp(numbers[part] + slope * (x - points[part])), np.inf)
        return result


@dataclass(frozen=True)
class StressCycles:
    """Cycles of a stress history; see `count_cycles`.

    Attributes:
        amplitudes: half of the ranges, shape (n,) [Pa]
        means: mean stresses, shape (n,) [Pa]
        counts: 1 for full cycles and 0.5 for half cycles, shape (n,) [-]
    """

    amplitudes: Array
    means: Array
    counts: Array

    __repr__ = short_repr

    def __post_init__(self) -> None:
        amplitudes = finite_array("amplitudes", self.amplitudes, (None,))
        means, counts = (finite_array(k, getattr(self, k), amplitudes.shape) for k in ("means", "counts"))
        freeze(self, amplitudes=amplitudes, means=means, counts=counts)

    def damage(self, line: WoehlerLine) -> float:
        """Return the damage of all cycles, 1 at failure [-].

        Args:
            line: the Woehler line
        """
        return float(np.sum(self.counts / line.cycles_to_failure(self.amplitudes)))


def count_cycles(stress: ArrayLike) -> StressCycles:
    """Count the cycles of a stress history by the rainflow method.

    Args:
        stress: history of one stress, such as a component of a `StressAt` sensor, shape (n_samples,) [Pa]. The von
            Mises stress has no sign, so its cycles are not those of the stress

    Returns:
        The cycles.

    Raises:
        ValueError: for a history that is not a finite vector
        ImportError: without the extra "fatigue"
    """
    history = finite_array("stress history", stress, (None,))
    # The package overlooks the half cycle of two samples alone; a last sample that occurs twice changes nothing else.
    found = list(_package("rainflow").extract_cycles([*history.tolist(), *history[-1:]]))
    ranges, means, counts = np.array([cycle[:3] for cycle in found]).reshape(-1, 3).T
    return StressCycles(ranges / 2, means, counts)


def damage_rate(
    budget: NoiseBudget,
    line: WoehlerLine,
    *,
    output: str | None = None,
    method: Literal["dirlik", "narrowband"] = "dirlik",
) -> float:
    """Compute the damage per second of a Gaussian stress by its spectrum.

    Args:
        budget: budget of a stress: of a component (`noise_budget`), or of the equivalent von Mises stress
            (`von_mises_budget`), which counts as one Gaussian stress; all its disturbances act
        line: the Woehler line
        output: name of the stress in the budget (default: its only one)
        method: "dirlik" for any spectrum, "narrowband" for cycles of one frequency, an upper bound for other spectra

    Returns:
        Damage per second [1/s]; its inverse is the time to failure.

    Raises:
        ValueError: for an unknown output or method, for a budget of several outputs without a name, and for an output
            that is no stress or is zero
        ImportError: without the extra "fatigue"

    Warns:
        UserWarning: for a damage that depends on where the spectrum ends. Behind the highest mode, the stress under
            white forces falls as f^-4. Its moment of fourth order, from which Dirlik's formula has the number of peaks,
            then grows with every frequency that is added, though there is hardly any stress.
    """
    name = METHODS[known("method", method, METHODS)]
    if output is None and len(budget.outputs) != 1:
        raise ValueError(f"the budget has the outputs {', '.join(budget.outputs)}: give one of them as output")
    k = budget.outputs.index(known("output", budget.outputs[0] if output is None else output, budget.outputs))
    if budget.units[k] not in ("", "Pa"):
        raise ValueError(f"output {budget.outputs[k]!r} has the unit {budget.units[k]}; give a stress in Pa")
    psd = budget.total.psd[k, 0]
    rms = float(budget.total.rms()[k, 0])
    if rms == 0.0:
        raise ValueError(f"output {budget.outputs[k]!r} has no noise, so it has no cycles")
    damage = _spectral_damage(name, budget.frequency, psd, rms, line)
    squares = budget.total.cumulative()[k, 0] ** 2
    last = int(np.argmax(squares <= TOP_SHARE * squares[0]))
    below = _spectral_damage(name, budget.frequency[: last + 1], psd[: last + 1], rms, line) if last > 1 else damage
    if abs(damage - below) > DAMAGE_CHANGE_WARNED * damage:
        warn(
            f"the damage of {budget.outputs[k]!r} depends on where its spectrum ends: without the frequencies above "
            f"{budget.frequency[last]:.4g} Hz, which hold a thousandth of the mean square, it is {below / damage:.2g} "
            "times as large; count the cycles of a record (spectral_noise, count_cycles), or take "
            'method="narrowband", an upper bound'
        )
    return damage


def _spectral_damage(method: str, frequency: Array, psd: Array, rms: float, line: WoehlerLine) -> float:
    """Compute the damage per second by a method of FLife from a spectrum and its root mean square."""
    flife = _package("FLife")
    # FLife's constants lose digits for large numbers, so it gets a stress of unit rms.
    data = flife.SpectralData(input={"PSD": psd / rms**2, "f": frequency})
    amplitude = np.linspace(0.0, LARGEST_AMPLITUDE, N_AMPLITUDES)
    density = getattr(flife, method)(data).get_PDF(amplitude)
    rate = float(data.m_p if method == METHODS["dirlik"] else data.nu)
    damage = density / line.cycles_to_failure(rms * amplitude)
    return rate * float(np.sum(0.5 * (damage[1:] + damage[:-1]) * np.diff(amplitude)))


def _package(name: str) -> Any:
    """Import a package of the extra."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f'fatigue needs the package {name}: pip install "nassim[fatigue]"') from error
