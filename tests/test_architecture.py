"""Architecture: imports point down, large libraries are imported in one place, functions are short, names are lazy."""

import ast
import functools
import importlib
import inspect
import itertools
import re
import subprocess
import sys
from dataclasses import is_dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import nassim
from nassim.base.file_registry import DATA_CLASSES

PACKAGE = Path(nassim.__file__).parent
ROOT = PACKAGE.parent
PATHS = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.parent != PACKAGE / "devices"
}
MODULES = [name for name in PATHS if not name.endswith("__init__")]
LAYERS = (
    {"base", "lazy_names"},
    {"signals", "bodies", "kinematics"},
    {"systems", "fem"},
    {"scene"},
    {"simulation"},
    {"exchange", "identification"},
    {"studies"},
    {"plotting", "viewer"},
)
"""Sub-packages from the lowest layer up; sub-packages of one layer do not import each other."""
LAYER = {name: number for number, names in enumerate(LAYERS) for name in names}
SIMULATION = {
    "model": set(),
    "loaded": {"model"},
    "linear": {"model", "loaded"},
    "exudyn": {"model"},
    "run": {"model", "loaded", "linear", "exudyn"},
}
"""Sub-packages of `nassim.simulation` and those that each may import."""
IMPORTED_IN = {
    "cloudpickle": {"nassim.studies.job"},
    "control": {"nassim.systems.control_conversion"},
    "exudyn": {"nassim.simulation.exudyn"},
    "h5py": {"nassim.base.storage"},
    "lazy_loader": {"nassim.lazy_names"},
    "matplotlib": {"nassim.plotting"},
    "netgen": {"nassim.fem"},
    "ngsolve": {"nassim.fem"},
    "pyuff": {"nassim.signals.uff"},
    "pyvista": {"nassim.viewer.picture"},
    "pyyeti": {"nassim.exchange.nastran"},
    "tqdm": {"nassim.base.progress"},
    "vtkmodules": {"nassim.viewer.picture"},
    "xarray": {"nassim.studies"},
}
"""Library -> the modules or the sub-package that may import it."""
LIBRARIES = {*IMPORTED_IN, "numpy", "scipy", "mpl_toolkits", "psutil", "cvxopt", "threadpoolctl"}
LONGEST_FUNCTION = 75


@functools.cache
def nodes(name):
    """Whatever a module's code consists of, itself first."""
    return tuple(ast.walk(ast.parse(PATHS[name].read_text(encoding="utf-8"))))


def imports_of(nodes, *, for_types=True):
    """Dotted names of everything that code imports, also inside its functions."""
    skipped = set()
    for node in nodes:
        if not for_types and isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            skipped |= {id(inner) for inner in ast.walk(node)}
    for node in nodes:
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "write absolute imports, from nassim.package.module import name"
            yield f"{node.module}"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@functools.cache
def imports(name):
    """Dotted names of everything that a module imports, also for types only."""
    return tuple(imports_of(nodes(name)))


def used_modules(name):
    return {target for target in imports_of(nodes(name), for_types=False) if target in PATHS}


def used_libraries(name):
    return {target.split(".")[0] for target in imports(name)}


def sub_package(name):
    return name.split(".")[1]


def public_definitions(body, prefix=""):
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            if "overload" in map(ast.unparse, node.decorator_list):
                continue
            yield prefix + node.name, node
            if isinstance(node, ast.ClassDef):
                yield from public_definitions(node.body, f"{prefix}{node.name}.")


def test_guides_to_sub_packages_name_what_they_have():
    """The docstring of each sub-package names its modules, or what it or nassim exports."""
    missing = []
    for folder in (path.parent for path in PACKAGE.rglob("__init__.py") if path.parent.name != "devices"):
        package = importlib.import_module(".".join(folder.relative_to(ROOT).parts))
        known = {path.stem for path in folder.iterdir()} | {*getattr(package, "__all__", ()), *nassim.__all__, "nassim"}
        named = re.findall(r"(?<!\w)`(\w+)", package.__doc__)
        missing += [(package.__name__, word) for word in named if word not in known]
    assert missing == []


def test_every_sub_package_has_a_layer():
    found = {sub_package(name) for name in MODULES}
    assert found == set(LAYER), "add the new sub-package to a layer"
    assert len(LAYER) == sum(map(len, LAYERS))


def test_imports_between_sub_packages_point_down():
    for name in MODULES:
        own = sub_package(name)
        for target in imports(name):
            if target.split(".")[0] == "nassim" and target != "nassim":
                other = sub_package(target)
                assert other in LAYER, f"{name} imports {target} from the top level; import from its module"
                assert other == own or LAYER[other] < LAYER[own], f"{name} imports {target}, in the same layer or above"


def wrong_imports_within_simulation(name, used):
    """Imports of `nassim.simulation`, among those used, that a module of one of its sub-packages may not make."""
    own = name.split(".")[2]
    allowed = tuple(f"nassim.simulation.{other}" for other in (own, *SIMULATION[own]))
    return [target for target in used if target.startswith("nassim.simulation") and not target.startswith(allowed)]


def test_imports_within_simulation_point_one_way():
    parts = [name for name in PATHS if name.startswith("nassim.simulation.") and name.count(".") > 2]
    wrong = {name: wrong_imports_within_simulation(name, imports(name)) for name in parts}
    assert {name: found for name, found in wrong.items() if found} == {}


@pytest.mark.parametrize("module", ["nassim.simulation", "nassim.simulation.linear", "nassim.simulation.run.checks"])
def test_imports_within_functions_count(module):
    late = ast.parse(f"def late():\n    from {module} import name\n")
    assert wrong_imports_within_simulation("nassim.simulation.exudyn.solver", imports_of(tuple(ast.walk(late))))


def test_modules_import_each_other_without_cycles():
    TopologicalSorter({name: used_modules(name) for name in MODULES}).prepare()


@pytest.mark.parametrize(("library", "places"), IMPORTED_IN.items())
def test_large_libraries_are_imported_in_one_place(library, places):
    users = {name for name in PATHS if library in used_libraries(name)}
    assert users
    assert {
        name for name in users if not any(name == place or name.startswith(f"{place}.") for place in places)
    } == set()


def test_other_libraries_are_not_imported():
    foreign = {library for name in PATHS for library in used_libraries(name)} - set(sys.stdlib_module_names)
    for_types = {"typing_extensions"}  # type checkers have it; at run time it is not imported
    assert foreign - {"nassim"} - for_types <= LIBRARIES


def test_models_import_each_other_relatively():
    """In a wheel their folder is `nassim.devices`."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "models").rglob("*.py")}
    named = {
        (path.name, name.split(".")[0])
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom)) and not getattr(node, "level", 0)
        for name in [getattr(node, "module", None) or node.names[0].name]
    }
    assert ("bench.py", "nassim") in named
    assert {path for path, package in named if package in ("models", "scripts", "tests")} == set()


def test_devices_are_the_models():
    code = "from nassim.devices import bench; from nassim.devices.apa300ml.calibration import APAGeometry; "
    code += "import models.bench, models.apa300ml as apa; print(bench is models.bench, APAGeometry is apa.APAGeometry)"
    run = run_without((), code)
    assert run.stdout.split() == ["True", "True"], run.stderr


def test_functions_are_short():
    for name in MODULES:
        functions = [node for node in nodes(name) if isinstance(node, ast.FunctionDef)]
        firsts = [f.body[bool(ast.get_docstring(f)) and len(f.body) > 1].lineno for f in functions]
        long = [f.name for f, first in zip(functions, firsts, strict=True) if f.end_lineno - first > LONGEST_FUNCTION]
        assert long == [], f"{name}: split functions that do not fit on a screen"


def test_everything_public_has_a_docstring():
    for name in PATHS:
        tree = nodes(name)[0]
        assert ast.get_docstring(tree), f"{name} has no docstring"
        missing = [label for label, node in public_definitions(tree.body) if not ast.get_docstring(node)]
        assert missing == [], name


def kinds_of_parts():
    for name in MODULES:
        for node in nodes(name)[0].body:
            bases = {base.id for base in getattr(node, "bases", []) if isinstance(base, ast.Name)}
            if bases & {"Actuator", "Sensor", "ForceElement", "Connection"}:
                yield node.name, name


MADE_HERE = {
    "FEModel", "UpdateReport", "LoadedState", "SampleMatrices", "StepProgram",  # nobody else makes them
    "OnCylinder", "Mark", "Scene",  # their fields are frozen by other means
}  # fmt: skip


def test_data_classes_are_frozen_but_for_four_that_collect_during_one_call():
    collecting = set()
    for node in (node for name in PATHS for node in nodes(name) if isinstance(node, ast.ClassDef)):
        made = [ast.unparse(one) for one in node.decorator_list if ast.unparse(one).startswith("dataclass")]
        collecting |= {node.name for one in made if "frozen=True" not in one}
    assert collecting == {"BulkData", "Evaluator", "ForceCarrier", "Loads"}


def test_a_data_class_that_freezes_freezes_all_its_arrays_and_sequences():
    """Read-only arrays and tuples, whatever a user gives; so do those in files that check what they are given."""
    collections = ("Array", "tuple", "Mapping", "Axes", "Position", "Sequence", "Names")
    for node in (node for name in PATHS for node in nodes(name) if isinstance(node, ast.ClassDef)):
        after = [part for part in node.body if isinstance(part, ast.FunctionDef) and part.name == "__post_init__"]
        calls = [call for part in after for call in ast.walk(part) if isinstance(call, ast.Call)]
        frozen = {word.arg for call in calls if ast.unparse(call.func) == "freeze" for word in call.keywords}
        if (frozen or (after and node.name in DATA_CLASSES)) and node.name not in MADE_HERE:
            fields = [part for part in node.body if isinstance(part, ast.AnnAssign)]
            left = {
                ast.unparse(field.target)
                for field in fields
                if any(word in ast.unparse(field.annotation) for word in collections)
            }
            assert left <= frozen, (node.name, left - frozen)


def test_kinds_of_parts_are_tested_only_where_they_are_defined():
    defined_in = dict(kinds_of_parts())
    assert len(defined_in) >= 9
    for name in MODULES:
        for node in nodes(name):
            asks = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "isinstance"
            named = {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)} if asks else set()
            if isinstance(node, ast.match_case):
                named = {inner.id for inner in ast.walk(node.pattern) if isinstance(inner, ast.Name)}
            assert {kind for kind in named & set(defined_in) if defined_in[kind] != name} == set(), (
                f"{name}: {ast.unparse(node)}"
            )


@pytest.mark.parametrize(
    "name", ["nassim", *(f"nassim.{w}" for w in ("base", "signals", "bodies", "kinematics", "systems"))]
)
def test_exported_names_exist(name):
    check_exports(name)


@pytest.mark.parametrize(
    "name",
    [
        f"nassim.{w}"
        for w in ("fem", "scene", "exchange", "simulation", "identification", "studies", "plotting", "viewer")
    ],
)
def test_exported_names_of_upper_layers_exist(name):
    check_exports(name)


def check_exports(name):
    package = __import__(name, fromlist=["__all__"])
    assert package.__all__
    found = [getattr(package, public) for public in package.__all__]
    takes = [str(inspect.signature(public)) for public in found if inspect.isfunction(public) or is_dataclass(public)]
    assert takes
    assert [text for text in takes if "_SupportsArray" in text] == [], "ArrayLike is that of nassim.base.field_types"


def test_a_name_of_another_package_is_told():
    with pytest.raises(ImportError, match=r"nassim has no 'margins', but nassim\.systems has: from nassim\."):
        from nassim import margins  # noqa: F401
    with pytest.raises(AttributeError, match="did you mean 'noise_budget'"):
        nassim.noise_bugdet  # noqa: B018
    assert not hasattr(nassim, "margin_of_nothing")


def test_a_sub_package_tells_a_name_of_the_top():
    with pytest.raises(ImportError, match=r"nassim\.systems has no 'Scene', but nassim has: from nassim import Scene"):
        from nassim.systems import Scene  # noqa: F401


def test_names_that_version_0_1_exported_are_still_there():
    """The list is that of version 0.1.0."""
    names = """
        FRF Condensation Controller ElectricalPort Encoder FEModel FlexibleBody GroundAcceleration Joint
        LinearModel Loop Material ModalFit NearestTo OnPlane PiezoStack PointForce ReducedBody RemotePoint
        Repair Report RigidBody Scene Solid SpringDamper StackActuator StackSensor Superelement TimeHistory
        VoltageDrive VoltageSensor apply_identification build_fe_model check condense craig_bampton
        estimate_frf export_body frequency_response identify_modes linearize load open_circuit read_frf
        read_record read_solid read_superelement repair save simulate static_response to_body
        truncation_error write_record
    """
    assert set(names.split()) <= set(nassim.__all__)


HEAVY = ("ngsolve", "netgen", "exudyn", "matplotlib", "pyuff", "pyvista", "pyyeti", "control", "xarray", "dask")
HEAVY += ("cloudpickle",)


def run_without(libraries, code):
    block = f"import sys; sys.modules.update(dict.fromkeys({libraries!r})); "
    return subprocess.run([sys.executable, "-c", block + code], capture_output=True, text=True, check=False)


def test_linear_systems_files_and_pages_need_neither_mesher_nor_simulator_nor_image_library():
    code = (
        "import nassim; "
        "packages = nassim.systems, nassim.exchange, nassim.scene, nassim.bodies, nassim.signals, nassim.kinematics, "
        "nassim.studies; "
        "[getattr(package, name) for package in packages for name in package.__all__ if name[-8:] != '_control']; "
        "nassim.linearize, nassim.truncation_error, nassim.load, nassim.identify_modes, nassim.apply_identification; "
        "from nassim.viewer import view_body, view_motion, view_scene, write_page; print('nothing is missing'); "
        "nassim.build_fe_model"
    )
    run = run_without(HEAVY, code)
    assert run.stdout == "nothing is missing\n", run.stderr
    assert run.returncode != 0


def test_every_sub_package_is_an_attribute_loaded_when_used():
    """This runs in a new process, in which nothing has imported the sub-packages."""
    packages = sorted({path.parent.name for path in (ROOT / "nassim").glob("*/__init__.py")} - {"devices"})
    code = (
        f"import nassim, sys; before = [f'nassim.{{p}}' in sys.modules for p in {packages}]; "
        f"print(any(before), all(getattr(nassim, p).__name__ == 'nassim.' + p for p in {packages}))"
    )
    assert run_without(HEAVY, code).stdout.split() == ["False", "True"]
    assert set(packages) <= set(nassim.__all__)


def test_importing_nassim_loads_nothing_large():
    code = "import nassim; print(*{name.split('.')[0] for name in sys.modules})"
    assert not set(run_without((), code).stdout.split()) & {*HEAVY, "numpy", "scipy", "h5py"}


@pytest.mark.parametrize("stub", sorted((ROOT / "nassim").rglob("__init__.pyi")), ids=lambda stub: stub.parent.name)
def test_no_public_name_is_that_of_a_module(stub):
    """The import of the module would take the name's place in its package."""
    public = {alias.asname for node in ast.parse(stub.read_text()).body for alias in getattr(node, "names", ())}
    packages = {path.parent.name for path in (ROOT / "nassim").glob("*/__init__.py")}
    assert public & {path.stem for path in stub.parent.glob("*.py")} - packages == set()


UNITS = {
    "mm": 1e3, "mm2": 1e6, "mm3": 1e9, "um": 1e6, "g": 1e3,
    "MPa": 1e-6, "GPa": 1e-9, "N/um": 1e-6, "GB": 1e-9, "%": 100.0,
}  # fmt: skip
"""What a number in SI is multiplied by for a text in these units."""
CONVERTED = {
    "10 * tenth", "50 * turned[farthest] ** 2", "_vector(1000.0 * centre)",  # in another way
    "share", "off", "change", "error", "high", "top", "z", "principal", "text",  # before the text
}  # fmt: skip


def in_texts():
    """Module, expression, factor and unit of the numbers in texts that a unit of `UNITS` follows."""
    for name in PATHS:
        for text in (node for node in nodes(name) if isinstance(node, ast.JoinedStr)):
            for number, after in itertools.pairwise(text.values):
                if isinstance(number, ast.FormattedValue) and isinstance(after, ast.Constant):
                    unit = re.match(rf" ({'|'.join(sorted(UNITS, key=len, reverse=True))})(?![\w/])", after.value)
                    yield name, number.value, unit[1] if unit else ""


def factor(expression):
    """The number by which an expression begins, or the inverse of that by which it ends."""
    if isinstance(getattr(expression, "op", None), ast.Div) and isinstance(expression.right, ast.Constant):
        return 1 / expression.right.value
    while isinstance(expression, ast.BinOp):
        expression = expression.left
    return expression.value if isinstance(expression, ast.Constant) else None


def test_numbers_in_texts_have_the_unit_that_they_are_converted_to():
    """A thousand too much or too little in a message misleads, and no other test would see it."""
    found = list(in_texts())
    wrong = [
        (name, ast.unparse(number), unit)
        for name, number, unit in found
        if unit and factor(number) != UNITS[unit] and ast.unparse(number) not in CONVERTED
    ]
    assert wrong == []
    assert sum(bool(unit) for *_, unit in found) > 90
    bare = [ast.unparse(number) for _, number, unit in found if not unit and factor(number) in UNITS.values()]
    assert [one for one in bare if "+ 0.0" not in one] == []
