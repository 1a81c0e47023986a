"""Configurations that few scenes have, each against a closed form or against a scene that must give the same."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy
from conftest import Given, lattice
from scipy.spatial.transform import Rotation
from test_large_motion import GRAVITY, INERTIA, NORMAL, SKEWED, ground, run
from test_loaded_states import frequencies

from nassim import (
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    Joint,
    Loop,
    PointForce,
    PointTorque,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageSensor,
    craig_bampton,
    fixed,
    linearize,
    revolute,
    simulate,
    static_response,
)
from nassim.bodies.piezo import PortCoupling
from nassim.bodies.readouts import by_name
from nassim.scene.joints import prismatic, spherical
from nassim.scene.measures import Displacement, PointVelocity
from nassim.scene.part import Sensor
from nassim.scene.terms import NonlinearSpring, Output, Spring, SpringForce
from nassim.simulation import Simulation, exudyn_eigenfrequencies, loaded_equilibrium, spinning_equilibrium
from nassim.simulation.loaded.geometric_stiffness import GeometricStiffness
from nassim.simulation.loaded.loads import static_loads
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.displacement import change_of_directions, displaced
from nassim.simulation.model.initial_velocities import is_axisymmetric, steady_rotation_twists
from nassim.simulation.model.period_correction import Steps
from nassim.simulation.model.reach import find_reach
from nassim.simulation.model.step_errors import describe_steps
from nassim.systems import proportional


def sliding(name, place, mass, **more):
    """A mass and its guide along NORMAL."""
    body = RigidBody(name, {"c": (0, 0, 0)}, mass, INERTIA, place, **more)
    return body, prismatic(f"{name} guide", f"ground.{name}", f"{name}.c", NORMAL)


def test_the_force_of_each_of_two_nonlinear_springs():
    """Of a chain that hangs on f = c v^3: either bears the whole force on the lower mass, by its own tangent."""
    places = {"upper": np.array([0.1, 0, 0]), "lower": np.array([0.3, 0.2, 0])}
    (upper, one), (lower, other) = (
        sliding(name, places[name], mass) for name, mass in (("upper", 1.0), ("lower", 2.0))
    )
    ends = (("ground.upper", "upper.c", 2e7), ("upper.c", "lower.c", 5e6))
    terms = []
    for k, (a, b, cubic) in enumerate(ends):
        law = NonlinearSpring(Displacement.between(a, b, NORMAL), force=lambda v, _, c=cubic: 50.0 * v + c * v**3)
        terms += [law, SpringForce(f"f{k}", "N", law)]
    scene = Scene(
        "chain",
        (ground(**places), upper, lower),
        (one, other),
        (PointForce("push", "lower.c", NORMAL, "push"),),
        springs=(Given("springs", tuple(terms)),),
        gravity=9.81 * NORMAL,
        damping_ratio=0.0,
    )
    a, b, c, d = linearize(scene).matrices
    np.testing.assert_allclose(d - c @ np.linalg.solve(a, b), [[1.0], [1.0]], rtol=1e-6)
    k = np.zeros(2)
    for i, (cubic, borne) in enumerate(((2e7, 3 * 9.81), (5e6, 2 * 9.81))):
        stretch = scipy.optimize.brentq(lambda v, c=cubic, f=borne: 50.0 * v + c * v**3 - f, 0.0, 1.0, xtol=1e-15)
        k[i] = 50.0 + 3 * cubic * stretch**2
    expected = scipy.linalg.eigvalsh([[k[0] + k[1], -k[1]], [-k[1], k[1]]], np.diag([1.0, 2.0]))
    for options in ({}, {"loaded": False}):
        found = np.unique(np.abs(linearize(scene, **options).poles()).round(6))
        np.testing.assert_allclose(found, np.sqrt(expected), rtol=1e-6)


def test_directions_change_as_the_bodies_of_a_joint_see_them():
    """Forces of a ball joint along the axes of one body, which the other, equally pushed, sees turn against its own."""
    bodies = [RigidBody(name, {"p": np.zeros(3)}, 1.0, np.eye(3)) for name in "ab"]
    turns = np.array([[0.2, -0.1, 0.15], [-0.05, 0.12, 0.3]])
    coordinates = assemble(Scene("pair", bodies, (spherical("ball", "a.p", "b.p"),))).coordinates
    values = np.zeros(coordinates.size)
    for body, turn in zip("ab", turns, strict=True):
        values[coordinates.slices[body]][3:] = turn
    of_a, of_b = (Rotation.from_rotvec(turn) for turn in turns)
    seen = np.linalg.norm((of_b.inv() * of_a).as_matrix() - np.eye(3), axis=0)
    assert change_of_directions(coordinates, displaced(coordinates, values)) == pytest.approx(seen.max() / np.sqrt(2))


def test_a_part_of_two_springs_tells_the_force_of_each():
    """Two masses that hang on one part: each spring bears the weight of its own."""
    places, masses = {"one": np.zeros(3), "other": np.array([0.3, 0, 0])}, (0.5, 8.0)
    (one, first), (other, second) = (sliding(name, places[name], m) for name, m in zip(places, masses, strict=True))
    laws = (Spring(Displacement.between(f"ground.{name}", f"{name}.c", NORMAL), 1e5) for name in places)
    scene = Scene("two", (ground(**places), one, other), (first, second), springs=(Given("springs", tuple(laws)),))
    found = loaded_equilibrium(replace(scene, gravity=9.81 * NORMAL)).spring_forces["springs"]
    assert found == pytest.approx({"1.value": 9.81 * masses[0], "2.value": 9.81 * masses[1]}, rel=1e-9)


def test_the_effect_of_steps_is_that_on_modes_up_to_the_frequency_asked_for():
    """By the trapezoidal rule, whose frequencies are atan(w h / 2) / (w h / 2) of the true ones."""
    places, frequencies, step = {"slow": np.zeros(3), "fast": np.array([0.3, 0, 0])}, (10.0, 50.0), 1e-3
    (slow, first), (fast, second) = (sliding(name, place, 2.0) for name, place in places.items())
    springs = (
        SpringDamper(name, f"ground.{name}", f"{name}.c", NORMAL, 2.0 * (2 * np.pi * f) ** 2)
        for name, f in zip(places, frequencies, strict=True)
    )
    assembly = assemble(Scene("two", (ground(**places), slow, fast), (first, second), springs=tuple(springs)))
    steps = Steps(step, corrected=False)
    assert describe_steps(assembly, steps, 9.0) == ""
    for highest, frequency in ((20.0, 10.0), (60.0, 50.0)):
        x = np.pi * frequency * step
        told = f"the steps shift modes up to {highest:g} Hz by up to {100 * (1 - np.arctan(x) / x):.2g} %"
        assert describe_steps(assembly, steps, highest) == told
    # Of a spectral radius below 1, by the eigenvalues of a step of Chung and Hulbert, J. Appl. Mech. 1993.
    rho, h, w2 = 0.5, step, (2 * np.pi * 50.0) ** 2
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
    after = [[w2 * (1 - alpha_f), 0, 1 - alpha_m], [1, 0, -beta * h**2], [0, 1, -gamma * h]]
    before = [[-w2 * alpha_f, 0, -alpha_m], [1, h, (0.5 - beta) * h**2], [0, 1, (1 - gamma) * h]]
    poles = np.log(np.linalg.eigvals(np.linalg.solve(after, before)).astype(complex)) / h
    pole = poles[np.argmin(np.abs(poles - 1j * np.sqrt(w2)))]
    told = f"damp them by up to {-100 * pole.real / np.abs(pole):.2g} % of critical"
    assert told in describe_steps(assembly, Steps(step, rho, corrected=False), 60.0)


def test_limits_of_loops_on_one_input_add_up():
    """Two loops may push as far as one of both limits."""
    mass, guide = sliding("mass", np.zeros(3), 2.0)
    push, read = PointForce("push", "mass.c", NORMAL, "push"), Encoder("x", "ground.mass", "mass.c", NORMAL)

    def path(*limits):
        loops = tuple(
            Loop(f"loop {k}", proportional(-1.0, sample_rate=1e3, limit=limit), "x", "push")
            for k, limit in enumerate(limits)
        )
        scene = Scene("mass", (ground(mass=np.zeros(3)), mass), (guide,), (push,), (read,), loops=loops)
        return find_reach(assemble(scene), np.zeros((1, 101)), 1e-3).path

    np.testing.assert_allclose(path(3.0, 4.0), path(7.0), rtol=1e-12)


def test_speeds_of_drives_add_up():
    """Two carriages at constant speeds get as far as one that has all momentum and both speeds."""
    places, masses, speeds = {"one": np.zeros(3), "other": np.array([0.3, 0, 0])}, (0.5, 8.0), (0.2, -0.7)
    (one, first), (other, second) = (sliding(name, places[name], m) for name, m in zip(places, masses, strict=True))
    motors = (Drive(f"{n} motor", f"{n} guide", "z", speed=v) for n, v in zip(places, speeds, strict=True))
    scene = Scene("two", (ground(**places), one, other), (first, second), tuple(motors))
    rate = np.sqrt(np.dot(masses, np.square(speeds))) + np.sqrt(np.sum(masses)) * np.sum(np.abs(speeds))
    path = find_reach(assemble(scene), np.zeros((0, 101)), 1e-3).path
    np.testing.assert_allclose(path, 1e-3 * np.arange(1, 102) * rate, rtol=1e-9)


def test_a_turntable_is_the_same_at_every_angle_without_weight_across_its_axis():
    """And without a spring to what stands."""
    bodies = (
        ground(o=np.zeros(3), side=(0.5, 0, 0)),
        RigidBody("table", {"o": (0, 0, 0)}, 1.0, INERTIA),
        RigidBody("load", {"c": (0, 0, 0)}, 1.0, INERTIA, (0.1, 0, 0)),
    )
    hinge, spindle = revolute("hinge", "ground.o", "table.o", NORMAL), Drive("motor", "hinge", "rz", speed=5.0)
    tie = Bushing("tie", "table.o", "load.c", [1e4] * 6)
    scene = Scene("table", bodies, (hinge,), (spindle,), springs=(tie,))
    for gravity, same in ((0.0 * NORMAL, True), (-9.0 * NORMAL, True), (GRAVITY, False)):
        now = replace(scene, gravity=gravity)
        assert is_axisymmetric(now, steady_rotation_twists(now)) == same
    held = replace(scene, springs=(tie, SpringDamper("hold", "ground.side", "load.c", "line", 10.0)))
    assert not is_axisymmetric(held, steady_rotation_twists(held))


def test_a_stator_swings_under_weight_across_the_axis_of_its_rotor():
    """In the stator's frame all weight is constant: a pendulum beside a spinning wheel, sqrt(g / l)."""
    place = np.array([0.5, 0.0, 0.0])
    bodies = (
        ground(o=np.zeros(3), side=place),
        RigidBody("wheel", {"o": (0, 0, 0)}, 1.0, 1e-3 * np.eye(3)),
        RigidBody("bob", {"o": (0, 0.2, 0)}, 2.0, 1e-12 * np.eye(3), place - [0, 0.2, 0]),
    )
    joints = revolute("spindle", "ground.o", "wheel.o", "z"), revolute("pin", "ground.side", "bob.o", "z")
    scene = Scene("beside", bodies, joints, (Drive("motor", "spindle", "rz", speed=40.0),), gravity=(0, -9.81, 0))
    poles = linearize(scene, frame="stator", stator=("ground", "bob")).poles()
    assert np.abs(poles - 1j * np.sqrt(9.81 / 0.2)).min() < 1e-6


def test_a_spinning_equilibrium_is_without_weight():
    """A mass on a spring along the axis stays; beside it a radial one stretches by m W^2 r / (k - m W^2)."""
    places = {"up": np.array([0.0, 0, 0.1]), "out": np.array([0.2, 0, 0])}
    axes = {"up": "z", "out": "x"}
    bodies = [RigidBody(name, {"c": (0, 0, 0)}, 2.0, INERTIA, place) for name, place in places.items()]
    joints = tuple(prismatic(f"guide {name}", f"ground.{name}", f"{name}.c", axis) for name, axis in axes.items())
    springs = tuple(
        SpringDamper(name, f"ground.{name}", f"{name}.c", axis, 1e4, frame=f"ground.{name}")
        for name, axis in axes.items()
    )
    sensors = tuple(Encoder(name, f"ground.{name}", f"{name}.c", axis) for name, axis in axes.items())
    scene = Scene("table", (ground(**places), *bodies), joints, (), sensors, springs, gravity=(0, 0, -9.81))
    found = spinning_equilibrium(scene, angular_velocity=(0, 0, 20.0))
    assert found["up"] == pytest.approx(0.0, abs=1e-15)
    assert found["out"] == pytest.approx(2.0 * 400.0 * 0.2 / (1e4 - 2.0 * 400.0), rel=1e-9)


def test_a_pendulum_that_stands_on_a_weak_spring_has_a_negative_frequency():
    """sqrt((m g l - k) / m l^2), as of a motion that grows."""
    up = -GRAVITY / np.linalg.norm(GRAVITY)
    axis = np.cross(up, NORMAL) / np.linalg.norm(np.cross(up, NORMAL))
    bob = RigidBody("bob", {"o": -0.2 * up}, 2.0, 1e-12 * np.eye(3), 0.2 * up)
    weight = 2.0 * np.linalg.norm(GRAVITY) * 0.2
    torsion = Bushing("torsion", "ground.o", "bob.o", np.zeros((6, 6)) + np.diag([0, 0, 0, 1, 1, 1]) * 0.4 * weight)
    scene = Scene("standing", (ground(), bob), (revolute("hinge", "ground.o", "bob.o", axis),), springs=(torsion,),
                  gravity=GRAVITY)  # fmt: skip
    expected = -np.sqrt(0.6 * weight / (2.0 * 0.2**2)) / (2 * np.pi)
    assert exudyn_eigenfrequencies(scene, loaded=True) == pytest.approx([expected], rel=1e-5)


def test_a_pushed_pair_in_free_space_bears_what_accelerates_its_second_mass():
    """F m / (M + m) in the spring and in the joint between them; nothing else holds the pair."""
    across = np.cross(NORMAL, [1.0, 0, 0]) / np.linalg.norm(np.cross(NORMAL, [1.0, 0, 0]))
    bodies = [RigidBody(name, {"o": (0, 0, 0)}, mass, np.eye(3)) for name, mass in (("a", 3.0), ("b", 2.0))]
    scene = Scene("pair", bodies, (prismatic("slide", "a.o", "b.o", NORMAL),),
                  [PointForce(name, "a.o", tuple(axis), name) for name, axis in (("along", NORMAL), ("aside", across))],
                  springs=(SpringDamper("k", "a.o", "b.o", tuple(NORMAL), 5e3),))  # fmt: skip
    found = loaded_equilibrium(scene, inputs={"along": 7.0, "aside": 4.0})
    assert found.spring_forces["k"]["value"] == pytest.approx(-7.0 * 2 / 5, rel=1e-9)
    assert np.linalg.norm([found.joint_forces["slide"][name] for name in "xy"]) == pytest.approx(4.0 * 2 / 5, rel=1e-9)
    assert (found.motions["b.o"] - found.motions["a.o"])[:3] @ NORMAL == pytest.approx(-2.8 / 5e3, rel=1e-9)


def test_a_port_with_a_resistance_bears_nothing_at_rest():
    """Its charge has left: a clamped body with one pulls at its clamp as its weight does, and by no more."""
    plain = craig_bampton(lattice(stiffness=1e8), n_modes=2, progress=False)
    forces = np.zeros(len(plain.mass_matrix))
    forces[6], forces[0], forces[12:] = 300.0, -300.0, [20.0, -10.0]
    body = replace(plain, readouts=by_name([*plain.readouts.values(), PortCoupling("v", forces, 1e-3)]))
    bar = FlexibleBody("bar", body, -SKEWED @ body.point("left").position, SKEWED)
    clamp, read = fixed("clamp", "ground.o", "bar.left"), VoltageSensor("read", "bar.v", resistance=1e5)
    scene = Scene("wired", (ground(), bar), (clamp,), sensors=(read,), gravity=GRAVITY)
    found = loaded_equilibrium(scene).joint_forces["clamp"]
    weight = plain.mass * GRAVITY
    arm = SKEWED @ (plain.center_of_mass - body.point("left").position)
    np.testing.assert_allclose([*found.values()], [*weight, *np.cross(arm, weight)], rtol=1e-6)
    # Nor has it a voltage where a soft foot lets the body turn.
    foot = Bushing("foot", "ground.o", "bar.left", [1e4] * 3 + [4.0] * 3)
    bodies = ground(), replace(bar, fidelity="linear")
    soft = replace(scene, bodies=bodies, joints=(), springs=(foot,))
    assert np.linalg.norm(loaded_equilibrium(soft).motions["bar.left"][3:]) > 5e-3
    start = simulate(soft, TimeHistory([0.0, 1e-5], np.zeros((0, 2)), (), ()), time_step=1e-5, method="exact",
                     progress=False)  # fmt: skip
    assert np.abs(start["read"]).max() < 1e-6 * 300.0 * 0.04 / 1e-3


def test_a_pendulum_on_accelerating_ground_swings_as_under_more_weight():
    """sqrt((g + a) / l) for an acceleration of the ground upwards."""
    up = -GRAVITY / np.linalg.norm(GRAVITY)
    across = np.cross(up, NORMAL) / np.linalg.norm(np.cross(up, NORMAL))
    bob = RigidBody("bob", {"o": 0.2 * up}, 2.0, 1e-12 * np.eye(3), -0.2 * up)
    scene = Scene(
        "pendulum",
        (ground(), bob),
        (revolute("hinge", "ground.o", "bob.o", across),),
        (GroundAcceleration("lift", up, "a"),),
        gravity=GRAVITY,
    )
    expected = np.sqrt((np.linalg.norm(GRAVITY) + 3.0) / 0.2) / (2 * np.pi)
    assert frequencies(scene, constant_inputs={"a": 3.0}) == pytest.approx([expected], rel=1e-6)


def test_a_free_body_under_a_torque_and_weight_feels_less_of_it_where_it_turns_away():
    """Body force per mass: weight less the acceleration a + alpha x r of its material, along the body's axes."""
    model = lattice(stiffness=1e5)
    body = craig_bampton(model, n_modes=2, progress=False)
    masses, spots = model.scalar_mass_matrix.diagonal(), model.fields[1:].T
    centre = masses @ spots / masses.sum()
    arms = spots - centre
    inertia = (masses @ (arms**2).sum(axis=1)) * np.eye(3) - arms.T @ (masses[:, None] * arms)
    force, torque = np.array([0.3, -0.2, 0.5]), np.array([2e-3, 1e-3, -3e-3])
    bar = FlexibleBody("bar", body, (0.1, 0.2, 0.3), SKEWED)
    pushes = PointForce("push", "bar.left", force, "push"), PointTorque("twist", "bar.right", torque, "twist")
    assembly = assemble(Scene("free", (bar,), (), pushes))
    values = {"push": float(np.linalg.norm(force)), "twist": float(np.linalg.norm(torque))}
    loads, _ = static_loads(assembly, GeometricStiffness.of(assembly), GRAVITY, values)
    force, torque = SKEWED.T @ force, SKEWED.T @ torque
    turning = np.linalg.solve(inertia, torque + np.cross(body.point("left").position - centre, force))
    for place in np.random.default_rng(1).normal(size=(3, 3)):
        expected = -force / masses.sum() - np.cross(turning, place - centre)
        np.testing.assert_allclose(loads.body_forces["bar"] @ [1.0, *place], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("unit", "factor"), [("kN", 1e3), ("mN", 1e-3)])
def test_an_excitation_in_another_unit(unit, factor):
    mass, guide = sliding("mass", np.zeros(3), 2.0)
    scene = Scene(
        "mass",
        (ground(mass=np.zeros(3)), mass),
        (guide,),
        (PointForce("idle", "mass.c", NORMAL, "idle"), PointForce("push", "mass.c", NORMAL, "push")),
        (Encoder("x", "ground.mass", "mass.c", NORMAL),),
    )
    time = 1e-3 * np.arange(51)
    given = TimeHistory(time, np.outer([0.5, 1.0], np.ones(51)), ("idle", "push"), ("N", unit))
    record = simulate(scene, given, time_step=1e-3, method="exact", progress=False)
    np.testing.assert_allclose(record["x"], (0.5 + factor) / 2.0 * time**2 / 2, rtol=1e-9, atol=1e-15)
    assert record.units[:2] == ("N", "N")
    np.testing.assert_allclose(record["push"], factor)
    np.testing.assert_allclose(record["idle"], 0.5)


def test_the_ground_shakes_a_body_in_small_motion_beside_one_that_spins():
    """As it shakes the body alone, by exact steps."""
    body = craig_bampton(lattice(stiffness=1e5), n_modes=2, progress=False)
    bar = FlexibleBody("bar", body, -SKEWED @ body.point("left").position, SKEWED, "linear")
    alone = Scene(
        "bar",
        (ground(), bar),
        (),
        (GroundAcceleration("quake", NORMAL, "a"),),
        (Encoder("end", "ground.o", "bar.right", "y"),),
        (Bushing("foot", "ground.o", "bar.left", [1e4, 2e4, 3e4, 20.0, 30.0, 40.0], 0.1 * np.ones(6)),),
        damping_ratio=0.0,
    )
    top = RigidBody("top", {"c": (0, 0, 0)}, 1.0, INERTIA, (1.0, 0, 0), angular_velocity=(0, 5.0, 0))
    shake = {"a": lambda t: np.sin(400 * t) ** 2}
    expected = run(alone, 0.01, 1e-4, shake, method="exact")["end"]
    found = run(replace(alone, bodies=(*alone.bodies, top)), 0.01, 1e-4, shake, spectral_radius=1.0)["end"]
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-3 * np.abs(expected).max())


def test_the_force_of_a_bushing_is_what_moves_its_body():
    """Between bodies that spin unlike each other, with a damper: m a of either one, as |a| has no axes."""
    place, start = np.array([0.06, -0.02, 0.03]), np.array([0.1, 0.0, 0.05])
    base = RigidBody("base", {"o": place, "c": (0, 0, 0)}, 2.0, 50 * INERTIA, angular_velocity=(8.0, -6.0, 5.0))
    load = RigidBody(
        "load", {"o": place - start, "c": (0, 0, 0)}, 0.7, 5 * INERTIA, start, angular_velocity=(-9.0, 3.0, 4)
    )
    bushing = Bushing("bushing", "base.o", "load.o", [300.0] * 3 + [0.5] * 3, [6.0] * 3 + [0.0] * 3, SKEWED)
    sensors = (ForceSensor("f", "bushing"), Speed("v", "load.c"))
    scene = Scene("two", (base, load), springs=(bushing,), sensors=sensors, damping_ratio=0.0)
    record = run(scene, 0.02, 5e-5)
    speed = np.array([record[f"v.{k}"] for k in range(3)])
    moved = 0.7 * np.linalg.norm(np.gradient(speed, 5e-5, axis=1), axis=0)[20:-20]
    force = np.linalg.norm([record[f"f.f{axis}"] for axis in "xyz"], axis=0)[20:-20]
    np.testing.assert_allclose(force, moved, rtol=0, atol=5e-3 * moved.max())


@dataclass(frozen=True)
class Speed(Sensor):
    """Three outputs: the velocity of a point."""

    name: str
    point: str

    def terms(self, scene):
        velocities = (PointVelocity(((self.point, axis),)) for axis in np.eye(3))
        return tuple(Output(f"{self.name}.{k}", "m/s", of, derivative=1) for k, of in enumerate(velocities))


def test_bodies_that_turn_together_do_not_move_against_each_other():
    """Two arms welded by a stiff bushing on a hinge turn by more than a radian; one alone is told."""
    body = craig_bampton(lattice(), n_modes=1, progress=False)
    bar = FlexibleBody("bar", body, -SKEWED @ body.point("left").position, SKEWED, angular_velocity=20.0 * NORMAL)
    tip = SKEWED @ (body.point("right").position - body.point("left").position)
    arm = RigidBody("arm", {"c": (0, 0, 0)}, 0.1, INERTIA, tip, angular_velocity=20.0 * NORMAL)
    hinge, tie = (
        revolute("hinge", "ground.o", "bar.left", NORMAL),
        Bushing("tie", "bar.right", "arm.c", [1e5] * 3 + [100.0] * 3),
    )
    scene = Scene("arms", (ground(), bar, arm), (hinge,), springs=(tie,), damping_ratio=0.01)

    def told(scene):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            run(scene, 0.1, 1e-3)
        return [str(w.message) for w in caught if "as seen from" in str(w.message)]

    assert told(scene) == []
    free = replace(scene, joints=(hinge, Joint("pin", "bar.right", "arm.c", free=("rx", "ry", "rz"))), springs=())
    free = replace(free, bodies=(ground(), bar, replace(arm, angular_velocity=-20.0 * NORMAL)))
    assert len(told(free)) == 1


@dataclass(frozen=True)
class Lagging(PointForce):
    """A force behind an amplifier."""

    bandwidth: float = 30.0

    def terms(self, scene):
        return tuple(replace(term, bandwidth=self.bandwidth) for term in super().terms(scene))


@pytest.mark.parametrize("spins", [False, True])
def test_a_force_behind_an_amplifier_begins_at_zero(spins):
    """Under a step at the start, by the first steps: the velocity of a low-pass of first order, integrated."""
    mass, guide = sliding("mass", np.zeros(3), 2.0)
    top = RigidBody("top", {"c": (0, 0, 0)}, 1.0, INERTIA, (1.0, 0, 0), angular_velocity=(0, 5.0 * spins, 0))
    push = Lagging("push", "mass.c", NORMAL, "push")
    scene = Scene("mass", (ground(mass=np.zeros(3)), mass, top), (guide,), (push,), (Speed("v", "mass.c"),))
    record = run(scene, 0.004, 1e-4, {"push": lambda t: 1.0 + 0 * t}, spectral_radius=0.9)
    rate, time = 2 * np.pi * 30.0, record.time
    expected = (time - (1 - np.exp(-rate * time)) / rate) / 2.0
    found = NORMAL @ [record[f"v.{k}"] for k in range(3)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 * expected[-1])


def test_bodies_that_have_moved_back_at_the_end_are_told_of():
    """An arm that a drive turns by 0.3 rad and back, on a bar of damped modes."""
    body = craig_bampton(lattice(), n_modes=1, progress=False)
    bar = FlexibleBody("bar", body, -SKEWED @ body.point("left").position, SKEWED)
    arm = RigidBody("arm", {"c": (0, 0, 0)}, 1e-3, 1e-3 * INERTIA, bar.point_position("right"))
    joints = fixed("clamp", "ground.o", "bar.left"), revolute("hinge", "bar.right", "arm.c", NORMAL)
    drive = Drive("motor", "hinge", "rz", "turn")
    scene = Scene("arm", (ground(), bar, arm), joints, (drive,), damping_ratio=0.01)
    for angle, n in ((0.3, 1), (0.05, 0)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            run(scene, 0.1, 1e-3, {"turn": lambda t, angle=angle: angle * np.sin(np.pi * t / 0.1) ** 2})
        assert sum("as seen from" in str(w.message) for w in caught) == n


@pytest.mark.parametrize("bandwidth", [30.0, 2400.0])
def test_explicit_steps_hold_what_goes_through_an_amplifier(bandwidth):
    """As exact steps do that hold inputs, at the first steps of a force that changes from step to step."""
    body = craig_bampton(lattice(stiffness=1e4), n_modes=1, progress=False)
    bar = FlexibleBody("bar", body, -SKEWED @ body.point("left").position, SKEWED, "linear")
    foot = Bushing("foot", "ground.o", "bar.left", [1e3] * 3 + [1.0] * 3)
    push = Lagging("push", "bar.left", NORMAL, "push", bandwidth=bandwidth)
    read = Encoder("x", "ground.o", "bar.left", NORMAL)
    scene = Scene("bar", (ground(), bar), (), (push,), (read,), (foot,), damping_ratio=0.0)
    force = {"push": lambda t: np.sin(600.0 * t)}
    found = run(scene, 0.01, 2e-4, force, method="explicit")["x"]
    expected = run(scene, 0.01, 2e-4, force, method="exact", hold_order=0)["x"]
    straight = run(scene, 0.01, 2e-4, force, method="exact")["x"]
    error = np.abs(found - expected).max()
    assert error < 0.1 * np.abs(straight - expected).max()


def test_a_restored_run_has_the_reach_of_its_state():
    """How far bodies can get counts from the start of the run, not the steps that were taken back."""
    mass, guide = sliding("mass", np.zeros(3), 2.0)
    push, read = PointForce("push", "mass.c", NORMAL, "push"), Encoder("x", "ground.mass", "mass.c", NORMAL)
    loop = Loop("loop", proportional(-1.0, sample_rate=1e3, limit=2.0), "x", "push")
    scene = Scene("mass", (ground(mass=np.zeros(3)), mass), (guide,), (push,), (read,), loops=(loop,))
    for method in ("exact", "generalized_alpha"):
        with Simulation(scene, time_step=1e-3, method=method) as steps:
            start, paths = steps.state, []
            for _ in range(2):
                steps.restore(start)
                for _ in range(100):
                    steps.step()
                paths.append(steps._engine.reach._path)
        assert paths[0] == paths[1] > 0


@pytest.mark.parametrize("method", ["generalized_alpha", "exact"])
def test_a_scene_without_a_motion_rests(method):
    """A bar of two points that are both clamped, which has no modes."""
    bar = craig_bampton(lattice(), n_modes=0, progress=False)
    clamps = [fixed(name, f"ground.{name}", f"bar.{name}") for name in ("left", "right")]
    bodies = (
        ground(**{point.name: point.position for point in bar.remote_points}),
        FlexibleBody("bar", bar, fidelity="linear"),
    )
    push, read = PointForce("push", "bar.left", NORMAL, "push"), Encoder("y", "ground.left", "bar.right", "y")
    scene = Scene("clamped", bodies, clamps, (push,), (read,), gravity=GRAVITY)
    record = simulate(scene, None, time_step=1e-3, duration=3e-3, method=method, progress=False)
    assert not record["y"].any()
    assert static_response(scene, {"push": 1.0}) == {"y": 0.0}


def test_chosen_outputs_have_their_own_units():
    mass, guide = sliding("mass", np.zeros(3), 2.0)
    sensors = Encoder("x", "ground.mass", "mass.c", NORMAL), Speed("v", "mass.c")
    scene = Scene("mass", (ground(mass=np.zeros(3)), mass), (guide,), sensors=sensors)
    nothing = TimeHistory(1e-3 * np.arange(3), np.zeros((0, 3)), (), ())
    record = simulate(scene, nothing, time_step=1e-3, outputs=["v.1", "x"], method="exact", progress=False)
    assert (record.names, record.units) == (("v.1", "x"), ("m/s", "m"))


def test_a_light_body_gets_farther_than_a_heavy_one():
    """By one over the root of its mass, beyond the size of the scene."""
    places = {"light": np.zeros(3), "heavy": np.array([0.3, 0, 0])}
    (light, one), (heavy, other) = (
        sliding(name, places[name], mass) for name, mass in (("light", 0.5), ("heavy", 8.0))
    )
    push = PointForce("push", "light.c", NORMAL, "push")
    reach = find_reach(
        assemble(Scene("two", (ground(**places), light, heavy), (one, other), (push,))), np.ones((1, 101)), 1e-3
    )
    found = reach.at(100)
    assert (found["light"] - reach.size) / (found["heavy"] - reach.size) == pytest.approx(4.0)


def test_preload_between_bodies_that_joints_hold_to_the_ground():
    """Nothing there moves, but the forces are read; neither does a force along axes of one of them."""
    rotation = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    points = {"c": (0, 0, 0), "end": (0.1, 0.2, -0.1)}
    bodies = [RigidBody(name, points, 2.0, INERTIA, rotation=rotation) for name in "ab"]
    swing = RigidBody("swing", {"c": (0, 0, 0)}, 1.0, INERTIA, (0, 1, 0))
    scene = Scene(
        "held",
        (ground(origin=(0, 0, 0), b=(1, 0, 0)), bodies[0], replace(bodies[1], position=(1, 0, 0)), swing),
        (fixed("a", "ground.origin", "a.c"), fixed("b", "ground.b", "b.c")),
        (PointForce("push", "a.end", "x", "push", frame="b.c"),),
        (ForceSensor("pull", "spring"), ForceSensor("six", "mount")),
        springs=(
            SpringDamper("spring", "a.end", "b.end", "line", 1e4, 3.0, preload=2.5),
            Bushing("mount", "a.c", "b.c", np.full(6, 1e3), preload=(0, 0, 1.5, 0, 0.5, 0)),
            Bushing("seat", "ground.origin", "swing.c", np.full(6, 1e4)),
        ),
    )
    expected = {"pull": 2.5, "six.fx": 0, "six.fy": 0, "six.fz": 1.5, "six.mx": 0, "six.my": 0.5, "six.mz": 0}
    assert static_response(scene) == pytest.approx(expected, abs=1e-12)
    push = TimeHistory(1e-3 * np.arange(4), np.ones((1, 4)), ("push",))
    record = simulate(scene, push, time_step=1e-3, progress=False)
    np.testing.assert_allclose(record.values[1:], np.tile(list(expected.values()), (4, 1)).T, atol=1e-12)


def test_a_fast_rigid_rotor_is_in_its_steady_rotation_from_the_start():
    """It has nothing to settle, whatever its energy."""
    rotor = RigidBody("rotor", {"c": (0, 0, 0)}, 20.0, 1e3 * INERTIA)
    scene = Scene("rotor", (ground(), rotor), (revolute("axle", "ground.o", "rotor.c", "y"),))
    fast = replace(scene, actuators=(Drive("motor", "axle", speed=40.0),))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert not len(simulate(fast, None, time_step=1e-3, duration=3e-3, progress=False).names)
