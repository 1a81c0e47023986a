"""Bodies that loads bend by their own thickness, and columns that loads deflect, against beams in closed form."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import make_bar, meshed
from scipy.spatial.transform import Rotation

from nassim import (
    Drive,
    ElectricalPort,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Joint,
    Material,
    PiezoStack,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StressAt,
    StressPoint,
    TimeHistory,
    VoltageDrive,
    build_fe_model,
    craig_bampton,
    fixed,
    linearize,
    load_limit,
    peak_stress,
    prismatic,
    revolute,
    simulate,
    static_motion,
    static_response,
)
from nassim.fem.meshing import generate_mesh
from nassim.scene import Displacement, Output, Sensor
from nassim.scene.measures import BodyCoordinates, Combination
from nassim.scene.part import ForceElement
from nassim.scene.stress_sensors import warn_of_pressed_stacks
from nassim.scene.terms import NonlinearSpring
from nassim.simulation import buckling_factors, exudyn_eigenfrequencies, loaded_equilibrium
from nassim.simulation.linear.linearization import linear_model, loaded_assembly, steady_outputs
from nassim.simulation.loaded import stress_limits

STEEL = Material("steel", 200e9, 0.3, 7800.0)
LENGTH, SIDE = 0.5, 0.01
BENDING = STEEL.young_modulus * SIDE**4 / 12
EULER = np.pi**2 * BENDING / (4 * LENGTH**2)
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()


@pytest.fixture(scope="module")
def bar():
    solid = make_bar(length=LENGTH, side=SIDE, material=STEEL)
    mesh = generate_mesh(solid, element_size=2 * SIDE, layer_thickness=LENGTH / 4, extrude="x")
    middle = StressPoint("middle", [LENGTH / 2, 0, SIDE / 2])
    options = {"n_modes": 4, "geometric_stiffness": True, "stress": [middle], "progress": False}
    return craig_bampton(meshed(mesh, solid, 4), **options)


def cantilever(bar, *, fidelity="ffrf", frame="left"):
    """A bar clamped at its left, with forces along and across it at its right."""
    body = FlexibleBody("bar", bar, rotation=TURN, fidelity=fidelity, frame=frame)
    ends = {"axial": -TURN[:, 0], "lateral": TURN[:, 2]}
    pushes = tuple(PointForce(name, "bar.right", axis, name) for name, axis in ends.items())
    read = Encoder("tip", "ground.c", "bar.right", TURN[:, 2]), StressAt("stress", "bar.middle", "sxx")
    foot = Joint("foot", "ground.c", "bar.left", axes=TURN)
    ground = RigidBody("ground", {"c": np.zeros(3)}, fixed=True)
    return Scene("cantilever", (ground, body), (foot,), pushes, read, damping_ratio=0.01)


def test_a_bar_that_is_bent_by_half_its_thickness_is_as_stiff_as_before(bar):
    """Without the square of the change of shape, its first frequency would drop by a tenth."""
    scene = cantilever(bar, frame="right")
    force = 0.5 * SIDE * 3 * BENDING / LENGTH**3
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="under its loads|body 'bar' is deformed")
        model = linearize(scene, constant_inputs={"lateral": force})
        again = exudyn_eigenfrequencies(replace(scene, gravity=2 * force / bar.mass * TURN[:, 2]), loaded=True)
    before = linearize(scene)
    found, expected = (np.sort(np.abs(one.poles().imag))[::2] for one in (model, before))
    np.testing.assert_allclose(found[:4], expected[:4], rtol=5e-4)
    np.testing.assert_allclose(again[:4] * 2 * np.pi, expected[:4], rtol=1e-3)
    static = [one.C @ np.linalg.solve(-one.A, one.B[:, [1]]) for one in (before, model)]
    np.testing.assert_allclose(static[1], static[0], rtol=1e-3)


@pytest.mark.parametrize(("fidelity", "thicknesses", "radius"), [("linear", 1.25, 0.8), ("ffrf", 2.5, 1.0)])
def test_a_bar_bent_by_more_than_its_thickness_rests_and_answers_a_small_push(bar, fidelity, thicknesses, radius):
    """Against a beam, and exact steps without the load: 100 kN within the bar hold its shortening against rounding."""
    force, small = thicknesses * SIDE * 3 * BENDING / LENGTH**3, 1e-3
    time = np.arange(101) * 1e-4
    push = TimeHistory(time, small * np.outer([0, 1], np.sin(np.pi * time / time[-1]) ** 2), ("axial", "lateral"))
    options = {"time_step": 1e-4, "progress": False}
    scene = cantilever(bar, fidelity=fidelity)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="under its loads|body 'bar'|in motion")
        found = simulate(scene, push, constant_inputs={"lateral": force}, spectral_radius=radius, **options)["tip"]
    assert found[0] == pytest.approx(thicknesses * SIDE, rel=5e-3)  # shear, and large angles
    answer = simulate(cantilever(bar, fidelity="linear"), push, method="exact", **options)["tip"]
    np.testing.assert_allclose(found - found[0], answer, atol=0.01 * answer.max())


@dataclass(frozen=True)
class Stop(ForceElement):
    """A spring of force c d^3 along x."""

    def terms(self, scene):
        measure = Displacement.between("ground.r", "bar.right", np.array([1.0, 0, 0]))
        return (NonlinearSpring(measure, force=lambda d, _: 1e3 * d**3, tangent=lambda d, _: (3e3 * d**2, 0.0)),)


@pytest.mark.parametrize(
    ("springs", "radius"), [((), 0.8), ((Stop("stop"),), 1.0)], ids=["linear", "with a nonlinear spring"]
)
def test_a_thick_bar_rests_under_a_press(springs, radius):
    """Of 50 mm x 50 mm and 100 mm: 1 MN shortens it by F L / (E A)."""
    body = craig_bampton(build_fe_model(make_bar(0.1, 0.05), element_size=0.025, progress=False), progress=False)
    ground = RigidBody("ground", {"l": np.zeros(3), "r": (0.1, 0, 0)}, fixed=True)
    scene = Scene(
        "press",
        (ground, FlexibleBody("bar", body, fidelity="linear")),
        (fixed("foot", "ground.l", "bar.left"),),
        (PointForce("press", "bar.right", (-1, 0, 0), "force"),),
        (Encoder("end", "ground.r", "bar.right", (-1, 0, 0)),),
        springs,
        damping_ratio=0.01,
    )
    options = {"time_step": 1e-4, "duration": 5e-3, "spectral_radius": radius, "progress": False}
    end = simulate(scene, None, constant_inputs={"force": 1e6}, **options)["end"]
    np.testing.assert_allclose(end, 1e6 * 0.1 / (200e9 * 0.05**2), rtol=1e-6)


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_a_column_deflects_many_times_as_far_under_its_load(bar, share):
    """H (tan k l - k l) / (P k) under P along it and H across it, and the moment H l + P w at its foot.

    S. P. Timoshenko, J. M. Gere, Theory of Elastic Stability, ch. 1.
    """
    along, across = share * EULER, 5.0 * (1 - share)
    k = np.sqrt(along / BENDING)
    deflection = across * (np.tan(k * LENGTH) - k * LENGTH) / (along * k)
    bent = across * np.sin(k * LENGTH / 2) / (k * np.cos(k * LENGTH))  # moment in the middle
    stress = -bent * SIDE / 2 * 12 / SIDE**4 - along / SIDE**2
    inputs = {"axial": along, "lateral": across}
    for fidelity in ("linear", "ffrf"):
        scene = cantilever(bar, fidelity=fidelity)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="the preload in body|under its loads")
            found = loaded_equilibrium(scene, inputs=inputs)
            rest = static_response(scene, inputs)
            peak = peak_stress(static_motion(scene, inputs=inputs), scene.bodies[1])
            still = TimeHistory(np.arange(3) * 1e-3, np.zeros((2, 3)), scene.inputs, ("N", "N"))
            run = simulate(scene, still, time_step=1e-3, constant_inputs=inputs, progress=False)
        assert found.motions["bar.right"][:3] @ TURN[:, 2] == pytest.approx(deflection, rel=5e-3)
        moment = -(across * LENGTH + along * deflection)
        assert found.joint_forces["foot"]["ry"] == pytest.approx(moment, rel=5e-3)
        np.testing.assert_allclose([rest["tip"], *run["tip"]], deflection, rtol=5e-3)
        np.testing.assert_allclose([rest["stress"], *run["stress"], -peak.von_mises], stress, rtol=5e-3)


@dataclass(frozen=True)
class Weighted(Sensor):
    """A combination of stresses at a point, and of a constant."""

    def terms(self, scene):
        of_stress = [term.measure for term in StressAt("s", "bar.middle", "sxx").terms(scene)]
        n = len(scene.body("bar").mass_matrix)
        return (
            Output(
                self.name, "Pa", Combination(((0.5, *of_stress), (3.0, BodyCoordinates("bar", n * [0], constant=2e5))))
            ),
        )


@pytest.mark.parametrize(("fidelity", "method"), [("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "")])
def test_a_combination_of_stresses_is_that_of_their_readings(bar, fidelity, method):
    """In a bent bar, whose shortening has no stress."""
    scene = cantilever(bar, fidelity=fidelity)
    scene = replace(scene, sensors=(*scene.sensors, Weighted("both")))
    options = {"time_step": 1e-4, "duration": 5e-4, "method": method or "generalized_alpha", "progress": False}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="under its loads")
        run = simulate(scene, None, constant_inputs={"lateral": 20.0}, **options)
        rest = static_response(scene, {"lateral": 20.0})
    np.testing.assert_allclose(run["both"], 0.5 * run["stress"] + 6e5, rtol=1e-9)
    assert rest["both"] == pytest.approx(0.5 * rest["stress"] + 6e5, rel=1e-9)
    assert abs(run["stress"][0]) == pytest.approx(20.0 * LENGTH / 2 * 6 / SIDE**3, rel=5e-3)


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_a_column_that_a_drive_presses(bar, share):
    """Clamped at one end, guided across at the other, which a drive moves along: the load is P = E A stroke / L.

    A force H across moves the end by H / (P k) (2 tan(k l / 2) - k l), and Euler's load is pi^2 E I / L^2.
    """
    places, body = {"c": np.zeros(3), "r": TURN @ [LENGTH, 0, 0]}, FlexibleBody("bar", bar, rotation=TURN)
    carrier = RigidBody("carrier", {"c": np.zeros(3)}, 0.01, 1e-6 * np.eye(3), places["r"])
    joints = (
        prismatic("slide", "ground.r", "carrier.c", TURN[:, 0]),
        Joint("end", "carrier.c", "bar.right", free=("z",), axes=TURN),
        Joint("foot", "ground.c", "bar.left", axes=TURN),
    )
    pushes = Drive("drive", "slide", input="stroke"), PointForce("across", "bar.right", TURN[:, 2], "force")
    read = (Encoder("tip", "ground.r", "bar.right", TURN[:, 2]),)
    scene = Scene("column", (RigidBody("ground", places, fixed=True), carrier, body), joints, pushes, read)
    press, force = share * 4 * EULER, 1.0
    k = np.sqrt(press / BENDING)
    expected = force / (press * k) * (2 * np.tan(k * LENGTH / 2) - k * LENGTH)
    stroke = -press * LENGTH / (STEEL.young_modulus * SIDE**2)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="the preload in body")
        found = static_response(scene, {"stroke": stroke, "force": force})["tip"]
        # A soft spring pushes across in place of the force: by a second stroke, or as one of two preloads.
        pusher, soft = replace(carrier, name="pusher"), SpringDamper("soft", "pusher.c", "bar.right", TURN[:, 2], 50.0)
        side = prismatic("side", "ground.r", "pusher.c", TURN[:, 2])
        drives = pushes[0], Drive("aside", "side", input="way")
        moved = Scene("moved", (*scene.bodies, pusher), (*joints, side), drives, read, (soft,))
        pressing = SpringDamper("press", "ground.r", "carrier.c", TURN[:, 0], 1.0, preload=press)
        held = replace(scene, actuators=(), springs=(pressing, replace(soft, a="ground.r", preload=-force)))
        tips = static_response(moved, {"stroke": stroke, "way": force / 50.0})["tip"], static_response(held)["tip"]
    assert found == pytest.approx(expected, rel=0.015)
    assert tips == pytest.approx([found / (1 + 50.0 * found / force)] * 2, rel=2e-3)
    motion = static_motion(scene, inputs={"stroke": stroke, "force": force})
    assert motion.coordinates["bar"][0, 8] == pytest.approx(found, rel=1e-3)
    assert buckling_factors(scene, inputs={"stroke": stroke})[0][0] == pytest.approx(1 / share, rel=5e-3)


def test_a_limit_of_stress_near_the_buckling_load(bar):
    """A force along a slender column, and a small one across it, which deflects the more the larger both are."""
    scene, inputs = cantilever(bar), {"axial": 0.5 * EULER, "lateral": 0.5}

    def peak(factor):
        loads = {name: factor * value for name, value in inputs.items()}
        return peak_stress(static_motion(scene, inputs=loads), scene.bodies[1]).von_mises

    found = load_limit(scene, peak(1.6), body="bar", inputs=inputs)
    assert found.factor == pytest.approx(1.6, rel=1e-3)
    larger = {name: 1.8 * value for name, value in inputs.items()}
    assert load_limit(scene, peak(1.6), body="bar", inputs=larger).factor == pytest.approx(1.6 / 1.8, rel=1e-3)
    assert peak(1.6) > 1.1 * 1.6 * peak(1.0)
    with pytest.warns(UserWarning, match="the loads at the limit exceed a buckling load: .* is unstable"):
        load_limit(scene, 4 * peak(1.9), body="bar", inputs=inputs)


@pytest.mark.parametrize("root", [0.03, 20.0])
def test_a_limit_far_from_the_loads_is_found_by_doubling(root):
    """A stress s (1 + 0.7 s) under s times the loads; none that stays below the limit has a factor."""
    limit = root * (1 + 0.7 * root)
    found = stress_limits._settled(lambda s: (limit / (1 + 0.7 * s), True), limit)
    assert found == pytest.approx(root, rel=1e-4)
    assert stress_limits._settled(lambda s: (s + root, s < 5.5), limit) > 5.5  # unstable from there on
    with pytest.raises(ValueError, match=r"far from proportional to the loads, and no factor .* from 1 to 1\.1e\+09"):
        stress_limits._settled(lambda s: (s + root, True), limit)


def test_columns_buckle_beside_a_force_across_them(bar):
    """At Euler's load: the change of shape by the force across is no buckling."""
    factors, _ = buckling_factors(cantilever(bar), inputs={"axial": 0.3 * EULER, "lateral": 5.0})
    assert factors[0] == pytest.approx(1 / 0.3, rel=2e-3)
    factors, _ = buckling_factors(cantilever(bar), inputs={"lateral": 5.0})
    assert np.all(factors > 100)  # of the bar's torsion
    factors, shapes = buckling_factors(cantilever(bar), inputs={"axial": -0.3 * EULER})
    assert factors.shape == (0,)
    assert shapes["bar"].shape[1] == 0


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_bar_on_a_drive_of_constant_speed_bears_its_centrifugal_forces(bar, fidelity):
    """rho W^2 (L^2 - x^2) / 2 at its middle; as a "linear" body its turning has none in generalized-alpha."""
    speed = 300.0
    body = FlexibleBody("bar", bar, rotation=TURN, fidelity=fidelity)
    scene = Scene(
        "arm",
        (RigidBody("ground", {"c": np.zeros(3)}, fixed=True), body),
        (revolute("axle", "ground.c", "bar.left", TURN[:, 1]),),
        (Drive("motor", "axle", "rz", speed=speed),),
        (StressAt("stress", "bar.middle", "sxx"),),
    )
    expected = STEEL.density * speed**2 * (LENGTH**2 - LENGTH**2 / 4) / 2
    options = {"duration": 2e-5, "time_step": 1e-5, "progress": False}
    assert static_response(scene)["stress"] == pytest.approx(expected, rel=1e-3)
    assert simulate(scene, None, method="exact", **options)["stress"] == pytest.approx(expected, rel=1e-3)
    if fidelity == "linear":
        with pytest.warns(UserWarning, match=r"turns at 300 rad/s without its centrifugal forces, up to 4.5e\+04 m/s2"):
            simulate(scene, None, **options)


PULLED = np.array([0.48, -0.6, 0.64])
"""Direction of gravity and of a spin."""


def between_plates(bar, place=(0, 0, 0), turn=TURN):
    """A bar between two heavy plates on springs along lines, of the same lengths wherever the bar is drawn."""
    rng, place = np.random.default_rng(5), np.asarray(place, dtype=float)
    feet, springs, plates, joints = {}, [], [], []
    for name, end, mass in (("left", 0.0, 50.0), ("right", LENGTH, 30.0)):
        points, centre = {"e": np.zeros(3)}, np.array([end, 0, 0])
        for k in range(6):
            arm, apart, key = 0.08 * rng.normal(size=3), 0.25 * rng.normal(size=3), f"{name}{k}"
            points[key], feet[key] = arm, TURN @ (centre + arm + apart)
            stretched = np.linalg.norm(feet[key] - place - turn @ (centre + arm)) - np.linalg.norm(apart)
            spring = SpringDamper(key, f"ground.{key}", f"{name}.{key}", "line", 2e5, preload=2e5 * stretched)
            springs.append(spring)
        inertia = mass * np.diag([1e-3, 1.5e-3, 2e-3])
        plates.append(RigidBody(name, points, mass, inertia, place + turn @ centre, rotation=turn))
        joints.append(fixed(f"to_{name}", f"bar.{name}", f"{name}.e"))
    read = StressAt("stress", "bar.middle", "sxx"), *(ForceSensor(f"n{k}", f"left{k}") for k in range(6))
    bodies = RigidBody("ground", feet, fixed=True), FlexibleBody("bar", bar, place, turn, frame="left"), *plates
    return Scene("plates", bodies, joints, (), read, springs, gravity=9.81 * PULLED, damping_ratio=0.0)


@pytest.mark.filterwarnings("ignore:under ")
def test_it_does_not_matter_where_a_machine_with_a_bent_bar_is_drawn(bar):
    """Drawn with relaxed springs, or near its equilibrium with the springs as long as they are there."""
    found, place, turn = [], np.zeros(3), TURN
    for _ in range(3):
        spin = {"angular_velocity": 5.0 * PULLED, "axis_point": (0.05, -0.02, 0.1)}
        assembly = loaded_assembly(between_plates(bar, place, turn), **spin)
        state = assembly.coordinates.states["bar"]
        place, turn = state.position, state.rotation @ turn
        poles, read = linear_model(assembly).poles(), list(steady_outputs(assembly).values())
        found.append((np.sort(np.abs(poles))[::2], np.array(read)))
    (as_drawn, forces), _, (at_rest, expected) = found
    np.testing.assert_allclose(as_drawn, at_rest, rtol=1e-5)
    np.testing.assert_allclose(forces, expected, rtol=1e-3, atol=1e-3 * np.abs(expected[1:]).max())


STACK_LENGTH, STACK_SIDE = 0.1, 5e-3
STACK = PiezoStack(
    free_stroke=20e-6,
    blocked_force=1000.0,
    voltage_range=200.0,
    stiffness=50e6,
    capacitance=5e-6,
    length=STACK_LENGTH,
    area=STACK_SIDE**2,
    transverse_ratio=-0.3,
)


PORT = VoltageDrive("drive", "bar.v", "voltage")
PAIR = StackActuator("drive", "bar.left", "bar.right", STACK.force_per_volt, "voltage")


@pytest.fixture(scope="module")
def stack():
    ceramic = Material("ceramic", STACK.young_modulus, 0.0, 8000.0)
    solid = make_bar(length=STACK_LENGTH, side=STACK_SIDE, material=ceramic)
    solid = replace(solid, ports=(ElectricalPort("v", "bar", STACK),))
    mesh = generate_mesh(solid, element_size=2 * STACK_SIDE, layer_thickness=STACK_LENGTH / 4, extrude="x")
    return craig_bampton(meshed(mesh, solid, 3), n_modes=4, geometric_stiffness=True, progress=False)


@pytest.mark.parametrize(("drive", "share"), [(PORT, -0.5), (PORT, 0.5), (PAIR, 0.5)])
def test_a_guided_stack_is_pressed_by_its_voltage(stack, share, drive):
    """A stack clamped at one end and guided across at the other, which the voltage presses with its blocked force P.

    The voltage is that of its port, or a pair of forces at its ends. A force H across moves the end by
    H / (P k) (2 tan(k l / 2) - k l), by Timoshenko and Gere.
    """
    ends = {"l": np.zeros(3), "r": TURN @ [STACK_LENGTH, 0, 0]}
    guide = Joint("guide", "ground.r", "bar.right", free=("z",), axes=TURN)
    scene = Scene(
        "stack",
        (RigidBody("ground", ends, fixed=True), FlexibleBody("bar", stack, rotation=TURN)),
        (Joint("foot", "ground.l", "bar.left", axes=TURN), guide),
        (drive, PointForce("push", "bar.right", TURN[:, 2], "force")),
        (Encoder("end", "ground.r", "bar.right", TURN[:, 2]),),
    )
    bending = STACK.young_modulus * STACK_SIDE**4 / 12
    press, force = share * np.pi**2 * bending / STACK_LENGTH**2, 1.0
    k = np.sqrt(complex(press / bending))
    expected = (force / (press * k) * (2 * np.tan(k * STACK_LENGTH / 2) - k * STACK_LENGTH)).real
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="the preload in body|under its loads|body 'bar' is deformed")
        found = static_response(scene, {"voltage": press / STACK.force_per_volt, "force": force})["end"]
    assert found == pytest.approx(expected, rel=0.02)  # shear, of a bar of slenderness 20
    if share > 0:
        factors, _ = buckling_factors(scene, inputs={"voltage": press / STACK.force_per_volt})
        assert factors[0] == pytest.approx(1 / share, rel=0.02)


def test_stress_within_a_stack_that_a_pair_of_forces_presses_is_told(bar):
    scene = cantilever(bar)
    with pytest.warns(UserWarning, match="'stress' lies between 'bar.left' and 'bar.right', which a pair"):
        linearize(replace(scene, actuators=(PAIR,)))


@pytest.mark.parametrize("off", [0.0, 0.24, 0.26])
@pytest.mark.parametrize("share", [-0.02, 0.02, 0.98, 1.02])
def test_a_stack_reaches_from_end_to_end_and_a_quarter_of_its_length_around_its_axis(bar, share, off):
    middle = replace(bar.readouts["middle"], positions=LENGTH * np.array([[share, 0.6 * off, 0.8 * off]]))
    moved = replace(bar, readouts={**bar.readouts, "middle": middle})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        warn_of_pressed_stacks(replace(cantilever(moved), actuators=(PAIR,)))
    assert len(told) == (0 < share < 1 and off < 0.25)
