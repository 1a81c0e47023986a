"""The bench and the hexapod, with their loops closed, as C code and as FMUs."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from compiled_c import COMPILER, largest_error, run_c
from fmu_program import run_program

from models.bench import make_bench
from models.nano_hexapod import make_nano_hexapod
from models.strut import fe_strut, with_own_damping
from nassim import Loop, TimeHistory, linearize, simulate
from nassim.exchange import export_c, export_fmu
from nassim.exchange.fmi_description import structured_name
from nassim.simulation import trim_scene
from nassim.simulation.run.scene_program import scene_rates
from nassim.systems import decentralised, integral_force_feedback

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine"),
]
RATE = 10e3


def closed_bench(apa):
    """The bench under gravity, whose loop has converters of 16 bit."""
    controller = integral_force_feedback(30.0, sample_rate=RATE, corner_frequency=2.0, limit=5.0)
    loop = Loop("iff", controller, "sensor_voltage", "actuator_voltage", input_step=3e-4, output_step=3e-4)
    return replace(make_bench(apa=apa, fidelity="linear", gravity=True), loops=(loop,))


def closed_hexapod(apa):
    """The hexapod with one loop in each of six struts."""
    strut = trim_scene(replace(fe_strut("linear", apa=apa), cutoff_frequency=1800.0))
    scene = make_nano_hexapod(with_own_damping(strut, 0.01), payload_mass=10.0)
    one = integral_force_feedback(60.0, sample_rate=RATE, corner_frequency=2.0)
    sensors, voltages = ([f"strut_{k}/{name}" for k in range(1, 7)] for name in ("sensor_voltage", "actuator_voltage"))
    return replace(scene, loops=(Loop("iff", decentralised(*[one] * 6), sensors, voltages),))


@pytest.fixture(scope="module", params=[closed_bench, closed_hexapod])
def machine(request, apa_with_ports):
    """A scene, inputs below 600 Hz, (inputs, n), and outputs and commands by exact steps, (outputs, n)."""
    scene = request.param(apa_with_ports)
    time = np.arange(2001) / RATE
    noise = np.random.default_rng(1).normal(size=(len(scene.inputs), len(time)))
    inputs = scipy.signal.lfilter(*scipy.signal.butter(4, 600.0, fs=RATE), noise)
    given = TimeHistory(time, inputs, scene.inputs, tuple(map(scene.input_unit, scene.inputs)))
    found = simulate(scene, given, time_step=1 / RATE, method="exact", hold_order=0, progress=False)
    return scene, inputs, np.array([found[name] for name in (*scene.outputs, *scene.commands)])


def test_c_code_of_machines_equals_exact_steps(machine, tmp_path):
    scene, inputs, expected = machine
    code = export_c(scene, tmp_path, "machine")
    assert largest_error(run_c(code, inputs), expected) < 1e-12
    single = export_c(scene, tmp_path, "single", precision="single")
    assert 1e-7 < largest_error(run_c(single, inputs, np.float32), expected) < 1e-2
    n = len(scene.inputs) + len(expected)
    assert code.step_operations < 3 * n * code.state_bytes / 8  # states are not coupled to each other


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmus_of_machines_equal_exact_steps(fmpy, machine, version, tmp_path):
    scene, inputs, expected = machine
    path = export_fmu(scene, tmp_path / "machine.fmu", version=version)
    description = fmpy.read_model_description(path)
    names = {kind: [v.name for v in description.modelVariables if v.causality == kind] for kind in ("input", "output")}
    time = np.arange(inputs.shape[1]) / RATE
    signals = np.zeros(len(time), dtype=[("time", float), *((name, float) for name in names["input"])])
    signals["time"] = time
    for name, values in zip(names["input"], inputs, strict=True):
        signals[name] = values
    run = fmpy.simulate_fmu(
        path, input=signals, stop_time=time[-1], output_interval=1 / RATE, output=names["output"], use_event_mode=False
    )
    found = np.array([run[name] for name in names["output"]])
    # FMPy reads the outputs of a step before it sets the inputs of the next, on which commands depend at once.
    n = len(scene.outputs)
    assert largest_error(found[:n], expected[:n]) < 1e-9


def test_fmus_of_machines_need_no_python(machine, tmp_path):
    """A program in C with an empty environment, linked with the library of the FMU; commands too."""
    scene, inputs, expected = machine
    path = export_fmu(scene, tmp_path / "machine.fmu", version="3.0")
    found, code, told = run_program(path, tmp_path / "fmu", inputs)
    assert (code, told) == (0, "")
    assert largest_error(found, expected) < 1e-9
    library = next((tmp_path / "fmu/binaries").glob("*/*"))
    assert b"python" not in library.read_bytes().lower()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_model_exchange_of_machines_equals_exact_steps(fmpy, machine, version, tmp_path):
    """CVode; voltages of different sizes act from the start, and the loops are left out.

    At a jump, modes beyond the mesh answer at once here, and within two samples in exact steps.
    """
    scene = replace(machine[0], loops=())
    values = np.linspace(1.0, 2.0, len(scene.inputs))
    time = np.arange(201) / RATE
    units = tuple(map(scene.input_unit, scene.inputs))
    given = TimeHistory(time, np.tile(values[:, None], 201), scene.inputs, units)
    record = simulate(scene, given, time_step=1 / RATE, method="exact", hold_order=0, progress=False)
    path = export_fmu(scene, tmp_path / "machine.fmu", version=version, interface="model_exchange")
    names = [v.name for v in fmpy.read_model_description(path).modelVariables if v.causality == "output"]
    starts = dict(zip(map(structured_name, scene.inputs), values, strict=True))
    run = fmpy.simulate_fmu(
        path,
        start_values=starts,
        stop_time=time[-1],
        output_interval=1 / RATE,
        relative_tolerance=1e-9,
        output=names,
        solver="CVode",
    )
    found = np.array([run[name] for name in names])
    expected = np.array([record[name] for name in scene.outputs])
    assert largest_error(found[:, 2:], expected[:, 2:]) < 1e-8


def test_continuous_programs_leave_out_modes_beyond_the_mesh(apa_with_ports):
    """Without damping, the response at a frequency f is that of the whole model but for (f / f_m)^2."""
    scene = replace(closed_bench(apa_with_ports), loops=(), damping_ratio=0.0)
    model = linearize(scene)
    a, b, c, d = scene_rates(scene).matrices
    assert len(a) < len(model.A)
    s = 2j * np.pi * 1.0
    found, whole = (c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d for a, b, c, d in ((a, b, c, d), model.matrices))
    np.testing.assert_allclose(found, whole, rtol=1e-6)
