"""What a sensor's cable and electronics do to its reading; open circuits in error figures; trimmed scenes' statics."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from conftest import lattice

from nassim import (
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    StackActuator,
    StackSensor,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
    frequency_response,
    linearize,
    open_circuit,
    placed,
    prismatic,
    simulate,
    static_response,
    trim_scene,
    truncation_error,
)
from nassim.bodies.piezo import PortCoupling
from nassim.fem.fe_model import make_coupling
from nassim.scene.part import Sensor
from nassim.scene.terms import OutputFilter
from nassim.simulation.run.simulate import exudyn_eigenfrequencies

CAPACITANCE = 1e-6
TURN = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


@pytest.fixture(scope="module")
def model():
    """A lattice with a third remote point inside and two electrical ports that stretch a layer each."""
    plain = lattice(n=5, stiffness=1e5)
    x = plain.fields[1]
    inner = np.flatnonzero(np.abs(x - 0.02) < 1e-9)
    point = RemotePoint("middle", "middle", [0.02, 0.01, 0.01])
    middle = make_coupling(point, inner, plain.fields[:, inner], plain.fields[:, inner])
    ports = []
    for name, start, end, strength in (("drive", 0.01, 0.02, 2.0), ("sense", 0.02, 0.03, 0.5)):
        along = strength * (np.isclose(x, end).astype(float) - np.isclose(x, start)) / 9
        ports.append(PortCoupling(name, np.concatenate([along, 0 * along, 0 * along]), CAPACITANCE))
    return replace(plain, couplings=(*plain.couplings, middle), ports=tuple(ports))


@pytest.fixture(scope="module")
def body(model):
    return craig_bampton(model, n_modes=3, progress=False)


@dataclass(frozen=True)
class LowPassed(Sensor):
    """Another sensor behind a low-pass of 1 Hz."""

    name: str
    sensor: Sensor

    def terms(self, scene):
        return (*self.sensor.terms(scene), OutputFilter(self.name, "low", 1.0))


def held(body, sensor, fidelity="linear", **options):
    """The body turned, clamped at its left, with a small payload at its right that a force pulls along the body."""
    at = [TURN @ body.point(name).position for name in ("left", "right")]
    base = RigidBody("base", {"o": np.zeros(3)}, position=at[0], fixed=True)
    payload = RigidBody("payload", {"foot": np.zeros(3)}, 0.01, 1e-6 * np.diag([1.0, 2.0, 2.5]), at[1])
    return Scene(
        "held",
        (base, FlexibleBody("body", body, rotation=TURN, fidelity=fidelity), payload),
        (Joint("clamp", "base.o", "body.left"), Joint("mount", "body.right", "payload.foot")),
        (PointForce("pull", "payload.foot", "z", "force"),),
        (sensor,),
        **{"damping_ratio": 0.0} | options,
    )


def short_circuit(body):
    """Charge per newton of pull with the port shorted, and the charge that its own volt brings by stretching."""
    free = np.arange(6, len(body.mass_matrix))
    flexibility = np.linalg.inv(body.stiffness_matrix[np.ix_(free, free)])
    forces = body.port("sense").forces[free]
    pull = np.eye(len(body.mass_matrix))[6 * body.point_names.index("right")][free]
    return forces @ flexibility @ pull, forces @ flexibility @ forces


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
@pytest.mark.parametrize("cable", [0.0, 0.5, 3.0])
def test_cable_takes_its_share_of_an_open_sensors_voltage(body, fidelity, cable):
    """The charge spreads over the port, free to stretch, and the cable: V = -Q / (c + c_stretch + C)."""
    charge, stretch = short_circuit(body)
    assert stretch > 0.1 * CAPACITANCE
    sensor = VoltageSensor("voltage", "body.sense", capacitance=cable * CAPACITANCE, gain=4.0)
    found = static_response(held(body, sensor, fidelity), {"force": 1e-3})["voltage"]
    expected = -4.0 * 1e-3 * charge / (CAPACITANCE * (1 + cable) + stretch)
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("cable", [0.0, 3.0])
def test_cable_lowers_a_resistive_sensors_corner(body, cable):
    """V = -s R Q / (1 + s R (c + c_stretch + C)) well below the resonance, whose inertia adds some 1e-5."""
    charge, stretch = short_circuit(body)
    total, resistance = CAPACITANCE * (1 + cable) + stretch, 3e5
    sensor = VoltageSensor("voltage", "body.sense", resistance, cable * CAPACITANCE)
    scene = held(body, sensor)
    s = 2j * np.pi * np.array([0.01, 0.1, 0.5, 1.0])
    found = frequency_response(linearize(scene), s.imag / (2 * np.pi)).values[0, 0]
    np.testing.assert_allclose(found, -s * resistance * charge / (1 + s * resistance * total), rtol=1e-3)

    time = np.arange(2001) * 1e-3

    def pull(t):
        return 1e-3 * np.sin(np.pi * t / 2.0) ** 2

    def rate(t, voltage):
        slope = 1e-3 * np.pi / 2.0 * np.sin(np.pi * t)
        return -(voltage / resistance + charge * slope) / total

    expected = scipy.integrate.solve_ivp(rate, (0, 2), [0.0], t_eval=time, rtol=1e-9, atol=1e-15, max_step=0.01).y[0]
    record = TimeHistory(time, pull(time)[None], ("force",), ("N",))
    for of in (scene, held(body, sensor, "ffrf")):
        found = simulate(of, record, time_step=1e-3, progress=False)["voltage"]
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def with_sensors(body, *sensors, **options):
    """The body held, with sensors at its ports, and their stiffness by hand: K + sum of b b^T / c, clamped modes."""
    scene = held(body, sensors[0], **options)
    scene = replace(scene, sensors=sensors)
    stiffness = body.stiffness_matrix[6:, 6:].copy()
    for sensor in sensors:
        forces = body.port(sensor.port.partition(".")[2]).forces[6:]
        stiffness += np.outer(forces, forces) / (CAPACITANCE + sensor.capacitance)
    pull = np.eye(len(body.mass_matrix))[6 * body.point_names.index("right")][6:]
    return scene, np.linalg.solve(stiffness, pull), stiffness


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_two_open_stacks_hold_together(body, fidelity):
    """Both charges stiffen the body, each by its own cable; whatever their resistances, in Exudyn's eigenvalues."""
    sensors = (
        VoltageSensor("voltage", "body.sense", capacitance=2e-7),
        VoltageSensor("other", "body.drive", capacitance=5e-7),
    )
    scene, moved, stiffness = with_sensors(body, *sensors, fidelity=fidelity)
    found = static_response(scene, {"force": 1e-3})
    for sensor in sensors:
        forces = body.port(sensor.port.partition(".")[2]).forces[6:]
        expected = -1e-3 * forces @ moved / (CAPACITANCE + sensor.capacitance)
        assert found[sensor.name] == pytest.approx(expected, rel=1e-5)
    mass = body.mass_matrix[6:, 6:].copy()
    place = 6 * (body.point_names.index("right") - 1)
    inertia = 1e-6 * TURN.T @ np.diag([1.0, 2.0, 2.5]) @ TURN
    mass[place : place + 6, place : place + 6] += scipy.linalg.block_diag(0.01 * np.eye(3), inertia)
    expected = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[:6]) / (2 * np.pi)
    for resistance in (np.inf, 1e4):
        leaky = replace(scene, sensors=tuple(replace(sensor, resistance=resistance) for sensor in sensors))
        np.testing.assert_allclose(exudyn_eigenfrequencies(leaky, n_modes=6), expected, rtol=1e-5)


@pytest.mark.parametrize(("fidelity", "method"), [("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", None)])
def test_charges_are_drained_where_a_run_begins_under_gravity(body, fidelity, method):
    """Nothing moves, no voltage is there, and a low-pass has long taken what it reads."""
    sensor = VoltageSensor("voltage", "body.sense", 1e4, 2e-7)
    scene, *_ = with_sensors(body, sensor, fidelity=fidelity, gravity=(0.5, -1.0, -4.0))
    way = Encoder("way", "base.far", "payload.foot", "z")
    base = replace(scene.bodies[0], points={"o": np.zeros(3), "far": np.array([0.1, 0.2, 0.3])})
    slow = replace(way, name="slow")
    scene = replace(scene, bodies=(base, *scene.bodies[1:]), sensors=(sensor, way, LowPassed("slow", slow)))
    still = TimeHistory(2.0 + 1e-4 * np.arange(301), np.zeros((1, 301)), ("force",), ("N",))
    record = simulate(scene, still, time_step=1e-4, method=method or "generalized_alpha", progress=False)
    sag = record["way"]
    kept = static_response(replace(scene, sensors=(replace(sensor, resistance=np.inf), way)))
    assert np.abs(kept["way"] - sag[0]) > 0.01 * abs(sag[0]), "the charge matters here"
    np.testing.assert_allclose(sag, sag[0], rtol=1e-5)
    np.testing.assert_allclose(record["slow"], sag[0], rtol=1e-5)
    np.testing.assert_allclose(record["voltage"], 0.0, atol=1e-4 * abs(kept["voltage"]))


@pytest.mark.parametrize("resistance", [np.inf, 1e8])
def test_an_amplifier_drives_a_port_by_its_gain_and_bandwidth(body, resistance):
    """Beside a port whose charge leaks, too."""
    sensor = VoltageSensor("voltage", "body.sense", resistance)
    plain = replace(held(body, sensor), actuators=(VoltageDrive("amplifier", "body.drive", "volts"),))
    fine = replace(plain, actuators=(VoltageDrive("amplifier", "body.drive", "volts", 2.5, 40.0),))
    frequency = np.array([0.5, 30.0, 200.0])
    one, other = (frequency_response(linearize(scene), frequency).values[0, 0] for scene in (plain, fine))
    np.testing.assert_allclose(other, one * 2.5 / (1 + 1j * frequency / 40.0), rtol=1e-9)
    if np.isinf(resistance):
        assert static_response(fine, {"volts": 2.0})["voltage"] == pytest.approx(5 * one[0].real, rel=1e-2)


def test_ports_of_a_placed_scene(body):
    """Their rows go with the body, which has another name."""
    scene = held(body, VoltageSensor("voltage", "body.sense", 1e4))
    frequency = np.array([0.5, 30.0, 200.0])
    expected = frequency_response(linearize(scene), frequency).values
    moved = placed(scene, "here", position=(1.0, 2.0, 3.0), rotation=TURN)
    np.testing.assert_allclose(frequency_response(linearize(moved), frequency).values, expected, rtol=1e-6)


def test_truncation_error_of_an_open_circuit(body):
    """Both the body and its richer form are stiffer by b b^T / c: eigenvalues of the two by SciPy."""
    opened = open_circuit(body, {"sense": 2e-7})

    def frequencies(of):
        forces = of.port("sense").forces
        stiffness = of.stiffness_matrix + np.outer(forces, forces) / (CAPACITANCE + 2e-7)
        values = scipy.linalg.eigh(stiffness[6:, 6:], of.mass_matrix[6:, 6:], eigvals_only=True)
        return np.sqrt(values) / (2 * np.pi)

    expected = frequencies(body) / frequencies(body.enriched)[: len(body.mass_matrix) - 6] - 1
    found = opened.truncation_errors(fixed=["left"])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    short = body.truncation_errors(fixed=["left"])
    assert np.abs(found - short).max() > 1e-3, "the port matters here"


def test_truncation_error_of_a_scene_with_an_open_sensor(body):
    sensor = VoltageSensor("voltage", "body.sense", capacitance=CAPACITANCE)
    scene = held(body, sensor, damping_ratio=0.01)
    frequency = np.array([1.0, 50.0, 300.0])
    found, better = (frequency_response(linearize(held(b, sensor)), frequency).values for b in (body, body.enriched))
    undamped = replace(scene, damping_ratio=0.0)
    np.testing.assert_allclose(truncation_error(undamped, frequency), np.abs(found / better - 1), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_trimmed_scenes_keep_their_statics(body, fidelity):
    """Stacks and ports anywhere in the body, though the middle point and all modes are left out."""
    scene = held(body, Encoder("tip", "base.o", "payload.foot", "z"), fidelity)
    scene = replace(
        scene,
        actuators=(
            *scene.actuators,
            StackActuator("stack", "body.left", "body.middle", 3.0, "stack"),
            VoltageDrive("amplifier", "body.drive", "volts", gain=0.5),
        ),
        sensors=(
            *scene.sensors,
            StackSensor("length", "body.middle", "body.right", 1e4),
            VoltageSensor("voltage", "body.sense", capacitance=2e-7),
        ),
    )
    trimmed = replace(scene, cutoff_frequency=10.0)
    left = trim_scene(trimmed).bodies[1].reduced
    assert left.point_names == ("left", "right")
    assert len(left.mass_matrix) < len(body.mass_matrix)
    for name in scene.inputs:
        expected = np.array(list(static_response(scene, {name: 1e-3}).values()))
        found = np.array(list(static_response(trimmed, {name: 1e-3}).values()))
        assert np.all(expected != 0)
        np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.parametrize("resistance", [3e5, 3.0])
def test_charge_of_what_a_drive_strains(body, resistance):
    """A drive that pulls the body, as a force that moves a mass of a thousand tons: F = M s^2 u."""
    plain = held(body, VoltageSensor("voltage", "body.sense", resistance))
    heavy = replace(plain.bodies[2], points={"foot": np.zeros(3), "rail": np.zeros(3)}, mass=1e6)
    base = replace(plain.bodies[0], points={"o": np.zeros(3), "rail": heavy.position - plain.bodies[0].position})
    joints = (*plain.joints, prismatic("rail", "base.rail", "payload.rail", "z"))
    pushed = replace(plain, bodies=(base, plain.bodies[1], heavy), joints=joints)
    followed = replace(pushed, actuators=(Drive("drive", "rail", "z", "way"),))
    s = 2j * np.pi * np.array([300.0, 1000.0, 3000.0])
    force, way = (frequency_response(linearize(of), s.imag / (2 * np.pi)).values[0, 0] for of in (pushed, followed))
    np.testing.assert_allclose(way, force * 1e6 * s**2, rtol=1e-5)

    step = 1e-5
    time = np.arange(401) * step
    record = TimeHistory(time, 1e-6 * np.sin(np.pi * time / 2e-3)[None] ** 4, ("way",), ("m",))
    exact = simulate(followed, record, time_step=step, method="exact", progress=False)["voltage"]
    for of in (followed, replace(followed, bodies=(base, replace(plain.bodies[1], fidelity="ffrf"), heavy))):
        found = simulate(of, record, time_step=step, progress=False)["voltage"]
        np.testing.assert_allclose(found, exact, atol=3e-3 * np.abs(exact).max())
