"""Calibration of the parameters of a model to measured or published figures, as far as these determine them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, finite, finite_array, freeze, positive, unique
from nassim.base.field_types import OptionalArray, data_class, held
from nassim.base.progress import Advance, silent
from nassim.base.short_repr import short_repr

Model = Callable[[Mapping[str, float]], Mapping[str, float]]
"""Function from parameters by name to figures by name, all positive."""

SENSITIVITY_STEP = 0.04
"""Relative step of the finite differences for sensitivities. It is large because each geometry has its own mesh."""
CONVERGED = 0.02
"""Step over the standard deviation of a parameter below which a fit has converged."""
MOST_STEPS = 8
ROUGHER = 4.0


@dataclass(frozen=True)
class Parameter:
    """Positive parameter of a model.

    Attributes:
        name: name of the parameter.
        start: start value.
        lowest: lower bound, in the unit of the start value.
        highest: upper bound, in the unit of the start value.
    """

    name: str
    start: float
    lowest: float
    highest: float
    __repr__ = short_repr

    def __post_init__(self) -> None:
        low, high = positive(f"{self.name}: lowest", self.lowest), positive(f"{self.name}: highest", self.highest)
        start = positive(f"{self.name}: start", self.start)
        if not low <= start <= high:
            raise ValueError(f"parameter {self.name!r}: {start:g} does not lie between {low:g} and {high:g}")


@dataclass(frozen=True)
class Target:
    """Figure that the model should reproduce.

    Attributes:
        name: name of the figure.
        value: wanted value.
        tolerance: relative standard deviation [-].
    """

    name: str
    value: float
    tolerance: float
    __repr__ = short_repr

    def __post_init__(self) -> None:
        freeze(
            self,
            value=positive(f"target {self.name!r}: value", self.value),
            tolerance=positive(f"target {self.name!r}: tolerance", self.tolerance),
        )


@data_class
class Calibration:
    """Result of a calibration.

    Attributes:
        values: fitted parameters by name.
        deviations: relative standard deviations of the parameters by name, from the tolerances of the targets, with
            parameters that were not fitted taken as exact (`at_bounds` gives their contribution) [-].
        figures: all figures of the calibrated model by name.
        errors: relative differences of the figures from their targets by name [-].
        n_evaluations: number of evaluations of the model, without those for sensitivities.
        covariance: covariance of the logarithms of the parameters, in their order, (parameters, parameters) [-]. Where
            another figure has the `sensitivities` s, (parameters,), its relative standard deviation is
            sqrt(s @ covariance @ s). None in a file of nassim 0.2, which lacks it.
    """

    values: Mapping[str, float]
    deviations: Mapping[str, float]
    figures: Mapping[str, float]
    errors: Mapping[str, float]
    n_evaluations: int
    covariance: OptionalArray = held(None)
    __repr__ = short_repr

    def __post_init__(self) -> None:
        n = len(self.values)
        freeze(self, values=self.values, deviations=self.deviations, figures=self.figures, errors=self.errors)
        if self.covariance is not None:
            freeze(self, covariance=finite_array("covariance", self.covariance, (n, n)))

    def __str__(self) -> str:
        """Return the parameters with their standard deviations, and the figures with their errors, line by line."""
        lines = [f"{p} = {value:.5g} ± {100 * self.deviations[p]:.2g} %" for p, value in self.values.items()]
        for name, figure in self.figures.items():
            error = f", {100 * self.errors[name]:+.2g} % from its target" if name in self.errors else ""
            lines.append(f"{name}: {figure:.5g}{error}")
        return "\n".join(lines)


def sensitivities(
    model: Model, parameters: Sequence[Parameter], figures: Sequence[str], *, advance: Advance = silent
) -> Array:
    """Compute the relative change of each figure per relative change of each parameter, at the start values.

    The derivatives are differences over +-4 %, or over the part of this interval within the bounds.

    Args:
        model: the model.
        parameters: the parameters.
        figures: names of the figures.
        advance: called once per evaluation; there are two evaluations per parameter.

    Returns:
        Sensitivities, (figures, parameters) [-].

    Raises:
        ValueError: without a parameter, for a parameter whose bounds are equal, and for figures that the model does not
            give.
    """
    if not unique("parameter", (p.name for p in parameters)):
        raise ValueError("name at least one parameter")
    start = {p.name: p.start for p in parameters}
    columns = []
    for p in parameters:
        ends = [p.start * np.exp(sign * SENSITIVITY_STEP) for sign in (-1.0, 1.0)]
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
    sensitivity: Array | None = None,
    largest_deviation: float = 0.1,
    report: Callable[[str], None] | None = None,
) -> Calibration:
    """Fit parameters to targets by the Gauss-Newton method in logarithms.

    Args:
        model: the model to fit. It is evaluated at the start and once per step.
        parameters: the parameters.
        targets: the targets.
        sensitivity: (targets, parameters) [-]. None: those of the model by `sensitivities`, anew at each step, which
            takes two more evaluations per parameter. Given ones, such as those of a cheaper model, hold for all steps
            and for the deviations; the fit then converges only from a start near the targets.
        largest_deviation: relative standard deviation of a parameter above which the targets do not determine it [-].
        report: called with a line of text for each step.

    Returns:
        Fitted parameters with their deviations, and the figures of the model.

    Raises:
        ValueError: when the targets cannot determine the parameters, with a given sensitivity before the model is
            evaluated; when the fit leaves the bounds of a parameter.
        RuntimeError: when the fit does not converge.
    """
    names = unique("parameter", (p.name for p in parameters))
    if not names or not unique("target", (t.name for t in targets)):
        raise ValueError("name at least one parameter and one target")
    weights = 1 / np.array([t.tolerance for t in targets])
    wanted = np.log([t.value for t in targets])
    x = np.log([p.start for p in parameters])
    for n in range(1, MOST_STEPS + 1):
        if sensitivity is None:
            values = np.clip(np.exp(x), [p.lowest for p in parameters], [p.highest for p in parameters])
            here = [replace(p, start=float(value)) for p, value in zip(parameters, values, strict=True)]
            slopes = sensitivities(model, here, [t.name for t in targets])
        else:
            slopes = np.asarray(sensitivity)
        deviation = check_determined(parameters, targets, slopes, largest_deviation=largest_deviation)
        figures = model(dict(zip(names, np.exp(x).tolist(), strict=True)))
        gap = wanted - _logarithms(figures, [t.name for t in targets])
        if report:
            report("; ".join(f"{t.name} {100 * (np.exp(-g) - 1):+.3f} %" for t, g in zip(targets, gap, strict=True)))
        weighted = weights[:, None] * slopes
        step = np.linalg.lstsq(weighted, weights * gap, rcond=None)[0]
        if np.all(np.abs(step) < CONVERGED * deviation):
            spread = np.linalg.pinv(weighted)
            return Calibration(
                dict(zip(names, np.exp(x).tolist(), strict=True)),
                dict(zip(names, deviation.tolist(), strict=True)),
                figures,
                {t.name: float(np.exp(-g) - 1) for t, g in zip(targets, gap, strict=True)},
                n,
                spread @ spread.T,
            )
        x = x + step
        for p, value in zip(parameters, np.exp(x), strict=True):
            if not p.lowest <= value <= p.highest:
                raise ValueError(
                    f"the targets would need {p.name} = {value:.4g}, outside {p.lowest:g} to {p.highest:g}, as far as "
                    f"step {n} tells: fit another parameter, question the target, or start nearer to it"
                )
    raise RuntimeError(f"the fit has not converged after {MOST_STEPS} steps; last errors: {np.expm1(-gap)}")


def at_bounds(
    model: Model,
    fitted: Sequence[Parameter],
    others: Sequence[Parameter],
    targets: Sequence[Target],
    *,
    sensitivity: Array,
    advance: Advance = silent,
) -> dict[str, dict[str, tuple[float, float]]]:
    """Compute the changes of the fitted parameters when another parameter takes the values of its bounds.

    Each change follows from a separate fit, compared with the fit with all others at their start values. Only
    differences matter, so a cheap model is sufficient.

    Args:
        model: the model.
        fitted: the fitted parameters.
        others: the parameters that were not fitted.
        targets: the targets.
        sensitivity: (targets, fitted) [-].
        advance: called once per bound; there are two bounds per other parameter.

    Returns:
        Relative changes [-] at the lower and at the upper bound, by name of the other parameter and then of the fitted
        one.

    Raises:
        RuntimeError: when a fit does not converge.
        ValueError: for a parameter given twice, and when a fit would change a parameter by more than a factor of five.
    """
    unique("parameter", (p.name for p in (*fitted, *others)))
    # Differences need less accuracy than the fit itself, so the iterations may end earlier.
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
    """Compute the relative standard deviations of the parameters that follow from the tolerances of the targets.

    Args:
        parameters: the parameters.
        targets: the targets.
        sensitivity: (targets, parameters) [-].
        largest_deviation: largest accepted standard deviation [-].

    Returns:
        Relative standard deviations, (parameters,) [-].

    Raises:
        ValueError: for a wrong shape, NaN or infinity; with the parameters that the targets cannot distinguish, and
            those that they could determine alone.
    """
    finite("largest_deviation", largest_deviation)
    sensitivity = finite_array("sensitivity", sensitivity, (len(targets), len(parameters)))
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
            f"the figures cannot determine {vague}; changing {mix} together has little effect. Fit fewer or give "
            f"figures that depend on them ({hint})"
        )
    return deviation


def _logarithms(figures: Mapping[str, float], names: Sequence[str]) -> Array:
    missing = [name for name in names if name not in figures]
    if missing:
        raise ValueError(f"the model does not give {', '.join(missing)}; it gives {', '.join(figures)}")
    return np.log([positive(f"the model's {name}", figures[name]) for name in names])
