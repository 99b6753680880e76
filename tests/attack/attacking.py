"""One attack: a file is read in every way the package has, and whatever comes of it is judged.

It is read, or refused in sentences that a terminal can be given, within the time and the memory that its size allows.
"""

from __future__ import annotations

import resource
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import jointid as ji
from jointid.common.errors import JointidError
from jointid.config import load, loads
from jointid.output import json as answers
from jointid.records.formats import read_blocks, read_table
from jointid.records.formats.reader_process import _BUSY, MEMORY, PACE, SECONDS
from jointid.records.inspection import inspect
from tests.attack.samples import JOINT
from tests.losses.runs import EXECUTED, note

_OF_OURS = "fault of ours"
_ENDED = "ended what reads it"
_LATE = "is not read within"
_SLACK = 1.3  # of the time: what asks takes some of its own beside what reads
_WITH_CHANNELS = {"torque": "i", "reference": "r"}


@dataclass
class Tally:
    """What came of all attacks.

    Attributes:
        outcomes: how often a file was read, refused, or ended the process that read it.
        failures: a line for each attack that came to something else.
        slowest: seconds of the slowest, and its name.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    slowest: tuple[float, str] = (0.0, "")

    def attack(self, reader: str, path: Path, name: str) -> None:
        """Read a file, and judge what comes of it."""
        seconds = SECONDS + PACE * path.stat().st_size / 1e6 if path.is_file() else SECONDS
        for read in READERS[reader]:
            before, begin = time.process_time(), time.monotonic()
            signal.alarm(int(3 * _BUSY * seconds))
            try:
                outcome = _outcome(read, path)
            except Exception as error:  # whatever it is, it is none of ours
                outcome = f"{type(error).__name__}: {error}"[:300]
            finally:
                signal.alarm(0)
            took, waited = time.process_time() - before, time.monotonic() - begin
            self.slowest = max(self.slowest, (waited, f"{name}, {read.__name__}"))
            note(seconds=waited)
            if EXECUTED.exists():
                outcome = "it was executed"
                EXECUTED.unlink()
            if took > _SLACK * seconds:
                outcome = f"{took:.1f} s, and {seconds:.1f} s are allowed"
            self.outcomes[outcome if outcome in OUTCOMES else "failed"] += 1
            if outcome not in OUTCOMES:
                self.failures.append(f"{name}, {read.__name__}: {outcome}")

    def judge_memory(self) -> None:
        """Note it as a failure if this process, or one it started, took more memory than a reader may."""
        for who, most in ((resource.RUSAGE_SELF, MEMORY), (resource.RUSAGE_CHILDREN, MEMORY + 2**29)):
            if (taken := resource.getrusage(who).ru_maxrss * 1024) > most:
                self.failures.append(
                    f"{taken / 2**30:.2f} GiB of memory were taken, and {most / 2**30:.2f} are allowed"
                )


OUTCOMES = ("read", "refused", "ended", "late")


def _late(*_: object) -> None:
    raise TimeoutError("it was stopped, far beyond its time")


signal.signal(signal.SIGALRM, _late)


def _outcome(read: Callable[[Path], object], path: Path) -> str:
    try:
        read(path)
    except JointidError as error:
        sentences = getattr(error, "faults", (str(error),))
        bad = [one for one in sentences if not (one.isprintable() and one[-1:] in tuple(".?") and 10 < len(one) < 5000)]
        if bad or _OF_OURS in str(error):
            return f"the sentence {(bad or [str(error)])[0][:300]!r}"
        return "ended" if _ENDED in str(error) else "late" if _LATE in str(error) else "refused"
    return "read"


def read_whole(path: Path) -> None:
    """Read a record's numbers at once."""
    read_table(path)


def read_in_blocks(path: Path) -> None:
    """Read a record block after block."""
    for block in read_blocks(path, 50_000):
        block.table()


def read_channels(path: Path) -> None:
    """Read a record as a joint's, with a column that is there and with one that is not."""
    columns = list(read_table(path).columns) or ["none"]
    ji.read(path, {"torque": columns[-1], "reference": columns[len(columns) // 2]}, sample_time=1e-3, kind="prismatic")


def look_into(path: Path) -> None:
    """Say what is in a record."""
    str(inspect(path))


def load_joint(path: Path) -> None:
    """Load a joint file, and put another controller and another record's path into its text."""
    file = load(path)
    from jointid.config.loading import save_with_controller

    if file.controller is not None:
        save_with_controller(file, file.controller, path.with_name("written.toml"))


def load_estimate(path: Path) -> None:
    """Read an answer as an identified joint."""
    file = loads(JOINT.replace('friction = "asymmetric"\n', ""))
    answers.load_estimate(path, file)


def read_report(path: Path) -> None:
    """Read an answer or a report to be compared."""
    answers.read_report(path)


READERS: dict[str, tuple[Callable[[Path], None], ...]] = {
    "record": (read_whole, read_in_blocks, read_channels, look_into),
    "joint": (load_joint,),
    "answer": (load_estimate, read_report),
}
