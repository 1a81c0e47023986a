"""The linear model of a scene at speed against its own runs: two forces that turn along, two readings on the table.

Steps h answer as if each frequency were 2 / h tan(omega h / 2). Up to a third of the rate of the samples that are
looked at, ten steps from one to the next keep within 0.07 dB beside resonances; among them it takes thirty, and a
single one would be wrong by a third.
"""

import numpy as np
import pytest
from conftest import lattice
from test_spinning_start import AXIS, INERTIA, turntable

from nassim import (
    Encoder,
    FlexibleBody,
    Joint,
    PointForce,
    RigidBody,
    Scene,
    SpringDamper,
    TimeHistory,
    craig_bampton,
    frequency_response,
    linearize,
    prismatic,
    simulate,
)

ACROSS = np.array([2.0, 2.0, -1.0]) / 3
OTHER = np.cross(AXIS, ACROSS)
DECIBEL, DEGREE = 0.1, 1.0


def rigid(speed):
    """A mass on two slides, with springs and dampers of unequal figures, beside the axis: 10 and 12 Hz at rest."""
    place = np.array([0.13, 0.23, 0.285])
    bodies, spindle, drive = turntable(speed, rail=place)
    slide = RigidBody("slide", {"c": (0, 0, 0)}, 0.2, 0.1 * INERTIA, place)
    mass = RigidBody("mass", {"c": (0, 0, 0)}, 1.0, INERTIA, place)
    rails = prismatic("u", "table.rail", "slide.c", ACROSS), prismatic("v", "slide.c", "mass.c", OTHER)
    springs = (
        SpringDamper("ku", "table.rail", "slide.c", tuple(ACROSS), 4700.0, 25.0, frame="table.rail"),
        SpringDamper("kv", "slide.c", "mass.c", tuple(OTHER), 5700.0, 20.0, frame="slide.c"),
    )
    pushes = tuple(PointForce(f"F{n}", "mass.c", d, f"F{n}", frame="mass.c") for n, d in (("u", ACROSS), ("v", OTHER)))
    sensors = tuple(
        Encoder(f"d{n}", "table.rail", "mass.c", tuple(d), frame="table.rail") for n, d in (("u", ACROSS), ("v", OTHER))
    )
    return Scene("platform", (*bodies, slide, mass), (spindle, *rails), (drive, *pushes), sensors, springs,
                 damping_ratio=0.0)  # fmt: skip


def flexible(speed):
    """A load on a reduced lattice, clamped askew beside the axis; pushed and read across it and along."""
    reduced = craig_bampton(lattice(stiffness=2e5), n_modes=4, progress=False)
    foot = np.array([0.15, 0.22, 0.27])
    bar = FlexibleBody("bar", reduced, foot - reduced.point("left").position, fidelity="ffrf")
    load = RigidBody("load", {"p": (0, 0, 0)}, 0.2, 5e-3 * INERTIA, bar.point_position("right"))
    bodies, spindle, drive = turntable(speed, foot=foot)
    joints = spindle, Joint("foot", "table.foot", "bar.left"), Joint("tip", "bar.right", "load.p")
    directions = ("u", np.array([0.6, 0.0, 0.8])), ("v", np.array([0.0, 0.8, 0.6]))
    pushes = tuple(PointForce(f"F{n}", "load.p", d, f"F{n}", frame="load.p") for n, d in directions)
    sensors = tuple(Encoder(f"d{n}", "table.foot", "load.p", tuple(d), frame="table.foot") for n, d in directions)
    return Scene("blade", (*bodies, bar, load), joints, (drive, *pushes), sensors, damping_ratio=0.06)


def response(scene, force, sample_rate, fine, period, settles):
    """FRFs (2, lines) per input and their frequencies [Hz], from a run whose inputs have every other line each.

    fine: steps of the integrator to a sample
    """
    step = 1 / (fine * sample_rate)
    per_period, before = round(period / step), round(settles / step)
    time = np.arange(before + per_period) * step
    lines = np.arange(1, int(sample_rate / 3 * period) + 1)
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, len(lines))
    waves = force * np.cos(2 * np.pi * lines[:, None] / period * time + phases[:, None])
    inputs = np.array([waves[k::2].sum(axis=0) for k in (0, 1)])
    record = simulate(scene, TimeHistory(time, inputs, ("Fu", "Fv"), ("N", "N")), time_step=step, progress=False)
    last = np.fft.rfft(record.values[:, -per_period::fine])
    found = [last[2:, lines[k::2]] / last[k, lines[k::2]] for k in (0, 1)]
    return [lines[k::2] / period for k in (0, 1)], found


@pytest.mark.parametrize(
    ("make", "figures", "crosses"),
    [
        (rigid, (1.0, 76.0, 10, 0.25, 0.8), 0.3),
        pytest.param(flexible, (0.2, 900.0, 30, 0.1, 0.15), 0.02, marks=pytest.mark.slow),
    ],
    ids=["rigid", "ffrf"],
)
def test_a_spinning_scene_answers_as_its_linear_model(make, figures, crosses):
    """Within 0.1 dB and 1 degree up to a third of the sample rate, Coriolis' cross terms too."""
    scene, at_rest = make(25.0), make(0.1)
    frequencies, found = response(scene, *figures)
    for k, (frequency, columns) in enumerate(zip(frequencies, found, strict=True)):
        model, still = (frequency_response(linearize(s), frequency).values[:, k] for s in (scene, at_rest))
        ratio = columns / model
        assert np.abs(20 * np.log10(np.abs(ratio))).max() < DECIBEL
        assert np.abs(np.degrees(np.angle(ratio))).max() < DEGREE
        assert np.abs(model[1 - k] - still[1 - k]).max() > crosses * np.abs(model[k]).max()
