"""Peaks of stress on two meshes: an edge without a fillet grows by Williams' exponent, a fillet stands."""

from dataclasses import replace
from types import SimpleNamespace

import netgen.occ as occ
import numpy as np
import pytest
from conftest import STEEL, meshed

from nassim import (
    FlexibleBody,
    Loop,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    StressAt,
    StressPoint,
    StressSurface,
    craig_bampton,
    fixed,
    peak_stress,
    static_motion,
    stress_convergence,
)
from nassim.fem import generate_mesh
from nassim.simulation.loaded.stress_convergence import _edges_near
from nassim.systems import proportional

SIDE, DEPTH = 10e-3, 1e-3


def bracket(size, fillet=0.0):
    """An L pushed at its end: its inner corner at the origin has a fillet or none; elements of a size at the corner."""
    shape = occ.Box(occ.Pnt(-SIDE, 0, -SIDE), occ.Pnt(SIDE, DEPTH, SIDE))
    pocket = occ.Box(occ.Pnt(0, -1, 0), occ.Pnt(1, 1, 1))
    if fillet:
        pocket = pocket.MakeFillet([e for e in pocket.edges if np.hypot(e.center.x, e.center.z) < 1e-9], fillet)
    shape -= pocket
    shape.solids.name = "bracket"
    for face in shape.faces:
        near = np.hypot(face.center.x, face.center.z) < SIDE / 2 + 1e-9 and 0.1 < face.center.y / DEPTH < 0.9
        face.name = "inner" if near and min(face.center.x, face.center.z) > -1e-9 else "other"
    root, tip = shape.faces.Max(occ.Z), shape.faces.Max(occ.X)
    root.name, tip.name = "root", "tip"
    points = (RemotePoint("root", "root", [-5e-3, 0.5e-3, SIDE]), RemotePoint("tip", "tip", [SIDE, 0.5e-3, -5e-3]))
    solid = Solid("bracket", shape, {"bracket": STEEL}, points)
    mesh = generate_mesh(solid, element_size=5e-3, extrude="y", local_sizes={"inner": size})
    places = [StressSurface("inner", "inner"), StressPoint("far", (-5e-3, 0.5e-3, -5e-3))]
    return craig_bampton(meshed(mesh, solid, 3), n_modes=0, discretization=False, stress=places, progress=False)


def clamped(body):
    wall = RigidBody("wall", {"face": body.point("root").position}, fixed=True)
    return Scene(
        "bracket",
        (wall, FlexibleBody("bracket", body, fidelity="linear")),
        (fixed("clamp", "wall.face", "bracket.root"),),
        (PointForce("push", "bracket.tip", "z", "force"),),
    )


@pytest.fixture(scope="module")
def sharp():
    """Bodies with a sharp corner, from two meshes."""
    return [bracket(size) for size in (1e-3, 0.5e-3)]


def test_a_sharp_corner_grows_as_williams_says_and_a_place_far_from_it_stands(sharp):
    found = stress_convergence(clamped(sharp[0]), sharp[1], body="bracket", inputs={"force": 10.0})
    corner = found.spots[0]
    assert found.growing == (corner,)
    assert (corner.place, corner.verdict) == ("inner", "grows")
    np.testing.assert_allclose(corner.position[[0, 2]], 0.0, atol=1e-9)
    assert 1.2 < corner.von_mises / corner.coarse < 1.7  # 2^0.4555 = 1.37 in the limit
    assert corner.change == corner.von_mises - corner.coarse
    assert corner.mesh_error > 0.3 * corner.von_mises
    lenient = stress_convergence(clamped(sharp[0]), sharp[1], body="bracket", inputs={"force": 10.0}, tolerance=2.0)
    assert lenient.spots[0].verdict == "unresolved"
    assert "far" in {spot.place for spot in found.standing}
    assert corner.von_mises > max(spot.von_mises for spot in found.standing)  # the corner does not stand
    figures = (f"{1e-6 * x:.4g}" for x in (corner.coarse, corner.von_mises, corner.mesh_error))
    assert " ".join((*figures, "grows")) in " ".join(str(found).split())


def test_a_fillet_stands():
    coarse, fine = (bracket(size, fillet=2e-3) for size in (1e-3, 0.5e-3))
    options = {"body": "bracket", "inputs": {"force": 10.0}}
    found = stress_convergence(clamped(coarse), fine, **options)
    assert found.growing == ()
    peak = found.spots[0]
    assert peak.place == "inner"
    assert np.hypot(*(peak.position[[0, 2]] - 2e-3)) == pytest.approx(2e-3, rel=1e-3)
    motion = static_motion(clamped(fine), inputs={"force": 10.0})
    assert peak.von_mises == pytest.approx(peak_stress(motion, clamped(fine).bodies[1]).von_mises)
    strict = stress_convergence(clamped(coarse), fine, **options, place="inner", tolerance=1e-9, n_spots=1)
    assert [spot.verdict for spot in strict.spots] != ["stands"]


def test_spins_and_voltages_are_loads_too(sharp):
    """The stress at a point under a spin about an axis, and in a stack that is held, as from a motion."""
    scene, spin = clamped(sharp[0]), {"angular_velocity": (0, 40.0, 0), "axis_point": (0, 0, 0.05)}
    (spot,) = stress_convergence(scene, sharp[1], body="bracket", place="far", **spin).spots
    fast = static_motion(clamped(sharp[1]), **spin)
    assert spot.von_mises == pytest.approx(peak_stress(fast, clamped(sharp[1]).bodies[1], place="far").von_mises)
    for on_coarse, verdict in ((1.0, "stands"), (2.0, "falls"), (0.5, "grows")):
        held = [
            replace(body, readouts={"far": replace(body.readouts["far"], voltages={"p": [[x * 1e5, 0, 0, 0, 0, 0]]})})
            for body, x in zip(sharp, (on_coarse, 1.0), strict=True)
        ]
        (spot,) = stress_convergence(clamped(held[0]), held[1], body="bracket", voltages={"p": 20.0}).spots
        expected = pytest.approx(2e6), pytest.approx(on_coarse * 2e6), verdict
        assert (spot.von_mises, spot.coarse, spot.verdict) == expected


def test_peaks_are_local(sharp):
    """A radius of the whole body leaves one peak; the finer body has the places asked for, not those of sensors, and
    no loop reads these."""
    loop = Loop("servo", proportional(-1e-9, sample_rate=1e3), "stress.sxx", "force")
    scene = replace(clamped(sharp[0]), sensors=(StressAt("stress", "bracket.far"),), loops=(loop,))
    only = replace(sharp[1], readouts={"inner": sharp[1].readouts["inner"]})
    options = {"body": "bracket", "inputs": {"force": 10.0}}
    (spot,) = stress_convergence(scene, only, **options, place="inner", radius=1.0).spots
    inner = sharp[0].readouts["inner"]
    rows, away = inner.rows.copy(), np.linalg.norm(inner.positions - spot.position, axis=1)
    rows[np.argmax(away)] = 2 * rows[np.argmin(away)]
    louder = replace(clamped(replace(sharp[0], readouts={"inner": replace(inner, rows=rows)})), sensors=())
    (other,) = stress_convergence(louder, only, **options, radius=1.0).spots
    assert (other.von_mises, other.coarse) == pytest.approx((spot.von_mises, 2 * spot.coarse))  # the largest within it
    bare = replace(sharp[1], readouts={"far": sharp[1].readouts["far"]})
    with pytest.raises(ValueError, match="unknown stress of the finer body 'bracket' 'inner'; known: far"):
        stress_convergence(scene, bare, **options)
    with pytest.raises(ValueError, match="body 'wall' is rigid"):
        stress_convergence(scene, sharp[1], body="wall")


@pytest.mark.parametrize("first", [0, 1, 2])
def test_edges_are_the_longest_at_a_corner_wherever_a_triangle_begins(first):
    positions = np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 4.0, 1.0]])
    triangles = np.roll([[0, 1, 2]], first, axis=1)
    field = SimpleNamespace(positions=positions, surface=SimpleNamespace(triangles=triangles))
    np.testing.assert_allclose(_edges_near(field, positions[::-1] + 0.1), [5.0, 5.0, 4.0])
