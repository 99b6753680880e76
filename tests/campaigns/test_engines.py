"""Processes of this machine as workers."""

from __future__ import annotations

import ctypes
import sys

import numpy as np
import pytest

from jointid.campaigns.engines import LocalProcesses

if sys.platform != "win32":
    import resource


def faults(turns: int) -> int:
    """Return how many pages the system gave this process while it took and freed the same 8 MB again and again."""
    before = 0
    for turn in range(turns + 1):
        if turn == 1:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        blocks = [np.ones(2**18) for _ in range(4)]
        del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's")
def test_a_worker_keeps_what_a_case_frees_for_the_next() -> None:
    pages = 10 * 2**23 // 4096
    with LocalProcesses(1).open() as workers:
        assert workers.executor.submit(faults, 10).result() < pages / 10
