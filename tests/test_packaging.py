"""The wheel holds the library and the devices, and nothing else; a type checker finds its types as users meet them."""

import importlib.util
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import nassim

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    if importlib.util.find_spec("hatchling") and importlib.util.find_spec("build"):
        command = ["build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    else:
        command = ["pip", "wheel", "--no-deps", "--wheel-dir", str(folder), str(ROOT)]
    command = [sys.executable, "-m", *command]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert run.returncode == 0, run.stdout + run.stderr
    (wheel,) = folder.glob("*.whl")
    return zipfile.ZipFile(wheel)


@pytest.fixture
def wheel_names(wheel):
    return wheel.namelist()


@pytest.mark.slow
def test_wheel_holds_nassim_only(wheel_names):
    top = {name.split("/")[0] for name in wheel_names}
    assert top == {"nassim", f"nassim-{nassim.__version__}.dist-info"}


@pytest.mark.slow
def test_wheel_holds_every_module(wheel_names):
    modules = {
        f"{name}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, name in {"nassim": "nassim", "models": "nassim/devices"}.items()
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".pyi", ".json", ".typed")
    }
    assert {"nassim/py.typed", "nassim/devices/apa300ml/calibration.json"} <= modules
    assert "nassim/signals/__init__.pyi" in modules
    page = {path.relative_to(ROOT).as_posix() for path in (ROOT / "nassim/viewer/page").rglob("*") if path.is_file()}
    assert {"nassim/viewer/page/viewer.html", "nassim/viewer/page/three/LICENSE"} <= page
    c_code = {path.relative_to(ROOT).as_posix() for path in (ROOT / "nassim/exchange/fmi").iterdir()}
    assert {"nassim/exchange/fmi/fmi2_interface.c", "nassim/exchange/fmi/fmi3Functions.h"} <= c_code
    assert {name for name in wheel_names if name.startswith("nassim/")} == modules | page | c_code


MISUSE = """from nassim import RemotePoint, Scene, TimeHistory, load

RemotePoint("left", "foot", None)
load("record.h5", as_=TimeHistory).values.T.no_such_attribute
RemotePoint("left", ["foot"], [0, 0, 1]).faces.append("another")
"""


def code_of(page):
    """Code of a page in the lines that it has there."""
    parts = re.split(r"^```(?:python|py)\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    return "".join(f"\n{part}" if k % 2 else re.sub(r"[^\n]", "", part) for k, part in enumerate(parts))


@pytest.mark.slow
def test_code_of_the_pages_passes_a_type_checker(wheel, tmp_path, monkeypatch):
    """Libraries without types, and those that a page alone needs, count as of any type."""
    pytest.importorskip("pyright", reason="needs the extra dev")
    wheel.extractall(tmp_path / "site")
    (tmp_path / "typings" / "netgen").mkdir(parents=True)
    for name in ("netgen/__init__.pyi", "netgen/occ.pyi", "dask_jobqueue.pyi"):
        (tmp_path / "typings" / name).write_text("from typing import Any\ndef __getattr__(name: str) -> Any: ...\n")
    pages = [path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "templates"]
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *pages):
        name = "_".join(page.relative_to(ROOT).with_suffix(".py").parts)
        (tmp_path / name).write_text(code_of(page), encoding="utf-8")
    (tmp_path / "misuse.py").write_text(MISUSE)
    (tmp_path / "pyrightconfig.json").write_text(
        json.dumps({"typeCheckingMode": "basic", "extraPaths": ["site"], "exclude": ["site"]})
    )
    monkeypatch.setenv("PYRIGHT_PYTHON_IGNORE_WARNINGS", "1")
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "-p", str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    found = [
        (Path(item["file"]).name, item["range"]["start"]["line"] + 1, item["message"])
        for item in json.loads(run.stdout)["generalDiagnostics"]
        if item["severity"] == "error"
    ]
    assert [item for item in found if item[0] != "misuse.py"] == []
    assert [item[1] for item in found] == [3, 4, 5]


def test_the_citation_names_this_version():
    assert f"version: {nassim.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
