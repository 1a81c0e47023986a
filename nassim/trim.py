"""Reduced bodies with only what a use needs: fewer points and modes, exact in statics.

A second Craig-Bampton reduction, of the reduced matrices: the points that stay are its interface, static shapes of the
loads that act elsewhere replace the coordinates of the other points.
"""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from nassim.body import ReducedBody
from nassim.checks import Array, known, positive
from nassim.modal import eigenmodes

DEPENDENT = 1e-10
"""Load shapes with less than this share of the largest one's energy add nothing."""


def trim_body(body: ReducedBody, *, points: Collection[str], loads: Array, cutoff_frequency: float) -> ReducedBody:
    """The body with the given remote points as coordinates, and all others as points that only move along.

    points: names of those that joints may hold; at least one
    loads: forces on the body's coordinates, shape (n, k): their static answers stay exact, at any of its points
    cutoff_frequency: fixed-interface modes (all given points held) above it are left out [Hz]

    The result remembers the body's richer form, so its truncation errors say what the trimming costs. Raises
    ValueError for unknown names and no points at all.
    """
    if not points:
        raise ValueError(f"body {body.name!r}: keep at least one remote point")
    kept = [name for name in body.point_names if name in points]
    for name in points:
        known("remote point", name, body.point_names)
    positive("cutoff_frequency", cutoff_frequency, "Hz")
    n = len(body.mass_matrix)
    held = np.concatenate([6 * body.point_names.index(name) + np.arange(6) for name in kept])
    inner = np.setdiff1d(np.arange(n), held)
    stiffness, mass = (matrix[np.ix_(inner, inner)] for matrix in (body.stiffness_matrix, body.mass_matrix))
    coupling = body.stiffness_matrix[np.ix_(inner, held)]
    # Metres, radians and modal amplitudes: a unit diagonal keeps the solves accurate.
    scale = 1.0 / np.sqrt(np.diag(stiffness))
    statics = scale[:, None] * np.linalg.solve(
        scale[:, None] * stiffness * scale, scale[:, None] * np.hstack([-coupling, loads[inner]])
    )
    frequency, modes = eigenmodes(stiffness, mass)
    modes = modes[:, frequency <= cutoff_frequency]
    shapes = _shapes_beside(statics[:, len(held) :], modes, stiffness, mass)
    change = np.zeros((n, len(held) + modes.shape[1] + shapes.shape[1]))
    change[held, np.arange(len(held))] = 1.0
    change[inner] = np.hstack([statics[:, : len(held)], modes, shapes])
    fields = np.zeros((len(body.gram), 4 + 3 * change.shape[1]))
    fields[:4, :4], fields[4:, 4:] = np.eye(4), np.kron(change, np.eye(3))
    passive = [name for name in body.all_point_names if name not in kept]
    released = body.released_stiffness
    return replace(
        body,
        remote_points=tuple(body.point(name) for name in kept),
        mass_matrix=_congruent(body.mass_matrix, change),
        stiffness_matrix=_congruent(body.stiffness_matrix, change),
        gram=_congruent(body.gram, fields),
        surface=None,
        surface_modes=None,
        released_stiffness=None if released is None else _congruent(released, change),
        passive_points=tuple(body.point(name) for name in passive),
        passive_motions=np.vstack([np.zeros((0, n)), *(body.motion(name) for name in passive)]) @ change,
        enriched=body.enriched or body,
    )


def _shapes_beside(shapes: Array, modes: Array, stiffness: Array, mass: Array) -> Array:
    """The part of static shapes that modes do not hold, as Ritz vectors of unit modal mass."""
    shapes = shapes - modes @ (modes.T @ (mass @ shapes))
    energy = _congruent(stiffness, shapes)
    size, combinations = np.linalg.eigh(energy)
    shapes = shapes @ combinations[:, size > DEPENDENT * max(size[-1], 0.0)] if size.size else shapes
    if not shapes.shape[1]:
        return shapes
    _, ritz = eigenmodes(_congruent(stiffness, shapes), _congruent(mass, shapes))
    result: Array = shapes @ ritz
    return result


def _congruent(matrix: Array, change: Array) -> Array:
    """C^T A C, symmetric to the last digit."""
    result = change.T @ matrix @ change
    return 0.5 * (result + result.T)
