"""Damping that belongs to bodies: stated ratios in every fidelity, the same wherever a machine stands."""

import warnings
from dataclasses import replace

import exudyn as exu
import numpy as np
import pytest
import scipy.linalg
from conftest import angular_momentum, lattice, turn

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    VoltageSensor,
    craig_bampton,
    linearize,
    load,
    save,
    simulate,
)
from nassim.base.modal import decay_poles
from nassim.bodies.readouts import BodyDamping
from nassim.simulation.exudyn.solver import solve_dynamic
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.description import describe
from nassim.simulation.model.ties import tied_bodies

INERTIA = np.array([[4e-6, 5e-7, -3e-7], [5e-7, 5e-6, 4e-7], [-3e-7, 4e-7, 3e-6]])
HAND = 0.05
DRAWN = 0.3
"""Angle at which the elbow is drawn [rad]."""


OBLIQUE = turn([1.0, -2.0, 0.5], 1.1)


@pytest.fixture(scope="module")
def bar():
    """A free lattice, its lowest clamped frequency 122 Hz."""
    return craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)


def base(**points):
    return RigidBody("base", {"o": np.zeros(3), **points}, fixed=True)


def clamped(bar, ratio, *, fidelity="linear", **options):
    """A bar in an odd position, held at its left end."""
    body = FlexibleBody("bar", bar, -OBLIQUE @ bar.point("left").position, OBLIQUE, fidelity, damping_ratio=ratio)
    return Scene("clamped", (base(), body), (Joint("clamp", "base.o", "bar.left"),), **options)


def elbow(bar, ratio, *, angle=DRAWN, fidelities=("ffrf", "ffrf"), free="rz", **options):
    """Two bars and a hand on the second one, the first clamped, all turned as one about an odd axis."""
    left, right = (OBLIQUE @ bar.point(name).position for name in ("left", "right"))
    bend = turn([0, 0, 1.0], angle)
    bodies = (
        base(),
        FlexibleBody("upper", bar, -left, OBLIQUE, fidelities[0], damping_ratio=ratio),
        FlexibleBody("lower", bar, right - left - bend @ left, bend @ OBLIQUE, fidelities[1], damping_ratio=ratio),
        RigidBody("hand", {"o": np.zeros(3)}, HAND, bend @ INERTIA @ bend.T, right - left + bend @ (right - left)),
    )
    joints = (
        Joint("shoulder", "base.o", "upper.left"),
        Joint("elbow", "upper.right", "lower.left", free=free),
        Joint("wrist", "lower.right", "hand.o"),
    )
    pushes = tuple(PointForce(f"push {axis}", "hand.o", axis, f"f{axis}") for axis in "yz")
    encoders = tuple(Encoder(axis, "base.o", "hand.o", axis) for axis in "xyz")
    return Scene("elbow", bodies, joints, pushes, encoders, **options)


def by_frequency(poles):
    poles = poles[poles.imag > 1.0]
    return poles[np.argsort(np.abs(poles))]


def ratios(poles):
    return -poles.real / np.abs(poles)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_modes_of_a_clamped_body_have_its_ratios(bar, fidelity):
    scene = clamped(bar, (0.02, 0.005, 0.03), fidelity=fidelity)
    poles = by_frequency(linearize(scene).poles())
    np.testing.assert_allclose(np.abs(poles) / (2 * np.pi), bar.eigenfrequencies(fixed=["left"]), rtol=1e-9)
    np.testing.assert_allclose(ratios(poles), [0.02, 0.005, *[0.03] * (len(poles) - 2)], rtol=1e-8)
    trimmed = by_frequency(linearize(replace(scene, cutoff_frequency=500.0)).poles())
    assert len(trimmed) < len(poles)
    np.testing.assert_allclose(ratios(trimmed)[:4], [0.02, 0.005, 0.03, 0.03], rtol=1e-8)


def test_modes_of_a_free_body_have_its_ratios_wherever_its_frame_rides(bar):
    soft = SpringDamper("soft", "base.o", "bar.left", (0.3, -1.0, 0.5), 1e-9)
    for frame, springs in (("left", ()), ("right", ()), ("left", (soft,))):
        body = FlexibleBody("bar", bar, rotation=OBLIQUE, frame=frame, damping_ratio=(0.02, 0.01))
        assembly = assemble(Scene("free", (base(), body), springs=springs))
        found = assembly.modal.damping.of_modes
        omega = 2 * np.pi * assembly.modal.frequency
        expected = np.concatenate([np.zeros(6), [0.04], np.full(len(omega) - 7, 0.02)]) * omega
        np.testing.assert_allclose(found, np.diag(expected), atol=1e-8 * expected.max())


def test_a_mass_on_a_clamped_bar_against_matrices_put_together_here(bar):
    """The damping is the clamped bar's, C = M V diag(2 zeta w) V^T M; a mass at its end changes the modes, not C."""
    mass, stiffness = bar.mass_matrix[6:, 6:], bar.stiffness_matrix[6:, 6:]
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    damping = mass @ shapes @ np.diag(2 * 0.02 * np.sqrt(squares)) @ shapes.T @ mass
    loaded = mass.copy()
    loaded[:6, :6] += scipy.linalg.block_diag(HAND * np.eye(3), OBLIQUE.T @ INERTIA @ OBLIQUE)
    n = len(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(loaded, np.hstack([stiffness, damping]))]])
    expected = by_frequency(np.linalg.eigvals(state))

    held = clamped(bar, 0.02)
    place = held.point_position("bar.right")
    hand = RigidBody("hand", {"o": np.zeros(3)}, HAND, INERTIA, place)
    scene = replace(held, bodies=(*held.bodies, hand), joints=(*held.joints, Joint("wrist", "bar.right", "hand.o")))
    found = by_frequency(linearize(scene).poles())
    assert ratios(expected)[0] < 0.018  # the mass makes it a slower mode
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_ratios_of_scene_and_body_add_up(bar):
    for options, expected in (({}, 0.02), ({"damping_ratio": 0.0}, 0.02), ({"damping_ratio": 0.03}, 0.05)):
        poles = by_frequency(linearize(clamped(bar, 0.02, **options)).poles())
        np.testing.assert_allclose(ratios(poles), expected, rtol=1e-8)
    np.testing.assert_allclose(ratios(by_frequency(linearize(clamped(bar, None)).poles())), 0.01, rtol=1e-8)
    np.testing.assert_allclose(ratios(by_frequency(linearize(clamped(bar, 0.0)).poles())), 0.0, atol=1e-10)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_ratio_adds_to_the_damping_that_a_body_was_reduced_with(bar, fidelity):
    """With C = beta K of the material, a mode at w has the ratio zeta + beta w / 2."""
    beta = 3e-5
    own = BodyDamping(beta * bar.stiffness_matrix)
    material = replace(bar, readouts={**bar.readouts, own.name: own})
    for ratio in (None, 0.0, 0.02):
        poles = by_frequency(linearize(clamped(material, ratio, fidelity=fidelity)).poles())  # no ratio of the scene
        expected = (ratio or 0.0) + beta * np.abs(poles) / 2
        np.testing.assert_allclose(ratios(poles)[:4], expected[:4], rtol=1e-7)


@pytest.mark.parametrize("stiffness", [1e6, 1e9])
def test_a_stiff_spring_leaves_a_scenes_ratios(bar, stiffness):
    """A guided hand on a spring at the end of a floating bar: no mode gets more than its ratio."""
    held = clamped(bar, None, fidelity="ffrf", damping_ratio=0.01)
    place = held.point_position("bar.right") + np.array([0.0, 0.0, 0.02])
    scene = replace(
        held,
        bodies=(base(rail=place), held.bodies[1], RigidBody("hand", {"o": np.zeros(3)}, HAND, INERTIA, place)),
        joints=(*held.joints, Joint("guide", "base.rail", "hand.o", free="z")),
        springs=(SpringDamper("stiff", "bar.right", "hand.o", "line", stiffness),),
    )
    damping = assemble(scene).modal.damping
    realised = np.diag(damping.of_deformation.of_modes) / (4 * np.pi * damping.frequency)
    assert realised.max() < 0.01 * (1 + 1e-9)
    assert realised[0] > 0.0095


def moved(scene, target):
    """The system made of a scene as it is drawn, brought to where another scene draws the same bodies."""
    system, other = build_system(assemble(scene)), build_system(assemble(target))
    drawn, reference = exu.ConfigurationType.Initial, exu.ConfigurationType.Reference
    there, here = (np.array(s.mbs.systemData.GetODE2Coordinates(reference)) for s in (other, system))
    start = there - here
    system.mbs.systemData.SetODE2Coordinates(start, drawn)
    return system


def free_decay(system):
    """Poles of what an impulse leaves."""
    step, n_steps = 1.5e-4, 1600
    push = np.zeros(n_steps + 1)
    push[:4] = 1e-2
    solve_dynamic(
        system, {"fy": push, "fz": push}, n_steps=n_steps, time_step=step, spectral_radius=1.0, progress=False
    )
    record = system.recorded(n_steps + 1)[:, 200::4]
    return by_frequency(decay_poles(np.diff(record), 4 * step, n_poles=24))


@pytest.mark.parametrize("angle", [-0.5, 2.5])
def test_an_elbow_has_the_ratios_of_the_position_it_is_in(bar, angle):
    """Drawn at 0.3 rad, moved elsewhere; the linear model is drawn there.

    A scene's ratio of 2 % becomes 1 to 3.4 % in these positions.
    """
    target = elbow(bar, 0.02, angle=angle)
    expected = by_frequency(linearize(target).poles())[:4]
    found = free_decay(moved(elbow(bar, 0.02), target))[:4]
    np.testing.assert_allclose(np.abs(found), np.abs(expected), rtol=3e-3)
    np.testing.assert_allclose(ratios(found), ratios(expected), rtol=2e-2)


def decay(scene, **options):
    step = 1e-4
    times = step * np.arange(401)
    push = np.where(times < 2e-3, np.sin(np.pi * times / 2e-3) ** 2, 0.0) * 1e-2
    record = simulate(
        scene, TimeHistory(times, [push, -push], ("fy", "fz"), ("N", "N")), time_step=step, progress=False, **options
    )
    return record.values[2:]


@pytest.mark.parametrize("cutoff", [None, 600.0])
def test_all_fidelities_decay_alike(bar, cutoff):
    """Two bars welded into an elbow, in small motion, one ratio each mode; the exact solution is the measure."""
    both = {"free": (), "cutoff_frequency": cutoff}
    linear = elbow(bar, (0.02, 0.05, 0.03), fidelities=("linear", "linear"), **both)
    expected = decay(linear, method="exact")
    undamped = decay(elbow(bar, 0.0, fidelities=("linear", "linear"), **both), method="exact")
    size = np.abs(expected).max()
    assert np.abs(undamped - expected).max() > 0.05 * size
    assert np.abs(decay(linear) - expected).max() < 5e-3 * size
    for fidelities in (("ffrf", "ffrf"), ("linear", "ffrf")):
        scene = elbow(bar, (0.02, 0.05, 0.03), fidelities=fidelities, **both)
        assert np.abs(decay(scene) - expected).max() < 5e-3 * size


def test_damping_takes_energy_from_deformation_only(bar):
    """Positive semidefinite, whatever the ratios, with nothing between bodies and nothing in rigid motion."""
    body = FlexibleBody("bar", bar, rotation=OBLIQUE, damping_ratio=(0.0, 0.9, 0.01))
    free = assemble(Scene("free", (body,)))
    rigid = np.vstack([np.vstack([np.eye(3, 6), np.eye(3, 6, 3)])] * 2)
    for k, name in enumerate(bar.point_names):
        x, y, z = bar.point(name).position
        rigid[6 * k : 6 * k + 3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    motions = np.linalg.lstsq(free.modal.basis, np.vstack([rigid, np.zeros((bar.n_modes, 6))]), rcond=None)[0]
    amplitudes, matrix = np.linalg.solve(free.modal.shapes, motions), free.modal.damping.of_modes
    assert np.abs(matrix @ amplitudes).max() < 1e-10 * np.abs(matrix).max()
    for assembly in (free, assemble(elbow(bar, (0.0, 0.9, 0.01)))):
        for matrix in (assembly.modal.damping.of_modes, assembly.modal.damping.on_deformation()):
            np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
            values = np.linalg.eigvalsh(matrix)
            assert values[0] > -1e-12 * values[-1]
    n = len(bar.mass_matrix) - 6
    assert not np.any(assembly.modal.damping.on_deformation()[:n, n:])


def test_a_free_spinning_body_keeps_its_angular_momentum(bar):
    """It starts undeformed, so it rings and loses energy; the momentum as steps of length zero leave it."""
    body = FlexibleBody("bar", bar, rotation=OBLIQUE, angular_velocity=OBLIQUE @ [3.0, 5.0, 40.0], damping_ratio=0.2)
    scene = Scene("spin", (body,))
    start = angular_momentum(build_system(assemble(scene)), bar)
    found = []
    for n_steps in (400, 800):
        system = build_system(assemble(scene))
        solve_dynamic(system, {}, n_steps=n_steps, time_step=8e-3 / n_steps, spectral_radius=1.0, progress=False)
        found.append(angular_momentum(system, bar))
    extrapolated = found[1] + (found[1] - found[0]) / 3
    assert np.abs(system.deformation("bar")).max() > 1e-6
    assert np.linalg.norm(extrapolated - start) < 1e-9 * np.linalg.norm(start)


def swung(scene, name, rate=20.0):
    """Simulate 20 ms in which a body turns about z."""
    spun = tuple(replace(b, angular_velocity=[0, 0, rate]) if b.name == name else b for b in scene.bodies)
    return quiet(replace(scene, bodies=spun))


def quiet(scene, force=0.0):
    """What a run of 20 ms under constant forces warns of."""
    push = np.full((len(scene.inputs), 51), force)
    push = TimeHistory(4e-4 * np.arange(51), push, scene.inputs, ("N",) * len(push))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        simulate(scene, push, time_step=4e-4, progress=False)
    return [str(warning.message) for warning in caught if "damping_ratio" in str(warning.message)]


def test_a_scenes_ratio_in_an_elbow_that_moves_far_is_told(bar):
    (told,) = swung(elbow(bar, None), "lower")
    assert "body 'lower' moved by up to 0.4 rad" in told
    assert "as seen from 'upper'" in told
    assert "Give flexible bodies a damping_ratio of their own" in told
    assert swung(elbow(bar, 0.02, damping_ratio=(0.0, 0.01)), "lower")


def test_what_moves_little_or_alone_or_has_its_own_damping_is_not_told(bar):
    assert swung(elbow(bar, 0.02), "lower") == []
    assert swung(elbow(bar, None, damping_ratio=0.0), "lower") == []
    assert swung(elbow(bar, None, fidelities=("rigid", "rigid")), "lower") == []
    assert swung(elbow(bar, None), "lower", rate=1.0) == []
    hinged = replace(clamped(bar, None, fidelity="ffrf"), joints=(Joint("hinge", "base.o", "bar.left", free="rz"),))
    assert swung(hinged, "bar", rate=30.0) == []


def test_bodies_that_turn_together_are_not_told(bar):
    """Two bars welded into an arm that swings about its shoulder: by any angle, its modes are the same."""
    scene = elbow(bar, None, free=())
    swinging = tuple(replace(j, free="rz") if j.name == "shoulder" else j for j in scene.joints)
    upper = replace(scene.bodies[1], angular_velocity=[0, 0, 20.0])
    bodies = (scene.bodies[0], upper, *scene.bodies[2:])
    assert quiet(replace(scene, bodies=bodies, joints=swinging)) == []


def test_a_scenes_ratio_with_a_carriage_that_slides_far_is_told(bar):
    held = clamped(bar, None, fidelity="ffrf")
    carriage = RigidBody("carriage", {"o": np.zeros(3)}, HAND, INERTIA, held.point_position("bar.right"))
    scene = replace(
        held,
        bodies=(*held.bodies, carriage),
        joints=(*held.joints, Joint("guide", "bar.right", "carriage.o", free="x")),
        actuators=(PointForce("push", "carriage.o", "x", "force"),),
    )
    (told,) = quiet(scene, force=1.0)  # 4 mm, of 34 mm between the bar's ends and the carriage
    assert "0.004 m as seen from" in told
    assert quiet(scene, force=0.1) == []


def test_bodies_that_springs_tie_are_tied(bar):
    scene = elbow(bar, 0.02)
    block = RigidBody("block", {"o": np.zeros(3)}, HAND, INERTIA)
    scene = replace(scene, bodies=(*scene.bodies, block))
    springs = tuple(SpringDamper(name, "hand.o", f"{name}.o", "x", 10.0) for name in ("block", "base"))
    assert tied_bodies(scene) == (("lower", "upper"), ("hand", "lower"))
    assert tied_bodies(replace(scene, springs=springs)) == (("lower", "upper"), ("hand", "lower"), ("block", "hand"))


def test_the_summary_tells_bodies_own_damping(bar):
    text = describe(clamped(bar, (0.02, 0.005)))
    assert max(map(len, text.splitlines())) <= 100
    words = " ".join(text.split())
    assert "own damping: 2 %, 0.5 % of critical in the first elastic modes, 0.5 % in all others, left clamped" in words
    assert "damping: none in modes; plus the bodies' own\n" in text
    text = describe(Scene("free", (FlexibleBody("bar", bar, damping_ratio=0.02),), damping_ratio=0.01))
    assert "own damping: 2 % of critical in every elastic mode, free\n" in text
    assert "damping: 1 % of critical in every elastic mode; plus the bodies' own\n" in text
    assert "own" not in describe(clamped(bar, None))


def test_files_keep_bodies_own_damping(bar, tmp_path):
    for scene in (clamped(bar, (0.02, 0.005)), clamped(bar, None)):
        back = load(save(scene, tmp_path / "scene.h5"))
        np.testing.assert_array_equal(linearize(back).A, linearize(scene).A)
        assert back.damping_ratio is None


def test_ratios_that_no_body_has_are_refused(bar):
    for ratio, message in ((-0.01, "must not be negative"), ((), "at least one value"), (np.nan, "NaN or infinite")):
        with pytest.raises(ValueError, match=f"flexible body 'bar': damping_ratio .*{message}"):
            FlexibleBody("bar", bar, damping_ratio=ratio)
    with pytest.warns(UserWarning, match="flexible body 'bar': damping_ratio 2 is critical damping or more"):
        FlexibleBody("bar", bar, damping_ratio=2)


def test_an_open_port_stiffens_a_body_and_its_ratio_stays(apa_with_ports):
    """The ratio is of the modes of the body as it is wired, so of an open circuit's too."""
    bottom = apa_with_ports.point("bottom").position
    body = FlexibleBody("apa", apa_with_ports, -OBLIQUE @ bottom, OBLIQUE, damping_ratio=0.02)
    scene = Scene("clamped", (base(), body), (Joint("clamp", "base.o", "apa.bottom"),))
    voltage = VoltageSensor("voltage", f"apa.{apa_with_ports.ports[0].name}")
    closed, opened = (by_frequency(linearize(s).poles()) for s in (scene, replace(scene, sensors=(voltage,))))
    assert np.abs(opened / closed - 1).max() > 1e-3
    for poles in (closed, opened):
        np.testing.assert_allclose(ratios(poles), 0.02, rtol=1e-6)
