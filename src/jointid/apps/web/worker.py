"""A process that works for the page: `python -m jointid.apps.web.worker MEMORY WORDS`.

The words are those of a command of jointid, or one of the actions below and a folder. A file may be damaged and a fit
may take hours: whatever becomes of the process, the page stays up, and its memory is bounded. It ends when the page
does, whose end it hears on its standard input. Refusals of an action are in `fault.json`, with exit code 2.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jointid.apps.web.folder import MODELS, REFUSED
from jointid.common.bounds import LIBRARIES, TOO_LARGE, limit_memory, measure_memory
from jointid.common.errors import JointFileError, JointidError
from jointid.common.files import write_whole


def preview(folder: Path) -> None:
    """Write the columns of the first record, and what the log says of itself."""
    from jointid.apps.web.form import describe_record
    from jointid.apps.web.preview import build_preview
    from jointid.records.formats import read_table

    work = _read(folder, "work.json")
    for name in reversed(work["files"]):  # the first one last
        table = read_table(folder / name, **work["options"])
        if not table.columns:
            raise JointidError(f"{name} holds no column with more than one number; choose another file.")
        made = describe_record(list(table.columns))
        _write(folder, "columns.json", {**build_preview(table), "sentence": made["sentence"]})
        _write(folder, "made.json", made)


def example(folder: Path) -> None:
    """Simulate the digital twin, and write its record and joint file."""
    from jointid import twin, write
    from jointid.paper.twin import JOINT_FILE

    write(twin().record, folder / "example.csv")
    write_whole(folder / "joint.toml", JOINT_FILE.replace(", optional = true", ""))  # this record has every channel


def check(folder: Path) -> None:
    """Read the records as the forms say, and write what the first one holds."""
    from jointid.apps.web.form import make_reading_tables
    from jointid.config import file_of

    names = _records(folder)
    file = file_of(make_reading_tables(_read(folder, "draft.json"), names), folder / "joint.toml")
    first, *_ = [file.record(folder / name) for name in ([names[0]] if file.source.files else names)]
    torque = first.torque
    assert torque is not None
    size = {"samples": len(torque), "sample_time": torque.sample_time, "duration": torque.duration, "unit": torque.unit}
    _write(folder, "checked.json", size)


def fill_in(folder: Path) -> None:
    """Write the entries of the forms that the joint file or robot file makes."""
    from jointid.apps.web.form import fill_in_form

    _write(folder, "made.json", fill_in_form((folder / "joint.toml").read_text(encoding="utf-8-sig")))


def order(folder: Path) -> None:
    """Write the joint file or the robot file that the forms describe."""
    from jointid.apps.web.form import make_joint_file, make_robot_file

    draft, sent = _read(folder, "draft.json"), _read(folder, "sent.json")["files"]
    if any(name.lower().endswith(MODELS) for name in sent):
        write_whole(folder / "robot.toml", make_robot_file(draft, sent, folder))
    else:
        write_whole(folder / "joint.toml", make_joint_file(draft, sent))


def prepare(_: Path) -> None:
    """Compile the simulation before the first identification needs it."""
    from jointid.simulation.warm_up import warm_up

    warm_up(wait=True)


ACTIONS: dict[str, Callable[[Path], None]] = {
    one.__name__: one for one in (preview, example, check, fill_in, order, prepare)
}


def _read(folder: Path, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / name).read_text(encoding="utf-8"))
    return found


def _write(folder: Path, name: str, value: Any) -> None:
    write_whole(folder / name, json.dumps(value, allow_nan=False))


def _records(folder: Path) -> list[str]:
    return [name for name in _read(folder, "sent.json")["files"] if not name.lower().endswith(MODELS)]


def act(action: str, folder: Path) -> int:
    """Carry out an action, and return the exit code."""
    try:
        ACTIONS[action](folder)
    except MemoryError:
        return TOO_LARGE
    except JointidError as error:
        faults = getattr(error, "faults", (str(error),))
        places = [getattr(fault, "place", ()) for fault in faults]
        _write(folder, "fault.json", {"faults": faults, "places": places, "of_form": isinstance(error, JointFileError)})
        return REFUSED
    return 0


def _end_with_the_page() -> None:
    """Wait for the end of standard input, which comes when the page ends, however it does."""
    while os.read(0, 1):  # past the buffer, whose lock a thread must not hold when Python ends
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_page, daemon=True).start()
    # Beside the libraries: one that is loaded at the limit fails in ways of its own, not with `MemoryError`.
    limit_memory(measure_memory() + LIBRARIES + int(sys.argv[1]))
    if sys.argv[2] in ACTIONS:
        sys.exit(act(sys.argv[2], Path(sys.argv[3])))
    from jointid.apps.cli import main

    main(sys.argv[2:])
