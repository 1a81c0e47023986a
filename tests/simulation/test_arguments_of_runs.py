"""Every optional argument of the verbs that run a scene: what it is by default, and that it changes what it should."""

from dataclasses import replace

import numpy as np
import pytest
from arguments import assert_all_tried
from conftest import lattice
from test_large_motion import GRAVITY, INERTIA, NORMAL, SKEWED, ground
from test_rotors import AXIS, rigid_machine

import nassim.simulation
from nassim import (
    Drive,
    Encoder,
    FlexibleBody,
    Geophone,
    Joint,
    LinearModel,
    Loop,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    describe,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.plotting import plot_time_history
from nassim.scene.joints import prismatic, revolute
from nassim.scene.springs import Bushing
from nassim.simulation import (
    Simulation,
    assemble,
    exudyn_eigenfrequencies,
    integrator_error,
    linearize_closed,
    loaded_state,
    mode_motion,
    numerical_damping,
    period_errors,
    scene_modes,
    simulate_motion,
    spinning_equilibrium,
)
from nassim.systems import loop_at_a_time, margins, relative_gain_array, sensitivity, singular_values
from nassim.systems.controllers import Controller
from nassim.viewer import save_picture, view_motion, write_page

STEP = 1e-3
PLACE = np.array([0.05, -0.02, 0.03])


@pytest.fixture(scope="module")
def scene():
    """In small motion: a mass on a guide and a spring under weight, a bar clamped beside it."""
    bar = craig_bampton(lattice(stiffness=3e4), n_modes=1, progress=False)
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 2.0, INERTIA, rotation=SKEWED)
    beside = FlexibleBody("bar", bar, PLACE - SKEWED @ bar.point("left").position, SKEWED, fidelity="linear")
    return Scene(
        "mass",
        (ground(o=np.zeros(3), b=PLACE), mass, beside),
        (prismatic("guide", "ground.o", "mass.c", NORMAL), Joint("clamp", "ground.b", "bar.left")),
        (PointForce("push", "mass.c", NORMAL, "push"),),
        (Encoder("x", "ground.o", "mass.c", NORMAL), Encoder("y", "ground.o", "bar.right", "y")),
        (SpringDamper("spring", "ground.o", "mass.c", NORMAL, 2.0 * (2 * np.pi * 40.0) ** 2),),
        gravity=GRAVITY,
        damping_ratio=0.0,
    )


TIME = STEP * np.arange(61)
PUSH = TimeHistory(TIME, [50 * np.sin(2 * np.pi * 30 * TIME) ** 2], ("push",), ("N",))
OPTIONS = [
    {"duration": 0.04},
    {"outputs": ["y"]},
    {"method": "exact"},
    {"spectral_radius": 0.3},
    {"method": "exact", "hold_order": 0},
    {"start": "released"},
    {"period_correction": False},
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_all_runs_heed_every_option(scene, options):
    """Those with motion, and those step by step, give the same record, and the motion is the record's."""
    record = simulate(scene, PUSH, time_step=STEP, progress=False, **options)
    again, motion = simulate_motion(scene, PUSH, time_step=STEP, frames=5, progress=False, **options)
    assert again.names == record.names
    np.testing.assert_allclose(again.values, record.values, rtol=1e-12, atol=1e-15)
    if "x" in record.names:
        moved = motion.positions["mass"] @ NORMAL
        np.testing.assert_allclose(moved, record["x"][:: (len(record.time) - 1) // 4], rtol=1e-9, atol=1e-12)
    if not {"duration", "outputs"} & set(options):
        with Simulation(scene, time_step=STEP, **options) as run:
            for value in PUSH.values[0, 1:]:
                run.step({"push": value})
        np.testing.assert_allclose(run.record.values, record.values, rtol=1e-12, atol=1e-15)
    others = {key: value for key, value in options.items() if key not in list(options)[-1:]}
    plain = simulate(scene, PUSH, time_step=STEP, progress=False, **others)
    if plain.values.shape == record.values.shape:
        assert np.abs(plain.values - record.values).max() > 1e-4 * np.abs(plain.values[1]).max()
    else:
        assert {"duration", "outputs"} & set(options)
        assert record.time[-1] == options.get("duration", TIME[-1])
        assert record.names == ("push", *options.get("outputs", ["x", "y"]))


def test_the_defaults(scene):
    defaults = {"method": "generalized_alpha", "spectral_radius": 1.0, "start": "equilibrium", "duration": TIME[-1]}
    default = simulate(scene, PUSH, time_step=STEP, progress=False)
    given = simulate(scene, PUSH, time_step=STEP, progress=False, outputs=["x", "y"], **defaults)
    assert default.names == given.names
    np.testing.assert_array_equal(default.values, given.values)
    straight, held = (
        simulate(scene, PUSH, time_step=STEP, method="exact", progress=False, hold_order=order) for order in (1, 0)
    )
    exact = simulate(scene, PUSH, time_step=STEP, method="exact", progress=False)
    np.testing.assert_array_equal(exact.values, straight.values)
    assert np.any(exact.values != held.values)


@pytest.mark.parametrize("verb", [simulate, simulate_motion])
@pytest.mark.parametrize("progress", [True, False, None])
def test_progress_is_shown_unless_it_is_not_wanted(scene, verb, progress, capfd):
    options = {} if progress is None else {"progress": progress}
    verb(scene, PUSH, time_step=STEP, **options, **({"frames": 2} if verb is simulate_motion else {}))
    assert bool("".join(capfd.readouterr())) == (progress is not False)


def pendulum(**parts):
    """A point mass 0.2 m outside a hinge along z, which is 0.3 m beside the origin, with a loop that does nothing."""
    bodies = (
        ground(o=(0.3, 0, 0)),
        RigidBody("bob", {"o": (-0.2, 0, 0), "c": (0, 0, 0)}, 2.0, 1e-12 * np.eye(3), (0.5, 0, 0)),
    )
    hinge = revolute("hinge", "ground.o", "bob.o", "z")
    pushes, reads = (PointForce("push", "bob.c", "y", "push"),), (Encoder("y", "ground.o", "bob.c", "y"),)
    return Scene("pendulum", bodies, (hinge,), pushes, reads, loops=(Loop("idle", IDLE, "y", "push"),), **parts)


IDLE = Controller(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]], 1e4)


@pytest.mark.parametrize(
    ("options", "radius"),
    [({}, 0.3), ({"axis_point": (0.1, 0, 0)}, 0.2), ({"axis_point": (0, 0.3, 0)}, np.nan)],
    ids=["origin", "along", "aside"],
)
def test_a_pendulum_on_a_table_swings_about_the_given_axis(options, radius):
    """At W sqrt(r / l), in closed loops and in pictures; with the axis aside it does not rest as drawn."""
    spin = {"angular_velocity": (0, 0, 7.0), **options}
    if np.isnan(radius):
        with pytest.raises(ValueError, match="the spin, body 'bob' comes to rest rotated"):
            linearize_closed(pendulum(), **spin)
        return
    expected = 7.0 * np.sqrt(radius / 0.2)
    assert np.abs(linearize_closed(pendulum(), **spin).poles() - 1j * expected).min() < 1e-6 * expected
    assert mode_motion(pendulum(), 1, **spin)[0] == pytest.approx(1j * expected, rel=1e-6)


def test_modes_as_motion_do_not_depend_on_sensors_and_forces():
    """Along axes of the world on a turntable, which have no linear model, or with filters that have their own poles."""
    table = RigidBody("table", {"o": np.zeros(3)}, 1.0, np.diag([1.0, 1.0, 1.5]))
    mass = RigidBody("mass", {"o": np.zeros(3)}, 1.0, np.diag([2.0, 3.0, 4.0]))
    slides = Joint("slides", "table.o", "mass.o", ("x", "y"))
    springs = [SpringDamper(f"k{a}", "table.o", "mass.o", a, 1.0, 0.05, frame="table.o") for a in "xy"]
    motor = Drive("motor", "spindle", speed=0.7)
    joints = (revolute("spindle", "ground.o", "table.o", "z"), slides)
    plain = Scene(
        "platform", (ground(o=np.zeros(3)), table, mass), joints, (motor,), springs=springs, damping_ratio=0.0
    )
    probe = Geophone("probe", "mass.o", "x", corner_frequency=0.01, sensitivity=1.0, bandwidth=0.02, order=2)
    seen = (Encoder("x", "ground.o", "mass.o", "x"), probe)
    scene = replace(plain, sensors=seen, actuators=(motor, PointForce("push", "mass.o", "x", "push")))
    with pytest.raises(ValueError, match=r"changes by|rotor"):
        linearize(scene)
    (pole, motion), (expected, same) = mode_motion(scene, 1), mode_motion(plain, 1)
    assert pole == pytest.approx(expected, rel=1e-12)
    assert np.abs(linearize(plain).poles() - pole).min() < 1e-9
    np.testing.assert_allclose(motion.positions["mass"], same.positions["mass"], rtol=0, atol=1e-15)


@pytest.mark.parametrize("loaded", [True, False])
def test_weight_in_closed_loops_is_optional(loaded):
    """It swings, or moves freely."""
    model = linearize_closed(pendulum(gravity=(9.81, 0, 0)), loaded=loaded)
    assert np.abs(model.poles() - 1j * loaded * np.sqrt(9.81 / 0.2)).min() < 1e-4


def test_a_number_of_modes(scene):
    every, few = exudyn_eigenfrequencies(scene), exudyn_eigenfrequencies(scene, n_modes=2)
    np.testing.assert_array_equal(few, every[:2])
    assert len(every) > 2
    frequency, shapes = scene_modes(scene)
    first, some = scene_modes(scene, n=2)
    np.testing.assert_array_equal(first, frequency[:2])
    assert some["mass"].shape == (6, 2)
    assert shapes["mass"].shape == (6, len(frequency))
    _, default = mode_motion(scene, 1)
    _, motion = mode_motion(scene, 1, frames=7)
    assert len(motion.time) == 7
    assert len(default.time) == 48


def test_inputs_of_statics(scene):
    """x = (F + m g . n) / k."""
    stiffness = 2.0 * (2 * np.pi * 40.0) ** 2
    weight = 2.0 * GRAVITY @ NORMAL
    assert static_response(scene)["x"] == pytest.approx(weight / stiffness, rel=1e-9)
    assert static_response(scene, {"push": 30.0})["x"] == pytest.approx((weight + 30.0) / stiffness, rel=1e-9)


def test_the_spectral_radius_of_errors(scene):
    """The rule's own error by default at 1: arctan; at another radius it damps."""
    angle = 2 * np.pi * 40.0 * STEP
    longer, damping = integrator_error(40.0, STEP)
    assert longer == pytest.approx(angle / (2 * np.arctan(angle / 2)) - 1, rel=1e-9)
    assert damping == 0.0
    assert integrator_error(40.0, STEP, spectral_radius=0.5)[1] > 1e-4
    default, one, half = (
        period_errors(scene, 4e-3, **options) for options in ({}, {"spectral_radius": 1.0}, {"spectral_radius": 0.0})
    )
    np.testing.assert_array_equal(default, one)
    assert np.any(np.abs(default - half) > 1e-6)
    assert not numerical_damping(scene, 4e-3).any()
    assert numerical_damping(scene, 4e-3, spectral_radius=0.5).max() > 1e-4


def test_what_stands_and_whose_frame_in_closed_loops_and_at_rest():
    """A loop that does nothing leaves the poles of the scene; a load that stands beside the axis is not flung out."""
    scene, spin = rigid_machine(40.0, k=(4e5, 4e5), arms=3)
    scene = replace(
        scene,
        actuators=(PointForce("push", "foundation.low", AXIS, "push"),),
        sensors=(Encoder("lift", "ground.top", "foundation.low", AXIS),),
        loops=(Loop("idle", IDLE, "lift", "push"),),
    )
    for frame in ("rotor", "stator"):
        expected = linearize(scene, **spin, frame=frame).poles()
        found = linearize_closed(scene, **spin, frame=frame).poles()
        assert max(np.abs(found - pole).min() for pole in expected) < 1e-5

    place = np.array([0.1, 0.0, 0.0])
    bodies = (
        ground(o=np.zeros(3), side=place),
        RigidBody("load", {"c": (0, 0, 0)}, 2.0, INERTIA, place),
        RigidBody("rotor", {"c": (0, 0, 0)}, 3.0, np.diag([2e-3, 2e-3, 3e-3])),
    )
    machine = Scene(
        "machine",
        bodies,
        (prismatic("guide", "ground.side", "load.c", "x"),),
        sensors=(Encoder("x", "ground.side", "load.c", "x"),),
        springs=(
            SpringDamper("spring", "ground.side", "load.c", "x", 1e5, frame="ground.side"),
            Bushing("bearing", "ground.o", "rotor.c", [1e6, 1e6, 1e6, 100.0, 100.0, 0.0]),
        ),
        damping_ratio=0.0,
    )
    turning = {"angular_velocity": (0, 0, 30.0), "frame": "stator"}
    flung = spinning_equilibrium(machine, angular_velocity=(0, 0, 30.0))["x"]
    assert flung == pytest.approx(2.0 * 900.0 * 0.1 / (1e5 - 2.0 * 900.0), rel=1e-9)
    assert spinning_equilibrium(machine, **turning, stator=("ground", "load"))["x"] == pytest.approx(0.0, abs=1e-15)
    with pytest.raises(ValueError, match="load"):  # what stands is not the same in all directions
        spinning_equilibrium(machine, angular_velocity=(0, 0, 30.0), stator=("ground", "load"))
    push = PointForce("push", "load.c", "x", "push")
    looped = replace(machine, actuators=(push,), loops=(Loop("idle", IDLE, "x", "push"),))
    for stands, square in ((None, 5e4 - 900.0), (("ground", "load"), 5e4)):
        poles = linearize_closed(looped, **turning, stator=stands).poles()
        assert np.abs(poles - 1j * np.sqrt(square)).min() < 1e-5


def test_a_spin_about_an_axis_and_loads_beyond_small_motion():
    """sqrt(m) W^2 (x - a) on a mode of unit mass; a pendulum that its weight would turn by 0.4 rad."""
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 4.0, INERTIA, (0.5, 0, 0))
    bodies = (ground(o=(0.5, 0, 0)), mass)
    guided = assemble(Scene("guided", bodies, (prismatic("guide", "ground.o", "mass.c", "x"),)))
    spin = {"angular_velocity": (0, 0, 7.0)}
    assert abs(loaded_state(guided, **spin).force[0]) == pytest.approx(2.0 * 49.0 * 0.5)
    assert abs(loaded_state(guided, **spin, axis_point=(0.2, 9.0, 9.0)).force[0]) == pytest.approx(2.0 * 49.0 * 0.3)
    tilted = Bushing("tilted", "ground.o", "mass.c", [0, 0, 0, 1.0, 1.0, 1.0])
    eccentric = replace(mass, points={"c": (0, 0, 1.0)}, position=(0.5, 0, -1.0))
    joint = Joint("hinge", "ground.o", "mass.c", free=("ry",))
    hung = assemble(Scene("hung", (bodies[0], eccentric), (joint,), springs=(tilted,)))
    with pytest.raises(ValueError, match="body 'mass'"):
        loaded_state(hung, gravity=(0.1, 0, 0))
    assert loaded_state(hung, gravity=(0.1, 0, 0), checked=False).force.any()


def places(file, **tests):
    """Where arguments are tried: a test of a file, and "verb: argument argument" of each."""
    return {
        f"{verb}: {argument}": f"simulation/{file}.py::test_{test}"
        for test, rows in tests.items()
        for verb, _, names in (row.partition(": ") for row in rows)
        for argument in names.split()
    }


OF_RUNS = "method spectral_radius hold_order start period_correction"
TRIED = {
    **places(
        "test_arguments_of_runs",
        all_runs_heed_every_option=[
            f"simulate: duration outputs {OF_RUNS}",
            f"simulate_motion: duration outputs {OF_RUNS}",
            f"Simulation: {OF_RUNS}",
            "step: inputs",
        ],
        progress_is_shown_unless_it_is_not_wanted=["simulate: progress", "simulate_motion: progress"],
        the_spectral_radius_of_errors=[
            f"{verb}: spectral_radius" for verb in ("integrator_error", "period_errors", "numerical_damping")
        ],
        a_number_of_modes=["scene_modes: n", "exudyn_eigenfrequencies: n_modes", "mode_motion: frames"],
        a_pendulum_on_a_table_swings_about_the_given_axis=[
            f"{verb}: angular_velocity axis_point" for verb in ("mode_motion", "linearize_closed")
        ],
        weight_in_closed_loops_is_optional=["linearize_closed: loaded"],
        what_stands_and_whose_frame_in_closed_loops_and_at_rest=[
            "linearize_closed: stator frame",
            "spinning_equilibrium: angular_velocity stator frame",
        ],
        inputs_of_statics=["static_response: inputs"],
        a_spin_about_an_axis_and_loads_beyond_small_motion=["loaded_state: angular_velocity axis_point checked"],
    ),
    **places(
        "test_stepping",
        inputs_keep_their_value_and_start_where_told=["Simulation: inputs"],
        steps_in_large_motion_with_filters_amplifiers_and_drives=["Simulation: input_rates"],
    ),
    **places("test_path_steps", steps_along_a_path_one_by_one_are_those_of_a_whole_run=["Simulation: path"]),
    **places(
        "test_loaded_states",
        gravimeter=["linearize: loaded", "loaded_state: stress", "Assembly: loads"],
        all_engines_have_the_same_frequencies_under_load=["exudyn_eigenfrequencies: loaded"],
        a_blade_that_runs_up_stiffens_in_time=["simulate: stress"],
        runs_stepped_one_by_one_have_the_same_present_stress=["Simulation: stress"],
        present_stress_is_refused_where_nothing_follows_it=["simulate_motion: stress"],
        runs_under_constant_inputs_are_about_their_equilibrium=[
            "simulate: constant_inputs",
            "simulate_motion: constant_inputs",
            "Simulation: constant_inputs",
        ],
        buckling_factors_of_columns=["buckling_factors: n inputs"],
        constant_inputs_soften_as_they_press=["linearize: constant_inputs", "linearize_closed: constant_inputs"],
        forces_of_joints_and_springs_balance_the_loads=["loaded_equilibrium: inputs"],
        constant_voltages_load_a_body=["loaded_state: inputs", "LoadedState: stress"],
        a_port_with_a_resistance_has_no_voltage_at_rest=["loaded_state: gravity"],
    ),
    **places("test_spinning_exact_steps", a_hexapod_with_six_loops_turns_as_in_floating_frames=["Assembly: rotation"]),
    **places(
        "test_rest",
        a_machine_of_rigid_bodies_about_its_equilibrium=["LoadedState: on_all offset output_offsets"],
    ),
    **places(
        "test_bent_bodies",
        columns_buckle_beside_a_force_across_them=["loaded_state: shape"],
        a_column_that_a_drive_presses=["loaded_state: moved"],
    ),
    **places("test_voice_coil", at_rest_the_resistance_limits_the_current=["LoadedState: given"]),
    **places("test_rigid_groups", loads_on_carried_bodies_stiffen_what_carries_them=["LoadedState: carried"]),
    **places(
        "test_stress_outputs",
        a_limit_gives_the_largest_force_beside_the_weight=["load_limit: inputs place"],
        the_weight_stresses_a_hanging_bar=["static_motion: gravity"],
        a_spin_stresses_a_bar_by_its_own_mass=[
            "load_limit: angular_velocity axis_point",
            "static_motion: angular_velocity axis_point",
        ],
        optional_arguments_of_sensors_and_peaks=["load_limit: voltages", "static_motion: inputs"],
        the_error_of_the_modes_left_out_is_in_pascal=["truncation_error: relative"],
    ),
    **places(
        "test_stress_convergence",
        a_fillet_stands=["stress_convergence: inputs place tolerance n_spots"],
        spins_and_voltages_are_loads_too=["stress_convergence: angular_velocity axis_point voltages"],
        peaks_are_local=["stress_convergence: radius"],
    ),
    **places(
        "test_active_damping",
        damping_grows_with_the_gain_and_needs_the_delay=["linearize_closed: continuous delay_order"],
    ),
    **places(
        "test_hexapod_loops",
        loops_inside_and_outside_of_one_scene=["linearize_closed: loops"],
        noise_of_a_scenes_encoders_is_shared_by_its_loops=["linearize_closed: noise"],
    ),
    **places(
        "test_rotors",
        a_rigid_rotor_in_the_standing_frame=[
            "linearize: angular_velocity axis_point stator frame",
            "loaded_state: partition",
        ],
    ),
    **places(
        "test_spinning",
        equilibrium_of_the_platform=["spinning_equilibrium: axis_point"],
    ),
    **places("test_scene_body", a_cut_off_keeps_statics=["reduce_scene: passive cutoff_frequency"]),
    **places(
        "test_stopped_runs",
        a_run_that_fails_keeps_what_it_had=["SimulationError: record trusted_until"],
        an_interrupted_run_keeps_what_it_had=["SimulationInterrupted: record trusted_until"],
    ),
}


def test_every_optional_argument_is_tried():
    assert_all_tried(nassim.simulation, {}, TRIED)


MISTAKEN = {
    "a model for a scene": (lambda scene, model, frf: linearize(model), "scene must be a Scene, got .*LinearModel"),
    "a model to simulate": (
        lambda scene, model, frf: simulate(model, None, time_step=1e-3, duration=0.1),
        "scene must be a Scene",
    ),
    "a model at rest": (lambda scene, model, frf: static_response(model), "scene must be a Scene"),
    "a model to describe": (lambda scene, model, frf: describe(model), "scene must be a Scene"),
    "a scene for a view": (lambda scene, model, frf: write_page(scene, "a.html"), "view_scene, view_modes and others"),
    "a scene for a picture": (lambda scene, model, frf: save_picture(scene, "a.png"), "view_scene, view_modes and"),
    "a record for a motion": (
        lambda scene, model, frf: view_motion(scene, TimeHistory([0, 1], [[0, 1]], ["x"], ["m"])),
        "motion must be a Motion, got .*TimeHistory; simulate_motion returns one",
    ),
    "a response for a record": (lambda scene, model, frf: plot_time_history(frf), "history must be a TimeHistory"),
    "a model for a loop": (lambda scene, model, frf: margins(model), "loop must be a FRF, got .*; open_loop"),
    "both sensitivities": (
        lambda scene, model, frf: singular_values((frf, frf)),
        "got tuple; `sensitivity` returns two",
    ),
    "a pair for a loop": (lambda scene, model, frf: sensitivity((frf, frf)), "loop must be a FRF, got tuple"),
    "a pair for several loops": (lambda scene, model, frf: loop_at_a_time((frf, frf), "x"), "loop must be a FRF"),
    "a model for a plant": (lambda scene, model, frf: relative_gain_array(model), "plant must be a FRF, got .*Linear"),
}


@pytest.mark.parametrize("name", MISTAKEN)
def test_what_is_taken_for_another_kind_of_result_is_told(name):
    call, message = MISTAKEN[name]
    scene = Scene("free", (RigidBody("mass", {"o": [0, 0, 0]}, 1.0, np.eye(3)),))
    model = LinearModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ("u",), ("y",))
    with pytest.raises(ValueError, match=message):
        call(scene, model, frequency_response(model, [1.0]))
