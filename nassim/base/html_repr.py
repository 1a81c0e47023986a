"""HTML representations of data classes for notebooks.

What draws them imports far more than the data classes do. The table names it as text, so that imports still go one way.
"""

import importlib
from typing import Any

DISPLAYS = {
    "FRF": "nassim.plotting.notebook:frf_html",
    "ReducedBody": "nassim.viewer.notebook:body_html",
    "Scene": "nassim.viewer.notebook:scene_html",
    "TimeHistory": "nassim.plotting.notebook:history_html",
    "View": "nassim.viewer.notebook:view_html",
}
"""Name of a data class -> function that returns its HTML, as "module:function"."""


def html_repr(data: Any) -> str:
    """Return a data class as HTML. Write `_repr_html_ = html_repr` in the class.

    Args:
        data: instance of a data class in `DISPLAYS`
    """
    module, function = DISPLAYS[type(data).__name__].split(":")
    return getattr(importlib.import_module(module), function)(data)
