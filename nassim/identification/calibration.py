"""Fitting a model's parameters to measured or published figures, as far as these can determine them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, frozen_mapping, positive, unique
from nassim.base.progress import Advance, silent

Model = Callable[[Mapping[str, float]], Mapping[str, float]]
"""Figures by name, all positive, from parameters by name."""

STEP = 0.04
"""Relative step of the differences that give sensitivities: large, because every geometry gets a mesh of its own."""
CONVERGED = 0.02
"""Steps below this share of a parameter's standard deviation end a fit."""
MOST_STEPS = 8
ROUGHER = 4.0


@dataclass(frozen=True)
class Parameter:
    """A positive number that a model depends on, with its start value and bounds, all in one unit."""

    name: str
    start: float
    lowest: float
    highest: float

    def __post_init__(self) -> None:
        low, high = positive(f"{self.name}: lowest", self.lowest), positive(f"{self.name}: highest", self.highest)
        start = positive(f"{self.name}: start", self.start)
        if not low <= start <= high:
            raise ValueError(f"parameter {self.name!r}: {start:g} does not lie between {low:g} and {high:g}")


@dataclass(frozen=True)
class Target:
    """A figure that the model shall show: its value and relative standard deviation [-]."""

    name: str
    value: float
    tolerance: float

    def __post_init__(self) -> None:
        freeze(
            self,
            value=positive(f"target {self.name!r}: value", self.value),
            tolerance=positive(f"target {self.name!r}: tolerance", self.tolerance),
        )


@dataclass(frozen=True)
class Calibration:
    """Fitted parameters, and what the model shows with them.

    values, deviations: by parameter; the deviation is the relative standard deviation [-] that follows from the
        targets' tolerances, with parameters that were not fitted taken as exact (what these add: `at_bounds`)
    figures: all that the model shows at the end, by name
    errors: relative differences of the targets' figures [-], by name
    n_evaluations: of the model
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    figures: Mapping[str, float]
    errors: Mapping[str, float]
    n_evaluations: int

    def __post_init__(self) -> None:
        names = ("values", "deviations", "figures", "errors")
        freeze(self, **{name: frozen_mapping(getattr(self, name)) for name in names})


def sensitivities(
    model: Model, parameters: Sequence[Parameter], figures: Sequence[str], *, advance: Advance = silent
) -> Array:
    """Relative change of each figure per relative change of each parameter at the start, shape (figures, parameters).

    By differences over +-4 %, or to the side that the bounds leave. advance: called once per evaluation, of which there
    are two per parameter.
    """
    if not unique("parameter", (p.name for p in parameters)):
        raise ValueError("name at least one parameter")
    start = {p.name: p.start for p in parameters}
    columns = []
    for p in parameters:
        ends = [p.start * np.exp(sign * STEP) for sign in (-1.0, 1.0)]
        ends = [min(max(end, p.lowest), p.highest) for end in ends]
        if ends[0] == ends[1]:
            raise ValueError(f"parameter {p.name!r} has no room between its bounds: {p.lowest:g} to {p.highest:g}")
        logarithms = []
        for end in ends:
            logarithms.append(_logarithms(model(start | {p.name: end}), figures))
            advance()
        low, high = logarithms
        columns.append((high - low) / np.log(ends[1] / ends[0]))
    return np.column_stack(columns)


def calibrate(
    model: Model,
    parameters: Sequence[Parameter],
    targets: Sequence[Target],
    *,
    sensitivity: Array,
    largest_deviation: float = 0.1,
    report: Callable[[str], None] = lambda _line: None,
) -> Calibration:
    """Fit parameters to targets by Gauss and Newton's method in logarithms, with given sensitivities.

    model: the one that shall fit; it is evaluated at the start and once a step
    sensitivity: shape (targets, parameters), as from `sensitivities`, where a cheaper model serves
    largest_deviation: relative standard deviation [-] of a parameter beyond which the targets do not determine it
    report: called with a line of text for every step

    Raises ValueError, before the model is evaluated, when the targets cannot determine the parameters, and when the fit
    leaves a parameter's bounds; RuntimeError when it does not settle.
    """
    names = unique("parameter", (p.name for p in parameters))
    if not names or not unique("target", (t.name for t in targets)):
        raise ValueError("name at least one parameter and one target")
    sensitivity = finite_array("sensitivity", sensitivity, (len(targets), len(parameters)))
    deviation = check_determined(parameters, targets, sensitivity, largest_deviation=largest_deviation)
    weights = 1 / np.array([t.tolerance for t in targets])
    wanted = np.log([t.value for t in targets])
    x = np.log([p.start for p in parameters])
    for n in range(1, MOST_STEPS + 1):
        figures = model(dict(zip(names, np.exp(x).tolist(), strict=True)))
        gap = wanted - _logarithms(figures, [t.name for t in targets])
        report("; ".join(f"{t.name} {100 * (np.exp(-g) - 1):+.3f} %" for t, g in zip(targets, gap, strict=True)))
        step = np.linalg.lstsq(weights[:, None] * sensitivity, weights * gap, rcond=None)[0]
        if np.all(np.abs(step) < CONVERGED * deviation):
            return Calibration(
                dict(zip(names, np.exp(x).tolist(), strict=True)),
                dict(zip(names, deviation.tolist(), strict=True)),
                figures,
                {t.name: float(np.exp(-g) - 1) for t, g in zip(targets, gap, strict=True)},
                n,
            )
        x = x + step
        for p, value in zip(parameters, np.exp(x), strict=True):
            if not p.lowest <= value <= p.highest:
                raise ValueError(
                    f"the targets would need {p.name} = {value:.4g}, outside {p.lowest:g} to {p.highest:g}: fit "
                    "another parameter, or question the target"
                )
    raise RuntimeError(f"the fit has not settled after {MOST_STEPS} steps; last errors: {np.expm1(-gap)}")


def at_bounds(
    model: Model,
    fitted: Sequence[Parameter],
    others: Sequence[Parameter],
    targets: Sequence[Target],
    *,
    sensitivity: Array,
    advance: Advance = silent,
) -> dict[str, dict[str, tuple[float, float]]]:
    """How far the fitted parameters move when one that was not fitted is put at its bounds.

    Returns, by name of the other and then of the fitted one, relative changes [-] at the other's lowest and highest
    value. Each comes from a fit of its own, compared with the fit with all others at their start; only differences
    count, so a cheap model serves.
    sensitivity: shape (targets, fitted); advance: called once per bound, of which there are two per other
    Raises RuntimeError when a fit does not settle, ValueError when one would move a parameter more than fivefold.
    """
    # Differences need not be as exact as the fit itself, so its steps may end sooner.
    rough = [replace(t, tolerance=ROUGHER * t.tolerance) for t in targets]

    def fit(values: Mapping[str, float], start: Mapping[str, float]) -> Mapping[str, float]:
        wide = [Parameter(p.name, start[p.name], p.start / 5, 5 * p.start) for p in fitted]
        found = calibrate(
            lambda free: model({**values, **free}), wide, rough, sensitivity=sensitivity, largest_deviation=1e9
        )
        return found.values

    usual = {p.name: p.start for p in others}
    reference = fit(usual, {p.name: p.start for p in fitted})
    result: dict[str, dict[str, tuple[float, float]]] = {}
    for other in others:
        changes = []
        for bound in (other.lowest, other.highest):
            there = reference if bound == other.start else fit(usual | {other.name: bound}, reference)
            changes.append({name: there[name] / value - 1 for name, value in reference.items()})
            advance()
        low, high = changes
        result[other.name] = {name: (low[name], high[name]) for name in reference}
    return result


def check_determined(
    parameters: Sequence[Parameter], targets: Sequence[Target], sensitivity: Array, *, largest_deviation: float
) -> Array:
    """Relative standard deviations of the parameters that the targets' tolerances mean, shape (parameters,) [-].

    Raises ValueError saying which parameters the targets cannot tell apart, and which they could determine alone.
    """
    finite("largest_deviation", largest_deviation)
    weighted = sensitivity / np.array([[t.tolerance] for t in targets])
    alone = 1 / np.maximum(np.linalg.norm(weighted, axis=0), 1e-100)
    could = [p.name for p, deviation in zip(parameters, alone, strict=True) if deviation <= largest_deviation]
    hint = f"alone, these targets could determine: {', '.join(could) or 'none of them'}"
    if len(parameters) > len(targets):
        raise ValueError(
            f"{len(parameters)} parameters cannot be fitted to {len(targets)} figure(s); fit fewer or give more "
            f"figures ({hint})"
        )
    _, sizes, directions = np.linalg.svd(weighted, full_matrices=False)
    deviation = np.sqrt(np.sum((directions / np.maximum(sizes, 1e-100)[:, None]) ** 2, axis=0))
    lost = [k for k, d in enumerate(deviation) if not d <= largest_deviation]
    if lost:
        vague = ", ".join(f"{parameters[k].name} (only to {100 * min(deviation[k], 1e3):.3g} %)" for k in lost)
        mix = " and ".join(
            f"{parameters[k].name} by {100 * share:+.0f} %"
            for k, share in enumerate(directions[-1] / np.abs(directions[-1]).max())
        )
        raise ValueError(
            f"the figures cannot determine {vague}; changing {mix} together would hardly show. Fit fewer or give "
            f"figures that depend on them ({hint})"
        )
    return deviation


def _logarithms(figures: Mapping[str, float], names: Sequence[str]) -> Array:
    missing = [name for name in names if name not in figures]
    if missing:
        raise ValueError(f"the model does not give {', '.join(missing)}; it gives {', '.join(figures)}")
    return np.log([positive(f"the model's {name}", figures[name]) for name in names])
