"""Turned bodies: joints whose axes turn along, and benches that give the same figures however they lie in the world."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
from conftest import lattice

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    TimeHistory,
    craig_bampton,
    simulate,
)
from nassim.interface import unit_vector


def turn(axis, angle):
    """Rotation about an axis, by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


OBLIQUE = turn([1.0, -2.0, 0.5], 1.1)
QUARTERS = {
    "about x": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "about y": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
    "about z": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}
QUARTERS["about x, then z"] = QUARTERS["about z"] @ QUARTERS["about x"]

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
    """The slider's centre from Newton's equations with one constraint force; q = arm's angle, centre, slider's angle."""
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


@pytest.mark.parametrize("fidelity", ["rigid", "ffrf"])
@pytest.mark.parametrize("owner", ["arm", "slider"])
def test_free_directions_turn_with_the_body_of_a(stiff, stiff_model, owner, fidelity):
    """A slot turns with whatever it is cut into, by some 40 degrees here; the arm's inertia summed over its masses."""
    masses = stiff_model.scalar_mass_matrix.diagonal()
    places = OBLIQUE @ (stiff_model.fields[1:] - stiff.point("left").position[:, None])
    inertia = masses @ (places[0] ** 2 + places[1] ** 2)
    pin = OBLIQUE @ (stiff.point("right").position - stiff.point("left").position)
    times = np.arange(401) * 5e-4

    def force(t):
        return 0.6 * np.sin(np.pi * t / 0.2) ** 2

    other = slot_by_hand(inertia, pin, "slider" if owner == "arm" else "arm", force, times)
    expected = slot_by_hand(inertia, pin, owner, force, times)
    push = TimeHistory(times, force(times)[None], ("force",), ("N",))
    record = simulate(pin_in_slot(stiff, owner, fidelity), push, time_step=5e-4, progress=False)
    size = np.abs(expected[1:3]).max()
    assert np.abs(expected[0]).max() > 0.5
    assert np.abs(other[1:3] - expected[1:3]).max() > 0.03 * size  # the order of the points matters
    for row, axis in zip(expected[1:3], "xy", strict=True):
        np.testing.assert_allclose(record[axis], row, atol=2e-3 * size)
