"""Causes that concern more than the torque of one joint, on a twin of three joints, and springs beside rigid joints."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.changes import AVERAGED, Cause
from jointid.diagnostics.diagnosis import Diagnosis, diagnose_robot
from jointid.diagnostics.robot_causes import find_robot_cause
from jointid.diagnostics.suspects import LOG_GAIN, FaultTest, Finding
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from tests.estimation.robots.test_one_estimate import logged
from tests.estimation.robots.twin import SAMPLE_TIME, arm, identified, motion, records_of
from tests.models.robots.trees import inverse_dynamics

FILTERING = Filtering(cutoff=10.0, decimation=15, position_cutoff=20.0)


def diagnosed(robot: Robot, records: list[Record]) -> Diagnosis:
    return diagnose_robot(identified(robot, records), records)


def cause_of(declared: Robot, truth: Robot) -> Cause | None:
    """Return the cause of a log of a robot that is declared otherwise."""
    return find_robot_cause(declared, records_of(truth, 2, noise=0.02), FILTERING)


def scaled(record: Record, position: float, torque: float) -> Record:
    """Return a record with position and torque times these."""
    return replace(
        record,
        motor_position=replace(record.motor_position, values=position * record.motor_position.values),
        torque=replace(record.torque, values=torque * record.torque.values),
    )


@pytest.mark.parametrize(("cause", "noise"), [pytest.param("order", 0.02, marks=pytest.mark.slow), ("gear_ratio", 0.6)])
def test_one_cause_is_named_in_place_of_faults_of_single_joints(cause: str, noise: float) -> None:
    robot = arm(3)
    records = list(records_of(robot, 2, noise=noise))
    if cause == "order":
        records[1:] = records[2], records[1]
    if cause == "gear_ratio":
        records[1] = scaled(records[1], 1.1, 1 / 1.1)
    found = diagnosed(robot, records)
    assert found.cause is not None and found.cause.name == cause and not found.explained
    assert not any(axis.faults.findings for axis in found.axes)
    assert found.sentence == found.sentences[0] and "check geometry" not in " ".join(found.sentences)
    if cause == "gear_ratio":
        assert found.cause.joints == ("joint2",) and found.cause.value == pytest.approx(1.1, rel=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "stiffness"), [(0, 2e4), (1, 2e4), (1, -2e4)])
def test_a_spring_is_named_at_its_joint_in_spite_of_noise(joint: int, stiffness: float) -> None:
    robot = arm(3)
    q, v, a = motion(2, 3)
    t = np.arange(len(q)) * SAMPLE_TIME
    w = 2 * np.pi * np.array([5.1, 6.3, 7.4])
    size, phase = np.array([0.01, 0.01, 0.01]), np.array([0.0, 1.0, 2.0])
    turns = np.outer(t, w) + phase
    q, v, a = q + size * np.sin(turns), v + w * size * np.cos(turns), a - w * w * size * np.sin(turns)
    through = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    wound = [through * np.eye(3)[joint] / stiffness]
    for _ in range(2):
        wound.append(np.gradient(wound[-1], SAMPLE_TIME, axis=0))
    motors = [one + more for one, more in zip((q, v, a), wound, strict=True)]
    rotor, viscous, coulomb, _ = (robot.of_joints(n) for n in ("rotor_inertia", "viscous", "coulomb", "offset"))
    torque = through + rotor * motors[2] + viscous * motors[1] + coulomb * np.sign(motors[1])
    torque += 0.005 * np.std(torque, axis=0) * np.random.default_rng(0).normal(size=torque.shape)
    motors[0] += 3e-6 * np.random.default_rng(1).normal(size=torque.shape)
    like = records_of(robot, 2)
    records = [
        replace(one, torque=replace(one.torque, values=u), motor_position=replace(one.motor_position, values=x))  # type: ignore[type-var]
        for one, u, x in zip(like, torque.T, motors[0].T, strict=True)
    ]
    found = diagnosed(robot, records)
    named = [(axis.name, one.test.name) for axis in found.axes for one in axis.faults.findings]
    if stiffness < 0.0:  # as a force in the loop shows; no spring is softer than none
        assert "compliance" not in {fault for _, fault in named}
        return
    assert named[0] == (f"joint{joint + 1}", "compliance")
    assert joint == 0 or {fault for _, fault in named} == {"compliance"}


def test_a_position_that_is_its_reference_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    records = list(records_of(arm(3), 2, noise=0.02))
    records[1] = replace(records[1], reference=records[1].motor_position)
    found = diagnosed(arm(3), records)
    assert found.cause is not None and found.cause.name == "reference_is_position" and found.cause.joints == ("joint2",)
    way, gain = (Finding(FaultTest(fault, (), 0.0, 1.0, 0.0, 0.0), None, (), {}) for fault in (AVERAGED, LOG_GAIN))
    faults = tuple(replace(axis.faults, findings=(way, gain)) for axis in found.axes)
    monkeypatch.setattr("jointid.diagnostics.diagnosis.search_axes", lambda *_: faults)
    assert all(axis.faults.findings == (way,) for axis in diagnosed(arm(3), records).axes)


def test_a_position_that_is_its_reference_is_the_cause_under_controllers_too() -> None:
    loop, (first, second) = logged()
    found = ji.identify((first, replace(second, motor_position=second.reference)), loop)
    assert (found.diagnosis.cause.name, found.diagnosis.cause.joints) == ("reference_is_position", ("joint2",))
    assert not found.answer.reliable


@pytest.mark.parametrize("tilt", [0.15, pytest.param(np.pi, marks=pytest.mark.slow)])
def test_a_base_is_named_by_its_angle_from_the_declared_one(tilt: float) -> None:
    down = 9.81 * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    cause = cause_of(replace(arm(3), gravity=np.array([0.0, 0.0, 9.81])), replace(arm(3), gravity=down))
    assert cause is not None and cause.name == "base" and cause.value == pytest.approx(tilt, abs=0.02)


@pytest.mark.slow
def test_a_declared_coupling_leaves_the_causes_and_an_undeclared_one_is_named() -> None:
    robot = arm(3)
    coupled = replace(robot, joints=(*robot.joints[:2], replace(robot.joints[2], coupling={"joint2": 1.0})))
    assert cause_of(coupled, coupled) is None
    cause = cause_of(robot, coupled)
    assert cause is not None and (cause.name, cause.joints) == ("coupled", ("joint3", "joint2"))


@pytest.mark.slow
def test_torques_without_gravity_are_a_cause_and_a_length_that_no_robot_has_is_none() -> None:
    assert getattr(cause_of(arm(3), replace(arm(3), gravity=np.zeros(3))), "name", "") == "unlogged_gravity"
    robot = arm(3)
    far = replace(robot.links[2], origin=robot.links[2].origin + np.array([1.4, 0.0, 0.0]))
    cause = cause_of(robot, replace(robot, links=(*robot.links[:2], far)))
    assert cause is None or cause.name != "geometry"


@pytest.mark.slow
def test_of_two_zeros_of_encoders_one_is_named() -> None:
    one = cause_of(arm(3), arm(3).turn(np.array([0.0, -1.6, 0.0])))
    assert one is not None and (one.name, one.joints) == ("zero", ("joint2",))
    assert one.value == pytest.approx(-1.6, abs=0.1)
    cause = cause_of(arm(3), arm(3).turn(np.array([0.0, -0.4, 0.5])))
    assert cause is not None and (cause.name, cause.joints) == ("zero", ("joint2",))
