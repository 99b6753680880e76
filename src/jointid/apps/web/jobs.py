"""Work in processes of its own, which may be cancelled or crash while the page stays up."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import sys
import time
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

from jointid.apps.web import folder
from jointid.apps.web.folder import Draft, PageError
from jointid.common.errors import JointidError, RecordError

_STOPPED = "The page was stopped before this had ended; press Identify again."


class Jobs:
    """The identification at work, of which there is one at a time."""

    def __init__(self) -> None:
        self._run: Draft | None = None
        self._began = 0.0
        self._task: asyncio.Task[None] | None = None

    def is_running(self, run: Draft | None) -> bool:
        """Return whether an identification is running."""
        return run is not None and self._run == run and self._task is not None and not self._task.done()

    def require_idle(self) -> None:
        """Raise a `PageError` while an identification is running."""
        if self.is_running(self._run):
            raise PageError("An identification is still running; wait for its end or cancel it in step 4.")

    def state(self, run: Draft) -> dict[str, Any]:
        """Return the state of an identification, a sentence on its end, and the seconds that it has taken."""
        if self.is_running(run):
            return {"state": "running", "sentence": "", "seconds": round(time.monotonic() - self._began)}
        return {"state": "refused", "sentence": _STOPPED} | run.json("_run.json")

    def start(self, run: Draft, *, learn: bool) -> None:
        """Start an identification, whose controller may have to be learned first."""
        self._run, self._began = run, time.monotonic()
        self._task = asyncio.create_task(_identify(run, learn))

    async def cancel(self) -> None:
        """Cancel what is running."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
            await asyncio.wait([self._task])


async def _identify(run: Draft, learn: bool) -> None:
    """Identify by the commands that a person would give, one after the other; without a report an answer stays."""
    commands = {
        "_answer.txt": ("identify", run.file, "--json", "answer.json"),
        "_log.txt": ("report", run.file, "--estimate", "answer.json", "--html", "report.html"),
    }
    if learn:
        commands = {"_learned.txt": ("learn-controller", run.file, "--write", "learned.toml")} | commands
    state, sentence = "refused", ""
    try:
        for out, words in commands.items():
            await work(run.path, folder.IDENTIFYING, out, *words)
            if run.has("learned.toml"):
                (run.path / "learned.toml").replace(run.path / run.file)
    except asyncio.CancelledError:
        state, sentence = "cancelled", "It was cancelled, or the page was stopped; press Identify again."
    except (JointidError, OSError) as error:
        sentence = str(error)
    with contextlib.suppress(RecordError):  # the folder has been removed, or the disk is full
        run.write_json("_run.json", {"state": "done" if run.has("answer.json") else state, "sentence": sentence})


async def work(place: Path, seconds: float, out: str, *words: str) -> None:
    """Run a command, or an action of the worker, in a folder to its end; what leaves this early ends it.

    Raises:
        PageError: it was refused, in its own sentences, ended otherwise, or took longer than so many seconds.
    """
    with (place / "_progress.txt").open("ab") as progress, (place / out).open("wb") as answer:
        begun = progress.tell()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "jointid.apps.web.worker", str(folder.MEMORY), *words),
            stdin=PIPE,  # whose end tells the worker that the page has ended
            stdout=answer,
            stderr=progress,
            cwd=place,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
        )
    try:
        async with asyncio.timeout(seconds):
            code = await process.wait()
    except TimeoutError:
        raise PageError(f"It took longer than {seconds:g} s and was stopped; use a shorter record.") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    said = (place / "_progress.txt").read_bytes()[begun:].decode("utf-8", "replace")
    if code < 0 or (code and "MemoryError" in said):
        raise PageError(
            "It takes more memory than this page gives one run, or was ended from outside; cut the record or resample "
            "it slower, or use the command line, which has no such bound: jointid identify --window."
        )
    if code:
        raise PageError("\n".join(re.findall("^jointid: (.*)$", said, re.MULTILINE)) or f"It failed: {said[-500:]}")
