"""Every command that the README's table, a sentence of the documentation or a help text prints runs on the demos."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App

from jointid.apps.cli import main
from jointid.controller_id.structures import Structure
from tests.apps.commands import commands
from tests.docs.blocks import ROOT, pages
from tests.learned_once import find_law, search_once

_COMMAND = re.compile(r"`(jointid [^`\n]+)`")
_FILE = re.compile(r"[\w/-]+\.(?:toml|csv|json|html|xml|urdf|mat)\b")
_STAND_IN = re.compile(r"(?:^|[\s/])[A-Z]{2,}\b|\$")
_ROWS = 8001  # of the demo's record: a third of it, to be quicker

_ON_SLURM = "jointid campaign run campaign.toml --out results"
NOT_RUN = {
    f"{_ON_SLURM} --executor slurm --shared /shared/jobs --partition short": "Slurm",
    "jointid identify examples/emps/joint.toml --record DATA_EMPS.mat": "a real record",
    "jointid learn-controller examples/emps/joint.toml --record DATA_EMPS.mat": "takes minutes; a page runs it",
    "jointid serve --open": "does not end",
    "jointid payload robot.toml --without empty.csv --with loaded.csv": "two joints do not tell all of a payload",
    "jointid tune examples/emps/joint.toml --record DATA_EMPS.mat": "a real record; a page runs it",
    "jointid diagnose examples/kr300/robot.toml --record rec_A.mat": "a real record",
}
"""By the command, what it needs that is not here, or where it is run."""


def _printed() -> Iterator[str]:
    texts = [page.read_text(encoding="utf-8") for page in pages()]
    texts += [" ".join((command.__doc__ or "").split()) for command in _functions()]
    for text in texts:
        for command in _COMMAND.findall(text):
            if _FILE.search(command) and not _STAND_IN.search(command):
                yield command.replace("jointid-demo/", "")
    for one in _apps():
        if one.default_command is not None:
            yield (one.help_epilogue or "").splitlines()[-2].strip()  # the example of its --help


def _functions() -> Iterator[object]:
    return (one.default_command for one in _apps() if one.default_command is not None)


def _apps() -> Iterator[App]:
    from jointid.apps.cli.app import app

    for name in commands():
        found = app
        for word in name.split():
            found = found[word]
        yield found


PRINTED = sorted(set(_printed()) - set(NOT_RUN))


@pytest.fixture(scope="session")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the demos write, under the names of the records, answers and pages that are printed."""
    place = tmp_path_factory.mktemp("printed")
    run(f"jointid demo --robot {place} -q")
    rows = (place / "record.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    for name in ("references", "other-robot", "empty", "loaded"):
        (place / f"{name}.csv").write_text("".join(rows), encoding="utf-8")
    for name in ("robot.json", "robot.csv"):
        shutil.move(place / {"robot.json": "estimate.json", "robot.csv": "record.csv"}[name], place / name)
    robot = (place / "robot.toml").read_text(encoding="utf-8")
    (place / "robot.toml").write_text(robot.replace('"record.csv"', '"robot.csv"'), encoding="utf-8")
    (place / "torque.png").unlink()
    run(f"jointid demo {place} -q")
    rows = (place / "record.csv").read_text(encoding="utf-8").splitlines(keepends=True)[:_ROWS]
    for name in ("run", "a", "other"):
        (place / f"{name}.csv").write_text("".join(rows), encoding="utf-8")
    run(f"jointid simulate --twin L19 --seed 2 --out {place / 'b.csv'} -q")
    shutil.copy(place / "estimate.json", place / "out.json")
    run(f"jointid report {place / 'joint.toml'} --record {place / 'a.csv'} --html {place / 'before.html'} -q")
    shutil.copy(place / "before.html", place / "after.html")
    (place / "logs").mkdir()
    for name in ("a", "b"):
        shutil.copy(place / f"{name}.csv", place / "logs")
    (place / "campaign.toml").write_text('[fleet]\njoint = "joint.toml"\nrecords = "logs/*.csv"\n', encoding="utf-8")
    run(f"jointid campaign run {place / 'campaign.toml'} --out {place / 'finished'} -q")
    return place


def run(command: str) -> None:
    with pytest.raises(SystemExit) as end:
        main(shlex.split(command)[1:])
    assert end.value.code == 0, command


@pytest.mark.docs
@pytest.mark.parametrize("command", PRINTED)
def test_a_printed_command_runs_as_it_stands(
    command: str, demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = shutil.copytree(demos, tmp_path / "demo")
    (place / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(place)
    search_once(monkeypatch)
    if command.startswith("jointid learn-controller"):  # the search takes minutes, and its law is known
        find_law(monkeypatch, Structure(), {"position_gain": 160.18, "velocity_gain": 243.45})
    if re.match("jointid campaign (status|report|export)", command):
        (place / "finished").rename(place / "results")
    if "--window" not in command:
        shutil.copy(place / "a.csv", place / "record.csv")
    if "axis.toml" in command:
        shutil.copy(place / "joint.toml", place / "axis.toml")
        shutil.copy(place / "a.csv", place / "loaded.csv")
    if "robot.toml" in command:
        for name in ("other", "a", "b"):
            shutil.copy(place / "other-robot.csv", place / f"{name}.csv")
    # Its minute of search is cut short.
    run(f"{command} --search-time 1" if command.startswith("jointid design") else command)


def test_what_is_not_run_is_printed() -> None:
    assert set(NOT_RUN) <= set(_printed())
    assert len(PRINTED) > 20
