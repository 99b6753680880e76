"""Kernels are compiled once for the same sources; a cache that is damaged or on a full disk costs time alone."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from jointid.common import compiled
from jointid.common.arrays import Room

KERNEL = """
from jointid.common.compiled import compile_kernel

@compile_kernel
def kernel(x):
    return 2.0 * x
"""
PROGRAM = """
import errno, sys
from numba.core.caching import IndexDataCacheFile
def refuse(*_):
    raise OSError(errno.ENOSPC, "full")
if sys.argv[1:]:
    IndexDataCacheFile._save_data = refuse
from stamped import kernel
print(kernel(1.5), sum(kernel.stats.cache_misses.values()))
"""


def run(folder: Path, *full: str) -> tuple[float, int]:
    """Return the result, and how many kernels were compiled."""
    (folder / "stamped.py").write_text(KERNEL)
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    command = [sys.executable, "-B", "-c", PROGRAM, *full]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    result, count = ran.stdout.split()
    return float(result), int(count)


def test_a_change_of_any_kernel_or_tuple_is_another_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "common" / "compiled.py"))
    paths = [tmp_path / one for one in ("common/compiled.py", "simulation/kernels/laws.py", "models/robots/robot.py")]
    found = set()
    for text in ("one", "two"):
        for path in paths:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            found.add(compiled.hash_kernels.__wrapped__())
    assert len(found) == 6


def test_constant_arguments_share_a_kernel() -> None:
    inner = compiled.compile_kernel(lambda x, n: x * n)
    outer = compiled.compile_kernel(lambda x: inner(x, 2) + inner(x, 3))
    assert (outer(1.5), len(inner.signatures)) == (7.5, 1)


@pytest.mark.slow
def test_a_kernel_is_compiled_once_and_again_where_its_cache_is_damaged(tmp_path: Path) -> None:
    assert [run(tmp_path) for _ in "ab"] == [(3.0, 1), (3.0, 0)]
    for ending in ("nbi", "nbc"):
        for path in tmp_path.rglob(f"*.{ending}"):
            path.write_bytes(path.read_bytes()[:-20])
        assert [run(tmp_path) for _ in "ab"] == [(3.0, 1), (3.0, 0)]


@pytest.mark.slow
def test_kernels_read_nothing_beyond_their_arrays(tmp_path: Path) -> None:
    """A rigid joint has one mass, where the kernel of its derivatives read two."""
    program = "from tests.frozen.cases import healthy; [healthy(kind, 'log', 0) for kind in ('rigid', 'flexible')]"
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=environment, cwd=Path(__file__).parents[1], check=True)


@pytest.mark.slow
def test_a_full_disk_costs_time_alone(tmp_path: Path) -> None:
    assert run(tmp_path, "full") == (3.0, 1)
    assert [run(tmp_path) for _ in "ab"] == [(3.0, 1), (3.0, 0)]


def test_threads_have_rooms_of_their_own() -> None:
    room, both = Room(), Barrier(2)

    def fill(value: float) -> bool:
        mine = room.array("a", (1000,))
        mine[:] = value
        both.wait()
        return bool(np.all(mine == value))

    with ThreadPoolExecutor(2) as pool:
        assert all(pool.map(fill, (1.0, 2.0)))
