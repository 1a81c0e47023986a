"""Sensors that have no meaning are refused when they are made, or when their scene is."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from nassim import (
    Accelerometer,
    Bushing,
    Encoder,
    ForceSensor,
    Geophone,
    RigidBody,
    Scene,
    SpringDamper,
    Vibrometer,
)
from nassim.scene.measures import Displacement
from nassim.scene.part import ForceElement, Sensor
from nassim.scene.terms import Output, OutputFilter, Spring

UP = Displacement((("body.o", np.array([0, 0, 1.0])),))


@dataclass(frozen=True)
class Says(Sensor, ForceElement):
    """A part that says given words."""

    words: tuple = ()

    def terms(self, scene):
        return self.words


def scene(*sensors, springs=()):
    points = {"o": (0, 0, 0), "away": (0.1, 0, 0)}
    bodies = RigidBody("base", points, fixed=True), RigidBody("body", points, 1.0, 0.01 * np.eye(3))
    return Scene("s", bodies, sensors=sensors, springs=springs)


SPRING = SpringDamper("spring", "base.o", "body.o", "z", 1e3)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (Geophone, {"corner_frequency": 0.0}, "geophone 'p': corner_frequency"),
        (Geophone, {"corner_frequency": -4.5}, "geophone 'p': corner_frequency"),
        (Geophone, {"corner_frequency": np.inf}, "geophone 'p': corner_frequency"),
        (Geophone, {"damping_ratio": 0.0}, "geophone 'p': damping_ratio"),
        (Geophone, {"sensitivity": 0.0}, "a sensitivity of 0 shows nothing"),
        (Geophone, {"sensitivity": np.nan}, "sensitivity"),
        (Accelerometer, {"resonance": 0.0}, "accelerometer 'p': resonance"),
        (Accelerometer, {"resonance": 9.0, "damping_ratio": -0.1}, "accelerometer 'p': damping_ratio"),
        (Accelerometer, {"corner_frequency": -1.0}, "accelerometer 'p': corner_frequency"),
        (Accelerometer, {"sensitivity": 0.0}, "a sensitivity of 0"),
        *((kind, {"axis": (0, 0, 0)}, "must have a length") for kind in (Geophone, Accelerometer, Vibrometer)),
        *((kind, {"axis": "line"}, "unknown axis") for kind in (Geophone, Accelerometer, Vibrometer)),
    ],
)
def test_figures_of_sensors(kind, options, message):
    with pytest.raises(ValueError, match=message):
        kind("p", "body.o", **options)


@pytest.mark.parametrize("kind", [Geophone, Accelerometer, Vibrometer])
def test_points_of_sensors(kind):
    for point, frame, message in (
        ("base.o", "", "belong to fixed bodies"),
        ("body.nowhere", "", "unknown point"),
        ("body.o", "body.nowhere", "unknown point"),
    ):
        with pytest.raises(ValueError, match=message):
            scene(kind("p", point, frame=frame))


def test_springs_of_force_sensors():
    with pytest.raises(ValueError, match=r"unknown spring of force sensor 'p' 'sprnig'.*spring"):
        scene(ForceSensor("p", "sprnig"), springs=(SPRING,))
    for words in ((), (Spring(UP, 1.0), Spring(UP, 2.0)), (Output("r", "m", UP),)):
        with pytest.raises(ValueError, match="has no one force to read"):
            scene(ForceSensor("p", "odd"), springs=(SPRING, Says("odd", words)))


def test_names_that_collide():
    bushing = Bushing("bushing", "base.o", "body.o", np.ones(6))
    assert scene(ForceSensor("p", "bushing"), springs=(bushing,)).outputs[3] == "p.mx"
    for other in (Encoder("p.mx", "base.o", "body.o"), Says("p", (Output("p.mx", "N m", UP),))):
        with pytest.raises(ValueError, match="must differ"):
            scene(ForceSensor("p", "bushing"), other, springs=(bushing,))
    with pytest.raises(ValueError, match=r"must differ; used more than once: same"):
        scene(Says("a", (Output("same", "m", UP),)), Says("b", (Output("same", "m", UP),)))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((Output("r", "m", UP), Output("r", "m/s", UP, derivative=1)), "output 'r' cannot be both m/?s? and m"),
        ((Output("r", "m", UP, inertial=True),), "only accelerations are read against"),
        ((Output("r", "m", UP), OutputFilter("t", "low", 1.0)), "unknown filtered output 't'"),
        ((Output("r", "m", UP), OutputFilter("r", "lwo", 1.0)), "unknown filter of output 'r' 'lwo'"),
        ((Output("r", "m", UP), OutputFilter("r", "band", 1.0)), "a band-pass is of second order"),
        ((Output("r", "m", UP), OutputFilter("r", "low", 0.0)), "filter of output 'r': frequency"),
        ((Output("r", "m", UP), OutputFilter("r", "low", 1.0, 0.0)), "filter of output 'r': damping_ratio"),
        (
            (Output("r", "m", UP), Output("r", "m", UP, derivative=1), OutputFilter("r", "low", 1.0)),
            "outputs of several derivatives and passes a filter",
        ),
    ],
)
def test_words_that_do_not_go_together(words, message):
    with pytest.raises(ValueError, match=message):
        scene(Says("p", words))


@pytest.mark.parametrize("derivative", [-1, 0.5, 3])
def test_an_output_is_a_value_a_rate_or_an_acceleration(derivative):
    with pytest.raises(ValueError, match="output 'r': derivative must be 0, 1 or 2, got "):
        Output("r", "m", UP, derivative=derivative)


def test_two_readings_of_one_part_are_one_output():
    both = Output("r", "m", UP), Output("r", "m", replace(UP, axes_of="body.o"), 2.0)
    assert scene(Says("p", both)).outputs == ("r",)
    assert scene(Says("p", both)).output_units == ("m",)
