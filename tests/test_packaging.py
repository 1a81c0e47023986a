"""The wheel holds the library and nothing else; the citation names its version."""

import importlib.util
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import nassim

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel_names(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    if importlib.util.find_spec("hatchling") and importlib.util.find_spec("build"):
        command = ["build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    else:
        command = ["pip", "wheel", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    command = [sys.executable, "-m", *command]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert run.returncode == 0, run.stdout + run.stderr
    (wheel,) = folder.glob("*.whl")
    return zipfile.ZipFile(wheel).namelist()


@pytest.mark.slow
def test_wheel_holds_nassim_only(wheel_names):
    top = {name.split("/")[0] for name in wheel_names}
    assert top == {"nassim", f"nassim-{nassim.__version__}.dist-info"}


@pytest.mark.slow
def test_wheel_holds_every_module(wheel_names):
    sources = (path for ending in ("py", "pyi") for path in (ROOT / "nassim").rglob(f"*.{ending}"))
    modules = {path.relative_to(ROOT).as_posix() for path in sources}
    assert "nassim/signals/__init__.pyi" in modules
    page = {path.relative_to(ROOT).as_posix() for path in (ROOT / "nassim/viewer/page").rglob("*") if path.is_file()}
    assert {"nassim/viewer/page/viewer.html", "nassim/viewer/page/three/LICENSE"} <= page
    c_code = {path.relative_to(ROOT).as_posix() for path in (ROOT / "nassim/exchange/fmi").iterdir()}
    assert {"nassim/exchange/fmi/fmi2_interface.c", "nassim/exchange/fmi/fmi3Functions.h"} <= c_code
    found = {name for name in wheel_names if name.startswith("nassim/")} - {"nassim/py.typed"}
    assert found == modules | page | c_code


def test_the_citation_names_this_version():
    assert f"version: {nassim.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
