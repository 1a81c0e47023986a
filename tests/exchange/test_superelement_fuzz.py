"""Damaged files end in a body that passes its inspection or in a ValueError.

`PYTHONPATH=tests python tests/exchange/test_superelement_fuzz.py N` runs N mutations, with time and memory.
"""

import contextlib
import io
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse

resource = pytest.importorskip("resource")  # not on Windows

from nassim.exchange.inspection import check
from nassim.exchange.repairing import repair, to_body
from nassim.exchange.superelement_writers import write_superelement
from nassim.exchange.superelements import read_superelement

SAMPLE = Path(__file__).parents[1] / "data" / "ansys_listing"
LISTING = {path.name: path.read_bytes() for path in sorted(SAMPLE.glob("*.txt"))}
LONGEST = 20.0
"""What one file may take [s], on a busy machine."""
WORDS = (
    b"NaN",
    b"1e999",
    b"-1e30",
    b"0",
    b"9" * 40,
    b"1.0D+308",
    b"[",
    b"inf",
    b"********",
    b"\x00\xff",
    b"-",
    b"1e-300",
)


def arrays():
    body = read_superelement(*SAMPLE.glob("*.txt"), units="mm-N-t")
    return {"K": np.array(body.stiffness_matrix), "M": np.array(body.mass_matrix), "P": np.array(body.positions)}


def as_mat(variables, **options):
    file = io.BytesIO()
    scipy.io.savemat(file, variables, **options)
    return file.getvalue()


def as_npz(variables, compressed):
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **variables)
    return file.getvalue()


def as_text(name):
    body = read_superelement(*SAMPLE.glob("*.txt"), units="mm-N-t")
    with tempfile.TemporaryDirectory() as folder:
        return {path.name: path.read_bytes() for path in write_superelement(body, Path(folder, name), units="mm-N-t")}


def seeds():
    good = arrays()
    sparse = {**good, "K": scipy.sparse.csc_matrix(good["K"]), "names": np.array(["left", "mid", "right"])}
    return [
        {"body.mat": as_mat(good, do_compression=True)},
        {"body.mat": as_mat(good)},
        {"body.mat": as_mat(good, format="4")},
        {"body.mat": as_mat(sparse)},
        {"body.npz": as_npz(good, False)},
        {"body.npz": as_npz(good, True)},
        LISTING,
        {"all.txt": b"\n".join(LISTING.values())},
        {"all.txt": b" ".join(LISTING.values()).replace(b"\n", b" ")},
        as_text("body.pch"),
        as_text("body.mtx"),
    ]


def damaged_arrays(rng):
    """Files that are sound and hold nonsense."""
    variables = dict(arrays())
    for _ in range(rng.integers(1, 3)):
        name = rng.choice(list(variables))
        array = variables[name]
        kind = rng.integers(9)
        if kind == 0:
            variables = {key: value for key, value in variables.items() if key != name} or {"K": np.eye(3)}
        elif kind == 1:
            variables[name] = array.ravel()
        elif kind == 2:
            variables[name] = array[: rng.integers(len(array) + 1)]
        elif kind == 3:
            variables[name] = array + 1j
        elif kind == 4:
            return {"body.npz": as_npz({**variables, name: np.array([{"a": 1}, None], dtype=object)}, True)}
        elif kind == 5:
            variables[name] = np.where(
                rng.random(array.shape) < 0.01, rng.choice([np.nan, np.inf, 1e300, -1e30]), array
            )
        elif kind == 6:
            variables[name] = array * rng.choice([0.0, -1.0, 1e-300, 1e38, 1e-30])
        elif kind == 7:
            variables[name] = rng.permutation(array.ravel()).reshape(array.shape)
        else:
            variables[name] = np.zeros([0] * int(rng.integers(4)) if rng.random() < 0.5 else (22, 22))
    if rng.random() < 0.5:
        return {"body.npz": as_npz(variables, True)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return {"body.mat": as_mat(variables, do_compression=True)}


def bomb(rng):
    """A small file that claims, or unpacks to, very much."""
    kind = rng.integers(4)
    if kind == 0:
        file = io.BytesIO()
        packed = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        with packed as archive, archive.open("K.npy", "w") as member:
            header = {"descr": "<f8", "fortran_order": False, "shape": (6000, 6000)}
            np.lib.format.write_array_header_1_0(member, header)
            for _ in range(275):
                member.write(bytes(2**20))
        return {"body.npz": file.getvalue()}
    if kind == 1:
        large = np.zeros((int(rng.integers(1400, 4500)),) * 2)
        return {"body.mat": as_mat({"K": large, "M": np.eye(12), "P": np.zeros((2, 3))}, do_compression=True)}
    if kind == 2:
        header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(rng.bytes(4000))
        return {"body.mat": header}
    return {"k.txt": b"MAT_K:\n[ 1500, 1500]: 1.0\nMAT_M:\n[ 99999999, 1]: 1.0\n" + b"[ 1, 1]: 0 " * 100000}


def mutated(rng, files):
    name = str(rng.choice(sorted(files)))
    data = bytearray(files[name])
    for _ in range(rng.integers(1, 4)):
        place = int(rng.integers(max(len(data), 1)))
        kind = rng.integers(9)
        if kind >= 6:  # another digit, which mostly is still a number
            digits = [k for k in range(place, min(place + 400, len(data))) if chr(data[k]).isdigit()]
            for k in digits[: int(rng.integers(1, 4))]:
                data[k] = ord("0") + int(rng.integers(10))
        elif kind == 0:
            for k in rng.integers(len(data), size=rng.integers(1, 9)):
                data[k] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del data[place:]
            data = data or bytearray(b"\n")
        elif kind == 2:
            lines = bytes(data).split(b"\n")
            k = int(rng.integers(len(lines)))
            lines[k : k + 1] = [[], [lines[k], lines[k]], [b"*** banner 12345 1.0 ***", lines[k]]][rng.integers(3)]
            data = bytearray(b"\n".join(lines)) or bytearray(b"\n")
        elif kind == 3:
            data[place : place + int(rng.integers(12))] = WORDS[rng.integers(len(WORDS))]
        elif kind == 4:
            data[place : place + 8] = int(rng.integers(2**63)).to_bytes(8, "little")
        else:
            data[place:place] = data[: int(rng.integers(200))]
    return {**files, name: bytes(data)}


def cases(seed, count):
    rng = np.random.default_rng(seed)
    sound = seeds()
    for _ in range(count):
        choice = rng.random()
        if choice < 0.005:
            yield bomb(rng)
        elif choice < 0.2:
            yield damaged_arrays(rng)
        else:
            yield mutated(rng, sound[rng.integers(len(sound))])


def refusal_of(work, paths):
    """What work() returns, and its ValueError, which must name one of the files."""
    try:
        return work(), None
    except ValueError as error:
        if not any(str(path) in str(error) for path in paths):
            raise AssertionError(f"names no file: {error}") from error
        return None, error


def outcome(files, folder):
    """What comes of reading, repairing and accepting; raises for anything but a sound body or a proper ValueError."""
    paths = [folder / name for name in files]
    for path in paths:
        path.write_bytes(files[path.name])
    units = "mm-N-t" if paths[0].suffix in (".txt", ".pch", ".mtx") else "m-N-kg"
    read, refusal = refusal_of(lambda: read_superelement(*paths, units=units), paths)
    if refusal:
        return "refused on reading"
    str(check(read))
    result = "accepted"
    body, refusal = refusal_of(lambda: to_body(read), paths)
    if refusal:
        with contextlib.redirect_stdout(io.StringIO()):
            body, refusal = refusal_of(lambda: to_body(repair(read).body), paths)
        if refusal:
            return "refused as unfit"
        result = "repaired"
    assert check(body).verdict != "fault", str(check(body))
    return result


def run(seed, count):
    outcomes, slowest = Counter(), 0.0
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        for number, files in enumerate(cases(seed, count)):
            start = time.perf_counter()
            try:
                outcomes[outcome(files, Path(folder))] += 1
            except Exception as error:
                raise AssertionError(f"mutation {number} of seed {seed}: {type(error).__name__}: {error}") from error
            slowest = max(slowest, time.perf_counter() - start)
            for name in files:
                (Path(folder) / name).unlink()
    return outcomes, slowest


def test_damaged_files_end_in_a_sound_body_or_a_value_error():
    outcomes, slowest = run(seed=1, count=200)
    assert slowest < LONGEST
    assert sum(outcomes.values()) == 200
    assert len(outcomes) == 4, f"the mutations are one-sided: {outcomes}"


@pytest.mark.parametrize("number", range(4))
def test_bombs_do_not_go_off(number, tmp_path):
    class Choose:
        def __init__(self):
            self.random = np.random.default_rng(0)
            self.bytes = self.random.bytes

        def integers(self, low, high=None):
            return number if (low, high) == (4, None) else 3000

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert outcome(bomb(Choose()), tmp_path) == "refused on reading"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 700e3  # kB


if __name__ == "__main__":
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    begun = time.perf_counter()
    try:
        found, longest = run(seed=2, count=total)
    except AssertionError:
        traceback.print_exc()
        sys.exit(1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{total} mutations in {time.perf_counter() - begun:.0f} s, the slowest {longest:.2f} s, {peak:.0f} MB at most"
    )
    print(dict(found))
    sys.exit(peak > 1024)
