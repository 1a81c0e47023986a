"""Build the site in build/site: run the gallery's scripts, build pages with warnings as errors, check links.

    python docs/build.py                          build all; results of scripts are kept until the code changes
    python docs/build.py --only import_body       run only these scripts; without a name: build pages only

Needs `pip install -e ".[docs]"` and no network; open build/site/index.html.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parent.parent
SITE = ROOT / "build" / "site"
sys.path.insert(0, str(ROOT / "docs" / "extensions"))

import gallery  # noqa: E402
from sphinx.cmd.build import main as sphinx  # noqa: E402


class Page(HTMLParser):
    """Anchors of a page, its links, and the files that it loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors, self.links, self.loads = set[str](), list[str](), list[str]()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect ids, names and addresses."""
        found = {name: value for name, value in attrs if value}
        self.anchors.update(found[name] for name in ("id", "name") if name in found)
        self.links += [found["href"]] if "href" in found and tag == "a" else []
        self.loads += [found[name] for name in ("src", "href") if name in found and tag not in ("a", "base")]


def dead_links(site: Path) -> Iterator[str]:
    """Yield links to nothing on the site, and files that pages load from other sites."""
    skipped = site / "_static"
    pages = {path: Page(path) for path in sorted(site.rglob("*.html")) if skipped not in path.parents}
    for path, page in pages.items():
        yield from (f"{path.relative_to(site)} loads {load}" for load in page.loads if urlsplit(load).netloc)
        for link in {*page.links, *page.loads}:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            known = pages[target].anchors if target in pages else None
            if not target.exists() or (parts.fragment and known is not None and unquote(parts.fragment) not in known):
                yield f"{path.relative_to(site)}: {link} leads nowhere"


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", metavar="SCRIPT", help="scripts of the gallery to run (default: all)")
    parser.add_argument("--thumbnails", action="store_true", help="store the pictures of the gallery's cards anew")
    args = parser.parse_args()
    begin = time.monotonic()
    runs = [run for run in gallery.runs() if args.only is None or run.folder.name in args.only]
    unknown = {*(args.only or ())} - {run.folder.name for run in runs}
    if unknown:
        parser.error(f"no page of the gallery runs {', '.join(sorted(unknown))}")
    problems = gallery.make(runs)
    if args.thumbnails:
        gallery.store_thumbnails()
    status = 0
    if not problems:
        doctrees = str(ROOT / "build" / "doctrees")
        status = sphinx(["-W", "--keep-going", "-q", "-d", doctrees, str(ROOT / "docs"), str(SITE)])
        problems = list(dead_links(SITE)) if status == 0 else []
    print(*problems, sep="\n", end="\n" if problems else "")
    if status or problems:
        return 1
    print(f"{SITE / 'index.html'} written in {time.monotonic() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
