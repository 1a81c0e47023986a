"""Responses and records in notebooks."""

import base64
import io
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from nassim.plotting.figures import COLORS, label_frequencies
from nassim.plotting.histories import plot_time_history
from nassim.plotting.responses import phase_degrees
from nassim.signals.frf import FRF
from nassim.signals.time_history import TimeHistory

MOST = len(COLORS)
"""Largest number of curves."""


def frf_html(frf: FRF) -> str:
    """Return the magnitude and phase of the first responses of an FRF as a picture.

    Args:
        frf: the FRF.
    """
    figure = Figure(figsize=(7, 5), layout="constrained")
    magnitude, angle = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    pairs = list(product(frf.outputs, frf.inputs))
    for output, name in pairs[:MOST]:
        response = frf.response(output, name)
        magnitude.loglog(frf.frequency, np.abs(response), lw=1.2, label=f"{output} / {name}")
        angle.semilogx(frf.frequency, phase_degrees(response), lw=1.2)
    magnitude.set_title(f"{frf.label}{_left_out(len(pairs), 'responses')}", fontsize=11)
    magnitude.legend(fontsize=9)
    magnitude.set_ylabel("magnitude")
    angle.set_ylabel("phase [deg]")
    label_frequencies(angle)
    for ax in (magnitude, angle):
        ax.grid(True, which="both", alpha=0.25)
    return _picture(figure)


def history_html(history: TimeHistory) -> str:
    """Return the first signals of a record as a picture.

    Args:
        history: the record.
    """
    shown = history.names[:MOST]
    figure = Figure(figsize=(7, 1.8 * len(shown) + 0.6), layout="constrained")
    plot_time_history(history, names=shown, figure=figure)
    if left_out := _left_out(len(history.names), "signals"):
        figure.suptitle(left_out, fontsize=11)
    return _picture(figure)


def _left_out(n: int, what: str) -> str:
    return f" (the first {MOST} of {n} {what})" if n > MOST else ""


def _picture(figure: Figure) -> str:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100)
    return f'<img src="data:image/png;base64,{base64.b64encode(data.getvalue()).decode()}"/>'
