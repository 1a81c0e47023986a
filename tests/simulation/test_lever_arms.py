"""Springs and coils whose points lie apart across their axis: what their forces leave on two bodies is told."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

from nassim import PointTorque, RigidBody, Scene, SpringDamper, VoiceCoil, describe, linearize, placed, prismatic
from nassim.scene import Displacement, ForceElement, Path, PointMeasure, Spring
from nassim.simulation.model.assembly import assemble

ARM = 0.03
GROUND = RigidBody("ground", {"o": (0, 0, 0)}, fixed=True)
LEFT = RigidBody("left", {"p": (0, 0.02, 0), "rail": (0, 0, 0)}, 1.0, 1e-3 * np.eye(3))
RIGHT = RigidBody("right", {"p": (0.01, 0.02 + ARM, 0), "rail": (-0.1, 0, 0)}, 2.0, 2e-3 * np.eye(3), (0.1, 0, 0))
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


@dataclass(frozen=True)
class Rocker(ForceElement):
    """A spring of two points on a rocker, which pulls b twice as strongly as a, and the rocker's axle with both."""

    a: Path
    b: Path

    def terms(self, scene):
        return (Spring(Displacement(((self.a, (1.0, 0.0, 0.0)), (self.b, (2.0, 0.0, 0.0)))), 1e5),)


@dataclass(frozen=True)
class Shift(PointMeasure):
    """The displacement of b against a along x and y."""

    a: Path
    b: Path
    components = ("x", "y")

    @property
    def points(self):
        return (self.a, self.b)

    def at(self, poses, reference):
        apart = (poses[1][0] - poses[0][0]) - (reference[1] - reference[0])
        rows = np.hstack([-np.eye(2, 3), np.zeros((2, 3)), np.eye(2, 3), np.zeros((2, 3))])
        return apart[:2], rows


@dataclass(frozen=True)
class Pad(ForceElement):
    """A spring in a plane."""

    a: Path
    b: Path

    def terms(self, scene):
        return (Spring(Shift(self.a, self.b), 1e5),)


def scene(*, a="left.p", joints=(), **changes):
    spring = SpringDamper("spring", a, "right.p", "x", 1e5, **changes)
    coil = VoiceCoil("coil", a, "right.p", "x", 20.0, 4.0, 1e-3, "voltage", **changes)
    whole = Scene("pair", (GROUND, LEFT, RIGHT), joints, (coil,), springs=(spring,), damping_ratio=0.0)
    return placed(whole, "odd", rotation=TURN)


def told(given):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        linearize(given)
    return [str(warning.message) for warning in caught if "as no real part does" in str(warning.message)]


def test_the_moment_on_both_bodies_is_described_and_warned_of():
    """A spring along an axis that does not rotate resists a common rotation by stiffness times arm squared."""
    apart = scene()
    assert describe(apart).replace("\n        ", " ").count("forces 30 mm apart across it: 0.03 N m per N on both") == 2
    spring, coil = told(apart)
    assert "SpringDamper 'odd/spring' of scene 'odd' acts at two points that lie 30 mm apart across" in spring
    assert "VoiceCoil 'odd/coil'" in coil
    assembly = assemble(apart)
    turn = np.concatenate([np.r_[np.cross(TURN[:, 2], body.position), TURN[:, 2]] for body in apart.bodies[1:]])
    stiffness = sum(tangent.rows.T @ tangent.stiffness @ tangent.rows for tangent in assembly.tangents)
    assert turn @ stiffness @ turn == pytest.approx(1e5 * ARM**2, rel=1e-9)


def test_of_several_forces_that_with_the_largest_arm_is_told():
    """Along y the points lie 110 mm apart across the force, along x only 30."""
    (pad,) = told(Scene("pad", (GROUND, LEFT, RIGHT), springs=(Pad("pad", "left.p", "right.p"),)))
    assert "Pad 'pad' of scene 'pad' acts at two points that lie 110 mm apart across" in pad


@pytest.mark.parametrize(
    "given",
    [
        scene(frame="left.p"),
        scene(frame="right.p"),
        scene(a="ground.o"),
        Scene("torque", (GROUND, LEFT, RIGHT), actuators=(PointTorque("t", "left.p", "x", "t", "right.p"),)),
        Scene("rocker", (GROUND, LEFT, RIGHT), springs=(Rocker("rocker", "left.p", "right.p"),)),
        scene(joints=(prismatic("x", "ground.o", "left.rail", "x"), prismatic("y", "left.rail", "right.rail", "y"))),
    ],
    ids=["frame-a", "frame-b", "ground", "torque", "rocker", "slides"],
)
def test_what_turns_no_bodies_is_not_warned_of(given):
    """Axes that rotate with a point, a force against the ground, a torque, forces that do not balance, slides."""
    assert told(given) == []
    assert ("N m per N" in describe(given)) == bool(given.joints)
