"""Checks of input say the figure with its unit."""

import numpy as np
import pytest

from nassim.base.checks import (
    above_zero,
    finite,
    freeze,
    instances,
    known,
    not_negative,
    positive,
    unique,
    whole_number,
)
from nassim.base.field_types import ClassArray
from nassim.base.progress import tell


@pytest.mark.parametrize(
    ("check", "value", "message"),
    [
        (positive, -2.0, r"length must be positive, got -2 mm$"),
        (positive, 0.0, r"length must be positive, got 0 mm$"),
        (not_negative, -1e-9, r"length must not be negative, got -1e-09 mm$"),
        (above_zero, 0, r"length must be positive, got 0 mm; inf for none$"),
    ],
)
def test_messages_have_the_unit(check, value, message):
    with pytest.raises(ValueError, match=message):
        check("length", value, "mm")
    bare = message.replace(" mm", "")
    with pytest.raises(ValueError, match=bare):
        check("length", value)


@pytest.mark.parametrize("value", [0, 7, 2.5, "3", True, None, np.nan, np.inf])
def test_what_is_no_whole_number_is_refused(value):
    with pytest.raises(ValueError, match=r"n must be a whole number from 1 to 6, got "):
        whole_number("n", value, 1, 6)


def test_whole_numbers_are_integers():
    assert [whole_number("n", value, 1) for value in (1, 2.0, np.int64(3), np.float32(4), np.array(5), 2**60 + 1)] == [
        1, 2, 3, 4, 5, 2**60 + 1
    ]  # fmt: skip
    assert type(whole_number("n", np.float64(-2.0))) is int
    with pytest.raises(ValueError, match=r"n must be a whole number, got 0\.5$"):
        whole_number("n", 0.5)
    with pytest.raises(ValueError, match=r"n must be a whole number of at least 1, got -inf$"):
        whole_number("n", -np.inf, 1)


@pytest.mark.parametrize("check", [finite, positive, not_negative, above_zero])
def test_numbers_of_any_kind_become_those_of_python(check):
    """Single precision would spread in all that is computed of it."""
    for value in (3, np.float32(3.0), np.int32(3), np.array(3)):
        assert type(check("length", value)) is float


def test_names_that_occur_twice_are_named():
    with pytest.raises(ValueError, match=r"body names must differ; used more than once: a, c$"):
        unique("body", ["c", "a", "b", "a", "c"])


def test_names_of_an_array_are_texts_of_python():
    """NumPy prints its own as np.str_('a')."""
    names = unique("body", np.array(["a", "b"]))
    assert [type(name) for name in (*names, known("body", names[0], np.array(["a"])))] == [str] * 3
    with pytest.raises(ValueError, match=r"unknown body 'c'; known: a, b$"):
        known("body", np.array(["c"])[0], names)


def test_an_array_that_all_bodies_share_cannot_be_changed():
    class Own:
        position = ClassArray(np.zeros(3))

    with pytest.raises(ValueError, match="read-only"):
        Own().position[0] = 1.0


def test_any_series_becomes_a_tuple():
    """A generator too, which can be read only once."""
    assert instances("numbers", (k for k in (1, 2)), (int,)) == (1, 2)
    assert instances("numbers", [1, 2], (int,)) == (1, 2)


def test_the_nearest_of_many_names_is_told_first():
    with pytest.raises(ValueError, match=r"unknown input 'forse_7'; did you mean 'force_7'\? known: force_0, force_1,"):
        known("input", "forse_7", [f"force_{k}" for k in range(12)])
    with pytest.raises(ValueError, match=r"unknown input 'forse'; known: force$"):
        known("input", "forse", ["force"])


def test_notes_are_indented_as_asked(capsys):
    tell("first")
    tell("second", indent="")
    first, second = capsys.readouterr().out.splitlines()
    assert first.lstrip() == "first" != first
    assert second == "second"


def test_what_a_data_class_freezes_cannot_change_in_place_nor_with_what_was_given():
    class Noun:
        """Whatever has fields."""

    array, names, inner = np.zeros(2), ["a"], {"b": 1.0}
    noun = Noun()
    freeze(noun, array=array, names=names, mapping={"inner": inner, "array": array}, parts=[array, [array]], text="c")
    array[0], inner["b"] = 1.0, 2.0
    names.append("d")
    assert (noun.names, noun.mapping["inner"]["b"], noun.text) == (("a",), 1.0, "c")
    for values in (noun.array, noun.mapping["array"], noun.parts[0], noun.parts[1][0]):
        assert not values.any()
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    for mapping in (noun.mapping, noun.mapping["inner"]):
        with pytest.raises(TypeError, match="does not support item assignment"):
            mapping["b"] = 3.0
