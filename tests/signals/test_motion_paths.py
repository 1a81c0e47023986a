"""Paths of drives against closed forms, and their limits."""

from functools import partial

import numpy as np
import pytest
import scipy

from nassim import TimeHistory
from nassim.signals import DriveLimits, back_and_forth, check_path, settling_time, shortest_step, smooth_step, turned

TIME = np.linspace(0, 4, 40001)
STEP = TIME[1]


def rates(path):
    speed = np.gradient(path, STEP)
    return np.abs(speed).max(), np.abs(np.gradient(speed, STEP)).max()


def test_a_smooth_step_as_short_as_its_drive_allows():
    """Where the speed limits it and where the acceleration does."""
    for limits, reached in ((DriveLimits(1.0, 0.5, 30.0), 0), (DriveLimits(1.0, 20.0, 0.7), 1)):
        path = 0.4 * smooth_step(TIME, 0.3, shortest_step(-0.4, limits))
        assert path[0] == 0
        assert path[-1] == pytest.approx(0.4, rel=1e-12)
        found, allowed = rates(path), (limits.speed, limits.acceleration)
        assert found[reached] == pytest.approx(allowed[reached], rel=1e-3)
        assert found[1 - reached] < allowed[1 - reached]
    assert shortest_step(2.0, limits) == pytest.approx(np.sqrt(5) * shortest_step(0.4, limits))  # between both ends
    for distance, message in ((-2.1, "travels 1 to either side, got a distance of -2.1"), (np.nan, "distance holds 1")):
        with pytest.raises(ValueError, match=message):
            shortest_step(distance, limits)


def test_back_and_forth_between_two_ends_at_constant_speed():
    path = back_and_forth(TIME, amplitude=0.3, speed=0.8, acceleration=6.0)
    assert (path.max(), path.min()) == pytest.approx((0.3, -0.3), abs=1e-6)
    assert rates(path) == pytest.approx((0.8, 6.0), rel=1e-3)
    assert np.mean(np.abs(np.abs(np.gradient(path, STEP)) - 0.8) < 1e-6) > 0.3
    ends = TIME[np.flatnonzero(np.diff(np.sign(np.diff(path)))) + 1]
    assert len(ends) == 4
    assert np.ptp(np.diff(ends)) < 2 * STEP


def test_the_first_two_turns_of_a_path_leave_a_line_between_them():
    """The way to the first end shortens with the amplitude, until the path would turn on its first rise."""

    def straight(amplitude):
        path = back_and_forth(TIME, amplitude=amplitude, speed=0.8, acceleration=6.0)
        return np.sum(np.abs(np.diff(path[: np.argmax(np.diff(path) < 0)]) / STEP - 0.8) < 1e-10) * STEP

    assert straight(0.45) == pytest.approx(straight(0.5) - 0.05 / 0.8, abs=3 * STEP)
    shortest = 0.45 - 0.8 * straight(0.45)
    straight(shortest + 4e-3)
    with pytest.raises(ValueError, match="leaves no line at constant speed"):
        straight(shortest - 4e-3)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (DriveLimits(0.29, 1.0, 7.0), "path 'y': its travel reaches 0.3 m, but its limit is 0.29 m"),
        (DriveLimits(0.31, 0.79, 7.0), "its speed reaches 0.8 m/s, but its limit is 0.79 m/s"),
        (DriveLimits(0.31, 1.0, 5.9), "its acceleration reaches 6 m/s2, but its limit is 5.9 m/s2"),
    ],
)
def test_a_path_that_its_drive_cannot_follow_is_refused(limits, message):
    path = back_and_forth(TIME, amplitude=0.3, speed=0.8, acceleration=6.0)
    record = TimeHistory(TIME, [0 * path, 5 + path], ("x", "y"), ("m", "m"))
    check_path(record, {"y": DriveLimits(0.31, 0.81, 6.1)})
    with pytest.raises(ValueError, match=message):
        check_path(record, {"y": limits})


def test_a_path_in_seconds_since_1970_is_as_steep_as_from_zero():
    """The rounding of its times, 2e-7 s, is no acceleration."""
    path = back_and_forth(TIME, amplitude=0.3, speed=0.8, acceleration=6.0)
    check_path(TimeHistory(1.7e9 + TIME, path, ("y",), ("m",)), {"y": DriveLimits(0.31, 0.81, 6.1)})


def test_a_path_may_reach_its_limits():
    """As the differences of its samples show them, to a part in a thousand."""
    path = back_and_forth(TIME, amplitude=0.3, speed=0.8, acceleration=6.0)
    reached = np.array([np.abs(path - path[0]).max(), *rates(path)])
    record = TimeHistory(TIME, path[None], ("y",), ("m",))
    for share in (1.0, 1 - 0.9e-3):
        check_path(record, {"y": DriveLimits(*(share * reached))})
    with pytest.raises(ValueError, match="its travel reaches"):
        check_path(record, {"y": DriveLimits(*((1 - 1.1e-3) * reached))})


def test_pairs_of_signals_turn_and_others_stay():
    record = TimeHistory([0.0, 1.0], [[1.0, 1.0], [2.0, 0.0], [3.0, 3.0]], ("x", "y", "z"), ("m", "m", "m"))
    found = turned(record, [("x", "y")], [0.0, np.pi / 3])
    np.testing.assert_allclose(found.values[:, 0], record.values[:, 0])
    np.testing.assert_allclose(found.values[:, 1], [0.5, np.sqrt(0.75), 3.0])
    back = turned(found, [("x", "y")], [0.0, -np.pi / 3])
    np.testing.assert_allclose(back.values, record.values, atol=1e-15)
    with pytest.raises(ValueError, match="unknown signal 'w'"):
        turned(record, [("x", "w")], [0.0, 1.0])
    for pairs in ([("x", "x")], [("x", "y"), ("y", "z")]):
        with pytest.raises(ValueError, match="signal names must differ"):
            turned(record, pairs, [0.0, 1.0])
    for pairs in (("x", "y"), [("x", "y", "z")]):
        with pytest.raises(ValueError, match="signals along two axes must be pairs of names"):
            turned(record, pairs, [0.0, 1.0])


def test_back_and_forth_is_the_same_path_at_any_times():
    """Against the area under its speed, at times that are coarse, uneven, and begin late."""
    options = {"amplitude": 0.3, "speed": 0.8, "acceleration": 6.0}
    fine = back_and_forth(TIME, **options)
    for times in (TIME[::4000], TIME[3705:], TIME[[70, 71, 1200, 9000, 9003, 31234]]):
        expected = fine[np.searchsorted(TIME, times)]
        np.testing.assert_allclose(back_and_forth(times, **options), expected, rtol=0, atol=1e-12)
    speed = np.gradient(fine, STEP)
    assert np.abs(np.cumsum((speed[1:] + speed[:-1]) / 2) * STEP - fine[1:]).max() < 1e-7
    assert np.all(back_and_forth([-0.1, 0.0], **options) == 0)


@pytest.mark.parametrize("name", ["travel", "speed", "acceleration", "amplitude", "duration"])
def test_travel_speed_acceleration_and_duration_below_zero_are_refused(name):
    numbers = {"speed": 0.8, "acceleration": 6.0, name: -1.0}
    calls = {
        "duration": [lambda: smooth_step(TIME, 0.3, -1.0)],
        "travel": [lambda: DriveLimits(**{"travel": 1.0, **numbers})],
        "amplitude": [lambda: back_and_forth(TIME, **{"amplitude": 0.3, **numbers})],
    }
    both = [*calls["travel"], *calls["amplitude"]]
    for call in calls.get(name, both):
        with pytest.raises(ValueError, match=f"{name}.* must be"):
            call()


def test_a_signal_settles_when_it_last_comes_within_the_tolerance():
    """An oscillation of 20 Hz that dies out with 0.1 s: its last maximum above 1 % is that at 0.45 s."""

    def left(since):
        return np.exp(-since / 0.1) * np.cos(2 * np.pi * 20 * since)

    time = 5.0 + np.arange(20001) * 1e-4
    way = np.where(time < 5.5, 0.0, 2.0 - 2.0 * left(time - 5.5))
    record = TimeHistory(time, [way, 3 * time + way - 2.0], ("x", "y"), ("m", "m"))
    exact = scipy.optimize.brentq(lambda since: left(since) - 0.01, 0.45, 0.4625)
    settled = partial(settling_time, record, tolerance=0.02)
    assert settled("x", target=2.0, start=5.5) == pytest.approx(exact, abs=1e-4)
    assert settled("x", target=2.0, start=5.0) == pytest.approx(0.5 + exact, abs=1e-4)
    assert settled("y", target=3 * time, start=5.5) == pytest.approx(exact, abs=1e-4)
    assert settled("x", target=2.0, start=6.5) == 0
    assert settling_time(record, "x", target=2.0, tolerance=5.0, start=5.5) == 0
    assert settled("x", target=2.1, start=5.5) == np.inf
    for changed, message in (({"start": 4.9}, r"start must lie in 5 \.\.\. 7 s"), ({"target": time[1:]}, "target")):
        with pytest.raises(ValueError, match=message):
            settled("x", **{"target": 2.0, "start": 5.5} | changed)
