"""What every optional argument of views does."""

from functools import partial

import numpy as np
import pytest
from arguments import assert_all_tried, is_now, table
from scipy.spatial.transform import Rotation
from seen import bar, machine, turning

import nassim.viewer
from nassim import FlexibleBody, PointForce, RigidBody, Scene, fixed
from nassim.scene import Motion
from nassim.simulation import buckling_factors
from nassim.viewer import (
    Form,
    Mark,
    Mode,
    Shape,
    View,
    block,
    cylinder,
    view_buckling,
    view_modes,
    view_motion,
    view_scene,
    view_scene_modes,
)

TURN = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
PLACE = np.array([4.0, 5.0, 6.0])
BRICK = block((1, 2, 3))
MODES = np.random.default_rng(2).normal(size=(9, 3, 2))
NAMED = Form(BRICK, ("tip",), PLACE[None], MODES)
MOTION = Motion(
    [0.0, 1.0], {"brick": [[0, 0, 0], PLACE]}, {"brick": [np.eye(3), TURN]}, {"brick": [[0, 0], [3.0, 4.0]]}
)
LOOKS = {"ground": block((0.2, 0.2, 0.02), label="table")}
SHIFT = np.linspace(0.0, 1.0, 15)
SHAKEN = View("shaken", (Shape("brick", NAMED),), modes=(Mode("sway", {"brick": np.array([2.0, -1.0])}),))
MOVED = View("moved", SHAKEN.shapes, motion=MOTION)
POINTS = np.vstack([BRICK.points, PLACE])


def frequencies(view):
    return [float(mode.name.split()[-2]) for mode in view.modes if mode.name.endswith("Hz")]


def has_modes_of(**options):
    """Whether a view has the modes of the body so held."""

    def law(_, after):
        frequency = bar().eigenmodes(**{"n": 6, **options})[0]
        elastic = frequency[frequency > 0]
        return len(after.modes) == len(frequency) and np.allclose(frequencies(after), elastic, rtol=1e-4)

    return law


def ground_is_seen(before, after):
    return len(before.shape("ground").points) == 2 and after.shape("ground").form.surface is LOOKS["ground"]


def pressed():
    """A bar that stands on the ground in its weight, with a force that presses on its top."""
    ground = RigidBody("ground", {"foot": np.zeros(3), "wall": -0.01 * TURN[:, 0]}, fixed=True)
    foot, press = fixed("clamp", "ground.foot", "bar.left"), PointForce("press", "bar.right", TURN[:, 0], "press")
    body = FlexibleBody("bar", bar(), rotation=TURN)
    return Scene("pressed", (ground, body), (foot,), (press,), gravity=-9.81 * TURN[:, 0])


def buckles_as_pressed(before, after):
    """By the factors of the simulation; the shape moves the top sideways."""
    sideways = np.linalg.norm(after.modes[0].coordinates["bar"][7:9])
    factors = [float(view.modes[0].name.removeprefix("shape 1: ").split()[0]) for view in (before, after)]
    expected = [buckling_factors(pressed(), inputs=inputs)[0][0] for inputs in (None, {"press": -1.0})]
    return np.allclose(factors, expected, rtol=1e-3) and sideways > 100 * abs(after.modes[0].coordinates["bar"][6])


def numbers(attribute, *expected):
    return lambda *found: [len(getattr(view, attribute)) for view in found] == list(expected)


def times(view):
    return len(view.motion.time)


ARGUMENTS = table(
    {
        "block": partial(block, (1, 2, 3)),
        "cylinder": partial(cylinder, 0.5, 2.0),
        "view_modes": lambda **options: view_modes(bar(), **options),
        "view_scene": lambda **options: view_scene(machine(), **options),
        "view_scene_modes": lambda **options: view_scene_modes(machine(), **options),
        "view_buckling": lambda **options: view_buckling(pressed(), **options),
        "view_motion": lambda **options: view_motion(machine(), turning(n=400), **options),
        "Form": partial(Form, BRICK),
        "Shape": partial(Shape, "shape", Form(BRICK)),
        "Mode": partial(Mode, "drift", {}),
        "Mark": partial(Mark, "mark", "joint", (("brick", "tip"),)),
        "View": partial(View, "view", (Shape("brick", NAMED),)),
        "displacement": partial(SHAKEN.displacement, "brick"),
    },
    [
        ("block", "centre", (0, 0, 0), PLACE, lambda before, after: np.allclose(after.points, before.points + PLACE)),
        ("block", "axes", None, TURN, lambda before, after: np.allclose(after.points, before.points @ TURN.T)),
        ("block", "label", "block", "plate", is_now("labels", ("plate",) * 12)),
        (
            "cylinder",
            "centre",
            (0, 0, 0),
            PLACE,
            lambda before, after: np.allclose(after.points, before.points + PLACE),
        ),
        (
            "cylinder",
            "label",
            "cylinder",
            "rod",
            lambda before, after: {*before.labels, *after.labels} == {"cylinder", "rod"},
        ),
        (
            "view_modes",
            "shapes",
            None,
            {"push": SHIFT},
            lambda _, after: np.array_equal(after.mode("push").coordinates["bar"], SHIFT),
        ),
        ("view_modes", "fixed", (), ["left"], has_modes_of(fixed=["left"])),
        ("view_modes", "guided", None, {"left": "x"}, has_modes_of(guided={"left": "x"})),
        ("view_modes", "masses", None, {"right": 0.2}, has_modes_of(masses={"right": 0.2})),
        ("view_modes", "n", 6, 9, has_modes_of(n=9)),
        ("Mode", "rigid", False, True, is_now("rigid", True)),
        ("Mode", "text", "", "no error", is_now("text", "no error")),
        ("view_scene", "looks", None, LOOKS, ground_is_seen),
        ("view_scene_modes", "looks", None, LOOKS, ground_is_seen),
        ("view_scene_modes", "n", 12, 3, numbers("modes", 12, 3)),
        ("view_buckling", "looks", None, LOOKS, ground_is_seen),
        ("view_buckling", "n", 1, 2, numbers("modes", 1, 2)),
        ("view_buckling", "inputs", None, {"press": -1.0}, buckles_as_pressed),
        ("view_motion", "looks", None, LOOKS, ground_is_seen),
        ("view_motion", "frames", 300, 40, lambda *found: [times(view) for view in found] == [300, 40]),
        ("Form", "modes", None, MODES[:8], lambda *found: [form.n_coordinates for form in found] == [0, 2]),
        (
            "Shape",
            "position",
            np.zeros(3),
            PLACE,
            lambda before, after: np.allclose(after.points, before.points + PLACE),
        ),
        ("Shape", "rotation", np.eye(3), TURN, lambda before, after: np.allclose(after.points, before.points @ TURN.T)),
        ("Shape", "colors", {}, {"block": "#123456"}, is_now("colors", {"block": "#123456"})),
        ("Shape", "text", "", "of brass", is_now("text", "of brass")),
        ("Mark", "axes", np.zeros((0, 3)), TURN, is_now("axes", TURN)),
        ("Mark", "frame", "", "brick", is_now("frame", "brick")),
        ("Mark", "text", "", "of steel", is_now("text", "of steel")),
        ("View", "marks", (), (Mark("m", "joint", (("brick", "tip"),)),), numbers("marks", 0, 1)),
        ("View", "modes", (), SHAKEN.modes, numbers("modes", 0, 1)),
        ("View", "motion", None, MOTION, lambda before, after: before.small and not after.small),
        ("displacement", "mode", None, "sway", lambda *found: np.allclose(found, [0 * POINTS, MODES @ [2.0, -1.0]])),
    ],
) | table(
    {"Form": partial(Form, BRICK, ("tip",)), "displacement": partial(MOVED.displacement, "brick")},
    [
        (
            "displacement",
            "frame",
            None,
            1,
            lambda *found: np.allclose(found, [0 * POINTS, PLACE + (POINTS + MODES @ [3.0, 4.0]) @ TURN.T - POINTS]),
        ),
    ],
)
PICTURES = "viewer/test_picture.py"
STRESS_HISTORY = "viewer/test_stress_views.py::test_a_motion_may_have_a_scale_of_its_own_fewer_images_and_voltages"
ELSEWHERE = {
    "Form: names": "viewer/test_viewer_arguments.py::test_points_have_names_and_places_together",
    "Form: positions": "viewer/test_viewer_arguments.py::test_points_have_names_and_places_together",
    "view_stress: place": "viewer/test_stress_views.py::test_a_surface_and_a_scale_may_be_chosen",
    "view_stress: voltages": "viewer/test_stress_views.py::test_a_surface_and_a_scale_may_be_chosen",
    "view_stress: largest": "viewer/test_stress_views.py::test_a_surface_and_a_scale_may_be_chosen",
    "view_stress_motion: place": STRESS_HISTORY,
    "view_stress_motion: voltages": STRESS_HISTORY,
    "view_stress_motion: largest": STRESS_HISTORY,
    "view_stress_motion: frames": STRESS_HISTORY,
    "Shape: coloring": "viewer/test_stress_views.py::test_colourings_that_do_not_fit_are_refused",
    "save_picture: modes": f"{PICTURES}::test_a_sheet_of_modes_and_a_frame_of_a_scene",
    "save_picture: frame": f"{PICTURES}::test_a_motion_is_drawn_at_rest_or_as_it_is_unless_more_is_asked_for",
    "save_picture: magnification": f"{PICTURES}::test_a_motion_is_drawn_at_rest_or_as_it_is_unless_more_is_asked_for",
    "save_picture: mesh": f"{PICTURES}::test_the_mesh_is_drawn_where_it_is_asked_for_and_the_size_is_that_of_a_page",
    "save_picture: size": f"{PICTURES}::test_the_mesh_is_drawn_where_it_is_asked_for_and_the_size_is_that_of_a_page",
    "save_picture: camera": f"{PICTURES}::test_the_camera_stands_where_it_is_told",
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.viewer, ARGUMENTS, ELSEWHERE)


def test_points_have_names_and_places_together():
    assert (Form(BRICK).names, Form(BRICK).positions.shape) == ((), (0, 3))
    assert NAMED.index("tip") == 8
    np.testing.assert_array_equal(NAMED.points, POINTS)
