"""Exudyn against the linear model, closed forms and the reduction; bad input."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from scipy.spatial.transform import Rotation

from models.bench import make_bench
from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    estimate_frf,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
    static_response,
)
from nassim.signals.excitations import multisine, sine_dwell
from nassim.simulation.model.assembly import assemble
from nassim.simulation.run.simulate import exudyn_eigenfrequencies


def quiet(duration, sample_rate=1e4):
    time = np.arange(round(duration * sample_rate) + 1) / sample_rate
    return TimeHistory(time, np.zeros(len(time)), ("actuator_voltage",), ("V",))


def test_eigenfrequencies_equal_the_reductions(bench, apa):
    found = exudyn_eigenfrequencies(bench, n_modes=10)
    expected = apa.eigenfrequencies(fixed=["bottom"], guided={"top": "z"}, n=10)
    with_payload = assemble(bench).modal.frequency[:10]
    assert np.allclose(found, with_payload, rtol=1e-6)
    assert found[0] < expected[0]
    assert found[0] == pytest.approx(
        apa.eigenfrequencies(fixed=["bottom"], guided={"top": "z"}, masses={"top": 5.0})[0], rel=1e-6
    )


def test_static_answer_to_a_voltage_equals_the_compliance(bench, apa):
    """K^-1 F with the stack's force pair, from the reduced stiffness alone."""
    compliance = apa.compliance(fixed=["bottom"], guided={"top": "z"})
    names = apa.coordinate_names
    force = np.zeros(30)
    actuator, sensor = bench.actuators[0], bench.sensors[0]
    force[names.index("actuator_end.ux")] = actuator.gain * actuator.force_per_volt
    force[names.index("junction.ux")] = -actuator.gain * actuator.force_per_volt
    motion = compliance @ force
    found = static_response(bench, {"actuator_voltage": 1.0})
    assert found["encoder"] == pytest.approx(motion[names.index("top.uz")], rel=1e-6)
    elongation = motion[names.index("junction.ux")] - motion[names.index("sensor_end.ux")]
    assert found["sensor_voltage"] == pytest.approx(-sensor.voltage_per_elongation * elongation, rel=1e-6)


def test_weight_of_the_payload_compresses_the_actuator(apa):
    """m g / k, plus the part of the actuator's own weight that its top carries."""
    top = apa.coordinate_names.index("top.uz")
    compliance = apa.compliance(fixed=["bottom"], guided={"top": "z"})
    rigid_z = np.zeros(len(apa.mass_matrix))
    rigid_z[2:30:6] = 1.0
    weight = -9.81 * (apa.mass_matrix @ rigid_z)[:30]
    weight[top] -= 9.81 * 5.0
    expected = (compliance @ weight)[top]
    assert static_response(make_bench(apa=apa, gravity=True))["encoder"] == pytest.approx(expected, rel=1e-6)


def test_start_under_gravity_does_not_ring(apa):
    bench = make_bench(apa=apa, gravity=True)
    record = simulate(bench, quiet(0.1), time_step=1e-4, progress=False)
    assert record["encoder"][0] == pytest.approx(static_response(bench)["encoder"], rel=1e-9)
    assert np.ptp(record["encoder"]) < 1e-6 * abs(record["encoder"][0])


@pytest.mark.usefixtures("plain_steps")
def test_simulation_follows_the_linear_model(bench):
    """Against the trapezoidal rule on the state space with the same step: the same method, so almost no difference."""
    excitation = sine_dwell(0.1, 1e4, frequency=60.0, amplitude=0.1)
    record = simulate(bench, excitation, time_step=1e-4, progress=False)
    model = linearize(bench)
    a, b, c, d, _ = scipy.signal.cont2discrete((model.A, model.B, model.C, model.D), 1e-4, method="bilinear")
    _, expected, _ = scipy.signal.dlsim((a, b, c, d, 1e-4), excitation.values[0])
    for column, name in enumerate(model.outputs):
        scale = np.abs(expected[:, column]).max()
        assert np.allclose(record[name], expected[:, column], atol=1e-3 * scale), name


@pytest.mark.slow
def test_frf_from_the_simulation_equals_the_linear_model(bench):
    """1 dB and 5 degrees where the coherence exceeds 0.99, 10 to 500 Hz."""
    excitation = multisine(3.0, 1e4, lowest_frequency=10, highest_frequency=500, period=1.0, rms=0.1)
    record = simulate(bench, excitation, time_step=1e-4, progress=False).after(1.0)
    estimated = estimate_frf(
        record,
        inputs=bench.inputs,
        outputs=bench.outputs,
        segment_duration=1.0,
        overlap=0.0,
        window="boxcar",
    ).band(10, 500)
    expected = frequency_response(linearize(bench), estimated.frequency)
    assert estimated.coherence is not None
    for row in range(2):
        good = estimated.coherence[row] > 0.99
        assert good.mean() > 0.9
        ratio = estimated.values[row, 0, good] / expected.values[row, 0, good]
        assert np.abs(20 * np.log10(np.abs(ratio))).max() < 1.0
        assert np.abs(np.angle(ratio, deg=True)).max() < 5.0


def test_modal_damping_is_what_the_scene_states(apa):
    scene = make_bench(apa=apa, damping_ratio=0.03)
    poles = linearize(scene).poles()
    assert np.allclose(-poles.real / np.abs(poles), 0.03, rtol=1e-6)
    assembly = assemble(scene)
    frame = assembly.coordinates.frames["apa"]
    body = scene.flexible_bodies[0].reduced
    shapes = frame.deformation(body) @ assembly.modal.basis[assembly.coordinates.slices["apa"]] @ assembly.modal.shapes
    modal = shapes.T @ assembly.modal.damping.on_deformation() @ shapes
    expected = np.diag(2 * 0.03 * 2 * np.pi * assembly.modal.frequency)
    assert np.allclose(modal, expected, atol=1e-9 * expected.max())


def test_two_flexible_bodies_share_the_modal_damping(apa):
    """Two actuators in series: Exudyn and the linear model agree, so the coupled damping does too."""
    shift = apa.point("top").position - apa.point("bottom").position
    low = make_bench(apa=apa)
    payload = low.bodies[2]
    raised = RigidBody("payload", payload.points, payload.mass, payload.inertia, payload.position + shift)
    top = apa.point("top").position + shift
    scene = Scene(
        "two",
        (
            RigidBody("base", {"top": apa.point("bottom").position, "guide": top}, fixed=True),
            FlexibleBody("apa", apa),
            FlexibleBody("upper", apa, position=shift),
            raised,
        ),
        (
            Joint("clamp", "base.top", "apa.bottom"),
            Joint("middle", "apa.top", "upper.bottom"),
            Joint("mount", "upper.top", "payload.bottom"),
            Joint("guide", "base.guide", "payload.bottom", free=("z",)),
        ),
        low.actuators,
        low.sensors,
        damping_ratio=0.05,
    )
    excitation = sine_dwell(0.05, 1e4, frequency=70.0, amplitude=0.1)
    record = simulate(scene, excitation, time_step=1e-4, progress=False)
    model = linearize(scene)
    a, b, c, d, _ = scipy.signal.cont2discrete((model.A, model.B, model.C, model.D), 1e-4, method="bilinear")
    _, expected, _ = scipy.signal.dlsim((a, b, c, d, 1e-4), excitation.values[0])
    assert np.allclose(record["encoder"], expected[:, 1], atol=2e-3 * np.abs(expected[:, 1]).max())


def test_time_step_too_long_for_the_excitation(bench):
    with pytest.raises(ValueError, match="too long: the excitation holds frequencies up to"):
        simulate(bench, sine_dwell(0.1, 1e4, frequency=400.0), time_step=1e-3, progress=False)


def test_a_run_without_an_excitation_has_inputs_of_zero():
    """A mass that hangs from a spring falls from its reference configuration; other kinds of excitation are refused."""
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    mass = RigidBody("mass", {"c": np.zeros(3)}, 2.0, np.eye(3))
    scene = Scene(
        "mass",
        (ground, mass),
        (prismatic("slide", "ground.o", "mass.c", "z"),),
        (PointForce("push", "mass.c", "z", "force"),),
        (Encoder("z", "ground.o", "mass.c", "z"),),
        (SpringDamper("spring", "ground.o", "mass.c", "z", stiffness=800.0),),
        gravity=(0, 0, -9.81),
        damping_ratio=0.0,
    )
    record = simulate(scene, None, duration=0.2, time_step=1e-3, method="exact", start="released", progress=False)
    assert record.names == ("force", "z")
    np.testing.assert_allclose(record["z"], 2 * 9.81 / 800 * (np.cos(20 * record.time) - 1), rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r"a run without an excitation needs a duration \[s\]"):
        simulate(scene, None, time_step=1e-3)
    with pytest.raises(TypeError, match=r"must be a TimeHistory of the inputs \(force\), or None .* got ndarray"):
        simulate(scene, np.zeros(201), time_step=1e-3)


def test_a_pendulum_released_in_small_motion_has_the_stiffness_of_its_weight():
    """Drawn at 0.02 rad beside the vertical, about which it swings by sqrt(m g l / (I + m l^2))."""
    mass, arm, inertia, axis, angle = 2.0, 0.3, 0.05, np.array([2.0, -1.0, 0.0]) / np.sqrt(5), 0.02
    down = -arm * np.array([0.0, 0.0, 1.0])
    place = Rotation.from_rotvec(angle * axis).apply(down)
    bob = RigidBody("bob", {"c": np.zeros(3), "pin": -place}, mass, inertia * np.eye(3), place)
    scene = Scene(
        "pendulum",
        (RigidBody("ground", {"o": np.zeros(3)}, fixed=True), bob),
        (revolute("pin", "ground.o", "bob.pin", axis),),
        sensors=(Encoder("way", "ground.o", "bob.c", np.cross(axis, down) / arm),),
        gravity=(0, 0, -9.81),
        damping_ratio=0.0,
    )
    record = simulate(scene, None, duration=2.0, time_step=1e-2, method="exact", start="released", progress=False)
    way = (record["way"] - record["way"][0]) / (arm * angle)
    omega = np.sqrt(mass * 9.81 * arm / (inertia + mass * arm**2))
    np.testing.assert_allclose(way, np.cos(omega * record.time) - 1, rtol=0, atol=2e-3)


def test_unknown_names_list_the_known_ones(bench):
    excitation = sine_dwell(0.1, 1e4, frequency=50.0, name="voltage")
    with pytest.raises(ValueError, match="lacks the input"):
        simulate(bench, excitation, time_step=1e-4, progress=False)
    with pytest.raises(ValueError, match="known: sensor_voltage, encoder"):
        simulate(bench, quiet(0.1), time_step=1e-4, outputs=["force"], progress=False)
    with pytest.raises(ValueError, match="known: actuator_voltage"):
        static_response(bench, {"voltage": 1.0})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time_step": -1e-4}, "time_step must be positive"),
        ({"time_step": 1e-4, "duration": 1.0}, "longer than the excitation"),
        ({"time_step": 1.0}, "longer than the duration"),
        ({"time_step": 1e-4, "method": "euler"}, "known: generalized_alpha"),
    ],
)
def test_bad_options(bench, options, message):
    with pytest.raises(ValueError, match=message):
        simulate(bench, quiet(0.1), progress=False, **options)


def test_body_that_falls_has_no_equilibrium(apa):
    scene = Scene("fall", (FlexibleBody("apa", apa),), gravity=np.array([0, 0, -9.81]))
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        static_response(scene)


def test_interrupt_ends_a_run_cleanly(bench):
    """Ctrl-C during the integration arrives as KeyboardInterrupt, and soon."""
    import signal
    import threading
    import time

    handler = signal.getsignal(signal.SIGINT)
    timer = threading.Timer(0.5, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt, match="stopped at t ="):
        simulate(bench, quiet(20.0), time_step=1e-4, progress=False)
    assert time.perf_counter() - start < 20.0
    assert signal.getsignal(signal.SIGINT) is handler


def test_inputs_push_beside_the_weight_and_beside_each_other(apa):
    """A voltage and two forces on a payload that hangs in its weight, in small motion against the exact solution."""
    bench = make_bench(apa=apa, fidelity="linear")
    forces = (
        PointForce("first", "payload.bottom", "z", "first"),
        PointForce("second", "payload.bottom", "z", "second"),
    )
    scene = replace(bench, actuators=(*bench.actuators, *forces), gravity=np.array([0, 0, -9.81]))
    time = np.arange(301) * 1e-4
    values = [0.5 * np.sin(300 * time), 20 * np.sin(500 * time), 30 * np.sin(200 * time)]
    pushes = TimeHistory(time, values, ("actuator_voltage", "first", "second"), ("V", "N", "N"))
    stepped, exact = (
        simulate(scene, pushes, time_step=1e-4, method=method, progress=False)["encoder"]
        for method in ("generalized_alpha", "exact")
    )
    assert exact[0] < -1e-5
    np.testing.assert_allclose(stepped, exact, atol=1e-3 * np.ptp(exact))
