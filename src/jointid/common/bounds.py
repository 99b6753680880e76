"""A bound on the memory of this process: by the system, or by a watch of its own where the system has none."""

from __future__ import annotations

import os
import sys
import threading
import time

LIBRARIES = 2**29  # bytes of addresses that the libraries of the formats take, most of which are never touched
TOO_LARGE = 5  # exit code of a process that took more than it may
_POLL = 0.05  # s between looks at what it has taken


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


def limit_memory(most: int) -> None:
    """Limit the memory of this process, in bytes; a thread watches it where the system bounds none."""
    if sys.platform != "linux":
        threading.Thread(target=_watch, args=(most,), daemon=True).start()
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    least = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (least, hard))


def _watch(most: int) -> None:
    while measure_memory() <= most:
        time.sleep(_POLL)
    os._exit(TOO_LARGE)
