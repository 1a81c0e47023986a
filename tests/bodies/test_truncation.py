"""Error figures: estimates of truncation and discretisation against true errors; modes by cut-off and tolerance."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice, make_bar, meshed, pair_forces_and_readings

from models.apa300ml import make_apa300ml
from models.bench import BENCH_CONDITIONS
from nassim import Material, build_fe_model, condense, craig_bampton, frequency_response, linearize, load, save
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.projection import keep_modes, trim_body
from nassim.bodies.reduced_body import SATURATION, relative_errors, unknown_from_first
from nassim.fem.full_model import full_eigenfrequencies, full_frequency_response
from nassim.fem.mesh_error import released_stiffness
from nassim.fem.modes import fixed_interface_modes
from nassim.simulation.linear.truncation import truncation_error

FACTOR = 3.0
APA_CASES = [
    {},
    {"fixed": ["sensor_end"]},
    {"fixed": ["bottom"], "guided": {"top": "z"}, "masses": {"top": 5.0}},
]


@pytest.fixture(scope="module")
def cantilever():
    return condense(build_fe_model(make_bar(), element_size=0.01, order=2, progress=False), progress=False)


def assert_within_factor(estimated, true, negligible=1e-7, too_large=FACTOR):
    """Never more than three times too small, nor `too_large` times too large, where the error is not negligible."""
    for estimate, error in zip(estimated, true, strict=True):
        if error > negligible:
            assert error / FACTOR < estimate < error * too_large


@pytest.mark.parametrize("conditions", APA_CASES, ids=str)
def test_truncation_of_the_apa(apa, apa_condensed, conditions):
    full = full_eigenfrequencies(apa_condensed, n=8 if "fixed" in conditions else 14, progress=False, **conditions)
    n_rigid = int(np.count_nonzero(full < 1.0))
    reduced = apa.eigenfrequencies(**conditions)[: len(full)]
    true = (reduced / np.where(full > 1.0, full, np.inf) - 1)[n_rigid:][:8]
    estimated = apa.truncation_errors(**conditions)
    assert np.all(estimated[:n_rigid] == 0.0)
    assert_within_factor(estimated[n_rigid:][:8], true)


@pytest.mark.parametrize("conditions", APA_CASES, ids=str)
def test_frequencies_without_shapes_are_those_of_the_modes(apa, conditions):
    """They are exactly zero for the same rigid-body modes, and the strain energies of the shapes agree."""
    frequency, shapes = apa.eigenmodes(**conditions)
    alone = apa.eigenfrequencies(**conditions)
    assert np.array_equal(alone == 0.0, frequency == 0.0)
    assert np.allclose(alone, frequency, rtol=1e-11, atol=0.0)
    energy = np.einsum("ij,ij->j", shapes, apa.stiffness_matrix @ shapes)
    assert np.allclose(energy, (2 * np.pi * alone) ** 2, rtol=1e-7, atol=1e-12 * energy.max())


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_modes_within_a_twentieth_are_the_same(share):
    """A body that knows of modes which are lower by so much leaves them out from a twentieth on."""
    body = craig_bampton(lattice(), n_modes=2, progress=False)
    softer, n = np.array(body.stiffness_matrix), 6 * len(body.remote_points)
    softer[n:, n:] /= (1 + 0.05 * share) ** 2
    known = replace(body, enriched=replace(body, stiffness_matrix=softer, enriched=None))
    first = np.sqrt(np.diag(softer)[n:].min()) / (2 * np.pi)
    assert known.valid_frequency == (pytest.approx(first) if share > 1 else np.inf)


def test_a_body_with_fewer_coordinates_keeps_its_discretisation_error():
    """One order more releases 2 % of the energy of every mode, and 2.5 times that is what is left in all."""
    body = craig_bampton(lattice(), n_modes=3, progress=False)
    body = replace(body, released_stiffness=0.02 * body.stiffness_matrix)
    loads = np.zeros((len(body.mass_matrix), 0))
    for fewer in (keep_modes(body, 1), trim_body(body, points=["left"], loads=loads, cutoff_frequency=1e4)):
        np.testing.assert_allclose(fewer.discretization_errors(fixed=["left"]), 0.95**-0.5 - 1, rtol=1e-6)
        np.testing.assert_array_equal(fewer.enriched.mass_matrix, body.enriched.mass_matrix)  # the richest form known


@pytest.mark.parametrize("n_modes", [0, 2, 6])
def test_truncation_of_a_cantilever(cantilever, n_modes):
    body = craig_bampton(cantilever, n_modes=n_modes, progress=False)
    full = full_eigenfrequencies(cantilever, fixed=["left"], n=6, progress=False)
    true = body.eigenfrequencies(fixed=["left"])[:6] / full - 1
    assert true.max() > 1e-4, "a reduction without error would prove nothing"
    assert_within_factor(body.truncation_errors(fixed=["left"], n=6), true)


def test_truncation_of_the_benchs_frf(apa_condensed, bench):
    frequency = np.geomspace(10.0, 1000.0, 40)
    inputs, outputs = pair_forces_and_readings()
    full = full_frequency_response(
        apa_condensed,
        frequency,
        inputs=inputs,
        outputs=outputs,
        damping_ratio=0.01,
        masses={"top": 5.0},
        progress=False,
        **BENCH_CONDITIONS,
    ).frf.values
    reduced = frequency_response(linearize(bench), frequency).values
    true = np.abs(reduced / full - 1).max(axis=2).ravel()
    assert_within_factor(truncation_error(bench, frequency).max(axis=2).ravel(), true)


def test_static_answers_have_no_truncation_error(apa):
    """The enriched body has the same constraint modes, so its compliance is the same."""
    found, expected = (body.compliance(fixed=["bottom"]) for body in (apa, apa.enriched))
    scale = 1 / np.sqrt(np.maximum(np.diag(expected), 1e-30))
    assert np.abs(scale[:, None] * (found - expected) * scale).max() < 1e-9


def test_enriched_body_is_a_richer_basis_of_the_same_model(apa):
    n = len(apa.mass_matrix)
    assert np.array_equal(apa.enriched.mass_matrix[:n, :n], apa.mass_matrix)
    assert np.all(apa.eigenfrequencies() >= apa.enriched.eigenfrequencies()[:n] * (1 - 1e-9) - 0.1)


@functools.cache
def reduced_cantilever(coupling, element_size, order, *, discretization=True):
    solid = make_bar(length=0.08, side=0.012, coupling=coupling)
    model = build_fe_model(solid, element_size=element_size, order=order, progress=False)
    return craig_bampton(model, n_modes=10, discretization=discretization, progress=False)


@pytest.mark.parametrize(
    ("coupling", "order"), [("rbe2", 3), ("rbe3", 2), pytest.param("rbe3", 4, marks=pytest.mark.slow)]
)
def test_discretisation_of_a_cantilever(coupling, order):
    """Against elements half as large and of a higher order."""
    body = reduced_cantilever(coupling, 0.012, order)
    reference = reduced_cantilever(coupling, 0.006, max(4, order + 1), discretization=False)
    true = body.eigenfrequencies(fixed=["left"])[:5] / reference.eigenfrequencies(fixed=["left"])[:5] - 1
    ratio = body.discretization_errors(fixed=["left"], n=5) / true
    assert np.all((ratio > 1.2) & (ratio < 2.6)), ratio


def test_an_error_above_a_half_is_unknown():
    """Elements of order 1 lock: bending is 60 to 80 % too high, of which one order more mends a part."""
    body = reduced_cantilever("rbe2", 0.012, 1)
    reference = reduced_cantilever("rbe2", 0.006, 4, discretization=False)
    true = body.eigenfrequencies(fixed=["left"])[:4] / reference.eigenfrequencies(fixed=["left"])[:4] - 1
    assert true.min() > 0.5
    assert np.all(body.discretization_errors(fixed=["left"], n=4) == np.inf)
    assert "unknown, above 50 %" in "".join(body.record.values())


def test_modes_above_an_unknown_one_are_unknown():
    np.testing.assert_array_equal(unknown_from_first(np.array([0.1, np.inf, 0.2])), [0.1, np.inf, np.inf])
    locked = reduced_cantilever("rbe2", 0.012, 1)
    _, shapes = locked.eigenmodes(fixed=["left"])
    parts = locked.released_stiffness, locked.stiffness_matrix
    released, energy = (np.einsum("ij,ij->j", shapes, part @ shapes) for part in parts)
    assert relative_errors(released / energy, power=0.5).min() < 0.1, "of a mode alone, without those below it"
    assert np.all(locked.discretization_errors(fixed=["left"]) == np.inf)


@pytest.mark.parametrize("order", [2, 3])
def test_discretisation_of_a_held_rod_is_sharp(order):
    """A rod held at both ends, f = c / 2 l: all that its mesh lacks is what one order more removes."""
    length = 0.03
    solid = make_bar(length=length, material=Material("cork", 1e9, 0.0, 200.0))
    model = build_fe_model(
        solid, element_size=0.005, order=order, extrude="x", layer_thickness=length / 4, progress=False
    )
    body = craig_bampton(model, n_modes=8, discretization=True, progress=False)
    held = {"fixed": ["left", "right"]}
    true = body.eigenfrequencies(**held) / (np.sqrt(1e9 / 200.0) / (2 * length)) - 1
    axial = np.argmin(np.abs(true))
    assert 1e-7 < true[axial] < 1e-3
    assert body.discretization_errors(**held)[axial] == pytest.approx(SATURATION * true[axial], rel=0.03)


@pytest.fixture(scope="module")
def fine_apa(apa_prisms):
    """Prisms of order 3: their own error is a sixth of that of tetrahedra, less of that of order 2."""
    return craig_bampton(meshed(apa_prisms, make_apa300ml(), 3), n_modes=16, progress=False)


@pytest.mark.slow
@pytest.mark.parametrize(("order", "kind"), [(2, "tetrahedra"), (3, "tetrahedra"), (2, "prisms")])
def test_discretisation_of_the_apa(order, kind, fine_apa, apa_prisms, apa_tetrahedra):
    """Clamped, as on the bench, and free."""
    mesh = {"tetrahedra": apa_tetrahedra, "prisms": apa_prisms}[kind]
    body = craig_bampton(meshed(mesh, make_apa300ml(), order), n_modes=16, discretization=True, progress=False)
    for conditions in ({"fixed": ["bottom"]}, APA_CASES[2], {}):
        first = 0 if conditions else 6
        n = slice(first, first + 5)
        true = body.eigenfrequencies(**conditions)[n] / fine_apa.eigenfrequencies(**conditions)[n] - 1
        assert_within_factor(body.discretization_errors(**conditions)[n], true, negligible=1e-4)


def test_refined_elements_release_no_stiffness_of_rigid_motions(cantilever):
    frequency, modes = fixed_interface_modes(cantilever, n_modes=2)
    released = released_stiffness(cantilever, frequency, modes)
    points = [c.point.position for c in cantilever.couplings]
    rigid = np.vstack([*(rigid_transfer(p) for p in points), np.zeros((2, 6))])
    assert np.abs(rigid.T @ released @ rigid).max() < 1e-9 * np.abs(released).max()
    assert np.linalg.eigvalsh(released)[0] > -1e-9 * np.abs(released).max()


def test_models_made_by_hand_have_no_discretisation_error():
    with pytest.raises(ValueError, match="not made from a mesh"):
        craig_bampton(lattice(), n_modes=3, discretization=True, progress=False)


def test_tolerance_is_met_with_fewer_modes_when_looser(cantilever):
    tolerances = (1e-1, 1e-2, 1e-3)
    bodies = [craig_bampton(cantilever, tolerance=tolerance, progress=False) for tolerance in tolerances]
    for fixed in ([], ["left"], ["right"]):
        full = full_eigenfrequencies(cantilever, fixed=fixed, n=11, progress=False)
        n_rigid = int(np.count_nonzero(full < 1.0))
        for body, tolerance in zip(bodies, tolerances, strict=True):
            true = body.eigenfrequencies(fixed=fixed)[n_rigid:][:5] / full[n_rigid:][:5] - 1
            assert true.max() < 1.5 * tolerance
    sizes = [body.n_modes for body in bodies]
    assert sizes == sorted(sizes)
    assert sizes[0] < sizes[-1]


def test_tolerance_up_to_a_frequency_needs_fewer_modes(cantilever):
    all_five = craig_bampton(cantilever, tolerance=1e-3, progress=False)
    first = craig_bampton(cantilever, tolerance=1e-3, cutoff_frequency=1000.0, progress=False)
    assert first.n_modes < all_five.n_modes


@pytest.mark.parametrize("other", [{"cutoff_frequency": 100.0}, {"tolerance": 0.01}])
def test_number_of_modes_excludes_the_other_choices(other):
    with pytest.raises(ValueError, match="either n_modes"):
        craig_bampton(lattice(), n_modes=3, progress=False, **other)


@pytest.mark.parametrize("name", ["cutoff_frequency", "tolerance"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_choices_must_be_positive(name, value):
    with pytest.raises(ValueError, match=name):
        craig_bampton(lattice(), progress=False, **{name: value})


def test_body_without_error_figures(apa):
    with pytest.raises(ValueError, match="truncation error is unknown"):
        replace(apa, enriched=None).truncation_errors()
    with pytest.raises(ValueError, match="discretization=True"):
        apa.discretization_errors()


def test_scene_without_error_figures(bench):
    body = bench.body("apa")
    bare = replace(body, reduced=replace(body.reduced, enriched=None))
    scene = replace(bench, bodies=tuple(bare if b.name == "apa" else b for b in bench.bodies))
    with pytest.raises(ValueError, match="'apa' carries no enriched form"):
        truncation_error(scene, np.array([10.0]))


def test_record_says_what_was_kept_and_what_it_costs(apa):
    text = apa.record["coordinates"]
    assert "5 remote points x 6 + 6 fixed-interface modes = 36" in text
    assert "'bottom'" in text
    assert "30 flexible + 6 rigid" in text
    assert any("modes left out" in key for key in apa.record)
    assert any("clamped (estimate)" in key for key in apa.record)


def test_error_figures_survive_saving(apa, tmp_path):
    again = load(save(apa, tmp_path / "apa.h5"))
    assert np.array_equal(again.truncation_errors(fixed=["bottom"]), apa.truncation_errors(fixed=["bottom"]))


def test_keep_modes_is_the_reduction_with_fewer_modes():
    condensed = condense(lattice(), progress=False)
    rich, fewer = (craig_bampton(condensed, n_modes=n, progress=False) for n in (9, 4))
    kept = keep_modes(rich, 4)
    assert kept.coordinate_names == fewer.coordinate_names
    assert np.allclose(kept.eigenfrequencies()[6:], fewer.eigenfrequencies()[6:], rtol=1e-8)
    richest = rich.enriched.eigenfrequencies()[6 : 6 + 10]
    assert np.allclose(kept.truncation_errors()[6:], kept.eigenfrequencies()[6:] / richest - 1)
    for n in (-1, 10):
        with pytest.raises(ValueError, match="has 9 modes, so it cannot keep"):
            keep_modes(rich, n)


def test_a_trimmed_body_knows_what_was_left_out_before():
    """Trimmed of nothing, against the richest form; frequencies by SciPy."""
    body = craig_bampton(lattice(), n_modes=2, progress=False)
    loads = np.zeros((len(body.mass_matrix), 0))
    trimmed = trim_body(body, points=body.point_names, loads=loads, cutoff_frequency=1e9)

    def held(of):
        values = scipy.linalg.eigh(of.stiffness_matrix[6:, 6:], of.mass_matrix[6:, 6:], eigvals_only=True)
        return np.sqrt(values)

    found = trimmed.truncation_errors(fixed=["left"])
    expected = held(body) / held(body.enriched)[: len(found)] - 1
    assert expected.max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


def test_loads_that_all_modes_answer_add_no_coordinates():
    """A point that goes while all modes of what is left stay: the same body, not one with rounding for coordinates."""
    body = craig_bampton(lattice(stiffness=1e6), n_modes=5, progress=False)
    n = len(body.mass_matrix)
    right = np.eye(n)[:, 6:12] @ np.array([[1.0, -0.4, 0.3, 0, 0, 0], [0.2, 0.9, -0.7, 0, 0, 0]]).T
    trimmed = trim_body(body, points=["left"], loads=right, cutoff_frequency=1e6)
    assert len(trimmed.mass_matrix) == n
    np.testing.assert_allclose(trimmed.eigenfrequencies(), body.eigenfrequencies(), rtol=1e-8, atol=1e-6)


def test_length_of_truncation_errors():
    body = craig_bampton(lattice(), n_modes=4, progress=False)
    assert body.truncation_errors().shape == (16,)
    assert body.truncation_errors(n=7).shape == (7,)
    assert np.array_equal(body.truncation_errors(n=7), body.truncation_errors()[:7])
    assert np.all(body.truncation_errors()[:6] == 0.0)


def test_tolerance_up_to_a_cutoff_frequency_is_met(cantilever):
    body = craig_bampton(cantilever, tolerance=1e-3, cutoff_frequency=6000.0, progress=False)
    for fixed in ([], ["left"], ["right"]):
        found = body.eigenfrequencies(fixed=fixed)
        full = full_eigenfrequencies(cantilever, fixed=fixed, n=len(found), progress=False)
        chosen = (full > 1.0) & (found < 6000.0)
        assert np.all(found[chosen] / full[chosen] - 1 < 3e-3)
        assert chosen.any()
