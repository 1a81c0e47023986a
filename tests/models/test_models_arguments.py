"""What optional arguments of scenes of real devices do, read from the parts of the scenes."""

import functools
from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from conftest import lattice

from models.bench import make_passive_bench
from models.nano_hexapod import PLATE_HEIGHT, PLATE_RADIUS, TOP_MASS, make_nano_hexapod, rigid_plate
from models.nass import END_STATION, alike_across, make_nass
from models.nass_loops import force_loop
from models.rotating_platform import make_rotating_platform
from models.strut import JOINT_STIFFNESS, LENGTH, imported_strut, spring_strut, two_mass_strut, with_own_damping
from models.two_mass import APA300ML
from nassim import craig_bampton
from nassim.scene import Actuator, Sensor
from nassim.systems import controller_response

STRUT = spring_strut(1e6)


@functools.cache
def body():
    return craig_bampton(lattice(), n_modes=1, progress=False)


CALLS = {
    "spring_strut": partial(spring_strut, 1e6),
    "two_mass_strut": two_mass_strut,
    "imported_strut": lambda **options: imported_strut(body(), **options),
    "with_own_damping": partial(with_own_damping, two_mass_strut()),
    "rigid_plate": rigid_plate,
    "make_nano_hexapod": partial(make_nano_hexapod, STRUT),
    "make_passive_bench": lambda **options: make_passive_bench(body(), **options),
    "make_rotating_platform": partial(make_rotating_platform, 0.1),
    "make_nass": partial(make_nass, STRUT),
    "force_loop": partial(force_loop, 100.0, sample_rate=1e4),
}


def of(name, attribute):
    """An attribute of the scene's part with a name."""

    def read(scene):
        parts = (*scene.bodies, *scene.springs, *scene.actuators, *scene.sensors)
        return next(getattr(part, attribute) for part in parts if part.name == name)

    return read


def at(path):
    return lambda scene: scene.point_position(path)[2]


def own(attribute):
    return lambda result: getattr(result, attribute)


def own_ratio(scene):
    return scene.damping_ratio[0]


def springs(scene):
    return [spring.name for spring in scene.springs]


def total_mass(scene):
    return sum(body.mass for body in scene.bodies)


def disc(radius, height):
    return TOP_MASS * np.diag([(3 * radius**2 + height**2) / 12] * 2 + [radius**2 / 2])


def at_10_hz(loop):
    return np.abs(controller_response(loop.controller, np.array([10.0])).values[0, 0, 0])


def integrator(leak):
    """Gain over the distance of 10 Hz from a pole; the difference to the sampled one is below a thousandth."""
    return 100.0 / (2 * np.pi * np.hypot(10.0, leak))


SOFTER, WEIGHT = np.array(JOINT_STIFFNESS) / 2, np.array([0.0, 0.0, -9.81])
SHELL = APA300ML.shell * 0.01 / (np.pi * 100.0)
TILT = END_STATION["tilt"]
ARGUMENTS = [
    ("spring_strut", "damping", 7.0, of("spring", "damping"), 0.0, 7.0),
    ("spring_strut", "parallel_stiffness", 3e5, springs, ["spring"], ["spring", "beside"]),
    ("spring_strut", "mass", 0.6, total_mass, 2e-9, 0.6 + 2e-9),
    ("spring_strut", "length", 0.1, at("top.end"), LENGTH, 0.1),
    ("two_mass_strut", "length", 0.1, at("top.end"), LENGTH, 0.1),
    ("two_mass_strut", "length", 0.1, at("middle.slide"), LENGTH / 2, 0.05),
    (
        "two_mass_strut",
        "joint_stiffness",
        SOFTER,
        of("top_joint", "stiffness"),
        np.diag(JOINT_STIFFNESS),
        np.diag(SOFTER),
    ),
    ("two_mass_strut", "damping_ratio", 0.02, own_ratio, 0.01, 0.02),
    ("imported_strut", "fidelity", "ffrf", of("apa", "fidelity"), "linear", "ffrf"),
    ("imported_strut", "damping_ratio", 0.02, own_ratio, 0.01, 0.02),
    ("imported_strut", "joint_stiffness", JOINT_STIFFNESS, springs, [], ["bottom_joint", "top_joint"]),
    ("with_own_damping", "ratio", 0.03, of("shell", "damping"), SHELL, 3 * SHELL),
    ("with_own_damping", "frequency", 50.0, of("shell", "damping"), SHELL, 2 * SHELL),
    ("rigid_plate", "mass", 1.0, own("mass"), TOP_MASS, 1.0),
    ("rigid_plate", "radius", 0.1, own("inertia"), disc(PLATE_RADIUS, PLATE_HEIGHT), disc(0.1, PLATE_HEIGHT)),
    ("rigid_plate", "height", 0.02, own("inertia"), disc(PLATE_RADIUS, PLATE_HEIGHT), disc(PLATE_RADIUS, 0.02)),
    ("make_nano_hexapod", "payload_mass", 3.0, of("payload", "mass"), 1.0, 3.0),
    ("make_nano_hexapod", "gravity", True, own("gravity"), 0 * WEIGHT, WEIGHT),
    ("make_nano_hexapod", "damping_ratio", 0.02, own_ratio, 0.0, 0.02),
    ("make_nano_hexapod", "cutoff_frequency", 500.0, own("cutoff_frequency"), None, 500.0),
    ("make_nano_hexapod", "spindle_rpm", 30.0, of("base", "fixed"), True, False),
    ("make_passive_bench", "payload_mass", 3.0, of("payload", "mass"), 1.0, 3.0),
    ("make_passive_bench", "fidelity", "linear", of("body", "fidelity"), "ffrf", "linear"),
    ("make_rotating_platform", "mass", 3.0, of("mass", "mass"), 1.0, 3.0),
    ("make_rotating_platform", "stiffness", 3.0, of("v/spring", "stiffness"), 1.0, 3.0),
    ("make_rotating_platform", "damping", 0.1, of("u/spring", "damping"), 0.05, 0.1),
    ("make_nass", "stages", alike_across(), of("tilt", "inertia"), TILT.inertia, TILT.alike().inertia),
    ("make_nass", "payload_mass", 3.0, of("payload", "mass"), 10.0, 3.0),
    ("force_loop", "leak", 10.0, at_10_hz, integrator(1.0), integrator(10.0)),
    ("force_loop", "delay", 3, lambda loop: loop.controller.delay, 1, 3),
]


@pytest.mark.parametrize(("verb", "name", "other", "read", "before", "after"), ARGUMENTS)
def test_an_optional_argument_does_what_it_should(verb, name, other, read, before, after):
    for options, expected in (({}, before), ({name: other}, after)):
        found = read(CALLS[verb](**options))
        if isinstance(expected, float | np.ndarray):
            np.testing.assert_allclose(np.broadcast_to(found, np.shape(expected)), expected, rtol=2e-3, atol=1e-12)
        else:
            assert found == expected


def test_spindles_turn_as_often_as_told():
    for make in (make_nano_hexapod, make_nass):
        (drive,) = (part for part in make(STRUT, spindle_rpm=30.0).actuators if part.name == "spindle")
        assert drive.speed == pytest.approx(np.pi)


def test_what_an_identification_corrects_is_the_gain_of_a_part():
    """Of all sensors and actuators, those of the models too."""

    def kinds(kind):
        return {kind}.union(*map(kinds, kind.__subclasses__()))

    for kind in kinds(Sensor) | kinds(Actuator):
        if kind.__module__.partition(".")[0] in ("nassim", "models"):
            gains = {f.name for f in fields(kind)} & {"gain", "voltage_per_elongation"}
            assert {kind.factor} - {None} == gains, kind.__name__


def test_the_first_of_two_points_is_the_bottom():
    (low, high), strut = body().point_names, imported_strut(body())
    length = np.linalg.norm(np.diff(body().positions, axis=0))
    np.testing.assert_allclose([at(f"apa.{low}")(strut), at(f"apa.{high}")(strut)], [0.0, length], atol=1e-12)
