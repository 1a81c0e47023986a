"""Turned bodies: joints whose axes turn along, and benches that give the same figures however they lie in the world."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from conftest import lattice, turn

from nassim import (
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.simulation.model.assembly import assemble
from nassim.simulation.run.simulate import exudyn_eigenfrequencies

OBLIQUE = turn([1.0, -2.0, 0.5], 1.1)
PIN_ON_SLIDER = np.array([-0.004, 0.007, 0.0])
SLIDER_MASS, SLIDER_INERTIA = 0.2, np.diag([2e-5, 3e-5, 4e-5])


@pytest.fixture(scope="module")
def stiff_model():
    return lattice(stiffness=1e9)


@pytest.fixture(scope="module")
def stiff(stiff_model):
    return craig_bampton(stiff_model, n_modes=2, progress=False)


def pin_in_slot(stiff, owner, fidelity):
    """An arm hinged about z, and a slider with a pin in a slot along x, of the arm or of the slider."""
    pin = OBLIQUE @ (stiff.point("right").position - stiff.point("left").position)
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True)
    arm = FlexibleBody("arm", stiff, -OBLIQUE @ stiff.point("left").position, OBLIQUE, fidelity=fidelity)
    points = {"pin": PIN_ON_SLIDER, "c": np.zeros(3)}
    slider = RigidBody("slider", points, SLIDER_MASS, SLIDER_INERTIA, pin - PIN_ON_SLIDER)
    ends = ("arm.right", "slider.pin") if owner == "arm" else ("slider.pin", "arm.right")
    return Scene(
        "slot",
        (base, arm, slider),
        (Joint("hinge", "base.o", "arm.left", free="rz"), Joint("slot", *ends, free=("x", "rz"))),
        (PointForce("push", "slider.c", "y", "force"),),
        tuple(Encoder(axis, "base.o", "slider.c", axis) for axis in "xy"),
    )


def planar(angle, vector):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ vector[:2]


def slot_by_hand(arm_inertia, pin, owner, force, times):
    """The slider's centre by Newton's laws with one constraint force; q = arm's angle, centre, slider's angle."""
    mass = np.diag([arm_inertia, SLIDER_MASS, SLIDER_MASS, SLIDER_INERTIA[2, 2]])

    def gap(q):
        across = planar(q[0] if owner == "arm" else q[3], np.array([0.0, 1.0]))
        return across @ (q[1:3] + planar(q[3], PIN_ON_SLIDER) - planar(q[0], pin))

    def rate(t, state):
        q, velocity = state[:4], state[4:]
        row = np.array([(gap(q + 1e-6 * e) - gap(q - 1e-6 * e)) / 2e-6 for e in np.eye(4)])
        s = 1e-4
        bend = (gap(q + s * velocity) - 2 * gap(q) + gap(q - s * velocity)) / s**2
        system = np.block([[mass, row[:, None]], [row[None], np.zeros((1, 1))]])
        answer = np.linalg.solve(system, [0.0, 0.0, force(t), 0.0, -bend])
        return np.concatenate([velocity, answer[:4]])

    start = np.array([0.0, *(pin - PIN_ON_SLIDER)[:2], 0.0])
    solution = scipy.integrate.solve_ivp(
        rate, (0.0, times[-1]), np.concatenate([start, np.zeros(4)]), t_eval=times, rtol=1e-9, atol=1e-11
    )
    return solution.y[:4] - start[:, None]


@pytest.mark.parametrize(("owner", "fidelity"), [("arm", "ffrf"), ("slider", "rigid")])
def test_free_directions_turn_with_the_body_of_a(stiff, stiff_model, owner, fidelity):
    """A slot turns with whatever it is cut into, by some 40 degrees here; the arm's inertia summed over its masses."""
    masses = stiff_model.scalar_mass_matrix.diagonal()
    places = OBLIQUE @ (stiff_model.fields[1:] - stiff.point("left").position[:, None])
    inertia = masses @ (places[0] ** 2 + places[1] ** 2)
    pin = OBLIQUE @ (stiff.point("right").position - stiff.point("left").position)
    times = np.arange(201) * 1e-3

    def force(t):
        return 0.6 * np.sin(np.pi * t / 0.2) ** 2

    other = slot_by_hand(inertia, pin, "slider" if owner == "arm" else "arm", force, times)
    expected = slot_by_hand(inertia, pin, owner, force, times)
    push = TimeHistory(times, force(times)[None], ("force",), ("N",))
    record = simulate(pin_in_slot(stiff, owner, fidelity), push, time_step=1e-3, progress=False)
    size = np.abs(expected[1:3]).max()
    assert np.abs(expected[0]).max() > 0.5
    assert np.abs(other[1:3] - expected[1:3]).max() > 0.03 * size  # the order of the points matters
    for row, axis in zip(expected[1:3], "xy", strict=True):
        np.testing.assert_allclose(record[axis], row, atol=2e-3 * size)


CORNERS = np.array([[0.05, 0.01, -0.02], [-0.04, 0.06, 0.01], [-0.01, -0.05, 0.03]])
APART = np.array([0.01, -0.02, 0.015])
SPRING, DAMPER = 2e4, 5.0
GRAVITY = 1e-2 * np.array([1.0, -2.0, -9.0])
"""Little, so that motion is small for every fidelity."""
FRAME_INERTIA = np.array([[3e-4, 4e-5, -2e-5], [4e-5, 4e-4, 5e-5], [-2e-5, 5e-5, 5e-4]])
PAYLOAD_INERTIA = np.array([[5e-5, -6e-6, 2e-6], [-6e-6, 3e-5, 4e-6], [2e-6, 4e-6, 6e-5]])
FRAME_MASS, PAYLOAD_MASS = 0.3, 0.15
SEAT, TIP = np.array([0.02, 0.01, 0.005]), np.array([0.01, -0.02, 0.03])
TILT = turn([0.3, 1.0, 0.7], 0.8)
"""Of the lower body; the upper one lies as OBLIQUE says."""
FOOT = np.array([0.004, -0.003, 0.006])
"""The payload's mount, from its centre of mass."""
FIDELITIES = (
    ("linear", "linear"),
    ("ffrf", "ffrf"),
    ("linear", "ffrf"),
    ("rigid", "ffrf"),
)


@pytest.fixture(scope="module")
def soft_model():
    return lattice(stiffness=1e5)


@pytest.fixture(scope="module")
def soft(soft_model):
    return craig_bampton(soft_model, n_modes=3, progress=False)


def places(body):
    """Where the scene that is not turned puts the lower body, the upper one and the payload."""
    left, right = body.point("left").position, body.point("right").position
    lower = SEAT - TILT @ left
    upper = lower + TILT @ right - OBLIQUE @ left
    return lower, upper, upper + OBLIQUE @ right - FOOT


def suspended(body, fidelities, q):
    """A frame on springs whose ends are apart, two flexible bodies and a payload on it, all turned by q together."""
    lower, upper, payload = (q @ place for place in places(body))
    ends = {f"c{k}": q @ corner for k, corner in enumerate(CORNERS)}
    tied = {name: end + q @ APART for name, end in ends.items()}
    frame = RigidBody("frame", ends | {"seat": q @ SEAT}, FRAME_MASS, q @ FRAME_INERTIA @ q.T)
    bodies = (
        RigidBody("base", tied | {"o": np.zeros(3)}, fixed=True),
        frame,
        FlexibleBody("lower", body, lower, q @ TILT, fidelity=fidelities[0]),
        FlexibleBody("upper", body, upper, q @ OBLIQUE, fidelity=fidelities[1]),
        RigidBody("payload", {"foot": q @ FOOT, "tip": q @ TIP}, PAYLOAD_MASS, q @ PAYLOAD_INERTIA @ q.T, payload),
    )
    joints = (
        Joint("a", "frame.seat", "lower.left"),
        Joint("b", "lower.right", "upper.left"),
        Joint("c", "upper.right", "payload.foot"),
    )
    actuators = (
        StackActuator("stacks", "lower.left", "lower.right", 3.0, "voltage", gain=2.0),
        *(PointForce(f"f{axis}", "payload.tip", axis, f"f{axis}") for axis in "xyz"),
        *(GroundAcceleration(f"a{axis}", axis, f"a{axis}") for axis in "xyz"),
    )
    sensors = (StackSensor("sensor", "upper.left", "upper.right", 1e4),)
    sensors += tuple(Encoder(axis, "base.o", "payload.tip", axis) for axis in "xyz")
    springs = tuple(
        SpringDamper(f"{name}{axis}", f"base.{name}", f"frame.{name}", axis, SPRING, DAMPER)
        for name in ends
        for axis in "xyz"
    )
    return Scene("turned", bodies, joints, actuators, sensors, springs, damping_ratio=0.0, gravity=q @ GRAVITY)


def inputs_turned(q):
    """Inputs of the turned scene per unit of those of the other, (7, 7): voltage, force, acceleration of the ground."""
    return scipy.linalg.block_diag(np.eye(1), q, q)


def outputs_turned(q):
    """Outputs likewise, (4, 4): voltage, three encoders."""
    return scipy.linalg.block_diag(np.eye(1), q)


LOAD = 1e-2 * np.array([3.0, 1.0, -2.0, 1.5, 0.4, -0.7, 1.1])
UNSEEN = 1e-10 * np.array([1e4, 1.0, 1.0, 1.0])
"""Motions of 0.1 nm count as none: what stacks in rigid bodies read [V], [m]."""
OBLIQUELY = turn([0.2, -0.5, 1.0], 2.0)


@pytest.mark.parametrize("fidelities", FIDELITIES, ids="-".join)
def test_a_scene_turned_as_a_whole_gives_the_same_figures(soft, fidelities):
    """Gravity, statics, eigenfrequencies, frequency responses and simulation, by Exudyn and by the linear model."""
    scene, turned = suspended(soft, fidelities, np.eye(3)), suspended(soft, fidelities, OBLIQUELY)
    to_inputs, to_outputs = inputs_turned(OBLIQUELY), outputs_turned(OBLIQUELY)
    np.testing.assert_allclose(assemble(turned).modal.frequency, assemble(scene).modal.frequency, rtol=1e-7)

    def statics(of, values):
        return np.array(list(static_response(of, dict(zip(of.inputs, values, strict=True))).values()))

    expected = to_outputs @ statics(scene, LOAD)
    np.testing.assert_allclose(statics(turned, to_inputs @ LOAD), expected, atol=1e-4 * np.abs(expected).max())

    frequency = np.geomspace(1.0, 2e3, 20)
    answers = [frequency_response(linearize(s), frequency).values for s in (scene, turned)]
    expected = np.einsum("ab,bif,ji->ajf", to_outputs, answers[0], to_inputs)
    scale = np.abs(expected).max(axis=(1, 2), keepdims=True) + UNSEEN[:, None, None]
    np.testing.assert_allclose(answers[1] / scale, expected / scale, atol=1e-7)

    time = np.arange(21) * 1e-3
    push = LOAD[:, None] * np.sin(np.pi * time / 0.02) ** 2
    records = []
    for of, values in ((scene, push), (turned, to_inputs @ push)):
        units = tuple(of.input_unit(name) for name in of.inputs)
        history = TimeHistory(time, values, of.inputs, units)
        records.append(simulate(of, history, time_step=1e-3, outputs=of.outputs, progress=False).values[-4:])
    expected = to_outputs @ records[0]
    scale = np.abs(expected).max(axis=1, keepdims=True) + UNSEEN[:, None]
    np.testing.assert_allclose(records[1] / scale, expected / scale, atol=1e-3)


@pytest.mark.parametrize("fidelities", [("ffrf", "ffrf"), ("linear", "ffrf")], ids="-".join)
def test_fidelities_agree_on_turned_bodies(soft, fidelities):
    """Statics under weight, force, ground acceleration and voltage against small motion throughout."""
    found, expected = (
        np.array(list(static_response(scene, dict(zip(scene.inputs, LOAD, strict=True))).values()))
        for scene in (suspended(soft, kinds, OBLIQUE) for kinds in (fidelities, ("linear", "linear")))
    )
    np.testing.assert_allclose(found[0], expected[0], rtol=2e-3)
    np.testing.assert_allclose(found[1:], expected[1:], atol=2e-3 * np.abs(expected[1:]).max())


def lumped(model, body):
    """Masses and positions of everything but frame and payload, in the scene that is not turned."""
    masses = model.scalar_mass_matrix.diagonal()
    lower, upper, _ = places(body)
    spots = [lower[:, None] + TILT @ model.fields[1:], upper[:, None] + OBLIQUE @ model.fields[1:]]
    return np.tile(masses, 2), np.hstack(spots).T


def cross(vector):
    return np.array([np.cross(vector, e) for e in np.eye(3)]).T


def by_hand(model, body):
    """Mass (6, 6), stiffness (6, 6) and place of the payload of all as one rigid body, about the world's origin."""
    masses, spots = lumped(model, body)
    payload = places(body)[2]
    mass, stiffness = np.zeros((6, 6)), np.zeros((6, 6))
    mass[3:, 3:] = FRAME_INERTIA + PAYLOAD_INERTIA
    for m, spot in [*zip(masses, spots, strict=True), (FRAME_MASS, np.zeros(3)), (PAYLOAD_MASS, payload)]:
        motion = np.hstack([np.eye(3), -cross(spot)])
        mass += m * motion.T @ motion
    for corner in CORNERS:
        motion = np.hstack([np.eye(3), -cross(corner)])
        stiffness += SPRING * motion.T @ motion
    return mass, stiffness, payload


def test_rigid_fidelity_of_turned_bodies_against_their_masses(soft, soft_model):
    """Six eigenfrequencies by the assembly and by Exudyn, and statics, against sums over all point masses."""
    mass, stiffness, payload = by_hand(soft_model, soft)
    scene = suspended(soft, ("rigid", "rigid"), np.eye(3))
    expected = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(assemble(scene).modal.frequency, expected, rtol=1e-9)
    np.testing.assert_allclose(exudyn_eigenfrequencies(replace(scene, gravity=np.zeros(3)))[:6], expected, rtol=1e-5)
    tip = np.hstack([np.eye(3), -cross(payload + TIP)])
    pull = mass[:, :3] @ (GRAVITY - LOAD[4:]) + tip.T @ LOAD[1:4]
    found = static_response(scene, dict(zip(scene.inputs, LOAD, strict=True)))
    expected = tip @ np.linalg.solve(stiffness, pull)
    np.testing.assert_allclose([found[a] for a in "xyz"], expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("fidelities", FIDELITIES[:3], ids="-".join)
def test_weight_of_turned_flexible_bodies(soft, soft_model, fidelities):
    """However soft the bodies are, the springs carry the weight where the masses are."""
    mass, stiffness, _ = by_hand(soft_model, soft)
    names = [f"c{k}" for k in range(len(CORNERS))]
    corners = tuple(Encoder(f"{name}{axis}", "base.o", f"frame.{name}", axis) for name in names for axis in "xyz")
    found = static_response(replace(suspended(soft, fidelities, np.eye(3)), sensors=corners))
    motions = np.vstack([np.hstack([np.eye(3), -cross(corner)]) for corner in CORNERS])
    expected = motions @ np.linalg.solve(stiffness, mass[:, :3] @ GRAVITY)
    np.testing.assert_allclose(list(found.values()), expected, atol=2e-3 * np.abs(expected).max())
