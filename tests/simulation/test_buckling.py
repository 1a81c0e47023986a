"""Preload in bodies: the estimated share of the buckling load against Euler's columns; who is warned."""

import re
import warnings

import numpy as np
import pytest
from conftest import STEEL, make_bar
from scipy.spatial.transform import Rotation

from models.bench import make_bench
from nassim import (
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    simulate,
    static_response,
)
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.axial_preload import FACTOR, axial_forces, buckling_share

LENGTH, SIDE = 0.2, 4e-3
BENDING = STEEL.young_modulus * SIDE**4 / 12
EULER = np.pi**2 * BENDING / (4 * LENGTH**2)
"""Buckling load of the column clamped at one end, free at the other [N]."""
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
UP = Rotation.from_euler("y", -90, degrees=True).as_matrix()


@pytest.fixture(scope="module")
def column():
    solid = make_bar(length=LENGTH, side=SIDE)
    return craig_bampton(build_fe_model(solid, element_size=0.01, order=3, progress=False), n_modes=4, progress=False)


def held(column, left, right, turn):
    """The column between ground and, unless right is None, ground; free directions of the ends in its own axes."""
    # Joints know the world's axes only, so here the ground is what turns.
    ground = RigidBody("ground", {"start": np.zeros(3), "end": turn @ [LENGTH, 0, 0]}, fixed=True)
    joints = [Joint("foot", "ground.start", "column.left", free=left)]
    if right is not None:
        joints.append(Joint("head", "ground.end", "column.right", free=right))
    return Scene("column", (ground, FlexibleBody("column", column, rotation=turn, fidelity="linear")), joints)


@pytest.mark.parametrize(
    ("left", "right", "turn", "euler", "error"),
    [
        ((), None, TURN, 1.0, 0.02),
        ((), ("x", "y", "z"), TURN, 4.0, 0.02),
        ((), ("z",), UP, 16.0, 0.04),
        (("rx", "ry"), ("z", "rx", "ry"), UP, 4.0, 0.25),
        ((), ("z", "rx", "ry"), UP, 20.19 / (np.pi**2 / 4), 0.5),
    ],
    ids=["free", "guided", "clamped", "pinned", "clamped and pinned"],
)
def test_buckling_loads_of_eulers_columns(column, left, right, turn, euler, error):
    scene = held(column, left, right, turn)
    force = np.zeros(len(column.mass_matrix))
    force[6] = -1.0
    squeezed = np.zeros(len(force))
    squeezed[6:] = np.linalg.solve(column.stiffness_matrix[6:, 6:], force[6:])
    tension = axial_forces(column, squeezed[:, None])[:, 0]
    assert tension == pytest.approx([-1.0], rel=1e-9)
    share, name = buckling_share(assemble(scene), {"column": tension})
    assert name == "column"
    assert abs(1 / share / (euler * EULER) - 1) < error
    assert error < FACTOR - 1
    assert buckling_share(assemble(scene), {"column": -tension})[0] < 1e-12 * share, "tension"


@pytest.mark.parametrize("loads", [(1.0, 2.0), (2.0, 1.0)])
def test_of_two_columns_the_one_nearer_to_its_buckling_is_named(column, loads):
    """Side by side and unlike in load; the other one takes no part."""
    alone, _ = buckling_share(assemble(held(column, (), None, TURN)), {"column": np.array([-1.0])})
    ground = RigidBody("ground", {"one": np.zeros(3), "other": np.array([0.3, 0.2, 0.1])}, fixed=True)
    columns = [FlexibleBody(name, column, place, TURN) for name, place in ground.points.items()]
    joints = [Joint(f"foot of {name}", f"ground.{name}", f"{name}.left") for name in ground.points]
    tensions = dict(zip(ground.points, -np.array(loads)[:, None], strict=True))
    share, name = buckling_share(assemble(Scene("two", (ground, *columns), joints)), tensions)
    assert (share, name) == (pytest.approx(2 * alone, rel=1e-6), "one" if loads[0] > loads[1] else "other")


def loaded(column, fidelity, mass, *, hanging=False, gravity=True):
    """A mass on a column that stands (or hangs) on the ground."""
    turn = UP.T if hanging else UP
    end = turn @ [LENGTH, 0, 0]
    bodies = (
        RigidBody("ground", {"top": np.zeros(3)}, fixed=True),
        FlexibleBody("column", column, rotation=turn, fidelity=fidelity),
        RigidBody("mass", {"centre": np.zeros(3)}, mass, 1e-3 * np.eye(3), end),
    )
    joints = (Joint("foot", "ground.top", "column.left"), Joint("head", "column.right", "mass.centre"))
    weight = np.array([0, 0, -9.81]) if gravity else np.zeros(3)
    return Scene("loaded", bodies, joints, (PointForce("push", "mass.centre", "z", "force"),), gravity=weight)


def constant(force):
    return TimeHistory(np.arange(21) * 1e-3, np.full((1, 21), force), ("force",), ("N",))


def told(action):
    """Shares of the buckling load in the warnings of an action, which tell what these do to frequencies."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        action()
    pattern = (
        r"preload in body 'column' is (\S+) of its buckling load.*; it would (?:.* up to some (\S+) %|let it buckle)"
    )
    found = [match.groups() for match in (re.search(pattern, str(w.message)) for w in caught) if match]
    for share, lowered in found:
        expected = 100 * (1 - np.sqrt(1 - min(float(share), 1)))
        assert float(lowered) == pytest.approx(expected, rel=0.05) if lowered else float(share) > 1
    return [float(share) for share, _ in found]


ACTIONS = {
    "statics": lambda scene, force: static_response(scene, {"force": force}),
    "exact": lambda scene, force: simulate(scene, constant(force), time_step=1e-3, method="exact", progress=False),
    "implicit": lambda scene, force: simulate(scene, constant(force), time_step=1e-3, progress=False),
}


@pytest.mark.parametrize(
    ("fidelity", "action"),
    [("linear", "statics"), ("ffrf", "statics"), ("linear", "exact"), ("linear", "implicit"), ("ffrf", "implicit")],
)
@pytest.mark.parametrize("share", [0.38, 1.9])
def test_a_column_near_its_buckling_load_is_told(column, fidelity, action, share):
    """A mass on top, and the column's own weight, of which Euler's load bears 0.315 as if it were on top."""
    mass = share * EULER / 9.81 - 0.315 * column.mass
    if share > 1 and fidelity == "linear":
        with pytest.raises(ValueError, match=r"scene 'loaded' under its loads is unstable: .* start=\"released\""):
            ACTIONS[action](loaded(column, fidelity, mass), 0.0)
        return
    shares = told(lambda: ACTIONS[action](loaded(column, fidelity, mass), 0.0))
    assert shares == [pytest.approx(share, rel=0.02)]


def test_a_force_presses_as_a_weight_does(column):
    light = loaded(column, "linear", 0.01, gravity=False)
    assert told(lambda: static_response(light, {"force": -0.5 * EULER})) == [pytest.approx(0.5, rel=0.02)]
    assert told(lambda: static_response(light, {"force": 0.5 * EULER})) == []


@pytest.mark.parametrize("action", ["exact", "implicit"])
def test_the_largest_compression_of_a_run_counts(column, action):
    """A force from the second sample on, from no preload: at least what it does in statics, at most twice that."""
    light = loaded(column, "linear", 0.01, gravity=False)
    time = constant(0.0).time
    pressed = TimeHistory(time, -0.5 * EULER * (time > 0)[None], ("force",), ("N",))
    options = {"time_step": 1e-3, "progress": False, **({"method": "exact"} if action == "exact" else {})}
    (share,) = told(lambda: simulate(light, pressed, **options))
    assert 0.49 < share < 1.02


@pytest.mark.parametrize("action", ACTIONS)
def test_light_and_hanging_loads_are_not_told(column, action):
    assert told(lambda: ACTIONS[action](loaded(column, "linear", 0.08 * EULER / 9.81), 0.0)) == []
    assert told(lambda: ACTIONS[action](loaded(column, "linear", 0.9 * EULER / 9.81, hanging=True), 0.0)) == []


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_stiff_bench_is_silent(apa, fidelity):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        static_response(make_bench(apa=apa, fidelity=fidelity, gravity=True))
