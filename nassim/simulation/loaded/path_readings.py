"""Readings of a path itself by the outputs, without small motion."""

import numpy as np

from nassim.base.checks import Array
from nassim.scene.terms import Output
from nassim.simulation.loaded.path_curves import PathSpline
from nassim.simulation.loaded.path_models import PathModels
from nassim.simulation.loaded.rotor_frame import FrameView

READ_SPACING = 0.02
"""Distance of angles at which readings of the path itself are evaluated [rad]; splines of order 5 join them."""


def path_readings(models: PathModels) -> tuple[PathSpline, Array]:
    """Return readings of the path itself by the outputs, without small motion.

    Returns:
        A function of the angle, of shape (outputs,), and readings per radian that add to it, (outputs,).
    """
    scene, view = models.start.scene, FrameView(models.start, models.partition)
    first, width = float(models.angles[0]), models.spacing * (len(models.angles) - (not models.closed))
    n = max(12, int(np.ceil(width / READ_SPACING)))
    angles = first + width * np.arange(n + 1) / n
    values = np.zeros((n + 1, len(scene.outputs)))
    for term in models.start.terms:
        if isinstance(term, Output) and not term.derivative and term.measure.has_value:
            read = np.array([term.measure.evaluate(view.states(float(angle)))[0][0] for angle in angles])
            if term.measure.period:
                read = np.unwrap(read, period=term.measure.period)
            values[:, scene.outputs.index(term.name)] += term.gain * read
    slopes = (values[-1] - values[0]) / width * models.closed
    values -= np.outer(angles, slopes)
    last = n if models.closed else n + 1
    return PathSpline.of(angles[:last], values[:last], closed=models.closed), slopes
