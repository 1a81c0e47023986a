"""Meshes of solids by Netgen: tetrahedra in general, prisms where CAD bodies are extruded along an axis."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from typing import Any

import netgen.occ as occ
import numpy as np
from netgen.libngpy._meshing import MeshingParameters, NgException, _SetTerminate

from nassim.base.checks import Array, known, positive
from nassim.base.library_lock import hold_library_lock
from nassim.base.warning_log import note, warn
from nassim.fem.faces import solid_triangles
from nassim.fem.netgen_output import silence
from nassim.fem.solid import Solid, face_names

OCC_AXES = {"x": occ.X, "y": occ.Y, "z": occ.Z}
EMPTY_CELL = "(empty)"
"""Name of cells without material. While a mesh is made, CAD bodies have numbers as names."""
PARALLEL = 1e-6
"""Largest cosine of the angle between an axis and the normals of faces that are parallel to it."""
SAME_SIZE = 1e-9
"""Relative difference of volumes and areas that counts as zero."""
TRIALS = (
    *((0.7, 1.0), (0.5, 1.0), (0.5, 0.95), (0.4, 1.0), (0.6, 1.0), (0.3, 1.0)),
    *((0.6, 0.9), (0.5, 0.9), (0.4, 0.9), (0.7, 0.8), (0.5, 0.8)),
)
"""Growth of the elements away from small features (Netgen's grading) and factor on the size, in the order of trial.

Between prisms and tetrahedra, Netgen fails in two or three of four trials; tetrahedra alone need several times as many.
"""
FILL_ATTEMPTS = 3
"""Netgen's attempts to fill a CAD body. Further attempts take minutes and usually fail too."""
SMALLEST_DISTANCE = 1e-6
"""Distances below this value count as zero [m]."""
EXTRUDED_SHARE = 0.8
"""Smallest share of the volume in extruded CAD bodies for which prisms are chosen without being asked for."""
SHORTEST_DIVIDED = 1e-6
"""Length of an edge of the CAD, over the element size, below which elements beside it are not as short.

Elements much longer than an edge between them make Netgen fail, or end the interpreter.
"""
INTERRUPT_INTERVAL = 0.1
"""Time between two checks for Ctrl-C [s]."""


class PrismsFailedError(ValueError):
    """Netgen cannot mesh a solid with prisms."""


def generate_mesh(
    solid: Solid,
    *,
    element_size: float,
    curvature: float = 0.5,
    local_sizes: Mapping[str, float] | None = None,
    extrude: str | None = None,
    layer_thickness: float | None = None,
    end_layers: float | None = None,
    point_sizes: tuple[Array, Array] | None = None,
    tetrahedra_instead: bool = True,
) -> Any:
    """Mesh a solid by Netgen.

    Args:
        solid: the solid
        element_size: largest edge length [m]; small features get smaller elements
        curvature: elements per radius of curvature of curved edges and faces
        local_sizes: largest edge length on faces, by the names of the faces [m]
        extrude: "x", "y" or "z" meshes the CAD bodies that are extruded along this axis with prisms, and the others
            with tetrahedra; None meshes all with tetrahedra. Prisms on curved faces represent rigid rotations only
            approximately, unless their remote points are of kind rbe3.
        layer_thickness: largest height of the prisms [m] (default: element_size)
        end_layers: height of the first and of the last layer of prisms [m] (default: that of the others)
        point_sizes: points, shape (n, 3) [m], and largest edge lengths there, shape (n,) [m]; sizes in extruded bodies
            hold along the whole body
        tetrahedra_instead: mesh with tetrahedra if Netgen fails with prisms

    Returns:
        The Netgen mesh, with coordinates in metres.

    Raises:
        PrismsFailedError: if Netgen fails with prisms and tetrahedra are not wanted instead
        ValueError: for impossible sizes, if no CAD body is extruded along the axis, and if Netgen fails

    Warns:
        UserWarning: if Netgen fails with prisms only, which happens where they meet tetrahedra; the mesh then consists
            of tetrahedra
    """
    size = positive("element_size", element_size, "m")
    extent = np.array([tuple(corner) for corner in solid.shape.bounding_box])
    length = np.ptp(extent, axis=0).max()
    if size > length * (1 + SAME_SIZE):
        raise ValueError(
            f"element_size {size:g} m is longer than the solid {solid.name!r}, which is {length:g} m long; choose "
            "at most that, and give lengths in metres: 5e-3 for 5 mm"
        )
    if size < 1e-3 * length:
        raise ValueError(
            f"element_size {size:g} m is below a thousandth of the solid {solid.name!r}; that mesh would not fit in "
            "memory: take a larger size and a higher order"
        )
    positive("curvature", curvature)
    sizes = dict(local_sizes or {})
    for name, local_size in sizes.items():
        known("face", name, face_names(solid.shape))
        positive(f"size on face {name!r}", local_size, "m")
    thickness = size if layer_thickness is None else positive("layer_thickness", layer_thickness, "m")
    end = None if end_layers is None else positive("end_layers", end_layers, "m")
    if extrude is not None:
        known("extrude", extrude, OCC_AXES)
    layers = None if extrude is None else Layers("xyz".index(extrude), thickness, end)
    with hold_library_lock():
        shape, names = _numbered_copy(solid.shape)
        numbered_sizes = {str(names.index(name)): local_size for name, local_size in sizes.items()}
        mesh = _mesh(solid.name, shape, size, curvature, numbered_sizes, layers, point_sizes, tetrahedra_instead)
        _restore_mesh_names(mesh, names)
    return mesh


def _mesh(
    name: str,
    shape: Any,
    size: float,
    curvature: float,
    sizes: Mapping[str, float],
    layers: "Layers | None",
    point_sizes: tuple[Array, Array] | None,
    tetrahedra_instead: bool,
) -> Any:
    """Mesh the shape of a solid with prisms if asked for and possible, otherwise with tetrahedra."""
    if layers is not None:
        try:
            layered, prism_sizes = _cut_in_layers(name, shape, layers, point_sizes)
            return _run_netgen(layered, size, curvature, sizes, prism_sizes)
        except NgException as error:
            if not tetrahedra_instead:
                raise PrismsFailedError(f"Netgen cannot mesh solid {name!r} with prisms of these sizes") from error
            warn(
                f"Netgen fails to mesh solid {name!r} with prisms: tetrahedra are used instead, with a larger "
                "error; other sizes may help",
            )
    try:
        return _run_netgen(shape, size, curvature, sizes, point_sizes)
    except NgException as error:
        raise ValueError(
            f"Netgen cannot mesh solid {name!r} with element_size {size:g} m ({error}); try another size or "
            "fewer elements per radius of curvature"
        ) from error


def _numbered_copy(shape: Any) -> tuple[Any, list[str]]:
    """Copy a shape, with indices of the returned names as names of CAD bodies and faces: meshes take no other names.

    OpenCASCADE and Netgen leave tolerances, triangles and sizes in a shape, on which its next mesh would depend.
    """
    result = shape.Move(occ.Vec(0, 0, 0))
    named = [item for item in [*result.solids, *result.faces] if item.name]
    names = list(dict.fromkeys(item.name for item in named))
    for item, number in [(item, names.index(item.name)) for item in named]:
        item.name = str(number)
    return result, names


def _restore_mesh_names(mesh: Any, names: Sequence[str]) -> None:
    """Put names in the place of the numbers of `_numbered_copy`, and '' in that of Netgen's "default"."""
    original = {str(number): name for number, name in enumerate(names)}
    for body in range(1, mesh.GetNDomains() + 1):
        mesh.SetMaterial(body, original.get(mesh.GetMaterial(body), ""))
    for face in range(mesh.GetNFaceDescriptors()):
        mesh.SetBCName(face, original.get(mesh.GetBCName(face), ""))


def _run_netgen(
    shape: Any,
    size: float,
    curvature: float,
    sizes: Mapping[str, float],
    point_sizes: tuple[Array, Array] | None,
) -> Any:
    """Mesh a shape with several gradings and sizes, because Netgen sometimes fails between prisms and tetrahedra."""
    for face in shape.faces:
        if face.name in sizes:
            face.maxh = sizes[face.name]
    trials = TRIALS if point_sizes is None else TRIALS[1:]
    for grading, share in trials:
        # With Netgen's defaults, a 0.3 mm fillet gets 30 times more elements than curved elements need.
        options = {
            "maxh": share * size,
            "grading": grading,
            "curvaturesafety": curvature,
            "segmentsperedge": 0.2,
            "closeedgefac": None,
            "minedgelen": SHORTEST_DIVIDED * size,
            "maxoutersteps": FILL_ATTEMPTS,
            "nthreads": 1,  # on the small parts of layers, more threads mostly wait for each other
        }
        try:
            with silence():
                mesh = _run_interruptibly(partial(_generate, shape, options, point_sizes, share))
        except NgException:
            if (grading, share) == trials[-1]:
                raise
        else:
            if share < 1:
                note(f"elements of {share:g} times the size that was asked for, for which Netgen failed")
            return mesh


def _generate(shape: Any, options: Mapping[str, Any], point_sizes: tuple[Array, Array] | None, share: float) -> Any:
    """Call Netgen with options, and with sizes at points times a share."""
    parameters = MeshingParameters(**options)
    for point, size in zip(*(point_sizes or ((), ())), strict=True):
        parameters.RestrictH(*map(float, point), h=share * float(size))
    return occ.OCCGeometry(shape).GenerateMesh(mp=parameters)


def _run_interruptibly(work: Callable[[], Any]) -> Any:
    """Run Netgen in another thread and return its result, so that Ctrl-C can stop it."""
    with ThreadPoolExecutor(1) as worker:
        future = worker.submit(work)
        try:
            while not wait([future], timeout=INTERRUPT_INTERVAL).done:
                pass
            return future.result()
        except KeyboardInterrupt:
            # The request is repeated, because Netgen resets it when it begins a mesh.
            while not wait([future], timeout=INTERRUPT_INTERVAL).done:
                _SetTerminate(True)
            raise
        finally:
            _SetTerminate(False)


@dataclass(frozen=True)
class Layers:
    """Layers in which extruded bodies are cut.

    Attributes:
        k: axis of the extrusion, 0 to 2
        thickness: largest thickness of a layer [m]
        end: thickness of the first and the last layer [m]; None for that of the others
    """

    k: int
    thickness: float
    end: float | None = None

    def between(self, prisms: Sequence["CADBody"]) -> list[tuple[float, float]]:
        """Return the lower and upper end of each layer. A layer ends where a body ends."""
        ends = sorted({round(place, 12) for body in prisms for place in (body.low, body.high)})
        if self.end is not None and 2 * self.end < ends[1] - ends[0] and 2 * self.end < ends[-1] - ends[-2]:
            ends = [ends[0], ends[0] + self.end, *ends[1:-1], ends[-1] - self.end, ends[-1]]
        levels: list[float] = [ends[0]]
        for low, high in itertools.pairwise(ends):
            n = int(np.ceil((high - low) / self.thickness - 1e-6))
            levels.extend(np.linspace(low, high, n + 1)[1:])
        return list(itertools.pairwise(levels))


def extrusion_axis(solid: Solid) -> str | None:
    """Return the axis "x", "y" or "z" along which most of a solid is extruded.

    The extruded CAD bodies must have most of the volume, and more than those along another axis, otherwise None.
    """
    bodies = list(solid.shape.solids)
    volume = np.array([body.mass for body in bodies])
    shares = [volume[[CADBody.measure(body, k).is_prism() for body in bodies]].sum() / volume.sum() for k in range(3)]
    second, most = sorted(shares)[1:]
    return "xyz"[shares.index(most)] if most > max(EXTRUDED_SHARE, second * (1 + SAME_SIZE)) else None


def _cut_in_layers(
    name: str, shape: Any, layers: Layers, point_sizes: tuple[Array, Array] | None
) -> tuple[Any, tuple[Array, Array] | None]:
    """Cut the extruded CAD bodies of a shape into layers, for a mesh with prisms between equal meshes of both faces.

    Every layer has the outlines of all extruded CAD bodies, so one mesh of the section fits all layers.

    Args:
        name: name of the solid
        shape: its shape
        layers: the layers
        point_sizes: points, shape (n, 3) [m], and sizes there, shape (n,) [m]

    Returns:
        The cut OpenCASCADE shape, and sizes at points where those in the extruded bodies hold for all layers.

    Raises:
        ValueError: if no CAD body is extruded along the axis
    """
    k, axis = layers.k, "xyz"[layers.k]
    names = [face.name for face in shape.faces]
    bodies = [CADBody.measure(body, k) for body in shape.solids]
    prisms = [body for body in bodies if body.is_prism()]
    if not prisms:
        raise ValueError(f"no CAD body of solid {name!r} is extruded along {axis}: mesh it with tetrahedra")
    limits = layers.between(prisms)
    others = [body.shape for body in bodies if body not in prisms]
    cells = [cell for low, high in limits for cell in _layer(prisms, others, k, low, high)]
    whole = occ.Glue([*cells, *others])
    kept = [body for body in whole.solids if body.name != EMPTY_CELL]
    layered = occ.Compound(kept)
    _restore_names(layered, shape, names, k)
    for body in layered.solids:
        extruded = CADBody.measure(body, k)
        if extruded.is_prism():
            low, high = body.faces.Min(OCC_AXES[axis]), body.faces.Max(OCC_AXES[axis])
            step = occ.Vec(*(np.eye(3)[k] * (extruded.high - extruded.low)))
            # The name also numbers the pairs, because Netgen distinguishes identifications by name.
            label = f"layer {tuple(low.center)}"
            low.Identify(high, label, occ.IdentificationType.CLOSESURFACES, occ.gp_Trsf.Translation(step))
    return layered, point_sizes and _along_prisms(
        point_sizes, prisms, k, sorted({end for pair in limits for end in pair})
    )


def _along_prisms(
    point_sizes: tuple[Array, Array], prisms: Sequence["CADBody"], k: int, levels: Sequence[float]
) -> tuple[Array, Array]:
    """Return sizes at points in which those in extruded bodies are repeated at all levels."""
    points, sizes = point_sizes
    inside = np.zeros(len(sizes), dtype=bool)
    for body in prisms:
        low, high = (np.array(tuple(corner)) for corner in body.shape.bounding_box)
        inside |= np.all((points > low - SMALLEST_DISTANCE) & (points < high + SMALLEST_DISTANCE), axis=1)
    repeated = np.repeat(points[inside], len(levels), axis=0)
    repeated[:, k] = np.tile(levels, np.count_nonzero(inside))
    return (
        np.vstack([points[~inside], repeated]),
        np.concatenate([sizes[~inside], np.repeat(sizes[inside], len(levels))]),
    )


def _restore_names(shape: Any, original: Any, names: Sequence[str | None], k: int) -> None:
    """Restore face names, because outlines pass the name of their end face on to other layers and to the original."""
    places: dict[str, list[float]] = {}
    for face, name in zip(original.faces, names, strict=True):
        face.name = name
        if name:
            places.setdefault(name, []).append(face.center[k])
    for face in shape.faces:
        low, high = (corner[k] for corner in face.bounding_box)
        known_places = places.get(face.name, [face.center[k]])
        if (
            high - low < SMALLEST_DISTANCE
            and min(abs(face.center[k] - place) for place in known_places) > SMALLEST_DISTANCE
        ):
            face.name = None


@dataclass(frozen=True, eq=False)
class CADBody:
    """A CAD body with its measures along an axis, stored because measuring a face takes milliseconds.

    Attributes:
        shape: OpenCASCADE shape [m]
        low: lower end along the axis [m]
        high: upper end along the axis [m]
        bottom: faces at the lower end
        top: faces at the upper end
        k: the axis, 0 to 2
    """

    shape: Any
    low: float
    high: float
    bottom: list[Any]
    top: list[Any]
    k: int

    @staticmethod
    def measure(shape: Any, k: int) -> "CADBody":
        """Measure a CAD body along axis k."""
        centres = [face.center[k] for face in shape.faces]
        low, high = min(centres), max(centres)
        near = 1e-6 * (high - low)
        faces = list(zip(shape.faces, centres, strict=True))
        bottom, top = [f for f, c in faces if c < low + near], [f for f, c in faces if c > high - near]
        return CADBody(shape, low, high, bottom, top, k)

    def is_prism(self) -> bool:
        """Return whether the area of both ends times the length is the volume, and the sides are parallel to it."""
        if not self.bottom or not self.top:  # a single closed face, such as a sphere
            return False
        areas = [sum(face.mass for face in end) for end in (self.bottom, self.top)]
        volume = self.shape.mass
        if any(abs(area * (self.high - self.low) - volume) > SAME_SIZE * volume for area in areas):
            return False
        # A skew body has this volume, too.
        along = np.abs(solid_triangles(self.shape)[1][..., self.k])
        return bool(np.all((along < PARALLEL) | (along > 1 - PARALLEL)))


def _layer(prisms: Sequence[CADBody], others: Sequence[Any], k: int, low: float, high: float) -> list[Any]:
    """Return the parts of the prisms in one layer, cut by the outlines of the prisms in other layers."""
    middle = 0.5 * (low + high)
    present = [body for body in prisms if body.low < middle < body.high]
    absent = [body for body in prisms if not body.low < middle < body.high]
    reach = 2 * max(abs(c) for body in prisms for corner in body.shape.bounding_box for c in corner)
    corners = np.array([np.full(3, -reach), np.full(3, reach)])
    corners[:, k] = low, high
    slab = occ.Box(*(occ.Pnt(*corner) for corner in corners))
    real = [cell for body in present for cell in _bodies_named(body.shape * slab, body.shape.name)]
    cells = list(real)
    for body in absent:
        step = np.eye(3)[k]
        for face in body.bottom:
            outline = face.Move(occ.Vec(*(step * (low - body.low)))).Extrude(occ.Vec(*(step * (high - low))))
            cells.extend(piece for cell in real for piece in _bodies_named(outline * cell, cell.name))
            for other in [*real, *others]:
                outline = outline - other
            cells.extend(_bodies_named(outline, EMPTY_CELL))
    return cells


def _bodies_named(shape: Any, name: str) -> list[Any]:
    """Return the CAD bodies of a shape, all with one name."""
    bodies = list(shape.solids)
    for body in bodies:
        body.name = name
    return bodies
