"""What every optional argument of reduced bodies and their parts does, and limits a tenth below and above."""

import functools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.linalg
from arguments import check_fields, check_finite, optional_arguments, table
from conftest import assert_limit, lattice

from nassim import ReducedBody, RemotePoint, bodies, craig_bampton
from nassim.base.rigid_motion import rigid_motions
from nassim.bodies import ElectricalPort, PiezoStack, PortCoupling, StressField, StressStiffness, inertia
from nassim.bodies.inertia import RigidInertia, rigid_inertia
from nassim.bodies.projection import open_circuit, project, trim_body
from nassim.bodies.readouts import BodyDamping, PassivePoint, Surface, Trace, by_name
from nassim.bodies.reduced_body import error_text, relative_errors
from nassim.bodies.remote_points import free_coordinates
from nassim.bodies.strain import Strain, has_rigid_modes, stiffness_root, strain_eigenmodes
from nassim.bodies.stress import GaugeStrain, largest_factor

SHEET = {"free_stroke": 20e-6, "blocked_force": 1000.0, "capacitance": 5e-6}
STACK = partial(PiezoStack, **SHEET, voltage_range=200.0, stiffness=50e6, length=20e-3, area=25e-6)
FROM_SHEET = partial(PiezoStack.from_datasheet, **SHEET, voltage_range=200.0, size=(20e-3, 5e-3, 5e-3))
RANDOM = np.random.default_rng(3)
ROWS = RANDOM.standard_normal((14, 4))
STRESSES = RANDOM.standard_normal((1, 6, 4))
MATRICES = (square := RANDOM.standard_normal((14, 4, 4))) + square.transpose(0, 2, 1)
SHAPES = np.random.default_rng(5).standard_normal((14, 4, 4))


@functools.cache
def body():
    """The lattice with two modes, whose finite elements would release one per cent of the energy of each coordinate."""
    plain = craig_bampton(lattice(), n_modes=2, progress=False)
    scale = np.sqrt(np.diag(plain.stiffness_matrix))
    released = np.outer(scale, scale) * np.linspace(0.2, 1.0, 14) * np.linspace(0.2, 1.0, 14)[:, None] * 1e-3
    return replace(plain, released_stiffness=released)


# Data classes


POINT = RemotePoint("right", "right", np.zeros(3))
PASSIVE = PassivePoint(RemotePoint("middle", (), np.zeros(3)), np.ones((6, 6)))
PLAIN = partial(
    ReducedBody, "one", remote_points=(POINT,), mass_matrix=np.eye(6), stiffness_matrix=np.eye(6), gram=np.eye(22)
)
FIELDS = {
    "ElectricalPort": (
        partial(ElectricalPort, "drive", "stack", STACK()), {"direction": (np.eye(3)[0], np.eye(3)[2])}
    ),
    "PiezoStack": (STACK, {"transverse_ratio": (-0.45, -0.3)}),
    "PortCoupling": (partial(PortCoupling, "drive", np.ones(3), 1e-6), {"place": (None, np.arange(3.0))}),
    "RemotePoint": (partial(RemotePoint, "end", "face", np.zeros(3)), {"coupling": ("rbe3", "rbe2")}),
    "StressField": (
        partial(StressField, "top", positions=np.zeros((1, 3)), rows=STRESSES, deviations=STRESSES),
        {"voltages": ({}, {"p": np.ones((1, 6))}),
         "surface": (None, Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([[0, 1]]), ("bar",)))},
    ),
    "StressStiffness": (
        partial(StressStiffness, ROWS, MATRICES, SHAPES),
        {"ports": ((), ("p", "q")), "blocked": (np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))},
    ),
    "ReducedBody": (
        PLAIN,
        {"readouts": ({}, {"middle": PASSIVE}), "record": ({}, {"made": "by hand"}), "enriched": (None, PLAIN()),
         "released_stiffness": (None, np.eye(6)), "full_integrals": (True, False)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_fields_have_their_defaults_and_take_a_value(name):
    check_fields(*FIELDS[name])


@pytest.mark.parametrize("name", FIELDS)
def test_numbers_that_are_not_finite_are_refused(name):
    check_finite(*FIELDS[name])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (partial(FROM_SHEET, free_stroke=0.0), "piezo stack: free_stroke must be positive, got 0"),
        (partial(ElectricalPort, "drive", ("stack", "stack"), STACK()), "CAD body names must differ; .* stack"),
        (partial(BodyDamping, np.ones((2, 3))), "damping: matrix must have shape 2 x 2"),
        (partial(GaugeStrain, "g", row=np.ones((1, 6)), ends=np.zeros((2, 3))), "gauge 'g': row must have shape"),
        (partial(GaugeStrain, "g", row=np.ones(6), ends=np.zeros(3)), "gauge 'g': ends must have shape 2 x 3"),
        (partial(StressField, "s", np.zeros((1, 3)), STRESSES, STRESSES, {"p": np.ones(6)}), "stress by 'p' must have"),
        (partial(largest_factor, np.zeros(6), np.ones(6), -1.0), "limit must be positive, got -1 Pa"),
        (partial(ElectricalPort, "drive", (), STACK()), "electrical port 'drive' names no CAD body"),
        (partial(ElectricalPort, "drive", "stack", STACK(), (0, 0, 0)), "direction must not be zero"),
        (partial(PortCoupling, "drive", np.ones(3), 0.0), "with all strains held its capacitance would be 0 F"),
        (partial(PLAIN, mass_matrix=np.ones((6, 7))), "the mass matrix must be square and symmetric"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# Methods


def dense(of, fixed=(), guided=None, masses=None, n=None):
    """Frequencies [Hz] and mode shapes by SciPy, from the rows and columns that stay."""
    free = free_coordinates(of.point_names, fixed=fixed, guided=guided)
    free = np.concatenate([free, np.arange(12, len(of.mass_matrix))])
    mass = np.array(of.mass_matrix)
    for point, more in (masses or {}).items():
        at = 6 * of.point_names.index(point) + np.arange(3)
        mass[at, at] += more
    squares, vectors = scipy.linalg.eigh(of.stiffness_matrix[np.ix_(free, free)], mass[np.ix_(free, free)])
    frequency = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    shapes = np.zeros((len(mass), len(free)))
    shapes[free] = vectors
    return np.where(frequency > 1.0, frequency, 0.0)[:n], shapes[:, :n]


def frequencies(**conditions):
    return dense(body(), **conditions)[0]


def modes(**conditions):
    return frequencies(**conditions), np.abs(dense(body(), **conditions)[1])


def truncation(n=None, **conditions):
    own, better = frequencies(**conditions), dense(body().enriched, **conditions)[0]
    better = np.where(own > 0, better[: len(own)], 1.0)
    return np.where(own > 0, own / better - 1, 0.0)[:n]


def discretization(**conditions):
    """(1 - 2.5 share of the energy)^(-1/2) - 1."""
    frequency, shapes = dense(body(), **conditions)
    released, energy = (
        np.einsum("ij,ij->j", shapes, matrix @ shapes)
        for matrix in (body().released_stiffness, body().stiffness_matrix)
    )
    share = np.where(frequency > 0, released / np.where(frequency > 0, energy, 1.0), 0.0)
    return (1 - 2.5 * share) ** -0.5 - 1


def compliance(fixed=("left",), guided=None):
    free = free_coordinates(body().point_names, fixed=fixed, guided=guided)
    result = np.zeros((12, 12))
    result[np.ix_(free, free)] = np.linalg.inv(body().stiffness_matrix[np.ix_(free, free)])
    return result


def elastic(modes):
    """Frequencies and elastic shapes without their signs; rigid-body modes may turn among themselves."""
    frequency, shapes = modes
    return frequency, np.abs(shapes) * (frequency > 0)


def rows_of(verb, expected, read=lambda result: result):
    """Rows of a verb with boundary conditions: each changes the result as SciPy says."""

    def law(name, other):
        def holds(before, after):
            pairs = ((before, read(expected())), (after, read(expected(**{name: other}))))
            return all(
                np.allclose(a, b, rtol=1e-5, atol=1e-8 * np.abs(b).max())
                for found, wanted in pairs
                for a, b in zip(*((x if isinstance(x, tuple) else (x,)) for x in (found, wanted)), strict=True)
            )

        return holds

    for name, default, other in (
        ("fixed", (), ["left"]),
        ("guided", None, {"right": "rx"}),
        ("masses", None, {"right": 0.5}),
        ("n", None, 8),
    ):
        yield verb, name, default, other, law(name, other)


def stress_stiffness(body_force=None, voltages=None):
    """Of the twelve body forces, then one voltage; 1, x, y, z one after the other."""
    amplitudes = ROWS @ [0.1, -0.2, 0.3, 0.4]
    if body_force is not None:
        amplitudes[1:13] += np.ravel(body_force, order="F")
    amplitudes[13] += (voltages or {}).get("p", 0.0)
    return np.einsum("k,kij->ij", amplitudes, MATRICES + SHAPES + SHAPES.transpose(0, 2, 1))


HELD = StressField(
    "top", positions=np.zeros((1, 3)), rows=STRESSES, deviations=STRESSES, voltages={"p": np.arange(6.0)[None]}
)
STRESS = StressStiffness(ROWS, MATRICES, SHAPES, ("p",))
FIELD = RANDOM.standard_normal((3, 4))


def stressed(**loads):
    return lambda *results: np.allclose(results, (stress_stiffness(), stress_stiffness(**loads)), rtol=1e-12)


CALLS = {
    "ElectricalPort": lambda **o: ElectricalPort("drive", "stack", STACK(), **o).strain_per_volt * 20e-3 / 1e-7,
    "PiezoStack": lambda **o: ElectricalPort("drive", "stack", STACK(**o)).strain_per_volt * 20e-3 / 1e-7,
    "PiezoStack.from_datasheet": FROM_SHEET,
    "ReducedBody.eigenfrequencies": lambda **o: body().eigenfrequencies(**o),
    "ReducedBody.eigenmodes": lambda **o: elastic(body().eigenmodes(**o)),
    "ReducedBody.truncation_errors": lambda **o: body().truncation_errors(**o),
    "ReducedBody.discretization_errors": lambda **o: body().discretization_errors(**o),
    "ReducedBody.compliance": lambda **o: body().compliance(fixed=["left"], **o),
    "StressField.stress": partial(HELD.stress, [0.1, -0.2, 0.3, 0.4]),
    "StressStiffness.stiffness": partial(STRESS.stiffness, [0.1, -0.2, 0.3, 0.4]),
    "StressStiffness.under": lambda **o: STRESS.under([0.1, -0.2, 0.3, 0.4], **o).first_order,
}
ARGUMENTS = table(
    CALLS,
    [
        (
            "ElectricalPort", "direction", (1, 0, 0), (0, 0, 2),
            lambda *r: np.allclose(r, [np.diag([1, -0.45, -0.45]), np.diag([-0.45, -0.45, 1])]),
        ),
        (
            "PiezoStack", "transverse_ratio", -0.45, -0.3,
            lambda *r: np.allclose(r, [np.diag([1, -0.45, -0.45]), np.diag([1, -0.3, -0.3])]),
        ),
        (
            "PiezoStack.from_datasheet", "stiffness", None, 45e6,
            lambda *r: np.allclose([x.stiffness for x in r], [50e6, 45e6]),
        ),
        (
            "PiezoStack.from_datasheet", "transverse_ratio", -0.45, -0.3,
            lambda *r: [x.transverse_ratio for x in r] == [-0.45, -0.3],
        ),
        *rows_of("ReducedBody.eigenfrequencies", frequencies),
        *rows_of("ReducedBody.eigenmodes", modes, elastic),
        *rows_of("ReducedBody.truncation_errors", truncation),
        *rows_of("ReducedBody.discretization_errors", discretization),
        (
            "ReducedBody.compliance", "guided", None, {"right": "y"},
            lambda *r: np.allclose(r, [compliance(), compliance(guided={"right": "y"})], rtol=1e-6, atol=1e-13),
        ),
        (
            "StressField.stress", "voltages", None, {"p": 7.0, "q": 1.0},
            lambda before, after: np.allclose([before, after - before], [STRESSES @ [0.1, -0.2, 0.3, 0.4],
                                                                         [7 * np.arange(6)]]),
        ),
        ("StressStiffness.stiffness", "body_force", None, FIELD, stressed(body_force=FIELD)),
        ("StressStiffness.stiffness", "voltages", None, {"p": 7.0}, stressed(voltages={"p": 7.0})),
        ("StressStiffness.under", "body_force", None, FIELD, stressed(body_force=FIELD)),
        ("StressStiffness.under", "voltages", None, {"p": 7.0}, stressed(voltages={"p": 7.0})),
    ],
)  # fmt: skip


@pytest.mark.parametrize("case", ARGUMENTS)
def test_an_optional_argument_does_what_it_should(case):
    ARGUMENTS[case].check()


def test_every_optional_argument_is_here():
    rows = {*ARGUMENTS, *(f"{name}: {field}" for name, (_, values) in FIELDS.items() for field in values)}
    of_comparisons = {"compare: fixed", "compare: n", "compare: points", "Comparison: fixed"}  # see test_comparison.py
    assert rows | of_comparisons == optional_arguments(bodies)


# Limits


@pytest.mark.parametrize("name", ["mass", "stiffness"])
def test_matrices_are_symmetric_to_a_billionth(name):
    def asymmetric(share):
        """One entry differs from its mirror image by a share of a billionth."""
        matrix = np.eye(6)
        matrix[0, 1] = 1e-9 * share
        PLAIN(**{f"{name}_matrix": matrix})

    assert_limit(asymmetric, f"the {name} matrix must be square and symmetric")


def test_an_error_is_known_up_to_a_half():
    """A stiffness of which one order more releases so much that the rest is two thirds of it."""
    for share, text in ((0.9, "45 %"), (1.1, "unknown, above 50 %")):
        error = 0.5 * share
        (found,) = relative_errors(np.array([(1 - 1 / (1 + error)) / 2.5]), power=1)
        assert found == (pytest.approx(error) if share < 1 else np.inf)
        assert error_text(found) == text
    assert error_text(-2e-16) == "below 1e-10 %"


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_motion_is_free_below_a_billionth_of_the_strain(share):
    """Two masses of 1 kg, a stiff spring on one, and one that is soft by its row on the other."""
    rows = np.diag([1.0, 1e-9 * share])
    frequency, _ = strain_eigenmodes(Strain(rows, 100.0 * np.diag([1.0, 1.0])), np.eye(2))
    assert np.count_nonzero(frequency == 0.0) == (share < 1)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_body_is_free_where_rigid_motions_cost_a_hundred_billionth_of_the_largest_force(share):
    """A spring to the ground at one point; the law of the forces follows from their definition."""
    plain, mass = body().stiffness_matrix, body().mass_matrix
    scale = 1 / np.sqrt(np.diag(mass))
    motions = rigid_motions(body().positions, len(mass)) / scale[:, None]

    def worst(stiffness):
        scaled = scale[:, None] * stiffness * scale
        forces = np.linalg.norm(scaled @ motions, axis=0) / np.linalg.norm(motions, axis=0)
        return forces.max() / np.linalg.norm(scaled)

    ground = np.diag(np.eye(14)[1])
    size = 1e-3 * plain[1, 1]  # far above rounding, far below the body's own
    spring = share * 1e-11 * size / (worst(plain + size * ground) - worst(plain))
    assert worst(plain + spring * ground) == pytest.approx(share * 1e-11, rel=0.05)
    assert has_rigid_modes(plain + spring * ground, mass, body().positions) == (share < 1)
    assert not has_rigid_modes(plain, mass, np.zeros((0, 3)))


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_load_shape_that_modes_hold_but_for_a_ten_billionth_of_its_energy_is_left_out(share):
    """Two masses on springs to a held point, one of them faster than all modes that are kept."""
    n = 8
    mass, stiffness = np.eye(n), np.eye(n)
    stiffness[6, 6], stiffness[7, 7] = (2 * np.pi * 10) ** 2, (2 * np.pi * 100) ** 2
    simple = PLAIN(mass_matrix=mass, stiffness_matrix=stiffness, gram=np.eye(4 + 3 * n))
    # Energies of the two shares of a load f: f^2 / 2 k.
    load = np.zeros((n, 1))
    load[6], load[7] = 2 * np.pi * 10, 2 * np.pi * 100 * np.sqrt(share * 1e-10)
    trimmed = trim_body(simple, points=["right"], loads=load, cutoff_frequency=50.0)
    assert trimmed.n_modes == (1 if share < 1 else 2)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_modes_of_a_projection_rest_in_rigid_motions_to_a_millionth(share):
    """A modal coordinate that moves with a point by less is rounding, and no force resists the body's rigid motions."""
    plain = body()
    change = np.eye(len(plain.mass_matrix))
    change[-1, 0] = 1e-6 * share
    found = project(plain, change, points=plain.point_names)
    assert has_rigid_modes(found.stiffness_matrix, found.mass_matrix, found.positions) == (share < 1)


def flat_box(share):
    """A box of unit mass, 20 mm long, the square of whose thickness is a share of 1e-5 of that of its length."""
    squares = 0.02**2 * np.array([1e-5 * share, 0.5, 1.0])
    return RigidInertia(1.0, np.zeros(3), np.diag((squares.sum() - squares) / 12), 0.0)


def test_a_box_is_flat_below_a_hundred_thousandth_of_the_square_of_its_length():
    assert np.isnan(flat_box(0.9).box_density)
    assert flat_box(1.1).box_density == pytest.approx(0.02**-3 / np.sqrt(0.5 * 1.1e-5))


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_points_span_a_direction_from_a_millionth_of_the_bodys_size(share):
    """Four point masses along x, beside their line by so little; sizes are radii of gyration and root sums of squares.

    Only from there on they tell of strain along y.
    """
    positions = np.zeros((4, 3))
    positions[:, 0] = [-2.0, -1.0, 1.0, 2.0]
    positions[:, 1] = share * 1e-6 * np.sqrt(2 * 10 / 4) * np.array([0.5, -0.5, -0.5, 0.5])
    mass = np.diag(np.tile([1.0] * 3 + [1e-9] * 3, 4))
    strains = inertia._homogeneous_strains(mass, positions, rigid_inertia(mass, rigid_motions(positions, 24)))
    # Of a homogeneous strain, each point shows a share that is its arm over the sum of squares.
    np.testing.assert_allclose(strains[0, ::6, 0], positions[:, 0] / 10.0, rtol=1e-6)
    assert (np.abs(strains[1]).max() > 1e-6) == (share > 1)


# What errors planted here have shown


def test_guessed_strains_need_no_more_inertia_than_there_is_and_no_less():
    """Masses of points that are coupled at random, whose homogeneous strains would need more than the matrix holds."""
    random = np.random.default_rng(0)
    positions, noise = random.uniform(-1, 1, (3, 3)), random.standard_normal((18, 18))
    scale = np.sqrt(np.tile([1.0] * 3 + [0.05] * 3, 3))
    mass = np.diag(scale**2) + 0.4 * scale[:, None] * scale * (noise @ noise.T) / 18
    motions = rigid_motions(positions, 18)
    rigid = rigid_inertia(mass, motions)
    strains = inertia._homogeneous_strains(mass, positions, rigid)
    central = 0.5 * np.trace(rigid.central_inertia) * np.eye(3) - rigid.central_inertia
    needed = np.einsum("ajb,ac,ckb->jk", strains, central, strains)
    free = inertia.elastic_basis(mass, motions)
    shares = scipy.linalg.eigh(free.T @ needed @ free, free.T @ mass @ free, eigvals_only=True)
    assert shares[-1] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("ports", [(), ("a", "b")])
def test_a_trimmed_body_has_the_stress_of_body_forces_that_its_coordinates_lack(ports):
    """Held at one point under a body force: the geometric stiffness of the whole body, whatever it is, projected."""
    random = np.random.default_rng(1)
    plain, n = craig_bampton(lattice(), n_modes=4, progress=False), 16
    n_cases = n + 12 + len(ports)
    matrices = random.standard_normal((n_cases, n, n))
    matrices[:n] *= 1e6  # deformation of some micrometres counts beside the body force itself
    stress = StressStiffness(np.eye(n_cases, n), matrices + matrices.transpose(0, 2, 1), 2 * matrices, ports)
    whole = replace(plain, readouts=by_name([stress, Trace(np.eye(n))]))
    trimmed = trim_body(whole, points=["left"], loads=np.zeros((n, 0)), cutoff_frequency=plain.eigenfrequencies(
        fixed=["left"])[3] + 1.0)  # fmt: skip
    assert 6 < len(trimmed.mass_matrix) < n
    field = random.standard_normal((3, 4))
    found = []
    for one in (whole, trimmed):
        load = np.einsum("kjc,ck->j", one.gram[:4, 4:].reshape(4, -1, 3), field)
        rest = np.zeros(len(load))
        rest[6:] = np.linalg.solve(one.stiffness_matrix[6:, 6:], load[6:])
        found.append(one.stress_stiffness.stiffness(rest, field))
    change = trimmed.readouts["trace"].rows
    expected = change.T @ found[0] @ change
    np.testing.assert_allclose(found[1], expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_an_open_port_stiffens_a_body_its_richer_form_and_its_statics():
    """V = -b q / (c + cable) adds b b^T / (c + cable), by which modes take part in static motion."""
    random = np.random.default_rng(2)
    plain = craig_bampton(lattice(), n_modes=2, progress=False)

    def with_port(one):
        forces = 0.1 * np.sqrt(np.diag(one.stiffness_matrix)) * random.standard_normal(len(one.mass_matrix))
        return replace(one, readouts=by_name([PortCoupling("p", forces, 1.5)]))

    whole = replace(with_port(plain), enriched=with_port(plain.enriched))
    opened = open_circuit(whole, {"p": 0.5})
    for before, after in ((whole, opened), (whole.enriched, opened.enriched)):
        (port,) = before.ports
        added = np.outer(port.forces, port.forces) / 2.0
        np.testing.assert_allclose(after.stiffness_matrix, before.stiffness_matrix + added, rtol=1e-12)
    inner = np.linalg.inv(opened.stiffness_matrix[6:, 6:])[:6, :6]
    np.testing.assert_allclose(opened.compliance(fixed=["left"])[6:, 6:], inner, rtol=1e-6, atol=1e-9 * inner.max())


def test_a_passive_point_becomes_a_remote_point_again():
    """Its motion as coordinates in place of that of the point that was kept; the body stays the same."""
    n = len(body().mass_matrix)
    loads = np.eye(n)[:, 6:12]
    trimmed = trim_body(body(), points=["left"], loads=loads, cutoff_frequency=1e6)
    assert trimmed.passive_points == (body().point("right"),)
    m = len(trimmed.mass_matrix)
    others = np.linalg.svd(trimmed.motion("right"))[2][6:]
    swapped = project(trimmed, np.linalg.inv(np.vstack([trimmed.motion("right"), others])), points=["right"])
    assert (swapped.point_names, swapped.passive_points) == (("right",), (body().point("left"),))
    np.testing.assert_allclose(swapped.eigenfrequencies(), trimmed.eigenfrequencies(), rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(
        swapped.eigenfrequencies(fixed=["right"]), dense(body(), fixed=["right"])[0][: m - 6], rtol=1e-3
    )


def test_bodies_may_have_coordinates_without_mass():
    assert PLAIN(mass_matrix=np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])).mass_matrix[3, 3] == 0.0
    with pytest.raises(ValueError, match="diagonal of the mass matrix holds -1"):
        PLAIN(mass_matrix=-np.eye(6))


def test_voltages_that_follow_coordinates_add_up():
    rows = RANDOM.standard_normal((2, 4))
    twice = STRESS.with_voltage_rows({"p": rows[0], "other": rows[1]}).with_voltage_rows({"p": rows[1]})
    np.testing.assert_allclose(twice.rows[13], ROWS[13] + rows[0] + rows[1], rtol=1e-12)
    np.testing.assert_array_equal(twice.rows[:13], ROWS[:13])


@pytest.mark.parametrize(("rest", "n_strains"), [(4.4e-16, 1), (1e-12, 2)])
def test_a_stiffness_that_is_positive_by_rounding_alone_has_no_strain_there(rest, n_strains):
    """Two coordinates on one spring, beside a second spring of a share of its stiffness."""
    stiffness = np.array([[1.0, 1.0], [1.0, 1.0 + rest]])
    strains, root = stiffness_root(stiffness, n_points=0)
    assert len(strains) == len(root) == n_strains
    np.testing.assert_allclose(root.T @ root, stiffness, rtol=1e-14)


def test_rounding_of_forces_is_told_from_soft_hinges():
    """A rod between soft hinges: 1e-9 N/m across is rounding of 1e8 N/m along it, 1e-7 N m/rad of a hinge is not."""
    stiffness = np.diag([1e8, 1e-9, 1e-9, 1e-7, 1e-7, 1e-21])
    strains, root = stiffness_root(stiffness, n_points=6)
    np.testing.assert_array_equal(np.flatnonzero(np.any(strains, axis=0)), [0, 3, 4])
    np.testing.assert_allclose(root.T @ root, np.where(stiffness > 1e-8, stiffness, 0.0), rtol=1e-14)


def charged():
    """The lattice with two electrical ports and their stress."""
    ports = [PortCoupling(name, RANDOM_FORCES[k], 1e-6 * (1 + k)) for k, name in enumerate("pq")]
    stress = StressField(
        "s", np.zeros((1, 3)), rows=MORE_ROWS, deviations=MORE_ROWS, voltages=dict(zip("pq", BLOCKED, strict=True))
    )
    return replace(body(), enriched=None, readouts=by_name([*ports, stress]))


RANDOM_FORCES = 1e-2 * np.random.default_rng(7).standard_normal((2, 14))
MORE_ROWS = np.random.default_rng(8).standard_normal((1, 6, 14))
BLOCKED = np.random.default_rng(9).standard_normal((2, 1, 6))


def test_several_at_once_are_one_after_the_other():
    """Ports opened, voltages and masses; in either order."""
    both = open_circuit(charged(), {"p": 0.0, "q": 1e-6})
    for order in ("pq", "qp"):
        one = charged()
        for name in order:
            one = open_circuit(one, {name: {"p": 0.0, "q": 1e-6}[name]})
        np.testing.assert_allclose(one.stiffness_matrix, both.stiffness_matrix, rtol=1e-12)
        np.testing.assert_allclose(one.readouts["s"].rows, both.readouts["s"].rows, rtol=1e-12)
    field, q = charged().readouts["s"], np.arange(14.0)
    single = [field.stress(q, {name: volts}) - field.stress(q) for name, volts in (("p", 2.0), ("q", -3.0))]
    np.testing.assert_allclose(field.stress(q, {"q": -3.0, "p": 2.0}) - field.stress(q), sum(single), rtol=1e-9)
    stiffness = StressStiffness(ROWS, MATRICES, SHAPES, ports=("p", "q"))
    at_rest, volts = np.zeros(4), {"p": 2.0, "q": -3.0}
    found = stiffness.under(at_rest, voltages=volts)
    singles = [stiffness.under(at_rest, voltages={name: value}) for name, value in volts.items()]
    np.testing.assert_allclose(found.stress, singles[0].stress + singles[1].stress, rtol=1e-12)
    masses = {"left": 1e-3, "right": 4e-3}
    np.testing.assert_allclose(body().eigenfrequencies(masses=masses), dense(body(), masses=masses)[0], rtol=1e-6)
