"""Rigid bodies that rigid joints hold to a floating body are part of it: against the same scene with its joints."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    craig_bampton,
    fixed,
    revolute,
)
from nassim.simulation import simulate_motion
from nassim.simulation.exudyn import system as exudyn_system
from nassim.simulation.exudyn.steady_state import squares_at_rest
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.rigid_groups import CarriedBody, find_rigid_groups, with_carried

PLACE = np.array([0.2, -0.1, 0.3])
TURN = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
OUTPUTS = ("reach", "knob_speed", "knob_shake", "shaft_shake", "pose.ux", "pose.rz", "bed.fx", "bed.mz", "pull")


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=3, progress=False)


def inertia(seed, size):
    turn = Rotation.random(random_state=seed).as_matrix()
    return turn @ np.diag(np.array([1.0, 1.3, 1.9]) * size) @ turn.T


def machine(bar, frame="left", *, speed=0.0, gravity=0.0):
    """A shaft carries a bar, which carries a head with a knob, on which a bushing holds a table; all lies askew."""
    left, right = (PLACE + TURN @ bar.point(name).position for name in ("left", "right"))
    random = np.random.default_rng(5)

    def rigid(name, at, mass, points, turn=None):
        turn = Rotation.random(random_state=len(name)).as_matrix()
        arms = {key: turn.T @ (place - at) for key, place in points.items()}
        return RigidBody(name, arms, mass, inertia(len(name), 2e-5 * mass), at, rotation=turn)

    pin, centre, seam, tip, seat = (at + random.uniform(-0.02, 0.02, 3) for at in (left, left, right, right, right))
    post = pin + [0.05, 0.03, -0.04]
    bodies = (
        RigidBody("ground", {"pin": pin, "post": post}, fixed=True),
        rigid("shaft", centre, 0.3, {"pin": pin, "mount": left, "horn": centre + [0.01, 0.02, 0.0]}),
        FlexibleBody("bar", bar, PLACE, TURN, "ffrf", frame, damping_ratio=0.02),
        rigid("head", seam + [0.01, -0.02, 0.005], 0.2, {"mount": right, "seam": seam, "seat": seat}),
        rigid("knob", tip, 0.1, {"seam": seam, "tip": tip + [0.0, 0.015, 0.01]}),
        rigid("table", seat + [0.01, 0.01, 0.02], 0.15, {"seat": seat}),
    )
    joints = (
        revolute("axle", "ground.pin", "shaft.pin", (0.3, -0.2, 1.0), damping=1e-3),
        fixed("top", "bar.right", "head.mount"),
        fixed("seam", "knob.seam", "head.seam"),
        fixed("bottom", "shaft.mount", "bar.left"),
    )
    return Scene(
        "machine",
        bodies,
        joints,
        (
            *((Drive("motor", "axle", "rz", speed=speed),) if speed else ()),
            PointForce("push", "knob.tip", (1.0, 0.4, -0.3), "force", frame="knob.tip"),
            PointTorque("twist", "head.seat", (0.0, 0.2, 1.0), "torque"),
            GroundAcceleration("quake", (0.1, 0.2, 1.0), "quake"),
        ),
        (
            Encoder("reach", "ground.post", "knob.tip", "line"),
            Vibrometer("knob_speed", "knob.tip", (0.2, 1.0, 0.3)),
            Accelerometer("knob_shake", "knob.tip", (0.1, -0.3, 1.0)),
            Accelerometer("shaft_shake", "shaft.horn", (1.0, 0.5, 0.2), frame="shaft.horn"),
            Pose("pose", "shaft.horn", "head.seat"),
            ForceSensor("bed", "bed"),
            ForceSensor("pull", "pull"),
        ),
        (
            Bushing("bed", "head.seat", "table.seat", (2e4, 3e4, 4e4, 5.0, 6.0, 7.0), 1e-4 * np.array([2e4] * 3 + [5.0] * 3)),
            SpringDamper("pull", "shaft.horn" if speed else "ground.post", "knob.tip", "line", 2e3, 1.0),
            *(() if speed else (SpringDamper("hold", "ground.post", "shaft.horn", "line", 3e3, 1.0),)),
        ),
        damping_ratio=0.0,
        gravity=gravity * np.array([0.3, 0.2, -1.0]),
    )


@pytest.fixture
def jointed(monkeypatch):
    """Build the same scenes with their joints."""

    def without_hosts(assembly):
        found = find_rigid_groups(assembly)
        mounts = {"top", "bottom"}
        return replace(found, hosts={}, joints=found.joints - mounts)

    return lambda: monkeypatch.setattr(exudyn_system, "find_rigid_groups", without_hosts)


@pytest.mark.parametrize("frame", ["left", "right"])
def test_frequencies_and_coordinates(bar, frame, jointed):
    scene = machine(bar, frame)
    assembly = assemble(scene)
    one = build_system(assembly)
    jointed()
    several = build_system(assembly)
    sizes = [(s.mbs.systemData.ODE2Size(), s.mbs.systemData.AEsize()) for s in (one, several)]
    assert np.subtract(*sizes[::-1]).tolist() == [14, 14]
    squares = [np.sqrt(squares_at_rest(system)) for system in (one, several)]
    np.testing.assert_allclose(squares[0], squares[1], rtol=1e-6)
    np.testing.assert_allclose(squares[0], np.sort(2 * np.pi * assembly.modal.frequency), rtol=1e-6)


def test_carried_bodies_add_their_mass_to_all_integrals(bar):
    """Mass matrix of the host with its guests in the coordinates of the host, against that of the joined bodies."""
    assembly = assemble(machine(bar))
    groups = find_rigid_groups(assembly)
    assert groups.hosts == {"shaft": "bar.left", "knob": "bar.right"} or groups.hosts == {
        "shaft": "bar.left",
        "head": "bar.right",
    }
    host = assembly.scene.split("bar.")[0]
    guests = [CarriedBody(assembly.scene.split(f"{name}.")[0].along_world, host, groups.hosts[leader].split(".")[1])
              for name, leader in groups.leaders.items() if leader in groups.hosts]
    whole = with_carried(host, guests).reduced
    basis = assembly.constraints.basis
    place = assembly.coordinates.slices["bar"]
    apart = sum(
        (rows.T @ assembly.scene.split(f"{name}.")[0].mass_matrix @ rows
        for name in ("shaft", "bar", "head", "knob") for rows in (basis[assembly.coordinates.slices[name]],)),
        start=np.zeros((basis.shape[1],) * 2),
    )
    together = basis[place].T @ whole.mass_matrix @ basis[place]
    np.testing.assert_allclose(together, apart, atol=1e-12 * np.abs(apart).max())
    trace = np.einsum("jckc->jk", whole.gram[4:, 4:].reshape(len(whole.mass_matrix), 3, -1, 3))
    np.testing.assert_allclose(trace, whole.mass_matrix, atol=1e-9 * np.abs(whole.mass_matrix).max())


@pytest.mark.parametrize(("frame", "speed", "gravity"), [("left", 0.0, 5.0), ("right", 0.0, 0.0), ("left", 30.0, 0.0)])
def test_histories_and_images(bar, frame, speed, gravity, jointed):
    scene, step = machine(bar, frame, speed=speed, gravity=gravity), 1e-4
    time = np.arange(301) * step
    values = np.array([np.sin(300 * time), 0.01 * np.cos(500 * time), np.sin(200 * time)]) * 0.3
    push = TimeHistory(time, values, ("force", "torque", "quake"), ("N", "N m", "m/s2"))
    options = {"time_step": step, "frames": 4, "progress": False}
    one, shown = simulate_motion(scene, push, **options)
    jointed()
    several, seen = simulate_motion(scene, push, **options)
    for name in several.names:
        size = np.abs(several[name] - several[name][0]).max()
        print(name, np.abs(one[name] - several[name]).max() / size)
    for name in scene.bodies:
        places = [dict(zip(m.__dataclass_fields__, (getattr(m, f) for f in m.__dataclass_fields__))) for m in (shown, seen)]; print(name.name, [(k, np.abs(np.asarray(places[0][k][name.name])-np.asarray(places[1][k][name.name])).max()) for k in list(places[0])[1:] if name.name in places[0][k]])
