"""Results as documents of blocks: plain text, terminal or HTML."""

from __future__ import annotations

import base64
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

from jointid.common.text import printable

if TYPE_CHECKING:
    from jinja2 import Environment
    from rich.console import Console, RenderableType

_MARKS: Mapping[bool | None, tuple[str, str]] = {
    True: ("yes", "green"),
    False: ("no", "bold red"),
    None: ("?", "yellow"),
}
WIDTH = 80
"""Characters of a line of plain text."""

_LEAST, _ASKED = 13, 19  # characters of a fact's name and of a question, or blocks would not line up with each other
_RULE = "    \n    \n----\n    \n    \n    \n    \n    \n"  # a line below the header only


Style: TypeAlias = Literal["", "good", "bad", "open", "heading", "part", "list", "code"]
"""Plain; good, bad or open for a coloured paragraph; a heading, or that of a part; a list of lines; or verbatim."""


@dataclass(frozen=True, slots=True)
class Text:
    """Text of one style."""

    text: str
    style: Style = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under a header; columns in `words` are text."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = (0,)


@dataclass(frozen=True, slots=True)
class Facts:
    """Pairs of a name and a value; `marks` answer those of questions."""

    pairs: tuple[tuple[str, str], ...]
    marks: tuple[bool | None, ...] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: PNG, or SVG that is embedded in the HTML.

    Attributes:
        draw: returns its content; SVG as one element with escaped text.
        text: the caption.
        wide: whether it may be as wide as the page.
    """

    name: str
    draw: Callable[[], bytes]
    text: str
    wide: bool = True


Block: TypeAlias = Text | Table | Facts | Picture


@dataclass(frozen=True, slots=True)
class Document:
    """A title and its blocks.

    Attributes:
        blocks: in order; empty facts and lists are left out.
        answer: JSON embedded in the page for other programs; none when empty.
    """

    title: str
    blocks: tuple[Block, ...]
    answer: str = ""

    def __post_init__(self) -> None:
        kept = tuple(block for block in self.blocks if block not in (Facts(()), Text("", "list")))
        object.__setattr__(self, "blocks", kept)

    def text(self, width: int = WIDTH) -> str:
        """Render as plain text; code and tables of numbers may be wider."""
        drawn = io.StringIO()
        self.print(plain_console(file=drawn, width=width, color_system=None))
        return "\n".join(line.rstrip() for line in drawn.getvalue().splitlines())

    def print(self, console: Console) -> None:
        """Print on a console, in colour if supported; see `plain_console`."""
        console.print(self.title, style="bold")
        before: Block | None = None
        for block in self.blocks:
            match before, block:
                case (Text(style="heading" | "part"), _) | (None, Facts(marks=())):
                    pass
                case _:
                    console.print()
            match block:
                case Text(text, style):
                    bold = "bold" if style in ("heading", "part") else None
                    console.print(text, style=bold, crop=False, soft_wrap=style == "code")
                case Picture():
                    console.print(block.text, crop=False)
                case Table():
                    console.print(_draw_table(block, console), crop=False)
                case Facts():
                    console.print(_draw_facts(block), crop=False)
            before = block

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
        return self.summary()

    @property
    def sentence(self) -> str:
        """The result in one sentence, by which its document begins."""
        return self.to_document().title

    def _repr_html_(self) -> str:
        """Render the document without its pictures for a notebook."""
        document = self.to_document()
        said = {document.title: None, self.sentence: None}  # printed once if they are equal
        blocks = (*map(Text, filter(None, said)), *document.blocks)
        macros: Any = templates().get_template("blocks.html").module
        return "\n".join(str(macros.show(block)) for block in blocks if not isinstance(block, Picture))


def common_facts(resampled: object | None, transmission: object | None) -> tuple[tuple[str, str], ...]:
    """Describe resampling and transmission, if any."""
    found = (("resampled", resampled), ("transmission", transmission))
    return tuple((name, str(value)) for name, value in found if value is not None)


def plain_console(**options: Any) -> Console:
    """Return a rich console that prints all text literally, without markup."""
    from rich.console import Console

    console: Any = Console(markup=False, emoji=False, highlight=False, force_jupyter=False, **options)
    render = console.render_str
    console.render_str = lambda text, **options: render(printable(text), **options)  # escapes control characters
    return cast("Console", console)


def _draw_facts(block: Facts) -> RenderableType:
    """Return a grid of pairs, with the answers of questions in colour."""
    from rich.table import Table as Grid
    from rich.text import Text as Words

    grid = Grid.grid(padding=(0, 1, 0, 0))
    for width in (_ASKED, 5) if block.marks else (_LEAST,):
        grid.add_column(min_width=width, overflow="fold")
    grid.add_column(overflow="fold")
    answers = [[Words(*_MARKS[mark])] for mark in block.marks] or [[] for _ in block.pairs]
    for (name, value), answer in zip(block.pairs, answers, strict=True):
        grid.add_row(name, *answer, value)
    return grid


def _draw_table(block: Table, console: Console) -> RenderableType:
    """Return a table at least as wide as its numbers."""
    from rich.box import Box
    from rich.console import Group
    from rich.measure import Measurement
    from rich.segment import Segments
    from rich.table import Table as Grid

    grid = Grid(
        box=Box(_RULE, ascii=True), show_edge=False, pad_edge=False, padding=(0, 1, 0, 0), header_style="dim",
        border_style="dim",
    )  # fmt: skip
    for i, cells in enumerate(zip(block.header, *block.rows, strict=True)):
        if i in block.words:
            grid.add_column(cells[0], overflow="fold")
        else:
            grid.add_column(cells[0], justify="right", min_width=max(map(len, cells)))
    for row in block.rows:
        grid.add_row(*row)
    least = Measurement.get(console, console.options.update(max_width=10_000), grid).minimum
    shown = Segments([*console.render(grid, console.options.update(max_width=max(console.width, least)))])
    return Group(block.caption, shown) if block.caption else shown


@cache
def templates(*folders: Path) -> Environment:
    """Return the HTML templates of folders and `blocks.html`, with escaped text."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    made = Environment(
        autoescape=True, loader=FileSystemLoader([Path(__file__).parent, *folders]), undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.filters["base64"] = lambda raw: base64.b64encode(raw).decode("ascii")
    # Escape the characters that begin HTML tags, comments and entities; JSON parsers read the same value.
    signs = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}
    made.filters["inert"] = lambda json: Markup(json.translate(str.maketrans(signs)))  # noqa: S704
    return made
