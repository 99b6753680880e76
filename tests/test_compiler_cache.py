"""A kernel whose sources change is compiled again, and so is one whose cache is damaged or torn by a full disk."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNEL = """
from jointid.common.compiled import compile_kernel
from stamped.helper import Outer, scaled

@compile_kernel
def kernel(x, outer):
    return scaled(x) + outer.inner.a
"""
HELPER = """
from typing import NamedTuple
from jointid.common.compiled import inline_kernel
from stamped.tuples import Inner

FACTOR = 2.0

class Outer(NamedTuple):
    inner: Inner

@inline_kernel
def scaled(x):
    return FACTOR * x
"""
TUPLES = """
from typing import NamedTuple

class Inner(NamedTuple):
    a: float
    b: float
"""
PROGRAM = """
import errno, sys
from numba.core.caching import IndexDataCacheFile
def refuse(*_):
    raise OSError(errno.ENOSPC, "full")
if sys.argv[1:]:
    IndexDataCacheFile._save_data = refuse
from stamped.kernel import kernel
from stamped.helper import Outer
from stamped.tuples import Inner
print(kernel(1.0, Outer(Inner(a=1.0, b=5.0))), sum(kernel.stats.cache_misses.values()))
"""


class Package:
    """A package of a kernel, a helper that it calls, and the tuples that it takes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "stamped"
        self.folder.mkdir()
        self.environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
        for name, text in (("__init__", ""), ("kernel", KERNEL), ("helper", HELPER), ("tuples", TUPLES)):
            (self.folder / f"{name}.py").write_text(text)

    def edit(self, name: str, was: str, becomes: str) -> None:
        path = self.folder / f"{name}.py"
        assert was in path.read_text()
        path.write_text(path.read_text().replace(was, becomes))

    def run(self, *full: str) -> tuple[float, int, str]:
        """Return the result, how many kernels were compiled, and warnings."""
        command = [sys.executable, "-B", "-c", PROGRAM, *full]
        ran = subprocess.run(command, env=self.environment, capture_output=True, text=True, check=True)
        result, compiled = ran.stdout.split()
        return float(result), int(compiled), ran.stderr


@pytest.mark.slow
def test_a_kernel_is_compiled_again_after_any_change_and_only_then(tmp_path: Path) -> None:
    package = Package(tmp_path)
    assert [package.run()[:2] for _ in "ab"] == [(3.0, 1), (3.0, 0)]
    package.edit("helper", "FACTOR = 2.0", "FACTOR = 3.0")
    assert [package.run()[:2] for _ in "ab"] == [(4.0, 1), (4.0, 0)]
    package.edit("tuples", "a: float\n    b: float", "b: float\n    a: float")
    assert [package.run()[:2] for _ in "ab"] == [(4.0, 1), (4.0, 0)]
    package.edit("tuples", "\nclass", "\n\n\nclass")
    assert package.run()[:2] == (4.0, 0)
    assert len(list(tmp_path.rglob("*.nbc"))) == 1, "those of former sources are removed"


@pytest.mark.slow
def test_a_full_disk_leaves_nothing_of_former_code(tmp_path: Path) -> None:
    """The index is written before the data, which then may be those of the former code."""
    package = Package(tmp_path)
    package.run()
    package.edit("kernel", "+ outer", "+ 100.0 + outer")
    result, _, said = package.run("full")
    assert result == 103.0 and "cannot be written" in said
    assert [package.run()[:2] for _ in "ab"] == [(103.0, 1), (103.0, 0)]


@pytest.mark.slow
def test_a_damaged_cache_is_compiled_again(tmp_path: Path) -> None:
    package = Package(tmp_path)
    package.run()
    for ending in ("nbi", "nbc"):
        for path in tmp_path.rglob(f"*.{ending}"):
            path.write_bytes(path.read_bytes()[:-20])
        found = [package.run() for _ in "ab"]
        assert [one[:2] for one in found] == [(3.0, 1), (3.0, 0)]
        assert ["is damaged" in one[2] for one in found] == [True, False]
