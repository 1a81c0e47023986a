"""Butterworth low-passes of sensors against their closed form, in every engine."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from conftest import lattice

from nassim import (
    Accelerometer,
    AngleSensor,
    CurrentSensor,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Geophone,
    Joint,
    Loop,
    PointForce,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    StackSensor,
    TimeHistory,
    Vibrometer,
    VoiceCoil,
    craig_bampton,
    describe,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
)
from nassim.simulation import linearize_closed
from nassim.systems import proportional

BANDWIDTH = 40.0


def butterworth(order, frequency, bandwidth=BANDWIDTH):
    """Frequency response of SciPy's analogue Butterworth filter."""
    b, a = scipy.signal.butter(order, 2 * np.pi * bandwidth, analog=True)
    return scipy.signal.freqs(b, a, 2 * np.pi * frequency)[1]


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=1, progress=False)


def scene(body, *sensors, fidelity="linear", **changes):
    """A body on a slide, held by a spring, with a block at its end."""
    beam = FlexibleBody("beam", body, fidelity=fidelity)
    near, far = (beam.point_position(name) for name in ("left", "right"))
    ground = RigidBody("ground", {"o": near, "wall": far + 0.1}, fixed=True)
    block = RigidBody("block", {"p": [0, 0, 0]}, 0.5, 1e-3 * np.eye(3), far)
    return Scene(
        "filtered",
        (ground, beam, block),
        (prismatic("slide", "ground.o", "beam.left", "x", damping=8.0), Joint("mount", "beam.right", "block.p")),
        (
            PointForce("push", "block.p", "x", "force"),
            VoiceCoil("coil", "ground.wall", "block.p", "x", 5.0, 4.0, 1e-3, "voltage"),
        ),
        sensors,
        (SpringDamper("spring", "ground.o", "beam.left", "x", 2e4),),
        **{"damping_ratio": 0.01} | changes,
    )


X = Encoder("x", "ground.o", "block.p", "x")
SENSORS = (
    X,
    AngleSensor("angle", "beam.left", "block.p", "y"),
    Pose("pose", "ground.o", "block.p"),
    ForceSensor("pull", of="spring"),
    Vibrometer("speed", "block.p", "x"),
    Geophone("geophone", "block.p", "x"),
    Accelerometer("acceleration", "block.p", "x", resonance=300.0),
    StackSensor("stack", "beam.left", "beam.right", 1e6),
    CurrentSensor("current", "coil"),
)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7])
def test_every_sensor_has_the_closed_form_of_its_filter(body, order):
    frequency = np.geomspace(0.5, 400.0, 9)
    plain = frequency_response(linearize(scene(body, *SENSORS)), frequency)
    filtered = [replace(sensor, bandwidth=BANDWIDTH, order=order) for sensor in SENSORS]
    found = frequency_response(linearize(scene(body, *filtered)), frequency)
    assert found.outputs == plain.outputs
    expected = plain.values * butterworth(order, frequency)
    size = abs(expected).max(axis=2, keepdims=True) + 1e-30  # some outputs stay at rest by symmetry
    np.testing.assert_allclose(found.values / size, expected / size, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_slow_signals_come_later_by_the_delay_of_the_docs(body, order):
    both = scene(body, X, replace(X, name="y", bandwidth=BANDWIDTH, order=order))
    given = frequency_response(linearize(both), [1e-3])
    late = -np.angle(given.response("y", "force") / given.response("x", "force"))[0] / (2 * np.pi * 1e-3)
    assert late == pytest.approx(1 / (2 * np.pi * BANDWIDTH * np.sin(np.pi / (2 * order))), rel=1e-6)
    assert f"sensor y: low-pass of order {order} at 40 Hz" in describe(both)
    assert late == pytest.approx([0.16, 0.23, 0.32, 0.42][order - 1] / BANDWIDTH, rel=0.03)


def filtered_in_time(time, values, order):
    """A signal that is at rest on its first value, behind SciPy's filter."""
    b, a = scipy.signal.butter(order, 2 * np.pi * BANDWIDTH, analog=True)
    return values[0] + scipy.signal.lsim((b, a), values - values[0], time)[1]


PAIR = (X, replace(X, name="y", bandwidth=BANDWIDTH, order=3))


@pytest.mark.parametrize(
    ("fidelity", "method", "tolerance"),
    [("linear", "exact", 1e-4), ("linear", "generalized_alpha", 1e-9), ("ffrf", "generalized_alpha", 1e-9)],
)
def test_runs_filter_what_comes(body, fidelity, method, tolerance):
    """Gravity bends the beam before the start; exact steps know what happens between samples."""
    built = scene(body, *PAIR, fidelity=fidelity, gravity=[-9.81, 0.0, -2.0])
    time = np.arange(251) * 2e-4
    given = TimeHistory(time, [20.0 * np.sin(150.0 * time), 0 * time], ("force", "voltage"), ("N", "V"))
    record = simulate(built, given, time_step=2e-4, method=method, progress=False)
    expected = filtered_in_time(time, record["x"], 3)
    assert abs(record["x"][0]) > 1e-5
    np.testing.assert_allclose(record["y"], expected, rtol=0, atol=tolerance * np.ptp(record["x"]))
    assert np.ptp(expected - record["x"]) > 0.3 * np.ptp(record["x"])


def test_a_turntable_filters_too():
    """Relative motion on a rotor, in exact steps and in the linear model about its spin.

    The acceleration of a point that goes round is there before the start, so its filter starts at W^2 r.
    """
    ground = RigidBody("ground", {"o": [0, 0, 0]}, fixed=True)
    table = RigidBody("table", {"o": [0, 0, 0], "p": [0.02, 0, 0]}, 5.0, 0.05 * np.eye(3))
    cart = RigidBody("cart", {"o": [0, 0, 0]}, 2.0, 0.01 * np.eye(3), [0.02, 0, 0])
    plain = Encoder("x", "table.p", "cart.o", "x", "table.p")
    turntable = Scene(
        "turntable",
        (ground, table, cart),
        (revolute("axle", "ground.o", "table.o", "z"), prismatic("slide", "table.p", "cart.o", "x", damping=20.0)),
        (PointForce("push", "cart.o", "x", "force", "cart.o"), Drive("motor", "axle", "rz", speed=12.0)),
        (plain, replace(plain, name="y", bandwidth=BANDWIDTH, order=3)),
        (SpringDamper("spring", "table.p", "cart.o", "x", 8e3, frame="table.p"),),
        damping_ratio=0.0,
    )
    frequency = np.array([2.0, 20.0, 90.0])
    found = frequency_response(linearize(turntable), frequency)
    expected = found.response("x", "force") * butterworth(3, frequency)
    np.testing.assert_allclose(found.response("y", "force"), expected, rtol=1e-9)
    time = np.arange(126) * 2e-4
    given = TimeHistory(time, 20.0 * np.sin(150.0 * time), ("force",), ("N",))
    inward = Accelerometer("a", "table.p", "x", frame="table.p", resonance=BANDWIDTH)
    turntable = replace(turntable, sensors=(*turntable.sensors, inward))
    for method, tolerance in (("exact", 1e-4), ("generalized_alpha", 1e-9)):
        record = simulate(turntable, given, time_step=2e-4, method=method, progress=False)
        assert record["x"][0] > 1e-4
        expected = filtered_in_time(time, record["x"], 3)
        np.testing.assert_allclose(record["y"], expected, rtol=0, atol=tolerance * np.ptp(record["x"]))
        np.testing.assert_allclose(record["a"], -(12.0**2) * 0.02, rtol=1e-6)


def test_loops_measure_behind_the_filter(body):
    """The sampled closed loop has the phase of the filter, and exact steps are its time response."""
    law = proportional(-2e3, sample_rate=5e3)
    built = scene(body, PAIR[1], loops=(Loop("servo", law, "y", "force", reference="set"),))
    closed = linearize_closed(built)
    time = np.arange(301) * 2e-4
    given = TimeHistory(time, [1e-3 * (time >= 0.002), 0 * time, 0 * time], ("set", "voltage", "force"))
    record = simulate(built, given, time_step=2e-4, method="exact", hold_order=0, progress=False)
    state, expected = np.zeros(len(closed.A)), []
    column = closed.inputs.index("set")
    for value in given["set"]:
        expected.append((closed.C @ state + closed.D[:, column] * value)[closed.outputs.index("y")])
        state = closed.A @ state + closed.B[:, column] * value
    np.testing.assert_allclose(record["y"], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_bad_filters_are_refused_by_name(body):
    for change, message in (
        ({"bandwidth": 0.0}, "sensor 'x': bandwidth must be positive, got 0.0 Hz; inf for none"),
        ({"bandwidth": -3.0}, "sensor 'x': bandwidth must be positive"),
        ({"order": 0}, "sensor 'x': order must be a whole number from 1 to 8, got 0"),
        ({"bandwidth": 3.0, "order": 2.5}, "sensor 'x': order must be a whole number from 1 to 8, got 2.5"),
    ):
        with pytest.raises(ValueError, match=message):
            scene(body, replace(X, **change))
