"""The command line: one file per command, which calls a verb."""

from __future__ import annotations

import signal

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the program and exit, by default with the command line's arguments.

    During loading, most of a short command's time, Ctrl-C ends the program at once: nothing is being written yet, and
    the module being loaded might swallow an exception.
    """
    if arguments is None and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from jointid.apps.cli.app import run

    run(arguments, signals=arguments is None)
