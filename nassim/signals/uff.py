"""Curves of universal files (UFF), data set 58, in SI."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.units import to_si

KINDS = {1: "time", 4: "frf", 6: "coherence", 26: "coherence"}
"""Function types that are read; other data sets are left out."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """One data set 58 in SI.

    kind: "time", "frf" or "coherence"; number: of the data set in its file, from 1
    x: times [s] or frequencies [Hz], (n,); values: (n,), complex for FRFs, in `unit`
    output, input: names of response and reference; the latter is empty but for FRFs
    """

    kind: str
    number: int
    x: Array
    values: Array
    output: str
    input: str
    unit: str


def read_curves(path: Path) -> tuple[Curve, ...]:
    """Read all time responses, FRFs and coherences of a universal file, ASCII or binary.

    A curve's names are the axis labels of its ordinate (numerator and denominator), which hold 20 characters, else the
    entity names, else node and direction such as "12 z"; its units are the axes' unit labels, without which SI cannot
    be told. Raises FileNotFoundError, RuntimeError without the package pyuff, and ValueError naming file, data set and
    cause.
    """
    try:
        import pyuff  # noqa: PLC0415 - an optional dependency, needed by few
    except ImportError as error:
        raise RuntimeError('reading UFF files needs the package pyuff: pip install "nassim[uff]"') from error
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    file = pyuff.UFF(str(path))
    curves = []
    for index, kind in enumerate(file.get_set_types()):
        if kind != 58:
            continue
        try:
            content = file.read_sets(index)
        except Exception as error:  # pyuff raises bare exceptions
            raise ValueError(f"{path}, data set {index + 1}: it cannot be read as a data set 58 ({error})") from error
        if content["func_type"] in KINDS:
            try:
                curves.append(_curve(content, index + 1))
            except ValueError as error:
                raise ValueError(f"{path}, data set {index + 1}: {error}") from error
    if not curves:
        raise ValueError(f"{path}: the file holds no time response, FRF or coherence as data set 58")
    return tuple(curves)


def _curve(content: dict[str, Any], number: int) -> Curve:
    kind = KINDS[content["func_type"]]
    x, values = np.asarray(content["x"], dtype=float), np.asarray(content["data"])
    if not len(values) or len(values) != content["num_pts"] or len(x) != len(values):
        raise ValueError(f"{len(values)} values where {content['num_pts']} are announced; is the file cut off?")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(values))):
        raise ValueError(f"value {1 + int(np.argmin(np.isfinite(values)))} is not finite")
    x_factor, x_unit = to_si(_unit(content, "abscissa"))
    if x_unit != ("s" if kind == "time" else "Hz"):
        raise ValueError(f"the axis of a {kind} is in {x_unit}")
    factor, unit = 1.0, "-"
    if kind != "coherence":
        factor, unit = to_si(_unit(content, "ordinate"))
    if kind == "frf":
        below, unit_below = to_si(_unit(content, "orddenom"))
        factor, unit = factor / below, f"{unit}/{unit_below}"
    return Curve(
        kind=kind,
        number=number,
        x=x_factor * x,
        values=factor * values,
        output=_name(content, "ordinate", "rsp"),
        input=_name(content, "orddenom", "ref"),
        unit=unit,
    )


def _unit(content: dict[str, Any], axis: str) -> str:
    unit = str(content.get(f"{axis}_axis_units_lab", "")).strip()
    if unit in ("", "NONE"):
        raise ValueError(f"its {axis} states no unit (axis units label), such as V or um")
    return unit


def _name(content: dict[str, Any], axis: str, entity: str) -> str:
    for key in (f"{axis}_axis_lab", f"{entity}_ent_name"):
        name = str(content.get(key, "")).strip()
        if name not in ("", "NONE"):
            return name
    direction = int(content.get(f"{entity}_dir", 0))
    axes = ("", "x", "y", "z", "rx", "ry", "rz")
    sign = "-" if direction < 0 else ""
    return f"{content.get(f'{entity}_node', 0)} {sign}{axes[min(abs(direction), 6)]}".strip()
