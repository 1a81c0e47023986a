"""The floating frame: integrals against Exudyn's own node-based formulas, momentum of a spinning free body."""

import numpy as np
import pytest
from conftest import angular_momentum, lattice, make_bar
from exudyn.FEM import ComputeSkewMatrix

from nassim import FlexibleBody, Scene, build_fe_model, condense, craig_bampton
from nassim.bodies.floating_frames import floating_frame
from nassim.fem.modes import fixed_interface_modes
from nassim.simulation.exudyn.solver import solve_dynamic
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble


@pytest.mark.parametrize("point", ["left", "right"])
def test_integrals_equal_exudyns_own_formulas(point):
    """The same integrals from nodes and lumped masses, as ObjectFFRFreducedOrderInterface computes them."""
    model = lattice()
    condensed = condense(model, progress=False)
    body = craig_bampton(condensed, n_modes=5, progress=False)
    frame = floating_frame(body, point)

    # The basis node by node (x, y, z of node 1, ...): constraint modes of the other point, then the modes.
    count = model.n_dofs // 3
    by_node = np.arange(3 * count).reshape(3, count).T.ravel()
    modes = fixed_interface_modes(condensed, n_modes=5)[1]
    others = np.delete(condensed.constraint_modes, np.s_[:6] if point == "left" else np.s_[6:12], axis=1)
    psi = np.hstack([others, modes])[by_node]
    mass = model.mass_matrix.toarray()[np.ix_(by_node, by_node)]
    positions = (model.fields[1:].T - body.point(point).position).ravel()
    phi, psi_tilde, x_tilde = (
        np.tile(np.eye(3), (count, 1)),
        ComputeSkewMatrix(psi),
        ComputeSkewMatrix(positions),
    )
    lumped = np.diag(mass)[::3]
    expected = {
        "center_of_mass": lumped @ positions.reshape(-1, 3) / lumped.sum(),
        "mass_matrix": psi.T @ mass @ psi,
        "inertia": x_tilde.T @ mass @ x_tilde,
        "translation_flexible": phi.T @ mass @ psi,
        "translation_rotated": phi.T @ mass @ psi_tilde,
        "position_flexible": x_tilde.T @ mass @ psi,
        "position_rotated": x_tilde.T @ mass @ psi_tilde,
        "rotated_flexible": psi_tilde.T @ mass @ psi,
        "rotated_rotated": psi_tilde.T @ mass @ psi_tilde,
    }
    for name, value in expected.items():
        assert np.allclose(getattr(frame, name), value, rtol=0, atol=1e-6 * np.abs(value).max()), name
    assert frame.mass == pytest.approx(lumped.sum(), rel=1e-12)


def test_rigid_motion_is_no_deformation():
    body = craig_bampton(lattice(), n_modes=3, progress=False)
    frame = floating_frame(body, "right")
    rigid = np.zeros((15, 6))
    for k, point in enumerate(body.remote_points):
        rigid[6 * k : 6 * k + 6] = np.eye(6)
        x, y, z = point.position
        rigid[6 * k : 6 * k + 3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    assert np.abs(frame.deformation(body) @ rigid).max() < 1e-15
    with pytest.raises(ValueError, match="unknown remote point 'middle'; known: left, right"):
        floating_frame(body, "middle")


@pytest.fixture(scope="module")
def free_bar():
    """A free bar with the frame on its left end and three elastic modes."""
    model = build_fe_model(make_bar(), element_size=0.01, order=2, progress=False)
    return craig_bampton(model, n_modes=3, remote_points=["left"], progress=False)


def spin(body, time_step, turns):
    scene = Scene("spin", (FlexibleBody("bar", body, angular_velocity=np.array([0, 0, 100.0])),), damping_ratio=0.0)
    system = build_system(assemble(scene))
    start = angular_momentum(system, body)
    n_steps = round(turns * 2 * np.pi / 100 / time_step)
    solve_dynamic(system, {}, n_steps=n_steps, time_step=time_step, spectral_radius=0.9, progress=False)
    return np.linalg.norm(angular_momentum(system, body) - start) / np.linalg.norm(start)


def test_initial_momentum_is_that_of_the_rigid_body(free_bar):
    scene = Scene("spin", (FlexibleBody("bar", free_bar, angular_velocity=np.array([0, 0, 100.0])),))
    found = angular_momentum(build_system(assemble(scene)), free_bar)
    mass = 7800 * 0.1 * 0.01**2
    assert np.allclose(found, [0, 0, 100 * mass * (0.1**2 + 0.01**2) / 12], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_spinning_free_body_keeps_its_angular_momentum(free_bar):
    """10 turns at 100 rad/s, to 1e-6, with 11 us steps (5700 a turn).

    The error arises at the start, from the Euler parameters' first steps, and falls with the step squared; the test
    below shows that it does not grow in 30 turns.
    """
    assert spin(free_bar, 1.1e-5, turns=10) < 1e-6


def test_momentum_error_falls_with_the_step_squared_and_does_not_grow(free_bar):
    coarse, fine, longer = spin(free_bar, 4e-4, 5), spin(free_bar, 2e-4, 5), spin(free_bar, 4e-4, 30)
    assert coarse / fine == pytest.approx(4.0, rel=0.1)
    assert abs(longer - coarse) < 1e-2 * coarse
