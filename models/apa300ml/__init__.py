"""The amplified piezo actuator APA300ML: geometry, materials, stacks, remote points.

Frame: x along the stacks, y along the depth, z along the actuation axis, origin at the centre. The outline was measured
on public CAD. That CAD does not show how the arm, the end block and the stack meet, so this is our assumption: a slot
with a round end extends beside the end of the stack. Its depth `relief` determines the stiffness.
"""

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import netgen.occ as occ
import numpy as np

from nassim import (
    Condensation,
    ElectricalPort,
    Material,
    PiezoStack,
    ReducedBody,
    RemotePoint,
    Solid,
    build_fe_model,
    craig_bampton,
)
from nassim.base import code_fingerprint, fingerprint, load_or_compute
from nassim.fem import glue, shape_bytes, solver_name

# Table 1 of the paper, which prints one Poisson ratio and one density for both materials.
STEEL = Material("stainless steel", young_modulus=190e9, poisson_ratio=0.31, density=7800.0)
PZT_TABLE_1 = Material("piezoelectric ceramic", young_modulus=49.5e9, poisson_ratio=0.31, density=7800.0)

CALIBRATION = Path(__file__).parent / "calibration.json"
"""Record of the fit that `scripts/calibrate_apa.py --write` made the default."""
_CALIBRATED = json.loads(CALIBRATION.read_text())["parameters"]
PZT = replace(PZT_TABLE_1, young_modulus=_CALIBRATED["pzt_modulus"])
"""Ceramic with the modulus that gives the vendor's stiffness, the default."""

# Data sheet of one stack, 10 x 10 x 20 mm, -20 ... 150 V. It gives 4.4 uF; the data sheet of the actuator gives 20 uF
# (18 to 26) for all three. With 4.4 uF the coupling factor k33 would be 0.86, too high for a ceramic; with 6.7 uF: 0.7.
STACK = PiezoStack.from_datasheet(
    free_stroke=20e-6,
    blocked_force=4700.0,
    voltage_range=(-20.0, 150.0),
    stiffness=235e6,
    capacitance=20e-6 / 3,
    size=(20e-3, 10e-3, 10e-3),
)
PORTS = (
    ElectricalPort("sensor", ("sensor_stack",), STACK),
    ElectricalPort("actuator", ("actuator_stack_1", "actuator_stack_2"), STACK),
)
"""Wiring of the paper: two stacks driven in parallel, one stack as sensor."""

PRISMS: dict[str, Any] = {
    "extrude": "y",
    "layer_thickness": 5e-3,
    "local_sizes": {"arm_roots": 0.3e-3, "pad_fillets": 0.5e-3, "holes": 1.5e-3},
}
"""Arguments of `build_fe_model` for prisms, with small elements where the arms bend most, and tetrahedra in the pads.

With 5 mm and order 3, the first five clamped frequencies differ by 0.07 to 0.21 % from those of order 5 (1 % with
tetrahedra of 5 mm).
"""

COARSE: dict[str, Any] = {"element_size": 8e-3, "order": 2, "mesh": {}}
"""Arguments of `reduced_apa300ml` for a fast, coarse model: tetrahedra of 8 mm."""

VENDOR_STIFFNESS = 1.79e6
"""Axial stiffness of the whole actuator [N/m], from the data sheet."""
VENDOR_STROKE = 304e-6
"""Stroke of the whole actuator over the full voltage range [m], from the literature; unverified."""
PAPER_FREQUENCY_FE = 95.9
"""First eigenfrequency with 5 kg on top, bottom fixed, top guided [Hz], from figure 2b of the paper."""


@dataclass(frozen=True)
class APAGeometry:
    """Variable dimensions [m]; the defaults are the measured ones, or those of the calibration.

    Attributes:
        arm_thickness: thickness of the arms
        pad_fillet: fillet between an arm and its pad
        relief: length of the slot between arm and end block beyond the end of the stack (see the module's docstring)
        depth: extent of the frame in y
        hole_diameter: diameter of the hole through the pads
    """

    arm_thickness: float = _CALIBRATED.get("arm_thickness", 1.40e-3)
    pad_fillet: float = _CALIBRATED.get("pad_fillet", 0.70e-3)
    relief: float = _CALIBRATED.get("relief", 3.5e-3)
    depth: float = 20e-3
    hole_diameter: float = 4.2e-3

    def __post_init__(self) -> None:
        limits = {
            "arm_thickness": (0.1e-3, 3e-3),
            "pad_fillet": (0.05e-3, 0.7e-3),
            "relief": (0.5e-3, 4.5e-3),
            "depth": (10e-3, 100e-3),
            "hole_diameter": (0.5e-3, 8e-3),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} must lie between {low:g} and {high:g} m, got {value:g}")


def make_apa300ml(
    geometry: APAGeometry | None = None,
    *,
    steel: Material = STEEL,
    ceramic: Material = PZT,
    coupling: str = "rbe3",
    stack_coupling: str = "rbe3",
    ports: Sequence[ElectricalPort] = (),
) -> Solid:
    """Make the APA300ML as a solid with its five remote points (A to E of the paper).

    Args:
        geometry: dimensions
        steel: material of the frame
        ceramic: material of the stacks
        coupling: coupling of the remote points on the pads, "rbe2" or "rbe3"
        stack_coupling: coupling of the three remote points on the stack line. "rbe3" adds no stiffness. "rbe2" keeps
            their faces plane, as a pair of forces between them needs: a soft face that is pushed from one side becomes
                concave,
            and the elongation measured across the sensor includes this deformation
        ports: electrical ports of its stacks, such as `PORTS`
    """
    return Solid(
        name="apa300ml",
        shape=_shape(geometry or APAGeometry()),
        materials={
            "frame": steel,
            "spacer": steel,
            "sensor_stack": ceramic,
            "actuator_stack_1": ceramic,
            "actuator_stack_2": ceramic,
        },
        remote_points=(
            RemotePoint("bottom", ("bottom_pad",), np.array([0, 0, -15e-3]), coupling),
            RemotePoint("top", ("top_pad",), np.array([0, 0, 15e-3]), coupling),
            RemotePoint("sensor_end", ("sensor_stack_end",), np.array([-32.5e-3, 0, 0]), stack_coupling),
            # One side of the spacer only: with both, the sensor would also measure strain of the drive in the spacer.
            RemotePoint("junction", ("spacer_actuator_side",), np.array([-7.5e-3, 0, 0]), stack_coupling),
            RemotePoint("actuator_end", ("actuator_stack_end",), np.array([32.5e-3, 0, 0]), stack_coupling),
        ),
        ports=tuple(ports),
    )


def _shape(g: APAGeometry) -> occ.TopoDS_Shape:
    """Make the glued CAD bodies [m] with the names of bodies and faces."""
    frame, pads = _frame(g), _pads(g)
    frame.faces.Max(occ.Z).name = "top_pad"
    frame.faces.Min(occ.Z).name = "bottom_pad"
    pieces = [*(frame * pads).solids, *(frame - pads).solids]
    for piece in pieces:
        piece.name = "frame"
        for face in piece.faces:
            face.name = _notch_name(face, g) or face.name
    sensor, spacer, actuator_1, actuator_2 = stacks = [
        _stack_piece(name, start, end)
        for name, start, end in [
            ("sensor_stack", -32.5, -12.5),
            ("spacer", -12.5, -7.5),
            ("actuator_stack_1", -7.5, 12.5),
            ("actuator_stack_2", 12.5, 32.5),
        ]
    ]
    sensor.faces.Min(occ.X).name = "sensor_stack_end"
    actuator_1.faces.Min(occ.X).name = spacer.faces.Max(occ.X).name = "spacer_actuator_side"
    actuator_2.faces.Max(occ.X).name = "actuator_stack_end"
    return glue([*pieces, *stacks]).Scale(occ.Pnt(0, 0, 0), 1e-3)


def reduced_apa300ml(
    geometry: APAGeometry | None = None,
    *,
    element_size: float = 5e-3,
    order: int = 3,
    n_modes: int = 6,
    coupling: str = "rbe3",
    stack_coupling: str = "rbe3",
    ports: Sequence[ElectricalPort] = (),
    ceramic: Material = PZT,
    mesh: Mapping[str, Any] = MappingProxyType(PRISMS),
    condensed: Condensation | None = None,
    geometric_stiffness: bool = False,
    progress: bool = True,
) -> ReducedBody:
    """Reduce the APA300ML by Craig-Bampton to 5 x 6 + 6 = 36 coordinates.

    The result comes from the cache if it was computed before with the same geometry, materials, points, ports and mesh,
    the same solver, the same code and the same versions of the libraries.

    Args:
        geometry: dimensions
        element_size: size of the finite elements [m]
        order: order of the finite elements
        n_modes: number of fixed-interface modes
        coupling: see `make_apa300ml`
        stack_coupling: see `make_apa300ml`
        ports: electrical ports of its stacks, such as `PORTS`; each adds a coordinate
        ceramic: material of the stacks; the default has a modulus calibrated to the vendor's stiffness, PZT_TABLE_1 is
            that of the paper
        mesh: further arguments of `build_fe_model`; {} for tetrahedra only
        condensed: condensed FE model with all these arguments, if it exists already
        geometric_stiffness: also compute its geometric stiffness under loads, see `craig_bampton`
        progress: show the stages and their times

    Raises:
        ValueError: for a condensed model with another element order or other ports
    """
    if condensed is not None:
        found = (condensed.fe_model.order, tuple(port.name for port in condensed.fe_model.ports))
        if found != (order, tuple(port.name for port in ports)):
            raise ValueError(
                f"condensed is of order {found[0]} with ports {found[1]}, but order={order} and other ports were "
                "given; build it with the same arguments"
            )
    solid = make_apa300ml(geometry, ceramic=ceramic, coupling=coupling, stack_coupling=stack_coupling, ports=ports)
    key = fingerprint(
        shape_bytes(solid.shape),
        solid.materials,
        solid.remote_points,
        solid.ports,
        (element_size, order, n_modes, geometric_stiffness),
        dict(mesh),
        solver_name(),
        code_fingerprint(),
    )

    def build() -> ReducedBody:
        model = condensed or build_fe_model(solid, element_size=element_size, order=order, progress=progress, **mesh)
        return craig_bampton(
            model,
            n_modes=n_modes,
            discretization=False,
            geometric_stiffness=geometric_stiffness,
            progress=progress,
        )

    return load_or_compute(solid.name, key, build, progress=progress)


def axial_stiffness(body: ReducedBody) -> float:
    """Return force over elongation between the pads of a reduced APA300ML [N/m]."""
    top = body.coordinate_names.index("top.uz")
    return float(1 / body.compliance(fixed=["bottom"])[top, top])


def _stack_piece(name: str, start: float, end: float) -> occ.Solid:
    piece = occ.Box(occ.Pnt(start, -5, -5), occ.Pnt(end, 5, 5))
    piece.name = name
    return piece


def _frame(g: APAGeometry) -> occ.TopoDS_Shape:
    """Make the steel frame [mm] by mirroring a quarter of its x-z section and drilling the pads."""
    depth, radius = 1e3 * g.depth, 0.5e3 * g.hole_diameter
    quarter = occ.Face(occ.Wire(_quarter_outline(g))).Extrude(depth * occ.Vec(0, 1, 0)).Move(occ.Vec(0, -depth / 2, 0))
    half = quarter + quarter.Mirror(occ.Axes((0, 0, 0), occ.X, occ.Y))
    whole = (half + half.Mirror(occ.Axes((0, 0, 0), occ.Z, occ.X))).UnifySameDomain()
    return whole - occ.Cylinder(occ.Pnt(0, 0, -20), occ.Z, radius, 40)


def _pads(g: APAGeometry) -> occ.TopoDS_Shape:
    """Return the parts of the frame that are not extruded along y, cut where the arms are straight, for a good mesh."""
    x = min(0.5e3 * g.hole_diameter + 2.0, 4.3)
    return occ.Box(occ.Pnt(-x, -100, 9), occ.Pnt(x, 100, 20)) + occ.Box(occ.Pnt(-x, -100, -20), occ.Pnt(x, 100, -9))


def _notch_name(face: occ.Face, g: APAGeometry) -> str | None:
    """Return the name of a curved face that needs small elements: end of a slot, fillet at a pad, hole of a pad."""
    x, y, z = (abs(c) for c in face.center)
    if max(x, y) < 1e-6 and 12.0 < z < 14.5:
        return "holes"
    slot_end = 32.5 + 1e3 * g.relief
    if slot_end - 2.0 < x < slot_end and 5.51 < z < 8.5:
        return "arm_roots"
    if 4.51 < x < 4.5 + 1e3 * g.pad_fillet and 12.77 < z < 12.763 + 1e3 * g.pad_fillet:
        return "pad_fillets"
    return None


def _quarter_outline(g: APAGeometry) -> list[occ.Edge]:
    """Return the edges of the frame's section for x, z >= 0 [mm]; every arc is tangent to its neighbours."""
    thickness, fillet, slot_end = 1e3 * g.arm_thickness, 1e3 * g.pad_fillet, 32.5 + 1e3 * g.relief
    pad_x, pad_z, shoulder = 4.5, 15.0, (5.2, 12.763)
    radius = 11.0
    centre = (shoulder[0], shoulder[1] - radius)
    arm_end = (34.555, 7.768)
    arm_start = (7.106, 12.596)
    slope = math.atan2(arm_start[1] - arm_end[1], arm_end[0] - arm_start[0])
    end_radius = 5.86
    end_centre = (arm_end[0] - end_radius * math.sin(slope), arm_end[1] - end_radius * math.cos(slope))

    def on_circle(c: tuple[float, float], r: float, angle: float) -> tuple[float, float]:
        """Point on a circle at an angle from the z axis towards x."""
        return c[0] + r * math.sin(angle), c[1] + r * math.cos(angle)

    # The slot beside the stack is between |z| = 5.5 and the inner line of the arm, closed by a tangent circle.
    floor, stack_end = 5.5, 32.5
    inner_start = on_circle(centre, radius - thickness, slope)
    share = math.cos(slope) / (1 + math.cos(slope))
    gap = inner_start[1] - (slot_end - inner_start[0]) * math.tan(slope) - floor
    slot_radius = share * gap / (1 - share * math.tan(slope))
    if slot_radius < 0.05:
        raise ValueError("the slot beside the stack closes: choose a smaller relief or a thinner arm")
    slot_centre = (slot_end - slot_radius, floor + slot_radius)

    def point(p: tuple[float, float]) -> occ.gp_Pnt:
        return occ.Pnt(p[0], 0, p[1])

    edges: list[occ.Edge] = []

    def line(*corners: tuple[float, float]) -> None:
        edges.extend(occ.Segment(point(a), point(b)) for a, b in itertools.pairwise(corners) if math.dist(a, b) > 1e-6)

    def arc(c: tuple[float, float], r: float, start: float, end: float) -> None:
        edges.append(occ.ArcOfCircle(*(point(on_circle(c, r, angle)) for angle in (start, (start + end) / 2, end))))

    fillet_centre = (pad_x + fillet, shoulder[1] + fillet)
    line((0, pad_z), (pad_x, pad_z), (pad_x, fillet_centre[1]))
    arc(fillet_centre, fillet, 1.5 * math.pi, math.pi)
    line((fillet_centre[0], shoulder[1]), shoulder)
    arc(centre, radius, 0.0, slope)
    line(on_circle(centre, radius, slope), on_circle(end_centre, end_radius, slope))
    arc(end_centre, end_radius, slope, math.pi / 2)
    line(on_circle(end_centre, end_radius, math.pi / 2), (end_centre[0] + end_radius, 0), (stack_end, 0))
    line((stack_end, 0), (stack_end, floor), (slot_centre[0], floor))
    arc(slot_centre, slot_radius, math.pi, slope)
    line(on_circle(slot_centre, slot_radius, slope), inner_start)
    arc(centre, radius - thickness, slope, 0.0)
    line((centre[0], centre[1] + radius - thickness), (0, centre[1] + radius - thickness), (0, pad_z))
    return edges
