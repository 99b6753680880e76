"""One record through every door: the same first line, the same trust and the same verdicts."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli import main
from jointid.campaigns.campaign import Case
from jointid.campaigns.run import run_case
from jointid.campaigns.store import Outcome
from jointid.config import File
from jointid.estimation.result.verdict import Subject
from jointid.output.report import sections

_JOINT = """[joint]
kind = "prismatic"
[record]
file = "run.csv"
time = "t"
[record.channels]
torque = {{ column = "f", unit = "N" }}
reference = {{ column = "r", unit = "m" }}
[controller]
law = "cascade"
position_gain = {gain}
velocity_gain = 2000.0
"""


def _recorded(folder: Path, gain: float) -> File:
    """Write a record of a drive, and a joint file that declares its position gain."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=4.0, travel=0.04, rest=0.05, sample_time=1e-3)
    truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    noise = 0.5 * np.random.default_rng(0).standard_normal(reference.size)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise)
    (folder / "joint.toml").write_text(_JOINT.format(gain=gain), encoding="utf-8")
    file = ji.load(folder / "joint.toml")
    file.write(record, folder / "run.csv")
    return file


def _command(*words: object) -> None:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    assert end.value.code == 0


def _told(answer: dict[str, Any]) -> tuple[Any, ...]:
    """Return what an answer in JSON says: its first line in two parts, its trust and its verdicts."""
    first, verdicts = answer["answer"], answer["checks"]["verdicts"]
    return first["found"]["words"], first["trust"]["words"], first["trust"]["code"], verdicts


@pytest.mark.parametrize(("gain", "trust"), [(100.0, "reliable"), (60.0, "not_reliable_yet")])
def test_one_record_has_one_answer(gain: float, trust: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sections, "svg", lambda *_: b"")  # drawing takes as long as all else
    file, joint, run = _recorded(tmp_path, gain), tmp_path / "joint.toml", tmp_path / "run.csv"
    record = file.record(run)
    notebook = ji.identify(record, ji.ClosedLoop(file.joint, file.loop.controller))
    expected = _told(ji.to_dict(notebook))
    assert expected[2] == trust
    assert notebook.checks.verdicts[-1].subject is Subject.LOOP
    assert _told(ji.to_dict(file.identify(record))) == expected
    _command("identify", joint, "--record", run, "--json", tmp_path / "command.json", "-q")
    _command("report", joint, "--record", run, "--html", tmp_path / "report.html", "--no-profiles", "--no-tuning", "-q")
    assert _told(json.loads((tmp_path / "command.json").read_text(encoding="utf-8"))) == expected
    page = re.search(
        r'<script[^>]*id="jointid-answer"[^>]*>(.*?)</script>',
        (tmp_path / "report.html").read_text(encoding="utf-8"),
        re.DOTALL,
    )
    assert page is not None
    assert _told(json.loads(page[1])["estimate"]) == expected
    row = run_case(Case("axis", joint.read_text(encoding="utf-8"), str(run), ""))
    outcome = Outcome.IDENTIFIED if trust == "reliable" else Outcome.DOUBTFUL
    assert (row.outcome, row.sentence, row.trust) == (outcome, notebook.sentence, trust)
