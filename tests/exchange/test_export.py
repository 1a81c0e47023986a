"""Export: exact round trips, the layout that others expect, state spaces."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from conftest import lattice

from nassim import craig_bampton, frequency_response, linearize
from nassim.bodies.readouts import BodyDamping
from nassim.exchange.export import body_damping, body_state_space, export_body, export_model
from nassim.exchange.superelements import read_superelement
from nassim.systems.control_conversion import to_control
from nassim.systems.linear_model import sampled


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(), n_modes=6, remote_points=["right", "left"], progress=False)


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_round_trips_are_exact(body, ending, tmp_path):
    path = export_body(body, tmp_path / f"new/body.{ending}")
    back = read_superelement(path)
    assert np.array_equal(back.stiffness_matrix, body.stiffness_matrix)
    assert np.array_equal(back.mass_matrix, body.mass_matrix)
    assert np.array_equal(back.positions, [point.position for point in body.remote_points])
    assert back.names == body.point_names
    assert [p.name for p in path.parent.iterdir()] == [path.name], "no temporary file stays"


def test_the_layout_is_simscapes(body, tmp_path):
    """Origins as rows; K, M, C with six rows per origin, then the modes; symmetric, C damping each elastic mode."""
    found = scipy.io.loadmat(export_body(body, tmp_path / "body.mat", damping_ratio=0.02))
    assert found["P"].shape == (2, 3)
    for letter in "KMC":
        assert found[letter].shape == (18, 18)
        assert np.allclose(found[letter], found[letter].T, rtol=1e-12, atol=1e-9)
    motion = np.zeros(18)
    motion[[0, 6]] = 1.0  # Tx of both interfaces
    assert np.abs(found["K"] @ motion).max() < 1e-9 * np.abs(found["K"]).max()
    assert motion @ found["M"] @ motion == pytest.approx(body.mass)
    assert np.abs(found["C"] @ motion).max() < 1e-6 * np.abs(found["C"]).max()
    frequency, shapes = body.eigenmodes()
    ratios = np.einsum("ji,jk,ki->i", shapes, found["C"], shapes)[6:] / (4 * np.pi * frequency[6:])
    assert ratios == pytest.approx(np.full(12, 0.02), rel=1e-9)


def test_each_mode_may_have_its_damping(body):
    frequency, shapes = body.eigenmodes()
    damping = body_damping(body, [0.01, 0.02])
    ratios = np.einsum("ji,jk,ki->i", shapes, damping, shapes)[6:] / (4 * np.pi * frequency[6:])
    assert ratios == pytest.approx([0.01] + [0.02] * 11, rel=1e-9)


def test_the_state_space_is_that_of_the_matrices(body):
    """(K - omega^2 M + i omega C)^-1 by a direct solve."""
    own = 1e-6 * body.stiffness_matrix
    damping = body_damping(body, 0.01) + own
    body = replace(body, readouts={**body.readouts, "damping": BodyDamping(own)})
    np.testing.assert_array_equal(body_damping(body, 0.01), damping)
    model = body_state_space(body, damping_ratio=0.01)
    frequency = np.array([20.0, 300.0, 900.0])
    found = frequency_response(model, frequency)
    assert found.inputs == found.outputs == body.coordinate_names[:12]
    assert model.units == 2 * (3 * ("m",) + 3 * ("rad",))
    for k, omega in enumerate(2 * np.pi * frequency):
        dynamic = body.stiffness_matrix - omega**2 * body.mass_matrix + 1j * omega * damping
        expected = np.linalg.inv(dynamic)[:12, :12]
        size = np.sqrt(np.abs(np.diag(expected)))  # metres and radians
        assert np.abs((found.values[:, :, k] - expected) / np.outer(size, size)).max() < 1e-9


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_models_round_trip_exactly(bench, ending, tmp_path):
    for model, step in ((sampled(linearize(bench), 1e4), 1e-4), (linearize(bench), 0.0)):  # MATLAB's 0: continuous
        path = export_model(model, tmp_path / f"bench.{ending}")
        found = scipy.io.loadmat(path) if ending == "mat" else np.load(path, allow_pickle=False)
        for letter in "ABCD":
            assert np.array_equal(found[letter], getattr(model, letter))
        assert float(np.squeeze(found["Ts"])) == step
    assert [str(name).strip() for name in found["inputs"]] == list(model.inputs)
    assert [str(name).strip() for name in found["outputs"]] == list(model.outputs)


def test_a_body_goes_to_python_control(body):
    model = body_state_space(body, damping_ratio=0.01)
    frequency = np.geomspace(10, 1000, 30)
    system = to_control(model)
    assert system.output_labels == [name.replace(".", "_") for name in model.outputs]
    assert np.allclose(system(2j * np.pi * frequency), frequency_response(model, frequency).values, rtol=1e-8)


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_endings_may_be_in_capitals(body, ending, tmp_path):
    path = export_body(body, tmp_path / f"body.{ending}").rename(tmp_path / f"body.{ending.upper()}")
    assert np.array_equal(read_superelement(path).mass_matrix, body.mass_matrix)


def test_other_endings_are_refused(body, tmp_path):
    with pytest.raises(ValueError, match="unknown file ending"):
        export_body(body, tmp_path / "body.csv")


def test_names_beyond_ascii_survive(body, tmp_path):
    named = replace(body, remote_points=tuple(replace(p, name=f"{p.name} µ-Spitze_ü") for p in body.remote_points))
    for ending in ("mat", "npz"):
        assert read_superelement(export_body(named, tmp_path / f"n.{ending}")).names == named.point_names


def test_negative_damping_is_refused(body, tmp_path):
    for use in (lambda: body_state_space(body, damping_ratio=-0.1), lambda: body_damping(body, -0.1)):
        with pytest.raises(ValueError, match="must not be negative"):
            use()
