"""Seeds judged in parallel processes, each outcome kept as it comes, so that a study may be interrupted."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class Task:
    """One seed of a study: a function as "module:name", its seed and its other arguments."""

    function: str
    seed: int
    settings: Mapping[str, Any]

    @property
    def key(self) -> str:
        """The task as one line of JSON."""
        return json.dumps([self.function, self.seed, self.settings], sort_keys=True)


@dataclass(frozen=True, slots=True)
class Judged:
    """The outcome of a task as JSON has it, and the seconds of the processor that it took."""

    outcome: Any
    seconds: float


def judge_tasks(tasks: Sequence[Task], out: Path | None = None) -> list[Judged]:
    """Judge tasks in parallel.

    Args:
        tasks: to be judged; the functions return a dataclass, plain values or None.
        out: folder in which outcomes are kept and found again; none are kept when None.
    """
    found: dict[str, Judged] = {}
    with contextlib.ExitStack() as stack:
        file = None
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context((out / "outcomes.jsonl").open("a+", encoding="utf-8"))
            file.seek(0)
            found = {line["task"]: Judged(line["outcome"], line["seconds"]) for line in map(json.loads, file)}
        missing = [task for task in tasks if task.key not in found]
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a second thread of linear algebra only waits for the first
        pool = stack.enter_context(ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")))
        running = {pool.submit(_judge, task): task for task in missing}
        for done, future in enumerate(as_completed(running), 1):
            task, judged = running[future], future.result()
            found[task.key] = judged
            if file is not None:
                file.write(json.dumps({"task": task.key, **asdict(judged)}) + "\n")
                file.flush()
            sys.stderr.write(f"{done} of {len(missing)}: {task.function}, seed {task.seed}\n")
    return [found[task.key] for task in tasks]


def _judge(task: Task) -> Judged:
    module, _, name = task.function.partition(":")
    function, began = getattr(import_module(module), name), time.process_time()
    found = function(task.seed, **task.settings)
    outcome = json.loads(json.dumps(found, default=asdict))  # a margin may be infinite, which this notation has
    return Judged(outcome, time.process_time() - began)
