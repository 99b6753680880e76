"""Running cases, several at a time, each process in a folder of its own."""

from __future__ import annotations

import json
import os
import tempfile
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tools.golden import adapter
from tools.golden.cases import CASES, SLOWEST, Skipped, Workspace


def run(chosen: list[str], jobs: int) -> tuple[dict[str, Any], bool]:
    """Return the numbers of every case that runs, and whether one broke."""
    found: dict[str, Any] = {}
    broken = False
    begin = time.perf_counter()
    adapter.ready()  # compiled once, where it must be compiled
    first = [name for name in SLOWEST if name in chosen]
    order = first + [name for name in chosen if name not in first]
    with tempfile.TemporaryDirectory(prefix="golden") as folder:
        pool = ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_begin, initargs=(folder,))
        with pool:
            for ended in as_completed([pool.submit(_ran, name) for name in order]):
                name, wall, cpu, numbers, said = ended.result()
                if numbers is not None:
                    found[name] = numbers
                broken |= said.startswith("BROKEN")
                print(f"{wall:6.1f} s ({cpu:5.1f} s cpu)  {name}  {said}".rstrip(), flush=True)
    print(f"{time.perf_counter() - begin:6.1f} s in all", flush=True)
    return found, broken


_HERE: list[Workspace] = []
"""The workspace of this process."""


def _begin(folder: str) -> None:
    warnings.simplefilter("ignore")
    _HERE.append(Workspace(Path(folder) / str(os.getpid())))
    adapter.ready()


def _ran(name: str) -> tuple[str, float, float, Any, str]:
    """Return name, seconds on the clock and of the processor, numbers and remark of a case."""
    wall, cpu, numbers, said = time.perf_counter(), time.process_time(), None, ""
    try:
        numbers = json.loads(json.dumps(CASES[name](_HERE[0]), allow_nan=False))
    except Skipped as why:
        said = f"skipped: {why}"
    except Exception as error:
        said = f"BROKEN: {type(error).__name__}: {error}"
    return name, time.perf_counter() - wall, time.process_time() - cpu, numbers, said
