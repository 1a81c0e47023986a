"""Every limit of a run's guards from both sides: at 0.9 of it nothing is told or refused, at 1.1 it is."""

import warnings
from dataclasses import replace

import exudyn as exu
import numpy as np
import pytest
from conftest import lattice
from test_large_motion import INERTIA, NORMAL, SKEWED, ground
from test_long_runs import ARM, wheel

from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    TimeHistory,
    craig_bampton,
    linearize,
)
from nassim.base.rigid_motion import axes_along
from nassim.scene.drives import Drive
from nassim.scene.joints import revolute
from nassim.scene.measures import Displacement
from nassim.scene.part import Sensor
from nassim.scene.terms import Output, OutputFilter
from nassim.signals.time_history import occupied_bandwidth
from nassim.simulation.exudyn.monitor import Monitor
from nassim.simulation.exudyn.steady_state import _growing
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.loaded.first_order_equilibrium import check_small
from nassim.simulation.loaded.spinning import warn_of_spinning_bodies
from nassim.simulation.model import axial_preload
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.damping import Damping
from nassim.simulation.model.digital_controllers import samples_per_period
from nassim.simulation.model.frame_dependence import frame_dependence
from nassim.simulation.model.motion_size import motion_sizes
from nassim.simulation.model.reach import Reach, find_reach
from nassim.simulation.model.runaway import see_runaway
from nassim.simulation.run import simulate as time_domain, warnings_of_runs
from nassim.simulation.run.checks import check_stability
from nassim.simulation.run.sampled_inputs import _check_loss, sample_excitation
from nassim.systems.controllers import Controller

SIDES = (0.9, 1.1)
IDLE = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]], 1e3, delay=0)


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=1, progress=False)


def clamped(bar, fidelity="ffrf", **parts):
    """The bar turned, held at its left end, with a rigid body at its right one."""
    left, right = (SKEWED @ bar.point(name).position for name in ("left", "right"))
    body = FlexibleBody("bar", bar, -left, SKEWED, fidelity=fidelity)
    load = RigidBody("load", {"c": (0, 0, 0)}, 0.5, INERTIA, right - left)
    joints = Joint("clamp", "ground.o", "bar.left"), Joint("mount", "bar.right", "load.c")
    return Scene("clamped", (ground(), body, load), joints, **parts)


def told(function, *arguments, **options):
    """How many warnings a call gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        function(*arguments, **options)
    return len(caught)


def both_sides(limit, tell, *, refused=None, says=None):
    """tell(value) warns by what `says` matches, or raises ValueError that matches, above the limit only."""
    below, above = (side * limit for side in SIDES)
    assert told(tell, below) == 0
    if refused is None:
        with pytest.warns(UserWarning, match=says) as found:
            tell(above)
        assert len(found) == 1
    else:
        with pytest.raises(ValueError, match=refused):
            tell(above)


def test_small_motion_holds_to_a_hundredth(bar):
    """Of rotation, but for a floating frame's own, and of deformation over size."""
    for fidelity in ("linear", "ffrf"):
        assembly = assemble(clamped(bar, fidelity))
        both_sides(0.01, lambda x, a=assembly: warnings_of_runs.warn_of_motion(a, {"bar": (0.0, x)}))
        both_sides(0.01, lambda x, a=assembly: warnings_of_runs.warn_of_motion(a, {"bar": (x, 0.0)}))
        both_sides(0.01, lambda x, a=assembly: warnings_of_runs.warn_of_motion(a, {"load": (x, 0.0)}))
    with pytest.warns(UserWarning, match="'load' turned by up to 0.03 rad.*, and 1 more turned far: give"):
        warnings_of_runs.warn_of_motion(assemble(clamped(bar, "linear")), {"bar": (0.02, 0.0), "load": (0.03, 0.0)})


def test_strain_may_depend_on_the_point_of_the_frame_by_a_hundredth(bar):
    """Which grows in proportion to the strain, of a bar that is held at both ends."""
    scene = clamped(bar)
    wall = RigidBody("wall", {"c": scene.point_position("load.c")}, fixed=True)
    scene = replace(scene, bodies=(*scene.bodies, wall), joints=(*scene.joints, Joint("stop", "wall.c", "load.c")))
    assembly = assemble(scene)
    shape = np.zeros(len(bar.mass_matrix))
    shape[6:12] = 0.01, 0.02, -0.03, 0.5, 0.7, -0.4
    unit = frame_dependence(assembly, scene.body("bar"), 1e-3 * shape) / 1e-3
    both_sides(
        0.01,
        lambda share: warnings_of_runs.warn_of_frames(assembly, {"bar": share / unit * shape}),
        says="strain of body 'bar' depends on the point that carries its frame, here 'left', by some 1.1 %",
    )


def test_ratios_of_modes_hold_to_a_tenth_of_motion_between_bodies(bar):
    """Of a radian, and of the size of the scene: the diagonal of the box around what moves."""
    assembly = assemble(clamped(bar, damping_ratio=0.01))
    left, right = np.zeros(3), SKEWED @ (bar.point("right").position - bar.point("left").position)
    centre = SKEWED @ (bar.center_of_mass - bar.point("left").position)
    size = np.linalg.norm(np.ptp([left, right, centre], axis=0))
    pair = ("bar", "load")
    both_sides(0.1, lambda x: warnings_of_runs.warn_of_changed_modes(assembly, {pair: np.array([x, 0.0])}))
    both_sides(0.1 * size, lambda x: warnings_of_runs.warn_of_changed_modes(assembly, {pair: np.array([0.0, x])}))
    undamped = assemble(clamped(bar, damping_ratio=0.0))
    assert told(warnings_of_runs.warn_of_changed_modes, undamped, {pair: np.array([1.0, 1.0])}) == 0


def turned_wheel(angle, system=None):
    """The system of a wheel that is turned on its hinge, and the part of its coordinates that are Euler parameters."""
    system = system or build_system(assemble(wheel()))
    data, first = system.mbs.systemData, system.mbs.GetNodeODE2Index(system.nodes["wheel"]) + 3
    place = slice(first, first + 4)
    positions = np.zeros(data.ODE2Size())
    turned = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * NORMAL])
    positions[place] = turned - data.GetODE2Coordinates(exu.ConfigurationType.Reference)[place]
    data.SetODE2Coordinates(positions)
    return system, place


def test_hinges_in_line_to_a_ten_millionth_are_one():
    """Of a body of equal moments of inertia: a second hinge whose axis is tilted by more locks it."""
    axes = axes_along(NORMAL)
    body = RigidBody("mass", {"c": (0, 0, 0)}, 1.0, 1e-3 * np.eye(3))

    def free(tilt):
        axis = axes[:, 2] + tilt * axes[:, 0]
        hinges = (revolute(name, "ground.o", "mass.c", a) for name, a in (("one", NORMAL), ("other", axis)))
        return len(assemble(Scene("mass", (ground(), body), tuple(hinges))).modal.frequency)

    assert [free(side * 1e-7) for side in SIDES] == [1, 0]


def test_an_equilibrium_is_far_from_a_tenth_of_a_radian_on():
    both_sides(0.1, lambda angle: warnings_of_runs.warn_of_far_equilibrium(turned_wheel(angle)[0]))


def test_stiffening_by_spin_is_told_from_a_thousandth_on(bar):
    """sqrt(1 + (rate / first)^2) - 1; of floating frames only, and once."""
    scene = clamped(bar)
    first = bar.eigenfrequencies(fixed=["left"])[0]

    def speed(share):
        return {"bar": 2 * np.pi * first * np.sqrt((1 + share) ** 2 - 1)}

    both_sides(1e-3, lambda share: warnings_of_runs.warn_of_spin(scene, speed(share)))
    assert told(warnings_of_runs.warn_of_spin, scene, speed(0.1), ["bar"]) == 0
    assert told(warnings_of_runs.warn_of_spin, clamped(bar, "linear"), speed(0.1)) == 0

    assembly = assemble(scene)
    rate = first * np.sqrt(1.0011**2 - 1)
    held = f"turns at {rate:.3g} Hz, its first frequency held at its frame is {first:.4g} Hz: .* by some 0.11 %"
    both_sides(1e-3, lambda x: warn_of_spinning_bodies(assembly, speed(x)["bar"] / (2 * np.pi), None, True), says=held)


def test_a_spinning_equilibrium_is_told_from_a_hundredth_on_and_refused_from_a_tenth(bar):
    assembly = assemble(clamped(bar))
    n = sum(place.stop - place.start for place in assembly.coordinates.slices.values())
    turned = np.zeros(n)
    turned[assembly.coordinates.slices["load"].start + 4] = 1.0
    both_sides(0.01, lambda x: check_small(assembly.coordinates, x * turned, "the spin"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_small(assembly.coordinates, 0.09 * turned, "the spin")
    with pytest.raises(ValueError, match="no small motion"):
        check_small(assembly.coordinates, 0.11 * turned, "the spin")
    assert told(check_small, assembly.coordinates, 0.3 * turned, "the spin", settled=True) == 0
    with pytest.raises(ValueError, match="no small motion"):
        check_small(assembly.coordinates, 0.33 * turned, "the spin", settled=True)
    stretched = np.zeros(n)
    stretched[assembly.coordinates.slices["bar"].start + 6] = 1.0
    stretched /= motion_sizes(assembly.coordinates, stretched[:, None])["bar"].max()
    both_sides(0.01, lambda x: check_small(assembly.coordinates, x * stretched, "the spin"))
    with pytest.raises(ValueError, match=r"deformed by 11 % of its size .* no small motion"):
        check_small(assembly.coordinates, 0.11 * stretched, "the spin")


def test_damping_that_is_lost_is_told_from_a_hundredth_on():
    """One body deforms by cos a and sin a in modes of 10 and 20 Hz: of the first mode's damping, P^2 is left.

    P = cos(a)^2 / (cos(a)^2 + sin(a)^2 / 2) is its own part of the projection with the weights of the frequencies.
    """

    def realised(lost):
        own = np.sqrt(1 - lost)
        cosine = np.sqrt(own / (2 - own))
        damping = Damping(
            frequency=np.array([10.0, 20.0]),
            shapes=np.eye(2),
            ratio=np.array([0.02, 0.0]),
            deformation=np.array([[cosine, np.sqrt(1 - cosine**2)]]),
            root=np.eye(1),
            own=np.zeros((1, 1)),
            dampers=np.zeros((2, 2)),
        )
        left = damping.of_deformation.non_modal[0, 0]
        assert left == pytest.approx((1 - lost) * 4 * np.pi * 0.02 * 10.0)

    both_sides(0.01, realised)


def test_preload_is_told_from_a_tenth_of_buckling_on(bar):
    assembly = assemble(clamped(bar))
    unit, _ = axial_preload.buckling_share(assembly, {"bar": np.array([-1.0])})
    assert unit > 0
    both_sides(
        0.1,
        lambda share: axial_preload.warn_of_buckling(assembly, {"bar": np.array([-share / unit])}),
        says=f"is 0.11 of its buckling load .* by up to some {100 * (1 - np.sqrt(0.89)):.2g} %",
    )


def test_estimated_stress_is_told_from_a_hundredth_of_a_frequency_on(bar):
    """In a body that does not hold its geometric stiffness, pulled along: the change is as large as the force."""
    push = PointForce("pull", "load.c", SKEWED @ (bar.point("right").position - bar.point("left").position), "pull")
    scene = replace(clamped(bar, actuators=(push,)), damping_ratio=0.0)

    def frequency(pull):
        return np.unique(linearize(scene, constant_inputs={"pull": pull}).poles().imag.round(9))[-8:]

    still, pulled = frequency(0.0), frequency(1e-3)
    unit = np.abs(pulled / still - 1).max() / 1e-3
    both_sides(0.01, lambda share: linearize(scene, constant_inputs={"pull": share / unit}))


def test_an_instability_is_rounding_below_a_ten_millionth_of_what_loads_stiffen():
    """A body that stands, so heavy to turn that it falls that much slower than another one swings."""

    def told_of(share):
        swing = RigidBody("swing", {"o": (0, 0, 0.1)}, 1.0, 1e-12 * np.eye(3), (1.0, 0, -0.1))
        stand = RigidBody("stand", {"o": (0, 0, -1e-3)}, 1.0, 1e3 / share * np.eye(3), (0, 0, 1e-3))
        hinges = revolute("one", "ground.o", "stand.o", "y"), revolute("other", "ground.p", "swing.o", "y")
        bodies = (ground(o=np.zeros(3), p=np.array([1.0, 0, 0])), swing, stand)
        linearize(Scene("both", bodies, hinges, gravity=(0, 0, -9.81)))

    both_sides(1.0, told_of)


def acceleration(cutoff=None, passes="low"):
    """A mass whose acceleration is read, through a filter."""
    body = RigidBody("mass", {"c": (0, 0, 0)}, 1.0, INERTIA)
    reading = Output("a", "m/s2", Displacement((("mass.c", NORMAL),)), derivative=2)

    class Accelerometer(Sensor):
        def terms(self, scene):
            filters = () if cutoff is None else (OutputFilter("a", passes, cutoff),)
            return (reading, *filters)

    return Scene("mass", (body,), sensors=(Accelerometer("a"),))


def test_accelerations_ring_above_a_radius_of_four_fifths():
    """Unless a low-pass below a tenth of the rate of steps takes that away."""
    told_radius = "spectral_radius 0.88 by .* take 0.8 or less"
    both_sides(0.8, lambda radius: warnings_of_runs.warn_of_ringing(acceleration(), radius, 1e-3), says=told_radius)
    both_sides(100.0, lambda corner: warnings_of_runs.warn_of_ringing(acceleration(corner), 1.0, 1e-3))
    assert told(warnings_of_runs.warn_of_ringing, acceleration(1.0, "high"), 1.0, 1e-3) == 1


def test_velocities_may_part_from_constraints_by_a_hundredth():
    """Of a body that has turned by more than a tenth of a radian since the run began at an angle of 0.4.

    The first look that sees it is told, and nothing from there on is to be trusted.
    """

    def drifts(turn, share):
        angle = 0.4 + turn
        system, place = turned_wheel(0.4)
        watch = Monitor(system)
        turned_wheel(angle, system)
        data = system.mbs.systemData
        along = (data.GetODE2Coordinates(exu.ConfigurationType.Reference) + data.GetODE2Coordinates())[place]
        rates = np.concatenate([[-np.sin(angle / 2)], np.cos(angle / 2) * NORMAL])
        speeds = np.zeros(data.ODE2Size())
        speeds[place] = 7.0 * (np.sqrt(1 - share**2) * rates + share * along)
        data.SetODE2Coordinates_t(speeds)
        watch.look(1)
        watch.look(2)
        said = watch.describe_drift(1e-3, 0.9)
        drifting = "from t = 0.001 s on" in said
        turns = "it turns by up to 0.014 rad in a step, and a spectral_radius of 0.9 holds for 0.11 rad"
        assert (turns in said) == drifting  # 14 rad/s
        assert watch.valid.last == 2 * (not drifting)
        return drifting

    assert [drifts(1.0, side * 0.01) for side in SIDES] == [False, True]
    assert [drifts(side * 0.1, 0.5) for side in SIDES] == [False, True]


def test_a_run_is_lost_at_its_bounds(bar):
    """Of rotation and of deformation: a tenth with a loop, whole ones without; to be trusted up to a hundredth."""
    plain = clamped(bar, "linear", actuators=(PointForce("push", "load.c", "z", "push"),))
    plain = replace(plain, sensors=(Encoder("z", "ground.o", "load.c"),))
    looped = replace(plain, loops=(Loop("idle", IDLE, "z", "push"),))
    for scene, bound in ((plain, 1.0), (looped, 0.1)):
        system = build_system(assemble(scene))
        carried = system.flexible["bar"].coordinates @ system.selection("bar")
        unit = np.zeros(carried.shape[1])
        unit[int(np.argmax(np.abs(carried[6 + 3])))] = 1.0  # of what turns the right end
        data = system.mbs.systemData

        def look(size, system=system, data=data, unit=unit):
            watch = Monitor(system)
            data.SetODE2Coordinates(size * unit)
            watch.look(1)
            return watch

        scale = 1.0 / max(float(sizes.max()) for sizes in look(1e-3).largest.values()) * 1e-3
        assert [bool(look(side * bound * scale).lost) for side in SIDES] == [False, True]
        assert [look(side * 0.01 * scale).valid.last for side in SIDES] == [1, 0]
        swapped = build_system(assemble(replace(scene, bodies=scene.bodies[::-1])))
        watch = look(1e3 * scale, swapped, swapped.mbs.systemData, np.random.default_rng(0).standard_normal(len(unit)))
        assert list(watch.largest) == ["load", "bar"]
        assert [name for name, _ in watch.lost] == ["bar", "load"]  # the one that is farthest beyond its bound first

    assembly = assemble(looped)
    reach = Reach(1.0, np.zeros(2), {"bar": 1.0, "load": 1.0})
    turned = np.zeros(assembly.coordinates.size)
    turned[assembly.coordinates.slices["load"].start + 4] = 1.0

    def seen(share):
        return see_runaway(assembly.coordinates, reach, share * turned, 1)

    assert [bool(seen(side * 0.1)[0]) for side in SIDES] == [False, True]
    assert [seen(side * 0.01)[1] for side in SIDES] == [True, False]


def test_a_body_may_get_ten_times_as_far_as_a_force_drives_it_when_it_is_free():
    """f t^2 / (2 m), beside the size of the scene."""
    ground = RigidBody("ground", {"p": (0, 0, 0)}, fixed=True)
    block = RigidBody("block", {"p": (0, 0, 0)}, 4.0, INERTIA, (0.3, 0.4, 0.0))
    pushed = Scene("pushed", (ground, block), actuators=(PointForce("f", "block.p", (0.6, 0, 0.8), "f"),))
    reach = find_reach(assemble(pushed), np.full((1, 4001), 6.0), 1e-3)
    assert reach.at(4000)["block"] - reach.size == pytest.approx(10 * 6.0 * 4.0**2 / (2 * 4.0), rel=1e-3)
    assert reach.size == pytest.approx(0.5 + np.sqrt(np.trace(INERTIA) / 4.0))


def test_the_explicit_rule_is_refused_beyond_its_limit(bar):
    scene = clamped(bar, "linear")
    fastest = assemble(scene).modal.frequency[-1]
    limit = 2.6 / (2 * np.pi * fastest)
    both_sides(
        limit,
        lambda h: check_stability(scene, h),
        refused=f"explicit rule's limit of {limit:.3g} s, set by the fastest pole of {fastest:.4g} Hz",
    )


def test_samples_fall_on_steps_within_a_millionth():
    loop = Loop("idle", IDLE, "y", "u")
    both_sides(
        1e-6,
        lambda off: samples_per_period(loop, 1e-3 / (4 * (1 + off))),
        refused="every 4 time steps of .* take time_step = 0.001 s over a whole number",
    )


def test_excitations_have_eight_steps_a_period_and_lose_two_hundredths():
    body = RigidBody("mass", {"c": (0, 0, 0)}, 1.0, INERTIA)
    scene = Scene("mass", (body,), actuators=(PointForce("force", "mass.c", "z", "force"),))
    fine = np.arange(40001) * 1e-5
    sine = TimeHistory(fine, np.sin(2 * np.pi * 25.0 * fine)[None], ("force",), ("N",))
    limit = 1 / (8 * occupied_bandwidth(sine))
    both_sides(
        limit,
        lambda h: sample_excitation(scene, sine, time_step=h, duration=None),
        refused=rf"up to {25 + 1 / 0.4:g} Hz; take at most {1 / (8 * 27.5):.3g} s \(8 steps per period\)",
    )

    # A sine about any mean, and a pulse of one sample between two steps: straight lines lose the pulse.
    slow = np.sin(2 * np.pi * 2.5 * fine)

    def pulsed(share, mean):
        pulse = np.zeros(len(fine))
        pulse[20050] = np.sqrt(share / (1 - share) * np.sum(slow**2))
        signals = [mean + slow, mean + slow + pulse]
        _check_loss(TimeHistory(fine, signals, ("slow", "pulsed"), ("N", "N")), 1e-3, fine[-1])

    for mean in (0.0, 30.0):
        both_sides(0.02, lambda share, m=mean: pulsed(share, m), refused="lose 2.2 % of the power of 'pulsed'")


@pytest.mark.parametrize(("time_step", "good"), [(7e-4, "0.0005"), (2.5e-3, "0.001")])
def test_a_step_that_loses_power_is_told_a_multiple_or_a_fraction_of_the_sample_time(time_step, good):
    time = np.arange(101) * 1e-3
    spiky = TimeHistory(time, [(np.arange(101) % 7 == 3) + 0.01 * time], ("force",), ("N",))
    with pytest.raises(ValueError, match=f"; take at most {good} s or filter it"):
        _check_loss(spiky, time_step, time[-1])


def test_a_step_that_loses_power_of_a_sine_is_told_the_longest_one():
    """Straight lines lose (omega h)^4 / 120 of it: 1.5 % over 7 samples, 2.6 % over 8."""
    time = np.arange(1001) * 1e-3
    sine = TimeHistory(time, [np.sin(166.0 * time)], ("force",), ("N",))
    with pytest.raises(ValueError, match=r"take at most 0\.007 s or filter it"):
        _check_loss(sine, 0.0123, time[-1])


def test_a_drive_starts_at_speed_when_it_goes_on_within_a_thousandth():
    table = RigidBody("table", {"o": -ARM}, 0.7, INERTIA, ARM)
    scene = Scene(
        "table",
        (ground(), table),
        (revolute("spindle", "ground.o", "table.o", NORMAL),),
        (Drive("motor", "spindle", "rz", "angle"),),
    )

    def steady(change):
        signals = {"angle": 1e-3 * 5.0 * np.array([0.0, 1.0, 2.0 + change])}
        return time_domain._starting_rates(scene, signals, 1e-3)[1]["angle"]

    assert [steady(side * 1e-3) for side in SIDES] == [pytest.approx(5.0), 0.0]


def test_a_linear_model_about_rest_warns_of_rotors():
    """A body's own angular velocity would give gyroscopic moments, which only a drive or a spinning scene gives."""
    rotor = RigidBody("rotor", {"axle": np.zeros(3)}, 2.0, np.diag([0.1, 0.1, 0.2]), angular_velocity=(0, 0, 30.0))
    stand = RigidBody("stand", {"axle": np.zeros(3)}, fixed=True)
    bearing = Bushing("bearing", "stand.axle", "rotor.axle", [1e5, 1e5, 1e5, 1e3, 1e3, 0.0])
    scene = Scene("spindle", (stand, rotor), springs=(bearing,))
    with pytest.warns(UserWarning, match="body 'rotor' of scene 'spindle' has an angular_velocity, whose gyroscopic"):
        linearize(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linearize(replace(scene, bodies=(stand, replace(rotor, angular_velocity=(0, 0, 0)))))
        linearize(scene, angular_velocity=(0, 0, 30.0))


def test_the_fastest_of_several_growing_motions_comes_first():
    """One of each pair, without those that fade or grow by rounding."""
    pairs = np.array([0.2 + 3.0j, 0.9 + 1.0j, -1.0 + 5.0j, 1e-9 + 7.0j])
    found = _growing(np.concatenate([pairs, pairs.conj(), [0.5]]), 1.0)
    assert [one.growth_rate for one in found] == [0.9, 0.5, 0.2]
    assert [2 * np.pi * one.frequency for one in found] == pytest.approx([1.0, 0.0, 3.0])
