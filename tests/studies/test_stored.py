"""Stored outcomes: read as they were written, within the claims, and the tables of the documentation are theirs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from studies import __main__ as command
from studies.comparing import compute_claim_chance, counted
from studies.registry import STUDIES
from studies.seeds import Judged, Task
from studies.stored import ROOT, Entry, Program, fill_tables, read_entries, shown_studies, write_entries
from studies.study import Share, Study

STUDY = Study(
    "squares",
    "Squares of numbers.",
    "tests.studies.test_stored:square",
    range(20),
    (
        Share("the square is small", lambda outcome: outcome["square"] < 400, 0.9),
        Share("it is odd", lambda outcome: outcome["square"] % 2 == 1 if outcome["square"] else None, 0.2),
    ),
)


def square(seed: int) -> dict[str, int]:
    return {"square": seed**2}


def spoiled(seed: int) -> dict[str, int]:
    return {"square": 1000 + 2 * seed}


def judged(task: Task) -> Judged:
    """Judge a task in this process."""
    return Judged(globals()[task.function.partition(":")[2]](task.seed), 0.5)


def entry(study: Study = STUDY) -> Entry:
    program = Program("0123456789abcdef", True, "2026-11-25", "a processor, 2 cores")
    return Entry(program, tuple(study.seeds), 1, 12.25, study.count([square(seed) for seed in study.seeds]))


def test_entries_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "studies.json"
    assert read_entries(path) == {}
    write_entries({"squares": entry()}, path)
    (found,) = read_entries(path).values()
    assert found == Entry(entry().program, entry().seeds, 1, 12.2, entry().shares)
    assert found.is_of(STUDY)
    assert '"held": 20' in path.read_text(encoding="utf-8")


def test_a_table_stands_between_its_markers() -> None:
    page = "before\n<!-- studies: squares -->\nreplaced\n<!-- end of studies -->\nafter\n"
    assert shown_studies(page) == ["squares"]
    filled = fill_tables(page, [STUDY], {"squares": entry()})
    assert "| the square is small | 20 | 20 | 100.0 | at least 90 |" in filled
    assert "| it is odd | 10 | 19 | 52.6 | at least 20 |" in filled
    assert "seeds 0 to 19; commit 012345678, 2026-11-25, a processor, 2 cores" in filled
    assert filled.startswith("before\n") and filled.endswith("<!-- end of studies -->\nafter\n")
    assert "replaced" not in filled
    assert fill_tables(filled, [STUDY], {"squares": entry()}) == filled
    assert "Not run yet: `python -m studies squares`" in fill_tables(filled, [STUDY], {})


def test_every_study_is_stored_as_it_is_and_within_its_claims() -> None:
    stored = read_entries()
    assert set(stored) == {study.name for study in STUDIES}
    for study in STUDIES:
        assert stored[study.name].is_of(study), study.name
        for share in study.shares:
            counts = counted(stored[study.name].shares[share.label])
            assert compute_claim_chance((0, 0), counts, share) > 1e-3, f"{study.name}: {share.label}"


def test_the_documentation_has_the_stored_tables(capsys: pytest.CaptureFixture[str]) -> None:
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs").rglob("*.md")]
    assert {name for page in pages for name in shown_studies(page)} == {study.name for study in STUDIES}
    assert command.main(["tables", "--check"]) == 0, capsys.readouterr().out


@pytest.fixture
def only_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "STUDIES", (STUDY,))
    monkeypatch.setattr(command, "read_entries", lambda: {"squares": entry()})
    monkeypatch.setattr(command, "judge_tasks", lambda tasks: [judged(task) for task in tasks])


def test_the_check_passes_a_right_program(only_squares: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["check", "--draw", "abc"]) == 0
    said = capsys.readouterr().out
    assert "squares: 8 of 20 tasks" in said
    assert "repeat: python -m studies check --draw abc" in said
    assert "all shares are as stored" in said


def test_the_check_fails_a_spoiled_one(
    only_squares: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "STUDIES", (replace(STUDY, judge="tests.studies.test_stored:spoiled"),))
    assert command.main(["check", "--draw", "abc"]) == 1
    said = capsys.readouterr().out
    assert "the square is small: 0 of 8; the others 12 of 12" in said
    assert "another outcome than the stored one: seed" in said
    assert "FAILED" in said


def test_other_tasks_than_the_stored_ones_are_refused(
    only_squares: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "STUDIES", (replace(STUDY, seeds=range(21)),))
    assert command.main(["check", "--draw", "abc"]) == 1
    assert "other tasks or shares than squares" in capsys.readouterr().out


def test_a_study_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["nothing"]) == 2
    assert 'No study is called nothing; "python -m studies list" shows them.' in capsys.readouterr().out
