"""Results as documents, rendered as text or HTML."""

from __future__ import annotations

import base64
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from jointid.common.text import align, encodable, wrap

if TYPE_CHECKING:
    from jinja2 import Environment

Mark: TypeAlias = bool | Literal["noted"] | None
"""The answer to a question; None if undecided, noted if it is no but changes nothing."""

_MARKS: Mapping[Mark, str] = {True: "yes", False: "no", None: "?", "noted": "noted"}
WIDTH = 80
"""Characters of a line of plain text."""

_LEAST = 13  # characters of a fact's name, or blocks of facts would not line up with each other
_ASKED = 19  # characters of a question

# Typography of a page:
_THIN = "\u202f"  # a thin space at which no line ends
_UNITS = r"(?:%|°|k?Hz|[mµ]?s|k?g|k?N|[mk]?m|m?rad|[mk]?A|[mk]?V|dB|σ|sigma)"
_SMALL = 1e-3  # a smaller p-value is said to be smaller than this
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_RULES: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"\+-", "±"),
    (r"\bp (=|<) (\d[\d.]*(?:e-?\d+)?)", lambda found: f"p {_p_value(found[1], float(found[2].rstrip('.')))}"),
    (r" >= ", " ≥ "),
    (r" <= ", " ≤ "),
    (r"(?<=[a-z])\^(-?\d)", lambda found: found[1].translate(_SUPERSCRIPTS)),
    (r"(?:(?<=\bkg m)|(?<=/[sm])|(?<=\b[AV] s))2\b", "²"),  # of units alone: m2 is also the symbol of a mass
    (r"(?<=\d)e([+-])0*(\d+)\b", lambda found: f"·10{(found[1].strip('+') + found[2]).translate(_SUPERSCRIPTS)}"),
    (rf"(?<=\d) (?={_UNITS}(?![\w/]|\s*=))", _THIN),
    (r"(?<=\d) (?=(?:N|kg|rad|m|A|V)(?:[ /](?:m|s|rad)\b|²))", _THIN),
    (r"(?<=\bN) (?=m\b|s/)|(?<=\bN\u202fm) (?=s/)|(?<=\bkg) (?=m²)|(?<=\b[AV]) (?=s[²/])", _THIN),
    (r"\bsigma\b", "σ"),
    (r"(?<![\w.)\]⁻-])-(?=\d)", "−"),
)


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of level 1 (the title), 2 or 3."""

    text: str
    level: int = 2


Tone: TypeAlias = Literal["", "good", "bad", "open"]


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Plain text; `lead` marks the first sentence, `tone` good or bad news."""

    text: str
    lead: bool = False
    tone: Tone = ""


@dataclass(frozen=True, slots=True)
class Listing:
    """Sentences, one below the other."""

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Questions, each with an answer and reasons."""

    rows: tuple[tuple[str, Mark, tuple[str, ...]], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under a header; columns in `words` are text, and a page shows `folded` rows on demand."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = (0,)
    folded: bool = False


@dataclass(frozen=True, slots=True)
class Facts:
    """Pairs of a name and a value."""

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Code:
    """Verbatim text with a caption."""

    text: str
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture, PNG, or SVG that stands in the HTML itself.

    Attributes:
        draw: returns its content; SVG of our own as one element, every text of it escaped.
        text: the caption, which says what to see.
        wide: whether it may be as wide as the page.
    """

    name: str
    draw: Callable[[], bytes]
    text: str
    wide: bool = True


Block: TypeAlias = Heading | Paragraph | Listing | Verdicts | Table | Facts | Code | Picture


@dataclass(frozen=True, slots=True)
class Document:
    """A title and its blocks.

    Attributes:
        blocks: in order; facts and listings that hold nothing are left out.
        answer: JSON that a page carries along for other programs; none when empty.
    """

    title: str
    blocks: tuple[Block, ...]
    answer: str = ""

    def __post_init__(self) -> None:
        kept = tuple(block for block in self.blocks if block not in (Facts(()), Listing(())))
        object.__setattr__(self, "blocks", kept)

    def text(self, width: int = WIDTH) -> str:
        """Render as plain text with aligned columns.

        Args:
            width: maximum line length; long words and code exceed it.
        """
        text, gap = wrap(self.title, width), "\n" if self.blocks and isinstance(self.blocks[0], Facts) else "\n\n"
        for block in self.blocks:
            text += gap + _block_text(block, width)
            gap = "\n" if isinstance(block, Heading) else "\n\n"
        return text

    @property
    def pictures(self) -> dict[str, bytes]:
        """The pictures, by the names of their files."""
        return {block.name: block.draw() for block in self.blocks if isinstance(block, Picture)}


class Documented(ABC):
    """A result that can be printed as a document."""

    __slots__ = ()

    @abstractmethod
    def to_document(self, *, details: bool = False) -> Document:
        """Return the result as a document, with `details` on demand."""

    def summary(self, *, details: bool = False) -> str:
        """Return the document as text."""
        return self.to_document(details=details).text()

    def __str__(self) -> str:
        """Summarise the result in the encoding of the standard output."""
        return encodable(self.summary(), getattr(sys.stdout, "encoding", None))

    @property
    def sentence(self) -> str:
        """The result in one sentence; empty if its document begins with one."""
        return ""

    def _repr_html_(self) -> str:
        """Render the document without its pictures for a notebook."""
        document = self.to_document()
        said = {document.title: None, self.sentence: None}  # once where they are the same
        blocks = (*map(Paragraph, filter(None, said)), *document.blocks)
        return "\n".join(block_html(block) for block in blocks if not isinstance(block, Picture))


def common_facts(resampled: object | None, transmission: object | None) -> tuple[tuple[str, str], ...]:
    """Describe resampling and transmission, where there were any."""
    found = (("resampled", resampled), ("transmission", transmission))
    return tuple((name, str(value)) for name, value in found if value is not None)


def _block_text(block: Block, width: int) -> str:
    if isinstance(block, Heading | Paragraph | Picture):
        return wrap(block.text, width)
    if isinstance(block, Listing):
        return "\n".join(wrap(item, width, below=2) for item in block.items)
    if isinstance(block, Facts):
        names = max([_LEAST, *(len(name) for name, _ in block.pairs)])
        return "\n".join(wrap(value, width, f"{name.ljust(names)} ") for name, value in block.pairs)
    if isinstance(block, Verdicts):
        return "\n".join(_verdict_text(*row, width) for row in block.rows)
    if isinstance(block, Code):
        return f"{block.caption}\n{block.text}" if block.caption else block.text
    return "\n".join([*([wrap(block.caption, width)] if block.caption else []), _table_text(block, width)])


def _verdict_text(asked: str, good: Mark, reasons: Sequence[str], width: int) -> str:
    head = f"{asked:{_ASKED}} {_MARKS[good]:5} "
    if not reasons:
        return wrap("", width, head)
    first, *others = reasons
    below = (wrap(other, width - 1, " " * len(head)) for other in others)  # a comma takes one
    return ",\n".join((wrap(first, width - 1, head), *below))


def _table_text(block: Table, width: int) -> str:
    table = [block.header, *block.rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(block.header))]
    parts, taken = [[0]], widths[0]
    for i in range(1, len(widths)):
        if len(parts[-1]) > 1 and taken + 2 + widths[i] > width:
            parts.append([0])
            taken = widths[0]
        parts[-1].append(i)
        taken += 2 + widths[i]
    shown = []
    for part in parts:
        header, *rows = ([row[i] for i in part] for row in table)
        if part is not parts[0]:
            rows = [row for row in rows if any(row[1:])]
        shown.append(align(header, rows, [i not in block.words for i in part]))
    return "\n\n".join(shown)


@cache
def templates(*folders: Path) -> Environment:
    """Return the templates of HTML in folders, and `blocks.html`, whose macro shows a block; all text is escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    made = Environment(
        autoescape=True, loader=FileSystemLoader([Path(__file__).parent, *folders]), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.filters["base64"] = lambda raw: base64.b64encode(raw).decode("ascii")
    made.filters["inert"] = lambda json: Markup(inert(json))  # noqa: S704  # no character of a tag is left in it
    return made


def block_html(block: Block) -> str:
    """Return a block as HTML."""
    macros: Any = templates().get_template("blocks.html").module
    return str(macros.show(block))


def inert(answer: str) -> str:
    """Return JSON in which no tag, comment or entity of HTML can begin; it is the same JSON."""
    return answer.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def typeset(text: str) -> str:
    """Typeset ±, minus signs, exponents, thin spaces before units, and p-values."""
    for pattern, into in _RULES:
        text = re.sub(pattern, into, text)
    return text


def p_value(value: float) -> str:
    """Format a p-value to two digits, or as below 0.001."""
    return f"< {_SMALL}" if value < _SMALL else f"{value:.2g}"


def typeset_block(block: Block) -> Block:
    """Typeset the texts of a block, except code and names with values: hashes and names of files are among them."""
    if isinstance(block, Code | Facts):
        return block
    changed: dict[str, Any] = {one.name: _deep(getattr(block, one.name)) for one in fields(block)}
    return replace(block, **changed)


def _deep(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_deep, value))
    return typeset(value) if isinstance(value, str) else value


def _p_value(relation: str, value: float) -> str:
    if value < _SMALL or (relation == "<" and value <= _SMALL):
        return f"< {_SMALL}"
    return f"{relation} {value:.2g}"
