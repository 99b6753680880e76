"""The blocks of a document: headings, paragraphs, tables, verdicts and pictures.

A result becomes a document once; terminal, Markdown, page and notebook are renderings of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TypeAlias


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
        """Return plain text, columns aligned."""
        from jointid.common.document.plain import document_text

        return document_text(self)

    def markdown(self) -> str:
        """Return Markdown; its pictures are files beside it."""
        from jointid.common.document.markdown import document_markdown

        return document_markdown(self)

    def html(self) -> str:
        """Return a fragment of HTML, every text escaped, as a notebook shows it."""
        from jointid.common.document.html import document_html

        return document_html(self)

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
