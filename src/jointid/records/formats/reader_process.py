"""Read untrusted files in a separate process, with limits on time and memory.

A file has `SECONDS`, and `PACE` more per megabyte, and `MEMORY` bytes. The process serves further files, since starting
it takes some tenths of a second; after a crash a new one starts. It runs `reader_program`.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock, Timer
from typing import IO, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.bounds import LATE, TOO_LARGE
from jointid.common.errors import ExtraError, JointFileError, JointidError, RecordError
from jointid.records.formats.table import Block, NotStreamedError, Table, format_size

SECONDS = 10.0
"""Seconds of the processor that any file may take."""

PACE = 2.0
"""Seconds of the processor that a file may take for each megabyte it has, and `SECONDS` beside them."""

MEMORY = 2**31
"""Bytes that reading a file may take, beside the interpreter and its libraries."""

# How many times its seconds a file may take by the clock, where the time of the processor is bounded too: a disk in the
# network may pause for minutes, and a machine do other things.
_BUSY = 6.0 if sys.platform == "win32" else 30.0
_OUT_OF_TIME = (LATE, -getattr(signal, "SIGXCPU", LATE))  # exit codes
_PROGRAM = Path(__file__).with_name("reader_program.py")
_PACKAGE = Path(__file__).parents[3]  # the folder with this package, which need not be installed
_NUMBER = 8  # bytes
_REMEDY = "log or copy it again, or convert it to CSV or NPY by what wrote it"
_DESCRIPTION = 2**28  # bytes of an answer without its numbers
_SENTENCES: dict[str, type[JointidError]] = {
    "RecordError": RecordError, "NotStreamedError": NotStreamedError, "ExtraError": ExtraError,
    "JointFileError": JointFileError,
}  # fmt: skip


class _EndedError(Exception):
    """The process ended before its answer did."""


@dataclass(slots=True, eq=False)
class ReaderProcess:
    """A process that reads one file at a time.

    Attributes:
        used: True once it has read a file.
        busy: True while it has an order and has not answered.
        late: True once it was ended for the time it took.
        lifeline: the end of a pipe that nobody writes to: when it is closed, as by the death of this process, the
            other is ended by the system, whatever it is doing. None where the system has no such thing (Windows).
    """

    process: subprocess.Popen[bytes]
    lifeline: int | None = None
    used: bool = False
    busy: bool = False
    late: bool = False

    @classmethod
    def start(cls) -> ReaderProcess:
        """Start the program with this process's module path."""
        places = os.pathsep.join(os.path.abspath(each) for each in (*sys.path, str(_PACKAGE)) if each)  # noqa: PTH100 - as text
        theirs, ours = (None, None) if sys.platform == "win32" else os.pipe()
        process = subprocess.Popen(  # noqa: S603 this Python, and a program that is part of this package
            [sys.executable, "-P", str(_PROGRAM), str(MEMORY), *([] if theirs is None else [str(theirs)])],
            pass_fds=() if theirs is None else (theirs,),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=_PACKAGE,  # a process keeps a disk, and on Windows a folder, from being taken away
            # A thread reserves memory that counts against the bound.
            env={
                **os.environ,
                "PYTHONPATH": places,
                "OPENBLAS_NUM_THREADS": "1",
                "OMP_NUM_THREADS": "1",
                "ARROW_DEFAULT_MEMORY_POOL": "system",
            },
        )
        if theirs is not None:
            os.close(theirs)
        return cls(process, ours)

    def ask(self, order: dict[str, Any], patience: float) -> Any:
        """Answer an order; a table includes its numbers.

        Raises:
            _EndedError: the process ended, or exceeded `patience` seconds.
            JointidError, OSError, MemoryError: from reading the file.
        """

        def end_late() -> None:
            self.late = True
            self.process.kill()

        watch = Timer(patience, end_late)
        watch.start()
        self.busy = True
        try:
            with contextlib.suppress(OSError):  # it has ended, which shows in the answer
                assert self.process.stdin is not None
                self.process.stdin.write(json.dumps(order).encode() + b"\n")
                self.process.stdin.flush()
            answers = self.process.stdout
            assert answers is not None
            size = int.from_bytes(_read_exactly(answers, 8), "little")
            if size > _DESCRIPTION:
                raise _EndedError
            answer = json.loads(_read_exactly(answers, size))
            if "table" in answer:
                answer = _read_table(answers, answer["table"])
            self.busy = False
        finally:
            watch.cancel()
        return answer if isinstance(answer, Table) else _require_good(answer)

    def is_free(self) -> bool:
        """True if it is done with its file, and may have another."""
        if self.busy or self.process.poll() is not None:
            return False
        with contextlib.suppress(Exception):  # whatever it is, the file was read
            return bool(self.ask({"do": "close"}, _BUSY * SECONDS)["free"])
        return False

    def end(self) -> int:
        """End the process, and return its exit code."""
        self.process.kill()
        if self.lifeline is not None:
            os.close(self.lifeline)
            self.lifeline = None
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                assert pipe is not None
                pipe.close()
        return self.process.wait()


def _read_exactly(answers: IO[bytes], size: int) -> bytes:
    found = answers.read(size)
    if len(found) < size:
        raise _EndedError
    return found


def _read_table(answers: IO[bytes], described: dict[str, Any]) -> Table:
    sizes = described.pop("columns")
    if min((size for _, size in sizes), default=1) < 1 or sum(size for _, size in sizes) * _NUMBER > MEMORY:
        raise _EndedError
    columns: dict[str, FloatArray] = {}
    for name, size in sizes:
        values = np.empty(size)
        place, at = values.data.cast("B"), 0
        while at < len(place):
            count = answers.readinto(place[at:])  # type: ignore[attr-defined]
            if not count:
                raise _EndedError
            at += count
        values.flags.writeable = False
        columns[name] = values
    return Table(columns, **described)


def _require_good(answer: dict[str, Any]) -> dict[str, Any]:
    if (error := answer.get("error")) is None:
        return answer
    kind, faults = error["kind"], error["faults"]
    if kind in _SENTENCES:
        raise _SENTENCES[kind](faults[0] if kind == "ExtraError" else faults)
    if "errno" in error:
        raise OSError(error["errno"], error["strerror"])
    if "MemoryError" in kind:
        raise MemoryError
    raise RecordError(f"Its reader failed ({kind}: {faults[0]}), which is a fault of ours; please report it.")


@dataclass(slots=True)
class _Idle:
    """Idle reader processes, ignoring those inherited by a fork."""

    lock: Lock = field(default_factory=Lock)
    waiting: list[ReaderProcess] = field(default_factory=list)
    owner: int = field(default_factory=os.getpid)

    def take(self) -> ReaderProcess | None:
        if self.owner != os.getpid():  # and the lock may have been copied while it was held
            return None
        with self.lock:
            return self.waiting.pop() if self.waiting else None

    def put(self, reader: ReaderProcess) -> bool:
        """Keep a process for the next file; False if one is kept already."""
        if self.owner != os.getpid():
            return False
        with self.lock:
            if self.waiting:
                return False
            self.waiting.append(reader)
            return True

    def end(self) -> None:
        while (reader := self.take()) is not None:
            reader.end()


_idle = _Idle()
atexit.register(_idle.end)


@dataclass(slots=True, eq=False)
class _Session:
    """One file in a process."""

    path: Path
    name: str
    options: dict[str, Any]
    reader: ReaderProcess
    remedy: str

    @property
    def size(self) -> int:
        """Bytes of the file, or of all in its folder."""
        every = self.path.iterdir() if self.path.is_dir() else [self.path]
        return sum(file.stat().st_size for file in every if file.is_file())

    @property
    def seconds(self) -> int:
        """Of the processor, for all of the file."""
        return math.ceil(SECONDS + PACE * self.size / 1e6)

    def ask(self, **order: Any) -> Any:
        """Answer an order; describe why a process ended."""
        try:
            return self.reader.ask(order, _BUSY * self.seconds)
        except _EndedError:
            code = self.reader.end()
            if code == TOO_LARGE:
                raise MemoryError from None
            raise RecordError(self._explain_end(code)) from None

    def open(self, do: str, **further: Any) -> Any:
        """Send the first order, and retry with a new process if a reused one ends."""
        order = {"do": do, "path": str(self.path.absolute()), "options": self.options, **further}
        order["seconds"] = self.seconds
        if self.reader.used:
            try:
                return self.reader.ask(order, _BUSY * self.seconds)
            except _EndedError:
                code = self.reader.end()
                if self.reader.late or code in _OUT_OF_TIME:
                    raise RecordError(self._explain_end(code)) from None
                self.reader = ReaderProcess.start()
        self.reader.used = True
        return self.ask(**order)

    def _explain_end(self, code: int) -> str:
        if self.reader.late or code in _OUT_OF_TIME:
            return (
                f"{self.path.name} ({format_size(self.size)}) is not read within {self.seconds} s, the time for a "
                f"file of its size ({SECONDS:g} s, and {PACE:g} s more for each megabyte); {self.remedy}."
            )
        return (
            f"{self.path.name} cannot be read as {self.name}: it is damaged, cut off or of another format, and ended "
            f"what reads it; {self.remedy}."
        )


@contextlib.contextmanager
def _session(path: Path, name: str, options: dict[str, Any], remedy: str = _REMEDY) -> Iterator[_Session]:
    session = _Session(path, name, options, _idle.take() or ReaderProcess.start(), remedy)
    try:
        yield session
    finally:
        reader = session.reader
        if not (reader.is_free() and _idle.put(reader)):
            reader.end()


def read_apart(path: Path, name: str, options: dict[str, Any]) -> Table:
    """Read all numbers of a file in a separate process.

    Args:
        path: the file, or the folder of a bag.
        name: of the format, for sentences.
        options: of its reader.
    """
    with _session(path, name, options) as session:
        found: Table = session.open("read")
        return found


def call_apart(path: Path, name: str, remedy: str, function: str, **arguments: Any) -> Any:
    """Call a function of this package on a file's content in a separate process.

    Args:
        path: the file, for sentences and the time that its size allows.
        name: of its format, for sentences.
        remedy: the end of the sentence where the process ends.
        function: its module and its name, as "jointid.config.robot_model:describe_robot".
        arguments: of it, as JSON has them; so is its result.
    """
    with _session(path, name, {}, remedy) as session:
        return session.open("call", function=function, arguments=arguments)["made"]


def read_blocks_apart(path: Path, rows: int, name: str, options: dict[str, Any]) -> Iterator[Block]:
    """Yield blocks of `rows` rows, read on demand in a separate process.

    Raises:
        NotStreamedError: the file has no consecutive rows.
        RecordError, OSError, MemoryError: see `read_apart`.
    """
    with _session(path, name, options) as session:
        session.open("blocks", rows=rows)
        while (count := session.ask(do="next")["rows"]) is not None:
            yield Block(count, lambda wanted: session.ask(do="take", rows=wanted))
