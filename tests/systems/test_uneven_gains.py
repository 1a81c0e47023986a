"""Branches of a root locus that cross, at gains of very different distances."""

import numpy as np

from nassim.systems import LinearModel, decentralised, proportional, root_locus


def test_branches_go_straight_through_a_crossing_at_uneven_gains():
    """Two oscillators, each in a loop that shifts its own frequency: w^2 - g k; they cross where both are equal."""
    squares, slopes = np.array([100.0, 400.0]) ** 2, np.array([-2e5, 3e4])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(squares), np.zeros((2, 2))]])
    b, c = np.vstack([np.zeros((2, 2)), np.eye(2)]), np.hstack([np.eye(2), np.zeros((2, 2))])
    model = LinearModel(a, b, c, np.zeros((2, 2)), ("u", "v"), ("x", "y"))
    controller = decentralised(*(proportional(k, sample_rate=1e4, delay=0) for k in slopes))
    gains = np.array([0.0, 0.02, 0.03, 0.2, 0.21, 0.45, 0.6, 0.62, 0.9, 1.0])
    locus = root_locus(model, controller, gains, measured=("x", "y"), driven=("u", "v"), delay_order=0)
    for square, slope in zip(squares, slopes, strict=True):
        branch = locus.poles[:, locus.branch(np.sqrt(square) / (2 * np.pi))]
        np.testing.assert_allclose(branch, 1j * np.sqrt(square - gains * slope), rtol=1e-9, atol=1e-6)
