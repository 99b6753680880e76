"""Memory that is used again: aligned, no larger than it must be, and never shared between threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np

from jointid.common.arrays import Room


def test_an_array_begins_with_a_line_of_the_cache() -> None:
    room = Room()
    for shape in ((3,), (1000, 8), (0, 4), (7, 3)):
        for dtype in (np.float64, np.int8):
            found = room.array("a", shape, dtype)
            assert found.shape == shape and found.dtype == dtype
            assert found.size == 0 or found.ctypes.data % 64 == 0


def test_threads_have_rooms_of_their_own() -> None:
    room, both = Room(), Barrier(2)

    def fill(value: float) -> bool:
        mine = room.array("a", (1000,))
        mine[:] = value
        both.wait()
        return bool(np.all(mine == value))

    with ThreadPoolExecutor(2) as pool:
        assert all(pool.map(fill, (1.0, 2.0)))
