"""Page of a report, with its parts' documents and pictures as sections.

A page opens without a network, prints, and runs no script. Its policy forbids scripts, so a text that evades the
escaping stays text. The answer that it carries for other programs is JSON in which no tag can end.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid import __version__
from jointid.common.charts import svg
from jointid.common.document import Block, Document, Documented, Facts, Picture, Style, Table, Text, templates
from jointid.common.errors import RecordError
from jointid.common.files import digest, explain, write_folder
from jointid.common.text import in_words, sentence
from jointid.config.toml import apply_changes
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import Trust
from jointid.models.controllers import numbers_of
from jointid.output import figures as charts
from jointid.output.axis_drawing import axis_figure, resonance_sentence
from jointid.output.json import REPORT_ELEMENT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jointid.output.report import Report

PAGES = (".html", ".htm")


def page(document: Document) -> str:
    """Render a document as one HTML page, with reproducible bytes."""
    anchors: dict[int, str] = {}  # of the headings, each name once
    for place, block in enumerate(document.blocks):
        if isinstance(block, Text) and block.style == "heading":
            name = re.sub(r"[^a-z0-9]+", "-", block.text.lower()).strip("-") or "part"
            anchors[place] = name if name not in anchors.values() else f"{name}-{place}"
    contents = [(getattr(document.blocks[place], "text", ""), name) for place, name in anchors.items()]
    return templates(Path(__file__).parent).get_template("page.html").render(
        title=document.title,
        blocks=[(block, anchors.get(place, "")) for place, block in enumerate(document.blocks)],
        contents=contents,
        answer=document.answer,
        element=REPORT_ELEMENT,
    )  # fmt: skip


def save(document: Document, folder: str | Path, name: str) -> tuple[Path, ...]:
    """Write `name`.html and its pictures into a folder; return the paths.

    Raises:
        RecordError: the folder or a file cannot be written.
    """
    return write_folder(folder, {f"{name}.html": page(document).encode()} | document.pictures)


@dataclass(frozen=True, slots=True)
class Repetition:
    """Version, files and command that reproduce a report; empty if unknown.

    Attributes:
        version: of this program.
        record_file: name of the record's file, or files.
        record_date: year-month-day when the file was last written (UTC).
        record_file_sha256: of that file, or of these one after the other.
        joint_file_name, joint_file: name and text of the file of the joint or of the robot.
        command: that writes the report again.
        declared: of the joint file, in words by what they are of.
    """

    version: str = __version__
    record_file: str = ""
    record_date: str = ""
    record_file_sha256: str = ""
    joint_file_name: str = ""
    joint_file: str = ""
    command: str = ""
    declared: Mapping[str, str] = field(default_factory=dict)


def repetition(
    joint: Path,
    records: Sequence[Path],
    options: Mapping[str, object],
    changes: Iterable[str] = (),
    html: str = "report.html",
) -> Repetition:
    """Data to repeat a report; file names are without folders.

    Options that are None are omitted; `changes` are keys of the joint file, as ``method.frequency=30``.
    `records` are the files of one record; the command names a single file, the joint file several.

    Raises:
        RecordError: a file cannot be read.
    """
    words = ["jointid", "report", joint.name, *(["--record", records[0].name] if len(records) == 1 else [])]
    given = {name.replace("_", "-"): str(value) for name, value in options.items() if value is not None}
    pairs = [*given.items(), *(("set", change) for change in changes), ("html", html)]
    command = shlex.join([*words, *(word for name, value in pairs for word in (f"--{name}", value))])
    with explain(joint, "opened", "check the path"):
        text = joint.read_text(encoding="utf-8")
    date = datetime.fromtimestamp(records[0].stat().st_mtime, UTC).date().isoformat()
    names = ", ".join(record.name for record in records)
    tables = apply_changes(tomllib.loads(text), changes)
    constant = tables.get("joint", {}).get("torque_constant")
    drive = {"torque_constant": f"{constant} (it scales all values; only a known mass shows it)"} if constant else {}
    torque = tables.get("record", {}).get("channels", {}).get("torque", {})
    if "tap" in torque or (torque and "profile" not in tables.get("drive", {})):  # a profile knows its signals
        logged = "an actual value" if torque.get("tap") == "measured" else "a setpoint"
        drive["torque"] = f"{logged} as declared (no record shows it behind a fast current loop)"
    stated = {"Controller": tables.get("controller", {}), "Drive": tables.get("drive", {}) | drive}
    shown = {name: _say(table)[1:-1] for name, table in stated.items() if table}
    return Repetition(__version__, names, date, digest(*records), joint.name, text, command, shown)


def _say(declared: Any) -> str:
    """Write what a file declares in words, of a filter its kind and numbers."""
    if type(declared) is dict:
        shown = (f"{in_words(key)} {_say(one)}".removeprefix("kind ") for key, one in declared.items())
        return f"({', '.join(shown)})"
    return " and ".join(map(_say, declared)) if type(declared) is list else str(declared).replace("_", " ")


_TONES: Mapping[Trust, Style] = {Trust.RELIABLE: "good", Trust.PARTLY: "good", Trust.NOT_CHECKED: "open"}  # else bad
_PICTURES = {
    "torque": (
        "",
        "Measured and predicted torque, and their difference. The motion is {motion}. Lines break where nothing "
        "is compared.",
    ),
    "residual": (
        "Residual",
        "The error against the {motion} velocity and position of the motor, with its mean over all samples. A mean "
        "that bends with velocity is friction. One that repeats with position is cogging, gravity or a screw's pitch.",
    ),
    "spectra": (
        "Spectra",
        "Amplitude spectra, with the joint's frequencies. Where the error is as large as the measured torque, the "
        "model explains nothing.",
    ),
    "response": (
        "Frequency response",
        "Velocity of the identified joint per motor torque, without Coulomb friction. The motor side has a dip at the "
        "motor-locked frequency, and a peak at the free-free one, which a controller must avoid or damp.",
    ),
    "profiles": (
        "Profiles",
        "The rise of the criterion in standard deviations, where a quantity is held and all others are fitted again. "
        "The interval ends at a rise of 2. The dashed line is that of the table: where they differ, use the profile.",
    ),
    "tuning": (
        "Tuned loop",
        "The joint's response, the loop cut open at the torque, and its Nyquist plot; the circle about -1 is the "
        "distance that was asked.",
    ),
}
"""The titles of the pictures, and what to see in them; in the order of the appendix."""


def report_blocks(given: Report, figures: Mapping[str, Figure]) -> Iterator[Block]:
    """Yield the whole report: result and appendix."""
    estimate, tuned = given.estimate, given.tuned
    yield Text("Result", "heading")
    yield from _result(given)
    if given.diagnosis is not None and given.diagnosis.sentences:
        yield from (Text("What to do", "heading"), Text("\n".join(given.diagnosis.sentences), "list"))
    torque = Text("Torque", "heading"), _picture(given, figures, "torque")
    if estimate.robot is None:
        yield Text("Parameters", "heading")
        yield from [*_part(estimate)][:-1]  # the last block has hints of the command
    else:  # the joints first; the inertial parameters are in the appendix
        yield from (*torque, Text("Joints", "heading"), next(_part(estimate)))
    if tuned is not None:
        yield Text("Tuning", "heading")
        yield Text(tuned.sentence)
        yield from tuned.proposal()
    yield from torque if estimate.robot is None else ()
    for check in given.checks:
        yield Text(f"Prediction of {check.record}", "heading")
        yield from _part(check)
    yield from (Text("Appendix", "heading"), Text("The estimate in full", "heading"))
    yield from _part(estimate, details=True)
    for part, title in ((given.diagnosis, "Tested faults"), (given.validation, "Validation"), (tuned, "Loop")):
        if part is not None:
            yield Text(title, "heading")
            yield from _part(part, details=part is given.diagnosis)
    for name in [name for name in _PICTURES if name in figures and name != "torque"]:
        yield Text(_PICTURES[name][0], "heading")
        yield _picture(given, figures, name)
        if name == "profiles":
            yield Text("\n".join(map(str, given.profiles)), "list")
    if given.absent:
        yield Text("Not available", "heading")
        yield Text("\n".join(sentence(" ".join(one.splitlines())) for one in given.absent.values()), "list")
    yield Text("Settings and data", "heading")
    yield from _settings(given)


def _part(result: Documented, *, details: bool = False) -> Iterator[Block]:
    """Yield the blocks of a result's document, its headings a level lower."""
    for block in result.to_document(details=details).blocks:
        yield replace(block, style="part") if isinstance(block, Text) and block.style == "heading" else block


def draw_figures(given: Report) -> dict[str, Figure]:
    """Figures of a report by name, without those that cannot be drawn."""
    estimate, cutoff = given.estimate, given.estimate.settings.filtering.cutoff
    if estimate.robot is not None:
        assert given.diagnosis is not None
        axes = charts.AxisSignals.of_robot(given.diagnosis)
    else:
        direct = given.validation
        axes = [charts.AxisSignals.of(estimate)] if direct is None else charts.AxisSignals.of_validation(direct)
    every: dict[str, Callable[[], Figure]] = {
        "torque": lambda: charts.torque_figure(axes),
        "residual": lambda: charts.residual_figure(axes),
        "spectra": lambda: charts.spectra_figure(axes, cutoff, estimate.frequencies),
        "profiles": lambda: charts.profiles_figure(estimate, given.profiles),
    }
    if given.response is not None:
        every["response"] = partial(charts.response_figure, estimate, given.response)
    if given.tuned is not None:
        every["tuning"] = given.tuned.plot
    found: dict[str, Figure] = {}
    for name, draw in every.items():
        with contextlib.suppress(RecordError):
            found[name] = draw()
    return found


def _picture(given: Report, figures: Mapping[str, Figure], name: str) -> Picture:
    motion = "simulated" if given.estimate.settings.simulates == "loop" else "measured"
    return Picture(f"{name}.svg", partial(svg, figures[name], name), _PICTURES[name][1].format(motion=motion))


def _result(given: Report) -> Iterator[Block]:
    """Yield the answer, its checks and the drawing of a joint."""
    estimate = given.estimate
    yield Text(str(estimate.answer), style=_TONES.get(Trust(estimate.answer.trust.code), "bad"))
    untested = "Whether it predicts another motion is not known yet: validate it on another record."
    yield from map(Text, [check.sentence for check in given.checks] or [untested])
    if estimate.robot is None:
        if resonances := resonance_sentence(estimate):
            yield Text(resonances)
        yield Picture("axis.svg", lambda: svg(axis_figure(estimate), "axis"), "The axis, with 2 sigma", wide=False)
        loop, motion = estimate.settings.loop, given.channels.get("reference")
        numbers = {} if loop is None else numbers_of(loop.controller)
        law = {name: f"{value:.3g}" for name, value in numbers.items() if 0.0 < abs(value) < np.inf}
        facts = {"Controller": _say(law)[1:-1]}
        if motion is not None:
            travel, speed = np.ptp(motion.values), np.abs(np.diff(motion.values)).max() / motion.sample_time
            size = f"{travel:.3g} {motion.unit} at up to {speed:.3g} {motion.unit}/s"
            facts["Motion"] = f"{motion.duration:.3g} s at {1.0 / motion.sample_time:.4g} Hz, {size}"
        yield Facts(tuple((name, said) for name, said in (facts | dict(given.repetition.declared)).items() if said))
    else:
        yield Text("All numbers are behind the gears.")


def _settings(given: Report) -> Iterator[Block]:
    """Yield filter settings, the record's channels, and how to repeat the report."""
    estimate, repetition = given.estimate, given.repetition
    f = estimate.settings.filtering
    position = "none" if f.position_cutoff is None else f"{f.position_cutoff:g} Hz"
    facts = (
        ("Filter", f"{f.cutoff:g} Hz, one sample in {f.decimation}; positions {position}; timing {f.timing}"),
        ("Delay of the torque", f"{1e3 * estimate.settings.delay:.4g} ms"),
        *(("Torque, SHA-256 of its samples", one) for one in estimate.data.fingerprints if one),
    )
    known = {"jointid": repetition.version, "Record": repetition.record_file, "Its date": repetition.record_date}
    known["Its SHA-256"] = repetition.record_file_sha256
    yield Facts((*facts, *((name, value) for name, value in known.items() if value)))
    if given.channels:
        yield _channels_table(estimate, given)
    if repetition.command:
        yield from (Text("The command, with its files beside each other:"), Text(repetition.command, "code"))
        yield from (Text(f"The file {repetition.joint_file_name}:"), Text(repetition.joint_file, "code"))


def _channels_table(estimate: Estimate, given: Report) -> Table:
    """Table of the record's channels, and which were read."""
    rows = list[tuple[str, ...]]()
    for name, one in given.channels.items():
        said = name.replace("_", " "), "read" if name in estimate.data.channels else "not read", one.source or "-"
        rows.append((*said, one.timing.value, one.unit, f"{one.sample_time:.6g}", str(len(one))))
    header = ("channel", "in this answer", "source", "timing", "unit", "sample time [s]", "samples")
    return Table(header, tuple(rows), "The record's channels, in SI units", words=(0, 1, 2, 3, 4))
