"""Figures of every script and matrices of a dozen scenes, before and after a rebuilding that must not change them.

Usage: python tests/unchanged_figures.py write FILE | compare FILE [OTHER FILE]
"""

import json
import math
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from test_scripts import test_script_writes_its_results

from models.apa300ml import PORTS, make_apa300ml
from models.bench import make_bench
from nassim import (
    Controller,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageDrive,
    build_fe_model,
    craig_bampton,
    linearize,
    simulate,
)

TOLERANCE = 1e-12
TIMINGS = ("time_s", "us_per_step", "steps_per_s", "real_time_factor", "speed", "memory", "command", "ratio_to_exudyn")
LOOSER = {
    # One unit in the last digit of a stiffness moves these by 2e-9: Newton's tolerance in static equilibrium.
    "generalized_alpha": 1e-8,
    # These differ between two runs of one version: a solver on two threads.
    "compare_routes.py: /volume_stress": 1e-9,
    "compare_routes.py: /axial_stress": 1e-9,
    "exudyn_ngsolve/error": 1e-4,
    # Of another form, not of another value.
    "trimmed_scene": 0.0,
}
"""Tolerances of figures whose name holds these words."""


def script_figures():
    """Summary of every script with the options of its test."""
    (mark,) = [m for m in test_script_writes_its_results.pytestmark if m.name == "parametrize"]
    for name, options, *_ in mark.args[1]:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, f"scripts/{name}", *options, "--no-plot", "--output", folder]
            subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            print(name, flush=True)
            for key, value in flat(json.loads((Path(folder) / "summary.json").read_text())):
                yield f"{name}: {key}", value


def flat(value, path=""):
    if isinstance(value, dict):
        for key, item in value.items():
            yield from flat(item, f"{path}/{key}")
    elif isinstance(value, list):
        for key, item in enumerate(value):
            yield from flat(item, f"{path}/{key}")
    elif not any(word in path for word in TIMINGS):
        yield path, value


def scenes():
    """A dozen scenes with every kind of part and fidelity."""
    solid = make_apa300ml(ports=PORTS)
    apa = craig_bampton(build_fe_model(solid, element_size=8e-3, order=2, progress=False), progress=False)
    bench = make_bench(apa=apa, gravity=True)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    yield "bench", bench
    yield "linear", make_bench(apa=apa, fidelity="linear")
    yield "rigid", make_bench(apa=apa, fidelity="rigid")
    yield "pair", make_bench(apa=apa, ports=False, disturbances=True)
    yield "pair, linear, gravity", make_bench(apa=apa, ports=False, fidelity="linear", gravity=True)
    yield "trimmed", make_bench(apa=apa, cutoff_frequency=2000.0)
    yield "trimmed pair", make_bench(apa=apa, ports=False, cutoff_frequency=2000.0)
    yield "open", make_bench(apa=apa, resistance=math.inf, damping_ratio=np.array([0.02, 0.01, 0.005]))
    slow = VoltageDrive("actuator_stacks", "apa.actuator", "actuator_voltage", gain=20.0, bandwidth=500.0)
    yield "amplifier", replace(bench, actuators=(slow,))
    yield "amplifier, linear", replace(make_bench(apa=apa, fidelity="linear"), actuators=(slow,))
    controller = Controller(np.array([[0.9]]), np.array([[1.0]]), np.array([[-1e-3]]), np.zeros((1, 1)), 1e4, delay=1)
    loop = Loop("iff", controller, ("sensor_voltage",), ("actuator_voltage",), input_step=1e-4)
    for fidelity in ("ffrf", "linear"):
        yield f"loop, {fidelity}", replace(make_bench(apa=apa, fidelity=fidelity), loops=(loop,))
    for fidelity in ("ffrf", "linear"):
        top = FlexibleBody("apa", apa, rotation=turn, position=np.array([0.1, -0.2, 0.3]), fidelity=fidelity)
        end, mount = top.point_position("top"), top.point_position("bottom")
        block = RigidBody(
            "block", {"mount": np.zeros(3), "corner": [0.05, 0.02, 0.01]}, 3.0, np.diag([1e-2, 2e-2, 2.5e-2]), end
        )
        ground = RigidBody("ground", {"foot": mount, "wall": end + np.array([0.1, 0.0, 0.0])}, fixed=True)
        yield (
            f"turned, spring, {fidelity}",
            Scene(
                "turned",
                (ground, top, block),
                (
                    Joint("foot", "ground.foot", "apa.bottom"),
                    Joint("head", "apa.top", "block.mount", free=("rx", "ry")),
                ),
                (PointForce("push", "block.corner", "y", "force"),),
                (Encoder("gauge", "ground.wall", "block.corner", "x"),),
                (SpringDamper("spring", "ground.wall", "block.corner", "y", 1e5, 30.0),),
                gravity=np.array([0.3, -0.2, -9.81]),
            ),
        )


def scene_figures():
    """Linear models, and 40 steps of each scene in time."""
    for label, scene in scenes():
        print(label, flush=True)
        model = linearize(scene)
        for key in "ABCD":
            yield f"{label}: {key}", getattr(model, key)
        time = np.arange(41) * 1e-4
        names = tuple(scene.inputs)
        rows = [np.sin(2 * np.pi * (250 + 50 * k) * time + k) for k in range(len(names))]
        excitation = TimeHistory(time, np.array(rows), names, tuple("" for _ in names))
        for method in ("generalized_alpha", "exact")[: 1 + scene.in_small_motion]:
            run = simulate(scene, excitation, time_step=1e-4, method=method, progress=False)
            for name in scene.outputs:
                yield f"{label}: {method} {name}", run.values[run.names.index(name)]


def deviation(before, after):
    """Largest difference of two figures over the larger size."""
    if isinstance(before, str) or before is None or isinstance(before, bool):
        return 0.0 if before == after else math.inf
    a, b = np.asarray(before, dtype=float), np.asarray(after, dtype=float)
    if a.shape != b.shape:
        return math.inf
    return float(np.abs(a - b).max(initial=0.0) / max(np.abs(a).max(initial=0.0), 1e-300))


def signed(figures):
    """Linear models with the sign of each mode, which is free, such that its largest push or reading is positive."""
    result = dict(figures)
    for label in {key[:-3] for key in figures if key.endswith(": B")}:
        a, b, c = (np.asarray(figures[f"{label}: {name}"], dtype=float) for name in "ABC")
        n = len(a)
        push = np.hstack([b / max(np.abs(b).max(initial=0.0), 1e-300), c.T / np.abs(c).max(initial=1e-300)])
        push = np.array([row if np.abs(row).max() > 1e-9 else np.ones(1) for row in push], dtype=object)
        signs = np.array([np.sign(row[np.argmax(np.abs(row))]) for row in push], dtype=float)
        # A displacement and its rate have one sign.
        half = np.count_nonzero(np.diag(a, n // 2) == 1.0) if n > 1 else 0
        signs[half : 2 * half] = signs[:half]
        result[f"{label}: A"], result[f"{label}: B"] = signs[:, None] * a * signs, signs[:, None] * b
        result[f"{label}: C"] = c * signs
    return result


def main(verb, path, after=None):
    figures = json.loads(Path(after).read_text()) if after else {**dict(scene_figures()), **dict(script_figures())}
    if verb == "write":
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in figures.items()}
        Path(path).write_text(json.dumps(plain))
        return
    timed = [key for key in figures if any(word in key for word in TIMINGS)]
    before, figures = signed(json.loads(Path(path).read_text())), signed(figures)
    before, figures = (
        {k: v for k, v in part.items() if not any(w in k for w in TIMINGS)} for part in (before, figures)
    )
    for key in sorted(before.keys() ^ figures.keys()):
        print("only in one:", key)
    off = {key: deviation(before[key], figures[key]) for key in before.keys() & figures.keys()}
    limit = {key: max([TOLERANCE, *(v for word, v in LOOSER.items() if word in key)]) for key in off}
    worse = sorted((d, key) for key, d in off.items() if not d <= limit[key])
    for d, key in worse:
        print(f"{d:.2g}  {key}")
    print(f"{len(off)} figures compared ({len(timed)} timings left out), {len(worse)} differ by more than they may")
    sys.exit(bool(worse))


if __name__ == "__main__":
    main(*sys.argv[1:])
