"""Run another library's reader in a process of its own, which a damaged file may end or keep busy for ever.

The process runs `isolated_readers`, started by path: it imports nothing of this package. The time it may take for one
answer is bounded and, where the system can do that, so is its memory, and it can write no file. What it answers is text
and numbers, never a pickle.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Timer
from typing import IO

PATIENCE = 10.0
"""Seconds for an answer, and one more for every so many bytes of the file."""

_PACE = 10**6  # bytes of a file in a second: slower than any reader here by a factor of ten
_MEMORY = 3 * 2**32  # bytes: the most that is read at once, as stored, as floats and on its way
_PROGRAM = Path(__file__).with_name("isolated_readers.py")
_END = 2**64 - 1  # instead of a length: nothing follows


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
