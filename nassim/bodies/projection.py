"""Reduced bodies in other coordinates: fewer points and modes with exact statics; electrical ports in open circuit.

Trimming is a second Craig-Bampton reduction, applied to the reduced matrices. The points that are kept are its
interface. Static shapes of the loads that act elsewhere replace the coordinates of the other points.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, known, not_negative, positive
from nassim.base.modal import eigenmodes
from nassim.base.rigid_motion import rigid_motions
from nassim.bodies.readouts import PassivePoint, Picture, by_name, readouts_of, sparse_if_faster
from nassim.bodies.reduced_body import ReducedBody
from nassim.bodies.strain import has_rigid_modes, remove_rounding
from nassim.bodies.stress import GaugeStrain, StressField
from nassim.bodies.stress_stiffness import BODY_FORCES, StressStiffness

DEPENDENT_SHAPE = 1e-10
"""Load shapes below this share of the largest energy are rounding errors and are left out.

A shape of which the modes leave less than this share of its own energy is left out too.
"""
SAME_MOTION = 1e-6
"""Difference of unit rigid motions below which a change of coordinates represents them by its points alone."""


def trim_body(body: ReducedBody, *, points: Collection[str], loads: Array, cutoff_frequency: float) -> ReducedBody:
    """Reduce a body to the given remote points as coordinates; its other points become passive.

    The result keeps the original body, without its surface, as its `enriched` body, so its truncation errors give the
    error of the trimming.

    Args:
        body: the reduced body
        points: names of the points that joints may hold; at least one
        loads: forces on the body's coordinates, shape (n, k). Their static responses, and those to voltages at the
            electrical ports, stay exact at every point, and those to body forces where the body keeps its stress. The
            stress of body forces stays exact in the geometric stiffness without them.
        cutoff_frequency: fixed-interface modes (all given points held) above this frequency are left out [Hz]

    Raises:
        ValueError: for unknown names and if there are no points
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
    # A unit diagonal balances metres, radians and modal amplitudes, and keeps the solves accurate.
    scale = 1.0 / np.sqrt(np.diag(stiffness))

    def respond(forces: Array) -> Array:
        """Return the static response of the inner coordinates to forces on them."""
        return scale[:, None] * np.linalg.solve(scale[:, None] * stiffness * scale, scale[:, None] * forces)

    loads = np.column_stack([loads, *_own_loads(body)])
    statics = respond(np.hstack([-coupling, loads[inner]]))
    frequency, modes = eigenmodes(stiffness, mass)
    modes = modes[:, frequency <= cutoff_frequency]
    shapes = _residual_shapes(statics[:, len(held) :], modes, stiffness, mass)
    change = np.zeros((n, len(held) + modes.shape[1] + shapes.shape[1]))
    change[held, np.arange(len(held))] = 1.0
    change[inner] = np.hstack([statics[:, : len(held)], modes, shapes])
    whole = body
    if body.stress_stiffness is not None:
        # Static response to body forces, with the kept points held, that the kept coordinates do not contain.
        forces = _body_forces(body)[inner]
        response = np.zeros((n, BODY_FORCES))
        response[inner] = respond(forces)
        held_still = change[:, len(held) :]
        within = _congruent(body.stiffness_matrix, held_still)
        response -= held_still @ np.linalg.solve(within, held_still[inner].T @ forces)
        stress = body.stress_stiffness.with_responses(response)
        whole = replace(body, readouts={**body.readouts, stress.name: stress})
    return replace(project(whole, change, points=kept), enriched=body.enriched or remove_surface(body))


def keep_modes(body: ReducedBody, n_modes: int) -> ReducedBody:
    """Return the same body with its first modal coordinates only; its `enriched` body is the richest form known.

    The static responses to voltages at electrical ports stay exact, and those to body forces where the body keeps its
    stress: further modal coordinates, at most one per port and 12 for body forces, replace the contribution of the
    coordinates that are removed.

    Args:
        body: the reduced body
        n_modes: number of modal coordinates to keep

    Raises:
        ValueError: if the body has fewer modes
    """
    if not 0 <= n_modes <= body.n_modes:
        raise ValueError(f"body {body.name!r} has {body.n_modes} modes, so it cannot keep {n_modes}")
    n_all, n = len(body.mass_matrix), 6 * len(body.remote_points) + n_modes
    stiffness, mass = body.stiffness_matrix[n:, n:], body.mass_matrix[n:, n:]
    loads = np.column_stack([np.zeros((n_all - n, 0)), *(load[n:] for load in _own_loads(body))])
    shapes = _residual_shapes(np.linalg.solve(stiffness, loads), np.zeros((n_all - n, 0)), stiffness, mass)
    change = np.eye(n_all, n + shapes.shape[1])
    change[n:, n:] = shapes
    richer = replace(remove_surface(body), released_stiffness=None)
    return replace(project(body, change, points=body.point_names), enriched=body.enriched or richer)


def project(body: ReducedBody, change: Array, *, points: Sequence[str]) -> ReducedBody:
    """Restrict a body to its coordinates q = change @ q'.

    The read-outs of the body are projected too.

    Args:
        body: the reduced body
        change: the body's coordinates per unit of the new ones, shape (n, n')
        points: names of the r' points whose motions are the first 6 r' new coordinates; all other remote points become
            passive
    """
    left = [PassivePoint(p, body.motion(p.name)) for p in body.remote_points if p.name not in points]
    readouts = [*left, *(readout for name, readout in body.readouts.items() if name not in points)]
    released = body.released_stiffness
    stiffness, kept = _congruent(body.stiffness_matrix, change), tuple(body.point(name) for name in points)
    if kept and has_rigid_modes(body.stiffness_matrix, body.mass_matrix, body.positions):
        places = np.array([point.position for point in kept])
        moved = change @ rigid_motions(places, change.shape[1])
        # With other modal coordinates, which move in rigid motions, rounding cannot be told from stiffness.
        if np.allclose(moved, rigid_motions(body.positions, len(change)), rtol=0.0, atol=SAME_MOTION):
            stiffness = remove_rounding(stiffness, places)
    return replace(
        body,
        remote_points=kept,
        mass_matrix=_congruent(body.mass_matrix, change),
        stiffness_matrix=stiffness,
        gram=_project_gram(body.gram, change),
        released_stiffness=None if released is None else _congruent(released, change),
        readouts=by_name(readout.projected(change) for readout in readouts),
    )


def open_circuit(body: ReducedBody, ports: Mapping[str, float]) -> ReducedBody:
    """Return a body with electrical ports whose charge stays zero (open circuit); their voltage adds stiffness.

    With the sum c of the port's own capacitance and the connected one, V = -b q / c, so the stiffness grows by b b^T /
    c.

    Args:
        body: the reduced body
        ports: name -> capacitance connected to the port, such as that of a cable [F]; 0 for none. All other ports stay
            at zero voltage.
    """
    stiffness, voltages = body.stiffness_matrix.copy(), {}
    for name, capacitance in ports.items():
        port = body.port(name)
        total = port.blocked_capacitance + not_negative(f"capacitance at port {name!r}", capacitance, "F")
        stiffness += np.outer(port.forces, port.forces) / total
        voltages[name] = -port.forces / total
    enriched = None if body.enriched is None else open_circuit(body.enriched, ports)
    return with_voltage_rows(replace(body, stiffness_matrix=stiffness, enriched=enriched), voltages)


def with_voltage_rows(body: ReducedBody, rows: Mapping[str, Array]) -> ReducedBody:
    """Return a body whose stress and geometric stiffness, if any, include port voltages that follow its coordinates.

    Args:
        body: the reduced body
        rows: name of a port -> its voltage per unit of the coordinates, shape (n,) [V]
    """
    changed = {
        name: readout.with_voltage_rows(rows) if isinstance(readout, (StressStiffness, StressField)) else readout
        for name, readout in body.readouts.items()
    }
    return replace(body, readouts=changed)


def keep_ports(body: ReducedBody, names: Collection[str]) -> ReducedBody:
    """Return the body with these electrical ports only; other ports stay at zero voltage, unknown names are ignored."""
    gone = {port.name for port in body.ports if port.name not in names}
    return replace(body, readouts={name: readout for name, readout in body.readouts.items() if name not in gone})


def remove_surface(body: ReducedBody) -> ReducedBody:
    """Return the body without its surface, which takes by far the most memory, for uses without images.

    Stress on surfaces remains as a read-out without points, so that projections keep static responses to body forces.
    """
    rest = {
        name: readout.without_points() if isinstance(readout, StressField) and readout.surface else readout
        for name, readout in body.readouts.items()
        if not isinstance(readout, Picture)
    }
    return replace(body, readouts=rest)


def keeps_stress(body: ReducedBody) -> bool:
    """Return whether a body keeps stress or strain, so that its static responses to body forces are exact."""
    return bool(readouts_of(body.readouts, StressField) or readouts_of(body.readouts, GaugeStrain))


def _own_loads(body: ReducedBody) -> list[Array]:
    """Return the loads on a body's coordinates, (n,) each, whose static responses every projection keeps exact."""
    loads = [port.forces for port in body.ports]
    return [*loads, *_body_forces(body).T] if keeps_stress(body) else loads


def _body_forces(body: ReducedBody) -> Array:
    """Return the forces of the body forces per mass g e_b, g = 1, x, y, z, b running first, shape (n, 12)."""
    n = len(body.mass_matrix)
    return body.gram[:4, 4:].reshape(4, n, 3).transpose(1, 0, 2).reshape(n, BODY_FORCES)


def _residual_shapes(shapes: Array, modes: Array, stiffness: Array, mass: Array) -> Array:
    """Return the part of static shapes that the modes do not contain, as Ritz vectors of unit modal mass."""
    whole = np.diag(_congruent(stiffness, shapes))
    shapes = shapes - modes @ (modes.T @ (mass @ shapes))
    energy = _congruent(stiffness, shapes)
    used = np.diag(energy) > DEPENDENT_SHAPE * whole
    if not used.any():
        return np.zeros((len(shapes), 0))
    shapes = shapes[:, used] / np.sqrt(np.diag(energy)[used])
    size, combinations = np.linalg.eigh(_congruent(stiffness, shapes))
    shapes = shapes @ combinations[:, size > DEPENDENT_SHAPE * size[-1]]
    _, ritz = eigenmodes(_congruent(stiffness, shapes), _congruent(mass, shapes))
    return shapes @ ritz


def _project_gram(gram: Array, change: Array) -> Array:
    """Return the Gram matrix of the fields 1, x, y, z and the displacement fields of new coordinates."""
    factor = sparse_if_faster(change)
    for _ in range(2):
        moving = factor.T @ gram[4:].reshape(len(change), -1)
        gram = np.vstack([gram[:4], moving.reshape(3 * change.shape[1], -1)]).T
    return 0.5 * (gram + gram.T)


def _congruent(matrix: Array, change: Array) -> Array:
    """Return C^T A C, made exactly symmetric."""
    factor = sparse_if_faster(change)
    result = factor.T @ (factor.T @ matrix.T).T
    return 0.5 * (result + result.T)
