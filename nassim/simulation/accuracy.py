"""What approximations cost: modes left out of bodies, the period error of time steps."""

from dataclasses import replace

import numpy as np

from nassim.base.checks import Array
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.linearization import linearize
from nassim.systems.linear_model import frequency_response


def truncation_error(scene: Scene, frequency: Array) -> Array:
    """Estimated relative error of a scene's FRFs due to the modes that its flexible bodies leave out.

    frequency: (n,) [Hz]. Returns |H / H_enriched - 1|, shape (outputs, inputs, n) [-], where H_enriched is the FRF of
    the scene with every body in its `enriched` form. Raises ValueError where a body has none.
    """
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            if body.reduced.enriched is None:
                raise ValueError(f"body {body.name!r} carries no enriched form, so its truncation error is unknown")
            bodies.append(replace(body, reduced=body.reduced.enriched))
        else:
            bodies.append(body)
    better = frequency_response(
        linearize(replace(scene, bodies=tuple(bodies), cutoff_frequency=None)), frequency
    ).values
    result: Array = np.abs(frequency_response(linearize(scene), frequency).values / better - 1)
    return result


def integrator_error(frequency: float, time_step: float, *, spectral_radius: float = 1.0) -> tuple[float, float]:
    """What generalized-alpha does to an undamped mode: relative lengthening of its period, damping ratio [-].

    frequency: of the mode [Hz]; time_step [s]; spectral_radius: as in `simulate`

    Source: J. Chung, G. M. Hulbert, A time integration algorithm for structural dynamics with improved numerical
    dissipation: the generalized-alpha method, J. Appl. Mech. 60 (1993) 371-375, equations 2 to 4 and 25.
    """
    rho, angle = spectral_radius, 2 * np.pi * frequency * time_step
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
    # Displacement, step x velocity, step^2 x acceleration.
    new = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 - alpha_f) * angle**2, 0, 1 - alpha_m]])
    old = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [-alpha_f * angle**2, 0, -alpha_m]])
    values = np.linalg.eigvals(np.linalg.solve(new, old))
    root = np.log(values[np.argmax(values.imag)])
    return float(angle / abs(root) - 1), max(0.0, round(float(-root.real / abs(root)), 12))
