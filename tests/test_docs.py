"""README and docs hold what their templates give, and every figure in them comes from a summary that a command made."""

import importlib
import importlib.util
import json
import re
import shlex
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
spec = importlib.util.spec_from_file_location("render", ROOT / "docs" / "render.py")
docs = importlib.util.module_from_spec(spec)
spec.loader.exec_module(docs)

GIVEN = json.loads((ROOT / "docs" / "given.json").read_text(encoding="utf-8"))
TEMPLATES = sorted((ROOT / "docs" / "templates").glob("*.md"))
FIGURES = docs.load_figures()


def test_documents_are_what_their_templates_give():
    for template, target, text in docs.documents():
        assert target.read_text(encoding="utf-8") == text, f"run python docs/render.py (for {template.name})"


def test_every_document_has_a_template_or_a_command():
    made = {target for _, target, _ in docs.documents()} | {ROOT / "docs" / "hard_cases.md"}
    assert set((ROOT / "docs").glob("*.md")) | {ROOT / "README.md"} == made


@pytest.mark.parametrize("template", TEMPLATES, ids=[path.name for path in TEMPLATES])
def test_no_figure_is_typed(template):
    typed = docs.typed_figures(template.read_text(encoding="utf-8"), GIVEN)
    assert not typed, "take them from a summary, or enter them in docs/given.json with their source"


def test_every_given_figure_is_used_and_has_a_source():
    text = "\n".join(path.read_text(encoding="utf-8") for path in TEMPLATES)
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
