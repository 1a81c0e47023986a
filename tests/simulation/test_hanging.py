"""Static equilibria that weight stiffens or softens: pendulums, by themselves and on springs, against closed forms."""

import numpy as np
import pytest
import scipy.optimize
from conftest import lattice
from scipy.spatial.transform import Rotation
from test_large_motion import INERTIA, NORMAL, SKEWED, ground

from nassim import AngleSensor, FlexibleBody, Joint, RigidBody, Scene, craig_bampton, static_response
from nassim.scene.joints import revolute
from nassim.scene.mechanics import Bushing

MASS, LENGTH, G = 0.7, 0.04, 9.81
ACROSS = np.cross(NORMAL, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(NORMAL, [1.0, 0.0, 0.0]))


def pendulum(angle, *, spring=0.0, body=None):
    """A pendulum drawn along ACROSS, where weight acts along what an angle makes of that; a spring in its hinge."""
    if body is None:
        body = RigidBody("bob", {"o": -LENGTH * ACROSS}, MASS, INERTIA, LENGTH * ACROSS)
    axes = Rotation.align_vectors([NORMAL], [[0.0, 0, 1]])[0].as_matrix()
    return Scene(
        "pendulum",
        (ground(), body),
        (revolute("hinge", "ground.o", "bob.o", NORMAL),),
        sensors=(AngleSensor("angle", "ground.o", "bob.o", NORMAL),),
        springs=(Bushing("spring", "ground.o", "bob.o", [0, 0, 0, 0, 0, spring], axes=axes),) if spring else (),
        gravity=G * Rotation.from_rotvec(angle * NORMAL).apply(ACROSS),
    )


@pytest.mark.filterwarnings("ignore:the run starts")
@pytest.mark.parametrize("angle", [-1.5, -0.3, 0.02, 0.5, 1.2])
def test_a_pendulum_hangs_along_its_weight(angle):
    assert static_response(pendulum(angle))["angle"] == pytest.approx(angle, rel=1e-6)


@pytest.mark.filterwarnings("ignore:the run starts")
@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.9, 2.0, 30.0])
@pytest.mark.parametrize("drawn", [0.2, np.pi - 0.02])
def test_a_pendulum_on_a_spring(share, drawn):
    """k x = m g l sin(drawn - x), hanging and upside down, where its weight's stiffness is a share of the spring's.

    Exudyn's rule does not know that stiffness, so it takes the share of the error along to the next iteration, and
    ends some 1e-5 before the root.
    """
    weight = MASS * G * LENGTH
    spring = weight / share
    if drawn > 1 and share > 1:
        with pytest.raises(RuntimeError, match="no static equilibrium"):
            static_response(pendulum(drawn, spring=spring))
        return
    expected = scipy.optimize.brentq(lambda x: spring * x - weight * np.sin(drawn - x), 0.0, 0.5)
    assert static_response(pendulum(drawn, spring=spring))["angle"] == pytest.approx(expected, rel=2e-5)


def test_no_equilibrium_is_still_none():
    """Upright, where nothing holds it, and level, where its weight has no stiffness."""
    for angle in (np.pi - 0.1, np.pi / 2):
        with pytest.raises(RuntimeError, match="no static equilibrium"):
            static_response(pendulum(angle))


@pytest.mark.filterwarnings("ignore:the run starts")
def test_a_soft_pendulum_hangs():
    """A flexible bar and a rigid one, each on its hinge: the centre of mass of the soft one comes below the hinge."""
    bar = craig_bampton(lattice(stiffness=1e4), n_modes=1, progress=False)
    left = SKEWED @ bar.point("left").position
    body = FlexibleBody("bob", bar, -left, SKEWED)
    scene = pendulum(0.0)
    hinge = Joint("hinge", "ground.o", "bob.left", ("rz",), revolute("h", "ground.o", "bob.o", NORMAL).axes)
    arm = body.centre - NORMAL * (NORMAL @ body.centre)
    for angle in (0.05, 0.8):
        down = Rotation.from_rotvec(angle * NORMAL).apply(arm / np.linalg.norm(arm))
        turned = Scene(
            "bar",
            (scene.bodies[0], body),
            (hinge,),
            sensors=(AngleSensor("a", "ground.o", "bob.left", NORMAL),),
            gravity=G * down,
        )
        assert static_response(turned)["a"] == pytest.approx(angle, abs=2e-3)
