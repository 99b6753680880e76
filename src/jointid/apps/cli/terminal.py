"""A document on a terminal, with colour: what passed is green, what did not red, and numbers stand out."""

from __future__ import annotations

import math
import sys

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.panel import Panel
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.table import Table as Grid
from rich.text import Text

from jointid.common.document import Block, Code, Document, Facts, Heading, Listing, Paragraph, Picture, Table, Verdicts
from jointid.common.messages import Detail, describe_pace, describe_time
from jointid.common.text import printable

_STAGE, _BESIDE = "", 30  # the key of a stage, and the characters of its bar and time
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
    """Draws on the standard error one line that is rewritten: the stage, or a bar for each piece of work.

    What is done leaves nothing there, but for a sentence that is longer than a line.

    Args:
        console: to draw on; one of the standard error when None.
    """

    def __init__(self, console: Console | None = None) -> None:
        columns = TextColumn("{task.description}", markup=False, table_column=_whole()), BarColumn(20), _Pace(_whole())
        self._progress = Progress(
            *columns,
            console=console or Console(file=sys.stderr),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, message: str) -> None:
        """Rewrite the line of the stage; print a sentence that is long, or beside bars, above them."""
        stage = printable(message.brief if isinstance(message, Detail) else message)
        if len(stage) > self._progress.console.width - _BESIDE or (stage and self._tasks.keys() - {_STAGE}):
            self._progress.console.print(Text(stage), soft_wrap=True)
        elif stage and not (_STAGE in self._tasks and self._progress.tasks[-1].description == stage):
            self._remove(_STAGE)
            self._add(_STAGE, stage, math.inf, "")

    def draw(self, what: str, done: float, total: float, unit: str) -> None:
        """Draw how far a piece of work is."""
        if what not in self._tasks and done < total:
            self._remove(_STAGE)
            self._add(what, printable(what), total, unit)
        if what in self._tasks:
            if done < total:
                self._progress.update(self._tasks[what], completed=done)
            else:
                self._remove(what)
                if not self._tasks:
                    self._progress.stop()

    def _add(self, key: str, text: str, total: float, unit: str) -> None:
        self._progress.start()
        self._tasks[key] = self._progress.add_task(text, total=total if math.isfinite(total) else None, unit=unit)

    def _remove(self, key: str) -> None:
        if key in self._tasks:
            self._progress.remove_task(self._tasks.pop(key))

    def clear(self) -> None:
        """Take all bars off."""
        for key in list(self._tasks):
            self._remove(key)
        self._progress.stop()


def _whole() -> Column:
    return Column(no_wrap=True)


class _Pace(ProgressColumn):
    """How much is done, the rate, and the time left; of a stage how long it has gone on."""

    def render(self, task: Task) -> Text:
        if not task.fields["unit"]:
            return Text(describe_time(task.elapsed or 0.0))
        total = math.inf if task.total is None else task.total
        return Text(describe_pace(task.completed, total, task.fields["unit"], task.elapsed or 0.0))
