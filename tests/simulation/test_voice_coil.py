"""Voice coils against their equations, in every engine: two unequal coils on one input, in general directions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from conftest import lattice

from nassim import (
    AngleSensor,
    CurrentSensor,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoiceCoil,
    craig_bampton,
    describe,
    fixed,
    frequency_response,
    linearize,
    load,
    placed,
    prismatic,
    revolute,
    save,
    simulate,
    static_response,
    trim_scene,
)
from nassim.scene.measures import PointVelocity
from nassim.scene.terms import CoilForce
from nassim.simulation.run.simulate import exudyn_eigenfrequencies
from nassim.systems import pid

AXIS, OTHER = np.array([2.0, -1.0, 2.0]) / 3, np.array([0.6, 0.0, 0.8])
MASS, DAMPING, STIFFNESS = 2.0, 3.0, 800.0
PULL, RESISTANCE, INDUCTANCE = np.array([12.0, 7.0]), np.array([3.0, 5.0]), np.array([2e-3, 8e-3])
ALONG = PULL * [1.0, -AXIS @ OTHER]
"""Forces of both coils on the cart along its slide [N/A]; the second one has the cart as its first point."""


def coils(cart, wall="ground.wall", other="cart.o"):
    """Two coils of unequal values between a cart and the ground, the second one askew and the other way round."""
    values = np.column_stack([RESISTANCE, INDUCTANCE])
    return (
        VoiceCoil("strong", wall, cart, AXIS, PULL[0], *values[0], "voltage"),
        VoiceCoil("weak", other, wall, OTHER, PULL[1], *values[1], "voltage"),
    )


def stage(stiffness=STIFFNESS, **changes):
    """A cart on a slide with a spring and two coils."""
    ground = RigidBody("ground", {"o": [0, 0, 0], "wall": [0.1, 0.2, 0.0]}, fixed=True)
    cart = RigidBody("cart", {"o": [0, 0, 0], "winding": [0.05, 0, 0.1]}, MASS, np.diag([0.01, 0.02, 0.025]))
    spring = SpringDamper("spring", "ground.o", "cart.o", AXIS, stiffness, 1e-9)
    options = {"damping_ratio": 0.0, "springs": (spring,)} | changes
    return Scene(
        "stage",
        (ground, cart),
        (prismatic("slide", "ground.o", "cart.o", AXIS, damping=DAMPING),),
        (*coils("cart.winding"), PointForce("push", "cart.o", AXIS, "force")),
        (Encoder("x", "ground.o", "cart.o", AXIS), CurrentSensor("i", "strong"), CurrentSensor("j", "weak")),
        **options,
    )


def impedance(s):
    """Impedances of both coils, (2, n) [Ohm]."""
    return RESISTANCE[:, None] + np.outer(INDUCTANCE, s)


def test_displacement_and_currents_follow_voltage_and_force_as_in_closed_form():
    """(m s^2 + (c + sum k^2 / Z) s + K) x = sum k / Z u + f and Z i = u - k s x."""
    frequency = np.geomspace(0.1, 1e3, 30)
    s = 2j * np.pi * frequency
    z = impedance(s)
    dynamic = MASS * s**2 + (DAMPING + (ALONG[:, None] ** 2 / z).sum(axis=0)) * s + STIFFNESS
    found = frequency_response(linearize(stage()), frequency)
    moved = (ALONG[:, None] / z).sum(axis=0) / dynamic
    np.testing.assert_allclose(found.response("x", "voltage"), moved, rtol=1e-9)
    np.testing.assert_allclose(found.response("x", "force"), 1 / dynamic, rtol=1e-9)
    for k, name in enumerate("ij"):
        np.testing.assert_allclose(found.response(name, "voltage"), (1 - ALONG[k] * s * moved) / z[k], rtol=1e-9)
        np.testing.assert_allclose(found.response(name, "force"), -ALONG[k] * s / dynamic / z[k], rtol=1e-9)


def test_poles_are_the_electrical_ones_and_those_of_back_emf_damping():
    """A free cart: (m s + c) (R + L s) (R' + L' s) + k^2 (R' + L' s) + k'^2 (R + L s), and the free displacement."""
    scene = replace(stage(), springs=())
    first, second = (np.polynomial.Polynomial(pair) for pair in zip(RESISTANCE, INDUCTANCE, strict=True))
    cart = np.polynomial.Polynomial([DAMPING, MASS])
    expected = np.append((cart * first * second + ALONG[0] ** 2 * second + ALONG[1] ** 2 * first).roots(), 0.0)
    found = np.linalg.eigvals(linearize(scene).A)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected.astype(complex)), rtol=1e-9, atol=1e-9)
    stuck = replace(scene, joints=(fixed("slide", "ground.o", "cart.o"),), bodies=(*scene.bodies, bob()))
    slow = np.sort(np.linalg.eigvals(linearize(stuck).A).real)[:2]
    np.testing.assert_allclose(slow, np.sort(-RESISTANCE / INDUCTANCE), rtol=1e-9)


def bob():
    """A body that nothing holds."""
    return RigidBody("bob", {"o": [0, 0, 0]}, 1.0, 0.01 * np.eye(3))


def own_run(time, voltage):
    """Displacement and currents of the stage under a voltage that runs straight between samples, (3, n)."""
    a = np.zeros((4, 4))
    a[0, 1], a[1, :2], a[1, 2:] = 1.0, [-STIFFNESS / MASS, -DAMPING / MASS], ALONG / MASS
    a[2:, 1], a[2:, 2:] = -ALONG / INDUCTANCE, -np.diag(RESISTANCE / INDUCTANCE)
    b = np.array([0.0, 0.0, *1 / INDUCTANCE])[:, None]
    return scipy.signal.lsim((a, b, np.eye(4)[[0, 2, 3]], np.zeros((3, 1))), voltage, time)[1].T


def run(scene, step, method, duration=0.04, **options):
    """Outputs of a scene under a voltage that does not start at zero, (outputs, n)."""
    time = np.arange(round(duration / step) + 1) * step
    inputs = [2.0 * np.cos(60.0 * time) if name == "voltage" else 0 * time for name in scene.inputs]
    given = TimeHistory(time, inputs, scene.inputs)
    record = simulate(scene, given, time_step=step, method=method, progress=False, **options)
    return record.values[len(scene.inputs) :]


def extrapolated(scene, step, **options):
    """Outputs by generalized-alpha at steps of half the size, without their error of second order."""
    coarse, fine = (run(scene, h, "generalized_alpha", spectral_radius=1.0, **options) for h in (step, step / 2))
    return (4 * fine[:, ::2] - coarse) / 3


def assert_close(found, expected, tolerance):
    """Compare signals by the size of each."""
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * np.abs(other).max())


def test_runs_are_those_of_the_equations():
    time = np.arange(101) * 1e-4
    assert_close(run(stage(), 1e-4, "exact", 0.01), own_run(time, 2.0 * np.cos(60.0 * time)), 1e-10)
    time = np.arange(51) * 4e-5
    assert_close(extrapolated(stage(), 4e-5, duration=2e-3), own_run(time, 2.0 * np.cos(60.0 * time)), 1e-6)


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=2, progress=False)


def flexible_stage(body, fidelity="linear", **changes):
    """The coils act on the far end of a flexible body, askew, whose near end slides."""
    at = FlexibleBody("beam", body, (0.1, -0.2, 0.3), scipy.spatial.transform.Rotation.from_rotvec(AXIS).as_matrix())
    beam = replace(at, fidelity=fidelity)
    near, far = (beam.point_position(name) for name in ("left", "right"))
    ground = RigidBody("ground", {"o": near, "wall": far + 0.1}, fixed=True)
    return Scene(
        "flexible stage",
        (ground, beam),
        (prismatic("slide", "ground.o", "beam.left", AXIS, damping=DAMPING),),
        coils("beam.right", other="beam.right"),
        (Encoder("x", "ground.wall", "beam.right", AXIS), CurrentSensor("i", "strong"), CurrentSensor("j", "weak")),
        (SpringDamper("spring", "ground.o", "beam.left", AXIS, STIFFNESS),),
        **{"damping_ratio": 0.0} | changes,
    )


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_exudyn_has_the_equations_of_exact_steps(body, fidelity):
    """The motion is small, 1e-6 of it by rotations of second order."""
    exact = run(flexible_stage(body), 4e-5, "exact", 2e-3)
    found = extrapolated(flexible_stage(body, fidelity), 4e-5, duration=2e-3, period_correction=False)
    assert np.abs(exact[0]).max() > 2e-6
    assert_close(found, exact, 1e-6)


def test_other_forms_of_a_scene_keep_its_coils(body, tmp_path):
    scene = flexible_stage(body)
    frequency = np.array([3.0, 80.0, 900.0])
    expected = frequency_response(linearize(scene), frequency).values
    for other in (load(save(scene, tmp_path / "scene.h5")), placed(scene, "a", rotation=np.eye(3)[[1, 2, 0]])):
        np.testing.assert_allclose(frequency_response(linearize(other), frequency).values, expected, rtol=1e-7)
    trimmed = trim_scene(replace(scene, cutoff_frequency=2e4))
    np.testing.assert_allclose(frequency_response(linearize(trimmed), frequency).values, expected, rtol=1e-3)
    assert "electrical pole at 238.7 Hz" in describe(scene)


@pytest.mark.parametrize("method", ["exact", "linear", "ffrf"])
def test_at_rest_the_resistance_limits_the_current(body, method):
    """Under a constant voltage u, i = u / R in every engine, and the force bends spring and beam."""
    fidelity = "ffrf" if method == "ffrf" else "linear"
    scene = flexible_stage(body, fidelity)
    found = static_response(scene, {"voltage": 0.5})
    assert_close([[found["i"]], [found["j"]]], 0.5 / RESISTANCE[:, None], 1e-6)
    gain = frequency_response(linearize(flexible_stage(body)), [0.0]).response("x", "voltage")[0].real
    assert found["x"] == pytest.approx(0.5 * gain, rel=1e-4)
    constant = {"constant_inputs": {"voltage": 0.5}}
    time = np.arange(11) * 1e-4
    given = TimeHistory(time, 0 * time, ("voltage",), ("V",))
    engine = "exact" if method == "exact" else "generalized_alpha"
    record = simulate(scene, given, time_step=1e-4, method=engine, progress=False, **constant)
    for name in ("i", "j", "x"):
        np.testing.assert_allclose(record[name], found[name], rtol=1e-4)


def test_a_push_balances_the_forces_of_both_coils_of_one_input():
    """A free cart then has an equilibrium, and a run starts and stays there."""
    scene = stage(springs=())
    held = {"voltage": 0.5, "force": -0.5 * float(np.sum(ALONG / RESISTANCE))}
    record = simulate(scene, None, duration=0.1, time_step=1e-3, method="exact", constant_inputs=held, progress=False)
    assert np.abs(record["x"]).max() < 1e-12
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        simulate(scene, None, duration=0.1, time_step=1e-3, method="exact", constant_inputs=held | {"force": 0.0})


@pytest.mark.parametrize("method", ["exact", "large", "small"])
def test_a_driven_carriage_feels_the_back_emf(body, method):
    """A carriage of mass m follows a slide on a table of mass M; its coil against the ground makes the table recoil."""
    table = RigidBody("table", {"o": [0, 0, 0]}, 5.0, 0.05 * np.eye(3))
    scene = stage()
    ground, cart = scene.bodies
    slide = prismatic("slide", "table.o", "cart.o", AXIS)
    foot = prismatic("foot", "ground.o", "table.o", AXIS, damping=DAMPING)
    spring = replace(scene.springs[0], b="table.o")
    bodies, joints = (ground, table, cart), (slide, foot)
    if method == "small":
        bodies += (FlexibleBody("other", body, (0.0, -0.01, -0.01), fidelity="linear"),)
        joints += (Joint("clamp", "ground.o", "other.left"),)
    scene = replace(
        scene,
        bodies=bodies,
        joints=joints,
        springs=(spring,),
        actuators=(*scene.actuators[:2], Drive("drive", "slide", input="path")),
        sensors=(Encoder("y", "ground.o", "table.o", AXIS), *scene.sensors[1:]),
    )
    frequency = np.geomspace(0.5, 300.0, 12)
    s, mass = 2j * np.pi * frequency, 5.0 + MASS
    z = impedance(s)
    drag = (ALONG[:, None] ** 2 / z).sum(axis=0) * s
    recoil = -(MASS * s**2 + drag) / (mass * s**2 + DAMPING * s + drag + STIFFNESS)
    found = frequency_response(linearize(scene), frequency)
    np.testing.assert_allclose(found.response("y", "path"), recoil, rtol=1e-7)
    np.testing.assert_allclose(found.response("i", "path"), -ALONG[0] * s * (1 + recoil) / z[0], rtol=1e-7)
    step = 1e-4
    time = np.arange(151) * step
    given = TimeHistory(time, [0 * time, 1e-3 * np.sin(50 * time) ** 2], ("voltage", "path"), ("V", "m"))
    expected = simulate(scene, given, time_step=step, method="exact", progress=False).values[2:]
    if method != "exact":
        found = simulate(scene, given, time_step=step, spectral_radius=1.0, progress=False).values[2:]
        assert_close(found, expected, 2e-3)


def test_a_coil_on_a_turntable_works_along_its_axes():
    """Along a slide that turns at W, the carriage has the stiffness K - m W^2; the turntable bears Coriolis forces."""
    speed, place = 12.0, 0.02
    ground = RigidBody("ground", {"o": [0, 0, 0]}, fixed=True)
    table = RigidBody("table", {"o": [0, 0, 0], "p": [place, 0, 0]}, 5.0, 0.05 * np.eye(3))
    cart = RigidBody("cart", {"o": [0, 0, 0]}, MASS, 0.01 * np.eye(3), [place, 0, 0])
    coil = VoiceCoil("coil", "table.p", "cart.o", "x", PULL[0], RESISTANCE[0], INDUCTANCE[0], "voltage", "table.p")
    scene = Scene(
        "turntable",
        (ground, table, cart),
        (revolute("axle", "ground.o", "table.o", "z"), prismatic("slide", "table.p", "cart.o", "x", damping=DAMPING)),
        (coil, Drive("motor", "axle", "rz", speed=speed)),
        (Encoder("x", "table.p", "cart.o", "x", "table.p"), CurrentSensor("i", "coil")),
        (SpringDamper("spring", "table.p", "cart.o", "x", 8e3, frame="table.p"),),
        damping_ratio=0.0,
    )
    s = 2j * np.pi * np.geomspace(1.0, 300.0, 9)
    z = RESISTANCE[0] + INDUCTANCE[0] * s
    moved = PULL[0] / z / (MASS * s**2 + (DAMPING + PULL[0] ** 2 / z) * s + 8e3 - MASS * speed**2)
    found = frequency_response(linearize(scene), s.imag / (2 * np.pi))
    np.testing.assert_allclose(found.response("x", "voltage"), moved, rtol=1e-7)
    np.testing.assert_allclose(found.response("i", "voltage"), (1 - PULL[0] * s * moved) / z, rtol=1e-7)
    exact = run(scene, 2e-4, "exact", 0.02)
    assert exact[0, 0] == pytest.approx(MASS * speed**2 * place / (8e3 - MASS * speed**2), rel=1e-7)
    assert exact[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert_close(run(scene, 2e-4, "generalized_alpha", 0.02), exact, 5e-3)


def test_a_current_loop_closes_over_coil_and_cart():
    """A sampled PI controller drives the voltage such that the current follows its set point."""
    servo = pid(3.0, 5e3, sample_rate=5e3)
    loop = Loop("amplifier", servo, "i", "voltage", reference="set")
    scene = stage(loops=(loop,))
    time = np.arange(401) * 5e-5
    given = TimeHistory(time, [np.full(401, 0.5), 0 * time], ("set", "force"), ("A", "N"))
    exact, stepped = (
        simulate(scene, given, time_step=5e-5, method=method, progress=False)
        for method in ("exact", "generalized_alpha")
    )
    assert exact["i"][-1] == pytest.approx(0.5, rel=0.02)
    # Where a command jumps by 1.5 V, generalized-alpha takes the mean: in the step before, the current then moves by
    # 1.5 V / 4 * 5e-5 s / 2 mH = 9.4 mA.
    assert_close([stepped["i"], stepped["x"]], [exact["i"], exact["x"]], 0.025)


def test_a_shorted_coil_takes_the_energy_of_a_pendulum():
    """In large motion along a line that turns: L i' + R i = -k d', and energy goes into R i^2 and the inductance."""
    pull, resistance, inductance, mass, arm, inertia, g = 6.0, 2.0, 0.05, 0.5, 0.2, 1e-3, 9.81
    ground = RigidBody("ground", {"o": [0, 0, 0], "wall": [-0.3, 0.02, -0.1]}, fixed=True)
    bob = RigidBody("bob", {"o": [-arm, 0, 0], "p": [0.05, 0.02, 0]}, mass, inertia * np.eye(3), [arm, 0, 0])
    scene = Scene(
        "pendulum",
        (ground, bob),
        (revolute("pivot", "ground.o", "bob.o", "y"),),
        (VoiceCoil("coil", "ground.wall", "bob.p", "line", pull, resistance, inductance, "voltage"),),
        (
            AngleSensor("angle", "ground.o", "bob.o", "y"),
            Encoder("d", "ground.wall", "bob.p", "line"),
            CurrentSensor("i", "coil"),
        ),
        gravity=[0, 0, -g],
    )
    step = 1e-3
    time = np.arange(251) * step
    given = TimeHistory(time, 0 * time, ("voltage",), ("V",))
    options = {"start": "released", "spectral_radius": 1.0, "progress": False}
    record = simulate(scene, given, time_step=step, **options)
    angle, d, i = record["angle"], record["d"], record["i"]
    assert np.ptp(angle) > 0.5
    law = inductance * np.gradient(i, step) + resistance * i + pull * np.gradient(d, step)
    np.testing.assert_allclose(law[2:-2], 0.0, atol=2e-3 * np.abs(resistance * i).max())
    energy = 0.5 * (inertia + mass * arm**2) * np.gradient(angle, step) ** 2 - mass * g * arm * np.sin(angle)
    lost = scipy.integrate.cumulative_trapezoid(resistance * i**2, dx=step, initial=0.0) + 0.5 * inductance * i**2
    assert lost[-1] > 0.1
    np.testing.assert_allclose(-energy[2:-2], lost[2:-2], atol=2e-3 * lost[-1])


def test_eigenfrequencies_are_those_without_current(body):
    scene = flexible_stage(body)
    for fidelity in ("linear", "ffrf"):
        without = replace(scene, actuators=(), sensors=scene.sensors[:1])
        expected = exudyn_eigenfrequencies(without, n_modes=4)
        found = exudyn_eigenfrequencies(flexible_stage(body, fidelity), n_modes=4)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_bad_coils_are_refused_by_name(body):
    good = stage()
    strong = good.actuators[0]
    for change, message in (
        ({"resistance": 0.0}, "voice coil 'strong' has no resistance, so its current would grow without end"),
        ({"resistance": -1.0}, "voice coil 'strong': resistance must be positive, got -1 Ohm"),
        ({"inductance": 0.0}, "voice coil 'strong': inductance must be positive, got 0 H"),
        ({"force_constant": 0.0}, "voice coil 'strong': a force_constant of 0 N/A makes no force"),
        ({"axis": (0, 0, 0)}, "voice coil 'strong': an axis must have a length"),
        ({"b": "ground.wall"}, "voice coil 'strong' connects 'ground.wall' with itself"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(strong, **change)
    with pytest.raises(ValueError, match=r"voice coil 'strong': 'ground.wall' and 'ground.o' belong to one rigid body"):
        replace(good, actuators=(replace(strong, b="ground.o"), *good.actuators[1:]))
    with pytest.raises(ValueError, match="unknown coil of current sensor 'i' 'none'; known: strong, weak"):
        replace(good, sensors=(CurrentSensor("i", "none"),))
    with pytest.raises(ValueError, match="unknown coil of current sensor 'i' 'push'; known: strong, weak"):
        replace(
            good,
            actuators=(*good.actuators[:2], PointForce("push", "cart.o", "x", "push")),
            sensors=(CurrentSensor("i", "push"),),
        )
    with pytest.raises(ValueError, match="input 'voltage' cannot be both N and V"):
        replace(good, actuators=(*good.actuators[:2], PointForce("push", "cart.o", "x", "voltage")))
    rate = PointVelocity((("cart.o", AXIS),))
    with pytest.raises(ValueError, match="coil 'c': a PointVelocity has no value in large motion"):
        CoilForce("c", "u", rate, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match='method "explicit" cannot integrate the circuits of coils'):
        run(flexible_stage(body), 1e-6, "explicit", 1e-4)
