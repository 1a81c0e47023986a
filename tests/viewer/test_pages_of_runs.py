"""Pages of runs: browsers can read them, and show bodies where the simulation has them."""

import numpy as np
import pytest
from conftest import lattice
from pages import Page
from scipy.spatial.transform import Rotation

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    TimeHistory,
    craig_bampton,
    simulate_motion,
)
from nassim.scene import point_motion
from nassim.viewer import view_motion, write_page

TILT = Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix()


@pytest.mark.parametrize("frames", [5, 6, 7])
@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_page_shows_what_was_simulated(frames, fidelity, tmp_path):
    """Points of a turned body by the page's own data; numbers lie where browsers take them, whatever came before."""
    body = craig_bampton(lattice(stiffness=1e6), n_modes=2, progress=False)
    scene = Scene(
        "tower",
        (
            RigidBody("base", {"o": np.zeros(3)}, fixed=True),
            FlexibleBody("box", body, rotation=TILT, fidelity=fidelity),
        ),
        (Joint("foot", "base.o", "box.left"),) if not body.point("left").position.any() else (),
        (PointForce("push", "box.right", (1.0, 2.0, -0.5), "f"),),
        (Encoder("x", "base.o", "box.right", "x"),),
    )
    time = np.arange(101) * 1e-4
    push = TimeHistory(time, np.sin(500 * time)[None], ("f",), ("N",))
    _, motion = simulate_motion(scene, push, time_step=1e-4, frames=frames, progress=False)
    page = Page(write_page(view_motion(scene, motion), tmp_path / "tower.html"))
    where = page.header["motion"]["time"]
    assert where["offset"] % 8 == 0
    np.testing.assert_allclose(page.array(where), motion.time)
    shape = page.shape("box")
    form = page.header["forms"][shape["form"]]
    points = page.array(form["points"]).reshape(-1, 3)
    right = int(np.flatnonzero(np.all(np.abs(points - body.point("right").position) < 1e-7, axis=1))[-1])
    shifts, turns = (page.moved("box", what, frames, 3).astype(float) for what in ("shift", "turn"))
    deformed = page.moved("box", "coordinates").reshape(frames, -1) @ page.patterns("box")[right].T
    rest = Rotation.from_quat(shape["rotation"])
    found = shape["position"] + shifts + (rest * Rotation.from_rotvec(turns)).apply(points[right] + deformed)
    expected, _ = point_motion(scene, motion, "box.right")
    assert np.ptp(expected, axis=0).max() > 1e-6
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.ptp(expected, axis=0).max())
