"""The estimate of a robot is that of a joint: its checks, its trust, its document, and what refuses it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import jointid as ji
from jointid.common.errors import MethodError, RecordError
from jointid.estimation.result.verdict import Subject, Trust
from jointid.models.robots.robot import RobotLoop
from jointid.output.json import load_estimate
from jointid.records.record import Record
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import two


@cache
def logged() -> tuple[RobotLoop, tuple[Record, ...]]:
    loop = two().loop()
    return loop, tuple(recorded(loop, two().records(6.0), 0.01)[0])


@cache
def estimate(*, checks: bool = True) -> ji.Estimate:
    loop, records = logged()
    return ji.identify(records, loop, checks=checks)


def verdicts(found: ji.Estimate) -> dict[Subject, bool | None]:
    return {check.name: check.passed for check in found.checks}


def test_a_robot_under_its_declared_controllers_is_relied_on() -> None:
    found = estimate()
    assert set(verdicts(found).values()) == {True}
    assert {Subject.SOLVER, Subject.FIT, Subject.BOUNDS, Subject.REPEATABLE, Subject.LOOP} == set(verdicts(found))
    assert found.answer.trust.code is Trust.RELIABLE and found.fit.converged
    row = found["joint2.coulomb"]
    assert (row.axis, row.unit) == ("joint2", "N m")
    assert row.interval[0] < 1.5 < row.interval[1]
    assert found.correlation.shape == (len(found.rows),) * 2 and found.residual.shape[1] == 2
    assert [row[-1] for row in found.to_document().blocks[0].rows] == ["reliable", "reliable"]


def test_a_controller_that_is_not_as_declared_speaks_against_a_robot() -> None:
    loop, records = logged()
    first, second = loop.controllers
    wrong = replace(loop, controllers=(first, replace(second, torque_filters=(ji.controller.FirstOrder(0.02),))))
    found = ji.identify(records, wrong)
    assert (verdicts(found)[Subject.LOOP], found.answer.trust.code) == (False, Trust.NOT_YET)
    assert [row[-1] for row in found.to_document().blocks[0].rows] == ["reliable", "not reliable yet"]


def test_a_joint_that_the_model_does_not_explain_speaks_against_a_robot() -> None:
    loop, records = logged()
    robot = replace(loop.robot, joints=(replace(loop.robot.joints[0], coupling={}), loop.robot.joints[1]))
    torque = records[1].torque
    spoilt = (records[0], replace(records[1], torque=replace(torque, values=torque.values[::-1].copy())))
    found = ji.identify(spoilt, robot, ji.IDIM())
    assert (verdicts(found)[Subject.FIT], found.answer.trust.code) == (False, Trust.NOT_YET)
    assert "torque_unexplained" in found.answer.trust.values["reasons"]
    assert [row[-1] for row in found.to_document().blocks[0].rows] == ["not checked", "not reliable yet"]


@pytest.mark.parametrize(
    "use",
    [
        ji.validate,
        ji.Report.of,
        lambda found, logs: ji.identify((*logs[0], logs[1]), found.robot.setup),
        lambda found, logs: ji.identify((logs[0], *logs[1]), found.robot.setup),
        lambda found, logs: ji.identify(logs, ji.twin().loop),
        lambda found, logs: ji.Report.of(found, logs[0], controllers=found.robot.setup.controllers[:1]),
        lambda found, logs: ji.robots.identify_payload(ji.twin().loop, *logs),  # type: ignore[arg-type]
    ],
)
def test_records_and_lists_that_do_not_fit_are_refused_in_a_sentence(use: Callable[[ji.Estimate, Any], object]) -> None:
    with pytest.raises((MethodError, RecordError)):
        use(estimate(), (logged()[1], logged()[1]))


def test_its_file_is_of_the_same_schema_and_is_no_joint(tmp_path: Path) -> None:
    found = estimate()
    answer = found.to_dict()
    assert answer["schema"] == "jointid.Estimate/2"
    assert answer["answer"]["trust"]["code"] == "reliable"
    row = answer["parameters"]["joint1.viscous"]
    assert row["axis"] == "joint1" and row["formula"] == row["symbol"] == "Fv1"
    assert row["nominal"] == pytest.approx(3.0)
    assert len(answer["correlation"]) == len(found.rows)
    with pytest.raises(RecordError):
        load_estimate(found.save(tmp_path / "robot.json"), ji.RigidJoint("revolute"))
    with pytest.raises(MethodError, match="that of a robot"):
        ji.intervals(found, logged()[1][0])
