"""Untrusted files: any fault of a library becomes one sentence, too large a file is refused, a reader is set apart.

The libraries behind the binary formats raise whatever their parsers stumble over. None of it tells a user more than
that the file is damaged, so everything that comes out of them on the way from a file is that sentence.

A reader that a damaged file may end, or keep busy for ever, runs in a process of its own: `isolated_readers`, started
by path, which imports nothing of this package. The time it may take for one answer is bounded and, where the system can
do that, so is its memory, and it can write no file. What it answers is text and numbers, never a pickle.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import IO

from jointid.common.errors import JointidError, RecordError

WHOLE = 2**32
"""Bytes of numbers that are read at once, 4 GiB: 50 columns of 10 million rows."""

PIECES = 2**40
"""Bytes of numbers that are read in chunks, 1 TiB: more than a year of 4 columns at 1 kHz."""

_NUMBER = 8  # bytes of a number in memory
_LISTED = 3  # things passed over that a sentence names
_STEPS = ("KiB", "MiB", "GiB", "TiB", "PiB")

PATIENCE = 10.0
"""Seconds for an answer, and one more for every so many bytes of the file."""

_PACE = 10**6  # bytes of a file in a second: slower than any reader here by a factor of ten
_MEMORY = 3 * 2**32  # bytes: the most that is read at once, as stored, as floats and on its way
_PROGRAM = Path(__file__).with_name("isolated_readers.py")
_END = 2**64 - 1  # instead of a length: nothing follows


@contextmanager
def explain_damage(path: Path, format_name: str, remedy: str) -> Iterator[None]:
    """Turn whatever a library raises into the sentence on a file that is damaged.

    Args:
        path: the file.
        format_name: what it should be.
        remedy: what writes such a file, the end of the sentence.
    """
    try:
        yield
    except JointidError:
        raise
    except Exception as error:
        raise RecordError(
            f"{path.name} cannot be read as {format_name}: it is damaged, cut off or of another format; {remedy}."
        ) from error


def require_size(path: Path, numbers: int, limit: int = WHOLE) -> None:
    """Refuse a file that declares more numbers than are read, before there is memory for any of them.

    Raises:
        RecordError: the sentence has the size.
    """
    if numbers * _NUMBER > limit:
        advice = (
            "choose columns with jointid data convert --columns, or read it in chunks with jointid identify --window"
            if limit == WHOLE
            else "cut it into shorter files"
        )
        raise RecordError(
            f"{path.name} declares {format_size(numbers * _NUMBER)} of numbers, and at most {format_size(limit)} are "
            f"read; {advice}."
        )


def format_size(count: int) -> str:
    """Return a number of bytes in words."""
    if count < 1024:
        return f"{count} bytes"
    value, step = float(count), -1
    while value >= 1024 and step < len(_STEPS) - 1:
        value, step = value / 1024, step + 1
    return f"{value:.3g} {_STEPS[step]}" if value < 1000 else f"{value:.0f} {_STEPS[step]}"


def require_unique_names(path: Path, names: list[str]) -> None:
    """Refuse a file in which two columns have one name.

    Raises:
        RecordError: the sentence names it.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise RecordError(f"{path.name} has more than one column called {name!r}; rename them.")
        seen.add(name)


def list_passed(passed: Mapping[str, str]) -> str:
    """Return what was passed over and why, in brackets: the first few; "" of nothing."""
    listed = "; ".join(f"{name!r}: {why}" for name, why in list(passed.items())[:_LISTED])
    return f" ({listed})" if listed else ""


def read_parts(reader: str, path: Path, *arguments: str) -> Iterator[bytes]:
    """Yield what a reader answers, part after part.

    Args:
        reader: name of a function in `isolated_readers`.
        path: the file.
        arguments: more of the reader's.

    Raises:
        ValueError: the reader failed, was ended by the file, or took too long.
    """
    patience = PATIENCE + path.stat().st_size / _PACE
    command = [sys.executable, "-P", str(_PROGRAM), str(_MEMORY), f"{patience:.0f}", reader, str(path.absolute())]
    process = subprocess.Popen(  # noqa: S603 this Python, and a program that is part of this package
        [*command, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a thread reserves memory that counts against the bound
    )
    assert process.stdout is not None
    try:
        while (part := _next_part(process, process.stdout, patience)) is not None:
            yield part
    finally:
        process.kill()
        process.stdout.close()
        process.wait()


def _next_part(process: subprocess.Popen[bytes], answers: IO[bytes], patience: float) -> bytes | None:
    """Return the next part of an answer; None at its end."""
    watch = Timer(patience, process.kill)
    watch.start()
    try:
        head = answers.read(8)
        size = int.from_bytes(head, "little")
        if len(head) == 8 and size == _END:
            return None
        part = answers.read(size)
    finally:
        watch.cancel()
    if len(head) < 8 or len(part) < size:
        raise ValueError("the reader of this format failed, or was ended by the file")
    return part
