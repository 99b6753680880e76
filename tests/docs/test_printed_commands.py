"""Every command that the README's table, a sentence of the documentation or a help text prints runs on the demos."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from jointid.apps.cli import main
from tests.apps.commands import commands
from tests.docs.blocks import ROOT, pages
from tests.learned_once import search_once

_COMMAND = re.compile(r"`(jointid [^`\n]+)`")
_FILE = re.compile(r"[\w/-]+\.(?:toml|csv|json|html|xml|urdf|mat)\b")
_STAND_IN = re.compile(r"(?:^|[\s/])[A-Z]{2,}\b|\$")
_ROWS = 8001  # of the demo's record: a third of it, to be quicker

NOT_RUN = {
    "jointid campaign run campaign.toml --out results --executor slurm --shared /shared/jobs --partition short": "Slurm",
    "jointid learn-controller joint.toml --write learned.toml": "run by the README's own axis, and takes minutes",
}
"""By the command, what it needs that is not here, or where it is run."""


def _printed() -> Iterator[str]:
    texts = [page.read_text(encoding="utf-8") for page in pages()]
    texts += [" ".join((command.__doc__ or "").split()) for command in _functions()]
    for text in texts:
        for command in _COMMAND.findall(text):
            if _FILE.search(command) and not _STAND_IN.search(command):
                yield command.replace("jointid-demo/", "")


def _functions() -> Iterator[object]:
    from jointid.apps.cli.app import app

    for name in commands():
        found = app
        for word in name.split():
            found = found[word]
        if found.default_command is not None:
            yield found.default_command


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
    for name in ("record", "run", "a", "b", "other"):
        (place / f"{name}.csv").write_text("".join(rows), encoding="utf-8")
    shutil.copy(place / "estimate.json", place / "out.json")
    run(f"jointid report {place / 'joint.toml'} --record {place / 'a.csv'} --html {place / 'before.html'} -q")
    shutil.copy(place / "before.html", place / "after.html")
    (place / "campaign.toml").write_text('[fleet]\njoint = "joint.toml"\nrecords = "[ab].csv"\n', encoding="utf-8")
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
    if "robot.toml" in command:
        shutil.copy(place / "other-robot.csv", place / "other.csv")
    run(command)


def test_what_is_not_run_is_printed() -> None:
    assert set(NOT_RUN) <= set(_printed())
    assert len(PRINTED) > 20
