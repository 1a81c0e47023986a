"""Formulas as MathML, which browsers draw without a script, a font or a network.

docutils, which Sphinx is based on, converts LaTeX to MathML. A command that it does not know is a warning, so
an error of the build.
"""

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)


def converted(node: nodes.math | nodes.math_block, *, block: bool) -> str:
    """Convert a formula to MathML."""
    try:
        return tex2mathml(node.astext(), as_block=block)
    except MathError as error:
        logger.warning("no MathML for %r: %s", node.astext(), error, location=node)
        return ""


def visit_math(writer: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    writer.body.append(converted(node, block=False))
    raise nodes.SkipNode


def visit_math_block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula on its own."""
    writer.body.append(f'<div class="formula">{converted(node, block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
