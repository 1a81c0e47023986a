"""Repairing superelements and using them: against the body that was spoilt, and in scenes."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from superelements import SAMPLE, grounded_at, joint_like, rounded, sample, with_matrices

from models.bench import make_bench, make_passive_bench
from nassim import craig_bampton, frequency_response, linearize, load, save, simulate, static_response
from nassim.exchange.export import export_body
from nassim.exchange.inspection import as_superelement, check
from nassim.exchange.repairing import repair, to_body
from nassim.exchange.superelements import read_superelement
from nassim.signals.excitations import band_limited_noise
from nassim.simulation.model.assembly import assemble
from nassim.simulation.run.simulate import exudyn_eigenfrequencies

SAMPLE_FREQUENCIES = [398.9, 664.9, 1107.9, 1846.5, 2171.3]
"""Of the beam model that the sample was made from, before its matrices were cut to four digits [Hz]."""


@pytest.fixture(scope="module")
def own():
    return as_superelement(craig_bampton(lattice(), n_modes=12, progress=False))


def sample_in(units):
    return read_superelement(*sorted(SAMPLE.glob("*.txt")), units=units)


def elastic(body):
    return to_body(body).eigenfrequencies()[6:]


def test_the_sample_has_the_beams_frequencies(capsys):
    """Four digits in K are up to 1e-4 in a frequency; before the repair and after."""
    for body in (sample(), repair(sample()).body):
        assert elastic(body)[:5] == pytest.approx(SAMPLE_FREQUENCIES, rel=5e-4)
        assert to_body(body).mass == pytest.approx(0.7536, rel=1e-4)


@pytest.mark.parametrize("digits", [4, 5])
@pytest.mark.parametrize("apart", [True, False], ids=["nodes apart", "nodes in one place"])
def test_rounded_matrices_are_repaired(own, digits, apart, capsys):
    """Rigid modes below 1 Hz, elastic ones within 0.1 % of those of the file and of the body before rounding."""
    exact = own if apart else joint_like(own)
    # A joint's two blocks differ in sign only, so they would be rounded alike: it is spoilt before.
    spoilt = rounded(own, digits) if apart else joint_like(rounded(own, digits))
    before = check(spoilt)["rigid motions"].figures["highest_Hz"]
    mended = repair(spoilt)
    assert before > 1.0
    assert mended.after["rigid motions"].figures["highest_Hz"] < 0.03
    assert np.abs(mended.elastic_shift).max() < 1e-3
    assert np.abs(mended.elastic_after / elastic(exact) - 1).max() < 1e-3
    assert mended.after["rigid motions"].verdict == "ok"


def test_bodies_have_symmetric_matrices_where_those_of_the_file_hardly_are(own):
    skewed = np.triu(np.full_like(own.mass_matrix, 1e-11), 1)
    given = {name: getattr(own, name) for name in ("stiffness_matrix", "mass_matrix")}
    body = to_body(replace(own, **{name: m + skewed * np.abs(m).max() for name, m in given.items()}))
    for name, matrix in given.items():
        found, largest = getattr(body, name), np.abs(matrix).max()
        np.testing.assert_array_equal(found, found.T)
        np.testing.assert_allclose(found, matrix + 0.5 * largest * (skewed + skewed.T), rtol=0, atol=1e-14 * largest)


def test_a_long_repair_is_told_shortly(own, capsys):
    """Of all elastic frequencies the ten lowest and the one that moved most; lines fit a terminal."""
    mended = repair(rounded(own, 4))
    lines = str(mended).splitlines()
    n, largest = len(mended.elastic_shift), int(np.argmax(np.abs(mended.elastic_shift)))
    assert lines[0] == f"{own.name}: {len(mended.steps)} repair(s), {mended.before.verdict} -> {mended.after.verdict}"
    assert lines[1] == f"  {mended.steps[0]}"
    for name, key, unit in (
        ("rigid motions", "highest_Hz", "Hz, highest of six rigid motions"),
        ("rigid motions", "residual", "K R over its terms"),
        ("mass", "kg", "kg, mass"),
    ):
        (line,) = [line for line in lines if line.endswith(f"  {unit}")]
        figures = [report[name].figures[key] for report in (mended.before, mended.after)]
        assert [float(word) for word in line.removesuffix(unit).split("->")] == pytest.approx(figures, rel=1e-5)
    told = [line for line in lines if "Hz, elastic" in line]
    moved = str(replace(mended, elastic_after=1.01 * mended.elastic_before))
    assert f"{mended.elastic_before[0]:.6g} -> {1.01 * mended.elastic_before[0]:12.6g}  Hz, elastic (+1 %)" in moved
    first, *rest = mended.before.findings
    worse = replace(mended.before, findings=(replace(first, verdict="fault"), *rest))
    assert str(replace(mended, before=worse)).splitlines()[0].endswith(f", fault -> {mended.after.verdict}")
    assert n > 11
    assert len(told) == (10 if largest < 10 else 11)
    assert f"({100 * mended.elastic_shift[largest]:+.2g} %" in "\n".join(told)
    assert lines[-1] == f"  and {n - len(told)} more elastic ones, which moved less"
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 100


def test_damage_in_one_nodes_rows_is_removed_altogether(own, capsys):
    """Whatever is wrong with K's block of one node, the other rows determine it."""
    exact = joint_like(own)
    spoilt = grounded_at(exact, 1, 3.0)
    with pytest.raises(ValueError, match=r"not fit for use: rigid motions: .* repair"):
        to_body(spoilt)
    mended = repair(spoilt)
    assert "in the rows of right" in mended.steps[0]
    size = np.abs(exact.stiffness_matrix).max()
    assert np.abs(mended.body.stiffness_matrix - exact.stiffness_matrix).max() < 1e-12 * size
    # Spread over the nodes, the same damage leaves a trace: the file's own elastic frequencies are off.
    assert np.abs(mended.elastic_shift).max() > 0.1


def test_nothing_is_repaired_silently(own, capsys):
    repair(rounded(own, 4))
    printed = capsys.readouterr().out
    for words in (
        "projected out of K",
        "highest of six rigid motions",
        "K R over its terms",
        "kg, mass",
        "Hz, elastic (",
    ):
        assert words in printed


def test_sound_bodies_are_left_alone(own, apa, capsys):
    assert repair(own).steps == ()
    assert np.array_equal(repair(own).body.stiffness_matrix, own.stiffness_matrix)
    mended = repair(apa)
    assert mended.steps == ()
    assert mended.body.full_integrals
    assert np.array_equal(mended.body.gram, apa.gram)


def test_asymmetry_is_repaired(own, capsys):
    rng = np.random.default_rng(0)
    noise = 1e-6 * rng.normal(size=own.mass_matrix.shape)
    spoilt = with_matrices(own, lambda matrix: matrix * (1 + noise))
    assert check(spoilt)["symmetry"].verdict == "fault"
    mended = repair(spoilt)
    assert sum("made symmetric" in step for step in mended.steps) == 2
    assert mended.after["symmetry"].verdict == "ok"
    assert elastic(mended.body) == pytest.approx(elastic(own), rel=1e-4)


def test_definiteness_is_restored(own, capsys):
    """A mode whose inertia rounding has made negative, and one whose stiffness it has."""
    mass = np.array(own.mass_matrix)
    values, vectors = np.linalg.eigh(mass)
    light = (vectors * np.concatenate([[-1e-9 * values[0]], values[1:]])) @ vectors.T
    mended = repair(replace(own, mass_matrix=light))
    assert any("M made positive definite" in step for step in mended.steps)
    assert mended.after["mass matrix"].verdict == "ok"

    frequency, shapes = to_body(own).eigenmodes()
    first = own.mass_matrix @ shapes[:, 6]
    square = (2 * np.pi * frequency[6]) ** 2
    soft = replace(own, stiffness_matrix=own.stiffness_matrix - (1 + 1e-4) * square * np.outer(first, first))
    assert "stiffness matrix" in {finding.name for finding in check(soft).faults}
    mended = repair(soft)
    assert any("made positive" in step for step in mended.steps)
    assert check(mended.body)["stiffness matrix"].verdict == "ok"
    # The square was -1e-4 of the true one, and is as large above zero; no other motion is touched.
    assert mended.elastic_before[0] == pytest.approx(-1e-2 * frequency[6], rel=1e-6)
    assert mended.elastic_after[0] == pytest.approx(1e-2 * frequency[6], rel=1e-6)
    np.testing.assert_allclose(mended.elastic_after[1:], frequency[7:], rtol=1e-9)


def least_inertia(mass):
    """Least eigenvalue where the diagonal is scaled to ones."""
    scale = np.sqrt(np.diag(mass))
    return np.linalg.eigvalsh(mass / np.outer(scale, scale))[0]


@pytest.mark.parametrize("size", [1e-6, 1e-8])
def test_negative_inertia_becomes_as_large_above_zero(own, size, capsys):
    """Whatever rounding has taken away, it may as well have added: as many digits of a mass matrix are left."""
    scale = np.sqrt(np.diag(own.mass_matrix))
    values, vectors = np.linalg.eigh(own.mass_matrix / np.outer(scale, scale))
    unit = (vectors * np.concatenate([[-size], values[1:]])) @ vectors.T
    spoilt = scale[:, None] * unit * scale
    mended = repair(replace(own, mass_matrix=spoilt)).body.mass_matrix
    assert least_inertia(spoilt) < -size
    assert least_inertia(mended) == pytest.approx(-least_inertia(spoilt), rel=1e-3)


def test_what_is_no_rounding_is_not_repaired(own):
    n = len(own.mass_matrix)
    rows = np.concatenate([np.arange(12).reshape(2, 2, 3)[:, ::-1].ravel(), np.arange(12, n)])
    for spoilt, message in (
        (sample().reordered([*range(6, 12), *range(6), *range(12, 22)]), "row order: wrong"),
        (own.reordered(rows), "row order: wrong"),
        (replace(own, mass_matrix=-own.mass_matrix), "the diagonal of M holds"),
        (replace(own, stiffness_matrix=-own.stiffness_matrix), "negative stiffness in elastic motion"),
        (replace(own, mass_matrix=own.mass_matrix - 0.9 * np.diag(np.diag(own.mass_matrix))), "no rounding"),
    ):
        with pytest.raises(ValueError, match=f"cannot be repaired: .*{message}"):
            repair(spoilt)


def test_a_reduced_body_is_repaired_as_one(apa, capsys):
    spoilt = replace(
        apa, stiffness_matrix=rounded(as_superelement(apa), 4).stiffness_matrix, released_stiffness=None, enriched=None
    )
    mended = repair(spoilt)
    assert type(mended.body) is type(apa)
    assert np.array_equal(mended.body.gram, apa.gram)
    assert mended.after["rigid motions"].figures["highest_Hz"] < 1.0
    assert np.abs(mended.elastic_shift).max() < 1e-3


def test_a_body_whose_mass_is_repaired_has_the_integrals_of_that(apa, capsys):
    """They are those of the new mass matrix, and a guess where that does not tell."""
    noise = 1e-10 * np.random.default_rng(1).normal(size=apa.mass_matrix.shape)
    spoilt = replace(apa, mass_matrix=apa.mass_matrix * (1 + noise), enriched=None)
    mended = repair(spoilt).body
    assert not mended.full_integrals
    n = len(mended.mass_matrix)
    trace = np.einsum("jckc->jk", mended.gram[4:, 4:].reshape(n, 3, n, 3))
    scale = np.sqrt(np.outer(np.diag(mended.mass_matrix), np.diag(mended.mass_matrix)))
    np.testing.assert_allclose(trace / scale, mended.mass_matrix / scale, rtol=0, atol=1e-14)


@pytest.mark.parametrize("apart", [True, False], ids=["nodes apart", "nodes in one place"])
def test_imported_bodies_run_in_both_fidelities(own, apart, capsys):
    """On the bench with a payload: equal frequencies and sag, in Exudyn and by hand."""
    body = to_body(own if apart else repair(grounded_at(joint_like(own), 1, 3.0)).body)
    axis = "x" if apart else "z"
    expected = body.eigenfrequencies(fixed=["left"], guided={"right": axis}, masses={"right": 2.0}, n=3)
    for fidelity in ("linear", "ffrf"):
        scene = make_passive_bench(body, payload_mass=2.0, fidelity=fidelity)
        assert assemble(scene).modal.frequency[:3] == pytest.approx(expected, rel=1e-9)
        assert exudyn_eigenfrequencies(scene, n_modes=3) == pytest.approx(expected, rel=1e-6)
        coordinate = body.coordinate_names.index(f"right.u{axis}")
        compliance = body.compliance(fixed=["left"], guided={"right": axis})[coordinate, coordinate]
        fall = np.zeros(len(body.mass_matrix))
        fall[[k for k, name in enumerate(body.coordinate_names) if name.endswith(f".u{axis}")]] = -9.81
        # The payload's weight, and the part of the body's own that its end carries.
        carried = -9.81 * 2.0 + (body.mass_matrix @ fall)[coordinate]
        assert static_response(scene)["encoder"] == pytest.approx(compliance * carried, rel=1e-6)


def test_the_passive_bench_needs_two_ends():
    with pytest.raises(ValueError, match="3 remote points"):
        make_passive_bench(to_body(sample()))


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_our_own_36_coordinates_come_back_with_the_same_frfs(apa, ending, tmp_path):
    """Exported, imported, put on the bench in small motion: the same FRFs and the same time history."""
    back = to_body(read_superelement(export_body(apa, tmp_path / f"apa.{ending}")))
    assert len(back.mass_matrix) == 36
    assert not back.full_integrals
    frequency = np.geomspace(1.0, 2000.0, 400)
    old, new = (make_bench(apa=body, fidelity="linear") for body in (apa, back))
    reference = frequency_response(linearize(old), frequency).values
    found = frequency_response(linearize(new), frequency).values
    assert np.abs(found / reference - 1).max() < 1e-9
    noise = band_limited_noise(0.05, 1e4, cutoff_frequency=300.0, rms=0.1)
    # With all modes in both: how far they can be trusted is no part of the matrices.
    scenes = [replace(scene, quasi_static_above=np.inf) for scene in (old, new)]
    histories = [simulate(scene, noise, time_step=1e-4, method="exact", progress=False) for scene in scenes]
    scale = np.abs(histories[0].values).max(axis=1, keepdims=True)
    assert np.abs((histories[1].values - histories[0].values) / scale).max() < 1e-9


@pytest.mark.parametrize("units", ["m-N-kg", "mm-N-kg", "m-N-t", "in-lbf-slinch", "ft-lbf-slug"])
def test_units_that_were_forgotten_are_refused(units):
    """The sample is in mm, N and t, 0.754 kg and 0.4 m: as m, N and kg it would weigh 0.75 g and be 400 m long."""
    strange = sample_in(units)
    with pytest.raises(
        ValueError, match=r"not fit for use: units: .* looks like mm-N-t \(0.754 kg, 0.4 m.*any_size=True"
    ):
        to_body(strange)
    assert to_body(strange, any_size=True).mass == pytest.approx(check(strange)["mass"].figures["kg"])


def test_confirmed_units_confirm_nothing_else():
    grounded = grounded_at(sample_in("m-N-kg"), 0, 5.0)
    with pytest.raises(ValueError, match="not fit for use: rigid motions"):
        to_body(grounded, any_size=True)


def test_imported_bodies_are_saved_and_loaded(own, tmp_path):
    body = to_body(own)
    back = load(save(body, tmp_path / "body.h5"))
    assert not back.full_integrals
    assert np.array_equal(back.gram, body.gram)
    assert back.point_names == body.point_names


def test_imported_bodies_say_so(own):
    body = to_body(own)
    assert body.surface is None
    assert body.record["imported from"] == own.source
    assert "rigid motions" in body.record["inspection"]
    assert check(body)["inertia integrals"].figures["spin_limit_Hz"] > 0
