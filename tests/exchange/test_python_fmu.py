"""FMUs that run nassim in a process of Python: equal to `Simulation`; what they log, need and refuse."""

import contextlib
import io
import json
import os
import struct
import sys
import warnings
import zipfile
from dataclasses import replace
from typing import ClassVar

import numpy as np
import psutil
import pytest
from compiled_c import COMPILER, STRICT
from conftest import lattice
from exported_scenes import STEP, excited, servoed
from fmu_program import run_program

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    PythonController,
    RigidBody,
    Scene,
    craig_bampton,
    linearize,
)
from nassim.exchange import c_compiler, export_fmu, python_run
from nassim.simulation import Simulation

VERSIONS = ("2.0", "3.0")
OPTIONS = {"method": "generalized_alpha", "time_step": STEP, "start": "released"}
START = 2.0
compiled = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def swing():
    """A flexible bar that falls about a hinge, in the floating frame."""
    reduced = craig_bampton(lattice(), n_modes=2, remote_points=["right", "left"], progress=False)
    hinge = reduced.point("left").position
    return Scene(
        "swing",
        (RigidBody("base", {"hinge": hinge}, fixed=True), FlexibleBody("bar", reduced, fidelity="ffrf")),
        (Joint("hinge", "base.hinge", "bar.left", free="ry"),),
        (PointForce("push", "bar.right", "z", "force"),),
        (Encoder("tip/way", "base.hinge", "bar.right", "z"), Encoder("across", "base.hinge", "bar.right", "x")),
        gravity=(0, 0, -9.81),
        damping_ratio=0.01,
    )


@pytest.fixture(scope="module")
def push():
    return 0.3 * np.sin(0.05 * np.arange(120)[None] + 0.4)


def stepped(scene, inputs, **options):
    """Outputs of a Simulation whose inputs run to the values of each sample within the next step."""
    options = {"time_step": STEP, "start": "released"} | options
    names = scene.inputs
    with Simulation(scene, inputs=dict(zip(names, inputs[:, 0], strict=True)), **options) as run:
        rows = [[*run.outputs.values()]]
        for values in inputs.T[:-1]:
            rows.append([*run.step(dict(zip(names, values, strict=True))).values()])
    return np.array(rows).T


@pytest.fixture(scope="module")
def fmus(swing, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    return {
        v: export_fmu(swing, folder / f"swing{v[0]}.fmu", version=v, description="a bar", **OPTIONS) for v in VERSIONS
    }


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_runs_equal_those_of_simulation(fmpy, fmus, swing, push, version):
    """By FMPy, from a time that is not zero; the time that FMPy gives is that of its samples."""
    from fmpy.validation import validate_fmu

    assert validate_fmu(fmus[version]) == []
    times = START + STEP * np.arange(push.shape[1])
    signals = np.array([*zip(times, push[0], strict=True)], dtype=[("time", float), ("force", float)])
    names = ["tip.way", "across"]
    run = fmpy.simulate_fmu(
        fmus[version], start_time=START, stop_time=times[-1], output_interval=STEP, input=signals, output=names,
        use_event_mode=False,
    )  # fmt: skip
    np.testing.assert_allclose(run["time"], times)
    np.testing.assert_array_equal([run[name] for name in names], stepped(swing, push))


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_a_program_in_c_runs_python(fmus, swing, push, version, tmp_path):
    """The program has no Python in its own process, and runs under sanitizers."""
    found, code, _ = run_program(
        fmus[version], tmp_path / "a b%20", push, start=START, sanitized=True, environment=dict(os.environ)
    )
    assert code == 0
    np.testing.assert_array_equal(found, stepped(swing, push))


@compiled
@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_errors_and_warnings_of_a_run_are_logged(fmus, push, version, tmp_path):
    environment = dict(os.environ)
    _, code, told = run_program(fmus[version], tmp_path / "warned", 5e3 + 0 * push, environment=environment)
    assert code == 0
    assert "logStatusWarning: body 'bar' turns at" in told
    assert "percent of its size" in told
    found, code, told = run_program(fmus[version], tmp_path / "failed", 1e9 + 0 * push, environment=environment)
    assert code == 4
    assert 1 <= found.shape[1] <= 50
    assert "logStatusError: SimulationError: " in told


@compiled
@pytest.mark.parametrize(
    ("python", "message"),
    [("/nowhere/python", "NASSIM_PYTHON"), (sys.executable, "does this Python have nassim")],
    ids=["no Python", "no nassim"],
)
def test_without_python_or_nassim_there_is_an_error(fmus, push, python, message, tmp_path):
    empty = tmp_path / "empty"
    (empty / "nassim").mkdir(parents=True)
    (empty / "nassim/__init__.py").touch()
    environment = {"NASSIM_PYTHON": python, "PYTHONPATH": str(empty)}
    found, code, told = run_program(fmus["3.0"], tmp_path / "fmu", push, environment=environment)
    assert (code, found.size) == (3, 0)
    assert "logStatusError" in told
    assert message in told
    assert python in told


@compiled
@pytest.mark.slow
def test_instances_are_independent_start_again_and_leave_no_process(fmpy, fmus, swing, push, tmp_path):
    from fmu_slave import Slave

    def children():
        started = (child.cmdline() for child in psutil.Process().children())
        return sum("nassim.exchange.python_run" in arguments for arguments in started)

    slaves = [Slave(fmpy, fmus["2.0"], tmp_path / name) for name in ("one", "other")]
    inputs = push[:, :30]
    expected = stepped(swing, inputs)
    for factor, slave in enumerate(slaves):
        slave.start(factor * inputs[:, 0])
    assert children() == 2
    np.testing.assert_array_equal(slaves[1].run(inputs), expected)
    np.testing.assert_array_equal(slaves[0].run(0 * inputs), stepped(swing, 0 * inputs))
    slaves[0].fmu.reset()
    slaves[0].start(inputs[:, 0])
    np.testing.assert_array_equal(slaves[0].run(inputs), expected)
    with pytest.raises(Exception, match="state"):
        slaves[0].fmu.getFMUState()
    for slave in slaves:
        slave.end()
    assert children() == 0


@compiled
def test_the_description_says_what_the_fmu_needs(fmus, swing, tmp_path):
    for path in fmus.values():
        text = described(path)
        assert "a bar; runs nassim" in text
        assert "in Python, which the machine that runs the FMU needs" in text
        assert 'needsExecutionTool="true"' in text
        assert "canGetAndSet" not in text
        assert 'description="tip/way: Encoder tip/way"' in text
        assert f'stepSize="{STEP!r}"' in text
    options = OPTIONS | {"binaries": False, "description": "a bar"}
    again = export_fmu(swing, tmp_path / "swing2.fmu", **options)
    assert described(again) == described(fmus["2.0"])
    other = export_fmu(swing, tmp_path / "other/swing2.fmu", **options | {"spectral_radius": 0.8})
    assert described(other) != described(again)


def described(path):
    return zipfile.ZipFile(path).read("modelDescription.xml").decode()


@compiled
@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_compile_with_all_warnings_as_errors(swing, version, tmp_path):
    path = export_fmu(swing, tmp_path / "m.fmu", version=version, binaries=False, **OPTIONS)
    zipfile.ZipFile(path).extractall(tmp_path)
    c_compiler.compile_library(sorted((tmp_path / "sources").glob("*.c")), tmp_path / "strict.so", more=STRICT)


def answers(folder, *requests, n_outputs=2):
    """Answers to requests in this process: whether they failed, their text, their outputs."""
    sent = b"".join(kind + np.array(inputs, dtype=float).tobytes() for kind, inputs in requests)
    replies = io.BytesIO()
    python_run.serve(folder, io.BytesIO(sent), replies)
    replies.seek(0)
    found = []
    while head := replies.read(8):
        failed, length = struct.unpack("=ii", head)
        text = replies.read(length).decode()
        found.append((bool(failed), text, np.frombuffer(replies.read(0 if failed else 8 * n_outputs))))
    return found


def test_requests_are_answered(swing, push, tmp_path):
    path = export_fmu(swing, tmp_path / "m.fmu", binaries=False, **OPTIONS, constant_inputs={"force": 0.2})
    zipfile.ZipFile(path).extractall(tmp_path)
    folder = tmp_path / "resources"
    steps = [(b"s", values) for values in push.T[:-1]]
    begun = (b"b", push[:, 0])
    *found, end = answers(folder, (b"b", [7.0]), begun, *steps, (b"e", []))
    expected = stepped(swing, push, constant_inputs={"force": 0.2})
    np.testing.assert_array_equal(np.array([row for *_, row in found[1:]]).T, expected)
    assert not any(failed for failed, *_ in [*found, end])
    (failed, text, _), *_ = answers(folder, (b"s", [1.0]))
    assert (failed, text) == (True, "RuntimeError: the run has not begun")
    *_, (failed, text, _) = answers(folder, begun, *[(b"s", [1e9])] * 60)
    assert failed
    assert text.startswith("SimulationError: ")
    (folder / "scene.h5").write_bytes(b"cut")
    ((failed, text, _),) = answers(folder, begun)
    assert failed
    assert "scene.h5" in text


def test_commands_of_loops_are_outputs_and_their_rate_is_the_time_step(tmp_path):
    """The loops' rates, converters and references are those of the scene."""
    scene = servoed()
    path = export_fmu(scene, tmp_path / "m.fmu", method="generalized_alpha", binaries=False)
    zipfile.ZipFile(path).extractall(tmp_path)
    inputs = 1e-4 * excited(scene, 40)
    steps = [(b"s", values) for values in inputs.T[:-1]]
    found = answers(tmp_path / "resources", (b"b", inputs[:, 0]), *steps, n_outputs=4)
    expected = stepped(scene, inputs, start="equilibrium")
    assert np.ptp(expected, axis=1).min() > 0
    np.testing.assert_array_equal(np.array([row for *_, row in found]).T, expected)


def test_options_are_taken_along(swing, tmp_path, monkeypatch):
    """The scene has no stress that could change, so nothing runs here."""
    tried = []
    stub = type("Simulation", (), {"Simulation": lambda *_, **given: tried.append(given) or Trial()})
    monkeypatch.setattr(python_run, "simulation", stub())
    options = OPTIONS | {"spectral_radius": 0.7, "stress": "present", "constant_inputs": {"force": 0.1}}
    path = export_fmu(swing, tmp_path / "m.fmu", binaries=False, **options)
    kept = json.loads(zipfile.ZipFile(path).read("resources/options.json"))
    expected = {name: value for name, value in options.items() if name != "method"}
    assert [kept] == tried == [expected]
    zipfile.ZipFile(path).extractall(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as by PYTHONWARNINGS; the importing program is told nevertheless
        *_, (failed, text, outputs) = answers(tmp_path / "resources", (b"b", [0.0]), (b"s", [0.0]), n_outputs=1)
    assert (failed, text, outputs) == (False, "bent by 50 percent", 3.0)


class Trial(contextlib.nullcontext):
    """A run that does nothing; it warns where it has inputs."""

    outputs: ClassVar = {"across": 3.0}

    def __enter__(self):
        return self

    def step(self, inputs=None):
        if inputs:
            warnings.warn("bent by 50 %", stacklevel=1)


def test_what_is_refused_and_that_nothing_is_written(swing, tmp_path, monkeypatch):
    path = tmp_path / "m.fmu"
    with pytest.raises(ValueError, match=r"unknown method 'explicit'; known: exact, generalized_alpha"):
        export_fmu(swing, path, method="explicit", time_step=STEP)
    for more in (
        {"interface": "model_exchange"},
        {"interface": "model_exchange", "time_step": None},
        {"hold_order": 1},
    ):
        with pytest.raises(ValueError, match=r"is for co-simulation with hold_order=0|are of co-simulation"):
            export_fmu(swing, path, **OPTIONS | more)
    for more in ({"stress": "present"}, {"spectral_radius": 0.9}):
        with pytest.raises(ValueError, match='spectral_radius and stress are of method="generalized_alpha"'):
            export_fmu(swing, path, time_step=STEP, **more)
    with pytest.raises(ValueError, match="has no loop that sets the time step"):
        export_fmu(swing, path, method="generalized_alpha")
    with pytest.raises(ValueError, match="takes a Scene, got a LinearModel"):
        export_fmu(linearize(servoed()), path, method="generalized_alpha", time_step=STEP)
    with pytest.raises(ValueError, match="unknown input 'farce'"):
        export_fmu(swing, path, **OPTIONS, input_sizes={"farce": 1.0})
    with pytest.raises(ValueError, match=r'body .bar. has fidelity "ffrf"; take generalized_alpha'):
        export_fmu(swing, path, time_step=STEP)
    law = PythonController(type("Law", (), {"output": lambda *_: 0.0})(), 1 / STEP)
    with pytest.raises(ValueError, match="loop 'own': its controller, a Law in Python, has no place in an FMU"):
        export_fmu(replace(swing, loops=(Loop("own", law, "across", "force"),)), path, method="generalized_alpha")
    own = type("Hand", (PointForce,), {"__module__": "mine"})("hand", "bar.left", "z", "hand")
    with pytest.raises(ValueError, match="'hand' is a Hand of mine, which is not of nassim"):
        export_fmu(replace(swing, actuators=(own,)), path, **OPTIONS)
    with pytest.raises(RuntimeError, match="equilibrium"):
        export_fmu(replace(swing, joints=()), path, **OPTIONS | {"start": "equilibrium"})
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(RuntimeError, match="are for Linux and macOS"):
        export_fmu(swing, path, **OPTIONS, binaries=False)
    assert not any(tmp_path.iterdir())
