"""Work in processes of its own, which may be cancelled or crash while the page stays up."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import os
import sys
import tempfile
import time
from asyncio.subprocess import PIPE
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jointid.apps.web.folder import FULL, Limits, PageError, Run, read_json, refuse_link, write_json
from jointid.apps.web.worker import NO_ROOM, REFUSED
from jointid.common.bounds import TOO_LARGE
from jointid.common.errors import Fault, JointFileError, JointidError
from jointid.common.files import is_full

_LOADING = "loading the simulation; the first time on a machine it is compiled, which takes some 20 s"
_TOO_LARGE = (
    "The record, or what is asked of it, is too large for the memory that this page gives one run; cut the record or "
    "resample it slower, or use the command line, which has no such bound: jointid identify, or jointid identify "
    "--window for a record of hours."
)
_LAST = 2000  # characters of what a failed process wrote
_SIDE_BY_SIDE = 2  # processes that look at forms


class FailedError(PageError):
    """A process that ended otherwise than by its answer or a sentence about the record."""


class Jobs:
    """The processes at work: readers that a request waits for, and one identification at a time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None
        self._preparing: asyncio.Task[None] | None = None
        self._asking = asyncio.Semaphore(_SIDE_BY_SIDE)

    def prepare(self) -> None:
        """Have the simulation compiled while the person fills in the form: the first time that takes half a minute."""
        if self._preparing is None:
            self._preparing = asyncio.create_task(self._prepare())

    async def require_idle(self, *, yields: bool = True) -> None:
        """Raise a `PageError` while an identification is running.

        One that only lacks its report, or a plan, gives way where that is allowed.
        """
        if self._run is not None and self._task is not None and not self._task.done():
            if self._run.answered and not yields:
                raise PageError(f"Identification {self._run.number} is still at work; wait for its end.")
            if self._run.answered:
                planning = self._run.status["state"] == "planning"
                what = "a test was planned" if planning else "its report was written"
                await self.cancel(self._run, f"Another identification was started before {what}.")
                return
            raise PageError(
                f"Identification {self._run.number} is still running; wait for its end or cancel it in step 4, then "
                "press Identify again."
            )

    def start(self, run: Run) -> None:
        """Start an identification."""
        self._run, self._task = run, asyncio.create_task(self._identify(run))

    def start_planning(self, run: Run) -> None:
        """Start planning the next test after an identification."""
        self._run, self._task = run, asyncio.create_task(self._plan(run))

    async def cancel(self, run: Run, sentence: str = "You cancelled it.") -> None:
        """Cancel an identification, or what is planned after it; one that has ended stays as it is."""
        if self._task is not None and self._run == run and not self._task.done():
            self._task.cancel()
            await asyncio.wait([self._task])
            state = run.status["state"]  # somebody else may have waited for the same, and said so
            if self._task.cancelled() and state == "planning":
                run.end_planning(sentence)
            elif self._task.cancelled() and state == "running":
                run.update(state="cancelled", sentence=sentence, ended=time.time())

    async def close(self) -> None:
        """Cancel what is running, as the page ends."""
        if self._run is not None:
            planning = self._run.status["state"] == "planning"
            what = "a test was planned" if planning else "this had ended; press Identify again"
            await self.cancel(self._run, f"The page was stopped before {what}.")
        if self._preparing is not None:
            self._preparing.cancel()
            await asyncio.wait([self._preparing])

    async def read(self, action: str, folder: Path, file: str = "", name: str = "") -> None:
        """Have the record of a folder read, and wait for it; sentences call its file by the name that it came with.

        Raises:
            PageError: it was refused; the sentences are the reader's.
            JointFileError: the form was.
        """
        (folder / "progress.txt").unlink(missing_ok=True)
        try:
            await self._work(action, folder, self._limits.reading, "Reading this record")
        except PageError as error:
            sentences, path = str(error), folder / file
            # The reader names the file as it is kept here.
            for ours, theirs in ((str(path.absolute()), name), (path.name, name), (path.stem, Path(name).stem)):
                sentences = sentences.replace(ours, theirs) if file else sentences
            raise PageError(sentences) from None

    async def ask(self, action: str, work: Mapping[str, Any], folder: Path) -> dict[str, Any]:
        """Have what stands in a form worked out, in a folder below this one, and return it.

        A text that takes long holds up nobody else: its process is stopped.

        Raises:
            PageError: it took too long.
            JointFileError: it was refused.
        """
        async with self._asking:
            with tempfile.TemporaryDirectory(prefix="form-", dir=folder, ignore_cleanup_errors=True) as place:
                write_json(Path(place) / "work.json", work)
                await self._work(action, Path(place), self._limits.form, "Reading the joint file")
                return read_json(Path(place) / "made.json") or {}

    async def _prepare(self) -> None:
        with (
            contextlib.suppress(JointidError, OSError),
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        ):
            await self._work("prepare", Path(folder), self._limits.reading, "Compiling the simulation")

    async def _identify(self, run: Run) -> None:
        state, sentence = "done", ""
        try:
            if self._preparing is not None and not self._preparing.done():
                (run.folder / "progress.txt").write_text(f"{_LOADING}\n", encoding="utf-8", newline="\n")
                await asyncio.wait([self._preparing])
            await self._work("identify", run.folder, self._limits.seconds, "Identifying this record")
        except FailedError as error:
            state, sentence = "failed", str(error)
        except (PageError, JointFileError) as error:
            state, sentence = "refused", str(error)
        except OSError as error:
            state = "failed"
            sentence = FULL if is_full(error) else f"Its process could not be started ({error.strerror or error})."
        run.update(state=state, sentence=sentence, ended=time.time())

    async def _plan(self, run: Run) -> None:
        sentence = ""
        try:
            await self._work("plan", run.folder, self._limits.seconds, "Planning the next test")
        except (PageError, JointFileError) as error:
            sentence = str(error)
        except OSError as error:
            sentence = FULL if is_full(error) else f"Its process could not be started ({error.strerror or error})."
        run.end_planning(sentence)

    async def _work(self, action: str, folder: Path, seconds: float, subject: str) -> None:
        """Run a worker to its end; what leaves this early, as a cancellation does, ends it."""
        (folder / "fault.json").unlink(missing_ok=True)
        refuse_link(*folder.iterdir())
        with (folder / "progress.txt").open("ab") as progress, (folder / "log.txt").open("wb") as log:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "jointid.apps.web.worker"),
                *(action, str(folder.absolute()), str(self._limits.memory)),
                stdin=PIPE,  # whose end tells the worker that the page has ended
                stdout=progress,
                stderr=log,
                cwd=folder,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
            )
        try:
            async with asyncio.timeout(seconds):
                code = await process.wait()
        except TimeoutError:
            limit = f"{seconds:g} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
            raise FailedError(f"{subject} took longer than {limit} and was stopped; use a shorter one.") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if code:
            _raise_fault(code, folder)


def _raise_fault(code: int, folder: Path) -> None:
    """Raise why a worker ended: its own sentences, or what its exit code says."""
    if code == NO_ROOM:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if code == TOO_LARGE:
        raise PageError(_TOO_LARGE)
    if code == REFUSED:
        with contextlib.suppress(OSError, ValueError):
            said = json.loads((folder / "fault.json").read_text(encoding="utf-8"))
            if not said["of_form"]:
                raise PageError("\n".join(said["faults"]))
            located = zip(said["faults"], said["places"], strict=True)
            raise JointFileError([Fault(sentence, tuple(place)) for sentence, place in located])
    if code < 0:
        raise FailedError(
            f"It was ended from outside (signal {-code}), as the system does when memory runs out; use a shorter "
            "record, or try again."
        )
    log = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")[-_LAST:].strip().splitlines()
    last = log[-1] if log else f"exit code {code}"
    raise FailedError(f"It failed, which is a fault of ours ({last}); please report it with the record's joint file.")
