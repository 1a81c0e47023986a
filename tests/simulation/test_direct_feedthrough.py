"""What outputs feel of inputs at once: of machines side by side in a scene nothing, to the last digit."""

from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    Bushing,
    Controller,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    condense,
    craig_bampton,
    fixed,
    linearize,
    prismatic,
    revolute,
    simulate,
)
from nassim.scene.field_kinds import Path
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.terms import Output

PUSH, FEEL = np.array([2.0, -1.0, 2.0]) / 3, np.array([3.0, 0.0, 4.0]) / 5
SHAPE = np.array([0.02, 0.05, 0.1])
STEP = 1e-4


@dataclass(frozen=True)
class Rate(Sensor):
    """A derivative of a point's displacement."""

    point: Path
    derivative: int

    def terms(self, scene):
        """It reads along an odd direction."""
        return (Output(self.name, "", Displacement(((self.point, FEEL),)), derivative=self.derivative),)


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(condense(lattice(), progress=False), n_modes=4, progress=False)


class Machines:
    """A driven sledge with a load on springs, two doors on hinges and a clamped bar, anywhere, turned anyhow."""

    def __init__(self, bar, seed, damping_ratio=0.01):
        self.rng = np.random.default_rng(seed)
        places = {name: self.rng.normal(size=3) for name in ("rail", "door", "gate", "wall", "bar")}
        turn = Rotation.random(random_state=self.rng).as_matrix()
        flexible = FlexibleBody("bar", bar, places["bar"], rotation=turn, fidelity="linear")
        ground = RigidBody("ground", {**places, "clamp": flexible.point_position("left")}, fixed=True)
        self.sledge, self.door, self.gate = (self.body(name, places[name]) for name in ("rail", "door", "gate"))
        load = self.body("load", self.sledge.point_position("far"))
        self.hinge = Rotation.random(random_state=self.rng).as_matrix()[0]
        self.scene = Scene(
            "machines",
            (ground, self.sledge, load, self.door, self.gate, flexible),
            (
                prismatic("rail", "ground.rail", "rail.near", Rotation.random(random_state=self.rng).as_matrix()[0]),
                revolute("door", "ground.door", "door.near", self.hinge),
                revolute("gate", "ground.gate", "gate.near", self.hinge),
                fixed("clamp", "ground.clamp", "bar.left"),
            ),
            (
                Drive("motor", "rail", "z", "way"),
                PointForce("at_door", "door.far", PUSH, "door_force"),
                PointForce("at_bar", "bar.right", PUSH, "bar_force"),
            ),
            tuple(
                Rate(f"{point}.{order}", f"{point}.{end}", order)
                for point, end in (("door", "far"), ("gate", "far"), ("bar", "right"))
                for order in (0, 1, 2)
            ),
            (
                Bushing("seat", "rail.far", "load.near", self.rng.uniform(1e3, 1e5, 6), np.full(6, 2.0)),
                SpringDamper("stop", "ground.wall", "door.far", "line", 2e5, 3.0),
                SpringDamper("brake", "ground.wall", "gate.far", "line", 0.0, 5.0),
            ),
            damping_ratio=damping_ratio,
        )

    def body(self, name, place):
        turn = Rotation.random(random_state=self.rng).as_matrix()
        points = {"near": SHAPE / 3, "far": SHAPE}
        inertia = np.diag([1.0, 1.3, 1.9]) * 1e-3
        return RigidBody(name, points, self.rng.uniform(0.1, 5.0), inertia, place - turn @ SHAPE / 3, rotation=turn)

    def at_once(self):
        """Acceleration of the door's far corner per unit force: levers over the inertia about the hinge."""
        turn, arm = self.door.rotation, self.door.rotation @ SHAPE / 3
        own = turn @ self.door.inertia @ turn.T
        about = self.hinge @ own @ self.hinge + self.door.mass * np.sum(np.cross(self.hinge, arm) ** 2)
        lever = np.cross(self.hinge, 2 * arm)
        return (lever @ FEEL) * (lever @ PUSH) / about


@pytest.mark.parametrize("damping_ratio", [0.01, 0.0])
@pytest.mark.parametrize("seed", range(4))
def test_machines_side_by_side_feel_nothing_of_each_other(bar, seed, damping_ratio):
    machines = Machines(bar, seed, damping_ratio)
    model = linearize(machines.scene)
    door, bar_end = (model.outputs.index(f"{name}.2") for name in ("door", "bar"))
    found = model.D[:, [model.inputs.index(name) for name in ("way", "door_force", "bar_force")]]
    assert found[door, 1] == pytest.approx(machines.at_once(), rel=1e-9)
    assert found[bar_end, 2] > 1e-3
    found[door, 1] = found[bar_end, 2] = 0.0
    assert not np.any(found)


def loop(*measured, driven):
    n = len(measured)
    controller = Controller([[0.0]], np.zeros((1, n)), [[0.0]], np.full((1, n), 1e-6), 1 / STEP)
    return Loop("hold", controller, measured, (driven,))


def run(scene):
    record = np.zeros((len(scene.inputs), 4))
    excitation = TimeHistory(
        STEP * np.arange(4), record, scene.inputs, [scene.input_unit(name) for name in scene.inputs]
    )
    return simulate(scene, excitation, time_step=STEP, progress=False)


@pytest.mark.parametrize(
    ("measured", "driven"),
    [("door.0", "way"), ("gate.2", "way"), ("bar.2", "way"), ("gate.2", "door_force"), ("door.2", "bar_force")],
)
def test_a_loop_may_measure_one_machine_and_move_another(bar, measured, driven):
    scene = replace(Machines(bar, 5).scene, loops=(loop(measured, driven=driven),))
    run(scene)


@pytest.mark.parametrize(("measured", "driven"), [("door.2", "door_force"), ("bar.2", "bar_force"), ("tip", "way")])
def test_what_follows_at_once_stays_refused(bar, measured, driven):
    """Also of a sledge of tonnes, a tip of micrograms on it; the loop measures what does not follow, too."""
    machines = Machines(bar, 6)
    heavy = replace(machines.sledge, mass=5e3)
    bodies = [heavy if body.name == "rail" else body for body in machines.scene.bodies]
    tip = RigidBody("tip", {"on": np.zeros(3)}, 1e-9, 1e-15 * np.eye(3), heavy.point_position("far"))
    sensors = (*machines.scene.sensors, Encoder("tip", "ground.rail", "tip.on", "x"))
    scene = replace(
        machines.scene,
        bodies=(*bodies, tip),
        joints=(*machines.scene.joints, fixed("glue", "rail.far", "tip.on")),
        sensors=sensors,
        loops=(loop("door.0", measured, driven=driven),),
    )
    with pytest.raises(ValueError, match=f"loop 'hold' measures '{measured}', which follows what the loop drives"):
        run(scene)


@pytest.mark.parametrize(("slope", "refused"), [(1e-17, False), (1e-9, True)])
def test_a_velocity_across_a_drive_is_no_derivative_of_it(slope, refused):
    """An axis that is across the slide but for rounding; one that is not, by little."""
    ground = RigidBody("ground", {"rail": np.zeros(3)}, fixed=True)
    sledge = RigidBody("sledge", {"rail": SHAPE}, 2.0, np.diag([1.0, 1.3, 1.9]) * 1e-3, -SHAPE)
    scene = Scene(
        "sledge",
        (ground, sledge),
        (prismatic("rail", "ground.rail", "sledge.rail", "y"),),
        (Drive("motor", "rail", input="way"),),
        (Vibrometer("across", "sledge.rail", (0, slope, 1)),),
    )
    with pytest.raises(ValueError, match="follows a derivative") if refused else nullcontext():
        linearize(scene)


def test_a_loop_may_measure_the_force_of_a_spring_beside_accelerometers(bar):
    """Accelerometers and drives let a loop be checked for what follows at once."""
    machines = Machines(bar, 5)
    force = ForceSensor("force", of="stop")
    scene = replace(machines.scene, sensors=(*machines.scene.sensors, force), loops=(loop("force", driven="way"),))
    assert not np.any(run(scene)["force"])


@pytest.mark.parametrize("beside", ["spin", "way"])
def test_a_loop_runs_beside_drives_whose_motion_no_linear_model_has(beside):
    """A turntable that a force of the world's pushes, a sledge whose velocity is read: the check is about the loop."""
    inertia = np.diag([1.0, 1.3, 1.9]) * 1e-3
    ground = RigidBody("ground", {"axle": np.zeros(3)}, fixed=True)
    table = RigidBody("table", {"axle": -SHAPE, "rail": SHAPE}, 3.0, inertia, SHAPE)
    slider = RigidBody("slider", {"rail": SHAPE}, 1.0, inertia, SHAPE)
    way = {"input": "way"} if beside == "way" else {"speed": 5.0}
    axle = prismatic if beside == "way" else revolute
    scene = Scene(
        "table",
        (ground, table, slider),
        (axle("axle", "ground.axle", "table.axle", "z"), prismatic("rail", "table.rail", "slider.rail", "x")),
        (Drive("motor", "axle", **way), PointForce("push", "slider.rail", "y", "force")),
        (
            Encoder("gap", "table.rail", "slider.rail", "x", "table.rail"),
            Vibrometer("speed", "slider.rail", "z"),
            Accelerometer("shock", "slider.rail", "x"),
        ),
        (SpringDamper("spring", "table.rail", "slider.rail", "x", 1e3, 1.0, "table.rail"),),
        damping_ratio=0.0,
        loops=(loop("gap", "speed", driven="force"),),
    )
    time = STEP * np.arange(200)
    ramp = TimeHistory(time, [0.5 * time**2 if name == "way" else 0 * time for name in scene.inputs], scene.inputs)
    record = simulate(scene, ramp, time_step=STEP, progress=False)
    if beside == "way":
        np.testing.assert_allclose(record["hold"][50:-1], 1e-6 * time[49:-2], rtol=0.05)
    else:
        stretch = 5.0**2 * SHAPE[0] / (1e3 - 5.0**2)  # of the slider's centre of mass
        np.testing.assert_allclose(record["gap"][0], stretch, rtol=1e-3)
