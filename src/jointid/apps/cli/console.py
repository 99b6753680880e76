"""What commands have in common: where they print, what they may write, and that they identify first."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.common.progress import Progress, silent
from jointid.common.text import printable

if TYPE_CHECKING:
    from jointid import Estimate, Record
    from jointid.config import JointFile

_PATIENCE = 2.0  # seconds after which the simulation is not being loaded but compiled


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


def progress(quiet: bool) -> Progress:
    """Return who listens to progress."""
    return silent if quiet else tell


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


def identified(file: JointFile, record: Path | None, listener: Progress) -> tuple[Record, Estimate]:
    """Identify a joint as its file says, and return the record, too.

    Args:
        file: the joint file.
        record: instead of the one the joint file names.
        listener: is told the progress.

    Raises:
        JointidError: the record cannot be read, or the joint cannot be identified from it.
    """
    logged = file.record(record)
    ready(listener)
    return logged, file.identify(logged, listener)


def check_outputs(figure: Path | None = None, *files: Path | None) -> None:
    """Refuse, before anything runs, what could not be written after it.

    Raises:
        RecordError: a file's folder does not exist, the file is a folder, or a figure has no format.
    """
    from jointid.common.errors import RecordError

    for path in (figure, *files):
        if path is not None and not path.absolute().parent.is_dir():
            raise RecordError(f"{path} cannot be written, because there is no folder {path.parent}; make it first.")
        if path is not None and path.is_dir():
            raise RecordError(f"{path} cannot be written, because it is a folder; name a file in it.")
    if figure is not None:
        from jointid.output.figures.figures import require_format

        require_format(figure)


def make_folder(folder: Path) -> Path:
    """Make a folder, unless it is there.

    Raises:
        RecordError: it cannot be made.
    """
    from jointid.common.errors import RecordError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{folder} cannot be made a folder ({error.strerror}); name another one.") from None
    return folder
