"""The page on a disk that is full: a sentence says so, what was there stays, and nothing is left that does not end."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from jointid.apps.web import folder as folder_of_the_page
from jointid.apps.web import worker
from jointid.apps.web.folder import FULL, Folder
from jointid.common.errors import RecordError
from jointid.common.files import write_whole
from tests.apps.web.asking import LAW, MADE, UNITS, Asker

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bounds on files")


@contextlib.contextmanager
def full_disk() -> Iterator[None]:
    """No file takes a byte meanwhile."""
    import resource

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_every_step_says_so_and_what_was_there_stays(asker: Asker, log: bytes) -> None:
    assert asker.post("/draft", UNITS)[0] == 204
    draft, kept = asker.folder.draft, asker.kept
    with full_disk():
        answers = [asker.send("log.csv", log), asker.send("a.toml", b"[joint]", "/jointfile")]
        answers += [asker.post(path, LAW) for path in ("/draft", "/again", "/channels", "/joint")]
    for code, text in answers:
        assert code == 422
        assert FULL in text
    assert asker.folder.draft == draft
    assert asker.kept == kept


@pytest.mark.slow
def test_so_does_what_a_process_could_not_write(asker: Asker) -> None:
    with full_disk():
        code, text = asker.post("/example")
    assert code == 422
    assert FULL in text
    assert asker.folder.record is None


def test_a_record_that_cannot_be_kept_leaves_the_one_before(folder: Path) -> None:
    page = Folder(folder)
    for name in ("old.csv", "new.csv"):
        (folder / name).write_text("t,i\n0,1\n", encoding="utf-8")
    page.save_record(folder / "old.csv", "old.csv", {})
    with full_disk(), pytest.raises(RecordError):
        page.save_record(folder / "new.csv", "new.csv", {})
    for name in ("old.csv", "new.csv"):
        page.discard(name)
    assert (page.record or {})["name"] == "old.csv"
    assert (folder / "old.csv").exists() and not (folder / "new.csv").exists()


@pytest.mark.slow
def test_a_disk_that_is_full_at_the_last_step_leaves_all_of_the_record_before(
    asker: Asker, log: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other record has been read when the disk is full: "go on" still leads to the channels of the one before."""
    assert asker.send("log.csv", log)[0] == 200
    assert asker.post("/channels", UNITS)[0] == 200
    page, kept = asker.folder, asker.kept
    before = page.record, page.preview, page.draft, page.checked
    write = folder_of_the_page.write_json

    def full(path: Path, value: Mapping[str, Any]) -> None:
        if path.name == "record.json":
            with full_disk():
                write(path, value)
        write(path, value)

    monkeypatch.setattr(folder_of_the_page, "write_json", full)
    code, text = asker.send("other.csv", log.replace(b"torque", b"moment"))
    assert code == 422
    assert FULL in text
    assert (page.record, page.preview, page.draft, page.checked) == before
    assert None not in before
    assert asker.kept == kept
    assert "log.csv" in asker.get("/channels")


def test_an_identification_begins_whole_or_not_at_all_and_none_runs_for_ever(folder: Path, log: bytes) -> None:
    page = Folder(folder)
    (folder / "log.csv").write_bytes(log)
    with full_disk(), pytest.raises(RecordError, match="cannot be written"):
        page.new_run({"log.csv": "log.csv"}, MADE)
    assert page.runs == []
    run = page.new_run({"log.csv": "log.csv"}, MADE)
    assert run.active
    with full_disk():
        run.update(state="done")
    assert not run.active
    assert "the disk is full" in run.status["sentence"]


def test_a_worker_says_so_by_its_exit_code(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(_: Path) -> None:
        write_whole(folder / "answer.json", "{}")

    def refuse(_: Path) -> None:
        raise RecordError("It is refused.")

    monkeypatch.setattr(worker, "ACTIONS", {"write": write, "refuse": refuse})
    with full_disk():
        assert [worker.main(action, folder) for action in ("write", "refuse")] == [worker.NO_ROOM] * 2
    assert [worker.main(action, folder) for action in ("write", "refuse")] == [0, worker.REFUSED]


def test_progress_that_cannot_be_kept_ends_no_worker() -> None:
    program = "from jointid.apps.web.worker import _print_progress; _print_progress('identifying')"
    with Path("/dev/full").open("wb") as full:
        ran = subprocess.run([sys.executable, "-c", program], stdout=full, stderr=subprocess.PIPE, check=False)
    assert (ran.returncode, ran.stderr) == (0, b"")
