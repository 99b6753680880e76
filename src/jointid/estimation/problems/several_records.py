"""Several records in one problem: the sum of the problems of each, whose parameters are one or belong to one.

The motor's first state is always a record's own; so is a number of the controller that the records declare differently.
Each record's rows go through a filter of a few taps that makes it count for what it is worth: one over its level, or
what makes its noise white (`whitening`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.problems.base import SumProblem, filter_rows
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.nuisance_parameters import INITIAL, of_law
from jointid.models.parameters import Parameter
from jointid.simulation.closed_loop import Simulation

_WHITE = 0.01  # of a residual's variance


def several(
    problems: Sequence[ClosedLoopProblem],
    own: Sequence[Sequence[str]] | None = None,
    added: Sequence[Mapping[str, float]] | None = None,
) -> SumProblem[ClosedLoopProblem]:
    """Return the criterion of several records; their residuals weigh alike, see `SumProblem.weighing`.

    Args:
        problems: one for each record, of one model of joint.
        own: for each record, names of its parameters that the others do not share.
        added: for each record, what is known to come on top of the shared value, by name, in the parameter's unit.

    Raises:
        MethodError: the joints are not of one model; a name is not one of a record's parameters; a parameter is its
            record's own and has something known added; or nothing tells the drive's gain.
    """
    own, added = own or [()] * len(problems), added or [{}] * len(problems)
    names = {tuple(p.name for p in problem.loop.joint.parameters) for problem in problems}
    if len(names) != 1 or len({problem.loop.joint.kind for problem in problems}) != 1:
        raise MethodError("Records that are fitted together have one model of joint, of one kind; give them the same.")
    for number, (problem, mine, more) in enumerate(zip(problems, own, added, strict=True), 1):
        _require_known(problem, mine, more, number)
    _require_scale(problems, own, added)
    apart = _apart(problems, own)
    labels = [
        [f"{p.name}@{k}" if p.name in apart[k - 1] else p.name for p in q.free] for k, q in enumerate(problems, 1)
    ]
    order = list(dict.fromkeys(name for each in labels for name in each))
    order.sort(key=lambda name: int(name.partition("@")[2] or 0))  # stable: what is shared comes first
    members: dict[str, list[Parameter]] = {name: [] for name in order}
    for problem, each, more in zip(problems, labels, added, strict=True):
        for p, label in zip(problem.free, each, strict=True):
            members[label].append(_less(p, more.get(p.name, 0.0)))
    return SumProblem(
        tuple(problems),
        tuple(_common(label, members[label]) for label in order),
        tuple(np.array([order.index(label) for label in each], dtype=np.intp) for each in labels),
        tuple(np.array([more.get(p.name, 0.0) for p in q.free]) for q, more in zip(problems, added, strict=True)),
        (np.ones(1),) * len(problems),
    )


def _require_known(problem: ClosedLoopProblem, own: Sequence[str], added: Mapping[str, float], number: int) -> None:
    known = [p.name for p in problem.parameters]
    for name in (*own, *added):
        if name not in known:
            raise MethodError(f"Record {number} has no parameter {name}; it has {', '.join(known)}.")
        if name in own and name in added:
            raise MethodError(
                f"{name} of record {number} is its own and has {added[name]:g} added to what others share; an addition "
                "is to a shared parameter: leave out one of the two."
            )


def _require_scale(
    problems: Sequence[ClosedLoopProblem], own: Sequence[Sequence[str]], added: Sequence[Mapping[str, float]]
) -> None:
    """Refuse a free gain of the drive where a change of it is made good by one of all of the joint's parameters."""
    if not any(p.name == "drive_gain" for problem in problems for p in problem.free):
        return
    joint = {p.name for p in problems[0].loop.joint.parameters}
    known = any(p.start for problem in problems for p in problem.parameters if not p.free and p.name in joint)
    for name in {name for more in added for name in more}:
        sharing = [m.get(name, 0.0) for m, mine in zip(added, own, strict=True) if name not in mine]
        known = known or len(set(sharing)) > 1
    if not known:
        raise MethodError(
            "The drive's gain cannot be told from the scale of the joint's parameters, because no two records differ "
            "by a known inertia; give the inertia that was added to the load in one of them, or keep the gain fixed."
        )


def _apart(problems: Sequence[ClosedLoopProblem], own: Sequence[Sequence[str]]) -> list[set[str]]:
    """Return, for each record, the names of its free parameters that it shares with no other."""
    starts: dict[str, set[float | None]] = {}
    for problem in problems:
        joint = {p.name for p in problem.loop.joint.parameters}
        for p in problem.free:
            if p.name not in joint and of_law(p.name):
                starts.setdefault(p.name, set()).add(p.start)
    differing = {name for name, values in starts.items() if len(values) > 1}
    apart = [set(mine) | set(INITIAL) | differing for mine in own]
    for name in {p.name for problem in problems for p in problem.free}:
        sharing = [k for k, q in enumerate(problems) if name not in apart[k] and name in {p.name for p in q.free}]
        if len(sharing) == 1:
            apart[sharing[0]].add(name)
    return apart


def _less(p: Parameter, added: float) -> Parameter:
    """Return a record's parameter without what is known to have been added."""
    start = None if p.start is None else p.start - added
    return replace(p, start=start, lower=p.lower - added, upper=p.upper - added)


def _common(label: str, members: Sequence[Parameter]) -> Parameter:
    """Return the parameter that records share: within the bounds of all of them."""
    first, (_, _, number) = members[0], label.partition("@")
    lower, upper = max(p.lower for p in members), min(p.upper for p in members)
    return replace(
        first, name=label, symbol=f"{first.symbol}@{number}" if number else first.symbol, lower=lower, upper=upper
    )


def whitening(error: FloatArray, level: float, order: int) -> FloatArray:
    """Return the taps that make a residual white and of level 1, (order + 1,).

    The prediction error of an autoregression (Yule-Walker): what is seen at frequencies where the noise is small counts
    for more (Cochrane and Orcutt 1949). A hundredth of the variance is taken to be white, so that nothing is made of
    what a low-pass took out.

    Args:
        error: (rows,) the residual of the record by itself, in the order of time.
        level: its level.
        order: of the autoregression; 0 for a mere weight.
    """
    lags = np.array([error[lag:] @ error[: error.size - lag] for lag in range(order + 1)])
    lags[0] *= 1.0 + _WHITE
    if not order or lags[0] <= 0.0:
        return np.array([1.0 / level])
    toeplitz = lags[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    taps = np.concatenate([[1.0], -np.linalg.solve(toeplitz, lags[1:])])
    return np.asarray(taps * np.linalg.norm(error) / (level * np.linalg.norm(filter_rows(taps, error))))


def at_rows(problem: ClosedLoopProblem, run: Simulation) -> tuple[FloatArray, FloatArray]:
    """Return the motor's position and velocity at the instants of the residual's rows, each (rows,)."""
    keep, samples = problem.filtering.decimation, run.motor_position.size
    assert keep is not None
    rows = slice((samples - 1) % keep, None, keep)  # the last sample is always kept
    return run.motor_position[rows], run.motor_velocity[rows]
