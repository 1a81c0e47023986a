"""What matrices alone tell of a body's inertia, on bodies whose full integrals are known."""

from dataclasses import fields, replace

import exudyn as exu
import numpy as np
import pytest
from conftest import lattice, make_bar
from scipy.spatial.transform import Rotation

from nassim import FlexibleBody, Scene, build_fe_model, craig_bampton
from nassim.base.rigid_motion import rigid_motions
from nassim.bodies.floating_frames import floating_frame
from nassim.bodies.inertia import RigidInertia, estimate_gram, rigid_inertia, transform_gram
from nassim.bodies.projection import trim_body
from nassim.simulation.exudyn.solver import solve_dynamic
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble

KNOWN = (
    "mass",
    "center_of_mass",
    "inertia",
    "mass_matrix",
    "translation_flexible",
    "translation_rotated",
    "position_flexible",
)
GUESSED = ("position_rotated", "rotated_flexible", "rotated_rotated")


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(build_fe_model(make_bar(), element_size=0.01, order=2, progress=False), progress=False)


def test_a_box_is_known_by_its_inertia():
    """Sides a, b, c: moments m (b^2 + c^2) / 12 and so on, about any axes."""
    sides, mass = np.array([0.03, 0.5, 0.2]), 4.0
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    inertia = turn @ np.diag(mass / 12 * (np.sum(sides**2) - sides**2)) @ turn.T
    centre = np.array([0.1, -0.2, 0.3])
    about = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    found = RigidInertia(mass, centre, about, 0.0)
    np.testing.assert_allclose(found.box, np.sort(sides**2), rtol=1e-9)
    assert found.box_density == pytest.approx(mass / np.prod(sides), rel=1e-9)


def forgetful(body):
    """The body as it would be imported: with what its matrices and node positions tell."""
    positions = np.array([point.position for point in body.remote_points])
    return replace(body, gram=estimate_gram(body.mass_matrix, positions), full_integrals=False)


def test_rigid_integrals_are_exact(bar, apa):
    for body in (bar, apa, craig_bampton(lattice(), n_modes=4, progress=False)):
        full, told = (floating_frame(b, body.point_names[1]) for b in (body, forgetful(body)))
        for name in KNOWN:
            expected = np.asarray(getattr(full, name))
            assert np.allclose(getattr(told, name), expected, atol=1e-9 * np.abs(expected).max()), name
    assert {f.name for f in fields(full)} >= {*KNOWN, *GUESSED}


def test_the_guess_is_positive_semidefinite_and_keeps_the_mass_matrix(bar, apa):
    for body in (bar, apa):
        gram, n = forgetful(body).gram, len(body.mass_matrix)
        trace = np.einsum("jckc->jk", gram[4:, 4:].reshape(n, 3, n, 3))
        assert np.allclose(trace, body.mass_matrix, atol=1e-12 * np.abs(body.mass_matrix).max())
        scale = 1 / np.sqrt(np.maximum(np.diag(body.gram), 1e-9 * np.diag(body.gram).max()))
        assert np.linalg.eigvalsh(scale[:, None] * gram * scale)[0] > -1e-9


def test_rigid_motions_have_their_exact_gram(bar):
    """Fields that are rigid motions of the whole body: all their products are known, rotations too."""
    n = len(bar.mass_matrix)
    change = np.zeros((4 + 3 * n, 22))
    change[:4, :4] = np.eye(4)
    motions = rigid_motions(np.array([p.position for p in bar.remote_points]), n)
    change[4:, 4:] = np.kron(motions, np.eye(3))
    expected, found = (change.T @ gram @ change for gram in (bar.gram, forgetful(bar).gram))
    assert np.allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_the_guess_does_not_depend_on_the_origin():
    """Matrices of points are those of any frame with these axes; the strains are about the body's own centre."""
    body, place = craig_bampton(lattice(), n_modes=4, progress=False), np.array([0.3, -0.2, 0.05])
    mass, positions = body.mass_matrix, body.positions
    found = estimate_gram(mass, positions + place)
    expected = transform_gram(estimate_gram(mass, positions), place, np.eye(3), np.eye(len(mass)))
    scale = 1 / np.sqrt(np.maximum(np.diag(expected), 1e-12 * np.diag(expected).max()))
    assert np.abs(scale[:, None] * (found - expected) * scale).max() < 1e-8


def test_a_rigid_bodys_inertia():
    """Two point masses 3 kg and 1 kg, 0.4 m apart, as nodes with a little moment of inertia of their own."""
    positions = np.array([[0.1, 0.2, 0.0], [0.5, 0.2, 0.0]])
    mass = np.diag([3.0] * 3 + [1e-3] * 3 + [1.0] * 3 + [1e-3] * 3)
    found = rigid_inertia(mass, rigid_motions(positions, 12))
    assert found.mass == pytest.approx(4.0)
    assert found.center_of_mass == pytest.approx([0.2, 0.2, 0.0])
    assert np.diag(found.central_inertia) == pytest.approx([2e-3, 0.12 + 2e-3, 0.12 + 2e-3])
    assert found.misfit < 1e-15
    wrong = np.diag([3.0, 3.0, 9.0] + [1e-3] * 3 + [1.0] * 3 + [1e-3] * 3)
    assert rigid_inertia(wrong, rigid_motions(positions, 12)).misfit > 0.5
    # Momentum along an axis by turning about it, which no body has: 0.05 kg m over 2 kg and a radius of 0.1 m.
    screw = np.diag([2.0] * 3 + [0.02] * 3)
    screw[0, 3] = screw[3, 0] = 0.05
    assert rigid_inertia(screw, np.eye(6)).misfit == pytest.approx(0.05 / (2.0 * 0.1))


def stretched_by_spin(body, angular_velocity):
    """Elongation after a free spin about z, with so much damping that the start has died away [m]."""
    scene = Scene(
        "spin", (FlexibleBody("bar", body, angular_velocity=np.array([0, 0, angular_velocity])),), damping_ratio=0.3
    )
    system = build_system(assemble(scene))
    solve_dynamic(system, {}, n_steps=800, time_step=2e-5, spectral_radius=0.7, progress=False)
    node = system.flexible["bar"].nodes[0][0]
    return np.array(system.mbs.GetNodeOutput(node, exu.OutputVariableType.Coordinates))[0]


@pytest.mark.parametrize("angular_velocity", [100.0, 800.0])
def test_a_spinning_bar_stretches_as_with_full_integrals(bar, angular_velocity):
    """Against the closed form rho omega^2 L^3 / 12 E, the full integrals, and the stated bound."""
    full, told = stretched_by_spin(bar, angular_velocity), stretched_by_spin(forgetful(bar), angular_velocity)
    closed_form = 7800 * angular_velocity**2 * 0.1**3 / (12 * 200e9)
    assert full == pytest.approx(closed_form, rel=0.02)
    assert told == pytest.approx(full, rel=0.02)
    share = angular_velocity / (2 * np.pi * bar.eigenfrequencies()[6])
    assert abs(told - full) < share**2 * 0.1


def test_where_the_points_lie_in_one_place_the_bound_still_holds(bar):
    """Trimmed to one end, nothing tells of stretch: it is left out, which costs less than the bound."""
    body = trim_body(bar, points=["left"], loads=np.zeros((len(bar.mass_matrix), 0)), cutoff_frequency=30e3)
    full, told = (floating_frame(b, "left") for b in (body, forgetful(body)))
    frequency = body.eigenfrequencies()[6]
    angular_velocity = 2 * np.pi * frequency / 30
    # Static deflection of each mode under centrifugal forces, and the tip's motion that they give.
    turn = np.array([0, 0, angular_velocity])
    n = len(full.flexible)

    def deflection(frame):
        load = np.array([turn @ frame.position_rotated[:, 3 * j : 3 * j + 3] @ turn for j in range(n)])
        return np.linalg.solve(frame.stiffness_matrix, load)

    missing = deflection(full) - deflection(told)
    tip = body.motion("right")[:3, full.flexible] @ missing
    assert 0 < np.linalg.norm(tip) < (1 / 30) ** 2 * 0.1
