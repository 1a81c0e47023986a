"""Units of recorded data and their conversion to SI."""

import math
import re

PREFIXES = {"": 1.0, "G": 1e9, "M": 1e6, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}
BASES = ("m", "s", "Hz", "N", "Pa", "J", "W", "V", "A", "C", "F", "H", "Ohm", "T", "K", "rad")
OTHERS = {
    "kg": (1.0, "kg"),
    "deg": (math.pi / 180, "rad"),
    "arcsec": (math.pi / 648000, "rad"),
    "min": (60.0, "s"),
    "bar": (1e5, "Pa"),
    "%": (0.01, "-"),
    "-": (1.0, "-"),
    "1": (1.0, "-"),
}
UNITS = {**{prefix + base: (f, base) for base in BASES for prefix, f in PREFIXES.items()}, **OTHERS}
"""Factor to SI and SI unit of every known unit."""
SPELLINGS = str.maketrans(
    {"µ": "u", "μ": "u", "²": "2", "°": "deg", "*": " ", "·": " "}
    | dict.fromkeys(("\N{GREEK CAPITAL LETTER OMEGA}", "\N{OHM SIGN}"), "Ohm")
)
TORQUE = re.compile(r"\b([GMkmunp]?N)(m{1,2}2?)\b")
"""A torque without a blank, such as Nm or kNmm; nm is a length."""


def to_si(unit: str) -> tuple[float, str]:
    """Return the factor to SI and the SI unit for a unit such as "um", "um/V", "kN mm" or "m/s2".

    "m/s^2", "Nm" and "N*m" are read as "m/s2" and "N m".

    Raises:
        ValueError: for an unknown unit; the message lists the known ones
    """
    factor, parts = 1.0, []
    for place, part in enumerate(TORQUE.sub(r"\1 \2", unit.translate(SPELLINGS)).split("/")):
        names = []
        for item in part.split() or [""]:
            name = item.replace("^", "")
            name, power = (name[:-1], 2) if name.endswith("2") else (name, 1)
            if name == "g":
                raise ValueError(f"unit {unit!r}: g may be gram or gravity; write kg or m/s2")
            if name not in UNITS:
                prefixes = ", ".join(filter(None, PREFIXES))
                raise ValueError(
                    f"unknown unit {unit!r}; known: {', '.join(BASES)} with the prefixes {prefixes}, "
                    f"{', '.join(OTHERS)}, products of these (by blanks or *) and quotients"
                )
            one, base = UNITS[name]
            factor *= one ** (-power if place else power)
            names.append(base + ("2" if power == 2 else ""))
        parts.append(" ".join(names))
    return factor, "/".join(parts)
