"""Encoding of a view for a page: a header in JSON, and all arrays in one block of bytes."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import DTypeLike
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array
from nassim.viewer.view_content import GREY, MARK_COLORS, Form, Mark, Shape, View

OMITTED = 1e-5
"""Error by omitted displacement patterns, relative to the largest displacement."""
QUANTISED = 32767
COLOR_LEVELS = 255
"""Number of steps of a quantity that colours show."""
LARGEST_ROUNDING, SINGLE_ROUNDING = 5e-5, 1e-6
"""Errors relative to the largest displacement: limit of rounding to 16 bits, and error of 32 bits, used above it."""


@dataclass(frozen=True)
class Block:
    """Arrays one after the other, each at a multiple of eight bytes, as browsers require for 64-bit numbers.

    Attributes:
        parts: bytes of the arrays.
    """

    parts: list[bytes] = field(default_factory=list)

    def add(self, values: Any, kind: DTypeLike) -> dict[str, Any]:
        """Append an array.

        Args:
            values: the array.
            kind: type of its numbers.

        Returns:
            Location of the array: offset in bytes, number of values, their type.
        """
        array = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
        offset = sum(map(len, self.parts))
        data = array.tobytes()
        self.parts.append(data + b"\0" * (-len(data) % 8))
        return {"offset": offset, "length": array.size, "kind": np.dtype(kind).name}


def encode(view: View) -> tuple[dict[str, Any], bytes]:
    """Return the header and the bytes of a view.

    A moving form is stored as orthogonal patterns in place of its modes, and only as the patterns that contribute.
    Displacements are patterns times the coordinates of each mode or image. The entry "error" of the header is a bound
    on the rounding error of displacements: the deviation from the view's own displacements is at most this fraction of
    the form's largest displacement.

    Args:
        view: the view.
    """
    block = Block()
    forms = list({id(shape.form): shape.form for shape in view.shapes}.values())
    number = {id(form): k for k, form in enumerate(forms)}
    peaks = {mode.name: _largest(view, mode=mode.name) or 1.0 for mode in view.modes}
    patterns = [_Patterns.of(form, _snapshots(view, form, peaks)) for form in forms]
    header: dict[str, Any] = {
        "title": view.title,
        "bounds": view.bounds.tolist(),
        "size": view.size,
        "small": view.small,
        "error": max((p.error for p in patterns), default=0.0),
        "kinds": MARK_COLORS,
        "forms": [_form(block, form, p) for form, p in zip(forms, patterns, strict=True)],
        "shapes": [_shape(block, shape, number[id(shape.form)]) for shape in view.shapes],
        "marks": [_mark(view, mark) for mark in view.marks],
        "modes": [],
        "first_mode": next((k for k, mode in enumerate(view.modes) if not mode.rigid), 0),
        "motion": None,
        "coloring": next(
            (
                {"quantity": c.quantity, "largest": c.largest, "ticks": c.ticks}
                for c in (shape.coloring for shape in view.shapes)
                if c
            ),
            None,
        ),
    }
    of_shape = {shape.name: patterns[number[id(shape.form)]] for shape in view.shapes}
    for mode in view.modes:
        peak = peaks[mode.name]
        moved = {name: of_shape[name].coordinates(c / peak).tolist() for name, c in mode.coordinates.items()}
        header["modes"].append({"name": mode.name, "text": mode.text, "peak": peak, "coordinates": moved})
    if view.motion is not None:
        header["motion"] = _motion(block, view, of_shape)
    return header, b"".join(block.parts)


@dataclass(frozen=True)
class _Patterns:
    """Orthogonal displacement patterns of a form, (3 n, r), and the matrix from its coordinates to theirs, (r, k)."""

    patterns: Array
    change: Array
    error: float
    fine: bool

    @classmethod
    def of(cls, form: Form, seen: Array) -> "_Patterns":
        """Return the patterns of a form for the coordinates that a view shows, (m, k)."""
        if form.modes is None or not np.any(seen):
            return cls(np.zeros((3 * len(form.points), 0)), np.zeros((0, form.n_coordinates)), 0.0, False)
        largest = max(_longest(form.modes @ row) for row in seen)
        basis, factor = np.linalg.qr(form.modes.reshape(-1, form.n_coordinates))
        left, sizes, _ = np.linalg.svd(factor @ seen.T, full_matrices=False)
        # The contribution of an omitted pattern to any displacement is smaller than its singular value.
        kept = sizes > OMITTED * largest
        patterns, change = basis @ left[:, kept], left[:, kept].T @ factor
        moved = np.abs(seen @ change.T) @ np.abs(patterns).max(axis=0)
        rounded = float(np.sqrt(3) * 0.5 / QUANTISED * moved.max() / largest)
        fine = rounded > LARGEST_ROUNDING
        return cls(patterns, change, OMITTED + (SINGLE_ROUNDING if fine else rounded), fine)

    def coordinates(self, given: Array) -> Array:
        """Return the coordinates of the patterns, (..., r), from those of the form, (..., k)."""
        return given @ self.change.T

    def add(self, block: Block) -> dict[str, Any]:
        highest = np.maximum(np.abs(self.patterns).max(axis=0, initial=0.0), 1e-300)
        if self.fine:
            return {"values": block.add(self.patterns.T, np.float32), "scales": [1.0] * len(highest)}
        rounded = np.round(self.patterns / highest * QUANTISED)
        return {"values": block.add(rounded.T, np.int16), "scales": (highest / QUANTISED).tolist()}


def _snapshots(view: View, form: Form, peaks: dict[str, float]) -> Array:
    """Return the coordinates of a form at all times and in all modes, (m, k), with modes scaled to 1 m."""
    names = {shape.name for shape in view.shapes if shape.form is form}
    rows = [np.zeros((0, form.n_coordinates))]
    for mode in view.modes:
        rows += [values[None] / peaks[mode.name] for name, values in mode.coordinates.items() if name in names]
    if view.motion is not None:
        rows += [values for name, values in view.motion.coordinates.items() if name in names]
    return np.concatenate(rows)


def _largest(view: View, **which: Any) -> float:
    """Return the largest displacement of any point in a mode or image [m]."""
    return max(_longest(view.displacement(shape.name, **which)) for shape in view.shapes)


def _longest(vectors: Array) -> float:
    return float(np.linalg.norm(vectors, axis=1).max(initial=0.0))


def _form(block: Block, form: Form, patterns: _Patterns) -> dict[str, Any]:
    surface = form.surface
    place = {label: k for k, label in enumerate(form.labels)}
    return {
        "points": block.add(form.points, np.float32),
        "triangles": block.add(surface.triangles, np.uint32),
        "labels": form.labels,
        "label": block.add([place[label] for label in surface.labels], np.uint32),
        "outline": block.add(form.outline, np.uint32),
        "edges": block.add(surface.edges, np.uint32),
        "patterns": patterns.add(block),
    }


def _shape(block: Block, shape: Shape, form: int) -> dict[str, Any]:
    coloring = shape.coloring
    levels = None if coloring is None else np.round(COLOR_LEVELS * np.minimum(coloring.values / coloring.largest, 1.0))
    return {
        "name": shape.name,
        "form": form,
        "position": shape.position.tolist(),
        # A copy, because SciPy before 1.12 does not accept read-only arrays.
        "rotation": Rotation.from_matrix(shape.rotation.copy()).as_quat().tolist(),
        "colors": [shape.colors.get(label, GREY) for label in shape.form.labels],
        "text": shape.text,
        "values": None if levels is None else block.add(levels, np.uint8),
    }


def _mark(view: View, mark: Mark) -> dict[str, Any]:
    ends = [[name, view.shape(name).form.index(point)] for name, point in mark.ends]
    axes = mark.axes @ view.shape(mark.frame).rotation if mark.frame else mark.axes
    kept = {"name": mark.name, "kind": mark.kind, "frame": mark.frame, "text": mark.text}
    return {**kept, "ends": ends, "axes": axes.tolist()}


def _motion(block: Block, view: View, patterns: dict[str, _Patterns]) -> dict[str, Any]:
    """Encode translations and rotations relative to rest, and deformations; shapes that do not move are omitted."""
    motion = view.motion
    assert motion is not None
    moved = {}
    for name, places in motion.positions.items():
        shape = view.shape(name)
        turns = Rotation.from_matrix(shape.rotation.T @ motion.rotations[name]).as_rotvec()
        moved[name] = {"shift": block.add(places - shape.position, np.float32), "turn": block.add(turns, np.float32)}
    for name, values in motion.coordinates.items():
        moved.setdefault(name, {})["coordinates"] = block.add(patterns[name].coordinates(values), np.float32)
    deformed = (_longest(view.deformation(name, k)) for name in motion.coordinates for k in range(len(motion.time)))
    return {
        "time": block.add(motion.time, np.float64),
        "moved": moved,
        "largest": max(_largest(view, frame=k) for k in range(len(motion.time))),
        "largest_deformation": max(deformed, default=0.0),
    }
