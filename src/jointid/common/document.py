"""A result as a document: blocks without a format, rendered as text for the terminal, as Markdown or as HTML.

Headings, paragraphs, tables, verdicts and pictures; a result becomes a document once, and every printed form is made of
that.
"""

from __future__ import annotations

import base64
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import PurePath
from typing import TypeAlias

from jointid.common.text import aligned

_MARKS = {True: "yes", False: "no", None: "?"}
_ANSWERS = {True: "Yes", False: "No", None: "Not known"}
_CLASSES = {True: "good", False: "bad", None: "open"}
_LEAST = 13  # characters of a fact's name, or blocks of facts would not line up with each other
_ASKED = 20  # characters of a question


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of level 1 (the title), 2 or 3."""

    text: str
    level: int = 2


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Plain text; `lead` is what is to be read first."""

    text: str
    lead: bool = False


@dataclass(frozen=True, slots=True)
class Listing:
    """Sentences, one below the other."""

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Questions, each with its answer (None where it cannot be said) and the reasons."""

    rows: tuple[tuple[str, bool | None, tuple[str, ...]], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under a header; the columns in `words` are text, the others are numbers."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = (0,)


@dataclass(frozen=True, slots=True)
class Facts:
    """Pairs of a name and a value."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Code:
    """A text that is copied as it is, and its caption."""

    text: str
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture; `name` is its file beside a Markdown page, PNG or SVG.

    Attributes:
        name: of the file.
        image: its content.
        text: the caption, which says what to see.
        plot: the same as JSON for bokeh, for a page; none when empty.
        wide: whether it may be as wide as the page.
    """

    name: str
    image: bytes
    text: str
    plot: str = ""
    wide: bool = True

    @property
    def kind(self) -> str:
        """The media type of the image."""
        return "image/svg+xml" if self.name.endswith(".svg") else "image/png"


Block: TypeAlias = Heading | Paragraph | Listing | Verdicts | Table | Facts | Code | Picture


@dataclass(frozen=True, slots=True)
class Document:
    """A title and what follows it.

    Attributes:
        title: of the page.
        blocks: in order.
        answer: JSON that a page carries along for other programs; none when empty.
    """

    title: str
    blocks: tuple[Block, ...]
    answer: str = ""

    def text(self) -> str:
        """Return plain text, columns aligned; what follows a heading stands right below it."""
        text, gap = self.title, "\n" if self.blocks and isinstance(self.blocks[0], Facts) else "\n\n"
        for block in self.blocks:
            text += gap + _block_text(block)
            gap = "\n" if isinstance(block, Heading) else "\n\n"
        return text

    def markdown(self) -> str:
        """Return Markdown; its pictures are files beside it. Of text that comes in no tag and no link is made."""
        return "\n\n".join(map(_block_markdown, (Heading(self.title, 1), *self.blocks))) + "\n"

    def html(self) -> str:
        """Return a fragment of HTML, every text escaped, as a notebook shows it."""
        blocks = "\n".join(map(block_html, self.blocks))
        return f'<div class="jointid">\n<p><strong>{escape(self.title)}</strong></p>\n{blocks}\n</div>'

    @property
    def pictures(self) -> dict[str, bytes]:
        """The pictures, by the names of their files."""
        return {block.name: block.image for block in self.blocks if isinstance(block, Picture)}


class Documented(ABC):
    """A result that becomes a document, from which every printed form of it is made."""

    __slots__ = ()

    @abstractmethod
    def document(self, *, details: bool = False) -> Document:
        """Return the result as a document; with details all there is to say rather than a screen of it."""

    def summary(self, *, details: bool = False) -> str:
        """Return the document as text."""
        return self.document(details=details).text()

    def __str__(self) -> str:
        """Return the summary."""
        return self.summary()

    def _repr_html_(self) -> str:
        """Return the document as a notebook shows it."""
        return self.document().html()


def common_facts(resampled: object | None, transmission: object | None) -> tuple[tuple[str, str], ...]:
    """Return how a record was brought to a uniform clock, and on which side of a transmission values are; if so."""
    found = (("resampled", resampled), ("transmission", transmission))
    return tuple((name, str(value)) for name, value in found if value is not None)


def _block_text(block: Block) -> str:
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


def _block_markdown(block: Block) -> str:
    if isinstance(block, Heading):
        return f"{'#' * block.level} {_plain(block.text)}"
    if isinstance(block, Paragraph):
        return _plain(block.text)
    if isinstance(block, Table):
        return _table_markdown(block)
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


def _table_markdown(block: Table) -> str:
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


def block_html(block: Block, anchor: str = "") -> str:
    """Return a block as HTML; `anchor` is what a heading is linked by."""
    if isinstance(block, Heading):
        link = f' id="{escape(anchor)}"' if anchor else ""
        return f"<h{block.level}{link}>{escape(block.text)}</h{block.level}>"
    if isinstance(block, Paragraph):
        return f"<p{' class=lead' if block.lead else ''}>{escape(block.text)}</p>"
    if isinstance(block, Listing | Verdicts | Facts):
        return "\n".join(_lines_html(block))
    if isinstance(block, Code):
        caption = f"<p>{escape(block.caption)}</p>\n" if block.caption else ""
        return f'{caption}<pre tabindex="0"><code>{escape(block.text)}</code></pre>'
    return _picture_html(block) if isinstance(block, Picture) else _table_html(block)


def inert(json: str) -> str:
    """Return JSON in which no tag, comment or entity of HTML can begin; it is the same JSON."""
    return json.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _lines_html(block: Listing | Verdicts | Facts) -> list[str]:
    if isinstance(block, Listing):
        return ["<ul>", *(f"<li>{escape(item)}</li>" for item in block.items), "</ul>"]
    if isinstance(block, Verdicts):
        return ['<ul class="verdicts">', *(_verdict(*row) for row in block.rows), "</ul>"]
    pairs = (f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in block.pairs)
    return ["<dl>", *pairs, "</dl>"]


def _verdict(asked: str, good: bool | None, reasons: tuple[str, ...]) -> str:
    why = "".join(f"\n<p>{escape(reason)}</p>" for reason in reasons)
    mark = f'<strong class="mark">{_ANSWERS[good]}</strong>'
    return f'<li class="{_CLASSES[good]}">{mark}<div><p class="asked">{escape(asked)}</p>{why}\n</div></li>'


def _picture_html(block: Picture) -> str:
    stem = escape(PurePath(block.name).stem)
    data = f'<script type="application/json" class="plot-data">{inert(block.plot)}</script>'
    plot = f'<div class="plot" id="plot-{stem}"></div>\n{data}\n' if block.plot else ""
    source = f"data:{block.kind};base64,{base64.b64encode(block.image).decode('ascii')}"
    image = f'<img class="still" src="{source}" alt="{escape(block.text)}">'
    narrow = "" if block.wide else " class=narrow"
    return f"<figure{narrow}>\n{plot}{image}\n<figcaption>{escape(block.text)}</figcaption>\n</figure>"


def _table_html(block: Table) -> str:
    kinds = [" class=text" if i in block.words else "" for i in range(len(block.header))]
    heads = "".join(f'<th scope="col"{k}>{escape(text)}</th>' for k, text in zip(kinds, block.header, strict=True))
    rows = [
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td{k}>{escape(text)}</td>" for k, text in zip(kinds[1:], row[1:], strict=True))
        + "</tr>"
        for row in block.rows
    ]
    caption = [f"<caption>{escape(block.caption)}</caption>"] if block.caption else []
    label = escape(block.caption or "table")
    start = f'<div class="wide" tabindex="0" role="region" aria-label="{label}"><table>'
    head = [start, *caption, f"<thead><tr>{heads}</tr></thead>", "<tbody>"]
    return "\n".join([*head, *rows, "</tbody>", "</table></div>"])
