"""Preparation of the fork server of the workers, which loads this module first.

A client may be interrupted or killed while the server still loads. A worker forked for it then fails without a word, as
nobody waits for it; of any other failure the client says a sentence. The server removes its socket and the empty folder
of it, which a killed client cannot. Every worker hears Ctrl-C unless it chose to ignore it: the program may have more.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from multiprocessing import forkserver, util

SOCKETS = "JOINTID_SOCKETS"
"""Names the folder of the socket to the server, which is empty where the server may not remove it."""

_folder = os.environ.pop(SOCKETS, None)


def _remove_socket(folder: str) -> None:
    with contextlib.suppress(OSError, TypeError, ValueError):  # there is none yet, or it is no file
        os.unlink(forkserver._forkserver._forkserver_address)  # type: ignore[attr-defined]  # noqa: PTH108
        os.rmdir(folder)  # noqa: PTH106 - the path may be empty, which is no folder


def _hear_interrupts(_: object) -> None:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))


if _folder is not None:
    sys.excepthook = lambda *_: None
    atexit.register(_remove_socket, _folder)
    util.register_after_fork(sys.modules[__name__], _hear_interrupts)
