"""Work in processes of its own, which may be cancelled or crash while the page stays up."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import time
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

from jointid.apps.web.folder import Draft, Limits, PageError
from jointid.common.errors import JointidError, RecordError

_TOO_LARGE = (
    "The record, or what is asked of it, is too large for the memory that this page gives one run; cut the record or "
    "resample it slower, or use the command line, which has no such bound: jointid identify, or jointid identify "
    "--window for a record of hours."
)
_SAID = "jointid: "  # begins the sentences of a command
_REFUSED = 2  # exit code of a command that refuses
_STOPPED = "The page was stopped before this had ended; press Identify again."


class Jobs:
    """The processes at work: readers that a request waits for, and one identification at a time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._run: Draft | None = None
        self._began = 0.0
        self._task: asyncio.Task[None] | None = None

    def is_running(self, run: Draft | None) -> bool:
        """Return whether an identification is running."""
        return run is not None and self._run == run and self._task is not None and not self._task.done()

    def require_idle(self) -> None:
        """Raise a `PageError` while an identification is running."""
        if self._run is not None and self.is_running(self._run):
            raise PageError(
                f"Identification {self._run.name} is still running; wait for its end or cancel it in step 4, then "
                "press Identify again."
            )

    def state(self, run: Draft) -> dict[str, Any]:
        """Return the state of an identification, a sentence on its end, and the seconds that it has taken."""
        if self.is_running(run):
            return {"state": "running", "sentence": "", "seconds": round(time.monotonic() - self._began)}
        found = run.json("_run.json")
        known = all(type(found.get(key)) is str for key in ("state", "sentence"))
        return found if known else {"state": "refused", "sentence": _STOPPED}

    def start(self, run: Draft, *, learn: bool) -> None:
        """Start an identification, whose controller may have to be learned first."""
        self._run, self._began = run, time.monotonic()
        self._task = asyncio.create_task(self._identify(run, learn))

    async def cancel(self, run: Draft, sentence: str = "You cancelled it.") -> None:
        """Cancel an identification; one that has ended stays as it is, and one that has its answer is done."""
        if self._task is not None and self.is_running(run):
            self._task.cancel()
            await asyncio.wait([self._task])
            if self._task.cancelled():
                self._end(run, "done" if run.has("answer.json") else "cancelled", sentence)

    async def close(self) -> None:
        """Cancel what is running, as the page ends."""
        if self._run is not None:
            await self.cancel(self._run, _STOPPED)

    async def read(self, folder: Path, action: str) -> None:
        """Have an action of the worker done in a folder, and wait for it.

        Raises:
            PageError: it was refused, or took too long.
        """
        await self._work(folder, self._limits.reading, "_log.txt", action)

    async def _identify(self, run: Draft, learn: bool) -> None:
        """Identify by the commands that a person would give, one after the other; without a report an answer stays."""
        state, sentence, limit = "done", "", self._limits.seconds
        try:
            if learn:
                learning = ("learn-controller", "joint.toml", "--write", "learned.toml")
                await self._work(run.path, limit, "_learned.txt", *learning)
                (run.path / "learned.toml").replace(run.path / "joint.toml")
            await self._work(run.path, limit, "_answer.txt", "identify", run.file, "--json", "answer.json")
            words = ("report", run.file, "--estimate", "answer.json", "--html", "report.html")
            await self._work(run.path, limit, "_log.txt", *words)
        except (JointidError, OSError) as error:
            state, sentence = "done" if run.has("answer.json") else "refused", str(error)
        self._end(run, state, sentence)

    @staticmethod
    def _end(run: Draft, state: str, sentence: str) -> None:
        with contextlib.suppress(RecordError):  # the folder has been removed, or the disk is full
            run.write_json("_run.json", {"state": state, "sentence": sentence})

    async def _work(self, folder: Path, seconds: float, out: str, *words: str) -> None:
        """Run a worker in a folder to its end; what leaves this early, as a cancellation does, ends it.

        Raises:
            PageError: it was refused, in its own sentences, or a link leads what is written out of the folder.
        """
        for path in folder.iterdir():
            if path.is_symlink():
                raise PageError(f"{path} is a symbolic link, which may lead out of the page's folder; remove it.")
        with (folder / "_progress.txt").open("ab") as progress, (folder / out).open("wb") as answer:
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
            raise PageError(f"It took longer than {limit} and was stopped; use a shorter record.") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if code:
            raise _explain(code, (folder / "_progress.txt").read_bytes()[begun:].decode("utf-8", "replace"))


def _explain(code: int, said: str) -> PageError:
    """Return why a worker ended: its own sentences, or what its exit code says."""
    sentences = [line.removeprefix(_SAID) for line in said.splitlines() if line.startswith(_SAID)]
    if "MemoryError" in said:
        return PageError(_TOO_LARGE)
    if code == _REFUSED and sentences:
        return PageError("\n".join(sentences))
    if code < 0:
        return PageError(
            f"It was ended from outside (signal {-code}), as the system does when memory runs out; use a shorter "
            "record, or try again."
        )
    last = [*sentences, *said.strip().splitlines()][-1:] or [f"exit code {code}"]
    return PageError(f"It failed, which is a fault of ours ({last[0]}); please report it with the joint file.")
