"""A log is searched once: what `identify` found is kept beside the joint file, and other commands begin from it."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import jointid as ji
import jointid.diagnostics.identify as verb
from jointid.apps.cli.console import Options
from jointid.config import File
from jointid.output import json as answers
from tests.rigid_axis import TRUTH, recorded, run, write_axis

PROGRAM = """
import os, signal, sys
import jointid.diagnostics.identify as verb
from jointid.apps.cli import main
number = int(sys.argv.pop())
signal.signal(signal.SIGINT, signal.SIG_IGN if number == signal.SIGTERM else signal.default_int_handler)  # as nohup
verb.run_checks = lambda *_: os.kill(os.getpid(), number)
main()
"""


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Every search that is made."""
    made, search = list[Any](), verb.fit_records
    monkeypatch.setattr(verb, "fit_records", lambda *one, **asked: made.append(one) or search(*one, **asked))
    return made


def answer(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text("utf-8")))


@pytest.mark.slow
def test_all_commands_begin_from_one_search(
    searches: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joint, out, other = write_axis(tmp_path), tmp_path / "out.json", tmp_path / "other.npy"
    ji.write(recorded(0.5, seed=1), other)
    files = ("--html", tmp_path / "r.html", "--json", out)
    assert run("identify", joint, "--no-checks", "-q", "--json", out) == 0
    assert answer(out)["answer"]["trust"]["code"] == "not_checked"
    for words in (("tune",), ("design", "--search-time", "0.1"), ("validate", "--record", other)):
        assert run(words[0], joint, *words[1:], "-q") == 0
    assert run("export", joint, "--out", tmp_path / "axis.xml") == 0
    commands = (("identify", *files[2:]), ("diagnose", *files[2:]), ("report", "--no-profiles", *files))
    said = list[bytes]()
    for command, *words in commands:
        assert run(command, joint, *words, "-q") == 0
        said.append(out.read_bytes())
    assert len(searches) == 1
    for (command, *words), before in zip(commands, said, strict=True):
        assert run(command, joint, *words, "-q", "--again") == 0
        assert out.read_bytes() == before, "the same as from a search"
    assert len(searches) == 4 and answer(out)["diagnosis"]["axes"][0]["faults"]["tests"]
    turned = (joint, "-q", "--set", "record.channels.torque.sign=-1")
    assert run("identify", *turned) == 2
    said_of_it, made = capsys.readouterr().err, len(searches)
    assert run("report", *turned) == 2 and capsys.readouterr().err == said_of_it, "a refusal is kept, too"
    assert run("diagnose", *turned, "--json", out) == 3
    assert answer(out)["symptoms"][0]["code"] == "torque_sign" and len(searches) == made > 4


def test_what_changes_the_answer_searches_again(
    searches: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joint, log = write_axis(tmp_path), tmp_path / "run.npy"
    words = ["identify", joint, "--no-checks", "-q"]
    for count, change in enumerate((
        lambda: None,
        lambda: log.write_bytes(log.read_bytes()[:-1] + b"\1"),
        lambda: joint.write_text(joint.read_text("utf-8") + "\n", "utf-8"),
        lambda: words.extend(("--set", "filtering.cutoff=40")),
        lambda: monkeypatch.setattr(answers, "_digest_program", lambda: "another version"),
    ), start=1):  # fmt: skip
        change()
        for _ in range(2):
            assert run(*words) == 0
            assert len(searches) == count
    assert run(*words, "--window", "9") == 2
    monkeypatch.setattr(File, "identify", None)
    assert run(*words, "--window", "9") == 2, "a refusal of windows is kept, too"


def test_a_test_for_a_refused_value_is_planned_from_its_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    joint, find = write_axis(tmp_path), Options.find

    def refuse(*asked: Any, **more: Any) -> ji.Estimate:
        found = find(*asked, **more)
        return replace(found, rows=tuple(replace(p, value=None, stderr=None) for p in found.rows))

    monkeypatch.setattr(Options, "find", refuse)
    assert run(*(words := ("design", joint, "--search-time", "0.1", "-q"))) == 2
    assert run(*words, *(word for n, x in TRUTH.items() for word in ("--set", f"parameters.{n}.start={x}"))) == 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no process can send itself these signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_what_is_known_when_the_checks_are_ended_is_printed_and_kept(
    number: signal.Signals, code: int, searches: list[Any], tmp_path: Path
) -> None:
    joint, out = write_axis(tmp_path), tmp_path / "out.json"
    words = [sys.executable, "-c", PROGRAM, "identify", *map(os.fspath, (joint, "--json", out)), str(int(number))]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended.returncode == code and not ended.stdout and answer(out)["answer"]["trust"]["code"] == "not_checked"
    assert all(word in ended.stderr for word in ("Inertia", "not checked", "Interrupted"))
    assert run("identify", joint, "-q") == 0 and not searches


@pytest.mark.parametrize("content", ["{", '{"schema": "jointid.Estimate/2"}', None])
def test_another_file_in_its_place_stays_and_counts_for_nothing(
    content: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joint, place = write_axis(tmp_path), tmp_path / "joint.estimate.json"
    place.mkdir() if content is None else place.write_text(content, "utf-8")
    assert run("identify", joint, "--no-checks") == 0
    said = capsys.readouterr()
    assert "Inertia" in said.out and "is not kept" in said.err and "Traceback" not in said.err
    assert content is None or place.read_text("utf-8") == content


def test_a_damaged_estimate_is_searched_for_again(searches: list[Any], tmp_path: Path) -> None:
    joint, place = write_axis(tmp_path), tmp_path / "joint.estimate.json"
    words = ("identify", joint, "-q", "--no-checks")
    assert run(*words) == 0
    whole = answer(place)
    for count, spoiled in enumerate(({"parameters": {}}, {"diagnosis": {"axes": 1}}, {"x": "x"}), start=2):
        place.write_text(json.dumps(whole | spoiled), "utf-8")
        assert run(*words) == 0
        assert len(searches) == count
    assert run(*words, "--json", place) == 2, "it is no place for answers"
