"""A validation begins with its answer: whether the joint predicts the record, within what noise allows."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.validation import Prediction
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import two

RATE = 1e-3
LAW = ji.controller.Cascade(position_gain=40.0, velocity_gain=2000.0)
LOOP = ji.ClosedLoop(ji.RigidJoint("prismatic"), LAW)
TRUTH = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}


def made(speed: float, seed: int, loop: ji.ClosedLoop = LOOP, **other: float) -> ji.Record:
    reference = ji.excitation.trapezoids((speed, 2 * speed), 2.0, 0.1, RATE, rest=0.1, duration=4.0)
    noise = 0.5 * np.random.default_rng(seed).standard_normal(reference.size)
    return ji.simulated_record(loop, reference, TRUTH | other, sample_time=RATE, torque_noise=noise, name=f"run{seed}")


@cache
def identified() -> tuple[ji.Estimate, ji.Record]:
    record = made(0.1, 1)
    return ji.identify(record, LOOP, checks=False), record


def answer(record: ji.Record) -> str:
    return str(ji.validate(identified()[0], record).answer.code)


def test_the_same_axis_is_predicted_and_a_changed_one_is_not() -> None:
    code = answer(made(0.13, 2))
    assert code == Prediction.PREDICTED
    code = answer(made(0.13, 3, inertia=33.0))  # 10 %: far less is left than a right model may leave
    assert code == Prediction.NOT_PREDICTED


def test_a_load_encoder_counts_from_elsewhere_in_any_record() -> None:
    joint = ji.FlexibleJoint("revolute")
    loop = ji.ClosedLoop(joint, ji.controller.Cascade(position_gain=40.0, velocity_gain=40.0))
    values = {"motor_inertia": 0.5, "motor_viscous": 1.0, "motor_coulomb": 0.6, "stiffness": 6e3, "damping": 1.0}
    values |= {"load_inertia": 0.3, "load_viscous": 0.8, "load_coulomb": 0.5, "offset": 0.2}
    reference = ji.excitation.trapezoids((1.0, 2.0), 20.0, 1.0, RATE, rest=0.1, duration=4.0)
    record = ji.simulated_record(loop, reference, values, sample_time=RATE)
    other = replace(record.load_position, values=record.load_position.values + 0.3)
    own, moved = (
        ji.validate(ji.identify(record, joint), one) for one in (record, record.with_channels({"load_position": other}))
    )
    assert moved.filtered_error == pytest.approx(own.filtered_error, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [30.0, 33.0])
def test_positions_alone_are_predicted(inertia: float) -> None:
    estimate = ji.identify(made(0.1, 1).without("torque"), LOOP, checks=False)
    found = ji.validate(estimate, made(0.13, 2, inertia=inertia).without("torque"))
    assert found.answer.code is (Prediction.PREDICTED if inertia == 30.0 else Prediction.NOT_PREDICTED)


def test_its_own_record_is_no_test_of_it() -> None:
    assert answer(identified()[1]) == Prediction.OWN_RECORD
    own = ji.validate(*identified())
    assert replace(own, axes=(replace(own.axes[0], filtered_error=0.4),)).answer.code is Prediction.OWN_RECORD


def test_each_of_several_records_is_an_own_one() -> None:
    records = [made(0.1, 1), made(0.13, 2)]
    estimate = ji.identify(records, LOOP)
    assert {ji.validate(estimate, one).answer.code for one in records} == {Prediction.OWN_RECORD}
    with pytest.raises(ji.MethodError):
        ji.validate(ji.identify(records, LOOP, several={"own": (("coulomb",), ("coulomb",))}), records[0])


def test_a_record_that_no_joint_explains_is_not_as_declared() -> None:
    record = made(0.13, 4)
    turned = record.with_channels({"torque": replace(record.torque, values=-record.torque.values)})
    assert answer(turned) == Prediction.NOT_PREDICTED


@pytest.mark.parametrize("inertia", [30.0, 33.0])
@pytest.mark.parametrize("method", [ji.IDIM(), ji.DriveSideFit()])
def test_by_measured_positions_too(method: Any, inertia: float) -> None:
    estimate = ji.identify(made(0.1, 1), LOOP.joint, method)
    found = ji.validate(estimate, made(0.13, 2, inertia=inertia))
    assert found.answer.code is (Prediction.PREDICTED if inertia == 30.0 else Prediction.NOT_PREDICTED)


@pytest.mark.parametrize("by_torques", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_of_a_robot_the_joint_that_changed_is_named(by_torques: bool) -> None:
    twin = two()
    first, second = twin.robot.joints
    changed = replace(twin.robot, joints=(first, replace(second, coulomb=1.5 * second.coulomb)))
    one, other = (twin.records(6.0, seed) for seed in (1, 4))
    estimate = ji.identify(recorded(twin.loop(), one, 0.02)[0], twin.loop() if by_torques else twin.robot, checks=False)
    same = ji.validate(estimate, recorded(twin.loop(), other, 0.02)[0])
    assert same.answer.code is Prediction.PREDICTED
    with pytest.raises(ji.MethodError):
        ji.validate(estimate, recorded(twin.loop(), other, 0.02)[0][:1])
    if by_torques:
        driven = [one.without("torque") for one in recorded(twin.loop(), other, 0.02)[0]]
        assert ji.validate(estimate, driven).answer.code is Prediction.PREDICTED, "as the declared controllers make it"
    there = ji.validate(estimate, recorded(replace(twin.loop(), robot=changed), other, 0.02)[0])
    assert there.answer.code is Prediction.NOT_PREDICTED and there.axes[0].prediction is Prediction.PREDICTED
    assert there.axes[1].attainable_error == pytest.approx(same.axes[1].filtered_error, rel=0.3)
