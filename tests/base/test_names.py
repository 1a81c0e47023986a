"""Any name does for bodies and faces: NGSolve looks names up as regular expressions, which no name must reach.

A name that reaches them may end the interpreter, so the solids are meshed in a process of their own.
"""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import netgen.occ as occ
import numpy as np
import pytest

import nassim
from nassim import ElectricalPort, Material, PiezoStack, RemotePoint, Solid, build_fe_model, read_solid
from nassim.fem.solid import glue

SIDE, LENGTHS = 0.01, (0.01, 0.02)
LIGHT, HEAVY = Material("light", 70e9, 0.3, 2000.0), Material("heavy", 49.5e9, 0.31, 8000.0)
STACK = PiezoStack.from_datasheet(
    free_stroke=20e-6,
    blocked_force=4700.0,
    voltage_range=(-20.0, 150.0),
    stiffness=235e6,
    capacitance=6.7e-6,
    size=(LENGTHS[1], SIDE, SIDE),
)
NAMES = (
    ("part.1", "part-1"),
    ("pad", "pad (2)"),
    ("bracket (1)", "c++"),
    ("M6 [x2]", "a|b"),
    ("default", "(empty)"),
    (".*", "\\"),
    ("1", "0"),
)
CASES = [
    (names, source, extrude)
    for k, names in enumerate(NAMES)
    for source, extrude in zip(("solid", "step"), (None, "x") if k % 2 else ("x", None), strict=True)
]
"""Names from CAD made here and from a file, meshed with tetrahedra the one and with prisms the other."""


def make_part(names, source, folder):
    """A light cube and a heavy bar in a row along x, the bodies and their outer ends called by the two names."""
    bodies, start = [], 0.0
    for name, length in zip(names, LENGTHS, strict=True):
        bodies.append(occ.Box((start, 0, 0), (start + length, SIDE, SIDE)))
        bodies[-1].name = name
        start += length
    bodies[0].faces.Min(occ.X).name, bodies[1].faces.Max(occ.X).name = names
    bodies[0].faces.Min(occ.Z).name = "floor"
    points = (
        RemotePoint("both ends", names, (start / 2, SIDE / 2, SIDE / 2)),
        RemotePoint("floor", "floor", (LENGTHS[0] / 2, SIDE / 2, 0.0)),
    )
    materials = dict(zip(names, (LIGHT, HEAVY), strict=True))
    ports = (ElectricalPort("port", (names[1],), STACK),)
    if source == "step":
        path = folder / "part.step"
        occ.Compound([body.Scale(occ.Pnt(0, 0, 0), 1e3) for body in bodies]).WriteStep(str(path))
        read = read_solid(path, materials, remote_points=points)
        return Solid("part", read.shape, materials, points, ports)
    return Solid("part", glue(bodies), materials, points, ports)


def describe(folder):
    """What is known of every solid, as JSON; runs in a process of its own."""
    found = []
    for names, source, extrude in CASES:
        solid = make_part(names, source, Path(folder))
        shown = [item.name for item in [*solid.shape.solids, *solid.shape.faces]]
        sizes = {"local_sizes": {names[0]: 0.004}, "extrude": extrude}
        model = build_fe_model(solid, element_size=0.01, order=1, **sizes, progress=False)
        moments = model.scalar_mass_matrix @ model.fields[0] @ model.fields.T
        coupling = model.coupling("both ends")
        found.append(
            {
                "mass": moments[0],
                "centre": moments[1] / moments[0],
                "point": (coupling.averages @ model.fields[1:, coupling.dofs].ravel())[:3].tolist(),
                "labels": sorted(set(model.surface.labels)),
                "port": model.port("port").forces[: model.n_dofs // 3] @ model.fields[1],
                "n_dofs": model.n_dofs,
                "kept": shown == [item.name for item in [*solid.shape.solids, *solid.shape.faces]],
            }
        )
    print(json.dumps(found))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("names")
    code = f"import warnings, test_names; warnings.simplefilter('ignore'); test_names.describe({str(folder)!r})"
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", code], env=paths, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return dict(zip(CASES, json.loads(done.stdout.splitlines()[-1]), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("names", "source", "extrude"), CASES)
def test_every_name_means_itself(found, names, source, extrude):
    solid = found[names, source, extrude]
    masses = SIDE**2 * np.array(LENGTHS) * (2000.0, 8000.0)
    assert solid["mass"] == pytest.approx(masses.sum(), rel=1e-9)
    assert solid["centre"] == pytest.approx(masses @ (0.005, 0.02) / masses.sum(), rel=1e-9)
    np.testing.assert_allclose(solid["point"], (0.015, 0.005, 0.005), atol=1e-12)
    assert solid["labels"] == sorted({*names, "both ends", "floor"})
    # Forces times positions: the stress of one volt, over the volume of the one body that is the port's.
    lam, mu = HEAVY.lame_parameters
    port = ElectricalPort("port", ("any",), STACK)
    stress = lam * np.trace(port.strain_per_volt) + 2 * mu * port.strain_per_volt[0, 0]
    assert solid["port"] == pytest.approx(stress * SIDE**2 * LENGTHS[1], rel=1e-9)
    assert solid["n_dofs"] > 75, "without local sizes 69 with tetrahedra, 48 with prisms"
    assert solid["kept"]


def test_body_without_a_name():
    shape = occ.Box((0, 0, 0), (0.01, 0.01, 0.02))
    for extrude in (None, "z"):
        solid = Solid("block", shape, {"": HEAVY})
        model = build_fe_model(solid, element_size=0.01, order=2, extrude=extrude, progress=False)
        assert model.mass == pytest.approx(8000 * 2e-6, rel=1e-9)
        assert set(model.surface.labels) == {""}


def test_no_name_reaches_a_regular_expression():
    """NGSolve's look-ups by name stay unused; `nassim.fem.regions` does without them."""
    look_ups = {"Materials", "Boundaries", "BBoundaries", "Region", "MaterialCF", "BoundaryCF", "RegionCF"}
    for path in Path(nassim.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if not any(name in text for name in look_ups):
            continue
        used = {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
        assert used & look_ups <= ({"Region"} if path.stem == "regions" else set()), path.stem
