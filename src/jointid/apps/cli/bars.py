"""Long work on a terminal: a bar for each piece, with its rate and the time left; sentences stand above them."""

from __future__ import annotations

import math
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.table import Column
from rich.text import Text

from jointid.common.messages import describe_pace
from jointid.common.text import printable


class Bars:
    """Draws on the standard error; a piece of work that is done leaves nothing there.

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
        """Print a sentence above the bars."""
        self._progress.console.print(Text(printable(message)), soft_wrap=True)

    def draw(self, what: str, done: float, total: float, unit: str) -> None:
        """Draw how far a piece of work is."""
        if what not in self._tasks and done < total:
            self._progress.start()
            self._tasks[what] = self._progress.add_task(
                printable(what), total=total if math.isfinite(total) else None, unit=unit
            )
        if what in self._tasks:
            if done < total:
                self._progress.update(self._tasks[what], completed=done)
            else:
                self._progress.remove_task(self._tasks.pop(what))
                if not self._tasks:
                    self._progress.stop()

    def clear(self) -> None:
        """Take all bars off."""
        for one in self._tasks.values():
            self._progress.remove_task(one)
        self._tasks.clear()
        self._progress.stop()


def _whole() -> Column:
    return Column(no_wrap=True)


class _Pace(ProgressColumn):
    """How much is done, the rate, and the time left."""

    def render(self, task: Task) -> Text:
        return Text(
            describe_pace(
                task.completed, math.inf if task.total is None else task.total, task.fields["unit"], task.elapsed or 0.0
            )
        )
