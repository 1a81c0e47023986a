"""The gallery: reports, pictures and figures of scripts, which run while the pages are built.

    ```{script} run_bench.py --duration 8
    ```

This directive shows the script's docstring, its command, its pictures, its report, its figures and its source.
`python docs/build.py` runs the commands of all pages. Their results stay in `build/gallery` until the code changes.
With `:not-run: why` a script is shown but not run.
"""

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import directives
from PIL import Image
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "build" / "gallery"
PAGES = ROOT / "docs" / "gallery"
THUMBNAILS = PAGES / "thumbnails"
DIRECTIVE = re.compile(r"^```\{script\} (.+)\n((?::.*\n)*)```", re.M)


@dataclass(frozen=True)
class Run:
    """A script with its options, as a page names them."""

    command: str

    @property
    def script(self) -> str:
        """Return the name of the script's file."""
        return shlex.split(self.command)[0]

    @property
    def folder(self) -> Path:
        """Return the folder of its results."""
        return RESULTS / Path(self.script).stem

    @property
    def key(self) -> str:
        """Return a hash of all that the results depend on: the command and the code."""
        return hashlib.sha256(f"{self.command}\n{code()}".encode()).hexdigest()

    @property
    def done(self) -> bool:
        """Tell whether there are results of this code."""
        try:
            return (self.folder / "key").read_text() == self.key
        except OSError:
            return False

    def make(self) -> str:
        """Run the script; return an empty text, or the error."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        script, *options = shlex.split(self.command)
        one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NGS")}
        paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        result = subprocess.run(
            [sys.executable, f"scripts/{script}", *options, "--output", str(self.folder)],
            cwd=ROOT,
            env={**os.environ, **one_thread, "NASSIM_THREADS": "1", "MPLBACKEND": "Agg", "PYTHONPATH": paths},
            capture_output=True,
            text=True,
            encoding="utf-8",
            check=False,
        )
        if result.returncode:
            return f"{self.command} ends with status {result.returncode}\n{result.stderr[-2000:]}"
        (self.folder / "report.txt").write_text(_without_places(result.stdout), encoding="utf-8")
        (self.folder / "key").write_text(self.key)
        return ""


def _without_places(report: str) -> str:
    """Return a report without the paths of this computer."""
    lines = [line for line in report.splitlines() if not re.search(r"^results in |: (loaded from|saved to) ", line)]
    return "\n".join(lines).replace(f"{ROOT}/", "").strip("\n") + "\n"


@cache
def code() -> str:
    """Return the SHA-256 of the package, the models and the scripts."""
    digest = hashlib.sha256()
    for folder in ("nassim", "models", "scripts"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def runs_of(page: str) -> list[Run]:
    """Return the runs of a page, without those that are not to be run."""
    return [Run(match[1].strip()) for match in DIRECTIVE.finditer(page) if ":not-run:" not in match[2]]


def runs() -> list[Run]:
    """Return the runs of all pages."""
    return [run for page in sorted(PAGES.glob("*.md")) for run in runs_of(page.read_text(encoding="utf-8"))]


def make(wanted: list[Run]) -> list[str]:
    """Run all that has no results of this code, two at a time; return the errors."""
    missing = [run for run in wanted if not run.done]

    def told(run: Run) -> str:
        print(f"gallery: {run.command}", flush=True)
        return run.make()

    with ThreadPoolExecutor(2) as pool:
        return list(filter(None, pool.map(told, missing)))


class Script(SphinxDirective):
    """Directive: a script and its results."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {"not-run": directives.unchanged_required}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        """Return the nodes of the page."""
        run = Run(self.arguments[0].strip())
        source = ROOT / "scripts" / run.script
        self.env.note_dependency(str(source))
        self.env.note_dependency(str(run.folder / "key"))
        why = self.options.get("not-run", "")
        text = source.read_text(encoding="utf-8")
        docstring = text.split('"""')[1].strip()
        parts = [docstring, f"```bash\npython scripts/{run.command}\n```"]
        if why:
            parts.append(f"*Not run while these pages were built: {why}.*")
        elif run.done:
            parts += _results(run)
        else:
            parts.append("*Not run in this build of the pages.*")
        parts.append(f"**Source**, `scripts/{run.script}`\n\n````python\n{text}\n````")
        return self.parse_text_to_nodes("\n\n".join(parts))


def _results(run: Run) -> list[str]:
    """Yield pictures, pages, report and figures."""
    name = run.folder.name
    parts = [f"![{path.stem}](/../build/gallery/{name}/{path.name})" for path in sorted(run.folder.glob("*.png"))]
    for path in sorted(run.folder.glob("*.html")):
        place = f"../_static/gallery/{name}/{path.name}"
        parts.append(
            f'<iframe class="viewer" src="{place}" title="{path.stem}" loading="lazy"></iframe>\n'
            f'<p><a href="{place}">{path.stem} in a window of its own</a></p>'
        )
    parts.append(f"**What it prints**\n\n````text\n{(run.folder / 'report.txt').read_text(encoding='utf-8')}````")
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    figures = json.dumps(summary, indent=1, ensure_ascii=False)
    title = "All its figures: summary.json"
    parts.append(f"<details><summary>{title}</summary>\n\n````json\n{figures}\n````\n\n</details>")
    return parts


class Cards(SphinxDirective):
    """Directive: a card for each page of this folder, with picture, title and purpose."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the cards, in the order of the directive's lines."""
        self.assert_has_content()
        cards = []
        for name in filter(None, map(str.strip, self.content)):
            page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
            title = page.splitlines()[0].removeprefix("# ")
            for path in (PAGES / f"{name}.md", *(run.folder / "key" for run in runs_of(page))):
                self.env.note_dependency(str(path))
            picture = f"[![{title}]({thumb})]({name}.md)\n\n" if (thumb := _thumbnail(page)) else ""
            said = page.split("\n\n")[1].replace("\n", " ")
            cards.append(f":::{{container}} card\n{picture}[{title}]({name}.md)\n\n{said}\n:::")
        return self.parse_text_to_nodes("::::{container} cards\n" + "\n".join(cards) + "\n::::")


def _thumbnail(page: str) -> str:
    """Return the picture of a page's card as a path of Sphinx: of this build, or the stored one; empty without any."""
    built = [path for run in runs_of(page) if run.done for path in sorted(run.folder.glob("*.png"))]
    stored = [
        path for run in DIRECTIVE.finditer(page) if (path := THUMBNAILS / f"{Run(run[1]).folder.name}.png").exists()
    ]
    return next((f"/{os.path.relpath(path, ROOT / 'docs')}" for path in (*built, *stored)), "")


def store_thumbnails() -> None:
    """Store small copies of the first picture of each script for builds that do not run it."""
    for folder in sorted(path.parent for path in RESULTS.glob("*/key")):
        for path in sorted(folder.glob("*.png"))[:1]:
            picture = Image.open(path).convert("RGB")
            picture.thumbnail((480, 320))
            picture.quantize(64).save(THUMBNAILS / f"{folder.name}.png", optimize=True)


def _copy_pages(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        for path in RESULTS.glob("*/*.html"):
            target = Path(app.outdir) / "_static" / "gallery" / path.parent.name / path.name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("script", Script)
    app.add_directive("cards", Cards)
    app.connect("build-finished", _copy_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
