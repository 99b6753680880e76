"""A document as Markdown. Text that comes in is data: no tag and no link is made of it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from jointid.common.document.blocks import (
    Block,
    Code,
    Document,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Verdicts,
)

_ANSWERS = {True: "Yes", False: "No", None: "Not known"}


def document_markdown(document: Document) -> str:
    """Return a document as Markdown."""
    return "\n\n".join(_markdown(block) for block in (Heading(document.title, 1), *document.blocks)) + "\n"


def _markdown(block: Block) -> str:
    if isinstance(block, Heading):
        return f"{'#' * block.level} {_plain(block.text)}"
    if isinstance(block, Paragraph):
        return _plain(block.text)
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Code):
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", block.text)), default=0))
        return _captioned(_plain(block.caption), f"{fence}\n{block.text.rstrip()}\n{fence}")
    if isinstance(block, Picture):
        return f"![{_plain(block.text)}]({block.name})\n\n*{_plain(block.text)}*"
    return "\n".join(f"- {line}" for line in _points(block))


def _points(block: Listing | Verdicts | Facts) -> list[str]:
    if isinstance(block, Listing):
        return [_plain(item) for item in block.items]
    if isinstance(block, Verdicts):
        return [f"**{_ANSWERS[good]}** — {_plain(asked)} {_plain('; '.join(why))}" for asked, good, why in block.rows]
    return [f"{_plain(name)}: {_plain(value)}" for name, value in block.pairs]


def _table(block: Table) -> str:
    rule = tuple("---" if i in block.words else "---:" for i in range(len(block.header)))
    lines = [f"| {' | '.join(row)} |" for row in (_cells(block.header), rule, *map(_cells, block.rows))]
    return _captioned(f"*{_plain(block.caption)}*" if block.caption else "", "\n".join(lines))


def _captioned(caption: str, text: str) -> str:
    return f"{caption}\n\n{text}" if caption else text


def _cells(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(_plain(text).replace("|", "\\|") for text in texts)


def _plain(text: str) -> str:
    one_line = " ".join(text.splitlines())
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line).replace("](", "]\\(")
