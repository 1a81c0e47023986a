"""How bodies moved, as data: what is refused, where named points are, and what files keep."""

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import FlexibleBody, RigidBody, Scene, craig_bampton, load, save
from nassim.base.storage import fingerprint
from nassim.scene import Motion, point_motion, seen_from

TURNS = Rotation.from_rotvec([[0.3, -0.2, 0.5], [1.1, 0.7, -2.0]]).as_matrix()
PLACES = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, 0.5]])


def motion(**changes):
    fields = {"time": [0.0, 0.5], "positions": {"a": PLACES}, "rotations": {"a": TURNS}, "coordinates": {}}
    return Motion(**{**fields, **changes})


def test_a_motion_is_read_only_and_saved(tmp_path):
    made = motion(coordinates={"a": np.arange(6.0).reshape(2, 3)}, voltages={"a": {"port": [3, 4]}})
    assert made.voltages["a"]["port"].tolist() == [3.0, 4.0]
    arrays = made.time, made.positions["a"], made.rotations["a"], made.coordinates["a"], made.voltages["a"]["port"]
    for array in arrays:
        assert not array.flags.writeable
    with pytest.raises(TypeError):
        made.positions["b"] = PLACES
    assert fingerprint(load(save(made, tmp_path / "motion.h5"))) == fingerprint(made)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"time": [0.0, 0.0]}, "times that rise"),
        ({"time": []}, "times that rise, got 0"),
        ({"positions": {}}, "only one of them is given for a"),
        ({"positions": {"b": PLACES}}, "only one of them is given for a, b"),
        ({"positions": {"a": PLACES[:1]}}, r"positions of 'a' must have shape 2 x 3"),
        ({"rotations": {"a": TURNS[:, :2]}}, r"rotations of 'a' must have shape 2 x 3 x 3"),
        ({"rotations": {"a": 0.99 * TURNS}}, "rotations of 'a' must be proper"),
        ({"rotations": {"a": -TURNS}}, "rotations of 'a' must be proper"),
        ({"coordinates": {"a": np.ones((3, 2))}}, "coordinates of 'a' must have shape 2 x any"),
        ({"coordinates": {"b": np.ones((2, 2))}}, "unknown body 'b'; known: a"),
    ],
)
def test_what_is_no_motion(changes, said):
    with pytest.raises(ValueError, match=said):
        motion(**changes)


def test_rotations_may_differ_from_proper_ones_by_a_millionth():
    """The largest entry of R^T R - I."""
    motion(rotations={"a": np.sqrt(1 + 0.9e-6) * TURNS})
    with pytest.raises(ValueError, match="rotations of 'a' must be proper"):
        motion(rotations={"a": np.sqrt(1 + 1.1e-6) * TURNS})


def test_points_of_a_turned_rigid_body():
    body = RigidBody("a", {"tip": [0.1, -0.2, 0.3]}, 1.0, np.diag([1.0, 2.0, 2.5]))
    places, turns = point_motion(Scene("scene", (body,)), motion(), "a.tip")
    for k in range(2):
        x, y, z = TURNS[k].T
        np.testing.assert_allclose(places[k], PLACES[k] + 0.1 * x - 0.2 * y + 0.3 * z, rtol=1e-14)
    np.testing.assert_array_equal(turns, TURNS)
    with pytest.raises(ValueError, match="unknown point of 'a': 'top'; known: tip"):
        point_motion(Scene("scene", (body,)), motion(), "a.top")


def test_points_of_a_deformed_body_also_go_with_its_coordinates():
    body = craig_bampton(lattice(), n_modes=2, progress=False)
    n, names = len(body.mass_matrix), body.point_names
    at = 6 * names.index("right")
    q = np.zeros((2, n))
    q[1, at : at + 6] = [1e-3, 2e-3, -3e-3, 0.0, 0.0, np.pi / 2]
    moved = motion(coordinates={"a": q})
    places, turns = point_motion(Scene("scene", (FlexibleBody("a", body),)), moved, "a.right")
    arm = body.point("right").position
    np.testing.assert_allclose(places[0], PLACES[0] + TURNS[0] @ arm, rtol=1e-14)
    np.testing.assert_allclose(places[1], PLACES[1] + TURNS[1] @ (np.array([1e-3, 2e-3, -3e-3]) + arm), rtol=1e-14)
    np.testing.assert_array_equal(turns[0], TURNS[0])
    x, y, z = TURNS[1].T
    np.testing.assert_allclose(turns[1], np.column_stack([y, -x, z]), atol=1e-14)
    stiff, _ = point_motion(Scene("scene", (FlexibleBody("a", body),)), motion(), "a.right")
    np.testing.assert_allclose(stiff[1], PLACES[1] + TURNS[1] @ arm, rtol=1e-14)


def test_who_turns_along_sees_where_points_lie_in_its_axes():
    """Distances along the axes of the body that looks are the same, and that stays where it is drawn."""
    drawn = Rotation.from_rotvec([-0.4, 0.1, 0.8]).as_matrix()
    looking = RigidBody("a", {}, 1.0, np.eye(3), [0.2, 0.0, -0.1], rotation=drawn)
    other = RigidBody("b", {"tip": [0.3, 0.1, 0.2]}, 1.0, np.eye(3))
    scene = Scene("scene", (looking, other))
    turns = Rotation.from_rotvec([[0.1, 2.0, 0.4], [0.5, -0.1, 1.3]]).as_matrix()
    places = {"a": PLACES, "b": PLACES[::-1]}
    moved = motion(positions=places, rotations={"a": TURNS, "b": turns}, coordinates={"b": np.ones((2, 1))})
    seen = seen_from(scene, moved, "a")
    np.testing.assert_allclose(seen.positions["a"], np.tile(looking.position, (2, 1)), atol=1e-14)
    np.testing.assert_allclose(seen.rotations["a"], np.tile(drawn, (2, 1, 1)), atol=1e-14)
    np.testing.assert_array_equal(seen.coordinates["b"], moved.coordinates["b"])
    (before, axes), (after, axes_after) = (point_motion(scene, m, "b.tip") for m in (moved, seen))
    for k in range(2):
        for column in range(3):
            expected = TURNS[k][:, column] @ (before[k] - PLACES[k])
            assert drawn[:, column] @ (after[k] - looking.position) == pytest.approx(expected, abs=1e-13)
        np.testing.assert_allclose(drawn.T @ axes_after[k], TURNS[k].T @ axes[k], atol=1e-13)
    with pytest.raises(ValueError, match="unknown body 'c'"):
        seen_from(scene, moved, "c")


def test_bodies_that_a_motion_leaves_out_are_named():
    bodies = (RigidBody(name, {"tip": [0.1, 0, 0]}, 1.0, np.eye(3)) for name in "ab")
    scene = Scene("scene", tuple(bodies))
    for ask in (lambda: point_motion(scene, motion(), "b.tip"), lambda: seen_from(scene, motion(), "b")):
        with pytest.raises(ValueError, match="unknown body of the motion 'b'; known: a"):
            ask()


def test_some_bodies_of_a_motion():
    whole = motion(
        positions={"a": PLACES, "b": PLACES}, rotations={"b": TURNS, "a": TURNS}, coordinates={"b": np.ones((2, 1))}
    )
    assert [*whole.select(["a"]).positions] == ["a"]
    assert not whole.select(["a"]).coordinates
    assert fingerprint(whole.select(["a", "b"])) == fingerprint(whole)
    with pytest.raises(ValueError, match="unknown body 'c'; known: a, b"):
        whole.select(["c"])
