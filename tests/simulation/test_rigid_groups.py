"""Rigid joints between floating bodies, rigid ones and the ground take coordinates: against scenes with the joints."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import STEEL, lattice, make_bar
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    Bushing,
    Drive,
    Encoder,
    FlexibleBody,
    ForceSensor,
    GroundAcceleration,
    Joint,
    PointForce,
    PointTorque,
    Pose,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    Vibrometer,
    build_fe_model,
    craig_bampton,
    describe,
    fixed,
    revolute,
    static_response,
)
from nassim.scene import Combination, Displacement, ForceElement, Path, Spring
from nassim.simulation import exudyn_eigenfrequencies, simulate, simulate_motion
from nassim.simulation.exudyn import bodies as exudyn_bodies
from nassim.simulation.exudyn.frame_poses import FramePoses
from nassim.simulation.exudyn.steady_state import squares_at_rest
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.loaded import carried_bodies, loaded_state
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.rigid_groups import CarriedBody, find_rigid_groups, with_carried

PLACE = np.array([0.2, -0.1, 0.3])
TURN = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=3, progress=False)


def inertia(seed, size):
    turn = Rotation.random(random_state=seed).as_matrix()
    return turn @ np.diag(np.array([1.0, 1.3, 1.9]) * size) @ turn.T


def machine(bar, frame="left", *, turns=True):
    """A shaft carries a bar, which carries a head with a knob, on which a bushing holds a table; all lies askew.

    The shaft is on an axle, or the ground holds it.
    """
    left, right = (PLACE + TURN @ bar.point(name).position for name in ("left", "right"))
    random = np.random.default_rng(5)

    def rigid(name, at, mass, points):
        turn = Rotation.random(random_state=len(name)).as_matrix()
        arms = {key: turn.T @ (place - at) for key, place in points.items()}
        return RigidBody(name, arms, mass, inertia(len(name), 2e-5 * mass), at, rotation=turn)

    pin, centre, seam, tip, seat = (at + random.uniform(-0.008, 0.008, 3) for at in (left, left, right, right, right))
    post = np.add(pin, [0.05, 0.03, -0.04])
    bodies = (
        RigidBody("ground", {"pin": pin, "post": post}, fixed=True),
        rigid("shaft", centre, 0.3, {"pin": pin, "mount": left, "horn": np.add(centre, [0.01, 0.02, 0.0])}),
        FlexibleBody("bar", bar, PLACE, TURN, "ffrf", frame, damping_ratio=0.02),
        rigid("head", np.add(seam, [0.004, -0.007, 0.005]), 0.2, {"mount": right, "seam": seam, "seat": seat}),
        rigid("knob", tip, 0.1, {"seam": seam, "tip": np.add(tip, [0.0, 0.007, 0.005])}),
        rigid("table", np.add(seat, [0.01, 0.01, 0.02]), 0.15, {"seat": seat}),
    )
    joints = (
        revolute("axle", "ground.pin", "shaft.pin", (0.3, -0.2, 1.0), damping=1e-3)
        if turns
        else fixed("axle", "ground.pin", "shaft.pin"),
        fixed("top", "bar.right", "head.mount"),
        fixed("seam", "knob.seam", "head.seam"),
        fixed("bottom", "shaft.mount", "bar.left"),
    )
    return Scene(
        "machine",
        bodies,
        joints,
        (
            PointForce("push", "knob.tip", (1.0, 0.4, -0.3), "force", frame="knob.tip"),
            PointTorque("twist", "head.seat", (0.0, 0.2, 1.0), "torque"),
            GroundAcceleration("quake", (0.1, 0.2, 1.0), "quake"),
        ),
        (
            Encoder("reach", "ground.post", "knob.tip", "line"),
            Vibrometer("knob_speed", "knob.tip", (0.2, 1.0, 0.3)),
            Accelerometer("knob_shake", "knob.tip", (0.1, -0.3, 1.0)),
            Accelerometer("shaft_shake", "shaft.horn", (1.0, 0.5, 0.2), frame="shaft.horn"),
            Pose("pose", "shaft.horn", "head.seat"),
            ForceSensor("bed", "bed"),
            ForceSensor("pull", "pull"),
        ),
        (
            Bushing(
                "bed", "head.seat", "table.seat", (2e4, 3e4, 4e4, 5.0, 6.0, 7.0), 1e-4 * np.array([2e4] * 3 + [5.0] * 3)
            ),
            SpringDamper("pull", "ground.post", "knob.tip", "line", 2e3, 1.0),
            SpringDamper("hold", "ground.post", "shaft.horn", "line", 3e3, 1.0),
        ),
        damping_ratio=0.0,
    )


@pytest.fixture
def jointed(monkeypatch):
    """Build the same scenes with their joints."""

    def without_hosts(constraints, **_):
        found = find_rigid_groups(constraints)
        return replace(found, hosts={}, grounded={}, joints=found.joints - {"top", "bottom"})

    def separate():
        for module in (exudyn_bodies, carried_bodies):
            monkeypatch.setattr(module, "find_rigid_groups", without_hosts)

    return separate


@pytest.mark.parametrize(
    ("frame", "turns", "fewer"),
    [("left", True, [14, 14]), ("right", True, [14, 14]), ("left", False, [14, 14]), ("right", False, [7, 7])],
)
def test_frequencies_and_coordinates(bar, frame, turns, fewer, jointed):
    """A floating body has no frame where the ground holds it there, and the head no coordinates of its own."""
    scene = machine(bar, frame, turns=turns)
    assembly = assemble(scene)
    one = build_system(assembly)
    jointed()
    several = build_system(assembly)
    sizes = [(s.mbs.systemData.ODE2Size(), s.mbs.systemData.AEsize()) for s in (one, several)]
    assert np.subtract(*sizes[::-1]).tolist() == fewer
    assert one.framed == several.framed
    squares = [np.sqrt(squares_at_rest(system)) for system in (one, several)]
    np.testing.assert_allclose(squares[0], squares[1], rtol=1e-6)
    np.testing.assert_allclose(squares[0], np.sort(2 * np.pi * assembly.modal.frequency), rtol=1e-6)


def test_poses_of_several_bodies_at_once_are_those_one_by_one(bar):
    """Of three that one flexible body carries, deformed, and of others."""
    system = build_system(assemble(machine(bar)))
    data, names = system.mbs.systemData, ["head", "knob", "shaft", "bar", "table"]
    data.SetODE2Coordinates(1e-3 * np.random.default_rng(3).normal(size=data.ODE2Size()))
    frames = FramePoses(system)
    rotations, places = frames.poses(names, reference=False)
    for rotation, place, name in zip(rotations, places, names, strict=True):
        expected = frames._pose(name, reference=False)
        np.testing.assert_allclose(rotation, expected[0], atol=1e-14, err_msg=name)
        np.testing.assert_allclose(place, expected[1], atol=1e-14, err_msg=name)


def test_carried_bodies_add_their_mass_to_all_integrals(bar):
    """Mass matrix of the host with its guests in the coordinates of the host, against that of the joined bodies."""
    assembly = assemble(machine(bar))
    groups = find_rigid_groups(assembly.constraints)
    assert sorted(groups.hosts.values()) == ["bar.left", "bar.right"]
    host = assembly.scene.split("bar.")[0]
    guests = [
        CarriedBody(assembly.scene.body(name).along_world, host, groups.hosts[leader].split(".")[1])
        for name, leader in groups.leaders.items()
        if leader in groups.hosts
    ]
    whole = with_carried(host, guests).reduced
    basis = assembly.constraints.basis
    place = assembly.coordinates.slices["bar"]
    apart = sum(
        (
            rows.T @ assembly.scene.body(name).mass_matrix @ rows
            for name in ("shaft", "bar", "head", "knob")
            for rows in (basis[assembly.coordinates.slices[name]],)
        ),
        start=np.zeros((basis.shape[1],) * 2),
    )
    together = basis[place].T @ whole.mass_matrix @ basis[place]
    np.testing.assert_allclose(together, apart, atol=1e-12 * np.abs(apart).max())
    trace = np.einsum("jckc->jk", whole.gram[4:, 4:].reshape(len(whole.mass_matrix), 3, -1, 3))
    np.testing.assert_allclose(trace, whole.mass_matrix, atol=1e-9 * np.abs(whole.mass_matrix).max())


@pytest.mark.parametrize("side", [0.9, 1.1])
@pytest.mark.parametrize("what", ["reach", "gyration", "mass"])
def test_a_body_carries_what_is_no_larger_than_itself(bar, side, what):
    """Nor a thousand times as heavy: points of its guests, their rms distance from their centre, and their mass."""
    left, right = bar.remote_points
    bar = replace(bar, remote_points=(left, replace(right, position=right.position + np.array([0.0, 0.02, -0.01]))))
    size = np.linalg.norm(bar.point("right").position - bar.point("left").position)
    reach, gyration, mass = (side if what == name else 0.1 for name in ("reach", "gyration", "mass"))
    at, along = PLACE + TURN @ bar.point("right").position, np.array([0.6, 0.0, 0.8])
    moment = 0.5 * 1e3 * mass * bar.mass * np.eye(3)
    heads = (
        RigidBody("head", {"seat": (0, 0, 0)}, moment[0, 0], 1e-3 * size**2 * moment, at),
        RigidBody(
            "cap",
            {"seat": (0, 0, 0), "end": reach * size * along},
            moment[0, 0],
            2 / 3 * (gyration * size) ** 2 * moment,
            at,
        ),
    )
    joints = fixed("top", "bar.right", "head.seat"), fixed("seam", "head.seat", "cap.seat")
    scene = Scene("heads", (FlexibleBody("bar", bar, PLACE, TURN, "ffrf", "left"), *heads), joints)
    hosts = find_rigid_groups(assemble(scene).constraints).hosts
    assert hosts == ({"head": "bar.right"} if side < 1 else {})


@pytest.mark.parametrize(("frame", "turns"), [("right", True), ("left", False)])
def test_histories_and_images(bar, frame, turns, jointed):
    """Differences are of second order in the deformation, some 1e-5 rad."""
    scene, step = machine(bar, frame, turns=turns), 1e-4
    time = np.arange(101) * step
    values = 0.03 * np.array([np.sin(300 * time), 0.01 * np.cos(500 * time), np.sin(200 * time)])
    push = TimeHistory(time, values, ("force", "torque", "quake"), ("N", "N m", "m/s2"))
    options = {"time_step": step, "frames": 3, "progress": False, "spectral_radius": 0.8}
    one, seen = simulate_motion(scene, push, **options)
    jointed()
    several, expected = simulate_motion(scene, push, **options)
    for name in scene.outputs:
        size = np.abs(several[name] - several[name][0]).max()
        assert size > 0 or name == "shaft_shake"
        share = 0.01 if name.endswith("shake") else 1e-4  # accelerations ring by what Newton's iterations leave
        np.testing.assert_allclose(one[name], several[name], rtol=0, atol=share * size, err_msg=name)
    for body in ("shaft", "bar", "head", "knob") if turns else ("head", "knob"):
        for pose in ("positions", "rotations"):
            found, right = (getattr(motion, pose)[body] for motion in (seen, expected))
            size = np.abs(right - right[0]).max()
            assert size > 1e-9
            np.testing.assert_allclose(found, right, rtol=0, atol=1e-4 * size, err_msg=f"{pose} of {body}")


def test_a_cantilever_at_an_odd_pose_bends_and_oscillates_as_beams_do():
    """Tip under a load across it, by Timoshenko, and the first frequency of either bending, by Euler and Bernoulli."""
    length, side = 0.2, 0.01
    model = build_fe_model(make_bar(length, side, coupling="rbe2"), element_size=0.01, order=3, progress=False)
    body = FlexibleBody("bar", craig_bampton(model, n_modes=4, discretization=False, progress=False), PLACE, TURN)
    left, right = (body.point_position(name) for name in ("left", "right"))
    across = TURN @ [0.0, 0.6, 0.8]
    ground = RigidBody("ground", {"left": left, "right": right}, fixed=True)
    scene = Scene(
        "cantilever",
        (ground, body),
        (fixed("wall", "ground.left", "bar.left"),),
        (PointForce("push", "bar.right", tuple(across), "force"),),
        (Encoder("tip", "ground.right", "bar.right", tuple(across)),),
        damping_ratio=0.0,
    )
    assert "held rigidly to the ground by left, which leaves 10 coordinates" in describe(scene)
    both = replace(scene, joints=(*scene.joints, fixed("far", "ground.right", "bar.right")), actuators=(), sensors=())
    assert "held rigidly to the ground by left, right, which leaves 4 coordinates" in describe(both)
    area, inertia, shear, factor = side**2, side**4 / 12, STEEL.lame_parameters[1], 10 * 1.3 / (12 + 11 * 0.3)
    tip = length**3 / (3 * STEEL.young_modulus * inertia) + length / (factor * shear * area)
    assert static_response(scene, {"force": 2.0})["tip"] == pytest.approx(2.0 * tip, rel=5e-3)
    first = 1.8751**2 / length**2 * np.sqrt(STEEL.young_modulus * inertia / (STEEL.density * area)) / (2 * np.pi)
    assert exudyn_eigenfrequencies(scene)[:2] == pytest.approx([first, first], rel=1e-2)


def pendulum(*, speed=0.0, gravity=0.0, free=()):
    """A heavy head of two bodies at the end of a soft bar, which its weight or the spin of the bar pulls along.

    Where a joint between the two leaves a motion free, the bar carries the first alone.
    """
    soft = craig_bampton(lattice(stiffness=1e4), n_modes=2, progress=False)
    left, right = (TURN @ soft.point(name).position for name in ("left", "right"))
    along, across = TURN[:, 0], TURN[:, 1]
    head = RigidBody(
        "head", {"mount": -0.02 * along, "tip": 0.005 * along}, 0.04, 1e-5 * np.eye(3), right + 0.02 * along
    )
    cap = RigidBody("cap", {"tip": -0.003 * along}, 0.06, 1e-5 * np.eye(3), right + 0.028 * along)
    hub = RigidBody("hub", {"hub": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), left)
    return Scene(
        "pendulum",
        (RigidBody("ground", {"hub": left}, fixed=True), hub, FlexibleBody("bar", soft, np.zeros(3), TURN), head, cap),
        (
            revolute("axle", "ground.hub", "hub.hub", across),
            fixed("bottom", "hub.hub", "bar.left"),
            fixed("top", "bar.right", "head.mount"),
            Joint("seam", "head.tip", "cap.tip", free),
        ),
        (
            Drive("motor", "axle", "rz", **({"speed": speed} if speed else {"input": "angle"})),
            PointForce("push", "head.tip", tuple(across), "force", frame="head.tip"),
        ),
        (Pose("pose", "hub.hub", "head.tip", axes=TURN),),
        damping_ratio=0.0,
        gravity=gravity * along,
    )


def sway(scene, step=5e-4):
    """Motion of the head across the bar by a push."""
    time = np.arange(201) * step
    inputs = tuple(scene.inputs)
    push = np.sin(np.pi * np.minimum(time / 0.02, 1.0)) ** 2
    values = np.array([1e-3 * push * (name == "force") for name in inputs])
    excitation = TimeHistory(time, values, inputs, tuple(map(scene.input_unit, inputs)))
    moved = simulate(scene, excitation, time_step=step, progress=False)["pose.uy"]
    return moved - moved[0]


@pytest.mark.parametrize(
    "loads",
    [{"gravity": 50.0}, {"speed": 30.0}, {"gravity": 50.0, "free": ("rx", "ry", "rz")}],
    ids=["hung", "spun", "jointed"],
)
def test_loads_on_carried_bodies_stiffen_what_carries_them(loads, jointed, monkeypatch):
    scene = pendulum(**loads)
    assert find_rigid_groups(assemble(scene).constraints).hosts == {"hub": "bar.left", "head": "bar.right"}
    assert "head: rigid, part of bar, whose right carries it" in " ".join(describe(scene).split())
    thrown = [
        replace(body, angular_velocity=30.0 * TURN[:, 1]) if body.name == "hub" else body for body in scene.bodies
    ]
    alone = describe(replace(scene, bodies=tuple(thrown), actuators=scene.actuators[1:]))
    assert ("head: rigid, 6 coordinates shared by 2 bodies" in " ".join(alone.split())) == ("free" not in loads)
    one = sway(scene)
    with monkeypatch.context() as without:
        full = loaded_state.stiffness_of_carried
        without.setattr(
            loaded_state, "stiffness_of_carried", lambda *given: {name: 0.0 * k for name, k in full(*given).items()}
        )
        soft = sway(scene)
    jointed()
    several = sway(scene)
    size = np.abs(several).max()
    assert np.abs(one - several).max() < 0.015 * size
    assert np.abs(soft - several).max() > 0.1 * size


def test_with_two_spindles_a_spin_has_no_linear_model_and_a_body_carries_nothing_by_its_other_end(jointed):
    """The loads known are then the weights alone, without the centrifugal force that holds the head up."""
    scene = pendulum(speed=30.0, gravity=50.0)
    wheel = RigidBody("wheel", {"hub": np.zeros(3)}, 1.0, 1e-3 * np.eye(3), scene.point_position("ground.hub"))
    two = replace(
        scene,
        bodies=(*scene.bodies, wheel),
        joints=(*scene.joints, revolute("other", "ground.hub", "wheel.hub", TURN[:, 1])),
        actuators=(*scene.actuators, Drive("second", "other", "rz", speed=10.0)),
    )
    one = sway(two)
    jointed()
    several = sway(two)
    assert np.abs(one - several).max() < 1e-3 * np.abs(several).max()


@pytest.mark.filterwarnings("ignore:the stress in body 'bar'")
def test_weights_that_a_point_carries_stiffen_its_rotation_by_their_moments():
    """By mass times gravity times the arm along it: of two bodies as one, and of one by one."""
    scene, along = pendulum(gravity=50.0), TURN[:, 0]
    *others, cap = scene.bodies
    on_bar = replace(cap, points={"mount": scene.point_position("bar.right") - cap.position})
    *joints, _ = scene.joints
    apart = replace(scene, bodies=(*others, on_bar), joints=(*joints, fixed("seam", "bar.right", "cap.mount")))
    assert find_rigid_groups(assemble(apart).constraints).hosts.keys() == {"hub", "head", "cap"}
    expected = np.zeros((14, 14))
    expected[10, 10] = expected[11, 11] = 50.0 * (0.04 * 0.020 + 0.06 * 0.028)
    for one in (scene, apart):
        found = loaded_state.loaded_state(assemble(one), gravity=50.0 * along, checked=False).carried["bar"]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@dataclass(frozen=True)
class Lever(ForceElement):
    """A spring that feels some times the motion of b against a along z."""

    a: Path
    b: Path
    times: float

    def terms(self, scene):
        return (Spring(Combination(((self.times, Displacement.between(self.a, self.b, TURN[:, 0])),)), 1e3),)


def test_a_spring_behind_a_lever_pulls_what_a_point_carries_by_its_ratio():
    """A lever of two to one makes its stiffness four times as large; it bears a part of the weight."""
    scene, along = pendulum(gravity=50.0), TURN[:, 0]

    def carried(*springs):
        held = assemble(replace(scene, springs=springs))
        return loaded_state.loaded_state(held, gravity=50.0 * along, checked=False).carried["bar"]

    levered = carried(Lever("lever", "ground.hub", "cap.tip", 2.0))
    straight = carried(SpringDamper("straight", "ground.hub", "cap.tip", along, 4e3))
    np.testing.assert_allclose(levered, straight, rtol=1e-9, atol=1e-12)
    assert np.abs(straight - carried()).max() > 0.01 * np.abs(carried()).max()
