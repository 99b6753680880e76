"""Bounds on what this process takes: by the system, or by a watch of its own where the system has none."""

from __future__ import annotations

import math
import os
import sys
import threading
import time

LIBRARIES = 2**29  # bytes of addresses that the libraries of the formats take, most of which are never touched
LATE, TOO_LARGE = 4, 5  # exit codes of a process that took more than it may
_POLL = 0.05  # s between looks at what it has taken
_watched: dict[str, int] = {}


def measure_memory() -> int:
    """Return the bytes of memory of this process.

    Addresses on Linux, commitments on Windows, and elsewhere the largest resident size so far.
    """
    if sys.platform == "linux":
        with open("/proc/self/statm", "rb") as file:  # noqa: PTH123 - one file of the system, and no import for it
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    if sys.platform == "win32":
        import ctypes

        counters = (ctypes.c_size_t * 9)(72)  # PROCESS_MEMORY_COUNTERS, whose size is the first entry
        ctypes.windll.kernel32.K32GetProcessMemoryInfo(ctypes.c_void_p(-1), counters, 72)
        return counters[7]
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def limit_resource(what: str, most: int) -> None:
    """Limit a resource of this process; a thread watches memory and time where the system bounds neither."""
    try:
        import resource
    except ImportError:  # Windows
        is_bounded = False
    else:
        is_bounded = what != "RLIMIT_AS" or sys.platform == "linux"
    if is_bounded:
        kind = getattr(resource, what)
        _, hard = resource.getrlimit(kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (least, hard))
        return
    if not _watched:
        threading.Thread(target=_watch, daemon=True).start()
    _watched[what] = most


def _watch() -> None:
    while True:
        time.sleep(_POLL)
        if time.process_time() > _watched.get("RLIMIT_CPU", math.inf):
            os._exit(LATE)
        if measure_memory() > _watched.get("RLIMIT_AS", math.inf):
            os._exit(TOO_LARGE)
