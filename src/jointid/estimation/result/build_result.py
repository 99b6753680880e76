"""The builder of an estimate: what every problem's solution says alike, with the differences as arguments."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import Bounds, Parameter
from jointid.common.text import join
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate, fingerprint, relative_error
from jointid.estimation.result.parts import Data, EstimatedParameter, Fit, Settings
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.uncertainty.covariance import Covariance

if TYPE_CHECKING:
    from jointid.estimation.robots.simulated import IdentifiedRobot

_AT_LIMIT = 0.01  # of the periods: more is said
_NEAR = 1e-6  # of a parameter's size: how near to a bound is at it


def rows_of_problem(
    problem: ClosedLoopProblem, x: FloatArray, covariance: Covariance, held: Mapping[str, float]
) -> tuple[EstimatedParameter, ...]:
    """Return the parameters of a problem's solution x, (free,), those of the joint and of what surrounds it.

    A deviation that is no number is not known; `held` has the bounds that are reached, by name.
    """
    own, units = {p.name for p in problem.joint.parameters}, problem.units
    std = {p.name: float(one) for p, one in zip(problem.free, covariance.std, strict=False) if np.isfinite(one)}
    return build_rows(problem.parameters, problem.values(x), std, lambda p: units[p.name], own, held)


def build_rows(
    parameters: Iterable[Parameter],
    values: Mapping[str, float],
    std: Mapping[str, float],
    unit: Callable[[Parameter], str],
    of_joint: Collection[str],
    held: Mapping[str, float] | None = None,
) -> tuple[EstimatedParameter, ...]:
    """Return the rows of an estimate.

    Args:
        parameters: in its order.
        values: of all of them, by name.
        std: standard deviations of the free ones, by name.
        unit: of a parameter.
        of_joint: names of those that belong to the joint, and not to what surrounds it.
        held: the bounds of those at one, by name.
    """
    return tuple(
        EstimatedParameter(
            p.name, p.symbol, unit(p), values[p.name], std.get(p.name), p.free,
            of_joint=p.name.partition("@")[0] in of_joint, at_bound=(held or {}).get(p.name),
        )
        for p in parameters
    )  # fmt: skip


def build_estimate(
    records: Sequence[Record],
    rows: tuple[EstimatedParameter, ...],
    correlation: FloatArray,
    torques: tuple[FloatArray, FloatArray],
    error: float | FloatArray,
    fitted: int,
    end: tuple[str, bool],
    simulations: int,
    settings: Settings,
    channels: Iterable[str] = (),
    *,
    robot: IdentifiedRobot | None = None,
    nominal: FloatArray | None = None,
    warnings: Sequence[str] = (),
    **found: Any,
) -> Estimate:
    """Return the estimate that a method ends with: of a joint or a robot, from one record or several.

    Args:
        records: that were read; of a robot those of its joints, one log after the other.
        rows: the parameters.
        correlation: of the errors of the free ones, in their order.
        torques: (samples,) each, measured and predicted; of a robot (samples, n).
        error: share of the filtered torque that the model leaves; of a robot (n,).
        fitted: rows of the filtered torque.
        end: why the search ended, and whether that is a good end.
        simulations: that were run.
        settings: model and method.
        channels: that were read; all of the records' where none are given.
        robot: that was identified; None for a joint.
        nominal: (n,) share of each joint's filtered torque that the nominal robot leaves.
        warnings: of the method.
        found: further parts of the estimate.
    """
    (measured, predicted), borders = torques, settings.filtering.borders
    read = [record.torque for record in records if record.torque is not None]
    errors, names = np.atleast_1d(error), () if robot is None else robot.model.names
    logs = [read[at : at + errors.size] for at in range(0, len(read), errors.size)]
    by_axis = dict(zip(names, map(float, errors), strict=False))
    fit = Fit(
        measured, predicted, relative_error(measured, predicted, borders),
        float(np.sqrt(np.mean(errors**2))) if by_axis else float(errors[0]), fitted, simulations, *end,
        axis_errors=by_axis,
    )  # fmt: skip
    if robot is not None:
        warnings = (*robot.model.remarks, *warnings)
        if robot.model.has_masses and nominal is not None:
            fit = replace(fit, nominal_errors=dict(zip(names, map(float, nominal), strict=True)))
    data = Data(
        record=join(list(dict.fromkeys(record.name for record in records))),
        channels=tuple(dict.fromkeys(channels or (name for record in records for name in record.channels))),
        sample_time=read[0].sample_time,
        torque_unit=join(list(dict.fromkeys(torque.unit for torque in read))),
        fingerprints=tuple(fingerprint(np.concatenate([torque.values for torque in log])) for log in logs),
        resampled=records[0].resampled if len(records) == 1 else None,
    )
    kept: dict[str, Any] = {"warnings": tuple(warnings), "records": () if robot is None else tuple(records)}
    return Estimate(rows, correlation, fit, data, settings, robot=robot, **kept, **found)


def list_loop_channels(loop: ClosedLoop, record: Record) -> tuple[str, ...]:
    """Return the channels of a record that a simulation of its loop reads."""
    return (*loop.channels, *(("injected",) if record.injected is not None else ()))


def find_active_bounds(free: Sequence[Parameter], x: FloatArray, error: FloatArray, J: FloatArray) -> dict[str, float]:
    """Return the bounds that hold free parameters, by name.

    A descent ends a little inside of a bound. So near is a millionth of the value, or, since a bound may be 0, of the
    change that would move the residual by all of its size, where that is more.

    Args:
        free: the parameters.
        x: (free,) what was found for them.
        error: (rows,) residual there.
        J: (rows, free) its derivatives, of either sign.
    """
    norms = np.linalg.norm(J, axis=0)
    size = np.maximum(np.abs(x), np.linalg.norm(error) / np.where(norms > 0, norms, np.inf))
    bounds, near = Bounds.of(free), _NEAR * size
    held = {p.name: p.upper for p, at in zip(free, x >= bounds.upper - near, strict=True) if at}
    return held | {p.name: p.lower for p, at in zip(free, x <= bounds.lower + near, strict=True) if at}


def warn_of_limit(share: float) -> tuple[str, ...]:
    """Return a sentence on a controller that was at its limit in more than a few of its periods."""
    if share <= _AT_LIMIT:
        return ()
    said = f"the controller is at its limit in {100 * share:.1f} % of the periods"
    return (f"{said}, where the torque says nothing of the joint",)
