"""Stress and strain of displacement fields of an FE model: at named points, along gauges, over surfaces.

The stress of an element jumps at its faces. Its values at a node are therefore averaged over all elements of one CAD
body that meet there, at nodes of the elements' own order, and interpolated between the nodes of an element. CAD bodies
are kept apart, because stress jumps where materials meet.
Source: O. C. Zienkiewicz, R. L. Taylor, J. Z. Zhu, The Finite Element Method, 7th ed. (2013), ch. 15.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nassim.base.checks import Array, instances, known, unique
from nassim.base.progress import Advance, silent
from nassim.bodies.readouts import SURFACE, Readout, Surface
from nassim.bodies.stress import PAIRS, GaugeStrain, StressField
from nassim.bodies.stress_stiffness import STRESS_STIFFNESS
from nassim.fem.cad_files import millimetres
from nassim.fem.element_finder import ElementFinder, ElementPoints, cad_bodies, distance, lattice, mesh_points
from nassim.fem.fe_model import FEModel
from nassim.fem.native_threads import threads
from nassim.fem.ports import blocked_stress
from nassim.fem.skin import triangle_faces
from nassim.fem.solid import Solid
from nassim.fem.stress_places import GaugeLine, Place, StressPoint, StressSurface

SURFACE_NODES = 2
"""Nodes along an element's edge, less one, on a surface: its pictures show corners and midpoints of edges."""
SAME_PLACE = 1e-5
"""Distance of equal nodes of two elements over the size of an element."""
LINEAR_STRESS = 2
"""Order of the elements up to which the stress in an element is linear at most."""
GAUGE_POINTS = 9
"""Number of points of a gauge's line at which its face is looked for."""
FLATNESS = 0.01
"""Distance of a gauge's line from its face, over its length, up to which the face is straight along it."""
COLUMNS = 8
"""Number of displacement fields that are evaluated at once."""
PROBES = COLUMNS
"""Number of random displacements by which the element of each node that deviates most is found."""
RIGID = 1e-12
"""Squared size of a displacement, over that of the largest one, below which it is rounding."""
STRAIN_OF_GRADIENT = 0.5 * np.array([[(3 * i + j == a) + (3 * j + i == a) for i, j in PAIRS] for a in range(9)])
"""Components of the strain in the order of those of stress per entry of a gradient, row by row, (9, 6)."""


@dataclass(frozen=True)
class StressEvaluation:
    """How the stress at m points follows from that at k samples.

    Attributes:
        place: what was asked for
        samples: points in elements
        positions: the m points, shape (m, 3) [m]
        mean: weights of the samples, sparse, shape (m, k)
        deviations: weights of the samples in differences of the mean from the stress of one element, or from the mean
            of those at the ends of an edge, sparse, shape (c, k); the largest difference of a point estimates its error
        owners: numbers of the points of these differences, shape (c,)
        surface: triangles between the points, or None
    """

    place: StressPoint | StressSurface
    samples: ElementPoints
    positions: Array
    mean: sp.csr_matrix
    deviations: sp.csr_matrix
    owners: NDArray[np.int64]
    surface: Surface | None = field(default=None, repr=False)


@dataclass(frozen=True)
class StressPlan:
    """Checked places of an FE model at which stress and strain are evaluated; see `plan_stress`."""

    model: FEModel
    evaluations: tuple[StressEvaluation, ...]
    gauges: tuple[tuple[GaugeLine, ElementPoints], ...]


def plan_stress(model: FEModel, places: Sequence[Place]) -> StressPlan:
    """Find the elements of places, and check that the places are on the solid.

    Args:
        model: the FE model
        places: points, surfaces and gauges

    Raises:
        ValueError: for a model that was not made from a mesh, for names used twice or by remote points and ports, for a
            point outside the solid or where several CAD bodies meet, for a gauge that is not on one face, and for
            unknown faces and CAD bodies
    """
    places = instances("stress", places, (StressPoint, StressSurface, GaugeLine))
    if model._source is None:
        raise ValueError(
            f"FE model {model.name!r} was not made from a mesh by build_fe_model, so stress cannot be computed: its "
            "matrices do not say how the material deforms. Give no `stress`, or reduce a Solid"
        )
    mesh, solid = model._source
    taken = [*(p.name for p in model.remote_points), *(port.name for port in model.ports), SURFACE, STRESS_STIFFNESS]
    unique(
        f"solid {solid.name!r}: remote point, electrical port and place of stress", [*taken, *(p.name for p in places)]
    )
    finder = ElementFinder(mesh, solid)
    evaluations = tuple(
        _at_point(finder, model.order, place) if isinstance(place, StressPoint) else _on_surface(finder, model, place)
        for place in places
        if not isinstance(place, GaugeLine)
    )
    gauges = tuple((place, _along_gauge(finder, place)) for place in places if isinstance(place, GaugeLine))
    return StressPlan(model, evaluations, gauges)


def stress_readouts(plan: StressPlan, basis: Array, scale: Array, *, advance: Advance = silent) -> list[Readout]:
    """Evaluate stress and strain of displacement fields.

    Args:
        plan: the places
        basis: displacements of n coordinates, shape (n_dofs, n)
        scale: amplitudes of the coordinates that matter alike, as those of unit energy, shape (n,)
        advance: called once per field

    Returns:
        The read-outs, in the order of the places, gauges last.
    """
    n = basis.shape[1]
    mesh, solid = plan.model._source  # type: ignore[misc]
    shown = _Fields(mesh, plan.model.order)
    materials = [_Elasticity(mesh, solid, e) for e in plan.evaluations]
    points = [mesh_points(mesh, e.samples) for e in plan.evaluations]
    of_gauges = [mesh_points(mesh, samples) for _, samples in plan.gauges]
    rows = [np.zeros((len(e.positions), 6, n)) for e in plan.evaluations]
    deviations = [np.zeros_like(part) for part in rows]
    strains = np.zeros((len(plan.gauges), n))
    with threads():
        shown.load(basis @ _probes(basis, scale))
        chosen = []
        for evaluation, material, at in zip(plan.evaluations, materials, points, strict=True):
            differences = material.stress(evaluation.deviations, shown.strain(at), evaluation.owners)
            chosen.append(_largest(evaluation, np.sum(differences**2, axis=(1, 2))))
        for start in range(0, n, COLUMNS):
            part = slice(start, min(start + COLUMNS, n))
            shown.load(basis[:, part])
            for i, (evaluation, at) in enumerate(zip(plan.evaluations, points, strict=True)):
                strain = shown.strain(at)
                for result, weights in ((rows[i], evaluation.mean), (deviations[i], chosen[i])):
                    result[:, :, part] = materials[i].stress(weights, strain).transpose(0, 2, 1)
            for i, (gauge, _) in enumerate(plan.gauges):
                ends = shown.displacement(of_gauges[i])
                strains[i, part] = (ends[1] - ends[0]) @ gauge.direction / gauge.length
            for _ in range(part.start, part.stop):
                advance()
    fields: list[Readout] = [
        StressField(
            e.place.name,
            positions=e.positions,
            rows=rows[i],
            deviations=deviations[i],
            voltages=_blocked(materials[i], e, plan.model),
            surface=e.surface,
        )
        for i, e in enumerate(plan.evaluations)
    ]
    return [*fields, *(GaugeStrain(g.name, row, g.ends) for (g, _), row in zip(plan.gauges, strains, strict=True))]


class _Fields:
    """Several displacement fields as one function of NGSolve, which then computes its shape functions once for all."""

    def __init__(self, mesh: Any, order: int) -> None:
        self.function = ng.GridFunction(ng.H1(mesh, order=order, dim=3 * COLUMNS))
        self.derivative = ng.Grad(self.function)
        self.values = self.function.vec.FV().NumPy().reshape(-1, COLUMNS, 3)
        self.n = 0

    def load(self, fields: Array) -> None:
        """Take displacements, (n_dofs, n), at most `COLUMNS`."""
        self.n = fields.shape[1]
        self.values[:, : self.n] = fields.reshape(3, -1, self.n).transpose(1, 2, 0)

    def displacement(self, points: Any) -> Array:
        """Return the displacements at k points, (k, n, 3)."""
        return np.asarray(self.function(points)).reshape(-1, COLUMNS, 3)[:, : self.n]

    def strain(self, points: Any) -> Array:
        """Return the strain at k points, (k, n, 6)."""
        # One product of matrices is faster than one for each point.
        strain = np.asarray(self.derivative(points)).reshape(-1, 9) @ STRAIN_OF_GRADIENT
        return strain.reshape(-1, COLUMNS, 6)[:, : self.n]


class _Elasticity:
    """Isotropic elasticity at the points of an evaluation; the samples of a point belong to one CAD body."""

    def __init__(self, mesh: Any, solid: Solid, evaluation: StressEvaluation) -> None:
        self.solid = solid
        first = evaluation.mean.indices[evaluation.mean.indptr[:-1]]
        self.bodies = cad_bodies(mesh)[evaluation.samples.elements[first]]
        lame = {name: solid.materials[name].lame_parameters for name in np.unique(self.bodies).tolist()}
        self.lame = np.array([lame[name] for name in self.bodies.tolist()]).reshape(-1, 2)

    def stress(self, weights: sp.csr_matrix, strain: Array, owners: NDArray[np.int64] | None = None) -> Array:
        """Return the stress (m, n, 6) of weighted sums (m, k) of the strain of samples (k, n, 6).

        owners: numbers of the points whose material the sums have, (m,); None: those of all points.
        """
        summed = (weights @ strain.reshape(len(strain), -1)).reshape(-1, *strain.shape[1:])
        first, second = (self.lame if owners is None else self.lame[owners]).T[..., None, None]
        result: Array = 2 * second * summed
        result[..., :3] += first * summed[..., :3].sum(axis=-1, keepdims=True)
        return result


def _blocked(material: _Elasticity, evaluation: StressEvaluation, model: FEModel) -> dict[str, Array]:
    """Return the stress per volt with all held at the points of an evaluation, by port that has any there."""
    result = {}
    for port in material.solid.ports:
        if port.name not in [kept.name for kept in model.ports]:
            continue
        stress = np.zeros((len(evaluation.positions), 6))
        for body in port.bodies:
            s = -blocked_stress(material.solid, port, body)
            stress[material.bodies == body] = [s[pair] for pair in PAIRS]
        if stress.any():
            result[port.name] = stress
    return result


def _probes(basis: Array, scale: Array) -> Array:
    """Return normally distributed amplitudes of coordinates of a size, (n, PROBES), which belong to displacements.

    The displacements are the same for any signs of the fields and any rotation among fields of equal size, which depend
    on rounding: the numbers are drawn by unknown, and orthonormal fields take them to the coordinates.

    Args:
        basis: displacements of n coordinates, shape (n_dofs, n)
        scale: size of the amplitudes, shape (n,)
    """
    squares, axes = np.linalg.eigh(scale[:, None] * (basis.T @ basis) * scale)
    moving = squares > RIGID * squares[-1]
    drawn = scale[:, None] * (basis.T @ np.random.default_rng(0).standard_normal((len(basis), PROBES)))
    orthonormal = axes[:, moving] / np.sqrt(squares[moving]) @ axes[:, moving].T
    return scale[:, None] * (orthonormal @ drawn)


def _largest(evaluation: StressEvaluation, spread: Array) -> sp.csr_matrix:
    """Return the difference of each point whose spread is largest."""
    order = np.lexsort((spread, evaluation.owners))
    last = np.append(np.flatnonzero(np.diff(evaluation.owners[order])), len(order) - 1)
    return evaluation.deviations[order[last]]


def _differences(mean: sp.csr_matrix, owner: NDArray[np.int64], samples: NDArray[np.int64]) -> sp.csr_matrix:
    """Return the rows of means minus single samples."""
    ones, shape = np.ones(len(samples)), (len(samples), mean.shape[1])
    return sp.csr_matrix(mean[owner] - sp.csr_matrix((ones, (np.arange(len(samples)), samples)), shape=shape))


def _matched(positions: Array, places: Array, size: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return numbers of places and of the positions that equal them."""
    distance, owner = cKDTree(places).query(positions, distance_upper_bound=SAME_PLACE * size)
    near = np.flatnonzero(np.isfinite(distance))
    return owner[near], near


def _mean(owner: NDArray[np.int64], samples: NDArray[np.int64], shape: tuple[int, int]) -> sp.csr_matrix:
    """Return the matrix that averages the samples of each owner."""
    counts = np.bincount(owner, minlength=shape[0])
    return sp.csr_matrix((1.0 / counts[owner], (owner, samples)), shape=shape)


def _with_neighbours(
    owner: NDArray[np.int64], samples: NDArray[np.int64], elements: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of points and samples: each point with its own, one of a single element with all of that element.

    At a corner of the solid the element is alone and deviates from nothing.
    """
    single = np.bincount(owner)[owner] == 1
    lone = sp.csr_matrix(
        (np.ones(np.count_nonzero(single)), (owner[single], elements[samples[single]])),
        shape=(owner.max() + 1, elements.max() + 1),
    )
    every = sp.csr_matrix((np.ones(len(elements)), (elements, np.arange(len(elements)))))
    points, others = (lone @ every).nonzero()
    return np.concatenate([owner[~single], points]), np.concatenate([samples[~single], others])


def _at_point(finder: ElementFinder, order: int, place: StressPoint) -> StressEvaluation:
    """Plan the stress at a point: interpolated between the averaged nodes of its element."""
    at = finder.find(f"stress point {place.name!r}", np.asarray(place.position), place.cad_body)
    element = int(at.elements[0])
    kind = finder.kinds[int(finder.types[element])]
    own = finder.nodes(at.elements, order)
    all_nodes = finder.nodes(finder.around_element(element), order)
    size = finder.size(np.asarray(place.position))
    owner, near = _matched(finder.positions(all_nodes), finder.positions(own), size)
    mean = _mean(owner, near, (len(own.elements), len(all_nodes.elements)))
    exponents = lattice(kind, order)
    monomials = [np.prod(x[:, None, :] ** exponents, axis=2) for x in (own.reference, at.reference)]
    weights = sp.csr_matrix(np.linalg.solve(monomials[0].T, monomials[1].T).T)
    # All nodes of the element count, because at a corner of the solid it is alone and deviates from nothing.
    alone = all_nodes.elements[near] == element
    deviations = _differences(mean, owner[alone], near[alone])
    if order == LINEAR_STRESS:
        deviations = sp.csr_matrix(sp.vstack([deviations, _bends(mean, *_halves(exponents))]))
    position, owners = np.atleast_2d(place.position), np.zeros(deviations.shape[0], dtype=np.int64)
    return StressEvaluation(place, all_nodes, position, sp.csr_matrix(weights @ mean), deviations, owners)


def _on_surface(finder: ElementFinder, model: FEModel, place: StressSurface) -> StressEvaluation:
    """Plan the stress on a surface: at corners and midpoints of edges of the surface's own triangles."""
    surface = model.surface
    assert surface is not None
    bodies, faces = triangle_faces(finder.mesh)
    outer = np.unique(faces).tolist()
    for face in place.faces:
        known(f"outer face of stress surface {place.name!r}", face, outer)
    wanted = np.isin(faces, place.faces) if place.faces else np.ones(len(faces), dtype=bool)
    # A point where CAD bodies meet has a stress in each.
    numbers, names = np.unique(bodies, return_inverse=True)
    corners = surface.triangles[wanted] + len(surface.points) * names[wanted, None]
    used, triangles = np.unique(corners, return_inverse=True)
    positions, body = surface.points[used % len(surface.points)], used // len(surface.points)
    touching = np.flatnonzero(finder.corners @ np.isin(np.arange(finder.mesh.nv), finder.tree.query(positions)[1]))
    samples = finder.nodes(touching, SURFACE_NODES)
    at = finder.positions(samples)
    size, owners, nears = finder.size(positions[0]), [], []
    for k, name in enumerate(numbers.tolist()):
        mine, theirs = np.flatnonzero(body == k), np.flatnonzero(finder.bodies[samples.elements] == name)
        if len(mine):
            owner, near = _matched(at[theirs], positions[mine], size)
            owners.append(mine[owner])
            nears.append(theirs[near])
    owner, near = np.concatenate(owners), np.concatenate(nears)
    if len(lost := np.setdiff1d(np.arange(len(positions)), owner)):
        raise ValueError(
            f"stress surface {place.name!r}: no node of an element lies at {millimetres(positions[lost[0]])}, a point "
            "of the surface, so the mesh is curved beyond the order of its elements: raise the order"
        )
    kept, near = np.unique(near, return_inverse=True)
    samples = ElementPoints(samples.reference[kept], samples.elements[kept])
    mean = _mean(owner, near, (len(positions), len(kept)))
    edges = surface.edges
    both = np.vstack([edges + len(surface.points) * k for k in range(len(numbers))])
    inside = np.all(np.isin(both, used), axis=1)
    labels = tuple(label for label, chosen in zip(surface.labels, wanted.tolist(), strict=True) if chosen)
    drawn = Surface(positions, triangles.reshape(-1, 3), np.searchsorted(used, both[inside]), labels)
    of, beside = _with_neighbours(owner, near, samples.elements)
    deviations = _differences(mean, owner[np.argsort(near)][beside], beside)
    if model.order <= LINEAR_STRESS:
        # The edges of a surface are the halves of those of the mesh: from a corner to a midpoint.
        corners, middles = drawn.edges[np.argsort(drawn.edges[:, 1], kind="stable")].T
        first = np.flatnonzero(middles[1:] == middles[:-1])
        ends, middle = np.column_stack([corners[first], corners[first + 1]]), middles[first]
        bends = _bends(mean, ends, middle)
        deviations = sp.csr_matrix(sp.vstack([deviations, bends, bends, bends]))
        of = np.concatenate([of, middle, *ends.T])
    return StressEvaluation(place, samples, positions, mean, deviations, of, drawn)


def _bends(mean: sp.csr_matrix, ends: NDArray[np.int64], middles: NDArray[np.int64]) -> sp.csr_matrix:
    """Return means at midpoints of edges minus those halfway between the ends.

    Elements of second order have a linear stress. Neighbours agree on one that bends, such as that around a peak, and
    are too low together.
    """
    return sp.csr_matrix(mean[middles] - 0.5 * (mean[ends[:, 0]] + mean[ends[:, 1]]))


def _halves(exponents: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the corners at the ends of the lines of an element of second order and their midpoints, by nodes."""
    number = {tuple(node): k for k, node in enumerate(exponents.tolist())}
    corners = np.flatnonzero((exponents % 2 == 0).all(axis=1))
    ends = np.array(list(itertools.combinations(corners.tolist(), 2)))
    return ends, np.array([number[tuple(node)] for node in (exponents[ends].sum(axis=1) // 2).tolist()])


def _along_gauge(finder: ElementFinder, gauge: GaugeLine) -> ElementPoints:
    """Find both ends of a gauge, and check that its line is on one face."""
    label, ends = f"gauge {gauge.name!r}", gauge.ends
    line = ends[0] + np.linspace(0, 1, GAUGE_POINTS)[:, None] * (ends[1] - ends[0])
    tolerance = FLATNESS * gauge.length
    apart = np.array([[distance(face, point) for point in line] for face in finder.solid.shape.faces])
    if apart.max(axis=1).min() > tolerance:
        nearest = apart.min(axis=0)
        reason = (
            f"crosses an edge: no one face holds all of its length of {1e3 * gauge.length:.4g} mm; move or shorten it"
            if nearest.max() <= tolerance
            else f"leaves the surface by {1e3 * nearest.max():.3g} mm; give the middle of the gauge on a face, a "
            "direction along the face, and a length over which the face is straight"
        )
        raise ValueError(f"{label}, from {millimetres(ends[0])} to {millimetres(ends[1])}, {reason}")
    found = [finder.find(label, end, _body_at(finder, end)) for end in ends]
    return ElementPoints(np.vstack([f.reference for f in found]), np.concatenate([f.elements for f in found]))


def _body_at(finder: ElementFinder, place: Array) -> str:
    """Return a CAD body at a place; displacements are the same in all that meet there."""
    nearest = min(finder.solid.shape.solids, key=lambda solid: distance(solid, place))
    return str(nearest.name)
