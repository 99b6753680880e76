"""The output that DIDIM reproduces: the logged torque, or the motor position.

The position is compared as the torque that the declared controller outputs for it
(`simulation.controller_torque`), so search, intervals and checks are those of a logged torque.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.estimation.parameters import LOG_DELAY
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import scale_check
from jointid.models.joints import ClosedLoop
from jointid.records.record import CHANNELS, Record
from jointid.simulation.controller_torque import compute_controller_torque

Logs: TypeAlias = Sequence[Record]

OUTPUTS = ("torque", "motor_position")

CONSTANT = ("offset", "gravity_constant", "coulomb_forwards", "coulomb_backwards")  # includes a constant torque
_OF_TORQUE = ("N", "kg", "A", "V")  # units of what is a part of the torque begin so
_ENOUGH = 0.05  # of the torque's scatter: a smaller known torque tells no scale


def check_outputs(outputs: Sequence[str]) -> None:
    """Refuse an output that no record has, and two.

    Raises:
        MethodError: a name is another one, or there are several.
    """
    if not set(outputs) <= set(OUTPUTS) or len(outputs) > 1:
        raise MethodError(
            f"DIDIM reproduces one output, {' or '.join(OUTPUTS)}; received {join(list(outputs))}: leave outputs out "
            "to take the torque where it is logged."
        )


def torques_of(records: Logs, loops: Sequence[ClosedLoop], outputs: Sequence[str]) -> list[Record]:
    """Return the records with the torque that is reproduced: the logged one, or that of the motor position.

    Args:
        records: of a joint, or of the joints of a robot; of several logs one after the other.
        loops: joint and controller of each.
        outputs: "torque" or "motor_position"; empty for the torque where it is logged, else the position.

    Raises:
        RecordError: a record lacks an output that is asked for.
    """
    logged = any(record.torque is not None for record in records)
    if tuple(outputs) == ("torque",) or (not outputs and logged):
        return list(records)
    return [compute_controller_torque(record, loop) for record, loop in zip(records, loops, strict=True)]


def state_scale(fit: Estimate, records: Logs) -> Estimate:
    """Return a fit of computed torques with a check of what these do not tell; any other fit as it is.

    A fixed parameter other than 0 that is a part of the torque, or a known torque beside the controller's output, tells
    the factor that controller and joint have in common. The content of an integral at the first sample is unknown, and
    with it a constant torque: the parameters that include it lose their values.
    """
    computed = [
        (one, one.torque, one.computed_by) for one in records if one.computed_by is not None and one.torque is not None
    ]
    if not computed:
        return fit
    rows = [row for row in fit.rows if row.of_joint]
    known = [row.name for row in rows if not row.free and row.value and row.unit.startswith(_OF_TORQUE)]
    if any(  # large enough beside the controller's output to tell a scale
        record.injected is not None and np.std(record.injected.channel.values) > _ENOUGH * np.std(torque.values)
        for record, torque, _ in computed
    ):
        known.append("the injected signal")
    integral = any(law.law(torque.sample_time).integrates for _, torque, law in computed)
    parts = {row.name: row.name.rpartition(".")[2].removeprefix("motor_").removeprefix("load_") for row in rows}
    lost = tuple(row.name for row in rows if integral and row.free and parts[row.name] in CONSTANT)
    freed = any(not row.of_joint and row.free and row.name == "gain" for row in fit.rows)
    if freed and not known:
        raise MethodError(
            "From positions alone the controller's gain is one with the scale of the joint; expected a known inertia, "
            "friction or stiffness, or an injected torque: fix one of them, or keep the gain."
        )
    checks = (*fit.checks, scale_check(known, lost, identified=freed))
    read = {*fit.data.channels, "motor_position", *(name for *_, law in computed for name in law.channels)}
    data = replace(fit.data, channels=tuple(name for name in CHANNELS if name in read - {"torque"}))
    return replace(fit, checks=checks, data=data)


def state_timing(fit: Estimate, records: Logs) -> Estimate:
    """Return a fit of the drive side whose log's delay covers half a sample, where no timing is stated; or as it is.

    Another reading of the torque, held or sampled, changes that delay by half a sample and nothing else. To DIDIM both
    are one: a controller's output is the same at its stamp and until its next period.
    """
    stated = all(one.torque.stated for one in records if one.torque is not None)
    if stated or fit.settings.method != "drive_side":
        return fit
    more = 0.25 * fit.data.sample_time  # half of it in two deviations
    rows = tuple(
        replace(row, stderr=float(np.hypot(row.stderr, more))) if row.name == LOG_DELAY.name and row.stderr else row
        for row in fit.rows
    )
    return replace(fit, rows=rows).warn(
        "it is not stated whether the torque is held or sampled: log_delay, which makes up for the difference, is "
        "estimated, counts from a held torque, and its interval covers half a sample; state timing of its channel"
    )
