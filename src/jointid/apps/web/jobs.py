"""Work in processes of its own: queued, followed, cancelled, and survived when it crashes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

from starlette.concurrency import run_in_threadpool

from jointid.apps.web.limits import Limits
from jointid.apps.web.sessions import GONE, PageError, Run, Visitor
from jointid.apps.web.worker import REFUSED

_LAST = 2000  # characters of what a failed process said
_PATIENCE = 5.0  # seconds that a process is given to end
_ENDING = "The page is being stopped; begin it again, and send this once more."


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
        self._reading = asyncio.Semaphore(limits.read_at_once)
        self._readers = 0  # requests whose record is read or waits to be; the event loop's alone
        self._jobs: dict[Path, _Job] = {}
        self._attended: dict[subprocess.Popen[bytes], Path] = {}
        self._closed = False
        self._lock = threading.Lock()

    def submit(self, run: Run) -> None:
        """Queue an identification.

        Raises:
            PageError: too many wait, of this visitor or of all, or the page ends.
        """
        with self._lock:
            if self._closed:
                raise PageError(_ENDING)
            going = [job for job in self._jobs.values() if not job.cancelled.is_set()]
            own = sum(job.run.folder.parent == run.folder.parent for job in going)
            if own >= self._limits.waiting_each:
                raise PageError(f"{own} identifications of yours are waiting or running; cancel one of them first.")
            if len(going) >= self._limits.waiting + self._limits.at_once:
                raise PageError(f"{len(going)} identifications are waiting already; come back in a while.")
            job = self._jobs[run.folder] = _Job(run)
        run.update(state="queued", sentence="Waiting for its turn.", queued=time.time())
        self._pool.submit(self._follow, job)

    def cancel(self, run: Run) -> None:
        """Cancel an identification, whether it waits or runs; one that has ended stays as it is."""
        with self._lock:
            job = self._jobs.get(run.folder)
        if job is not None:
            job.stop()
            if job.process is None:
                _cancelled(run)
            else:
                job.ended.wait(2 * _PATIENCE)

    def forget(self, visitor: Visitor) -> None:
        """End all that a visitor has running, the reading of a record included, and remove their folder."""
        self._end(visitor.folder)  # first: some systems keep a folder in which a process works
        visitor.forget()
        self._end(visitor.folder)  # what began in between

    def _end(self, folder: Path) -> None:
        with self._lock:
            jobs = [job for job in self._jobs.values() if folder in job.run.folder.parents]
            readings = [process for process, place in self._attended.items() if place == folder]
            for process in readings:
                del self._attended[process]  # which tells its request why it ended
        for process in readings:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE)
        for job in jobs:
            if not job.cancelled.is_set():
                self.cancel(job.run)

    def close(self) -> None:
        """End everything; what waits is not begun."""
        with self._lock:
            self._closed = True
            jobs, readings = list(self._jobs.values()), list(self._attended)
        for process in readings:
            process.kill()
        for job in jobs:
            job.stop()
        self._pool.shutdown(wait=True, cancel_futures=True)

    async def attend(self, action: str, folder: Path) -> None:
        """Have a short piece of work done in a visitor's folder, and wait for it; those who wait keep no thread.

        Raises:
            PageError: it refused; the sentences are its own. Or too many wait, or the visitor or the page is gone.
            FileNotFoundError: the folder is not there.
        """
        if self._readers >= self._limits.read_at_once + self._limits.waiting:
            raise PageError(f"{self._readers} records are being read or wait for it; come back in a while.")
        self._readers += 1
        try:
            async with self._reading:
                await run_in_threadpool(self._attend, action, folder)
        finally:
            self._readers -= 1

    def _attend(self, action: str, folder: Path) -> None:
        with self._begun(action, folder) as process:
            try:
                code = process.wait(self._limits.reading)
            except subprocess.TimeoutExpired:
                process.kill()
                raise PageError(
                    f"Reading this record takes longer than {self._limits.reading:.0f} s; send a shorter one."
                ) from None
            forgotten = process not in self._attended
        if forgotten or not folder.is_dir():
            raise PageError(GONE)
        if code:
            raise PageError(_ENDING if self._closed else "\n".join(_sentences(code, folder)))

    @contextlib.contextmanager
    def _begun(self, action: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
        """Begin a process that a deletion, or the end of the page, ends."""
        with self._lock:  # whoever ends all that runs finds it, or comes first
            if self._closed:
                raise PageError(_ENDING)
            started = _Process(action, folder, self._limits.memory)
            self._attended[started.process] = folder
        try:
            with started as process:
                yield process
        finally:
            with self._lock:
                self._attended.pop(started.process, None)

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
            started = _Process("identify", run.folder, self._limits.memory)
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

    def __init__(self, action: str, folder: Path, memory: int) -> None:
        (folder / "fault.json").unlink(missing_ok=True)
        with (folder / "progress.txt").open("wb") as said, (folder / "log.txt").open("wb") as complained:
            self.process = _started(action, folder, memory, said, complained)

    def __enter__(self) -> subprocess.Popen[bytes]:
        return self.process

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.process.wait(_PATIENCE)


def _started(action: str, folder: Path, memory: int, said: IO[bytes], complained: IO[bytes]) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "jointid.apps.web.worker", action, str(folder.absolute()), str(memory)],
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
