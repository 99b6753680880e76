"""The processor time of the quick tests, relative to a reference computation that each process of the run repeats.

A pytest plugin. It measures only if all quick tests are asked for. If they pass, it writes `build/quick-tests.json`,
which `python -m tools.census --check` compares with `tools/budget.toml`. The time counts every process from its start
to its end: imports, collection, compiling and subprocesses. A slow machine is slow at the reference, too.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from pathlib import Path

_SELECTING = ("keyword", "deselect", "ignore", "ignore_glob", "lf", "stepwise", "collectonly")
"""Options that leave tests out."""


def time_reference() -> float:
    """Processor seconds of a fixed computation, half of it plain Python and half of it NumPy on small arrays."""
    began = time.process_time()
    counts: dict[str, int] = {}
    for number in range(1_000_000):
        word = str(number * number % 9973)
        counts[word] = counts.get(word, 0) + len(word)
    values = np.linspace(0.0, 1.0, 2000)
    matrix = np.eye(60) + np.outer(values[:60], values[:60])
    for _ in range(6000):
        values = np.sin(np.cumsum(values) / values.size + 1.0)
        np.linalg.solve(matrix, values[:60])
    return time.process_time() - began


def asks_for_all(config: pytest.Config) -> bool:
    """Test whether a run is that of all quick tests, as `pytest` without arguments is."""
    given = config.getini("addopts")
    quick = given[given.index("-m") + 1] if "-m" in given else ""
    return (
        config.args_source is config.ArgsSource.TESTPATHS
        and config.option.markexpr == quick
        and not any(getattr(config.option, name, None) for name in _SELECTING)
    )


class Reference:
    """The reference, timed at the start and at the end of a process that runs tests."""

    def __init__(self) -> None:
        self.seconds: list[float] = []

    def pytest_sessionstart(self) -> None:
        self.seconds.append(time_reference())

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self.seconds.append(time_reference())
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["reference"] = self.seconds


class Measurement:
    """The sum over all processes, in the process that the user started."""

    def __init__(self, place: Path, seconds: list[float]) -> None:
        self.place = place
        self.references = seconds

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: object) -> None:
        node.workerinput["reference"] = True

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object) -> None:
        self.references += getattr(node, "workeroutput", {}).get("reference", [])

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, exitstatus: int) -> None:
        if exitstatus != pytest.ExitCode.OK:
            return
        used = os.times()  # workers and their subprocesses have ended and are children
        reference = statistics.median(self.references)
        seconds = sum(used[:4]) - sum(self.references)
        found = {
            "ratio": round(seconds / reference),
            "seconds": round(seconds, 1),
            "reference": round(reference, 4),
            "tests": sum(len(terminalreporter.stats.get(kind, ())) for kind in ("passed", "skipped")),
        }
        self.place.parent.mkdir(exist_ok=True)
        self.place.write_text(json.dumps(found) + "\n", encoding="utf-8")
        terminalreporter.write_line(f"Processor time: {seconds:.0f} s, {found['ratio']} times the reference.")


def pytest_configure(config: pytest.Config) -> None:
    """Measure if this process belongs to a run of all quick tests."""
    worker = hasattr(config, "workerinput")
    if not (config.workerinput.get("reference") if worker else asks_for_all(config)):
        return
    reference = Reference()
    if config.option.dist == "no":  # not in a process that only hands the tests out
        config.pluginmanager.register(reference)
    if not worker:
        config.pluginmanager.register(Measurement(config.rootpath / "build" / "quick-tests.json", reference.seconds))
