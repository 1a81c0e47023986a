"""Runs that end early: what they raise and keep, until when that is right, and how far a loop may move bodies."""

import pickle
import re
import signal
import threading
import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import lattice
from test_large_motion import GRAVITY, INERTIA, NORMAL, SKEWED, ground
from test_long_runs import SPEED, STEP, wheel

from nassim import (
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SimulationError,
    TimeHistory,
    Vibrometer,
    craig_bampton,
    simulate,
)
from nassim.scene.drives import Drive
from nassim.scene.joints import prismatic
from nassim.simulation import SimulationInterrupted
from nassim.simulation.exudyn import solver
from nassim.simulation.linear import exact_steps
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.initial_velocities import starting_energy
from nassim.simulation.model.reach import GrowingReach, Reach, find_reach, scene_size
from nassim.simulation.model.stopped_runs import Stopped, ValidSamples
from nassim.systems.controllers import Controller

MASS = 2.0
MARGIN = 10.0
"""By how much a loop may move a body farther than forces and drives alone could."""
METHODS = ("exact", "generalized_alpha")


def quiet(duration, *names, step=STEP):
    time = step * np.arange(round(duration / step) + 1)
    return TimeHistory(time, np.zeros((len(names), len(time))), names, ())


def test_a_run_that_fails_keeps_what_it_had(capfd):
    with pytest.raises(
        SimulationError, match=r"integration failed at t = [\d.]+ s; body 'wheel' has .* trust it until"
    ) as caught:
        simulate(wheel(), quiet(10.0), time_step=STEP, spectral_radius=1.0, outputs=["angle"], progress=False)
    error = caught.value
    assert isinstance(error, RuntimeError)
    record = error.record
    assert record.names == ("angle",)
    assert record.units == ("rad",)
    assert 1.0 < error.trusted_until < record.time[-1] < 10.0
    wrong = np.abs(record["angle"] - SPEED * record.time)
    assert wrong[record.time <= error.trusted_until].max() < 0.01
    assert wrong[-1] > 0.1
    told = capfd.readouterr()
    assert told.out == told.err == ""
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert again.trusted_until == error.trusted_until
    np.testing.assert_array_equal(again.record.values, record.values)


def test_a_run_that_has_gone_wrong_without_failing_is_told():
    """The same run, beside bodies that hardly turn, ends before it fails; at the default nothing is told."""
    one, two, three = (RigidBody(name, {"c": (0, 0, 0)}, 0.5, INERTIA) for name in ("one", "two", "three"))
    alone, slow = wheel(), replace(one, angular_velocity=0.5 * NORMAL)
    scene = replace(alone, bodies=(slow, two, *alone.bodies, three))
    with pytest.warns(
        UserWarning,
        match=r"body 'wheel' has velocities that violate its constraints, from t = [\d.]+ s on: it turns by up to "
        r"(\S+) rad in a step, and a spectral_radius of 1 holds for 0 rad; .* do not trust",
    ) as told:
        simulate(scene, quiet(2.4), time_step=STEP, spectral_radius=1.0, progress=False)
    assert float(str(told[0].message).split("by up to ")[1].split()[0]) > 0.9 * SPEED * STEP
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(scene, quiet(2.4), time_step=STEP, progress=False)


def test_an_interrupted_run_keeps_what_it_had():
    threading.Timer(0.4, signal.raise_signal, (signal.SIGINT,)).start()
    with pytest.raises(SimulationInterrupted, match="stopped at t =") as caught:
        simulate(wheel(), quiet(400.0), time_step=STEP, progress=False)
    record = caught.value.record
    assert len(record.time) > 10
    assert isinstance(caught.value, KeyboardInterrupt)
    np.testing.assert_allclose(record["angle"], SPEED * record.time, atol=1e-2)


def test_a_record_ends_before_what_is_no_number():
    stopped = Stopped("failed", np.array([[0.0, 1.0, 2.0, np.nan], [0.0, 1.0, 2.0, 3.0]]), 3)
    assert stopped.readings.shape == (2, 3)
    assert stopped.public_error(None, 0.5).trusted_until == 1.0


def carriage(gain, *, beside=None, limit=np.inf, sample_rate=1 / STEP, **parts):
    """A carriage free to slide along an odd axis, whose loop pushes it away by gain N/m."""
    controller = Controller(
        np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], sample_rate, delay=0, limit=limit
    )
    body = RigidBody("carriage", {"c": (0, 0, 0), "p": (0.05, 0.0, 0.02)}, MASS, INERTIA, rotation=SKEWED)
    bodies, joints = (ground(), body), (prismatic("guide", "ground.o", "carriage.c", NORMAL),)
    if beside is not None:
        place = beside.point("left").position
        bodies = (ground(o=np.zeros(3), b=place), body, FlexibleBody("beside", beside, fidelity="linear"))
        joints = (*joints, Joint("clamp", "ground.b", "beside.left"))
    return Scene(
        "carriage",
        bodies,
        joints,
        (PointForce("force", "carriage.c", NORMAL, "force"),),
        (Encoder("x", "ground.o", "carriage.c", NORMAL),),
        loops=(Loop("hold", controller, "x", "force"),),
        **parts,
    )


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=0, progress=False)


def pushed(duration, size=1.0):
    history = quiet(duration, "force")
    return replace(history, values=size * np.exp(-(((history.time - 0.1) / 0.02) ** 2))[None])


@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_a_loop_that_runs_away_on_a_slide_is_stopped(bar, small, method):
    scene = carriage(+200.0, beside=bar if small else None)
    message = (
        r"closed loop runs away: at t = (\S+) s 'x' has grown to (\S+) m and body 'carriage' has moved by (\S+) m, "
        r"where the scene's size, forces, speeds and drives account for (\S+) m at most\. Unstable, .* trust it until t"
    )
    with pytest.raises(SimulationError, match=message) as caught:
        simulate(scene, pushed(10.0), time_step=STEP, method=method, progress=False)
    record = caught.value.record
    time, grown, moved, allowed = map(float, re.search(message, str(caught.value)).groups())
    assert time == pytest.approx(record.time[-1])
    assert grown == moved == pytest.approx(np.abs(record["x"]).max(), rel=5e-3)
    assert 0.2 < allowed < moved
    assert record.names == ("force", "x", "hold")
    assert record.time[-1] < 3.0
    assert np.abs(record["x"]).max() < 100.0
    # It goes as exp(10 t): x'' = 100 x. Looks are 64 steps apart at most.
    growth = np.log(record["x"][-1] / record["x"][-51]) / (50 * STEP)
    assert growth == pytest.approx(10.0, rel=0.02)
    assert caught.value.trusted_until == pytest.approx(record.time[-1], abs=0.13)


def test_a_rigid_body_that_is_held_to_the_ground_has_not_moved():
    """It has no node of its own beside a loop that works."""
    scene = carriage(-200.0)
    post = RigidBody("post", {"foot": np.zeros(3)}, 1.0, np.eye(3), scene.point_position("ground.o"))
    held = replace(scene, bodies=(*scene.bodies, post), joints=(*scene.joints, Joint("bolt", "ground.o", "post.foot")))
    run = {"time_step": STEP, "progress": False}
    found, expected = (simulate(s, pushed(0.5), **run)["x"] for s in (held, scene))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("method", METHODS)
def test_loops_that_work_are_not_stopped(bar, method):
    """Far out: an idle loop on a free fall, a strong push, a body thrown by its start, a loop at its limit."""
    options = {"time_step": STEP, "method": method, "progress": False}
    falling = simulate(carriage(0.0, gravity=GRAVITY), quiet(5.0, "force"), start="released", **options)
    fall = GRAVITY @ NORMAL / 2 * falling.time**2
    assert abs(fall[-1]) > 50.0
    np.testing.assert_allclose(falling["x"], fall, atol=1e-6 * abs(fall[-1]))

    thrown = simulate(carriage(0.0), pushed(8.0, 1500.0), **options)
    assert thrown["x"][-1] > 100.0

    held = simulate(carriage(+200.0, limit=20.0), pushed(5.0), **options)
    assert np.abs(held["hold"]).max() == pytest.approx(20.0)
    assert abs(held["x"][-1]) > 50.0

    shaken = replace(carriage(0.0), actuators=(*carriage(0.0).actuators, GroundAcceleration("quake", NORMAL, "a")))
    quake = replace(quiet(5.0, "force", "a"), values=np.outer([0.0, 3.0], np.ones(round(5 / STEP) + 1)))
    moved = simulate(shaken, quake, **options)
    assert moved["x"][-1] == pytest.approx(-37.5, rel=1e-3)


@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize(("method", "module"), [("exact", exact_steps), ("generalized_alpha", solver)])
def test_a_body_may_get_as_far_as_it_is_let(monkeypatch, bar, small, method, module):
    """At 0.9 and at 1.1 of the bound."""
    scene = carriage(0.0, beside=bar if small else None)
    farthest = simulate(scene, pushed(1.0), time_step=STEP, method=method, progress=False)["x"].max()

    def bounded(share):
        masses = {"carriage": MASS}
        masses |= {"beside": 1.0} if small else {}
        monkeypatch.setattr(module, "find_reach", lambda *_: Reach(farthest / share, np.zeros(1), masses))
        return simulate(scene, pushed(1.0), time_step=STEP, method=method, progress=False)

    assert bounded(0.9)["x"][-1] == farthest
    with pytest.raises(SimulationError, match="body 'carriage' has moved"):
        bounded(1.1)


def test_trust_does_not_come_back():
    """Until the last sound look before the first unsound one."""
    valid = ValidSamples()
    for sample, sound in ((10, True), (20, True), (30, False), (40, True)):
        valid.check(sample, valid=sound)
    assert valid.last == 20


def test_reach_in_closed_form():
    """Under a constant force F, weight and ground acceleration a: size + margin (F / m + g + a) t^2 / 2, and drives."""
    scene = carriage(0.0, gravity=GRAVITY)
    scene = replace(scene, actuators=(*scene.actuators, GroundAcceleration("quake", NORMAL, "a")))
    n, force, acceleration = 1001, -6.0, 3.0
    inputs = np.outer([force, acceleration], np.ones(n))
    reach = find_reach(assemble(scene), inputs, STEP)
    time = (n - 1) * STEP
    total = abs(force) / MASS + np.linalg.norm(GRAVITY) + acceleration
    assert reach.at(n - 1)["carriage"] == pytest.approx(reach.size + MARGIN * total * time**2 / 2, rel=5e-3)
    assert reach.at(0)["carriage"] == pytest.approx(reach.size, rel=1e-2)
    spread = np.sqrt(np.trace(INERTIA) / MASS)
    assert reach.size == pytest.approx(np.hypot(0.05, 0.02) + spread, rel=0.2)

    limited = carriage(0.0, limit=4.0)
    path = find_reach(assemble(limited), np.zeros((1, n)), STEP)
    assert path.at(n - 1)["carriage"] == pytest.approx(path.size + MARGIN * 4.0 / MASS * time**2 / 2, rel=5e-3)

    spun = replace(wheel(), loops=())
    speed = find_reach(assemble(spun), np.zeros((0, n)), STEP)
    energy = SPEED**2 * (NORMAL @ spun.bodies[1].rigid_inertia[2] @ NORMAL)
    arm = spun.bodies[1].position - NORMAL * (NORMAL @ spun.bodies[1].position)
    energy += 0.7 * SPEED**2 * arm @ arm
    expected = speed.size + MARGIN * np.sqrt(energy / 0.7) * time
    assert speed.at(n - 1)["wheel"] == pytest.approx(expected, rel=2e-3)


class Lagging(PointForce):
    """A force behind an amplifier."""

    def terms(self, scene):
        return tuple(replace(term, bandwidth=50.0) for term in super().terms(scene))


def test_reach_of_what_drives_move():
    """What a drive carries goes as fast, a turn as fast as the size of the scene lets it; commands to their limit."""
    n, rate = 1001, 3.0
    time = (n - 1) * STEP
    ramp = rate * STEP * np.arange(n)[None]
    scene = replace(wheel(0.0), loops=())
    turned = replace(scene, actuators=(Drive("motor", "hinge", "rz", "angle in"),))
    reach = find_reach(assemble(turned), ramp, STEP)
    path = MARGIN * rate * reach.size * time
    assert reach.at(n - 1)["wheel"] == pytest.approx(reach.size + path, rel=2e-3)
    spun = find_reach(assemble(replace(scene, actuators=(Drive("motor", "hinge", "rz", speed=rate),))), ramp[:0], STEP)
    own = np.sqrt(2 * starting_energy(wheel(rate)) / 0.7)
    assert spun.at(len(spun.path) - 1)["wheel"] == pytest.approx(reach.size + path + MARGIN * own * time, rel=2e-3)
    growing = GrowingReach(assemble(wheel(rate)), STEP)
    pieces = [growing.after(np.zeros((0, k))).path for k in (1, 400, 600)]
    np.testing.assert_allclose(
        np.concatenate(pieces), find_reach(assemble(wheel(rate)), np.zeros((0, n)), STEP).path, rtol=1e-9
    )
    limited = Loop("hold", replace(carriage(0.0).loops[0].controller, limit=2.0), "angle", "angle in")
    assert find_reach(assemble(replace(turned, loops=(limited,))), ramp, STEP).size == pytest.approx(3 * reach.size)

    along = replace(
        carriage(0.0), sensors=(Encoder("x", "ground.o", "carriage.c", NORMAL), Vibrometer("v", "carriage.c"))
    )
    for measured, share in (("x", 1.0), ("v", 0.0)):
        aimed = replace(along, loops=(replace(along.loops[0], measured=measured, reference="wanted"),))
        wanted = np.array([[0.0], [-4.0]]) * np.ones(n)
        aiming = GrowingReach(assemble(aimed), STEP)
        for found in (find_reach(assemble(aimed), wanted, STEP), aiming.after(wanted), aiming.after(0 * wanted)):
            assert found.size == pytest.approx(scene_size(along) + 4.0 * share)  # also once the set point is back
    slid = replace(carriage(0.0), actuators=(Drive("motor", "guide", "z", "x in"),), loops=())
    moved = find_reach(assemble(slid), ramp, STEP)
    assert moved.at(n - 1)["carriage"] == pytest.approx(moved.size + MARGIN * rate * time, rel=2e-3)
    stopped = find_reach(assemble(slid), np.minimum(ramp, ramp[0, n // 2]), STEP)
    np.testing.assert_allclose(stopped.path, moved.path, rtol=1e-12)  # what was thrown goes on
    growing = GrowingReach(assemble(slid), STEP)
    pieces = [growing.after(part).path for part in np.split(np.minimum(ramp, ramp[0, n // 2]), [600], axis=1)]
    np.testing.assert_allclose(np.concatenate(pieces), moved.path, rtol=1e-12)
    lagging = (Lagging("force", "carriage.c", NORMAL, "force"),)
    late, prompt = (
        find_reach(assemble(s), np.ones((1, n)), STEP).path
        for s in (replace(carriage(0.0), actuators=lagging), carriage(0.0))
    )
    np.testing.assert_allclose(late, prompt, rtol=1e-12)
