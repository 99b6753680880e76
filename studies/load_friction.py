"""Friction that grows with the torque: the share that is identified, and whether symmetric friction is named for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import jointid as ji
from jointid.diagnostics.diagnosis import diagnose_robot
from jointid.models.friction import Friction
from tests.load_friction import LAWS, hanging_joint, lifting_arm

_FAULT = "load_dependent_friction"


def judge(seed: int, system: str) -> dict[str, float | bool]:
    """Identify with the law and without it; return errors in their deviations, and whether the fault is named."""
    if system == "joint":
        loop, record, numbers = hanging_joint(seed)
        found = ji.identify(record, loop, ji.DIDIM(), checks=False)
        stderr = {name: found[name].stderr or np.inf for name in numbers}
        z = {name: (found.values[name] - value) / stderr[name] for name, value in numbers.items()}
        plain = replace(loop, joint=replace(loop.joint, friction=Friction()))
        named = _FAULT in str(ji.identify(record, plain, ji.DIDIM()).to_dict())
    else:
        arm = lifting_arm(seed)
        found = ji.identify(arm.logs, arm.loop, ji.DIDIM(), checks=False)
        robot = found.robot
        assert robot is not None
        truth = robot.parameters_of(arm.robot)
        assert truth is not None
        errors = (robot.values - truth) / found.covariance_of(robot.names).std
        z = dict(zip(robot.names, map(float, errors), strict=True))
        estimate = ji.identify(arm.logs[0], arm.plain, ji.DIDIM(), checks=False)
        said = diagnose_robot(estimate, arm.logs[0], LAWS)
        named = any(one.test.name == _FAULT for axis in said.axes for one in axis.faults.findings)
    shares = [error for name, error in z.items() if name.endswith("friction_per_torque")]
    grips = [error for name, error in z.items() if name.endswith("coulomb")]
    inside = float(np.mean([abs(error) <= 2.0 for error in z.values()]))
    return {"share": max(map(abs, shares)), "coulomb": max(map(abs, grips)), "inside": inside, system: named}
