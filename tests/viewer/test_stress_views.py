"""Views of stress: bands where the stress is, a legend in MPa, pages and pictures of them."""

from dataclasses import replace

import numpy as np
import pytest

from nassim.viewer import save_picture, view_stress, write_page

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
    assert view.title.startswith("bar: von Mises stress up to ")


def test_a_surface_and_a_scale_may_be_chosen(bent):
    body, q = bent
    with pytest.raises(ValueError, match="unknown stress surface of body 'bar' 'stress'; known: surface stress"):
        view_stress(body, q)
    field = replace(body.readouts["surface stress"], name="stress")
    renamed = replace(body, readouts={**body.readouts, "stress": field})
    whole = view_stress(renamed, q).shapes[0].form.labels
    assert not any("above" in label for label in whole)
    cut = view_stress(renamed, q, largest=3e6).shapes[0].form.labels
    assert cut[0] == "3 MPa and above"
    volts = replace(field, voltages={"p": np.tile([1e6, 0, 0, 0, 0, 0], (len(field.positions), 1))})
    excited = replace(body, readouts={"stress": volts})
    (shape,) = view_stress(excited, 0 * q, voltages={"p": 25.0}, largest=100e6).shapes
    assert shape.form.labels == ("20 to 30 MPa",)
    assert view_stress(excited, 0 * q, largest=100e6).shapes[0].form.labels == ("0 to 10 MPa",)


def test_pages_and_pictures_show_the_bands(bent, tmp_path):
    view = view_stress(*bent, place="surface stress", largest=LARGEST)
    page = write_page(view, tmp_path / "stress.html").read_text(encoding="utf-8")
    assert "0 to 0.6 MPa" in page
    pytest.importorskip("pyvista")
    assert save_picture(view, tmp_path / "stress.png").stat().st_size > 10_000
