"""Element sizes of a mesh for a tolerance: at first from the CAD, then from the estimated errors by element."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import ngsolve as ng
import numpy as np
from numpy.typing import NDArray

from nassim.base.checks import Array, known
from nassim.bodies.reduced_body import SATURATION
from nassim.fem.assembly import SMALLER
from nassim.fem.cad_sizes import LARGEST_PER_RADIUS, CADSizes, interface_sizes, sizes_from_cad
from nassim.fem.curving import Curving
from nassim.fem.mesh_targets import MeshTargets
from nassim.fem.meshing import OCC_AXES, extrusion_axis, generate_mesh
from nassim.fem.solid import Solid

LARGEST_PER_LENGTH = 1 / 6
"""Largest element size as a share of the solid's length."""
CONVERGENCE = 1.5
"""Exponent r of the elements' error, size^(2 r); below the order because of corners and flat elements."""
SIZE_CHANGE = (0.35, 1.25)
"""Smallest and largest factor on an element's size between two meshes."""
RELAXED_CAD_SIZES = 1.4
"""Factor on the sizes from CAD in later meshes, whose sizes come from the estimate; not in round bars."""
PRISMS_PER_RADIUS = 1.0
"""Largest size of prisms across their axis, as a multiple of the radius of curvature."""
FEWEST_LAYERS = 2
THIN_WALL = 1 / 6
"""Thickness of the walls as a share of the depth below which the first and the last layer of prisms are as thick."""


@dataclass(frozen=True)
class Prisms:
    """How a solid is meshed with prisms.

    Attributes:
        extrude: axis of the extrusion, "x", "y" or "z"
        layer_thickness: largest thickness of a layer [m]
        end_layers: thickness of the first and the last layer [m]; None for that of the others
    """

    extrude: str
    layer_thickness: float
    end_layers: float | None

    @staticmethod
    def from_cad(solid: Solid, cad: CADSizes, largest: float, options: Mapping[str, Any]) -> "Prisms | None":
        """Return the layers of a solid that is extruded along an axis, None for another solid.

        At the ends of a thin wall, torsion changes the strain within a length of about the thickness.
        """
        extrude = options["extrude"] or extrusion_axis(solid)
        if extrude is None:
            return None
        if options["layer_thickness"] is not None:
            return Prisms(extrude, options["layer_thickness"], None)
        k = "xyz".index(known("extrude", extrude, OCC_AXES))
        depth = float(np.ptp([tuple(corner)[k] for corner in solid.shape.bounding_box]))
        wall = cad.wall(k)
        return Prisms(extrude, min(largest, depth / FEWEST_LAYERS), wall if wall < THIN_WALL * depth else None)


@dataclass(frozen=True)
class MeshSizing:
    """Element sizes for a mesh.

    Attributes:
        largest: largest size [m]
        cad: points and sizes from the CAD in later meshes, shapes (n, 3) and (n,) [m]
        points: points and sizes of the next mesh, shapes (m, 3) and (m,) [m]
        prisms: how extruded bodies are meshed with prisms, None for tetrahedra
    """

    largest: float
    cad: tuple[Array, Array]
    points: tuple[Array, Array]
    prisms: Prisms | None = None

    @staticmethod
    def from_cad(solid: Solid, options: Mapping[str, Any]) -> "MeshSizing":
        """Return the sizes before the first mesh; options: arguments of `generate_mesh` that the user gave."""
        corners = np.array([tuple(corner) for corner in solid.shape.bounding_box])
        largest = LARGEST_PER_LENGTH * float(np.ptp(corners, axis=0).max())
        cad = sizes_from_cad(solid)
        prisms = Prisms.from_cad(solid, cad, largest, options)
        interfaces, interface_limits = interface_sizes(solid)
        points = np.vstack([cad.points, interfaces])
        per_radius = LARGEST_PER_RADIUS if prisms is None else PRISMS_PER_RADIUS
        first, later = (
            np.append(cad.sizes(per_radius, relaxed=factor), factor * interface_limits)
            for factor in (1.0, RELAXED_CAD_SIZES)
        )
        small = first < largest
        return MeshSizing(largest, (points[small], later[small]), (points[small], first[small]), prisms)

    def mesh(self, solid: Solid, options: Mapping[str, Any], *, tetrahedra_instead: bool = True) -> Any:
        """Return a Netgen mesh with these sizes; tetrahedra_instead: as of `generate_mesh`."""
        layers = asdict(self.prisms) if self.prisms else {}
        return generate_mesh(
            solid,
            element_size=self.largest,
            point_sizes=self.points,
            tetrahedra_instead=tetrahedra_instead,
            **{**options, **layers},
        )

    @property
    def can_be_coarser(self) -> bool:
        """Whether a size is below the largest."""
        return bool(np.any(self.points[1] < self.largest))

    def coarsened(self, factor: float) -> "MeshSizing":
        """Return sizes larger by a factor; those above the largest do not limit a mesh."""
        cad, points = ((places, factor * sizes) for places, sizes in (self.cad, self.points))
        return replace(self, cad=cad, points=points)

    def refined(self, mesh: Any, targets: MeshTargets, curving: Curving, goal: float) -> "MeshSizing":
        """Return sizes with which the error of the worst target is the goal, with as few elements as possible.

        The error of an element falls with size^(2 r), and the number of elements grows with size^-3. The optimum has
        equal errors in all elements, each element's being that of the target for which it is largest. The prisms of one
        column have one size. Elements are smaller where some could not be mended, in this mesh and in later ones.
        """
        centres, size, columns = element_sizes(mesh, self.prisms.extrude if self.prisms else None)
        shares = np.array([np.bincount(columns, weights=share) for share in targets.shares.T]).T
        errors = shares * (SATURATION * targets.powers / goal)
        worst = np.max(errors, axis=1)
        worst = np.maximum(worst, 1e-9 * worst.max())
        r = CONVERGENCE
        equal = np.max(worst ** (-2 * r / (2 * r + 3)) @ errors) ** (-(2 * r + 3) / (2 * r))
        change = np.clip((equal / worst) ** (1 / (2 * r + 3)), *SIZE_CHANGE)[columns]
        kept = np.vstack([self.cad[0], curving.corners]), np.append(self.cad[1], SMALLER * curving.sizes)
        points = np.vstack([centres, kept[0]]), np.append(change * size, kept[1])
        return replace(self, cad=kept, points=points)


def element_sizes(mesh: Any, axis: str | None = None) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the sizes of the elements of a mesh.

    Args:
        mesh: NGSolve mesh
        axis: "x", "y" or "z" along which prisms are extruded; None only for a mesh without prisms

    Returns:
        Centres, shape (n, 3) [m]; mean lengths, shape (n,) [m], of the edges, for prisms of those across the axis; and
        numbers of the columns of prisms, or of single elements of other kinds, shape (n,).
    """
    points = np.array([vertex.point for vertex in mesh.vertices])
    ends = np.array([[vertex.nr for vertex in edge.vertices] for edge in mesh.edges])
    elements = list(mesh.Elements(ng.VOL))
    centres = np.array([points[[vertex.nr for vertex in element.vertices]].mean(axis=0) for element in elements])
    across = np.ones(3)
    if axis:
        across["xyz".index(axis)] = 0.0
    edges = points[ends[:, 0]] - points[ends[:, 1]]
    length, flat = np.linalg.norm(edges, axis=1), np.linalg.norm(edges * across, axis=1)
    prism = np.array([element.type == ng.ET.PRISM for element in elements])
    sizes = np.empty(len(elements))
    for i, element in enumerate(elements):
        numbers = [edge.nr for edge in element.edges]
        sizes[i] = flat[numbers].sum() / 6 if prism[i] else length[numbers].mean()
    keys = np.column_stack([centres * np.where(prism[:, None], across, 1.0), prism])
    columns = np.unique(np.round(keys, 9), axis=0, return_inverse=True)[1].ravel()
    return centres, sizes, columns
