"""The demos of a robot and of a fleet: what can be tried without a real record."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointid.apps.cli.demo import FIRST_DAY
from jointid.config import load
from tests.rigid_axis import run

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.slow
def test_a_robot_is_identified_from_torques_alone_beside_its_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "robot"
    assert run("demo", "--robot", place, "-q") == 0
    names = {"record.csv", "robot.toml", "robot.xml", "estimate.json", "torque.png"}
    assert {path.name for path in place.iterdir()} == names
    for name in ("robot.toml", "robot.xml"):
        assert (place / name).read_bytes() == (ROOT / "examples" / "robot" / name).read_bytes()
    assert (place / "record.csv").read_text(encoding="utf-8").startswith("t,tau1,r1,tau2,r2\n")
    out = capsys.readouterr().out
    assert "repeatable residual" not in out and max(map(len, out.partition("\n\nWritten")[0].splitlines())) <= 80
    rows = re.findall(r"  (-?[\d.e-]+) ± ([\d.e-]+)  \S.*? +(-?[\d.e-]+)  (?:.* )?(\w+)$", out, re.MULTILINE)
    found = {symbol: tuple(map(float, numbers)) for *numbers, symbol in rows}
    assert len(found) == 18, "every parameter has its truth"
    assert all(abs(value - true) < 2 * interval for value, interval, true in found.values())
    value, interval, true = found["K1"]
    assert true == 2560.0 and interval < 0.01 * value
    assert run("demo", "--robot", place, "-q") == 2, "it holds files"


def test_a_fleet_is_made_by_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "fleet"
    assert run("demo", "--fleet", place, "-q") == 0
    assert len([*place.glob("logs/axis-00?/*.npy")]) == 4 * 9
    record = load(place / "joint.toml").record(place / "logs" / "axis-001" / f"{FIRST_DAY}.npy")
    assert record.torque is not None and record.torque.values.size == 8000
    said = capsys.readouterr()
    assert f"jointid campaign {place}/campaign.toml" in said.out
    assert not said.err
    assert run("demo", "--fleet", "--robot", place) == 2
    assert "A demo is of a robot or of a fleet" in capsys.readouterr().err
