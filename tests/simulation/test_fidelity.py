"""Fidelities against each other, the exact solution, trimmed scenes, guards."""

from dataclasses import replace

import exudyn as exu
import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from conftest import make_bar

from models.bench import make_bench
from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
    static_response,
    truncation_error,
)
from nassim.base.modal import decay_poles
from nassim.bodies.projection import trim_body
from nassim.signals.excitations import band_limited_noise, sine_dwell
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.linear.exact_steps import exact_response
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.description import describe
from nassim.simulation.model.prescribed_motion import PrescribedMotions
from nassim.simulation.model.step_errors import integrator_error
from nassim.simulation.model.trimming import trim_scene
from nassim.simulation.run.simulate import exudyn_eigenfrequencies

STEP = 1e-4


@pytest.fixture(scope="module")
def noise():
    return band_limited_noise(0.06, 1 / STEP, cutoff_frequency=300.0, rms=0.1)


def relative(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


def test_all_fidelities_have_the_same_names_inputs_and_outputs(apa):
    scenes = [make_bench(apa=apa, fidelity=fidelity) for fidelity in ("rigid", "linear", "ffrf")]
    assert len({(scene.inputs, scene.outputs) for scene in scenes}) == 1


def test_linear_and_floating_frame_agree_at_nanometres(apa, noise):
    small = replace(noise, values=1e-4 * noise.values)
    records = [
        simulate(make_bench(apa=apa, fidelity=f), small, time_step=STEP, progress=False) for f in ("linear", "ffrf")
    ]
    assert np.abs(records[0]["encoder"]).max() < 1e-8
    for output in ("encoder", "sensor_voltage"):
        assert relative(records[0][output], records[1][output]) < 1e-6


def test_a_rigid_actuator_neither_moves_nor_feels(apa, noise):
    record = simulate(make_bench(apa=apa, fidelity="rigid"), noise, time_step=STEP, progress=False)
    assert np.abs(record["encoder"]).max() < 1e-15
    assert np.all(record["sensor_voltage"] == 0.0)


def test_rigid_fidelity_has_the_bodys_mass_and_inertia(apa):
    """On a soft actuator: a rigid one on top weighs what the flexible one does."""
    shift = apa.point("top").position - apa.point("bottom").position
    scenes = []
    for fidelity in ("ffrf", "rigid"):
        bodies = (
            RigidBody("base", {"top": apa.point("bottom").position}, fixed=True),
            FlexibleBody("apa", apa),
            FlexibleBody("upper", apa, position=shift, fidelity=fidelity),
        )
        joints = (Joint("clamp", "base.top", "apa.bottom"), Joint("middle", "apa.top", "upper.bottom"))
        scenes.append(Scene("stack", bodies, joints))
    flexible, rigid = (assemble(scene).modal.frequency[:3] for scene in scenes)
    assert np.allclose(exudyn_eigenfrequencies(scenes[1], n_modes=3), rigid, rtol=1e-6)
    assert np.all(rigid > flexible * (1 - 1e-12))
    assert np.allclose(rigid[0], flexible[0], rtol=0.1)


def test_linear_and_floating_bodies_share_a_scene(apa, noise):
    """Two actuators in series, one of each fidelity, against both linear."""
    shift = apa.point("top").position - apa.point("bottom").position
    bench = make_bench(apa=apa)
    payload = replace(bench.bodies[2], position=bench.bodies[2].position + shift)
    top = apa.point("top").position + shift
    base = RigidBody("base", {"top": apa.point("bottom").position, "guide": top}, fixed=True)
    joints = (
        Joint("clamp", "base.top", "apa.bottom"),
        Joint("middle", "apa.top", "upper.bottom"),
        Joint("mount", "upper.top", "payload.bottom"),
        Joint("guide", "base.guide", "payload.bottom", free=("z",)),
    )
    records, weighed = [], []
    for lower, upper in (("linear", "linear"), ("linear", "ffrf"), ("ffrf", "linear")):
        bodies = (
            base,
            FlexibleBody("apa", apa, fidelity=lower),
            FlexibleBody("upper", apa, shift, fidelity=upper),
            payload,
        )
        scene = Scene("two", bodies, joints, bench.actuators, bench.sensors)
        records.append(simulate(scene, noise, time_step=STEP, progress=False))
        weighed.append(static_response(replace(scene, gravity=np.array([0, 0, -9.81])))["encoder"])
    for other in records[1:]:
        assert relative(other["encoder"], records[0]["encoder"]) < 1e-6
    assert weighed[1:] == pytest.approx(weighed[:1] * 2, rel=1e-6)


@pytest.fixture(scope="module")
def stiff_bar():
    return craig_bampton(
        build_fe_model(make_bar(), element_size=0.02, order=2, progress=False), n_modes=0, progress=False
    )


@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.0, 2.5])
def test_exact_solution_of_one_mass_on_a_spring(stiff_bar, ratio):
    """Any damping, against SciPy's matrix exponential of each mode and its input."""
    base = RigidBody("base", {"hook": np.zeros(3)}, fixed=True)
    bar = FlexibleBody("bar", stiff_bar, fidelity="linear")
    clamp, push = Joint("clamp", "base.hook", "bar.left"), PointForce("f", "bar.right", "x", "f")
    sensor = Encoder("e", "base.hook", "bar.right")
    assembly = assemble(Scene("bar", (base, bar), (clamp,), (push,), (sensor,), damping_ratio=ratio))
    modal, n_all = assembly.modal, assembly.coordinates.size
    inputs = np.sin(np.arange(200.0))[None]
    one = {"input_matrix": np.ones((n_all, 1)) * 1e3, "output_matrix": np.ones((1, n_all))}
    signals = replace(assembly.signals, **one, prescribed=PrescribedMotions.none(n_all, 3))
    omega, modes = 2 * np.pi * modal.frequency, modal.modes
    step = 0.3 / omega[0]
    expected = np.zeros(200)
    for k, w in enumerate(omega[:3]):
        drive, reading = (modes.T @ signals.input_matrix)[k, 0], (signals.output_matrix @ modes)[0, k]
        system = [[0, 1], [-(w**2), -2 * ratio * w]], [[0], [drive]], [[1, 0]], [[0]]
        expected += reading * scipy.signal.lsim(system, inputs[0], np.arange(200) * step, interp=True)[1]
    few = {"frequency": modal.frequency[:3], "shapes": modal.shapes[:, :3]}
    damping = replace(modal.damping, **few, ratio=modal.damping.ratio[:3])
    modal = replace(modal, **few, damping=damping, unsupported=np.zeros(3, dtype=bool))
    found, *_ = exact_response(replace(assembly, modal=modal, signals=signals), inputs, step)
    assert relative(found[0], expected) < 1e-8


def test_generalized_alpha_converges_to_the_exact_solution(apa):
    bench = make_bench(apa=apa, fidelity="linear")
    fine = sine_dwell(0.1, 4e4, frequency=60.0, amplitude=0.1)
    exact = simulate(bench, fine, time_step=2.5e-5, method="exact", progress=False)
    errors = []
    for n in (4, 2, 1):
        record = simulate(bench, fine, time_step=n * 2.5e-5, progress=False)
        errors.append(relative(record["encoder"], exact["encoder"][::n]))
    assert errors[0] < 0.01
    assert min(errors[0] / errors[1], errors[1] / errors[2]) > 3.9, "of second order at least"


def test_trimmed_bench_keeps_its_frfs(apa):
    """From 38 coordinates to what the open-loop bench needs: both FRFs within 0.1 % up to 500 Hz."""
    full, trimmed = make_bench(apa=apa), make_bench(apa=apa, cutoff_frequency=1500.0)
    frequency = np.concatenate([[1e-3], np.geomspace(1, 500, 400)])
    expected = frequency_response(linearize(full), frequency).values
    found = frequency_response(linearize(trimmed), frequency).values
    scale = np.abs(expected)
    # At the zero of V_s/V_a the magnitude vanishes: there 0.1 % of the static gain.
    assert np.all(np.abs(found - expected) < 1e-3 * np.maximum(scale, scale[:, :, :1]))
    assert np.allclose(found[:, :, 0].real, expected[:, :, 0].real, rtol=1e-11, atol=0)
    assert len(trim_scene(trimmed).bodies[1].reduced.mass_matrix) <= 16


def test_trimmed_scene_tells_its_error(apa):
    frequency = np.array([10.0, 100.0, 400.0])
    trimmed = make_bench(apa=apa, cutoff_frequency=1500.0)
    expected = frequency_response(linearize(make_bench(apa=apa.enriched)), frequency).values
    found = frequency_response(linearize(trimmed), frequency).values
    assert np.allclose(truncation_error(trimmed, frequency), np.abs(found / expected - 1), rtol=1e-6, atol=1e-12)
    floor, block = (
        RigidBody("floor", {"c": np.ones(3)}, fixed=True),
        RigidBody("block", {"c": [1, 1, 1]}, 1.0, np.eye(3)),
    )
    aside = replace(
        trimmed,
        bodies=(*trimmed.bodies, floor, block),
        springs=(Bushing("seat", "floor.c", "block.c", np.full(6, 1e5)),),
        sensors=(Encoder("aside", "floor.c", "block.c", "x"), *trimmed.sensors),
    )
    assert np.all(truncation_error(aside, frequency)[0] == 0)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_trimmed_scenes_simulate_alike(apa, noise, fidelity):
    full, trimmed = (
        simulate(
            make_bench(apa=apa, fidelity=fidelity, cutoff_frequency=f, gravity=True),
            noise,
            time_step=STEP,
            progress=False,
        )
        for f in (None, 1500.0)
    )
    for output in ("encoder", "sensor_voltage"):
        assert relative(trimmed[output], full[output]) < 2e-3


def test_trimming_keeps_rigid_motion_and_statics(apa):
    loads = np.zeros((len(apa.mass_matrix), 1))
    loads[apa.coordinate_names.index("junction.ux")] = 1.0
    body = trim_body(apa, points=["top", "bottom"], loads=loads, cutoff_frequency=1000.0)
    assert body.point_names == ("bottom", "top")
    assert body.all_point_names == ("bottom", "top", "sensor_end", "junction", "actuator_end")
    assert body.mass == pytest.approx(apa.mass, rel=1e-12)
    assert body.eigenfrequencies()[5] < 1e-2
    answer = np.linalg.solve(body.stiffness_matrix[6:, 6:], (body.motion("junction")[0])[6:])
    assert body.motion("junction")[0, 6:] @ answer == pytest.approx(apa.compliance(fixed=["bottom"])[18, 18], rel=1e-9)
    found, expected = body.compliance(fixed=["bottom"])[6:, 6:], apa.compliance(fixed=["bottom"])[6:12, 6:12]
    scale = 1 / np.sqrt(np.diag(expected))
    assert np.abs(scale[:, None] * (found - expected) * scale).max() < 1e-8


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"points": []}, "keep at least one"),
        ({"points": ["lid"]}, "known: bottom"),
        ({"cutoff_frequency": 0.0}, "positive"),
    ],
)
def test_impossible_trimming(apa, options, message):
    with pytest.raises(ValueError, match=message):
        trim_body(apa, **({"points": ["top"], "loads": np.zeros((36, 0)), "cutoff_frequency": 1e3} | options))


def test_summary_says_what_is_modelled_and_left_out(apa):
    text = describe(make_bench(apa=apa, fidelity="linear", cutoff_frequency=1500.0))
    assert "apa: linear, 15 coordinates: bottom, top x 6 + 3 modes" in text
    left_out = f"left out: {len(apa.mass_matrix) - 15} coordinates: points that no joint holds ("
    assert f"{left_out}sensor_end, junction, actuator_end)" in " ".join(text.split())
    assert "base: fixed" in text
    assert "apa: rigid, held rigidly to base, which is fixed" in describe(make_bench(apa=apa, fidelity="rigid"))
    held = replace(make_bench(apa=apa), joints=make_bench(apa=apa).joints[:2])  # from base to actuator to payload
    assert not any(words in describe(held) for words in ("nothing uses", "not held"))
    loose = replace(held, joints=held.joints[1:])
    assert "not held: no joint and no spring connects apa, payload to a fixed body" in describe(loose)
    imported = replace(apa, enriched=None, full_integrals=False)
    text = " ".join(describe(make_bench(apa=imported)).split())
    assert "modes and load shapes, complete up to an unknown frequency" in text
    idle = replace(make_bench(apa=apa), actuators=(), sensors=())
    assert "nothing uses sensor_end, junction, actuator_end" in describe(idle)


def test_exact_solution_needs_small_motion(bench, noise):
    with pytest.raises(ValueError, match="'apa' has fidelity \"ffrf\""):
        simulate(bench, noise, time_step=STEP, method="exact", progress=False)


def test_linear_bodies_do_not_spin(apa):
    with pytest.raises(ValueError, match="'apa' spins"):
        FlexibleBody("apa", apa, fidelity="linear", angular_velocity=np.array([0, 0, 1.0]))


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_motion_beyond_small_rotations_is_reported(apa, noise, method):
    far = replace(noise, values=200 * noise.values)
    with pytest.warns(UserWarning, match="'apa' is deformed by up to .* % of its size"):
        simulate(make_bench(apa=apa, fidelity="linear"), far, time_step=STEP, method=method, progress=False)


def test_diverging_run_names_body_and_time(apa, noise):
    absurd = replace(noise, values=1e6 * noise.values)
    with pytest.raises(RuntimeError, match=r"diverges: at t = .* s body 'apa' is deformed|integration failed at t = "):
        simulate(make_bench(apa=apa), absurd, time_step=STEP, progress=False)


def test_free_body_in_gravity_has_no_exact_equilibrium(apa):
    quiet = TimeHistory(np.arange(11) * STEP, np.zeros((0, 11)), (), ())
    scene = Scene("fall", (FlexibleBody("apa", apa, fidelity="linear"),), gravity=np.array([0, 0, -9.81]))
    with pytest.raises(RuntimeError, match="no static equilibrium: no joint and no spring connects 'apa' to a fixed"):
        simulate(scene, quiet, time_step=STEP, method="exact", progress=False)


def test_system_in_small_motion_has_no_joints(apa):
    system = build_system(assemble(make_bench(apa=apa, fidelity="linear")))
    assert system.mbs.systemData.AEsize() == 0
    assert system.mbs.systemData.ODE2Size() == len(system.assembly.modal.mass)
    assert build_system(assemble(make_bench(apa=apa))).mbs.systemData.AEsize() > 0
    assert set(system.flexible) == {"apa", "payload"}


def test_integrator_error_of_the_trapezoidal_rule():
    angle = 2 * np.pi * 100.0 * 1e-4
    longer, damping = integrator_error(100.0, 1e-4)
    assert longer == pytest.approx(angle / (2 * np.arctan(angle / 2)) - 1, rel=1e-6)
    assert longer == pytest.approx(angle**2 / 12, rel=0.01)
    assert damping == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("radius", [0.8, 0.6, 0.2])
def test_integrator_error_is_what_exudyn_shows(radius):
    """Period and decay of a mass on a spring, undamped, 16 steps a period, after a push."""
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    mass = RigidBody("mass", {"c": np.zeros(3)}, 2.0, np.eye(3))
    frequency, step = 50.0, 1 / (16 * 50.0)
    spring = SpringDamper("spring", "ground.c", "mass.c", "z", 2.0 * (2 * np.pi * frequency) ** 2)
    scene = Scene(
        "oscillator",
        (ground, mass),
        (Joint("guide", "ground.c", "mass.c", free="z"),),
        (PointForce("push", "mass.c", "z", "force"),),
        (Encoder("position", "ground.c", "mass.c"),),
        (spring,),
        damping_ratio=0.0,
    )
    time = np.arange(600) * step
    push = TimeHistory(time, np.exp(-(((time - 0.05) / 0.02) ** 2)) * (time < 0.06), ("force",), ("N",))
    record = simulate(scene, push, time_step=step, spectral_radius=radius, progress=False).after(0.1)
    (pole,) = (p for p in decay_poles(record.values[1:], step, n_poles=2) if p.imag > 0)
    longer, damping = integrator_error(frequency, step, spectral_radius=radius)
    assert 2 * np.pi * frequency / abs(pole) - 1 == pytest.approx(longer, rel=1e-3)
    assert -pole.real / abs(pole) == pytest.approx(damping, rel=1e-3)
    assert damping > 1e-5


def exudyns_own_frf(scene, frequency):
    """FRFs from Exudyn's mass, stiffness, damping and constraints; where forces act and sensors read is ours."""
    system = build_system(assemble(scene))
    mbs, solver = system.mbs, exu.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(mbs, exu.SimulationSettings())
    n = mbs.systemData.ODE2Size()
    solver.ComputeMassMatrix(mbs)
    mass = np.array(solver.GetSystemMassMatrix())[:n, :n]
    found = []
    for position, velocity in ((-1.0, 0.0), (0.0, -1.0)):
        solver.ComputeJacobianODE2RHS(mbs, scalarFactor_ODE2=position, scalarFactor_ODE2_t=velocity)
        found.append(np.array(solver.GetSystemJacobian())[:n, :n])
    solver.ComputeJacobianAE(mbs, scalarFactor_ODE2=1.0, scalarFactor_ODE2_t=0.0)
    rows = np.array(solver.GetSystemJacobian())[n:, :n]
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    basis = scipy.linalg.null_space((rows / np.where(sizes > 0, sizes, 1.0)), rcond=1e-9) if len(rows) else np.eye(n)

    counts = {int(node): count for node, count in system.flexible["apa"].nodes}

    def places(nodes):
        return [mbs.GetNodeODE2Index(node) + k for node in map(int, nodes) for k in range(counts[node])]

    forces, readings = np.zeros(n), np.zeros((2, n))
    forces[places(mbs.GetObject(system.channels[0].number)["nodeNumbers"])] = system.channels[0].forces
    for row, output in zip(readings, scene.outputs, strict=True):
        for term in system.readings[output]:
            row[places([mbs.GetSensor(term.sensors[0])["nodeNumber"]])] += term.weights
    mass, stiffness, damping = (basis.T @ matrix @ basis for matrix in (mass, *found))
    s = 2j * np.pi * frequency[:, None, None]
    answers = np.linalg.solve(
        s**2 * mass + s * damping + stiffness, np.tile(basis.T @ forces, (len(frequency), 1))[:, :, None]
    )
    return (readings @ basis @ answers)[:, :, 0].T


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_frf_of_exudyns_linearisation_equals_ours(apa, fidelity):
    bench = make_bench(apa=apa, fidelity=fidelity)
    frequency = np.concatenate([[1e-3], np.geomspace(1, 2000, 200)])
    expected = frequency_response(linearize(bench), frequency).values[:, 0]
    found = exudyns_own_frf(bench, frequency)
    assert np.all(np.abs(found - expected) < 1e-6 * np.abs(expected).max(axis=1, keepdims=True))


def test_explicit_integration_equals_the_exact_solution_and_knows_its_limit(apa):
    bench = make_bench(apa=apa, fidelity="linear", cutoff_frequency=1500.0)
    fastest = assemble(bench).modal.frequency[-1]
    limit = 2.6 / (2 * np.pi * fastest)
    step = 0.9 * limit
    time = np.arange(1501) * step
    push = TimeHistory(time, 0.1 * np.exp(-(((time - 5e-3) / 1.5e-3) ** 2)), bench.inputs, ("V",))
    exact = simulate(bench, push, time_step=step, method="exact", hold_order=0, progress=False)
    record = simulate(bench, push, time_step=step, method="explicit", progress=False)
    assert relative(record["encoder"], exact["encoder"]) < 1e-5
    with pytest.raises(ValueError, match=r"beyond the explicit rule's limit of .* s, set by the fastest pole"):
        simulate(bench, push, time_step=1.1 * limit, method="explicit", progress=False)
    with pytest.raises(ValueError, match='method "explicit" is for small motion'):
        simulate(make_bench(apa=apa), push, time_step=step, method="explicit", progress=False)
