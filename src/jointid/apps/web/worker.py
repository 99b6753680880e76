"""The process that does one piece of work for the page: `python -m jointid.apps.web.worker ACTION FOLDER MEMORY`.

A file may be damaged and a fit may take hours: whatever becomes of the process, the page stays up, and its memory is
bounded. It prints its progress, a line each, and leaves its answer in the folder; exit code 2 and `fault.json` for what
the person can mend. It ends when the page does, whose end it hears on its standard input.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from jointid.common.errors import FaultsError, JointidError

REFUSED = 2

_TOO_LARGE = (
    "The record, or what is asked of it, is too large for the memory that this page gives one run; cut the record or "
    "resample it slower, or use the command line, which has no such bound: jointid identify, or jointid identify "
    "--window for a record of hours."
)


def preview(folder: Path) -> None:
    """Read the record of `work.json`, and write `preview.json`."""
    from jointid.apps.web.preview import build_preview
    from jointid.records.formats import read_table

    work = _read_work(folder)
    table = read_table(folder / work["file"], **work["options"])
    if not table.columns:
        raise JointidError("The file holds no column with more than one number; choose another file.")
    _write(folder / "preview.json", json.dumps(build_preview(table), allow_nan=False))


def simulate(folder: Path) -> None:
    """Simulate the digital twin, and write `example.csv`."""
    from jointid import twin, write

    write(twin().record, folder / "example.csv")


def check(folder: Path) -> None:
    """Read the record as the tables of `work.json` say, and write what it holds to `checked.json`."""
    from jointid.config import JointFile

    work = _read_work(folder)
    record = JointFile.of(work["tables"]).record(folder / work["file"])
    torque = record.torque
    assert torque is not None
    size = {"samples": len(torque), "sample_time": torque.sample_time, "duration": torque.duration}
    _write(folder / "checked.json", json.dumps({**size, "unit": torque.unit}))


def identify(folder: Path) -> None:
    """Identify as the joint file says, its controller learned first if `work.json` has its gain; write all answers."""
    from jointid.config import load
    from jointid.output import json as answers
    from jointid.output.report.report import report_estimate
    from jointid.output.report.reproducibility import repetition
    from jointid.simulation import sensitivities

    work = _read_work(folder)
    if work["gain"] is not None:
        _learn(folder, work)
    file = load(folder / "joint.toml")
    _tell("reading the record")
    record = file.record(folder / work["file"])
    _tell("preparing the simulation; the first time on a machine this takes some 20 s")
    sensitivities.warm_up()
    _tell("identifying")
    estimate = file.identify(record, _tell)
    told = report_estimate(estimate, record, name=file.name or "", loop=file.tells_of_its_loop, progress=_tell)
    again = repetition(folder / "joint.toml", folder / work["file"], {})
    again = replace(again, command="jointid report joint.toml --html report.html")
    _write(folder / "report.html", replace(told, repetition=again).html())
    _write(folder / "answer.txt", f"{told.estimate}\n")
    answers.write(answers.to_dict(told.estimate), folder / "answer.json")


def _learn(folder: Path, work: dict[str, Any]) -> None:
    """Learn the controller, and put it into the joint file in place of the stand-in."""
    from jointid import learn_loop
    from jointid.config import load, save_with_controller

    _tell("learning the controller")
    file = load(folder / "joint.toml")
    record = file.record(folder / work["file"])
    learned = learn_loop(record, gain=work["gain"], transmission=file.joint.transmission, progress=_tell)
    save_with_controller(file, learned.controller, folder / "joint.toml")
    _write(folder / "learned.txt", f"{learned}\n")


def _read_work(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "work.json").read_text(encoding="utf-8"))
    return found


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")


def _tell(message: str) -> None:
    print(message.replace("\n", " "), flush=True)  # noqa: T201


ACTIONS: dict[str, Callable[[Path], None]] = {
    "preview": preview,
    "simulate": simulate,
    "check": check,
    "identify": identify,
}


def _end_with_the_page() -> None:
    """Wait for the end of standard input, which comes when the page ends, however it does."""
    while os.read(0, 1):  # past the buffer, whose lock a thread must not hold when Python ends
        pass
    os._exit(1)


def _bound_memory(memory: int) -> None:
    """Take no more address space than so many bytes, where the system can hold a process to it."""
    if sys.platform == "linux":  # macOS knows the bound and does not keep to it, Windows has none
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        least = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_AS, (least, least))


def main(action: str, folder: Path) -> int:
    """Do one piece of work, and return the exit code."""
    try:
        ACTIONS[action](folder)
    except JointidError as error:
        faults = error.faults if isinstance(error, FaultsError) else (str(error),)
        _write(folder / "fault.json", json.dumps(faults))
        return REFUSED
    except MemoryError:
        _write(folder / "fault.json", json.dumps([_TOO_LARGE]))
        return REFUSED
    return 0


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_page, daemon=True).start()
    _bound_memory(int(sys.argv[3]))
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
