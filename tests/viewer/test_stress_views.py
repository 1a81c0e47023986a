"""Views of stress: bands where the stress is, a legend in MPa, pages and pictures of them."""

import re
from dataclasses import replace

import numpy as np
import pytest

from nassim import FlexibleBody, RigidBody, von_mises
from nassim.bodies import Surface
from nassim.scene import Motion
from nassim.viewer import Coloring, save_picture, view_stress, view_stress_motion, write_page
from nassim.viewer.encoding import encode

FORCE, LENGTH, SIDE = 10.0, 0.1, 0.01
LARGEST = 6e6
"""Stress of the root, 6 F L / a^3 [Pa]."""


@pytest.fixture(scope="module")
def bent(stressed_bar):
    """The bar and its coordinates under a force across at the tip, held at the other end."""
    n = len(stressed_bar.mass_matrix)
    load, q = np.zeros(n), np.zeros(n)
    load[8] = FORCE
    q[6:] = np.linalg.solve(stressed_bar.stiffness_matrix[6:, 6:], load[6:])
    return replace(stressed_bar, name="bar"), q


def test_bands_lie_where_the_stress_is(bent):
    """Far from the ends the stress of bending is F (L - x) z / I, on top of the shear stress of the sides."""
    view = view_stress(*bent, place="surface stress", largest=LARGEST)
    (shape,) = view.shapes
    surface = shape.form.surface
    centres = surface.points[surface.triangles].mean(axis=1)
    on_top = (np.abs(centres[:, 2] - SIDE / 2) < 1e-9) & (np.abs(centres[:, 0] - 0.05) < 0.03)
    assert np.count_nonzero(on_top) > 10
    for triangle in np.flatnonzero(on_top):
        expected = 6e-6 * FORCE * (LENGTH - centres[triangle, 0]) / SIDE**3
        low, _, high = surface.labels[triangle].removesuffix(" MPa").partition(" to ")
        assert float(low) - 0.3 < expected < float(high) + 0.3
    ends = [float(label.partition(" ")[0]) for label in shape.form.labels]
    assert ends == sorted(ends, reverse=True)
    assert set(shape.form.labels) <= set(shape.colors)
    stress, error = map(
        float, re.fullmatch(r"bar: von Mises stress up to (\S+) MPa \(mesh: \+-(\S+) MPa\)", view.title).groups()
    )
    assert stress == pytest.approx(6e-6 * FORCE * LENGTH / SIDE**3, rel=0.15)
    assert 1e-3 * stress < error < 0.3 * stress


def test_a_surface_and_a_scale_may_be_chosen(bent):
    body, q = bent
    for given, options, problem in (
        (q[1:], {}, f"coordinates must have shape {len(q)}, got {len(q) - 1}"),
        (np.nan * q, {}, "coordinates holds"),
        (q, {"largest": 0.0}, "largest must be positive, got 0 Pa"),
    ):
        with pytest.raises(ValueError, match=problem):
            view_stress(body, given, place="surface stress", **options)
    with pytest.raises(ValueError, match="unknown stress surface of body 'bar' 'stress'; known: surface stress"):
        view_stress(body, q)
    field = replace(body.readouts["surface stress"], name="stress")
    renamed = replace(body, readouts={**body.readouts, "stress": field})
    whole = view_stress(renamed, q).shapes[0].form.labels
    assert set(whole) == {f"{k} to {k + 1} MPa" for k in range(6)}
    cut = view_stress(renamed, q, largest=3e6).shapes[0].form.labels
    assert cut[0] == "3 MPa and above"
    volts = replace(field, voltages={"p": np.tile([1e6, 0, 0, 0, 0, 0], (len(field.positions), 1))})
    excited = replace(body, readouts={"stress": volts})
    (shape,) = view_stress(excited, 0 * q, voltages={"p": 25.0}, largest=100e6).shapes
    assert shape.form.labels == ("20 to 30 MPa",)
    assert view_stress(excited, 0 * q, largest=100e6).shapes[0].form.labels == ("0 to 10 MPa",)
    assert view_stress(excited, 0 * q, voltages={"p": 25.0}, largest=27e6).shapes[0].form.labels == ("25 to 27 MPa",)
    assert view_stress(excited, 0 * q, voltages={"p": 30.0}).shapes[0].form.labels == ("25 to 30 MPa",)


@pytest.fixture(scope="module")
def swinging(bent):
    """The bar in a scene, in a general pose, and its state at rest under the force times 0, 0.25, 0.5, 0.75 and 1."""
    body, q = bent
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    flexible = FlexibleBody("bar", body, [0.1, 0.2, 0.3], turn * np.linalg.det(turn), fidelity="linear")
    share = np.linspace(0, 1, 5)
    places, axes = np.tile(flexible.position, (5, 1)), np.tile(flexible.rotation, (5, 1, 1))
    return flexible, Motion(share, {"bar": places}, {"bar": axes}, {"bar": share[:, None] * q})


def test_a_motion_has_the_stress_of_each_time_on_the_surface_that_moves(swinging):
    flexible, motion = swinging
    view = view_stress_motion(flexible, motion, place="surface stress")
    (shape,) = view.shapes
    field = flexible.reduced.readouts["surface stress"]
    full = 1e-6 * von_mises(field.stress(motion.coordinates["bar"][-1]))
    np.testing.assert_allclose(shape.coloring.values, motion.time[:, None] * full, rtol=1e-12)
    assert 5.5 < full.max() < 6.0
    assert (shape.coloring.quantity, shape.coloring.largest) == ("von Mises stress [MPa]", 6.0)
    deflection = view.displacement("bar", frame=4)[: len(field.positions)] @ flexible.rotation
    tip = np.abs(field.positions[:, 0] - LENGTH) < 1e-9
    root = flexible.reduced.motion("right")[2] @ motion.coordinates["bar"][-1]
    np.testing.assert_allclose(deflection[tip, 2], root, rtol=0.02)
    looks, n = flexible.reduced.readouts["surface"], len(flexible.reduced.surface.points)
    order = np.roll(np.arange(n), 5)
    points, faces = looks.surface.points[order], np.argsort(order)[looks.surface.triangles]
    other = replace(looks, surface=Surface(points, faces, [], looks.surface.labels), modes=looks.modes[order])
    rolled = replace(flexible.reduced, readouts={**flexible.reduced.readouts, "surface": other})
    same = view_stress_motion(replace(flexible, reduced=rolled), motion, place="surface stress")
    np.testing.assert_array_equal(same.displacement("bar", frame=4), view.displacement("bar", frame=4))
    header, data = encode(view)
    where = header["shapes"][0]["values"]
    levels = np.frombuffer(data, np.uint8, where["length"], where["offset"]).reshape(5, -1)
    np.testing.assert_allclose(levels / 255, shape.coloring.values / 6.0, atol=0.5 / 255)
    ticks = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert header["coloring"] == {"quantity": "von Mises stress [MPa]", "largest": 6.0, "ticks": ticks}


@pytest.mark.parametrize(
    ("largest", "ticks"),
    [
        (10.0, range(11)),
        (60.0, range(0, 61, 10)),
        (0.3, [0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]),
        (64.0, [0, 16, 32, 48, 64]),
        (1200.0, range(0, 1201, 200)),
    ],
)
def test_a_legend_has_round_numbers(largest, ticks):
    assert Coloring("stress", np.zeros((1, 1)), largest).ticks == tuple(ticks)


def test_a_motion_may_have_a_scale_of_its_own_fewer_images_and_voltages(swinging):
    flexible, motion = swinging
    view = view_stress_motion(flexible, motion, place="surface stress", largest=3e6, frames=3)
    (shape,) = view.shapes
    assert shape.coloring.values.shape[0] == len(view.motion.time) == 3
    assert encode(view)[0]["coloring"]["largest"] == 3.0
    field = flexible.reduced.readouts["surface stress"]
    volts = replace(field, name="stress", voltages={"p": np.tile([1e6, 0, 0, 0, 0, 0], (len(field.positions), 1))})
    excited = replace(
        flexible, reduced=replace(flexible.reduced, readouts={**flexible.reduced.readouts, "stress": volts})
    )
    ramp = view_stress_motion(excited, motion, voltages={"p": 8 * motion.time}).shapes[0].coloring.values
    driven = von_mises(volts.stress(0.5 * motion.coordinates["bar"][-1], {"p": 4.0}))
    np.testing.assert_allclose(ramp[2], 1e-6 * driven, rtol=1e-12)
    with pytest.raises(ValueError, match="unknown flexible body of the motion 'bar'"):
        view_stress_motion(flexible, replace(motion, coordinates={}), place="surface stress")
    with pytest.raises(ValueError, match="body 'block' is rigid, so it has no stress"):
        view_stress_motion(RigidBody("block", {}, 1.0, np.eye(3)), motion)


def test_colourings_that_do_not_fit_are_refused(swinging):
    view = view_stress_motion(*swinging, place="surface stress")
    (shape,) = view.shapes
    for motion, coloring in (
        (None, shape.coloring),
        (view.motion, replace(shape.coloring, values=shape.coloring.values[:, 1:])),
    ):
        with pytest.raises(ValueError, match="needs values for every image of a motion and every point of the surface"):
            replace(view, motion=motion, shapes=(replace(shape, coloring=coloring),))
    with pytest.raises(ValueError, match="must not be negative"):
        replace(shape.coloring, values=-shape.coloring.values)
    other = replace(shape, name="other", coloring=replace(shape.coloring, largest=1.0))
    with pytest.raises(ValueError, match="one quantity and one largest value"):
        replace(view, shapes=(shape, other))


def test_pages_and_pictures_show_the_bands(bent, tmp_path):
    view = view_stress(*bent, place="surface stress", largest=LARGEST)
    page = write_page(view, tmp_path / "stress.html").read_text(encoding="utf-8")
    assert "0 to 1 MPa" in page
    pytest.importorskip("pyvista")
    assert save_picture(view, tmp_path / "stress.png").stat().st_size > 10_000
