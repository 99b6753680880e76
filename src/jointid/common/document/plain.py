"""A document as plain text for the terminal: columns line up, one fact or verdict a line."""

from __future__ import annotations

from jointid.common.document.blocks import Block, Code, Document, Facts, Heading, Listing, Paragraph, Picture, Verdicts
from jointid.common.text import aligned

_MARKS = {True: "yes", False: "no", None: "?"}
_LEAST = 13  # characters of a fact's name, or blocks of facts would not line up with each other
_ASKED = 20  # characters of a question


def document_text(document: Document) -> str:
    """Return a document as plain text; what follows a heading stands right below it."""
    text, gap = document.title, "\n" if document.blocks and isinstance(document.blocks[0], Facts) else "\n\n"
    for block in document.blocks:
        text += gap + _text(block)
        gap = "\n" if isinstance(block, Heading) else "\n\n"
    return text


def _text(block: Block) -> str:
    if isinstance(block, Heading | Paragraph | Picture):
        return block.text
    if isinstance(block, Listing):
        return "\n".join(block.items)
    if isinstance(block, Facts):
        width = max([_LEAST, *(len(name) for name, _ in block.pairs)])
        return "\n".join(f"{name.ljust(width)} {value}" for name, value in block.pairs)
    if isinstance(block, Verdicts):
        below = f",\n{'':{_ASKED + 6}}"
        return "\n".join(f"{asked:{_ASKED}} {_MARKS[good]:4} {below.join(why)}" for asked, good, why in block.rows)
    if isinstance(block, Code):
        return f"{block.caption}\n{block.text}" if block.caption else block.text
    right = tuple(i not in block.words for i in range(len(block.header)))
    table = aligned(block.header, block.rows, right)
    return f"{block.caption}\n{table}" if block.caption else table
