"""Work in processes of its own: queued, followed, cancelled, and survived when it crashes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

from jointid.web.limits import Limits
from jointid.web.sessions import PageError, Run, Visitor
from jointid.web.worker import REFUSED

_LAST = 2000  # characters of what a failed process said
_PATIENCE = 5.0  # seconds that a process is given to end


class _Job:
    """One identification on its way through the queue."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.cancelled = threading.Event()
        self.ended = threading.Event()
        self.process: subprocess.Popen[bytes] | None = None
        self.lock = threading.Lock()

    def stop(self) -> None:
        """Do not begin, or end."""
        with self.lock:
            self.cancelled.set()
            if self.process is not None and self.process.poll() is None:
                self.process.terminate()


class Jobs:
    """The identifications of all visitors: so many run at once, the others wait their turn."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._pool = ThreadPoolExecutor(limits.at_once, "identification")
        self._reading = threading.BoundedSemaphore(2)
        self._jobs: dict[Path, _Job] = {}
        self._lock = threading.Lock()

    def submit(self, run: Run) -> None:
        """Queue an identification.

        Raises:
            PageError: too many wait.
        """
        with self._lock:
            if len(self._jobs) >= self._limits.waiting + self._limits.at_once:
                raise PageError(f"{len(self._jobs)} identifications are waiting already; come back in a while.")
            job = self._jobs[run.folder] = _Job(run)
        run.update(state="queued", sentence="Waiting for its turn.", queued=time.time())
        self._pool.submit(self._follow, job)

    def cancel(self, run: Run) -> None:
        """Cancel an identification, whether it waits or runs; one that has ended stays as it is."""
        with self._lock:
            job = self._jobs.get(run.folder)
        if job is not None:
            job.stop()
            if run.status["state"] == "queued":
                _cancelled(run)
            else:
                job.ended.wait(2 * _PATIENCE)

    def forget(self, visitor: Visitor) -> None:
        """End all that a visitor has running."""
        for run in visitor.runs:
            self.cancel(run)

    def close(self) -> None:
        """End everything; what waits is not begun."""
        with self._lock:
            jobs = list(self._jobs.values())
        for job in jobs:
            job.stop()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def attend(self, action: str, folder: Path) -> None:
        """Have a short piece of work done, and wait for it.

        Raises:
            PageError: it refused; the sentences are its own.
        """
        with self._reading, _Process(action, folder) as process:
            try:
                code = process.wait(self._limits.reading)
            except subprocess.TimeoutExpired:
                process.kill()
                raise PageError(
                    f"Reading this record takes longer than {self._limits.reading:.0f} s; send a shorter one."
                ) from None
        if code:
            raise PageError("\n".join(_sentences(code, folder)))

    def _follow(self, job: _Job) -> None:
        run = job.run
        try:
            self._run(job)
        except Exception as error:  # whatever it is, the next one is to have its turn
            run.update(state="failed", sentence=f"The page failed, which is a fault of ours ({error}).")
        finally:
            with self._lock:
                self._jobs.pop(run.folder, None)
            job.ended.set()

    def _run(self, job: _Job) -> None:
        run = job.run
        with job.lock:
            if job.cancelled.is_set():
                _cancelled(run)
                return
            started = _Process("identify", run.folder)
            job.process = started.process
        run.update(state="running", sentence="", started=time.time())
        with started as process:
            try:
                code = process.wait(self._limits.seconds)
            except subprocess.TimeoutExpired:
                process.kill()
                minutes = self._limits.seconds / 60
                sentence = f"It took longer than {minutes:.0f} minutes and was stopped; use a shorter record."
                run.update(state="failed", sentence=sentence, ended=time.time())
                return
        if job.cancelled.is_set():
            _cancelled(run)
        elif code == 0:
            run.update(state="done", sentence="", ended=time.time())
        else:
            state = "refused" if code == REFUSED else "failed"
            run.update(state=state, sentence="\n".join(_sentences(code, run.folder)), ended=time.time())


class _Process:
    """A worker, its progress and its complaints going to files in its folder; ended when it is left."""

    def __init__(self, action: str, folder: Path) -> None:
        (folder / "fault.json").unlink(missing_ok=True)
        with (folder / "progress.txt").open("wb") as said, (folder / "log.txt").open("wb") as complained:
            self.process = _started(action, folder, said, complained)

    def __enter__(self) -> subprocess.Popen[bytes]:
        return self.process

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.wait(_PATIENCE)


def _started(action: str, folder: Path, said: IO[bytes], complained: IO[bytes]) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "jointid.web.worker", action, str(folder.absolute())],
        stdin=subprocess.PIPE,
        stdout=said,
        stderr=complained,
        cwd=folder,
        env=environment,
    )


def _cancelled(run: Run) -> None:
    run.update(state="cancelled", sentence="You cancelled it.", ended=time.time())


def _sentences(code: int, folder: Path) -> list[str]:
    """Return why a worker ended: its own sentences, or what its exit says."""
    if code == REFUSED:
        with contextlib.suppress(OSError, ValueError):
            return [str(line) for line in json.loads((folder / "fault.json").read_text(encoding="utf-8"))]
    if code < 0:
        return [
            f"It was ended from outside (signal {-code}), as the system does when memory runs out; use a shorter "
            "record, or press Identify again. Nothing else on this page is affected."
        ]
    try:
        said = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")[-_LAST:].strip().splitlines()
    except OSError:
        said = []
    last = said[-1] if said else f"exit code {code}"
    return [f"It failed, which is a fault of ours ({last}); please report it with the record's joint file."]
