"""Coordinates in which the loops of a plant with several signals are nearly independent.

`svd_decoupling` and `modal_decoupling` return what `decoupled` takes: `measure` gives the coordinates from the measured
signals, and `drive` gives the driven signals from the outputs of the controllers. Where the geometry decouples a
platform, `decoupled` with the Jacobian at the `uncoupled_point` of its stiffness or mass does the same.
"""

import contextlib

import numpy as np

from nassim.base.checks import Array, finite_array, of_kind, positive
from nassim.base.field_types import ArrayLike
from nassim.base.modal import eigenmodes
from nassim.base.rigid_motion import skew
from nassim.signals.frf import FRF, ComplexArray

LARGEST_GAIN = 1e12
"""Relative gain from which on a plant is singular: a relative change of one entry by its inverse makes it so."""
ASYMMETRY = 1e-6
"""Largest difference of a symmetric matrix from its transpose, over its largest entry."""


def svd_decoupling(plant: FRF, frequency: float) -> tuple[Array, Array]:
    """Return coordinates from the singular vectors of a plant at one frequency, less the phase that its entries share.

    Args:
        plant: FRF of the plant from the driven to the measured signals.
        frequency: frequency, such as the wanted crossover; the nearest line of the FRF is taken [Hz].

    Returns:
        measure, (coordinates, measured), and drive, (driven, coordinates), in the order of falling gains.

    Raises:
        ValueError: for a frequency outside the FRF.

    Source: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. (2005), sec. 3.5.4.
    """
    low, high = plant.frequency[[0, -1]]
    if not low <= positive("frequency", frequency, "Hz") <= high:
        raise ValueError(f"the plant's FRF goes from {low:g} to {high:g} Hz, and does not hold {frequency:g} Hz")
    line = int(np.argmin(np.abs(plant.frequency - frequency)))
    values = plant.values[:, :, line]
    shared = np.exp(-0.5j * np.angle(np.sum(values**2)))
    left, _, right = np.linalg.svd((values * shared).real, full_matrices=False)
    return left.T, right.T


def modal_decoupling(
    mass: ArrayLike, stiffness: ArrayLike, *, measured: ArrayLike, driven: ArrayLike
) -> tuple[Array, Array]:
    """Return the modal coordinates of a body with as many sensors and actuators as degrees of freedom.

    Args:
        mass: mass matrix in coordinates x, (n, n).
        stiffness: stiffness matrix in x, (n, n).
        measured: measured signals from x, (n, n), such as the Jacobian of a platform for encoders in its struts.
        driven: generalised forces on x from the driven signals, (n, n), such as the transposed Jacobian.

    Returns:
        measure, (n, n), and drive, (n, n), in the order of rising frequencies.

    Raises:
        ValueError: for matrices without an inverse, and for a mass or stiffness that is not symmetric.
    """
    n = len(finite_array("mass", mass, (None, None)))
    m, k = finite_array("mass", mass, (n, n)), finite_array("stiffness", stiffness, (n, n))
    sensors, forces = finite_array("measured", measured, (n, n)), finite_array("driven", driven, (n, n))
    for name, matrix in (("mass", m), ("stiffness", k)):
        if np.abs(matrix - matrix.T).max(initial=0.0) > ASYMMETRY * np.abs(matrix).max(initial=0.0):
            raise ValueError(f"{name} must be symmetric; give the matrices of energies in x")
    _, shapes = eigenmodes(k, m)
    if min(np.linalg.matrix_rank(sensors), np.linalg.matrix_rank(forces)) < n:
        raise ValueError(
            "measured and driven must have an inverse: each degree of freedom needs a sensor and an actuator"
        )
    return np.linalg.inv(sensors @ shapes), np.linalg.inv(shapes.T @ forces)


def uncoupled_point(matrix: ArrayLike) -> tuple[Array, float]:
    """Find the point at which a 6 x 6 stiffness or mass matrix couples translations and rotations least.

    This is the centre of stiffness or of mass, where there is one.

    Args:
        matrix: stiffness or mass matrix of a rigid body, at the origin: three translations, three rotations.

    Returns:
        Point, (3,) [m], and the coupling that remains there: the norm of the block between translations and rotations
        over that of the block of translations [m].

    Raises:
        ValueError: where the coupling does not depend on the point along some axis.
    """
    values = finite_array("matrix", matrix, (6, 6))
    moving, coupling = values[:3, :3], values[:3, 3:]
    # Translations of the origin are those of the point p plus [p]x times the rotations.
    columns = np.array([(moving @ skew(axis)).ravel() for axis in np.eye(3)]).T
    point, _, rank, _ = np.linalg.lstsq(columns, -coupling.ravel(), rcond=None)
    if rank < 3:
        raise ValueError("the translations' stiffness or mass leaves the point free along some axis")
    rest = coupling + (columns @ point).reshape(3, 3)
    return point, float(np.linalg.norm(rest) / np.linalg.norm(moving))


def relative_gain_array(plant: FRF) -> ComplexArray:
    """Compute the relative gain array G * (G^-1)^T, entry by entry, at each frequency.

    An entry is the gain of its output and input with the other loops open, over that with the other loops closed
    tightly. Pair signals whose entries are near 1; large entries warn of plants that are sensitive to errors.

    Args:
        plant: FRF of a plant with as many outputs as inputs.

    Returns:
        Complex, (outputs, inputs, n) [-].

    Raises:
        ValueError: for different numbers of outputs and inputs, and for a plant that is singular at a frequency.

    Source: E. H. Bristol, On a new measure of interaction for multivariable process control, IEEE Transactions on
        Automatic Control 11 (1966) 133-134.
    """
    of_kind("plant", plant, FRF, "frequency_response computes one")
    if len(plant.outputs) != len(plant.inputs):
        raise ValueError(f"the plant has {len(plant.outputs)} outputs and {len(plant.inputs)} inputs; choose as many")
    values = plant.values.transpose(2, 0, 1)
    inverse = np.full_like(values, np.inf)
    for k, line in enumerate(values):
        with contextlib.suppress(np.linalg.LinAlgError):
            inverse[k] = np.linalg.inv(line)
    with np.errstate(invalid="ignore"):
        gains = values * inverse.transpose(0, 2, 1)
    singular = ~(np.abs(gains).max(axis=(1, 2)) < LARGEST_GAIN)
    if singular.any():
        raise ValueError(
            f"the plant is singular at {plant.frequency[singular][0]:g} Hz: outputs follow from each other, or inputs "
            "do the same; leave some out"
        )
    return gains.transpose(1, 2, 0)
