"""What a worker leaves and when: the answer before it is checked, a report without what takes long, the whole one."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.web import worker
from jointid.apps.web.folder import Run
from jointid.apps.web.form import make_order
from jointid.apps.web.pages import _build_checks, _build_rows
from jointid.apps.web.routes import _bundle, _events
from jointid.common import parallel
from jointid.diagnostics.check_loop import search_faults
from jointid.uncertainty.verdict import Subject
from tests.apps.web.asking import LAW, UNITS

DRAFT = LAW | UNITS | {f"record.channels.{name}.column": name for name in ("torque", "reference", "motor_position")}
DRAFT |= {"record.time": "t", "controller.limit": "1000"}


@dataclass
class Kept:
    """The versions of answer and report that a worker wrote, in their order, and how often the loop was checked."""

    answers: list[dict[str, Any]] = field(default_factory=list)
    reports: list[str] = field(default_factory=list)
    checks: int = 0


@pytest.fixture
def identified(tmp_path: Path, log: bytes, monkeypatch: pytest.MonkeyPatch) -> tuple[Run, Kept]:
    """A run whose profiles and tuning are never there in a moment."""
    (tmp_path / "log.csv").write_bytes(log)
    (tmp_path / "joint.toml").write_text(make_order(DRAFT, "log.csv")[0], encoding="utf-8")
    (tmp_path / "work.json").write_text(json.dumps({"file": "log.csv", "records": ["log.csv"], "learn": False}))
    kept = Kept()
    replace = Path.replace

    def replace_and_keep(path: Path, target: Path) -> Path:
        done = replace(path, target)
        if target.name == "answer.json":
            kept.answers.append(json.loads(target.read_text(encoding="utf-8")))
        if target.name == "report.html":
            kept.reports.append(target.read_text(encoding="utf-8"))
        return done

    def count(check: Callable[..., Any]) -> Callable[..., Any]:
        def check_and_count(*given: Any, **named: Any) -> Any:
            kept.checks += 1
            return check(*given, **named)

        return check_and_count

    monkeypatch.setattr(Path, "replace", replace_and_keep)
    monkeypatch.setattr("jointid.diagnostics.diagnose.search_faults", count(search_faults))
    monkeypatch.setattr(parallel.Aside, "is_done", lambda aside, within=0.0: False)
    worker.identify(tmp_path)
    return Run(tmp_path), kept


@pytest.mark.slow
def test_the_answer_comes_first_then_its_check_then_the_report_and_the_whole_of_it(
    identified: tuple[Run, Kept],
) -> None:
    _, kept = identified
    assert kept.checks == 1
    first, last = kept.answers
    assert first["parameters"] == last["parameters"]
    assert "which was not checked" in first["answer"]["trust"]["words"]
    assert "not checked" not in last["answer"]["trust"]["words"]
    begun, whole = kept.reports
    assert "It is still being computed, and follows in this place" in begun
    assert "being computed" not in whole
    assert '<h2 id="tuning"' not in begun
    assert "Tuning in full" in whole


@pytest.mark.anyio
@pytest.mark.parametrize("anyio_backend", ["asyncio"])
async def test_each_version_is_told_once(tmp_path: Path, anyio_backend: str) -> None:
    run = Run(tmp_path)
    run.update(state="running")
    told = _events(run, 0)
    (tmp_path / "answer.json").write_text("{}")
    first = await anext(told)
    assert first.startswith("event: answer")
    (tmp_path / "report.html").write_text("")
    assert (await anext(told)).startswith("event: report")
    (tmp_path / "whole").write_text("")
    (tmp_path / "whole").replace(tmp_path / "answer.json")
    second = await anext(told)
    assert second.startswith("event: answer")
    assert second != first
    run.update(state="done")
    assert [said.split("\n")[0] async for said in told] == ["event: end"]


def _answer(*reasons: dict[str, Any]) -> dict[str, Any]:
    shown = {"symbol": "K12", "unit": "N/m", "value": 2e4, "std": 100.0, "free": True, "lower_bound": None}
    parameters = {"stiffness": shown | {"at_bound": None}, "load_viscous": shown | {"at_bound": 0.0, "symbol": "Fv2"}}
    verdicts = [{"subject": "loop", "status": "failed", "reasons": list(reasons)}]
    return {"parameters": parameters, "verdicts": verdicts}


def test_what_a_fault_moves_is_remarked_as_in_the_table_of_the_command() -> None:
    """A law that is not excluded adds nothing to a fault that was found; what is within the interval is not said."""
    fault = {"code": "loop_not_as_declared", "words": "", "values": {"changes": {"stiffness": 1234.0}}}
    law = {"code": "law_undecided", "words": "", "values": {"changes": {"stiffness": -3000.0}}}
    small = {"code": "loop_not_as_declared", "words": "", "values": {"changes": {"stiffness": 20.0}}}
    assert [row["note"] for row in _build_rows(_answer(fault, law))] == ["+1234 N/m once corrected", "at its bound"]
    assert _build_rows(_answer(law))[0]["note"] == "-3000 N/m under the other law"
    assert not _build_rows(_answer(small))[0]["note"]
    assert not _build_rows(_answer())[0]["note"]


def test_an_archive_holds_the_newest_answer(tmp_path: Path) -> None:
    """The first one may have been made of an answer whose loop was not checked yet, before there was a report."""
    run = Run(tmp_path)
    (tmp_path / "log.csv").write_text("1,2")
    (tmp_path / "work.json").write_text('{"file": "log.csv"}')
    for answer in ("unchecked", "checked"):
        (tmp_path / "answer.json").write_text(answer)
        path, _ = _bundle(run)
        assert zipfile.ZipFile(path).read("answer.json").decode() == answer


def test_a_check_asks_the_same_on_the_page_and_in_the_report() -> None:
    verdicts = [{"subject": subject.value, "status": "passed", "reasons": []} for subject in Subject]
    assert [one["question"] for one in _build_checks({"verdicts": verdicts}, {})] == [one.question for one in Subject]


def test_a_noted_check_is_noted_on_the_page() -> None:
    failed = {"subject": Subject.WHITENESS.value, "status": "failed", "reasons": []}
    answer = {"verdicts": [failed, failed | {"subject": Subject.FIT.value}]}
    assert [one["mark"] for one in _build_checks(answer, {Subject.WHITENESS.value: "noted"})] == ["noted", "not fine"]


def test_an_interval_of_the_page_holds_the_lack_of_fit() -> None:
    """The table had 1.3 kg where the answer above it had 1.8."""
    answer = _answer()
    answer["parameters"]["stiffness"]["lack_of_fit"] = 300.0
    assert _build_rows(answer)[0]["value"] == "20000 ± 630 N/m"
