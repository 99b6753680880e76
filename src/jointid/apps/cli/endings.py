"""Ctrl-C and a request to end (SIGTERM, SIGHUP): whatever is being written is tidied away, and there is no traceback.

Python raises an exception where the program stands, and that may be a place that swallows exceptions or makes others of
them: an import, a callback of a library. What came is therefore kept here, and asked for when the program ends.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

from jointid.apps import INTERRUPTED, WHOLE

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_MOMENT = 0.02  # s

_received: list[int] = []


class EndedError(BaseException):
    """The program was asked to end; no search keeps its best for that."""


def describe(number: int) -> str:
    """Return the sentence on the signal that ends the program."""
    return INTERRUPTED if number == signal.SIGINT else f"Ended by {signal.Signals(number).name}; {WHOLE}"


def listen_to_signals() -> None:
    """End the program by an exception on a signal; ignored signals stay ignored."""
    signal.signal(signal.SIGINT, _receive)
    for name in ("SIGTERM", "SIGHUP"):
        one = getattr(signal, name, None)
        if one is not None and signal.getsignal(one) is signal.SIG_DFL:
            signal.signal(one, _receive)
    sys.unraisablehook = _raise_again


def ignore_signals() -> None:
    """Ignore signals from now on, as the program is about to end."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        one = getattr(signal, name, None)
        if one is not None:
            signal.signal(one, signal.SIG_IGN)


def last_signal() -> int | None:
    """Return the last signal, or None."""
    return _received[-1] if _received else None


def _receive(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    if frame is not None and frame.f_code is _raise_again.__code__:  # which swallows what is raised in it
        _once_more()
        return
    raise KeyboardInterrupt if number == signal.SIGINT else EndedError


def _raise_again(swallowed: UnraisableHookArgs) -> None:
    """Raise an ending again that a callback has swallowed; report other exceptions as usual."""
    if isinstance(swallowed.exc_value, KeyboardInterrupt | EndedError) and _received:
        _once_more()
    else:
        sys.__unraisablehook__(swallowed)


def _once_more() -> None:
    """Send the last signal again a moment later, as here it cannot be raised."""
    again = threading.Timer(_MOMENT, _send, (signal.Signals(_received[-1]),))
    again.daemon = True
    again.start()


def _send(number: signal.Signals) -> None:
    """Send a signal to the main thread, and wake it where possible."""
    if sys.platform == "win32":
        _thread.interrupt_main(number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)
