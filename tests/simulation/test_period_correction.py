"""Steps that keep periods: against the exact solution, in floating frames, with springs, loops, charges and spin."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    linearize,
    simulate,
)
from nassim.base.modal import decay_poles
from nassim.scene import Bushing, Drive, Loop, fixed, prismatic, revolute
from nassim.simulation import assemble, integrator_error, numerical_damping, period_errors
from nassim.simulation.model import period_correction
from nassim.simulation.model.period_correction import Steps, correct_periods
from nassim.systems import proportional

STEP = 2e-4
METHODS = ("generalized_alpha", "exact")
FIRST, SECOND = (Rotation.from_rotvec(v).as_matrix() for v in ([0.3, 0.2, -0.5], [-0.7, 0.9, 0.1]))


@pytest.fixture(scope="module")
def link():
    return craig_bampton(lattice(), n_modes=6, progress=False)


def elbow(link, fidelity, *, seat=None, own=None):
    """Two flexible links askew and a block at their end; seat: stiffness of bushings between them, else joints."""
    a = FlexibleBody("a", link, rotation=FIRST, fidelity=fidelity[0], damping_ratio=own)
    b = FlexibleBody("b", link, rotation=SECOND, fidelity=fidelity[1], damping_ratio=own)
    b = replace(b, position=a.point_position("right") - b.point_position("left"))
    inertia = 2e-5 * np.diag([1.0, 2.0, 3.0])
    block = RigidBody(
        "m", {"p": np.zeros(3), "q": (0.01, 0.02, 0.0)}, 0.3, inertia, b.point_position("right"), rotation=FIRST
    )
    ground = RigidBody("g", {"p": a.point_position("left")}, fixed=True)
    ends = (("a.right", "b.left"), ("b.right", "m.p"))
    joints, bushings = [fixed("foot", "g.p", "a.left")], []
    for k, (one, other) in enumerate(ends):
        if seat is None:
            joints.append(fixed(f"j{k}", one, other))
        else:
            figures = seat * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
            bushings.append(Bushing(f"s{k}", one, other, figures, 1e-5 * figures))
    return Scene(
        "elbow",
        (ground, a, b, block),
        tuple(joints),
        (PointForce("f", "m.q", (1, 0.3, -0.4), "f"),),
        (Encoder("e", "g.p", "m.q", (0.2, 1, 0.5)), Encoder("stretch", "a.left", "a.right", "line")),
        tuple(bushings),
        damping_ratio=0.01 if own is None else 0.0,
    )


def shaken(step=STEP, duration=0.12):
    """Forty sines, 10 to 400 Hz, faded in, from a time that is not zero."""
    t = step * np.arange(round(duration / step) + 1)
    phases = np.random.default_rng(1).uniform(0, 6, 40)
    force = sum(np.sin(2 * np.pi * f * t + p) for f, p in zip(np.linspace(10, 400, 40), phases, strict=True))
    return TimeHistory(0.7 + t, 1e-3 * (force * np.minimum(1, t / 0.02))[None], ("f",), ("N",))


def error(found, exact):
    return max(float(np.abs(found[n] - exact[n]).max() / np.abs(exact[n]).max()) for n in ("e", "stretch"))


def errors(scene, exactly, *, radius=1.0):
    """Of steps that compensate, and of the plain rule."""
    push, options = shaken(), {"time_step": STEP, "progress": False}
    exact = simulate(exactly, push, method="exact", **options)
    found = error(simulate(scene, push, spectral_radius=radius, **options), exact)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(period_correction, "FASTEST", 1e-4)
        return found, error(simulate(scene, push, spectral_radius=radius, **options), exact)


@pytest.mark.parametrize(
    ("fidelity", "own"), [(("ffrf", "ffrf"), 0.01), (("linear", "ffrf"), None), (("linear", "linear"), None)]
)
def test_several_bodies_step_as_the_exact_solution(link, fidelity, own):
    """Three modes between 250 and 370 Hz, 14 to 20 steps a period: 40 times nearer than the plain rule."""
    found, plain = errors(elbow(link, fidelity, own=own), elbow(link, ("linear", "linear"), own=own))
    assert plain > 0.4, "so the plain rule fails here"
    assert found < 0.012


def test_springs_that_share_in_the_modes(link):
    """Bodies make up for what bushings lack, as far as they bend; the damping is their own, as the scene's would be."""
    found, plain = errors(
        elbow(link, ("ffrf", "ffrf"), seat=1e7, own=0.01), elbow(link, ("linear", "linear"), seat=1e7, own=0.01)
    )
    assert found < 0.05 * plain


def test_modes_are_corrected_up_to_nine_tenths_of_half_a_step():
    """(x / tan x)^2 of the mass with x = pi h f; faster modes get the factor of the fastest that are corrected."""
    x = 0.9 * np.array([0.1, 0.9, 1.0, 1.1, 3.0])
    kept = np.minimum(x, 0.9)
    mass, damping = Steps(1.0).factors(x / np.pi)
    np.testing.assert_allclose(mass, (kept / np.tan(kept)) ** 2, rtol=1e-9)
    np.testing.assert_allclose(damping, (kept / np.sin(kept)) ** 2, rtol=1e-9)


def test_period_errors_are_those_of_a_run(link):
    """Poles of a decay in floating frames against the frequencies with what `period_errors` says of them."""
    scene = elbow(link, ("ffrf", "ffrf"), seat=1e6, own=0.003)
    frequency = assemble(scene).modal.frequency[:6]
    kick = TimeHistory(STEP * np.arange(801), 1e-3 * (np.arange(801) < 3)[None], ("f",), ("N",))
    run = simulate(scene, kick, time_step=STEP, progress=False)
    poles = decay_poles(run.values[1:, 10:], STEP, n_poles=40)
    found = np.sort(np.abs(poles[poles.imag > 0])) / (2 * np.pi)
    stepped = frequency * (1 + period_errors(scene, STEP)[:6])
    assert np.all(np.min(np.abs(found[:, None] / stepped - 1), axis=0) < 2e-4)
    plain = np.arctan(np.pi * STEP * frequency) / (np.pi * STEP)
    assert np.abs(plain / stepped - 1).max() > 5e-3, "so it matters"


def slow(link, fidelity="linear", *, driven=False, ratio=0.0):
    """A heavy load on the link, on a guide."""
    left, right = (link.point(name).position for name in ("left", "right"))
    base = RigidBody("base", {"rail": left, "end": right}, fixed=True)
    load = RigidBody("load", {"p": np.zeros(3)}, 20.0, 1e-1 * np.diag([1.0, 1.2, 1.5]), right)
    foot = prismatic("foot", "base.rail", "link.left", "x") if driven else fixed("foot", "base.rail", "link.left")
    return Scene(
        "slow",
        (base, FlexibleBody("link", link, fidelity=fidelity), load),
        (foot, fixed("b", "link.right", "load.p"), Joint("guide", "base.end", "load.p", free="x")),
        (PointForce("f", "load.p", "x", "f"), *((Drive("motor", "foot", "z", "way"),) if driven else ())),
        (Encoder("e", "base.end", "load.p", "x"),),
        damping_ratio=ratio,
    )


def test_a_damper_behind_a_spring_keeps_its_force(link):
    """Its light end, a mode far above the steps, follows the slow motion."""
    plain = slow(link)
    end = plain.point_position("load.p")
    light = RigidBody("light", {"p": np.zeros(3)}, 1e-3, 1e-7 * np.diag([1.0, 1.2, 1.5]), end)
    scene = replace(
        plain,
        bodies=(*plain.bodies, light),
        joints=(*plain.joints, prismatic("rail", "base.end", "light.p", "x")),
        springs=(
            SpringDamper("spring", "load.p", "light.p", "x", 1e6),
            SpringDamper("damper", "base.end", "light.p", "x", 0.0, 3e3),
        ),
        quasi_static_above=np.inf,
    )
    found, exact = (simulate(scene, shaken(), time_step=STEP, method=m, progress=False)["e"] for m in METHODS)
    np.testing.assert_allclose(found, exact, atol=5e-3 * np.abs(exact).max())


@pytest.mark.parametrize(("fidelity", "driven"), [("linear", False), ("ffrf", False), ("linear", True)])
def test_numerical_damping_is_that_of_a_run(link, fidelity, driven):
    """Radius 0, six steps in the first period: poles of a decay."""
    scene = slow(link, fidelity, driven=driven)
    step = 1 / (6 * assemble(scene).modal.frequency[0])
    time = step * np.arange(60)
    push = TimeHistory(
        time, np.array([np.arange(60) < 3, np.zeros(60)])[: 1 + driven], scene.inputs, ("N", "m")[: 1 + driven]
    )
    run = simulate(scene, push, time_step=step, spectral_radius=0.0, progress=False)
    (pole,) = (p for p in decay_poles(run.values[:, 8:40], step, n_poles=2) if p.imag > 0)
    told = numerical_damping(scene, step, spectral_radius=0.0)[0]
    assert -pole.real / abs(pole) == pytest.approx(told, rel=1e-3)
    alone = integrator_error(1 / (6 * step), step, spectral_radius=0.0)[1]
    assert told == pytest.approx(alone, rel=1e-6) if driven else told > 1.2 * alone


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_damping_ratio_is_kept_in_coarse_steps(link, fidelity):
    """Six steps in the first period: with the mass alone corrected, the ratio would be 9 % smaller."""
    scene = slow(link, fidelity, ratio=0.02)
    step = 1 / (6 * assemble(scene).modal.frequency[0])
    push = TimeHistory(step * np.arange(60), (np.arange(60) < 3.0)[None], ("f",), ("N",))
    run = simulate(scene, push, time_step=step, spectral_radius=1.0, progress=False)
    (pole,) = (p for p in decay_poles(run.values[1:, 8:40], step, n_poles=2) if p.imag > 0)
    assert -pole.real / abs(pole) == pytest.approx(0.02, rel=5e-3)


@pytest.mark.parametrize("radius", [1.0, 0.8])
def test_nothing_is_made_up_for_beside_a_drive_in_small_motion(link, radius):
    """All modes are those of the rule alone, by the roots of its recursion for one oscillator."""
    left, right = (link.point(name).position for name in ("left", "right"))
    base = RigidBody("base", {"rail": left}, fixed=True)
    sledge = RigidBody("sledge", {"rail": np.zeros(3)}, 0.2, 1e-3 * np.diag([1.0, 1.2, 1.5]), left)
    load = RigidBody("load", {"p": np.zeros(3)}, 0.3, 1e-4 * np.diag([1.0, 1.2, 1.5]), right)
    joints = prismatic("rail", "base.rail", "sledge.rail", "x"), fixed("a", "sledge.rail", "link.left")
    scene = Scene(
        "shaker",
        (base, sledge, FlexibleBody("link", link, fidelity="linear"), load),
        (*joints, fixed("b", "link.right", "load.p")),
        (Drive("motor", "rail", "z", "way"),),
    )
    frequency = assemble(scene).modal.frequency[:3]
    am, af = (2 * radius - 1) / (radius + 1), radius / (radius + 1)
    gamma, beta = 0.5 - am + af, 0.25 * (1 - am + af) ** 2
    for mode, told in zip(frequency, period_errors(scene, STEP, spectral_radius=radius), strict=False):
        x = (2 * np.pi * mode * STEP) ** 2
        # (1 - am) a1 + am a0 + x ((1 - af) u1 + af u0) = 0 for u, step v and step^2 a.
        after = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 - af) * x, 0, 1 - am]])
        before = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [-af * x, 0, -am]])
        roots = np.linalg.eigvals(np.linalg.solve(after, before))
        swing = np.log(roots[np.argmax(np.abs(roots.imag))])
        assert told == pytest.approx(abs(swing) / np.sqrt(x) - 1, rel=1e-4)
        assert told < -1e-4


def test_steps_with_numerical_damping_keep_periods_too(link):
    found, plain = errors(elbow(link, ("ffrf", "ffrf")), elbow(link, ("linear", "linear")), radius=0.8)
    assert found < 0.05 * plain


def test_masses_stay_positive(link):
    """However soft the springs and long the steps, from no mode more than 0.6 of its mass is taken."""
    for seat in (None, 1e7, 1e5, 1e3):
        for step in (1e-5, 1e-3, 1.0):
            assembly = assemble(elbow(link, ("ffrf", "ffrf"), seat=seat))
            bent = assembly.modal.damping.deformation @ assembly.modal.shapes
            change = np.linalg.eigvalsh(bent.T @ correct_periods(assembly, Steps(step))[1] @ bent)
            assert -0.61 < change.min() <= change.max() < 1e-9


def test_what_moves_far_has_positive_masses_everywhere(link):
    """Two links that swing: no position takes more than 0.9 of the mass that their deformation has in free flight."""
    scene = elbow(link, ("ffrf", "ffrf"))
    hinge = replace(scene.joints[0], free=("rx", "ry", "rz"))
    for step in (1e-4, 1e-2):
        assembly = assemble(replace(scene, joints=(hinge, *scene.joints[1:])))
        assert assembly.modal.rigid_modes.any()
        frames = [assembly.coordinates.frames[name] for name in "ab"]
        spare = scipy.linalg.block_diag(*map(period_correction.in_free_flight, frames))
        taken = scipy.linalg.eigh(-correct_periods(assembly, Steps(step))[1], spare, eigvals_only=True)
        assert -1e-9 < taken.min() < taken.max() < 0.9 + 1e-9


def test_double_modes_have_no_axes_of_their_own(link):
    """Whichever two shapes stand for a pair of modes, the mass is the same."""
    assembly = assemble(elbow(link, ("ffrf", "ffrf"), seat=1e6))
    frequency, turned = assembly.modal.frequency.copy(), assembly.modal.shapes.copy()
    frequency[3] = frequency[2]
    turned[:, 2:4] = turned[:, 2:4] @ np.array([[0.8, -0.6], [0.6, 0.8]])
    models = (replace(assembly.modal, frequency=frequency, shapes=s) for s in (assembly.modal.shapes, turned))
    one, other = (correct_periods(replace(assembly, modal=modal), Steps(STEP))[1] for modal in models)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(one).max())


def test_a_free_body_keeps_its_momentum(link):
    """What is made up for pushes no rigid motion: a body that tumbles in space under a force, against fine steps."""
    free = FlexibleBody("a", link, rotation=FIRST, angular_velocity=(1.0, -2.0, 3.0))
    scene = Scene(
        "free",
        (RigidBody("g", {"o": np.zeros(3)}, fixed=True), free),
        (),
        (PointForce("f", "a.left", "x", "f"),),
        tuple(Encoder(f"{point}", "g.o", f"a.{point}", "x") for point in ("left", "right")),
        damping_ratio=0.01,
    )
    t = STEP * np.arange(301)
    push = TimeHistory(t, 0.2 * np.sin(40 * t)[None], ("f",), ("N",))
    run, fine = (simulate(scene, push, time_step=step, progress=False) for step in (STEP, STEP / 8))
    for name in scene.outputs:
        assert np.abs(run[name] - fine[name][::8]).max() < 1e-5 * np.abs(run[name]).max()


def test_a_loop_closed_around_compensated_steps(link):
    """A damped loop's poles in time, against those of the sampled linear model; the plain rule is 1 % off."""
    scene = elbow(link, ("ffrf", "ffrf"), own=0.002)
    controller = proportional(1e4, sample_rate=1 / STEP)
    scene = replace(scene, loops=(Loop("loop", controller, "e", "f"),))
    in_small_motion = replace(scene, bodies=elbow(link, ("linear", "linear"), own=0.002).bodies)
    found, plain = errors(scene, in_small_motion)
    assert plain > 0.4
    assert found < 0.012


def test_modes_of_a_spinning_elbow(link):
    """In the turning frame, against the spinning linear model: poles within 1.2e-3 at 300 rpm, 14 steps a period."""
    speed = 2 * np.pi * 5
    scene = elbow(link, ("ffrf", "ffrf"), own=0.002)
    ground, a, b, block = scene.bodies
    at = ground.points["p"]
    table = RigidBody("table", {"p": np.zeros(3)}, 1.0, np.eye(3), at)
    axis = (0.3, -0.5, 1.0)
    foot = (revolute("spindle", "g.p", "table.p", axis), replace(scene.joints[0], a="table.p"))
    scene = replace(
        scene,
        bodies=(ground, table, a, b, block),
        joints=(*foot, *scene.joints[1:]),
        actuators=(replace(scene.actuators[0], frame="m.q"), Drive("motor", "spindle", "rz", speed=speed)),
        sensors=tuple(Encoder(f"{n}", "table.p", "m.q", n, "table.p") for n in "xyz"),
    )
    n = 501
    kick = TimeHistory(STEP * np.arange(n), 1e-3 * (np.arange(n) < 3)[None], ("f",), ("N",))
    run = simulate(scene, kick, time_step=STEP, progress=False)
    poles = decay_poles(run.values[1:, 10:] - run.values[1:, :1], STEP, n_poles=40)
    model = linearize(scene)
    wanted = np.sort(model.poles().imag)
    wanted = wanted[wanted > 0][:5]
    found = poles.imag
    assert np.all(np.min(np.abs(found[:, None] / wanted - 1), axis=0) < 1.2e-3)
