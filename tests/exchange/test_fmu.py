"""FMUs of FMI 2 and 3: valid, equal to exact steps in co-simulation and model exchange; what they hold and refuse."""

import shutil
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import scipy
from compiled_c import COMPILER, STRICT, largest_error
from exported_scenes import STEP, excited, hanging, record, servoed, turning
from fmu_program import run_program
from fmu_slave import Slave

from nassim import Drive, Geophone, LinearModel, linearize
from nassim.exchange import c_compiler, export_c, export_fmu
from nassim.exchange.fmi_description import structured_name
from nassim.exchange.fmi_units import base_unit
from nassim.exchange.programs import Exported
from nassim.systems import sampled

VERSIONS = ("2.0", "3.0")
compiled = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def servos(tmp_path_factory):
    """FMUs of the scene with loops, by version."""
    folder = tmp_path_factory.mktemp("servos")
    return {v: export_fmu(servoed(), folder / f"servoed{v[0]}.fmu", version=v) for v in VERSIONS}


@compiled
@pytest.mark.parametrize(("make", "hold_order"), [(hanging, 1), (turning, 0)])
def test_co_simulation_equals_exact_steps(fmpy, make, hold_order, tmp_path):
    from fmpy.validation import validate_fmu

    scene = make()
    inputs = excited(scene)
    path = export_fmu(scene, tmp_path / "model.fmu", version="2.0", time_step=STEP, hold_order=hold_order)
    assert validate_fmu(path) == []
    slave = Slave(fmpy, path, tmp_path / "unpacked")
    slave.start(inputs[:, 0])
    assert largest_error(slave.run(inputs), record(scene, inputs, hold_order)) < 1e-11
    slave.end()


@compiled
@pytest.mark.parametrize(("make", "version"), [(hanging, "2.0"), (turning, "3.0")])
def test_model_exchange_equals_exact_steps_to_the_tolerance_of_the_solver(fmpy, make, version, tmp_path):
    """CVode, with inputs that are constant, which FMPy does not vary between its communication points."""
    from fmpy.validation import validate_fmu

    scene = make()
    inputs = np.tile(np.linspace(1.0, 2.0, len(scene.inputs))[:, None], 100)
    path = export_fmu(scene, tmp_path / "model.fmu", version=version, interface="model_exchange")
    assert validate_fmu(path) == []
    names = [v.name for v in fmpy.read_model_description(path).modelVariables if v.causality == "output"]
    starts = {structured_name(name): value for name, value in zip(scene.inputs, inputs[:, 0], strict=True)}
    run = fmpy.simulate_fmu(
        path,
        start_values=starts,
        stop_time=99 * STEP,
        output_interval=STEP,
        relative_tolerance=1e-8,
        output=names,
        solver="CVode",
    )
    assert largest_error(np.array([run[name] for name in names]), record(scene, inputs, 0)) < 1e-6


@pytest.mark.parametrize("options", [{}, {"start": "released"}, {"constant_inputs": {"force": 70.0}}], ids=str)
def test_continuous_equations_start_and_go_on_as_runs_do(options):
    scene = hanging()
    given = {"start": "equilibrium", "constant_inputs": None, "input_sizes": None, "allow_unstable": False} | options
    program = Exported(source=scene, **given).rates()
    state, drives, reading, direct = program.matrices
    inputs = np.tile(np.linspace(1.0, 2.0, len(scene.inputs))[:, None], 40)
    states = [program.start]
    whole = scipy.linalg.expm(STEP * np.block([[state, drives], [np.zeros((len(inputs), sum(drives.shape)))]]))
    for u in inputs.T[1:]:
        states.append(whole[: len(state)] @ np.append(states[-1], u))
    found = reading @ np.array(states).T + direct @ inputs
    assert largest_error(found, record(scene, inputs, 0, **options)) < 1e-8
    assert (largest_error(found, record(scene, inputs, 0)) > 1e-2) == bool(options)


def test_quasi_static_modes_keep_their_share_in_continuous_equations():
    """Of two masses in a row: the compliance of both springs, by the states of the lower mode and of the geophone."""
    scene = replace(hanging(), gravity=(0, 0, 0), quasi_static_above=60.0)
    given = {"start": "equilibrium", "constant_inputs": None, "input_sizes": None, "allow_unstable": False}
    state, drives, reading, direct = Exported(source=scene, **given).rates().matrices
    assert len(state) == 4
    gains = direct - reading @ np.linalg.solve(state, drives)
    np.testing.assert_allclose(gains, np.array([[1, 1], [0, 1], [0, 0]]) / 4e5, rtol=1e-9, atol=1e-15)


@compiled
@pytest.mark.parametrize("version", VERSIONS)
def test_a_program_in_c_runs_an_fmu_under_sanitizers(version, tmp_path):
    scene = servoed()
    inputs = excited(scene)
    path = export_fmu(scene, tmp_path / "model.fmu", version=version, binaries=False)
    found, code, told = run_program(path, tmp_path / "fmu", inputs, start=5.0, sanitized=True)
    assert (code, told) == (0, "")
    assert largest_error(found, record(scene, inputs, 0)) < 1e-11


@compiled
@pytest.mark.parametrize("version", VERSIONS)
def test_loops_run_states_are_saved_and_instances_are_independent(fmpy, servos, version, tmp_path):
    from fmpy.validation import validate_fmu

    scene = servoed()
    inputs = excited(scene)
    assert validate_fmu(servos[version]) == []
    one, other = (Slave(fmpy, servos[version], tmp_path / name) for name in ("one", "other"))
    one.start(inputs[:, 0])
    expected = one.run(inputs)
    assert largest_error(expected, record(scene, inputs, 0)) < 1e-11
    other.start(inputs[:, 0])
    other.run(inputs[:, :30])
    fmu = other.fmu
    save, load = (
        (fmu.getFMUState, fmu.setFMUState) if hasattr(fmu, "getFMUState") else (fmu.getFMUstate, fmu.setFMUstate)
    )
    state = save()
    again = [other.run(inputs[:, 30:], first=30) for _ in range(2) if load(state) is None]
    for found in again:
        np.testing.assert_array_equal(found, expected[:, 30:])
    one.fmu.reset()
    one.start(inputs[:, 0])
    np.testing.assert_array_equal(one.run(inputs), expected)


@compiled
@pytest.mark.parametrize("version", VERSIONS)
def test_communication_steps_are_whole_numbers_of_time_steps(fmpy, servos, version, tmp_path):
    scene = servoed()
    slave = Slave(fmpy, servos[version], tmp_path / "unpacked")
    start = np.linspace(1.0, 2.0, len(scene.inputs))
    slave.start(start)
    slave.fmu.doStep(0.0, 25 * STEP)
    *_, expected, after = record(scene, np.tile(start[:, None], 27), 0).T
    np.testing.assert_allclose(slave.outputs(), expected, rtol=1e-11)
    for begin, size in ((25 * STEP, 0.5 * STEP), (25 * STEP, 1.01 * STEP), (25 * STEP, -STEP), (0.0, STEP)):
        with pytest.raises(Exception, match=r"[Dd]iscard|doStep"):
            slave.fmu.doStep(begin, size)
        np.testing.assert_allclose(slave.outputs(), expected, rtol=1e-11)
    slave.fmu.doStep(25 * STEP, STEP)
    np.testing.assert_allclose(slave.outputs(), after, rtol=1e-11)
    slave.end()


@compiled
@pytest.mark.parametrize(("version", "interface"), [("2.0", "model_exchange"), ("3.0", "co_simulation")])
def test_the_sources_compile_on_their_own_with_all_warnings_as_errors(version, interface, tmp_path):
    step = STEP if interface == "co_simulation" else None
    options = {"version": version, "interface": interface, "time_step": step, "binaries": False}
    path = export_fmu(hanging(), tmp_path / "m.fmu", **options)
    zipfile.ZipFile(path).extractall(tmp_path)
    listing = ET.parse(tmp_path / ("modelDescription.xml" if version == "2.0" else "sources/buildDescription.xml"))
    sources = [tmp_path / "sources" / file.get("name") for tag in ("File", "SourceFile") for file in listing.iter(tag)]
    assert sorted(sources) == sorted((tmp_path / "sources").glob("*.c"))
    library = tmp_path / "strict.so"
    c_compiler.compile_library(sources, library, more=STRICT)
    assert library.exists()
    names = {name.rpartition("/")[2] for name in zipfile.ZipFile(path).namelist()}
    assert {"model.c", "model.h", "instance.h", "fmu.h", f"fmi{version[0]}_interface.c"} <= names


@pytest.mark.parametrize(
    "options", [{}, {"hold_order": 1}, {"start": "released"}, {"constant_inputs": {"force": 70.0}}], ids=str
)
def test_an_fmu_holds_the_code_of_export_c(options, tmp_path):
    path = export_fmu(hanging(), tmp_path / "m.fmu", time_step=STEP, binaries=False, **options)
    code = export_c(hanging(), tmp_path, "model", time_step=STEP, **options)
    for file in (code.source, code.header):
        assert zipfile.ZipFile(path).read(f"sources/{file.name}") == file.read_bytes()


def test_the_description_is_that_given(tmp_path):
    for given, expected in (({}, None), ({"description": "a < \x0bb"}, "a < _b")):
        root = description(export_fmu(hanging(), tmp_path / "m.fmu", time_step=STEP, binaries=False, **given))
        assert root.get("description") == expected


@compiled
@pytest.mark.parametrize(("version", "interface"), [("2.0", "co_simulation"), ("3.0", "model_exchange")])
def test_models_without_states_inputs_or_effect_compile(version, interface, tmp_path):
    none, one = np.zeros((0, 0)), np.zeros((1, 1))
    models = {
        "gain": LinearModel(none, np.zeros((0, 1)), np.zeros((1, 0)), 3.0 + one, ("u",), ("y",), ("-",)),
        "nothing": LinearModel(none, np.zeros((0, 1)), np.zeros((1, 0)), one, ("u",), ("y",), ("1",)),
        "lone": LinearModel(-1.0 - one, np.zeros((1, 0)), 1.0 + one, np.zeros((1, 0)), (), ("y",)),
    }
    for name, model in models.items():
        step = STEP if interface == "co_simulation" else None
        options = {"version": version, "interface": interface, "time_step": step, "binaries": False}
        path = export_fmu(model, tmp_path / f"{name}.fmu", **options)
        assert [u.get("name") for u in description(path).iter("Unit")] == ["s"]  # signals without a unit have none
        zipfile.ZipFile(path).extractall(tmp_path / name)
        sources = sorted((tmp_path / name / "sources").glob("*.c"))
        c_compiler.compile_library(sources, tmp_path / f"{name}.so", more=STRICT)


def description(path):
    return ET.fromstring(zipfile.ZipFile(path).read("modelDescription.xml"))


def test_the_description_holds_names_units_descriptions_starts_and_dependencies(tmp_path):
    root = description(export_fmu(hanging(), tmp_path / "m.fmu", version="3.0", time_step=STEP, binaries=False))
    variables = {v.get("name"): v.attrib for v in root.find("ModelVariables")}
    assert [*variables] == ["time", "force", "'2nd force'", "tower.way", "tower.gap", "geophone"]
    assert variables["'2nd force'"]["description"] == "2nd force: PointForce pull"
    assert variables["force"] | {"unit": "N", "start": "0.0", "causality": "input"} == variables["force"]
    assert "nominal" not in variables["force"]  # of size one unless told otherwise
    assert variables["tower.way"]["unit"] == "m"
    assert root.get("variableNamingConvention") == "structured"  # which dots in names need
    assert root.get("generationTool").startswith("nassim ")
    units = {u.get("name"): u.find("BaseUnit").attrib for u in root.iter("Unit")}
    assert units["V"] == {"kg": "1", "m": "2", "s": "-3", "A": "-1"}
    assert [o.get("dependencies") for o in root.iter("Output")] == ["", "", ""]
    assert root.find("CoSimulation").get("fixedInternalStepSize") == repr(STEP)


def test_rates_name_their_states(tmp_path):
    """FMI 2 counts variables from 1, FMI 3 names them by value references."""
    options = {"interface": "model_exchange", "binaries": False}
    for version in VERSIONS:
        root = description(export_fmu(hanging(), tmp_path / "m.fmu", version=version, **options))
        variables = list(root.find("ModelVariables"))
        shift = version == "2.0"
        rates = {v.get("name"): (v[0] if shift else v).get("derivative") for v in variables}
        named = {name: variables[int(k) - shift].get("name") for name, k in rates.items() if k}
        assert len(named) > 4
        assert all(name == f"der({state})" for name, state in named.items())


def test_sizes_of_inputs_give_those_of_the_states(tmp_path):
    """A mass of 1 kg on a spring of 1e4 N/m: 0.1 mm and 10 mm/s a newton, of which a mean over a period is half.

    A free mass has no period; the mean over about a second of t^2 / 2 and of t is 1.
    """
    model = LinearModel([[0.0, 1.0], [-1e4, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], ("force",), ("way",))
    free = replace(model, A=[[0.0, 1.0], [0.0, 0.0]])
    for one, size, way, speed in ((model, 1.0, 0.5e-4, 0.5e-2), (model, 1e-3, 0.5e-4, 0.5e-2), (free, 3.0, 1.0, 1.0)):
        options = {"interface": "model_exchange", "binaries": False, "input_sizes": {"force": size}}
        root = description(export_fmu(one, tmp_path / "m.fmu", version="3.0", **options))
        nominal = {v.get("name"): float(v.get("nominal")) for v in root.find("ModelVariables") if v.get("nominal")}
        assert nominal.pop("force", 1.0) == size
        assert nominal == pytest.approx({"state[1]": way * size, "state[2]": speed * size})
    with pytest.raises(ValueError, match=r"unknown input 'farce'; known: force"):
        export_fmu(model, tmp_path / "m.fmu", time_step=STEP, binaries=False, input_sizes={"farce": 1.0})


def test_commands_may_depend_on_all_inputs(tmp_path):
    root = description(export_fmu(servoed(), tmp_path / "m.fmu", version="3.0", binaries=False))
    assert [o.get("dependencies") for o in root.iter("Output")] == ["", "", None, None]


def test_direct_feedthrough_is_a_dependency_and_units_have_their_factors(tmp_path):
    signals = ("a", "b"), ("x", "y"), ("mm", "kN")
    model = LinearModel([[-1.0]], [[1.0, 0.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 2.0]], *signals)
    for version, expected in (("2.0", ["", "3"]), ("3.0", ["", "2"])):
        root = description(export_fmu(model, tmp_path / "m.fmu", version=version, time_step=STEP, binaries=False))
        places = root.find("ModelStructure/Outputs") if version == "2.0" else root.iter("Output")
        assert [place.get("dependencies") for place in places] == expected
        units = {unit.get("name"): float(unit[0].get("factor", 1)) for unit in root.iter("Unit")}
        assert units == {"s": 1.0, "mm": 1e-3, "kN": 1e3}


def test_equal_models_give_equal_files_and_other_models_other_tokens(tmp_path):
    first, again, other = (
        export_fmu(scene, tmp_path / f"{k}/m.fmu", time_step=STEP, binaries=False)
        for k, scene in enumerate((hanging(), hanging(), replace(hanging(), gravity=(0, 0, -1.6))))
    )
    assert first.read_bytes() == again.read_bytes()
    assert description(first).get("guid") != description(other).get("guid")


@pytest.mark.parametrize(
    ("unit", "factor", "exponents"),
    [
        ("N m", 1.0, {"kg": 1, "m": 2, "s": -2}),
        ("m/s2", 1.0, {"m": 1, "s": -2}),
        ("um/V", 1e-6, {"kg": -1, "m": -1, "s": 3, "A": 1}),
        ("mm", 1e-3, {"m": 1}),
        ("1/s", 1.0, {"s": -1}),
        ("kHz", 1e3, {"s": -1}),
        ("Pa", 1.0, {"kg": 1, "m": -1, "s": -2}),
        ("deg/s", np.pi / 180, {"rad": 1, "s": -1}),
        ("bar", 1e5, {"kg": 1, "m": -1, "s": -2}),
    ],
)
def test_units_are_products_of_base_units(unit, factor, exponents):
    found = base_unit(unit)
    assert found.factor == pytest.approx(factor)
    assert dict(found.exponents) == exponents


@pytest.mark.parametrize(
    ("named", "product"),
    [
        ("N", "kg m/s2"),
        ("J", "N m"),
        ("W", "J/s"),
        ("V", "W/A"),
        ("C", "A s"),
        ("F", "C/V"),
        ("Ohm", "V/A"),
        ("mH", "mV s/A"),
        ("T", "V s/m2"),
        ("Pa", "N/m2"),
    ],
)
def test_units_with_a_name_are_products_of_others(named, product):
    assert base_unit(named) == base_unit(product)


def test_levels_of_names_that_are_no_identifiers_stand_in_quotes():
    assert structured_name("strut_1/apa.top") == "strut_1.apa.top"
    assert structured_name("2nd/x y.z") == "'2nd'.'x y'.z"
    assert structured_name("state[1]") == "'state[1]'"  # which is not the state


def test_a_unit_that_is_not_known_has_a_name_alone(tmp_path):
    model = LinearModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",), ("furlong",))
    assert base_unit("furlong") is None
    root = description(export_fmu(model, tmp_path / "m.fmu", time_step=STEP, binaries=False))
    assert [len(u) for u in root.iter("Unit") if u.get("name") == "furlong"] == [0]


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_improper_models_are_refused(interface, tmp_path):
    """A geophone reads the acceleration that a drive prescribes by its input's second derivative."""
    drive, seen = Drive("motor", "slide_0", "z", input="way"), Geophone("seen", "lower.rail")
    scene = replace(hanging(), actuators=(drive,), sensors=(seen,))
    options = {"time_step": STEP} if interface == "co_simulation" else {}
    with pytest.raises(ValueError, match="'seen' reads an acceleration that follows a derivative of input"):
        export_fmu(scene, tmp_path / "m.fmu", interface=interface, binaries=False, **options)
    assert not any(tmp_path.iterdir())


def test_what_is_refused_and_that_nothing_is_written(tmp_path, monkeypatch):
    scene, path = hanging(), tmp_path / "m.fmu"
    with pytest.raises(ValueError, match=r"unknown file ending '.zip'"):
        export_fmu(scene, tmp_path / "m.zip", time_step=STEP)
    with pytest.raises(ValueError, match=r"unknown version '1.0'; known: 2.0, 3.0"):
        export_fmu(scene, path, version="1.0", time_step=STEP)
    with pytest.raises(ValueError, match="unknown interface 'scheduled'"):
        export_fmu(scene, path, interface="scheduled")
    for options in ({"time_step": STEP}, {"hold_order": 1}):
        with pytest.raises(ValueError, match="time_step and hold_order are of co-simulation"):
            export_fmu(scene, path, interface="model_exchange", **options)
    with pytest.raises(ValueError, match="scene 'servoed' has the sampled loop 'x_servo'"):
        export_fmu(servoed(), path, interface="model_exchange")
    with pytest.raises(ValueError, match="model exchange needs a continuous model"):
        export_fmu(sampled(linearize(scene), 1e3), path, interface="model_exchange")
    growing = LinearModel([[1.0]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",))
    with pytest.raises(ValueError, match="the model is unstable"):
        export_fmu(growing, path, interface="model_exchange")
    for taken in ("time", "x/y"):
        model = LinearModel([[-1.0]], [[1.0]], [[1.0]] * 2, [[0.0]] * 2, ("u",), (taken, "x.y"))
        with pytest.raises(ValueError, match="rename a signal"):
            export_fmu(model, path, interface="model_exchange", binaries=False)
    monkeypatch.setattr(c_compiler, "COMPILERS", ("no_such_compiler",))
    with pytest.raises(RuntimeError, match=r"no C compiler on this machine.*binaries=False"):
        export_fmu(scene, path, time_step=STEP)
    monkeypatch.setattr(c_compiler, "COMPILERS", ("false",))
    if shutil.which("false"):
        with pytest.raises(RuntimeError, match=r"the C compiler .*false failed"):
            export_fmu(scene, path, time_step=STEP)
    monkeypatch.setattr(c_compiler.platform, "machine", lambda: "riscv64")
    with pytest.raises(RuntimeError, match="no folder for binaries of riscv64"):
        export_fmu(scene, path, time_step=STEP)
    monkeypatch.setattr(c_compiler.platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(c_compiler.sys, "platform", "linux")
    assert c_compiler.binary_of("3.0", "model") == "binaries/aarch64-linux/model.so"
    with pytest.raises(RuntimeError, match=r"FMI 2\.0 names no folder for binaries of aarch64 under linux"):
        c_compiler.binary_of("2.0", "model")
    assert not any(tmp_path.iterdir())
    export_fmu(growing, path, interface="model_exchange", binaries=False, allow_unstable=True)
    export_fmu(scene, path, time_step=STEP, binaries=False)
    assert not any("binaries" in name for name in zipfile.ZipFile(path).namelist())
