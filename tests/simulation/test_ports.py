"""Electrical ports: data sheets, closed forms of a single stack, the coupled FE system, fidelities, bad input."""

import functools
from dataclasses import replace

import netgen.occ as occ
import numpy as np
import pytest
import scipy.sparse as sp
from conftest import make_bar
from scipy.sparse.linalg import splu

from models.apa300ml import PZT, STACK
from models.apa300ml.calibration import data_sheet_figures
from models.bench import make_bench
from nassim import (
    ElectricalPort,
    Encoder,
    FlexibleBody,
    Joint,
    Material,
    PiezoStack,
    PointForce,
    RemotePoint,
    RigidBody,
    Scene,
    Solid,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    build_fe_model,
    craig_bampton,
    frequency_response,
    linearize,
    load,
    save,
    simulate,
    static_response,
)
from nassim.base.rigid_motion import rigid_transfer
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import keep_modes, open_circuit, trim_body
from nassim.fem import glue
from nassim.signals.excitations import band_limited_noise
from nassim.simulation import reduce_scene
from nassim.simulation.run.simulate import exudyn_eigenfrequencies

SHEET = {
    "free_stroke": 20e-6,
    "blocked_force": 4700.0,
    "voltage_range": (-20.0, 150.0),
    "capacitance": 6.7e-6,
    "size": (20e-3, 10e-3, 10e-3),
}
FIRST_VOLT = 170.0


@functools.cache
def stack_model(coupling="rbe3", **changes):
    """A single stack between two remote points, and its FE model."""
    stack = PiezoStack.from_datasheet(**SHEET | changes)
    shape = occ.Box(occ.Pnt(0, -5e-3, -5e-3), occ.Pnt(20e-3, 5e-3, 5e-3))
    shape.name = "stack"
    shape.faces.Min(occ.X).name, shape.faces.Max(occ.X).name = "left", "right"
    points = tuple(RemotePoint(name, name, [x, 0, 0], coupling) for name, x in (("left", 0.0), ("right", 20e-3)))
    ceramic = Material("ceramic", stack.young_modulus, 0.31, 7800.0)
    solid = Solid("stack", shape, {"stack": ceramic}, points, (ElectricalPort("v", "stack", stack),))
    return stack, build_fe_model(solid, element_size=10e-3, order=2, progress=False)


@functools.cache
def make_stack(coupling="rbe3", n_modes=6, **changes):
    """The same, reduced."""
    stack, model = stack_model(coupling, **changes)
    return stack, craig_bampton(model, n_modes=n_modes, progress=False)


def test_a_port_lies_in_the_middle_of_its_stacks(tmp_path):
    """Of two in line among three blocks; also after trimming, and in the frame of a scene that becomes one body."""
    stack = PiezoStack.from_datasheet(**SHEET)
    blocks = [occ.Box(occ.Pnt(20e-3 * k, 1e-3, 2e-3), occ.Pnt(20e-3 * (k + 1), 11e-3, 12e-3)) for k in range(3)]
    for k, block in enumerate(blocks):
        block.name = f"block_{k}"
    blocks[0].faces.Min(occ.X).name, blocks[2].faces.Max(occ.X).name = "left", "right"
    points = [RemotePoint("left", "left", [0, 6e-3, 7e-3]), RemotePoint("right", "right", [60e-3, 6e-3, 7e-3])]
    ceramic = Material("ceramic", stack.young_modulus, 0.31, 7800.0)
    port = ElectricalPort("v", ("block_1", "block_2"), stack)
    solid = Solid("line", glue(blocks), {f"block_{k}": ceramic for k in range(3)}, tuple(points), (port,))
    body = craig_bampton(build_fe_model(solid, element_size=20e-3, order=1, progress=False), n_modes=0, progress=False)
    place = np.array([40e-3, 6e-3, 7e-3])
    np.testing.assert_allclose(body.port("v").place, place, atol=1e-12)
    trimmed = trim_body(body, points=["left"], loads=np.zeros((len(body.mass_matrix), 0)), cutoff_frequency=1e6)
    save(trimmed, tmp_path / "body.h5")
    np.testing.assert_allclose(load(tmp_path / "body.h5").port("v").place, place, atol=1e-12)
    turn = np.array([[6.0, 2.0, 3.0], [-3.0, 6.0, 2.0], [-2.0, -3.0, 6.0]]).T / 7
    scene = Scene("s", (FlexibleBody("line", body, (1, 2, 3), rotation=turn, fidelity="linear"),))
    whole = reduce_scene(scene, name="whole", points={"end": "line.left"})
    np.testing.assert_allclose(whole.port("v").place, np.array([1, 2, 3]) + turn @ place, atol=1e-12)


def answer(body, held, voltage):
    """Coordinates under a voltage at the first port with some coordinates held, and the charge."""
    port, q = body.ports[0], np.zeros(len(body.mass_matrix))
    free = np.setdiff1d(np.arange(len(q)), held)
    q[free] = np.linalg.solve(body.stiffness_matrix[np.ix_(free, free)], port.forces[free] * voltage)
    return q, port.forces @ q + port.blocked_capacitance * voltage


def test_single_stack_returns_its_data_sheet():
    """Ends that may widen (rbe3) leave the stack in uniaxial stress, so all figures come back."""
    tolerance = 1e-8
    stack, body = make_stack()
    free, charge = answer(body, np.arange(6), FIRST_VOLT)
    assert free[6] == pytest.approx(stack.free_stroke, rel=tolerance)
    assert charge / FIRST_VOLT == pytest.approx(stack.capacitance, rel=tolerance)
    blocked, charge = answer(body, np.arange(12), FIRST_VOLT)
    force = body.ports[0].forces * FIRST_VOLT - body.stiffness_matrix @ blocked
    assert force[6] == pytest.approx(stack.blocked_force, rel=tolerance)
    assert charge / FIRST_VOLT == pytest.approx(stack.capacitance * (1 - stack.coupling_factor**2), rel=tolerance)
    assert 1 / body.compliance(fixed=["left"])[6, 6] == pytest.approx(stack.stiffness, rel=tolerance)


def test_figures_of_an_actuator_made_of_one_stack():
    """What the APA300ML is calibrated with, where its closed form is the stack's own data sheet."""
    shape = occ.Box(occ.Pnt(-5e-3, -5e-3, 0), occ.Pnt(5e-3, 5e-3, STACK.length))
    shape.name = "stack"
    shape.faces.Min(occ.Z).name, shape.faces.Max(occ.Z).name = "floor", "roof"
    points = (RemotePoint("bottom", "floor", np.zeros(3)), RemotePoint("top", "roof", [0, 0, STACK.length]))
    ceramic = Material("ceramic", STACK.young_modulus, 0.31, 7800.0)
    ports = (ElectricalPort("all", "stack", STACK, direction=(0, 0, 1)),)
    solid = Solid("stack", shape, {"stack": ceramic}, points, ports)
    figures = data_sheet_figures(build_fe_model(solid, element_size=10e-3, order=2, progress=False))
    assert figures["stroke"] == pytest.approx(20e-6, rel=1e-8), "20 um from -20 to 150 V"
    assert figures["axial_stiffness"] == pytest.approx(235e6, rel=1e-8)
    assert figures["mass"] == pytest.approx(7800.0 * 2e-6, rel=1e-9)
    rod = np.sqrt(235e6 / (5.0 + 7800.0 * 2e-6 / 3)) / (2 * np.pi)
    assert figures["frequency_5kg"] == pytest.approx(rod, rel=1e-5)


def test_the_apas_stack_is_a_possible_ceramic():
    assert "; usual)" in STACK.consistency()


def test_ends_that_cannot_widen_cost_stroke():
    """Poisson's ratio: rigid ends (rbe2) hold the ceramic's width, so it is stiffer and lengthens less."""
    stack, body = make_stack("rbe2")
    free, _ = answer(body, np.arange(6), FIRST_VOLT)
    assert 0.92 < free[6] / stack.free_stroke < 0.97
    assert 1.02 < 1 / body.compliance(fixed=["left"])[6, 6] / stack.stiffness < 1.06


def test_open_circuit_stiffens_by_the_coupling_factor():
    stack, body = make_stack()
    opened = open_circuit(body, {"v": 0.0})
    expected = stack.stiffness / (1 - stack.coupling_factor**2)
    assert 1 / opened.compliance(fixed=["left"])[6, 6] == pytest.approx(expected, rel=1e-3)
    axial = {"fixed": ["left"], "guided": {"right": "x"}, "masses": {"right": 1.0}}
    rise = opened.eigenfrequencies(**axial)[0] / body.eigenfrequencies(**axial)[0]
    assert rise == pytest.approx(1 / np.sqrt(1 - stack.coupling_factor**2), rel=1e-3)
    shunted = open_circuit(body, {"v": 1.0})
    assert 1 / shunted.compliance(fixed=["left"])[6, 6] == pytest.approx(stack.stiffness, rel=1e-5)
    assert np.allclose(opened.eigenfrequencies()[:6], 0.0, atol=0.01), "rigid motions bring no charge"


def test_an_open_stack_knows_what_its_modes_leave_out():
    """Its first axial frequency, estimated by the open richer form, against a reduction that keeps nearly all."""
    held = {"fixed": ["left"], "guided": {"right": "x"}, "masses": {"right": 0.02}}
    coarse, fine = (open_circuit(make_stack(n_modes=n)[1], {"v": 0.0}) for n in (0, 20))
    first = [body.eigenfrequencies(**held)[0] for body in (coarse, fine)]
    true = first[0] / first[1] - 1
    assert true > 5e-3
    assert coarse.truncation_errors(**held)[0] == pytest.approx(true, rel=0.05)


CABLE, RESISTANCE = 2.5e-6, 1e3


def loaded_stack(fidelity, *, resistance=np.inf, **options):
    """A stack on the ground that a force pulls at, its port loaded by a cable; weightless but for a small tip."""
    stack, body = make_stack()
    tip = RigidBody("tip", {"foot": np.zeros(3)}, 1e-3, 1e-8 * np.eye(3), position=np.array([20e-3, 0, 0]))
    ground = RigidBody("ground", {"left": np.zeros(3), "right": np.array([20e-3, 0, 0])}, fixed=True)
    scene = Scene(
        "loaded stack",
        (ground, FlexibleBody("stack", body, fidelity=fidelity), tip),
        (Joint("clamp", "ground.left", "stack.left"), Joint("mount", "stack.right", "tip.foot")),
        (PointForce("pull", "tip.foot", "x", "force"),),
        (
            VoltageSensor("voltage", "stack.v", resistance=resistance, capacitance=CABLE, gain=3.0),
            Encoder("elongation", "ground.right", "tip.foot", axis="x"),
        ),
        **options,
    )
    return stack, scene


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_cable_shares_the_charge(fidelity):
    """Q = d F + (C + cable) V = 0, and the voltage stiffens the stack by what is left of its coupling."""
    stack, scene = loaded_stack(fidelity)
    whole = stack.capacitance + CABLE
    voltage = -3.0 * stack.stroke_per_volt / whole
    flexibility = (1 - stack.coupling_factor**2 * stack.capacitance / whole) / stack.stiffness
    found = static_response(scene, {"force": 2.0})
    assert found["voltage"] == pytest.approx(2.0 * voltage, rel=1e-5)
    assert found["elongation"] == pytest.approx(2.0 * flexibility, rel=1e-5)
    slow = frequency_response(linearize(scene), np.array([1e-3])).values[:, 0, 0]
    assert np.allclose(slow, [voltage, flexibility], rtol=1e-6, atol=0)


def test_a_loaded_sensor_is_a_high_pass_of_all_its_capacitance():
    """Under a given force: V = V_open jf / (jf + f_c) with f_c = 1 / (2 pi R (C + cable)), far below resonance."""
    frequency = np.array([2.0, 19.0, 60.0])
    stack, scene = loaded_stack("linear", resistance=RESISTANCE)
    corner = 1 / (2 * np.pi * RESISTANCE * (stack.capacitance + CABLE))
    expected = -3.0 * stack.stroke_per_volt / (stack.capacitance + CABLE) * 1j * frequency / (1j * frequency + corner)
    found = frequency_response(linearize(scene), frequency).response("voltage", "force")
    assert np.allclose(found, expected, rtol=1e-4, atol=0)


@pytest.mark.parametrize(("fidelity", "method"), [("linear", "exact"), ("linear", None), ("ffrf", None)])
def test_a_loaded_sensor_follows_a_ramp_by_its_time_constant(fidelity, method):
    """Under a force that rises by F' a second: V = -F' d R (1 - exp(-t / R (C + cable)))."""
    stack, scene = loaded_stack(fidelity, resistance=RESISTANCE, damping_ratio=0.05)
    time = np.arange(201) * 1e-4
    ramp = TimeHistory(time, 100.0 * time, ("force",), ("N",))
    found = simulate(scene, ramp, time_step=1e-4, method=method or "generalized_alpha", progress=False)["voltage"]
    constant = RESISTANCE * (stack.capacitance + CABLE)
    expected = -3.0 * 100.0 * stack.stroke_per_volt * RESISTANCE * (1 - np.exp(-time / constant))
    assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()


@pytest.fixture(scope="module")
def coarse(apa_with_ports_condensed):
    return apa_with_ports_condensed.fe_model


@pytest.fixture(scope="module")
def coupled_system(coarse, apa_with_ports_condensed):
    """The FE model with both ports, bottom held and top guided, as one sparse saddle point system, factorised.

    Unknowns: displacements, sensor voltage, the points' reactions. Returns solve(forces, actuator voltage).
    """
    condensed = apa_with_ports_condensed
    held = sp.vstack([condensed.averages[:6], condensed.averages[[6, 7, 9, 10, 11]]])
    sensor, actuator = coarse.port("sensor"), coarse.port("actuator")
    scale = 1e8
    coupling = sp.csr_matrix(sensor.forces[:, None])
    matrix = sp.bmat(
        [
            [coarse.stiffness_matrix, -coupling, scale * held.T],
            [-coupling.T, -sp.eye(1) * sensor.blocked_capacitance, None],
            [scale * held, None, None],
        ],
        format="csc",
    )
    factor = splu(matrix)

    def solve(forces, voltage):
        load = np.concatenate([forces + actuator.forces * voltage, np.zeros(1 + held.shape[0])])
        solution = factor.solve(load)
        solution += factor.solve(load - matrix @ solution)
        u = solution[: coarse.n_dofs]
        return u, solution[coarse.n_dofs], actuator.forces @ u + actuator.blocked_capacitance * voltage

    return condensed.averages, solve


@pytest.mark.slow
def test_static_answer_equals_the_coupled_fe_system(apa_with_ports, coupled_system):
    averages, solve = coupled_system
    u, voltage, charge = solve(np.zeros(averages.shape[1]), 1.0)
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    drive = replace(bench.actuators[0], gain=1.0)
    found = static_response(replace(bench, actuators=(drive,)), {"actuator_voltage": 1.0})
    assert found["encoder"] == pytest.approx((averages @ u)[8], rel=1e-8)
    assert found["sensor_voltage"] == pytest.approx(voltage, rel=1e-8)
    assert charge > apa_with_ports.port("actuator").blocked_capacitance


def test_stacks_in_parallel_add_their_capacitances(apa_with_ports):
    """Two alike, held, take twice the charge of one."""
    one, two = apa_with_ports.port("sensor"), apa_with_ports.port("actuator")
    assert two.blocked_capacitance == pytest.approx(2 * one.blocked_capacitance, rel=1e-9)


def test_a_voltage_does_not_push_on_rigid_motions(apa_with_ports):
    """Forces in balance: they do no work on any of the six, however curved the elements are."""
    points = [rigid_transfer(point.position) for point in apa_with_ports.remote_points]
    rigid = np.vstack([*points, np.zeros((apa_with_ports.n_modes, 6))])
    for port in apa_with_ports.ports:
        terms = np.abs(port.forces) @ np.abs(rigid)
        assert np.all(np.abs(port.forces @ rigid) < 1e-12 * terms)


@pytest.mark.slow
def test_reciprocity(apa_with_ports, coupled_system):
    """Displacement per volt equals charge per newton, in the FE system and in the reduced body."""
    averages, solve = coupled_system
    top = averages[8].toarray().ravel()
    motion = top @ solve(np.zeros_like(top), 1.0)[0]
    charge = solve(top, 0.0)[2]
    assert charge == pytest.approx(motion, rel=1e-10)
    opened = open_circuit(apa_with_ports, {"sensor": 0.0})
    free = np.setdiff1d(np.arange(len(opened.mass_matrix)), [0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11])
    flexibility = np.linalg.inv(opened.stiffness_matrix[np.ix_(free, free)])
    forces = opened.port("actuator").forces[free]
    assert flexibility[0] @ forces == pytest.approx(motion, rel=1e-8)
    assert forces @ flexibility[:, 0] == pytest.approx(charge, rel=1e-8)


@pytest.mark.usefixtures("plain_steps")
@pytest.mark.parametrize("resistance", [np.inf, 5e3])
def test_fidelities_agree(apa_with_ports, resistance):
    """Both fidelities by Exudyn, with a massless row for the charge, against the exact solution and its FRF."""
    excitation = band_limited_noise(0.05, 10e3, cutoff_frequency=150.0, rms=0.1)

    def run(fidelity, method, time_step):
        bench = make_bench(apa=apa_with_ports, fidelity=fidelity, resistance=resistance)
        record = simulate(bench, excitation, time_step=time_step, method=method, progress=False)
        return record.values[1:, :: round(1e-4 / time_step)]

    reference = run("linear", "exact", 1e-4)
    size = np.abs(reference).max(axis=1)
    for fidelity in ("linear", "ffrf"):
        coarse, fine = (
            np.abs(run(fidelity, "generalized_alpha", h) - reference).max(axis=1) / size for h in (1e-4, 5e-5)
        )
        assert np.all(fine < 5e-3)
        assert np.all(fine < coarse / 3.5), "the difference must be the integrator's, which is of order 2"


def test_exact_steps_of_a_leaking_sensor_are_its_frf(apa_with_ports):
    """A sine in steady state against the FRF: two routes through different code."""
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=5e3, damping_ratio=0.05)
    time = np.arange(20001) * 1e-4
    for frequency in (3.0, 60.0):
        drive = TimeHistory(time, np.sin(2 * np.pi * frequency * time), ("actuator_voltage",), ("V",))
        record = simulate(bench, drive, time_step=1e-4, method="exact", progress=False)
        response = frequency_response(linearize(bench), np.array([frequency])).values[:, 0, 0]
        for name, value in zip(bench.outputs, response, strict=True):
            expected = np.imag(value * np.exp(2j * np.pi * frequency * time))
            assert np.abs((record[name] - expected)[15000:]).max() < 1e-3 * abs(value)


def test_resistance_makes_a_high_pass(apa_with_ports):
    open_bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    loaded = make_bench(apa=apa_with_ports, fidelity="linear", resistance=1e5)
    frequency = np.geomspace(0.01, 5.0, 30)
    quotient = frequency_response(linearize(loaded), frequency).response(
        "sensor_voltage", "actuator_voltage"
    ) / frequency_response(linearize(open_bench), frequency).response("sensor_voltage", "actuator_voltage")
    corner = np.interp(1 / np.sqrt(2), np.abs(quotient), frequency)
    # Far below the resonance the port's capacitance is that at zero force, between blocked and free.
    port, stack = apa_with_ports.port("sensor"), STACK
    assert 1 / (2 * np.pi * 1e5 * stack.capacitance) < corner < 1 / (2 * np.pi * 1e5 * port.blocked_capacitance)
    assert np.allclose(quotient, 1j * frequency / (corner + 1j * frequency), atol=5e-3)


def test_exudyn_finds_the_open_circuit_frequencies(apa_with_ports):
    for fidelity in ("linear", "ffrf"):
        bench = make_bench(apa=apa_with_ports, fidelity=fidelity, resistance=np.inf)
        expected = np.sort(np.abs(linearize(bench).poles()))[::2] / (2 * np.pi)
        assert np.allclose(exudyn_eigenfrequencies(bench, n_modes=4), expected[:4], rtol=1e-6)


def test_exudyn_takes_a_leaking_port_as_one_that_keeps_its_charge(apa_with_ports):
    scenes = [make_bench(apa=apa_with_ports, fidelity="linear", resistance=r) for r in (np.inf, 1e4)]
    assert np.allclose(*(exudyn_eigenfrequencies(scene, n_modes=5) for scene in scenes), rtol=1e-9)


def test_fewer_coordinates_keep_the_static_answer(apa_with_ports):
    conditions = {"points": ["bottom", "top"], "loads": np.zeros((len(apa_with_ports.mass_matrix), 0))}
    for fewer in (keep_modes(apa_with_ports, 2), trim_body(apa_with_ports, cutoff_frequency=1e3, **conditions)):
        assert len(fewer.mass_matrix) < len(apa_with_ports.mass_matrix)
        charges = []
        for body in (fewer, apa_with_ports):
            index = 6 * body.point_names.index("bottom") + np.arange(6)
            free = np.setdiff1d(np.arange(len(body.mass_matrix)), index)
            forces = np.array([port.forces[free] for port in body.ports])
            charges.append(forces @ np.linalg.solve(body.stiffness_matrix[np.ix_(free, free)], forces.T))
        assert np.allclose(charges[0], charges[1], rtol=1e-8, atol=0)


def test_ports_survive_saving(apa_with_ports, tmp_path):
    again = load(save(apa_with_ports, tmp_path / "apa.h5"))
    assert np.array_equal(again.port("sensor").forces, apa_with_ports.port("sensor").forces)


def test_bodies_without_deformation_read_nothing(apa_with_ports):
    bench = make_bench(apa=apa_with_ports, fidelity="rigid", resistance=1e4)
    excitation = band_limited_noise(0.01, 10e3, cutoff_frequency=400.0)
    record = simulate(bench, excitation, time_step=1e-4, progress=False)
    assert not np.any(record["sensor_voltage"])


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"free_stroke": 20.0}, "1e\\+05 % of the length"),
        ({"blocked_force": 4.7e6}, "4.7e\\+04 MPa"),
        ({"stiffness": 235.0}, "is it in N/m"),
        ({"capacitance": 6.7e-9}, "give back more energy than it takes"),
        ({"size": (20e-3, 10e-3)}, "size must have shape 3"),
        ({"transverse_ratio": 0.4}, "transverse_ratio must be from"),
        ({"voltage_range": (150.0, 150.0)}, "voltage_range must be positive"),
    ],
)
def test_impossible_data_sheets(changes, problem):
    with pytest.raises(ValueError, match=problem):
        PiezoStack.from_datasheet(**SHEET | changes)


def test_the_least_capacitance_is_that_of_the_energy():
    """The one that is told is refused a little below and taken a little above."""
    with pytest.raises(ValueError, match="need more than") as caught:
        PiezoStack.from_datasheet(**SHEET | {"capacitance": 6.7e-9})
    least = float(str(caught.value).split()[-2])
    assert PiezoStack.from_datasheet(**SHEET | {"capacitance": 1.01 * least}).coupling_factor > 0.99
    with pytest.raises(ValueError, match="give back more energy than it takes"):
        PiezoStack.from_datasheet(**SHEET | {"capacitance": 0.99 * least})


def test_consistency_tells_a_coupling_factor_that_is_too_high():
    assert "usual" in PiezoStack.from_datasheet(**SHEET).consistency()
    assert "high: stroke and force" in PiezoStack.from_datasheet(**SHEET | {"capacitance": 4.4e-6}).consistency()
    assert "low: are there" in PiezoStack.from_datasheet(**SHEET | {"capacitance": 20e-6}).consistency()


def test_ceramic_that_cannot_be():
    """No transverse strain in an isotropic ceramic of this stiffness: more energy out than in, so refused."""
    with pytest.raises(ValueError, match="less than none"):
        make_stack(capacitance=4.4e-6, transverse_ratio=0.0)


@pytest.mark.parametrize("share", [-0.9, 1.1])
@pytest.mark.parametrize(
    ("longer", "message"), [(0, "mm3; give each stack"), (1, "mm long along the port's direction")]
)
def test_a_stack_may_differ_from_its_data_sheet_by_two_per_cent(share, longer, message):
    """By its cross-section, or by its length with the same volume."""
    sides = np.array([20e-3, 10e-3, 10e-3])
    sides[0] *= 1 + longer * 0.02 * share
    sides[1] *= (1 + 0.02 * share) ** (1 - 2 * longer)
    bar = occ.Box((0, 0, 0), tuple(sides))
    bar.name = "bar"
    port = ElectricalPort("v", "bar", PiezoStack.from_datasheet(**SHEET))
    solid = Solid("bar", bar, {"bar": PZT}, (), (port,))
    if abs(share) < 1:
        build_fe_model(solid, element_size=10e-3, order=2, progress=False)
    else:
        with pytest.raises(ValueError, match=message):
            build_fe_model(solid, element_size=10e-3, order=2, progress=False)


def test_bad_ports():
    bar = make_bar(length=20e-3)
    port = ElectricalPort("v", "bar", PiezoStack.from_datasheet(**SHEET))
    for ports, problem in (
        ((replace(port, bodies=("rod",)),), "unknown CAD body 'rod'"),
        ((port, port), "electrical port names must differ"),
        ((port, replace(port, name="w")), "CAD body of electrical port names must differ"),
    ):
        with pytest.raises(ValueError, match=problem):
            replace(bar, ports=ports)
    with pytest.raises(ValueError, match="1000 mm3, its stack 2000 mm3"):
        build_fe_model(replace(make_bar(length=10e-3), ports=(port,)), element_size=5e-3, progress=False)
    with pytest.raises(ValueError, match=r"10 mm long along the port's direction, its stack 20 mm"):
        build_fe_model(replace(bar, ports=(replace(port, direction=(0, 1, 0)),)), element_size=5e-3, progress=False)
    with pytest.raises(ValueError, match="direction must not be zero"):
        replace(port, direction=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="names no CAD body"):
        replace(port, bodies=())


def test_a_port_is_kept_once():
    _, model = stack_model()
    with pytest.raises(ValueError, match="electrical port names must differ"):
        craig_bampton(model, ports=["v", "v"], progress=False)
    assert not craig_bampton(model, ports=[], progress=False).ports


def test_bad_use_in_scenes(apa, apa_with_ports):
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    for changes, problem in (
        ({"sensors": (VoltageSensor("v", "apa.actuator"),)}, "'apa.actuator' is used more than once"),
        ({"sensors": (VoltageSensor("v", "apa.junction"),)}, "unknown electrical port 'junction'; known: sensor"),
        ({"actuators": (VoltageDrive("v", "base.top", "u"),)}, "body 'base' is rigid"),
    ):
        with pytest.raises(ValueError, match=problem):
            replace(bench, **changes)
    with pytest.raises(ValueError, match="unknown electrical port 'actuator'; known: none"):
        make_bench(apa=apa, ports=True)
    with pytest.raises(ValueError, match="resistance must be positive"):
        VoltageSensor("v", "apa.sensor", resistance=0.0)
    with pytest.raises(ValueError, match="must not be negative, got -1 F"):
        open_circuit(apa_with_ports, {"sensor": -1.0})
    with pytest.raises(ValueError, match="reads 3 coordinates, but the body has 36"):
        replace(apa, readouts={"v": PortCoupling("v", np.zeros(3), 1e-6)})
    loaded = make_bench(apa=apa_with_ports, fidelity="linear", resistance=1e5, cutoff_frequency=500.0)
    excitation = band_limited_noise(0.01, 10e3, cutoff_frequency=400.0)
    with pytest.raises(ValueError, match="cannot integrate the circuits"):
        simulate(loaded, excitation, time_step=1e-4, method="explicit", progress=False)
