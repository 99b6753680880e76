"""Formulas as MathML: every browser of today draws it by itself, offline, without a script."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from docutils import nodes
from latex2mathml.converter import convert

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

_TAG = re.compile(r"\\tag\{([^}]*)\}")


def mathml(tex: str, *, block: bool) -> str:
    """Return a formula of TeX as a MathML element.

    Args:
        tex: the formula, without its delimiters and its ``\\tag``.
        block: whether it stands alone, and not within a line.
    """
    return str(convert(tex.strip(), display="block" if block else "inline"))


def displayed(tex: str) -> str:
    """Return a formula that stands alone, with its number at the end of its line."""
    number = _TAG.search(tex)
    named = f'<span class="equation-number">({number[1]})</span>' if number else ""
    return f'<div class="equation">{mathml(_TAG.sub("", tex), block=True)}{named}</div>'


def _inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def _block(self: HTML5Translator, node: nodes.math_block) -> None:
    self.body.append(displayed(node.astext()))
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
