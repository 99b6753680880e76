"""What the tests of exports share: an estimate of given values, and a servo that closes a loop around any plant."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import jointid as ji
from jointid.common.parameters import POSITION_UNIT
from jointid.estimation.result.estimate import Data, EstimatedParameter, Fit, Settings
from jointid.models.joints import Joint
from jointid.paper.twin import TABLE_2
from jointid.simulation.loop_input import prepare
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate

PIECES = TABLE_2 | {"gap": 3e-4, "stiffness_2": 1.2e6, "stiffness_3": 1.5e6, "torque_1": 20.0, "torque_2": 40.0}
"""The paper's axis with what springs in pieces have, too."""


def model(joint: Joint, values: Mapping[str, float | None], record: str = "run 7", **settings: Any) -> ji.Estimate:
    """An estimate of these values, and with these settings."""
    rows = tuple(EstimatedParameter(p.name, p.symbol, joint.unit(p), values[p.name], 0.01, True)
                 for p in joint.parameters)  # fmt: skip
    return ji.Estimate(
        rows,
        np.eye(len(rows)),
        Fit(np.zeros(0), np.zeros(0), 0.01, 0.01, 100, 1, "it settled", True),
        Data(record, ("torque",), 1e-3, joint.force_unit, ("5f1c",)),
        Settings("didim", "didim", joint, None, ji.Filtering(cutoff=60.0, decimation=1, borders=(0, 0)), **settings),
    )


def with_parameter(estimate: ji.Estimate, name: str, **changes: Any) -> ji.Estimate:
    """The estimate with another number of a parameter, or with one more, like its offset."""
    rows = {row.name: row for row in estimate.rows}
    rows[name] = replace(rows.get(name, rows["offset"]), name=name, **changes)
    return replace(estimate, rows=tuple(rows.values()))


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
