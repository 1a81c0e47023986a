"""What a run in Exudyn does at every step and every look, gathered so that it costs little, against one by one."""

import exudyn as exu
import numpy as np
import pytest
from conftest import lattice

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    fixed,
    revolute,
    simulate,
)
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.axial_preload import axial_forces
from nassim.simulation.model.rigid_groups import find_rigid_groups


def chain(*fidelities):
    """Bars end to end, the first clamped, and a block on the last."""
    bar = craig_bampton(lattice(), n_modes=2, progress=False)
    step = bar.point("right").position - bar.point("left").position
    turned = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    start = np.array([0.1, 0.2, 0.3])
    bodies = [RigidBody("ground", {"left": start}, fixed=True)]
    joints = []
    for k, fidelity in enumerate(fidelities):
        place = start + k * step - turned @ bar.point("left").position
        bodies.append(FlexibleBody(f"bar{k}", bar, place, turned, fidelity))
        before = "ground.left" if k == 0 else f"bar{k - 1}.right"
        joints.append(Joint(f"joint{k}", before, f"bar{k}.left"))
    end, ahead = start + len(fidelities) * step, np.array([0.01, 0.0, 0.0])
    inertia = np.diag([1e-4, 2e-4, 2.5e-4])
    bodies.append(RigidBody("block", {"left": -ahead}, 0.3, inertia, end + ahead))
    joints.append(Joint("mount", f"bar{len(fidelities) - 1}.right", "block.left"))
    return Scene("chain", tuple(bodies), tuple(joints))


@pytest.mark.parametrize("fidelities", [("linear", "linear"), ("ffrf", "linear"), ("linear", "ffrf"), ("ffrf", "ffrf")])
def test_a_look_sees_all_bodies_as_one_by_one(fidelities):
    system = build_system(assemble(chain(*fidelities)))
    seen = Monitor(system)
    random, data, states = np.random.default_rng(3), system.mbs.systemData, []
    for sample, scale in enumerate((1e-6, 3e-6, 2e-6)):
        data.SetODE2Coordinates(scale * random.standard_normal(data.ODE2Size()), exu.ConfigurationType.Current)
        seen.look(sample)
        states.append({name: system.deformation(name) for name in system.flexible})
    assert set(seen.largest) == set(system.flexible)
    for name in system.flexible:
        parts = system.assembly.coordinates.size_rows[name]
        sizes = [[np.abs(rows @ state[name]).max(initial=0.0) for rows in parts] for state in states]
        np.testing.assert_allclose(seen.largest[name], np.max(sizes, axis=0), rtol=1e-12, atol=1e-20)
        if name in seen.most_turned:
            most = states[int(np.argmax(sizes, axis=0)[0])][name]
            np.testing.assert_allclose(seen.most_turned[name], most, rtol=1e-12, atol=1e-20)
    assert set(seen.most_turned) == {body.name for body in system.assembly.scene.of_fidelity("ffrf")}
    assert set(seen.slackest) == {body.name for body in system.assembly.scene.deformable_bodies}
    for body in system.assembly.scene.deformable_bodies:
        found = np.column_stack([axial_forces(body.reduced, state[body.name]) for state in states])
        assert found.shape[0] > 0
        expected = np.minimum(found.min(axis=1), 0.0)
        np.testing.assert_allclose(seen.slackest[body.name], expected, atol=1e-9 * np.abs(found).max())


def test_the_fastest_look_counts():
    """Angular speeds of Euler parameters, 2 |e'| where e . e' = 0: of each body the fastest, at rest least."""
    system = build_system(assemble(chain("linear", "ffrf", "ffrf")))
    seen, data = Monitor(system), system.mbs.systemData
    places = {name: system.mbs.GetNodeODE2Index(system.nodes[name]) + 3 for name in ("bar1", "bar2")}
    parameters = data.GetODE2Coordinates(exu.ConfigurationType.Reference) + data.GetODE2Coordinates()
    assert set(seen.speeds) == set(places)
    assert set(seen.speeds.values()) == {0.0}
    random, speeds = np.random.default_rng(4), {"bar1": (5.0, 30.0, 20.0), "bar2": (7.0, 3.0, 4.0)}
    for sample in range(3):
        rates = np.zeros(data.ODE2Size())
        for name, place in places.items():
            e = parameters[place : place + 4]
            across = np.linalg.qr(np.column_stack([e, random.standard_normal(4)]))[0][:, 1]
            rates[place : place + 4] = 0.5 * speeds[name][sample] * across
        data.SetODE2Coordinates_t(rates, exu.ConfigurationType.Current)
        seen.look(sample)
    assert seen.speeds == {name: pytest.approx(max(values)) for name, values in speeds.items()}


def heavy(name, cloud, points):
    """A rigid body of point masses (mass, place), with points at places, all in the world."""
    masses, places = np.array([m for m, _ in cloud]), np.array([p for _, p in cloud])
    centre = masses @ places / masses.sum()
    inertia = sum(m * ((p - centre) @ (p - centre) * np.eye(3) - np.outer(p - centre, p - centre)) for m, p in cloud)
    return RigidBody(name, {k: p - centre for k, p in points.items()}, masses.sum(), inertia, centre)


def swing(bodies, joints, names):
    """A spatial pendulum that a spring and a force make swing far; names: whose point "hinge", "tip" and "end" is."""
    hinge, tip, end = names
    return Scene(
        "swing",
        bodies,
        (*joints, revolute("pin", "post.top", f"{hinge}.hinge", (1.0, 2.0, -0.5))),
        (PointForce("push", f"{end}.end", (0.3, 1.0, 0.2), "force"),),
        (Encoder("tip", "ground.tip", f"{tip}.tip", "line"), Encoder("height", "ground.tip", f"{end}.end", "z")),
        (SpringDamper("spring", "post.foot", f"{tip}.tip", "line", 300.0, 2.0),),
        damping_ratio=0.0,
        gravity=np.array([0.0, 0.5, -9.81]),
    )


def test_bodies_that_rigid_joints_hold_together_swing_as_one():
    """Clouds of masses in three bodies on a post, against one body of all masses and a post that is the ground."""
    random = np.random.default_rng(7)
    pin = np.array([0.4, 0.1, 0.3])
    foot, tip, end, anchor = random.uniform(-0.2, 0.2, (4, 3))
    clouds = [
        [(m, p) for m, p in zip(random.uniform(0.1, 0.9, 5), spots, strict=True)]
        for spots in random.uniform(-0.3, 0.3, (3, 5, 3))
    ]
    seams = random.uniform(-0.1, 0.1, (2, 3))
    parts = (
        heavy("arm", clouds[0], {"hinge": pin, "seam": seams[0]}),
        heavy("head", clouds[1], {"seam": seams[0], "other": seams[1], "tip": tip}),
        heavy("tail", clouds[2], {"other": seams[1], "end": end, "seam": seams[0]}),
    )
    ground = RigidBody("ground", {"tip": anchor, "top": pin}, fixed=True)
    loose = heavy("post", clouds[0], {"top": pin, "foot": foot})
    rigid = RigidBody("post", {"top": pin, "foot": foot}, fixed=True)
    joints = (
        fixed("first", "tail.other", "head.other"),
        fixed("mast", "post.top", "ground.top"),
        fixed("second", "arm.seam", "head.seam"),
        fixed("again", "arm.seam", "tail.seam"),  # which the others hold already
    )
    together = heavy("all", [*clouds[0], *clouds[1], *clouds[2]], {"hinge": pin, "tip": tip, "end": end})
    scenes = (
        swing((*parts, loose, ground), joints, ("arm", "head", "tail")),
        swing((together, rigid, ground), (), ("all", "all", "all")),
    )
    systems = [build_system(assemble(scene)) for scene in scenes]
    assert [system.mbs.systemData.ODE2Size() for system in systems] == [7, 7]
    time = np.arange(401) * 1e-3
    push = TimeHistory(time, 3.0 * np.sin(20.0 * time)[None], ("force",), ("N",))
    several, one = (simulate(scene, push, time_step=1e-3, progress=False, start="released") for scene in scenes)
    assert np.abs(one["height"]).max() > 0.05
    for output in ("tip", "height"):
        np.testing.assert_allclose(several[output], one[output], atol=1e-8 * np.abs(one[output]).max())


def test_only_what_holds_in_all_directions_is_one():
    """A joint that leaves a turn free and one to a body in small motion stay joints, but for one to the ground."""
    scene = chain("linear", "rigid")
    welds = find_rigid_groups(assemble(scene).constraints)
    assert welds.joints == {"joint0", "mount"}
    assert welds.groups == {"ground": ["ground"], "bar1": ["bar1", "block"]}
    free = Joint("mount", "bar1.right", "block.left", free=("rx",))
    hinged = Scene("hinged", scene.bodies, (*scene.joints[:-1], free))
    assert find_rigid_groups(assemble(hinged).constraints).joints == {"joint0"}
