"""The joint files of the actuators identify what MuJoCo's logs are made with."""

from __future__ import annotations

from pathlib import Path

import pytest

import jointid as ji
from jointid.output.report.data_sheet import data_sheets
from tests.docs.blocks import ROOT

pytest.importorskip("mujoco", reason="the logs are made by MuJoCo, which is not installed")
from examples.actuator import make as actuators

FOLDER = ROOT / "examples" / "actuator"
QUICK = "leg"
NAMES = [QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in actuators.ACTUATORS if name != QUICK)]


@pytest.mark.parametrize("name", NAMES)
def test_an_actuator_is_identified_from_the_torque_of_its_log(name: str, tmp_path: Path) -> None:
    actuators.make(name, tmp_path / "log.csv")
    file = ji.load(FOLDER / f"{name}.toml")
    estimate = file.identify(file.record(tmp_path / "log.csv"))
    assert estimate.answer.reliable, estimate.answer
    truth = actuators.ACTUATORS[name].values
    for row in (row for row in estimate.params.rows if row.of_joint):
        assert row.interval is not None
        assert row.interval[0] <= truth[row.name] <= row.interval[1], (row.name, row.interval)
    asked = estimate.answer.found.values["parameter"]
    assert estimate[asked].value == pytest.approx(truth[asked], rel=0.02)
    (sheet,) = data_sheets(estimate)
    kp, kd = actuators.ACTUATORS[name].gains
    said = {row[0]: row[1] for row in sheet.rows}
    assert (float(said["kp"]), float(said["kd"])) == pytest.approx((kp, kd), rel=1e-4)
    assert ("backlash" in said) == ("gap" in truth)


def test_the_readme_has_every_joint_file() -> None:
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(actuators.ACTUATORS)
    assert all(page.count(f"| `{name}.toml` |") == 1 for name in actuators.ACTUATORS)
