"""Program of the reader process: orders on standard input, answers on standard output.

An order is a line of JSON. An answer is its length in eight bytes, JSON, and the numbers of the columns listed in it.
Nothing is pickled. `reader_process` starts this file by path and documents the orders.

Processor time and memory are bounded, by a watch of its own where the system does not; there a library that keeps
Python waiting is ended by the parent's clock. Except on Windows no file can be written. The process ends with its
standard input, and with a pipe that the parent keeps open.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from typing import IO, Any

from jointid.common.bounds import LIBRARIES, limit_resource, measure_memory

_TIRED = 2**28  # bytes more than at the beginning: what libraries keep of the files before


def main(memory: int, lifeline: int | None) -> None:
    """Follow orders until there are no more."""
    if lifeline is not None:
        _end_with(lifeline)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who gave the orders is interrupted as well, and closes the input
    orders, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    from jointid.records.formats.table import Block

    begin = measure_memory()
    limit_resource("RLIMIT_AS", begin + memory + LIBRARIES)
    limit_resource("RLIMIT_FSIZE", 0)
    limit_resource("RLIMIT_CORE", 0)
    blocks: Iterator[Block] = iter(())
    block: Block | None = None
    for line in orders:
        order = json.loads(line)
        try:
            match order["do"]:
                case "read":
                    reader, path = _prepare(order)
                    _send_table(answers, reader.read(path))
                case "blocks":
                    reader, path = _prepare(order)
                    blocks = iter(reader.blocks(path, order["rows"]))
                    _send(answers, {})
                case "next":
                    block = next(blocks, None)
                    _send(answers, {"rows": None if block is None else block.rows})
                case "take":
                    assert block is not None
                    _send_table(answers, block.table(order["rows"]))
                case "call":
                    _limit_time(order)
                    module, _, name = order["function"].partition(":")
                    _send(answers, {"made": getattr(import_module(module), name)(**order["arguments"])})
                case "close":
                    blocks, block = iter(()), None
                    _send(answers, {"free": measure_memory() <= begin + LIBRARIES + _TIRED})
        except Exception as error:  # reported to the parent
            blocks, block = iter(()), None
            faults = [str(fault) for fault in getattr(error, "faults", (str(error),))]
            answer: dict[str, Any] = {"kind": type(error).__name__, "faults": faults}
            if isinstance(error, OSError):
                answer |= {"errno": error.errno, "strerror": error.strerror}
            _send(answers, {"error": answer})


def _end_with(lifeline: int) -> None:
    """End this process when the other end of a pipe closes, even during library calls.

    `PR_SET_PDEATHSIG` is tied to the starting thread, which may end earlier; a watching thread would wait for the
    library.
    """
    if sys.platform == "win32":
        return
    import fcntl
    import select

    signal.signal(signal.SIGIO, signal.SIG_DFL)  # it ends the process
    with contextlib.suppress(OSError):  # a system without it ends this process with its input, once it reads it
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([lifeline], [], [], 0)[0]:  # it was closed before
        sys.exit(1)


def _prepare(order: dict[str, Any]) -> tuple[Any, Any]:
    """Return the format and path of an order, and start the file's time limit."""
    from pathlib import Path

    from jointid.records.formats import format_of

    _limit_time(order)
    return format_of(order["path"], **order["options"]), Path(order["path"])


def _limit_time(order: dict[str, Any]) -> None:
    limit_resource("RLIMIT_CPU", int(time.process_time()) + 1 + order["seconds"])


def _send(answers: IO[bytes], answer: dict[str, Any]) -> None:
    content = json.dumps(answer).encode()
    answers.write(len(content).to_bytes(8, "little") + content)
    answers.flush()


def _send_table(answers: IO[bytes], table: Any) -> None:
    described = {
        "columns": [(name, values.size) for name, values in table.columns.items()],
        "scalars": dict(table.scalars),
        "source": table.source,
        "units": dict(table.units),
        "passed": dict(table.passed),
        "clocks": dict(table.clocks),
    }
    _send(answers, {"table": described})
    for values in table.columns.values():
        answers.write(values.data.cast("B"))
    answers.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else None)
