"""What the tests of exports share: a joint as its answer says it, and a servo that closes a loop around any plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

import jointid as ji
from jointid.common.parameters import POSITION_UNIT
from jointid.models.joints import Joint
from jointid.output.export.joint_model import JointModel, joint_model
from jointid.output.json import plain
from jointid.paper.twin import TABLE_2
from jointid.simulation.closed_loop import Initial, simulate
from jointid.simulation.loop_input import prepare

PIECES = TABLE_2 | {"gap": 3e-4, "stiffness_2": 1.2e6, "stiffness_3": 1.5e6, "torque_1": 20.0, "torque_2": 40.0}
"""The paper's axis with what springs in pieces have, too."""


SMOOTH = TABLE_2 | {
    "cubic_stiffness": 1e13, "hysteresis_stiffness": 3e5, "hysteresis_torque": 5.0, "motor_presliding_distance": 1e-3,
    "load_presliding_distance": 4e-4, "load_friction_per_torque": 0.1, "motor_viscous_drift": -100.0,
    "motor_coulomb_drift": 5.0, "load_coulomb_drift": -4.0,
    "load_viscous_drift": 200.0, "swinging_share": 0.3, "swinging_stiffness": 1e6, "swinging_damping": 200.0,
    "harmonic_1_cosine": 3.0, "harmonic_1_sine": -2.0, "harmonic_2_cosine": 0.0, "harmonic_2_sine": 4.0,
}  # fmt: skip
"""The paper's axis with what smooth laws have, too."""


def answer(joint: Joint, values: Mapping[str, float | None], record: str = "run 7") -> dict[str, Any]:
    """The keys of an estimate's JSON that an export reads."""
    return {
        "schema": "jointid.estimate/1",
        "method": "didim",
        "model": joint.model,
        "kind": joint.kind,
        "friction": joint.friction.name,
        "spring": joint.spring_name,
        "gravity": plain(joint.gravity),
        "ripple": plain(joint.ripple),
        "transmission": plain(joint.transmission),
        "record": {"name": record, "sample_time": 1e-3, "torque_sha256": "5f1c"},
        "parameters": {
            p.name: {
                "symbol": p.symbol,
                "value": values[p.name],
                "std": 0.01,
                "unit": joint.unit(p),
                "free": True,
                "identifiable": True,
                "lower_bound": None,
                "lack_of_fit": 0.0,
            }
            for p in joint.parameters
        },
        "delay": 0.0,
        "effects": [],
    }


def model(joint: Joint, values: Mapping[str, float | None], name: str = "axis", record: str = "run 7") -> JointModel:
    return joint_model(answer(joint, values, record), joint, name)


def servo(
    law: ji.controller.Cascade, reference: np.ndarray, period: float, plant: Callable[[float], float]
) -> np.ndarray:
    """The torque of a P-P cascade with its velocity filter, written out; `plant` holds a torque for a period.

    `plant` returns the motor's position after it; the motor begins at rest on the reference.
    """
    weights = np.asarray(law.velocity_filter)
    seen = [float(reference[0])] * (weights.size + 1)  # the newest first
    torque = np.empty(reference.size)
    for k, wanted in enumerate(reference):
        velocity = float(weights @ -np.diff(seen)) / period
        torque[k] = law.gain * np.clip(
            law.velocity_gain * (law.position_gain * (wanted - seen[0]) - velocity), -law.limit, law.limit
        )
        seen = [plant(float(torque[k])), *seen[:-1]]
    return torque


def simulated(
    joint: Joint, law: ji.controller.Cascade, reference: np.ndarray, values: Mapping[str, float]
) -> np.ndarray:
    """The torque of our own simulation of the same loop, at 1 kHz."""
    record = ji.simulated_record(ji.ClosedLoop(joint, law), reference, values, sample_time=1e-3)
    assert record.torque is not None
    return record.torque.values


def apart(torque: np.ndarray, ours: np.ndarray) -> float:
    """The norm of what two torques differ by, over that of ours."""
    return float(np.linalg.norm(torque - ours) / np.linalg.norm(ours))


def pushed(
    joint: Joint, values: Mapping[str, float], torque: np.ndarray, period: float, delay: float = 0.0
) -> np.ndarray:
    """The motor's position of our own simulation, from rest at 0, under a held torque that acts so late."""
    passing = ji.controller.StateSpaceController(
        A=np.zeros((0, 0)), B={}, C=np.zeros(0), D={"reference": 1.0}, delay=delay
    )
    loop = ji.ClosedLoop(joint, passing)
    experiment = prepare(loop, ji.Record(reference=ji.Channel(torque, POSITION_UNIT[joint.kind], period)))
    return simulate(loop, experiment, values, Initial(0.0, 0.0)).motor_position
