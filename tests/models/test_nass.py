"""The end-station against rigid bodies on springs put together by hand, and its budget against runs in time."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import motion_beside

from models.hexapods import NANO_HEXAPOD
from models.nano_hexapod import make_nano_hexapod
from models.nass import (
    DISTURBANCES,
    END_STATION,
    FIXED_PAIRS,
    POSE_PAIRS,
    SIX,
    Stage,
    alike_across,
    four_corners,
    make_nass,
    suspension,
)
from models.nass_loops import (
    CONVERTERS,
    POSE,
    SENSORS,
    TARGETS,
    VOLTAGES,
    force_loop,
    hac_lac,
    pose_loop,
    scheduled,
    shaped_pose_loop,
    wrench_shares,
)
from models.strut import spring_strut, two_mass_strut, with_own_damping
from nassim import (
    Bushing,
    LinearModel,
    RigidBody,
    Scene,
    TimeHistory,
    frequency_response,
    linearize,
    load,
    save,
    simulate,
)
from nassim.kinematics import jacobian
from nassim.signals import smooth_step, spectral_noise, turned
from nassim.simulation import linearize_closed, spinning_equilibrium
from nassim.systems import (
    close_loop,
    controller_response,
    damping,
    family_margins,
    noise_budget,
    open_loop,
    rotating_noise_budget,
    sampled,
    unstable_poles,
    with_inputs,
)

PLATFORM = replace(NANO_HEXAPOD, point=np.array([0.02, -0.01, 0.12]))
SAMPLE = np.array([0.02, -0.01, 0.095 + 0.12])
HEIGHTS = {"granite": -1.2, "translation": -0.8, "tilt": -0.55, "spindle": -0.4, "micro_hexapod": -0.03}
RATE = 2000.0
STRUT, LOAD = spring_strut(1.8e6, damping=80.0), {"payload_mass": 10.0}


def machine(**options):
    return make_nass(STRUT, platform=PLATFORM, **LOAD, **options)


def static(model, output, inputs):
    """Static gains, (6, inputs)."""
    gains = model.D - model.C @ np.linalg.solve(model.A, model.B)
    rows = [model.outputs.index(f"{output}.{six}") for six in SIX]
    return gains[np.ix_(rows, [model.inputs.index(name) for name in inputs])]


def arms():
    return {name: motion_beside(SAMPLE - [0, 0, height]) for name, height in HEIGHTS.items()}


@pytest.fixture(scope="module")
def model():
    return linearize(machine())


@pytest.fixture(scope="module")
def driven():
    """Linear model of the machine with struts that voltages drive."""
    return linearize(make_nass(with_own_damping(two_mass_strut()), platform=PLATFORM, payload_mass=10.0))


def test_a_wrench_on_the_sample_bends_all_stages_in_series(model):
    inputs = [f"payload_{kind}_{c}" for kind in ("force", "torque") for c in "xyz"]
    expected = static(model, "pose", inputs)
    for name, arm in arms().items():
        stiffness = END_STATION[name].stiffness
        square = np.diag(stiffness) if stiffness.ndim == 1 else stiffness
        expected = expected + arm @ np.linalg.inv(square) @ arm.T
    found = static(model, "metrology", inputs)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)


def test_struts_push_against_their_base_only(model):
    """Forces in the struts are inner ones: far from it, nothing bends below the hexapod."""
    forces = [f"strut_{k}/actuator_force" for k in range(1, 7)]
    expected = np.linalg.inv(jacobian(PLATFORM)) / 1.8e6
    np.testing.assert_allclose(static(model, "metrology", forces), expected, atol=1e-9 * np.abs(expected).max())


def test_offsets_carry_the_sample_along_as_a_rigid_body(model):
    """A runout of 1 um moves it by 1 um, a tilt of 1 urad about the tilt stage's foot."""
    found = static(model, "metrology", DISTURBANCES)
    expected = [arms()[stage][:, SIX.index(six)] for stage, six in DISTURBANCES.values()]
    np.testing.assert_allclose(found, np.transpose(expected), atol=1e-8)
    assert np.abs(static(model, "pose", DISTURBANCES)).max() < 1e-8


def test_a_slow_acceleration_of_the_floor_compresses_what_is_below(model):
    """Each bushing carries what stands on it: masses of stages, rotor, base, plate and payload."""
    above = 120.0 + 40.0 + 3.87 + 5.19 + 10.0
    sag = 0.0
    for name in ("spindle", "tilt", "translation", "granite"):
        above += END_STATION[name].mass
        sag += above / END_STATION[name].stiffness[2]
    micro = END_STATION["micro_hexapod"].stiffness[2, 2]
    sag += (40.0 + 3.87 + 5.19 + 10.0) / micro
    found = static(model, "metrology", ["floor_z"])[2, 0] - static(model, "pose", ["floor_z"])[2, 0]
    assert found == pytest.approx(-sag, rel=1e-9)


def test_modes_of_the_whole():
    """Of the linear model with its damping, and where they move."""
    scene = machine()
    modes = suspension(scene, 150.0)
    frequency, ratio = damping(linearize(scene))
    np.testing.assert_allclose([f for f, _ in modes], frequency[frequency < 149.0][: len(modes)], rtol=2e-3)
    assert ratio[frequency < 149.0].max() < 0.05
    assert len(modes) >= 12
    for _, shares in modes:
        assert sum(shares.values()) == pytest.approx(1.0)
        assert list(shares.values()) == sorted(shares.values(), reverse=True)
        assert {"granite", "rotor", "payload"} <= set(shares)


def test_one_stage_alone_is_an_oscillator_of_its_own_ratio():
    stage = Stage(mass=50.0, size=(0.3, 0.4, 0.5), foot=0.0, centre=0.0, stiffness=np.full(6, 4e6), damping_ratio=0.03)
    body = RigidBody("stage", {"o": np.zeros(3)}, stage.mass, stage.inertia)
    assert stage.inertia[2, 2] == pytest.approx(50.0 / 12 * (0.3**2 + 0.4**2))
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    time = stage.damping_ratio / (np.pi * 100.0)
    spring = Bushing("spring", "ground.o", "stage.o", stage.stiffness, time * stage.stiffness)
    frequency, ratio = damping(linearize(Scene("one", (ground, body), springs=(spring,), damping_ratio=0.0)))
    assert ratio == pytest.approx(0.03 * frequency / 100.0, rel=1e-6)


def test_every_bushing_has_its_stages_ratio_at_the_frequency():
    """As a spring and a damper beside it: c = 2 zeta k / omega, at 100 Hz; that of the tilt stage is another's."""
    stages = {**END_STATION, "tilt": replace(END_STATION["tilt"], damping_ratio=0.05)}
    springs = {spring.name: spring for spring in machine(stages=stages).springs}
    for name, stage in stages.items():
        square = np.diag(stage.stiffness) if stage.stiffness.ndim == 1 else stage.stiffness
        expected = 2 * (0.05 if name == "tilt" else 0.02) * square / (2 * np.pi * 100.0)
        np.testing.assert_allclose(springs[name].damping, expected, rtol=1e-12, atol=1e-6)


def test_every_part_is_described():
    scene = make_nass(tilt_input="tilt")
    assert [part.name for part in scene.parts if part.name not in part.describe()] == []


def test_stages_alike_across_have_the_means_of_their_figures():
    stages = alike_across()
    assert stages["micro_hexapod"] is END_STATION["micro_hexapod"]
    tilt, translation = stages["tilt"], stages["translation"]
    assert translation.size == pytest.approx((0.95, 0.95, 0.25))
    np.testing.assert_allclose(translation.stiffness, [6e8, 6e8, 1.2e9, 1.35e8, 1.35e8, 1e8])
    assert (tilt.mass, tilt.foot, tilt.centre) == (400.0, -0.55, -0.45)
    np.testing.assert_allclose(tilt.stiffness[:3], 4e6 * np.array([456.0, 456.0, 238.0]))


def test_the_nano_hexapods_base_lies_below_its_upper_face():
    """A steel disc of 3.87 kg and 0.3 m, its centre half of its 7 mm down; on a spindle of 60 turns a minute."""
    scene = machine(spindle_rpm=60.0)
    base = scene.body("base")
    thick = 3.87 / (7800.0 * np.pi * 0.15**2)
    np.testing.assert_allclose(base.position, [0, 0, -thick / 2], rtol=1e-12)
    across = 3.87 * (3 * 0.15**2 + thick**2) / 12
    np.testing.assert_allclose(base.inertia, np.diag([across, across, 3.87 * 0.15**2 / 2]), rtol=1e-12, atol=1e-15)
    for k, joint in enumerate(PLATFORM.base_joints, start=1):
        np.testing.assert_allclose(scene.point_position(f"base.joint_{k}"), joint, atol=1e-12)
    (drive,) = (part for part in scene.actuators if part.name == "spindle")
    assert drive.speed == pytest.approx(2 * np.pi)


def test_shares_of_bodies_in_modes_by_hand():
    """Two masses above each other: along z 2 kg and 1 kg on two springs, solved as 2 x 2."""
    springs = [Bushing(n, f"{a}.o", f"{b}.o", [1e9, 1e9, k, 1e7, 1e7, 1e7]) for n, a, b, k in (
        ("one", "ground", "low", 2e5), ("two", "low", "high", 1e5))]  # fmt: skip
    bodies = [RigidBody(n, {"o": np.zeros(3)}, m, m * np.eye(3)) for n, m in (("low", 2.0), ("high", 1.0))]
    scene = Scene("two", (RigidBody("ground", {"o": np.zeros(3)}, fixed=True), *bodies), springs=springs)
    squares, shapes = scipy.linalg.eigh([[3e5, -1e5], [-1e5, 1e5]], np.diag([2.0, 1.0]))
    found = suspension(scene, 150.0)
    assert [f for f, _ in found] == pytest.approx(np.sqrt(squares) / (2 * np.pi), rel=1e-9)
    for (_, shares), shape in zip(found, shapes.T, strict=True):
        assert shares == pytest.approx({"low": 2 * shape[0] ** 2, "high": shape[1] ** 2}, rel=1e-9)


def test_force_loops_are_six_leaky_integrators():
    loop = force_loop(80.0, sample_rate=RATE, leak=3.0, delay=2)
    frequency = np.array([1.0, 10.0, 40.0])
    s = 2j * np.pi * frequency
    each = -80.0 / (s + 2 * np.pi * 3.0) * np.exp(-2 * s / RATE)
    found = controller_response(loop.controller, frequency).values
    np.testing.assert_allclose(found, np.eye(6)[:, :, None] * each, rtol=2e-3, atol=1e-12)
    assert (loop.measured, loop.driven) == (tuple(f"strut_{k}/sensor_voltage" for k in range(1, 7)), tuple(VOLTAGES))


@pytest.mark.parametrize("coordinates", ["struts", "cartesian"])
def test_each_pose_loop_crosses_where_asked_with_those_before_closed(driven, coordinates):
    """By the machine's response at the crossover alone, and the struts' lines written down."""
    inner = force_loop(100.0, sample_rate=RATE)
    damped = close_loop(sampled(driven, RATE), inner.controller, measured=inner.measured, driven=inner.driven)
    options = {"coordinates": coordinates, "phase_margin": 50.0, "sample_rate": RATE, "platform": PLATFORM}
    loop = pose_loop(damped, 15.0, **options)
    lines = PLATFORM.platform_joints + np.array([0, 0, PLATFORM.height]) - PLATFORM.base_joints
    along = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    lengths = np.hstack([along, np.cross(PLATFORM.platform_joints - PLATFORM.point, along)])
    measure, drive = (lengths, np.eye(6)) if coordinates == "struts" else (np.eye(6), np.linalg.inv(lengths).T)
    at = np.array([15.0])
    g = frequency_response(damped, at)
    g = np.array([[g.response(y, u)[0] for u in VOLTAGES] for y in POSE])
    whole = controller_response(loop.controller, at).values[..., 0]
    k = np.linalg.solve(drive, whole) @ np.linalg.inv(measure)
    np.testing.assert_allclose(k, np.diag(np.diag(k)), atol=1e-9 * np.abs(k).min(where=np.eye(6) > 0, initial=np.inf))
    opened = -measure @ g @ drive @ k
    for n in range(1, 7):
        alone = 1 / np.linalg.inv(np.eye(n) + opened[:n, :n])[-1, -1] - 1
        assert abs(alone) == pytest.approx(1.0, rel=1e-6)
        assert np.degrees(np.angle(-alone)) == pytest.approx(50.0, abs=1e-4)
    assert not unstable_poles(close_loop(damped, loop.controller, measured=loop.measured, driven=loop.driven))


@pytest.mark.parametrize("delay", [1, 3])
def test_pose_loops_wait_as_told(delay):
    """Six lags of first order along the struts: the phase margin is as asked for in spite of the delay."""
    lag = LinearModel(-np.eye(6), np.eye(6), np.linalg.inv(jacobian(PLATFORM)), np.zeros((6, 6)), VOLTAGES, POSE)
    lag = sampled(lag, RATE)
    loop = pose_loop(lag, 15.0, phase_margin=50.0, sample_rate=RATE, delay=delay, platform=PLATFORM)
    assert loop.controller.delay == delay
    opened = open_loop(lag, loop.controller, [15.0], measured=loop.measured, driven=loop.driven).values[..., 0]
    np.testing.assert_allclose(np.linalg.eigvals(opened), np.exp(-1j * np.radians(130)), atol=1e-6)


def test_four_bearings():
    """Held at four corners, each as stiff along x, y, z."""
    found = four_corners((1.0, 2.0, 5.0), 0.3, 0.2)
    corners = [motion_beside((sx * 0.3, sy * 0.2, 0.0)) for sx in (1, -1) for sy in (1, -1)]
    expected = sum(arm[:3].T @ np.diag([1.0, 2.0, 5.0]) @ arm[:3] for arm in corners)
    np.testing.assert_allclose(np.diag(found), expected, atol=1e-12)


def test_a_wrench_of_the_pose_loop_moves_the_sample_along_itself(driven):
    """As a wrench from outside does, but for the joints, which bend, and of which the Jacobian does not know."""
    inputs = [f"payload_{kind}_{c}" for kind in ("force", "torque") for c in "xyz"]
    inside, outside = static(driven, "pose", VOLTAGES) @ wrench_shares(PLATFORM), static(driven, "pose", inputs)
    scale = np.sqrt(np.outer(np.diag(outside), np.diag(outside)))
    per_volt = np.sum(inside * outside / scale**2) / np.sum((outside / scale) ** 2)
    assert np.abs(inside / per_volt - outside).max() < 0.05 * np.abs(outside).max()
    np.testing.assert_allclose(inside / per_volt / scale, outside / scale, rtol=0, atol=0.1)


def test_a_spinning_linear_model_needs_stages_alike_across_the_axis():
    with pytest.raises(ValueError, match="body 'translation': in the rotor frame, this changes by"):
        linearize(make_nass(STRUT, spindle_rpm=60.0, frame="rotor"))
    scene = make_nass(STRUT, stages=alike_across(), spindle_rpm=60.0, frame="rotor")
    assert {name for pair in FIXED_PAIRS for name in pair} <= set(scene.inputs)
    spinning, at_rest = linearize(scene), linearize(make_nass(STRUT, stages=alike_across()))
    assert not unstable_poles(spinning)
    # Symmetric pairs part by about the spindle's frequency, others stay.
    apart = np.abs(damping(spinning)[0][:8] - damping(at_rest)[0][:8])
    assert 0.05 < apart.max() < 1.5
    found = static(spinning, "metrology", ["runout_x", "runout_z", "translation_y"])
    assert found[0, 0] == pytest.approx(1.0, rel=2e-3)
    assert found[2, 1] == pytest.approx(1.0, rel=1e-8)
    assert found[1, 2] == pytest.approx(1.0, rel=5e-3)


def test_exact_steps_start_in_the_steady_state_of_a_turning_spindle():
    """As the linear model reads it, with a force that comes later."""
    scene = make_nass(STRUT, stages=alike_across(), spindle_rpm=60.0, frame="rotor")
    time = np.arange(201) * 1e-3
    push = np.sin(10.0 * np.clip(time - 0.1, 0.0, None)) ** 2
    quiet = TimeHistory(time, [push * (n == "payload_force_x") for n in scene.inputs], scene.inputs, ())
    record = simulate(scene, quiet, time_step=1e-3, method="exact", hold_order=0, progress=False)
    steady = spinning_equilibrium(scene)
    for name in scene.outputs:
        np.testing.assert_allclose(record[name][:100], steady[name], rtol=1e-6, atol=1e-18)
    assert np.ptp(record["metrology.ux"]) > 1e-8


def test_the_real_station_turns_in_time():
    """In the stator frame; the sample goes round with the spindle, but for the jolt of the start."""
    scene = make_nass(STRUT, spindle_rpm=60.0)
    time = np.arange(21) * 1e-3
    quiet = TimeHistory(
        time, np.zeros((len(scene.inputs), 21)), scene.inputs, tuple(map(scene.input_unit, scene.inputs))
    )
    record = simulate(scene, quiet, time_step=1e-3, progress=False)
    np.testing.assert_allclose(record["metrology.rz"], 2 * np.pi * time, atol=0.03)
    assert record["metrology.rz"][-1] > 0.1
    with pytest.raises(ValueError, match="this changes by"):
        linearize(scene)
    with pytest.raises(ValueError, match="unknown frame 'moving'"):
        make_nass(STRUT, frame="moving")


def test_the_pose_of_a_turning_sample_is_what_is_left_of_its_rotation():
    """In large motion, along the rotor's axes and along fixed ones, where the angle about z is the whole one."""
    time = np.arange(41) * 1e-3
    angle = 1.2 * smooth_step(time, 0.0, 0.04)
    found = {}
    for frame in ("rotor", "stator"):
        scene = machine(spindle_input="angle", frame=frame, payload_centre=(0.03, -0.02, 0.06))
        given = np.zeros((len(scene.inputs), len(time)))
        given[scene.inputs.index("angle")] = angle
        units = tuple(map(scene.input_unit, scene.inputs))
        path = TimeHistory(time, given, scene.inputs, units)
        found[frame] = simulate(scene, path, time_step=1e-3, outputs=POSE, progress=False).select(POSE)
    fixed = turned(found["stator"], POSE_PAIRS[1:], -angle)
    for name in ("metrology.rx", "metrology.ry"):
        np.testing.assert_allclose(found["rotor"][name], fixed[name], rtol=0, atol=1e-9)
        assert np.ptp(fixed[name]) > 1e-7
    # The twist and the rotation vector's component differ by a twelfth of the square of the tilt.
    twist, tilt = fixed["metrology.rz"] - angle, np.hypot(fixed["metrology.rx"], fixed["metrology.ry"]).max()
    error = np.abs(found["rotor"]["metrology.rz"] - twist).max()
    assert error < 0.1 * tilt**2 * np.abs(twist).max()


def test_a_tilt_stage_turns_the_sample_about_its_point_of_interest(model):
    """Without any displacement of that point; at rest it is the locked machine, whose mass its two bodies share."""
    moving = linearize(machine(tilt_input="tilt_angle"))
    np.testing.assert_allclose(static(moving, "metrology", ["tilt_angle"])[:, 0], [0, 0, 0, 0, 1, 0], atol=1e-8)
    frequency = np.array([3.0, 40.0, 130.0])
    for output in ("metrology.ux", "metrology.ry"):
        one, other = (frequency_response(m, frequency).response(output, "tilt_ry") for m in (model, moving))
        np.testing.assert_allclose(one, other, rtol=1e-8)
    parts = {body.name: body for body in machine(tilt_input="tilt_angle").bodies}
    assert parts["tilt"].mass == pytest.approx(300.0)
    assert parts["tilt_guides"].mass == pytest.approx(100.0)


def test_a_metrology_that_sees_nothing_of_an_axis_is_named(model):
    """Whether a reading is missing or two are the same."""
    about_z, along_y = (model.outputs.index(f"metrology.{six}") for six in ("rz", "uy"))
    driven = with_inputs(model, VOLTAGES, np.eye(6), of=[f"strut_{k}/actuator_force" for k in range(1, 7)])
    for make in (pose_loop, shaped_pose_loop):
        for row, other, axis in ((about_z, None, "rz"), (along_y, "metrology.ux", "u[xy]")):
            c = driven.C.copy()
            c[row] = 0.0 if other is None else c[model.outputs.index(other)]
            with pytest.raises(ValueError, match=f"sees nothing of the sample's motion along '{axis}'"):
                make(replace(driven, C=c), 10.0, sample_rate=RATE, platform=PLATFORM)


def test_what_no_end_station_is():
    with pytest.raises(
        ValueError, match=r"granite, translation, tilt, spindle, micro_hexapod, in this order, got tilt"
    ):
        make_nass(STRUT, stages={"tilt": END_STATION["tilt"]})
    with pytest.raises(ValueError, match="six values"):
        END_STATION["micro_hexapod"].alike()


def test_the_payload_is_that_of_the_hexapod():
    options = {"payload_mass": 7.0, "payload_centre": (0.01, 0.02, 0.05), "payload_inertia": np.diag([0.1, 0.2, 0.25])}
    found, expected = (
        next(body for body in make(STRUT, platform=PLATFORM, **options).bodies if body.name == "payload")
        for make in (make_nass, make_nano_hexapod)
    )
    assert found.mass == 7.0
    np.testing.assert_array_equal(found.inertia, options["payload_inertia"])
    for name in ("position", "rotation", "inertia"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert {n: list(p) for n, p in found.points.items()} == {n: list(p) for n, p in expected.points.items()}


def test_the_end_station_is_saved(tmp_path):
    scene = make_nass(two_mass_strut(), platform=PLATFORM, **LOAD)
    save(scene, tmp_path / "scene.h5")
    again = load(tmp_path / "scene.h5")
    assert (again.inputs, again.outputs) == (scene.inputs, scene.outputs)


PERIOD, LOW, HIGH = 8.0, 2.0, 240.0


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["struts", "cartesian"])
def test_the_budget_of_the_closed_machine_is_the_rms_of_a_run(coordinates):
    """Of three disturbances at once, each with every third line of a random-phase multisine, over one period."""
    scene = make_nass(with_own_damping(two_mass_strut()), payload_mass=10.0)
    model = sampled(linearize(scene), RATE)
    inner = force_loop(100.0, sample_rate=RATE)
    damped = close_loop(model, inner.controller, measured=inner.measured, driven=inner.driven)
    scene = replace(scene, loops=(inner, pose_loop(damped, 15.0, coordinates=coordinates, sample_rate=RATE)))
    closed = linearize_closed(scene)
    densities = {"floor_x": 1e-8, "runout_y": 1e-19, "runout_z": 4e-19}
    budget = noise_budget(closed, densities, np.array([LOW, HIGH]), outputs=POSE)
    expected = budget.total.rms()[:, 0]

    rng, n = np.random.default_rng(1), round(PERIOD * RATE)
    lines = np.arange(round(LOW * PERIOD), round(HIGH * PERIOD))
    values = np.zeros((len(scene.inputs), n))
    for k, (name, density) in enumerate(densities.items()):
        own = lines[lines % 3 == k]
        spectrum = np.zeros(n // 2 + 1, dtype=complex)
        spectrum[own] = n / 2 * np.sqrt(2 * density * 3 / PERIOD) * np.exp(2j * np.pi * rng.random(len(own)))
        values[scene.inputs.index(name)] = np.fft.irfft(spectrum, n)
    settling = round(1.5 * RATE)
    values = np.hstack([values[:, -settling:], values])
    noise = TimeHistory(
        np.arange(values.shape[1]) / RATE, values, scene.inputs, tuple(map(scene.input_unit, scene.inputs))
    )
    record = simulate(scene, noise, time_step=1 / RATE, method="exact", hold_order=0, outputs=POSE, progress=False)
    found = record.select(POSE).values[:, settling:].std(axis=1)
    np.testing.assert_allclose(found, expected, rtol=0.05)
    shares = budget.rms() / expected[:, None]
    assert (shares > 0.2).any(axis=0).all()  # each of the three counts somewhere


@pytest.mark.slow
def test_the_budget_of_the_turning_machine_is_the_rms_of_a_run():
    """At 60 rpm, closed, along fixed axes: a floor and a translation with fixed axes, and runout that turns."""
    options = {"payload_mass": 10.0, "stages": alike_across(), "frame": "rotor"}
    loops = hac_lac(linearize(make_nass(**options)), 10.0, sample_rate=RATE)
    scene = replace(make_nass(**options, spindle_rpm=60.0), loops=loops)
    assert {*TARGETS, *CONVERTERS} <= set(scene.inputs)
    levels = {"floor_x": 1e-8, "translation_y": 4e-18, "runout_y": 4e-18, "target.uz": 1e-19}
    spectra = {name: lambda f, level=level: np.full(len(f), level) for name, level in levels.items()}
    pairs = {"fixed_inputs": FIXED_PAIRS, "fixed_outputs": POSE_PAIRS, "rotation_frequency": 1.0}
    budget = rotating_noise_budget(linearize_closed(scene), spectra, np.geomspace(LOW, HIGH, 80), outputs=POSE, **pairs)
    noise = spectral_noise(spectra, 10.0, RATE, band=(LOW, HIGH))
    values = np.zeros((len(scene.inputs), len(noise.time)))
    values[[scene.inputs.index(name) for name in noise.names]] = noise.values
    angle = 2 * np.pi * noise.time
    given = turned(TimeHistory(noise.time, values, scene.inputs), FIXED_PAIRS, -angle)
    record = simulate(scene, given, time_step=1 / RATE, method="exact", hold_order=0, outputs=POSE, progress=False)
    found = turned(record.select(POSE), POSE_PAIRS, angle).after(1.0).values.std(axis=1)
    expected = budget.total.rms()[:, 0]
    np.testing.assert_allclose(found[:5], expected[:5], rtol=0.1)
    assert abs(expected[0] / expected[1] - 1) > 0.15  # so that axes that are mixed up show
    assert (budget.rms()[:5] / expected[:5, None] > 0.2).any(axis=0).all()  # each of the four counts somewhere


def test_the_schedule_is_interpolated_and_has_ends():
    assert scheduled(10.0) == pytest.approx((200.0, 15.0))
    middle = np.sqrt(10.0 * 50.0)
    assert scheduled(middle) == pytest.approx((np.sqrt(200.0 * 60.0), np.sqrt(15.0 * 4.0)))
    assert scheduled(3.0, {2.0: (1.0, 5.0), 4.5: (4.0, 20.0)}) == pytest.approx((2.0, 10.0))
    with pytest.raises(ValueError, match="the schedule has payloads from 1 to 50 kg, got 60 kg"):
        scheduled(60.0)


@pytest.mark.slow
def test_scheduled_loops_are_stable_for_all_payloads_up_to_60_rpm_and_wrong_ones_are_not():
    options = {"stages": alike_across(), "frame": "rotor"}
    loop = {"measured": POSE, "driven": VOLTAGES}
    frequency, plants, schedule = np.geomspace(0.5, 4500.0, 600), {}, {}
    for mass in (1.0, 10.0, 50.0):
        force, pose = hac_lac(linearize(make_nass(payload_mass=mass, **options)), mass, sample_rate=10e3)
        for rpm in (0.0, 30.0, 60.0):
            plant = linearize(make_nass(payload_mass=mass, spindle_rpm=rpm, **options))
            plants[mass, rpm] = close_loop(plant, force.controller, measured=SENSORS, driven=VOLTAGES)
            schedule[mass, rpm] = pose.controller
    family = family_margins(plants, schedule, frequency, **loop)
    assert family.stable
    assert min(worst.modulus_margin for _, worst in family.worst.values()) > 0.5
    wrong = family_margins({"50 kg": plants[50.0, 60.0]}, schedule[1.0, 60.0], frequency, **loop)
    assert list(wrong.unstable) == ["50 kg"]


@pytest.mark.slow
def test_a_shaped_pose_loop_has_its_bandwidth_and_takes_its_options():
    """A wider loop is stiffer at 1 Hz by as much; fewer states, more delay, other axes."""
    model, force = linearize(make_nass(payload_mass=10.0)), force_loop(200.0, sample_rate=5e3)
    damped = close_loop(model, force.controller, measured=SENSORS, driven=VOLTAGES)
    wide, narrow = (shaped_pose_loop(damped, f, sample_rate=5e3) for f in (12.0, 6.0))
    gains = [np.abs(controller_response(loop.controller, np.array([1.0])).values[0, :, 0]) for loop in (wide, narrow)]
    assert gains[0] / gains[1] == pytest.approx(2.0, rel=0.05)
    assert (wide.controller.sample_rate, wide.controller.delay, len(wide.controller.A)) == (5e3, 1, 60)
    other = replace(NANO_HEXAPOD, point=np.array([0.0, 0, 0.05]))
    small = shaped_pose_loop(damped, 12.0, sample_rate=5e3, n_states=6, delay=2, platform=other)
    assert (small.controller.delay, len(small.controller.A)) == (2, 36)
    expected, first = jacobian(other)[0], small.controller.B[:6]  # the first strut's controller reads its length
    assert np.abs(first @ expected / np.linalg.norm(expected)) == pytest.approx(np.linalg.norm(first, axis=1))
