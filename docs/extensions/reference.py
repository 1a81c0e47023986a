"""The reference: every public name of a sub-package, from its docstring.

    ```{subpackage} nassim.signals
    ```

Docstrings are plain text with sections of Google's style, which Sphinx's napoleon reads. Backticks in them become code,
or links where they name something public, and other characters stay as they are.
"""

import importlib
import inspect
import pkgutil
import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import nassim
from nassim.scene.field_kinds import FieldKind

PACKAGES = [module.name for module in pkgutil.iter_modules(nassim.__path__) if module.ispkg]
SECTION = re.compile(r"[A-Z]\w+:\n")
TYPE = re.compile(r"(?<![~\w.])(?:[a-z_]\w*\.)+[A-Z]\w*")
ARRAY = re.compile(r"[\w~.]*ndarray\[tuple\[[^]]*\], [\w~.]*dtype\[([^]]*)\]\]")
SHORT = {"complex128": "ComplexArray", "bool": "BoolArray", "bool_": "BoolArray", "int64": "IntArray"}


def public_names(module: str) -> list[str]:
    """Return the names that a sub-package exports, or those that a module without `__all__` defines."""
    found = importlib.import_module(module)
    names = getattr(found, "__all__", None) or [
        name for name, value in vars(found).items() if getattr(value, "__module__", "") == module and name[0] != "_"
    ]
    return sorted(names, key=lambda name: (not name[0].isupper(), name.lower()))


def _homes() -> dict[str, str]:
    return {
        name: f"nassim.{package}.{name}"
        for package in PACKAGES
        for name in public_names(f"nassim.{package}")
        if not inspect.ismodule(getattr(importlib.import_module(f"nassim.{package}"), name))
    }


class SubPackage(SphinxDirective):
    """Directive: the purpose of a sub-package, and each of its public names."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Let autodoc document them."""
        module = self.arguments[0]
        found = importlib.import_module(module)
        lines = [to_rst(inspect.getdoc(found) or ""), ""]
        for name in public_names(module):
            value = getattr(found, name)
            if inspect.ismodule(value):
                continue
            if isinstance(value, FieldKind):
                lines += [f".. py:data:: {module}.{name}", ""]
            elif inspect.isclass(value):
                lines += [f".. autoclass:: {module}.{name}", "   :members:", ""]
            elif inspect.isroutine(value):
                lines += [f".. autofunction:: {module}.{name}", ""]
            else:
                lines += [f".. py:data:: {module}.{name}", ""]
        text = "```{eval-rst}\n" + "\n".join(lines) + "\n```"
        return self.parse_text_to_nodes(text)


def to_rst(docstring: str) -> str:
    """Turn a docstring into what napoleon reads.

    Backticks become code or links. Characters that reStructuredText would read as markup are escaped. Paragraphs with
    indented lines, other than sections, keep their lines.
    """
    text = inline(re.sub(r"`[^`]*`", lambda match: " ".join(match[0].split()), docstring))
    paragraphs = re.split(r"\n\s*\n", text.strip("\n"))
    return "\n\n".join(part if SECTION.match(part) else _kept_lines(part) for part in paragraphs)


def _kept_lines(paragraph: str) -> str:
    indented = re.search(r"^ ", paragraph, re.M)
    return re.sub(r"^ *", "| ", paragraph, flags=re.M) if indented else paragraph


def inline(text: str) -> str:
    """Mark up prose: backticks are code, or a link where they name something public; there is no other markup."""
    parts = re.split(r"`([^`]*)`", text)
    result = ""
    for place, part in enumerate(parts):
        between = "\\ " if place % 2 == 0 and result and part[:1].isalnum() else ""
        result += _code(part) if place % 2 else between + _escaped(part)
    return result


def _code(text: str) -> str:
    first, *rest = text.removeprefix("nassim.").split(".")
    path = HOMES.get(first)
    if path is None and rest and first in PACKAGES:
        path = HOMES.get(rest[0])
        rest = rest[1:]
    if path is None or rest:
        return f"``{text}``"
    return f":py:obj:`{text} <{path}>`"


def _escaped(text: str) -> str:
    return re.sub(r"([\\*|])|_(?!\w)", lambda match: f"\\{match[0]}", text)


def _process_docstring(_app: Sphinx, _what: str, _name: str, value: Any, _options: Any, lines: list[str]) -> None:
    generated = inspect.isclass(value) and (value.__doc__ or "").startswith(f"{value.__name__}(")
    lines[:] = [] if generated else to_rst("\n".join(lines)).split("\n")


def _process_signature(
    _app: Sphinx, _what: str, _name: str, _value: Any, _options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    return _shortened(signature and TYPE.sub(r"~\g<0>", signature)), _shortened(returned)


def _shortened(text: str | None) -> str | None:
    """Shorten types to the names in the sources."""
    if text is None:
        return None
    text = ARRAY.sub(lambda match: SHORT.get(match[1].split(".")[-1].strip("~"), "Array"), text)
    text = re.sub(r"[\w~.]*\bndarray\b(?!\[)", "Array", text)
    text = text.replace("<factory>", "...")
    return re.sub(r"<function (\w+)[^>]*>", r"\1", text)


def _shorten_types(_app: Sphinx, document: nodes.document) -> None:
    """Shorten the types of properties, which are in no signature."""
    for node in document.findall(addnodes.desc_annotation):
        text = node.astext()
        if (short := _shortened(text)) != text:
            node.children = []
            node.append(nodes.Text(short))


HOMES = _homes()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register directive and hooks."""
    app.add_directive("subpackage", SubPackage)
    app.connect("autodoc-process-docstring", _process_docstring, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", _process_signature)
    app.connect("doctree-read", _shorten_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
