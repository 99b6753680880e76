"""Run the program in a copy of this process: what it loads is loaded already, so that its own work is attacked."""

import io
import os
import select
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jointid
from tests.drawing import DRAW

SEED = os.environ.get("JOINTID_ATTACKS_SEED", DRAW)
"""Of the moments: with another one they are others, so that many can be tried in parts. A draw has its own."""

COUNT = int(os.environ.get("JOINTID_ATTACKS", "6"))
"""Moments at which every command is interrupted; a full disk has a quarter as many sizes, and at least three."""

BROKEN = 70  # exit code of a copy whose exception came out of the program

EXECUTED = Path("jointid-executed").absolute()
"""What hostile content makes if it is executed."""


@dataclass(frozen=True)
class Ended:
    """How a run ended: its exit code, negative the signal that killed it, its output, and how long it took."""

    code: int
    said: str
    seconds: float


def run_program(*words: object, **how: object) -> Ended:
    """Run a command; see `run_copy`."""

    def program() -> None:
        from jointid.apps.cli import main

        sys.argv = ["jointid", *map(str, words)]
        main()

    return run_copy(program, **how)


def run_copy(
    action: Callable[[], None],
    *,
    folder: Path | None = None,
    most: int | None = None,
    kill: int = 0,
    after: float = 0.0,
) -> Ended:
    """Run an action in a copy of this process, with files of `most` bytes, until it is killed `after` seconds."""
    begin = time.monotonic()
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _become(action, writer, folder, most)
    os.close(writer)
    if kill:
        watch = os.pidfd_open(child)
        select.select([watch], [], [], after)  # until the moment at which it is attacked, or its end
        os.close(watch)
        os.kill(child, kill)
    said = bytearray()
    while part := os.read(reader, 2**16):
        said += part
    os.close(reader)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return Ended(status, said.decode("utf-8", "replace"), time.monotonic() - begin)


def _become(action: Callable[[], None], writer: int, folder: Path | None, most: int | None) -> None:
    """Do what a new process does, and end."""
    code = BROKEN
    try:
        for one in (1, 2):
            os.dup2(writer, one)
        os.close(writer)
        sys.stdout, sys.stderr = (io.TextIOWrapper(io.FileIO(one, "w"), "utf-8", write_through=True) for one in (1, 2))
        sys.unraisablehook = sys.__unraisablehook__
        warnings.simplefilter("ignore", ResourceWarning)  # as in every process but a test's
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if folder is not None:
            os.chdir(folder)
        if most is not None:
            import resource

            # Python cuts the bytecode of a module there without a word, and fails to load it ever after.
            sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
        action()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and not _in_program(error):
            code = 128 + signal.SIGINT  # it came before the program began
        else:
            traceback.print_exc()
    finally:
        os._exit(code)


def _in_program(error: BaseException) -> bool:
    """Whether an exception went through a line of the package."""
    package = str(Path(jointid.__file__).parent)
    return any(frame.filename.startswith(package) for frame in traceback.extract_tb(error.__traceback__))


def require_calm(ended: Ended, codes: Sequence[int]) -> None:
    """Assert that a run ended as it may, without a traceback."""
    assert "Traceback" not in ended.said, ended.said
    assert "Exception ignored" not in ended.said, ended.said
    assert "fault of ours" not in ended.said, ended.said
    assert ended.code in codes, ended


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
