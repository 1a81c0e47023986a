"""README and docs hold what their templates give, figures come from summaries that a command made, and code runs.

The site's pages name every script, every sub-package and every warning. Tests of what builds the site need Sphinx.
"""

import ast
import importlib
import importlib.util
import inspect
import json
import pkgutil
import pydoc
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import nassim
from models.apa300ml import COARSE, reduced_apa300ml
from nassim.fem import accuracy
from nassim.plotting import plt
from nassim.scene.part import Part
from nassim.scene.rotation_measures import RelativePose

ROOT = Path(__file__).parent.parent
spec = importlib.util.spec_from_file_location("render", ROOT / "docs" / "render.py")
docs = importlib.util.module_from_spec(spec)
spec.loader.exec_module(docs)

GIVEN = json.loads((ROOT / "docs" / "given.json").read_text(encoding="utf-8"))
TEMPLATES = sorted((ROOT / "docs" / "templates").rglob("*.md"))
FIGURES = docs.load_figures()


def test_documents_are_what_their_templates_give():
    for template, target, text in docs.documents():
        assert target.read_text(encoding="utf-8") == text, f"run python docs/render.py (for {template.name})"


MADE = {target for _, target, _ in docs.documents()} | {ROOT / "docs" / "hard_cases.md"}
PAGES = [
    ROOT / "CONTRIBUTING.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "templates" not in path.parts),
]
HAND_WRITTEN = [path for path in PAGES if path not in MADE]


@pytest.mark.parametrize("page", HAND_WRITTEN, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_without_a_template_or_a_command_hold_no_figures(page):
    text = page.read_text(encoding="utf-8").partition("\n## Sources\n")[0]
    assert not docs.typed_figures(text, GIVEN), "make it a template, docs/templates, with the figures of a summary"


def blocks(page, language="python"):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)


COARSELY = """from models import apa300ml
apa300ml.reduced_apa300ml.__kwdefaults__.update(apa300ml.COARSE)"""


@pytest.mark.slow
@pytest.mark.parametrize("page", [*filter(blocks, PAGES)], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_code_on_a_page_runs_as_it_stands(page, tmp_path, monkeypatch):
    """But for what is fenced as `py`, which needs several machines.

    Actuators are coarse, as of the scripts' tests, and meshes for a tolerance are those of the first round.
    """
    code = "\n".join(blocks(page))
    shutil.copytree(ROOT / "tests" / "data", tmp_path / "tests" / "data")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reduced_apa300ml, "__kwdefaults__", reduced_apa300ml.__kwdefaults__ | COARSE)
    monkeypatch.setattr(accuracy, "MOST_ROUNDS", 1)
    if "sweep(" in code:  # whose child processes import the page
        Path("page.py").write_text(f"{COARSELY}\n{code}", encoding="utf-8")
        subprocess.run([sys.executable, "page.py"], check=True)
    else:
        exec(compile(code, page.name, "exec"), {"__name__": "__main__"})
    plt.close("all")


@pytest.mark.slow
def test_the_notebook_shows_what_it_makes(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="notebooks need the extra docs")
    client = pytest.importorskip("nbclient", reason="notebooks need the extra docs")
    tour = nbformat.read(ROOT / "docs" / "tour.ipynb", 4)
    tour.cells.insert(0, nbformat.v4.new_code_cell(COARSELY))
    client.NotebookClient(tour, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    expressions = {expression for group in docs.SHOWN for expression in group}
    shown = {cell.source: cell.outputs[-1]["data"] for cell in tour.cells if cell.source in expressions}
    assert shown.keys() == expressions
    for name, start in {"body": "<iframe", "bench": "<iframe", "estimated": "<img"}.items():
        assert shown[name]["text/html"].startswith(start)
        assert len(shown[name]["text/plain"]) < 300


def test_every_part_has_an_example():
    code = "\n".join(block for page in PAGES for block in blocks(page))
    parts = [
        name for name in nassim.__all__ if isinstance(kind := getattr(nassim, name), type) and issubclass(kind, Part)
    ]
    assert len(parts) > 20
    assert [name for name in parts if f"{name}(" not in code] == []


def test_every_public_function_has_an_example():
    """Of the names in `nassim` itself; classes that functions return, such as reports, need none."""
    code = "\n".join(block for page in [*PAGES, ROOT / "README.md"] for block in blocks(page))
    functions = [name for name in nassim.__all__ if inspect.isfunction(getattr(nassim, name))]
    assert len(functions) > 40
    assert [name for name in functions if not re.search(rf"\b{name}\(|^@{name}$", code, re.M)] == []


def test_help_of_public_names_is_not_that_of_numpy():
    """Arrays as class attributes would bring numpy's manual into `help`."""
    long = [name for name in nassim.__all__ if "ndarray(shape" in pydoc.render_doc(getattr(nassim, name))]
    assert long == []


def test_help_prints_types_that_users_give():
    """Kinds of fields, by which scenes are placed, read as the types of their values."""
    # Since Python 3.13, each argument has a line of its own.
    words = " ".join(pydoc.render_doc(nassim.Geophone).replace("|  ", "").split())
    assert "name: str, point: str, axis: str | numpy.typing.ArrayLike = 'z', frame: str = ''," in words
    words = " ".join(pydoc.render_doc(RelativePose).replace("|  ", "").split())
    assert "a: str, b: str, axes: numpy.ndarray = <factory>," in words
    noted = [name for name in nassim.__all__ if "Annotated[" in pydoc.render_doc(getattr(nassim, name))]
    assert noted == []


def test_every_script_has_its_place_in_the_gallery(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "gallery").glob("*.md"))
    commands = [shlex.split(line) for line in re.findall(r"^```\{script\} (.+)$", pages, re.M)]
    assert sorted(name for name, *_ in commands) == sorted(p.name for p in (ROOT / "scripts").glob("[a-z]*.py"))
    for name, *options in commands:
        importlib.import_module(Path(name).stem).arguments.parse_args(options)


def test_every_sub_package_has_its_page_in_the_reference():
    listed = (ROOT / "docs" / "reference" / "index.md").read_text(encoding="utf-8")
    for package in filter(lambda module: module.ispkg, pkgutil.iter_modules(nassim.__path__)):
        page = ROOT / "docs" / "reference" / f"{package.name}.md"
        assert page.exists(), f"write {page}, three lines as of the others"
        assert f"]({package.name}.md)" in listed


def texts(node, function):
    """Constant parts of what a call says, also by way of names that its function assigns."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
            yield inner.value
        elif isinstance(inner, ast.Name):
            for other in ast.walk(function):
                targets = other.targets if isinstance(other, ast.Assign) else []
                if inner.id in {target.id for target in targets if isinstance(target, ast.Name)}:
                    yield from (part.value for part in ast.walk(other.value) if isinstance(part, ast.Constant))


def warnings_of(path):
    text = path.read_text(encoding="utf-8")
    for function in ast.walk(ast.parse(text)) if "warn(" in text else ():
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and ast.unparse(node.func) in ("warn", "warnings.warn"):
                    yield f"{path.name}, line {node.lineno}", [t for t in texts(node, function) if isinstance(t, str)]


def test_links_to_functions_lead_somewhere():
    roles = re.compile(r"\{(?:func|class|meth|attr|mod)\}`~?(nassim[\w.]*)`")
    for page in PAGES:
        for name in roles.findall(page.read_text(encoding="utf-8")):
            assert pydoc.locate(name) is not None, f"{page.name} names {name}"


def test_every_warning_stands_on_its_page():
    page = (ROOT / "docs" / "howto" / "warnings.md").read_text(encoding="utf-8")
    quoted = re.findall(r'^\| "([^"]+)" \|', page, re.M)
    spoken = []
    for path in sorted((ROOT / "nassim").rglob("*.py")):
        if path.name == "warning_log.py":
            continue
        for where, parts in warnings_of(path):
            told = "{}".join(parts)
            spoken.append(told)
            again = path.name == "storage.py" and not parts  # what a cached body was warned of
            assert again or any(phrase in told for phrase in quoted), f"{where} is not in warnings.md: {told}"
    assert [phrase for phrase in quoted if not any(phrase in told for told in spoken)] == []


@pytest.fixture
def site(monkeypatch):
    """Imports what builds the site, by name; skipped without Sphinx."""
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "extensions"))
    return importlib.import_module


def test_docstrings_become_links_and_plain_text(site):
    reference = site("reference")
    docstring = """Do something, 2 * 3 | 4, to x_ of `estimate_frf`s.

    u = Psi q

Args:
    size: in `a
        b`; `signals.FRF` and `FRF.band`."""
    assert (
        reference.to_rst(docstring)
        == """\
Do something, 2 \\* 3 \\| 4, to x\\_ of :py:obj:`estimate_frf <nassim.signals.estimate_frf>`\\ s.

| u = Psi q

Args:
    size: in ``a b``; :py:obj:`signals.FRF <nassim.signals.FRF>` and ``FRF.band``."""
    )


def test_dead_links_and_what_needs_a_network_are_found(site, tmp_path):
    build = site("build")
    (tmp_path / "b.html").write_text('<h1 id="here">x</h1>')
    (tmp_path / "a.html").write_text(
        '<a href="b.html#here"></a><a href="b.html#gone"></a><a href="c.html"></a><a href="#own"></a><i id="own"></i>'
        '<a href="https://elsewhere.org/x"></a><script src="https://cdn.org/x.js"></script><img src="no.png">'
    )
    assert sorted(build.dead_links(tmp_path)) == [
        "a.html loads https://cdn.org/x.js",
        "a.html: b.html#gone leads nowhere",
        "a.html: c.html leads nowhere",
        "a.html: no.png leads nowhere",
    ]


def test_results_stay_until_the_code_changes(site, tmp_path, monkeypatch):
    gallery = site("gallery")
    for folder in ("nassim", "models", "scripts"):
        (tmp_path / folder).mkdir()
    script = tmp_path / "scripts" / "count.py"
    script.write_text(
        "import pathlib, sys\nfolder = pathlib.Path(sys.argv[-1])\nprint('seven', sys.argv[1])\n"
        "print('results in', folder)\n(folder / 'summary.json').write_text('{}')\n"
    )
    monkeypatch.setattr(gallery, "ROOT", tmp_path)
    monkeypatch.setattr(gallery, "RESULTS", tmp_path / "build")
    gallery.code.cache_clear()
    run = gallery.Run("count.py 3")
    assert not run.done
    assert gallery.make([run]) == []
    assert run.done
    assert (run.folder / "report.txt").read_text() == "seven 3\n"
    assert not gallery.Run("count.py 4").done
    script.write_text("raise SystemExit('no more')")
    gallery.code.cache_clear()
    assert not run.done
    (problem,) = gallery.make([run])
    assert "count.py 3 ends with status 1\nno more" in problem
    gallery.code.cache_clear()


def test_what_a_script_made_stands_on_its_page(site, tmp_path, monkeypatch):
    gallery = site("gallery")
    monkeypatch.setattr(gallery, "RESULTS", tmp_path / "gallery")
    run = gallery.Run("run_bench.py")
    run.folder.mkdir(parents=True)
    for name, text in {"report.txt": "pole 98 Hz\n", "summary.json": '{"pole_Hz": 98}', "modes.html": "<p>"}.items():
        (run.folder / name).write_text(text)
    (run.folder / "frf.png").write_bytes(b"")
    parts = "".join(gallery._results(run))
    assert "![frf](/../build/gallery/run_bench/frf.png)" in parts
    assert 'src="../_static/gallery/run_bench/modes.html"' in parts
    assert "pole 98 Hz" in parts
    assert '"pole_Hz": 98' in parts
    gallery._copy_pages(SimpleNamespace(outdir=tmp_path / "site"), None)
    assert (tmp_path / "site" / "_static" / "gallery" / "run_bench" / "modes.html").read_text() == "<p>"


@pytest.mark.parametrize("template", TEMPLATES, ids=[path.name for path in TEMPLATES])
def test_no_figure_is_typed(template):
    typed = docs.typed_figures(template.read_text(encoding="utf-8"), GIVEN)
    assert not typed, "take them from a summary, or enter them in docs/given.json with their source"


def test_every_given_figure_is_used_and_has_a_source():
    text = "\n".join(path.read_text(encoding="utf-8") for path in [*TEMPLATES, *HAND_WRITTEN])
    unused = [phrase for phrase in GIVEN if not re.search(re.escape(phrase).replace(r"\ ", r"\s+"), text)]
    assert unused == []
    assert all(len(source) > 10 for source in GIVEN.values())


@pytest.mark.parametrize("name", FIGURES)
def test_figures_name_the_command_that_made_them(name, monkeypatch):
    interpreter, script, *options = shlex.split(FIGURES[name]["command"])
    assert interpreter == "python"
    assert (ROOT / script).is_file()
    assert Path(script).stem == name.partition("-")[0]
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    importlib.import_module(Path(script).stem).arguments.parse_args(options)


@pytest.mark.parametrize("template", TEMPLATES, ids=[path.name for path in TEMPLATES])
def test_sections_name_the_commands_of_their_figures(template):
    for section in docs.sections(template.read_text(encoding="utf-8")):
        rendered = docs.render(section, FIGURES)
        for match in docs.PLACEHOLDER.finditer(docs.CODE_BLOCK.sub("", section)):
            command = FIGURES[match[1]]["command"]
            assert f"`{command}`" in rendered, f"{match[0]} stands in a section that does not name its command"


FIGURE = {
    "command": "python scripts/bench.py --quick",
    "gain_m_per_V": 2.1549e-5,
    "n_dofs": 88854,
    "5_kg_Hz": [94.9077, 401.5],
    "rows": [{"name": "prisms, order 3", "error": 0.0021}, {"name": "order 4", "error": 0.0005}],
    "none": None,
}


@pytest.mark.parametrize(
    ("template", "expected"),
    [
        ("{bench:gain_m_per_V*1e6:.2f} um/V", "21.55 um/V"),
        ("{bench:n_dofs:,d} and {bench:n_dofs*1e-3:.1f}", "88 854 and 88.9"),
        ("{bench:5_kg_Hz/0:.2f} {bench:5_kg_Hz/min:.0f} {bench:5_kg_Hz/max:.1f}", "94.91 95 401.5"),
        ("{bench:rows/prisms, order 3/error*100:.2f} %", "0.21 %"),
        ("`{bench:command}`", "`python scripts/bench.py --quick`"),
        ('{"a": 1} {x} {} ${y}$', '{"a": 1} {x} {} ${y}$'),
        ("{bench:n_dofs}\n```python\nf'{x:n:.2f}'\n```\n{bench:n_dofs}", "88854\n```python\nf'{x:n:.2f}'\n```\n88854"),
    ],
)
def test_placeholders(template, expected):
    assert docs.render(template, {"bench": FIGURE}) == expected


@pytest.mark.parametrize(
    ("template", "message"),
    [
        ("{run:n_dofs}", r"\{run:n_dofs\}: there is no docs/figures/run\.json"),
        ("{bench:gain}", r"there is no figure 'gain': KeyError\('gain'\)"),
        ("{bench:5_kg_Hz/2}", r"there is no figure '5_kg_Hz/2'"),
        ("{bench:rows/order 5/error}", r"no figure 'rows/order 5/error': .* at 'order 5'"),
        ("{bench:rows}", "'rows' is no figure but list"),
        ("{bench:none}", "'none' is no figure but NoneType"),
        ("{bench:n_dofs:.2q}", r"\{bench:n_dofs:\.2q\}: "),
    ],
)
def test_placeholders_without_a_figure_are_named(template, message):
    with pytest.raises(ValueError, match=message):
        docs.render(template, {"bench": FIGURE})


TEXT = """# A bench of 5 kg and 36 coordinates, 89 000 before
Order 3, five points, Table 1, UFF 58, the APA300ML; pole at 94.91 Hz, gain 1e-3,
zero at 31 Hz (45 kg), 12 % less, `0.5 in code`, [a link](docs/1.23.png), {bench:n_dofs*1e6:.2f} Hz; 4910 in all.
```python
x = 1.25
```
| trimmed | 92 | 5
kg |
"""


def test_typed_figures_are_found():
    found = ["line 1: 36", "line 1: 89 000", "line 2: 94.91", "line 2: 1e-3", "line 3: 31", "line 3: 45", "line 3: 12"]
    assert docs.typed_figures(TEXT, {"5 kg": "payload"}) == [*found, "line 3: 4910", "line 7: 92"]
    assert docs.typed_figures(TEXT, {"5 kg": "", "31 Hz (45 kg)": ""})[4] == "line 3: 12"


def test_summaries_are_collected_under_their_commands_name(tmp_path):
    def results(name, command):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(json.dumps({"command": command, "x_Hz": 1.0}))
        return tmp_path / name

    path = docs.collect(results("bench-coarse", "python scripts/bench.py --coarse"), tmp_path)
    assert path == tmp_path / "bench-coarse.json"
    assert docs.load_figures(tmp_path)["bench-coarse"]["x_Hz"] == 1.0
    with pytest.raises(ValueError, match="call the folder <script> or <script>-<variant>"):
        docs.collect(results("other", "python scripts/bench.py"), tmp_path)
    for file in ("/tmp/record.csv", "'/home/a b/record.csv'", "--file=/tmp/record.csv", "C:/record.csv"):
        with pytest.raises(ValueError, match="outside the repository"):
            docs.collect(
                results(f"identify-{len(list(tmp_path.iterdir()))}", f"python scripts/identify.py {file}"), tmp_path
            )


def test_check_tells_stale_documents(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(docs, "ROOT", tmp_path)
    (tmp_path / "docs" / "templates").mkdir(parents=True)
    (tmp_path / "docs" / "templates" / "README.md").write_text("seven")
    (tmp_path / "docs" / "templates" / "page.md").write_text("eight")

    def status(*options):
        monkeypatch.setattr("sys.argv", ["render.py", *options])
        return docs.main()

    assert status("--check") == 1
    assert "README.md is not what its template gives" in capsys.readouterr().out
    assert not (tmp_path / "README.md").exists()
    assert status() == 0
    assert (tmp_path / "README.md").read_text().endswith("change that. -->\nseven")
    assert (tmp_path / "docs" / "page.md").exists()
    assert status("--check") == 0
    (tmp_path / "README.md").write_text("edited")
    assert status("--check") == 1
