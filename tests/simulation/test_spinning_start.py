"""Runs that start at speed begin at rest on the turntable: closed forms, the linear model, and what cannot."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageSensor,
    craig_bampton,
    prismatic,
    revolute,
    simulate,
    static_response,
)
from nassim.base.warning_log import collect_messages
from nassim.bodies.piezo import PortCoupling
from nassim.scene.motion_sensors import AngleSensor
from nassim.scene.springs import Bushing
from nassim.simulation.linear.linearization import spinning_equilibrium
from nassim.simulation.model.initial_velocities import steady_rotation_twists
from nassim.systems import proportional

AXIS = np.array([2.0, -1.0, 2.0]) / 3
ACROSS = np.cross(AXIS, [0.0, 0.6, 0.8]) / np.linalg.norm(np.cross(AXIS, [0.0, 0.6, 0.8]))
CENTRE = np.array([0.1, 0.2, 0.3])
INERTIA = np.array([[3e-3, 2e-4, -1e-4], [2e-4, 4e-3, 3e-4], [-1e-4, 3e-4, 5e-3]])


def run(scene, duration, time_step, *, signals=None, **options):
    time = np.arange(round(duration / time_step) + 1) * time_step
    values = {name: np.broadcast_to(f(time), time.shape) for name, f in (signals or {}).items()}
    excitation = TimeHistory(time, np.reshape(list(values.values()), (len(values), len(time))), tuple(values), ())
    return simulate(scene, excitation, time_step=time_step, progress=False, **options)


def turntable(speed=0.0, *, drive=None, **points):
    """Ground, a heavy table on a spindle about an odd axis, and its drive."""
    ground = RigidBody("ground", {"axle": CENTRE}, fixed=True)
    places = {"axle": np.zeros(3)} | {name: np.asarray(at) - CENTRE for name, at in points.items()}
    table = RigidBody("table", places, 3.0, 10 * INERTIA, CENTRE)
    spindle = revolute("spindle", "ground.axle", "table.axle", AXIS)
    return (ground, table), spindle, drive or Drive("motor", "spindle", "rz", speed=speed)


def blade(speed, stiffness=2e4, **options):
    """A flexible bar on the turntable, beside the axis and askew to it, with a load at its tip."""
    reduced = craig_bampton(lattice(stiffness=stiffness), n_modes=4, progress=False)
    foot = CENTRE + np.array([0.05, 0.02, -0.03])
    bar = FlexibleBody("bar", reduced, foot - reduced.point("left").position, fidelity="ffrf")
    load = RigidBody("load", {"p": (0, 0, 0)}, 0.2, 5e-3 * INERTIA, bar.point_position("right"))
    bodies, spindle, drive = turntable(speed, foot=foot)
    joints = spindle, Joint("foot", "table.foot", "bar.left"), Joint("tip", "bar.right", "load.p")
    sensors = tuple(Encoder(axis, "table.foot", "load.p", axis, frame="table.foot") for axis in "xyz")
    return Scene("blade", (*bodies, bar, load), joints, (drive,), sensors, damping_ratio=0.0, **options)


@pytest.mark.filterwarnings("ignore:body 'bar'", "ignore:under the spin")
@pytest.mark.parametrize(("speed", "near"), [(10.0, 1e-3), (30.0, 1e-2)])
def test_a_flexible_blade_starts_stretched_and_does_not_ring(speed, near):
    """As the linear equilibrium to first order; drawn unloaded, it rings about that by as much again."""
    scene = blade(speed)
    with collect_messages() as log:
        started, released = (run(scene, 0.05, 2e-4, start=start).values for start in ("equilibrium", "released"))
    assert not [text for text in log.warnings if text.startswith("under the spin")]
    expected = np.array(list(spinning_equilibrium(scene).values()))
    size = np.abs(expected).max()
    assert np.ptp(released, axis=1).max() > 1.5 * size
    assert np.ptp(started, axis=1).max() < 1e-4 * size
    assert np.abs(started[:, 0] - expected).max() < near * size
    assert np.all(released[:, 0] == 0.0)


def governor(speed, drawn, *, gravity=9.81, stiffness=0.6):
    """A pendulum hinged beside the axis, with a torsion spring, drawn at an angle from the axis."""
    hinge, reach, mass = CENTRE + 0.08 * ACROSS, 0.15, 0.4
    third = np.cross(AXIS, ACROSS)
    along = -np.cos(drawn) * AXIS + np.sin(drawn) * ACROSS
    inertia = 2e-4 * np.outer(along, along) + 3e-4 * np.outer(third, third)
    inertia += 4e-4 * np.outer(np.cross(third, along), np.cross(third, along))
    bob = RigidBody("bob", {"hinge": -reach * along}, mass, inertia, hinge + reach * along)
    bodies, spindle, drive = turntable(speed, hinge=hinge)
    # Turned about the hinge by -third, the bob moves outwards.
    joint = revolute("hinge", "table.hinge", "bob.hinge", -third)
    spring = Bushing("spring", "table.hinge", "bob.hinge", [0, 0, 0, 0, 0, stiffness], axes=joint.axes)
    sensors = (AngleSensor("turned", "ground.axle", "table.axle", AXIS),)
    sensors += tuple(Encoder(axis, "table.hinge", "bob.hinge", axis) for axis in "xyz")
    outwards = Encoder("out", "table.hinge", "bob.c", tuple(ACROSS), frame="table.hinge")
    bob = replace(bob, points={**bob.points, "c": np.zeros(3)})
    scene = Scene("governor", (*bodies, bob), (spindle, joint), (drive,), (*sensors[:1], outwards), (spring,),
                  damping_ratio=0.0, gravity=-gravity * AXIS)  # fmt: skip

    def moment(angle):
        """Outwards, of the centrifugal forces, the weight and the spring: the bob's inertias are along, across."""
        out = 0.08 + reach * np.sin(angle)
        spin = mass * out * reach * np.cos(angle) + (4e-4 - 2e-4) * np.sin(angle) * np.cos(angle)
        return speed**2 * spin - mass * gravity * reach * np.sin(angle) - stiffness * (angle - drawn)

    rest = scipy.optimize.brentq(moment, 0.0, 1.5)
    return scene, reach * (np.sin(rest) - np.sin(drawn)), rest


@pytest.mark.parametrize(("speed", "drawn"), [(9.0, 0.0), (9.0, 0.6), (0.5, 0.3)])
def test_a_governor_starts_at_its_angle(speed, drawn):
    """Far from where it is drawn, under weight along an odd axis: the angle from its own equation, to 1e-9.

    What is left to swing about is the integrator's: steps h put the equilibrium off by some (W h)^2 / 12.
    """
    scene, expected, rest = governor(speed, drawn)
    if abs(rest - drawn) > 0.1:
        with pytest.warns(UserWarning, match=f"with body 'bob' turned by {abs(rest - drawn):.2g} rad"):
            record = run(scene, 0.2, 1e-3)
    else:
        record = run(scene, 0.2, 1e-3)
    assert record["out"][0] == pytest.approx(expected, abs=1e-9)
    assert np.ptp(record["out"]) < (speed * 1e-3) ** 2 / 6 * 0.15
    np.testing.assert_allclose(record["turned"], speed * record.time, atol=1e-7)
    assert static_response(scene)["out"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.filterwarnings("ignore:the run starts in static equilibrium")
def test_an_input_that_runs_at_constant_speed_starts_as_a_drive_of_constant_speed():
    """And one that only begins to move starts as drawn."""
    scene, expected, _ = governor(9.0, 0.45, gravity=0.0, stiffness=5.0)
    driven = replace(scene, actuators=(Drive("motor", "spindle", "rz", "angle"),))
    steady = run(driven, 0.05, 1e-3, signals={"angle": lambda t: 9.0 * t})
    assert steady["out"][0] == pytest.approx(expected, abs=1e-9)
    assert np.ptp(steady["out"]) < 1e-6
    begun = run(driven, 0.05, 1e-3, signals={"angle": lambda t: 0.2 * np.sin(30.0 * t) ** 2})
    assert begun["out"][0] == 0.0


def platform(speed, offset=0.03, stiffness=1.0):
    """A mass on two springs across the axis, on slides, beside the axis along the first."""
    other = np.cross(AXIS, ACROSS)
    place = CENTRE + offset * ACROSS
    bodies, spindle, drive = turntable(speed, rail=place)
    slide = RigidBody("slide", {"c": (0, 0, 0)}, 1e-6, 1e-6 * INERTIA, place)
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 1.0, INERTIA, place)
    rails = prismatic("u", "table.rail", "slide.c", ACROSS), prismatic("v", "slide.c", "mass.c", other)
    axes = {"u": tuple(ACROSS), "v": tuple(other)}
    springs = tuple(SpringDamper(f"k{n}", "table.rail", "mass.c", a, stiffness, 0.05, frame="table.rail")
                    for n, a in axes.items() if stiffness)  # fmt: skip
    push = PointForce("push", "mass.c", axes["u"], "push", frame="mass.c")
    sensors = tuple(Encoder(f"d{n}", "table.rail", "mass.c", a, frame="table.rail") for n, a in axes.items())
    return Scene("platform", (*bodies, slide, mass), (spindle, *rails), (drive, push), sensors, springs,
                 damping_ratio=0.0)  # fmt: skip


def test_weight_along_the_axis_does_not_make_an_unstable_start_less_so():
    scene, still = platform(1.1, offset=0.0), {"push": lambda t: 0.0 * t}
    with pytest.raises(ValueError, match="is unstable"):
        run(replace(scene, gravity=-9.81 * AXIS), 0.1, 0.02, signals=still)


def test_what_the_ground_holds_may_be_stable_though_it_looks_unstable():
    """Beyond its critical speed the platform is refused, but not with a spring to the ground, which turns past it."""
    scene = platform(1.1, offset=0.0)
    still = {"push": lambda t: 0.0 * t}
    with pytest.raises(ValueError, match="is unstable"):
        run(scene, 0.1, 0.02, signals=still)
    across = SpringDamper("across", "ground.axle", "mass.c", tuple(ACROSS), 10.0, frame="ground.axle")
    record = run(replace(scene, springs=(*scene.springs, across)), 0.1, 0.02, signals=still)
    assert np.abs(record.values[1:]).max() < 1e-6


def test_the_stretched_platform():
    """u = (m W^2 r + F) / (k - m W^2), at half of the critical speed, and static gain."""
    record = run(platform(0.5), 2.0, 0.02, signals={"push": lambda t: 0.0 * t})
    assert record["du"][0] == pytest.approx(0.03 * 0.25 / 0.75, rel=1e-5)  # the slide's share: 1e-6
    assert np.ptp(record.values[1:], axis=1).max() < 1e-4 * record["du"][0]  # the steps' share
    found = static_response(platform(0.5), {"push": 0.02})
    assert found["du"] == pytest.approx((0.03 * 0.25 + 0.02) / 0.75, rel=1e-5)
    assert found["dv"] == pytest.approx(0.0, abs=1e-9)
    scene = platform(0.5)
    springs = [replace(one, damping=1e3) for one in scene.springs]  # which bear nothing at rest on the table
    scene = replace(scene, springs=springs, sensors=(ForceSensor("pull", "ku"), ForceSensor("across", "kv")))
    found = static_response(scene, {"push": 0.02})
    assert found["pull"] == pytest.approx((0.03 * 0.25 + 0.02) / 0.75, rel=1e-5)
    assert found["across"] == pytest.approx(0.0, abs=1e-9)


def test_an_unstable_equilibrium_is_refused_with_its_pole():
    """Above its resonance the damped platform grows by 0.002498 +- 0.099934j, as published."""
    scene = platform(1.1, offset=0.0)
    with pytest.raises(ValueError, match=r"unstable: an oscillation at 0\.01591 Hz that grows e-fold in 400 s; "):
        run(scene, 1.0, 0.01, signals={"push": lambda t: 0.0 * t})
    with pytest.raises(ValueError, match=r"unstable: an oscillation at 0\.01591 Hz"):
        static_response(scene)
    record = run(scene, 1.0, 0.01, signals={"push": lambda t: 1e-3 + 0.0 * t}, start="released")
    assert record["du"][-1] > 1e-4
    looped = replace(scene, loops=(Loop("hold", proportional(-1.0, sample_rate=100.0), "du", "push"),))
    assert run(looped, 1.0, 0.01)["du"][0] == pytest.approx(0.0, abs=1e-9)  # a loop may hold it


def test_what_nothing_holds_has_no_equilibrium():
    """A mass on one slide is at rest on the axis only, and flies off it; one free along the axis falls."""
    loose = platform(0.5, stiffness=0.0)
    still = {"push": lambda t: 0.0 * t}
    one = replace(loose, joints=(*loose.joints[:2], Joint("v", "slide.c", "mass.c")))
    with pytest.raises(ValueError, match=r"unstable: a drift that grows e-fold in 2 s"):
        run(one, 0.1, 0.01, signals=still)
    record = run(one, 0.1, 0.01, signals=still, start="released")
    assert record["du"][-1] > 0.0
    falling = replace(loose, joints=(*loose.joints[:2], prismatic("v", "slide.c", "mass.c", AXIS)), gravity=AXIS)
    with pytest.raises(RuntimeError, match=r'no spinning equilibrium to start from: .*start="released"'):
        run(falling, 0.1, 0.01, signals=still)


@pytest.mark.filterwarnings("ignore:the run starts in static equilibrium")
def test_what_stands_beside_a_turntable_hangs_in_its_own_equilibrium():
    """A mass on a spring beside a governor, under the same weight, and a rotor beside both that turns another way."""
    scene, expected, _ = governor(9.0, 0.45, stiffness=2.0)
    place = np.array([1.0, 0.0, 0.0])
    aside = place + np.array([0.0, 1.0, 0.0])
    ground = RigidBody("ground", {"axle": CENTRE, "side": place, "aside": aside}, fixed=True)
    block = RigidBody("block", {"c": (0, 0, 0)}, 2.0, INERTIA, place)
    rotor = RigidBody("rotor", {"c": (0, 0, 0), "end": 0.1 * ACROSS}, 0.5, 1e-3 * np.eye(3), aside)
    guide, bearing = (
        prismatic("guide", "ground.side", "block.c", AXIS),
        revolute("bearing", "rotor.c", "ground.aside", ACROSS),
    )
    both = replace(
        scene,
        bodies=(ground, *scene.bodies[1:], block, rotor),
        joints=(*scene.joints, guide, bearing),
        actuators=(*scene.actuators, Drive("rotor", "bearing", "rz", speed=-50.0)),
        sensors=(*scene.sensors, Encoder("sag", "ground.side", "block.c", tuple(AXIS))),
        springs=(*scene.springs, SpringDamper("leg", "ground.side", "block.c", tuple(AXIS), 400.0)),
    )
    twists = steady_rotation_twists(both)
    np.testing.assert_allclose(twists["rotor"][3:], 50.0 * ACROSS)
    assert not twists["block"].any()
    record = run(both, 0.05, 5e-4)
    assert record["out"][0] == pytest.approx(expected, abs=1e-9)
    assert record["sag"][0] == pytest.approx(-2.0 * 9.81 / 400.0, rel=1e-9)
    assert np.ptp(record["sag"]) < 1e-8


def test_motions_that_are_not_steady_start_as_drawn():
    """A guide on the ground, a slot that bodies only start along, a table on a table, bodies with another spin."""
    scene, _, _ = governor(9.0, 0.45, gravity=0.0)
    assert steady_rotation_twists(scene) is not None
    ground, table, bob = scene.bodies
    far = replace(ground, points={"axle": CENTRE, "far": bob.position})
    guided = replace(
        scene, bodies=(far, table, bob), joints=(*scene.joints, prismatic("g", "ground.far", "bob.c", AXIS))
    )
    assert steady_rotation_twists(guided) is None
    axes = np.column_stack([np.cross(AXIS, ACROSS), -ACROSS, AXIS])
    slot = Joint("slot", "ground.far", "bob.c", ("x", "rz"), axes)
    assert steady_rotation_twists(replace(guided, joints=(*scene.joints, slot))) is None
    stacked = replace(scene, springs=(), actuators=(*scene.actuators, Drive("second", "hinge", "rz", speed=1.0)))
    assert steady_rotation_twists(stacked) is None
    assert (
        steady_rotation_twists(replace(scene, bodies=(ground, table, replace(bob, angular_velocity=3.0 * AXIS))))
        is None
    )
    assert (
        steady_rotation_twists(replace(scene, bodies=(ground, table, replace(bob, angular_velocity=9.0 * AXIS))))
        is not None
    )
    assert steady_rotation_twists(replace(scene, actuators=())) is None


def test_a_spring_along_an_axis_of_the_world_that_shakes_a_rotor_is_told():
    """A mass on four springs of the table has the rest (W^2 r, 0) / (k - W^2), were it not for the fifth."""
    speed, arm, k, fifth = 9.0, 0.1, 900.0, 70.0
    other, place = np.cross(AXIS, ACROSS), CENTRE + arm * ACROSS
    (ground, table), spindle, drive = turntable(speed, seat=place)
    ground = replace(ground, points={"axle": CENTRE, "seat": place})
    mass = RigidBody("mass", {"c": np.zeros(3)}, 1.0, INERTIA, place)
    flat = Joint("flat", "table.seat", "mass.c", ("x", "y"), np.column_stack([ACROSS, other, AXIS]))
    springs = [SpringDamper(n, "table.seat", "mass.c", way, k, frame="table.seat") for n, way in
               (("u", ACROSS), ("v", other))]  # fmt: skip
    sensors = [Encoder("u", "table.seat", "mass.c", ACROSS, frame="table.seat")]
    of_world, turning = (SpringDamper("w", "ground.seat", "mass.c", ACROSS, fifth, frame=f) for f in ("", "table.seat"))
    scene = Scene("s", (ground, table, mass), (spindle, flat), (drive,), sensors, springs, damping_ratio=0.0)
    start = arm * speed**2 / (k + fifth - speed**2)
    assert static_response(replace(scene, springs=(*springs, turning)))["u"] == pytest.approx(start, rel=1e-7)
    way = np.array([np.cos(1.0), -np.sin(1.0)])  # of the fifth spring, along axes of the table after a radian
    push = fifth * (start * np.array([1.0, 0.0]) - (way[0] * (arm + start) - arm) * way)
    sway = np.linalg.norm(push / (np.array([k + fifth, k]) - speed**2))
    shaken = replace(scene, springs=(*springs, of_world))
    with pytest.warns(UserWarning, match=f"no steady rotation: .* rest up to {sway:.3g} m elsewhere on it"):
        assert static_response(shaken)["u"] == pytest.approx(start, rel=1e-7)
    with pytest.warns(UserWarning, match="no steady rotation"):
        run(shaken, 0.02, 1e-3)
    heavy = replace(scene, springs=(springs[0], replace(springs[1], stiffness=2 * k)), gravity=2.0 * other)
    sway = 2.0 * np.linalg.norm([np.sin(1.0), np.cos(1.0) - 1] / (np.array([k, 2 * k]) - speed**2))
    with pytest.warns(UserWarning, match=f"weight, .* rest up to {sway:.3g} m elsewhere on it"):
        static_response(heavy)


@pytest.mark.filterwarnings("ignore:body 'bar'", "ignore:under the spin")
def test_weight_that_bends_a_turning_blade_is_told():
    """By the way of its tip from one rest to that under the weight as it is a radian later, along axes of the table."""
    weights = [9.81 * Rotation.from_rotvec(-angle * AXIS).apply(ACROSS) for angle in (0.0, 1.0)]
    with pytest.warns(UserWarning, match="no steady rotation") as told:
        now, later = (np.array(list(static_response(blade(10.0, gravity=weight)).values())) for weight in weights)
    assert f"rest up to {np.linalg.norm(later - now):.3g} m elsewhere on it" in str(told[0].message)


@pytest.mark.filterwarnings("ignore:body 'bar'", "ignore:under the spin")
def test_a_charge_that_leaks_is_drained_at_the_start():
    """The blade is deflected as with its port short, and no voltage is left to leak."""
    scene = blade(10.0, stiffness=1e5)
    bar = scene.bodies[2]
    port = PortCoupling("stack", np.random.default_rng(2).standard_normal(len(bar.reduced.mass_matrix)), 1e-3)
    bar = replace(bar, reduced=replace(bar.reduced, readouts={"stack": port}))
    short = replace(scene, bodies=(*scene.bodies[:2], bar, scene.bodies[3]))
    leaky, kept = (
        replace(short, sensors=(*scene.sensors, VoltageSensor("voltage", "bar.stack", *resistance)))
        for resistance in ((1e3,), ())
    )
    record = run(leaky, 0.01, 2e-4)
    expected = run(short, 0.01, 2e-4).values[:, 0]
    size = np.abs(expected).max()
    np.testing.assert_allclose(record.values[:3, 0], expected, rtol=0, atol=1e-7 * size)
    assert np.ptp(record.values[:3], axis=1).max() < 1e-4 * size
    assert np.abs(record["voltage"]).max() < 1e-4 * np.abs(run(kept, 0.01, 2e-4)["voltage"]).max()


def test_either_side_of_a_spindle_may_be_the_one_that_stands():
    """A drive turns b against a: with the ground as b, what turns is a, the other way."""
    ground = RigidBody("ground", {"p": np.zeros(3)}, fixed=True)
    block = RigidBody("block", {"p": np.zeros(3)}, 2.0, np.diag([0.02, 0.03, 0.04]))
    for ends, sign in ((("ground.p", "block.p"), 1.0), (("block.p", "ground.p"), -1.0)):
        hinge = revolute("hinge", *ends, (0.6, 0.0, 0.8))
        twist = steady_rotation_twists(
            Scene("r", (ground, block), (hinge,), (Drive("motor", "hinge", "rz", speed=3.0),))
        )["block"]
        np.testing.assert_allclose(twist[3:], sign * 3.0 * np.array([0.6, 0.0, 0.8]))
