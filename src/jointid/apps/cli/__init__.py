"""The command line: one file per command, each a thin call of a verb."""

from __future__ import annotations

import os

from jointid.apps import INTERRUPTED, SIGNALLED

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the program and exit; `arguments` are those of the command line when None.

    Ctrl-C ends the program at once while it is being loaded, which is most of a short command's time: nothing is being
    written yet, and an exception might be swallowed by the module that is being loaded.
    """
    try:
        # A module in C, always there: Ctrl-C in the middle of the import of `signal` would be ignored, and said to be.
        import _signal  # type: ignore[import-not-found]

        loading = arguments is None and _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler
        if loading:
            _signal.signal(_signal.SIGINT, _leave)
    except KeyboardInterrupt:
        _leave(2)  # SIGINT, whose name has not been loaded
    from jointid.apps.cli.app import run

    run(arguments, signals=loading)


def _leave(number: int, _: object = None) -> None:
    try:
        os.write(2, f"jointid: {INTERRUPTED}\n".encode())
    finally:
        os._exit(SIGNALLED + number)
