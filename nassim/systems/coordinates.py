"""Other coordinates for a linear model's signals: outputs that sum up outputs, inputs that act on several inputs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from nassim.base.checks import Array, finite_array, known
from nassim.systems.linear_model import LinearModel, Names, names


def with_outputs(
    model: LinearModel, new: Names, matrix: ArrayLike, *, of: Names, units: Sequence[str] = ()
) -> LinearModel:
    """The model with further outputs, weighted sums of those it has: new = matrix @ of.

    new: names; matrix: (new, of); of: names of outputs; units: of the new ones

    As Cartesian motions from encoders in struts with Jacobian J by matrix = J^-1. Raises ValueError for unknown names,
    for new ones that exist, and for another shape.
    """
    added, rows, weights = _mixed("output", new, matrix, of, model.outputs)
    old_units = model.units or ("",) * len(model.outputs)
    new_units = tuple(units) or ("",) * len(added)
    if len(new_units) != len(added):
        raise ValueError(f"one unit per new output: got {len(new_units)} units for {len(added)} outputs")
    return replace(
        model,
        C=np.vstack([model.C, weights @ model.C[rows]]),
        D=np.vstack([model.D, weights @ model.D[rows]]),
        outputs=model.outputs + added,
        units=old_units + new_units,
    )


def with_inputs(model: LinearModel, new: Names, matrix: ArrayLike, *, of: Names) -> LinearModel:
    """The model with further inputs, each acting on several of those it has: of = matrix @ new, besides their own.

    new: names; matrix: (of, new); of: names of inputs

    As forces and torques on a hexapod's plate by its struts' actuators, with Jacobian J, by matrix = J^-T; or one
    disturbance that enters at several places at once. Raises ValueError as `with_outputs`.
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
    """New names, indices of the old signals, and weights (new, of)."""
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
