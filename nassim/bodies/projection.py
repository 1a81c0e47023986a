"""Reduced bodies in other coordinates: fewer points and modes, exact in statics; electrical ports in open circuit.

Trimming is a second Craig-Bampton reduction, of the reduced matrices: the points that stay are its interface, static
shapes of the loads that act elsewhere replace the coordinates of the other points.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, known, not_negative, positive
from nassim.base.modal import eigenmodes
from nassim.bodies.readouts import PassivePoint, Picture, by_name
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.strain import has_rigid_modes, without_rounding

DEPENDENT = 1e-10
"""Load shapes with less than this share of the largest one's energy add nothing, nor what modes leave of one with less
than this share of its own: rounding."""


def trim_body(body: ReducedBody, *, points: Collection[str], loads: Array, cutoff_frequency: float) -> ReducedBody:
    """The body with the given remote points as coordinates, and all others as points that only move along.

    points: names of those that joints may hold; at least one
    loads: forces on the body's coordinates, shape (n, k). The static answers to them, and to voltages at the electrical
        ports, stay exact at every point
    cutoff_frequency: fixed-interface modes (all given points held) above it are left out [Hz]

    The result keeps the richer body as its `enriched`, without its picture, so its truncation errors say what the
    trimming costs. Raises ValueError for unknown names and no points at all.
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
    loads = np.column_stack([loads, *(port.forces for port in body.ports)])
    statics = scale[:, None] * np.linalg.solve(
        scale[:, None] * stiffness * scale, scale[:, None] * np.hstack([-coupling, loads[inner]])
    )
    frequency, modes = eigenmodes(stiffness, mass)
    modes = modes[:, frequency <= cutoff_frequency]
    shapes = _shapes_beside(statics[:, len(held) :], modes, stiffness, mass)
    change = np.zeros((n, len(held) + modes.shape[1] + shapes.shape[1]))
    change[held, np.arange(len(held))] = 1.0
    change[inner] = np.hstack([statics[:, : len(held)], modes, shapes])
    return replace(project(body, change, points=kept), enriched=body.enriched or without_picture(body))


def keep_modes(body: ReducedBody, n_modes: int) -> ReducedBody:
    """The same body with its first n_modes modal coordinates only; its `enriched` is the richest form known.

    The static answers to voltages at electrical ports stay exact: what the coordinates that go contributed to them is
    kept by further modal coordinates, one per port at most. Raises ValueError when there are not so many modes.
    """
    if not 0 <= n_modes <= body.n_modes:
        raise ValueError(f"body {body.name!r} has {body.n_modes} modes, so it cannot keep {n_modes}")
    n_all, n = len(body.mass_matrix), 6 * len(body.remote_points) + n_modes
    stiffness, mass = body.stiffness_matrix[n:, n:], body.mass_matrix[n:, n:]
    loads = np.column_stack([np.zeros((n_all - n, 0)), *(port.forces[n:] for port in body.ports)])
    shapes = _shapes_beside(np.linalg.solve(stiffness, loads), np.zeros((n_all - n, 0)), stiffness, mass)
    change = np.eye(n_all, n + shapes.shape[1])
    change[n:, n:] = shapes
    richer = replace(without_picture(body), released_stiffness=None)
    return replace(project(body, change, points=body.point_names), enriched=body.enriched or richer)


def project(body: ReducedBody, change: Array, *, points: Sequence[str]) -> ReducedBody:
    """The body restricted to its coordinates q = change @ q', shape (n, n').

    points: names of the r' points whose motions are the first 6 r' new coordinates; all other remote points become
        passive. Everything that the body reads out is carried along
    """
    fields = np.zeros((len(body.gram), 4 + 3 * change.shape[1]))
    fields[:4, :4], fields[4:, 4:] = np.eye(4), np.kron(change, np.eye(3))
    left = [PassivePoint(p, body.motion(p.name)) for p in body.remote_points if p.name not in points]
    readouts = [*left, *(readout for name, readout in body.readouts.items() if name not in points)]
    released = body.released_stiffness
    stiffness, kept = _congruent(body.stiffness_matrix, change), tuple(body.point(name) for name in points)
    if kept and has_rigid_modes(body.stiffness_matrix, body.mass_matrix, body.positions):
        stiffness = without_rounding(stiffness, np.array([point.position for point in kept]))
    return replace(
        body,
        remote_points=kept,
        mass_matrix=_congruent(body.mass_matrix, change),
        stiffness_matrix=stiffness,
        gram=_congruent(body.gram, fields),
        released_stiffness=None if released is None else _congruent(released, change),
        readouts=by_name(readout.projected(change) for readout in readouts),
    )


def open_circuit(body: ReducedBody, ports: Mapping[str, float]) -> ReducedBody:
    """The body with electrical ports whose charge stays zero (open circuit): their voltage opposes motion and stiffens.

    ports: name -> capacitance connected to it, such as a cable's [F]; 0 for none. All other ports stay at zero voltage.
    With c the port's own capacitance and the connected one, V = -b q / c, so the stiffness grows by b b^T / c.
    """
    stiffness = body.stiffness_matrix.copy()
    for name, capacitance in ports.items():
        port = body.port(name)
        total = port.blocked_capacitance + not_negative(f"capacitance at port {name!r}", capacitance, "F")
        stiffness += np.outer(port.forces, port.forces) / total
    enriched = None if body.enriched is None else open_circuit(body.enriched, ports)
    return replace(body, stiffness_matrix=stiffness, enriched=enriched)


def keep_ports(body: ReducedBody, names: Collection[str]) -> ReducedBody:
    """The body with these electrical ports only (other names are ignored); its other ports stay at zero voltage."""
    gone = {port.name for port in body.ports if port.name not in names}
    return replace(body, readouts={name: readout for name, readout in body.readouts.items() if name not in gone})


def without_picture(body: ReducedBody) -> ReducedBody:
    """The body without its surface, by far the largest part of one, where nobody looks at it."""
    rest = {name: readout for name, readout in body.readouts.items() if not isinstance(readout, Picture)}
    return replace(body, readouts=rest)


def _shapes_beside(shapes: Array, modes: Array, stiffness: Array, mass: Array) -> Array:
    """The part of static shapes that modes do not hold, as Ritz vectors of unit modal mass."""
    whole = np.diag(_congruent(stiffness, shapes))
    shapes = shapes - modes @ (modes.T @ (mass @ shapes))
    energy = _congruent(stiffness, shapes)
    used = np.diag(energy) > DEPENDENT * whole
    if not used.any():
        return np.zeros((len(shapes), 0))
    shapes = shapes[:, used] / np.sqrt(np.diag(energy)[used])
    size, combinations = np.linalg.eigh(_congruent(stiffness, shapes))
    shapes = shapes @ combinations[:, size > DEPENDENT * size[-1]]
    _, ritz = eigenmodes(_congruent(stiffness, shapes), _congruent(mass, shapes))
    result: Array = shapes @ ritz
    return result


def _congruent(matrix: Array, change: Array) -> Array:
    """C^T A C, symmetric to the last digit."""
    result = change.T @ matrix @ change
    return 0.5 * (result + result.T)
