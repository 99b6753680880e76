"""Work in processes of its own, which may be cancelled or crash while the page stays up."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import tempfile
import time
from asyncio.subprocess import PIPE
from pathlib import Path

from jointid.apps.web.folder import FULL, REFUSED, Limits, PageError, Run, read_json, refuse_links
from jointid.common.bounds import TOO_LARGE
from jointid.common.errors import Fault, JointFileError, JointidError
from jointid.common.files import is_full

_TOO_LARGE = (
    "The record, or what is asked of it, is too large for the memory that this page gives one run; cut the record or "
    "resample it slower, or use the command line, which has no such bound: jointid identify, or jointid identify "
    "--window for a record of hours."
)
_SAID = "jointid: "  # begins the sentences of a command
_SIDE_BY_SIDE = 2  # processes that look at files and forms


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

    def require_idle(self) -> None:
        """Raise a `PageError` while an identification is running."""
        if self._run is not None and self._task is not None and not self._task.done():
            raise PageError(
                f"Identification {self._run.number} is still running; wait for its end or cancel it in step 4, then "
                "press Identify again."
            )

    def start(self, run: Run) -> None:
        """Start an identification."""
        self._run, self._task = run, asyncio.create_task(self._identify(run))

    async def cancel(self, run: Run, sentence: str = "You cancelled it.") -> None:
        """Cancel an identification; one that has ended stays as it is, and one that has its answer is done."""
        if self._task is not None and self._run == run and not self._task.done():
            self._task.cancel()
            await asyncio.wait([self._task])
            if self._task.cancelled() and run.active:
                state = "done" if run.has("answer.json") else "cancelled"
                run.update(state=state, sentence=sentence, ended=time.time())

    async def close(self) -> None:
        """Cancel what is running, as the page ends."""
        if self._run is not None:
            await self.cancel(self._run, "The page was stopped before this had ended; press Identify again.")
        if self._preparing is not None:
            self._preparing.cancel()
            await asyncio.wait([self._preparing])

    async def act(self, action: str, folder: Path) -> None:
        """Have an action of the worker done in a folder, and wait for it.

        Raises:
            PageError: it was refused, or took too long.
            JointFileError: the form was refused.
        """
        reads = action in ("preview", "check", "example")
        async with self._asking:
            await self._work(
                folder, self._limits.reading if reads else self._limits.form, action, str(folder.absolute())
            )

    async def _prepare(self) -> None:
        with (
            contextlib.suppress(JointidError, OSError),
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        ):
            await self._work(Path(folder), self._limits.reading, "prepare", folder)

    async def _identify(self, run: Run) -> None:
        """Identify by the commands that a person would give, one after the other."""
        try:
            if self._preparing is not None and not self._preparing.done():
                await asyncio.wait([self._preparing])
            if (read_json(run.folder / "work.json") or {}).get("learn") is True:
                await self._command(run, "learned.txt", "learn-controller", "joint.toml", "--write", "learned.toml")
                (run.folder / "learned.toml").replace(run.folder / "joint.toml")
            await self._command(run, "answer.txt", "identify", run.file, "--json", "answer.json")
        except FailedError as error:
            run.update(state="failed", sentence=str(error), ended=time.time())
        except PageError as error:
            run.update(state="refused", sentence=str(error), ended=time.time())
        except OSError as error:
            sentence = FULL if is_full(error) else f"Its process could not be started ({error.strerror or error})."
            run.update(state="failed", sentence=sentence, ended=time.time())
        else:
            await self._report(run)

    async def _report(self, run: Run) -> None:
        """Write the report; a refusal of it costs no answer."""
        sentence = ""
        try:
            words = ("report", run.file, "--estimate", "answer.json", "--html", "report.html")
            await self._command(run, "log.txt", *words)
        except (PageError, OSError) as error:
            sentence = str(error)
        run.update(state="done", sentence=sentence, ended=time.time())

    async def _command(self, run: Run, out: str, *words: str) -> None:
        """Run a command of jointid in the folder of an identification, its answer in a file.

        Raises:
            PageError: it was refused; the sentences are the command's.
        """
        await self._work(run.folder, self._limits.seconds, *words, out=out)

    async def _work(self, folder: Path, seconds: float, *words: str, out: str = "log.txt") -> None:
        """Run a worker to its end; what leaves this early, as a cancellation does, ends it."""
        refuse_links(folder)
        (folder / "fault.json").unlink(missing_ok=True)
        with (folder / "progress.txt").open("ab") as progress, (folder / out).open("wb") as answer:
            begun = progress.tell()
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "jointid.apps.web.worker", str(self._limits.memory), *words),
                stdin=PIPE,  # whose end tells the worker that the page has ended
                stdout=answer,
                stderr=progress,
                cwd=folder,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
            )
        try:
            async with asyncio.timeout(seconds):
                code = await process.wait()
        except TimeoutError:
            limit = f"{seconds:g} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
            raise FailedError(f"It took longer than {limit} and was stopped; use a shorter record.") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if code:
            _raise_fault(code, folder, (folder / "progress.txt").read_bytes()[begun:].decode("utf-8", "replace"))


def _raise_fault(code: int, folder: Path, said: str) -> None:
    """Raise why a worker ended: its own sentences, or what its exit code says."""
    sentences = [line.removeprefix(_SAID) for line in said.splitlines() if line.startswith(_SAID)]
    if code == TOO_LARGE or "MemoryError" in said:
        raise PageError(_TOO_LARGE)
    if code == REFUSED:
        with contextlib.suppress(OSError, ValueError):
            fault = json.loads((folder / "fault.json").read_text(encoding="utf-8"))
            if not fault["of_form"]:
                raise PageError("\n".join(fault["faults"]))
            located = zip(fault["faults"], fault["places"], strict=True)
            raise JointFileError([Fault(sentence, tuple(place)) for sentence, place in located])
        if sentences:
            raise PageError("\n".join(sentences))
    if code < 0:
        raise FailedError(
            f"It was ended from outside (signal {-code}), as the system does when memory runs out; use a shorter "
            "record, or try again."
        )
    last = [*sentences, *said.strip().splitlines()][-1:] or [f"exit code {code}"]
    raise FailedError(
        f"It failed, which is a fault of ours ({last[0]}); please report it with the record's joint file."
    )
