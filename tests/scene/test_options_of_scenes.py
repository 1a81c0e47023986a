"""Optional arguments of scenes' verbs that no other test would miss."""

import numpy as np
import pytest

from nassim import Encoder, Loop, PointForce, RigidBody, Scene, SpringDamper, joined, placed
from nassim.simulation import linearize_closed
from nassim.systems import proportional

MASS, STIFFNESS, GAIN = 2.0, 3e4, 5e4


def block():
    """A mass on a spring along an odd direction, pushed and read along it; weak springs across."""
    axis = (0.6, 0.0, 0.8)
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    body = RigidBody("block", {"p": np.zeros(3)}, MASS, np.eye(3))
    return Scene(
        "block",
        (ground, body),
        actuators=(PointForce("push", "block.p", axis, "push"),),
        sensors=(Encoder("way", "ground.p", "block.p", axis),),
        springs=(SpringDamper("k", "ground.p", "block.p", axis, STIFFNESS),),
        damping_ratio=0.0,
    )


def test_loops_of_a_joined_scene_run():
    """Two masses, each held by a loop that reads the other, which couples them.

    K = [[k, g], [g, k]] has the eigenvalues k + g and k - g.
    """
    gain, rate = 0.4 * STIFFNESS, 1e5
    loops = tuple(
        Loop(f"{y} to {u}", proportional(-gain, sample_rate=rate, delay=0), f"{y}/way", f"{u}/push")
        for y, u in ("ab", "ba")
    )
    both = joined("both", placed(block(), "a"), placed(block(), "b", position=(1, 0, 0)), loops=loops)
    poles = linearize_closed(both, continuous=True).poles()
    for k in (STIFFNESS + gain, STIFFNESS - gain):
        nearest = poles[np.argmin(np.abs(poles - 1j * np.sqrt(k / MASS)))]
        assert nearest.imag == pytest.approx(np.sqrt(k / MASS), rel=1e-4)
