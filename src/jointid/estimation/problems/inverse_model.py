"""Inverse dynamic model of a measured motion: torques and parameter columns.

Butterworth low-pass forwards and backwards on the positions, derivatives, borders dropped, the same
low-pass-and-decimate on torque and every column [P section III; EMPS report]. A rigid joint needs the motor's
position, a flexible one the load's too: both rows of (2) are then stacked. A robot has a row for each joint.
Of a long record the columns are made part by part, so that memory holds those of one part and the decimated rows.

Torque and columns are seen through one window (`filtering.window_torque`), so that a held, averaged or delayed torque
is compared with the motion it made. The published pipeline reads it as sampled and differentiates twice centrally.

Where a mass rests or reverses, its friction is undetermined, and its row is left out. On a twin with little noise
17 % of the 2-sigma intervals of the Coulomb frictions held the truth with the rows of reversals, and all do without.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.parallel import in_threads
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.parameters import Parameters
from jointid.estimation.problems.regression import Rows
from jointid.models.joints import Joint, RigidJoint
from jointid.models.position_forces import Motion
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Robot
from jointid.records.columns import finite_faults
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, require_units
from jointid.records.signals.filtering import (
    Filtering,
    apply_window,
    differentiate_twice,
    find_noise_limit,
    lowpass,
    settle,
    thin_channel,
    window_torque,
)

ENCODER_OFFSET = Parameter("encoder_offset", "K dq0", Quantity.FORCE)
"""The spring's force by the difference of two encoders' zeros, which acts on the load and against the motor.

An encoder counts from where it was switched on, or from its own mark. The difference at a rest of the record is not
enough: friction may hold the spring wound up there.
"""

POSITIONS = ("motor_position", "load_position")
"""Of the masses of a joint."""

REST = 0.02
"""Of the root mean square speed: a mass slower than that rests, or sticks as it turns round."""

SAID = 0.02  # of a record: a larger share of rest is said
SMEAR = 0.6  # of the position filter's period: from there on the errors of a filtered step add up to 0
BLOCK = 2_400_000
"""Samples times the square of n masses or joints of a motion whose columns are made at once; see `split`."""

_FEW = 0.1  # of the moving samples: if less were left without reversals, these stay
TOLD = 0.05  # of a row's weight: what holds less is of rest


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMotion:
    """Filtered motion of masses or joints, and the motors' torques.

    Attributes:
        q, v, a: (samples, n) positions and their derivatives.
        torque: (samples, n) of the motors, behind their gears, through the window of their timing; of a robot without
            that of the record's payload, on the load of a joint 0.
        moving: (samples, n) 0 where a mass rests or reverses, or where the record is left out, else 1.
        sample_time: s.
        filtering: resolved.
        limit: Hz, the highest cut-off that the noise of the positions allows.
        raw: (samples, n) positions as measured.
        if_sampled: (samples, n) change of torques of unstated timing if read as sampled, not held; else 0.
        counts: (samples, n) 0 where the record is left out, else 1.
        apart: whether rows at which no mass moves are left out, as of a joint; else they are 0.
        told: least weight of a row that is not at rest.
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
    if_sampled: FloatArray
    counts: FloatArray
    apart: bool = False
    told: float = TOLD

    def decimate_columns(self, columns: FloatArray) -> FloatArray:
        """Columns, (samples, n, columns), through the torques' window and decimation.

        In a robot about half of them are 0 in each equation, and stay so.
        """
        rows = []
        for j in range(columns.shape[1]):
            own = np.any(columns[:, j], axis=0)
            seen = self.decimate_joint(j, through_window(columns[:, j, own], self.filtering))
            rows.append(seen @ np.eye(own.size)[own])
        return np.concatenate(rows)

    def cut(self, first: int, end: int) -> MeasuredMotion:
        """Return the motion of some samples."""
        named = ("q", "v", "a", "torque", "moving", "raw", "if_sampled", "counts")
        return replace(self, **{name: getattr(self, name)[first:end] for name in named})

    def read_as(self, timing: Timing | None) -> MeasuredMotion:
        """The motion with torques of unstated timing read as `timing`, or held."""
        return replace(self, torque=self.torque + self.if_sampled) if timing is Timing.SAMPLED else self

    def split(self) -> list[MeasuredMotion]:
        """Split a long motion into parts whose columns fit in memory."""
        size, n = self.q.shape
        count = math.ceil(size * n * n / BLOCK)
        ends = np.linspace(0, size, count + 1).astype(int)
        return [self.cut(*span) for span in pairwise(ends)]

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Decimate one equation's columns, (samples, columns); rest is 0 or excluded."""
        inside = self.filtering.inside(len(self.q))
        moving = self.moving[inside, joint, np.newaxis]
        among = self.moving[inside] if self.apart else moving
        both = self.filtering.decimate(np.hstack([columns[inside] * moving, among]), self.sample_time)
        rows, shares = np.split(both, columns.shape[1:], axis=1)
        stated = np.any(shares > self.told, axis=1)
        return rows[stated] if self.apart else np.where(stated[:, np.newaxis], rows, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """The inverse model of a joint or a robot.

    Attributes:
        system: the joint, or the robot, whose joints are rigid.
        parameters: of the columns.
        columns: of a motion, (samples, equations, parameters), not filtered.
        driven: how many equations, the first, have the torque of a motor.
        delay: seconds from the output of a joint's controller to the torque that acts.
    """

    system: Joint | Robot
    parameters: Parameters
    columns: Callable[[MeasuredMotion], FloatArray]
    driven: int = 1
    delay: float = 0.0

    def measure(self, records: Sequence[Record], filtering: Filtering) -> MeasuredMotion:
        """Return the motion of a log; see `measure_motion`."""
        return measure_motion(self.system, records, filtering, delay=self.delay)

    def rows(self, motions: Sequence[MeasuredMotion], columns: Iterable[FloatArray] | None = None) -> Rows:
        """Regression along the motions of logs, by default of their own columns."""
        pairs, n = zip(motions, columns or map(self.columns, motions), strict=True), motions[0].q.shape[1]
        columns = [motion.decimate_columns(each) for motion, each in pairs]
        W, series = join_rows(columns, n), tuple(len(each) // n for each in columns)
        torques = [
            decimate_each(motion, np.stack([motion.torque.T, motion.if_sampled.T], axis=2)) for motion in motions
        ]
        Y, early = join_rows(torques, n).T
        return Rows(Y, W, self.parameters.names, n, self.driven, series, early if np.any(early) else None)


def turn(system: Joint | Robot, motion: MeasuredMotion) -> MeasuredMotion:
    """Convert the motion of a robot's motors to its joints; that of a joint stays."""
    if not isinstance(system, Robot):
        return motion
    joints = np.linalg.inv(system.coupling).T
    return replace(motion, q=motion.q @ joints, v=motion.v @ joints, a=motion.a @ joints)


def decimate_each(log: Any, each: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Filter signals of each joint, (samples,) or (samples, columns), in the rows of a log, and concatenate."""
    return np.concatenate(in_threads(lambda j: log.decimate_joint(j, each[j]), range(len(each))))


def join_rows(each: Sequence[FloatArray], equations: int) -> FloatArray:
    """Join logs' rows, (rows, ...), equation by equation."""
    whole = np.concatenate([rows.reshape(equations, -1, *rows.shape[1:]) for rows in each], axis=1)
    return whole.reshape(-1, *whole.shape[2:])


def filter_motion(
    positions: FloatArray, sample_time: float, filtering: Filtering
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations of raw positions, (samples, n) each."""
    assert filtering.position_cutoff is not None
    smooth = lowpass(positions, filtering.position_cutoff, sample_time)
    if filtering.timing == "respected":
        velocity, acceleration = differentiate_twice(smooth, sample_time)
    else:
        velocity = np.gradient(smooth, sample_time, axis=0)
        acceleration = np.gradient(velocity, sample_time, axis=0)
    return smooth, settle(velocity), acceleration


def through_window(columns: FloatArray, filtering: Filtering) -> FloatArray:
    """Columns, (samples, ...), through the window of a torque with respected timing."""
    return apply_window(columns) if filtering.timing == "respected" else columns


def motion_along(
    torques: Sequence[Channel],
    positions: FloatArray,
    filtering: Filtering,
    delays: Sequence[float] = (0.0,),
    model: str = "rigid",
    counts: FloatArray | float = 1.0,
    limit: float | None = None,
) -> MeasuredMotion:
    """Motion along raw positions, (samples, n), with the torques.

    Args:
        torques: on the first of n masses or joints, at the positions' rate.
        positions: of the motor, and for a flexible joint of the load; or of the motors of a robot.
        filtering: of positions and rows.
        delays: seconds from each logged torque to the acting torque, or one for all.
        model: "rigid" or "flexible", for the default cut-offs.
        counts: (samples, n) or (samples, 1), 0 at excluded samples.
        limit: Hz, the highest cut-off that noise allows; by default that of the positions.
    """
    from scipy.ndimage import minimum_filter1d

    measured, more, sample_time = np.zeros(positions.shape), np.zeros(positions.shape), torques[0].sample_time
    limit, size = find_noise_limit(positions.T, sample_time) if limit is None else limit, len(positions)
    filtering = filtering.resolve(sample_time, model, limit)
    for j, (torque, delay) in enumerate(zip(torques, np.resize(delays, len(torques)), strict=True)):
        read = [torque.values]
        if filtering.timing == "respected":
            ways = [torque.timing] if torque.stated else [Timing.HELD, Timing.SAMPLED]
            read = [window_torque(replace(torque, timing=way), delay) for way in ways]
        measured[:, j], more[:, j] = read[0][:size], (read[-1] - read[0])[:size]
    moved = filter_motion(positions, sample_time, filtering)
    # The filter of the positions, which may go over torques, too, smears what is left out by a period.
    reach = math.ceil(1.0 / ((filtering.position_cutoff or math.inf) * sample_time))
    counts = minimum_filter1d(np.broadcast_to(counts, positions.shape), 2 * reach + 1, axis=0)
    return MeasuredMotion(*moved, measured, counts, sample_time, filtering, limit, positions, more, counts)


def torque_and_positions(
    record: Record, joint: Joint, names: Sequence[str], method: str
) -> tuple[Channel, tuple[FloatArray, ...]]:
    """Torque on the motor and the named positions, (samples,) each.

    The log lacks a signal that was injected after the controller's limit; it is added.

    Raises:
        RecordError: a channel is missing, in another unit, not sampled, at another rate, or has values that are none.
    """
    record.require(("torque", *names), method)
    require_units(record, joint.kind, joint.torque_unit)
    assert record.torque is not None
    torque, added, period = record.torque, record.injected, record.torque.sample_time
    channels = {"torque": torque} | {name: thin_channel(getattr(record, name), period) for name in names}
    if isinstance(added, Injection) and added.at is not InjectionPoint.BEFORE_LIMIT and not added.in_torque:
        channels["injected"] = added.channel
    for name, one in channels.items():
        sampled = name in ("torque", "injected") or one.timing is Timing.SAMPLED
        if not sampled or abs(one.sample_time / period - 1.0) > 1e-9:
            raise RecordError(
                f"{method} needs a sampled {name} at the torque's rate; this one is {one.timing.value} every "
                f"{one.sample_time:g} s, and the torque comes every {period:g} s: resample it, or use DIDIM, which "
                "needs no position."
            )
        if faults := finite_faults(name, one.values):
            raise RecordError(faults)
    size = min(map(len, channels.values()))
    acting = np.sum([channels[name].values[:size] for name in ("torque", "injected") if name in channels], axis=0)
    return replace(torque, values=acting), tuple(channels[name].values[:size] for name in names)


# A joint


def inverse_of_joint(joint: Joint, delay: float = 0.0, parameters: tuple[Parameter, ...] = ()) -> Inverse:
    """Inverse model of a joint; a flexible one has `ENCODER_OFFSET` last.

    Args:
        joint: the model.
        delay: seconds from the controller's output to the torque that acts.
        parameters: of the joint, with other values and bounds than its own.
    """
    own = parameters or joint.parameters

    def columns(motion: MeasuredMotion) -> FloatArray:
        motor, *load = (Motion(*side) for side in zip(motion.q.T, motion.v.T, motion.a.T, strict=True))
        of_joint = joint.regressor(motor, *load).transpose(1, 0, 2)
        offset = np.broadcast_to([[-1.0], [1.0]], (len(motion.q), 2, 1))
        return np.concatenate([of_joint, offset], axis=2) if load else of_joint

    every = (*own, ENCODER_OFFSET) if joint.model == "flexible" else own
    return Inverse(joint, Parameters.of_joint(joint, every), columns, delay=delay)


def _late(record: Record, delay: float, period: float) -> float:
    """Time from a logged torque's stamp to its effect, s.

    A measured torque is the acting one. With a delay of a fractional number of periods it began within the period
    before the sample that shows it, and an average over that period is stamped at its end.
    """
    if record.tap is not Tap.MEASURED:
        return delay
    fraction = delay / period % 1.0
    averaged = record.torque is not None and record.torque.timing is Timing.AVERAGED
    return 0.0 if averaged or min(fraction, 1 - fraction) < 1e-6 else (fraction - 1.0) * period


# A robot

Records: TypeAlias = Sequence[Record] | Sequence[Sequence[Record]]
"""The records of a robot's joints from one log, or those of several logs."""


def each_log(records: Records) -> tuple[Sequence[Record], ...]:
    """Records of each log.

    Raises:
        RecordError: there are none, or both records and lists of them.
    """
    whole = {isinstance(one, Record) for one in records}
    if len(whole) != 1:
        raise RecordError(
            "A robot is identified from the records of its joints, of several logs from a list of them for each log; "
            f"received {'both' if whole else 'none'}: give one or the other."
        )
    return (cast("Sequence[Record]", records),) if whole.pop() else tuple(cast("Sequence[Sequence[Record]]", records))


def require_one_log(records: Sequence[object]) -> None:
    """Raise a `MethodError` unless all are records of one log."""
    if not all(isinstance(record, Record) for record in records):
        raise MethodError(
            "The records of the joints of one log are needed here, and these are no records, or of several logs: give "
            "those of one log."
        )


def require_torques(robot: Robot, torques: Iterable[FloatArray]) -> None:
    """Raise a `MethodError` if a joint's torque, (samples,), is always 0."""
    dead = [joint.name for joint, torque in zip(robot.joints, torques, strict=True) if not np.any(torque)]
    if dead:
        raise MethodError(f"The torque of {', '.join(dead)} is 0 throughout; log it, or leave its joint out.")


def inverse_of_robot(robot: Robot, parameters: Parameters) -> Inverse:
    """Return the inverse model of a robot of rigid joints."""
    return Inverse(
        robot, parameters, lambda motion: parameters.columns(robot, motion.q, motion.v, motion.a), len(robot)
    )


# From records to a motion


def measure_motion(
    system: Joint | Robot,
    records: Sequence[Record],
    filtering: Filtering,
    said: str = "IDIM",
    *,
    delay: float = 0.0,
    model: str = "rigid",
    smear: float = SMEAR,
) -> MeasuredMotion:
    """Measure the motion of a joint or robot, and its motors' torques.

    Args:
        system: the joint, or the robot, whose coupling takes the motors' positions to the joints'.
        records: of the joint, or of each joint of the robot, on one clock; with torque and positions behind the gear.
        filtering: of positions and rows.
        said: the method, in the words of an error.
        delay: seconds from the controller's output to the torque that acts.
        model: of a robot's joints, for the default cut-offs: "rigid" or "flexible".
        smear: periods of the position filter on each side of a rest or a reversal that are left out with it.

    Raises:
        RecordError: a channel is missing, not sampled, or at another rate; or the joints' records have not one clock.
        MethodError: a torque of a robot is 0 throughout.
    """
    require_one_log(records)
    robot = system if isinstance(system, Robot) else None
    joints: list[Joint] = [cast("Joint", system)] if robot is None else [RigidJoint(link.kind) for link in robot.links]
    if len(records) != len(joints):
        raise RecordError(f"A robot of {len(joints)} joints needs as many records; received {len(records)}.")
    channels, positions = list[Channel](), list[FloatArray]()
    for axis, (joint, record) in enumerate(zip(joints, records, strict=True)):
        try:
            torque, each = torque_and_positions(record, joint, POSITIONS[: len(joint.sides)], said)
        except RecordError as error:
            if robot is None:
                raise
            raise RecordError([f"{robot.names[axis]}: {fault}" for fault in error.faults]) from error
        channels.append(torque)
        positions += each
    clocks = {round(channel.sample_time, 12) for channel in channels}
    if len(clocks) > 1:
        raise RecordError(
            f"The torques of the joints come every {', '.join(f'{one:g}' for one in sorted(clocks))} s; expected one "
            "sample time: resample them."
        )
    sample_time, size = channels[0].sample_time, min(map(len, positions))
    raw, springs = np.column_stack([position[:size] for position in positions]), joints[0].model == "flexible"
    delays = [_late(record, delay, sample_time) for record in records]
    counts = np.column_stack([record.counts(size, sample_time) for record in records])
    motion = motion_along(channels, raw, filtering, delays, model if robot else joints[0].model, counts)
    if filtering.timing == "respected":  # the published pipeline takes all rows
        moving, steady = steady_weights(motion, smear, _FEW if robot is None else 0.0)
        # A spring smooths the jump of the load's acceleration; there the rows about reversals show the stiffness.
        motion = replace(motion, moving=(moving if springs else steady) * motion.counts, apart=robot is None)
    if robot is None:
        return motion
    require_torques(robot, [channel.values for channel in channels])
    motion = turn(robot, motion)
    if payload := records[-1].payload:  # its torque is known
        last = slice(-len(SYMBOLS) - len(robot), -len(robot))
        carried = inverse_columns(robot, motion.q, motion.v, motion.a)[:, :, last] @ payload
        motion = replace(motion, torque=motion.torque - through_window(carried, motion.filtering))
    return motion


# Samples at rest or at a reversal, at which sticking friction does not follow ``Fc sign(v)``


def moving_weights(velocity: FloatArray, long: int = 3, reach: int = 3, *, turning: bool = False) -> FloatArray:
    """Weights of samples: 0 while a mass rests, else 1.

    Args:
        velocity: (samples,).
        long: samples in a row that are a rest.
        reach: samples on each side that count with it.
        turning: whether a reversal, which is between two samples, counts as a rest.
    """
    from scipy.ndimage import grey_dilation, grey_opening

    speed = np.abs(velocity)
    slow = (speed < REST * float(np.sqrt(np.mean(speed**2)))).astype(np.uint8)
    left = grey_dilation(grey_opening(slow, (long,), mode="constant"), (2 * reach + 1,), mode="constant")
    if turning:
        way = np.sign(velocity).astype(np.int8)
        turns = np.diff(way, prepend=way[:1], append=way[-1:]) != 0.0
        turns = (turns[1:] | turns[:-1]).astype(np.uint8)
        left = np.maximum(left, grey_dilation(turns, (2 * reach - 1,), mode="constant"))
    return np.asarray(1.0 - left)


def steady_weights(motion: MeasuredMotion, smear: float = SMEAR, few: float = _FEW) -> tuple[FloatArray, FloatArray]:
    """Weights, (samples, n), 0 at rest, else 1; and with reversals excluded.

    What is left out rests. At a reversal the acceleration jumps by the Coulomb friction. The position filter smears the
    jump, which looks like inertia: at 30 Hz it was 14 % of an inertia, and as much as half a sample of timing. The sign
    of a filtered velocity also changes some samples before or after the reversal, where rows are off by up to twice
    that friction.

    Args:
        motion: along filtered positions.
        smear: periods of their filter on each side that are left out.
        few: share of the moving samples; if less were left without reversals, these stay.
    """
    assert motion.filtering.position_cutoff is not None
    reach = math.ceil(smear / (motion.filtering.position_cutoff * motion.sample_time))
    long = max(20, 4 * reach)  # samples in a row that are a rest before filtered positions
    moving, steady = (
        np.column_stack([moving_weights(v, long, reach, turning=turning) for v in (motion.v * motion.counts).T])
        for turning in (False, True)
    )
    return moving, np.where(np.mean(steady, axis=0) < few * np.mean(moving, axis=0), moving, steady)
