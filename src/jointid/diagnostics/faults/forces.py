"""Forces and signals that are not declared: an offset, an injected signal, a limit of the output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import number, pluralise
from jointid.diagnostics.faults.fault import Fault, FaultSignature, FaultTest, Measure, words
from jointid.diagnostics.faults.findings import Finding, LoopCheck
from jointid.diagnostics.faults.numbers import describe_number
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import with_numbers
from jointid.records.record import Record, Tap
from jointid.uncertainty.verdict import Reason

_STEP = 1e-4  # of the known signal
_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_FEWEST = 12  # steps of an injected signal
_CLEAR = 10.0  # times the median change of a sample: so large is a step
_LARGE = 0.03  # of the torque's scatter: a smaller step is of no interest
_ALONE = 0.3  # of a step: so much the samples before and after it may change
_ROUNDED = 5  # times the smallest change of a sample, which is that of its rounding
_RESTS, _OFTEN = 1e-3, 0.02  # of the greatest speed, and of the samples: where a reference asks for nothing
_AS_OFTEN = 1 / 3  # as all over the record they are where the reference rests, if it does
_OWN = 0.5  # of their squares: so much of the steps is none of the reference's velocity, acceleration and direction


def _describe_offset(finding: Finding, check: LoopCheck, spread: bool) -> str:
    s = finding.test
    size = s.show_size(check.on_side("torque"), spread=spread)
    signed = f"of {'-' if s.size < 0 else ''}{size}" if size else ""
    return words("a constant", "torque" if check.units["position"] == "rad" else "force", signed, "is not declared")


def _free_offset(problem: ClosedLoopProblem, test: FaultTest) -> tuple[ClosedLoopProblem, float]:
    freed = {p.name: replace(p, free=True) for p in problem.parameters if p.name == OFFSET.name}
    return problem.changed(freed), test.declared + test.size


OFFSET = Fault("offset", "constant force", describe=_describe_offset, measure=Measure.TORQUE, free=_free_offset)
"""A constant force, where the joint is declared without one."""


def _vary_injected_gain(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signature of the injected signal's gain, where the signal is added after the limit."""
    if not np.any(problem.experiment.after_limit):
        return

    def scaled(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    raw = (scaled(1 + _STEP) - scaled(1 - _STEP)) / (2 * _STEP)
    yield FaultSignature(INJECTED_GAIN, problem.filtered(raw), raw=raw)


INJECTED_GAIN = Fault(
    "injected_gain", "size of the injected signal", "the injected signal", describe_number, vary=_vary_injected_gain,
    declared=1.0, last=True,
)  # fmt: skip


def _vary_limit(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of lower limits: the whole change of the torque, so a size of 1 is the limit itself."""
    free = any(p.name == LIMIT.name for p in problem.free)
    if free or not hasattr(problem.loop.controller, LIMIT.name):
        return
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))
    asked, unlimited = float(np.max(np.abs(output))), problem.torque(x)

    def limited(level: float) -> FloatArray:
        return problem.torque(x, lambda e: e.with_law(e.law.with_limit(level)))

    for share in _LEVELS:
        level = share * asked
        if level < problem.experiment.law.limit:
            yield FaultSignature(LIMIT, problem.filtered(limited(level) - unlimited), level)


def _torque_per_unit(problem: ClosedLoopProblem) -> float:
    """Return the torque on the joint per unit of the controller output."""
    controller = problem.loop.controller
    return float(getattr(controller, "gain", 1.0) * abs(getattr(controller, "ratio", 1.0)))


def _free_limit(problem: ClosedLoopProblem, test: FaultTest) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with a limit: the declared one may be infinite, where no search can begin."""
    start = (test.shape or 0.0) / _torque_per_unit(problem)
    loop = replace(problem.loop, controller=with_numbers(problem.loop.controller, {LIMIT.name: start}))
    law = problem.experiment.law_of(loop.controller)
    problem = replace(problem, loop=loop, experiment=problem.experiment.with_law(law))
    return free_number(problem, LIMIT.name, start)


def free_number(problem: ClosedLoopProblem, name: str, start: float) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with a number of the loop free, and a start that it can have."""
    wider = problem.freeing(name)
    lower = next(p.lower for p in wider.parameters if p.name == name)
    return wider, max(start, lower)


LIMIT = Fault(
    "limit", "limit of the controller's output", vary=_vary_limit, one_sided=True,
    describe=lambda finding, check, _: "the controller's output stops at "
    f"{number(finding.value or finding.test.shape, 4)} {check.on_side('torque')}, which is not declared",
    measure=Measure.SHARE, free=_free_limit, value=lambda problem, value: value * _torque_per_unit(problem),
)  # fmt: skip

INJECTED = Fault("injected", "signal that is not declared")

FAULTS = (OFFSET, INJECTED_GAIN, INJECTED)


def find_steps(record: Record) -> Message | None:
    """Return that a signal is injected that is not declared, where the torque makes steps of its own; else None.

    A step is a change in one sample between two in which hardly anything changes; those of a controller that runs
    slower than the log, or of a reference in steps, follow from the reference, and are not there where that rests.
    """
    torque, reference = record.torque, record.reference
    assert torque is not None
    assert reference is not None
    if record.injected is not None or torque.values.size < 2 * _FEWEST:
        return None
    signed = np.diff(torque.values)
    change = np.abs(signed)
    if not np.any(change):
        return None
    rounding = float(np.min(change[change > 0]))
    bound = max(_CLEAR * float(np.median(change)), _ROUNDED * rounding, _LARGE * float(np.std(torque.values)))
    here = change[1:-1]
    steps = (here > bound) & (np.maximum(change[:-2], change[2:]) < _ALONE * here)
    velocity = np.gradient(reference.values, reference.sample_time)
    asked = np.column_stack([velocity, np.gradient(velocity), np.sign(velocity)])
    asked = np.column_stack([np.interp(torque.time, reference.time, one)[1:-2] for one in asked.T])
    rests = np.abs(asked[:, 0]) < _RESTS * np.max(np.abs(velocity))
    count = int(np.sum(steps))
    if count < _FEWEST:
        return None
    if np.mean(rests) > _OFTEN and np.mean(steps[rests]) < _AS_OFTEN * np.mean(steps):
        return None
    sizes, by = signed[1:-1][steps], asked[steps] / np.maximum(np.max(np.abs(asked), axis=0), np.finfo(float).tiny)
    own = sizes - by @ np.linalg.lstsq(by, sizes, rcond=None)[0]
    if own @ own < _OWN * (sizes @ sizes):
        return None
    clause = (
        f"a signal is injected that is not declared (channel injected): the torque makes {pluralise(count, 'step')} "
        "that the reference does not ask for"
    )
    values: dict[str, Any] = {"causes": [{"cause": INJECTED.name, "value": count, "error": None}]}
    return Message(Reason.CAUSE_FOUND, clause, values, clause)
