import time
from dataclasses import replace

import numpy as np
import pytest
import tiny_functions

from nassim import FRF, TimeHistory
from nassim.studies.outcome import Task
from nassim.studies.results import Axis, Layout, Quantity, flatten_result


def read(result, taken=()):
    layout, data = flatten_result(result, taken)
    return layout, layout.arrays(data)


def test_all_kinds_come_back_bit_for_bit():
    given = tiny_functions.everything(3.0)
    layout, found = read(given)
    assert found["root"].shape == ()
    assert found["root"] == given["root"]
    for name, values in {
        "powers": given["powers"],
        "frf": given["frf"].values,
        "history": given["history"].values,
    }.items():
        np.testing.assert_array_equal(found[name], values)
    np.testing.assert_array_equal(found["frf_coherence"], given["frf"].coherence)
    assert layout.quantities["frf"].dims == ("output", "input", "frequency")
    assert layout.quantities["powers"].dims == ("powers_0", "powers_1")
    assert (layout.axes["frequency"].values, layout.axes["frequency"].unit) == ((1.0, 2.0, 5.0), "Hz")
    assert layout.axes["signal_unit"].along == "signal"
    assert layout.axes["signal_unit"].values == ("V", "m")


def frf(frequency, values=(1.0, 2.0)):
    return FRF(frequency, np.array([[values]], complex), ("y",), ("u",))


def test_axes_are_shared_where_they_are_the_same():
    layout, _ = read({"one": frf([1.0, 2.0]), "two": frf([1.0, 2.0], (3.0, 4.0)), "three": frf([1.0, 3.0])})
    assert [q.dims[2] for q in layout.quantities.values()] == ["frequency", "frequency", "three_frequency"]
    assert layout.axes["three_frequency"].along == "three_frequency"
    layout, _ = read(frf([1.0, 2.0]), taken=("frequency",))
    assert layout.quantities["frf"].dims == ("frf_output", "frf_input", "frf_frequency")


def test_truth_values_are_results():
    layout, values = read({"stable": True, "held": np.array([True, False])})
    assert layout.quantities["held"].dims == ("held_0",)
    np.testing.assert_array_equal(values["stable"], True)
    np.testing.assert_array_equal(values["held"], [True, False])


def test_layouts_are_told_apart_by_shape_kind_and_axes():
    results = [1.0, 1j, [1.0], [1.0, 2.0], {"x": 1.0}, frf([1.0, 2.0]), frf([1.0, 3.0])]
    assert len({flatten_result(result, ())[0].digest() for result in results}) == len(results)
    assert flatten_result(1, ())[0].digest() == flatten_result(np.float32(2.0), ())[0].digest()
    assert (
        flatten_result(frf([1.0, 2.0]), ())[0].digest() == flatten_result(frf([1.0, 2.0], (5.0, 6.0)), ())[0].digest()
    )


@pytest.mark.parametrize(
    ("result", "error", "message"),
    [
        ("text", TypeError, "'result' is a str; a function of a study returns"),
        ({"x": None}, TypeError, "'x' is a NoneType"),
        ({}, ValueError, "no result"),
        ({"mass": 1.0}, ValueError, "may not be called 'mass'"),
        ({"status": 1.0}, ValueError, "may not be called 'status'"),
        ({3: 1.0}, ValueError, "may not be called 3"),
    ],
)
def test_other_results_are_refused(result, error, message):
    with pytest.raises(error, match=message):
        flatten_result(result, ("mass",))


COHERENT = FRF([1.0, 2.0], np.ones((1, 1, 2), complex), ("y",), ("u",), np.full((1, 2), 0.5))


@pytest.mark.parametrize(
    ("result", "taken", "twice"),
    [
        ({"x": [1.0, 2.0], "x_0": 3.0}, (), "x_0"),
        ({"x": [1.0, 2.0]}, ("x_0",), "x_0"),
        ({"frf": COHERENT, "frf_coherence": 3.0}, (), "frf_coherence"),
        ({"frf_coherence": 3.0, "frf": COHERENT}, (), "frf_coherence"),
        (COHERENT, ("frf_coherence",), "frf_coherence"),
        (COHERENT, ("frequency", "frf_frequency"), "frf_frequency"),
    ],
)
def test_one_name_for_two_things_is_refused(result, taken, twice):
    with pytest.raises(ValueError, match=f"two are called '{twice}': rename one"):
        flatten_result(result, taken)


def test_a_result_called_as_an_axis_keeps_its_name():
    record = TimeHistory([0.0, 0.1], [[1.0, 2.0], [3.0, 4.0]], ("u", "y"), ("V", "m"))
    layout, found = read({"time": 5.0, "record": record})
    assert found["time"] == 5.0
    assert layout.quantities["record"].dims == ("record_signal", "record_time")
    assert layout.axes["record_signal_unit"].along == "record_signal"
    assert layout.axes["record_time"].unit == "s"


def test_a_run_that_raises_is_an_outcome():
    start = time.perf_counter()
    outcome = Task(tiny_functions.troublesome, ())({"n": 3})
    assert 0 < outcome.wall_time < time.perf_counter() - start
    assert (outcome.status, outcome.message) == ("failed", "RuntimeError: run 3 does not converge")
    assert "in troublesome" in outcome.details
    outcome = Task(lambda: "text", ())({})
    assert outcome.status == "failed"
    assert "is a str" in outcome.message
    assert Task(lambda: {"a": 1.0, "b": [1.0, np.nan]}, ())({}).message == "there is NaN in b"


def test_leaving_python_is_a_failed_run_and_ctrl_c_is_not():
    def leave(error):
        raise error

    assert Task(leave, ())({"error": SystemExit(3)}).status == "failed"
    with pytest.raises(KeyboardInterrupt):
        Task(leave, ())({"error": KeyboardInterrupt()})


def test_layouts_differ_by_everything_that_describes_them():
    """Runs of different layouts do not share one array."""
    quantity, axis = Quantity(("x",), (2,)), Axis("x", (1.0, 2.0), "m")
    given = Layout({"f": quantity}, {"x": axis})
    others = [
        Layout({"g": quantity}, {"x": axis}),
        Layout({"f": replace(quantity, complex=True)}, {"x": axis}),
        Layout({"f": replace(quantity, shape=(2, 1))}, {"x": axis}),
        Layout({"f": quantity}, {"y": axis}),
        *(
            Layout({"f": quantity}, {"x": replace(axis, **change)})
            for change in ({"unit": "mm"}, {"values": (1.0, 3.0)}, {"along": "z"})
        ),
    ]
    assert len({layout.digest() for layout in (given, *others)}) == 1 + len(others)
    assert Layout({"f": quantity}, {"x": axis}).digest() == given.digest()
