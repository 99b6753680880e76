"""A document: headings, paragraphs, tables, verdicts and pictures, written as one HTML page or as Markdown.

Whatever text comes in is data: it is escaped on its way out. Nothing is loaded from elsewhere, pictures are part of the
page, and the same document gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from jointid.common.errors import RecordError

MARKS = {True: "Yes", False: "No", None: "Not known"}
"""How the answer to a question is said."""


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
    """Questions, each with its answer (None where it cannot be said) and why."""

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
    """What is called what: pairs of a name and a value."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Code:
    """A text that is copied as it is; `caption` says what it is."""

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
        answer: JSON that the page carries along for other programs; none when empty.
    """

    title: str
    blocks: tuple[Block, ...]
    answer: str = ""

    def markdown(self) -> str:
        """Return Markdown; its pictures are files beside it."""
        return "\n\n".join(_markdown(block) for block in (Heading(self.title, 1), *self.blocks)) + "\n"

    @property
    def pictures(self) -> dict[str, bytes]:
        """The pictures, by the names of their files."""
        return {block.name: block.image for block in self.blocks if isinstance(block, Picture)}


def written(folder: str | Path, files: dict[str, bytes]) -> tuple[Path, ...]:
    """Write files by their names into a folder, which is made; return their paths.

    Raises:
        RecordError: the folder or a file cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, content in files.items():
            (folder / file).write_bytes(content)
    except OSError as error:
        raise RecordError(f"{folder} cannot be written ({error.strerror}); name another folder.") from None
    return tuple(folder / file for file in files)


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
        return [f"**{MARKS[good]}** — {_plain(asked)} {_plain('; '.join(said))}" for asked, good, said in block.rows]
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
    """Return text as Markdown shows it: no tag and no link is made of what only looks like one."""
    one_line = " ".join(text.splitlines())
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line).replace("](", "]\\(")
