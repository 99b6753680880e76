"""The inverse dynamics of a robot's measured motion as one linear regression: all joints' rows at all instants.

Signals go the way of one joint's (`problems.inverse_model`): positions through a low-pass both ways, torques through
the window of their timing, both sides of the equations through one decimation. Where a motor rests or turns round, its
friction takes what it must, and its row is left out: of a twin with little noise the rows of reversals pulled the
Coulomb frictions so far that of their 2-sigma intervals 17 % held the truth, and without these rows all do.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.estimation.methods.linear import Rows
from jointid.estimation.problems.inverse_model import through_window, torque_and_positions
from jointid.estimation.problems.rest import SMEAR, steady_weights
from jointid.models.joints import RigidJoint
from jointid.models.robots.base_parameters import BaseParameters, inverse_columns
from jointid.models.robots.friction_terms import Friction, FrictionTerm, friction_columns, friction_terms
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.checks import find_record_warnings, range_faults, scale_faults
from jointid.records.record import Record
from jointid.records.signals.filtering import (
    Filtering,
    decimate_all,
    differentiate,
    differentiate_twice,
    lowpass,
    settle,
    window_torque,
)
from jointid.records.signals.position_noise import find_noise_limit

_WHOLE = 0.9  # of the weight of a row whose samples are all seen, as a filter leaves it
_REACHED = 1e-2  # of the Coulomb friction's column: that of a rise of which a record has samples
_TOLD = 0.05  # of a row's weight: what holds less is of rest


Records: TypeAlias = Sequence[Record] | Sequence[Sequence[Record]]
"""The records of a robot's joints from one log, or those of several logs."""


def each_log(records: Records) -> tuple[Sequence[Record], ...]:
    """Return the records of each log.

    Raises:
        RecordError: there are none.
        MethodError: they are records of one log and of several.
    """
    if not records:
        raise RecordError("A robot is identified from the records of its joints; received none.")
    if isinstance(records[0], Record):
        require_one_log(records)
        return (cast("Sequence[Record]", records),)
    if not all(isinstance(log, Sequence) for log in records):
        raise MethodError("Of several logs the records of the joints are lists; received a single record among them.")
    return tuple(cast("Sequence[Sequence[Record]]", records))


def in_logs(flat: Sequence[Record], records: Records) -> Records:
    """Return the records of all logs, one after the other, in the logs of others."""
    if len(logs := each_log(records)) == 1 and isinstance(records[0], Record):
        return flat
    ends = np.cumsum([len(log) for log in logs])
    return [flat[end - len(log) : end] for log, end in zip(logs, ends, strict=True)]


def require_one_log(records: Sequence[object]) -> None:
    """Require records of one log.

    Raises:
        MethodError: there are records of several logs, or something else.
    """
    if not all(isinstance(record, Record) for record in records):
        raise MethodError(
            "The records of the joints of one log are needed here, and these are no records, or of several logs: give "
            "those of one log."
        )


def robot_record_warnings(records: Records, robot: Robot) -> tuple[str, ...]:
    """Return warnings on the records of a robot's joints, one sentence each, which names its joint."""
    found = (
        f"{name}: {said}"
        for log in each_log(records)
        for name, record in zip(robot.names, log, strict=False)
        for said in find_record_warnings(record, record.channels)
    )
    return tuple(dict.fromkeys(found))


def check_robot_records(records: Records, robot: Robot) -> None:
    """Check the units and scales of the records of a robot's joints, also by the limits of its model.

    Raises:
        RecordError: one cannot be in its units; each sentence names its joint.
    """
    back = np.linalg.inv(robot.coupling)
    faults = []
    for log in each_log(records):
        for k, (name, record) in enumerate(zip(robot.names, log, strict=False)):
            faults += [f"{name}: {said}" for said in scale_faults(record)]
            limits, alone = robot.links[k].limits, np.count_nonzero(back[k]) == 1
            position = record.motor_position or record.reference
            if limits is not None and alone and position is not None:
                faults += [f"{name}: {said}" for said in range_faults(position, limits)]
    if faults:
        raise RecordError(dict.fromkeys(faults))


def require_torques(robot: Robot, torques: Iterable[FloatArray]) -> None:
    """Raise a `MethodError` if the torque, (samples,), of a joint is 0 throughout."""
    dead = [joint.name for joint, torque in zip(robot.joints, torques, strict=True) if not np.any(torque)]
    if dead:
        raise MethodError(f"The torque of {', '.join(dead)} is 0 throughout; log it, or leave its joint out.")


def join_rows(each: Sequence[FloatArray], equations: int) -> FloatArray:
    """Return the rows of several logs as of one: those of one equation after those of the other.

    Args:
        each: (rows,) or (rows, columns) of each log.
        equations: how many share their instants.
    """
    whole = np.concatenate([rows.reshape(equations, -1, *rows.shape[1:]) for rows in each], axis=1)
    return whole.reshape(-1, *whole.shape[2:])


@dataclass(frozen=True, slots=True, eq=False)
class RobotMotion:
    """The motion of all joints, filtered, and the torques of their motors.

    Attributes:
        q, v, a: (samples, n) positions of the joints and their derivatives.
        torque: (samples, n) of the motors, behind their gears, without that of the record's payload.
        moving: (samples, n) 0 where a motor rests or turns round, else 1.
        sample_time: s.
        filtering: resolved.
        limit: Hz, the highest cut-off that the noise of the positions allows.
        raw: (samples, n) positions of the motors, as measured.
    """

    q: FloatArray
    v: FloatArray
    a: FloatArray
    torque: FloatArray
    moving: FloatArray
    sample_time: float
    filtering: Filtering
    limit: float
    raw: FloatArray

    def decimate_columns(self, columns: FloatArray) -> FloatArray:
        """Return columns, (samples, n, columns), decimated: (n instants, columns), joint after joint, 0 at rest."""
        seen = through_window(columns.transpose(1, 0, 2), self.filtering)
        return np.concatenate([self.decimate_joint(j, equation) for j, equation in enumerate(seen)])

    def thinned_torque(self) -> FloatArray:
        """Return the torques decimated, (n instants,), joint after joint, 0 at rest."""
        return np.concatenate([self.decimate_joint(j, each[:, np.newaxis]) for j, each in enumerate(self.torque.T)])[
            :, 0
        ]

    def begin(self, size: int) -> RobotMotion:
        """Return the motion of the first samples."""
        named = ("q", "v", "a", "torque", "moving", "raw")
        return replace(self, **{name: getattr(self, name)[:size] for name in named})

    @property
    def inside(self) -> slice:
        """The samples that no border of the filters reaches."""
        return self.filtering.inside(len(self.torque))

    @property
    def whole_rows(self) -> NDArray[np.bool_]:
        """Rows without any sample that is left out, (n, rows); only these are judged.

        A row beside one that is left out has some of that in it, and less noise.
        """
        return self.decimate_columns(np.ones((*self.q.shape, 1)))[:, 0].reshape(self.q.shape[1], -1) > _WHOLE

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Return columns of a joint's equation, (samples, columns), decimated, (rows, columns), 0 at rest."""
        moving = self.moving[self.inside, joint]
        rows, whole = decimate_all(
            [columns[self.inside] * moving[:, np.newaxis], moving], self.filtering, self.sample_time
        )
        return np.where(whole[:, np.newaxis] <= _TOLD, 0.0, rows)


def motion_of_robot(
    robot: Robot,
    records: Sequence[Record],
    filtering: Filtering,
    said: str = "IDIM of a robot",
    model: str = "rigid",
    smear: float = SMEAR,
) -> RobotMotion:
    """Return the motion of a robot and its motors' torques.

    Args:
        robot: whose coupling takes the motors' positions to the joints'.
        records: of each joint, with torque and motor position behind the gear, on one clock.
        filtering: of positions and rows.
        said: the method, in the words of an error.
        model: of the joints, whose cut-offs are taken where there are none: "rigid" or "flexible".
        smear: periods of the position filter on each side of a rest or a reversal that are left out with it.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: a torque is 0 throughout.
    """
    require_one_log(records)
    if len(records) != len(robot):
        raise RecordError(f"A robot of {len(robot)} joints needs as many records; received {len(records)}.")
    channels, positions = [], []
    for joint, link, record in zip(robot.joints, robot.links, records, strict=True):
        try:
            torque, (position,) = torque_and_positions(record, RigidJoint(link.kind), ("motor_position",), said)
        except RecordError as error:
            raise RecordError([f"{joint.name}: {fault}" for fault in error.faults]) from error
        for what, values in (("torque", torque.values), ("motor_position", position)):
            if not np.all(np.isfinite(values)):
                at = int(np.flatnonzero(~np.isfinite(values))[0])
                raise RecordError(
                    f"{joint.name}: {what} is {values[at]} at sample {at}; expected numbers: cut the record there, or "
                    "mend the channel."
                )
        channels.append(torque)
        positions.append(position)
    require_torques(robot, [channel.values for channel in channels])
    clocks = {round(channel.sample_time, 12) for channel in channels}
    if len(clocks) > 1:
        raise RecordError(
            f"The torques of the joints come every {', '.join(f'{one:g}' for one in sorted(clocks))} s; expected one "
            "sample time: resample them."
        )
    sample_time, size = channels[0].sample_time, min(map(len, positions))
    motors = np.column_stack([position[:size] for position in positions])
    limit = find_noise_limit(motors.T, sample_time)
    filtering = filtering.resolve(sample_time, model, limit)
    assert filtering.position_cutoff is not None
    smooth = lowpass(motors, filtering.position_cutoff, sample_time)
    if filtering.timing == "respected":
        twice = [differentiate_twice(each, sample_time) for each in smooth.T]
        velocity, acceleration = (np.column_stack(each) for each in zip(*twice, strict=True))
        torques = [window_torque(channel)[:size] for channel in channels]
    else:
        velocity = differentiate(smooth, sample_time)
        acceleration = differentiate(velocity, sample_time)
        torques = [channel.values[:size] for channel in channels]
    velocity = settle(velocity)
    moving = [steady_weights(each, filtering.position_cutoff, sample_time, smear, few=0.0)[1] for each in velocity.T]
    joints = np.linalg.inv(robot.coupling).T
    motion = smooth @ joints, velocity @ joints, acceleration @ joints
    measured = np.column_stack(torques)
    if payload := records[-1].payload:  # its torque is known
        carried = inverse_columns(robot, *motion)[:, :, -len(SYMBOLS) - len(robot) : -len(robot)] @ payload
        measured -= through_window(carried.T[:, :, np.newaxis], filtering)[:, :, 0].T
    return RobotMotion(
        *motion,
        measured,
        np.column_stack(moving),
        sample_time,
        filtering,
        limit,
        motors,
    )


def motions_of_logs(robot: Robot, logs: Sequence[Sequence[Record]], filtering: Filtering) -> list[RobotMotion]:
    """Return the motions of several logs through one filtering: of the defaults the lowest."""
    motions = [motion_of_robot(robot, log, filtering) for log in logs]
    common = min((motion.filtering for motion in motions), key=lambda one: one.cutoff or math.inf)
    return [
        motion if motion.filtering == common else motion_of_robot(robot, log, common)
        for motion, log in zip(motions, logs, strict=True)
    ]


def base_columns(robot: Robot, base: BaseParameters, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return the columns of base parameters, then of the motors' friction, (samples, n, parameters)."""
    return np.concatenate([inverse_columns(robot, q, v, a)[:, :, base.chosen], friction_columns(robot, v)], axis=2)


def base_rows(robot: Robot, base: BaseParameters, motion: RobotMotion, columns: FloatArray | None = None) -> Rows:
    """Return the regression of the base parameters, then of the numbers of the motors' friction.

    Args:
        robot: that moves.
        base: its base parameters.
        motion: of it.
        columns: of `base_columns`, where they are known.
    """
    W = motion.decimate_columns(base_columns(robot, base, motion.q, motion.v, motion.a) if columns is None else columns)
    names = (*base.names, *(term.name(robot) for term in friction_terms(robot)))
    return Rows(motion.thinned_torque(), W, names, len(robot), len(robot))


def require_slow_samples(robot: Robot, rows: Rows, fixed: Collection[str] = ()) -> None:
    """Raise a `MethodError` if a friction is to rise at speeds that no sample of the record has.

    Args:
        robot: whose motors' friction may rise towards standstill.
        rows: of `base_rows`, without the samples about reversals.
        fixed: names of parameters that are known.
    """
    sizes = dict(zip(rows.names, np.linalg.norm(rows.W, axis=0), strict=True))
    for term in friction_terms(robot):
        joint = robot.joints[term.joint]
        name, coulomb = term.name(robot), FrictionTerm(term.joint, Friction.COULOMB).name(robot)
        if term.number is Friction.RISE and name not in fixed and sizes[name] < _REACHED * sizes[coulomb]:
            raise MethodError(
                f"The friction of {joint.name} is declared to rise below {joint.motor['stribeck_speed']:g} "
                f"{robot.position_unit(term.joint)}/s, and beside reversals, which IDIM leaves out, this record has "
                f"hardly a sample there; move it slowly, leave the speed out, or fix {name} by its value."
            )


def relative_errors(rows: Rows, values: FloatArray) -> FloatArray:
    """Return the residual share of each joint's torque, (n,)."""
    error = rows.by_equation(rows.Y - rows.W @ values)
    return np.asarray(np.linalg.norm(error, axis=1) / np.linalg.norm(rows.by_equation(rows.Y), axis=1))
