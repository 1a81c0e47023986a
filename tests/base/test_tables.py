"""Tables in the terminal: plain where they fit, with headings on several lines and in parts where they do not."""

import math

import pytest

from nassim.base.tables import rounded, text_table, with_deviation

ROWS = [
    ["mode", "frequency [Hz]", "damping ratio", "gain of the sensor"],
    ["first, axial", "94.9", "0.01", "2.19e-05"],
    ["2", "876.0", "-", "1"],
]


def test_a_table_that_fits():
    assert text_table(ROWS).splitlines() == [
        "mode          frequency [Hz]  damping ratio  gain of the sensor",
        "first, axial            94.9           0.01            2.19e-05",
        "2                      876.0              -                   1",
    ]


def test_a_table_as_wide_as_the_lines_fits():
    width = max(map(len, text_table(ROWS).splitlines()))
    assert text_table(ROWS, width=width) == text_table(ROWS)
    assert text_table(ROWS, width=width - 1) != text_table(ROWS)


def test_headings_take_no_more_lines_than_they_must():
    assert text_table(ROWS, width=48).splitlines() == [
        "              frequency  damping     gain of",
        "mode               [Hz]    ratio  the sensor",
        "first, axial       94.9     0.01    2.19e-05",
        "2                 876.0        -           1",
    ]
    assert text_table(ROWS, width=42).splitlines()[:3] == [
        "                                   gain of",
        "              frequency  damping       the",
        "mode               [Hz]    ratio    sensor",
    ]


def test_columns_without_room_follow_below():
    assert text_table(ROWS, width=34).splitlines() == [
        "              frequency  damping",
        "mode               [Hz]    ratio",
        "first, axial       94.9     0.01",
        "2                 876.0        -",
        "",
        "               gain of",
        "                   the",
        "mode            sensor",
        "first, axial  2.19e-05",
        "2                    1",
    ]


def test_no_line_is_too_wide_and_no_cell_is_lost():
    for width in range(25, 70):
        text = text_table(ROWS, width=width)
        assert max(map(len, text.splitlines())) <= width
        assert all(cell in text for row in ROWS[1:] for cell in row)
        assert text.count("first, axial") == len(text.split("\n\n"))


def test_a_cell_that_is_wider_than_the_table_stays_whole():
    assert "x" * 40 in text_table([["", "a"], ["b", "x" * 40]], width=20)


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [
        (98.05858, 7.4e-5, "98.05858 ± 7e-05"),
        (97.5, 0.011, "97.50 ± 0.01"),
        (0.5217, 0.0031, "0.522 ± 0.003"),
        (-2.2457e-5, 3.2e-9, "-2.2457e-05 ± 3e-09"),
        (4.66384e6, 962.0, "4.6638e+06 ± 1e+03"),
        (7.3, 2.0, "7 ± 2"),
        (3e-7, 2e-4, "3e-07 ± 0.0002"),
        (0.0, 0.1, "0 ± 0.1"),
        (1.25, 0.0, "1.25 ± 0"),
        (1.25, math.inf, "1.25 ± inf"),
    ],
)
def test_a_number_has_the_digits_that_its_deviation_allows(value, deviation, text):
    assert with_deviation(value, deviation) == text


def test_a_number_with_two_digits_of_its_deviation():
    given = {"134.980": (134.98, 0.0559), "1.806e+06": (1.8063e6, 3.09e4), "99.32": (99.3241, 0.924)}
    given |= {"-0.00085": (-0.00084574, 3.45e-4), "2e-07": (2.3e-7, 3e-4), "0.7": (0.7, 0.0)}
    assert [rounded(*pair, digits=2) for pair in given.values()] == list(given)
