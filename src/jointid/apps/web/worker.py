"""The process that does one piece of work for the page: `python -m jointid.apps.web.worker ACTION FOLDER MEMORY`.

A file may be damaged and a fit may take hours: whatever becomes of the process, the page stays up, and its memory is
bounded. It prints its progress, a line each, and leaves its answer in the folder; exit code 2 and `fault.json` for what
the person can mend, 3 for a disk that is full, 5 for too little memory. It ends when the page does, whose end it hears
on its standard input.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jointid.apps.web.folder import CHECKED, PREVIEW, Run, link_files, write_json
from jointid.common.bounds import LIBRARIES, TOO_LARGE, limit_memory, measure_memory
from jointid.common.errors import JointFileError, JointidError
from jointid.common.files import is_full, write_whole

if TYPE_CHECKING:
    from jointid import Estimate, Record
    from jointid.config.contents import File
    from jointid.tuning.tuned import Tuned

REFUSED, NO_ROOM = 2, 3

_MOMENT = 3.0  # seconds that the first report waits for what belongs into it
_FOLLOWS = "It is still being computed, and follows in this place."


def preview(folder: Path) -> None:
    """Read the record of `work.json`, and write its preview."""
    from jointid.apps.web.preview import build_preview
    from jointid.records.formats import read_table

    work = _read_work(folder)
    table = read_table(folder / work["file"], **work["options"])
    if not table.columns:
        raise JointidError("The file holds no column with more than one number; choose another file.")
    write_whole(folder / f"{work['file']}{PREVIEW}", json.dumps(build_preview(table), allow_nan=False))


def simulate(folder: Path) -> None:
    """Simulate the digital twin, and write `example.csv`."""
    from jointid import twin, write

    write(twin().record, folder / "example.csv")


def check(folder: Path) -> None:
    """Read the records as the entries of the form in `work.json` say, and write what the first one holds."""
    from jointid.apps.web.form import make_reading_tables, require_answers
    from jointid.config import JointFile

    work = _read_work(folder)
    require_answers(work["draft"])
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as place:
        link_files(folder, work["files"], Path(place))  # by the names that the joint file has
        names = [*work["files"]]
        file = JointFile.of(make_reading_tables(work["draft"], *names), Path(place) / "joint.toml")
        first, *_ = [file.record(Path(place) / name) for name in ([names[0]] if file.source.files else names)]
    assert first.torque is not None
    size = {"samples": len(first.torque), "sample_time": first.torque.sample_time, "duration": first.torque.duration}
    write_whole(folder / f"{work['files'][names[0]]}{CHECKED}", json.dumps({**size, "unit": first.torque.unit}))


def fill_in(folder: Path) -> None:
    """Write the entries of the form that the joint file or robot file in `work.json` makes to `made.json`."""
    from jointid.apps.web.form import fill_in_form

    write_whole(folder / "made.json", json.dumps(fill_in_form(_read_work(folder)["text"])))


def order(folder: Path) -> None:
    """Write the joint file or the robot file of the form in `work.json`, and whether to learn, to `made.json`."""
    from jointid.apps.web.form import MODELS, make_order, make_robot_order

    work = _read_work(folder)
    names = [*work["files"]]
    if work["robot"]:
        link_files(folder.parent, {n: f for n, f in work["files"].items() if n.lower().endswith(MODELS)}, folder)
        text, records = make_robot_order(work["draft"], names, folder)
        made = {"name": "robot.toml", "text": text, "records": records, "learn": False}
    else:
        text, to_learn = make_order(work["draft"], *names)
        made = {"name": "joint.toml", "text": text, "records": names[:1], "learn": to_learn}
    write_whole(folder / "made.json", json.dumps(made))


def prepare(_: Path) -> None:
    """Compile the simulation before the first identification needs it."""
    from jointid.simulation.warm_up import warm_up

    warm_up(wait=True)


def identify(folder: Path) -> None:
    """Identify as the joint file or robot file says, a controller learned first if `work.json` says so.

    The answer is written as soon as it is known and checked, and the page shows it; the report follows.
    """
    from jointid import Record
    from jointid.config import load
    from jointid.estimation.result.parts import IN_WINDOWS
    from jointid.simulation.warm_up import warm_up

    work = _read_work(folder)
    if work["learn"]:
        learn(folder, work)
    file: File[Any] = load(folder / Run(folder).file)
    paths = [folder / name for name in work["records"]]
    about = {"name": file.name or "", "checked": False}
    write_json(folder / "about.json", about)
    if file.runs or len(paths) > 1:
        _print_progress("identifying from several records")
        _write_tuning(folder, "They are computed from one record; identify one alone.")
        _write_answer(folder, file.identify_together([] if file.runs else paths, _print_progress))
        return
    _print_progress("reading the record")
    record = file.record(paths[0], judged=True)
    if isinstance(record, Record):  # the engine of a robot is another
        _print_progress("preparing the simulation")
        warm_up()
    _print_progress("identifying")
    try:
        estimate = file.identify(record, _print_progress, unchecked=partial(_write_answer, folder))
    except JointidError as error:
        raise file.explain(error, record, _print_progress) from error
    write_json(folder / "about.json", about | {"checked": True})
    _write_answer(folder, estimate)
    if estimate.data.windows is not None:
        _write_tuning(folder, IN_WINDOWS)
        return
    _print_progress("writing the report")
    _write_report(folder, file, estimate, record)


def _write_report(folder: Path, file: File[Any], estimate: Estimate, record: Record | tuple[Record, ...]) -> None:
    """Write the report, first without profiles and tuning where these take longer than a moment."""
    from jointid import Report
    from jointid.common.parallel import Aside
    from jointid.output.report import repetition, tune_to_limit

    system: Literal["joint", "robot"] = "joint" if estimate.robot is None else "robot"
    again = repetition(file.path, Path(file.record_path()), {}, system=system)
    again = replace(again, command=f"jointid report {file.path.name} --html report.html")
    tell = partial(
        Report.of, estimate, record, name=file.name or "", controllers=file.controllers,
        feed_forward=file.feed_forward, repetition=again, progress=_print_progress,
    )  # fmt: skip

    def tell_all() -> Report:
        if estimate.robot is not None:
            _write_tuning(folder, "They are of one joint: jointid tune robot.toml --axis, with the name of the joint.")
            return tell()
        tuned = tune_to_limit(estimate, file.axes[0].drive, file.declared_numbers)
        _write_tuning(folder, tuned)
        return tell(tuned=None if isinstance(tuned, str) else tuned)

    whole = Aside(tell_all)
    if not whole.is_done(within=_MOMENT) and estimate.robot is None:
        first = tell(profiles=())
        first.data.absent["profiles"] = first.data.absent["tuning"] = _FOLLOWS
        write_whole(folder / "report.html", first.html())
    write_whole(folder / "report.html", whole.result().html())


def _write_tuning(folder: Path, tuned: Tuned | str | None) -> None:
    """Write margins and gains, or why there are none."""
    from jointid.common.document import Code, Table

    if tuned is None or isinstance(tuned, str):
        why = tuned or "They need an answer by DIDIM under a controller whose torque limit is given in step 3."
        stated: dict[str, Any] = {"sentence": f"No margins and gains: {why}", "tables": [], "notch": ""}
    else:
        blocks = tuned.proposal()
        tables = [{"header": one.header, "rows": one.rows} for one in blocks if isinstance(one, Table)]
        notch = "".join(f"{one.caption}\n{one.text}" for one in blocks if isinstance(one, Code))
        stated = {"sentence": tuned.sentence, "tables": tables, "notch": notch}
    write_json(folder / "tuning.json", stated)


def _write_answer(folder: Path, estimate: Estimate) -> None:
    """Write an estimate as text, drawing and JSON, this at once, since the page looks when it was written."""
    from jointid.estimation.result.answer import mark_of
    from jointid.output import json as answers
    from jointid.output.figures.axis_drawing import draw_axis, resonance_sentence

    write_whole(folder / "answer.txt", f"{estimate}\n")
    if estimate.robot is None:
        write_whole(folder / "axis.svg", draw_axis(estimate))
        write_whole(folder / "resonance.txt", resonance_sentence(estimate))
    marks = {str(v.subject): "noted" for v in estimate.checks.verdicts if mark_of(estimate, v) == "noted"}
    write_json(folder / "marks.json", marks)
    answers.write(answers.to_dict(estimate), folder / "answer.json")


def learn(folder: Path, work: dict[str, Any]) -> None:
    """Learn the controller, and put it into the joint file in place of the stand-in."""
    from jointid.config import load_joint, save_with_controller

    _print_progress("learning the controller")
    file = load_joint(folder / "joint.toml")
    learned = file.learn_controller(file.record(folder / work["file"]), _print_progress)
    save_with_controller(file, learned.controller, folder / "joint.toml")
    write_whole(folder / "learned.txt", f"{learned}\n")


def plan(folder: Path) -> None:
    """Plan the next test of an axis that was identified, for the goal of `work.json`: tables, a figure, `plan.json`."""
    from jointid.common.charts import png
    from jointid.common.document import Facts, Table
    from jointid.config import load_joint
    from jointid.output.test_layout import lay_out
    from jointid.planning.design import design
    from jointid.simulation.warm_up import warm_up

    work = _read_work(folder)
    file = load_joint(folder / "joint.toml")
    record = file.record(folder / work["file"])
    warm_up()
    _print_progress("identifying again")
    estimate = file.identify(record, _print_progress, checks=False)
    asked = {"goal": work["goal"], "search_time": work["seconds"], "limits": file.limits}
    found = lay_out(file, design(estimate, record, progress=_print_progress, **asked))
    for name, content in {**found.files(), "test.png": png(found)}.items():
        write_whole(folder / name, content)
    table, reached, _, facts = found.to_document().blocks
    assert isinstance(table, Table)
    assert isinstance(reached, Table)
    assert isinstance(facts, Facts)
    stated = {
        "goal": found.goal.name,
        "sentence": found.sentence,
        "header": table.header,
        "rows": table.rows,
        "facts": [*reached.rows, *facts.pairs],
    }
    write_whole(folder / "plan.json", json.dumps(stated))


def _read_work(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "work.json").read_text(encoding="utf-8"))
    return found


def _print_progress(message: str) -> None:
    line = message.replace("\n", " ")
    with contextlib.suppress(OSError):  # a full disk loses the line, and the work goes on
        os.write(1, f"{line}\n".encode())


ACTIONS: dict[str, Callable[[Path], None]] = {
    "preview": preview,
    "simulate": simulate,
    "check": check,
    "fill_in": fill_in,
    "order": order,
    "prepare": prepare,
    "identify": identify,
    "plan": plan,
}


def _end_with_the_page() -> None:
    """Wait for the end of standard input, which comes when the page ends, however it does."""
    while os.read(0, 1):  # past the buffer, whose lock a thread must not hold when Python ends
        pass
    os._exit(1)


def main(action: str, folder: Path) -> int:
    """Do one piece of work, and return the exit code."""
    try:
        try:
            ACTIONS[action](folder)
        except MemoryError:
            return TOO_LARGE
        except JointidError as error:
            if is_full(error):
                raise
            faults = getattr(error, "faults", (str(error),))
            places = [getattr(fault, "place", ()) for fault in faults]
            fault = {"faults": faults, "places": places, "of_form": isinstance(error, JointFileError)}
            write_whole(folder / "fault.json", json.dumps(fault))
            return REFUSED
    except (JointidError, OSError) as error:
        if is_full(error):
            return NO_ROOM
        raise
    return 0


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_page, daemon=True).start()
    # Beside the libraries: one that is loaded at the limit fails in ways of its own, not with `MemoryError`.
    limit_memory(measure_memory() + LIBRARIES + int(sys.argv[3]))
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
