"""What a run in Exudyn does at every step and every look, gathered so that it costs little, against one by one."""

import exudyn as exu
import numpy as np
import pytest
from conftest import lattice

from nassim import FlexibleBody, Joint, RigidBody, Scene, craig_bampton
from nassim.simulation.buckling import axial_forces
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.exudyn.watch import Watch
from nassim.simulation.small_motion import assemble, motion_size


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
    seen = Watch(system)
    random, data, states = np.random.default_rng(3), system.mbs.systemData, []
    for scale in (1e-6, 3e-6, 2e-6):
        data.SetODE2Coordinates(scale * random.standard_normal(data.ODE2Size()), exu.ConfigurationType.Current)
        seen.look()
        states.append({name: system.deformation(name) for name in system.carriers})
    assert set(seen.largest) == set(system.carriers)
    for name in system.carriers:
        sizes = [motion_size(system.assembly, name, state[name][:, None]) for state in states]
        np.testing.assert_allclose(seen.largest[name], np.max(sizes, axis=0), rtol=1e-12, atol=1e-20)
    assert set(seen.slackest) == {body.name for body in system.assembly.scene.deformable_bodies}
    for body in system.assembly.scene.deformable_bodies:
        found = np.column_stack([axial_forces(body.reduced, state[body.name]) for state in states])
        assert found.shape[0] > 0
        expected = np.minimum(found.min(axis=1), 0.0)
        np.testing.assert_allclose(seen.slackest[body.name], expected, atol=1e-9 * np.abs(found).max())
