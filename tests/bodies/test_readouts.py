"""What a reduced body reads out: carried by every projection, saved, refused where names or sizes clash."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import OwnReadout, lattice, make_bar

from nassim import ElectricalPort, ReducedBody, RemotePoint, craig_bampton, load, save
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import _congruent, _project_gram, keep_modes, keep_ports, project, trim_body
from nassim.bodies.readouts import PassivePoint, Picture, Surface, by_name, readouts_of, upgrade_readouts

RNG = np.random.default_rng(5)
N = 16
TRIANGLE = Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([[0, 1], [1, 2], [0, 2]]), ("bar",))
PICTURE = Picture(TRIANGLE, RNG.standard_normal((3, 3, N)))
PORTS = tuple(PortCoupling(name, RNG.standard_normal(N), 1e-6) for name in ("second", "first"))
MIDDLE = PassivePoint(RemotePoint("middle", (), np.zeros(3)), RNG.standard_normal((6, N)))

BESIDE = PassivePoint(RemotePoint("beside", (), np.ones(3)), RNG.standard_normal((6, N)))


@pytest.fixture(scope="module")
def body():
    """Two remote points and four modes, with a read-out of every kind."""
    plain = craig_bampton(lattice(), n_modes=4, progress=False)
    gauge = OwnReadout("gauge", plain.motion("left")[0] - MIDDLE.motions[0])
    return replace(plain, readouts=by_name([PICTURE, *PORTS, MIDDLE, gauge]))


def test_each_kind_reads_the_same_in_other_coordinates():
    change, q = RNG.standard_normal((N, 5)), RNG.standard_normal(5)
    np.testing.assert_allclose(PICTURE.projected(change).modes @ q, PICTURE.modes @ (change @ q))
    np.testing.assert_allclose(MIDDLE.projected(change).motions @ q, MIDDLE.motions @ (change @ q))
    np.testing.assert_allclose(PORTS[0].projected(change).forces @ q, PORTS[0].forces @ (change @ q))
    assert [kind.projected(change).n_coordinates for kind in (PICTURE, MIDDLE, PORTS[0])] == [5, 5, 5]
    assert PORTS[0].projected(change).blocked_capacitance == 1e-6


def test_a_body_tells_its_readouts_by_kind(body):
    assert body.surface is TRIANGLE
    assert body.surface_modes is PICTURE.modes
    assert body.ports == PORTS
    assert body.port("first") is PORTS[1]
    assert body.all_point_names == ("left", "right", "middle")
    assert body.point("middle") is MIDDLE.point
    assert body.motion("middle") is MIDDLE.motions
    bare = replace(body, readouts={})
    assert (bare.surface, bare.surface_modes, bare.ports, bare.passive_points) == (None, None, (), ())


def test_projection_carries_everything(body):
    """Also a kind that only this file knows, and the points that cease to be coordinates."""
    change = RNG.standard_normal((N, 9))
    change[6:12, :6], change[6:12, 6:] = np.eye(6), 0.0
    projected = project(body, change, points=["right"])
    assert list(projected.readouts) == ["left", "surface", "second", "first", "middle", "gauge"]
    assert projected.all_point_names == ("right", "left", "middle")
    np.testing.assert_allclose(projected.motion("left"), change[:6])
    np.testing.assert_allclose(projected.surface_modes, PICTURE.modes @ change)
    (gauge,) = readouts_of(projected.readouts, OwnReadout)
    np.testing.assert_allclose(gauge.row, (projected.motion("left") - projected.motion("middle"))[0])


def test_a_selection_of_many_coordinates_is_projected_as_any_change():
    """Here as a sparse matrix: rows and columns of the selection."""
    kept, n = [*range(60), 70, 75], 80
    matrix, gram = (half + half.T for half in map(RNG.standard_normal, ((n, n), (4 + 3 * n,) * 2)))
    change = np.eye(n)[:, kept]
    np.testing.assert_array_equal(_congruent(matrix, change), matrix[np.ix_(kept, kept)])
    fields = [0, 1, 2, 3, *(4 + 3 * k + c for k in kept for c in range(3))]
    np.testing.assert_array_equal(_project_gram(gram, change), gram[np.ix_(fields, fields)])


def test_trimming_carries_everything(body):
    """A picture whose corners ride on points moves as these do in the trimmed body; the richer form has none."""
    corners = Picture(TRIANGLE, np.array([body.motion(name)[:3] for name in body.all_point_names]))
    body = replace(body, readouts={**body.readouts, "surface": corners}, enriched=None)
    trimmed = trim_body(body, points=["right"], loads=np.zeros((N, 0)), cutoff_frequency=1e5)
    assert list(trimmed.readouts) == ["left", "surface", "second", "first", "middle", "gauge"]
    np.testing.assert_allclose(
        trimmed.readouts["gauge"].row, (trimmed.motion("left") - trimmed.motion("middle"))[0], atol=1e-12
    )
    expected = [trimmed.motion(name)[:3] for name in ("left", "right", "middle")]
    np.testing.assert_allclose(trimmed.surface_modes, expected, atol=1e-12)
    assert trimmed.enriched.surface is None


def test_fewer_modes_keep_the_picture_which_the_richer_form_lacks(body):
    fewer = keep_modes(replace(body, enriched=None), 1)
    assert list(fewer.readouts) == list(body.readouts)
    np.testing.assert_allclose(fewer.surface_modes[:, :, :13], PICTURE.modes[:, :, :13])
    assert list(fewer.enriched.readouts) == ["second", "first", "middle", "gauge"]


def test_keep_ports(body):
    kept = keep_ports(body, {"first", "middle"})
    assert kept.ports == PORTS[1:]
    assert kept.all_point_names == body.all_point_names
    assert kept.surface is TRIANGLE


def test_names_are_used_once(body):
    with pytest.raises(ValueError, match="read-out names must differ; used more than once: first"):
        by_name([*PORTS, PORTS[1]])
    left = replace(PORTS[0], name="left")
    with pytest.raises(ValueError, match=r"body 'lattice': remote point and read-out names must differ.*: left"):
        replace(body, readouts=by_name([left]))
    bar = make_bar()
    with pytest.raises(ValueError, match=r"solid 'bar': .* surface \('surface'\) names must differ.*: left"):
        replace(bar, ports=(ElectricalPort("left", "bar", None),))
    with pytest.raises(ValueError, match=r"surface \('surface'\) names must differ.*: surface"):
        replace(bar, remote_points=(replace(bar.remote_points[0], name="surface"),))


@pytest.mark.parametrize(
    ("readouts", "problem"),
    [
        ({"v": PORTS[0]}, "read-out 'v' has the name 'second'; make the mapping by readouts.by_name"),
        ({"gauge": OwnReadout("gauge", np.zeros(3))}, "read-out 'gauge' reads 3 coordinates, but the body has 16"),
        ({"gauge": np.zeros(N)}, "read-out 'gauge' is a ndarray, which `project` could not convert"),
    ],
    ids=["name", "size", "kind"],
)
def test_readouts_that_do_not_fit_are_refused(body, readouts, problem):
    with pytest.raises(ValueError, match=f"body 'lattice': {problem}"):
        replace(body, readouts=readouts)


def test_sizes_are_checked():
    with pytest.raises(ValueError, match="surface: modes must have shape 3 x 3 x any, got 2 x 3 x 16"):
        Picture(TRIANGLE, PICTURE.modes[:2])
    with pytest.raises(ValueError, match="passive point 'middle': motions must have shape 6 x any, got 5 x 16"):
        PassivePoint(MIDDLE.point, MIDDLE.motions[:5])


def fields_of_0_1(body):
    """A body's fields as nassim 0.1 named them."""
    passive = readouts_of(body.readouts, PassivePoint)
    motions = np.vstack([np.zeros((0, N)), *(point.motions for point in passive)])
    return {
        "name": body.name,
        "remote_points": body.remote_points,
        "mass_matrix": body.mass_matrix,
        "stiffness_matrix": body.stiffness_matrix,
        "gram": body.gram,
        "surface": body.surface,
        "surface_modes": body.surface_modes,
        "record": {},
        "enriched": None,
        "released_stiffness": None,
        "passive_points": body.passive_points,
        "passive_motions": motions,
        "ports": body.ports,
        "full_integrals": True,
    }


@pytest.mark.parametrize(
    "readouts", [[PICTURE, *PORTS, MIDDLE], [PICTURE], [MIDDLE, BESIDE], PORTS, []], ids=["all", "a", "b", "c", "none"]
)
def test_bodies_of_0_1_are_upgraded(body, readouts):
    given = replace(body, readouts=by_name(readouts))
    again = ReducedBody(**upgrade_readouts(fields_of_0_1(given)))
    assert list(again.readouts) == list(given.readouts)
    assert again.surface is given.surface
    assert again.ports == given.ports
    for name in given.all_point_names:
        np.testing.assert_array_equal(again.motion(name), given.motion(name))


def test_what_needs_no_upgrade_stays(body):
    content = {"name": "a", "readouts": body.readouts}
    assert upgrade_readouts(content) == content
    assert upgrade_readouts({"name": "a", "surface": None, "passive_motions": None}) == {"name": "a", "readouts": {}}


def test_saved_bodies_keep_their_readouts(body, tmp_path):
    kept = replace(body, readouts=by_name([PICTURE, *PORTS, MIDDLE]))
    again = load(save(kept, tmp_path / "body.h5"))
    assert list(again.readouts) == list(kept.readouts)
    np.testing.assert_array_equal(again.surface_modes, kept.surface_modes)
    np.testing.assert_array_equal(again.motion("middle"), kept.motion("middle"))
    np.testing.assert_array_equal(again.port("first").forces, kept.port("first").forces)
    assert again.surface.labels == kept.surface.labels
    for array in (again.surface.points, again.surface.triangles, again.surface.edges):
        assert not array.flags.writeable
