"""What commands print, and where: answers on standard output, progress on standard error."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from jointid.common.progress import Progress, silent

_PATIENCE = 1.0  # seconds after which the first simulation must be compiling


def show(text: object = "") -> None:
    """Print an answer."""
    print(text)  # noqa: T201


def tell(message: str) -> None:
    """Print a line of progress."""
    print(message, file=sys.stderr, flush=True)  # noqa: T201


def progress(quiet: bool) -> Progress:
    """Return who listens to progress."""
    return silent if quiet else tell


@contextmanager
def compiling(listener: Callable[[str], None]) -> Iterator[None]:
    """Say why the first simulation on a machine takes long; a compiled one is over before that."""
    timer = threading.Timer(
        _PATIENCE, listener, ["compiling the simulation for this machine; this happens once and takes some 15 s"]
    )
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
