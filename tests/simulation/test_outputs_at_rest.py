"""Outputs of scenes at rest under loads, against own equations of finite motion."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    CurrentSensor,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    VoiceCoil,
    fixed,
    frequency_response,
    linearize,
    prismatic,
    revolute,
    simulate,
    static_response,
    to_body,
)
from nassim.exchange import Superelement
from nassim.scene.measures import Displacement, Distance
from nassim.scene.part import ForceElement
from nassim.scene.terms import NonlinearSpring
from nassim.simulation import loaded_equilibrium
from nassim.simulation.loaded import settling

MASS, INERTIA = 1.3, np.diag([4e-3, 6e-3, 7e-3])
GRAVITY = np.array([3.0, -5.0, -8.0])
FEET = np.array([[0.3, 0.1, 0], [-0.1, 0.3, 0.1], [-0.2, -0.3, 0], [0.2, -0.2, 0.3], [0, 0.3, -0.3], [0.3, 0, -0.2]])
ENDS = np.array([[0.1, 0, 0.1], [0, 0.1, 0], [-0.1, 0, 0], [0.05, -0.1, 0.1], [0, 0.1, -0.1], [0.1, 0, -0.1]])
STIFFNESS = 3 * np.array([1500.0, 2500.0, 2000.0, 1800.0, 1200.0, 2200.0])


@pytest.fixture(scope="module")
def hung() -> Scene:
    """A block on six soft springs along lines, which gravity turns."""
    feet = {f"f{k}": foot for k, foot in enumerate(FEET)}
    ends = {f"e{k}": end for k, end in enumerate(ENDS)}
    axis = (0.6, 0.0, 0.8)
    return Scene(
        "hung",
        (RigidBody("ground", feet, fixed=True), RigidBody("block", ends, MASS, INERTIA)),
        springs=[SpringDamper(f"s{k}", f"ground.f{k}", f"block.e{k}", "line", n, 3.0) for k, n in enumerate(STIFFNESS)],
        actuators=(
            GroundAcceleration("shaker", (0.0, 1.0, 0.0), "base"),
            VoiceCoil("coil", "ground.f1", "block.e1", axis, 20.0, 2.0, 1e-3, "voltage"),
        ),
        sensors=(
            *(ForceSensor(f"n{k}", f"s{k}") for k in range(6)),
            Encoder("e", "ground.f0", "block.e3", "z", frame="block.e0"),
            Accelerometer("a", "block.e4", "z", frame="block.e0"),
            *(CurrentSensor(f"i{k}", "coil") for k in range(2)),
        ),
        gravity=GRAVITY,
        damping_ratio=0.0,
    )


@pytest.fixture(scope="module")
def rest() -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of the block at rest, by the balance of forces and moments."""

    def left(x: np.ndarray) -> np.ndarray:
        turned = ENDS @ Rotation.from_rotvec(x[3:]).as_matrix().T
        lines = turned + x[:3] - FEET
        lengths = np.linalg.norm(lines, axis=1)
        pulls = -(STIFFNESS * (lengths - np.linalg.norm(ENDS - FEET, axis=1)) / lengths)[:, None] * lines
        return np.concatenate([pulls.sum(axis=0) + MASS * GRAVITY, np.cross(turned, pulls).sum(axis=0)])

    x = scipy.optimize.fsolve(left, np.zeros(6), xtol=1e-12)
    return x[:3], Rotation.from_rotvec(x[3:]).as_matrix()


def test_exact_steps_start_on_the_outputs_of_the_equilibrium(hung: Scene, rest: tuple[np.ndarray, np.ndarray]) -> None:
    place, turn = rest
    assert np.arccos((np.trace(turn) - 1) / 2) > 0.01
    with pytest.warns(UserWarning, match="body 'block' turned by up to 0.039 rad"):
        start = simulate(hung, None, duration=2e-3, time_step=1e-3, method="exact", progress=False)
    ends = ENDS @ turn.T + place
    forces = STIFFNESS * (np.linalg.norm(ends - FEET, axis=1) - np.linalg.norm(ENDS - FEET, axis=1))
    np.testing.assert_allclose([start[f"n{k}"] for k in range(6)], np.tile(forces[:, None], 3), rtol=1e-6)
    read = turn[:, 2] @ (ends[3] - FEET[0]) - (ENDS[3] - FEET[0])[2]
    np.testing.assert_allclose(start["e"], read, rtol=1e-6)
    np.testing.assert_allclose([start["i0"], start["i1"]], 0.0, atol=1e-9)


def test_inertial_sensors_have_the_directions_of_the_equilibrium(
    hung: Scene, rest: tuple[np.ndarray, np.ndarray]
) -> None:
    # Far below the resonances the block moves with the ground, and far above them it rests.
    response = frequency_response(linearize(hung), [1e-3, 1e4]).response("a", "base")
    np.testing.assert_allclose(response[0], rest[1][1, 2], rtol=1e-6)
    assert abs(response[1]) < 1e-4


@dataclass(frozen=True)
class Hardening(ForceElement):
    """A spring with a force in the reference configuration, between the ground and the tip."""

    name: str = "hardening"

    def terms(self, scene: Scene) -> tuple[NonlinearSpring]:
        """Return the law."""
        measure = Displacement.between("ground.q", "rod.tip", np.array([0, 0, 1.0]))
        return (NonlinearSpring(measure, force=law),)


def law(z: np.ndarray, v: np.ndarray | float = 0.0) -> np.ndarray:
    """Return force of the hardening spring [N]."""
    result: np.ndarray = 5.0 + 2e3 * z + 3e13 * z**3 + 2.0 * v
    return result


@dataclass(frozen=True)
class Rubber(ForceElement):
    """A spring along a line that hardens as it gets longer."""

    def terms(self, scene: Scene) -> tuple[NonlinearSpring]:
        """Return the law."""
        return (NonlinearSpring(Distance("ground.r", "lever.tip"), force=lambda s, v: 7.0 + 3e3 * s + 1e5 * s**2 + v),)


PRELOADED = SpringDamper("hardening", "ground.q", "rod.tip", "z", 1e4, preload=7.0)


@pytest.mark.parametrize("springs", [Hardening(), PRELOADED])
def test_sensors_read_the_whole_force_of_a_spring_in_small_motion(springs: ForceElement) -> None:
    """The sensor had only the tangent of the force: not its preload, nor its curvature."""
    # A clamped rod whose tip has six springs and a mass.
    stiffness, mass = np.diag([1e7, 2e5, 1e5, 80.0, 300.0, 400.0]), np.diag([0.2, 0.2, 0.2, 1e-4, 2e-4, 2e-4])
    arm = np.eye(6)
    arm[1, 5], arm[2, 4] = -0.3, 0.3
    both = np.hstack([-np.linalg.inv(arm), np.eye(6)])
    foot = np.kron(np.diag([1.0, 0.0]), mass)
    rod = Superelement(
        "rod",
        stiffness_matrix=both.T @ stiffness @ both,
        mass_matrix=foot + np.kron(np.diag([0.0, 1.0]), mass),
        positions=[[0, 0, 0], [0.3, 0, 0]],
        names=("foot", "tip"),
    )
    scene = Scene(
        "rod",
        (
            RigidBody("ground", {"p": [0, 0, 0], "q": [0.3, 0, -0.1]}, fixed=True),
            FlexibleBody("rod", to_body(rod), fidelity="linear"),
        ),
        joints=(fixed("clamp", "ground.p", "rod.foot"),),
        springs=(springs,),
        actuators=(PointForce("push", "rod.tip", "z", "force"),),
        sensors=(ForceSensor("n", "hardening"), Encoder("z", "ground.q", "rod.tip", "z")),
    )
    for force in (0.0, 20.0):
        read = static_response(scene, {"force": force})
        z = np.array(read["z"])
        expected = law(z) if isinstance(springs, Hardening) else 7.0 + 1e4 * z
        np.testing.assert_allclose(read["n"], expected, rtol=1e-9)
        np.testing.assert_allclose(read["n"], force - 1e5 * z, rtol=1e-6)
    # A lever on a hinge beside it: about the equilibrium, where the line of its spring has turned.
    lever = RigidBody("lever", {"hinge": [0, 0, 0], "tip": [0.2, 0, 0]}, 0.5, 1e-3 * np.eye(3))
    ground = replace(scene.bodies[0], points={**scene.bodies[0].points, "r": [0.25, 0, -0.1]})
    turned = replace(
        scene,
        bodies=(ground, scene.bodies[1], lever),
        joints=(*scene.joints, revolute("hinge", "ground.p", "lever.hinge", "y")),
        actuators=(PointForce("push", "lever.tip", "z", "force"),),
        springs=(Rubber("hardening"),),
    )
    run = simulate(turned, None, time_step=1e-4, duration=1e-3, constant_inputs={"force": 20.0}, progress=False)
    borne = loaded_equilibrium(turned, inputs={"force": 20.0}).spring_forces["hardening"]["value"]
    np.testing.assert_allclose(run["n"], borne, rtol=1e-6)


def test_an_equilibrium_on_springs_that_stiffen_across_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two springs across a guide bear most of the load by their second order: the tangent is that of present forces.

    With the tangent of the forces of first order, Newton's method takes several times as many iterations, or fails.
    """
    monkeypatch.setattr(settling, "ITERATIONS", 6)
    soft, stiff, length, mass = 200.0, 1e5, 0.2, 0.05
    load = soft * 0.05 * length

    def pull(z: float) -> float:
        return float(soft * z + 2 * stiff * (1 - length / np.hypot(length, z)) * z)

    z = scipy.optimize.brentq(lambda z: pull(z) - load, 0, 0.05 * length, xtol=1e-16)
    now = np.hypot(length, z)
    tangent = soft + 2 * stiff * (1 - length / now + length * z**2 / now**3)
    scene = Scene(
        "guided",
        (
            RigidBody("ground", {"o": [0, 0, 0], "l": [-length, 0, 0], "r": [length, 0, 0]}, fixed=True),
            RigidBody("slide", {"o": [0, 0, 0]}, mass, 1e-5 * np.eye(3)),
        ),
        joints=(prismatic("guide", "ground.o", "slide.o"),),
        springs=(
            SpringDamper("soft", "ground.o", "slide.o", "z", soft),
            SpringDamper("left", "ground.l", "slide.o", "line", stiff),
            SpringDamper("right", "ground.r", "slide.o", "line", stiff),
        ),
        sensors=(Encoder("z", "ground.o", "slide.o", "z"), ForceSensor("n", "left")),
        gravity=(0, 0, load / mass),
        damping_ratio=0.0,
    )
    np.testing.assert_allclose(np.abs(linearize(scene).poles()), np.sqrt(tangent / mass), rtol=1e-6)
    start = simulate(scene, None, duration=2e-3, time_step=1e-3, method="exact", progress=False)
    np.testing.assert_allclose(start["z"], z, rtol=1e-6)
    np.testing.assert_allclose(start["n"], stiff * (now - length), rtol=1e-6)


def test_accelerometers_of_a_steady_rotation_read_the_way_to_its_axis() -> None:
    """Also where the centre of mass goes round."""
    turn = Rotation.from_rotvec([0.4, 0.5, -0.8]).as_matrix()
    axis, point, speed = turn[:, 2], np.array([0.3, 0.05, 0.02]), 7.0
    base = RigidBody("base", {"axle": np.zeros(3)}, fixed=True)
    points = {"axle": [-0.2, 0.0, 0.0], "rim": point - [0.2, 0.0, 0.0]}
    wheel = RigidBody("wheel", points, 1.0, np.diag([1e-3, 1e-2, 1e-2]), 0.2 * turn[:, 0], rotation=turn)
    scene = Scene(
        "wheel",
        (base, wheel),
        (revolute("axle", "base.axle", "wheel.axle", axis),),
        (Drive("motor", "axle", speed=speed),),
        [Accelerometer(f"a{k}", "wheel.rim", along, frame="wheel.rim") for k, along in enumerate(turn.T)],
    )
    expected = -(speed**2) * point * [1, 1, 0]
    np.testing.assert_allclose(list(static_response(scene).values()), expected, rtol=1e-9, atol=1e-9)
