"""The inverse dynamic model of a measured motion: torques on one side, the columns of the parameters on the other.

Butterworth low-pass forwards and backwards on the positions, derivatives, borders dropped, the same
low-pass-and-decimate on torque and every column [P section III; EMPS report]. A rigid joint needs the motor's
position, a flexible one the load's too: both rows of (2) are then stacked. A robot has a row for each joint.
Of a long record the columns are made part by part, so that memory holds those of one part and the decimated rows.

Torque and columns are seen through one window (`filtering.window_torque`), so that a held, averaged or delayed torque
is compared with the motion it made. The published pipeline reads it as sampled and differentiates twice centrally.

Where a mass rests or turns round, its friction takes what it must, and its row is left out: of a twin with little noise
the rows of reversals pulled the Coulomb frictions so far that of their 2-sigma intervals 17 % held the truth, and
without these rows all do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.parameters import Parameter, Quantity
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
    decimate_all,
    differentiate,
    differentiate_twice,
    find_noise_limit,
    lowpass,
    settle,
    thin_channel,
    window_torque,
)

if TYPE_CHECKING:
    from jointid.estimation.parameters import RobotParameters

ENCODER_OFFSET = Parameter("encoder_offset", "K dq0", Quantity.FORCE)
"""The spring's force by the difference of two encoders' zeros, which acts on the load and against the motor.

An encoder counts from where it was switched on, or from its own mark. The difference at a rest of the record is not
enough: friction may hold the spring wound up there.
"""

REST = 0.02
"""Of the root mean square speed: a mass slower than that ..."""

_LONG = 3  # ... for so many samples rests, or sticks as it turns round
_REACH = 3  # samples on each side that the window smears a rest over
SAID = 0.02  # of a record: a larger share of rest is said
_REST_LONG = 20  # samples in a row that are a rest before filtered positions
SMEAR = 0.6  # of the position filter's period: from there on the errors of a filtered step add up to 0
LARGEST = 2_400_000
"""Samples times the square of n masses or joints of a motion whose columns are made at once; see `split`."""

_FEW = 0.1  # of the moving samples: if less were left without reversals, these stay
_TOLD = 0.05  # of a row's weight: what holds less is of rest
_WHOLE = 0.9  # of the weight of a row whose samples are all seen, as a filter leaves it

Columns: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""The columns, (samples, equations, parameters), of positions, velocities and accelerations, (samples, n) each."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMotion:
    """A motion, filtered, and the torques it takes: of a joint's motor and load, or of a robot's joints.

    Attributes:
        q, v, a: (samples, n) positions and their derivatives.
        torque: (samples, n) of the motors, behind their gears, through the window of their timing; of a robot without
            that of the record's payload, on the load of a joint 0.
        moving: (samples, n) 0 where a mass rests or turns round, else 1.
        sample_time: s.
        filtering: resolved.
        limit: Hz, the highest cut-off that the noise of the positions allows.
        raw: (samples, n) positions as measured.
        if_sampled: (samples, n) what torques of unstated timing, read as held, are more if read as sampled; None where
            all are stated.
        apart: whether the rows at rest are left out; else they are 0.
        told: of a row's weight; what holds less is of rest.
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
    if_sampled: FloatArray | None = None
    apart: bool = False
    told: float = _TOLD

    def decimate_columns(self, columns: FloatArray) -> FloatArray:
        """Return columns, (samples, n, columns), decimated: (n instants, columns), one after the other, 0 at rest."""
        seen = through_window(columns, self.filtering)
        return np.concatenate([self.decimate_joint(j, seen[:, j]) for j in range(seen.shape[1])])

    def decimate_torques(self) -> FloatArray:
        """Return the torques, and what they are more if read as sampled, decimated: (n instants, 2), 0 at rest."""
        both = np.stack([self.torque, 0.0 * self.torque if self.if_sampled is None else self.if_sampled], axis=2)
        return np.concatenate([self.decimate_joint(j, both[:, j]) for j in range(both.shape[1])])

    def cut(self, first: int, end: int) -> MeasuredMotion:
        """Return the motion of some samples."""
        named = ("q", "v", "a", "torque", "moving", "raw", *(() if self.if_sampled is None else ("if_sampled",)))
        return replace(self, **{name: getattr(self, name)[first:end] for name in named})

    def split(self) -> list[MeasuredMotion]:
        """Return the parts of a motion whose columns take too much memory at once; itself of a shorter one."""
        size, n = self.q.shape
        count = math.ceil(size * n * n / LARGEST)
        ends = np.linspace(0, size, count + 1).astype(int)
        return [self.cut(*span) for span in pairwise(ends)]

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
        """Return columns of one equation, (samples, columns), decimated, (rows, columns), 0 or left out at rest."""
        moving = self.moving[self.inside, joint, np.newaxis]
        among = self.moving[self.inside] if self.apart else moving
        rows, shares = decimate_all([columns[self.inside] * moving, among], self.filtering, self.sample_time)
        stated = np.any(shares > self.told, axis=1)
        return rows[stated] if self.apart else np.where(stated[:, np.newaxis], rows, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A linear regression.

    Attributes:
        Y: (rows,) the torque, filtered and decimated; the rows of one equation after those of the other.
        W: (rows, parameters) the columns.
        names: of the parameters.
        equations: how many share their instants.
        driven: how many of them, the first, have the torque of a motor; the others are homogeneous.
        early: (rows,) what the torque is more if it is read as sampled; None where all timings are stated.
    """

    Y: FloatArray
    W: FloatArray
    names: tuple[str, ...]
    equations: int
    driven: int = 1
    early: FloatArray | None = None

    def by_equation(self, values: FloatArray) -> FloatArray:
        """Return the values of all rows, (equations, instants)."""
        return values.reshape(self.equations, -1)

    def spread_out(self, sizes: FloatArray) -> FloatArray:
        """Return one number for each row, (rows,), from one for each equation."""
        return np.repeat(sizes, self.Y.size // self.equations)

    def relative_errors(self, values: FloatArray) -> FloatArray:
        """Return the residual share of each equation's torque, (equations,)."""
        left, whole = (np.linalg.norm(self.by_equation(one), axis=1) for one in (self.Y - self.W @ values, self.Y))
        return np.asarray(left / whole)


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """The inverse model of a joint or a robot.

    Attributes:
        names: of the parameters.
        driven: how many equations, the first, have the torque of a motor.
        columns: of the parameters.
        measure: from the records of a log, and the filtering of positions and rows, to the motion.
    """

    names: tuple[str, ...]
    driven: int
    columns: Columns
    measure: Callable[[Sequence[Record], Filtering], MeasuredMotion]

    def measure_logs(self, logs: Sequence[Sequence[Record]], filtering: Filtering) -> list[MeasuredMotion]:
        """Return the motion of each log, all filtered with the lowest cut-off of one of them."""
        motions = [self.measure(log, filtering) for log in logs]
        common = min((motion.filtering for motion in motions), key=lambda one: one.cutoff or math.inf)
        pairs = zip(motions, logs, strict=True)
        return [motion if motion.filtering == common else self.measure(log, common) for motion, log in pairs]

    def columns_along(self, motion: MeasuredMotion) -> FloatArray:
        """Return the columns of a motion, (samples, equations, parameters), not filtered."""
        return self.columns(motion.q, motion.v, motion.a)

    def rows(self, motions: Sequence[MeasuredMotion], columns: Iterable[FloatArray] | None = None) -> Rows:
        """Return the regression along the motions of one log or several; of other columns where these are given."""
        pairs, n = zip(motions, columns or map(self.columns_along, motions), strict=True), motions[0].q.shape[1]
        W = join_rows([motion.decimate_columns(each) for motion, each in pairs], n)
        Y, early = join_rows([motion.decimate_torques() for motion in motions], n).T
        return Rows(Y, W, self.names, n, self.driven, early if np.any(early) else None)


def join_rows(each: Sequence[FloatArray], equations: int) -> FloatArray:
    """Return the rows of several logs as of one: those of one equation after those of the other.

    Args:
        each: (rows,) or (rows, columns) of each log.
        equations: how many share their instants.
    """
    whole = np.concatenate([rows.reshape(equations, -1, *rows.shape[1:]) for rows in each], axis=1)
    return whole.reshape(-1, *whole.shape[2:])


def filter_motion(
    positions: FloatArray, sample_time: float, filtering: Filtering
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions, velocities and accelerations of raw positions, (samples, n) each; the filtering resolved."""
    assert filtering.position_cutoff is not None
    smooth = lowpass(positions, filtering.position_cutoff, sample_time)
    if filtering.timing == "respected":
        twice = [differentiate_twice(each, sample_time) for each in smooth.T]
        velocity, acceleration = (np.column_stack(each) for each in zip(*twice, strict=True))
    else:
        velocity = differentiate(smooth, sample_time)
        acceleration = differentiate(velocity, sample_time)
    return smooth, settle(velocity), acceleration


def through_window(columns: FloatArray, filtering: Filtering) -> FloatArray:
    """Return columns, (samples, n, columns), as a torque whose timing is respected sees them."""
    return apply_window(columns) if filtering.timing == "respected" else columns


def motion_along(
    torques: Sequence[Channel], positions: FloatArray, filtering: Filtering, delays: Sequence[float] = (0.0,)
) -> MeasuredMotion:
    """Return the motion along raw positions, (samples, n), of which all samples count.

    Args:
        torques: on the first of n masses or joints, at the positions' rate.
        positions: of the motor, and for a flexible joint of the load; or of the motors of a robot.
        filtering: resolved.
        delays: seconds from each logged torque to the torque that acts, or one for all.
    """
    measured, more, sample_time = np.zeros(positions.shape), np.zeros(positions.shape), torques[0].sample_time
    respected, size = filtering.timing == "respected", len(positions)
    for j, (torque, delay) in enumerate(zip(torques, np.resize(delays, len(torques)), strict=True)):
        read = torque if torque.stated else replace(torque, timing=Timing.HELD)
        measured[:, j] = (window_torque(read, delay) if respected else torque.values)[:size]
        if respected and not torque.stated:
            more[:, j] = window_torque(replace(torque, timing=Timing.SAMPLED), delay)[:size] - measured[:, j]
    limit = find_noise_limit(positions.T, sample_time)
    moved = filter_motion(positions, sample_time, filtering)
    return MeasuredMotion(*moved, measured, np.ones(positions.shape), sample_time, filtering, limit, positions, more)


def read_as(records: Sequence[Record], timing: Timing | None) -> list[Record]:
    """Return records whose torques of unstated timing have this one; None keeps it."""

    def read(torque: Channel) -> Channel:
        return replace(torque, timing=timing, stated=True) if timing and not torque.stated else torque

    return [one if one.torque is None else replace(one, torque=read(one.torque)) for one in records]


def torque_and_positions(
    record: Record, joint: Joint, names: Sequence[str], method: str
) -> tuple[Channel, tuple[FloatArray, ...]]:
    """Return the torque on the motor, and positions of as many samples, (samples,) each.

    The log lacks a signal that was injected after the controller's limit; it is added.

    Args:
        record: with all of them.
        joint: whose units they have.
        names: of the positions.
        method: as an error names it.

    Raises:
        RecordError: a channel is missing, in another unit, not sampled, or at another rate.
    """
    record.require(("torque", *names), method)
    require_units(record, joint.kind, joint.torque_unit)
    assert record.torque is not None
    torque, added, period = record.torque, record.injected, record.torque.sample_time
    channels = [(name, thin_channel(getattr(record, name), period)) for name in names]
    acting = list[Channel]()
    if isinstance(added, Injection) and added.at is not InjectionPoint.BEFORE_LIMIT and not added.in_torque:
        acting = [added.channel]
    for name, one in (*channels, *(("injected", one) for one in acting)):
        sampled = name == "injected" or one.timing is Timing.SAMPLED
        if not sampled or abs(one.sample_time / period - 1.0) > 1e-9:
            raise RecordError(
                f"{method} needs a sampled {name} at the torque's rate; this one is {one.timing.value} every "
                f"{one.sample_time:g} s, and the torque comes every {period:g} s: resample it, or use DIDIM, which "
                "needs no position."
            )
    size = min(map(len, (torque, *acting, *(one for _, one in channels))))
    values = sum((one.values[:size] for one in acting), torque.values[:size])
    return replace(torque, values=values), tuple(one.values[:size] for _, one in channels)


# A joint


def idim_channels(model: str) -> tuple[str, ...]:
    """Return the channels that IDIM of a rigid or a flexible joint reads."""
    return ("torque", "motor_position", *(("load_position",) if model == "flexible" else ()))


def inverse_of_joint(joint: Joint, delay: float = 0.0, *, zeros: bool = False) -> Inverse:
    """Return the inverse model of a joint.

    Args:
        joint: whose parameters come first.
        delay: seconds from the controller's output to the torque that acts.
        zeros: whether the encoders' zeros follow, see `ENCODER_OFFSET`.
    """
    names = tuple(p.name for p in (*joint.parameters, *((ENCODER_OFFSET,) if zeros else ())))

    def columns(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        motor, *load = (Motion(*side) for side in zip(q.T, v.T, a.T, strict=True))
        own = joint.regressor(motor, load[0] if load else None).transpose(1, 0, 2)
        offset = np.broadcast_to([[-1.0], [1.0]], (len(q), 2, 1))
        return np.concatenate([own, offset], axis=2) if zeros else own

    def measure(records: Sequence[Record], filtering: Filtering) -> MeasuredMotion:
        return motion_of_joint(records[0], delay, filtering, joint)

    return Inverse(names, 1, columns, measure)


def motion_of_joint(record: Record, delay: float, filtering: Filtering, joint: Joint) -> MeasuredMotion:
    """Return the motion of a record with the positions a joint needs.

    Raises:
        RecordError: a channel is missing, not sampled, or at another rate.
    """
    flexible = joint.model == "flexible"
    said = "IDIM of a flexible joint" if flexible else "IDIM"
    torque, each = torque_and_positions(record, joint, idim_channels(joint.model)[1:], said)
    positions, sample_time = np.column_stack(each), torque.sample_time
    filtering = filtering.resolve(sample_time, joint.model, find_noise_limit(positions.T, sample_time))
    motion = motion_along([torque], positions, filtering, [_late(record, delay, sample_time)])
    if filtering.timing != "respected":  # the published pipeline takes all rows
        return motion
    assert filtering.position_cutoff is not None
    # A spring smooths the jump of the load's acceleration; there the rows about reversals tell of the stiffness.
    kept = [steady_weights(side, filtering.position_cutoff, sample_time)[0 if flexible else 1] for side in motion.v.T]
    return replace(motion, moving=np.column_stack(kept), apart=True)


def _late(record: Record, delay: float, period: float) -> float:
    """Return how long after its stamp a logged torque begins to act, in seconds.

    A measured torque is the one that acts; behind a delay of a broken number of periods it began within the period
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
    """Return the records of each log.

    Raises:
        RecordError: there are none, or records beside lists of them.
    """
    whole = {isinstance(one, Record) for one in records}
    if len(whole) != 1:
        raise RecordError(
            "A robot is identified from the records of its joints, of several logs from a list of them for each log; "
            f"received {'both' if whole else 'none'}: give one or the other."
        )
    return (cast("Sequence[Record]", records),) if whole.pop() else tuple(cast("Sequence[Sequence[Record]]", records))


def require_one_log(records: Sequence[object]) -> None:
    """Raise a `MethodError` if there are records of several logs, or something else."""
    if not all(isinstance(record, Record) for record in records):
        raise MethodError(
            "The records of the joints of one log are needed here, and these are no records, or of several logs: give "
            "those of one log."
        )


def require_torques(robot: Robot, torques: Iterable[FloatArray]) -> None:
    """Raise a `MethodError` if the torque, (samples,), of a joint is 0 throughout."""
    dead = [joint.name for joint, torque in zip(robot.joints, torques, strict=True) if not np.any(torque)]
    if dead:
        raise MethodError(f"The torque of {', '.join(dead)} is 0 throughout; log it, or leave its joint out.")


def motion_of_robot(
    robot: Robot,
    records: Sequence[Record],
    filtering: Filtering,
    said: str = "IDIM of a robot",
    model: str = "rigid",
    smear: float = SMEAR,
) -> MeasuredMotion:
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
        faults = [*finite_faults("torque", torque.values), *finite_faults("motor_position", position)]
        if faults:
            raise RecordError([f"{joint.name}: {fault}" for fault in faults])
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
    resolved = filtering.resolve(sample_time, model, find_noise_limit(motors.T, sample_time))
    motion = motion_along(channels, motors, resolved)
    assert resolved.position_cutoff is not None
    moving = [steady_weights(each, resolved.position_cutoff, sample_time, smear, few=0.0)[1] for each in motion.v.T]
    joints = np.linalg.inv(robot.coupling).T
    measured = motion.torque
    q, v, a = motion.q @ joints, motion.v @ joints, motion.a @ joints
    if payload := records[-1].payload:  # its torque is known
        carried = inverse_columns(robot, q, v, a)[:, :, -len(SYMBOLS) - len(robot) : -len(robot)] @ payload
        measured = measured - through_window(carried[:, :, np.newaxis], resolved)[:, :, 0]
    return replace(motion, q=q, v=v, a=a, torque=measured, moving=np.column_stack(moving))


def inverse_of_robot(robot: Robot, parameters: RobotParameters) -> Inverse:
    """Return the inverse model of a robot of rigid joints."""

    def columns(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return parameters.columns(robot, q, v, a)

    def measure(records: Sequence[Record], filtering: Filtering) -> MeasuredMotion:
        return motion_of_robot(robot, records, filtering)

    return Inverse(parameters.names, len(robot), columns, measure)


# Samples at rest or at a reversal, at which sticking friction does not follow ``Fc sign(v)``


def moving_weights(velocity: FloatArray, long: int = _LONG, reach: int = _REACH) -> FloatArray:
    """Return 0 for the samples at which a mass rests, and 1 for the others.

    Args:
        velocity: (samples,).
        long: samples in a row that are a rest.
        reach: samples on each side that count with it.
    """
    speed = np.abs(velocity)
    slow = speed < REST * float(np.sqrt(np.mean(speed**2)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]])))
    begins, ends = edges[::2], edges[1::2]
    rests = ends - begins >= long
    return _leave_out(velocity.size, begins[rests], ends[rests], reach)


def turning_weights(velocity: FloatArray, reach: int = _REACH) -> FloatArray:
    """Return 0 for so many samples on each side of those at which a mass turns round, and 1 for the others."""
    turns = np.flatnonzero(np.diff(np.sign(velocity))) + 1
    return _leave_out(velocity.size, turns, turns, reach)


def steady_weights(
    velocity: FloatArray, cutoff: float, sample_time: float, smear: float = SMEAR, few: float = _FEW
) -> tuple[FloatArray, FloatArray]:
    """Return 0 for the samples at which a mass rests, else 1; and the same with those about reversals.

    At a reversal the acceleration jumps by the Coulomb friction. The position filter smears the jump, which looks like
    inertia: at 30 Hz it was 14 % of an inertia, and as much as half a sample of timing. And the sign of a filtered
    velocity changes some samples before or after the mass turned, where rows are off by up to twice that friction.

    Args:
        velocity: (samples,) of positions filtered with this cut-off.
        cutoff: Hz.
        sample_time: s.
        smear: periods of the filter on each side that are left out.
        few: share of the moving samples; if less were left without reversals, these stay.
    """
    reach = math.ceil(smear / (cutoff * sample_time))
    moving = moving_weights(velocity, max(_REST_LONG, 4 * reach), reach)
    steady = moving * turning_weights(velocity, reach)
    return moving, moving if np.mean(steady) < few * np.mean(moving) else steady


def _leave_out(size: int, begins: NDArray[np.intp], ends: NDArray[np.intp], reach: int) -> FloatArray:
    """Return weights, (size,), that are 0 from each begin to each end, and so many samples on each side."""
    weights = np.ones(size)
    for begin, end in zip(begins, ends, strict=True):
        weights[max(begin - reach, 0) : end + reach] = 0.0
    return weights
