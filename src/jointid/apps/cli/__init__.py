"""The command line: one file per command, each a thin call of a verb."""

from __future__ import annotations

import signal

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the program and exit; `arguments` are those of the command line when None.

    Ctrl-C ends the program at once while it is being loaded, which is most of a short command's time: nothing is being
    written yet, and an exception might be swallowed by the module that is being loaded.
    """
    loading = arguments is None and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if loading:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from jointid.apps.cli.app import run

    run(arguments, signals=loading)
