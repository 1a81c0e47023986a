"""Warnings name the user's line, whichever part of nassim gives them, and stand in the results of studies."""

import linecache
import warnings
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from nassim import Bushing, RigidBody, Scene, linearize, simulate
from nassim.base.warning_log import collect_messages, mute_warnings, warn
from nassim.signals import spectral_noise
from nassim.studies import linear_effects, sweep

SHAPE = {"axle": [0.1, 0, 0]}, 2.0, np.diag([0.1, 0.1, 0.2])
BLOCK, ROTOR = RigidBody("block", *SHAPE), RigidBody("rotor", *SHAPE, angular_velocity=(0, 0, 30.0))
NAMED = xr.Dataset({"f": ("run", [1.0, 2, 4, 3])}, {"n": ("run", [0.0, 1, 2, 3]), "kind": ("run", list("aabb"))})


def on_a_spring(body, **options):
    stand = RigidBody("stand", {"axle": np.zeros(3)}, fixed=True)
    spring = Bushing("spring", "stand.axle", f"{body.name}.axle", [1e5, 1e5, 1e5, 50.0, 50.0, 50.0])
    return Scene("s", (stand, body), springs=(spring,), **options)


def sag(gravity):
    scene = on_a_spring(BLOCK, gravity=(0, 0, -gravity))
    return simulate(scene, None, duration=2e-3, time_step=1e-3, method="exact", progress=False).time[-1]


@pytest.mark.parametrize(
    ("verb", "call"),
    {
        "Scene": lambda: on_a_spring(BLOCK, damping_ratio=2.0),
        "replace": lambda: replace(on_a_spring(BLOCK), damping_ratio=2.0),
        "spectral_noise": lambda: spectral_noise({"a": lambda f: f**-4.0}, 10.0, 100.0, band=(0.1, 40.0)),
        "linearize": lambda: linearize(on_a_spring(ROTOR)),
        "simulate": lambda: sag(9.81),
        "linear_effects": lambda: linear_effects(NAMED, coverage=1.0),
    }.items(),
)
def test_a_warning_names_the_line_that_calls_nassim(verb, call):
    with pytest.warns(UserWarning, match=r"critical damping|changes much|gyroscopic|turned by|texts") as told:
        call()
    assert [w.filename for w in told] == [__file__]
    assert f" {verb}(" in linecache.getline(__file__, told[0].lineno)


@pytest.mark.filterwarnings("ignore:body 'block' turned")
def test_warnings_of_a_run_stand_in_the_results_of_a_study():
    found = sweep(sag, grid={"gravity": [0.1, 9.81]}, executor="serial", progress=False)
    assert found.status.values.tolist() == ["ok", "ok"]
    none, one = found.message.values
    assert none == ""
    assert one.startswith("warning: body 'block' turned by up to 0.039 rad")


def test_warnings_of_trials_are_muted_in_logs_too():
    with collect_messages() as log, warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        with mute_warnings("a trial|another"):
            warn("a trial")
            warnings.warn("another trial", stacklevel=1)
            warn("a result")
        warn("a trial")
    assert log.warnings == [str(one.message) for one in told] == ["a result", "a trial"]
