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
from jointid.apps.web.routes import _bundle, _events
from jointid.common import parallel
from jointid.diagnostics.check_loop import search_faults
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


def test_an_archive_holds_the_newest_answer(tmp_path: Path) -> None:
    """The first one may have been made of an answer whose loop was not checked yet, before there was a report."""
    run = Run(tmp_path)
    (tmp_path / "log.csv").write_text("1,2")
    (tmp_path / "work.json").write_text('{"file": "log.csv", "files": ["log.csv"]}')
    for answer in ("unchecked", "checked"):
        (tmp_path / "answer.json").write_text(answer)
        path, _ = _bundle(run)
        assert zipfile.ZipFile(path).read("answer.json").decode() == answer
