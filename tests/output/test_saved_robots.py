"""An estimate of a robot that was saved comes back, and predicts what it predicted."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import RecordError
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.output.json import load_estimate
from jointid.records.record import Record
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import two


@cache
def logged(seed: int) -> tuple[RobotLoop, tuple[Record, ...]]:
    twin = two()
    loop = twin.loop()
    return loop, tuple(recorded(loop, twin.records(4.0 + seed), 0.01)[0])


def systems() -> dict[str, Any]:
    loop, _ = logged(0)
    return {"idim": loop.robot, "didim": loop, "delays": loop}


@cache
def found(method: str) -> ji.Estimate:
    free = ji.DIDIM(free=("delay",)) if method == "delays" else None
    return ji.identify(logged(0)[1], systems()[method], free, checks=False)


@pytest.mark.parametrize("method", ["idim", pytest.param("didim", marks=pytest.mark.slow), "delays"])
def test_a_saved_estimate_of_a_robot_comes_back(method: str, tmp_path: Path) -> None:
    estimate, system = found(method), systems()[method]
    path = estimate.save(tmp_path / "out.json")
    back = load_estimate(path, system)
    assert back.to_dict() == estimate.to_dict()
    assert back.summary(details=True) == estimate.summary(details=True)
    np.testing.assert_allclose(back.covariance, estimate.covariance, rtol=1e-12)
    assert (
        back.data.fingerprints == estimate.data.fingerprints and back.settings.filtering == estimate.settings.filtering
    )
    unseen = logged(1)[1]
    one, other = (ji.validate(each, unseen) for each in (back, estimate))
    np.testing.assert_allclose(*([a.filtered_error for a in check.axes] for check in (one, other)), rtol=1e-9)
    assert one.nominal_error == pytest.approx(other.nominal_error, rel=1e-9)
    assert ji.validate(back, logged(0)[1]).test == "direct"
    xml = [ji.export(each, "urdf").text for each in (back, estimate)]
    assert xml[0] == xml[1]
    read, fresh = (each.require_robot().robot().of_joints("viscous") for each in (back, estimate))
    np.testing.assert_allclose(read, fresh, rtol=1e-12)
    said = ji.Report.of(back, logged(0)[1])
    assert json.loads(said.answer())["estimate"]["parameters"] == estimate.to_dict()["parameters"]


def test_a_robot_that_is_another_one_is_refused(tmp_path: Path) -> None:
    loop, _ = logged(0)
    path = found("idim").save(tmp_path / "out.json")
    first, second = loop.robot.links
    longer = replace(loop.robot, links=(first, replace(second, origin=1.2 * second.origin)))
    with pytest.raises(RecordError):
        load_estimate(path, longer)
    renamed = replace(loop.robot, joints=tuple(replace(one, name=f"j{k}") for k, one in enumerate(loop.robot.joints)))
    with pytest.raises(RecordError):
        load_estimate(path, renamed)
    with pytest.raises(RecordError):
        load_estimate(found("didim").save(tmp_path / "loop.json"), loop.robot)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["didim", "drive_side"])
def test_a_saved_estimate_of_a_flexible_robot_comes_back(method: str, tmp_path: Path) -> None:
    twin = two((12.0, 15.0))
    loop = twin.loop()
    records = tuple(recorded(loop, twin.records(6.0, multisine=0.004), 0.003)[0])
    system = loop if method == "didim" else RobotDriveSide(loop.robot)
    estimate = ji.identify(records, system, checks=False)
    back = load_estimate(estimate.save(tmp_path / "out.json"), system)
    assert back.to_dict() == estimate.to_dict()
    one, other = back.require_robot(), estimate.require_robot()
    assert isinstance(one, SimulatedRobot) and isinstance(other, SimulatedRobot)
    for mine, own in zip(one.numbers().arrays, other.numbers().arrays, strict=True):
        np.testing.assert_allclose(mine, own, rtol=1e-12)
