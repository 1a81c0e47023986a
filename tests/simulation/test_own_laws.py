"""Laws, measures and bodies written here alone: a cubic spring, a screw, a chain of masses; faster items."""

import functools
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np
import pytest
import scipy
from conftest import Given, lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    Bushing,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    craig_bampton,
    describe,
    frequency_response,
    linearize,
    simulate,
    static_response,
)
from nassim.bodies.strain import Strain
from nassim.scene import (
    AngleSensor,
    AppliedForce,
    Body,
    BodyCoordinates,
    Combination,
    Connection,
    Constraint,
    Displacement,
    Distance,
    ForceElement,
    ForceLaw,
    LinearActuator,
    NonlinearSpring,
    Output,
    Path,
    PointMeasure,
    PointVelocity,
    RelativePose,
    RotationAngle,
    RotationDeviation,
    Spring,
    SpringForce,
    Term,
    cylindrical,
    fixed,
    placed,
    prismatic,
    revolute,
)
from nassim.simulation import assemble, loaded_equilibrium, mode_motion
from nassim.simulation.model.displacement import displaced, motion_of_frames
from nassim.simulation.model.motion_size import motion_sizes, scene_size
from nassim.simulation.model.states import RigidState
from nassim.viewer import view_scene

ODD = Rotation.from_rotvec([0.5, -0.7, 0.4]).as_matrix()
GROUND = RigidBody("ground", {"o": np.zeros(3), "p": [0.2, -0.1, 0.3]}, fixed=True)

STILL = np.zeros(6)


@functools.cache
def reduced():
    return craig_bampton(lattice(stiffness=1e5), n_modes=2, progress=False)


def free_run(scene, duration, time_step, push=0.0, **options):
    time = time_step * np.arange(round(duration / time_step) + 1)
    still = TimeHistory(time, np.full((len(scene.inputs), len(time)), push), scene.inputs, ("",) * len(scene.inputs))
    record = simulate(scene, still, time_step=time_step, progress=False, **options)
    return dict(zip(record.names, record.values, strict=True)), time


@dataclass(frozen=True)
class Cubic(ForceElement):
    """A spring whose force grows with the cube of the stretch of a line."""

    a: Path
    b: Path
    stiffness: float = 0.0
    cubic: float = 0.0

    def terms(self, scene):
        """One law."""
        return (NonlinearSpring(Distance(self.a, self.b), force=lambda v, _: self.stiffness * v + self.cubic * v**3),)


def swinging(**options):
    """A point mass on two cubic springs, in large motion."""
    ball = RigidBody("ball", {"c": np.zeros(3)}, 0.5, 1e-3 * np.diag([1.0, 2.0, 2.5]), (0.1, 0.2, -0.4))
    springs = (Cubic("one", "ground.o", "ball.c", 200.0, 4e4), Cubic("two", "ball.c", "ground.p", 150.0, 9e4))
    sensors = tuple(Encoder(axis, "ground.o", "ball.c", axis) for axis in "xyz")
    return Scene("swing", (GROUND, ball), springs=springs, sensors=sensors, gravity=(1.0, -2.0, -9.81), **options)


def test_a_cubic_spring_in_large_motion_is_an_own_integration():
    scene = swinging()
    ball = scene.bodies[1]
    anchors = [np.zeros(3), np.array([0.2, -0.1, 0.3])]
    lengths = [np.linalg.norm(ball.position - anchor) for anchor in anchors]

    def rates(_t, y):
        force = ball.mass * np.asarray(scene.gravity)
        for anchor, length, (k, c) in zip(anchors, lengths, ((200.0, 4e4), (150.0, 9e4)), strict=True):
            apart = y[:3] - anchor
            stretch = np.linalg.norm(apart) - length
            force = force - (k * stretch + c * stretch**3) * apart / np.linalg.norm(apart)
        return np.concatenate([y[3:], force / ball.mass])

    found, time = free_run(scene, 0.3, 5e-4, start="released")
    solution = scipy.integrate.solve_ivp(
        rates, (0, 0.3), [*ball.position, 0, 0, 0], t_eval=time, rtol=1e-10, atol=1e-12
    )
    moved = solution.y[:3] - ball.position[:, None]
    assert np.abs(moved).max() > 0.1
    for axis, expected in zip("xyz", moved, strict=True):
        np.testing.assert_allclose(found[axis], expected, rtol=0, atol=5e-5)


def bar_on_a_cubic_spring(force, fidelity="linear"):
    body = reduced()
    bar = FlexibleBody("bar", body, -ODD @ body.point("left").position, ODD, fidelity)
    hook = RigidBody("hook", {"o": np.zeros(3)}, fixed=True, position=bar.point_position("right") + 0.05 * np.eye(3)[2])
    holds = (Bushing("foot", "ground.o", "bar.left", [1e4, 2e4, 3e4, 20.0, 30.0, 40.0]),)
    return Scene("bar", (GROUND, hook, bar), springs=(*holds, force), gravity=(0, 0, -200.0), damping_ratio=0.0)


@dataclass(frozen=True)
class Hook(ForceElement):
    """A law along z between hook and bar."""

    law: object = None

    def terms(self, scene):
        """One law."""
        along = Displacement.between("hook.o", "bar.right", np.array([0.0, 0.0, 1.0]))
        return (NonlinearSpring(along, force=self.law),)


def test_a_cubic_spring_is_linearised_about_its_equilibrium():
    """As a linear spring of its tangent, found by bisection of the force that both carry."""
    law = Hook("hook", lambda v, _: 2e3 * v + 3e9 * v**3)
    found = linearize(bar_on_a_cubic_spring(law), loaded=False)

    free = bar_on_a_cubic_spring(Hook("hook", lambda v, _: 0.0 * v))
    end, push = Encoder("z", "hook.o", "bar.right", "z"), PointForce("f", "bar.right", "z", "f")
    free = replace(free, sensors=(end,), actuators=(push,))
    a, b, c, _ = linearize(free, loaded=False).matrices
    by_weight, by_force = c[0] @ np.linalg.solve(-a, np.column_stack([rates_by_weight(free), b[:, 0]]))

    def sag(stretch):
        """Of the bar's end, pulled by the law's force at a stretch."""
        return float(by_weight - by_force * (2e3 * stretch + 3e9 * stretch**3))

    stretch = scipy.optimize.brentq(lambda v: sag(v) - v, -0.05, 0.0, xtol=1e-15)
    tangent = 2e3 + 9e9 * stretch**2
    assert tangent > 3 * 2e3
    along = SpringDamper("hook", "hook.o", "bar.right", "z", tangent)
    expected = linearize(bar_on_a_cubic_spring(along), loaded=False)
    np.testing.assert_allclose(np.sort(found.poles().imag), np.sort(expected.poles().imag), rtol=1e-7, atol=1e-6)


def test_tangents_that_are_not_given_are_differences():
    """Of two components, by value and by rate; the damper of a mass is that of its linear model."""
    both = np.array([[300.0, -40.0], [60.0, 500.0]])
    x, v = np.array([0.3, -0.8]), np.array([0.5, 1.2])
    for long, fast in ((1.0, 1.0), (1e-5, 1e3), (1e3, 1e-2)):  # values and rates of any sizes
        law = NonlinearSpring(
            RelativePose("ground.o", "mass.c"),
            force=lambda x, v, a=long, b=fast: 0.1 * both @ (x[:2] / a) ** 3 + both.T @ np.sin(v[:2] / b),
        )
        found = law.tangents(long * x, fast * v)
        np.testing.assert_allclose(long * found[0], 0.3 * both * x**2, rtol=1e-6)
        np.testing.assert_allclose(fast * found[1], both.T * np.cos(v), rtol=1e-6)

    mass = RigidBody("mass", {"c": np.zeros(3)}, 0.7, 1e-2 * np.eye(3))
    guide = Joint("guide", "ground.o", "mass.c", free="x")
    along = Displacement.between("ground.o", "mass.c", np.eye(3)[0])
    rubber = NonlinearSpring(along, force=lambda x, v: 300.0 * x + 4.0 * np.tanh(v))
    poles = linearize(
        Scene("mass", (GROUND, mass), (guide,), springs=(Given("rubber", (rubber,)),), damping_ratio=0.0)
    ).poles()
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(np.roots([0.7, 4.0, 300.0])), rtol=1e-6)


def rates_by_weight(scene):
    """Rates of the states by gravity."""
    from nassim.simulation.linear.scene_state_space import state_space
    from nassim.simulation.model.assembly import assemble

    return state_space(assemble(scene))[1][:, -1]


def test_a_nonlinear_spring_in_small_motion_follows_its_law_beyond_the_tangent():
    """Decays in small motion (one object of modes), by explicit steps too, and beside floating frames."""
    law = Hook("hook", lambda v, w: 2e3 * v + 3e10 * v**3 + 2.0 * w)
    along_z = NonlinearSpring(
        RelativePose("hook.o", "bar.right"), force=lambda v, w: np.array([0, 0, law.law(v[2], w[2]), 0, 0, 0])
    )
    part = Given("hook", (along_z, SpringForce("pull", "N", along_z, "z")))
    runs = []
    for fidelity, method in (("linear", "generalized_alpha"), ("linear", "explicit"), ("ffrf", "generalized_alpha")):
        scene = replace(
            bar_on_a_cubic_spring(part, fidelity),
            sensors=(Encoder("z", "hook.o", "bar.right", "z"),),
            actuators=(PointForce("f", "bar.right", (0.6, 0.0, 0.8), "f"),),
            gravity=np.zeros(3),
        )
        time = 1e-4 * np.arange(121)
        at = time + 0.5e-4 * (method == "explicit")  # which holds what it is given from step to step
        pulse = TimeHistory(time, 20.0 * np.sin(np.pi * np.minimum(at / 2e-3, 1.0))[None] ** 2, ("f",), ("N",))
        runs.append(simulate(scene, pulse, time_step=1e-4, method=method, progress=False))
    assert np.ptp(runs[0]["z"]) > 1e-4
    for name in ("z", "pull"):
        for other in runs[1:]:
            np.testing.assert_allclose(runs[0][name], other[name], rtol=0, atol=0.01 * np.ptp(runs[0][name]))
    nothing = TimeHistory(np.arange(3) * 1e-3, np.zeros((0, 3)), (), ())
    with pytest.raises(ValueError, match="the NonlinearSpring on a Displacement of Hook 'hook' is not linear"):
        simulate(bar_on_a_cubic_spring(law), nothing, time_step=1e-3, method="exact", progress=False)


@dataclass(frozen=True)
class Screw(Connection):
    """A nut on a spindle: a joint's slide follows its rotation."""

    a: Path
    b: Path
    axis: tuple
    lead: float

    def terms(self, scene):
        """The slide less the lead times the turns is zero."""
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        slide = Displacement.between(self.a, self.b, axis, axes_of=self.a)
        parts = ((1.0, slide), (-self.lead / (2 * np.pi), RotationAngle(self.b, axis, self.a)))
        return (Constraint(self.name, Combination(parts)),)


def test_a_screw_couples_rotation_to_translation():
    """A nut on an inclined spindle, let go: as a mass m + J (2 pi / lead)^2 on the way down."""
    axis, lead, mass, inertia = np.array([0.48, -0.6, 0.64]), 0.3, 0.7, 2e-3
    axes = np.linalg.qr(np.column_stack([axis, np.eye(3)[:, :2]]))[0]
    moments = axes @ np.diag([inertia, 3e-3, 2.5e-3]) @ axes.T
    nut = RigidBody("nut", {"m": np.zeros(3)}, mass, 0.5 * (moments + moments.T))
    joints = (
        cylindrical("guide", "ground.o", "nut.m", tuple(axis)),
        Screw("screw", "ground.o", "nut.m", tuple(axis), lead),
    )
    sensors = (
        Encoder("slide", "ground.o", "nut.m", tuple(axis)),
        AngleSensor("turn", "ground.o", "nut.m", tuple(axis)),
    )
    scene = Scene("screw", (GROUND, nut), joints, sensors=sensors, gravity=(0.0, 0.0, -9.81))
    found, time = free_run(scene, 0.6, 8e-3, start="released", spectral_radius=0.9)
    acceleration = mass * -9.81 * axis[2] / (mass + inertia * (2 * np.pi / lead) ** 2)
    expected = 0.5 * acceleration * time**2
    assert np.abs(expected[-1]) > 1.5 * lead
    np.testing.assert_allclose(found["slide"], expected, rtol=0, atol=2e-3 * np.abs(expected).max())
    np.testing.assert_allclose(found["turn"], 2 * np.pi / lead * found["slide"], rtol=0, atol=1e-6)
    spring = SpringDamper("k", "ground.o", "nut.m", tuple(axis), 400.0)
    poles = linearize(replace(scene, springs=(spring,), gravity=np.zeros(3))).poles()
    frequency = np.sqrt(400.0 / (mass + inertia * (2 * np.pi / lead) ** 2))
    np.testing.assert_allclose(np.abs(poles), [frequency, frequency], rtol=1e-9)


@dataclass(frozen=True)
class Chain(Body):
    """Equal masses on a line with springs between them: a formulation of its own."""

    name: str
    n: int
    mass: float
    stiffness: float
    direction: tuple = (0.0, 0.0, 1.0)
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def point_names(self):
        return tuple(f"m{k}" for k in range(self.n))

    @property
    def mass_matrix(self):
        return self.mass * np.eye(self.n)

    @property
    def strain(self):
        rows = np.diff(np.eye(self.n), axis=0)
        sizes = np.sqrt(2 / self.mass)
        return Strain(rows / sizes, np.sqrt(self.stiffness) * rows)

    def weight(self, gravity):
        return self.mass * np.full(self.n, gravity @ self.direction)

    def motion(self, point):
        result = np.zeros((6, self.n))
        result[:3, self.point_names.index(point)] = self.direction
        return result

    def point_position(self, point):
        return self.position + 0.1 * self.point_names.index(point) * np.asarray(self.direction)

    @property
    def rigid_inertia(self):
        return self.n * self.mass, self.position, self.n * self.mass * np.eye(3)


def test_a_body_formulation_of_its_own_under_its_weight():
    """Its points move linearly, so a hung chain has the modes of one in space; a spin is refused by name."""
    springs = (SpringDamper("wall", "ground.o", "chain.m0", "z", 2e4),)
    sensors = [Encoder(f"m{k}", "ground.o", f"chain.m{k}", "z") for k in range(4)]
    scene = Scene("chain", (GROUND, Chain("chain", 4, 0.2, 3e4)), springs=springs, sensors=sensors, damping_ratio=0.0)
    coordinates = assemble(scene).coordinates
    assert motion_sizes(coordinates, np.ones((4, 1)))["chain"].tolist() == [0.0, 0.0]
    moved = displaced(coordinates, np.array([0.0, 0.01, -0.02, 0.01]))
    assert motion_of_frames(coordinates, moved) == pytest.approx(0.02 / scene_size(scene))
    hung = linearize(replace(scene, gravity=(0, 0, -9.81)))
    np.testing.assert_allclose(np.sort(hung.poles().imag), np.sort(linearize(scene).poles().imag), atol=1e-6)
    rest = loaded_equilibrium(replace(scene, gravity=(0, 0, -9.81)))
    below = np.array([4, 3, 2, 1]) * 0.2 * 9.81  # the weight that each spring bears
    expected = -np.cumsum(below / [2e4, 3e4, 3e4, 3e4])
    np.testing.assert_allclose([rest.motions[f"chain.m{k}"][2] for k in range(4)], expected, rtol=1e-9)
    read = static_response(replace(scene, gravity=(0, 0, -9.81)))
    np.testing.assert_allclose([read[f"m{k}"] for k in range(4)], expected, rtol=1e-6)
    time = 1e-4 * np.arange(101)
    rise, options = TimeHistory(time, np.full((1, 101), 9.81), ("rise",)), {"time_step": 1e-4, "progress": False}
    quake = simulate(replace(scene, actuators=(GroundAcceleration("quake", "z", "rise"),)), rise, **options)
    fall = simulate(replace(scene, gravity=(0, 0, -9.81)), None, duration=time[-1], start="released", **options)
    np.testing.assert_allclose(quake["m3"], fall["m3"], atol=1e-9 * np.ptp(fall["m3"]))
    with pytest.raises(ValueError, match="body 'chain' is a Chain, whose centrifugal forces are not known"):
        linearize(scene, angular_velocity=(0, 0, 1.0))


def chain_and_bar(fidelity):
    """A chain with a load, between a wall and a bar; every kind of part acts on the chain or reads it."""
    direction = np.array([0.6, 0.0, 0.8])
    chain = Chain("chain", 4, 0.2, 3e4, tuple(direction), np.array([0.1, 0.0, 0.0]))
    body = reduced()
    start = chain.point_position("m3") + 0.05 * np.eye(3)[0]
    bar = FlexibleBody("bar", body, start - ODD @ body.point("left").position, ODD, fidelity)
    end = bar.point_position("right")
    foot = RigidBody(
        "foot", {"o": np.zeros(3), "behind": chain.position - 0.05 * direction - end}, position=end, fixed=True
    )
    load = RigidBody("load", {"o": np.zeros(3)}, 0.15, 1e-4 * np.eye(3), chain.point_position("m3"))
    springs = (
        SpringDamper("wall", "ground.o", "chain.m0", tuple(direction), 2e4, 1.0),
        SpringDamper("link", "chain.m3", "bar.left", tuple(direction), 1e4, 2.0),
        SpringDamper("along", "foot.behind", "chain.m0", "line", 2e3, 1.0),
        Bushing("foot", "foot.o", "bar.right", [4e4, 5e4, 3e4, 20.0, 30.0, 40.0], 0.02 * np.ones(6)),
    )
    scene = Scene(
        "chain",
        (GROUND, foot, chain, load, bar),
        (fixed("weld", "chain.m3", "load.o"),),
        springs=springs,
        actuators=(PointForce("push", "chain.m1", tuple(direction), "push"),),
        sensors=(
            Encoder("m2", "ground.o", "chain.m2", tuple(direction)),
            Vibrometer("v", "bar.left", "z"),
            Accelerometer("a", "chain.m3", tuple(direction), frame="bar.left"),
        ),
        damping_ratio=0.0,
    )
    spread, long = 0.1 * np.eye(3)[1], BodyCoordinates.between(bar, "left", "right", np.eye(3)[0])
    mount = Spring(RelativePose("chain.m3", "bar.left", ODD), np.diag([3e3, 2e3, 4e3, 3.0, 2.0, 4.0]), 0.5 * np.eye(6))
    tilt = RotationDeviation("bar.left", "chain.m2", direction, "bar.right", "chain.m1", spread)
    rub = PointVelocity((("chain.m3", -ODD[0]), ("bar.left", ODD[0])), "bar.left", angular=True)
    extra = (
        *(mount, SpringForce("mount", "N", mount, "x"), Spring(rub, 0.0, 1e-3)),
        *(Output("line", "m", Distance("chain.m2", "bar.left")), Output("tilt", "rad", tilt)),
        Output("turn", "rad", RotationAngle("bar.left", ODD[1], "chain.m2")),
        Output("growth", "m/s", replace(long, constant=5.0), derivative=1),
    )
    pull = LinearActuator("pull", "foot.behind", "chain.m0", "push")
    return replace(scene, springs=(*springs, Given("extra", extra)), actuators=(*scene.actuators, pull))


@pytest.mark.parametrize("method", ["exact", "generalized_alpha", "ffrf"])
def test_a_body_formulation_of_its_own_runs_in_every_engine(method):
    """Against the model."""
    scene = chain_and_bar("ffrf" if method == "ffrf" else "linear")
    time = 1e-4 * np.arange(81)
    pulse = TimeHistory(time, np.sin(np.pi * np.minimum(time / 2e-3, 1.0))[None] ** 2, ("push",), ("N",))
    options = {"method": "exact"} if method == "exact" else {}
    found = simulate(scene, pulse, time_step=1e-4, progress=False, **options)
    model = linearize(scene)
    whole = np.zeros((len(model.A) + 2,) * 2)
    whole[: len(model.A), : len(model.A)], whole[: len(model.A), -2:-1], whole[-2, -1] = model.A, model.B, 1.0
    phi = scipy.linalg.expm(whole * 1e-4)
    state, expected = np.zeros(len(model.A)), []
    for now, following in zip(pulse.values[0], [*pulse.values[0][1:], 0.0], strict=True):
        expected.append(model.C @ state)
        state = (phi @ [*state, now, (following - now) / 1e-4])[: len(state)]
    for name, values in zip(model.outputs, np.transpose(expected), strict=True):
        size = np.abs(values).max()
        atol = (1e-8 if method == "exact" else 0.02) * size
        np.testing.assert_allclose(found.values[found.names.index(name)], values, rtol=0, atol=atol)


def test_a_body_formulation_of_its_own_has_the_modes_of_its_matrices():
    scene = chain_and_bar("linear")
    light = replace(
        scene, bodies=scene.bodies[:4], springs=(replace(scene.springs[0], damping=0.0),), sensors=scene.sensors[:1]
    )
    matrix = 3e4 * np.diff(np.eye(4), axis=0).T @ np.diff(np.eye(4), axis=0)
    matrix[0, 0] += 2e4
    frequency = np.sqrt(scipy.linalg.eigvalsh(matrix, np.diag(0.2 + np.array([0.0, 0.0, 0.0, 0.15]))))
    poles = np.abs(linearize(light).poles())
    np.testing.assert_allclose(np.unique(poles.round(6)), np.unique(frequency.round(6)), rtol=1e-6)


def test_a_body_formulation_of_its_own_lacks_no_modes():
    """By strain energy, those beyond the limit of the bar are the bar's, though the chain comes before it."""
    assembly = assemble(chain_and_bar("linear"))
    bar, modal = assembly.scene.body("bar").reduced, assembly.modal
    own = modal.modes[assembly.coordinates.slices["bar"]]
    share = np.einsum("ik,ij,jk->k", own, bar.stiffness_matrix, own) / np.maximum(modal.omega, 1.0) ** 2
    expected = (share > 0.5) & (modal.frequency > bar.valid_frequency)
    assert np.count_nonzero(expected) == 5
    np.testing.assert_array_equal(modal.unsupported, expected)


MEASURES = {
    "displacement": Displacement((("a.p", np.array([1.0, -2, 0.5])), ("b.q", np.array([-0.3, 0.4, 2])))),
    "turning": Displacement.between("a.p", "b.q", np.array([0.6, 0.0, 0.8]), axes_of="b.q"),
    "distance": Distance("a.p", "b.q"),
    "angle": RotationAngle("b.q", np.array([0.3, 0.4, -1.2]), "a.p"),
    "angle of the world": RotationAngle("b.q", np.array([0.3, 0.4, -1.2])),
    "deviation": RotationDeviation("a.p", "b.q", np.array([0.3, 0.4, -1.2]), "b.p", "a.q", np.array([1.0, 0.5, 2.0])),
    "deviation along axes that stay": RotationDeviation(
        "b.p", "a.q", ODD[0], "b.q", "a.p", 2.0 * ODD[1], turning=False
    ),
    "vector": RelativePose("a.p", "b.q", ODD),
    "tilt": RelativePose("a.p", "b.q", ODD, "tilt", np.array([2.0, -1.0, 2.0]) / 3),
    "matrix": RelativePose("a.p", "b.q", ODD, "matrix"),
    "combination": Combination(((2.0, Distance("a.p", "b.q")), (-0.3, RotationAngle("b.q", np.eye(3)[1], "a.p")))),
}


@pytest.mark.parametrize("name", MEASURES)
def test_jacobians_are_the_derivatives_of_values(name):
    """In a configuration far from the reference, along every motion of both bodies; no angle about a shaft."""
    measure, random = MEASURES[name], np.random.default_rng(3)
    with_value = np.eye(len(measure.components))
    if name == "tilt":
        with_value[3:, 3:] -= np.outer(measure.shaft, measure.shaft)
    bodies = [
        RigidBody(
            label, {"p": random.normal(size=3), "q": random.normal(size=3)}, 1.0, np.eye(3), random.normal(size=3)
        )
        for label in "ab"
    ]
    twists = [np.concatenate([random.normal(size=3), random.normal(size=3) * 0.6]) for _ in bodies]

    def states(k=0, step=STILL):
        """With a small twist after the finite motion of body k."""
        result = {}
        for j, (body, twist) in enumerate(zip(bodies, twists, strict=True)):
            moved = Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]
            if j == k:
                after = Rotation.from_rotvec(step[3:]).as_matrix()
                moved = after @ moved[0], after @ moved[1] + step[:3]
            result[body.name] = RigidState(body, np.concatenate([moved[1], Rotation.from_matrix(moved[0]).as_rotvec()]))
        return result

    _, rows = measure.evaluate(states())
    size = max(np.abs(row).max() for row in rows.values())
    for k, label in enumerate(measure.bodies if len(measure.bodies) > 1 else ()):
        index = [body.name for body in bodies].index(label)
        for j, unit in enumerate(np.eye(6)):
            ahead, behind = (measure.evaluate(states(index, sign * 1e-6 * unit))[0] for sign in (1, -1))
            found, expected = with_value @ rows[label][:, j], (ahead - behind) / 2e-6
            np.testing.assert_allclose(found, expected, rtol=0, atol=2e-8 * size, err_msg=k)


def as_lists(measure):
    """The measure made with lists in place of arrays."""
    given = {f.name: getattr(measure, f.name) for f in fields(measure)}
    given = {name: one.tolist() if isinstance(one, np.ndarray) else one for name, one in given.items()}
    if "weights" in given:
        given["weights"] = [(path, along.tolist()) for path, along in given["weights"]]
    return type(measure)(**given)


def test_lists_give_the_directions_that_arrays_give():
    """Of what a tumbling body is read and held by, in Exudyn's own sensors and springs and in general ones."""
    scalar = {name: one for name, one in MEASURES.items() if len(one.components) == 1 and name != "combination"}
    rate = PointVelocity((("a.p", ODD[0]), ("b.q", ODD[1])), "b.q", angular=True)

    def run(form):
        outputs = [Output(name, "", form(one), 2.0) for name, one in scalar.items()]
        outputs += [Output("rate", "", form(rate), 2.0, 1)]
        springs = [Tie(f"spring {k}", Spring(form(one), 0.3)) for k, one in enumerate(scalar.values())]
        springs += [Tie("rub", Spring(form(rate), 0.0, 0.01))]
        springs += [Tie("pose", Spring(form(MEASURES["vector"]), 0.2 * np.eye(6)))]
        inertia = 1e-2 * np.diag([1.0, 2.0, 2.5])
        body = RigidBody("b", {"p": STILL[:3], "q": (0.1, 0.2, -0.1)}, 1.0, inertia, angular_velocity=(1.0, -2.0, 1.5))
        held = RigidBody("a", {"p": (0.3, 0.1, 0.2), "q": STILL[:3]}, fixed=True)
        scene = Scene("b", (held, body), springs=(*springs, Given("read", tuple(outputs))), gravity=(0, 0, -1.0))
        return np.array(list(free_run(scene, 0.1, 1e-2, start="released")[0].values()))

    np.testing.assert_array_equal(run(as_lists), run(lambda one: one))


@pytest.mark.parametrize("rotation", ["vector", "tilt"])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.9e-4, 2.1e-4, 1.3, 3.0, 3.14159])
def test_rates_of_a_relative_pose_at_any_angle(rotation, angle):
    """As the bodies rotate and move about general positions: the derivative of the value by central differences.

    About the shaft of a tilt, it is the angular velocity.
    """
    shaft, random = np.array([0.6, 0.0, 0.8]), np.random.default_rng(5)
    measure = RelativePose("a.p", "b.q", ODD, rotation, shaft)
    first = Rotation.from_rotvec(random.normal(size=3))
    second = Rotation.from_rotvec(angle * np.array([2.0, -1.0, 2.0]) / 3) * first
    places, reference, twist = random.normal(size=(2, 3)), random.normal(size=(2, 3)), random.normal(size=(2, 6))

    def at(time):
        """The poses, as both move with their twists."""
        moved = [Rotation.from_rotvec(time * t[3:]) * r for t, r in zip(twist, (first, second), strict=True)]
        return [(p + time * t[:3], r.as_matrix()) for p, t, r in zip(places, twist, moved, strict=True)]

    step = 1e-7
    ahead, behind = (measure.at(at(sign * step), reference)[0] for sign in (1, -1))
    rate = measure.at(at(0.0), reference)[1] @ twist.ravel()
    expected = (ahead - behind) / (2 * step)
    if rotation == "tilt":
        expected[3:] += shaft * (first.apply(ODD @ shaft) @ (twist[1, 3:] - twist[0, 3:]))
    np.testing.assert_allclose(rate, expected, rtol=0, atol=1e-7)


@dataclass(frozen=True)
class Tie(ForceElement):
    """A given term."""

    term: object = None

    def terms(self, scene):
        """It."""
        return (self.term,)


FASTER = {
    "distance": Spring(Distance("ground.p", "block.c"), 300.0, 0.4),
    "axis": Spring(Displacement.between("ground.p", "block.c", np.array([0.0, 1.5, 0.0])), 300.0, 0.4),
    "oblique": Spring(Displacement.between("ground.p", "block.c", np.array([0.9, 0.0, 1.2])), 300.0, 0.4),
    "turning": Spring(
        Displacement.between("bar.right", "block.c", np.array([0.6, 0.0, 0.8]), axes_of="block.c"), 9.0, 0.4
    ),
    "along axes of a third point": Spring(
        Displacement.between("ground.p", "block.c", np.array([0.6, 0.0, 0.8]), axes_of="bar.right"), 90.0, 0.4
    ),
    "of three points": Spring(
        Displacement((("ground.p", -ODD[0]), ("bar.right", 0.4 * ODD[0]), ("block.c", 0.6 * ODD[0]))),
        300.0,
        0.4,
    ),
    "bushing": Spring(RelativePose("bar.right", "block.c", ODD), np.diag([90.0, 50, 70, 2, 3, 4]), 0.02 * np.eye(6)),
    "of a far rotation": Spring(
        RelativePose("bar.right", "block.c", ODD, "tilt", np.array([0.0, 1.0, 0.0])),
        np.diag([90.0, 50, 70, 0.02, 0.0, 0.04]),
    ),
    "of two displacements": Spring(
        Combination(
            (
                (0.7, Displacement.between("ground.p", "block.c", ODD[1])),
                (-0.4, Displacement.between("bar.right", "block.c", ODD[2])),
            )
        ),
        *(300.0, 0.4),
    ),
    "damper": Spring(
        PointVelocity((("bar.right", -1.5 * ODD[0]), ("block.c", 1.5 * ODD[0])), "bar.right", angular=True), 0.0, 0.02
    ),
}

"""Springs and dampers along directions of any length."""


def tied(*springs, duration=0.05):
    """Outputs of a block that is released beside a flexible bar that swings."""
    body = reduced()
    bar = FlexibleBody("bar", body, -ODD @ body.point("left").position, ODD, angular_velocity=(1.0, -2.0, 3.0))
    block = RigidBody(
        "block", {"c": [0.03, -0.02, 0.05]}, 0.3, 1e-3 * np.diag([1.0, 2.0, 2.5]), (0.3, 0.2, -0.1), rotation=ODD
    )
    sensors = (
        *(Encoder(axis, "ground.o", "block.c", axis) for axis in "xyz"),
        Encoder("end", "ground.o", "bar.right", "x"),
        AngleSensor("twist", "bar.right", "block.c", (0.3, 0.4, -1.2)),
        Encoder("seen", "bar.right", "block.c", (0.3, 0.4, -1.2), frame="bar.right"),
    )
    scene = Scene(
        "tied", (GROUND, bar, block), springs=springs, sensors=sensors, gravity=(0, 1, -9.81), damping_ratio=0.0
    )
    return free_run(scene, duration, 1e-3, 1.0, start="released", spectral_radius=0.9)[0]


untied = functools.cache(tied)


@pytest.mark.parametrize("name", FASTER)
def test_faster_items_are_the_general_ones(name, monkeypatch):
    """In large motion, of bodies turned about odd axes; the forces too, as sensors read them."""
    from nassim.simulation.exudyn import outputs, springs
    from nassim.simulation.exudyn.items import Items

    law, free = FASTER[name], untied()
    part = Given("tie", (law, *(SpringForce(f"force {c}", "", law, c) for c in law.measure.components)))
    found = tied(part)
    monkeypatch.setattr(springs, "FASTER_FORCES", {})
    monkeypatch.setattr(outputs, "FASTER_OUTPUTS", {})
    monkeypatch.setattr(Items, "has_markers", lambda *_: False)
    expected = tied(part)
    for output in found:
        np.testing.assert_allclose(found[output], expected[output], rtol=0, atol=2e-6 * np.ptp(expected[output]))
    assert any(np.abs(free[o] - found[o]).max() > 1e-4 * np.ptp(found[o]) for o in free)


def test_faster_forces_of_inputs_are_the_general_ones(monkeypatch):
    """Along lines, directions of the world and of bodies that turn, and on coordinates: together, each by an input."""
    from nassim.simulation.exudyn import items

    bar, ends = FlexibleBody("bar", reduced(), rotation=ODD), ("bar.right", "block.c")
    stretch = BodyCoordinates.between(bar, "left", "right", np.eye(3)[0])
    measures = (
        *(Distance("ground.p", "block.c"), Displacement((("bar.right", ODD[1]), ("block.c", ODD[0])))),
        *(PointVelocity(((path, ODD[2]),), axes) for path, axes in zip(ends * 2, (*ends, *ends[::-1]), strict=True)),
        *(PointVelocity(((path, 1e-2 * ODD[2]),), axes, angular=True) for path in ends for axes in ("", *ends)),
        *(stretch, Combination(((2.0, stretch), (0.3, Displacement.between(*ends, ODD[1]))))),
    )
    forces = Given("forces", tuple(AppliedForce(f"{k}", "N", one, 0.2 + 0.1 * k) for k, one in enumerate(measures)))
    found = tied(forces, duration=5e-3)
    monkeypatch.setattr(items.Items, "has_marker", lambda *_: False)
    monkeypatch.setattr(items, "on_coordinates", lambda *_: None)
    expected = tied(forces, duration=5e-3)
    for output in found:
        np.testing.assert_allclose(found[output], expected[output], rtol=0, atol=2e-6 * np.ptp(expected[output]))


def test_a_force_stiffer_than_the_springs_along_a_measure_without_an_item_of_its_own(monkeypatch):
    """A bar on a soft hinge is pulled by 100 N towards a point, until the hinge's moment is that of the pull."""
    from nassim.simulation.exudyn.items import Items

    monkeypatch.setattr(Items, "has_markers", lambda *_: False)
    ground = RigidBody("ground", {"o": (0, 0, 0), "far": ODD @ [1.0, 0.2, 0]}, fixed=True)
    bar = RigidBody("bar", {"hinge": (0, 0, 0), "tip": ODD @ [0.5, 0, 0]}, 2.0, 0.05 * np.eye(3))
    hinge = Bushing("hinge", "ground.o", "bar.hinge", [1e8, 1e8, 1e8, 1e5, 1e5, 20.0], np.zeros(6), ODD)
    pull, turn = (
        LinearActuator("pull", "ground.far", "bar.tip", "push"),
        AngleSensor("turn", "ground.o", "bar.hinge", ODD[:, 2]),
    )
    scene = Scene("pulled", (ground, bar), springs=(hinge,), actuators=(pull,), sensors=(turn,), gravity=(0, 0, 0))
    angle = static_response(scene, {"push": -100.0})["turn"]
    tip = 0.5 * np.array([np.cos(angle), np.sin(angle)])
    way = np.array([1.0, 0.2]) - tip
    moment = 100.0 * (tip[0] * way[1] - tip[1] * way[0]) / np.linalg.norm(way)
    assert angle > 0.1
    assert 20.0 * angle == pytest.approx(moment, rel=1e-4)


@dataclass(frozen=True)
class Swelling(PointMeasure):
    """Half of the growth of the squared distance of two points over its start: a measure that nassim does not have."""

    a: Path
    b: Path

    @property
    def points(self):
        return (self.a, self.b)

    def at(self, poses, reference):
        apart, start = poses[1][0] - poses[0][0], reference[1] - reference[0]
        length = np.linalg.norm(start)
        row = np.concatenate([-apart, np.zeros(3), apart, np.zeros(3)]) / length
        return np.array([(apart @ apart - start @ start) / (2 * length)]), row[None]


@dataclass(frozen=True)
class Swell(ForceElement):
    """A spring on it, and an output of it."""

    a: Path
    b: Path

    def terms(self, scene):
        measure = Swelling(self.a, self.b)
        return (Spring(measure, 4e3, 3.0), Output(self.name, "m", measure))


def swollen(fidelity, part):
    """A bar between bushing and the part."""
    body = reduced()
    bar = FlexibleBody("bar", body, -ODD @ body.point("left").position, ODD, fidelity)
    hook = RigidBody(
        "hook", {"o": np.zeros(3)}, fixed=True, position=bar.point_position("right") + np.array([0.03, 0.04, 0.05])
    )
    foot = Bushing("foot", "ground.o", "bar.left", [1e4, 2e4, 3e4, 20.0, 30.0, 40.0], 0.1 * np.ones(6))
    push = PointForce("push", "bar.right", (0.6, 0.0, 0.8), "push")
    return Scene("swollen", (GROUND, hook, bar), (), (push,), springs=(foot, part), damping_ratio=0.0)


def test_a_measure_that_nassim_does_not_have_runs_in_every_verb():
    """As the distance does, to which it is equal for small motion."""
    own, known = Swell("part", "hook.o", "bar.right"), SpringDamper("part", "hook.o", "bar.right", "line", 4e3, 3.0)
    frequency = np.geomspace(1.0, 300.0, 9)
    reading = Encoder("part", "hook.o", "bar.right", "line")
    model, expected = (
        linearize(swollen("linear", own)),
        linearize(replace(swollen("linear", known), sensors=(reading,))),
    )
    found, wanted = (frequency_response(m, frequency).values for m in (model, expected))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    time = 1e-4 * np.arange(51)
    pulse = TimeHistory(time, 1e-2 * np.sin(np.pi * time / time[-1])[None] ** 2, ("push",), ("N",))
    runs = []
    for fidelity, method in (("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")):
        record = simulate(swollen(fidelity, own), pulse, time_step=1e-4, method=method, progress=False)
        runs.append(record.values[record.names.index("part")])
        statics = static_response(swollen(fidelity, own), {"push": 1e-2})
        assert statics["part"] == pytest.approx(found[0, 0, 0].real * 1e-2, rel=2e-2)
    for run in runs[1:]:
        np.testing.assert_allclose(run, runs[0], rtol=0, atol=2e-3 * np.abs(runs[0]).max())
    scene = swollen("linear", own)
    copy = placed(scene, "copy", position=(1, 2, 3), rotation=ODD)
    np.testing.assert_allclose(linearize(copy).poles(), linearize(scene).poles(), rtol=1e-6)
    trimmed = linearize(replace(scene, cutoff_frequency=500.0))
    assert frequency_response(trimmed, frequency[:1]).values == pytest.approx(found[:, :, :1], rel=1e-6)
    assert "part" in describe(scene)
    assert "" not in describe(scene).splitlines()
    assert {mark.name for mark in view_scene(scene).marks} >= {"part", "push"}
    assert len(mode_motion(scene, 1)[1].time)


@dataclass(frozen=True)
class Wish(Term):
    """A term that no engine knows."""


def test_springs_with_a_preload_in_large_motion():
    """A mass lets go of two of them: it falls to the sum of both preloads, as a damped oscillator does."""
    axis, mass, load = ODD[:, 1], 0.7, np.array([0.0, 5.0, 0.0, 0.0, 0.0, 0.0])
    body = RigidBody("mass", {"c": np.zeros(3)}, mass, 1e-3 * np.eye(3))
    springs = (
        SpringDamper("line", "ground.o", "mass.c", tuple(axis), 120.0, 1.5, preload=3.0),
        Bushing("six", "ground.o", "mass.c", np.full(6, 80.0), np.full(6, 2.0), ODD, load),
    )
    guide, read = prismatic("guide", "ground.o", "mass.c", tuple(axis)), Encoder("x", "ground.o", "mass.c", tuple(axis))
    scene = Scene("mass", (GROUND, body), (guide,), (), (read,), springs, damping_ratio=0.0)
    found, time = free_run(scene, 0.25, 5e-4, start="released")
    pole = np.roots([mass, 3.5, 200.0])[0]
    expected = -8.0 / 200.0 * (1 - (np.exp(pole * time) * (1 + 1j * pole.real / pole.imag)).real)
    np.testing.assert_allclose(found["x"], expected, rtol=0, atol=1e-4 * 8.0 / 200.0)


def test_a_spring_of_some_directions_leaves_the_others_free():
    """A stiffness of rank two, with the default damping: four rigid-body modes, and two by M and K alone."""
    shape = np.random.default_rng(4).normal(size=(6, 2))
    inertia = ODD @ np.diag([2e-3, 3e-3, 4e-3]) @ ODD.T
    mass = RigidBody("mass", {"c": np.zeros(3)}, 0.7, inertia)
    given = Given("spring", (Spring(RelativePose("ground.o", "mass.c"), 1e4 * shape @ shape.T),))
    assembly = assemble(Scene("mass", (GROUND, mass), springs=(given,)))
    whole = scipy.linalg.block_diag(0.7 * np.eye(3), inertia)
    squares = np.sort(np.linalg.eigvals(1e4 * shape.T @ np.linalg.solve(whole, shape)).real)
    assert np.count_nonzero(assembly.modal.rigid_modes) == 4
    assert (2 * np.pi * assembly.modal.frequency[4:]) ** 2 == pytest.approx(squares, rel=1e-9)
    same = Given("spring", (Spring(RelativePose("ground.o", "mass.c"), 50.0, 0.2),))
    poles = linearize(Scene("mass", (GROUND, mass), springs=(same,), damping_ratio=0.0)).poles()
    for inert in (0.7, 2e-3, 3e-3, 4e-3):
        assert np.abs(poles - np.roots([inert, 0.2, 50.0])[0]).min() < 1e-6


@pytest.mark.parametrize("linear", [True, False])
def test_a_law_within_a_body_in_small_motion_beside_one_that_spins(linear):
    """On coordinates of a turned bar: as by exact steps of the bar alone with a spring and its damper."""
    body = reduced()
    bar = FlexibleBody("bar", body, -ODD @ body.point("left").position, ODD, "linear")
    stretch = BodyCoordinates.between(bar, "left", "right", np.array([0.3, 0.8, -0.5]))
    foot = Bushing("foot", "ground.o", "bar.left", [1e4, 2e4, 3e4, 20.0, 30.0, 40.0], 0.1 * np.ones(6))
    push, end = PointForce("push", "bar.right", (0.6, 0.0, 0.8), "push"), Encoder("end", "ground.o", "bar.right", "y")
    alone = Scene(
        "bar",
        (GROUND, bar),
        actuators=(push,),
        sensors=(end,),
        springs=(foot, Given("within", (Spring(stretch, 3e4, 30.0),))),
        damping_ratio=0.0,
    )
    top = RigidBody("top", {"c": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), (1.0, 0, 0), angular_velocity=(0, 5.0, 0))
    law = NonlinearSpring(stretch, force=lambda v, w: 3e4 * v + 30.0 * w, tangent=lambda _v, _w: (3e4, 30.0))
    law = Spring(stretch, 3e4, 30.0) if linear else law
    beside = replace(alone, bodies=(GROUND, bar, top), springs=(foot, Given("within", (law,))))
    time = 1e-4 * np.arange(81)
    pulse = TimeHistory(time, 20.0 * np.sin(np.pi * np.minimum(time / 4e-3, 1.0))[None] ** 2, ("push",), ("N",))
    undamped = replace(alone, springs=(foot, Given("within", (Spring(stretch, 3e4),))))
    found, expected, *others = (
        simulate(scene, pulse, time_step=1e-4, progress=False, **options)["end"]
        for scene, options in (
            (beside, {"spectral_radius": 1.0}),
            (alone, {"method": "exact"}),
            (replace(alone, springs=(foot,)), {"method": "exact"}),
            (undamped, {"method": "exact"}),
        )
    )
    assert min(np.abs(other - expected).max() for other in others) > 0.05 * np.ptp(expected)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-3 * np.ptp(expected))


UNEQUAL = Displacement((("bar.right", -0.7 * ODD[1]), ("block.c", ODD[0])), "block.c")


SCALAR = {name: law for name, law in FASTER.items() if len(law.measure.components) == 1}
SCALAR["unequal directions"] = Spring(UNEQUAL, 9.0, 0.4)


@pytest.mark.parametrize("law", SCALAR.values(), ids=SCALAR)
def test_a_spring_of_any_measure_tells_its_force(law):
    """Its stiffness times the measure and its damping times the rate, as both are read, beside a bar that swings."""
    body = reduced()
    bar = FlexibleBody("bar", body, -ODD @ body.point("left").position, ODD, angular_velocity=(1.0, -2.0, 3.0))
    block = RigidBody("block", {"c": [0.03, -0.02, 0.05]}, 0.3, 1e-3 * np.diag([1.0, 2.0, 2.5]), (0.3, 0.2, -0.1))
    (stiffness, damping), measure = law.scalars, law.measure
    terms = [law, SpringForce("pull", "N", law), Output("rate", "", measure, 1.0, 1)]
    terms += [Output("way", "", measure)] if measure.has_value else []
    scene = Scene("tied", (GROUND, bar, block), springs=(Given("tie", tuple(terms)),), damping_ratio=0.0)
    found, _ = free_run(scene, 0.05, 1e-3, start="released")
    expected = stiffness * found.get("way", 0.0) + damping * found["rate"]
    np.testing.assert_allclose(found["pull"], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_unknown_terms_and_measures_are_refused_when_a_scene_is_made():
    with pytest.raises(TypeError, match="Given 'wish': Wish is no term that engines know; known are AppliedForce"):
        swollen("linear", Given("wish", (Spring(Distance("hook.o", "bar.right"), 1.0), Wish())))
    with pytest.raises(TypeError, match="the measure of its Spring is a Height; derive it from Measure"):
        swollen("linear", Given("wish", (Spring(Height("height"), 1.0),)))


class Height(str):
    """A text that passes for a measure."""

    __slots__ = ()
    has_value = True


def test_a_combination_unwraps_one_angle():
    angle = RotationAngle("ball.c", np.eye(3)[2], "ground.o")
    slide = Displacement.between("ground.o", "ball.c", np.eye(3)[2])
    assert Combination(((3.0, slide), (-2.0, angle))).period == pytest.approx(4 * np.pi)
    assert Combination(((3.0, slide),)).period is None
    with pytest.raises(ValueError, match="several angles cannot be unwrapped"):
        Combination(((1.0, angle), (1.0, slide), (-2.0, angle))).period  # noqa: B018


def test_a_constraint_holds_all_its_components():
    """Of a pose by its rotation vector, which is no joint of the engine: a ball that slides along one axis."""
    ball = RigidBody("ball", {"c": np.zeros(3)}, 0.7, np.diag([3e-3, 2e-3, 1e-3]))
    pose = RelativePose("ground.o", "ball.c", np.eye(3), rotation="vector")
    guide = Given("guide", (Constraint("guide", pose, ("y", "z", "rx", "ry", "rz")),))
    push = PointForce("push", "ball.c", "z", "push")
    sensors = tuple(Encoder(axis, "ground.o", "ball.c", axis) for axis in "xyz")
    scene = Scene("guided", (GROUND, ball), (), (push,), sensors, (guide,), gravity=(1.2, -3.0, -9.81))
    found, time = free_run(scene, 0.2, 2e-3, start="released")
    np.testing.assert_allclose(found["x"], 0.6 * time**2, rtol=0, atol=1e-6)
    np.testing.assert_allclose([found["y"], found["z"]], 0, atol=1e-9)


@pytest.mark.parametrize("axes_of", ["", "ground.o", "wheel.o", "other.o"])
def test_a_rotation_is_damped_about_axes_of_any_point(axes_of):
    """A wheel on an axle slows down by c / J, whoever carries the axis: a body that a joint holds to the ground too."""
    axis = np.array([0.48, -0.6, 0.64])
    wheel = RigidBody("wheel", {"o": np.zeros(3)}, 1.0, 0.01 * np.eye(3), angular_velocity=5.0 * axis)
    other = RigidBody("other", {"o": np.zeros(3)}, 1.0, 0.01 * np.eye(3))
    drag = PointVelocity((("ground.o", -axis), ("wheel.o", axis)), axes_of, angular=True)
    joints = revolute("axle", "ground.o", "wheel.o", tuple(axis)), fixed("hold", "ground.o", "other.o")
    sensor, law = AngleSensor("turn", "ground.o", "wheel.o", tuple(axis)), Given("drag", (Spring(drag, 0.0, 0.03),))
    scene = Scene("wheel", (GROUND, wheel, other), joints, sensors=(sensor,), springs=(law,), gravity=np.zeros(3))
    found, time = free_run(scene, 0.3, 5e-3, start="released")
    np.testing.assert_allclose(found["turn"], 5.0 / 3.0 * -np.expm1(-3.0 * time), rtol=0, atol=2e-4)


def test_what_an_engine_cannot_do_is_refused_by_name():
    """Before anything runs."""
    turn = PointVelocity((("bar.right", np.eye(3)[0]),), angular=True)
    still = TimeHistory(1e-3 * np.arange(3), np.zeros((1, 3)), ("push",), ("N",))
    scene = swollen("ffrf", Given("twist", (Output("twist", "rad", turn),)))
    with pytest.raises(
        ValueError, match=r"large motion: the Output on a PointVelocity of Given 'twist' has a value in small"
    ):
        simulate(scene, still, time_step=1e-3, progress=False)
    assert "twist" in linearize(swollen("linear", Given("twist", (Output("twist", "rad", turn),)))).outputs
    ball = RigidBody("ball", {"c": np.zeros(3)}, 0.1, 1e-3 * np.eye(3), (0.3, 0.2, 0.1))
    wheel = replace(ball, name="wheel", position=np.array([0.5, 0.0, 0.2]))
    lever = Combination(((1.0, Distance("bar.right", "ball.c")), (-2.0, Distance("ball.c", "wheel.c"))))
    tied = Given("lever", (Constraint("lever", lever),))
    three = replace(scene, bodies=(*scene.bodies, ball, wheel), springs=(*scene.springs[:1], tied))
    with pytest.raises(
        ValueError, match="large motion: the Constraint on a Combination of Given 'lever' constrains more than"
    ):
        simulate(three, still, time_step=1e-3, progress=False)
    stay = Given("stay", (Constraint("stay", Distance("bar.left", "ball.c")),))
    knob = replace(ball, position=scene.point_position("bar.right"))
    carried = replace(scene, bodies=(*scene.bodies, knob), joints=(fixed("hold", "bar.right", "ball.c"),))
    carried = replace(carried, springs=(scene.springs[0], stay))
    with pytest.raises(ValueError, match="constraint 'stay': rigid joints make one body of bar, ball"):
        simulate(carried, still, time_step=1e-3, progress=False)


def test_accelerations_of_any_measure_are_derivatives_of_its_rates():
    """A pendulum in large motion: of a distance and of an angle, which have no faster reading."""
    arm = RigidBody(
        "arm",
        {"hinge": np.array([0.0, 0.0, 0.4]), "tip": [0.1, 0.0, -0.2]},
        0.7,
        np.diag([3e-3, 2e-3, 1e-3]),
        (0, 0, -0.4),
    )
    hinge = revolute("hinge", "ground.o", "arm.hinge", (0.0, 0.6, 0.8))
    measures = {
        "line": Distance("ground.p", "arm.tip"),
        "angle": RotationAngle("arm.tip", np.array([0, 0.6, 0.8]), "ground.o"),
        "axes": Displacement.between("ground.p", "arm.tip", np.array([0.3, -0.5, 0.8]), axes_of="arm.tip"),
        "spin": PointVelocity((("arm.tip", np.array([0.3, -0.5, 0.8])),), "arm.hinge", angular=True),
        "lean": RotationDeviation(
            "ground.o", "arm.tip", np.eye(3)[0], "arm.hinge", "ground.p", np.array([0.5, -1.0, 2.0])
        ),
    }
    outputs = tuple(
        Output(f"{name}{k}", "", m, 2.0, k) for name, m in measures.items() for k in range(not m.has_value, 3)
    )
    scene = Scene("arm", (GROUND, arm), (hinge,), springs=(Given("out", outputs),), gravity=(15.0, 0, -29.4))
    found, _ = free_run(scene, 0.1, 1e-3, start="released", spectral_radius=0.7)
    for name in measures:
        orders = [found[f"{name}{k}"] for k in range(3) if f"{name}{k}" in found]
        assert orders[0][0] == pytest.approx(0.0, abs=1e-12)
        for low, high in pairwise(orders):
            middle = (low[2:] - low[:-2]) / 2e-3
            np.testing.assert_allclose(high[1:-1], middle, rtol=0, atol=3e-3 * np.ptp(middle))
    assert np.ptp(found["angle0"]) > 0.3


def test_the_ground_moves_all_parts_of_a_combination():
    """A mass on a spring on a shaking ground: each part of an inertial output counts by its factor."""
    up, mass, stiffness = np.eye(3)[2], 0.7, 300.0
    body = RigidBody("mass", {"c": np.zeros(3), "p": [0.1, 0, 0], "q": [0, 0.2, 0]}, mass, 1e-2 * np.eye(3))
    both = Combination(((2.0, PointVelocity((("mass.p", up),))), (-0.5, PointVelocity((("mass.q", up),)))))
    scene = Scene(
        "mass",
        (GROUND, body),
        (Joint("guide", "ground.o", "mass.c", free="z"),),
        (GroundAcceleration("shake", "z", "shake"),),
        springs=(
            SpringDamper("spring", "ground.o", "mass.c", "z", stiffness),
            Given("reading", (Output("a", "m/s2", both, derivative=2, inertial=True),)),
        ),
        damping_ratio=0.0,
    )
    frequency = np.array([0.5, 2.0, 9.0])
    found = frequency_response(linearize(scene), frequency).response("a", "shake")
    expected = 1.5 * stiffness / (stiffness - mass * (2 * np.pi * frequency) ** 2)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_law_says_which_method_it_lacks():
    law = ForceLaw(RotationAngle("wheel.hub", np.eye(3)[0], "base.o"))
    for method in ("resistance", "tangents"):
        with pytest.raises(NotImplementedError, match=f"force law ForceLaw must define the method `{method}`"):
            getattr(law, method)(np.zeros(1), np.zeros(1))


def test_a_force_along_any_measure_is_a_torque_about_its_axis():
    """By an amplifier, on a body that turns far."""
    axis = np.array([0.0, 0.6, 0.8])
    wheel = RigidBody("wheel", {"hub": np.zeros(3)}, 1.0, np.diag([2e-2, 3e-2, 2.5e-2]), (0.1, 0.2, 0.3))
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True, position=wheel.position)
    hinge = revolute("hinge", "base.o", "wheel.hub", tuple(axis))
    angle = RotationAngle("wheel.hub", axis, "base.o")
    own = Given("motor", (AppliedForce("u", "N m", angle, 4.0, 80.0), Output("turn", "rad", angle)))
    scene = Scene("wheel", (base, wheel), (hinge,), springs=(own,))
    time = 1e-3 * np.arange(151)
    record = simulate(scene, TimeHistory(time, np.ones((1, 151)), ("u",), ("N m",)), time_step=1e-3, progress=False)
    inertia, rate = axis @ wheel.inertia @ axis, 2 * np.pi * 80.0
    expected = 4.0 / inertia * (time**2 / 2 - time / rate + (1 - np.exp(-rate * time)) / rate**2)
    assert expected[-1] > 1.0
    np.testing.assert_allclose(record.values[1], expected, rtol=0, atol=2e-3 * expected[-1])
