"""Progress on a terminal: one line that is rewritten."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.text import Text

from jointid.common.messages import Detail
from jointid.common.text import printable

_BESIDE = 10  # characters of a line that are not the stage's


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
        stage = printable(message.brief if isinstance(message, Detail) and not message.pace else message)
        if len(stage) > self._console.width - _BESIDE:
            self._console.print(Text(stage), soft_wrap=True)
        elif stage:
            self._status.update(Text(stage))
            self._status.start()

    def clear(self) -> None:
        """Take the line off."""
        self._status.stop()
