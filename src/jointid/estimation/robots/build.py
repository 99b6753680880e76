"""The builder of a robot's fit: parameters, errors by axis and verdicts, alike for every method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import join
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.estimate import fingerprint, relative_error
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, Params, Settings
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.verdict import (
    axes_verdict,
    bounds_verdict,
    friction_verdict,
    solver_verdict,
    springs_verdict,
)


def build_robot_result(
    records: Sequence[Record],
    part: IdentifiedRobot,
    rows: tuple[EstimatedParameter, ...],
    errors: FloatArray,
    torques: tuple[FloatArray, FloatArray],
    method: tuple[str, str],
    filtering: Filtering,
    count: int,
    end: tuple[str, bool],
    simulations: int,
    *,
    negative: Sequence[str] = (),
    warnings: tuple[str, ...] = (),
) -> FitResult:
    """Return the fit of a robot.

    Args:
        records: of its joints, those of one log after those of another.
        part: what only a robot has; its arrays are in the order of the rows.
        rows: the parameters.
        errors: (n,) the share of each joint's filtered torque that the model leaves.
        torques: (samples, n) each, measured and predicted.
        method: its name, and how it was run.
        filtering: resolved.
        count: of the filtered samples that were fitted.
        end: why the search ended, and whether that is a good end.
        simulations: that were run.
        negative: joints whose friction comes out negative.
        warnings: of the method.
    """
    model, (measured, predicted), (stop, converged) = part.model, torques, end
    free = [i for i, row in enumerate(rows) if row.free]
    left = dict(zip(model.names, map(float, errors), strict=True))
    first = records[0].torque
    assert first is not None
    held = bounds_verdict([row.name for row in rows if row.at_bound is not None])
    torques_of = [record.torque.values for record in records if record.torque is not None]
    starts = range(0, len(torques_of), len(model))
    channels = dict.fromkeys(name for record in records for name in record.channels)
    return FitResult(
        params=Params(
            rows,
            tuple(rows[i].name for i in free),
            part.covariance.correlation[np.ix_(free, free)],
        ),
        fit=Fit(
            measured=measured,
            predicted=predicted,
            borders=filtering.borders,
            relative_error=relative_error(measured, predicted, filtering.borders),
            filtered_error=float(np.sqrt(np.mean(errors**2))),
            rows=count,
            simulations=simulations,
            stop=stop,
            converged=converged,
            axis_errors=left,
        ),
        checks=Checks(
            verdicts=(
                solver_verdict(stop, converged),
                axes_verdict(left),
                friction_verdict(negative) if negative else held,
                *((springs_verdict([str(s) for s in part.springs if not s.shown]),) if part.springs else ()),
            ),
            warnings=(*model.remarks, *warnings),
        ),
        data=Data(
            record=join(list(dict.fromkeys(record.name for record in records))),
            channels=tuple(channels),
            sample_time=first.sample_time,
            torque_unit=join(list(dict.fromkeys(r.torque.unit for r in records if r.torque is not None))),
            fingerprint=fingerprint(np.concatenate(torques_of)),
            logs=tuple(fingerprint(np.concatenate(torques_of[at : at + len(model)])) for at in starts),
        ),
        settings=Settings(*method, system=model, loop=None, filtering=filtering),
        robot=part,
        records=tuple(records),
    )
