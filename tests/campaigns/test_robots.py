"""Robots in a campaign: a fleet of records, runs that are simulated, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointid.campaigns.campaign_file import load_campaign
from jointid.campaigns.cases import Outcome
from jointid.campaigns.run import run_case
from jointid.common.errors import JointFileError
from tests.apps.cli.test_robots_from_torques import logged, run, write_files
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
    cases = list(found.cases())
    assert [case.day for case in cases] == ["2026-11-22", "2026-11-23"]
    run("campaign", "run", place / "campaign.toml", "--out", place / "results", "--workers", "1")
    run("campaign", "export", place / "results", "--out", place / "rows.csv")
    capsys.readouterr()
    header, *rows = (place / "rows.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 2 and "joint2.coulomb" in header
    row = run_case(cases[0])
    assert row.outcome is Outcome.IDENTIFIED and row.converged
    for joint in two().robot.joints:
        coulomb = row.found[f"{joint.name}.coulomb"]
        assert coulomb.value is not None and coulomb.std is not None and coulomb.unit == "N m"
        assert abs(coulomb.value - joint.coulomb) < 4 * coulomb.std


def test_another_model_is_another_case(place: Path) -> None:
    text = '[fleet]\njoint = "robot.toml"\nrecords = "robot_{day}.csv"\n'
    before = [case.content_hash for case in load_campaign(campaign(place, text)).cases()]
    model = place / "robot.xml"
    model.write_text(model.read_text(encoding="utf-8") + "\n<!-- changed -->\n", encoding="utf-8")
    after = [case.content_hash for case in load_campaign(campaign(place, text)).cases()]
    assert len({*before, *after}) == 4


@pytest.mark.slow
def test_simulated_runs_of_a_robot_differ_by_their_seed(place: Path) -> None:
    text = '[monte_carlo]\njoint = "robot.toml"\nrecord = "references.csv"\nruns = 2\nnoise_log = 0.5\nseed = 7\n'
    rows = [run_case(case) for case in load_campaign(campaign(place, text)).cases()]
    assert [row.seed for row in rows] == [7, 8]
    values = [row.found["joint1.coulomb"].value for row in rows]
    assert values[0] != values[1]
    assert values == pytest.approx([4.0, 4.0], rel=0.05)
    assert "parameters known to a tenth" in rows[0].sentence


def test_what_is_fixed_is_not_counted(place: Path) -> None:
    file = place / "robot.toml"
    text = file.read_text(encoding="utf-8")
    channels = '[record.channels]\nmotor_position = { column = "q{axis}" }'
    fixed = '\n[method]\nname = "idim"\nfixed = { "joint2.viscous" = 1.2 }\n'
    file.write_text(text.replace("[record.channels]", channels) + fixed, encoding="utf-8")
    asked = '[monte_carlo]\njoint = "robot.toml"\nrecord = "references.csv"\nruns = 1\nnoise_log = 0.5\n'
    row = run_case(next(load_campaign(campaign(place, asked)).cases()))
    assert "of 12 parameters known to a tenth" in row.sentence


@pytest.mark.parametrize("method", ["didim", "idim"])
def test_simulated_runs_of_a_robot_stand_beside_their_truth(place: Path, method: str) -> None:
    joint = place / "robot.toml"
    text = joint.read_text(encoding="utf-8")
    text = text.replace("[record.channels]", '[record.channels]\nmotor_position = { column = "q{axis}" }')
    text = text.replace('name = "joint2"\n', 'name = "joint2"\ncoupling = { joint1 = 0.6 }\ncoulomb_backwards = 5.0\n')
    joint.write_text(f'{text}\n[method]\nname = "{method}"\n', encoding="utf-8")
    asked = '[monte_carlo]\njoint = "robot.toml"\nrecord = "references.csv"\nruns = 1\nnoise_log = 0.5\nseed = 7\n'
    row = run_case(next(load_campaign(campaign(place, asked)).cases()))
    assert set(row.truth) == set(row.found)
    assert row.truth["joint1.viscous" if method == "idim" else "joint1.coulomb"] == pytest.approx(
        3.0 if method == "idim" else 4.0
    )
    for name, value in row.truth.items():
        found = row.found[name]
        assert found.value is not None and found.std is not None
        assert abs(found.value - value) < 5 * found.std, name


def test_what_is_refused(place: Path) -> None:
    for kind in ("bootstrap", "multistart"):
        with pytest.raises(JointFileError, match=rf"\[{kind}\] draws .* is a robot file"):
            load_campaign(campaign(place, f'[{kind}]\njoint = "robot.toml"\nruns = 2\n'))
    text = '[monte_carlo]\njoint = "robot.toml"\nrecord = "references.csv"\nruns = 1\nnoise_force = 0.5\n'
    row = run_case(next(load_campaign(campaign(place, text)).cases()))
    assert row.outcome is Outcome.REFUSED and "leave values and noise_force out" in row.sentence
    with pytest.raises(JointFileError, match=r"method\.wonder"):
        load_campaign(campaign(place, '[fleet]\njoint = "robot.toml"\n[sweep]\n"method.wonder" = [1]\n'))
