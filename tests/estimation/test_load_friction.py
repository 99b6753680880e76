"""Friction that grows with the torque: told by several loads, refused where one record scales it with the rest."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.seen import see_loop
from jointid.diagnostics.suspects import FAULTS
from jointid.estimation.problems.simulated import torque_problem
from jointid.models.controllers import Cascade
from jointid.models.friction import FRICTIONS, Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.load_friction import lifting_arm

TRUTH = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "friction_per_torque": 0.1, "offset": 1.5}
ADDED = 10.0  # kg
LOOP = ClosedLoop(RigidJoint("prismatic", FRICTIONS["load-dependent"]), Cascade(position_gain=60, velocity_gain=500))


def slow_record(seed: int, inertia: float) -> Record:
    """Return a motion so slow that the torque never brakes, with 0.2 N of noise."""
    reference = trapezoids([0.1, 0.3], 2.0, 0.2, 1e-3, 0.1, 4.0)
    made = simulated_record(LOOP, reference, TRUTH | {"inertia": inertia}, sample_time=1e-3)
    noise = 0.2 * np.random.default_rng(seed).standard_normal(len(made.torque.values))
    return replace(made, torque=replace(made.torque, values=made.torque.values + noise))


def without_torque(record: Record, rng: np.random.Generator) -> Record:
    """Return a record of positions alone, with 1e-5 rad of noise."""
    position = record.motor_position
    noise = 1e-5 * rng.standard_normal(position.values.size)
    return replace(record, torque=None, motor_position=replace(position, values=position.values + noise))


@pytest.mark.slow
def test_two_loads_tell_it() -> None:
    one, other = slow_record(0, TRUTH["inertia"]), slow_record(1, TRUTH["inertia"] + ADDED)
    found = identify([one, other], LOOP, several={"added_inertia": (0.0, ADDED)})
    for name, value in TRUTH.items():
        stderr = found[name].stderr
        assert stderr is not None and stderr < 0.03 * value
        assert abs(found.values[name] - value) < 3.0 * stderr


@pytest.mark.slow
@pytest.mark.parametrize("by", ["torque", "motor_position"])
def test_two_payloads_tell_the_share_of_every_axis(by: Literal["torque", "motor_position"]) -> None:
    arm, rng = lifting_arm(3), np.random.default_rng(0)
    logs = arm.logs
    if by == "motor_position":
        logs = tuple(tuple(without_torque(one, rng) for one in log) for log in logs)  # type: ignore[assignment]
    found = identify(logs, arm.loop, ji.DIDIM(outputs=(by,)))
    robot, spread = found.robot, found.covariance_of([*found.parameters]).std
    z = (robot.values - robot.parameters_of(arm.robot)) / spread
    assert np.max(np.abs(z)) < 4.0
    share = robot.names.index("lower.friction_per_torque")
    assert spread[share] < 0.02 * robot.values[share]


def test_its_signature_is_of_the_torque_that_acts_and_not_of_the_logged_one() -> None:
    t, truth = np.arange(2000) * 1e-3, TRUTH | {"friction_per_torque": 0.0}
    plain = replace(LOOP, joint=replace(LOOP.joint, friction=Friction()))
    reference, injected = 0.1 * np.sin(6.0 * t) * np.clip(2 * t, 0.0, 1.0) ** 2, 200.0 * np.sin(44.0 * t)
    record = simulated_record(plain, reference, truth, sample_time=1e-3, injected=injected, in_torque=False)
    made, own = (torque_problem(record, one, Filtering(), one.joint.parameters) for one in (plain, LOOP))
    seen = see_loop(made, made.vector(truth), np.zeros(0), np.zeros((0, 0)))
    ((_, found),) = FAULTS["load_dependent_friction"].columns(seen)
    none, some = (own.torque(own.vector(truth | {"friction_per_torque": share})) for share in (0.0, 1e-4))
    law = (some - none) / 1e-4
    assert np.linalg.norm(found - law) < 0.1 * np.linalg.norm(law)
