"""Units of signals as products of SI base units, as FMI defines them."""

import re
from dataclasses import dataclass

from nassim.base.units import OTHERS, PREFIXES

BASE = {
    "m": {"m": 1},
    "s": {"s": 1},
    "kg": {"kg": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "C": {"A": 1, "s": 1},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "T": {"kg": 1, "s": -2, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
}
"""Exponents of the SI base units in each unit with a name."""
DIMENSIONLESS = ("", "-", "1")


@dataclass(frozen=True)
class BaseUnit:
    """A unit in SI base units.

    Attributes:
        factor: the unit over the product of the base units.
        exponents: exponent of each base unit that occurs, in the order kg, m, s, A, K, rad.
    """

    factor: float
    exponents: tuple[tuple[str, int], ...]


def base_unit(unit: str) -> BaseUnit | None:
    """Return a unit such as "N m", "m/s2" or "um/V" in SI base units; None for one that is not known."""
    factor = 1.0
    exponents: dict[str, int] = dict.fromkeys(("kg", "m", "s", "A", "K", "rad"), 0)
    for place, part in enumerate(unit.split("/")):
        for item in part.replace("*", " ").replace("·", " ").split():
            matched = re.fullmatch(r"([A-Za-zµ]+|1)\^?(-?\d)?", item)
            found = _named(matched[1]) if matched else None
            if matched is None or found is None:
                return None
            power = int(matched[2] or 1) * (-1 if place else 1)
            factor *= found[0] ** power
            for name, exponent in found[1].items():
                exponents[name] += power * exponent
    return BaseUnit(factor, tuple((name, exponent) for name, exponent in exponents.items() if exponent))


def _named(name: str) -> tuple[float, dict[str, int]] | None:
    """Return the factor and exponents of a unit with a name and perhaps a prefix; None for an unknown one."""
    if name == "1":
        return 1.0, {}
    name = name.replace("µ", "u")
    if name in BASE:
        return 1.0, BASE[name]
    if name in OTHERS:  # an angle in degrees, a time in minutes
        factor, base = OTHERS[name]
        return factor, BASE[base]
    if name[:1] in PREFIXES and name[1:] in BASE:
        return PREFIXES[name[0]], BASE[name[1:]]
    return None
