"""What `check` says: of the sample, of sound bodies, and of every defect that a body can be given."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import lattice
from scipy.spatial.transform import Rotation
from superelements import SAMPLE, grounded_at, joint_like, rounded, sample, with_matrices

from nassim import craig_bampton
from nassim.base.rigid_motion import rigid_transfer
from nassim.exchange.inspection import Finding, as_superelement, check
from nassim.exchange.node_positions import motions_without_stiffness, positions_from_motions
from nassim.exchange.repairing import _damaged_node, repair, to_body
from nassim.exchange.row_order import guess_order, order_misfit, rigid_residual
from nassim.exchange.superelements import read_superelement, superelement


@pytest.fixture(scope="module")
def own():
    """A body of two nodes and twelve modes, at full precision."""
    return as_superelement(craig_bampton(lattice(), n_modes=12, progress=False))


def test_the_sample_has_the_beams_figures():
    report = check(sample())
    assert report.verdict == "warning"
    assert {f.name for f in report.findings if f.verdict != "ok"} == {"digits", "rigid motions"}
    assert report["mass"].figures["kg"] == pytest.approx(0.4 * 0.012 * 0.02 * 7850, rel=1e-4)
    assert report["centre of mass"].figures["x_m"] == pytest.approx(0.2, rel=1e-4)
    # About the centre: the lateral moment of a thin bar (its beam elements have no rotary inertia to speak of).
    assert report["inertia"].figures["moment_3_kgm2"] == pytest.approx(0.7536 * 0.4**2 / 12, rel=2e-3)
    assert report["rigid motions"].figures["first_elastic_Hz"] == pytest.approx(398.9, rel=1e-3)
    assert "4 significant digits" in report["digits"].text
    assert "mm-N-t" in report["units"].text


def test_own_bodies_are_clean(own, apa):
    for body in (own, apa, joint_like(own)):
        report = check(body)
        assert report.verdict == "ok", str(report)
    assert check(apa)["mass"].figures["kg"] == pytest.approx(apa.mass, rel=1e-12)
    assert check(apa)["digits"].figures["digits"] == 16
    names = [finding.name for finding in check(apa).findings]
    assert "inertia integrals" not in names, "its integrals are known"
    with pytest.raises(ValueError, match="unknown finding"):
        check(apa)["colour"]
    with pytest.raises(ValueError, match="unknown verdict"):
        Finding("a", "good", "")


def test_coincident_nodes_are_named(own):
    joint = joint_like(own)
    assert "left and right" in check(joint)["nodes"].text
    assert check(joint)["nodes"].verdict == "ok"
    lost = replace(own, positions=np.zeros((2, 3)))
    assert check(lost)["nodes"].verdict == "warning"
    assert check(lost).verdict == "fault"


def test_a_truncated_joint_is_found(own):
    """One node's block damaged, as by cancellation in a text listing."""
    damaged = grounded_at(rounded(joint_like(own), 4), 1, 2.0)
    report = check(damaged)
    assert report["rigid motions"].verdict == "fault"
    assert report["digits"].verdict == "warning"
    for units in ("m-N-kg", "mm-N-t"):
        text = check(replace(damaged, units=units))["row order"].text
        assert text.endswith("errors in the numbers") == units.startswith("m-")
    assert report["mass"].figures["kg"] == pytest.approx(check(own)["mass"].figures["kg"], rel=1e-3)


def orders(body):
    """Orders that other programs use: rows[i] is the standard row that they put in place i."""
    r, n = len(body.positions), len(body.mass_matrix)
    index, modes = np.arange(6 * r).reshape(r, 2, 3), np.arange(6 * r, n)
    turned = np.roll(np.arange(r), 1)
    return {
        "rotations before translations": np.concatenate([index[:, ::-1].ravel(), modes]),
        "translations of all nodes, then all rotations": np.concatenate([index.transpose(1, 0, 2).ravel(), modes]),
        "rotations of all nodes": np.concatenate([index[:, ::-1].transpose(1, 0, 2).ravel(), modes]),
        "direction by direction": np.concatenate([index.reshape(r, 6).T.ravel(), modes]),
        "rx of all nodes first": np.concatenate([index[:, ::-1].reshape(r, 6).T.ravel(), modes]),
        "ux rx uy": np.concatenate([index.transpose(0, 2, 1).ravel(), modes]),
        "axes in the order": np.concatenate([index[:, :, [1, 2, 0]].ravel(), modes]),
        "nodes in the order": np.concatenate([index[turned].ravel(), modes]),
        "modal rows first": np.concatenate([modes, index.ravel()]),
        "modal rows first; rotations before translations": np.concatenate([modes, index[:, ::-1].ravel()]),
    }


@pytest.mark.parametrize("words", orders(sample()))
def test_the_order_of_rows_is_guessed(words):
    body = sample()
    shuffled = body.reordered(orders(body)[words])
    report = check(shuffled)
    assert report["row order"].verdict == "fault"
    for word in words.split("; "):
        assert word in report["row order"].text
    guess = guess_order(shuffled)
    assert guess.misfit < 1e-3
    assert guess.given_misfit > 0.1
    assert np.array_equal(shuffled.reordered(guess.rows).stiffness_matrix, body.stiffness_matrix)
    assert check(shuffled.reordered(guess.rows))["row order"].verdict == "ok"


@pytest.mark.parametrize("name", ["rotations before translations", "translations of all nodes, then all rotations"])
def test_the_order_is_guessed_where_nodes_coincide(own, name):
    """There the stiffness does not tell, but the mass does."""
    joint = joint_like(own)
    shuffled = joint.reordered(orders(joint)[name])
    assert check(shuffled)["row order"].verdict == "fault"
    assert name in check(shuffled)["row order"].text


@pytest.mark.parametrize(("a", "b"), [(1, 3), (0, 4)])
def test_many_nodes(apa, a, b):
    """Five nodes, two of them swapped."""
    body = as_superelement(apa)
    rows = np.arange(36)
    first, second = np.arange(6 * a, 6 * a + 6), np.arange(6 * b, 6 * b + 6)
    rows[first], rows[second] = second, first
    text = check(body.reordered(rows))["row order"].text
    assert f"given, but {body.names[a]} and {body.names[b]} swapped" in text
    backwards = np.concatenate([np.arange(30).reshape(5, 6)[::-1].ravel(), np.arange(30, 36)])
    assert "the nodes in the order last to first" in check(body.reordered(backwards))["row order"].text


def test_no_order_is_claimed_for_noise(own):
    rng = np.random.default_rng(0)
    noise = rng.normal(size=own.mass_matrix.shape)
    assert guess_order(with_matrices(own, lambda matrix: noise @ noise.T)) is None
    assert order_misfit(own) < 1e-10
    assert guess_order(own) is None


@pytest.mark.parametrize(
    ("declared", "truth"),
    [("m-N-kg", "mm-N-t"), ("mm-N-kg", "mm-N-t"), ("in-lbf-slinch", "mm-N-t")],
)
def test_wrong_units_are_diagnosed(declared, truth):
    """The sample is in mm, N, t."""
    report = check(read_superelement(*sorted(SAMPLE.glob("*.txt")), units=declared))
    assert report["units"].verdict == "fault"
    assert f"not plausible; looks like {truth} (0.754 kg, 0.4 m long" in report["units"].text


def test_coordinates_in_another_unit_than_the_matrices_are_found():
    body = sample()
    inch = 0.0254
    for factor, word in ((1e3, "in mm"), (1e-3, "length mm"), (1 / inch, "in inches:"), (inch, "m, not inches")):
        found = check(replace(body, positions=factor * body.positions))["row order"]
        assert found.verdict == "fault"
        assert word in found.text
        assert found.figures["coordinate_factor"] == pytest.approx(1 / factor)


def beam_of_nodes(points):
    """A chain of springs between nodes, each with a lump, with coupled and unequal stiffnesses; no symmetry."""
    rng, r = np.random.default_rng(3), len(points)
    stiffness, mass = np.zeros((6 * r, 6 * r)), np.zeros((6 * r, 6 * r))
    for a, b in zip(range(r - 1), range(1, r), strict=True):
        relative = np.zeros((6, 6 * r))
        relative[:, 6 * b : 6 * b + 6] = np.eye(6)
        relative[:, 6 * a : 6 * a + 6] = -rigid_transfer(points[b] - points[a])
        root = rng.normal(size=(6, 6)) * np.array([3e3] * 3 + [40.0] * 3)
        stiffness += relative.T @ (root.T @ root + np.diag([2e7] * 3 + [3e3] * 3)) @ relative
    for k in range(r):
        mass[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = np.diag([0.2 + 0.05 * k] * 3 + [1e-4, 1.5e-4, 2e-4])
    return superelement(stiffness, mass, points)


POINTS = np.array([[0.0, 0.01, 0.02], [0.05, -0.02, 0.01], [0.11, 0.03, -0.02], [0.15, 0.0, 0.06], [0.22, 0.04, 0.0]])


def in_degrees(body):
    """The same body whose rotations are in degrees: one degree is pi / 180 of the motion of one radian."""
    unit = np.ones(len(body.mass_matrix))
    unit[[6 * k + i for k in range(len(body.positions)) for i in (3, 4, 5)]] = np.pi / 180
    return with_matrices(body, lambda matrix: unit[:, None] * matrix * unit)


MOVED = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [12e-3, 0, 16e-3], [0, 0, 0]])
TURNED_AXES = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
MISFITS = {
    "shuffled": (lambda body: replace(body, positions=POINTS[[2, 0, 3, 4, 1]]), "they fit in the order node_2 node_5"),
    "one 20 mm off": (lambda body: replace(body, positions=POINTS + MOVED), r"node_4 is given 20 mm from \(150.000, "),
    "the first 20 mm off": (
        lambda body: replace(body, positions=POINTS + np.roll(MOVED, 2, axis=0)),
        r"node_1 is given 20 mm from \(-?0\.000, 10\.000, 20\.000\) mm, .* relative to node_2",
    ),
    "two of five off": (
        lambda body: replace(body, positions=POINTS + MOVED + 2 * np.roll(MOVED, 1, axis=0)),
        r"node_4 is given 20 mm from \(150.000, .*; node_5 is given 40 mm from \(220.000, ",
    ),
    "three of five off": (
        lambda body: replace(body, positions=POINTS + sum(k * np.roll(MOVED, k, axis=0) for k in (1, 2, 3))),
        "of other nodes or of another body",
    ),
    "degrees": (in_degrees, "rotations seem to be in degrees"),
    "turned": (lambda body: replace(body, positions=POINTS @ TURNED_AXES.T), "coordinates are turned or mirrored"),
    "of another body": (lambda body: replace(body, positions=POINTS**2 * 7), "of other nodes or of another body"),
    "K in kN/m": (lambda body: replace(body, stiffness_matrix=1e-3 * body.stiffness_matrix), "looks like m-kN-kg"),
    "one node's axes turned": (
        lambda body: with_matrices(body, lambda m: turned_node(m, 2)),
        "along other axes than the body's",
    ),
}


def turned_node(matrix, node):
    change = np.eye(len(matrix))
    for start in (6 * node, 6 * node + 3):
        change[start : start + 3, start : start + 3] = TURNED_AXES
    return change @ matrix @ change.T


@pytest.mark.parametrize("name", MISFITS)
def test_coordinates_that_do_not_fit_are_refused_with_the_likeliest_cause(name, capsys):
    """Where nodes lie follows from the motions that K does not resist, without a look at the coordinates."""
    sound = beam_of_nodes(POINTS)
    assert not check(sound).faults
    assert "impossible" not in str(check(sound))
    spoil, cause = MISFITS[name]
    spoilt = spoil(sound)
    option = "any_size" if name == "K in kN/m" else "any_coordinates"
    with pytest.raises(ValueError, match=f"not fit for use: .*{cause}.* confirm by {option}=True"):
        to_body(spoilt)
    if name in ("K in kN/m", "one 20 mm off", "shuffled"):
        assert to_body(spoilt, **{option: True}).name == spoilt.name
    if option == "any_coordinates":
        with pytest.raises(ValueError, match="cannot be repaired: row order"):
            repair(spoilt)


@pytest.mark.parametrize(("share", "verdict"), [(0.9, "ok"), (1.1, "fault")])
def test_a_node_may_lie_one_percent_of_the_size_away(share, verdict):
    body = beam_of_nodes(POINTS)
    size = check(body)["units"].figures["size_m"]
    moved = POINTS + share * 0.01 * size * np.outer([0, 1, 0, 0, 0], [0.6, 0.0, 0.8])
    found = check(replace(body, positions=moved))["row order"]
    assert found.verdict == verdict
    assert ("node_2 is given" in found.text) == (verdict == "fault")


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_the_least_plausible_stiffness(share):
    """2e-4 of that of a steel cube of the same mass: the largest of a node in translation."""
    body = beam_of_nodes(POINTS)
    mass = check(body)["mass"].figures["kg"]
    largest = max(np.diag(body.stiffness_matrix)[6 * k + i] for k in range(5) for i in range(3))
    factor = share * 2e-4 * 2e11 * (mass / 7800.0) ** (1 / 3) / largest
    found = check(replace(body, stiffness_matrix=factor * body.stiffness_matrix))["units"]
    assert (found.verdict == "fault") == (share < 1)
    assert found.figures["stiffness_over_steel"] == pytest.approx(2e-4 * share, rel=1e-9)


def test_the_stiffness_of_a_long_body_is_that_of_its_translations():
    """Thirty metres, where the numbers of rotations, in N m/rad, are larger."""
    body = beam_of_nodes(30 * POINTS)
    along, about = (np.diag(body.stiffness_matrix).reshape(5, 2, 3)[:, k].max() for k in (0, 1))
    assert about > along
    report = check(body)
    steel = 2e11 * (report["mass"].figures["kg"] / 7800.0) ** (1 / 3)
    assert report["units"].figures["stiffness_over_steel"] == pytest.approx(along / steel, rel=1e-9)


def faults(body):
    return {finding.name for finding in check(body).faults}


def test_every_other_defect_has_its_line(own):
    n = len(own.mass_matrix)
    skewed = np.zeros((n, n))
    skewed[0, 5] = 1e-4 * np.abs(own.stiffness_matrix).max()
    assert faults(replace(own, stiffness_matrix=own.stiffness_matrix + skewed)) >= {"symmetry"}
    assert faults(replace(own, mass_matrix=-own.mass_matrix)) == {"mass matrix"}
    assert faults(replace(own, mass_matrix=np.zeros((n, n)))) == {"mass matrix"}
    heavy = np.array(own.mass_matrix)
    heavy[0, 0] *= 5
    assert "mass" in faults(replace(own, mass_matrix=heavy)), "heavier along x than along y"
    assert "stiffness matrix" in faults(replace(own, stiffness_matrix=-own.stiffness_matrix))
    scaled = np.eye(n)
    scaled[-1, -1] = 2.0
    assert check(with_matrices(own, lambda m: scaled @ m @ scaled))["modal rows"].verdict == "warning"
    coupled = np.array(own.stiffness_matrix)
    coupled[7, -1] = coupled[-1, 7] = 0.1 * np.sqrt(coupled[7, 7] * coupled[-1, -1])
    assert check(replace(own, stiffness_matrix=coupled))["modal rows"].figures["coupling"] == pytest.approx(0.1)
    assert check(replace(own, stiffness_matrix=coupled))["modal rows"].verdict == "warning"
    no_modes = replace(own, stiffness_matrix=own.stiffness_matrix[:12, :12], mass_matrix=own.mass_matrix[:12, :12])
    assert check(no_modes)["range"].verdict == "warning"
    assert "static reduction" in check(no_modes)["modal rows"].text


def test_the_range_is_that_of_the_kept_modes(own):
    held = np.sqrt(own.stiffness_matrix[-1, -1]) / (2 * np.pi)
    assert check(own)["range"].figures["good_to_Hz"] == pytest.approx(held / 1.5)
    assert (
        f"to about {held / 1.5:.5g} Hz: modes with all nodes held are kept to {held:.5g} Hz" in check(own)["range"].text
    )
    # In amplitudes of another size the modal masses are no ones, but the modes are the same.
    scale = np.concatenate([np.ones(12), np.geomspace(0.1, 5.0, own.n_modes)])
    scaled = with_matrices(own, lambda matrix: scale[:, None] * matrix * scale)
    assert check(scaled)["range"].figures["good_to_Hz"] == pytest.approx(held / 1.5)


def test_the_spin_limit_is_a_thirtieth_of_the_first_elastic_frequency(own):
    """In revolutions a minute: 60 / 30 of the frequency in hertz."""
    report = check(own)
    limit = 2 * report["rigid motions"].figures["first_elastic_Hz"]
    assert f"right below some {limit:.3g} rev/min" in report["inertia integrals"].text


@pytest.mark.parametrize(("away", "verdict"), [(0.9 * 0.2, "ok"), (1.1 * 0.2, "warning"), (-1.1 * 0.2, "warning")])
def test_a_centre_of_mass_far_from_all_nodes_is_told(away, verdict):
    """A box of 0.1 m and 2 kg that two nodes 0.2 m apart hold, its centre beside them, all far from the origin."""
    place = np.array([3.0, -2.0, 1.0])
    arms = np.array([[away, -0.1, 0.0], [away, 0.1, 0.0]])
    mass = np.zeros((12, 12))
    for k, (x, y, z) in enumerate(arms):
        to_centre = np.eye(6)
        to_centre[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
        mass[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = to_centre.T @ np.diag([1.0] * 3 + [0.1**2 / 6] * 3) @ to_centre
    body = superelement(np.zeros((12, 12)), mass, place + np.array([[0, 0.1, 0], [0, -0.1, 0]]))
    found = check(body)["centre of mass"]
    assert [found.figures[f"{axis}_m"] for axis in "xyz"] == pytest.approx(place + np.array([away, 0, 0]), abs=1e-12)
    assert found.verdict == verdict
    assert ("; 220 mm outside the nodes" in found.text) == (verdict != "ok")


def test_the_report_reads_line_by_line():
    lines = str(check(sample())).splitlines()
    assert lines[0] == "beam_K: warning"
    assert all(line.split()[0] in ("ok", "warning", "fault") or line.startswith(32 * " ") for line in lines[1:])
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize(("moment", "verdict"), [(1.5, "ok"), (2.0, "ok"), (2.1, "fault")])
def test_no_moment_of_inertia_exceeds_the_sum_of_the_others(moment, verdict):
    """A rigid body of one node, whose moments are 1, 1 and another: at 2 it is a flat plate, beyond it cannot be."""
    body = superelement(np.zeros((6, 6)), np.diag([1.0, 1, 1, 1, 1, moment]), np.zeros((1, 3)))
    report = check(body)
    assert report["inertia"].verdict == verdict
    assert "ffrf" not in report["inertia integrals"].text, "no elastic frequency limits its speed"


def verdict_of(body, name):
    return check(body)[name].verdict


def skewed(body, letter, share):
    """An entry off its mirror image by a share of the largest."""
    matrix = np.array(getattr(body, letter))
    matrix[0, 1] += share * np.abs(matrix).max()
    return replace(body, **{letter: matrix})


def on_a_soft_ground(body, share, sign=1):
    """All rigid motions at a frequency that is this share of the lowest elastic one, which the ground changes too.

    sign: -1 for a ground that pushes away, so that all rigid motions grow.
    """
    first = 2 * np.pi * check(body)["rigid motions"].figures["first_elastic_Hz"]
    square = sign * share**2
    return replace(body, stiffness_matrix=body.stiffness_matrix + square / (1 - square) * first**2 * body.mass_matrix)


def lump(along, moments=(1.0, 1.0, 1.0)):
    return superelement(np.zeros((6, 6)), np.diag([*along, *moments]), np.zeros((1, 3)))


def with_a_mode(mass, coupling):
    """A unit mode whose mass differs from one, or that is tied to a node, by so much."""
    sound = beam_of_nodes(POINTS[:2])
    stiffness, masses = np.zeros((2, 13, 13))
    stiffness[:12, :12], masses[:12, :12] = sound.stiffness_matrix, sound.mass_matrix
    stiffness[12, 12], masses[12, 12] = 1e8, 1 + mass
    stiffness[2, 12] = stiffness[12, 2] = coupling * np.sqrt(1e8 * stiffness[2, 2])
    return superelement(stiffness, masses, POINTS[:2])


def with_a_mode_at(share):
    """A unit mode whose frequency is this share of the lowest elastic one of the body without it."""
    sound = with_a_mode(0.0, 0.0)
    bare = replace(sound, stiffness_matrix=sound.stiffness_matrix[:12, :12], mass_matrix=sound.mass_matrix[:12, :12])
    first = check(bare)["rigid motions"].figures["first_elastic_Hz"]
    stiffness = np.array(sound.stiffness_matrix)
    stiffness[12, 12] = (2 * np.pi * share * first) ** 2
    return replace(sound, stiffness_matrix=stiffness)


def tied(share):
    """One node whose translations along x and y have this share of their inertia in common."""
    mass = np.eye(6)
    mass[0, 1] = mass[1, 0] = share
    return superelement(np.zeros((6, 6)), mass, np.zeros((1, 3)))


BEAM = beam_of_nodes(POINTS)
LIMITS = {
    "symmetry of K, warned of": (lambda x: skewed(BEAM, "stiffness_matrix", 1e-12 * x), "symmetry", "ok", "warning"),
    "symmetry of M, warned of": (lambda x: skewed(BEAM, "mass_matrix", 1e-12 * x), "symmetry", "ok", "warning"),
    "symmetry of K": (lambda x: skewed(BEAM, "stiffness_matrix", 1e-9 * x), "symmetry", "warning", "fault"),
    "symmetry of M": (lambda x: skewed(BEAM, "mass_matrix", 1e-9 * x), "symmetry", "warning", "fault"),
    "rigid motions, warned of": (lambda x: on_a_soft_ground(BEAM, 1e-2 * x), "rigid motions", "ok", "warning"),
    "rigid motions": (lambda x: on_a_soft_ground(BEAM, 0.1 * x), "rigid motions", "warning", "fault"),
    "motions that grow": (lambda x: on_a_soft_ground(BEAM, 0.1 * x, -1), "rigid motions", "warning", "fault"),
    "rows": (lambda x: lump([1 + 0.03 * x / (1 - 0.01 * x), 1, 1], [1, 1.2, 1.4]), "row order", "ok", "warning"),
    "mass": (lambda x: lump([1 + 0.3 * x / (1 - 0.1 * x), 1, 1]), "mass", "ok", "fault"),
    "inertia": (lambda x: lump([1, 1, 1], [1, 1, 2 * (1 + 2e-3 * x)]), "inertia", "ok", "fault"),
    "a motion without inertia": (lambda x: lump([1, 1, 1], [1, 1, 1e-30 * x]), "mass matrix", "fault", "ok"),
    "a definite mass": (lambda x: tied(1 - 6e-13 * x), "mass matrix", "fault", "ok"),
    "the range of a mode": (lambda x: with_a_mode_at(1.5 / x), "range", "ok", "warning"),
    "modal masses": (lambda x: with_a_mode(1e-3 * x, 0.0), "modal rows", "ok", "warning"),
    "coupling of modes": (lambda x: with_a_mode(0.0, 1e-3 * x), "modal rows", "ok", "warning"),
}


@pytest.mark.parametrize("name", LIMITS)
def test_verdicts_change_at_their_limits(name):
    make, finding, below, above = LIMITS[name]
    assert [verdict_of(make(share), finding) for share in (0.9, 1.1)] == [below, above]


def test_negative_eigenvalues_are_repaired_up_to_a_hundredth_of_positive_ones(capsys):
    """Of a mass with unit diagonal, and of an elastic motion against the slowest stable one."""

    def falling(share):
        body = with_a_mode_at(1.0)
        stiffness = np.array(body.stiffness_matrix)
        stiffness[12, 12] *= -0.01 * share
        return replace(body, stiffness_matrix=stiffness)

    for spoilt in (falling, lambda share: tied(1 + 0.01 * share)):
        assert repair(spoilt(0.9)).after["mass matrix"].verdict == "ok"
        with pytest.raises(ValueError, match="no rounding"):
            repair(spoilt(1.1))


def test_as_many_other_orders_are_told_as_there_are():
    """Across nodes on a line along x, y and z may change places; across a line along no axis, nothing may."""
    given = as_superelement(craig_bampton(lattice(), n_modes=2, progress=False))
    turn = Rotation.from_rotvec([0.5, -0.9, 0.4]).as_matrix()
    change = np.eye(14)
    change[:12, :12] = np.kron(np.eye(4), turn)
    askew = with_matrices(given, lambda matrix: change @ matrix @ change.T)
    for body, others in ((given, 1), (replace(askew, positions=given.positions @ turn.T), 0)):
        found = guess_order(body.reordered([3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8, 12, 13]))
        assert (found.text, found.alternatives) == ("rotations before translations at each node", others)


def test_negative_eigenvalues_in_rigid_motions_are_told():
    """A foundation of negative stiffness under all of the body, which moves it far more slowly than it bends."""
    for share, told in ((1e-3, False), (-1e-3, True)):
        first = 2 * np.pi * check(BEAM)["rigid motions"].figures["first_elastic_Hz"]
        foundation = np.sign(share) * (share * first) ** 2 * BEAM.mass_matrix
        finding = check(replace(BEAM, stiffness_matrix=BEAM.stiffness_matrix + foundation))["stiffness matrix"]
        assert finding.verdict == "ok"
        assert ("negative eigenvalues in rigid motions only" in finding.text) == told


def test_eight_digits_are_few():
    assert [verdict_of(replace(BEAM, digits=digits), "digits") for digits in (8, 9)] == ["warning", "ok"]


def test_nodes_within_a_millionth_of_the_size_are_in_one_place():
    def of(distance):
        places = np.vstack([POINTS[:4], POINTS[3] + distance * np.array([0.6, 0.0, 0.8])])
        return check(replace(BEAM, positions=places))

    size = of(0.0)["units"].figures["size_m"]
    assert "in one place: node_4 and node_5" in of(0.9e-6 * size)["nodes"].text
    assert "in one place" not in of(1.1e-6 * size)["nodes"].text


# Limits


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_six_motions_are_rigid_up_to_a_tenth_of_the_lowest_elastic_frequency(share):
    stiffness = np.diag([0.0, 0.0, 0.0, 0.0, 0.0, (0.1 * share) ** 2, 1.0, 4.0])
    motions = motions_without_stiffness(stiffness, np.eye(8))
    assert (motions is not None) == (share < 1)


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("block", [0, 3])
def test_rows_are_those_of_nodes_where_rigid_rotations_agree_to_a_tenth(block, share):
    """The second node 0.2 m along y, turned against the first in its translations or its rotations."""
    second = rigid_transfer(np.array([0.0, 0.2, 0.0]))
    second[block, block + 1] += 0.1 * share
    found = positions_from_motions(np.vstack([np.eye(6), second]), 2)
    if share < 1:
        np.testing.assert_allclose(found, [[0, 0, 0], [0, 0.2, 0]], atol=1e-12)
    else:
        assert found is None


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_one_node_is_damaged_where_others_have_a_hundredth_of_its_residual(share):
    """Two nodes in one place on springs to the ground, whose scaled forces are the roots of their stiffness."""
    body = SimpleNamespace(positions=np.zeros((2, 3)), rigid_motions=np.tile(np.eye(6), (2, 1)))
    stiffness = np.diag(np.repeat([(0.01 * share) ** 2, 1.0], 6))
    assert _damaged_node(stiffness, body) == (1 if share < 1 else None)


def test_another_order_is_sought_from_a_misfit_of_a_fiftieth_on(monkeypatch):
    shuffled = sample().reordered(orders(sample())["direction by direction"])
    for share in (0.9, 1.1):
        monkeypatch.setattr("nassim.exchange.row_order.order_misfit", lambda _, misfit=0.02 * share: misfit)
        assert (guess_order(shuffled) is not None) == (share > 1)


def test_residuals_of_rigid_motions_lie_between_none_and_all_of_the_force():
    """For any signs of stiffness and motions: 1 where nothing balances, at most 1 otherwise, whatever the units."""
    random = np.random.default_rng(6)
    root, motions = random.normal(size=(9, 9)), random.normal(size=(9, 6))
    stiffness, units = root @ root.T, 10.0 ** random.integers(-1, 2, 9)
    assert rigid_residual(np.diag(units), motions) == pytest.approx(np.ones(6))
    found = rigid_residual(stiffness, motions)
    assert np.all((found > 0) & (found < 1))
    assert rigid_residual(stiffness / np.outer(units, units), motions * units[:, None]) == pytest.approx(found)
