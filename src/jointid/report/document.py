"""A document: headings, paragraphs, tables and pictures, written as one HTML file or as Markdown.

Whatever text comes in is data: it is escaped on its way into HTML. Nothing is loaded from elsewhere, pictures are part
of the page, and the same document gives the same bytes.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TypeAlias

from jointid.common.errors import RecordError


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of level 1 (the title), 2 or 3."""

    text: str
    level: int = 2


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under a header; the first column is text, the others are numbers."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG picture; `name` is its file beside a Markdown page."""

    name: str
    png: bytes
    text: str


Block: TypeAlias = Heading | Paragraph | Table | Picture


@dataclass(frozen=True, slots=True)
class Document:
    """A title and what follows it."""

    title: str
    blocks: tuple[Block, ...]

    def html(self) -> str:
        """Return one self-contained HTML page."""
        body = "\n".join(_html(block) for block in (Heading(self.title, 1), *self.blocks))
        return _PAGE.replace("{title}", escape(self.title)).replace("{body}", body)

    def markdown(self) -> str:
        """Return Markdown; its pictures are files beside it."""
        return "\n\n".join(_markdown(block) for block in (Heading(self.title, 1), *self.blocks)) + "\n"

    def save(self, folder: str | Path, name: str) -> tuple[Path, ...]:
        """Write `name`.html, `name`.md and the pictures into a folder, which is made; return what was written.

        Raises:
            RecordError: the folder or a file cannot be written.
        """
        folder = Path(folder)
        files: dict[str, bytes] = {f"{name}.html": self.html().encode(), f"{name}.md": self.markdown().encode()}
        files |= {block.name: block.png for block in self.blocks if isinstance(block, Picture)}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for file, content in files.items():
                (folder / file).write_bytes(content)
        except OSError as error:
            raise RecordError(f"{folder} cannot be written ({error.strerror}); name another folder.") from None
        return tuple(folder / file for file in files)


def _html(block: Block) -> str:
    if isinstance(block, Heading):
        return f"<h{block.level}>{escape(block.text)}</h{block.level}>"
    if isinstance(block, Paragraph):
        return f"<p>{escape(block.text)}</p>"
    if isinstance(block, Picture):
        data = base64.b64encode(block.png).decode("ascii")
        text = escape(block.text)
        return f'<figure><img src="data:image/png;base64,{data}" alt="{text}"><figcaption>{text}</figcaption></figure>'
    caption = f"<caption>{escape(block.caption)}</caption>" if block.caption else ""
    head = _cells(block.header, "th")
    rows = "\n".join(f"<tr>{_cells(row, 'td')}</tr>" for row in block.rows)
    return f'<div class="wide"><table>{caption}<thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></div>'


def _cells(texts: Iterable[str], tag: str) -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)


def _markdown(block: Block) -> str:
    if isinstance(block, Heading):
        return f"{'#' * block.level} {block.text}"
    if isinstance(block, Paragraph):
        return block.text
    if isinstance(block, Picture):
        return f"![{block.text}]({block.name})\n\n*{block.text}*"
    rule = ("---", *("---:" for _ in block.header[1:]))
    lines = [f"| {' | '.join(_escaped(row))} |" for row in (block.header, rule, *block.rows)]
    return "\n".join([*([f"*{block.caption}*", ""] if block.caption else []), *lines])


def _escaped(texts: Sequence[str]) -> list[str]:
    return [text.replace("|", "\\|") for text in texts]


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.25rem; margin-top: 2.2rem; } h3 { font-size: 1.05rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; margin: .8rem 0; }
caption { text-align: left; font-style: italic; padding: .3rem 0; }
th, td { padding: .22rem .6rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { border-bottom: 2px solid #555; vertical-align: bottom; white-space: normal; }
figure { margin: 1rem 0; } img { max-width: 100%; } figcaption { font-style: italic; font-size: .9rem; }
@media print { body { margin: 0; max-width: none; } h2 { break-after: avoid; } table, figure { break-inside: avoid; } }
</style>
</head>
<body>
{body}
</body>
</html>
"""
