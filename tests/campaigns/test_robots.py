"""Robots in a campaign: a fleet of records, and the model as a part of a case."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointid.campaigns.campaign import load_campaign
from jointid.campaigns.run import run_case
from jointid.campaigns.store import Outcome
from tests.apps.cli.test_robots_from_torques import logged, write_files
from tests.rigid_axis import call as run
from tests.robots_plants import two


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A robot file of two joints, and two days' logs of one robot."""
    write_files(tmp_path, two(), 4.0)
    for day, motion in (("2026-11-22", "references.csv"), ("2026-11-23", "others.csv")):
        out = f"robot_{day}.csv"
        run("simulate", tmp_path / "robot.toml", "--record", tmp_path / motion, "--out", tmp_path / out)
        logged(tmp_path, out, 0.01, len(motion))
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
    assert len(lines) == 2 and all("joint2.coulomb" in line for line in lines)
    row = run_case(cases[0])
    assert row.outcome is Outcome.IDENTIFIED
    for joint in two().robot.joints:
        coulomb = row.found[f"{joint.name}.coulomb"]
        assert coulomb.value is not None and coulomb.std is not None and coulomb.unit == "N m"
        assert abs(coulomb.value - joint.coulomb) < 4 * coulomb.std


def test_another_model_is_another_case(place: Path) -> None:
    text = '[fleet]\njoint = "robot.toml"\nrecords = "robot_{day}.csv"\n'
    before = [case.content_hash for case in load_campaign(campaign(place, text)).cases]
    model = place / "robot.xml"
    model.write_text(model.read_text(encoding="utf-8") + "\n<!-- changed -->\n", encoding="utf-8")
    after = [case.content_hash for case in load_campaign(campaign(place, text)).cases]
    assert len({*before, *after}) == 4
