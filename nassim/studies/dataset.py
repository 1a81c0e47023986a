"""The results of a study as one xarray.Dataset: named dimensions, coordinates with units, a status for every run."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.studies.outcome import DIVERGED, OK, OTHER_SHAPE
from nassim.studies.plan import Plan, run_key
from nassim.studies.results import MESSAGE, STATUS, WALL_TIME, Layout, Quantity
from nassim.studies.run_store import Records

EMPTY = {False: np.nan, True: complex(np.nan, np.nan)}


def to_dataset(plan: Plan, records: Records, units: Mapping[str, str], attributes: Mapping[str, Any]) -> Any:
    """The runs of a plan as an xarray.Dataset; NaN where there is no number.

    Where runs gave results of several layouts, the most frequent one counts (of equals, that of the earlier run); the
    others have the status "other shape" and a message. Real numbers become complex ones where other runs have such.
    Warns of units of what is not there, and if no run is of use.
    """
    import xarray as xr  # noqa: PLC0415 -- of the extra `studies`

    keys = [run_key(parameters) for parameters in plan.runs()]
    runs = [records.runs[key] for key in keys]
    status = [run.status for run in runs]
    message = [run.message for run in runs]
    shapes = {digest: _as_real(layout) for digest, layout in records.layouts.items()}
    family = {digest: shape.digest() for digest, shape in shapes.items()}
    frequent = Counter(family[run.layout] for run in runs if run.layout).most_common(1)
    chosen = {digest for digest in family if frequent and family[digest] == frequent[0][0]}
    layout = _common([records.layouts[run.layout] for run in runs if run.layout in chosen])
    for place, run in enumerate(runs):
        if run.layout and run.layout not in chosen:
            status[place] = OTHER_SHAPE
            message[place] = _difference(_as_real(layout), shapes[run.layout])
    wanted = [place for place, run in enumerate(runs) if run.layout in chosen]
    arrays = _filled(len(plan), layout, records, {place: keys[place] for place in wanted})

    variables: dict[str, tuple[tuple[str, ...], Array]] = {
        name: ((*plan.dims, *layout.quantities[name].dims), array.reshape(plan.shape + array.shape[1:]))
        for name, array in arrays.items()
    }
    own = {STATUS: np.array(status, object), MESSAGE: np.array(message, object)}
    own[WALL_TIME] = np.array([run.wall_time for run in runs], float)
    variables |= {name: (plan.dims, array.reshape(plan.shape)) for name, array in own.items()}
    coordinates = {n: (n if plan.grid else plan.dims, np.array(v)) for n, v in plan.values.items()}
    coordinates |= {name: (axis.along, np.array(axis.values)) for name, axis in layout.axes.items()}
    result = xr.Dataset(variables, coordinates, dict(attributes))
    known = {WALL_TIME: "s", **{name: axis.unit for name, axis in layout.axes.items() if axis.unit}, **units}
    for name, unit in known.items():
        if name in result.variables:
            result[name].attrs["units"] = unit
    if unknown := [name for name in units if name not in result.variables]:
        warn(f"units of {', '.join(unknown)} are of no use; known: {', '.join(result.variables)}", stacklevel=3)
    if not {OK, DIVERGED} & set(status):
        warn(f"no run of the study gave a result; the first one: {status[0]}, {message[0]}", stacklevel=3)
    return result


def _filled(n_runs: int, layout: Layout, records: Records, keys: Mapping[int, str]) -> dict[str, Array]:
    """Arrays of all runs by name, a run per row; keys: names of the runs that have numbers, by row."""
    arrays = {n: np.full((n_runs, *q.shape), EMPTY[q.complex], q.dtype) for n, q in layout.quantities.items()}
    for place, key in keys.items():
        for name, numbers in records.numbers(key).items():
            arrays[name][place] = numbers
    return arrays


def _as_real(layout: Layout) -> Layout:
    """The layout without regard to which quantities are complex."""
    return replace(layout, quantities={name: replace(q, complex=False) for name, q in layout.quantities.items()})


def _common(layouts: Sequence[Layout]) -> Layout:
    """Layouts that differ in what is complex as one, complex where any of them is; an empty one of none."""
    if not layouts:
        return Layout({}, {})
    quantities = {
        name: replace(quantity, complex=any(layout.quantities[name].complex for layout in layouts))
        for name, quantity in layouts[0].quantities.items()
    }
    return replace(layouts[0], quantities=quantities)


def _difference(usual: Layout, other: Layout) -> str:
    """How a layout differs from that of most runs."""
    names = [*usual.quantities, *(name for name in other.quantities if name not in usual.quantities)]
    for name in names:
        one, two = usual.quantities.get(name), other.quantities.get(name)
        if one != two:
            return f"{name} is {_told(two)}, in most runs {_told(one)}"
    axis = next(name for name in {**usual.axes, **other.axes} if usual.axes.get(name) != other.axes.get(name))
    return f"the axis {axis} has other values than in most runs"


def _told(quantity: Quantity | None) -> str:
    if quantity is None:
        return "absent"
    return " x ".join(map(str, quantity.shape)) or "a number"
