"""The architecture: imports point down, big libraries have one importer, modules are short and documented."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import nassim

PACKAGE = Path(nassim.__file__).parent
MODULES = sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")
TREES = {name: ast.parse((PACKAGE / f"{name}.py").read_text(encoding="utf-8")) for name in MODULES}

# A module imports only from lower layers, never from its own.
LAYERS = (
    ("checks", "exclusive", "notices", "progress", "units"),
    ("rigid_motion", "sparse", "storage"),
    ("arrayfiles", "calibration", "interface", "listing", "materials", "modal", "piezo", "statespace", "unit_systems"),
    ("readouts", "regions", "signals", "solver"),
    ("solid", "frf", "inertia", "pole_fit"),
    ("control", "fe_model", "meshing", "ports", "superelement", "skin", "identification", "mesh_checks", "uff"),
    ("fe_assembly", "measurements", "rowguess", "strain"),
    ("condensation", "body"),
    ("inspection", "modes", "trim"),
    ("acceptance", "mesh_error", "parts"),
    ("craig_bampton",),
    ("floating_frame", "full_model", "scene"),
    ("assembly", "kinematics", "sampling"),
    ("buckling", "linear", "exudyn_state", "digital", "updating"),
    ("exact", "export", "exudyn_parts", "feedback", "interchange"),
    ("exudyn_system", "locus"),
    ("exudyn_solver",),
    ("simulation",),
    ("plotting",),
)
LAYER = {name: number for number, names in enumerate(LAYERS) for name in names}
IMPORTERS = {
    "control": {"interchange"},
    "exudyn": {"exudyn_parts", "exudyn_solver", "exudyn_state", "exudyn_system"},
    "h5py": {"storage"},
    "matplotlib": {"plotting"},
    "netgen": {"solid", "meshing"},
    "ngsolve": {"fe_assembly", "mesh_checks", "ports", "regions", "skin", "solver"},
    "pyuff": {"uff"},
    "tqdm": {"progress"},
}
LIBRARIES = {*IMPORTERS, "numpy", "scipy", "mpl_toolkits", "psutil", "pypardiso", "threadpoolctl"}
LONGEST = 400
HEAVY = ("exudyn", "netgen", "ngsolve")
WITHOUT_HEAVY = (
    *("acceptance", "assembly", "body", "export", "feedback", "floating_frame", "inertia", "inspection", "interface"),
    *("fe_model", "linear", "piezo", "readouts", "rigid_motion", "scene", "superelement", "trim"),
)
"""Modules that work where none of these libraries can be loaded."""


def imports(tree):
    """Dotted names of everything that a module imports, also inside its functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "write imports in full, from nassim.module import name"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def used_modules(name):
    """Modules of nassim that a module imports."""
    dotted = [target.split(".") for target in imports(TREES[name])]
    return {parts[1] if len(parts) > 1 else "" for parts in dotted if parts[0] == "nassim"}


def used_libraries(name):
    return {target.split(".")[0] for target in imports(TREES[name])}


def public_definitions(body, prefix=""):
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                yield from public_definitions(node.body, f"{prefix}{node.name}.")


def test_every_module_has_a_layer():
    assert [name for name in MODULES if name not in LAYER] == [], "give new modules a layer"
    assert len(LAYER) == sum(map(len, LAYERS)), "a module stands in two layers"


@pytest.mark.parametrize("name", MODULES)
def test_imports_point_down(name):
    used = used_modules(name)
    assert used <= set(LAYER), f"{name} imports {used - set(LAYER)}, not modules of a layer"
    upward = sorted(other for other in used if LAYER[other] >= LAYER[name])
    assert not upward, f"{name} imports {upward}, which lie in its own layer or above"


@pytest.mark.parametrize(("library", "importers"), IMPORTERS.items())
def test_each_big_library_has_its_importer(library, importers):
    assert {name for name in MODULES if library in used_libraries(name)} == importers


def test_no_other_library_is_imported_unnoticed():
    foreign = {lib for name in MODULES for lib in used_libraries(name)} - set(sys.stdlib_module_names)
    assert foreign - {"nassim"} <= LIBRARIES


@pytest.mark.parametrize("name", MODULES)
def test_modules_stay_short(name):
    n_lines = len((PACKAGE / f"{name}.py").read_text(encoding="utf-8").splitlines())
    assert n_lines <= LONGEST, f"{name} has {n_lines} lines; split it by ideas"


@pytest.mark.parametrize("name", MODULES)
def test_everything_public_has_a_docstring(name):
    assert ast.get_docstring(TREES[name]), f"module {name} has no docstring"
    missing = [label for label, node in public_definitions(TREES[name].body) if not ast.get_docstring(node)]
    assert missing == []


def test_bodies_and_scenes_load_without_meshes_and_solvers():
    code = f"""
import importlib, sys, types
sys.modules.update(dict.fromkeys({HEAVY}))
package = types.ModuleType("nassim")
package.__path__ = [{str(PACKAGE)!r}]
sys.modules["nassim"] = package
for name in {WITHOUT_HEAVY}:
    importlib.import_module("nassim." + name)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_public_names_exist():
    assert all(hasattr(nassim, name) for name in nassim.__all__)
    assert len(set(nassim.__all__)) == len(nassim.__all__)
