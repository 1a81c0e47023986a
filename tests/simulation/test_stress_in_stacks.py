"""Stress and strain in piezo stacks whose voltage is that of an amplifier or of a resistance, in every engine.

The stack is one-dimensional: its Poisson's ratio is minus its transverse ratio. A voltage V then gives the stress
E (strain - d V / L), which is the force of what holds its ends over its cross-section.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import netgen.occ as occ
import numpy as np
import pytest
from conftest import meshed
from scipy.spatial.transform import Rotation

from nassim import (
    Controller,
    Drive,
    ElectricalPort,
    FlexibleBody,
    GaugeLine,
    Loop,
    Material,
    PiezoStack,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    SpringDamper,
    StrainGauge,
    StressAt,
    StressPoint,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    craig_bampton,
    fixed,
    frequency_response,
    linearize,
    load_limit,
    peak_stress,
    prismatic,
    simulate,
    simulate_motion,
    static_motion,
    static_response,
    stress_convergence,
)
from nassim.fem import generate_mesh
from nassim.scene import AppliedForce, BodyCoordinates, Combination, Output, Sensor, Spring, SpringForce, stress_peaks
from nassim.scene.motion import point_motion
from nassim.scene.stress_peaks import sensor_stress

STACK = PiezoStack(
    free_stroke=20e-6, blocked_force=1000.0, voltage_range=200.0, stiffness=50e6, capacitance=5e-6, length=20e-3,
    area=25e-6, transverse_ratio=-0.3,
)  # fmt: skip
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
ORIGIN = np.array([0.3, -0.2, 0.5])
ALONG = TURN[:, 0]
GAIN, VOLTS = 20.0, 5.0
ENGINES = [("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")]


@pytest.fixture(scope="module")
def stack():
    box = occ.Box(occ.Pnt(0, -2.5e-3, -2.5e-3), occ.Pnt(20e-3, 2.5e-3, 2.5e-3))
    box.solids.name, box.faces.Min(occ.X).name, box.faces.Max(occ.X).name = "stack", "left", "right"
    points = tuple(RemotePoint(n, n, np.array([x, 0, 0])) for n, x in (("left", 0.0), ("right", 20e-3)))
    material = Material("ceramic", STACK.young_modulus, 0.3, 8000.0)
    solid = Solid("stack", box, {"stack": material}, points, (ElectricalPort("v", "stack", STACK),))
    model = meshed(generate_mesh(solid, element_size=0.01, layer_thickness=0.005, extrude="x"), solid, 2)
    places = [StressPoint("middle", (0.01, 1e-3, 0.0)), GaugeLine("gauge", (0.01, 0.0, 2.5e-3), (1, 0, 0), 0.01)]
    return craig_bampton(model, n_modes=2, stress=places, discretization=False, progress=False)


def held(body, against=0.0, fidelity="linear", **options):
    """The stack on a wall in a general position, driven against a spring of some stiffness, or between two walls."""
    tip = ORIGIN + TURN @ [20e-3, 0, 0]
    wall = RigidBody("wall", {"face": ORIGIN, "other": tip, "far": tip + 0.1 * ALONG}, fixed=True)
    joints, springs = (fixed("clamp", "wall.face", "stack.left"),), ()
    if np.isinf(against):
        joints += (fixed("other", "wall.other", "stack.right"),)
    elif against:
        springs = (SpringDamper("spring", "wall.far", "stack.right", tuple(ALONG), against),)
    given = {
        "actuators": (VoltageDrive("amplifier", "stack.v", "u", gain=GAIN),),
        "sensors": (StressAt("all", "stack.middle"), StrainGauge("strain", "stack.gauge")),
        "damping_ratio": 0.02,
    }
    flexible = FlexibleBody("stack", body, ORIGIN, TURN, fidelity=fidelity)
    return Scene("held stack", (wall, flexible), joints, springs=springs, **given | options)


def test_a_free_stack_under_voltage_is_not_taut(stack):
    """The body does not hold its geometric stiffness, which is then estimated from the forces that others exert."""
    still, driven = (np.abs(linearize(held(stack), constant_inputs=given).poles()) for given in (None, {"u": VOLTS}))
    np.testing.assert_allclose(np.sort(driven)[:4], np.sort(still)[:4], rtol=1e-3)


@pytest.mark.parametrize(
    ("against", "fidelity"), [*itertools.product([0.0, 20e6, np.inf], ["linear", "ffrf"]), (np.inf, "rigid")]
)
def test_a_driven_stack_bears_what_holds_its_ends(stack, against, fidelity):
    """Free: no stress and the free strain. Against a spring: its force. Between walls: the blocked force."""
    scene = held(stack, against, fidelity)
    free = STACK.free_stroke * GAIN * VOLTS / STACK.voltage_range
    stroke = free / (1 + against / STACK.stiffness)
    force = STACK.stiffness * (free - stroke)
    expected = {"all.sxx": -force / STACK.area, "strain": stroke / STACK.length}
    sizes = {"all": 1000.0 / STACK.area, "strain": 1e-3}
    found = static_response(scene, {"u": VOLTS})
    gains = frequency_response(linearize(scene), [0.0]).values[:, 0, 0].real
    for values in (found, dict(zip(scene.outputs, VOLTS * gains, strict=True))):
        for name, value in values.items():
            assert value == pytest.approx(expected.get(name, 0.0), abs=2e-3 * sizes[name.partition(".")[0]]), name


def amplified(time, bandwidth):
    """Output of an amplifier whose input rises from 0 to VOLTS within 1 ms."""
    rate, ramp = 2 * np.pi * bandwidth, 1e-3

    def risen(t):
        t = np.maximum(t, 0.0)
        return VOLTS / ramp * (t - (1 - np.exp(-rate * t)) / rate)

    return GAIN * (risen(time) - risen(time - ramp))


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
@pytest.mark.parametrize("bandwidth", [np.inf, 200.0])
def test_runs_add_the_stress_of_the_voltage_to_that_of_the_motion(monkeypatch, stack, fidelity, method, bandwidth):
    """As the body's own stress says for its recorded coordinates and the voltage of the amplifier in closed form."""
    drive = VoltageDrive("amplifier", "stack.v", "u", gain=GAIN, bandwidth=bandwidth)
    one = StressAt("one", "stack.middle", "sxx")
    scene = held(stack, 20e6, fidelity, actuators=(drive,), sensors=(StressAt("all", "stack.middle"), one))
    time = np.arange(151) * 2e-5
    ramp = TimeHistory(time, [VOLTS * np.minimum(time / 1e-3, 1.0)], ("u",), ("V",))
    options = {"time_step": 2e-5, "method": method, "progress": False}
    record, motion = simulate_motion(scene, ramp, frames=time, **options)
    volts = amplified(time, bandwidth) if np.isfinite(bandwidth) else GAIN * ramp.values[0]
    stress = stack.readouts["middle"].stress(motion.coordinates["stack"], {"v": volts})[:, 0]
    largest = np.abs(stress).max()
    assert largest > 0.9e6
    np.testing.assert_allclose(sensor_stress(record, "all"), stress, atol=1e-6 * largest)
    np.testing.assert_allclose(record["one"], record["all.sxx"], rtol=1e-12)
    assert record.names == ("u", *scene.outputs)
    np.testing.assert_allclose(motion.voltages["stack"]["v"], volts, atol=1e-6 * np.abs(volts).max())
    assert peak_stress(motion, scene.bodies[1]).von_mises == pytest.approx(peak_stress(record, "all").von_mises)
    monkeypatch.setattr(stress_peaks, "VALUES_AT_ONCE", 1)  # image by image, each with its voltage
    assert peak_stress(motion, scene.bodies[1]).von_mises == pytest.approx(peak_stress(record, "all").von_mises)


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
def test_a_constant_voltage_stresses_the_stack_from_the_start(stack, fidelity, method):
    drive = VoltageDrive("amplifier", "stack.v", "u", gain=GAIN, bandwidth=500.0)
    scene = held(stack, np.inf, fidelity, actuators=(drive,))
    time = np.arange(4) * 1e-5
    none = TimeHistory(time, np.zeros((1, 4)), ("u",), ("V",))
    given = {"constant_inputs": {"u": VOLTS}, "method": method, "progress": False}
    record = simulate(scene, none, time_step=1e-5, **given)
    blocked = STACK.blocked_force * GAIN * VOLTS / STACK.voltage_range / STACK.area
    np.testing.assert_allclose(record["all.sxx"], -blocked, rtol=5e-3)


@pytest.mark.parametrize(("fidelity", "method"), ENGINES)
def test_a_resistance_discharges_the_stress_of_the_voltage_too(stack, fidelity, method):
    """A push on a stack with a resistance: force over area, however much of its charge has gone."""
    push = PointForce("push", "stack.right", tuple(-ALONG), "force")
    sensors = (VoltageSensor("voltage", "stack.v", resistance=100.0, gain=-3.0), StressAt("all", "stack.middle"))
    scene = held(stack, 0.0, fidelity, actuators=(push,), sensors=sensors, damping_ratio=0.5)
    time = np.arange(101) * 2e-5
    force = TimeHistory(time, [40.0 * np.minimum(time / 4e-4, 1.0)], ("force",), ("N",))
    options = {"time_step": 2e-5, "method": method, "progress": False}
    record, motion = simulate_motion(scene, force, frames=time, **options)
    volts = record["voltage"] / -3.0
    assert volts[-1] < 0.5 * volts.max()
    stress = stack.readouts["middle"].stress(motion.coordinates["stack"], {"v": volts})[:, 0]
    np.testing.assert_allclose(sensor_stress(record, "all"), stress, atol=1e-5 * np.abs(stress).max())
    np.testing.assert_allclose(motion.voltages["stack"]["v"], volts, atol=1e-5 * np.abs(volts).max())
    np.testing.assert_allclose(record["all.sxx"][25:], -40.0 / STACK.area, rtol=0.02)


def test_a_loop_that_drives_what_it_measures_at_once_needs_a_bandwidth(stack):
    none = np.zeros((0, 0))
    gain = Controller(none, np.zeros((0, 1)), np.zeros((1, 0)), [[1e-6]], 1e4)
    loop = Loop("loop", gain, "all.sxx", "u")
    scene = held(stack, 20e6, loops=(loop,), damping_ratio=0.3)
    time = np.arange(21) * 1e-4
    idle = TimeHistory(time, np.zeros((0, 21)), (), ())
    with pytest.raises(ValueError, match="which follows what the loop drives at once"):
        simulate(scene, idle, time_step=1e-4, method="exact", progress=False)
    slow = VoltageDrive("amplifier", "stack.v", "u", gain=GAIN, bandwidth=2e3)
    pushed = replace(scene, actuators=(slow, PointForce("push", "stack.right", tuple(ALONG), "force")))
    time = np.arange(301) * 1e-5
    pull = TimeHistory(time, [40.0 * np.sin(np.pi * time / 3e-3) ** 2], ("force",), ("N",))
    exact, stepped = (
        simulate(pushed, pull, time_step=1e-5, method=method, progress=False)["all.sxx"]
        for method in ("exact", "generalized_alpha")
    )
    assert 0 < exact[150] < 0.9 * static_response(pushed, {"force": 40.0})["all.sxx"]  # the loop relieves the stack
    np.testing.assert_allclose(stepped, exact, atol=0.01 * exact.max())


@pytest.mark.parametrize(("sensor", "stiffening"), [({}, 1 - STACK.coupling_factor**2), ({"resistance": 1e5}, 1.0)])
def test_a_stroke_is_a_load_beside_charges(stack, sensor, stiffening):
    """An open stack stiffens by its coupling factor; a resistance has discharged it at rest."""
    scene = held(stack, np.inf, actuators=(), sensors=(VoltageSensor("voltage", "stack.v", **sensor),))
    slide = prismatic("other", "wall.other", "stack.right", tuple(ALONG))
    motor = Drive("motor", "other", input="stroke")
    limit = load_limit(
        replace(scene, joints=(scene.joints[0], slide), actuators=(motor,)), 5e6, body="stack", inputs={"stroke": 1e-6}
    )
    expected = 5e6 / STACK.young_modulus * STACK.length * stiffening
    assert limit.loads["stroke"] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(("sensor", "stiffening"), [({}, 1 - STACK.coupling_factor**2), ({"resistance": 1e5}, 1.0)])
def test_a_stroke_behind_a_spring_is_shared_with_a_stack_that_has_lost_its_charge(stack, sensor, stiffening):
    scene, spring = held(stack, actuators=(), sensors=(VoltageSensor("voltage", "stack.v", **sensor),)), 20e6
    wall, body = scene.bodies
    anvil = RigidBody("anvil", {"face": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), wall.point_position("far"))
    motor = Drive("motor", "slide", input="stroke")
    scene = replace(
        scene,
        bodies=(wall, body, anvil),
        joints=(*scene.joints, prismatic("slide", "wall.far", "anvil.face", tuple(ALONG))),
        springs=(SpringDamper("spring", "stack.right", "anvil.face", tuple(ALONG), spring),),
        actuators=(motor,),
    )
    motion = static_motion(scene, inputs={"stroke": -1e-6})
    moved = ALONG @ (point_motion(scene, motion, "stack.right")[0][0] - body.point_position("right"))
    assert moved == pytest.approx(-1e-6 * spring / (spring + STACK.stiffness / stiffening), rel=5e-3)


@dataclass(frozen=True)
class Odd(Sensor):
    """A part that uses a port by a law that stress does not know."""

    law: Callable = lambda name, charge: SpringForce(name, "C", Spring(charge))
    claims = ("stack.v",)

    def terms(self, scene):
        charge = BodyCoordinates("stack", scene.split("stack.v")[0].reduced.port("v").forces)
        return (Output(self.name, "C", charge), self.law(self.name, charge))


def test_a_port_by_another_law_is_refused(stack):
    """Its motion does not know the voltage, so peaks ask for it."""
    combined = partial(Odd, law=lambda name, charge: AppliedForce(name, "V", Combination(((2.0, charge),))))
    for odd, law in ((Odd, "SpringForce"), (combined, "AppliedForce")):
        with pytest.raises(ValueError, match=f"how the {law} of part 'odd' sets this voltage is unknown"):
            held(stack, actuators=(), sensors=(odd("odd"), StressAt("all", "stack.middle")))
    scene = held(stack, actuators=(), sensors=(Odd("odd"),))
    motion = static_motion(scene)
    assert not motion.voltages
    beside = replace(scene.bodies[1], name="beside")
    two = replace(
        scene,
        bodies=(*scene.bodies, beside),
        joints=(*scene.joints, fixed("second clamp", "wall.face", "beside.left")),
        actuators=(VoltageDrive("amplifier", "beside.v", "u", gain=GAIN),),
    )
    known = static_motion(two, inputs={"u": VOLTS}).voltages
    assert {body: list(ports) for body, ports in known.items()} == {"beside": ["v"]}
    with pytest.raises(ValueError, match=r"those of v are unknown here: give voltages=\{'v': \.\.\.\} in volts, 0 for"):
        peak_stress(motion, scene.bodies[1])
    blocked = STACK.young_modulus * STACK.free_stroke / STACK.voltage_range / STACK.length
    peak = peak_stress(motion, scene.bodies[1], voltages={"v": -7.0})
    assert peak.stress[0] == pytest.approx(7.0 * blocked, rel=5e-3)
    with pytest.raises(ValueError, match="unknown electrical port of body 'stack' 'V'; known: v"):
        peak_stress(motion, scene.bodies[1], voltages={"V": -7.0})


def test_a_motion_at_rest_knows_its_voltages(stack):
    """A stack against a spring; other voltages in place of them; part of a motion keeps its part of them."""
    scene = held(stack, 20e6)
    motion = static_motion(scene, inputs={"u": VOLTS})
    body = scene.bodies[1]
    expected = -STACK.blocked_force * GAIN * VOLTS / STACK.voltage_range / STACK.area / (1 + STACK.stiffness / 20e6)
    assert peak_stress(motion, body).stress[0] == pytest.approx(expected, rel=5e-3)
    shorted = peak_stress(motion, body, voltages={"v": 0.0})
    assert shorted.stress[0] == pytest.approx(expected + STACK.force_per_volt * GAIN * VOLTS / STACK.area, rel=5e-3)
    assert motion.select(["wall"]).voltages == {}
    (volts,) = motion.select(["stack"]).at(np.array([0])).voltages["stack"]["v"]
    assert volts == GAIN * VOLTS
    assert not static_motion(scene).voltages["stack"]["v"].any()
    with pytest.raises(ValueError, match=r"voltages of 'stack\.v'"):
        replace(motion, voltages={"stack": {"v": [1.0, 2.0]}})


@pytest.mark.parametrize("sensor", [None, {}, {"resistance": 1e5}])
def test_limits_know_the_voltage_of_their_scene(stack, sensor):
    """Between walls a voltage that reaches the limit; pushed in open circuit or discharged, force over area."""
    if sensor is None:
        scene, load, stress = held(stack, np.inf), "u", STACK.force_per_volt * GAIN / STACK.area
    else:
        push = PointForce("push", "stack.right", tuple(-ALONG), "force")
        gauge = VoltageSensor("voltage", "stack.v", **sensor)
        scene, load, stress = held(stack, actuators=(push,), sensors=(gauge,)), "force", 1 / STACK.area
    limit = load_limit(scene, 8e6, body="stack", inputs={load: 1.0})
    assert limit.factor == pytest.approx(8e6 / stress, rel=5e-3)
    (spot,) = stress_convergence(scene, stack, body="stack", inputs={load: limit.factor}).spots
    assert (spot.von_mises, spot.coarse) == (pytest.approx(8e6, rel=1e-6), pytest.approx(8e6, rel=1e-6))
