"""Views as scripts leave them: a page for the browser, and a picture where PyVista is installed."""

from pathlib import Path
from typing import Any

from nassim.viewer import View, save_picture, write_page


def show(view: View, path: Path, **picture: Any) -> None:
    """Write path.html and path.png; a picture that cannot be is told in a line. picture: as of `save_picture`."""
    write_page(view, path.with_suffix(".html"))
    try:
        save_picture(view, path.with_suffix(".png"), **picture)
    except ImportError as error:
        print(f"no {path.name}.png: {error}")
