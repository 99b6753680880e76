"""One record through every door: the same first line, the same trust and the same verdicts."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import jointid as ji
from jointid.campaigns.campaign import Case
from jointid.campaigns.run import Outcome, run_case
from jointid.estimation.result.verdict import Subject
from jointid.output.report import sections
from tests.rigid_axis import JOINT, run, write_axis


def _told(answer: dict[str, Any]) -> tuple[Any, ...]:
    """Return what an answer in JSON says: its first line in two parts, its trust and its verdicts."""
    first, text = answer["answer"], json.dumps(answer["checks"])
    verdicts = json.loads(text, parse_float=lambda number: f"{float(number):.5g}")
    return first["found"]["words"], first["trust"]["words"], first["trust"]["code"], verdicts


@pytest.mark.parametrize(
    ("gain", "trust"), [(100.0, "reliable"), pytest.param(60.0, "not_reliable_yet", marks=pytest.mark.slow)]
)
def test_one_record_has_one_answer(gain: float, trust: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sections, "svg", lambda *_: b"")  # drawing takes as long as all else
    joint = write_axis(tmp_path, JOINT.replace("100.0", str(gain)))
    file, log = ji.load(joint), tmp_path / "run.npy"
    record = file.record()
    notebook = ji.identify(record, ji.ClosedLoop(file.joint, file.loop.controller))
    expected = _told(ji.to_dict(notebook))
    assert expected[2] == trust
    assert notebook.checks[-1].name is Subject.LOOP
    page = ("--html", tmp_path / "report.html", "--no-profiles", "--no-tuning", "-q")
    assert run("identify", joint, "--record", log, "--json", tmp_path / "command.json", "-q") == 0
    assert run("report", joint, "--record", log, *page) == 0
    assert _told(json.loads((tmp_path / "command.json").read_text(encoding="utf-8"))) == expected
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    answer = re.search(r'<script[^>]*id="jointid-answer"[^>]*>(.*?)</script>', text, re.DOTALL)
    assert _told(json.loads(answer[1])["estimate"]) == expected
    row = run_case(Case("axis", joint.read_text(encoding="utf-8"), str(log), ""))
    outcome = Outcome.IDENTIFIED if trust == "reliable" else Outcome.DOUBTFUL
    assert (row.outcome, row.sentence, row.trust) == (outcome, notebook.sentence, trust)
