"""Optional arguments within runs that no other test would miss."""

import warnings

import numpy as np
import pytest
from conftest import lattice

from nassim import (
    Encoder,
    FlexibleBody,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    simulate,
)


def block():
    """A mass on a spring, pushed and read along z."""
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    return Scene(
        "block",
        (ground, RigidBody("block", {"p": np.zeros(3)}, 2.0, np.eye(3))),
        actuators=(PointForce("push", "block.p", "z", "push"),),
        sensors=(Encoder("way", "ground.p", "block.p", "z"),),
        springs=tuple(SpringDamper(axis, "ground.p", "block.p", axis, 1e4) for axis in "xyz"),
        damping_ratio=0.0,
    )


def record(n_steps, time_step):
    time = np.arange(n_steps + 1) * time_step
    return TimeHistory(time, np.sin(20 * time)[None], ("push",), ("N",))


@pytest.mark.filterwarnings("ignore:damping_ratio acts")
@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_all_steps_are_counted(method, monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    simulate(block(), record(700, 1e-3), time_step=1e-3, method=method)
    assert "700/700 steps" in capsys.readouterr().err
    simulate(block(), record(700, 1e-3), time_step=1e-3, method=method, progress=False)
    told = capsys.readouterr()
    assert not told.err
    assert not told.out


def test_a_spin_is_told_once_a_run():
    """At the start, as it is known then, and not again at the end."""
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    first = reduced.eigenfrequencies(fixed=["left"])[0]
    body = FlexibleBody("bar", reduced, angular_velocity=2 * np.pi * 0.1 * first * np.array([0.6, 0.0, 0.8]))
    scene = Scene("top", (body,), damping_ratio=0.0)
    time = np.arange(6) * 1e-5
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        simulate(scene, TimeHistory(time, np.zeros((0, 6)), (), ()), time_step=1e-5, progress=False)
    assert sum("centrifugal stiffening" in str(one.message) for one in told) == 1
