"""The nano-hexapod: published cases of Stewart platforms, and its own struts against matrices put together here."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice, motion_beside

from models import nano_hexapod
from models.apa300ml import PORTS, axial_stiffness, reduced_apa300ml
from models.bench import AMPLIFIER_GAIN, SENSOR_RESISTANCE, make_passive_bench
from models.hexapods import DEFAULT_PLATFORM, NANO_HEXAPOD
from models.nano_hexapod import (
    PLATE_HEIGHT,
    PLATE_RADIUS,
    TOP_MASS,
    flexible_plate,
    make_nano_hexapod,
    make_plate,
    rigid_plate,
)
from models.strut import (
    JOINT_MASS,
    JOINT_SIDE,
    JOINT_STIFFNESS,
    LENGTH,
    fe_strut,
    imported_strut,
    sensors_in_line,
    spring_strut,
    two_mass_strut,
    with_own_damping,
)
from models.two_mass import APA300ML, two_mass_actuator
from nassim import (
    Bushing,
    PointForce,
    Pose,
    ReducedBody,
    RigidBody,
    TimeHistory,
    craig_bampton,
    describe,
    export_body,
    fixed,
    frequency_response,
    joined,
    linearize,
    open_circuit,
    prismatic,
    read_superelement,
    simulate,
    to_body,
)
from nassim.bodies.projection import trim_body
from nassim.fem import solid
from nassim.kinematics import (
    stiffness_matrix,
    strut_forces,
    strut_lengths,
    strut_vectors,
)
from nassim.simulation import reduce_scene
from nassim.systems import close_loop, damping, decentralised, integral_force_feedback, zeros

FEET = DEFAULT_PLATFORM.base_joints
LONG = float(strut_lengths(DEFAULT_PLATFORM)[0])
SIX = range(1, 7)


def published(strut, **payload):
    """The published platform with its disc of 1 kg; without a payload."""
    disc = rigid_plate(DEFAULT_PLATFORM, mass=1.0, radius=0.1, height=0.01)
    options = {"payload_mass": 0.0, "damping_ratio": 0.0} | payload
    return make_nano_hexapod(strut, platform=DEFAULT_PLATFORM, plate=disc, **options)


def half_struts(stiffness=20e6, **options):
    return spring_strut(stiffness, mass=0.2, length=LONG, **options)


MODES = np.array([780.60, 780.60, 903.89, 1061.43, 1061.43, 1269.66])


def test_modes_and_dampings_of_the_published_platform():
    frequency, ratio = damping(linearize(published(half_struts(damping=20.0))))
    np.testing.assert_allclose(frequency, MODES, atol=0.006)
    np.testing.assert_allclose(100 * ratio, [0.245, 0.245, 0.284, 0.333, 0.333, 0.399], atol=6e-4)


def with_force_feedback(model, gain, leak=0.0):
    """Poles with six integrators, each from its strut's force sensor to its force; leak [Hz]."""
    measured, driven = ([f"strut_{k}/{name}_force" for k in SIX] for name in ("sensor", "actuator"))
    each = integral_force_feedback(-gain, sample_rate=1e7, corner_frequency=leak)
    six = decentralised(*[each] * 6)
    model = sensors_in_line(model)
    return close_loop(model, six, measured=measured, driven=driven, delay_order=0).poles()


def nearest(poles, pole):
    return poles[np.argmin(np.abs(poles - pole))]


def test_integral_force_feedback_damps_every_mode_critically():
    """The sensors in all of the struts: mode by mode s^2 + g s + w^2 = 0, critical at g = 2 w."""
    model = linearize(published(half_struts()))
    for gain, omega in zip([9809, 11359, 13338, 15955], 2 * np.pi * damping(model)[0][[0, 2, 3, 5]], strict=True):
        assert 2 * omega == pytest.approx(gain, rel=5e-5)
        pole = omega * np.exp(1j * np.arccos(-0.95))
        assert nearest(with_force_feedback(model, 1.9 * omega), pole) == pytest.approx(pole, rel=1e-6)
        assert np.abs(with_force_feedback(model, 2 * omega) + omega).min() < 1e-3 * omega


def test_integral_force_feedback_beside_a_parallel_spring():
    """A quarter of the stiffness beside the sensors: 0.5 at most, at g = w sqrt(2), as (w - z) / (2 z) says."""
    model = linearize(published(half_struts(15e6, parallel_stiffness=5e6)))
    np.testing.assert_allclose(damping(model)[0], MODES, atol=0.006)
    for gain, omega in zip([6936, 8032, 9432, 11282], 2 * np.pi * damping(model)[0][[0, 2, 3, 5]], strict=True):
        assert np.sqrt(2) * omega == pytest.approx(gain, rel=1e-4)
        largest = []
        for factor in (0.97, 1.0, 1.03):
            g = factor * np.sqrt(2) * omega
            expected = np.roots([1, g, omega**2, g * omega**2 / 4])
            pole = expected[np.argmax(expected.imag)]
            assert nearest(with_force_feedback(model, g), pole) == pytest.approx(pole, rel=1e-6)
            largest.append(-pole.real / abs(pole))
        assert largest[1] == pytest.approx(0.5, rel=1e-6)
        assert largest[1] > max(largest[0], largest[2])


def loaded(**options):
    """50 kg on struts without mass."""
    heavy = {"payload_mass": 50.0, "payload_centre": (0, 0, 0.2), "payload_inertia": np.eye(3)}
    return published(spring_strut(1.846e6, length=LONG), **heavy, **options)


ON_THE_SPINDLE = [10.4091, 12.1414, 36.9134, 46.7331, 74.4199, 75.7247]


def test_spinning_platform():
    standing = damping(linearize(loaded()))[0]
    np.testing.assert_allclose(standing, [11.2747, 11.2747, 36.9134, 46.7331, 75.0703, 75.0703], atol=6e-5)
    np.testing.assert_allclose(damping(linearize(loaded(spindle_rpm=60.0)))[0], ON_THE_SPINDLE, atol=6e-5)
    turned = linearize(loaded(), angular_velocity=(0, 0, 2 * np.pi))
    np.testing.assert_allclose(damping(turned)[0], ON_THE_SPINDLE, atol=6e-5)


def test_force_feedback_on_the_spindle():
    """A pure one is unstable at any speed, a leak of 1 Hz makes up for that."""
    model = linearize(loaded(spindle_rpm=60.0))
    assert with_force_feedback(model, 100.0).real.max() == pytest.approx(0.552, abs=6e-4)
    poles = with_force_feedback(model, 100.0, leak=1.0)
    swinging = poles[poles.imag > 0]
    assert poles.real.max() < 0
    assert (-swinging.real / np.abs(swinging)).min() == pytest.approx(0.104, abs=6e-4)


def test_struts_push_as_a_wrench_from_outside_on_a_fixed_base_only():
    """Forces J^-T w of the struts and the wrench w move B alike, unless the base gives way to the former."""
    standing = published(spring_strut(20e6, length=LONG))
    base = standing.body("base")
    loose = RigidBody("base", base.points, 4.0, np.diag([0.02, 0.02, 0.04]))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    feet = Bushing("feet", "ground.o", "base.centre", [3e7, 3e7, 3e7, 3e5, 3e5, 3e5])
    flexible = replace(
        standing,
        bodies=(ground, *(loose if body is base else body for body in standing.bodies)),
        springs=(*standing.springs, feet),
        sensors=(Pose("pose", "ground.o", "payload.target"),),
    )
    along = np.column_stack([strut_forces(DEFAULT_PLATFORM, column) for column in np.eye(6)])
    differences = []
    for machine in (standing, flexible):
        frf = frequency_response(linearize(machine), np.geomspace(10, 2e3, 40))
        pose = frf.values[[frf.outputs.index(f"pose.{c}") for c in ("ux", "uy", "uz", "rx", "ry", "rz")]]
        outside = pose[:, [n for n, name in enumerate(frf.inputs) if name.startswith("payload")]]
        inside = np.einsum("yaf,aw->ywf", pose[:, [frf.inputs.index(f"strut_{k}/actuator_force") for k in SIX]], along)
        scale = np.sqrt(np.einsum("iif->if", np.abs(outside).max(axis=2, keepdims=True)))
        differences.append(np.abs((inside - outside) / (scale[:, None] * scale[None])).max())
    assert differences[0] < 1e-10
    assert differences[1] > 0.1


@pytest.fixture(scope="module")
def apa(apa_with_ports):
    """Between its ends only, with the modes below 3 kHz and the stacks' static answers."""
    return trim_body(
        apa_with_ports,
        points=("bottom", "top"),
        loads=np.zeros((len(apa_with_ports.mass_matrix), 0)),
        cutoff_frequency=3e3,
    )


def six_by_six(mass, inertia):
    return scipy.linalg.block_diag(mass * np.eye(3), inertia)


def disc(mass, radius, height):
    across = mass * (3 * radius**2 + height**2) / 12
    return six_by_six(mass, np.diag([across, across, mass * radius**2 / 2]))


PAYLOAD = {"payload_mass": 10.0, "payload_centre": (0.02, -0.03, 0.07), "payload_inertia": np.diag([0.05, 0.07, 0.06])}
TARGET = np.array([0.01, 0.02, 0.05])
HEXAPOD = replace(NANO_HEXAPOD, point=TARGET)


def by_hand(bodies, *, jointed=True):
    """Mass, stiffness, drives (n, 6), sensors' charges (6, n), encoders (6, n) and B's motion (6, n).

    The coordinates are the plate's motion at M, then those of each body's own but its ends where these are rigid, along
    the world's axes. Body k has the points "bottom" and "top" on its own z axis, its middle in the strut's middle.
    """
    sizes = [len(body.mass_matrix) - 12 * (not jointed) for body in bodies]
    n, starts = 6 + sum(sizes), np.cumsum([6, *sizes])
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    plate = np.eye(6, n)
    half = six_by_six(JOINT_MASS / 2, JOINT_MASS / 2 * JOINT_SIDE**2 / 6 * np.eye(3))
    loads = [
        (disc(5.19, 0.15, 0.0094), (0, 0, -0.0047)),
        (six_by_six(10.0, PAYLOAD["payload_inertia"]), PAYLOAD["payload_centre"]),
    ]
    for matrix, place in loads:
        row = motion_beside(np.array(place)) @ plate
        mass += row.T @ matrix @ row
    drives, charges, encoders = np.zeros((n, 6)), np.zeros((6, n)), np.zeros((6, n))
    feet, heads = HEXAPOD.base_joints, HEXAPOD.platform_joints
    for k, body in enumerate(bodies):
        along = heads[k] + [0, 0, 0.095] - feet[k]
        length = np.linalg.norm(along)
        z = along / length
        x = np.cross([0, 1, 0], z) / np.linalg.norm(np.cross([0, 1, 0], z))
        turn = np.kron(np.eye(2), np.column_stack([x, np.cross(z, x), z]))
        own = len(body.mass_matrix)
        gap = (length - 0.03) / 2 if jointed else (length - np.ptp(body.positions[:, 2])) / 2
        head = motion_beside(heads[k]) @ plate
        encoders[k] = z @ head[:3]
        to_own = np.zeros((own, n))
        if jointed:
            to_own[:, starts[k] : starts[k + 1]] = scipy.linalg.block_diag(turn.T, turn.T, np.eye(own - 12))
            for flange, other, reach in ((0, np.zeros((6, n)), -gap), (6, head, gap)):
                # The flange at the joint's centre, along the strut's axes; the other side of the joint too.
                near = motion_beside([0, 0, reach]) @ to_own[flange : flange + 6]
                far = turn.T @ other
                mass += near.T @ half @ near + far.T @ half @ far
                stiffness += (near - far).T @ np.diag(JOINT_STIFFNESS) @ (near - far)
        else:
            to_own[6:12] = motion_beside([0, 0, -gap]) @ turn.T @ head
            to_own[12:, starts[k] : starts[k + 1]] = np.eye(own - 12)
        mass += to_own.T @ body.mass_matrix @ to_own
        stiffness += to_own.T @ body.stiffness_matrix @ to_own
        if body.ports:
            drives[:, k] = AMPLIFIER_GAIN * body.port("actuator").forces @ to_own
            charges[k] = body.port("sensor").forces @ to_own
    return mass, stiffness, drives, charges, encoders, motion_beside(TARGET) @ plate


def states_by_hand(body):
    """A, B, C and D with the sensors' voltages as states: their charges leak through the resistance."""
    mass, stiffness, drives, charges, encoders, look = by_hand([body] * 6)
    n, capacitance = len(mass), body.port("sensor").blocked_capacitance
    inputs = np.hstack([drives, look.T])
    a, b = np.zeros((2 * n + 6, 2 * n + 6)), np.zeros((2 * n + 6, 12))
    a[:n, n : 2 * n] = np.eye(n)
    solved = np.linalg.solve(mass, np.hstack([stiffness, charges.T, inputs]))
    # b V pushes; c V + b q = Q leaks.
    a[n : 2 * n, :n], a[n : 2 * n, 2 * n :], b[n : 2 * n] = -solved[:, :n], solved[:, n : n + 6], solved[:, n + 6 :]
    a[2 * n :, n : 2 * n] = -charges / capacitance
    a[2 * n :, 2 * n :] = -np.eye(6) / (SENSOR_RESISTANCE * capacitance)
    c = np.zeros((18, 2 * n + 6))
    c[:6, 2 * n :], c[6:12, :n], c[12:, :n] = np.eye(6), encoders, look
    return a, b, c


@pytest.fixture(scope="module")
def machine(apa):
    return linearize(make_nano_hexapod(fe_strut(apa=apa), platform=HEXAPOD, damping_ratio=0.0, **PAYLOAD))


VOLTAGES = [f"strut_{k}/actuator_voltage" for k in SIX]
SENSORS, ENCODERS = ([f"strut_{k}/{name}" for k in SIX] for name in ("sensor_voltage", "encoder"))
POSE = [f"pose.{c}" for c in ("ux", "uy", "uz", "rx", "ry", "rz")]


def rows(model):
    return [model.outputs.index(name) for name in (*SENSORS, *ENCODERS, *POSE)]


def test_hexapod_of_finite_element_struts_by_hand(apa, machine):
    """Static answers to voltages and wrenches, poles and zeros below 300 Hz, put together from the same matrices."""
    a, b, c = states_by_hand(apa)
    expected = -c @ np.linalg.solve(a, b)
    found = (machine.D - machine.C @ np.linalg.solve(machine.A, machine.B))[rows(machine)]
    leaked = expected[6:]
    scale = np.abs(leaked).max(axis=1, keepdims=True)
    assert machine.inputs == (*VOLTAGES, *(f"payload_{kind}_{c}" for kind in ("force", "torque") for c in "xyz"))
    np.testing.assert_allclose(found[6:] / scale, leaked / scale, rtol=0, atol=1e-8)

    poles, wanted = machine.poles(), np.linalg.eigvals(a)
    below = wanted[(wanted.imag > 0) & (wanted.imag < 2 * np.pi * 300)]
    assert len(below) == 12
    assert max(abs(nearest(poles, pole) - pole) / abs(pole) for pole in below) < 1e-8

    found = zeros(machine, inputs=VOLTAGES, outputs=SENSORS)
    dips = zeros_by_hand(apa)
    assert len(dips) >= 6
    assert max(abs(nearest(found, 1j * dip) - 1j * dip) / dip for dip in dips) < 1e-8


def zeros_by_hand(body):
    """Where voltages at the stacks keep all sensors' charges, and so their voltages, at rest, below 300 Hz [rad/s]."""
    mass, stiffness, drives, charges, *_ = by_hand([body] * 6)
    scale = 1 / np.sqrt(np.diag(stiffness))
    still = scale[:, None] * scipy.linalg.null_space(charges * scale)
    unpushed = scale[:, None] * scipy.linalg.null_space((scale[:, None] * drives).T)
    squares = scipy.linalg.eigvals(unpushed.T @ stiffness @ still, unpushed.T @ mass @ still)
    return np.sqrt(squares[(squares.real > 0) & (squares.real < (2 * np.pi * 300) ** 2)].real)


def joints_bent():
    """Stiffness at B by the joints' bending and torsion alone, struts rigid between them, (6, 6)."""
    _, _, _, bend, _, twist = JOINT_STIFFNESS
    result = np.zeros((6, 6))
    for line, head in zip(strut_vectors(HEXAPOD), HEXAPOD.platform_joints - TARGET, strict=True):
        length = np.linalg.norm(line)
        z = line / length
        tilt = np.cross(z, motion_beside(head)[:3], axisb=0, axisc=0) / length
        turn = np.eye(3, 6, 3)
        across = np.eye(3) - np.outer(z, z)
        result += bend * (tilt.T @ tilt + (turn - tilt).T @ across @ (turn - tilt))
        result += twist / 2 * turn.T @ np.outer(z, z) @ turn
    return result


def test_joints_are_as_stiff_as_published():
    """T. Dehaeze, finite elements of the flexible joint: shear 13, axial 94 N/um, bending 5, torsion 260 N m/rad."""
    np.testing.assert_allclose(JOINT_STIFFNESS, (13e6, 13e6, 94e6, 5.0, 5.0, 260.0), rtol=0.05)


def test_hexapod_of_finite_element_struts_by_closed_form(apa, machine):
    """Six springs, actuator and two joints in series each; the shell alone carries at the zeros."""
    joints = 2 / JOINT_STIFFNESS[2]
    series = 1 / (1 / axial_stiffness(apa) + joints)
    static = machine.D - machine.C @ np.linalg.solve(machine.A, machine.B)
    compliance = static[rows(machine)][12:, 6:]
    bending = joints_bent()
    expected = np.linalg.inv(stiffness_matrix(HEXAPOD, series) + bending)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(compliance / scale, expected / scale, rtol=0, atol=0.02)

    opened = 1 / (1 / axial_stiffness(open_circuit(apa, {"sensor": 0.0})) + joints)
    shell = 1 / (1 / two_mass_actuator(apa).shell + joints)
    upper = JOINT_MASS + apa.mass / 2
    mass = sum(
        motion_beside(place - TARGET).T @ matrix @ motion_beside(place - TARGET)
        for matrix, place in (
            (disc(5.19, 0.15, 0.0094), np.array([0, 0, -0.0047])),
            (six_by_six(10.0, PAYLOAD["payload_inertia"]), np.array(PAYLOAD["payload_centre"])),
            *((six_by_six(upper, np.zeros((3, 3))), head) for head in HEXAPOD.platform_joints),
        )
    )
    frequencies = (
        np.sqrt(scipy.linalg.eigh(stiffness_matrix(HEXAPOD, k) + bending, mass, eigvals_only=True)) / (2 * np.pi)
        for k in (opened, shell)
    )
    poles = damping(machine)[0]
    np.testing.assert_allclose(poles[poles > 1.0][:6], next(frequencies), rtol=0.02)
    dips = zeros(machine, inputs=VOLTAGES, outputs=SENSORS)
    dips = np.sort(dips.imag[dips.imag > 2 * np.pi * 5])[:6] / (2 * np.pi)
    np.testing.assert_allclose(dips, next(frequencies), rtol=0.02)


def rig(strut):
    """A strut under a guided payload of 5 kg."""
    base = RigidBody("base", {"o": np.zeros(3), "rail": (0, 0, LENGTH)}, fixed=True)
    load = RigidBody("load", {"foot": np.zeros(3)}, 5.0, 1e-2 * np.eye(3), (0, 0, LENGTH))
    joints = (
        fixed("foot", "base.o", "bottom.end"),
        fixed("head", "top.end", "load.foot"),
        prismatic("payload_guide", "base.rail", "load.foot"),
    )
    push = PointForce("push", "load.foot", "z", "push")
    return joined("rig", strut, bodies=(base, load), joints=joints, actuators=(push,), damping_ratio=0.0)


def test_two_masses_answer_as_the_finite_elements_they_were_fitted_to(apa):
    """Along the strut, also to a force on the payload, to which nothing was fitted; and six of them as a hexapod."""
    struts = fe_strut(apa=apa), two_mass_strut(two_mass_actuator(apa))
    frequency = np.array([10.0, 20.0, 38.0, 60.0, 90.0, 110.0, 150.0, 220.0])
    expected, found = (frequency_response(linearize(rig(strut)), frequency) for strut in struts)
    assert (found.inputs, found.outputs) == (expected.inputs, expected.outputs)
    np.testing.assert_allclose(np.abs(found.values), np.abs(expected.values), rtol=2e-3)
    np.testing.assert_allclose(np.cos(np.angle(found.values / expected.values)), 1.0, atol=5e-4)
    models = [linearize(make_nano_hexapod(strut, payload_mass=10.0, damping_ratio=0.0)) for strut in struts]
    expected, found = (damping(model)[0] for model in models)
    np.testing.assert_allclose(found[:6], expected[expected > 1.0][:6], rtol=4e-3)
    expected, found = (zeros(model, inputs=VOLTAGES, outputs=SENSORS).imag / (2 * np.pi) for model in models)
    np.testing.assert_allclose(*(np.sort(dips[dips > 5.0])[:6] for dips in (found, expected)), rtol=3e-3)


def test_an_actuator_without_a_shell_beside_its_sensor(apa):
    """Read at the port that is driven, no zero lies below the pole."""
    same = replace(apa.port("actuator"), name="sensor")
    with pytest.raises(ValueError, match=r"no frequency below its pole at .* Hz has a zero sensor response"):
        two_mass_actuator(replace(apa, readouts={**apa.readouts, "sensor": same}))


@pytest.mark.slow
def test_figures_of_the_two_masses_are_those_of_the_usual_actuator():
    found = two_mass_actuator(reduced_apa300ml(ports=PORTS, progress=False))
    for field in fields(found):
        assert getattr(APA300ML, field.name) == pytest.approx(getattr(found, field.name), rel=1e-3)


@pytest.fixture(scope="module")
def foreign():
    """Six complete struts of other origin, no two alike, along x and beside their frames' origins."""
    models = (lattice(stiffness=(1 + 0.1 * k) * 1e6, node_mass=0.01 + 0.001 * k) for k in range(6))
    return [craig_bampton(model, n_modes=1 + k % 2, progress=False) for k, model in enumerate(models)]


@dataclass(frozen=True)
class Turned:
    """A body along z instead of x, and its ends on the axis."""

    body: ReducedBody
    ports = ()

    def __post_init__(self):
        turn = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])
        n = len(self.body.mass_matrix)
        to_z = scipy.linalg.block_diag(*[turn] * 4, np.eye(n - 12))
        object.__setattr__(self, "mass_matrix", to_z @ self.body.mass_matrix @ to_z.T)
        object.__setattr__(self, "stiffness_matrix", to_z @ self.body.stiffness_matrix @ to_z.T)
        object.__setattr__(self, "positions", self.body.positions @ turn.T)


@pytest.mark.parametrize("ends", [{}, {"bottom": "left", "top": (0.03, 0.01, 0.01)}])
def test_imported_struts_make_a_hexapod_by_one_call(foreign, ends, tmp_path):
    """From six files, against their matrices put together by hand."""
    files = [export_body(body, tmp_path / f"strut_{k}.mat") for k, body in enumerate(foreign)]
    struts = [imported_strut(to_body(read_superelement(file)), length=LENGTH, **ends) for file in files]
    scene = make_nano_hexapod(struts, platform=HEXAPOD, damping_ratio=0.0, **PAYLOAD)
    mass, stiffness, *_, encoders, look = by_hand([Turned(body) for body in foreign], jointed=False)
    expected = np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)) / (2 * np.pi)
    model = linearize(scene)
    np.testing.assert_allclose(damping(model)[0][:12], expected[:12], rtol=1e-7)
    assert model.inputs == tuple(f"payload_{kind}_{c}" for kind in ("force", "torque") for c in "xyz")
    static = (model.D - model.C @ np.linalg.solve(model.A, model.B))[[model.outputs.index(n) for n in ENCODERS + POSE]]
    wanted = np.vstack([encoders, look]) @ np.linalg.solve(stiffness, look.T)
    scale = np.abs(wanted).max(axis=1, keepdims=True)
    np.testing.assert_allclose(static / scale, wanted / scale, rtol=0, atol=1e-7)


def test_an_imported_actuator_is_the_finite_element_strut(apa_with_ports):
    """Upside down and along another axis, with flexible joints added, by its ports or by pairs of forces."""
    expected = rig(fe_strut(apa=apa_with_ports))
    found = rig(
        imported_strut(apa_with_ports, bottom="bottom", top="top", length=LENGTH, joint_stiffness=JOINT_STIFFNESS)
    )
    np.testing.assert_allclose(damping(linearize(found))[0], damping(linearize(expected))[0], rtol=1e-9)
    assert (found.inputs, found.outputs) == (expected.inputs, expected.outputs)

    bare = replace(apa_with_ports, readouts={})
    down = {"bottom": "top", "top": "bottom", "length": LENGTH, "joint_stiffness": JOINT_STIFFNESS}
    pairs = {"stacks": ("junction", "actuator_end"), "sensor": ("sensor_end", "junction")}
    scenes = rig(fe_strut(apa=bare)), rig(imported_strut(bare, **down, **pairs))
    frfs = [frequency_response(linearize(scene), np.array([5.0, 60.0])) for scene in scenes]
    assert frfs[0].inputs == frfs[1].inputs
    # Its own weight lies a little nearer to one end.
    np.testing.assert_allclose(frfs[1].values, frfs[0].values, rtol=1e-3)


def test_a_strut_reduced_to_one_body_makes_the_same_hexapod(apa):
    """A complete strut with its ports, as a superelement of nassim's own; modes above 5 kHz left out."""
    strut = fe_strut(apa=apa, damping_ratio=0.0)
    ends = {"bottom": "bottom.end", "top": "top.end"}
    whole = imported_strut(reduce_scene(strut, "strut", points=ends, cutoff_frequency=5e3), damping_ratio=0.0)
    expected, found = (linearize(make_nano_hexapod(s, payload_mass=10.0)) for s in (strut, whole))
    assert (found.inputs, found.outputs) == (expected.inputs, expected.outputs)
    np.testing.assert_allclose(damping(found)[0][6:18], damping(expected)[0][6:18], rtol=2e-6)
    statics = [(m.D - m.C @ np.linalg.solve(m.A, m.B))[rows(m)[6:]] for m in (expected, found)]
    scale = np.abs(statics[0]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(statics[1] / scale, statics[0] / scale, rtol=0, atol=1e-8)


@pytest.mark.parametrize("length", [LENGTH, 0.12])
def test_the_actuator_is_amid_its_strut(apa, length):
    strut = fe_strut(apa=apa, length=length)
    ends = np.array([strut.point_position(path) for path in ("bottom.end", "apa.bottom", "apa.top", "top.end")])
    np.testing.assert_allclose(ends[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(ends[:, 2], [0.0, length / 2 - 0.015, length / 2 + 0.015, length], atol=1e-12)


def test_ends_that_are_not_found(foreign, apa_with_ports):
    with pytest.raises(ValueError, match=r"has 5 remote points \(bottom, top, .*bottom=\.\.\., top="):
        imported_strut(apa_with_ports)
    with pytest.raises(ValueError, match="both ends"):
        imported_strut(foreign[0], bottom="left")
    with pytest.raises(ValueError, match=r"no remote point within 1e-06 m of .*it has left .*metres"):
        imported_strut(foreign[0], bottom="left", top=(30.0, 10.0, 10.0))
    with pytest.raises(ValueError, match="unknown point of 'lattice': 'up'"):
        imported_strut(foreign[0], bottom="left", top="up")
    with pytest.raises(ValueError, match="the same place"):
        imported_strut(foreign[0], bottom="left", top="left")


def with_right_end(body, place):
    """A body with its second point elsewhere, and no other change."""
    left, right = body.remote_points
    return replace(body, remote_points=(left, replace(right, position=np.asarray(place))))


def test_ends_are_found_within_a_thousandth_of_a_millimetre(foreign):
    body = foreign[0]
    (left, right), up = body.positions, np.eye(3)[2]
    for share in (0.9, 1.1):
        for call in (
            lambda off: imported_strut(body, bottom="left", top=right + off * up),
            lambda off: imported_strut(with_right_end(body, left + 1e-12 / off * up)),
        ):
            if share < 1:
                call(1e-6 * share)
            else:
                with pytest.raises(ValueError, match=r"within 1e-06 m|the same place"):
                    call(1e-6 * share)


def test_the_passive_bench_guides_along_z_where_ends_coincide(foreign):
    left = foreign[0].positions[0]
    for length, direction in ((0.9e-6, 2), (1.1e-6, 0)):
        scene = make_passive_bench(with_right_end(foreign[0], left + length * np.eye(3)[0]))
        np.testing.assert_array_equal(scene.gravity, -9.81 * np.eye(3)[direction])


def test_struts_have_the_platforms_lengths_to_a_nanometre():
    for share in (0.9, -0.9, 1.1, -1.1):
        strut = spring_strut(1e6, length=LENGTH + 1e-9 * share)
        if abs(share) < 1:
            make_nano_hexapod(strut)
        else:
            with pytest.raises(ValueError, match="strut 1: the platform wants its ends"):
                make_nano_hexapod(strut)


def test_struts_that_do_not_fit():
    strut = spring_strut(1e6)
    with pytest.raises(ValueError, match="six struts, got 5"):
        make_nano_hexapod([strut] * 5)
    with pytest.raises(ValueError, match=r"strut 1: the platform wants .*0\.0952254.*strut_lengths\(platform\)\[0\]"):
        make_nano_hexapod(strut, platform=DEFAULT_PLATFORM)


@pytest.mark.slow
def test_a_thick_flexible_plate_is_a_rigid_one(tmp_path, monkeypatch):
    """Six remote points at the joints' centres and one at M; the usual one has the real one's mass."""
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    strut = spring_strut(2e6)
    thick = flexible_plate(height=0.06, element_size=0.06, progress=False)
    mass = thick.reduced.mass
    assert mass == pytest.approx(7800 * np.pi * 0.15**2 * 0.06, rel=2e-3)
    rigid = rigid_plate(mass=mass, height=0.06)
    for name in (*(f"joint_{k}" for k in SIX), "centre"):
        np.testing.assert_allclose(thick.point_position(name), rigid.point_position(name), atol=1e-12)
    np.testing.assert_allclose(thick.rigid_inertia[1], rigid.rigid_inertia[1], atol=1e-4)
    np.testing.assert_allclose(thick.rigid_inertia[2], rigid.rigid_inertia[2], atol=3e-3 * rigid.inertia[2, 2])
    found, expected = (
        damping(linearize(make_nano_hexapod(strut, plate=plate, damping_ratio=0.0)))[0][:6] for plate in (thick, rigid)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-2)
    usual = make_plate(NANO_HEXAPOD, height=PLATE_HEIGHT, radius=PLATE_RADIUS)
    assert 7800 * usual.shape.mass == pytest.approx(TOP_MASS, rel=2e-3)


def test_a_plate_is_reduced_anew_when_an_input_changes(monkeypatch):
    """Every figure that the reduction depends on is in its key, and the same figures have the same one."""
    keys = []
    monkeypatch.setattr(solid, "_refuse_overlaps", lambda *_: None)  # most of the CAD's time
    plate = RigidBody("plate", {"centre": np.zeros(3)}, 1.0, np.eye(3))
    monkeypatch.setattr(nano_hexapod, "load_or_compute", lambda name, key, build, progress: keys.append(key))
    monkeypatch.setattr(nano_hexapod, "FlexibleBody", lambda *_: plate)
    lower = replace(NANO_HEXAPOD, platform_joints=NANO_HEXAPOD.platform_joints - np.array([0, 0, 1e-3]))
    changes = ({}, {"height": 0.012}, {"radius": 0.16}, {"element_size": 0.03}, {"order": 3}, {"n_modes": 7})
    for change in (*changes, {"platform": lower}):
        flexible_plate(**change)
    assert len(set(keys)) == len(keys) == 7
    flexible_plate()
    assert keys[-1] == keys[0]


def test_the_usual_payload_is_a_steel_cylinder_that_stands_on_the_plate():
    """20 kg of 100 mm radius: 82 mm high, its centre half of that above M, its target where the platform says."""
    scene = make_nano_hexapod(spring_strut(2e6), platform=HEXAPOD, payload_mass=20.0)
    payload = scene.body("payload")
    height = 20.0 / (7800 * np.pi * 0.1**2)
    np.testing.assert_allclose(payload.position, [0, 0, 0.095 + height / 2], rtol=1e-12)
    across = 20.0 * (3 * 0.1**2 + height**2) / 12
    np.testing.assert_allclose(payload.inertia, np.diag([across, across, 20.0 * 0.1**2 / 2]), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(scene.point_position("payload.foot"), [0, 0, 0.095], atol=1e-12)
    np.testing.assert_allclose(scene.point_position("payload.target"), (0.01, 0.02, 0.145), atol=1e-12)


@pytest.mark.parametrize("strut", ["finite elements", "two masses"])
def test_damping_of_the_parts_is_in_proportion_to_frequency(strut, apa):
    """Of the sensors' electrical stiffness, which has none, some percent."""
    strut, share = {"finite elements": (fe_strut(apa=apa), 0.02), "two masses": (two_mass_strut(), 1e-4)}[strut]
    scene = make_nano_hexapod(with_own_damping(strut, 0.01, frequency=80.0), payload_mass=10.0)
    frequency, ratio = damping(linearize(scene))
    suspension = (frequency > 1.0) & (frequency < 300.0)
    assert np.count_nonzero(suspension) >= 6
    np.testing.assert_allclose(ratio[suspension], 0.01 * frequency[suspension] / 80.0, rtol=share)


def test_damping_by_modes_of_bodies_that_would_lose_modes(apa):
    with pytest.raises(ValueError, match=r"'strut_1/apa' has damping ratios by mode.*trim_body"):
        linearize(make_nano_hexapod(with_own_damping(fe_strut(apa=apa)), cutoff_frequency=600.0))


@pytest.mark.filterwarnings("error")
def test_floating_frames_move_and_are_damped_as_linear_ones(apa):
    """A push on one strut and one on the payload, small, and what follows."""
    time = np.arange(121) * 1e-4
    shape = 0.1 * np.sin(np.pi * np.minimum(time / 0.01, 1.0)) ** 2
    records = []
    for fidelity in ("linear", "ffrf"):
        strut = with_own_damping(fe_strut(fidelity, apa=apa), 0.05)
        scene = make_nano_hexapod(strut, payload_mass=5.0)
        values = np.zeros((len(scene.inputs), len(time)))
        values[1], values[scene.inputs.index("payload_torque_y")] = shape, 0.1 * shape
        push = TimeHistory(time, values, scene.inputs, tuple(map(scene.input_unit, scene.inputs)))
        records.append(simulate(scene, push, time_step=1e-4, progress=False))
    for name in (*SENSORS, *ENCODERS, "pose.uz", "pose.rx"):
        expected = records[0][name]
        np.testing.assert_allclose(records[1][name], expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_a_hexapod_reads_well(apa):
    scene = make_nano_hexapod(fe_strut(apa=apa), spindle_rpm=60.0)
    text = describe(scene)
    assert len(text.splitlines()) < 50
    assert "strut_1/, and the same again strut_2/, strut_3/" in text
    assert "strut_1/sensor_voltage (x 6), strut_1/encoder (x 6), pose.ux" in text
    assert "drive spindle: rz of joint spindle runs at 6.28319 rad/s" in text
    text = describe(make_nano_hexapod(two_mass_strut()))  # which slides along the directions of the struts
    assert len(text.splitlines()) < 60
    assert "strut_1/, and the same again, in other directions, strut_2/" in text
