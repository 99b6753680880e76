"""The stamp of a compiled kernel, and a cache that is damaged."""

from __future__ import annotations

import os
import subprocess
import sys
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


@pytest.mark.slow
def test_a_damaged_cache_is_compiled_again(tmp_path: Path) -> None:
    (tmp_path / "cached.py").write_text(SOURCE)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", "from cached import kernel; print(kernel(1.0), kernel.stats.cache_misses)"]
    shown = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True)]
    for ending in ("nbi", "nbc"):
        for path in tmp_path.rglob(f"*.{ending}"):
            path.write_bytes(path.read_bytes()[:-20])
        shown += [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in "ab"]
    assert {one.stdout[:3] for one in shown} == {"3.0"}
    assert ["is damaged" in one.stderr for one in shown] == [False, True, False, True, False]
