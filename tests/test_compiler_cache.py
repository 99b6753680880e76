"""The stamp of a compiled kernel, and the lock on its compilation."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from jointid.common.compiler_cache import _stamp

SOURCE = '''
from __future__ import annotations
from typing import NamedTuple
from jointid.common.compiled import compile_kernel, inline_kernel

FACTOR = 2.0

@inline_kernel
def scaled(x):
    """Scale a number."""
    return FACTOR * x

class Inner(NamedTuple):
    a: float
    b: float

class Outer(NamedTuple):
    inner: Inner

@compile_kernel
def kernel(x, outer: Outer | None = None):
    """Do it."""
    return scaled(x) + 1.0

def other(x):
    return x
'''
WORKER = """
import sys, time
from pathlib import Path
import numba, numpy
from cached import kernel
place, own = Path(sys.argv[1]), sys.argv[2]
(place / own).touch()
while not all((place / name).exists() for name in "ab"):
    time.sleep(0.001)
kernel(1.0)
print(sum(kernel.stats.cache_misses.values()))
"""


def stamp_of(source: str, options: dict[str, Any] | None = None) -> str:
    sys.modules["stamped"] = module = ModuleType("stamped")
    names: dict[str, Any] = vars(module)
    names |= {"compile_kernel": lambda function: function, "inline_kernel": lambda function: function}
    exec(source.replace("from jointid.common.compiled import compile_kernel, inline_kernel", ""), names)
    return _stamp(names["kernel"], options or {})


@pytest.mark.parametrize(
    ("was", "becomes", "another"),
    [
        ("+ 1.0", "+ 1.5", True),
        ("FACTOR * x", "FACTOR + x", True),
        ("FACTOR = 2.0", "FACTOR = 3.0", True),
        ("    a: float\n    b: float", "    b: float\n    a: float", True),
        ("Scale a number", "Multiply", False),
        ("def other(x):\n    return x", "def other(x):\n    return -x", False),
        ("FACTOR = 2.0", "\n\nFACTOR = 2.0", False),
    ],
)
def test_a_stamp_changes_with_what_is_compiled_and_with_nothing_else(was: str, becomes: str, another: bool) -> None:
    assert was in SOURCE
    assert (stamp_of(SOURCE) != stamp_of(SOURCE.replace(was, becomes))) is another
    assert stamp_of(SOURCE) != stamp_of(SOURCE, {"fastmath": True})


FULL = """
import sys, warnings
from jointid.common import compiler_cache
def refuse(*_):
    raise OSError(28, "full")
if sys.argv[1:]:
    compiler_cache._CheckedFile._save_data = refuse
warnings.simplefilter("ignore")
from cached import kernel
print(kernel(1.0))
"""


@pytest.mark.slow
def test_former_code_never_runs_under_a_new_stamp(tmp_path: Path) -> None:
    """A disk that fills after the index is written leaves the data of the former code beside it."""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run(source: str, *full: str) -> str:
        (tmp_path / "cached.py").write_text(source)
        command = [sys.executable, "-B", "-c", FULL, *full]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    assert run(SOURCE) == "3.0\n"
    edited = SOURCE.replace("+ 1.0", "+ 100.0")
    assert run(edited, "full") == "102.0\n"
    assert run(edited) == "102.0\n"


def test_a_compilation_that_fails_releases_its_lock() -> None:
    from numba import TypingError

    from jointid.common.compiled import compile_kernel

    @compile_kernel
    def impossible(x: Any) -> Any:
        return x.nothing

    with pytest.raises(TypingError):
        impossible(1.0)
    assert impossible._cache.lock._file < 0  # type: ignore[attr-defined]


@pytest.mark.skipif(importlib.util.find_spec("fcntl") is None, reason="there are no file locks here")
def test_threads_release_a_lock_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that finds the kernel compiled does not close the file that another thread is about to close."""
    import fcntl

    from jointid.common.compiled import compile_kernel

    @compile_kernel
    def doubled(x: float) -> float:
        return 2.0 * x

    flock = fcntl.flock

    def release_slowly(file: int, operation: int) -> None:
        flock(file, operation)
        if operation == fcntl.LOCK_UN:
            time.sleep(0.1)

    monkeypatch.setattr(fcntl, "flock", release_slowly)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(doubled, [1.0] * 4)) == [2.0] * 4


@pytest.mark.skipif(importlib.util.find_spec("fcntl") is None, reason="there are no file locks here")
def test_of_two_processes_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "cached.py").write_text(SOURCE)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, str(tmp_path), name], env=environment, stdout=subprocess.PIPE, text=True
        )
        for name in "ab"
    ]
    misses = [int(process.communicate(timeout=120)[0]) for process in both]
    assert sorted(misses) == [0, 1]


def test_a_killed_process_releases_its_lock(tmp_path: Path) -> None:
    """The operating system does it."""
    from jointid.common.compiler_cache import _CompileLock

    path = tmp_path / "kernel.lock"
    program = (
        "import sys; from pathlib import Path; from jointid.common.compiler_cache import _CompileLock\n"
        "lock = _CompileLock(Path(sys.argv[1])); lock.acquire(); print('held', flush=True); input()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    holder.kill()
    holder.communicate()
    began = time.monotonic()
    _CompileLock(path).acquire()
    assert time.monotonic() - began < 60.0


CARRIED = """
import numpy as np
from jointid.common.compiled import carry
said = np.ones((1, 40, 8))
carry(np.full((2, 4), 0.5), said, 1)
print(repr(float(said.sum())))
"""


def compute(cache: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, "-c", CARRIED], env=environment, capture_output=True, text=True, check=False)


@pytest.mark.hostile
def test_a_damaged_cache_is_compiled_again_and_one_that_cannot_be_written_is_done_without(tmp_path: Path) -> None:
    good = compute(tmp_path)
    for suffix in (".nbi", ".nbc"):
        (kept,) = tmp_path.rglob(f"*carry*{suffix}")
        kept.write_bytes(kept.read_bytes()[: kept.stat().st_size // 2])
        ended = compute(tmp_path)
        assert (ended.returncode, ended.stdout) == (0, good.stdout), ended.stderr
        assert "is damaged" in ended.stderr and "Traceback" not in ended.stderr
        assert compute(tmp_path).stderr == ""
    (index,) = tmp_path.rglob("*carry*.nbi")
    index.unlink()
    index.mkdir()  # even root cannot write a file there
    ended = compute(tmp_path)
    assert (ended.returncode, ended.stdout) == (0, good.stdout), ended.stderr
    assert "cannot be written" in ended.stderr
