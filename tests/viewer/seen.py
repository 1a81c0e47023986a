"""A bar and a machine of two bars that turn far, for all that is shown."""

from functools import cache

import numpy as np
from conftest import make_bar
from scipy.spatial.transform import Rotation

from nassim import FlexibleBody, RigidBody, Scene, build_fe_model, craig_bampton, fixed, revolute, spherical
from nassim.scene import Encoder, Motion, PointForce, SpringDamper

TURN = Rotation.from_euler("zyx", [40, -25, 10], degrees=True).as_matrix()


@cache
def bar_model():
    return build_fe_model(make_bar(), element_size=0.01, order=2, progress=False)


@cache
def bar():
    return craig_bampton(bar_model(), n_modes=3, progress=False)


@cache
def machine():
    """Two bars, one held and one hinged to a block, all of it turned."""
    hinge, tip = TURN @ [0, 0, 0.1], TURN @ [0.1, 0, 0]
    moments = np.diag([2e-5, 3e-5, 4e-5])
    return Scene(
        "machine",
        bodies=(
            RigidBody("ground", {"foot": np.zeros(3), "hinge": hinge}, fixed=True),
            FlexibleBody("bar_1", bar(), rotation=TURN),
            FlexibleBody("bar_2", bar(), position=hinge, rotation=TURN),
            RigidBody(
                "block", {"corner": np.array([0.01, 0, 0])}, 0.1, moments, tip - TURN @ [0.01, 0, 0], rotation=TURN
            ),
        ),
        joints=(
            fixed("clamp", "ground.foot", "bar_1.left"),
            revolute("pin", "ground.hinge", "bar_2.left", TURN[:, 1]),
            spherical("ball", "bar_1.right", "block.corner"),
        ),
        springs=(SpringDamper("spring", "bar_1.right", "bar_2.right", "line", stiffness=1e3),),
        actuators=(PointForce("push", "bar_2.right", "z", "force", frame="bar_2.right"),),
        sensors=(Encoder("encoder", "ground.hinge", "bar_2.right", "x"),),
    )


def turning(*, n=7, angle=2.0, size=1e-5):
    """A motion in which the second bar turns about its hinge and bends, and the first bends a little."""
    time = np.linspace(0, 0.3, n)
    numbers = np.random.default_rng(1)
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, angle, n), TURN[:, 1])).as_matrix()
    bends = size * numbers.normal(size=(n, len(bar().mass_matrix)))
    rest = np.broadcast_to(TURN, (n, 3, 3))
    places = {b.name: np.broadcast_to(b.position, (n, 3)) for b in machine().bodies if b.name.startswith("bar")}
    return Motion(time, places, {"bar_1": rest, "bar_2": turns @ TURN}, {"bar_1": 0.1 * bends, "bar_2": bends})
