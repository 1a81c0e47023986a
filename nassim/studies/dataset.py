"""Results of a study as one xarray.Dataset: named dimensions, coordinates with units, a status for each run."""

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

MISSING_VALUES = {False: np.nan, True: complex(np.nan, np.nan)}


def to_dataset(plan: Plan, records: Records, units: Mapping[str, str], attributes: Mapping[str, Any]) -> Any:
    """Return the runs of a plan as an xarray.Dataset, with NaN where there is no number.

    When runs returned results of several layouts, the most frequent layout counts (for equal numbers, that of the
    earlier run). The other runs get the status "other shape" and a message. Real numbers become complex where other
    runs returned complex ones. Warns of units of names that do not exist, and when no run returned a result.

    Args:
        plan: plan of the study.
        records: finished runs.
        units: units of parameters and results by name.
        attributes: attributes of the dataset.
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
        warn(f"units of {', '.join(unknown)} are of no use; known: {', '.join(result.variables)}")
    if not {OK, DIVERGED} & set(status):
        warn(f"no run of the study gave a result; the first one: {status[0]}, {message[0]}")
    return result


def _filled(n_runs: int, layout: Layout, records: Records, keys: Mapping[int, str]) -> dict[str, Array]:
    """Return the arrays of all runs by name, one run per row; keys: names of the runs with numbers, by row."""
    arrays = {n: np.full((n_runs, *q.shape), MISSING_VALUES[q.complex], q.dtype) for n, q in layout.quantities.items()}
    for place, key in keys.items():
        for name, numbers in records.numbers(key).items():
            arrays[name][place] = numbers
    return arrays


def _as_real(layout: Layout) -> Layout:
    """Return the layout with all quantities real and in the order of their names, for comparison."""
    return replace(layout, quantities={n: replace(q, complex=False) for n, q in sorted(layout.quantities.items())})


def _common(layouts: Sequence[Layout]) -> Layout:
    """Combine layouts that differ only in complex quantities: complex where any layout is; empty for no layouts."""
    if not layouts:
        return Layout({}, {})
    quantities = {
        name: replace(quantity, complex=any(layout.quantities[name].complex for layout in layouts))
        for name, quantity in layouts[0].quantities.items()
    }
    return replace(layouts[0], quantities=quantities)


def _difference(usual: Layout, other: Layout) -> str:
    """Describe the difference of a layout from that of most runs."""
    names = [*usual.quantities, *(name for name in other.quantities if name not in usual.quantities)]
    for name in names:
        one, two = usual.quantities.get(name), other.quantities.get(name)
        if one != two:
            return f"{name} is {_describe_shape(two)}, in most runs {_describe_shape(one)}"
    axis = next(name for name in {**usual.axes, **other.axes} if usual.axes.get(name) != other.axes.get(name))
    return f"the axis {axis} has other values than in most runs"


def _describe_shape(quantity: Quantity | None) -> str:
    if quantity is None:
        return "absent"
    return " x ".join(map(str, quantity.shape)) or "a number"
