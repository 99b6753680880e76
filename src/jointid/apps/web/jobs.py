"""Work in processes of its own, which may be cancelled or crash while the page stays up."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from asyncio.subprocess import PIPE
from pathlib import Path

from jointid.apps.web.folder import Limits, PageError, Run
from jointid.apps.web.worker import REFUSED

_LAST = 2000  # characters of what a failed process wrote


class FailedError(PageError):
    """A process that ended otherwise than by its answer or a sentence about the record."""


class Jobs:
    """The processes at work: readers that a request waits for, and one identification at a time."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None

    def require_idle(self) -> None:
        """Raise a `PageError` while an identification is running."""
        if self._run is not None and self._task is not None and not self._task.done():
            raise PageError(
                f"Identification {self._run.number} is still running; wait for its end or cancel it in step 4, then "
                "press Identify again."
            )

    def start(self, run: Run) -> None:
        """Start an identification."""
        run.update(state="running", sentence="", started=time.time())
        self._run, self._task = run, asyncio.create_task(self._identify(run))

    async def cancel(self, run: Run, sentence: str = "You cancelled it.") -> None:
        """Cancel an identification; one that has ended stays as it is."""
        if self._task is not None and self._run == run:
            self._task.cancel()
            await asyncio.wait([self._task])
            if self._task.cancelled():
                run.update(state="cancelled", sentence=sentence, ended=time.time())

    async def close(self) -> None:
        """Cancel what is running, as the page ends."""
        if self._run is not None:
            await self.cancel(self._run, "The page was stopped before this had ended; press Identify again.")

    async def read(self, action: str, folder: Path) -> None:
        """Have the record of a folder read, and wait for it.

        Raises:
            PageError: it was refused; the sentences are the reader's.
        """
        await self._work(action, folder, self._limits.reading, "Reading this record")

    async def _identify(self, run: Run) -> None:
        state, sentence = "done", ""
        try:
            await self._work("identify", run.folder, self._limits.seconds, "It")
        except FailedError as error:
            state, sentence = "failed", str(error)
        except PageError as error:
            state, sentence = "refused", str(error)
        except OSError as error:
            state, sentence = "failed", f"Its process could not be started ({error})."
        run.update(state=state, sentence=sentence, ended=time.time())

    async def _work(self, action: str, folder: Path, seconds: float, subject: str) -> None:
        """Run a worker to its end; what leaves this early, as a cancellation does, ends it."""
        (folder / "fault.json").unlink(missing_ok=True)
        with (folder / "progress.txt").open("wb") as progress, (folder / "log.txt").open("wb") as log:
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
            raise FailedError(
                f"{subject} took longer than {seconds / 60:.0f} minutes and was stopped; use a shorter record."
            ) from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if code:
            _raise_fault(code, folder)


def _raise_fault(code: int, folder: Path) -> None:
    """Raise why a worker ended: its own sentences, or what its exit code says."""
    if code == REFUSED:
        with contextlib.suppress(OSError, ValueError):
            lines = json.loads((folder / "fault.json").read_text(encoding="utf-8"))
            raise PageError("\n".join(map(str, lines)))
    if code < 0:
        raise FailedError(
            f"It was ended from outside (signal {-code}), as the system does when memory runs out; use a shorter "
            "record, or try again."
        )
    log = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")[-_LAST:].strip().splitlines()
    last = log[-1] if log else f"exit code {code}"
    raise FailedError(f"It failed, which is a fault of ours ({last}); please report it with the record's joint file.")
