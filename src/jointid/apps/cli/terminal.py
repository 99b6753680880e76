"""A document on a terminal, with colour: what passed is green, what did not red, and numbers stand out."""

from __future__ import annotations

import sys

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table as Grid
from rich.text import Text

from jointid.common.document import Block, Code, Document, Facts, Heading, Listing, Paragraph, Picture, Table, Verdicts
from jointid.common.messages import Detail, Pace
from jointid.common.text import printable

_BESIDE = 10  # characters of a line that are not the stage's
_MARKS = {True: ("yes", "green"), False: ("no", "bold red"), None: ("?", "yellow"), "noted": ("noted", "cyan")}


def print_blocks(document: Document, console: Console | None = None) -> None:
    """Print a document; names of files are plain text to it, whatever they hold."""
    console = console or Console()
    blocks = [Padding(_render(block), (1, 0, 0, 0)) for block in document.blocks]
    console.print(Panel(_text(document.title, "bold"), expand=False), Group(*blocks))


def _render(block: Block) -> RenderableType:
    if isinstance(block, Table):
        # Unfolded, or a narrow terminal would cut numbers.
        title = _text(block.caption, "bold") if block.caption else None
        grid = Grid(title=title, title_justify="left", box=None, pad_edge=False, header_style="dim")
        for i, name in enumerate(block.header):
            grid.add_column(_text(name), justify="left" if i in block.words else "right", no_wrap=i not in block.words)
        for row in block.rows:
            grid.add_row(*map(_text, row))
        return grid
    if isinstance(block, Facts | Verdicts):
        return _pairs(block)
    if isinstance(block, Listing):
        return _text("\n".join(block.items))
    if isinstance(block, Code):
        return _text(f"{block.caption}\n{block.text}".lstrip())
    assert isinstance(block, Heading | Paragraph | Picture)
    return _text(block.text, "bold" if isinstance(block, Heading) else "")


def _pairs(block: Facts | Verdicts) -> Grid:
    grid = Grid.grid(padding=(0, 2, 0, 0))
    if isinstance(block, Facts):
        for name, value in block.pairs:
            grid.add_row(_text(name, "yellow" if name == "warning" else "dim"), _text(value))
        return grid
    for asked, good, reasons in block.rows:
        mark, style = _MARKS[good]
        grid.add_row(_text(asked), _text(mark, style), _text("\n".join(reasons)))
    return grid


def _text(text: str, style: str = "") -> Text:
    return Text(printable(text), style=style)


class Bars:
    """Draws on the standard error one line that is rewritten: the stage, or how far a piece of work is.

    What is done leaves nothing there, but for a sentence that is longer than a line.

    Args:
        console: to draw on; one of the standard error when None.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(file=sys.stderr)
        self._status = self._console.status("")

    def __call__(self, message: str) -> None:
        """Rewrite the line; print a sentence that is longer above it."""
        stage = printable(message.brief if isinstance(message, Detail) and not isinstance(message, Pace) else message)
        if len(stage) > self._console.width - _BESIDE:
            self._console.print(Text(stage), soft_wrap=True)
        elif stage:
            self._status.update(Text(stage))
            self._status.start()

    def clear(self) -> None:
        """Take the line off."""
        self._status.stop()
