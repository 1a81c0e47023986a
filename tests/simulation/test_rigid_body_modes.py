"""Free motions follow from geometry: soft springs beside stiff bodies, really free bodies, neutral equilibrium."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice, make_bar
from scipy.spatial.transform import Rotation
from superelements import grounded_at

from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    PointForce,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    frequency_response,
    linearize,
    simulate,
)
from nassim.base.rigid_motion import rigid_motions, rigid_transfer
from nassim.bodies.projection import trim_body
from nassim.bodies.strain import strain_eigenmodes
from nassim.exchange.export import body_damping, body_state_space
from nassim.identification.apply import modal_gains
from nassim.simulation.model.assembly import assemble
from nassim.systems.linear_model import damping

MASS = 100.0
CENTRE = np.array([0.3, -0.2, 0.1])
QUIET = TimeHistory(np.array([0.0, 1.0]), np.zeros((0, 2)), (), ())


@pytest.fixture(scope="module")
def flexure():
    """4 mm of steel, whose fastest mode is above 1 MHz."""
    model = build_fe_model(make_bar(length=4e-3, side=1e-3), element_size=1e-3, order=2, progress=False)
    return craig_bampton(model, n_modes=2, progress=False)


def table(flexure, frequency, *, spring_damping=0.0, fidelity="linear", **options):
    """A table on three springs at its centre, with the flexure on its rim."""
    stiffness = MASS * (2 * np.pi * frequency) ** 2
    base = RigidBody("base", {"centre": np.zeros(3)}, fixed=True)
    rim = np.array([0.2, 0.1, 0.0])
    plate = RigidBody("table", {"centre": np.zeros(3), "rim": rim}, MASS, np.diag([5.0, 6.0, 7.0]), CENTRE)
    leaf = FlexibleBody("flexure", flexure, CENTRE + rim, fidelity=fidelity)
    springs = [SpringDamper(a, "base.centre", "table.centre", a, stiffness, spring_damping) for a in "xyz"]
    return Scene(
        "table",
        (base, plate, leaf),
        (Joint("foot", "table.rim", "flexure.left"),),
        (PointForce("push", "table.centre", "x", "force"),),
        (Encoder("motion", "base.centre", "table.centre", "x"),),
        tuple(springs),
        **options,
    )


def step_response(mass, stiffness, damper, time):
    omega, decay = np.sqrt(stiffness / mass), damper / (2 * mass)
    turn = np.sqrt(omega**2 - decay**2)
    return (1 - np.exp(-decay * time) * (np.cos(turn * time) + decay / turn * np.sin(turn * time))) / stiffness


@pytest.mark.parametrize("frequency", [0.7, 1e-3])
@pytest.mark.parametrize("damper", [0.0, 0.05])
def test_soft_springs_beside_a_stiff_body(flexure, frequency, damper):
    """An oscillator's closed form, though its frequency is less than a millionth of the highest."""
    scene = table(flexure, frequency, spring_damping=damper, damping_ratio=0.0)
    assembly = assemble(scene)
    assert frequency < 1e-6 * assembly.modal.frequency[-1]
    assert np.count_nonzero(assembly.modal.rigid_modes) == 3  # springs at one point leave the rotations free
    step = 1e-3 / frequency
    time = np.arange(2001) * step
    push = TimeHistory(time, np.ones((1, 2001)), ("force",), ("N",))
    found = simulate(scene, push, time_step=step, method="exact", progress=False)["motion"]
    stiffness = MASS * (2 * np.pi * frequency) ** 2
    expected = step_response(MASS + flexure.mass, stiffness, damper, time)
    assert expected.max() > 1.2 / stiffness
    np.testing.assert_allclose(found, expected, atol=1e-6 * expected.max())


def test_linear_model_of_soft_springs_beside_a_stiff_body(flexure):
    scene = table(flexure, 0.7, spring_damping=20.0, damping_ratio=0.0)
    mass, stiffness = MASS + flexure.mass, MASS * (2 * np.pi * 0.7) ** 2
    model = linearize(scene)
    s = 2j * np.pi * np.array([1e-3, 0.3, 0.7, 3.0])
    expected = 1 / (mass * s**2 + 20.0 * s + stiffness)
    found = frequency_response(model, s.imag / (2 * np.pi)).values[0, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    natural, ratio = damping(model)
    slow = np.argsort(np.abs(natural - np.sqrt(stiffness / mass) / (2 * np.pi)))[:3]
    np.testing.assert_allclose(natural[slow], np.sqrt(stiffness / mass) / (2 * np.pi), rtol=1e-6)
    np.testing.assert_allclose(ratio[slow], 20.0 / (2 * np.sqrt(stiffness * mass)), rtol=1e-6)


def test_soft_modes_have_their_share_of_the_static_response(flexure):
    """The three modes of the springs hold all of 1 / k; the free rotations none."""
    gains = modal_gains(assemble(table(flexure, 0.7)))[0, 0]
    assert gains.sum() == pytest.approx(1 / (MASS * (2 * np.pi * 0.7) ** 2), rel=1e-6)
    assert np.all(gains[:3] == 0)


def test_soft_modes_have_the_modal_damping_that_the_scene_states(flexure):
    assembly = assemble(table(flexure, 0.7, damping_ratio=(0.01, 0.02, 0.03, 0.04)))
    np.testing.assert_array_equal(assembly.modal.damping.ratio[:8], [0, 0, 0, 0.01, 0.02, 0.03, 0.04, 0.04])


def test_loss_of_damping_of_soft_springs_is_told(flexure):
    push = TimeHistory(np.array([0.0, 1e-3]), np.ones((1, 2)), ("force",), ("N",))
    with pytest.warns(UserWarning, match=r"the modes at 0\.7, 0\.7, 0\.7 Hz, in which springs"):
        simulate(table(flexure, 0.7, fidelity="ffrf"), push, time_step=1e-3, progress=False)


def test_a_scene_that_nothing_holds_gets_no_warning_of_lost_damping(recwarn):
    plate = RigidBody("plate", {"centre": np.zeros(3)}, 2.0, np.eye(3))
    scene = Scene("free", (plate,), actuators=(PointForce("push", "plate.centre", "y", "force"),))
    push = TimeHistory(np.array([0.0, 1.0]), np.ones((1, 2)), ("force",), ("N",))
    simulate(scene, push, time_step=0.1, outputs=(), progress=False)
    assert not recwarn.list


def soft_and_stiff(slow, fast, twist=1.0):
    """Two masses of 1 kg and 1 g m2, 1 m apart along y on a bar as soft as stated, and a mode as fast as stated."""
    points = (RemotePoint("a", "a", [0.2, 0.3, 0.1]), RemotePoint("b", "b", [0.2, 1.3, 0.1]))
    fields = np.zeros((2, 3, 13))
    for k in range(2):
        fields[k, :, 6 * k : 6 * k + 3] = np.eye(3)
    corners = np.array([[1.0, *p.position, *f.T.ravel()] for p, f in zip(points, fields, strict=True)])
    mass = np.diag([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3] * 2 + [1.0])
    relative = np.hstack([-rigid_transfer([0.0, 1.0, 0.0]), np.eye(6)])
    stiffness = np.zeros((13, 13))
    stiffness[:12, :12] = (2 * np.pi * slow) ** 2 * relative.T @ np.diag([0.5, 1e3, 0.5, 1, twist, 1]) @ relative
    stiffness[12, 12] = (2 * np.pi * fast) ** 2
    gram = corners.T @ corners
    return ReducedBody("soft and stiff", remote_points=points, mass_matrix=mass, stiffness_matrix=stiffness, gram=gram)


def test_a_soft_body_is_not_free():
    """Its stretch against a closed form, 3e-9 of the fastest frequency; damping and export count it as elastic."""
    body = soft_and_stiff(1e-3, 1e7)
    frequency, shapes = body.eigenmodes()
    assert np.count_nonzero(frequency == 0) == 6
    stretch = np.sqrt(2 * 1e3) * 1e-3  # two masses of 1 kg on one spring
    assert np.abs(frequency / stretch - 1).min() < 1e-6
    motions = rigid_motions(np.array([p.position for p in body.remote_points]), 13)
    rest = motions - shapes[:, :6] @ (shapes[:, :6].T @ body.mass_matrix @ motions)
    assert np.abs(rest).max() < 1e-9
    model = body_state_space(body, damping_ratio=0.02)
    assert np.count_nonzero(np.diag(model.A)) == 7
    modal = np.diag(shapes.T @ body_damping(body, 0.02) @ shapes)
    np.testing.assert_allclose(modal, 0.04 * 2 * np.pi * frequency, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_a_body_with_a_joint_inside_is_free_in_it(fidelity):
    """No stiffness against a turn of its far end about the line between the points: a seventh free motion."""
    body = soft_and_stiff(1e3, 1e5, twist=0.0)
    assert np.count_nonzero(body.eigenfrequencies() == 0) == 7
    base = RigidBody("base", {"o": np.zeros(3)}, position=body.remote_points[0].position, fixed=True)
    wheel = RigidBody("wheel", {"o": np.zeros(3), "rim": np.array([0.1, 0, 0])}, 1.0, np.diag([0.1, 0.2, 0.15]))
    wheel = replace(wheel, position=body.remote_points[1].position)
    scene = Scene(
        "shaft",
        (base, FlexibleBody("shaft", body, fidelity=fidelity), wheel),
        (
            Joint("slide", "base.o", "shaft.a", free=("z",)),
            Joint("stop", "base.o", "shaft.a", free=("x", "y", "rx", "ry", "rz")),
            Joint("hub", "shaft.b", "wheel.o"),
        ),
        (PointForce("push", "wheel.rim", "z", "force"),),
        (Encoder("rim", "base.o", "wheel.rim", "z"),),
    )
    time = np.arange(101) * 1e-3
    push = TimeHistory(time, np.full((1, 101), 0.01), ("force",), ("N",))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what rounding turns does not spin
        found = simulate(scene, push, time_step=1e-3, progress=False)["rim"]
    assert found[-1] == pytest.approx(0.01 * 0.1**2 / (0.2 + 1e-3) * time[-1] ** 2 / 2, rel=1e-2)


def test_truncation_errors_of_a_soft_free_body():
    """A richer form half as soft: the errors of the stretch, sqrt(2) - 1, of the rigid motions nought."""
    body = soft_and_stiff(1e-3, 1e7)
    scale = np.diag([1.0] * 12 + [np.sqrt(2.0)])
    softer = replace(body, stiffness_matrix=scale @ body.stiffness_matrix @ scale / 2)
    errors = replace(body, enriched=softer).truncation_errors()
    np.testing.assert_array_equal(errors[:6], 0.0)
    np.testing.assert_allclose(errors[6:12], np.sqrt(2) - 1, rtol=1e-6)
    released = replace(body, released_stiffness=0.02 * body.stiffness_matrix).discretization_errors()
    np.testing.assert_array_equal(released[:6], 0.0)
    np.testing.assert_allclose(released[6:], 0.95**-0.5 - 1, rtol=1e-6)


@pytest.fixture(scope="module")
def block():
    return craig_bampton(lattice(), n_modes=3, progress=False)


def test_a_free_body_has_six_free_motions_and_falls(block):
    assert np.count_nonzero(block.eigenfrequencies() == 0) == 6
    assert np.count_nonzero(block.eigenfrequencies(guided={"left": "z"}) == 0) == 1
    assert np.count_nonzero(block.eigenfrequencies(fixed=["left"]) == 0) == 0
    scene = Scene("fall", (FlexibleBody("block", block, fidelity="linear"),), gravity=(0, 0, -9.81))
    with pytest.raises(RuntimeError, match="no static equilibrium"):
        simulate(scene, QUIET, time_step=0.1, method="exact", progress=False)


@pytest.mark.parametrize("point", ["left", "right"])
@pytest.mark.parametrize("cutoff_frequency", [1e3, 1e9])
def test_a_body_of_one_point_is_free_however_little_is_left(flexure, point, cutoff_frequency):
    """All stiffness against its point's motion is rounding; without modes there is nothing to compare that with."""
    loads = np.zeros((len(flexure.mass_matrix), 0))
    body = trim_body(flexure, points=[point], loads=loads, cutoff_frequency=cutoff_frequency)
    assert np.count_nonzero(body.eigenfrequencies() == 0) == 6
    assert (len(body.mass_matrix) == 6) == (cutoff_frequency == 1e3)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
@pytest.mark.parametrize("cutoff_frequency", [1e3, None])
def test_a_body_without_deformation_moves_as_a_rigid_one(flexure, fidelity, cutoff_frequency):
    """Force over both masses, though the floating frame has nothing to float."""
    leaf = FlexibleBody("leaf", flexure, fidelity=fidelity)
    block = RigidBody("block", {"c": np.zeros(3)}, 1e-3, 1e-9 * np.diag([1.0, 1.5, 2.0]))
    scene = Scene(
        "flight",
        (RigidBody("ground", {"o": np.zeros(3)}, fixed=True), leaf, block),
        (Joint("glue", "block.c", "leaf.left"),),
        (PointForce("push", "block.c", "x", "force"),),
        (Encoder("motion", "ground.o", "block.c", "x"),),
        cutoff_frequency=cutoff_frequency,
    )
    time = np.arange(101) * 1e-4
    push = TimeHistory(time, np.full((1, 101), 1e-3), ("force",), ("N",))
    found = simulate(scene, push, time_step=1e-4, progress=False)["motion"]
    np.testing.assert_allclose(found[-1], 1e-3 / (1e-3 + flexure.mass) * time[-1] ** 2 / 2, rtol=1e-3)


def test_a_body_tied_to_the_ground_is_not_free(block):
    tied = grounded_at(block, 1, 1e-5)
    expected = np.sqrt(scipy.linalg.eigh(tied.stiffness_matrix, tied.mass_matrix, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(tied.eigenfrequencies(), expected, rtol=1e-6)
    assert np.count_nonzero(assemble(Scene("tied", (FlexibleBody("b", tied),))).modal.rigid_modes) == 0


def hinged(block, axis, gravity, **options):
    """The block on a hinge through its left point."""
    base = RigidBody("base", {"pin": np.zeros(3)}, position=block.point("left").position, fixed=True)
    bodies = (base, FlexibleBody("block", block, fidelity="linear"))
    return Scene("hinged", bodies, (Joint("pin", "base.pin", "block.left", free=axis),), gravity=gravity, **options)


@pytest.mark.parametrize("along", ["rx", "ry", "rz", "x", "y", "z"])
@pytest.mark.parametrize("gravity", [(9.81, 0, 0), (0, 9.81, 0), (0, 0, 9.81)])
def test_gravity_is_refused_only_where_it_does_work(block, along, gravity):
    """Weight times the velocity of the centre of mass in the one free motion tells."""
    lever = block.center_of_mass - block.point("left").position
    axis = np.eye(3)["xyz".index(along[-1])]
    velocity = np.cross(axis, lever) if along[0] == "r" else axis
    scene = hinged(block, (along,), gravity)
    assert np.count_nonzero(assemble(scene).modal.rigid_modes) == 1
    if abs(velocity @ gravity) > 1e-6 * 9.81 * np.linalg.norm(lever):
        with pytest.raises(RuntimeError, match="no static equilibrium"):
            simulate(scene, QUIET, time_step=0.1, method="exact", progress=False)
    else:
        simulate(scene, QUIET, time_step=0.1, method="exact", progress=False)


@pytest.mark.parametrize("damper", [0.0, 3.0])
def test_neutral_equilibrium(damper):
    """A plate that slides freely along x and sags on a spring along z, pushed along x."""
    base = RigidBody("base", {"o": np.zeros(3)}, fixed=True)
    plate = RigidBody("plate", {"o": np.zeros(3)}, 2.0, np.diag([0.1, 0.15, 0.2]))
    leaf = FlexibleBody("leaf", soft_and_stiff(1e3, 1e4), position=(-0.2, -0.3, -0.1), fidelity="linear")
    springs = [SpringDamper("z", "base.o", "plate.o", "z", 500.0)]
    springs += [SpringDamper("drag", "base.o", "plate.o", "x", 0.0, damper)] if damper else []
    scene = Scene(
        "slide",
        (base, plate, leaf),
        (
            Joint("slide", "base.o", "plate.o", free=("x", "z")),
            Joint("mount", "plate.o", "leaf.a"),
        ),
        (PointForce("push", "plate.o", "x", "force"),),
        (Encoder("x", "base.o", "plate.o", "x"), Encoder("z", "base.o", "plate.o", "z")),
        tuple(springs),
        gravity=(0, 0, -9.81),
    )
    time = np.arange(1001) * 1e-3
    push = TimeHistory(time, np.full((1, 1001), 8.0), ("force",), ("N",))
    record = simulate(scene, push, time_step=1e-3, method="exact", progress=False)
    np.testing.assert_allclose(record["z"], -4.0 * 9.81 / 500.0, rtol=1e-3)
    m, c = 4.0, damper
    expected = 8.0 * (time / c - m / c**2 * (1 - np.exp(-c * time / m))) if c else 8.0 * time**2 / (2 * m)
    # The far mass follows on a stiff bar, so the plate's ripple is small beside the motion.
    np.testing.assert_allclose(record["x"], expected, atol=1e-4 * expected[-1])


@pytest.mark.parametrize("along", ["x", "y"])
def test_neutral_equilibrium_of_a_slide_that_carries_all_weight(block, along):
    """Nothing gives way under weight, so the free motion's share, all rounding, has only itself to compare with."""
    loads = np.zeros((len(block.mass_matrix), 0))
    body = trim_body(block, points=["left"], loads=loads, cutoff_frequency=1.0)
    c, s = np.cos(0.7), np.sin(0.7)
    tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    base = RigidBody("base", {"rail": np.zeros(3)}, position=tilt @ body.point("left").position, fixed=True)
    sled = FlexibleBody("sled", body, rotation=tilt, fidelity="linear")
    rail = Joint("rail", "base.rail", "sled.left", free=along)
    push = GroundAcceleration("shake", along, "shake")
    scene = Scene("slide", (base, sled), (rail,), (push,), gravity=(0, 0, -9.81))
    assembly = assemble(scene)
    assert np.any(assembly.modal.modes.T @ assembly.signals.weight)
    shake = TimeHistory(np.array([0.0, 1.0]), np.ones((1, 2)), ("shake",), ("m/s2",))
    simulate(scene, shake, time_step=0.1, method="exact", progress=False)


def test_modes_need_a_definite_mass(block):
    strange = np.eye(len(block.mass_matrix))
    strange[0, 1] = strange[1, 0] = 2.0
    with pytest.raises(ValueError, match="not positive definite"):
        strain_eigenmodes(block.strain, strange)
    with pytest.raises(ValueError, match="a diagonal entry that is not positive"):
        strain_eigenmodes(block.strain, -block.mass_matrix)
    with pytest.raises(ValueError, match="n must be a whole number of at least 1, got 0"):
        block.eigenfrequencies(n=0)


@pytest.mark.parametrize("turn", Rotation.random(6, random_state=0).as_matrix())
def test_what_a_turned_bushing_leaves_free_is_free_in_spite_of_rounding(turn):
    """A force across two axes and a moment about one; the products of matrices have small eigenvalues of any sign."""
    ground, body = (
        RigidBody("ground", {"o": np.zeros(3)}, fixed=True),
        RigidBody("b", {"o": np.zeros(3)}, 2.0, np.eye(3)),
    )
    blocks = [turn @ np.diag(stiffness) @ turn.T for stiffness in ((1e6, 3e6, 0.0), (1e3, 0.0, 0.0))]
    bushing = Bushing("bushing", "ground.o", "b.o", scipy.linalg.block_diag(*(0.5 * (k + k.T) for k in blocks)))
    modal = assemble(Scene("bushing", (ground, body), springs=(bushing,))).modal
    np.testing.assert_array_equal(modal.rigid_modes, [True] * 3 + [False] * 3)
    expected = np.sqrt([1e3, 1e6 / 2.0, 3e6 / 2.0]) / (2 * np.pi)
    np.testing.assert_allclose(modal.frequency[3:], expected, rtol=1e-9)
