"""The inverse dynamic model of a measured motion: torques on one side, the columns of the parameters on the other.

Butterworth low-pass forwards and backwards on the positions, derivatives, borders dropped, the same
low-pass-and-decimate on torque and every column [P section III; EMPS report]. A rigid joint needs the motor's
position, a flexible one the load's too: both rows of (2) are then stacked. A robot has a row for each joint.

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
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.parameters import Parameter, Quantity
from jointid.models.joints import Joint
from jointid.models.position_forces import Motion
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, require_units
from jointid.records.signals.filtering import (
    Filtering,
    apply_window,
    decimate_all,
    decimated_at,
    differentiate,
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

REST = 0.02
"""Of the root mean square speed: a mass slower than that ..."""

_LONG = 3  # ... for so many samples rests, or sticks as it turns round
_REACH = 3  # samples on each side that the window smears a rest over
SAID = 0.02  # of a record: a larger share of rest is said
_REST_LONG = 20  # samples in a row that are a rest before filtered positions
SMEAR = 0.6  # of the position filter's period: from there on the errors of a filtered step add up to 0
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
        stated: (instants,) the decimated rows that are kept; None keeps all, 0 at rest.
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
    stated: NDArray[np.bool_] | None = None

    @property
    def sampled(self) -> MeasuredMotion:
        """The motion with torques of unstated timing read as sampled; itself where all are stated."""
        return self if self.if_sampled is None else replace(self, torque=self.torque + self.if_sampled)

    def decimate_columns(self, columns: FloatArray) -> FloatArray:
        """Return columns, (samples, n, columns), decimated: (n instants, columns), one after the other, 0 at rest."""
        seen = through_window(columns, self.filtering)
        return np.concatenate([self.decimate_joint(j, seen[:, j]) for j in range(seen.shape[1])])

    def thinned_torque(self) -> FloatArray:
        """Return the torques decimated, (n instants,), one after the other, 0 at rest."""
        each = [self.decimate_joint(j, torque[:, np.newaxis]) for j, torque in enumerate(self.torque.T)]
        return np.concatenate(each)[:, 0]

    def rows_at(self) -> NDArray[np.intp]:
        """Return the samples of the decimated rows, (instants,)."""
        rows = -(-(self.inside.stop - self.inside.start) // (self.filtering.decimation or 1))
        at = decimated_at(rows, self.inside.stop, self.filtering)
        return at if self.stated is None else at[self.stated]

    def begin(self, size: int) -> MeasuredMotion:
        """Return the motion of the first samples."""
        named = ("q", "v", "a", "torque", "moving", "raw")
        return replace(self, if_sampled=None, **{name: getattr(self, name)[:size] for name in named})

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
        moving = self.moving[self.inside, joint]
        rows, whole = decimate_all(
            [columns[self.inside] * moving[:, np.newaxis], moving], self.filtering, self.sample_time
        )
        return np.where(whole[:, np.newaxis] <= _TOLD, 0.0, rows) if self.stated is None else rows[self.stated]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A linear regression.

    Attributes:
        Y: (rows,) the torque, filtered and decimated; the rows of one equation after those of the other.
        W: (rows, parameters) the columns.
        names: of the parameters.
        equations: how many share their instants.
        driven: how many of them, the first, have the torque of a motor; the others are homogeneous.
    """

    Y: FloatArray
    W: FloatArray
    names: tuple[str, ...]
    equations: int
    driven: int = 1

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

    def columns_along(self, motion: MeasuredMotion) -> FloatArray:
        """Return the columns of a motion, (samples, equations, parameters), not filtered."""
        return self.columns(motion.q, motion.v, motion.a)

    def rows(self, motions: Sequence[MeasuredMotion], columns: Iterable[FloatArray] | None = None) -> Rows:
        """Return the regression along the motions of one log or several; of other columns where these are given."""
        pairs = zip(motions, columns or map(self.columns_along, motions), strict=True)
        W = join_rows([motion.decimate_columns(each) for motion, each in pairs], motions[0].q.shape[1])
        return Rows(self.torques(motions), W, self.names, motions[0].q.shape[1], self.driven)

    def torques(self, motions: Sequence[MeasuredMotion]) -> FloatArray:
        """Return the torques of the rows, (rows,)."""
        return join_rows([motion.thinned_torque() for motion in motions], motions[0].q.shape[1])


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
    return MeasuredMotion(
        *moved, measured, np.ones(positions.shape), sample_time, filtering, limit, positions,
        None if all(torque.stated for torque in torques) else more,
    )  # fmt: skip


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
        return joint_columns(joint, q, v, a, zeros=zeros)

    def measure(records: Sequence[Record], filtering: Filtering) -> MeasuredMotion:
        return motion_of_joint(records[0], delay, filtering, joint)

    return Inverse(names, 1, columns, measure)


def joint_columns(joint: Joint, q: FloatArray, v: FloatArray, a: FloatArray, *, zeros: bool = False) -> FloatArray:
    """Return the columns of a joint's parameters in its equations, (samples, equations, parameters).

    Args:
        joint: whose columns come first.
        q: (samples, sides) positions of motor and load.
        v: their velocities.
        a: their accelerations.
        zeros: whether the column of the encoders' zeros follows.
    """
    motor, *load = (Motion(*side) for side in zip(q.T, v.T, a.T, strict=True))
    columns = joint.regressor(motor, load[0] if load else None).transpose(1, 0, 2)
    offset = np.array([[-1.0], [1.0]])
    return np.concatenate([columns, np.broadcast_to(offset, (len(q), *offset.shape))], axis=2) if zeros else columns


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
    steady = np.column_stack(kept)
    (share,) = decimate_all([steady[motion.inside]], filtering, sample_time)
    return replace(motion, moving=steady, stated=np.any(share > _TOLD, axis=1))


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
