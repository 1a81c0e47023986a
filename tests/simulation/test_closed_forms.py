"""Scenes of a few masses, whose motion can be written down: what forces, springs, encoders and damping ratios mean."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.spatial

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    LinearModel,
    PointForce,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.inertia import RigidInertia
from nassim.scene.joints import cylindrical, fixed, planar, prismatic, revolute, spherical, universal
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.motion_size import motion_sizes
from nassim.simulation.run.simulate import exudyn_eigenfrequencies
from nassim.systems.linear_model import damping
from nassim.systems.state_space import discretize

LENGTH, STIFFNESS, LEFT, RIGHT, LOAD = 0.2, 5e4, 0.7, 0.4, 1.3
GROUND = RigidBody("ground", {"left": np.zeros(3), "right": np.array([LENGTH, 0, 0])}, fixed=True)


def dumbbell(origin=(0.0, 0.0, 0.0)):
    """Six point masses around either end of a spring without mass, which resists every relative motion of the ends.

    origin: of the body's frame, as seen from the left end
    """
    ends = np.array([[0.0, 0, 0], [LENGTH, 0, 0]]) - np.asarray(origin)
    offsets = 0.02 * np.vstack([np.eye(3), -np.eye(3)])
    gram = np.zeros((40, 40))
    for end, mass in enumerate((LEFT, RIGHT)):
        for offset in offsets:
            motions = np.zeros((12, 3))
            motions[6 * end : 6 * end + 6] = rigid_transfer(offset)[:3].T
            fields = np.concatenate([[1.0], ends[end] + offset, motions.ravel()])
            gram += mass / 6 * np.outer(fields, fields)
    relative = np.hstack([-rigid_transfer(ends[1] - ends[0]), np.eye(6)])
    stiffness = relative.T @ np.diag([STIFFNESS, 2e5, 3e5, 900.0, 1100.0, 1300.0]) @ relative
    mass_matrix = np.einsum("jckc->jk", gram[4:, 4:].reshape(12, 3, 12, 3))
    points = tuple(RemotePoint(name, name, end) for name, end in zip(("left", "right"), ends, strict=True))
    return ReducedBody("dumbbell", remote_points=points, mass_matrix=mass_matrix, stiffness_matrix=stiffness, gram=gram)


def pushed(*joints, **options):
    """A load of some mass on the dumbbell's right end, which a force pushes along x; its position is read."""
    load = RigidBody("load", {"foot": np.zeros(3)}, LOAD, 1e-3 * np.eye(3), position=np.array([LENGTH, 0, 0]))
    return Scene(
        "pushed",
        (GROUND, FlexibleBody("dumbbell", dumbbell(), fidelity="linear"), load),
        (*joints, Joint("mount", "dumbbell.right", "load.foot")),
        (PointForce("push", "load.foot", "x", "force"),),
        (Encoder("position", "ground.right", "load.foot", axis="x"),),
        **options,
    )


def record(time, force):
    return TimeHistory(time, force, ("force",), ("N",))


@pytest.mark.parametrize("hold_order", [0, 1])
def test_a_force_that_is_there_from_the_start(hold_order):
    """F/k (1 - cos w t), however far into the force's record the run begins."""
    scene = pushed(Joint("clamp", "ground.left", "dumbbell.left"), damping_ratio=0.0)
    omega = np.sqrt(STIFFNESS / (LOAD + RIGHT))
    time = np.arange(400) * 0.1 / omega
    options = {"time_step": time[1], "method": "exact", "hold_order": hold_order, "progress": False}
    found = simulate(scene, record(time, np.full(400, 7.0)), **options)["position"]
    assert np.allclose(found, 7.0 / STIFFNESS * (1 - np.cos(omega * time)), atol=1e-9 * 7.0 / STIFFNESS)


def test_a_ramp_on_a_free_body():
    """Rigid motion under a rising force, and the oscillation of the two ends against each other."""
    scene = pushed(damping_ratio=0.0)
    right = RIGHT + LOAD
    omega = np.sqrt(STIFFNESS * (1 / LEFT + 1 / right))
    time = np.arange(300) * 0.05 / omega
    base, slope = 3.0, 900.0
    rising = record(time, base + slope * time)
    found = simulate(scene, rising, time_step=time[1], method="exact", progress=False)["position"]
    whole = (base * time**2 / 2 + slope * time**3 / 6) / (LEFT + right)
    stretch = (base * (1 - np.cos(omega * time)) + slope * (time - np.sin(omega * time) / omega)) / (omega**2 * right)
    expected = whole + LEFT / (LEFT + right) * stretch
    assert np.allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_exact_steps_of_an_oscillator_driven_in_both_states():
    """Inputs into the displacement and into the velocity, held and straight, at a frequency that asks for balancing."""
    w, h = 3e4, 4e-5
    c, s = np.cos(w * h), np.sin(w * h)
    step, held, risen = discretize(np.array([[0.0, 1.0], [-(w**2), 0.0]]), np.diag([2.0, 5.0]), h)
    assert np.allclose(step, [[c, s / w], [-w * s, c]], rtol=1e-10)
    expected = np.array([[s / w, (1 - c) / w**2], [c - 1, s / w]]) @ np.diag([2.0, 5.0])
    assert np.allclose(held, expected, rtol=1e-10, atol=0)
    rise = 1 - s / (w * h)
    expected = np.array([[(1 - c) / (w**2 * h), rise / w**2], [-rise, (1 - c) / (w**2 * h)]]) @ np.diag([2.0, 5.0])
    assert np.allclose(risen, expected, rtol=1e-9, atol=0)


def test_free_motions_strain_nothing():
    """A free body's six motions at 0 Hz cause no force, whichever axis they turn about."""
    body = dumbbell()
    scene = Scene("free", (FlexibleBody("dumbbell", body, fidelity="linear"),))
    assembly = assemble(scene)
    assert np.array_equal(assembly.modal.frequency == 0, np.arange(12) < 6)
    motions = assembly.modal.modes[:, :6]
    forces = np.abs(body.stiffness_matrix @ motions)
    assert np.all(forces <= 1e-9 * np.abs(body.stiffness_matrix) @ np.abs(motions))


def test_damping_ratios_belong_to_modes_in_order():
    given = [0.02, 0.05, 0.03]
    scene = pushed(Joint("clamp", "ground.left", "dumbbell.left"), damping_ratio=given)
    frequency, ratio = damping(linearize(scene))
    assert len(frequency) == 6
    assert np.allclose(frequency, assemble(scene).modal.frequency, rtol=1e-9)
    assert np.allclose(ratio, [0.02, 0.05, 0.03, 0.03, 0.03, 0.03], rtol=1e-9)


def test_damping_that_grows_is_negative():
    """x'' - 2 z w x' + w^2 x = 0, a drift x' = a x and one that dies away."""
    w, z = 2 * np.pi * 12.0, 0.03
    state = np.zeros((4, 4))
    state[:2, :2] = [[0, 1], [-(w**2), 2 * z * w]]
    state[2, 2], state[3, 3] = 5.0, -800.0
    model = LinearModel(state, np.zeros((4, 0)), np.zeros((0, 4)), np.zeros((0, 0)), (), ())
    frequency, ratio = damping(model)
    assert np.allclose(frequency, [5 / (2 * np.pi), 12.0, 800 / (2 * np.pi)], rtol=1e-9)
    assert np.allclose(ratio, [-1.0, -z, 1.0], rtol=1e-9)


def test_the_box_of_a_bodys_inertia_is_the_box_itself():
    """A homogeneous box of 0.3 x 0.1 x 0.2 m, turned, its centre away from the origin."""
    sides, mass, centre = np.array([0.3, 0.1, 0.2]), 7.0, np.array([0.4, -0.2, 0.1])
    turn = scipy.spatial.transform.Rotation.from_euler("zyx", [30, 40, 50], degrees=True).as_matrix()
    inertia = turn @ np.diag(mass / 12 * (np.sum(sides**2) - sides**2)) @ turn.T
    about_origin = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    rigid = RigidInertia(mass, centre, about_origin, 0.0)
    assert np.allclose(rigid.central_inertia, inertia, atol=1e-12)
    assert np.allclose(rigid.box, np.sort(sides**2), rtol=1e-9)
    assert rigid.box_density == pytest.approx(mass / np.prod(sides), rel=1e-9)


def test_size_of_a_motion_does_not_depend_on_the_bodys_origin():
    """What counts as large is measured by the body, not by how far from it its frame lies."""
    found = []
    for origin in ((0, 0, 0), (0.4, -0.9, 2.0)):
        body = FlexibleBody("dumbbell", dumbbell(origin), position=origin, fidelity="linear")
        scene = Scene("free", (GROUND, body), (Joint("clamp", "ground.left", "dumbbell.left"),))
        coordinates = np.zeros((12, 1))
        coordinates[[6, 11]] = [[2e-3], [4e-3]]
        found.append(motion_sizes(assemble(scene).coordinates, coordinates)["dumbbell"])
    assert np.allclose(found[0], found[1], rtol=1e-9)
    assert found[0][0] == pytest.approx(4e-3)
    # Radius of gyration of two masses at a distance, and of the points around them.
    spread = LEFT * RIGHT / (LEFT + RIGHT) ** 2 * LENGTH**2 + 0.02**2
    assert found[0][1] == pytest.approx(2e-3 / np.sqrt(spread))


def test_a_lever_turns_about_its_hinge():
    """A force, a spring and an encoder beside the centre of mass: their arms make the moments and the reading."""
    arms = {"hinge": np.zeros(3), "push": [0.03, 0, 0.01], "held": [-0.05, 0, 0.02], "read": [0.08, 0, -0.01]}
    base = RigidBody("base", {name: np.asarray(arm, dtype=float) for name, arm in arms.items()}, fixed=True)
    lever = RigidBody("lever", arms, 2.0, np.diag([0.01, 0.02, 0.03]))
    scene = Scene(
        "lever",
        (base, lever),
        (Joint("hinge", "base.hinge", "lever.hinge", free=("ry",)),),
        (PointForce("push", "lever.push", "z", "force"),),
        (Encoder("reading", "base.read", "lever.read", axis="z"),),
        (SpringDamper("spring", "base.held", "lever.held", axis="z", stiffness=4e4),),
        damping_ratio=0.0,
    )
    # A rotation b about y lifts a point at x by -b x: b = -0.03 F / (k 0.05^2).
    expected = 0.03 * 0.08 / (4e4 * 0.05**2)
    assert static_response(scene, {"force": 1e-3})["reading"] == pytest.approx(1e-3 * expected, rel=1e-5)
    slow = frequency_response(linearize(scene), np.array([1e-3])).response("reading", "force")[0]
    assert slow == pytest.approx(expected, rel=1e-9)
    frequency = np.sqrt(4e4 * 0.05**2 / 0.02) / (2 * np.pi)
    assert assemble(scene).modal.frequency == pytest.approx([frequency], rel=1e-9)
    assert exudyn_eigenfrequencies(scene) == pytest.approx([frequency], rel=1e-6)


def test_a_spring_between_two_masses_that_move():
    """In phase it does nothing, in opposite phase it counts twice."""
    place = {"ends": np.zeros(3)}
    masses = [RigidBody(name, place, 2.0, 0.01 * np.eye(3)) for name in ("a", "b")]
    scene = Scene(
        "two",
        (RigidBody("base", place, fixed=True), *masses),
        tuple(Joint(f"guide {m.name}", "base.ends", f"{m.name}.ends", free=("x",)) for m in masses),
        (PointForce("push", "a.ends", "x", "force"),),
        (Encoder("other", "base.ends", "b.ends", axis="x"), Encoder("between", "a.ends", "b.ends", axis="x")),
        (
            SpringDamper("left", "base.ends", "a.ends", axis="x", stiffness=3e4),
            SpringDamper("middle", "a.ends", "b.ends", axis="x", stiffness=1e4),
            SpringDamper("right", "b.ends", "base.ends", axis="x", stiffness=3e4),
        ),
        damping_ratio=0.0,
    )
    expected = np.sqrt(np.array([3e4, 5e4]) / 2.0) / (2 * np.pi)
    assert np.allclose(assemble(scene).modal.frequency, expected, rtol=1e-9)
    assert np.allclose(exudyn_eigenfrequencies(scene), expected, rtol=1e-6)
    # Force 1 N on a: x_b = k_c / (k (k + 2 k_c)), x_b - x_a = -1 / (k + 2 k_c).
    answer = [1e4 / (3e4 * 5e4), -1 / 5e4]
    found = static_response(scene, {"force": 1.0})
    assert [found["other"], found["between"]] == pytest.approx(answer, rel=1e-6)
    slow = frequency_response(linearize(scene), np.array([1e-3])).values[:, 0, 0]
    assert np.allclose(slow, answer, rtol=1e-6, atol=0)


ALONG = np.array([2.0, -1.0, 2.0]) / 3
ACROSS = np.array([[1.0, 2.0, 0.0], [-4.0, 2.0, 5.0]]) / np.sqrt([[5.0], [45.0]])
STILL = np.zeros(3)


@pytest.mark.parametrize(
    ("joint", "shifts", "turns"),
    [
        (fixed("j", "base.o", "body.o"), [], []),
        (revolute("j", "base.o", "body.o", ALONG), [], [ALONG]),
        (prismatic("j", "base.o", "body.o", ALONG), [ALONG], []),
        (cylindrical("j", "base.o", "body.o", ALONG), [ALONG], [ALONG]),
        (universal("j", "base.o", "body.o", *ACROSS), [], [*ACROSS]),
        (spherical("j", "base.o", "body.o"), [], [*np.eye(3)]),
        (planar("j", "base.o", "body.o", ALONG), [*ACROSS], [ALONG]),
    ],
    ids=["fixed", "revolute", "prismatic", "cylindrical", "universal", "spherical", "planar"],
)
def test_what_joints_leave_free(joint, shifts, turns):
    """Motions of a rigid body whose centre of mass is in its joint to the ground."""
    base = RigidBody("base", {"o": np.array([0.1, 0.2, 0.3])}, fixed=True)
    body = RigidBody("body", {"o": STILL}, 2.0, np.diag([1e-2, 2e-2, 2.5e-2]), [0.1, 0.2, 0.3])
    basis = assemble(Scene("joint", (base, body), (joint,))).modal.basis
    expected = [np.concatenate([shift, STILL]) for shift in shifts] + [np.concatenate([STILL, turn]) for turn in turns]
    assert basis.shape == (6, len(expected))
    for motion in expected:
        np.testing.assert_allclose(basis @ np.linalg.pinv(basis) @ motion, motion, atol=1e-12)


def test_rigid_bodies_alone_by_exact_steps():
    """A block on a spring under a force that jumps; what spins without a drive is refused."""
    block = RigidBody("block", {"o": np.zeros(3)}, LOAD, np.eye(3))
    parts = {
        "joints": (prismatic("guide", "ground.left", "block.o", "x"),),
        "actuators": (PointForce("push", "block.o", "x", "push"),),
        "sensors": (Encoder("moved", "ground.left", "block.o", "x"),),
        "springs": (SpringDamper("spring", "ground.left", "block.o", "x", STIFFNESS),),
        "damping_ratio": 0.0,
    }
    scene = Scene("block", (GROUND, block), **parts)
    time = np.linspace(0.0, 0.2, 41)
    push = TimeHistory(time, np.full(41, 3.0), ("push",), ("N",))
    found = simulate(scene, push, time_step=5e-3, method="exact", hold_order=0, progress=False)["moved"]
    expected = 3.0 / STIFFNESS * (1 - np.cos(np.sqrt(STIFFNESS / LOAD) * time))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * expected.max())
    spinning = Scene("spinning", (GROUND, replace(block, angular_velocity=(1.0, 0, 0))), **parts)
    with pytest.raises(ValueError, match="small motion: in scene 'spinning', body 'block' spins without"):
        simulate(spinning, push, time_step=5e-3, method="exact", progress=False)
