"""Outputs that DIDIM reproduces: the logged torque, the motor position, or both.

The position is compared as the torque that the declared controller outputs for it
(`simulation.controller_torque`), so search, intervals and checks are those of a logged torque. Both outputs show one
simulated torque: their mean, weighted by the noise of each, holds all that they say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.ndimage import uniform_filter1d

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import format_signed, join, number
from jointid.estimation.result.assemble import FitResult
from jointid.models.joints import ClosedLoop
from jointid.records.record import CHANNELS, Record
from jointid.simulation.controller_torque import SOURCE, compute_controller_torque, seen_position
from jointid.uncertainty.covariance import robust
from jointid.uncertainty.verdict import scale_verdict

Logs: TypeAlias = Sequence[Record]

OUTPUTS = ("torque", "motor_position")

_ONE_WAY = ("coulomb_forwards", "coulomb_backwards")
_CONSTANT = (  # what includes a constant torque
    "offset", "gravity_constant", *(f"{side}{name}" for side in ("", "motor_", "load_") for name in _ONE_WAY),
)  # fmt: skip
_OF_TORQUE = ("N", "kg", "A", "V")  # units of what is a part of the torque begin so
_ENOUGH = 0.05  # of the torque's scatter: a smaller known torque tells no scale
_SURE, _SAME = 4.0, 0.02  # deviations, and size or samples: what two torques must differ by to be two
_BANDS = 64  # of the spectrum, in each of which the shares of both outputs are one
_FEWEST = 8  # frequencies in one


def check_outputs(outputs: Sequence[str]) -> None:
    """Refuse outputs that no record has.

    Raises:
        MethodError: a name is another one, or stands twice.
    """
    if not set(outputs) <= set(OUTPUTS) or len(set(outputs)) < len(outputs):
        raise MethodError(
            f"The outputs of DIDIM are {join(OUTPUTS)}, or one of them; received {join(list(outputs))}: leave outputs "
            "out to take the torque where it is logged."
        )


def fit_outputs(
    records: Logs, loops: Sequence[ClosedLoop], outputs: Sequence[str], fit: Callable[[Logs], FitResult]
) -> FitResult:
    """Return the fit of the outputs that are asked for; of what the records have where none are.

    Args:
        records: of a joint, or of the joints of a robot.
        loops: joint and controller of each.
        outputs: "torque", "motor_position" or both; empty for the torque where it is logged, else the position.
        fit: of records that have a torque.

    Raises:
        RecordError: a record lacks an output that is asked for.
    """
    logged = any(record.torque is not None for record in records)
    if tuple(outputs) == ("torque",) or (not outputs and logged):
        return fit(records)
    computed = [compute_controller_torque(record, loop) for record, loop in zip(records, loops, strict=True)]
    if "torque" not in outputs:
        return fit(computed)
    for record in records:
        record.require(("torque",), "An identification from torque and motor position")
    first = fit(records)
    if first.robot is not None and len(records) > len(first.robot.model):
        raise MethodError(
            "Both outputs of a robot are fitted from one log; received several: name one output, or one log."
        )
    found = fit([_average(*one) for one in zip(records, _errors(first, records, computed), strict=True)])
    channels = ("torque", "motor_position", *(name for name in found.data.channels if name not in OUTPUTS))
    return replace(found, data=replace(found.data, channels=channels), earlier=found.earlier + first.simulations)


def _errors(fit: FitResult, records: Logs, computed: Logs) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield for each axis the errors of the logged and of the computed torque beside a fit, (samples,) each.

    A joint's simulated position is seen through the controller like the measured one. A robot's is not: its computed
    torque is compared with the simulated one, which is the same unless a controller is faster than the log.
    """
    predicted = fit.fit.predicted.reshape(fit.fit.predicted.shape[0], -1)
    for axis, (record, other) in enumerate(zip(records, computed, strict=True)):
        assert record.torque is not None and other.torque is not None
        logged = record.torque.values[: len(predicted)] - predicted[:, axis]
        law = other.torque.values[: len(predicted)] - predicted[:, axis]
        if (
            fit.problem is not None
            and fit.x is not None
            and (seen := seen_position(other, fit.problem.loop)) is not None
        ):
            assert other.motor_position is not None
            simulated = seen.torque(fit.problem.simulate(fit.x).motor_position)
            law = seen.torque(other.motor_position.values)[: len(simulated)] - simulated
        yield logged, law


def _average(record: Record, errors: tuple[FloatArray, FloatArray]) -> Record:
    """Return the record with the mean of both torques whose error is least at each frequency.

    Both errors e are seen beside one prediction. The share w of the computed torque makes the power of
    ``(1 - w) e1 + w e2`` least, averaged over neighbouring frequencies, which allows for what they have in common. What
    is constant is taken from the log: the content of an integral is unknown.

    Raises:
        MethodError: the torques differ by a factor or by a delay, so one of them is wrong.
    """
    assert record.torque is not None
    torque, difference = record.torque.values[: errors[0].size], errors[1] - errors[0]
    columns = np.column_stack([torque, np.gradient(torque), np.ones(torque.size)])
    weights = np.linalg.lstsq(columns, difference, rcond=None)[0]
    std = robust(columns, columns, difference - columns @ weights).std
    sure = np.abs(weights) > np.maximum(_SURE * std, _SAME)
    if sure[0] or sure[1]:
        told = (f"{format_signed(100 * weights[0], 2)} % in size", f"{number(abs(weights[1]), 2)} samples in time")
        apart_by = join([said for said, is_sure in zip(told, sure, strict=False) if is_sure])
        raise MethodError(
            f"The controller's torque for the logged motor position differs from the logged torque by {apart_by}; "
            "expected one torque: identify from one output, which tests the other, and correct gains, units or delay."
        )
    logged, apart = np.fft.rfft(errors[0]), np.fft.rfft(difference - difference.mean())
    width = max(logged.size // _BANDS, _FEWEST)
    common, size = (uniform_filter1d(one, width) for one in (-(logged * apart.conj()).real, np.abs(apart) ** 2))
    share = np.clip(np.divide(common, size, out=np.full_like(size, 0.5), where=size > 0.0), 0.0, 1.0)
    values = record.torque.values.copy()
    values[: errors[0].size] += np.fft.irfft(share * apart, errors[0].size)
    return replace(record, torque=replace(record.torque, values=values, source=f"logged, and {SOURCE}"))


def state_scale(fit: FitResult, records: Logs) -> FitResult:
    """Return a fit of computed torques with a verdict on what these do not tell; any other fit as it is.

    A fixed parameter other than 0 that is a part of the torque, or a known torque beside the controller's output, tells
    the factor that controller and joint have in common. The content of an integral at the first sample is unknown, and
    with it a constant torque: the parameters that include it lose their values.
    """
    computed = [(record, record.computed_by) for record in records if record.computed_by is not None]
    if not computed:
        return fit
    rows = fit.params.rows
    known = [
        row.name for row in rows if row.of_joint and not row.free and row.value and row.unit.startswith(_OF_TORQUE)
    ]
    known += ["the injected signal"] if any(_tells_scale(record) for record, _ in computed) else []
    integral = any(law.law(_sample_time(record)).integrates for record, law in computed)
    lost = tuple(
        row.name for row in rows if integral and row.of_joint and row.free and row.name.rpartition(".")[2] in _CONSTANT
    )
    freed = [row.name for row in rows if not row.of_joint and row.free and row.name == "gain"]
    if freed and not known:
        raise MethodError(
            "From positions alone the controller's gain is one with the scale of the joint; expected a known inertia, "
            "friction or stiffness, or an injected torque: fix one of them, or keep the gain."
        )
    verdict = scale_verdict(known, lost)
    checks = replace(
        fit.checks, verdicts=(*fit.checks.verdicts, verdict), warnings=(*fit.checks.warnings, verdict.said)
    )
    read = {*fit.data.channels, "motor_position", *(name for _, law in computed for name in law.channels)}
    data = replace(fit.data, channels=tuple(name for name in CHANNELS if name in read - {"torque"}))
    return replace(fit, checks=checks, data=data, undetermined=lost)


def _tells_scale(record: Record) -> bool:
    """Test whether a known torque beside the controller's output is large enough to tell a scale."""
    if record.injected is None or record.torque is None:
        return False
    return float(np.std(record.injected.channel.values)) > _ENOUGH * float(np.std(record.torque.values))


def _sample_time(record: Record) -> float:
    assert record.torque is not None
    return record.torque.sample_time
