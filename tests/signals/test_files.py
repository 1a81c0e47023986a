"""Files of measurements: what is read, and what every fault is called."""

import builtins
import re
from dataclasses import replace

import numpy as np
import pytest

from nassim import FRF, TimeHistory, save
from nassim.base.units import to_si
from nassim.signals.files import read_frf, read_measurement, read_record, write_record
from nassim.signals.uff import _curve

pyuff = pytest.importorskip("pyuff")
RECORD = "time [ms], actuator_voltage [mV], encoder [um]\n0, 1, 2\n1, 3, 4\n2, 5, -6e-1\n"
FRF_FILE = (
    "frequency [kHz], encoder/u real [um/V], encoder/u imag [um/V], s/u real [V/V], s/u imag [V/V], "
    "encoder coherence [-], s coherence [-]\n0.1, 1, 2, 3, 4, 0.5, 0.6\n0.3, 5, 6, 7, 8, 0.7, 0.8\n"
)


def written(tmp_path, text, name="file.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("unit", "factor", "si"),
    [
        ("um", 1e-6, "m"),
        ("\N{MICRO SIGN}m", 1e-6, "m"),
        ("\N{GREEK SMALL LETTER MU}m", 1e-6, "m"),
        ("kV", 1e3, "V"),
        ("um/V", 1e-6, "m/V"),
        ("mm / kN", 1e-6, "m/N"),
        ("mm/s^2", 1e-3, "m/s2"),
        ("m/ms2", 1e6, "m/s2"),
        ("mrad", 1e-3, "rad"),
        ("N m", 1.0, "N m"),
        ("kN mm/mrad", 1e3, "N m/rad"),
        ("kg mm2", 1e-6, "kg m2"),
        ("MPa", 1e6, "Pa"),
        ("N/GPa", 1e-9, "N/Pa"),
        ("deg/s", np.pi / 180, "rad/s"),
        ("-", 1.0, "-"),
        ("%", 0.01, "-"),
        ("mNm", 1e-3, "N m"),
        ("nm", 1e-9, "m"),
        ("kN*mm", 1.0, "N m"),
        ("Nmm/deg", 0.18 / np.pi, "N m/rad"),
        ("N\N{MIDDLE DOT}m^2", 1.0, "N m2"),
        ("Nm2", 1.0, "N m2"),
        ("k\N{GREEK CAPITAL LETTER OMEGA}", 1e3, "Ohm"),
        ("MOhm", 1e6, "Ohm"),
        ("pF", 1e-12, "F"),
        ("arcsec", 4.84813681109536e-6, "rad"),
    ],
)
def test_units_become_si(unit, factor, si):
    found = to_si(unit)
    assert found[0] == pytest.approx(factor, rel=1e-12)
    assert found[1] == si


@pytest.mark.parametrize("unit", ["", "inch", "V/", "um/V/parsec", "2"])
def test_unknown_units_are_refused(unit):
    with pytest.raises(ValueError, match=r"unknown unit.*known: m, s, Hz"):
        to_si(unit)


@pytest.mark.parametrize("mark", ["", "\ufeff", "# bench of Monday\n"])
def test_record_is_read_in_si(tmp_path, mark):
    record = read_record(written(tmp_path, mark + RECORD + "\n \n"))
    np.testing.assert_allclose(record.time, [0, 1e-3, 2e-3], rtol=1e-12)
    np.testing.assert_allclose(record["actuator_voltage"], [1e-3, 3e-3, 5e-3])
    np.testing.assert_allclose(record["encoder"], [2e-6, 4e-6, -6e-7])
    assert record.units == ("V", "m")


def test_signals_are_chosen_by_name(tmp_path):
    path = written(tmp_path, RECORD)
    assert read_record(path, names=["encoder"]).names == ("encoder",)
    with pytest.raises(ValueError, match=r"file.csv: there is no 'x'; present: actuator_voltage, encoder"):
        read_record(path, names=["x"])
    with pytest.raises(ValueError, match="signal names must be a list of them, got the text 'encoder'"):
        read_record(path, names="encoder")


def test_frf_is_read_in_si(tmp_path):
    frf = read_frf(written(tmp_path, FRF_FILE))
    np.testing.assert_allclose(frf.frequency, [100, 300])
    np.testing.assert_allclose(frf.response("encoder", "u"), [1e-6 + 2e-6j, 5e-6 + 6e-6j])
    np.testing.assert_allclose(frf.response("s", "u"), [3 + 4j, 7 + 8j])
    np.testing.assert_allclose(frf.coherence, [[0.5, 0.7], [0.6, 0.8]])


def test_a_measurement_is_what_its_columns_say_in_any_order(tmp_path):
    assert isinstance(read_measurement(written(tmp_path, RECORD)), TimeHistory)
    assert isinstance(read_measurement(written(tmp_path, FRF_FILE)), FRF)
    turned = "a/u real [1], frequency [Hz], a/u imag [1]\n1, 10, 3\n2, 20, 4\n"
    np.testing.assert_array_equal(read_measurement(written(tmp_path, turned)).response("a", "u"), [1 + 3j, 2 + 4j])
    sweep = read_measurement(written(tmp_path, "frequency [Hz], time [s]\n10, 0\n20, 1\n"))
    np.testing.assert_array_equal(sweep["frequency"], [10, 20])


def test_a_response_may_be_written_as_magnitude_and_phase(tmp_path):
    text = "frequency [Hz], a/u magnitude [mm/V], a/u phase [deg], b/u real [1], b/u imag [1]\n1, 10, 90, 3, 4\n"
    found = read_frf(written(tmp_path, text))
    np.testing.assert_allclose(found.values[:, 0, 0], [10e-3j, 3 + 4j], atol=1e-17)
    for lacking, message in (("phase [deg]", "no 'a/u phase'"), ("magnitude [mm/V]", "no 'a/u magnitude'")):
        with pytest.raises(ValueError, match=message):
            read_frf(written(tmp_path, text.replace(lacking, "other [1]")))
    with pytest.raises(ValueError, match="'a/u phase' must be in rad, not -"):
        read_frf(written(tmp_path, text.replace("[deg]", "[-]")))


FAULTS = [
    (("RECORD", ""), "file.csv: the file is empty"),
    (("-6e-1\n", ""), "line 4, column 'encoder': a gap, the cell is empty"),
    (("3, 4", "3, nan"), "line 3, column 'encoder': nan is not finite"),
    (("3, 4", "3, inf"), "line 3, column 'encoder': inf is not finite"),
    (("3, 4", "three, 4"), "line 3, column 'actuator_voltage': 'three' is no number"),
    (("3, 4", "3"), "line 3: 2 cells, but the header names 3 columns"),
    (("3, 4", "3, 4#5"), "line 3, column 'encoder': '4#5' is no number"),
    (("3, 4", "3, 4_0"), "the rows cannot be read as numbers"),  # which Python itself reads
    (("1, 3, 4\n", "\n"), "line 3: a gap, the line is empty"),
    (("-6e-1\n", "6\n4, 1, 1\n5, 1, 1\n"), "line 5: unequal sampling, a step of 0.002 s where 0.001 s is usual"),
    (("-6e-1\n", "6\n2, 1, 1\n3, 1, 1\n"), "line 5: unequal sampling, a step of 0 s"),
    (("0, 1, 2\n1, 3, 4\n2", "2, 1, 2\n1, 3, 4\n0"), "line 3: the time must rise from line to line"),
    (("0, 1, 2\n1, 3, 4\n2", "1, 1, 2\n1, 3, 4\n1"), "line 3: the time must rise from line to line"),
    (("time [ms]", "t [ms]"), "line 1: there is no 'time'; present: t, actuator_voltage, encoder"),
    (("time [ms]", "time [mV]"), "line 1: 'time' must be in s, not V"),
    (("[um]", "[inch]"), "line 1: unknown unit 'inch'"),
    (("encoder [um]", "encoder"), r"line 1: column 'encoder' must be written 'name \[unit\]'"),
    (("encoder", "actuator_voltage"), "line 1: column 'actuator_voltage' occurs twice"),
    ((", actuator_voltage [mV], encoder [um]\n0, 1, 2\n1, 3, 4\n2, 5, -6e-1", "\n0\n1"), "no signal besides the time"),
    (("0, 1, 2\n1, 3, 4\n2, 5, -6e-1\n", ""), "ends after its header"),
    (("1, 3, 4\n2, 5, -6e-1\n", ""), "line 2: a record needs at least 2 samples"),
]


@pytest.mark.parametrize(("change", "message"), FAULTS)
def test_faults_are_named_by_file_and_line(tmp_path, change, message):
    text = "" if change[0] == "RECORD" else RECORD.replace(*change)
    assert text != RECORD
    with pytest.raises(ValueError, match=message) as fault:
        read_record(written(tmp_path, text))
    assert "file.csv" in str(fault.value)


def test_blank_lines_count_even_before_the_header(tmp_path):
    with pytest.raises(ValueError, match=r"line 6, column 'encoder'.*'x' is no number"):
        read_record(written(tmp_path, "# a\n\n" + RECORD.replace("-6e-1", "x")))


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "file.csv"
    path.write_bytes(b"time [s], a [\xff]\n")
    with pytest.raises(ValueError, match=r"file.csv: the file is not text in UTF-8"):
        read_record(path)
    with pytest.raises(FileNotFoundError):
        read_record(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("imag", "imaginary"), "line 1: there is no 'encoder/u imag'; present: frequency"),
        (("encoder/u real", "encoder/  real"), "line 1: there is no 'encoder/u real'; present: frequency"),
        (("encoder/u imag [um/V]", "encoder/u imag [V]"), "'encoder/u imag' have units of different kinds"),
        ((", s coherence [-]", ", t coherence [-]"), "there is no 's coherence'"),
        (("coherence [-]", "coherence [V]"), "'encoder coherence' must be in -, not V"),
        (("frequency [kHz]", "frequency [s]"), "'frequency' must be in Hz, not s"),
        (("0.3,", "0.1,"), "line 3: the frequency must rise"),
        (("0.3,", "-0.3,"), "line 3: the frequency must rise"),
        (("0.5, 0.6", "0.5, 1.6"), r"coherence must lie in 0 \.\.\. 1, got 0\.5 \.\.\. 1\.6"),
        (("/", "|"), "unknown unit"),
    ],
)
def test_faults_of_frfs(tmp_path, change, message):
    with pytest.raises(ValueError, match=message) as fault:
        read_frf(written(tmp_path, FRF_FILE.replace(*change)))
    assert "file.csv" in str(fault.value)


def table(*pairs, coherence=()):
    """An FRF file of two lines in which output k over its input is k + 1, and of the coherences."""
    columns = [f"{pair} {part} [m/N]" for pair in pairs for part in ("real", "imag")]
    header = ["frequency [Hz]", *columns, *(f"{name} coherence [-]" for name in coherence)]
    cells = [str(k + 1) if part else "0" for k in range(len(pairs)) for part in (1, 0)] + ["1"] * len(coherence)
    return (
        "\n".join(", ".join([*first, *rest]) for first, rest in ((header, []), (["1"], cells), (["2"], cells))) + "\n"
    )


@pytest.mark.parametrize(
    ("pairs", "coherence", "outputs", "inputs"),
    [
        (["strut_1/enc/strut_1/V"], (), ["strut_1/enc"], ["strut_1/V"]),
        (["a/enc/a/V", "a/enc/V", "enc/a/V", "enc/V"], (), ["a/enc", "enc"], ["a/V", "V"]),
        (["enc/b/a/V", "enc/b/a/W"], ["enc"], ["enc"], ["b/a/V", "b/a/W"]),
        (["enc / b/a/V"], (), ["enc"], ["b/a/V"]),
        (["b/x/enc / V", "enc / V"], (), ["b/x/enc", "enc"], ["V"]),
        (["a/x/u", "a/y/u", "b/x/u", "b/y/u"], ["a", "b"], ["a", "b"], ["x/u", "y/u"]),
    ],
)
def test_names_of_placed_scenes_hold_slashes(tmp_path, pairs, coherence, outputs, inputs):
    frf = read_frf(written(tmp_path, table(*pairs, coherence=coherence)))
    assert (list(frf.outputs), list(frf.inputs)) == (outputs, inputs)
    values = np.arange(1, len(pairs) + 1).reshape(len(outputs), len(inputs))
    np.testing.assert_array_equal(frf.values, np.repeat(values[:, :, None], 2, axis=2))


def test_a_slash_that_may_divide_or_not_is_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"'enc/a/V' may be 'enc / a/V' or 'enc/a / V': write the slash .* blanks around"
    ):
        read_frf(written(tmp_path, table("enc/a/V")))
    with pytest.raises(ValueError, match=r"there is no 'b/enc/a/W real'"):
        read_frf(written(tmp_path, table("a/enc/a/V", "a/enc/a/W", "b/enc/a/V")))


def test_a_record_is_no_frf(tmp_path):
    with pytest.raises(ValueError, match=r"file\.csv, line 1: no column is named like 'output/input real"):
        read_frf(written(tmp_path, "frequency [Hz], gain [-]\n1, 2\n3, 4\n"))
    with pytest.raises(ValueError, match=r"there is no 'frequency'; present: time"):
        read_frf(written(tmp_path, RECORD))


def test_rounded_times_are_made_equidistant(tmp_path):
    exact = np.arange(1000) / 12800
    lines = [f"{1e3 * t:.4f}, 1" for t in exact]
    record = read_record(written(tmp_path, "time [ms], a [V]\n" + "\n".join(lines)))
    assert record.sample_rate == pytest.approx(12800, rel=1e-5)
    assert np.ptp(np.diff(record.time)) < 1e-12


def test_what_is_written_is_read_again(tmp_path):
    values = np.random.default_rng(0).standard_normal((2, 100)) * [[1.0], [1e-9]]
    record = TimeHistory(np.arange(100) / 3e3, values, ("a", "b"), ("V", "m"))
    again = read_record(write_record(record, tmp_path / "new" / "record.csv"))
    np.testing.assert_allclose(again.values, record.values, rtol=1e-11)
    np.testing.assert_allclose(again.time, record.time, atol=1e-12)
    assert (again.names, again.units) == (record.names, record.units)
    late = replace(record, time=1.7e9 + record.time)  # seconds since 1970 have steps of 2.4e-7
    again = read_record(write_record(late, tmp_path / "late.csv"))
    np.testing.assert_allclose(again.time, late.time, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="equal steps"):
        replace(record, time=1.7e9 + record.time + 1e-5 * (record.time > 0.01))


def test_fast_records_in_seconds_since_1970(tmp_path):
    """At 51.2 kHz the rounding of such times is more than a hundredth of a step; a lost sample is still found."""
    time = 1.7e9 + np.arange(400) / 51200
    path = write_record(TimeHistory(time, np.arange(400.0), ("a",), ("V",)), tmp_path / "fast.csv")
    assert read_record(path).sample_rate == pytest.approx(51200, rel=1e-4)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:200] + lines[201:]))
    with pytest.raises(ValueError, match="line 201: unequal sampling"):
        read_record(path)


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    record = TimeHistory([0.0, 1.0], [[1.0, 2.0]], ("a",), ("V",))
    path = write_record(record, tmp_path / "record.csv")
    before = path.read_bytes()

    def interrupt(file, *_arguments, **_options):
        file.write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savetxt", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_record(record, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_many_lines_still_have_numbers(tmp_path):
    lines = ["time [s], a [V], b [um]", *(f"{1e-4 * k:.4f},1.25,-3.5" for k in range(60_000))]
    path = written(tmp_path, "\n".join(lines))
    assert read_record(path).values.shape == (2, 60_000)
    lines[50_000] = lines[50_000].replace("1.25", "1,25")
    with pytest.raises(ValueError, match=r"line 50001: 4 cells, but the header names 3 columns"):
        read_record(written(tmp_path, "\n".join(lines)))


def data_set(x, data, func_type, **change):
    content = {
        "type": 58,
        "binary": 0,
        "func_type": func_type,
        "rsp_node": 3,
        "rsp_dir": -3,
        "ref_node": 1,
        "ref_dir": 1,
        "abscissa_spacing": 1,
        "abscissa_axis_units_lab": "s" if func_type == 1 else "Hz",
        "ordinate_axis_lab": "encoder",
        "ordinate_axis_units_lab": "um",
        "orddenom_axis_lab": "actuator_voltage",
        "orddenom_axis_units_lab": "mV",
        "orddenom_spec_data_type": 0,
        "x": x,
        "data": data,
    }
    return {**content, **change}


def write_uff(path, sets):
    path.unlink(missing_ok=True)
    for content in sets:  # one by one in mode "add": pyuff's "overwrite" loses the header of binary sets
        pyuff.UFF(str(path)).write_sets(content, "add")
    return path


@pytest.mark.parametrize("binary", [0, 1])
def test_records_of_uff_files(tmp_path, binary):
    time = np.arange(200) * 1e-4
    a, b = np.random.default_rng(0).standard_normal((2, 200))
    sets = [
        data_set(time, a, 1, binary=binary),
        data_set(time, b, 1, binary=binary, ordinate_axis_lab="NONE", ordinate_axis_units_lab="mV"),
    ]
    record = read_measurement(write_uff(tmp_path / "record.uff", sets))
    assert isinstance(record, TimeHistory)
    assert (record.names, record.units) == (("encoder", "3 -z"), ("m", "V"))
    np.testing.assert_allclose(record.values, [1e-6 * a, 1e-3 * b], rtol=1e-10)
    np.testing.assert_allclose(record.time, time, atol=1e-10)
    slow = write_uff(tmp_path / "slow.uff", [data_set(time, a, 1, binary=binary, abscissa_axis_units_lab="ms")])
    assert read_record(slow).sample_rate == pytest.approx(1e7, rel=1e-5)


@pytest.mark.parametrize("spacing", [0, 1])
def test_frfs_of_uff_files(tmp_path, spacing):
    frequency = 10.0 + 0.5 * np.arange(50)
    response = np.random.default_rng(0).standard_normal((2, 50)) @ np.ones((50, 50)) + 1j * np.arange(50)
    coherence = np.linspace(0.5, 1.0, 50)
    same = {"abscissa_spacing": spacing}
    sets = [
        data_set(frequency, response[0], 4, **same),
        data_set(frequency, response[1], 4, ordinate_axis_lab="sensor", ordinate_axis_units_lab="V", **same),
        data_set(frequency, coherence, 6, **same),
        data_set(frequency, coherence, 6, ordinate_axis_lab="sensor", **same),
    ]
    frf = read_measurement(write_uff(tmp_path / "frf.unv", sets))
    assert (frf.outputs, frf.inputs) == (("encoder", "sensor"), ("actuator_voltage",))
    np.testing.assert_allclose(frf.frequency, frequency, rtol=1e-5)
    np.testing.assert_allclose(frf.values[0, 0], 1e-3 * response[0], rtol=1e-10)
    np.testing.assert_allclose(frf.values[1, 0], 1e3 * response[1], rtol=1e-10)
    np.testing.assert_allclose(frf.coherence, [coherence, coherence], rtol=1e-10)


def test_frfs_of_several_inputs_in_any_order_of_a_uff_file(tmp_path):
    """No label but nodes and directions; curves and coherences out of order, frequencies in kHz."""
    places = {"1": 1, "2 -y": 2, "3 rz": 3}
    names = {"1": (1, 0), "2 -y": (2, -2), "3 rz": (3, 6), "7 x": (7, 1), "8 -ry": (8, -5)}
    frequency, none = 10.0 + np.arange(30.0), {"ordinate_axis_lab": "NONE", "orddenom_axis_lab": "NONE"}

    def curve(data, func_type, output, input="7 x"):
        (rsp_node, rsp_dir), (ref_node, ref_dir) = names[output], names[input]
        ends = {"rsp_node": rsp_node, "rsp_dir": rsp_dir, "ref_node": ref_node, "ref_dir": ref_dir}
        units = {"abscissa_axis_units_lab": "kHz", "ordinate_axis_units_lab": "m", "orddenom_axis_units_lab": "V"}
        return data_set(1e-3 * frequency, data, func_type, **none, **ends, **units)

    sets = [curve(np.full(30, 0.1 * places[output]), 6, output) for output in ("3 rz", "1", "2 -y")]
    pairs = [(output, input) for input in ("7 x", "8 -ry") for output in ("2 -y", "3 rz", "1")]
    sets += [curve(np.full(30, places[o] + 1j * (i == "8 -ry")), 4, o, i) for o, i in pairs]
    frf = read_frf(write_uff(tmp_path / "frf.uff", sets))
    assert (frf.outputs, frf.inputs) == (("2 -y", "3 rz", "1"), ("7 x", "8 -ry"))
    np.testing.assert_allclose(frf.frequency, frequency, rtol=1e-5)
    for output, place in places.items():
        np.testing.assert_allclose(frf.response(output, "7 x"), place)
        np.testing.assert_allclose(frf.response(output, "8 -ry"), place + 1j)
        np.testing.assert_allclose(frf.coherence[frf.outputs.index(output)], 0.1 * place)


TIME = np.arange(20) * 1e-3


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        ([data_set(TIME, TIME, 1, ordinate_axis_units_lab="NONE")], "data set 1: its ordinate has no unit"),
        ([data_set(TIME, TIME, 1, ordinate_axis_units_lab="furlong")], "data set 1: unknown unit 'furlong'"),
        ([data_set(TIME, TIME, 1, abscissa_axis_units_lab="V")], "data set 1: the axis of a time is in V"),
        (
            [data_set(TIME, TIME, 1), data_set(2 * TIME, TIME, 1)],
            "data set 2: its axis differs from that of data set 1",
        ),
        ([data_set(np.append(TIME, 1.0), np.ones(21), 1, abscissa_spacing=0)], "sample 21: unequal sampling"),
        ([data_set(TIME, TIME, 2)], "holds no time response, FRF or coherence"),
        ([data_set(TIME, TIME, 1), data_set(TIME, TIME, 1)], "signal names must differ"),
        ([data_set(TIME, TIME, 4)], "no data set 58 is a time response"),
    ],
)
def test_faults_of_uff_files(tmp_path, sets, message):
    with pytest.raises(ValueError, match=message) as fault:
        read_record(write_uff(tmp_path / "file.uff", sets))
    assert "file.uff" in str(fault.value)


def test_curves_of_a_uff_file_are_as_long_as_their_header_says(tmp_path):
    """Data sets of other kinds are passed over."""
    good = data_set(TIME, TIME, 1, num_pts=20)
    assert _curve(good, 1, "y", "u").x.size == 20
    for change in ({"num_pts": 21}, {"data": TIME[:19]}, {"x": TIME[:19]}, {"data": []}):
        with pytest.raises(ValueError, match=r"\d+ values but the header announces 2\d; is the file cut off\?"):
            _curve(good | change, 1, "y", "u")
    path = write_uff(tmp_path / "file.uff", [data_set(TIME, TIME, 1)])
    path.write_text("    -1\n   151\nby hand\n    -1\n" + path.read_text())
    assert read_record(path).values.shape == (1, 20)


def test_columns_of_an_frf_may_come_in_any_order(tmp_path):
    """Outputs z and a, whose coherences come in the other order, of inputs v and b."""
    values = {
        f"{output}/{input}": row for output, input, row in (("z", "v", 1), ("a", "v", 2), ("a", "b", 4), ("z", "b", 3))
    }
    cells = {"frequency [Hz]": [5, 6], "a coherence [-]": [0.2, 0.3], "z coherence [-]": [0.8, 0.9]}
    for pair, value in values.items():
        cells |= {f"{pair} imag [mm/V]": [10 * value] * 2, f"{pair} real [mm/V]": [value, value + 0.5]}
    lines = [list(cells), *zip(*cells.values(), strict=True)]
    path = tmp_path / "frf.csv"
    path.write_text("\n".join(",".join(map(str, line)) for line in lines))
    frf = read_frf(path)
    for pair, value in values.items():
        np.testing.assert_allclose(
            frf.response(*pair.split("/")), 1e-3 * (np.array([value, value + 0.5]) + 10j * value)
        )
    np.testing.assert_array_equal(frf.coherence[frf.outputs.index("z")], [0.8, 0.9])
    np.testing.assert_array_equal(frf.coherence[frf.outputs.index("a")], [0.2, 0.3])


@pytest.mark.parametrize("ending", [".uff", ".UNV", ".58"])
def test_endings_of_uff_files(tmp_path, ending):
    path = write_uff(tmp_path / "record.uff", [data_set(TIME, TIME, 1)]).rename(tmp_path / f"record{ending}")
    for read in (read_record, read_measurement):
        np.testing.assert_allclose(read(path).time, TIME, atol=1e-10)


def test_axes_of_a_uff_file_are_the_same_to_a_billionth(tmp_path):
    for share in (0.9, -0.9, 1.1, -1.1):
        axes = [np.array([10.0, 20.0, 40.0]), np.array([10.0, 20 * (1 + 1e-9 * share), 40.0])]
        curves = [
            data_set(axis, np.ones(3), 4, ordinate_axis_lab=name, abscissa_spacing=0, binary=1)
            for axis, name in zip(axes, "ab", strict=True)
        ]
        path = write_uff(tmp_path / "frf.uff", curves)
        if abs(share) < 1:
            np.testing.assert_array_equal(read_frf(path).frequency, axes[0])
        else:
            with pytest.raises(ValueError, match="data set 2: its axis differs from that of data set 1"):
                read_frf(path)


def test_curves_of_one_point_do_not_overwrite_each_other(tmp_path):
    frequency = 10.0 + np.arange(20.0)
    twice = [data_set(frequency, np.full(20, value), 4) for value in (1.0, 2.0)]
    sets = [data_set(frequency, np.ones(20), 4, ordinate_axis_lab="other"), *twice]
    with pytest.raises(ValueError, match="data set 3: 'encoder' is there already, in data set 2"):
        read_frf(write_uff(tmp_path / "frf.uff", sets))


def test_ordinary_coherences_of_several_references_are_left_out(tmp_path):
    """As of a roving hammer. The multiple coherence is that of an FRF of several inputs."""
    frequency = 10.0 + np.arange(20.0)
    references = [{"ref_node": node, "orddenom_axis_lab": "Force"} for node in (1, 2)]
    sets = [data_set(frequency, np.full(20, k + 1.0), 4, **of) for k, of in enumerate(references)]
    sets += [data_set(frequency, np.full(20, 0.5), 6, **of) for of in references]
    with pytest.warns(UserWarning, match="'encoder' has 2 coherences, in data sets 3, 4, such as one for each refer"):
        frf = read_frf(write_uff(tmp_path / "frf.uff", sets))
    assert frf.inputs == ("Force 1 x", "Force 2 x")
    np.testing.assert_allclose(frf.values[0, :, 0].real, [1e-3, 2e-3])
    assert frf.coherence is None
    path = write_uff(tmp_path / "frf.uff", [*sets, data_set(frequency, np.full(20, 0.9), 9)])
    path.write_text(path.read_text().replace("\n    9", "\n   26"))  # which pyuff only reads
    np.testing.assert_allclose(read_frf(path).coherence, 0.9)


def test_coherences_of_two_responses_at_one_node_are_left_out(tmp_path):
    frequency, labels = 10.0 + np.arange(20.0), ("left", "right")
    sets = [data_set(frequency, np.ones(20), 4, ordinate_axis_lab=label) for label in labels]
    seen = [data_set(frequency, np.full(20, value), 6, ordinate_axis_lab="Coherence") for value in (0.5, 0.6)]
    for some, message in ((seen, "'Coherence' has 2 coherences"), (seen[:1], "its coherences are of Coherence")):
        with pytest.warns(UserWarning, match=message):
            frf = read_frf(write_uff(tmp_path / "frf.uff", [*sets, *some]))
        assert (frf.outputs, frf.coherence) == (labels, None)


def test_uff_files_of_other_programs(tmp_path):
    """Blanks behind the first and last line of a data set, line ends of Windows, and Fortran's double precision."""
    plain = write_uff(tmp_path / "plain.uff", [data_set(TIME, TIME, 1), data_set(TIME, TIME**2, 1, rsp_node=2)])
    text = plain.read_text().replace("    -1\n", "    -1  \n").replace("\n", "\r\n")
    other = tmp_path / "other.uff"
    other.write_bytes(re.sub(r"(\d)e([+-]\d\d)", r"\1D\2", text).encode())
    np.testing.assert_array_equal(read_record(other).values, read_record(plain).values)


def test_points_of_one_label_are_told_apart_by_node_and_direction(tmp_path):
    """As analysers write them: the label is that of the quantity. A label of one point only remains its name."""
    frequency, quantity = 10.0 + np.arange(20.0), {"ordinate_axis_lab": "Displacement"}
    sets = [
        data_set(frequency, np.full(20, value), 4, rsp_node=node, rsp_dir=direction, **quantity)
        for value, node, direction in ((1.0, 12, 3), (2.0, 12, -1), (3.0, 7, 3))
    ]
    sets.append(data_set(frequency, np.full(20, 4.0), 4))
    sets += [data_set(frequency, np.full(20, 0.5), 6, rsp_node=0, rsp_dir=0)]
    frf = read_frf(write_uff(tmp_path / "frf.uff", sets))
    assert frf.outputs == ("Displacement 12 z", "Displacement 12 -x", "Displacement 7 z", "encoder")
    assert frf.inputs == ("actuator_voltage",)
    np.testing.assert_allclose(frf.values[:, 0, 0].real, [1e-3, 2e-3, 3e-3, 4e-3])


def test_coherences_belong_to_the_response_at_their_node(tmp_path):
    frequency, outputs = 10.0 + np.arange(20.0), {12: "left", 13: "right"}
    sets = [
        data_set(frequency, np.ones(20), 4, rsp_node=node, ordinate_axis_lab=name) for node, name in outputs.items()
    ]
    seen = [data_set(frequency, np.full(20, 0.01 * n), 6, rsp_node=n, ordinate_axis_lab="Coherence") for n in outputs]
    frf = read_frf(write_uff(tmp_path / "frf.uff", [*seen[::-1], *sets]))
    np.testing.assert_allclose(frf.coherence[:, 0], [0.12, 0.13])
    with pytest.warns(UserWarning, match="coherences are of left, its responses of left, right"):
        assert read_frf(write_uff(tmp_path / "frf.uff", [*sets, seen[0]])).coherence is None


def test_missing_and_damaged_uff_files(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_record(tmp_path / "none.uff")
    path = write_uff(tmp_path / "file.uff", [data_set(TIME, TIME, 1)])
    text = path.read_text()
    path.write_text(text.replace("1.10000000000e-02", "nan".rjust(17)))  # pyuff itself writes zeros for NaN
    with pytest.raises(ValueError, match=r"file.uff, data set 1: value 12 is not finite"):
        read_record(path)
    path.write_text(text[: len(text) // 2] + "\n    -1\n")
    with pytest.raises(ValueError, match=r"file.uff, data set 1: "):
        read_record(path)
    for cut in (20, 3 * len(text) // 2, 2 * len(text) - 20):
        path.write_text((text + text.replace("encoder", "voltage"))[:cut])
        with pytest.raises(ValueError, match=r"file.uff: a data set lacks its first or last line"):
            read_record(path)
    with pytest.raises(ValueError, match=r"file.uff: no data set 58 is a frequency response"):
        read_frf(write_uff(path, [data_set(TIME, TIME, 1)]))


def test_without_pyuff_the_message_says_what_to_install(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name == "pyuff":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(RuntimeError, match=r'pip install "nassim\[uff\]"'):
        read_record(tmp_path / "file.uff")


def test_g_is_ambiguous():
    with pytest.raises(ValueError, match="gram or gravity"):
        to_si("g")


@pytest.mark.parametrize("name", ["r.mat", "r.h5", "r.NPZ", "r.uff", "r.csv.gz"])
def test_csv_is_not_written_under_the_ending_of_another_format(name, tmp_path):
    record = TimeHistory([0.0, 1.0], [1.0, 2.0], ("u",), ("V",))
    with pytest.raises(
        ValueError, match=rf"written as CSV, which is no {name[name.rindex('.') :].lower()} file; .* `save`"
    ):
        write_record(record, tmp_path / name)
    assert not list(tmp_path.iterdir())
    for usual in ("r.csv", "r.txt", "r"):
        assert read_record(write_record(record, tmp_path / usual)).names == ("u",)


def test_a_file_of_save_is_told_from_csv(tmp_path):
    path = save(TimeHistory([0.0, 1.0], [1.0, 2.0], ("u",), ("V",)), tmp_path / "r.h5")
    with pytest.raises(ValueError, match=r"not text in UTF-8 .* `load` reads files of `save`"):
        read_record(path)


def test_torques_and_stress_are_written_too(tmp_path):
    """The units of nassim's own signals."""
    record = TimeHistory([0.0, 1.0], [[1.0, 2.0], [3e6, -4e6]], ("twist", "top.sxx"), ("N m", "Pa"))
    found = read_record(write_record(record, tmp_path / "r.csv"))
    assert (found.names, found.units) == (record.names, record.units)
    np.testing.assert_array_equal(found.values, record.values)


@pytest.mark.parametrize(
    ("name", "unit"), [("a, b", "V"), ("u", "N parsec"), ("a\nb", "V"), ("time", "s"), (" a", "V")]
)
def test_records_that_could_not_be_read_back_are_not_written(name, unit, tmp_path):
    record = TimeHistory([0.0, 1.0], [[1.0, 2.0]], (name,), (unit,))
    with pytest.raises(ValueError, match=r"cannot be a column's name|unknown unit"):
        write_record(record, tmp_path / "r.csv")
    with pytest.raises(ValueError, match="a record without signals cannot be read back"):
        write_record(record.select(()), tmp_path / "r.csv")
    assert not list(tmp_path.iterdir())
