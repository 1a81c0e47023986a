"""Random machines, whose routes agree: in another place, in another order, in time, at rest; and which no verb breaks.

Bodies hang on each other by any joint, spring, actuator and sensor at odd places. What is refused is refused in words.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation
from test_routes_agree import STEP, by_scipy

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Controller,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Geophone,
    GroundAcceleration,
    Joint,
    LinearActuator,
    Loop,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    VoiceCoil,
    craig_bampton,
    describe,
    fixed,
    frequency_response,
    linearize,
    load,
    placed,
    planar,
    prismatic,
    revolute,
    save,
    simulate,
    spherical,
    static_response,
    universal,
)
from nassim.exchange import export_c
from nassim.scene.joints import cylindrical
from nassim.simulation import loaded_equilibrium
from nassim.viewer import view_scene

FREQUENCY = np.geomspace(0.5, 400.0, 10)
UP = np.array([0.0, 0.0, 1.0])
SIZES = {"N": 0.05, "N m": 0.005, "m/s2": 0.02, "V": 0.05, "m": 2e-6, "rad": 2e-5}
"""Of inputs, so small that motion stays small."""
FLOORS = {"m": 1e-7, "rad": 1e-6, "N": 1e-3, "N m": 1e-4, "m/s": 1e-6, "m/s2": 1e-4, "V": 1e-4, "A": 1e-5}
"""Of responses to one newton."""


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=4, progress=False)


class Maker:
    """Makes a machine of one to three rigid bodies, and sometimes a flexible one, from a seed."""

    def __init__(self, bar, seed):
        self.rng = np.random.default_rng(seed)
        self.bar, self.points = bar, {"ground": {}}
        count = self.pick(1, 4)
        self.order = [f"body{k}" for k in range(count)] + ["bar"] * bool(self.pick(0, 2))
        self.rng.shuffle(self.order)
        self.points |= {name: {} for name in self.order}
        self.place = {name: self.rng.uniform(-0.2, 0.2, 3) + 0.15 * k * UP for k, name in enumerate(self.points)}
        self.turn = {name: self.rotation() for name in self.points}

    def pick(self, low, high):
        return int(self.rng.integers(low, high))

    def share(self, probability):
        return self.rng.random() < probability

    def uniform(self, low, high):
        return float(self.rng.uniform(low, high))

    def rotation(self):
        return Rotation.random(random_state=self.rng).as_matrix()

    def axis(self):
        return ["x", "y", "z", tuple(self.rng.standard_normal(3).tolist())][self.pick(0, 4)]

    def at(self, name, place=None):
        """A new point of a body, or an end of the bar."""
        if name == "bar":
            return f"bar.{('left', 'right')[self.pick(0, 2)]}"
        arm = self.rng.uniform(-0.08, 0.08, 3) if place is None else self.turn[name].T @ (place - self.place[name])
        point = f"p{len(self.points[name])}"
        self.points[name][point] = arm
        return f"{name}.{point}"

    def other(self, name):
        return self.rng.choice([body for body in self.points if body != name])

    def joint(self, name, a, b):
        def damping(*free):
            return {d: self.uniform(0.1, 2.0) * (0.01 if d.startswith("r") else 10.0) for d in free}

        across = np.linalg.qr(self.rng.standard_normal((3, 2)))[0].T
        free = tuple(d for d in ("x", "y", "z", "rx", "ry", "rz") if self.share(0.5))
        makers = (
            lambda: fixed(name, a, b),
            lambda: revolute(name, a, b, self.axis(), damping=damping("rz")),
            lambda: prismatic(name, a, b, self.axis(), damping=damping("z")),
            lambda: cylindrical(name, a, b, self.axis(), damping=damping("z", "rz")),
            lambda: universal(name, a, b, *across, damping=damping("rx", "ry")),
            lambda: spherical(name, a, b, damping=damping("rx", "ry", "rz")),
            lambda: planar(name, a, b, self.axis(), damping=damping("x", "y", "rz")),
            lambda: Joint(name, a, b, free, self.rotation(), damping(*free)),
        )
        return makers[self.pick(0, len(makers))]()

    def bushing(self, name, a, b):
        root = self.rng.standard_normal((6, 6))
        size = np.array([1, 1, 1, 0.07, 0.07, 0.07])
        stiffness = 1e5 * np.outer(size, size) * (root @ root.T / 6 + 0.5 * np.eye(6))
        return Bushing(name, a, b, stiffness, 2e-4 * stiffness, self.rotation())

    def held(self):
        """Joints and bushings that hold each body to an earlier one and to any other."""
        joints, springs, tree = [], [], ["ground"]
        for k, name in enumerate(self.order):
            parent = self.rng.choice(tree)
            place, end = self.place[name], {name: "left", parent: "right"}.get("bar")
            if end:
                place = self.place["bar"] + self.turn["bar"] @ self.bar.point(end).position
            ends = [f"bar.{end}" if body == "bar" else self.at(body, place) for body in (parent, name)]
            self.rng.shuffle(ends)
            if self.share(0.9):
                joints.append(self.joint(f"joint{k}", *ends))
            springs.append(self.bushing(f"mount{k}", self.at("ground"), self.at(name)))
            tree.append(name)
        return joints, springs

    def spring(self, name):
        body = self.order[self.pick(0, len(self.order))]
        a, b = self.at(self.other(body)), self.at(body)
        axis = "line" if self.share(0.4) else self.axis()
        frame = "" if axis == "line" else ("", a, b)[self.pick(0, 3)]
        preload = self.uniform(-3, 3) * (self.rng.random() < 0.2)
        return SpringDamper(name, a, b, axis, self.uniform(1e3, 3e4), self.uniform(0, 30), frame, preload)

    def actuator(self, name, joints):
        body = self.order[self.pick(0, len(self.order))]
        a, b, given = self.at(self.other(body)), self.at(body), f"{name}.in"
        frame = ("", b)[self.pick(0, 2)]
        sliding = [joint.name for joint in joints if len(joint.free) == 1]
        makers = [
            lambda: PointForce(name, b, self.axis(), given, frame),
            lambda: PointTorque(name, b, self.axis(), given, frame),
            lambda: LinearActuator(name, a, b, given),
            lambda: GroundAcceleration(name, self.axis(), given),
            lambda: VoiceCoil(name, a, b, "line", self.uniform(1, 10), self.uniform(1, 5), 3e-3, given),
        ]
        if sliding and name == "0":
            makers += 2 * [lambda: Drive(name, sliding[0], input=given, bandwidth=80.0)]
        return makers[self.pick(0, len(makers))]()

    def sensor(self, name, springs):
        body = self.order[self.pick(0, len(self.order))]
        a, b = self.at(self.other(body)), self.at(body)
        frame = ("", a, b)[self.pick(0, 3)]
        low_pass = {"bandwidth": self.uniform(50, 500), "order": self.pick(1, 4)} if self.share(0.4) else {}
        sensitivity = self.uniform(0.5, 20) if self.share(0.5) else None
        makers = (
            lambda: Encoder(name, a, b, "line", **low_pass),
            lambda: Encoder(name, a, b, self.axis(), frame, **low_pass),
            lambda: AngleSensor(name, a, b, self.axis(), **low_pass),
            lambda: Pose(name, a, b, self.rotation()),
            lambda: Vibrometer(name, b, self.axis(), frame, **low_pass),
            lambda: Geophone(name, b, self.axis(), frame, self.uniform(1, 10), sensitivity=sensitivity, **low_pass),
            lambda: Accelerometer(name, b, self.axis(), frame, 900.0, 0.3, self.uniform(0, 1), sensitivity, **low_pass),
            lambda: ForceSensor(name, springs[self.pick(0, len(springs))].name, **low_pass),
        )
        return makers[self.pick(0, len(makers))]()

    def bodies(self):
        for name, points in self.points.items():
            pose = {"position": self.place[name], "rotation": self.turn[name]}
            if name == "ground":
                yield RigidBody(name, points or {"o": np.zeros(3)}, fixed=True, **pose)
            elif name == "bar":
                yield FlexibleBody(name, self.bar, fidelity=("rigid", "linear", "ffrf")[self.pick(0, 3)], **pose)
            else:
                yield RigidBody(name, points, self.uniform(1, 5), np.diag(self.rng.uniform(0.01, 0.018, 3)), **pose)

    def loop(self, scene):
        driven = [name for name in scene.inputs if scene.input_unit(name) in ("N", "N m", "V")]
        measured = [name for name in scene.outputs if scene.output_unit(name) in ("m", "rad", "N")]
        if not driven or not measured or self.share(0.5):
            return scene
        law = Controller([[0.5]], [[1e-3]], [[1.0]], [[1e-3]], 1 / STEP, delay=self.pick(0, 2))
        return replace(scene, loops=(Loop("loop", law, self.rng.choice(measured), self.rng.choice(driven)),))

    def machine(self):
        joints, springs = self.held()
        springs += [self.spring(f"spring{k}") for k in range(self.pick(0, 4))]
        actuators = [self.actuator(str(k), joints) for k in range(self.pick(1, 4))]
        sensors = [self.sensor(f"out{k}", springs) for k in range(self.pick(2, 6))]
        gravity = 5.0 * self.rng.standard_normal(3) * self.share(0.7)
        return Scene(
            "machine",
            list(self.bodies()),
            joints,
            actuators,
            sensors,
            springs,
            damping_ratio=0.0,
            gravity=gravity,
            quasi_static_above=np.inf,
        )


def response(model):
    return frequency_response(model, FREQUENCY)


def floors(scene, outputs, inputs):
    """Sizes of responses below which they are rounding, (outputs, inputs)."""
    return np.outer(
        [FLOORS[scene.output_unit(name)] for name in outputs],
        [SIZES["N"] / SIZES[scene.input_unit(name)] for name in inputs],
    )


def assert_alike(found, expected, scene):
    """Whether responses agree, which may have other orders of names."""
    values = found.values[[found.outputs.index(name) for name in expected.outputs]]
    values = values[:, [found.inputs.index(name) for name in expected.inputs]]
    size = np.abs(expected.values).max(axis=2) + floors(scene, expected.outputs, expected.inputs)
    assert (np.abs(values - expected.values).max(axis=2) / size).max() < 1e-6


def static_gains(scene):
    """Changes of all outputs at rest by all inputs, (outputs, inputs)."""
    rest = static_response(scene)
    columns = []
    for name in scene.inputs:
        size = SIZES[scene.input_unit(name)]
        moved = static_response(scene, {name: size})
        columns.append([(moved[output] - rest[output]) / size for output in scene.outputs])
    return np.transpose(columns)


def check(maker, folder):
    scene = maker.machine()
    motion = scene.of_fidelity("ffrf") or [part for part in scene.springs if np.any(part.preload)]
    try:
        model = linearize(scene)
    except ValueError as error:  # what only large motion has
        if "follows a derivative of input" in str(error):
            return
        raise
    expected = response(model)
    turn = maker.rotation()
    there = replace(placed(scene, "there", position=(1, 2, -3), rotation=turn), gravity=turn @ scene.gravity)
    moved = response(linearize(there))
    assert_alike(replace(moved, outputs=model.outputs, inputs=model.inputs), expected, scene)
    mixed = {
        kind: [getattr(scene, kind)[k] for k in maker.rng.permutation(len(getattr(scene, kind)))]
        for kind in ("actuators", "sensors", "bodies")
    }
    assert_alike(response(linearize(replace(scene, **mixed))), expected, scene)

    time = STEP * np.arange(81)
    pulse = np.sin(np.pi * time / time[-1]) ** 4
    values = [SIZES[scene.input_unit(name)] * pulse * (1 + k) for k, name in enumerate(scene.inputs)]
    excitation = TimeHistory(7.0 + time, values, scene.inputs)
    rest = replace(excitation, values=0 * excitation.values)
    options = {"time_step": STEP, "progress": False}
    if not motion:
        found, at_rest = (simulate(scene, given, method="exact", **options) for given in (excitation, rest))
        moved = np.array([found[name] - at_rest[name] for name in model.outputs])
        stepped = by_scipy(model.matrices, dict(zip(model.inputs, values, strict=True)), model.inputs, None)
        least = 1e-3 * np.array([FLOORS[unit] for unit in model.units])
        assert (np.abs(moved - stepped).max(axis=1) < 1e-6 * np.abs(stepped).max(axis=1) + least).all()
    gains = model.D - model.C @ np.linalg.solve(model.A, model.B)
    size = np.abs(gains) + floors(scene, model.outputs, model.inputs)
    assert (np.abs(static_gains(scene) - gains) / size).max() < 0.01  # rotations at rest are of this size

    simulate(maker.loop(scene), excitation, **options)
    assert load(save(scene, folder / "scene.h5")).inputs == scene.inputs
    assert repr(loaded_equilibrium(scene))
    assert describe(scene)
    assert view_scene(scene)
    export_c(model, folder, "model", time_step=STEP)


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 80))])
def test_random_machines(bar, seed, tmp_path):
    check(Maker(bar, seed), tmp_path)
