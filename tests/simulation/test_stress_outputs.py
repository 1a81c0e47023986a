"""Stress and strain as outputs of scenes: statics, steps, spins and noise in every engine; peaks, limits."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nassim import (
    Controller,
    Drive,
    FlexibleBody,
    Loop,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    StrainGauge,
    StressAt,
    TimeHistory,
    VoltageDrive,
    VoltageSensor,
    fixed,
    frequency_response,
    linearize,
    load_limit,
    peak_stress,
    placed,
    prismatic,
    reduce_scene,
    revolute,
    simulate,
    simulate_motion,
    static_motion,
    static_response,
    truncation_error,
    von_mises,
    von_mises_budget,
)
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.projection import keep_modes
from nassim.bodies.stress import COMPONENTS
from nassim.scene import stress_peaks
from nassim.scene.stress_peaks import PeakStress, sensor_stress
from nassim.systems.linear_model import LinearModel

LENGTH, SIDE, PLACE = 0.1, 0.01, 0.043
AREA, BENDING = SIDE**2, SIDE**4 / 12
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
ORIGIN = np.array([0.3, -0.2, 0.5])
AXIAL, LATERAL = TURN[:, 0], TURN[:, 2]
TORSION = 0.20817 * SIDE**3


SENSORS = (StressAt("top", "bar.top"), StressAt("inside", "bar.inside", "sxx"), StrainGauge("strain", "bar.gauge"))


def clamped_bar(body, fidelity="linear", **options):
    """The bar on a wall in a general position, pulled, bent and twisted at its free end."""
    wall = RigidBody("wall", {"face": ORIGIN}, fixed=True)
    return Scene(
        "bar",
        (wall, FlexibleBody("bar", body, ORIGIN, TURN, fidelity=fidelity)),
        (fixed("clamp", "wall.face", "bar.left"),),
        (
            PointForce("pull", "bar.right", tuple(AXIAL), "pull"),
            PointForce("bend", "bar.right", tuple(LATERAL), "bend"),
            PointTorque("twist", "bar.right", tuple(AXIAL), "twist"),
        ),
        **{"sensors": SENSORS, "damping_ratio": 0.02} | options,
    )


def history(scene, signals, time):
    return TimeHistory(time, [signals(name, time) for name in scene.inputs], scene.inputs, ["N", "N", "N m"])


PULL, BEND, TWIST = 80.0, 3.0, 0.5
STATIC = {
    "top.sxx": PULL / AREA - BEND * (LENGTH - PLACE) * SIDE / 2 / BENDING,
    "top.sxy": -TWIST / TORSION,
    "strain": (PULL / AREA - BEND * (LENGTH - PLACE) * SIDE / 2 / BENDING) / 200e9,
    "inside": PULL / AREA + BEND * (LENGTH - 0.052) * 0.0013 / BENDING,
}
LOADS = {"pull": PULL, "bend": BEND, "twist": TWIST}
LARGEST = max(abs(STATIC["top.sxx"]), abs(STATIC["top.sxy"]))


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_statics_have_the_stress_of_the_closed_form(stressed_bar, fidelity):
    found = static_response(clamped_bar(stressed_bar, fidelity), LOADS)
    for name, expected in STATIC.items():
        assert found[name] == pytest.approx(expected, rel=5e-3), name
    for name in ("syy", "szz", "syz", "sxz"):
        assert abs(found[f"top.{name}"]) < 5e-3 * LARGEST


@pytest.mark.parametrize("cutoff", [None, 3000.0])
def test_a_linear_model_has_the_same_static_gain(stressed_bar, cutoff):
    """Also of a trimmed scene, whose modes above the cut-off are left out."""
    scene = clamped_bar(stressed_bar, cutoff_frequency=cutoff)
    gain = frequency_response(linearize(scene), [0.0]).values[..., 0].real
    found = dict(zip(scene.outputs, gain @ [PULL, BEND, TWIST], strict=True))
    for name, expected in STATIC.items():
        assert found[name] == pytest.approx(expected, rel=5e-3), name


RUNS = [("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")]


@pytest.mark.parametrize(("fidelity", "method"), RUNS)
def test_a_slow_ramp_ends_at_the_static_stress(stressed_bar, fidelity, method):
    scene = clamped_bar(stressed_bar, fidelity, damping_ratio=0.3)
    time = np.arange(161) * 1e-4
    ramp = 0.5 * (1 - np.cos(np.pi * np.minimum(time / 0.012, 1)))
    record = simulate(
        scene, history(scene, lambda n, t: LOADS[n] * ramp, time), time_step=1e-4, method=method, progress=False
    )
    for name, expected in STATIC.items():
        assert record[name][-1] == pytest.approx(expected, rel=5e-3), name


def test_all_engines_agree_on_a_vibration(stressed_bar):
    time = np.arange(301) * 2e-5
    records = []
    for fidelity, method in RUNS:
        scene = clamped_bar(stressed_bar, fidelity)
        knock = history(scene, lambda n, t: LOADS[n] * np.where(t < 2e-3, np.sin(np.pi * t / 2e-3) ** 2, 0.0), time)
        records.append(simulate(scene, knock, time_step=2e-5, method=method, progress=False))
    for name in STATIC:
        largest = np.abs(records[0][name]).max()
        for other in records[1:]:
            np.testing.assert_allclose(other[name], records[0][name], atol=0.01 * largest)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_the_weight_stresses_a_hanging_bar(stressed_bar, fidelity):
    """Gravity along the bar, from the start of a run."""
    scene = clamped_bar(stressed_bar, fidelity, gravity=tuple(9.81 * AXIAL))
    time = np.arange(5) * 1e-4
    record = simulate(scene, history(scene, lambda n, t: 0 * t, time), time_step=1e-4, progress=False)
    expected = 7800 * 9.81 * (LENGTH - PLACE)
    np.testing.assert_allclose(record["top.sxx"], expected, rtol=5e-3)
    peak = peak_stress(static_motion(scene), scene.bodies[1], place="surface stress")
    assert peak.von_mises == pytest.approx(7800 * 9.81 * LENGTH, rel=0.02)
    assert peak.position[0] < 0.01 * LENGTH
    assert peak_stress(static_motion(scene, gravity=False), scene.bodies[1]).von_mises < 1e-9 * peak.von_mises


def test_a_spin_stresses_a_bar_by_its_own_mass(stressed_bar):
    """rho W^2 (L^2 - r^2) / 2, on a turntable in large motion and in a rotating frame."""
    speed = 200.0
    base = RigidBody("base", {"axle": ORIGIN}, fixed=True)
    scene = Scene(
        "rotor",
        (base, FlexibleBody("bar", stressed_bar, ORIGIN, TURN, frame="left")),
        (revolute("axle", "base.axle", "bar.left", LATERAL),),
        (Drive("motor", "axle", "rz", speed=speed),),
        (StressAt("top", "bar.top"),),
        damping_ratio=0.0,
    )
    time = np.arange(41) * 2e-4
    record = simulate(scene, TimeHistory(time, np.zeros((0, 41)), (), ()), time_step=2e-4, progress=False)
    expected = 7800 * speed**2 / 2 * (LENGTH**2 - PLACE**2)
    np.testing.assert_allclose(record["top.sxx"], expected, rtol=5e-3)
    with pytest.raises(ValueError, match=r"scene 'rotor' turns \(axle\), and its state at rest has no centrifugal"):
        static_motion(scene)
    turning = static_motion(scene, angular_velocity=speed * LATERAL, axis_point=ORIGIN)
    assert peak_stress(turning, scene.bodies[1], place="top").stress[0] == pytest.approx(expected, rel=5e-3)
    wheel = RigidBody("wheel", {"hub": np.zeros(3)}, 0.1, 1e-4 * np.eye(3), scene.point_position("bar.right"))
    wheel = replace(wheel, angular_velocity=speed * AXIAL)
    clamped = clamped_bar(stressed_bar)
    hub = revolute("hub", "bar.right", "wheel.hub", AXIAL)
    spun = replace(clamped, bodies=(*clamped.bodies, wheel), joints=(*clamped.joints, hub))
    for asked in (lambda: static_motion(spun), lambda: load_limit(spun, 1e6, body="bar", inputs={"pull": 1.0})):
        with pytest.raises(ValueError, match=r"scene 'bar' turns \(wheel\), and its state at rest has no centrifugal"):
            asked()
    motion = static_motion(clamped, angular_velocity=speed * LATERAL, axis_point=ORIGIN)
    assert peak_stress(motion, clamped.bodies[1], place="top").stress[0] == pytest.approx(expected, rel=5e-3)
    limit = load_limit(
        clamped, 4 * expected, body="bar", place="top", angular_velocity=speed * LATERAL, axis_point=ORIGIN
    )
    assert limit.factor == pytest.approx(2.0, rel=5e-3)


def test_peaks_tell_where_and_when(stressed_bar, monkeypatch):
    """A force across at the tip: the largest stress is at the root, at the top or the bottom, after the ramp."""
    scene = clamped_bar(stressed_bar, damping_ratio=0.5)
    time = np.arange(81) * 1e-4
    ramp = np.minimum(time / 0.006, 1.0)
    record, motion = simulate_motion(
        scene,
        history(scene, lambda n, t: 2.0 * ramp * (n == "bend"), time),
        time_step=1e-4,
        frames=time,
        method="exact",
        progress=False,
    )
    body = scene.bodies[1]
    peak = peak_stress(motion, body)
    root = 2.0 * LENGTH * SIDE / 2 / BENDING
    assert peak.von_mises == pytest.approx(root, rel=0.15)  # with the stress that the soft interface adds
    assert (abs(peak.position[2]), peak.place) == (pytest.approx(SIDE / 2), "surface stress")
    assert peak.position[0] < 0.15 * LENGTH
    assert peak.time > 5e-3
    of_sensor = peak_stress(record, "top")
    of_point = peak_stress(motion, body, place="top")
    assert of_sensor.von_mises == pytest.approx(of_point.von_mises, rel=1e-6)
    assert of_sensor.von_mises == pytest.approx(2.0 * (LENGTH - PLACE) * SIDE / 2 / BENDING, rel=0.01)
    assert of_sensor.principal[2] == pytest.approx(-of_sensor.von_mises, rel=0.01)  # compressed where it bends to
    stress = ", ".join(f"{1e-6 * s:.4g}" for s in peak.principal)
    assert f"{1e-6 * peak.von_mises:.4g} MPa von Mises" in str(peak)
    assert str(peak).endswith(f"t = {peak.time:.6g} s; principal {stress} MPa")
    monkeypatch.setattr(stress_peaks, "VALUES_AT_ONCE", 1)  # image by image
    again = peak_stress(motion, body)
    assert (again.von_mises, again.time) == (pytest.approx(peak.von_mises, rel=1e-12), peak.time)
    top = stressed_bar.readouts["top"]
    rough = replace(stressed_bar, readouts={"top": replace(top, deviations=0.05 * top.rows)})
    assert peak_stress(motion, replace(body, reduced=rough)).mesh_error == pytest.approx(0.05 * of_point.von_mises)


@pytest.mark.parametrize("share", [0.09, 0.11])
def test_a_peak_whose_mesh_error_is_above_a_tenth_warns_by_name_and_place(stressed_bar, share):
    """The deviation of one element is a given share of the stress."""
    top = stressed_bar.readouts["top"]
    body = replace(stressed_bar, readouts={"top": replace(top, deviations=share * top.rows)})
    scene = clamped_bar(body, sensors=())
    words = r"body 'bar': the largest stress, .* MPa at 'top' \(43, 0, 5\) mm, is uncertain by some 11 % because of the"
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        peak_stress(static_motion(scene, inputs={"bend": BEND}), scene.bodies[1])
        load_limit(scene, 2e6, body="bar", inputs={"bend": BEND})
    told = [str(one.message) for one in found]
    assert [bool(re.match(words, text)) for text in told] == [True, True] * (share > 0.1)


def test_a_limit_gives_the_largest_force_beside_the_weight(stressed_bar):
    scene = clamped_bar(stressed_bar, gravity=tuple(-9.81e3 * AXIAL))
    weight = -9.81e3 * 7800 * (LENGTH - PLACE)
    bending = (LENGTH - PLACE) * SIDE / 2 / BENDING
    found = load_limit(scene, 20e6, body="bar", inputs={"bend": 1.0}, place="top")
    assert found.factor == pytest.approx((20e6 - abs(weight)) / bending, rel=5e-3)
    none = load_limit(scene, 20e6, body="bar", inputs={"bend": 0.0}, place="top")
    assert (none.factor, str(none)) == (np.inf, "no load reaches 20 MPa von Mises")
    pulled = load_limit(scene, 20e6, body="bar", inputs={"pull": 2.0}, place="top")
    assert pulled.factor == pytest.approx((20e6 - weight) * AREA / 2.0, rel=5e-3)
    both = load_limit(scene, 20e6, body="bar", inputs={"bend": 1.0, "pull": 2.0}, place="top")
    assert both.factor == pytest.approx((20e6 - abs(weight)) / (bending - 2.0 / AREA), rel=5e-3)
    surface = load_limit(scene, 20e6, body="bar", inputs={"bend": 1.0}, place="surface stress")
    least = load_limit(scene, 20e6, body="bar", inputs={"bend": 1.0})
    assert (least.factor, least.place) == (surface.factor, "surface stress")
    assert least.factor < 0.7 * found.factor
    with pytest.raises(ValueError, match=r"under the loads at the limit, body 'bar' .* no small motion"):
        load_limit(scene, 2e9, body="bar", inputs={"bend": 1.0})
    with pytest.raises(ValueError, match="the constant loads alone"):
        load_limit(scene, 1e6, body="bar", inputs={"bend": 1.0})
    with pytest.raises(ValueError, match="either inputs or an angular_velocity"):
        load_limit(scene, 1e6, body="bar")


def test_a_limit_is_that_of_the_loads_there_beside_a_preload(stressed_bar):
    """The preload stays as it is, as the weight does."""
    plain = clamped_bar(stressed_bar, gravity=tuple(500.0 * LATERAL))
    wall = replace(plain.bodies[0], points={"face": ORIGIN, "far": ORIGIN + LENGTH * AXIAL + 0.02 * LATERAL})
    spring = SpringDamper("spring", "wall.far", "bar.right", tuple(LATERAL), 5e4, preload=-7.0)
    scene = replace(plain, bodies=(wall, plain.bodies[1]), springs=(spring,))
    found = load_limit(scene, 8e6, body="bar", inputs={"bend": 0.1, "twist": 0.02}, place="top")
    there = static_response(scene, found.loads)
    assert von_mises(np.array([there[f"top.{name}"] for name in COMPONENTS])) == pytest.approx(8e6, rel=1e-3)
    assert found.factor > 1.0


@pytest.mark.filterwarnings("ignore:body 'bar' turns at:UserWarning")
@pytest.mark.parametrize("speed", [1e-5, 900.0])
def test_a_limit_of_the_speed_is_that_of_the_spin_there(stressed_bar, speed):
    """Beside the axis the bar bends, and a fast spin softens it; whatever speed is given."""
    scene = clamped_bar(stressed_bar)
    across = TURN[:, 1]
    spin = {"axis_point": ORIGIN + 0.0015 * LATERAL}
    found = load_limit(scene, 60e6, body="bar", angular_velocity=speed * across, place="top", **spin)
    rate = found.loads["angular velocity"]
    for speeds, share in ((rate, 1.0), (1e-3 * rate, 0.97)):
        motion = static_motion(scene, angular_velocity=speeds * across, **spin)
        stress = peak_stress(motion, scene.bodies[1], place="top").von_mises * (rate / speeds) ** 2
        assert stress / 60e6 == pytest.approx(share, abs=1e-3 if share == 1.0 else 0.02)


def test_a_limit_gives_the_largest_stroke_of_a_guided_bar(stressed_bar):
    """By Timoshenko's beam with both ends held against rotation, and its text has the units."""
    plain = clamped_bar(stressed_bar)
    wall = replace(plain.bodies[0], points={"face": ORIGIN, "end": ORIGIN + LENGTH * AXIAL})
    guide = prismatic("guide", "wall.end", "bar.right", LATERAL)
    motor = Drive("motor", "guide", input="stroke")
    scene = Scene("guided", (wall, plain.bodies[1]), (*plain.joints, guide), (motor,))
    shear = 12 * BENDING * 2.6 / (0.85 * AREA * LENGTH**2)  # G. R. Cowper's factor of a square, J. Appl. Mech. 1966
    per_metre = 12 * 200e9 * BENDING / LENGTH**3 / (1 + shear) * (LENGTH / 2 - PLACE) * SIDE / 2 / BENDING
    found = load_limit(scene, 1e6, body="bar", inputs={"stroke": 1e-6}, place="top")
    assert found.factor == pytest.approx(1e6 / per_metre / 1e-6, rel=0.01)
    assert found.loads == {"stroke": pytest.approx(1e6 / per_metre, rel=0.01)}
    assert re.match(r"stroke [\d.e-]+ m for 1 MPa von Mises at 'top' \(43, 0, 5\) mm \(mesh: ", str(found))
    assert str(found).endswith(f"(mesh: +-{100 * found.mesh_error:.2g} %)")
    motion = static_motion(scene, inputs=found.loads)
    assert peak_stress(motion, scene.bodies[1], place="top").von_mises == pytest.approx(1e6)
    with pytest.raises(ValueError, match="moves a drive; only forces"):
        static_motion(scene, inputs={"stroke": 1e-6}, angular_velocity=AXIAL)


def test_the_error_of_the_modes_left_out_is_in_pascal(stressed_bar):
    """No mode against four: nothing in statics, and the difference of the responses elsewhere."""
    frequency = np.array([0.0, 300.0, 1500.0])
    few, all_modes = (clamped_bar(keep_modes(stressed_bar, n), damping_ratio=0.01) for n in (0, 4))
    estimate = truncation_error(few, frequency, relative=False)
    k, bend = few.outputs.index("top.sxx"), few.inputs.index("bend")
    responses = [frequency_response(linearize(scene), frequency).values for scene in (few, all_modes)]
    true = np.abs(responses[0] - responses[1])[k, bend]
    static = (LENGTH - PLACE) * SIDE / 2 / BENDING
    assert estimate[k, bend, 0] < 1e-6 * static
    np.testing.assert_allclose(estimate[k, bend, 1:], true[1:], rtol=0.3)
    assert true[1] > 1e-4 * static
    relative = truncation_error(few, frequency)[k, bend, 1]
    assert estimate[k, bend, 1] == pytest.approx(relative * np.abs(responses[1][k, bend, 1]), rel=0.05)


def test_a_loop_may_measure_strain(stressed_bar):
    """A gain on the strain at rest: the loop commands it from the second sample on."""
    scene = clamped_bar(stressed_bar, gravity=tuple(9.81e3 * AXIAL))
    none = np.zeros((0, 0))
    gain = Controller(none, np.zeros((0, 1)), np.zeros((1, 0)), [[1e3]], 1e4)
    looped = replace(scene, loops=(Loop("strain loop", gain, "strain", "twist"),))
    time = np.arange(6) * 1e-4
    idle = TimeHistory(time, np.zeros((2, 6)), ("pull", "bend"), ("N", "N"))
    record = simulate(looped, idle, time_step=1e-4, method="exact", progress=False)
    (command,) = looped.commands
    np.testing.assert_allclose(record[command][2], 1e3 * record["strain"][0], rtol=1e-3)
    assert record["strain"][0] == pytest.approx(9.81e3 * 7800 * (LENGTH - PLACE) / 200e9, rel=5e-3)


def test_copies_and_reduced_scenes_carry_the_stress(stressed_bar):
    """A placed copy keeps the components of its body; the reduced scene has them along its own axes."""
    scene = clamped_bar(stressed_bar)
    spun = Rotation.from_rotvec([0.0, 0.9, -0.3]).as_matrix()
    copy = placed(scene, "copy", position=[0.1, 0, 0], rotation=spun)
    found = static_response(copy, {f"copy/{name}": value for name, value in LOADS.items()})
    assert found["copy/top.sxx"] == pytest.approx(STATIC["top.sxx"], rel=5e-3)
    free = replace(scene, bodies=scene.bodies[1:], joints=(), actuators=(), sensors=())
    whole = reduce_scene(free, "whole", points={"left": "bar.left", "right": "bar.right"})
    n = len(whole.mass_matrix)
    q = np.zeros(n)
    load = np.zeros(n)
    load[6:9] = PULL * AXIAL
    q[6:] = np.linalg.solve(whole.stiffness_matrix[6:, 6:], load[6:])
    place = whole.readouts["top"]
    np.testing.assert_allclose(place.positions[0], ORIGIN + TURN @ [PLACE, 0, SIDE / 2], atol=1e-12)
    xx, yy, zz, xy, yz, xz = place.stress(q)[0]
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(tensor, PULL / AREA * np.outer(AXIAL, AXIAL), atol=5e-3 * PULL / AREA)
    other = FlexibleBody("other", stressed_bar, (LENGTH, 0, 0))
    weld = fixed("weld", "bar.right", "other.left")
    pair = Scene("pair", (FlexibleBody("bar", stressed_bar), other), (weld,))
    both = reduce_scene(pair, "both", points={"left": "bar.left", "right": "other.right"})
    for name, x in (("bar/top", PLACE), ("other/top", LENGTH + PLACE)):
        np.testing.assert_allclose(both.readouts[name].positions[0], [x, 0, SIDE / 2], atol=1e-12)


@pytest.mark.slow
def test_rms_under_noise_is_that_of_a_simulation(stressed_bar):
    """60 s of forces and torques that are white up to 2 kHz, above the first two modes."""
    scene, step, highest = clamped_bar(stressed_bar), 5e-5, 2000.0
    time = np.arange(round(60.0 / step)) * step
    densities = {"pull": 0.0, "bend": 1e-3, "twist": 3e-5}
    rng, signals = np.random.default_rng(8), []
    for density in densities.values():
        spectrum = np.fft.rfft(np.sqrt(density / (2 * step)) * rng.standard_normal(len(time)))
        spectrum[np.fft.rfftfreq(len(time), step) > highest] = 0.0
        signals.append(np.fft.irfft(spectrum, len(time)))
    forces = TimeHistory(time, signals, scene.inputs, ("N", "N", "N m"))
    record = simulate(scene, forces, time_step=step, method="exact", progress=False)
    simulated = von_mises(sensor_stress(record, "top"))
    budget = von_mises_budget(linearize(scene), densities, np.linspace(0.1, highest, 2000), sensors="top")
    assert np.sqrt(np.mean(simulated**2)) == pytest.approx(float(budget.total.rms()[0, 0]), rel=0.02)


def test_noise_adds_bending_and_torsion_as_von_mises_does(stressed_bar):
    """sxx and sxy of two independent inputs: vm^2 = sxx^2 + 3 sxy^2; and of one input, at two places."""
    model = linearize(clamped_bar(stressed_bar, sensors=(SENSORS[0], StressAt("middle", "bar.inside"))))
    spectra, frequency = {"bend": 1e-3, "twist": 3e-5}, np.linspace(1.0, 50.0, 50)
    budget = von_mises_budget(model, spectra, frequency, sensors=["top"])
    low = budget.total.psd[0, 0, 0]
    bend, twist = (LENGTH - PLACE) * SIDE / 2 / BENDING, 1.0 / TORSION
    assert low == pytest.approx(1e-3 * bend**2 + 3 * 3e-5 * twist**2, rel=0.01)
    assert (budget.outputs, budget.units) == (("top",), ("Pa",))
    places = von_mises_budget(model, {"bend": 1e-3}, frequency, sensors=["middle", "top"])
    middle, shear = (LENGTH - 0.052) * 0.0013 / BENDING, 1.5 / AREA * (1 - (2 * 0.0013 / SIDE) ** 2)
    expected = 1e-3 * np.array([middle**2 + 3 * shear**2, bend**2])
    np.testing.assert_allclose(places.total.psd[:, 0, 0], expected, rtol=0.02)
    for sensors, reason in (("strain", r"unknown output 'strain.sxx'"), (("top", "top"), "sensor names .*: top")):
        with pytest.raises(ValueError, match=reason):
            von_mises_budget(model, spectra, frequency, sensors=sensors)


def test_noise_that_stresses_at_once_adds_to_what_it_moves():
    """A model with feedthrough, such as that of motions above a cut-off: by the formula of each frequency's stress."""
    numbers = np.random.default_rng(3).normal(size=(16, 3))
    names = tuple(f"{sensor}.{c}" for sensor in ("left", "right") for c in COMPONENTS)
    model = LinearModel(
        -np.diag([30.0, 200.0]), 100 * numbers[:2], numbers[2:14, :2], numbers[-12:], ("a", "b", "c"), names
    )
    budget = von_mises_budget(model, dict.fromkeys("abc", 0.25), [1.0, 40.0], sensors=("right", "left"))
    responses = frequency_response(model, budget.frequency).values
    x, y, z, *shears = responses.reshape(2, 6, 3, -1).swapaxes(0, 1)[:, ::-1]
    normal = sum(np.abs(d) ** 2 for d in (x - y, y - z, z - x)) / 2
    np.testing.assert_allclose(budget.psd, 0.25 * (normal + 3 * sum(np.abs(s) ** 2 for s in shears)), rtol=1e-9)


REFUSED = {
    "unknown point": (
        (StressAt("s", "bar.bottom"),),
        r"stress point of body 'bar' .*craig_bampton.*'bottom'; known: top",
    ),
    "a surface": ((StressAt("s", "bar.surface stress"),), "known: top, inside"),
    "unknown gauge": ((StrainGauge("s", "bar.top"),), "known: gauge"),
    "rigid": ((StressAt("s", "wall.face"),), "body 'wall' is rigid, so it has no stress"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_sensors_of_places_that_a_body_does_not_keep_are_refused(stressed_bar, name):
    sensors, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        replace(clamped_bar(stressed_bar), sensors=sensors)


def test_peaks_of_what_keeps_no_stress_are_refused(stressed_bar):
    scene = clamped_bar(stressed_bar)
    motion = static_motion(scene, inputs={"pull": 1.0})
    bare = FlexibleBody("bar", replace(stressed_bar, readouts={}))
    with pytest.raises(ValueError, match=r"keeps no stress: reduce the body by craig_bampton"):
        peak_stress(motion, bare)
    with pytest.raises(ValueError, match="unknown stress of body 'bar' 'side'"):
        peak_stress(motion, scene.bodies[1], place="side")
    record = TimeHistory([0.0, 1.0], np.zeros((1, 2)), ("pull",))
    for source, body, message in (
        (record, scene.bodies[1], "a record has the outputs of sensors only: give the name"),
        (motion, "bar", "for a motion, give the flexible body of the scene itself"),
    ):
        with pytest.raises(ValueError, match=message):
            peak_stress(source, body)
    with pytest.raises(ValueError, match="body 'wall' is rigid, so it has no stress"):
        load_limit(scene, 1e6, body="wall", inputs={"pull": 1.0})
    rigid = clamped_bar(stressed_bar, "rigid")
    with pytest.raises(ValueError, match=r"body 'bar' has the fidelity 'rigid', so it does not deform"):
        load_limit(rigid, 1e6, body="bar", inputs={"pull": 1.0})
    with pytest.raises(ValueError, match="unknown component of stress sensor"):
        StressAt("s", "bar.top", "mises")
    assert COMPONENTS[0] == "sxx"


def test_optional_arguments_of_sensors_and_peaks(stressed_bar):
    """A gauge's gain, one component, a place, voltages of numbers and of histories; what a record does not know."""
    scene = clamped_bar(stressed_bar)
    assert StrainGauge("s", "bar.gauge") == StrainGauge("s", "bar.gauge", 1.0)
    assert StressAt("s", "bar.top") == StressAt("s", "bar.top", "")
    for sensor, text in (
        (StrainGauge("s", "bar.gauge", 3.0), "strain gauge s [1]: bar.gauge"),
        (StressAt("s", "bar.top"), "stress sensor s [Pa]: at bar.top, along the axes of the body"),
        (StressAt("s", "bar.top", "syz"), "stress sensor s [Pa]: syz at bar.top, along the axes of the body"),
    ):
        assert sensor.describe() == text
    gauges = (StrainGauge("plain", "bar.gauge"), StrainGauge("amplified", "bar.gauge", -5.0))
    found = static_response(replace(scene, sensors=gauges), {"pull": PULL})
    assert found["amplified"] == pytest.approx(-5.0 * found["plain"])
    assert scene.outputs == (*(f"top.{name}" for name in COMPONENTS), "inside", "strain")
    place = replace(stressed_bar.readouts["top"], voltages={"stack": [[1e5, 0, 0, 0, 0, 0]]})
    body = replace(scene.bodies[1], reduced=replace(stressed_bar, readouts={"top": place}))
    motion = static_motion(scene, inputs={"pull": PULL})
    plain, excited = (peak_stress(motion, body, voltages=volts) for volts in (None, {"stack": np.array([-3.0])}))
    assert plain.place == "top"
    assert excited.stress[0] - plain.stress[0] == pytest.approx(-3e5)
    assert excited.von_mises < plain.von_mises
    driven = replace(scene, bodies=(scene.bodies[0], body), sensors=())
    volts = load_limit(driven, 1e6, body="bar", inputs={"pull": PULL}, voltages={"stack": -3.0})
    assert volts.factor == pytest.approx(1e6 / excited.von_mises, rel=1e-6)
    port = PortCoupling("stack", np.zeros(len(stressed_bar.mass_matrix)), 1e-6)
    wired = replace(
        driven,
        bodies=(scene.bodies[0], replace(body, reduced=replace(stressed_bar, readouts={"top": place, "stack": port}))),
        actuators=(*scene.actuators, VoltageDrive("amplifier", "bar.stack", "volts")),
    )
    for amplified, given in ((-3.0, None), (50.0, {"stack": -3.0})):  # what is given takes the place of the amplifier's
        found = load_limit(wired, 1e6, body="bar", inputs={"pull": PULL, "volts": amplified}, voltages=given)
        assert (found.factor, found.units) == (pytest.approx(volts.factor, rel=1e-9), ("N", "V"))
    record = PeakStress(1.0, np.zeros(3), np.zeros(6), 0.0, "top")
    assert record.position is None
    assert np.isnan(record.mesh_error)


def test_stress_in_a_stack_knows_its_open_circuit_voltage(stressed_bar):
    """V = -charge / capacitance adds its stress, of each of two ports."""
    rng, volts = np.random.default_rng(9), np.arange(1.0, 7.0)
    ports = {
        name: PortCoupling(name, 1e-3 * rng.standard_normal(len(stressed_bar.mass_matrix)), 1e-6)
        for name in ("stack", "other")
    }
    place = replace(stressed_bar.readouts["top"], voltages={"stack": volts[None], "other": -volts[None, ::-1]})
    body = replace(stressed_bar, readouts={**stressed_bar.readouts, **ports, "top": place})
    scene = clamped_bar(body, sensors=())
    opened = (VoltageSensor("voltage", "bar.stack", capacitance=3e-6), VoltageSensor("second", "bar.other"))
    short, open_port = (replace(scene, sensors=(*more, StressAt("top", "bar.top"))) for more in ((), opened))
    found = static_response(open_port, {"bend": BEND})
    motion = static_motion(open_port, inputs={"bend": BEND})
    read = {name: np.array([found[sensor]]) for name, sensor in (("stack", "voltage"), ("other", "second"))}
    stress = place.stress(motion.coordinates["bar"], read)[0, 0]
    np.testing.assert_allclose([found[f"top.{name}"] for name in COMPONENTS], stress, rtol=1e-6, atol=1e-6)
    assert abs(found["voltage"]) > 1e-6
    assert static_response(short, {"pull": PULL})["top.sxx"] == pytest.approx(PULL / AREA, rel=5e-3)
