"""Ties of a rotor to a stator, by kind, side and means, against equations of Newton and Euler written down here.

The machine is a stator on legs and a rotor of two halves, about an axis askew; all bodies have axes of their own. With
z along the axis and W the speed, the motion v of a body is described in the frame of the rotor or of the stator:

    body    frame
    rotor   rotor    m (v'' + 2 W~ v' + W~ W~ v),   I v'' + (I W~ + W~ I - (I W)~) v' + (W~ I W~ - (I W)~ W~) v
    stator  rotor    as a motion R v in its own frame: v' is v' + W~ v there, with inertias alike across z
    stator  stator   m v'',   I v''
    rotor   stator   m v'',   I v'' - (I W)~ v', with inertias alike across z

Dampers resist the rate that the side of their axes sees. Ties are joints, as rows that vanish, or springs.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from nassim import (
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    Joint,
    Loop,
    PointForce,
    PointTorque,
    ReducedBody,
    RemotePoint,
    RigidBody,
    Scene,
    SpringDamper,
    fixed,
    linearize,
)
from nassim.base.rigid_motion import axes_along, rigid_transfer, skew
from nassim.simulation import linearize_closed, spinning_equilibrium
from nassim.systems import proportional

EYE = np.eye(3)
AXIS, POINT, SPEED = np.array([2.0, -1.0, 2.0]) / 3, np.array([0.3, -0.2, 0.1]), 170.0
AXES = axes_along(AXIS) @ Rotation.from_rotvec([0, 0, 0.4]).as_matrix()
W = SPEED * skew(np.array([0, 0, 1.0]))
TURNING = ("hub", "disc")
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
NEAR = np.array([3.0 + 20j, 10 + 170j, 40 + 700j, 5 + 3000j])
"""Where transfer functions are compared [1/s], off the imaginary axis, where free motions have poles."""
MASSES = {"stator": 5.0, "hub": 1.3, "disc": 2.0}
ODD = {"stator": [0.05, 0.08, 0.06], "hub": [0.004, 0.006, 0.007], "disc": [0.02, 0.013, 0.03]}
EVEN = {"stator": [0.05, 0.05, 0.06], "hub": [0.004, 0.004, 0.007], "disc": [0.02, 0.02, 0.03]}
"""Moments of inertia, alike across the axis or not."""
PLACES = {"ground": np.zeros(3), "stator": [0, 0, -0.03], "hub": [0, 0, 0.06], "disc": [0, 0, 0.15]}
"""Centres of mass from a point of the axis."""
TILTS = {name: Rotation.from_rotvec([k, 1.0 - k, 0.4]).as_matrix() for k, name in enumerate(PLACES)}
SPOTS = {
    "on": [0, 0, 0.04],
    "above": [0, 0, 0.07],
    "far": [0, 0, 0.13],
    "rim": [0.05, 0.08, 0.12],
    "side": [-0.09, 0.02, 0.02],
}
"""Points that all bodies have."""
SPOTS |= {f"leg {k}": [0.2 * np.cos(t), 0.2 * np.sin(t), -0.1] for k, t in enumerate(2 * np.pi / 3 * np.arange(3))}
FIGURES = np.array([4e5, 4e5, 7e5, 900.0, 900.0, 0.0])
"""Of springs across the spindle, by direction."""


def rigid(name, mass=None, moments=None):
    """A body by its moments along AXES, (3, 3), or a fixed one."""
    along = TILTS[name].T @ AXES
    points = {spot: along @ (np.array(at) - PLACES[name]) for spot, at in SPOTS.items()}
    inertia = None if mass is None else along @ moments @ along.T
    place = POINT + AXES @ PLACES[name]
    return RigidBody(name, points, mass, inertia, place, fixed=mass is None, rotation=TILTS[name])


LUMP, REACH = 1e-9, np.array([0.04, 0.05, 0.06])
"""Of one of the six masses of an end of a reduced body [kg]; how far they lie from it along its axes [m]."""


def two_lumps(a, b, stiffness):
    """A reduced body of two ends of six masses each, tied by six springs along AXES that reach from a to b."""
    tilt = Rotation.from_rotvec([0.4, -1.3, 0.6]).as_matrix()
    along = tilt.T @ AXES
    ends = {"a": along @ a, "b": along @ b}
    places = [end + side * along[:, k] * REACH[k] for end in ends.values() for k in range(3) for side in (1, -1)]
    gram, matrix = np.zeros((40, 40)), np.zeros((12, 12))
    for j, place in enumerate(places):
        fields = np.zeros((3, 12))
        at = slice(0, 6) if j < 6 else slice(6, 12)
        fields[:, at] = rigid_transfer(place - ends["ab"[j // 6]])[:3]
        scalars = np.concatenate([[1.0], place, fields.T.ravel()])
        gram, matrix = gram + LUMP * np.outer(scalars, scalars), matrix + LUMP * fields.T @ fields
    apart = np.kron(np.eye(2), along.T) @ np.hstack([-rigid_transfer(ends["b"] - ends["a"]), np.eye(6)])
    points = tuple(RemotePoint(name, name, end) for name, end in ends.items())
    strained = apart.T @ np.diag(stiffness) @ apart
    return ReducedBody("lumps", remote_points=points, mass_matrix=matrix, stiffness_matrix=strained, gram=gram), tilt


class Machine:
    """The scene and its equations; frame: of the description; grounded: the hub is tied to the ground itself.

    ratio: damping of the modes; coupling: what ties the halves of the rotor, a "bushing", a reduced "body" or a joint
    stand: what holds the stator, "legs", a "slide" along the axis or a "body" that is clamped in the ground
    """

    def __init__(self, frame, *, grounded=False, ratio=0.0, coupling="bushing", stand="legs"):
        self.frame, self.grounded, self.ratio = frame, grounded, ratio
        turns = frame == "rotor"
        own = {"stator": EVEN if turns else ODD} | dict.fromkeys(TURNING, ODD if turns else EVEN)
        self.names = TURNING if grounded else ("stator", *TURNING)
        self.slices = {name: slice(6 * k, 6 * k + 6) for k, name in enumerate(self.names)}
        self.n = 6 * len(self.names)
        self.bodies = {"ground": rigid("ground")}
        self.springs, self.joints, self.held = [], [], np.zeros((0, self.n))
        self.mass, self.drag, self.stiff, self.elastic = np.zeros((4, self.n, self.n))
        for name, place in self.slices.items():
            moments = np.diag(own[name][name])
            self.bodies[name] = rigid(name, MASSES[name], moments)
            self.inertia(name, place, moments)
        soft = np.array([3e5, 4.8e5 if turns else 3e5, 5e5, 520.0 if turns else 400.0, 400.0, 600.0])
        if coupling == "bushing":
            self.bushing("coupling", "hub.above", "disc.far", soft, 2e-4)
        elif coupling == "body":
            self.body("coupling", "hub.above", "disc.far", soft)
        else:
            self.joint("coupling", "hub.rim", "disc.rim", DIRECTIONS)
        leg = np.array([2e5, 3e5, 6e5, 200.0, 300.0, 150.0])
        if grounded:
            return
        if stand == "slide":
            self.joint("slide", "ground.on", "stator.on", ("x", "y", "rx", "ry", "rz"))
        elif stand == "body":
            self.body("leg", "ground.leg 1", "stator.side", 100 * leg)
        else:
            for k in [0, 1, 2] if turns else [0, 1]:
                turn = Rotation.from_rotvec([0, 0, 2 * np.pi / 3 * k]).as_matrix()
                self.bushing(f"leg {k}", f"ground.leg {k}", f"stator.leg {k}", leg, 1e-4, turn)

    def inertia(self, name, place, moments):
        self.mass[place, place] = scipy.linalg.block_diag(MASSES[name] * np.eye(3), moments)
        both, gyro = np.kron(np.eye(2), W), np.zeros((6, 6))
        if name in TURNING:
            momentum = skew(moments @ [0, 0, SPEED])
            gyro[3:, 3:] = -momentum
            if self.frame == "rotor":
                m = MASSES[name]
                self.drag[place, place] = scipy.linalg.block_diag(2 * m * W, moments @ W + W @ moments - momentum)
                self.stiff[place, place] = scipy.linalg.block_diag(m * W @ W, W @ moments @ W - momentum @ W)
            else:
                self.drag[place, place] = gyro
        elif self.frame == "rotor":
            own = self.mass[place, place]
            self.drag[place, place], self.stiff[place, place] = 2 * own @ both, own @ both @ both

    def rows(self, a, b, turn=EYE):
        """Motion of b against a, whose body reaches rigidly to the place of b, along the axes turned, (6, n)."""
        at, result = np.array(SPOTS[b.partition(".")[2]]), np.zeros((6, self.n))
        for path, sign in ((a, -1), (b, 1)):
            name = path.partition(".")[0]
            if name in self.slices:
                result[:, self.slices[name]] += sign * rigid_transfer(at - PLACES[name])
        return np.kron(np.eye(2), turn.T) @ result

    def law(self, rows, stiffness, damping, side):
        """A spring, and a damper of a side, "rotor" or "stator"."""
        self.elastic += rows.T @ np.diag(stiffness) @ rows
        damper = rows.T @ np.diag(damping) @ rows
        self.drag += damper
        if side != self.frame:
            sees = np.kron(np.eye(self.n // 3), W)
            self.stiff += damper @ (sees if self.frame == "rotor" else -sees)

    def bushing(self, name, a, b, stiffness, share, turn=EYE):
        self.springs.append(Bushing(name, a, b, stiffness, share * stiffness, AXES @ turn))
        side = "rotor" if a.partition(".")[0] in TURNING else "stator"
        self.law(self.rows(a, b, turn), stiffness, share * stiffness, side)

    def body(self, name, a, b, stiffness):
        """A reduced body that is a spring, and weighs next to nothing."""
        reduced, tilt = two_lumps(*(np.array(SPOTS[path.partition(".")[2]]) for path in (a, b)), stiffness)
        self.bodies[name] = FlexibleBody(name, reduced, POINT, tilt, "linear")
        self.joints += [fixed(f"{name} {end}", path, f"{name}.{end}") for path, end in ((a, "a"), (b, "b"))]
        rows = self.rows(a, b)
        self.elastic += rows.T @ np.diag(stiffness) @ rows

    def joint(self, name, a, b, held):
        self.joints.append(Joint(name, a, b, tuple(d for d in DIRECTIONS if d not in held), AXES))
        self.held = np.vstack([self.held, self.rows(a, b)[[DIRECTIONS.index(d) for d in held]]])

    def tie(self, held, owner, means):
        """What ties the hub to what stands."""
        other = "ground" if self.grounded else "stator"
        spots = ("on", "on") if means == "joint" else ("on", "above")
        a, b = (
            f"{name}.{spot}"
            for name, spot in zip(("hub", other) if owner == "rotor" else (other, "hub"), spots, strict=True)
        )
        chosen = [DIRECTIONS.index(d) for d in held]
        rows = self.rows(a, b)[chosen]
        if means == "joint":
            self.joint("spindle", a, b, held)
        elif means == "bushing":
            figures = np.zeros(6)
            figures[chosen] = FIGURES[chosen]
            self.springs.append(Bushing("spindle", a, b, figures, axes=AXES))
            self.law(rows, FIGURES[chosen], 0 * FIGURES[chosen], owner)
        else:
            for d in chosen:
                axis = tuple(AXES[:, d])
                self.springs.append(SpringDamper(f"spindle {d}", a, b, axis, FIGURES[d], 3e-4 * FIGURES[d], frame=a))
            self.law(rows, FIGURES[chosen], 3e-4 * FIGURES[chosen], owner)

    def frfs(self):
        """The scene, and its transfer functions where they are compared, (outputs, inputs, n)."""
        turns, stand = self.frame == "rotor", "ground" if self.grounded else "stator"
        pushed, at, a = ("disc.rim", "hub.on", "hub.side") if turns else ("disc.above", "", "ground.side")
        direction, about, across = np.array([0.3, -0.5, 0.8]), np.array([0.7, 0.4, -0.2]), np.array([0.6, 0.7, -0.2])
        actuators = (
            PointForce("push", pushed, tuple(AXES @ direction), "push", frame=pushed if turns else ""),
            PointTorque("twist", "hub.on", tuple(AXES @ about), "twist", frame=at),
            PointForce("lift", "hub.on", tuple(AXIS), "lift"),
        )
        sensors = (
            Encoder("way", a, pushed, tuple(AXES @ across), frame=a if turns else ""),
            Encoder("gap", "ground.on", "disc.far", tuple(AXIS)),
            AngleSensor("angle", f"{stand}.on", "hub.on", tuple(AXIS)),
        )
        forces = np.zeros((self.n, 3))
        for k, (path, weights) in enumerate(
            ((pushed, direction), ("hub.on", [0, 0, 0, *about]), ("hub.on", [0, 0, 1]))
        ):
            alone = self.rows("ground.on", path)
            forces[:, k] = np.asarray(weights) @ alone[: len(weights)]
        norm = np.linalg.norm
        forces = forces / [norm(direction), norm(about), 1.0]
        ways = self.rows(a, pushed)[:3], self.rows("ground.on", "disc.far"), self.rows(f"{stand}.on", "hub.on")
        reads = np.array([across @ ways[0] / norm(across), ways[1][2], ways[2][5]])
        scene = Scene(
            "machine",
            tuple(self.bodies.values()),
            tuple(self.joints),
            actuators,
            sensors,
            tuple(self.springs),
            damping_ratio=self.ratio,
        )
        m, answers = len(self.held), []
        modal = self.modal()
        damping, stiffness = self.drag + modal, self.stiff + self.elastic
        for s in NEAR:
            whole = np.zeros((self.n + m,) * 2, complex)
            whole[: self.n, : self.n] = s**2 * self.mass + s * damping + stiffness
            whole[: self.n, self.n :], whole[self.n :, : self.n] = self.held.T, self.held
            answers.append(reads @ np.linalg.solve(whole, np.vstack([forces, np.zeros((m, 3))]))[: self.n])
        return scene, np.moveaxis(answers, 0, 2)

    def modal(self):
        """Damping of the modes at rest by a ratio."""
        left = scipy.linalg.null_space(self.held) if len(self.held) else np.eye(self.n)
        squares, shapes = scipy.linalg.eigh(left.T @ self.elastic @ left, left.T @ self.mass @ left)
        rates = np.sqrt(np.where(squares > 1e-6 * squares[-1], squares, 0.0))
        weights = self.mass @ left @ shapes
        return weights * (2 * self.ratio * rates) @ weights.T


def assert_same(found, expected, share=1e-7):
    """Transfer functions, each to a share of its own size."""
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=share, atol=0.01 * share * np.abs(other).max())


JOINTS = ["x y z rx ry", "x y rx ry", "x y z", "z rx ry", "x y", "rx ry", "z", "x", "rx", "x z"]
CASES = [(held, "joint", owner) for held in JOINTS for owner in ("rotor", "stator")]
CASES += [(held, "bushing", owner) for held in JOINTS for owner in ("rotor", "stator")]
CASES += [(held, "spring", owner) for held in ("x y z", "x y", "z", "x", "x z") for owner in ("rotor", "stator")]


def found_of(scene, frame):
    """Transfer functions of the package's linear model."""
    standing = [body.name for body in scene.bodies if body.name in ("ground", "stator", "leg")]
    model = linearize(scene, angular_velocity=SPEED * AXIS, axis_point=POINT, stator=standing, frame=frame)
    a, b, c, d = model.matrices
    return np.moveaxis([c @ np.linalg.solve(s * np.eye(len(a)) - a, b) + d for s in NEAR], 0, 2)


@pytest.mark.parametrize("grounded", [False, True])
@pytest.mark.parametrize("frame", ["rotor", "stator"])
@pytest.mark.parametrize(("held", "means", "owner"), CASES)
def test_every_tie_across_a_spindle(held, means, owner, frame, grounded):
    """What is not alike across the axis is constant as its owner sees it, and is refused by name in the other frame.

    Bushings with one stiff rotation are no bearings: their axes turn halfway, so no frame sees those constant.
    """
    machine = Machine(frame, grounded=grounded)
    machine.tie(held.split(), owner, means)
    scene, expected = machine.frfs()
    alike = all((a in held.split()) == (b in held.split()) for a, b in (("x", "y"), ("rx", "ry")))
    halfway = means == "bushing" and held == "rx"
    if alike or (frame == owner and not halfway):
        assert_same(found_of(scene, frame), expected)
        return
    with pytest.raises(
        ValueError, match=rf"^(joint 'spindle'|the force law between \w+.on and \w+.above): in the {frame} frame"
    ):
        found_of(scene, frame)


DAMPED = [
    ("rotor", {"grounded": True}),
    ("rotor", {"grounded": True, "coupling": "body"}),
    ("rotor", {"stand": "slide", "coupling": "body"}),
    ("stator", {"stand": "body", "coupling": "joint"}),
]
HINGE = ["x", "y", "z", "rx", "ry"]


@pytest.mark.parametrize("owner", ["rotor", "stator"])
@pytest.mark.parametrize(("frame", "options"), DAMPED)
def test_modal_damping_across_a_spindle(frame, options, owner):
    """It is that of the parts that deform: it turns with a rotor and stands with a stator."""
    machine = Machine(frame, ratio=0.04, **options)
    machine.tie(HINGE, owner, "joint")
    scene, expected = machine.frfs()
    assert_same(found_of(scene, frame), expected, 1e-6)


def test_modal_damping_of_a_rotor_does_not_stand():
    """The frame of the stator knows rigid bodies of the rotor, whose modes lose their damping, with a warning."""
    machine, undamped = Machine("stator", grounded=True, ratio=0.04), Machine("stator", grounded=True)
    for each in (machine, undamped):
        each.tie(HINGE, "stator", "joint")
    scene, _ = machine.frfs()
    with pytest.warns(UserWarning, match="damping_ratio acts through deformation only"):
        found = found_of(scene, "stator")
    assert_same(found, undamped.frfs()[1])


STATOR = {"m": 5.0, "k": 3e5, "c": 400.0}
"""Of a foundation: its mass, and what holds and damps it across the axis."""


def unbalanced(*, lopsided=0.0):
    """A rotor whose centre lies beside its axis, in a hinge of a stator on one damped bushing; all in one plane."""
    offset, at = 2e-4 * AXES[:, 0], {"on": np.zeros(3), "rim": 0.1 * AXES[:, 1]}
    inertia = AXES @ np.diag([0.05, 0.05 * (1 + lopsided), 0.08]) @ AXES.T
    ground = RigidBody("ground", {"on": np.zeros(3)}, fixed=True, position=POINT)
    stator = RigidBody("stator", at, STATOR["m"], inertia, POINT)
    rotor = RigidBody("rotor", {"on": -offset}, 2.0, inertia, POINT + offset)
    figures = np.array([STATOR["k"], STATOR["k"], 1e6, 4e3, 4e3, 4e3])
    damping = np.array([STATOR["c"], STATOR["c"], 0, 0, 0, 0])
    springs = (Bushing("feet", "ground.on", "stator.on", figures, damping, AXES),)
    hinge = Joint("hinge", "stator.on", "rotor.on", ("rz",), AXES)
    way = tuple(Encoder(f"{k}", "ground.on", "rotor.on", tuple(AXES[:, k]), frame="rotor.on") for k in range(2))
    return Scene("unbalanced", (ground, stator, rotor), (hinge,), sensors=way, springs=springs, damping_ratio=0.0)


def test_a_foundation_that_stands_damps_an_unbalance():
    """Whirl (k + i c W - m W^2) u = e m W^2 as the rotor sees it, with a ring that hangs between both sides.

    Whether the ring turns has to be said, and does not matter to its whirl.
    """
    scene, hung = unbalanced(), 2e5
    ring = RigidBody("ring", {"on": np.zeros(3)}, 0.5, 1e-3 * np.eye(3), POINT)
    ties = tuple(Bushing(b, f"{b}.on", "ring.on", [hung / 2] * 3 + [0] * 3) for b in ("stator", "rotor"))
    drive = (Drive("motor", "hinge", "rz", speed=SPEED),)
    scene = replace(scene, bodies=(*scene.bodies, ring), springs=(*scene.springs, *ties), actuators=drive)
    dynamic = np.array(
        [[STATOR["k"] + 1j * STATOR["c"] * SPEED - 7.0 * SPEED**2 + hung, -hung], [-hung, hung - 0.5 * SPEED**2]]
    )
    expected = np.linalg.solve(dynamic, [2e-4 * 2.0 * SPEED**2, 0.0])[0]
    assert abs(expected.imag) > 0.1 * abs(expected.real)
    for standing in (["ground", "stator"], ["ground", "stator", "ring"]):
        found = spinning_equilibrium(scene, stator=standing)
        assert found["0"] + 1j * found["1"] == pytest.approx(expected, rel=1e-6)
    with pytest.raises(ValueError, match="name all bodies of the stator"):
        spinning_equilibrium(scene)


def test_an_equilibrium_in_either_frame():
    """A stator that differs across the axis has one as it stands, without unbalance at zero; the rotor refuses it."""
    uneven = unbalanced(lopsided=0.2)
    ground, stator, rotor = uneven.bodies
    even = replace(rotor, position=POINT, points={"on": np.zeros(3)}, inertia=unbalanced().bodies[2].inertia)
    scene = replace(uneven, bodies=(ground, stator, even), sensors=(Encoder("0", "ground.on", "rotor.on", "x"),))
    spin = {"angular_velocity": SPEED * AXIS, "axis_point": POINT, "stator": ["ground", "stator"]}
    assert spinning_equilibrium(scene, **spin, frame="stator") == pytest.approx({"0": 0.0}, abs=1e-12)
    with pytest.raises(ValueError, match="body 'stator': in the rotor frame"):
        spinning_equilibrium(scene, **spin)


@pytest.mark.parametrize("frame", ["rotor", "stator"])
def test_a_loop_across_a_spindle(frame):
    """A weak sampled loop along the axis moves a pole as its gain times the transfer function's residue."""
    machine = Machine(frame)
    machine.tie(HINGE, frame, "joint")
    scene, _ = machine.frfs()
    rate, gain = 2e4, 10.0
    loop = Loop("loop", proportional(gain, sample_rate=rate, delay=0), "gap", "lift")
    spin = {"angular_velocity": SPEED * AXIS, "axis_point": POINT, "stator": ["ground", "stator"], "frame": frame}
    closed = linearize_closed(replace(scene, loops=(loop,)), continuous=True, delay_order=0, **spin)
    a, b, c, _ = linearize(scene, **spin).matrices
    rows, columns = [closed.outputs.index("gap")], [closed.inputs.index("lift")]
    expected = np.linalg.eigvals(a + gain * b[:, columns] @ c[rows])
    found = closed.poles()[np.argmin(np.abs(np.subtract.outer(expected, closed.poles())), axis=1)]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("frame", "cure"),
    [
        ("rotor", r'take the axis, or a direction whose frame is a point of the rotor: frame="body\.point"'),
        ("stator", "take the axis, or a direction whose frame is the world or a point of the stator"),
    ],
)
def test_a_signal_across_the_axis_is_told_which_frame_serves(frame, cure):
    machine = Machine(frame)
    machine.tie(HINGE, frame, "joint")
    other = "ground.on" if frame == "rotor" else "disc.on"
    across = Encoder("across", "ground.on", "disc.on", tuple(AXES[:, 0]), frame=other)
    scene = replace(machine.frfs()[0], sensors=(across,))
    with pytest.raises(ValueError, match=f"output 'across': in the {frame} frame, .*; {cure}$"):
        found_of(scene, frame)
