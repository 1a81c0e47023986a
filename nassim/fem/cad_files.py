"""CAD files: reading of bodies with the names and colours of an assembly, and healing.

Netgen's reader gives no product names, and colours of placed instances only in part. Both stand in the text of a STEP
file. Here the text is changed before it is read, so that names carry them: an instance gets the name of its part, and a
coloured face, body or instance gets its colour behind its name.
"""

import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import netgen.occ as occ
import numpy as np

from nassim.base.warning_log import note, warn
from nassim.fem.netgen_output import silence

CAD_ENDINGS = {".step": ".step", ".stp": ".step", ".iges": ".iges", ".igs": ".iges", ".brep": ".brep"}
SAME_PLACE = 1e-9
"""Largest distance between the centres of one face or edge that is listed twice [m]."""
TINY = 1e-4
"""Length of an edge, and width of a face, below which it is told, over the length of the solid."""
STEP_COLOURS = {
    "red": "#ff0000",
    "green": "#00ff00",
    "blue": "#0000ff",
    "yellow": "#ffff00",
    "magenta": "#ff00ff",
    "cyan": "#00ffff",
    "black": "#000000",
    "white": "#ffffff",
}
"""Predefined colours of STEP files by name."""
STEP_STRING = r"'(?:[^']|'')*'"
INSTANCES = {"NEXT_ASSEMBLY_USAGE_OCCURRENCE"}
PRODUCTS = INSTANCES | {
    "PRODUCT",
    "PRODUCT_DEFINITION",
    "PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS",
    "PRODUCT_DEFINITION_FORMATION",
    "PRODUCT_DEFINITION_FORMATION_WITH_SPECIFIED_SOURCE",
}
PLACES = {"PRODUCT_DEFINITION_SHAPE", "SHAPE_DEFINITION_REPRESENTATION", "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION"}
BY_CONTEXT = "PRESENTATION_STYLE_BY_CONTEXT"
STYLED = ("STYLED_ITEM", "OVER_RIDING_STYLED_ITEM")
STYLES = {
    *STYLED,
    "PRESENTATION_STYLE_ASSIGNMENT",
    BY_CONTEXT,
    "SURFACE_STYLE_USAGE",
    "SURFACE_SIDE_STYLE",
    "SURFACE_STYLE_FILL_AREA",
    "FILL_AREA_STYLE",
    "FILL_AREA_STYLE_COLOUR",
    "COLOUR_RGB",
    "DRAUGHTING_PRE_DEFINED_COLOUR",
}
SOLIDS = {"MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS"}
COLOURED = {"ADVANCED_FACE", *SOLIDS}
OPERATOR, DIRECTION = "CARTESIAN_TRANSFORMATION_OPERATOR_3D", "DIRECTION"
Entities = Mapping[str, tuple[str, str]]
"""Kind and content of entities of a STEP file by their numbers."""
NUMBERED = "=>["
"""Beginning of the names that OpenCASCADE gives to copies without a name."""
IDENTITY = occ.Box((0, 0, 0), (1, 1, 1)).location


def read_bodies(source: Path, scale: float, *, heal: float | None = None) -> list[Any]:
    """Read the CAD bodies of a file, placed and named.

    A body of an assembly has the name of its part, or its own name where the part consists of several bodies. Further
    bodies of the same name get ":2", ":3", ... in the order of the file. A body of a single part without a name becomes
    "body 1", "body 2", ...

    Args:
        source: path of the file
        scale: length of one coordinate unit after reading [m]
        heal: length below which edges and gaps are removed [m]; None reads the file as it is

    Returns:
        The bodies, in metres.

    Raises:
        FileNotFoundError: if there is no such file
        ValueError: if the file cannot be read or holds no body

    Warns:
        UserWarning: for faces that belong to no body, and for copies that the file mirrors or scales
    """
    origin = occ.Pnt(0, 0, 0)
    parts = [(name, shape.Scale(origin, scale)) for name, shape in _read_parts(source)]
    if heal is not None:
        parts = [(name, _healed(f"{source.name}: {name or 'shape'}", shape, heal)) for name, shape in parts]
    bodies: list[Any] = []
    for name, shape in parts:
        for body in shape.solids:
            only = len(shape.solids) == 1
            body.name = (name if only else body.name) or body.name or name or f"body {len(bodies) + 1}"
            bodies.append(body)
    if not bodies:
        raise ValueError(_without_body(source, [shape for _, shape in parts]))
    for name, shape in parts:
        loose = set(shape.faces) - {face for body in shape.solids for face in body.faces}
        if loose:
            warn(
                f"{source.name}: {len(loose)} face(s) of {name or 'the part'!r} belong to no CAD body and are left "
                f"out, one at {millimetres(loose.pop().center)}; export solids, or close gaps by heal=",
            )
    _number_repeated_names(bodies)
    return bodies


def warn_without_unit(source: Path) -> None:
    """Warn of a STEP file that declares no unit of length, because OpenCASCADE takes it for millimetres.

    Args:
        source: path of the file
    """
    if CAD_ENDINGS[source.suffix.lower()] == ".step" and not re.search(rb"\bLENGTH_UNIT\b", source.read_bytes()):
        warn(
            f"{source.name} declares no unit of length: millimetres are assumed; give unit= if it is another one",
        )


def open_edges(body: Any) -> list[Any]:
    """Return the edges of a shape that bound only one face. A body that is closed has none.

    Args:
        body: OpenCASCADE shape
    """
    # The pole of a sphere is an edge without length.
    uses = Counter(edge for face in body.faces for edge in face.edges)
    return [edge for edge, count in uses.items() if count % 2 and edge.mass > SAME_PLACE]


def warn_of_tiny_features(name: str, bodies: Sequence[Any]) -> None:
    """Warn of edges and faces that are far smaller than the solid, because they force small elements.

    Args:
        name: name of the solid
        bodies: its CAD bodies [m]
    """
    corners = np.array([tuple(corner) for body in bodies for corner in body.bounding_box])
    limit = TINY * np.ptp(corners, axis=0).max()
    edges = {edge: edge.mass for body in bodies for edge in body.edges}
    short = {edge: length for edge, length in edges.items() if SAME_PLACE < length < limit}
    faces = {face: _width(face, edges) for body in bodies for face in body.faces}
    narrow = {face: width for face, width in faces.items() if width < limit}
    if not short and not narrow:
        return
    smallest, size = min({**short, **narrow}.items(), key=lambda item: item[1])
    found = [f"{len(short)} edge(s)"] * bool(short) + [f"{len(narrow)} face(s)"] * bool(narrow)
    warn(
        f"solid {name!r}: {' and '.join(found)} are shorter or narrower than {1e6 * limit:.3g} um, the smallest "
        f"{1e6 * size:.3g} um at {millimetres(smallest.center)}; they force small elements: remove them in the CAD, or "
        f"by heal={limit:.1g}",
    )


def millimetres(point: Iterable[float]) -> str:
    """Return the text of a point.

    Args:
        point: coordinates [m]
    """
    return "(" + ", ".join(f"{round(1e3 * c, 6) + 0.0:.4g}" for c in point) + ") mm"


def _width(face: Any, lengths: dict[Any, float]) -> float:
    """Return twice the area of a face over its perimeter, which is the width of a narrow face [m]."""
    perimeter = sum(lengths[edge] for edge in face.edges)
    return 2 * float(face.mass) / perimeter if perimeter else float(np.sqrt(face.mass))


def _number_repeated_names(bodies: Sequence[Any]) -> None:
    """Append ":2", ":3", ... to names that bodies before had."""
    taken: set[str] = set()
    for body in bodies:
        name, number = body.name, 1
        while body.name in taken:
            number += 1
            body.name = f"{name}:{number}"
        taken.add(body.name)


def _without_body(source: Path, shapes: Sequence[Any]) -> str:
    """Return the message about a file without a CAD body."""
    edges = [edge for shape in shapes for edge in open_edges(shape)]
    faces = sum(len(shape.faces) for shape in shapes)
    gap = (
        f"; its {faces} face(s) have {len(edges)} open edge(s), one at {millimetres(edges[0].center)}" if edges else ""
    )
    return (
        f"{source} holds no CAD body, only surfaces or curves{gap}; export solids, or close gaps by heal=, which is "
        "the largest gap [m]"
    )


def _read_parts(source: Path) -> list[tuple[str, Any]]:
    """Return names and shapes of the parts of a file; the only part of a file without an assembly has the name ''."""
    ending = CAD_ENDINGS.get(source.suffix.lower())
    if ending is None:
        raise ValueError(f"{source}: unknown ending {source.suffix!r}; known: {', '.join(CAD_ENDINGS)}")
    if not source.is_file():
        raise FileNotFoundError(f"no such CAD file: {source}")
    content = source.read_bytes()
    if ending == ".step":
        text = _decoded(content)
        _warn_of_changed_copies(source, text)
        content = _with_telling_names(text).encode("utf-8")
    with tempfile.TemporaryDirectory() as folder:
        # OpenCASCADE's readers accept only endings in lower case.
        copy = Path(folder) / f"shape{ending}"
        copy.write_bytes(content)
        try:
            geometry = occ.OCCGeometry(str(copy))
        except Exception as error:
            raise ValueError(f"{source} is not a readable {ending[1:].upper()} file: {error}") from error
    tree = geometry.GetAssemblyTree() if ending == ".step" else None
    parts = [(*name.partition("\t")[::2], shape) for name, shape in _leaves(tree)] or [("", "", geometry.shape)]
    if len(parts) == 1 and tree is not None and tree.children[0].shape is not None:
        parts = [("", *parts[0][1:])]
    for _, colour, shape in parts:
        _give_names_and_colours(shape, colour)
    return [("" if name.startswith(NUMBERED) else name, shape) for name, _, shape in parts]


def _decoded(content: bytes) -> str:
    """Return the text of a STEP file, whose letters beyond ASCII are in UTF-8 or, from old programs, in Latin-1."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _leaves(node: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and placed shapes of the parts below a node of an assembly."""
    if node is not None and node.shape is not None:
        yield node.name, node.shape
    for child in node.children if node is not None else ():
        yield from _leaves(child)


def _give_names_and_colours(shape: Any, own: str) -> None:
    """Give the bodies and faces of a placed shape the names and colours that stand in the names of the part.

    Args:
        shape: the shape
        own: colour of the bodies of this instance of the part; "" for that of the part
    """
    for items in ("solids", "faces"):
        # Netgen gives names to the part where it was drawn, which is where it has no location.
        for item, drawn in zip(getattr(shape, items), getattr(shape.Located(IDENTITY), items), strict=True):
            name, _, colour = (drawn.name or item.name or "").partition("\t")
            item.name = name or None
            colour = own if own and items == "solids" else colour
            if colour:
                for face in item.faces if items == "solids" else (item,):
                    face.col = _linear(colour)


def _with_telling_names(text: str) -> str:
    """Return the text of a STEP file in which instances have the name of their part, and names end in the colour."""
    entities = {
        number: (kind, content) for number, kind, content in _entities(text, PRODUCTS | STYLES | PLACES | SOLIDS)
    }
    named, coloured = dict(_parts_of_instances(entities)), dict(_coloured_items(entities))

    def renamed(match: re.Match[str]) -> str:
        number, kind = match[1], match[2]
        if number not in named and number not in coloured:
            return match[0]
        # Some programs write $ for no name.
        old = list(re.finditer(rf"{STEP_STRING}|\$", match[0]))[1 if kind in INSTANCES else 0]
        name = named.get(number, old[0][1:-1]) + coloured.get(number, "")
        return f"{match[0][: old.start()]}'{name}'{match[0][old.end() :]}"

    return re.sub(_entity_pattern(INSTANCES | COLOURED), renamed, text)


def _warn_of_changed_copies(source: Path, text: str) -> None:
    """Warn of placements that mirror or scale a part: OpenCASCADE only turns and shifts it."""
    if OPERATOR not in text:
        return
    entities = {number: (kind, content) for number, kind, content in _entities(text, {OPERATOR, DIRECTION})}
    changed = 0
    for kind, content in entities.values():
        if kind == OPERATOR:
            first, second, _, scale, third = re.sub(STEP_STRING, "", content).rstrip(" )\r\n").split(",")[-5:]
            axes = np.eye(3)
            for k, axis in enumerate((first, second, third)):
                if (number := axis.strip(" #\r\n")) in entities:
                    axes[k] = re.findall(r"[-+.\dEe]+", re.sub(STEP_STRING, "", entities[number][1]))
            changed += np.linalg.det(axes) < 0 or (scale.strip() not in ("$", "*") and abs(float(scale) - 1) > 1e-9)
    if changed:
        warn(
            f"{source.name} mirrors or scales {changed} placed part(s), which OpenCASCADE only turns and shifts: "
            "export them as parts of their own"
        )


def _entity_pattern(kinds: Iterable[str]) -> str:
    """Return the pattern of entities of a STEP file: number, kind, and content up to the semicolon."""
    return rf"#(\d+)\s*=\s*({'|'.join(sorted(kinds))})\s*\(((?:[^';]|'[^']*')*);"


def _entities(text: str, kinds: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    """Yield number, kind and content of the entities of a STEP file."""
    for match in re.finditer(_entity_pattern(kinds), text):
        yield match[1], match[2], match[3]


def _references(content: str) -> list[str]:
    """Return the numbers of the entities to which the content of an entity refers."""
    return re.findall(r"#(\d+)", re.sub(STEP_STRING, "", content))


def _parts_of_instances(entities: Entities) -> Iterator[tuple[str, str]]:
    """Yield the numbers of placed instances and the names of their parts."""
    for number, (kind, content) in entities.items():
        if kind in INSTANCES:
            # An instance refers to the definitions of its assembly and of its part, a definition to a version of the
            # part, and a version to the part.
            definition = entities.get("".join(_references(content)[1:2]))
            version = _referred(entities, definition)
            product = _referred(entities, version)
            strings = [string[1:-1] for string in re.findall(STEP_STRING, product[1])] if product else []
            name = next((string for string in strings[1::-1] if string.strip()), "")
            if name:
                yield number, name


def _referred(entities: Entities, entity: tuple[str, str] | None) -> tuple[str, str] | None:
    """Return the first entity to which an entity refers."""
    return entities.get("".join(_references(entity[1])[:1])) if entity else None


def _coloured_items(entities: Entities) -> Iterator[tuple[str, str]]:
    """Yield the numbers of coloured faces, bodies and instances, and their colours behind a tabulator."""
    instances = dict(_instances_of_contexts(entities))
    for styled in STYLED:
        for kind, content in entities.values():
            if kind == styled:
                *styles, item = _references(content)[: -1 if styled == "OVER_RIDING_STYLED_ITEM" else None]
                colours = ((number, _colour(number, entities)) for number in styles)
                number, colour = next(filter(lambda pair: pair[1], colours), ("", ""))
                style, of_style = entities.get(number, ("", ""))
                if style == BY_CONTEXT:  # the colour of a body in one instance of its part
                    item = instances.get(_references(of_style)[-1], "") if item in entities else ""
                if colour and item:
                    yield item, f"\t{colour}"


def _instances_of_contexts(entities: Entities) -> Iterator[tuple[str, str]]:
    """Yield the numbers of contexts in which a style holds for one instance of a part, and of the instances."""
    for number, (kind, content) in entities.items():
        if kind == "SHAPE_DEFINITION_REPRESENTATION":
            shape, context = _references(content)[:2]
        elif kind == "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION":
            shape, context = _references(content)[-1], number
        else:
            continue
        instance = "".join(_references(entities.get(shape, ("", ""))[1])[:1])
        if entities.get(instance, ("", ""))[0] in INSTANCES:
            yield context, instance


def _colour(number: str, entities: Entities) -> str:
    """Return the colour to which a style refers as "#rrggbb", or ""."""
    kind, content = entities.get(number, ("", ""))
    if kind == "COLOUR_RGB":
        values = re.sub(STEP_STRING, "", content).strip("(), ").split(",")
        return "#" + "".join(f"{round(255 * float(value)):02x}" for value in values[-3:])
    if kind == "DRAUGHTING_PRE_DEFINED_COLOUR":
        return STEP_COLOURS.get(content.strip("'() \n").lower(), "")
    return next(filter(None, (_colour(reference, entities) for reference in _references(content))), "")


def _linear(colour: str) -> tuple[float, ...]:
    """Return red, green and blue of OpenCASCADE, which are proportional to light, from those of a screen."""
    values = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return tuple(np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).tolist())


def _healed(name: str, shape: Any, length: float) -> Any:
    """Return a shape without edges and gaps shorter than a length, with the names and colours of its faces."""
    inside = {face for body in shape.solids for face in body.faces}
    loose = [face for face in shape.faces if face not in inside]
    pieces = [(body.name or "body", body) for body in shape.solids]
    if loose:
        pieces.append(("surfaces", occ.Compound(loose)))
    if len(pieces) > 1:  # of several bodies at once, Netgen leaves surfaces
        return occ.Compound([_healed(f"{name}: {label}", piece, length) for label, piece in pieces])
    before = [(face, np.array(tuple(face.center)), face.mass) for face in shape.faces]
    names = [body.name for body in shape.solids]
    geometry = occ.OCCGeometry(shape)
    with silence():
        geometry.Heal(length)
    healed = geometry.shape
    if len(healed.solids) == len(names):
        for body, old in zip(healed.solids, names, strict=True):
            body.name = old
    for face in healed.faces:
        place = np.array(tuple(face.center))
        for old, centre, area in before:
            if np.linalg.norm(place - centre) <= length and abs(face.mass - area) <= 4 * length * np.sqrt(area):
                face.name, face.col = old.name, old.col
    note(
        f"{name}: healed below {1e6 * length:.3g} um: {len(before)} faces became {len(healed.faces)}, "
        f"{len(names)} CAD bodies {len(healed.solids)}"
    )
    return healed
