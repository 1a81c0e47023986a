"""One HTML file of a view, which opens by a double click, without a network or other files.

`page/` contains its template, its programs `viewer.js`, `marks.js` and `stage.js`, which need no build step, and
three.js 0.184.0 as published (MIT; https://threejs.org). Data and library are compressed by gzip, which browsers can
decompress since 2023.
"""

import base64
import gzip
import html
import json
from importlib.resources import files
from pathlib import Path

from nassim.base.checks import of_kind
from nassim.base.storage import write_atomically
from nassim.viewer.encoding import encode
from nassim.viewer.view_content import View

LIBRARY = {
    "three": "three/three.module.min.js",
    "three-core": "three/three.core.min.js",
    "orbit": "three/OrbitControls.js",
    "marks": "marks.js",
    "stage": "stage.js",
}
"""Modules that the page imports, and their files."""


def write_page(view: View, path: str | Path) -> Path:
    """Write a view as one HTML file.

    Args:
        view: the view.
        path: file to write.

    Returns:
        Path of the file.
    """
    of_kind("view", view, View, "view_scene, view_modes and others make one")
    target = Path(path)
    with write_atomically(target) as temporary:
        temporary.write_text(page_text(view), encoding="utf-8")
    return target


def page_text(view: View) -> str:
    """Return the HTML file of a view as text.

    Args:
        view: the view.
    """
    header, data = encode(view)
    folder = files("nassim.viewer") / "page"
    library = {name: (folder / file).read_text(encoding="utf-8") for name, file in LIBRARY.items()}
    # Modules inside the page cannot import others by a relative path, so that they import them by name.
    library["three"] = library["three"].replace("./three.core.min.js", "three-core")
    parts = {
        "title": html.escape(view.title),
        "header": json.dumps(header, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "data": _packed(data),
        "library": "\n".join(
            f'<script type="text/plain" class="library" data-name="{name}">{_packed(text.encode())}</script>'
            for name, text in library.items()
        ),
        "program": (folder / "viewer.js").read_text(encoding="utf-8"),
    }
    text = (folder / "viewer.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"<!--{name}-->", part)
    return text


def _packed(data: bytes) -> str:
    # Without the time of writing, so that equal views give equal files, bit for bit.
    return base64.b64encode(gzip.compress(data, mtime=0)).decode()
