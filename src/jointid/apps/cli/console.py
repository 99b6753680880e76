"""Common to commands: the options that most of them take, where they print, and what they may write."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Parameter

from jointid.common.errors import RecordError
from jointid.common.progress import Progress, silent
from jointid.common.text import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jointid import Estimate, Record
    from jointid.config import JointFile

Flag: TypeAlias = Annotated[bool, Parameter(negative=())]
Quiet: TypeAlias = Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())]
Several: TypeAlias = Annotated[list[str] | None, Parameter(negative=())]
Changes: TypeAlias = Annotated[tuple[str, ...], Parameter(name="--set", negative=())]
"""Keys of the joint file that are changed before it is checked; every setting can be reached."""

FilteringName = Literal["default", "published", "as-printed"]

_PATIENCE = 2.0  # seconds after which the simulation is not being loaded but compiled


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """The options of a command that identifies as a joint file says.

    Attributes:
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        quiet: say nothing of the progress.
    """

    record: Path | None = None
    changes: Changes = ()
    quiet: Quiet = False

    @property
    def progress(self) -> Progress:
        """The listener to progress."""
        return listen(self.quiet)

    def load(self, joint: Path, **choices: str | None) -> JointFile:
        """Load the joint file with its changes; see `jointid.config.load`."""
        from jointid.config import load

        return load(joint, self.changes, **choices)

    def identify(self, file: JointFile) -> tuple[Record, Estimate]:
        """Identify a joint from the record, as its file says, and return the record, too.

        Raises:
            JointidError: the record cannot be read, or the joint cannot be identified from it.
        """
        record = file.record(self.record)
        ready(self.progress)
        return record, file.identify(record, self.progress)

    def identify_by_didim(self, joint: Path) -> tuple[Record, Estimate]:
        """Load the joint file, identify the joint by didim whatever the file says, and return the record, too."""
        return self.identify(self.load(joint, method="didim"))


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Options(Inputs):
    """Those, and where the answer goes; most commands have them.

    Attributes:
        json: also write the answer as JSON to this file.
    """

    json: Path | None = None


DEFAULTS = Options()


def show(result: object = "", *, details: bool = False) -> None:
    """Print a result or a line; nothing that a name in a file may hold reaches the terminal as a command.

    Args:
        result: in colour where the output is a terminal and it becomes a document, else as plain text.
        details: whether to print all there is to say of it.
    """
    from jointid.common.document import Documented

    if isinstance(result, Documented) and sys.stdout.isatty():
        from jointid.apps.cli.terminal import print_document

        print_document(result.document(details=details))
        return
    text = result.summary(details=details) if isinstance(result, Documented) else str(result)
    print(printable(text))  # noqa: T201


def tell(message: str) -> None:
    """Print a line of progress."""
    print(printable(message), file=sys.stderr, flush=True)  # noqa: T201


def listen(quiet: bool) -> Progress:
    """Return who listens to progress."""
    return silent if quiet else tell


def deliver(
    result: object,
    json: Path | None = None,
    *figures: tuple[Path | None, Callable[[Any], Figure]],
    details: bool = False,
) -> None:
    """Print a result, and write it where it was asked for.

    Args:
        result: of any command.
        json: file for the answer.
        figures: a file, and what draws the result for it.
        details: whether to print all there is to say of it.
    """
    from jointid.output import json as answers

    show(result, details=details)
    if json is not None:
        answers.write(answers.to_dict(result), json)
    for path, draw in figures:
        if path is not None:
            from jointid.output.figures.figures import save

            save(draw(result), path)


def ready(listener: Progress, *, derivatives: bool = True) -> None:
    """Load the compiled simulation; where it must be compiled first, say why that takes long.

    Args:
        listener: is told.
        derivatives: whether its derivatives are needed, too.
    """
    from jointid.simulation import closed_loop, sensitivities

    warm_up, takes = (sensitivities.warm_up, 20) if derivatives else (closed_loop.warm_up, 10)
    timer = threading.Timer(
        _PATIENCE, listener, [f"compiling the simulation for this machine; this happens once and takes some {takes} s"]
    )
    timer.daemon = True
    timer.start()
    try:
        warm_up()
    finally:
        timer.cancel()


def check_outputs(*files: Path | None, figures: tuple[Path | None, ...] = ()) -> None:
    """Refuse, before anything runs, what could not be written after it.

    Raises:
        RecordError: a file's folder does not exist, the file is a folder, or a figure has no format.
    """
    for path in (*figures, *files):
        if path is not None and not path.absolute().parent.is_dir():
            raise RecordError(f"{path} cannot be written, because there is no folder {path.parent}; make it first.")
        if path is not None and path.is_dir():
            raise RecordError(f"{path} cannot be written, because it is a folder; name a file in it.")
    for path in figures:
        if path is not None:
            from jointid.output.figures.figures import require_format

            require_format(path)


def make_folder(folder: Path, option: str = "", mode: int = 0o777) -> None:
    """Make a folder, unless it is there.

    Args:
        folder: to make.
        option: that names it, if one does.
        mode: of a new one: who may reach it.

    Raises:
        RecordError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=mode)
    except OSError as error:
        by = f" by {option}" if option else ""
        raise RecordError(f"{folder} cannot be made a folder ({error.strerror}); name another one{by}.") from None
