"""Optional arguments within runs that no other test would miss."""

import re
import warnings
from dataclasses import dataclass, replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import lattice
from scipy.signal import cont2discrete, dlsim

from nassim import (
    Accelerometer,
    AngleSensor,
    Drive,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Loop,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
    simulate_motion,
    static_response,
)
from nassim.scene import Displacement, Output, Sensor
from nassim.simulation.model.axial_preload import estimated_stiffness
from nassim.simulation.model.runaway import runaway
from nassim.simulation.run.sampled_inputs import sample_excitation
from nassim.systems import proportional


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


def test_a_spin_that_has_stopped_is_told():
    """A bar that its hinge swings to and fro, at rest at the end, as fast as a tenth of its first frequency."""
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    rate = 2 * np.pi * 0.1 * reduced.eigenfrequencies(fixed=["left"])[0]
    ground = RigidBody("ground", {"p": reduced.point("left").position}, fixed=True)
    hinge, motor = revolute("hinge", "ground.p", "bar.left", "z"), Drive("motor", "hinge", "rz", "turn")
    scene = Scene("swing", (ground, FlexibleBody("bar", reduced)), (hinge,), (motor,), damping_ratio=0.0)
    time = np.linspace(0, 0.5 * np.pi / rate, 201)
    turn = TimeHistory(time, 0.5 * np.sin(2 * rate * time)[None] ** 2, ("turn",), ("rad",))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        simulate(scene, turn, time_step=time[1], progress=False)
    assert sum("centrifugal stiffening" in str(one.message) for one in told) == 1


def test_a_pulse_counts_by_its_share_of_the_run():
    """One between two steps, small beside what the record holds after the end of a short run."""
    time = np.arange(20001) * 1e-4
    values = (0.02 + time**2) * np.sin(20 * time)
    values[503] += 0.3
    record = TimeHistory(time, values[None], ("push",), ("N",))
    found = sample_excitation(block(), record, time_step=1e-3, duration=None)
    np.testing.assert_allclose(found["push"], values[::10], atol=1e-12)
    with pytest.raises(ValueError, match="straight lines between the steps lose"):
        sample_excitation(block(), record, time_step=1e-3, duration=0.1)


@dataclass(frozen=True)
class Relative(Sensor):
    """Acceleration of the block against the ground's point, each against inertial space."""

    def terms(self, scene):
        """One reading of two points."""
        row = Displacement.between("ground.p", "block.p", np.array([0.6, 0.0, 0.8]))
        return (Output(self.name, "m/s2", row, derivative=2, inertial=True),)


def test_the_ground_s_own_acceleration_is_no_relative_one():
    """What a sensor of one point reads beside the relative motion is the share of the ground along its axis."""
    scene = replace(
        block(),
        actuators=(GroundAcceleration("shake", (0.0, 0.28, 0.96), "shake"),),
        sensors=(
            Relative("apart"),
            Accelerometer("whole", "block.p", (0.6, 0.0, 0.8)),
            Encoder("way", "ground.p", "block.p", (0.6, 0.0, 0.8)),
        ),
    )
    frequency = np.array([3.0, 11.0, 40.0])
    apart, whole, way = frequency_response(linearize(scene), frequency).values[:, 0]
    np.testing.assert_allclose(apart, -((2 * np.pi * frequency) ** 2) * way, rtol=1e-9)
    np.testing.assert_allclose(whole, apart + 0.8 * 0.96, rtol=1e-9)


def test_a_loop_that_runs_away_is_told_by_what_has_grown():
    """Not by the signal that is largest, which may be in another unit and steady."""
    scene = replace(
        block(),
        sensors=(AngleSensor("large", "ground.p", "block.p", "x"), Encoder("growing", "ground.p", "block.p", "z")),
        loops=(Loop("loop", proportional([[1.0, 1.0]], sample_rate=1e3), ("large", "growing"), "push"),),
    )
    time = np.arange(801) * 1e-3
    outputs = np.column_stack([50 + np.sin(99 * time), 1e-6 * np.exp(8 * time) * np.sin(70 * time)])
    said = runaway(scene, "block", outputs, 1e-3)
    assert re.search(r"at t = 0\.8 s 'growing' has grown to \S+ m and block", said)


def test_a_twist_is_deformation_too():
    """A floating body that is twisted by 0.02 rad, with hardly any displacement of its points."""
    reduced = craig_bampton(lattice(), n_modes=1, progress=False)
    ground = RigidBody("ground", {"p": reduced.point("left").position}, fixed=True)
    torque = PointTorque("torque", "bar.right", "x", "torque")
    turn = AngleSensor("turn", "ground.p", "bar.right", "x")
    scene = Scene(
        "bar", (ground, FlexibleBody("bar", reduced)), (fixed("foot", "ground.p", "bar.left"),), (torque,), (turn,)
    )
    compliance = float(-linearize(scene).C[0] @ np.linalg.solve(linearize(scene).A, linearize(scene).B[:, 0]))
    with pytest.warns(UserWarning, match=r"body 'bar' is deformed by up to 0?.*% of its size and 0\.02 rad"):
        static_response(scene, {"torque": 0.02 / compliance})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = static_response(scene, {"torque": 0.009 / compliance})
    assert found["turn"] == pytest.approx(0.009, rel=1e-3)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0), (2, 1, 0)])
def test_the_order_of_its_points_does_not_matter_to_a_body_s_buckling(order):
    """A mode with all points held is softened by the line with the most pressure over its length, wherever that is."""
    places = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.0], [0.1, 0.4, 0.2]])
    tension = {(0, 1): -50.0, (0, 2): -400.0, (1, 2): 30.0}

    def softened(order):
        points = [SimpleNamespace(position=places[k]) for k in order]
        mass, n = np.eye(19), 19
        mass[18, 18] = 1.0
        body = SimpleNamespace(
            remote_points=points,
            positions=places[list(order)],
            stiffness_matrix=np.zeros((n, n)),
            mass_matrix=mass,
            mass=2.5,
        )
        lines = [tension[tuple(sorted((order[i], order[j])))] for i, j in combinations(range(3), 2)]
        return estimated_stiffness(body, lines)

    there = np.concatenate([*(6 * order.index(k) + np.arange(6) for k in range(3)), [18]])
    found = softened(order)[np.ix_(there, there)]
    np.testing.assert_allclose(found, softened((0, 1, 2)), atol=1e-9)
    assert found[18, 18] == pytest.approx(-12.3 * 400 / np.linalg.norm(places[2]) / 2.5)


@pytest.mark.filterwarnings("ignore:damping_ratio acts")
@pytest.mark.parametrize(
    "options",
    [
        {"method": "exact", "hold_order": 0, "duration": 0.05, "outputs": ["way"]},
        {"method": "exact", "start": "released", "outputs": ["side", "way"]},
        {"spectral_radius": 0.3, "duration": 0.04},
    ],
)
def test_a_run_with_its_motion_is_the_run(options, capsys):
    """The same record by the same options, each of which matters, and the motion of the body that it reads."""
    side = Encoder("side", "ground.p", "block.p", "x")
    scene = replace(block(), sensors=(*block().sensors, side), gravity=np.array([1.0, 0.0, -9.0]))
    given = {"time_step": 2e-3, "progress": False} | options
    history = record(200, 5e-4)
    plain = simulate(scene, history, **given)
    assert plain.names == ("push", *options.get("outputs", ("way", "side")))
    assert plain.duration == pytest.approx(options.get("duration", 0.1))
    found, motion = simulate_motion(scene, history, frames=5, **given)
    assert found.names == plain.names
    np.testing.assert_array_equal(found.values, plain.values)
    np.testing.assert_allclose(motion.positions["block"][:, 2], np.interp(motion.time, plain.time, plain["way"]))
    assert not capsys.readouterr().out
    for option in options.keys() - {"method", "duration", "outputs"}:
        other = simulate(scene, history, **{k: v for k, v in given.items() if k != option})
        assert np.abs(other["way"] - plain["way"]).max() > 1e-6 * np.abs(plain["way"]).max()


def test_what_hangs_on_a_drive_starts_to_move_along():
    """An input that begins with a rate: a floating body goes along from the first step, and does not ring."""
    axis, speed = np.array([0.6, 0.0, 0.8]), 0.03
    bar = FlexibleBody("bar", craig_bampton(lattice(stiffness=1e4), n_modes=1, progress=False))
    place = bar.point_position("left")
    ground = RigidBody("ground", {"p": place}, fixed=True)
    scene = Scene(
        "stage",
        (ground, RigidBody("carriage", {"p": np.zeros(3)}, 2.0, np.eye(3), place), bar),
        (prismatic("slide", "ground.p", "carriage.p", axis), fixed("foot", "carriage.p", "bar.left")),
        (Drive("motor", "slide", "z", "way"),),
        (Encoder("apart", "bar.left", "bar.right", axis),),
        damping_ratio=0.0,
    )
    time, found = np.arange(201) * 1e-4, []
    for start in (speed * time, speed * np.maximum(time - 5e-4, 0.0)):
        run = simulate(scene, TimeHistory(time, start[None], ("way",), ("m",)), time_step=1e-4, progress=False)
        found.append(np.abs(run["apart"]).max())
    assert found[0] < 1e-6 * found[1]
    assert found[1] > 1e-6


def test_white_noise_of_a_converter_is_held_exactly():
    """Frequencies up to half the sample rate, which straight lines would lose; discretised by scipy.

    Seconds since 1970 are rounded by a fifty-thousandth of a step.
    """
    values = np.random.default_rng(3).standard_normal((1, 200))
    noise = TimeHistory(2.0 + np.arange(200) * 1e-2, values, ("push",), ("N",))
    a, b, c, d, _ = cont2discrete([np.array(m) for m in ([[0, 1], [-5e3, 0]], [[0], [0.5]], [[1, 0]], [[0]])], 1e-2)
    expected = dlsim((a, b, c, d, 1e-2), values[0])[1][:, 0]
    options = {"method": "exact", "progress": False}
    for start, error in ((2.0, 1e-9), (1.7e9, 1e-4)):
        late = replace(noise, time=start + np.arange(200) * 1e-2)
        found = simulate(block(), late, time_step=1e-2, hold_order=0, **options)["way"]
        np.testing.assert_allclose(found, expected, atol=error * np.abs(expected).max())
    for refused in ({"time_step": 1e-2}, {"time_step": 2e-2, "hold_order": 0}):
        with pytest.raises(ValueError, match="is too long: the excitation"):
            simulate(block(), noise, **refused, **options)
