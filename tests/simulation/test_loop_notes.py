"""What a run tells of its loops: how long they were at a limit, since when, and what their resolution means."""

import math
import re
import warnings

import numpy as np
import pytest

from nassim import Encoder, Loop, PointForce, RigidBody, Scene, Simulation, TimeHistory, load, prismatic, save, simulate
from nassim.simulation.model.digital_controllers import converter
from nassim.systems import pid

RATE, STEP, LIMIT = 1e3, 5e-4, 20.0


def stage(**loop):
    """A cart on a slide with a servo of 20 N."""
    ground = RigidBody("ground", {"o": [0, 0, 0]}, fixed=True)
    cart = RigidBody("cart", {"o": [0, 0, 0]}, 2.0, 0.01 * np.eye(3))
    servo = pid(1.2e4, 1e5, 220.0, sample_rate=RATE, derivative_bandwidth=200.0, limit=LIMIT)
    options = {"reference": "set"} | loop
    return Scene(
        "stage",
        (ground, cart),
        (prismatic("slide", "ground.o", "cart.o", "x"),),
        (PointForce("motor", "cart.o", "x", "force"),),
        (Encoder("x", "ground.o", "cart.o", "x"),),
        loops=(Loop("servo", servo, "x", "force", **options),),
    )


def excitation(stroke):
    time = 3.0 + np.arange(601) * STEP
    return TimeHistory(time, [stroke * (time > 3.0205), 0 * time], ("set", "force"), ("m", "N"))


def run(scene, stroke, method="exact"):
    return simulate(scene, excitation(stroke), time_step=STEP, method=method, progress=False)


def follow(stepped, wanted):
    """Step a run along set points."""
    with stepped:
        for value in wanted[1:]:
            stepped.step({"set": value})


def told(note):
    """Duration, share and first time of a note on a limit."""
    found = re.fullmatch(r".* limit of .* for (\S+) s in all, (\S+) % of the run, first at t = (\S+) s", note)
    return tuple(map(float, found.groups()))


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_a_run_tells_how_long_a_loop_was_at_its_limit(method, tmp_path):
    record = run(stage(), 3e-3, method)
    reached = np.abs(record["servo"]) == LIMIT
    assert 3 < np.count_nonzero(reached) < 0.1 * len(reached)
    (note,) = record.notes
    assert note.startswith("loop 'servo': 'servo' was at its limit of 20 N for ")
    duration, share, first = told(note)
    assert duration == pytest.approx(STEP * np.count_nonzero(reached))
    assert share == pytest.approx(100 * np.mean(reached), rel=0.05)
    assert first == pytest.approx(record.time[np.argmax(reached)], abs=1e-9)
    assert record.select(["x"]).after(0.1).notes == load(save(record, tmp_path / "record.h5")).notes == record.notes
    assert run(stage(), 1e-5, method).notes == ()


def test_a_run_that_is_long_at_a_limit_warns():
    with pytest.warns(UserWarning, match="'servo' was at its limit of 20 N .* the loop was open then"):
        far = run(stage(), 0.2)
    assert told(far.notes[0])[1] > 10
    given = excitation(0.2)
    stepped = Simulation(stage(), time_step=STEP, method="exact", inputs={"set": 0.0})
    with pytest.warns(UserWarning, match="the loop was open then"):
        follow(stepped, given["set"])
    assert told(stepped.record.notes[0])[:2] == told(far.notes[0])[:2]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(stage(), 3e-3)


@pytest.mark.filterwarnings("ignore:loop .servo.. .x. was at its limit")
def test_measured_values_beyond_their_range_count_at_the_samples():
    scene = stage(input_limit=1.005e-3, input_step=1e-4)
    record = run(scene, 1.2e-3)
    seen = np.abs(record["x"][::2]) >= 1e-3 * (1 - 1e-9)  # ten steps
    assert 0 < np.mean(seen) < 0.9
    note = next(note for note in record.notes if "'x' was at its limit of 0.001005 m" in note)
    assert told(note)[1] == pytest.approx(100 * np.mean(seen), rel=0.05)
    assert told(note)[2] == record.time[2 * np.argmax(seen)]


def test_notes_tell_the_rms_error_of_a_resolution():
    """The error of a rounded signal that moves over many steps, from the record itself, is the one of the note."""
    step = 2e-6
    record = run(stage(input_step=step, output_step=0.5), 1e-3)
    reading = [note for note in record.notes if "reads" in note]
    driving = [note for note in record.notes if "gives" in note]
    assert reading == ["loop 'servo' reads 'x' in steps of 2e-06 m, of an expected error of 5.77e-07 m rms"]
    assert driving == ["loop 'servo' gives 'servo' in steps of 0.5 N, of an expected error of 0.144 N rms"]
    moving = record["x"][45:100]
    error = [converter(step, math.inf)(value) - value for value in moving]
    assert np.sqrt(np.mean(np.square(error))) == pytest.approx(5.77e-7, rel=0.25)
    (still,) = run(stage(input_step=1e-3), 0.0).notes
    assert still.endswith("; it moved by 0 steps only, so its error is no noise")
