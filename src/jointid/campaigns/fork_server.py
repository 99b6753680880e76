"""Preparation of the fork server of the workers, which loads this module first.

A client may be interrupted or killed while the server still loads. A worker forked for it then fails without a word, as
nobody waits for it; of any other failure the client says a sentence. A program without ``if __name__ == "__main__"``
fails with Python's explanation. Every worker hears Ctrl-C unless it chose to ignore it: the program may have more.
"""

from __future__ import annotations

import os
import signal
import sys
from multiprocessing import util

IS_SERVER = "JOINTID_FORK_SERVER"
"""Is set for the server alone."""


def _hear_interrupts(_: object) -> None:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))


if os.environ.pop(IS_SERVER, None):
    sys.excepthook = lambda kind, *about: sys.__excepthook__(kind, *about) if issubclass(kind, RuntimeError) else None
    util.register_after_fork(sys.modules[__name__], _hear_interrupts)
