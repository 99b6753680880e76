"""The inverse dynamic model of a measured motion: torque on one side, the columns of the parameters on the other.

Butterworth low-pass forwards and backwards on the positions, derivatives, borders dropped, the same
low-pass-and-decimate on torque and every column [P section III; EMPS report]. A rigid joint needs the motor's
position, a flexible one the load's too: both rows of (2) are then stacked.

Torque and columns are seen through one window (`filtering.window_torque`), so that a held, averaged or delayed torque
is compared with the motion it made. The published pipeline reads it as sampled and differentiates twice centrally.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.rest import steady_weights
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
    lowpass,
    settle,
    thin_channel,
    window_torque,
)
from jointid.records.signals.position_noise import find_noise_limit

ENCODER_OFFSET = Parameter("encoder_offset", "K dq0", Quantity.FORCE)
"""The spring's force by the difference of two encoders' zeros, which acts on the load and against the motor.

An encoder counts from where it was switched on, or from its own mark. The difference at a rest of the record is not
enough: friction may hold the spring wound up there.
"""

_TOLD = 0.05  # of a row's weight: what holds less is of rest


def idim_channels(model: str) -> tuple[str, ...]:
    """Return the channels that IDIM of a rigid or a flexible joint reads."""
    return ("torque", "motor_position", *(("load_position",) if model == "flexible" else ()))


@dataclass(frozen=True, slots=True, eq=False)
class InverseModel:
    """The torque of one motion, and the columns whose sum with the parameters it is, raw.

    Attributes:
        torque: (equations, samples): of the motor, and for a flexible joint 0 for the load.
        columns: (equations, samples, parameters) all of the joint's, then perhaps that of the encoders' zeros.
        inside: the samples that the position filter's ends do not reach.
        motor, load: their motion, filtered; the load's is None for a rigid joint.
        moving: (equations, samples) 0 where the equation's mass rests or turns round; None where all samples count.
        resting: share of the record in which the motor rests.
    """

    torque: FloatArray
    columns: FloatArray
    inside: slice
    motor: Motion
    load: Motion | None = None
    moving: FloatArray | None = None
    resting: float = 0.0

    def decimate(
        self, filtering: Filtering, sample_time: float, values: FloatArray, *, compiled: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return torque less that of `values` (rows,), and columns (rows, parameters), filtered; equations stacked."""
        torque = self.torque - self.columns @ values
        both = np.concatenate([torque[..., np.newaxis], self.columns], axis=2)
        seen = self.decimate_columns(both, filtering, sample_time, compiled=compiled)
        return seen[:, 0], seen[:, 1:]

    def decimate_columns(
        self, columns: FloatArray, filtering: Filtering, sample_time: float, *, compiled: bool = False
    ) -> FloatArray:
        """Return columns, (equations, samples, parameters), filtered and decimated; equations stacked.

        Samples at rest have no weight on both sides of an equation, and rows that hold little else are left out.
        """
        inside = columns[:, self.inside]
        if compiled:
            return np.concatenate(decimate_all(list(inside), filtering, sample_time))
        if self.moving is None:
            return np.concatenate([filtering.decimate(equation, sample_time) for equation in inside])
        weighted, stated = inside * self.moving[:, self.inside, np.newaxis], self.stated(filtering, sample_time)
        return np.concatenate([filtering.decimate(equation, sample_time)[stated] for equation in weighted])

    def stated(self, filtering: Filtering, sample_time: float) -> NDArray[np.bool_]:
        """Return which decimated rows hold more than rest, (rows,)."""
        weights = np.ones(self.torque.shape) if self.moving is None else self.moving
        share = np.array([filtering.decimate(one, sample_time) for one in weights[:, self.inside]])
        return np.asarray(np.any(share > _TOLD, axis=0))

    def rows_at(self, filtering: Filtering, sample_time: float) -> NDArray[np.intp]:
        """Return the samples of the decimated rows, (rows,)."""
        stated = self.stated(filtering, sample_time)
        return decimated_at(stated.size, self.inside.stop, filtering)[stated]


def inverse_model(
    joint: Joint,
    torque: Channel,
    positions: tuple[FloatArray, ...],
    filtering: Filtering,
    delay: float = 0.0,
    *,
    zeros: bool = False,
) -> InverseModel:
    """Return torque and regressor of a measured, simulated or reconstructed motion.

    Args:
        joint: whose columns come first.
        torque: on the motor.
        positions: (samples,) each, raw, at the torque's rate: motor, and load for a flexible joint.
        filtering: resolved.
        delay: seconds from the logged torque to the torque that acts.
        zeros: whether the column of the encoders' zeros follows, see `ENCODER_OFFSET`.
    """
    sample_time, size = torque.sample_time, torque.values.size
    respected = filtering.timing == "respected"
    motor, *others = (_motion(position, sample_time, filtering) for position in positions)
    load = others[0] if others else None
    regressor = joint.regressor(motor, load)
    if zeros:
        offset = np.array([-1.0, 1.0])[:, np.newaxis, np.newaxis]
        regressor = np.concatenate([regressor, np.broadcast_to(offset, (2, size, 1))], axis=2)
    columns = through_window(regressor, filtering)
    rows = np.zeros((len(columns), size))
    rows[0] = window_torque(torque, delay) if respected else torque.values
    inside = filtering.inside(size)
    return InverseModel(rows, columns, inside, motor, load)


def through_window(columns: FloatArray, filtering: Filtering) -> FloatArray:
    """Return columns, (equations, samples, parameters), as a torque whose timing is respected sees them."""
    if filtering.timing != "respected":
        return columns
    return apply_window(columns.transpose(1, 0, 2)).transpose(1, 0, 2)


def _motion(position: FloatArray, sample_time: float, filtering: Filtering) -> Motion:
    assert filtering.position_cutoff is not None
    smooth = lowpass(position, filtering.position_cutoff, sample_time)
    if filtering.timing == "respected":
        velocity, acceleration = differentiate_twice(smooth, sample_time)
    else:
        velocity = differentiate(smooth, sample_time)
        acceleration = differentiate(velocity, sample_time)
    return Motion(smooth, settle(velocity), acceleration)


def motor_torque(record: Record) -> Channel:
    """Return the torque on the motor: the log, with what was injected after the limit where the log lacks it."""
    assert record.torque is not None
    torque, added = record.torque, record.injected
    if not isinstance(added, Injection) or added.at is InjectionPoint.BEFORE_LIMIT or added.in_torque:
        return torque
    if added.channel.sample_time != torque.sample_time:
        raise RecordError(
            "IDIM adds the injected signal to the logged torque, so both need one sample time; "
            f"they have {added.channel.sample_time:g} s and {torque.sample_time:g} s."
        )
    size = min(len(torque), len(added.channel))
    return replace(torque, values=torque.values[:size] + added.channel.values[:size])


def torque_and_positions(
    record: Record, joint: Joint, names: Sequence[str], method: str
) -> tuple[Channel, tuple[FloatArray, ...]]:
    """Return the torque on the motor, and positions of as many samples, (samples,) each.

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
    torque = motor_torque(record)
    positions = [thin_channel(getattr(record, name), torque.sample_time) for name in names]
    for name, position in zip(names, positions, strict=True):
        if position.timing is not Timing.SAMPLED or abs(position.sample_time / torque.sample_time - 1.0) > 1e-9:
            raise RecordError(
                f"{method} needs a sampled {name} at the torque's rate; this one is {position.timing.value} every "
                f"{position.sample_time:g} s, and the torque comes every {torque.sample_time:g} s: resample it, or use "
                "DIDIM, which needs no position."
            )
    size = min(map(len, (torque, *positions)))
    return replace(torque, values=torque.values[:size]), tuple(position.values[:size] for position in positions)


def noise_limit_of(record: Record, joint: Joint, names: Sequence[str]) -> float:
    """Return the highest cut-off that the noise of positions of a record allows, Hz; see `find_noise_limit`.

    Args:
        record: with a torque and these positions.
        joint: whose units they have.
        names: of the positions.
    """
    torque, positions = torque_and_positions(record, joint, names, _title(joint))
    return find_noise_limit(positions, torque.sample_time)


def motion_of(record: Record, delay: float, filtering: Filtering, joint: Joint, *, zeros: bool = False) -> InverseModel:
    """Return torque and regressor of a record with the positions a joint needs; `filtering` resolved.

    Raises:
        RecordError: a channel is missing, not sampled, or at another rate.
    """
    torque, positions = torque_and_positions(record, joint, idim_channels(joint.model)[1:], _title(joint))
    model = inverse_model(joint, torque, positions, filtering, _late(record, delay, torque.sample_time), zeros=zeros)
    if filtering.timing != "respected":  # the published pipeline takes all rows
        return model
    assert filtering.position_cutoff is not None
    sides = [model.motor, *([] if model.load is None else [model.load])]
    weights = [steady_weights(side.velocity, filtering.position_cutoff, torque.sample_time) for side in sides]
    # A spring smooths the jump of the load's acceleration; there the rows about reversals tell of the stiffness.
    steady = np.array([moving if joint.model == "flexible" else without for moving, without in weights])
    return model if np.all(steady) else replace(model, moving=steady, resting=1.0 - float(np.mean(weights[0][0])))


def _title(joint: Joint) -> str:
    return "IDIM of a flexible joint" if joint.model == "flexible" else "IDIM"


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
