"""A flexible joint of no length, both of its points in one place: as a reduced body it is what a bushing is."""

import re
import warnings

import numpy as np
import pytest
import scipy.linalg

from nassim import (
    Bushing,
    Encoder,
    FlexibleBody,
    ForceSensor,
    PointForce,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    Superelement,
    TimeHistory,
    fixed,
    frequency_response,
    linearize,
    placed,
    simulate,
    static_response,
)
from nassim.base.rigid_motion import rigid_transfer
from nassim.exchange import to_body
from nassim.simulation.model.assembly import assemble

STIFFNESS = np.array([12.71e6, 12.71e6, 93.96e6, 4.83, 4.83, 260.2])
"""Of a joint, its own z along the strut [N/m], [N m/rad]."""
HALF, HALF_INERTIA = 0.0146, np.diag([6e-7, 7e-7, 9e-7])
LENGTH = 0.0824
TILT = np.array([[6.0, 2.0, 3.0], [-3.0, 6.0, 2.0], [-2.0, -3.0, 6.0]]).T / 7
LITTLE = 0.05 * np.array([1.0, -2.0, -9.0])
"""Gravity of which all stays in small motion."""


@pytest.fixture(scope="module")
def joint():
    half = scipy.linalg.block_diag(HALF * np.eye(3), HALF_INERTIA)
    k = np.diag(STIFFNESS)
    return to_body(
        Superelement(
            "joint",
            stiffness_matrix=np.block([[k, -k], [-k, k]]),
            mass_matrix=scipy.linalg.block_diag(half, half),
            positions=np.zeros((2, 3)),
            names=("a", "b"),
        )
    )


def half(name, place):
    return RigidBody(name, {"p": np.zeros(3)}, HALF, HALF_INERTIA, place)


def strut(ends, gravity):
    """Joint, rod, joint and a payload on springs, along z; `ends` makes a joint at a place from its name."""
    rod = RigidBody(
        "rod",
        {"a": (0, 0, -LENGTH / 2), "b": (0, 0, LENGTH / 2)},
        0.2,
        np.diag([1e-4, 1.2e-4, 2e-5]),
        (0, 0, LENGTH / 2),
    )
    inertia = np.array([[3e-4, 4e-5, -2e-5], [4e-5, 4e-4, 5e-5], [-2e-5, 5e-5, 5e-4]])
    arm = np.array([0.01, -0.015, 0.02])
    payload = RigidBody("payload", {"m": -arm, "n": 2 * arm}, 0.5, inertia, np.array([0, 0, LENGTH]) + arm)
    ground = RigidBody("ground", {"o": np.zeros(3), "top": np.array([0, 0, LENGTH])}, fixed=True)
    low, high = ends("low", 0.0), ends("high", LENGTH)
    joints = (
        fixed("1", "ground.o", low[1]),
        fixed("2", low[2], "rod.a"),
        fixed("3", "rod.b", high[1]),
        fixed("4", high[2], "payload.m"),
    )
    guides = tuple(SpringDamper(axis, "ground.top", "payload.m", axis, 2e3, 1.0) for axis in "xy")
    return Scene(
        "strut",
        (ground, rod, payload, *low[0], *high[0]),
        joints,
        (PointForce("push", "payload.n", (2, -1, 3), "force"),),
        (Pose("pose", "ground.o", "payload.n"), Encoder("bend", "rod.b", "payload.n", "y", frame="rod.b")),
        (*guides, *low[3], *high[3]),
        damping_ratio=0.0,
        gravity=gravity,
    )


def as_body(joint, fidelity):
    def ends(name, z):
        body = FlexibleBody(name, joint, (0, 0, z), fidelity=fidelity)
        return (body,), f"{name}.a", f"{name}.b", ()

    return ends


def as_bushing(name, z):
    halves = half(f"{name}_a", (0, 0, z)), half(f"{name}_b", (0, 0, z))
    return halves, f"{name}_a.p", f"{name}_b.p", (Bushing(name, f"{name}_a.p", f"{name}_b.p", STIFFNESS),)


def turned(ends, gravity=(0, 0, 0)):
    return placed(strut(ends, gravity), "s", position=(0.1, 0.2, -0.3), rotation=TILT)


def test_the_joint_in_a_linear_model(joint):
    """Frequencies and responses, of the rod on the soft side of its joints and along it."""
    body, bushing = turned(as_body(joint, "linear")), turned(as_bushing)
    expected = assemble(bushing).modal.frequency
    assert expected[-1] > 100 * expected[0]
    np.testing.assert_allclose(assemble(body).modal.frequency, expected, rtol=1e-8)
    found, answer = (frequency_response(linearize(s), np.geomspace(1, 1e4, 60)).values for s in (body, bushing))
    scale = np.abs(answer).max(axis=2, keepdims=True)
    np.testing.assert_allclose(found / scale, answer / scale, rtol=0, atol=1e-7)


def near(found, expected, share):
    """Displacements, turns and the encoder, (7, ...), each to a share of its largest."""
    for kind in (slice(0, 3), slice(3, 6), slice(6, 7)):
        largest = np.abs(expected[kind]).max()
        np.testing.assert_allclose(found[kind], expected[kind], rtol=0, atol=share * largest)


FIDELITIES = (("linear", 5e-3), ("ffrf", 1e-3))
"""How near to the bushing, whose rotations by 0.2 % are not so small that their squares are nothing."""


@pytest.mark.parametrize(("fidelity", "share"), FIDELITIES)
def test_the_joint_under_weight(joint, fidelity, share):
    found, expected = (
        np.array(list(static_response(turned(ends, LITTLE)).values()))
        for ends in (as_body(joint, fidelity), as_bushing)
    )
    near(found, expected, share)


@pytest.mark.parametrize(("fidelity", "share"), FIDELITIES)
def test_the_joint_in_time(joint, fidelity, share):
    """A bushing as stiff as this is held by Newton's iteration even while there is hardly any force yet."""
    time = np.arange(151) * 2e-4
    push = TimeHistory(time, 0.1 * np.sin(np.pi * time / time[-1])[None] ** 2, ("s/force",), ("N",))
    found, expected = (
        simulate(turned(ends), push, time_step=2e-4, progress=False).values[1:]
        for ends in (as_body(joint, fidelity), as_bushing)
    )
    near(found, expected, share)


AXIAL, STRUT = 4e7, 2e7
"""Of a rod beyond a neck, and of a strut beside the rod, along the rod [N/m]."""


def beyond_a_neck(strut, frame):
    """A joint whose second half goes on as a rod, as one body that the ground holds; a strut ties the rod's ends."""
    arm = np.array([0.0, 0.0, LENGTH])
    rows = np.hstack([np.zeros((6, 6)), -rigid_transfer(arm), np.eye(6)])  # of the rod, and of the neck
    neck, rod = np.hstack([-np.eye(6), np.eye(6), np.zeros((6, 6))]), np.diag([AXIAL, AXIAL, AXIAL, 5e4, 5e4, 5e4])
    body = Superelement(
        "body",
        stiffness_matrix=neck.T @ np.diag(STIFFNESS) @ neck + rows.T @ rod @ rows,
        mass_matrix=scipy.linalg.block_diag(*[HALF * np.eye(3), HALF_INERTIA] * 3),
        positions=np.array([0 * arm, 0 * arm, arm]),
        names=("foot", "low", "high"),
    )
    ground = RigidBody("ground", {"o": np.zeros(3)}, fixed=True)
    springs = (SpringDamper("strut", "body.low", "body.high", "line", STRUT),) if strut else ()
    scene = Scene(
        "neck",
        (ground, FlexibleBody("body", to_body(body), frame=frame)),
        (fixed("hold", "ground.o", "body.foot"),),
        (PointForce("push", "body.high", (0.6, 0.8, 0.0), "force"),),
        tuple(ForceSensor("pull", spring.name) for spring in springs),
        springs,
        damping_ratio=0.0,
    )
    return placed(scene, "s", position=(0.1, 0.2, -0.3), rotation=TILT)


@pytest.mark.parametrize("turn", [1e-4, 3e-3])
def test_a_rod_beyond_a_neck_lengthens_as_it_turns_and_a_warning_tells_it(turn):
    """By half of the square of its turn t, in the neck's frame, with the energy k t^2 / 2 + held (L t^2 / 2)^2 / 2."""
    force = turn * STIFFNESS[3] / LENGTH
    held = 1 / (1 / STRUT + 1 / AXIAL)
    roots = np.roots([0.5 * held * LENGTH**2, 0.0, STIFFNESS[3], -force * LENGTH])
    turned = roots[roots.imag == 0][0].real
    pull = held * 0.5 * LENGTH * turned**2
    squeezed, bent = pull**2 / AXIAL, STIFFNESS[3] * turned**2
    share = 100 * np.sqrt(squeezed / (squeezed + bent))
    for strut, frame, expected in ((False, "foot", None), (True, "foot", pull), (True, "high", 0.0)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = static_response(beyond_a_neck(strut, frame), {"s/force": force})
        told = [re.findall(r"frame, here '(\w+)', by some (.+?) %", str(one.message))[0] for one in caught]
        assert len(told) == (strut and share > 1)
        assert all(at == frame and float(size) == pytest.approx(share, rel=0.1) for at, size in told)
        if strut:
            assert found["s/pull"] == pytest.approx(expected, rel=1e-3, abs=1e-3 * pull)
