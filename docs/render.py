"""Write README.md, pages of docs/ and docs/tour.ipynb from docs/templates.

Each figure comes from the summary.json of a command.

    python docs/render.py                              write README.md, the pages and docs/tour.ipynb
    python docs/render.py --check                      exit with status 1 where they are not what the templates give
    python docs/render.py --collect results/run_bench  copy a summary to docs/figures/run_bench.json, then write

A template writes {script:key}, {script:key:format} or {script:key*factor:format}, for example
{run_bench:static_gain_m_per_V*1e6:.2f}. The script is that of docs/figures/<script>[-variant].json; the key is a path
with slashes, whose steps into a list are an index, the "name" of an entry, min or max. {script:command} is the command
that made the figures; it must stand in the section that quotes them. A "," in the format separates thousands by blanks.
Fenced code stays as it is. Figures that no command makes (settings, values of a vendor or
a paper) are in docs/given.json, each with its source.
"""

import argparse
import json
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
FIGURES = ROOT / "docs" / "figures"
PLACEHOLDER = re.compile(r"\{([\w-]+):([^{}:*\n]+)(?:\*([\d.e+-]+))?(?::([^{}\n]*))?\}")
CODE_BLOCK = re.compile(r"^```.*?^```$", re.M | re.S)
NO_TEXT = re.compile(r"\$\$.*?\$\$|\$[^$\n]+\$|`[^`]*`|\]\([^)]*\)|<!--.*?-->", re.S)
PYTHON_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.M | re.S)
LINK = re.compile(r"\]\((?=docs/|scripts/|models/)")
TOUR = "A tour of the chain"
SHOWN = (("body",), ("bench", "estimated", "predicted"), ('view_modes(apa, fixed=["bottom"])',))
"""Expressions that cells of the notebook show after each block of the README's tour."""
UNITS = r"%|[kM]?Hz|[kMG]?Pa|[mu]?[msN]|nm|[km]?g|[mk]?V|[um]?F|[kM]?Ohm|[kMG]B|dB|deg|rpm|times|percent|coordinates"
NUMBER = re.compile(
    rf"(?<![\w.])\d+(?:(?: \d{{3}})+|\d\d|(?:\.\d+)?e[+-]?\d+|\.\d+|(?=\s?(?:{UNITS})(?!\w)|\s*\|))(?!\d)"
)
"""Numbers that are figures: with a decimal point, an exponent, a unit, grouped thousands, three digits and more, or at
the end of a table's cell."""


def value_of(summary: Mapping[str, Any], path: str) -> Any:
    """What stands in a summary under a path; raises ValueError for none and for what is neither number nor text."""
    value: Any = summary
    try:
        for step in path.split("/"):
            if isinstance(value, Mapping):
                value = value[step]
            elif step in ("min", "max"):
                value = min(value) if step == "min" else max(value)
            elif step.isdecimal():
                value = value[int(step)]
            else:
                (value,) = (entry for entry in value if entry["name"] == step)
    except (LookupError, TypeError, ValueError) as error:
        raise ValueError(f"there is no figure {path!r}: {error!r} at {step!r}") from error
    if not isinstance(value, (int, float, str)):
        raise ValueError(f"{path!r} is no figure but {type(value).__name__}")
    return value


def render(template: str, figures: Mapping[str, Mapping[str, Any]]) -> str:
    """A template with its figures; raises ValueError naming a placeholder that has none."""

    def fill(match: re.Match[str]) -> str:
        script, path, factor, form = match.groups()
        try:
            if script not in figures:
                raise ValueError(f"there is no docs/figures/{script}.json")
            value = value_of(figures[script], path)
            if isinstance(value, str):
                return format(value, form or "")
            return format(value * float(factor) if factor else value, form or "").replace(",", " ")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{match[0]}: {error}") from error

    text, place = "", 0
    for block in CODE_BLOCK.finditer(template):
        text += PLACEHOLDER.sub(fill, template[place : block.start()]) + block[0]
        place = block.end()
    return text + PLACEHOLDER.sub(fill, template[place:])


def typed_figures(template: str, given: Mapping[str, str]) -> list[str]:
    """Figures that stand in a template's text as numbers, each with its line, but for those given."""
    text = template
    phrases = [re.escape(phrase).replace(r"\ ", r"\s+") for phrase in sorted(given, key=len, reverse=True)]
    known = [re.compile(rf"(?<![\w.]){phrase}(?!\w|\.\d)") for phrase in phrases]
    for pattern in (CODE_BLOCK, NO_TEXT, PLACEHOLDER, *known):
        text = pattern.sub(lambda match: "\n" * match[0].count("\n"), text)
    return [f"line {text.count(chr(10), 0, m.start()) + 1}: {m[0]}" for m in NUMBER.finditer(text)]


def sections(text: str) -> list[str]:
    """Split a text before its headings of second level."""
    return re.split(r"^(?=## )", text, flags=re.M)


def load_figures(folder: Path = FIGURES) -> dict[str, dict[str, Any]]:
    """Load the summaries in docs/figures, by name."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}


def documents() -> Iterator[tuple[Path, Path, str]]:
    """Yield each template, its target file, and the text of the target."""
    figures, folder = load_figures(), ROOT / "docs" / "templates"
    for template in sorted(folder.rglob("*.md")):
        name = template.relative_to(folder).as_posix()
        target = ROOT / name if name == "README.md" else ROOT / "docs" / name
        note = f"<!-- Made by `python docs/render.py` from docs/templates/{name}: change that. -->\n"
        text = render(template.read_text(encoding="utf-8"), figures)
        yield template, target, note + text
        for section in sections(text):
            if name == "README.md" and section.startswith(f"## {TOUR}"):
                yield template, ROOT / "docs" / "tour.ipynb", notebook(section)


def notebook(section: str) -> str:
    """The README's tour as a Jupyter notebook, not executed, that also shows what the code of each block makes."""
    cells, place = [_cell(f"# nassim: {TOUR[0].lower()}{TOUR[1:]}")], section.index("\n")
    for block, shown in zip(PYTHON_BLOCK.finditer(section), SHOWN, strict=True):
        code = (block[1].strip(), *shown)
        cells += [_cell(section[place : block.start()]), *(_cell(text, code=True) for text in code)]
        place = block.end()
    cells.append(_cell(section[place:]))
    metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    numbered = [{**cell, "id": f"cell-{k}"} for k, cell in enumerate(cells)]
    return json.dumps({"cells": numbered, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _cell(text: str, *, code: bool = False) -> dict[str, Any]:
    source = LINK.sub(r"](../", text.strip()).splitlines(keepends=True)
    if not code:
        return {"cell_type": "markdown", "metadata": {}, "source": source}
    return {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": source}


def collect(results: Path, folder: Path = FIGURES) -> Path:
    """Copy the summary of a folder of results, <script> or <script>-<variant>, to the figures; returns its new path.

    Raises ValueError if another script made it, or from files that only this computer has.
    """
    source = results / "summary.json"
    command = json.loads(source.read_text(encoding="utf-8")).get("command", "")
    if f"/{results.name.partition('-')[0]}.py" not in command:
        raise ValueError(f"{source} was made by {command!r}; call the folder <script> or <script>-<variant>")
    if re.search(r"[ ='](/|[A-Za-z]:)", command):
        raise ValueError(f"{source} was made by {command!r}, from files that lie outside the repository")
    return Path(shutil.copyfile(source, folder / f"{results.name}.json"))


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing, exit with status 1 where files differ")
    parser.add_argument("--collect", type=Path, nargs="+", default=[], metavar="DIR", help="folders of results")
    args = parser.parse_args()
    try:
        for results in args.collect:
            print(f"{collect(results.resolve())} written")
        stale = [(target, text) for _, target, text in documents() if not _holds(target, text)]
    except (OSError, ValueError) as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    for target, text in stale:
        print(f"{target} {'is not what its template gives' if args.check else 'written'}")
        if not args.check:
            target.write_text(text, encoding="utf-8")
    return int(bool(args.check and stale))


def _holds(target: Path, text: str) -> bool:
    return target.exists() and target.read_text(encoding="utf-8") == text


if __name__ == "__main__":
    sys.exit(main())
