"""Error of the modes that reduced bodies leave out, in the frequency responses of a scene."""

import numpy as np

from nassim.base.checks import Array
from nassim.base.field_types import ArrayLike
from nassim.scene.bodies import FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.linear.linearization import linearize
from nassim.simulation.model.trimming import with_enriched_bodies
from nassim.systems.linear_model import frequency_response


def truncation_error(scene: Scene, frequency: ArrayLike, *, relative: bool = True) -> Array:
    """Estimate the error of a scene's FRFs due to the modes that its flexible bodies leave out.

    Args:
        scene: the scene.
        frequency: frequencies, (n,) [Hz].
        relative: whether the error is relative; otherwise it is in the units of the outputs per unit of the inputs,
            such as Pa/N for the stress of a `StressAt` sensor.

    Returns:
        |H / H_enriched - 1| [-], 0 where an input does not reach an output, or |H - H_enriched| [output unit/input
        unit], (outputs, inputs, n), where H_enriched is the FRF of the scene with every body in its `enriched` form.

    Raises:
        ValueError: if a body has no enriched form.
    """
    for body in scene.bodies:
        if isinstance(body, FlexibleBody) and body.reduced.enriched is None:
            raise ValueError(f"body {body.name!r} carries no enriched form, so its truncation error is unknown")
    better = frequency_response(linearize(with_enriched_bodies(scene)), frequency).values
    own = frequency_response(linearize(scene), frequency).values
    error = np.abs(own - better)
    if not relative:
        return error
    return np.divide(error, np.abs(better), out=np.where(error > 0, np.inf, 0.0), where=better != 0)
