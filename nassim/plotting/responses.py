"""Frequency responses: Bode plots with coherence, differences from references, fits to recorded ones."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, MultipleLocator, NullFormatter

from nassim.base.checks import Array
from nassim.identification.modal_fit import ModalFit
from nassim.plotting.figures import COLORS, colors, plt
from nassim.signals.frf import FRF


def plot_frf(
    frfs: Sequence[FRF],
    *,
    output: str,
    input: str,
    unit: str,
    markers: Sequence[str] = (),
    figure: Any = None,
) -> Sequence[Any]:
    """Bode plot of one entry of several FRFs, with the coherence below where one of them has it.

    unit: of the magnitude; markers: labels of FRFs drawn as some 50 points instead of lines
    figure: matplotlib figure or subfigure to draw in (default: a new one)

    Returns the Axes: magnitude, phase and, with any coherence, coherence.
    """
    with_coherence = any(frf.coherence is not None for frf in frfs)
    figure = figure or plt.figure(figsize=(7, 7), layout="constrained")
    ratios = [3, 2, 1] if with_coherence else [3, 2]
    axes = list(figure.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios}))
    for color, frf in zip(colors(len(frfs)), frfs, strict=True):
        response = frf.response(output, input)
        style: dict[str, Any] = {"color": color, "label": frf.label, "lw": 1.2}
        if frf.coherence is not None:  # estimated: broad, so that the model's line stays visible on top
            style.update(lw=3.5, alpha=0.5)
        if frf.label in markers:
            style.update(ls="", marker="o", ms=4, mfc="none", markevery=max(len(frf.frequency) // 50, 1))
        axes[0].loglog(frf.frequency, np.abs(response), **style)
        axes[1].semilogx(frf.frequency, _phase(response), **style)
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
    axes[-1].set_xlabel("frequency [Hz]")
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_frf_error(
    frfs: Sequence[FRF], references: Sequence[FRF], *, output: str, input: str, figure: Any = None
) -> Sequence[Any]:
    """Relative difference |H / H_ref - 1| of estimated FRFs from references at the same frequencies, with coherence.

    Returns the Axes: error, incoherence 1 - gamma^2.
    """
    figure = figure or plt.figure(figsize=(7, 5), layout="constrained")
    axes = list(figure.subplots(2, 1, sharex=True))
    for color, frf, reference in zip(colors(len(frfs)), frfs, references, strict=True):
        error = np.abs(frf.response(output, input) / reference.response(output, input) - 1)
        axes[0].loglog(frf.frequency, 100 * error, color=color, label=frf.label, lw=1.2)
        if frf.coherence is not None:
            incoherence = np.maximum(1 - frf.coherence[frf.outputs.index(output)], 1e-16)
            axes[1].loglog(frf.frequency, incoherence, color=color, lw=1.2)
    axes[0].set_title(f"{output} / {input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel("difference from the model [%]")
    axes[0].legend(fontsize=9)
    axes[1].set_ylabel("1 - coherence [-]")
    axes[1].set_xlabel("frequency [Hz]")
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def plot_modal_fit(
    fit: ModalFit, models: Sequence[FRF], *, output: str, unit: str, figure: Any = None
) -> Sequence[Any]:
    """Recorded responses of one output line by line, the fit and models over them, and what the fit leaves over.

    models: FRFs to compare with, such as a scene's before and after; unit: of the response

    Returns the Axes: magnitude, phase, residual.
    """
    figure = figure or plt.figure(figsize=(7, 8), layout="constrained")
    axes = list(figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2, 2]}))
    dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 2, "color": "0.65", "rasterized": True}
    recorded = fit.recorded.response(output, fit.input)
    # Lines that are mostly noise say nothing of the phase.
    clear = np.abs(recorded) > 3 * fit.noise[fit.outputs.index(output)]
    frequency = fit.recorded.frequency
    axes[0].loglog(frequency, np.abs(recorded), label="recorded, line by line", **dots)
    fine = np.geomspace(frequency[0], frequency[-1], 4000)
    identified = fit.response(fine, label="identified")
    response = identified.response(output, fit.input)
    phase = _phase(response)

    def near_phase(x: Array, values: Array) -> Array:
        """Phase without jumps against the fit's [deg]."""
        own = fit.response(x).response(output, fit.input)
        turns = np.round((np.interp(x, fine, phase) - np.angle(own, deg=True)) / 360)
        result: Array = np.angle(own, deg=True) + 360 * turns + np.angle(values / own, deg=True)
        return result

    axes[1].semilogx(frequency[clear], near_phase(frequency[clear], recorded[clear]), **dots)
    for k, frf in enumerate((identified, *models)):
        style: dict[str, Any] = {"color": COLORS[k % len(COLORS)], "ls": ("-", "--", "-.", ":")[k % 4], "lw": 1.4}
        values = frf.response(output, fit.input)
        axes[0].loglog(frf.frequency, np.abs(values), label=frf.label, **style)
        axes[1].semilogx(frf.frequency, near_phase(frf.frequency, values), **style)
    axes[2].loglog(frequency, np.abs(fit.residual.response(output, fit.input)), label="residual", **dots)
    noise = fit.noise[fit.outputs.index(output)]
    axes[2].loglog(*_running_median(frequency, noise), color="black", lw=1.2, label="noise, standard deviation")
    axes[2].loglog(fine, np.abs(response), color=COLORS[0], lw=0.8, label="identified")
    axes[0].set_title(f"{output} / {fit.input}".replace("_", " "), fontsize=11)
    axes[0].set_ylabel(f"magnitude [{unit}]")
    axes[1].set_ylabel("phase [deg]")
    axes[1].yaxis.set_major_locator(MultipleLocator(90))
    axes[2].set_ylabel(f"residual [{unit}]")
    axes[2].set_xlabel("frequency [Hz]")
    for ax in (axes[0], axes[2]):
        ax.legend(fontsize=8)
    axes[2].xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes[2].xaxis.set_major_formatter("{x:g}")
    axes[2].xaxis.set_minor_formatter(NullFormatter())
    for ax in axes:
        ax.grid(True, which="both", alpha=0.25)
    return axes


def _running_median(frequency: Array, values: Array, n_bins: int = 200) -> tuple[Array, Array]:
    edges = np.geomspace(frequency[0], frequency[-1] * (1 + 1e-9), n_bins + 1)
    groups = [(frequency >= low) & (frequency < high) for low, high in itertools.pairwise(edges)]
    filled = [group for group in groups if group.any()]
    return np.array([frequency[g].mean() for g in filled]), np.array([np.median(values[g]) for g in filled])


def _phase(response: Array) -> Array:
    """Phase in degrees without jumps, starting in -180 ... 180 (180 up to rounding counts as -180)."""
    degrees: Array = np.unwrap(np.angle(response, deg=True), period=360.0)
    return degrees - 360.0 * np.round((degrees[0] + 1.0) / 360.0)
