"""H-infinity and H2 synthesis and complementary filters against those of Slycot, where it is installed."""

import numpy as np
import pytest
from test_synthesis import LOOP, general

from nassim.systems import (
    frequency_response,
    h2_synthesis,
    hinf_complementary_filters,
    hinf_norm,
    hinf_synthesis,
    to_control,
    weighting_filter,
)

pytest.importorskip("slycot", reason="needs Slycot: pip install slycot")
control = pytest.importorskip("control")


@pytest.mark.parametrize("options", [{}, {"errors": True}])
def test_the_least_h_infinity_norm_is_that_of_slycot(options):
    plant = general(4, **options)
    found = hinf_synthesis(plant, **LOOP, tolerance=1e-5)
    norm = control.hinfsyn(to_control(plant), 2, 2)[2]
    assert found.norm == pytest.approx(norm, rel=1e-3)
    assert hinf_norm(found.closed_loop)[0] == pytest.approx(
        control.linfnorm(to_control(found.closed_loop))[0], rel=1e-6
    )


def test_the_h2_controller_is_that_of_slycot():
    plant = general(4)
    ours, frequency = h2_synthesis(plant, **LOOP).controller, np.geomspace(0.1, 1e4, 50)
    theirs = control.h2syn(to_control(plant), 2, 2)(2j * np.pi * frequency)
    found = frequency_response(ours, frequency).values
    np.testing.assert_allclose(found, theirs, rtol=1e-6, atol=1e-9 * np.abs(found).max())


def test_complementary_filters_have_the_norm_of_slycot():
    """With the published weights: the plant [[w1, -w1], [0, w2], [1, 0]], put together by python-control."""
    first = weighting_filter(11.0, low=0.1, high=1000.0, gain=0.5, order=2)
    second = weighting_filter(10.0, low=1000.0, high=0.1, gain=0.5, order=3)
    one, split = control.ss([], [], [], [[1.0]]), control.ss([], [], [], [[1.0, -1.0], [0.0, 1.0], [1.0, 0.0]])
    plant = control.append(to_control(first), to_control(second), one) * split
    found = hinf_complementary_filters(first, second)
    assert found.norm == pytest.approx(control.hinfsyn(plant, 1, 1)[2], rel=1.5e-3)
