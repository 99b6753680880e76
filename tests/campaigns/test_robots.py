"""Robots in a campaign: a fleet of records, and the model as a part of a case."""

import shutil
from pathlib import Path

import pytest

from jointid.apps.cli.demo import _write_robot
from jointid.campaigns.campaign import load_campaign
from jointid.campaigns.run import Outcome, run_case
from tests.rigid_axis import call as run


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The demo's robot file, and its log on two days."""
    _write_robot(tmp_path)
    for day in ("2026-11-22", "2026-11-23"):
        shutil.copy(tmp_path / "record.csv", tmp_path / f"robot_{day}.csv")
    return tmp_path


def campaign(place: Path, text: str) -> Path:
    path = place / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_fleet_of_robots(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = '[fleet]\njoint = "{joint}.toml"\nrecords = "{joint}_{day}.csv"\n'
    found = load_campaign(campaign(place, text))
    cases = list(found.cases)
    assert [case.day for case in cases] == ["2026-11-22", "2026-11-23"]
    run("campaign", place / "campaign.toml", "--workers", "1")
    capsys.readouterr()
    lines = (place / "campaign.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2 and all("elbow.coulomb" in line for line in lines)
    row = run_case(cases[0])
    assert row.outcome is Outcome.IDENTIFIED
    assert row.found["elbow.coulomb"].unit == "N m"


def test_another_model_is_another_case(place: Path) -> None:
    text = '[fleet]\njoint = "robot.toml"\nrecords = "robot_{day}.csv"\n'
    before = [case.content_hash for case in load_campaign(campaign(place, text)).cases]
    model = place / "robot.xml"
    model.write_text(model.read_text(encoding="utf-8") + "\n<!-- changed -->\n", encoding="utf-8")
    after = [case.content_hash for case in load_campaign(campaign(place, text)).cases]
    assert len({*before, *after}) == 4
