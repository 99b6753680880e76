"""Folders of the page, and the processes that work in them.

A folder holds records with the texts of the forms, or an identification. A process may be cancelled or crash while the
page stays up. Names that begin with `_` are reserved for the page; no upload has such a name.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import sys
import time
from asyncio.subprocess import PIPE
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointid.common.errors import JointidError, RecordError
from jointid.common.files import write_whole

UPLOAD = 256 * 2**20  # bytes of one upload
MEMORY = 5 * 2**30  # bytes of address space of each worker process, on Linux
READING, IDENTIFYING = 300, 3600  # seconds of processor time for reading, and for each command of an identification
MODELS = (".urdf", ".xml", ".mjcf")  # suffixes of a robot's model


class PageError(JointidError):
    """A request that the page refuses; the message explains it."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A folder of records and form texts, or of an identification."""

    path: Path

    @property
    def files(self) -> list[str]:
        """Names of the files that are not reserved for the page."""
        return sorted(one.name for one in self.path.glob("*") if not one.name.startswith("_") and self.has(one.name))

    @property
    def robot(self) -> bool:
        """True if the files contain a robot model."""
        return any(name.lower().endswith(MODELS) for name in self.files)

    @property
    def file(self) -> str:
        """Name of its joint file or robot file."""
        return "robot.toml" if self.robot else "joint.toml"

    @property
    def records(self) -> list[str]:
        """Names of its records."""
        return [name for name in self.files if not name.lower().endswith((".toml", *MODELS))]

    @property
    def texts(self) -> dict[str, str]:
        """Texts of the forms by field key."""
        return {key: text for key, text in self.json("_texts.json").items() if type(text) is str}

    def enter(self, texts: Mapping[str, str]) -> None:
        """Store the texts of the forms."""
        self.path.mkdir(parents=True, exist_ok=True)
        self.write_json("_texts.json", texts)

    def has(self, name: str) -> bool:
        """Test for a regular file with this name."""
        path = self.path / name
        return path.is_file() and not path.is_symlink()

    def read(self, name: str) -> str:
        """Return the text of a file; empty without it."""
        return (self.path / name).read_text("utf-8", "replace") if self.has(name) else ""

    def json(self, name: str) -> dict[str, Any]:
        """Return a file as JSON; empty if it is missing or damaged."""
        try:
            found = json.loads(self.read(name))
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_json(self, name: str, value: Mapping[str, Any]) -> None:
        """Write a reserved JSON file."""
        write_whole(self.path / name, json.dumps(value, allow_nan=False))


class Jobs:
    """The running identification; there is at most one."""

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
        """Return the state, final sentence and duration [s] of an identification."""
        if self.is_running(run):
            return {"state": "running", "sentence": "", "seconds": round(time.monotonic() - self._began)}
        stopped = "The page was stopped before this had ended; try it again."
        return {"state": "refused", "sentence": stopped} | run.json("_run.json")

    def start(self, run: Draft, *, learn: bool) -> None:
        """Start an identification, which may first learn the controller."""
        self._run, self._began = run, time.monotonic()
        self._task = asyncio.create_task(_identify(run, learn))

    async def cancel(self) -> None:
        """Cancel the running identification."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
            await asyncio.wait([self._task])


async def _identify(run: Draft, learn: bool) -> None:
    """Identify by command-line commands; an answer is kept without its report."""
    commands = {
        "_answer.txt": ("identify", run.file, "--json", "answer.json"),
        "_log.txt": ("report", run.file, "--html", "report.html"),
    }
    if learn:
        commands = {"_learned.txt": ("learn-controller", run.file, "--write", "learned.toml")} | commands
    state, sentence = "refused", ""
    try:
        for out, words in commands.items():
            await work(run.path, IDENTIFYING, out, *words)
            if run.has("learned.toml"):
                (run.path / "learned.toml").replace(run.path / run.file)
    except asyncio.CancelledError:
        state, sentence = "cancelled", "It was cancelled, or the page was stopped; press Identify again."
    except (JointidError, OSError) as error:
        sentence = str(error)
    with contextlib.suppress(RecordError):  # the folder has been removed, or the disk is full
        run.write_json("_run.json", {"state": "done" if run.has("answer.json") else state, "sentence": sentence})


async def work(place: Path, seconds: int, out: str, *words: str) -> None:
    """Run a command or worker action in a folder.

    Raises:
        PageError: it was refused, with its own sentences, failed, or, on Linux, exceeded memory or processor time.
    """
    with (place / "_progress.txt").open("ab") as progress, (place / out).open("wb") as answer:
        start = progress.tell()
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "jointid.apps.web.worker", str(MEMORY), str(seconds), *words),
            stdin=PIPE,  # closed when the page ends, which ends the worker
            stdout=answer,
            stderr=progress,
            cwd=place,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"},
        )
    try:
        code = await process.wait()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    said = (place / "_progress.txt").read_bytes()[start:].decode("utf-8", "replace")
    if code < 0 or (code and "MemoryError" in said):
        raise PageError(
            f"It needs more memory than this page allows, or more than {seconds} s of processor, or was ended; "
            "cut the record, resample it slower, or use a command, without such bounds: jointid identify --window."
        )
    if code:
        raise PageError("\n".join(re.findall("^jointid: (.*)$", said, re.MULTILINE)) or f"It failed: {said[-500:]}")
