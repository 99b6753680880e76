"""SLURM jobs that outlive their client, and are found by the next one.

executorlib submits jobs and reads results as files in a shared folder. The cases determine a job's name and folder, and
SLURM's queue shows it, so that a job is known even if the client was killed before writing its number.
"""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from jointid.campaigns.cases import canonical, sha256_of
from jointid.campaigns.engines import Workers
from jointid.common.errors import RecordError, extra

_POLL = 0.5  # s between looks for the result of a job
_LOOK = 10.0  # s between looks at the queue, for the jobs of an earlier client
_MISSED = 2  # looks in a row that a job is not in the queue and has no result, after which it has died
_SCRIPT = """\
#!/bin/bash
#SBATCH --output=time.out
#SBATCH --job-name={{job_name}}
#SBATCH --chdir={{working_directory}}
#SBATCH --get-user-env=L
{%- if partition %}
#SBATCH --partition={{partition}}
{%- endif %}
#SBATCH --ntasks={{cores}}

{{command}}
"""
"""Of a job; pysqa's own has an empty partition where none is named, which is not SLURM's default one."""
_CASES = "cases.txt"  # in the folder of a job, the hashes of its cases


@dataclass(frozen=True, slots=True)
class SlurmJobs:
    """SLURM jobs of several cases, submitted by executorlib, with files in a folder.

    The client may leave: a job that is under way goes on, and what it gives is found in the folder when the same
    command is given again. These files are executorlib's, pickled: whoever writes into the folder runs code as the
    client, so that it is the user's alone.

    Attributes:
        folder: for functions and results, which client and nodes share.
        partition: of SLURM; its default one when empty.
    """

    folder: Path
    jobs: int = 64
    batch: int = 100
    partition: str = ""

    @contextlib.contextmanager
    def open(self, workers: int | None = None) -> Iterator[Workers]:
        """Yield the workers; see `Engine`."""
        try:
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise RecordError(
                f"{self.folder} cannot be made a folder ({(error.strerror or '').lower()}); name another one by "
                "--shared."
            ) from error
        for module in ("pysqa", "h5py"):  # without which executorlib would quietly run all of it here
            extra(module, "slurm", "SLURM")
        executorlib = extra("executorlib", "slurm", "SLURM")
        resources = {"cores": 1, "submission_template": _SCRIPT} | (
            {"partition": self.partition} if self.partition else {}
        )
        executor = executorlib.SlurmClusterExecutor(
            cache_directory=str(self.folder), resource_dict=resources, wait=False, refresh_rate=_POLL
        )
        jobs = _NamedJobs(executor, self.folder)
        try:
            # Of two jobs with the same case, the later one counts.
            found: dict[str, frozenset[str]] = {}
            for path in sorted(self.folder.glob(f"*/{_CASES}"), key=lambda path: path.stat().st_mtime_ns):
                job = frozenset(path.read_text(encoding="ascii").split())
                found |= dict.fromkeys(job, job)
            yield Workers(jobs, lambda: workers or self.jobs, self.batch, ahead=1, submitted=found)
        finally:
            jobs.shutdown(wait=False)

    def is_death(self, error: BaseException) -> bool:
        """Test whether a job ended without a result."""
        return isinstance(error, RuntimeError) and "terminated without producing output" in str(error)


class _NamedJobs(Executor):
    """executorlib's jobs by name; those of an earlier client are awaited, not repeated."""

    def __init__(self, executor: Any, folder: Path) -> None:
        self._executor, self._folder = executor, folder
        self._earlier: dict[str, tuple[Future[Any], Callable[[], Future[Any]]]] = {}
        self._over, self._watch = threading.Event(), threading.Thread(target=self._wait_for_earlier, daemon=True)

    def submit(self, function: Callable[..., Any], /, *given: Any, **_: Any) -> Future[Any]:
        """Submit a function with a case function and cases."""
        carry, cases = given
        called = getattr(carry, "__qualname__", repr(carry))
        name = sha256_of(canonical([called, sorted(case.content_hash for case in cases)]))
        own = self._folder / name

        def hand_out() -> Future[Any]:
            asked: Future[Any] = self._executor.submit(
                function, *given, resource_dict={"cache_key": name, "cwd": str(own)}
            )
            return asked

        ended = f"{name}_o.h5" in _names_in(self._folder)
        if ended:
            result = self._folder / f"{name}_o.h5"
            with extra("h5py", "slurm", "SLURM").File(result, "r") as file:
                failed = "error" in file
            if failed:
                result.unlink()
        elif (own / _CASES).exists():
            # executorlib looks for a result, and then at the queue: what ends in between it would make again.
            future: Future[Any] = Future()
            self._earlier[name] = future, hand_out
            if not self._watch.is_alive():
                self._watch.start()
            return future
        own.mkdir(exist_ok=True)
        (own / _CASES).write_text("\n".join(case.content_hash for case in cases), encoding="ascii")
        return hand_out()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the jobs running."""
        self._over.set()
        if self._watch.is_alive():
            self._watch.join()
        self._executor.shutdown(wait=wait, cancel_futures=cancel_futures)

    def _wait_for_earlier(self) -> None:
        """Collect the results of an earlier client's jobs."""
        missed, checked = Counter[str](), -_LOOK
        while not self._over.wait(_POLL):
            if time.monotonic() - checked >= _LOOK:
                checked, queue = time.monotonic(), _queue()
                if queue is not None:
                    missed = Counter({name: missed[name] + 1 for name in list(self._earlier) if name not in queue})
            try:
                there = _names_in(self._folder)
            except OSError:  # a disk in a network comes back, or Ctrl-C ends the wait
                continue
            for name, (future, hand_out) in list(self._earlier.items()):
                if f"{name}_o.h5" in there or missed[name] >= _MISSED:
                    del self._earlier[name]
                    hand_out().add_done_callback(partial(_pass_on, future))


def _names_in(folder: Path) -> set[str]:
    """Names in a folder; listing refreshes a network disk's cache."""
    return {path.name for path in folder.iterdir()}


def _queue() -> set[str] | None:
    """Names of queued or running jobs; None if the queue does not answer."""
    try:
        found = subprocess.run(
            ["squeue", "--noheader", "--format", "%Z"],  # noqa: S607 - where SLURM's are, the path says
            capture_output=True, text=True, check=True, timeout=6 * _LOOK,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return {Path(line.strip()).name for line in found.stdout.splitlines()}


def _pass_on(future: Future[Any], found: Future[Any]) -> None:
    """Copy the result of a future to another."""
    if found.cancelled():
        future.cancel()
    elif (error := found.exception()) is not None:
        future.set_exception(error)
    else:
        future.set_result(found.result())
