"""Information of a robot's first record for the next test: noise and motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.robots.torques import torques_of
from jointid.estimation.robots.idim import RobotEstimate
from jointid.estimation.robots.regression import motion_of_robot
from jointid.estimation.robots.torque_estimate import RobotTorqueEstimate
from jointid.records.record import Record
from jointid.simulation.robot_drive_side import RobotDriveSide


@dataclass(frozen=True, slots=True, eq=False)
class FirstRecord:
    """A first record, as `design_robot_test` takes it.

    Attributes:
        noise: (n,) deviation of white noise on each joint's log that has as much in the band of the filter as the
            estimate left.
        motion: positions, velocities and accelerations of the joints, (samples, n) each; of a test by DIDIM those of
            the references.
        sample_time: s.
    """

    noise: FloatArray
    motion: tuple[FloatArray, FloatArray, FloatArray]
    sample_time: float

    @property
    def duration(self) -> float:
        """Of the record, s."""
        return len(self.motion[0]) * self.sample_time


def first_record(estimate: RobotEstimate | RobotTorqueEstimate, records: Sequence[Record]) -> FirstRecord:
    """Summarise a record and its estimate for the next test.

    Args:
        estimate: of the robot.
        records: of each joint, that it was identified from.

    Raises:
        RecordError, MethodError: as of the identification.
    """
    torques = torques_of(estimate, records)
    left = np.array([np.sqrt(np.mean(e[s] ** 2)) for e, s in zip(torques.error, torques.seen, strict=True)])
    if isinstance(estimate, RobotEstimate) or isinstance(estimate.closing, RobotDriveSide):
        found = motion_of_robot(estimate.robot, records, estimate.filtering)
        motion, sample_time = (found.q, found.v, found.a), found.sample_time
    else:
        references = [record.reference for record in records if record.reference is not None]
        sample_time = references[0].sample_time
        q = np.column_stack([one.values for one in references]) @ np.linalg.inv(estimate.robot.coupling).T
        v = np.gradient(q, sample_time, axis=0)
        motion = q, v, np.gradient(v, sample_time, axis=0)
    # White noise has in the band the share 2 cutoff / rate of its power.
    return FirstRecord(left * np.sqrt(0.5 / (sample_time * torques.cutoff)), motion, sample_time)
