"""Run CalculiX on the mesh of an FE model, if it is installed (Debian: calculix-ccx)."""

import re
import shutil
import subprocess

import netgen.occ  # noqa: F401 (its classes must be known before meshes of CAD are read)
import ngsolve as ng
import numpy as np

from nassim.fem.regions import faces
from nassim.fem.skin import _edge_functions_at_midpoint

PROGRAM = shutil.which("ccx")
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
"""Edges of a tetrahedron in the order of C3D10's nodes on them."""


def input_file(model, steps, *, fixed=()):
    """Input for an FE model of order 2 on tetrahedra with fixed faces; steps: what is computed."""
    mesh, solid = model._source
    assert model.order == 2
    (at_middle,) = _edge_functions_at_midpoint(2)
    places = model.fields[1:].T.copy()
    edge_of = {}
    for number, edge in enumerate(mesh.edges):
        a, b = (vertex.nr for vertex in edge.vertices)
        edge_of[frozenset((a, b))] = mesh.nv + number
        places[mesh.nv + number] = 0.5 * (places[a] + places[b]) + at_middle * places[mesh.nv + number]
    lines = ["*NODE"] + [f"{k + 1}, " + ", ".join(f"{x:.12e}" for x in place) for k, place in enumerate(places)]
    materials = mesh.GetMaterials()
    members = {index: [] for index in range(len(materials))}
    for number, element in enumerate(mesh.Elements(ng.VOL)):
        corners = [vertex.nr for vertex in element.vertices]
        arms = places[corners[1:]] - places[corners[0]]
        if np.linalg.det(arms) < 0:
            corners[:2] = corners[1::-1]
        nodes = corners + [edge_of[frozenset((corners[a], corners[b]))] for a, b in EDGES]
        members[element.index].append(", ".join(str(k + 1) for k in (number, *nodes)))
    for index, elements in members.items():
        lines += [f"*ELEMENT, TYPE=C3D10, ELSET=BODY{index}", *elements]
        material = solid.materials[materials[index]]
        lines += [f"*MATERIAL, NAME=M{index}", "*ELASTIC", f"{material.young_modulus!r}, {material.poisson_ratio!r}"]
        lines += ["*DENSITY", f"{material.density!r}", f"*SOLID SECTION, ELSET=BODY{index}, MATERIAL=M{index}"]
    lines += ["*ELSET, ELSET=ALL", *(f"BODY{index}" for index in members)]
    if fixed:
        lines += ["*BOUNDARY", *(f"{k}, 1, 3" for k in face_nodes(model, fixed))]
    return "\n".join([*lines, steps]) + "\n"


def face_nodes(model, names):
    """Numbers of the nodes on faces in the input file."""
    mesh, _ = model._source
    return 1 + np.flatnonzero(np.array(ng.H1(mesh, order=2).GetDofs(faces(mesh, names))))


def run_with_rigid_faces(model, folder, steps):
    """Run steps of a free body whose remote points hold rigid faces; return positions and rotation nodes.

    Reference nodes are 900001, 900011, ...; each rotation node has the next number.
    """
    positions, lines = {}, []
    for k, point in enumerate(model._source[1].remote_points):
        node = 900001 + 10 * k
        positions[node] = point.position
        place = ", ".join(f"{x:.12e}" for x in point.position)
        lines += ["*NODE", f"{node}, {place}", f"{node + 1}, {place}", f"*NSET, NSET=FACE{k}"]
        lines += [str(number) for number in face_nodes(model, point.faces)]
        lines += [f"*RIGID BODY, NSET=FACE{k}, REF NODE={node}, ROT NODE={node + 1}"]
    (folder / "model.inp").write_text(input_file(model, "\n".join([*lines, steps])))
    done = subprocess.run([PROGRAM, "model"], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    if "*ERROR" in done.stdout:
        raise RuntimeError(done.stdout[done.stdout.find("*ERROR") :][:300])
    return positions, {node: node + 1 for node in positions}


def frequency_step(n, loads=""):
    """A step that finds n eigenfrequencies, under constant loads if there are any."""
    static = f"*STEP\n*STATIC\n*DLOAD\n{loads}\n*END STEP\n" if loads else ""
    return f"{static}*STEP{', PERTURBATION' if loads else ''}\n*FREQUENCY\n{n}\n*END STEP"


def eigenfrequencies(model, folder, *, fixed, n, loads=""):
    """The first n eigenfrequencies by CalculiX [Hz]; loads: lines of *DLOAD on the elements ALL."""
    rows = run(model, folder, frequency_step(n, loads), fixed=fixed)
    return np.array([float(row.split()[3]) for row in rows[:n]])


def buckling_factors(model, folder, *, fixed, n, loads):
    """The first n buckling factors by CalculiX; loads: lines of *DLOAD on the elements ALL."""
    rows = run(model, folder, f"*STEP\n*BUCKLE\n{n}\n*DLOAD\n{loads}\n*END STEP", fixed=fixed)
    return np.array([float(row.split()[1]) for row in rows[:n]])


def run(model, folder, steps, *, fixed):
    """Rows of numbers that CalculiX writes, first those of its modes; RuntimeError with its message if it refuses."""
    (folder / "model.inp").write_text(input_file(model, steps, fixed=fixed))
    done = subprocess.run([PROGRAM, "model"], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    result = folder / "model.dat"
    rows = re.findall(r"^ +\d+(?: +[-+.\dE]+)+$", result.read_text() if result.exists() else "", re.M)
    if "*ERROR" in done.stdout or not rows:
        raise RuntimeError(done.stdout[done.stdout.find("*ERROR") :][:300])
    return rows
