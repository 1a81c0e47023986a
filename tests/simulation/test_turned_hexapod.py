"""A hexapod of six different flexible bodies, all turned differently: the same figures however it lies in the world."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from conftest import lattice, motion_beside, turn

from nassim import (
    Encoder,
    FlexibleBody,
    GroundAcceleration,
    Joint,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    StackActuator,
    StackSensor,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    placed,
    simulate,
    spherical,
    static_response,
    universal,
)
from nassim.simulation.exudyn import solver
from nassim.simulation.model.assembly import assemble

WHOLE, AWAY = turn([0.4, -1.0, 0.7], 2.3), np.array([0.2, -0.5, 0.3])
"""How the machine is turned as a whole, and where to."""
BASE, PLATE = turn([1.0, 2.0, -1.0], 0.7), turn([-2.0, 1.0, 0.5], 1.9)
"""How the axes of the base and of the plate lie in the machine."""
FEET = np.array([[3, 0.2, 0.1], [2, 2, -0.2], [-1, 2.6, 0.3], [-2.5, 1.2, 0], [-2, -1.6, 0.2], [1, -2.8, 0]]) / 60
ODD = ((0, -1, 0.2), (1, -1, 0), (-1, -2, 0.4), (0.3, -1, -1), (-0.6, -1, 0.1), (1, -1, 1))
TILTS = [turn(axis, angle) for axis, angle in zip(ODD, (1.3, 1.7, 1.2, 1.9, 1.5, 1.4), strict=True)]
"""How the struts lie, whose own axes run along x: by odd axes, no two the same."""
STIFFNESS = (1e6, 1.4e6, 0.8e6, 2e6, 1.1e6, 0.6e6)
CENTRE, LOOK = np.array([0.004, -0.003, 0.05]), np.array([0.01, -0.02, 0.06])
MASS, INERTIA = 0.4, np.array([[4e-4, 5e-5, -3e-5], [5e-5, 6e-4, 4e-5], [-3e-5, 4e-5, 7e-4]])
SPRING = np.array([2.0, 1.0, -2.0])
GRAVITY = np.array([0.5, -1.0, -9.0])
SECOND_ORDER = {"linear": 1e-6, "ffrf": 5e-5}
"""Difference of the turned machine in large motion: of three struts that the base holds rigidly, some points turn by
4e-5 rad, and the angles of these points are successive rotations about the axes of the world, which do not commute."""


@pytest.fixture(scope="module")
def struts():
    """Of unequal stiffness, mass and number of modes."""
    models = (lattice(n=3 + k % 2, stiffness=s, node_mass=0.004 + 0.001 * k) for k, s in enumerate(STIFFNESS))
    return [craig_bampton(model, n_modes=1 + k % 3, progress=False) for k, model in enumerate(models)]


@pytest.fixture
def iterated_to_the_end(monkeypatch):
    """Newton's iteration otherwise stops at a few millionths of an answer, elsewhere in each position."""
    usual = solver._settings

    def settings(system):
        result = usual(system)
        for newton in (result.staticSolver.newton, result.timeIntegration.newton):
            newton.relativeTolerance = newton.absoluteTolerance = 1e-12
        return result

    monkeypatch.setattr(solver, "_settings", settings)


def ends(struts):
    """Where the struts' heads are in the machine."""
    reach = [body.point("right").position - body.point("left").position for body in struts]
    return np.array([foot + tilt @ r for foot, tilt, r in zip(FEET, TILTS, reach, strict=True)])


def machine(struts, fidelity, q, p):
    """Turned by q and moved by p as a whole, by hand."""
    heads = ends(struts)
    feet = {f"f{k}": BASE.T @ foot for k, foot in enumerate(FEET)}
    points = {f"h{k}": PLATE.T @ (head - CENTRE) for k, head in enumerate(heads)} | {"look": PLATE.T @ LOOK}
    inertia = PLATE.T @ INERTIA @ PLATE
    bodies = [
        RigidBody("base", feet, fixed=True, position=p, rotation=q @ BASE),
        RigidBody("plate", points, MASS, inertia, p + q @ CENTRE, rotation=q @ PLATE),
    ]
    joints = []
    for k, (body, tilt) in enumerate(zip(struts, TILTS, strict=True)):
        place = p + q @ (FEET[k] - tilt @ body.point("left").position)
        bodies.append(FlexibleBody(f"s{k}", body, place, q @ tilt, fidelity))
        if k % 2:
            joints.append(Joint(f"a{k}", f"base.f{k}", f"s{k}.left"))
            joints.append(spherical(f"b{k}", f"s{k}.right", f"plate.h{k}"))
        else:
            joints.append(universal(f"a{k}", f"base.f{k}", f"s{k}.left", q @ tilt[:, 1], q @ tilt[:, 2]))
            joints.append(Joint(f"b{k}", f"s{k}.right", f"plate.h{k}"))
    return Scene(
        "machine",
        bodies,
        joints,
        (
            StackActuator("stacks", "s4.left", "s4.right", 3.0, "voltage"),
            PointForce("push", "plate.look", q[:, 0], "force"),
            PointTorque("twist", "plate.look", q[:, 1], "torque"),
            PointForce("rider", "s3.right", q[:, 2], "rider", frame="s3.right"),
            GroundAcceleration("quake", q @ [1, 2, 2], "quake"),
        ),
        (
            StackSensor("sensor", "s2.left", "s2.right", 1e4),
            Encoder("seen", "base.f0", "plate.look", q @ [2, -1, 2]),
            Encoder("line", "base.f1", "plate.h4", "line"),
            Pose("pose", "s1.right", "plate.look", q),
        ),
        (SpringDamper("stay", "base.f0", "plate.look", q @ SPRING, 3e4, 2.0),),
        damping_ratio=0.01,
        gravity=q @ GRAVITY,
    )


def both(struts, fidelity):
    """As it stands, and turned by `placed`, with gravity turned along."""
    scene = machine(struts, fidelity, np.eye(3), np.zeros(3))
    return scene, replace(placed(scene, "m", position=AWAY, rotation=WHOLE), gravity=WHOLE @ GRAVITY)


def alike(found, expected, atol):
    """Signal by signal, over time or frequency."""
    scale = np.abs(expected).max(axis=-1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=atol)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
def test_frequencies_and_responses_of_the_turned_machine(struts, fidelity):
    """Turned by `placed` and by hand."""
    scene, copy = both(struts, fidelity)
    frequency, expected = np.geomspace(5.0, 5e3, 12), assemble(scene).modal.frequency
    responses = frequency_response(linearize(scene), frequency).values
    for other in (copy, machine(struts, fidelity, WHOLE, AWAY)):
        np.testing.assert_allclose(assemble(other).modal.frequency, expected, rtol=1e-9)
        alike(frequency_response(linearize(other), frequency).values, responses, 1e-9)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf"])
@pytest.mark.usefixtures("iterated_to_the_end")
def test_weight_of_the_turned_machine(struts, fidelity):
    expected, found = (np.array(list(static_response(s).values())) for s in both(struts, fidelity))
    for unit in (slice(1), slice(1, 6), slice(6, None)):  # a voltage, lengths, turns
        atol = SECOND_ORDER[fidelity] * np.abs(expected[unit]).max()
        np.testing.assert_allclose(found[unit], expected[unit], rtol=0, atol=atol)


WAYS = (("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha"))


@pytest.mark.parametrize(("fidelity", "method"), WAYS)
@pytest.mark.usefixtures("iterated_to_the_end")
def test_simulation_of_the_turned_machine(struts, fidelity, method):
    time = np.arange(21) * 2e-4
    shape = np.sin(np.pi * time / time[-1]) ** 2
    records = []
    for scene in both(struts, fidelity):
        values = np.outer([5.0, 1.0, 0.02, 0.5, 2.0], shape)
        units = tuple(scene.input_unit(name) for name in scene.inputs)
        push = TimeHistory(time, values, scene.inputs, units)
        records.append(simulate(scene, push, time_step=2e-4, method=method, progress=False).values[5:])
    alike(records[1], records[0], SECOND_ORDER[fidelity])


def world(tilt, n_points, n):
    """From a body's coordinates to those along the world's axes, modes as they are."""
    return scipy.linalg.block_diag(*[tilt] * (2 * n_points), np.eye(n - 6 * n_points))


def written_out(struts):
    """Mass, stiffness, constraints, weight and the plate's point, in coordinates along the world's axes."""
    heads = ends(struts)
    mass, stiffness, pulls = [np.diag([MASS] * 3 + [0] * 3).astype(float)], [np.zeros((6, 6))], [np.zeros(6)]
    mass[0][3:, 3:] = INERTIA
    pulls[0][:3] = MASS * GRAVITY
    for body, tilt in zip(struts, TILTS, strict=True):
        to_world = world(tilt, 2, len(body.mass_matrix))
        mass.append(to_world @ body.mass_matrix @ to_world.T)
        stiffness.append(to_world @ body.stiffness_matrix @ to_world.T)
        falling = np.zeros(len(to_world))
        falling[:3] = falling[6:9] = GRAVITY
        pulls.append(mass[-1] @ falling)
    starts = np.cumsum([0, *map(len, mass)])
    n, rows = starts[-1], []
    for k, tilt in enumerate(TILTS):
        foot, head = np.eye(6, n, starts[k + 1]), np.eye(6, n, starts[k + 1] + 6)
        plate = motion_beside(heads[k] - CENTRE) @ np.eye(6, n)
        if k % 2:
            rows += [foot, (head - plate)[:3]]
        else:
            rows += [foot[:3], tilt[:, :1].T @ foot[3:], head - plate]
    look = motion_beside(LOOK) @ np.eye(6, n)
    axis = SPRING / np.linalg.norm(SPRING)
    row = axis @ look[:3]
    stiffness = scipy.linalg.block_diag(*stiffness) + 3e4 * np.outer(row, row)
    return scipy.linalg.block_diag(*mass), stiffness, np.vstack(rows), np.concatenate(pulls), look


def test_machine_against_matrices_written_out(struts):
    """Frequencies, sag under gravity and the response to a force, put together here from the bodies' matrices."""
    mass, stiffness, rows, pull, look = written_out(struts)
    basis = scipy.linalg.null_space(rows)
    m, k = basis.T @ mass @ basis, basis.T @ stiffness @ basis
    expected = np.sqrt(scipy.linalg.eigh(k, m, eigvals_only=True)) / (2 * np.pi)
    turned = machine(struts, "linear", WHOLE, AWAY)
    np.testing.assert_allclose(assemble(turned).modal.frequency, expected, rtol=1e-9)

    sag = (look @ basis @ np.linalg.solve(k, basis.T @ pull))[:3]
    seen = np.array([2, -1, 2]) / 3
    for fidelity in ("linear", "ffrf"):  # under little weight: what it turns and stiffens is not written out here
        scene = machine(struts, fidelity, WHOLE, AWAY)
        found = static_response(replace(scene, gravity=1e-3 * np.array(scene.gravity)))
        assert found["seen"] == pytest.approx(1e-3 * seen @ sag, rel=2e-6)

    springs = tuple(replace(spring, damping=0.0) for spring in turned.springs)
    undamped = replace(turned, damping_ratio=0.0, springs=springs)
    frequency = np.geomspace(5.0, 3e3, 20)
    response = frequency_response(linearize(undamped, loaded=False), frequency)
    for f, value in zip(frequency, response.response("seen", "force"), strict=True):
        answer = np.linalg.solve(k - (2 * np.pi * f) ** 2 * m, basis.T @ look[0])
        assert value == pytest.approx(seen @ (look @ basis @ answer)[:3], rel=1e-7)
