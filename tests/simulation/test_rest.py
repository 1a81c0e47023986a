"""Linear models about loaded equilibria, against equations of motion that are written out here and differentiated."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from scipy.spatial.transform import Rotation

from nassim import (
    Accelerometer,
    AngleSensor,
    Bushing,
    Drive,
    Encoder,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    Vibrometer,
    frequency_response,
    linearize,
    revolute,
    static_response,
)
from nassim.simulation import loaded_equilibrium
from nassim.simulation.linear.linearization import linear_model, loaded_assembly, steady_outputs
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.run.loaded_start import assemble_spin

FREQUENCY = np.array([0.3, 1.0, 3.3, 7.0, 15.0, 40.0])


def turned(vector):
    return Rotation.from_rotvec(vector).as_matrix()


def cross(a, b):
    """The cross product, without the overhead of NumPy's."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rate_to_spin(vector):
    """The angular velocity of a rotation per unit rate of its rotation vector, (3, 3)."""
    angle, cross_by = np.linalg.norm(vector) + 1e-12, np.cross(np.eye(3), vector)
    wider = (angle - np.sin(angle)) / angle**3
    return np.eye(3) + 2 * (np.sin(angle / 2) / angle) ** 2 * cross_by + wider * cross_by @ cross_by


def rigid_scene(rng, load):
    """Two bodies in odd positions on springs along lines and along axes that turn with either end, and on bushings.

    All of it is preloaded, by a share of a fixed load.
    """
    places = {f"p{k}": 0.3 * rng.normal(size=3) for k in range(8)}
    bodies, springs = [RigidBody("ground", places, fixed=True)], []
    for name in "ab":
        inertia = np.sort(rng.uniform(0.01, 0.02, 3))
        axes, start = turned(rng.normal(size=3)), turned(2 * rng.normal(size=3))
        points = {f"p{k}": 0.15 * rng.normal(size=3) for k in range(8)}
        mass, place = rng.uniform(0.5, 3), 0.3 * rng.normal(size=3)
        bodies.append(RigidBody(name, points, mass, axes @ np.diag(inertia) @ axes.T, place, rotation=start))
    for body in bodies[1:]:
        for k in range(7):
            ends = (f"{'a' if body.name == 'b' and k > 3 else 'ground'}.p{k}", f"{body.name}.p{k}")
            axis, frame = ("line", "") if k % 2 else (rng.normal(size=3), rng.choice(["", *ends]))
            sizes = {"stiffness": rng.uniform(2e3, 2e4), "damping": rng.uniform(0, 20)}
            sizes["preload"] = load * rng.uniform(-30, 30)
            springs.append(SpringDamper(f"{body.name}{k}", *ends, axis, frame=str(frame), **sizes))
        root = rng.normal(size=(6, 6)) * np.repeat([1.0, 0.1], 3)[:, None]
        stiffness = 2e3 * root @ root.T + np.diag([5e3, 5e3, 5e3, 0.5, 0.5, 0.5])
        pull = load * np.append(rng.uniform(-10, 10, 3), np.zeros(3))
        parts = stiffness, 1e-3 * stiffness, turned(rng.normal(size=3)), pull
        springs.append(Bushing(f"{body.name}7", "ground.p7", f"{body.name}.p7", *parts))
    push = PointForce("push", "a.p0", rng.normal(size=3), "force", "a.p0")
    read = Encoder("read", "b.p1", "a.p2", rng.normal(size=3), "b.p1")
    swift = Vibrometer("swift", "a.p3", (0.6, -0.3, 0.7), "a.p3")
    shaken = Accelerometer("shaken", "b.p4", (0.2, 0.8, -0.5), "b.p4")
    options = {"gravity": load * 5.0 * rng.normal(size=3), "damping_ratio": 0.0}
    return Scene("machine", bodies, (), (push,), (read, swift, shaken), springs, **options)


def on_a_spindle(scene, velocity, point):
    """The same machine, whose ground becomes a body that a drive turns."""
    (ground, *others), rate = scene.bodies, float(np.linalg.norm(velocity))
    table = RigidBody("ground", {**ground.points, "axle": point}, 3.0, np.diag([0.1, 0.2, 0.25]))
    floor = RigidBody("floor", {"axle": point}, fixed=True)

    def turning(part):
        fixed = isinstance(part, SpringDamper) and not isinstance(part.axis, str) and not part.frame
        return replace(part, frame="ground.p0") if fixed else part

    spindle = revolute("spindle", "floor.axle", "ground.axle", velocity / rate)
    actuators = [*scene.actuators, Drive("motor", "spindle", "rz", speed=rate)]
    springs = [turning(part) for part in scene.springs]
    return replace(scene, bodies=(floor, table, *others), joints=[spindle], actuators=actuators, springs=springs)


class NewtonEuler:
    """Accelerations of a scene of rigid bodies on springs in a rotating frame."""

    def __init__(self, scene, velocity, point):
        self.scene, self.velocity, self.point = scene, velocity, point
        self.bodies = scene.bodies[1:]
        self.start = self.states(np.zeros((2, 12)))
        self.size = 12

    def states(self, values):
        """Position, rotation since the start, velocity and angular velocity of each body."""
        motion, rate = np.reshape(values, (2, -1, 6))
        result = {"ground": (np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))}
        for body, x, v in zip(self.bodies, motion, rate, strict=True):
            result[body.name] = (body.position + x[:3], turned(x[3:]), v[:3], v[3:])
        return result

    def point_motion(self, states, path):
        name, _, key = path.partition(".")
        body = self.scene.body(name)
        place, rotation, velocity, spin = states[name]
        arm = rotation @ body.rotation @ body.points[key]
        return place + arm, velocity + cross(spin, arm)

    def measured(self, states, part):
        """Direction and displacement of part.b from part.a, and its rate, along part.axis, which turns with a frame."""
        (pa, va), (pb, vb) = (self.point_motion(states, path) for path in (part.a, part.b))
        starts = [self.point_motion(self.start, path)[0] for path in (part.a, part.b)]
        if isinstance(part.axis, str):
            length = np.linalg.norm(pb - pa)
            along = (pb - pa) / length
            return along, length - np.linalg.norm(starts[1] - starts[0]), along @ (vb - va), np.zeros(3)
        _, rotation, _, spin = states[part.frame.partition(".")[0] or "ground"]
        axis = part.axis / np.linalg.norm(part.axis)
        along = rotation @ axis
        value = along @ (pb - pa) - axis @ (starts[1] - starts[0])
        return along, value, along @ (vb - va) + cross(spin, along) @ (pb - pa), cross(along, pb - pa)

    def accelerations(self, motion, rate, force=0.0):
        states = self.states([motion, rate])
        acting = {body.name: np.zeros(6) for body in self.scene.bodies}

        def act(path, pull, moment=0.0):
            name, place = path.partition(".")[0], self.point_motion(states, path)[0]
            acting[name] += np.concatenate([pull, cross(place - states[name][0], pull) + moment])

        for part in self.scene.springs:
            if isinstance(part, SpringDamper):
                along, value, speed, turning = self.measured(states, part)
                tension = part.stiffness * value + part.damping * speed + part.preload
                act(part.b, -tension * along)
                act(part.a, tension * along)
                if part.frame:
                    acting[part.frame.partition(".")[0]][3:] -= tension * turning
            else:  # from the ground, whose point coincides with the body's but for a vector that stays
                (pa, _), (pb, vb) = (self.point_motion(states, path) for path in (part.a, part.b))
                place = pa + np.subtract(*(self.point_motion(self.start, path)[0] for path in (part.b, part.a)))
                _, rotation, _, spin = states[part.b.partition(".")[0]]
                by = Rotation.from_matrix(rotation).as_rotvec()
                axes, by_spin = turned(by / 2) @ part.axes, np.linalg.inv(rate_to_spin(by))
                half = 0.5 * rate_to_spin(by / 2) @ by_spin
                value = np.concatenate([axes.T @ (pb - place), part.axes.T @ by])
                rate = np.concatenate([axes.T @ (vb - cross(half @ spin, pb - place)), part.axes.T @ by_spin @ spin])
                push, moment = np.reshape(part.stiffness @ value + part.damping @ rate + part.preload, (2, 3))
                pull = axes @ push
                act(part.b, -pull, half.T @ cross(pb - place, pull) - by_spin.T @ part.axes @ moment)
        push = self.scene.actuators[0]
        act(push.point, force * states["a"][1] @ push.axis / np.linalg.norm(push.axis))
        result, w = [], self.velocity
        for body in self.bodies:
            place, rotation, v, spin = states[body.name]
            inertia = rotation @ body.rotation @ body.inertia @ (rotation @ body.rotation).T
            pull = acting[body.name][:3] / body.mass + self.scene.gravity
            result.append(pull - 2 * cross(w, v) - cross(w, cross(w, place - self.point)))
            momentum = inertia @ (spin + w)
            change = cross(spin, momentum) - inertia @ cross(spin, spin + w)
            result.append(np.linalg.solve(inertia, acting[body.name][3:] - cross(w, momentum) - change))
        return np.concatenate(result)

    def readings(self, motion, rate, acceleration):
        """Of the encoder, and velocity and acceleration in inertial space along axes that turn with their body."""
        encoder, swift, shaken = self.scene.sensors
        states, speeding = (self.states([motion, change]) for change in (rate, acceleration))

        def along(sensor, vector):
            return states[sensor.point[0]][1] @ sensor.axis @ vector / np.linalg.norm(sensor.axis)

        place, velocity = self.point_motion(states, swift.point)
        absolute = velocity + cross(self.velocity, place - self.point)
        place, velocity = self.point_motion(states, shaken.point)
        second = self.point_motion(speeding, shaken.point)[1] + 2 * cross(self.velocity, velocity)
        second = second + cross(self.velocity, cross(self.velocity, place - self.point))
        return np.array([self.measured(states, encoder)[1], along(swift, absolute), along(shaken, second)])

    def response(self, frequency):
        """Frequency response from the force to the sensors, by differences about the equilibrium, and their values."""
        still, step, eye = np.zeros(12), 1e-5, np.eye(12)
        rest = scipy.optimize.root(lambda x: self.accelerations(x, still), still, tol=1e-13).x

        def moved(change):
            motion = (rest + change).reshape(-1, 6)
            for x, before, by in zip(motion, rest.reshape(-1, 6), change.reshape(-1, 6), strict=True):
                x[3:] = (Rotation.from_rotvec(by[3:]) * Rotation.from_rotvec(before[3:])).as_rotvec()
            return motion.ravel()

        def slope(function):
            return np.transpose([(function(step * e) - function(-step * e)) / (2 * step) for e in eye])

        stiffness = slope(lambda x: self.accelerations(moved(x), still))
        damping = slope(lambda v: self.accelerations(rest, v))
        given = self.accelerations(rest, still, 1.0) - self.accelerations(rest, still)
        parts = (lambda x: (moved(x), still, still)), (lambda v: (rest, v, still)), (lambda a: (rest, still, a))
        read = [slope(lambda x, part=part: self.readings(*part(x))) for part in parts]
        responses = [
            (read[0] + s * read[1] + s**2 * read[2]) @ np.linalg.solve(s**2 * eye - s * damping - stiffness, given)
            for s in 2j * np.pi * frequency
        ]
        return np.transpose(responses), self.readings(rest, still, still)


@pytest.mark.parametrize(("speed", "load"), [(0.0, 1.6), (12.0, 3.0)])
def test_a_machine_of_rigid_bodies_about_its_equilibrium(speed, load):
    """Response and reading are exact, at rest and in a spin about an odd axis beside the machine, or by a drive."""
    rng = np.random.default_rng(11)
    scene = rigid_scene(rng, load)
    velocity, point = np.sqrt(load) * speed * np.array([0.36, -0.48, 0.8]), np.array([0.05, -0.02, 0.1])
    if speed:
        scene = replace(scene, gravity=load * 9.81 * np.array([0.36, -0.48, 0.8]))
    expected, readings = NewtonEuler(scene, velocity, point).response(FREQUENCY)
    whole, size = replace(scene, sensors=scene.sensors[:1]), np.abs(expected).max(axis=1)
    as_drawn = frequency_response(linearize(whole, loaded=False), FREQUENCY).values[0, 0]
    assert np.abs(as_drawn - expected[0]).max() > 1e-4 * size[0]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="under its loads|under the spin|under weight and spin")
        found = [loaded_assembly(whole, angular_velocity=velocity, axis_point=point)]
        if speed:
            found.append(assemble_spin(on_a_spindle(scene, velocity, point)))
    for assembly in found:
        responses = frequency_response(linear_model(assembly), FREQUENCY).values[:, 0]
        n = len(responses)
        assert np.all(np.abs(responses - expected[:n]).max(axis=1) < 1e-7 * size[:n])
        steady = list(steady_outputs(assembly).values())
        np.testing.assert_allclose(steady, readings[: len(steady)], rtol=1e-9)


@pytest.mark.parametrize("free", [("rz",), ("rx", "ry", "rz")])
def test_a_shaft_that_may_tilt_where_a_drive_turns_it_is_described_as_drawn(free):
    """The driven angle is then another at every angle, to second order, even where a second bearing holds the tilt."""
    velocity, point = np.array([0.9, -1.2, 2.0]), np.array([0.05, -0.02, 0.1])
    scene = on_a_spindle(rigid_scene(np.random.default_rng(11), 0.05), velocity, point)
    bodies = [replace(b, points={**b.points, "far": point + 0.1 * velocity}) for b in scene.bodies[:2]]
    spindle = replace(scene.joints[0], free=free)
    bearing = replace(spindle, name="bearing", a="floor.far", b="ground.far", free=("z", "rx", "ry", "rz"))
    scene = replace(scene, bodies=(*bodies, *scene.bodies[2:]), joints=(spindle, bearing))
    found = loaded_assembly(scene).coordinates
    assert isinstance(found, MovedCoordinates) == (free == ("rz",))


@pytest.mark.parametrize("redundant", [False, True])
@pytest.mark.parametrize("stiffness", [40.0, 7.0])
def test_a_hinged_arm_on_a_torsion_spring(stiffness, redundant):
    """It rests where k angle = m g l cos(angle) and swings at w^2 = (k + m g l sin(angle)) / (J + m l^2)."""
    mass, inertia, length, gravity = 1.3, 0.004, 0.12, 9.81
    ground = RigidBody("ground", {"p": (0, 0, 0), "q": (0, 0.05, 0)}, fixed=True)
    points = {"p": (-length, 0, 0), "q": (-length, 0.05, 0)}
    arm = RigidBody("arm", points, mass, np.diag([0.003, inertia, 0.005]), (length, 0, 0))
    hinges = [revolute(name, f"ground.{name}", f"arm.{name}", "y") for name in ("p", "q")[: 1 + redundant]]
    spring = Bushing("spring", "ground.p", "arm.p", (0, 0, 0, 0, stiffness, 0))
    scene = Scene("arm", [ground, arm], hinges, springs=[spring], gravity=(0, 0, -gravity), damping_ratio=0.0)
    moment = mass * gravity * length
    angle = scipy.optimize.brentq(lambda angle: stiffness * angle - moment * np.cos(angle), 0, 1.5)
    expected = np.sqrt((stiffness + moment * np.sin(angle)) / (inertia + mass * length**2))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="under its loads")
        assert np.abs(linearize(scene).poles()).max() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("share", "beside"), [(0.9, 3e-3), (0.98, 5e-4), (0.98, 3e-3)])
def test_a_mass_above_a_hinge_near_its_critical_weight(share, beside):
    """It rests where k angle = m g (e cos + l sin)(angle), up to fifty times as far as the arm e alone lets it.

    Its frequency, its reading and what the hinge and the spring bear are those of that angle.
    """
    mass, inertia, length, gravity = 1.3, 0.004, 0.12, 9.81
    arm = np.array([beside * length, 0, length])
    stiffness = mass * gravity * length / share
    bodies = (
        RigidBody("ground", {"p": (0, 0, 0)}, fixed=True),
        RigidBody("top", {"p": -arm}, mass, np.diag([0.003, inertia, 0.005]), arm),
    )
    joint, spring = (
        revolute("hinge", "ground.p", "top.p", "y"),
        Bushing("spring", "ground.p", "top.p", (0, 0, 0, 0, stiffness, 0)),
    )
    read = AngleSensor("angle", "ground.p", "top.p", "y")
    scene = Scene("s", bodies, [joint], (), [read], [spring], gravity=(0, 0, -gravity), damping_ratio=0.0)

    def moment(angle):
        return mass * gravity * (arm[0] * np.cos(angle) + arm[2] * np.sin(angle))

    angle = scipy.optimize.brentq(lambda angle: stiffness * angle - moment(angle), 0, 3)
    slope = mass * gravity * (arm[2] * np.cos(angle) - arm[0] * np.sin(angle))
    expected = np.sqrt((stiffness - slope) / (inertia + mass * arm @ arm))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="under its loads")
        assert np.abs(linearize(scene).poles()).max() == pytest.approx(expected, rel=1e-7)
        assert static_response(scene)["angle"] == pytest.approx(angle, rel=1e-7)
        found = loaded_equilibrium(scene)
    assert found.motions["top.p"][4] == pytest.approx(angle, rel=1e-7)
    assert found.spring_forces["spring"]["ry"] == pytest.approx(moment(angle), rel=1e-7)
    borne = np.linalg.norm([found.joint_forces["hinge"][axis] for axis in "xyz"])
    assert borne == pytest.approx(mass * gravity, rel=1e-7)
