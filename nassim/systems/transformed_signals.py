"""Transformed signals of a linear model: weighted sums of outputs, and inputs that act on several inputs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, finite_array, known, units_of
from nassim.base.field_types import ArrayLike
from nassim.systems.linear_model import LinearModel, Names, names


def with_outputs(
    model: LinearModel, new: Names, matrix: ArrayLike, *, of: Names, units: Sequence[str] = ()
) -> LinearModel:
    """Add outputs that are weighted sums of existing outputs, new = matrix @ of.

    For example, matrix = J^-1 gives Cartesian motions from encoders in struts with Jacobian J.

    Args:
        model: the linear model.
        new: names of the new outputs.
        matrix: weights, (new, of).
        of: names of existing outputs.
        units: units of the new outputs.

    Returns:
        Model with the existing outputs, then the new ones.

    Raises:
        ValueError: for unknown names in `of`, for names in `new` that exist already, and for a matrix of another shape.
    """
    added, rows, weights = _mixed("output", new, matrix, of, model.outputs)
    return replace(
        model,
        C=np.vstack([model.C, weights @ model.C[rows]]),
        D=np.vstack([model.D, weights @ model.D[rows]]),
        outputs=model.outputs + added,
        units=model.units + units_of("output", units, added),
    )


def with_inputs(model: LinearModel, new: Names, matrix: ArrayLike, *, of: Names) -> LinearModel:
    """Add inputs that act on several existing inputs, of = matrix @ new.

    The existing inputs remain. For example, matrix = J^-T gives forces and torques on the platform of a hexapod with
    Jacobian J by the actuators of its struts. One disturbance that enters at several places is another example.

    Args:
        model: the linear model.
        new: names of the new inputs.
        matrix: weights, (of, new).
        of: names of existing inputs.

    Returns:
        Model with the existing inputs, then the new ones.

    Raises:
        ValueError: in the same cases as `with_outputs`.
    """
    added, columns, weights = _mixed("input", new, np.transpose(np.asarray(matrix)), of, model.inputs)
    return replace(
        model,
        B=np.hstack([model.B, model.B[:, columns] @ weights.T]),
        D=np.hstack([model.D, model.D[:, columns] @ weights.T]),
        inputs=model.inputs + added,
    )


def _mixed(
    kind: str, new: Names, matrix: ArrayLike, of: Names, existing: tuple[str, ...]
) -> tuple[tuple[str, ...], list[int], Array]:
    """Return the new names, the indices of the existing signals, and the weights (new, of)."""
    added, old = names(f"new {kind}", new), names(kind, of)
    places = [existing.index(known(kind, name, existing)) for name in old]
    taken = [name for name in added if name in existing]
    if taken:
        raise ValueError(f"the model has an {kind} {taken[0]!r} already; choose another name")
    weights = np.atleast_2d(np.asarray(matrix))
    if weights.shape != (len(added), len(old)):
        rows, columns = (len(added), len(old)) if kind == "output" else (len(old), len(added))
        raise ValueError(f"the matrix for {kind}s {', '.join(added)} must have shape {rows} x {columns}")
    return added, places, finite_array(f"matrix for {kind}s {', '.join(added)}", weights, weights.shape)
