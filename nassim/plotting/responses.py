"""Figures of frequency responses: Bode plots with coherence, differences from references, modal fits."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import MultipleLocator

from nassim.base.checks import Array, instances
from nassim.identification.modal_fit import ModalFit
from nassim.plotting.figures import COLORS, colors, label_frequencies, plt
from nassim.signals.frf import FRF

STYLES = ("-", "--", "-.", ":")
"""Styles of lines, which keep those visible that lie on each other."""
BINS = 200
"""Number of intervals of frequency over which a running median is taken."""


def plot_frf(
    frfs: Sequence[FRF],
    *,
    output: str,
    input: str,
    unit: str,
    markers: Sequence[str] = (),
    figure: Any = None,
) -> Sequence[Any]:
    """Plot one entry of several FRFs as a Bode plot, with the coherence where one of them has it.

    Args:
        frfs: the FRFs.
        output: name of the output.
        input: name of the input.
        unit: unit of the values of the FRFs, for the label; nothing is converted.
        markers: labels of FRFs shown by up to 50 points in place of lines, evenly spread over the logarithmic axis.
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes of magnitude, phase and, if any FRF has it, coherence.

    Raises:
        ValueError: for no FRF, for one that is not in a list, and for unknown outputs and inputs.
    """
    frfs = at_least_one("frfs", frfs)
    with_coherence = any(frf.coherence is not None for frf in frfs)
    figure = figure or plt.figure(figsize=(7, 7), layout="constrained")
    ratios = [3, 2, 1] if with_coherence else [3, 2]
    axes = list(figure.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios}))
    styles = itertools.cycle(STYLES)
    for color, frf, label in zip(colors(len(frfs)), frfs, legend_labels(frfs), strict=True):
        response = frf.response(output, input)
        style: dict[str, Any] = {"color": color, "label": label, "lw": 1.2}
        if frf.coherence is not None:
            # An estimated FRF gets a broad line, on which the line of a model remains visible.
            style.update(lw=3.5, alpha=0.5)
        if label in markers:
            style.update(ls="", marker="o", ms=4, mfc="none", markevery=_spread(frf.frequency, 50))
        elif frf.coherence is None:
            style.update(ls=next(styles))
        axes[0].loglog(frf.frequency, np.abs(response), **style)
        axes[1].semilogx(frf.frequency, phase_degrees(response), **style)
        if frf.coherence is not None:
            axes[2].semilogx(frf.frequency, frf.coherence[frf.outputs.index(output)], **style)
    axes[0].set_ylabel(f"magnitude [{unit}]")
    axes[0].set_title(f"{output} / {input}".replace("_", " "), fontsize=11)
    axes[0].legend(fontsize=9)
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(MultipleLocator(90))
    if with_coherence:
        axes[2].set_ylabel("coherence [-]")
        axes[2].set_ylim(0, 1.05)
    label_frequencies(axes[-1])
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def _spread(frequency: Array, n: int) -> list[int]:
    """Return the indices of up to n frequencies above zero that are evenly spread on a logarithmic axis."""
    first = int(np.searchsorted(frequency, 0.0, side="right"))
    if first == len(frequency):
        return []
    logs = np.log(frequency[first:])
    places = np.linspace(logs[0], logs[-1], n)
    return sorted({first + int(np.argmin(np.abs(logs - place))) for place in places})


def at_least_one(what: str, frfs: Sequence[FRF]) -> tuple[FRF, ...]:
    """Return FRFs as a tuple; raise ValueError for none, and for one that is not in a list."""
    result = instances(what, frfs, (FRF,))
    if not result:
        raise ValueError(f"{what} must hold at least one FRF")
    return result


def legend_labels(frfs: Sequence[FRF]) -> list[str]:
    """Return the labels of FRFs for a legend; those without a label get "estimated" or "FRF" with their number.

    Args:
        frfs: the FRFs.
    """
    numbers = [f" {k + 1}" if len(frfs) > 1 else "" for k in range(len(frfs))]
    return [
        frf.label or ("FRF" if frf.coherence is None else "estimated") + number
        for frf, number in zip(frfs, numbers, strict=True)
    ]


def plot_frf_error(
    frfs: Sequence[FRF], references: Sequence[FRF], *, output: str, input: str, figure: Any = None
) -> Sequence[Any]:
    """Plot the relative difference |H / H_ref - 1| of estimated FRFs from references, with coherence.

    Args:
        frfs: the estimated FRFs.
        references: one reference per FRF, at the same frequencies.
        output: name of the output.
        input: name of the input.
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes of the error and of the incoherence 1 - gamma^2.

    Raises:
        ValueError: for references of another number or at other frequencies, and in the cases of `plot_frf`.
    """
    frfs, references = at_least_one("frfs", frfs), at_least_one("references", references)
    if len(references) != len(frfs):
        raise ValueError(f"give one reference per FRF: got {len(references)} for {len(frfs)}")
    for frf, reference in zip(frfs, references, strict=True):
        if not np.array_equal(frf.frequency, reference.frequency):
            raise ValueError(
                f"the reference {reference.label!r} has other frequencies than {frf.label!r}: compute it at those, as "
                "by frequency_response(model, frf.frequency)"
            )
    figure = figure or plt.figure(figsize=(7, 5), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    labels = legend_labels(frfs)
    for color, frf, label, reference in zip(colors(len(frfs)), frfs, labels, references, strict=True):
        error = np.abs(frf.response(output, input) / reference.response(output, input) - 1)
        axes[0].loglog(frf.frequency, 100 * error, color=color, label=label, lw=1.2)
        if frf.coherence is not None:
            incoherence = np.maximum(1 - frf.coherence[frf.outputs.index(output)], 1e-16)
            axes[1].loglog(frf.frequency, incoherence, color=color, lw=1.2)
    axes[0].set_title(f"{output} / {input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel("difference from the model [%]")
    axes[0].legend(fontsize=9)
    axes[1].set_ylabel("1 - coherence [-]")
    label_frequencies(axes[1])
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_modal_fit(
    fit: ModalFit, models: Sequence[FRF], *, output: str, unit: str, figure: Any = None
) -> Sequence[Any]:
    """Plot the recorded responses of one output line by line, with the fit, models and the residual of the fit.

    Args:
        fit: the identified modes.
        models: FRFs for comparison, such as those of a scene before and after its correction.
        output: name of the output.
        unit: unit of the values, for the label; nothing is converted.
        figure: matplotlib figure or subfigure to plot in (default: a new one).

    Returns:
        The Axes of magnitude, phase and residual.

    Raises:
        ValueError: for models that are not FRFs in a list, and for unknown outputs and inputs.
    """
    models = instances("models", models, (FRF,))
    figure = figure or plt.figure(figsize=(7, 8), layout="constrained")
    axes = list(figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 2]}))
    dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2, "color": "0.65", "rasterized": True}
    recorded = fit.recorded.response(output, fit.input)
    # The phase is shown only at lines that are well above the noise.
    clear = np.abs(recorded) > 3 * fit.noise[fit.outputs.index(output)]
    frequency = fit.recorded.frequency
    axes[0].loglog(frequency, np.abs(recorded), label="recorded, line by line", **dots)
    fine = np.geomspace(frequency[0], frequency[-1], 4000)
    identified = fit.response(fine, label="identified")
    response = identified.response(output, fit.input)
    phase = phase_degrees(response)

    def near_phase(x: Array, values: Array) -> Array:
        """Return the phase without jumps relative to that of the fit [deg]."""
        own = fit.response(x).response(output, fit.input)
        turns = np.round((np.interp(x, fine, phase) - np.angle(own, deg=True)) / 360)
        return np.angle(own, deg=True) + 360 * turns + np.angle(values / own, deg=True)

    axes[1].semilogx(frequency[clear], near_phase(frequency[clear], recorded[clear]), **dots)
    for k, frf in enumerate((identified, *models)):
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)], "ls": STYLES[k % len(STYLES)], "lw": 1.4}
        shown = frf.frequency > 0  # the axis is logarithmic
        x, values = frf.frequency[shown], frf.response(output, fit.input)[shown]
        axes[0].loglog(x, np.abs(values), label=frf.label, **style)
        axes[1].semilogx(x, near_phase(x, values), **style)
    axes[2].loglog(frequency, np.abs(fit.residual.response(output, fit.input)), label="residual", **dots)
    noise = fit.noise[fit.outputs.index(output)]
    axes[2].loglog(*_running_median(frequency, noise), color="black", lw=1.2, label="noise, standard deviation")
    axes[2].loglog(fine, np.abs(response), color=COLORS[0], lw=0.8, label="identified")
    axes[0].set_title(f"{output} / {fit.input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel(f"magnitude [{unit}]")
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(MultipleLocator(90))
    axes[2].set_ylabel(f"residual [{unit}]")
    label_frequencies(axes[2])
    for ax in (axes[0], axes[2]):
        ax.legend(fontsize=8)
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def _running_median(frequency: Array, values: Array) -> tuple[Array, Array]:
    edges = np.geomspace(frequency[0], frequency[-1] * (1 + 1e-9), BINS + 1)
    groups = [(frequency >= low) & (frequency < high) for low, high in itertools.pairwise(edges)]
    filled = [group for group in groups if group.any()]
    return np.array([frequency[g].mean() for g in filled]), np.array([np.median(values[g]) for g in filled])


def phase_degrees(response: Array) -> Array:
    """Return the phase without jumps [deg], which starts in -180 ... 180 (180 within rounding counts as -180)."""
    degrees: Array = np.unwrap(np.angle(response, deg=True), period=360.0)
    return degrees - 360.0 * np.round((degrees[0] + 1.0) / 360.0)
