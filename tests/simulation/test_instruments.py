"""Sensors of force, velocity and acceleration: closed forms, every engine against the linear model, large motion."""

import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from conftest import lattice
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    Bushing,
    FlexibleBody,
    ForceSensor,
    Geophone,
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
)
from nassim.scene.joints import prismatic

STEP = 2e-5
ALONG = np.array([0.48, -0.6, 0.64])
ODD = np.array([2.0, -1.0, 2.0]) / 3


def turn(*vector):
    return Rotation.from_rotvec(vector).as_matrix()


SKEWED = turn(0.7, -0.4, 1.2)
INERTIA = turn(0.3, 0.5, -0.2) @ np.diag([2e-3, 3e-3, 4e-3]) @ turn(0.3, 0.5, -0.2).T
MASS, STIFFNESS, DAMPING = 2.0, 8e3, 12.0


def slider(*sensors, axis=ALONG, **parts):
    """A turned block on a spring and a guide along an odd axis, pushed along it."""
    ground = RigidBody("ground", {"o": (0, 0, 0), "away": 0.2 * ALONG}, fixed=True)
    block = RigidBody("block", {"o": (0, 0, 0), "tip": (0.1, 0.2, 0.3)}, MASS, INERTIA, rotation=SKEWED)
    given = {
        "joints": (prismatic("guide", "ground.o", "block.o", axis),),
        "springs": (SpringDamper("spring", "ground.o", "block.o", tuple(axis), STIFFNESS, DAMPING),),
        "actuators": (PointForce("push", "block.tip", tuple(axis), "push"),),
        "damping_ratio": 0.0,
    }
    return Scene("slider", (ground, block), sensors=sensors, **{**given, **parts})


FREQUENCY = np.geomspace(0.3, 3e3, 40)
S = 2j * np.pi * FREQUENCY


def section(frequency, ratio, power):
    """Second order: power 0 for a low-pass, 2 for a high-pass."""
    w = 2 * np.pi * frequency
    return (S if power else w) ** 2 / (S**2 + 2 * ratio * w * S + w**2)


def test_closed_forms_of_one_mass():
    """Force to velocity, acceleration and the force in the spring, through the sensors' own dynamics."""
    other = np.array([0.6, 0.8, 0.0])
    scene = slider(
        Geophone("geophone", "block.tip", tuple(other), "", 4.5, 0.56, 28.8),
        Accelerometer("accelerometer", "block.tip", tuple(-ALONG), "block.o", 900.0, 0.03, 0.8, 0.1),
        Accelerometer("acceleration", "block.tip", tuple(ALONG)),
        Vibrometer("velocity", "block.tip", tuple(ALONG)),
        ForceSensor("force", "spring"),
    )
    assert scene.output_units == ("V", "V", "m/s2", "m/s", "N")
    model = linearize(scene)
    assert len(model.poles()) == 2 + 2 + 3
    assert np.all(model.poles().real < 0)
    assert [bool(row[0]) for row in model.D] == [False, False, True, False, False]
    found = frequency_response(model, FREQUENCY)
    moved = 1 / (MASS * S**2 + DAMPING * S + STIFFNESS)
    expected = {
        "geophone": 28.8 * (other @ ALONG) * section(4.5, 0.56, 2) * S * moved,
        "accelerometer": -0.1 * section(900.0, 0.03, 0) * S / (S + 2 * np.pi * 0.8) * S**2 * moved,
        "acceleration": S**2 * moved,
        "velocity": S * moved,
        "force": (STIFFNESS + DAMPING * S) * moved,
    }
    for name, answer in expected.items():
        np.testing.assert_allclose(found.response(name, "push"), answer, rtol=1e-8, err_msg=name)
    text = describe(scene)
    assert "geophone geophone: block.tip above 4.5 Hz" in text
    assert "accelerometer accelerometer: block.tip above 0.8 Hz, resonance 900 Hz" in text


def test_inertial_sensors_feel_the_ground():
    """An isolator on a shaking ground: what they read is absolute, what a vibrometer reads is against the ground."""
    shake = np.array([0.0, 0.6, 0.8])
    scene = slider(
        Geophone("geophone", "block.tip", tuple(ALONG), "", 2.0, 0.6),
        Geophone("across", "block.tip", tuple(np.cross(ALONG, shake)), "", 2.0, 0.6),
        Accelerometer("soft", "block.tip", tuple(ALONG), resonance=300.0, damping_ratio=0.1),
        Accelerometer("stiff", "block.tip", tuple(ALONG)),
        Accelerometer("high", "block.tip", tuple(ALONG), corner_frequency=3.0),
        Vibrometer("velocity", "block.tip", tuple(ALONG)),
        actuators=(GroundAcceleration("shake", tuple(shake), "shake"),),
    )
    found = frequency_response(linearize(scene), FREQUENCY)
    share = ALONG @ shake
    relative = -share * MASS / (MASS * S**2 + DAMPING * S + STIFFNESS)
    absolute = share * (DAMPING * S + STIFFNESS) / (MASS * S**2 + DAMPING * S + STIFFNESS)
    for name, answer in {
        "geophone": section(2.0, 0.6, 2) * absolute / S,
        "soft": section(300.0, 0.1, 0) * absolute,
        "stiff": absolute,
        "high": S / (S + 6 * np.pi) * absolute,
        "velocity": S * relative,
    }.items():
        np.testing.assert_allclose(found.response(name, "shake"), answer, rtol=1e-7, err_msg=name)
    # The guide takes the ground along: the block follows it across.
    assert np.abs(found.response("across", "shake")).max() < 1e-9


@pytest.fixture(scope="module")
def body():
    return craig_bampton(lattice(stiffness=1e5), n_modes=4, progress=False)


TURN = turn(*(0.7 / 3 * np.array([1.0, -2.0, 2.0])))
STIFF = np.diag([2e5, 3e5, 4e5, 60.0, 90.0, 75.0])
STIFF[0, 1] = STIFF[1, 0] = 5e4
STIFF[0, 4] = STIFF[4, 0] = 300.0
INSTRUMENTS = (
    ForceSensor("along", "along"),
    ForceSensor("line", "line"),
    ForceSensor("six", "bushing"),
    Geophone("geophone", "load.c", tuple(ALONG), "", 40.0, 0.6, 30.0),
    Geophone("turning", "load.c", tuple(ODD), "load.c", 40.0, 0.6),
    Accelerometer("soft", "load.c", tuple(ALONG), "load.c", 900.0, 0.2, 20.0, 0.1),
    Accelerometer("inside", "body.right", "y", resonance=1200.0, damping_ratio=0.3),
    Vibrometer("velocity", "load.c", "x"),
)


def machine(body, fidelity, **parts):
    """A flexible body askew on the ground, whose tip carries a load on a bushing, and springs beside."""
    flexible = FlexibleBody("body", body, -TURN @ body.point("left").position, TURN, fidelity)
    tip = flexible.point_position("right")
    ground = RigidBody("ground", {"o": (0, 0, 0), "wall": tip + [0.05, 0.1, -0.04]}, fixed=True)
    centre = tip + [0.02, -0.01, 0.03]
    points = {"c": (0, 0, 0), "mount": SKEWED.T @ (tip - centre)}
    load = RigidBody("load", points, 0.3, 0.1 * INERTIA, centre, rotation=SKEWED)
    given = {
        "joints": (Joint("foot", "ground.o", "body.left"),),
        "springs": (
            Bushing("bushing", "body.right", "load.mount", STIFF, 2e-5 * STIFF, turn(0.5, 0.2, -1.0)),
            SpringDamper("along", "load.c", "ground.wall", tuple(ODD), 3e4, 4.0, "load.c"),
            SpringDamper("line", "ground.wall", "load.mount", "line", 2e4, 5.0),
        ),
        "actuators": (PointForce("push", "load.c", tuple(ODD), "push"),),
        "sensors": INSTRUMENTS,
        "damping_ratio": 0.02,
    }
    return Scene("machine", (ground, flexible, load), **{**given, **parts})


def run(scene, n_steps=600, method="generalized_alpha", offset=0.0, size=1.0, **options):
    time = STEP * np.arange(n_steps + 1)
    shape = size * np.sin(np.pi * np.minimum(time / (150 * STEP), 1.0)) ** 2 + offset
    excitation = TimeHistory(time, np.tile(shape, (len(scene.inputs), 1)), scene.inputs, ())
    record = simulate(scene, excitation, time_step=STEP, method=method, progress=False, **options)
    return dict(zip(record.names, record.values, strict=True))


def sampled(scene, offset=0.0, n_steps=600):
    """Outputs of the linear model between straight lines, by SciPy's own exact steps."""
    model = linearize(scene)
    time = STEP * np.arange(n_steps + 1)
    shape = np.sin(np.pi * np.minimum(time / (150 * STEP), 1.0)) ** 2 + offset
    _, found, _ = scipy.signal.lsim(
        (model.A, model.B, model.C, model.D), np.tile(shape, (len(model.inputs), 1)).T, time
    )
    return dict(zip(model.outputs, found.T, strict=True))


ENGINES = [
    ("linear", "exact", 1e-9),
    ("linear", "generalized_alpha", 1e-2),
    ("ffrf", "generalized_alpha", 1e-2),
    ("rigid", "generalized_alpha", 1e-2),
]


@pytest.mark.parametrize(("fidelity", "method", "tolerance"), ENGINES)
def test_engines_agree(body, fidelity, method, tolerance):
    """A force that jumps at the start and then changes; gravity bends the machine before, and is not felt."""
    scene = machine(body, fidelity)
    expected = sampled(scene, 0.3)
    found = run(scene, method=method, offset=0.3, **({} if method == "exact" else {"spectral_radius": 0.8}))
    for name in scene.outputs:
        size = np.abs(expected[name]).max()
        off = np.abs(found[name] - expected[name]).max() / size
        print(name, size, off)
        assert off < tolerance, name
