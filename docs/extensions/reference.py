"""The reference: every name at a wing's door, its docstring in plain prose made readable.

    ```{wing} nassim.signals
    ```

Our docstrings are prose in which a line `name: meaning [unit]` tells an argument or a field; these become lists of
terms, names in backticks links, and what is set apart and indented stays as it is.
"""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Collection
from dataclasses import fields, is_dataclass
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import nassim

WINGS = [module.name for module in pkgutil.iter_modules(nassim.__path__)]
NAME = r"[A-Za-z_]\w*(?: \([^)]*\))?(?: \[[^\]]*\])?"
TERM = re.compile(rf"^({NAME}(?:, {NAME})*)[:;] (.*)$")
ARRAY_LIKE = re.compile(r"[\w~.]*Buffer \| .*?NestedSequence\[complex \| bytes \| str\]")
ALIAS = re.compile(r"[\w~.]*Annotated\[[^,]*(?:\[[^]]*\])?, '(\w+)'\]")
ARRAY = re.compile(r"[\w~.]*ndarray\[tuple\[[^]]*\], [\w~.]*dtype\[([^]]*)\]\]")
SHORT = {"complex128": "ComplexArray", "bool": "BoolArray", "bool_": "BoolArray", "int64": "IntArray"}


def public_names(module: str) -> list[str]:
    """The names at the door of a wing, or those that a module without a door defines."""
    found = importlib.import_module(module)
    names = getattr(found, "__all__", None) or [
        name for name, value in vars(found).items() if getattr(value, "__module__", "") == module and name[0] != "_"
    ]
    return sorted(names, key=lambda name: (not name[0].isupper(), name.lower()))


def _homes() -> dict[str, str]:
    return {
        name: f"nassim.{wing}.{name}"
        for wing in WINGS
        for name in public_names(f"nassim.{wing}")
        if not inspect.ismodule(getattr(importlib.import_module(f"nassim.{wing}"), name))
    }


class Wing(SphinxDirective):
    """What a wing is for, and each of its public names."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Let autodoc document them."""
        module = self.arguments[0]
        found = importlib.import_module(module)
        lines = [*to_rst(inspect.getdoc(found) or ""), ""]
        for name in public_names(module):
            value = getattr(found, name)
            if inspect.ismodule(value):
                continue
            if inspect.isclass(value):
                lines += [f".. autoclass:: {module}.{name}", "   :members:", ""]
            elif inspect.isroutine(value):
                lines += [f".. autofunction:: {module}.{name}", ""]
            else:
                lines += [f".. py:data:: {module}.{name}", ""]
        text = "```{eval-rst}\n" + "\n".join(lines) + "\n```"
        return self.parse_text_to_nodes(text)


def to_rst(docstring: str, names: Collection[str] = ()) -> list[str]:
    """A docstring as lines of reStructuredText; names: of the arguments, or fields, that its lines may tell."""
    result: list[str] = []
    docstring = re.sub(r"`[^`]*`", lambda match: " ".join(match[0].split()), docstring)
    for paragraph in re.split(r"\n\s*\n", docstring.strip("\n")):
        lines = paragraph.split("\n")
        if lines[0].startswith("    "):
            result += ["::", "", *lines, ""]
        elif lines[0].startswith("- "):
            result += [*map(inline, lines), ""]
        else:
            result += [*_terms(lines, {*names, "Source"}), ""]
    return result


def _terms(lines: list[str], names: set[str]) -> list[str]:
    """A paragraph, whose lines `name: meaning; other: meaning` become terms with their definitions."""
    result: list[str] = []
    inside = False
    begin = re.compile(rf"; (?=(?:{'|'.join(map(re.escape, names))})\b[^:;]*: )")
    for line in (part for whole in lines for part in begin.split(whole)):
        match = TERM.match(line)
        told = {name.split(" ")[0] for name in re.split(r", (?=[A-Za-z_])", match[1])} if match else set()
        if match and told <= names:
            result += [] if inside or not result else [""]
            result += [match[1] if told == {"Source"} else f"``{match[1]}``", "    " + inline(match[2])]
            inside = True
        else:
            result.append(("    " if inside else "") + inline(line.strip()))
    return result


def inline(text: str) -> str:
    """A line of prose: backticks are code, or a link where they name something public; no other markup."""
    parts = re.split(r"`([^`]*)`", text)
    result = ""
    for place, part in enumerate(parts):
        between = "\\ " if place % 2 == 0 and result and part[:1].isalnum() else ""
        result += _code(part) if place % 2 else between + _escaped(part)
    return result


def _code(text: str) -> str:
    first, *rest = text.removeprefix("nassim.").split(".")
    path = HOMES.get(first)
    if path is None and rest and first in WINGS:
        path = HOMES.get(rest[0])
        rest = rest[1:]
    if path is None or rest:
        return f"``{text}``"
    return f":py:obj:`{text} <{path}>`"


def _escaped(text: str) -> str:
    return re.sub(r"([\\*|])|_(?!\w)", lambda match: f"\\{match[0]}", text)


def _process_docstring(_app: Sphinx, _what: str, _name: str, value: Any, _options: Any, lines: list[str]) -> None:
    own = inspect.isclass(value) and (value.__doc__ or "").startswith(f"{value.__name__}(")
    names = tuple(inspect.signature(value).parameters) if inspect.isfunction(value) else ()
    names = tuple(field.name for field in fields(value)) if is_dataclass(value) else names
    lines[:] = [] if own else to_rst("\n".join(lines), names)


def _process_signature(
    _app: Sphinx, _what: str, _name: str, _value: Any, _options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    return _shortened(signature), _shortened(returned)


def _shortened(text: str | None) -> str | None:
    """Types as the sources write them."""
    if text is None:
        return None
    text = ARRAY.sub(lambda match: SHORT.get(match[1].split(".")[-1].strip("~"), "Array"), text)
    text = ARRAY_LIKE.sub("ArrayLike", text)
    text = ALIAS.sub(lambda match: match[1].capitalize(), text)
    return re.sub(r"<function (\w+) at 0x\w+>", r"\1", text)


def _shorten_types(_app: Sphinx, document: nodes.document) -> None:
    """The types of properties, which no signature holds."""
    for node in document.findall(addnodes.desc_annotation):
        text = node.astext()
        if (short := _shortened(text)) != text:
            node.children = []
            node.append(nodes.Text(short))


HOMES = _homes()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register directive and hooks."""
    app.add_directive("wing", Wing)
    app.connect("autodoc-process-docstring", _process_docstring)
    app.connect("autodoc-process-signature", _process_signature)
    app.connect("doctree-read", _shorten_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
