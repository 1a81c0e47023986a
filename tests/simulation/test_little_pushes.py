"""Bodies with floating frames between stiff springs, pushed so little that rounding is as large as the forces are."""

import numpy as np
import pytest
from conftest import lattice

from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    PointForce,
    RigidBody,
    Scene,
    TimeHistory,
    condense,
    craig_bampton,
    fixed,
    placed,
    simulate,
)

TIME = np.arange(11) * 1e-4
UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]).T
"""The struts' x axis is the world's z."""
TURNED = np.array([[6.0, 2.0, 3.0], [-3.0, 6.0, 2.0], [-2.0, -3.0, 6.0]]).T / 7
JOINT = np.array([1e7, 1.2e7, 9e7, 100.0, 120.0, 200.0])
STIFF_TURNS = np.array([1e7, 1.2e7, 9e7, 1e8, 1.2e8, 2e8])


@pytest.fixture(scope="module")
def strut():
    return craig_bampton(condense(lattice(stiffness=1e4), progress=False), n_modes=4, progress=False)


def ring(strut, count, stiffness):
    """Upright struts in a ring on a base, with bushings under a plate, which carry the frames: so these float."""
    angles = 2 * np.pi * np.arange(count) / count + 0.1
    feet = {f"at_{k}": (0.1 * np.cos(t), 0.08 * np.sin(t), 0.0) for k, t in enumerate(angles)}
    low, high = (strut.point(name).position for name in ("left", "right"))
    struts = [
        FlexibleBody(f"strut_{k}", strut, foot - UPRIGHT @ low, rotation=UPRIGHT, frame="right")
        for k, foot in enumerate(feet.values())
    ]
    points = {**feet, "held": (0.01, 0.02, 0.0)}
    plate = RigidBody("plate", points, 0.5, np.diag([1e-3, 1.2e-3, 2e-3]), UPRIGHT @ (high - low))
    base = RigidBody("base", feet, fixed=True)
    return Scene(
        "ring",
        (base, plate, *struts),
        [fixed(f"foot_{k}", f"base.at_{k}", f"strut_{k}.left") for k in range(count)],
        (PointForce("push", "plate.held", (2, -1, 3), "force"),),
        [Encoder(axis, "base.at_0", "plate.held", axis) for axis in "xyz"],
        [Bushing(f"head_{k}", f"strut_{k}.right", f"plate.at_{k}", stiffness) for k in range(count)],
        damping_ratio=0.0,
    )


@pytest.mark.parametrize(
    ("count", "stiffness", "place", "turn"),
    [(12, JOINT, (0, 0, 0), TURNED), (6, JOINT, (1.0, -2.0, 3.0), np.eye(3)), (3, STIFF_TURNS, (0, 0, 0), TURNED)],
    ids=["many", "far", "turns"],
)
def test_answers_grow_with_the_push(strut, count, stiffness, place, turn):
    """A step of force, of 0.1 uN and of 1 N: Newton's iteration ends where rounding in all springs together lets it."""
    scene = placed(ring(strut, count, stiffness), "r", position=place, rotation=turn)

    def answer(push):
        force = TimeHistory(TIME, np.full((1, len(TIME)), push), scene.inputs, ("N",))
        record = simulate(scene, force, time_step=1e-4, progress=False)
        return np.array([record[name] for name in scene.outputs])

    little, much = answer(1e-7), answer(1.0)
    rounded = np.finfo(float).eps * (0.1 + np.abs(place).max())
    np.testing.assert_allclose(little, 1e-7 * much, rtol=1e-5, atol=4 * rounded)
