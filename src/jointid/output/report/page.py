"""A document as one HTML page: it opens without a network, prints, and runs no script.

The page's policy allows none: a text that got past the escaping would still be nothing but text. The answer it carries
for other programs is JSON in which no tag can end.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from jointid.common.document import Document, Heading, templates
from jointid.common.files import write_folder
from jointid.output.json.documents import REPORT_ELEMENT

_FEW = 4  # headings: a shorter page needs no list of contents


def page(document: Document) -> str:
    """Return a document as one HTML page; the same document gives the same bytes."""
    headings = [block for block in document.blocks if isinstance(block, Heading) and block.level == 2]
    anchors = _anchors(block.text for block in headings)
    links = dict(zip(map(id, headings), anchors, strict=True))
    return templates(Path(__file__).parent).get_template("page.html").render(
        title=document.title,
        blocks=[(block, links.get(id(block), "")) for block in document.blocks],
        contents=list(zip((block.text for block in headings), anchors, strict=True)) if len(headings) >= _FEW else [],
        style=Path(__file__).with_name("style.css").read_text(encoding="utf-8"),
        answer=document.answer,
        element=REPORT_ELEMENT,
    )  # fmt: skip


def save(document: Document, folder: str | Path, name: str) -> tuple[Path, ...]:
    """Write `name`.html and the pictures into a folder, which is made; return what was written.

    Raises:
        RecordError: the folder or a file cannot be written.
    """
    return write_folder(folder, {f"{name}.html": page(document).encode()} | document.pictures)


def _anchors(texts: Iterable[str]) -> list[str]:
    """Return names for headings to be linked by, each once."""
    found: list[str] = []
    for text in texts:
        name = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "part"
        while name in found:
            name += "-"
        found.append(name)
    return found
