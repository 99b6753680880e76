"""Signatures of faults of loop and log: the change of the torque by each.

For a solved problem, each fault is one column, the derivative of the filtered torque by the size of the fault,
the joint's parameters held:

- numbers of the law (``kp``, ``kv``, ``gain``, ..., ``delay``), ``log_gain`` and ``log_delay``: exact derivatives;
- ``injected_gain``: the known signal is larger than the record says;
- ``offset``: a constant force, where the joint is declared without one;
- ``limit``: the law's output is cut off below its declared limit, at some shares of the largest torque it asks for;
- ``stribeck``: the motor's friction is larger by ``S exp(-(v / vs)^2)`` at low speed, for some vs: a force on the
  simulated motion, through the loop; ``presliding``: it is smaller by that.

A wrong ``drive_gain`` is none of them: it scales the whole record, and with it the joint, so it is not identifiable. A
gain that applies to one part only is: the law's (``gain``, ``kv``), the log's (``log_gain``), or that of a signal of
known size (``injected_gain``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of
from jointid.records.record import Tap
from jointid.simulation.loop_input import LoopInput, as_logged

STRIBECK, PRESLIDING, LIMIT, OFFSET, INJECTED_GAIN = "stribeck", "presliding", "limit", "offset", "injected_gain"
ONE_SIDED = (STRIBECK, PRESLIDING, LIMIT)
"""Faults whose size can only be positive."""

_SPEEDS = (0.02, 0.04, 0.08)  # of the largest speed: the Stribeck speeds that are tried
_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly
_STEP = 1e-4  # of the known signal


@dataclass(frozen=True, slots=True, eq=False)
class FaultSignature:
    """Change of the torque by one fault of loop or log.

    Attributes:
        name: of the fault.
        column: (rows,) derivative of the filtered torque by its size.
        shape: the level of a limit or a Stribeck speed that was tried; None where the fault has no shape.
        raw: (samples,) the column before the filter, where a problem has no parameter for the fault.
    """

    name: str
    column: FloatArray
    shape: float | None = None
    raw: FloatArray | None = None


def compute_signatures(
    problem: ClosedLoopProblem, x: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
    """Return the residual, the columns of the free parameters, (rows, free), and the signatures of all faults.

    Args:
        problem: solved; its free parameters are no faults.
        x: its parameters.
    """
    taken = {p.name for p in problem.free}
    names = [name for name in _list_differentiable(problem) if name not in taken]
    wider = problem.freeing(*names)
    bare = [p for p in wider.parameters if p.name == OFFSET and not p.free and (p.start or 0.0) == 0.0]
    if bare:
        wider = replace(wider, parameters=tuple(replace(p, free=True) if p in bare else p for p in wider.parameters))
    residual, slopes = wider.linearised(wider.vector(problem.values(x)))
    columns = dict(zip((p.name for p in wider.free), -slopes.T, strict=True))
    own = np.column_stack([columns[p.name] for p in problem.free])
    exact = [FaultSignature(name, columns[name]) for name in (*names, *(p.name for p in bare))]
    tried = [
        *exact,
        *_vary_injected_gain(problem, x),
        *_vary_low_speed_friction(problem, x),
        *([] if LIMIT in taken else _vary_limit(problem, x)),
    ]
    return residual, own, tuple(a for a in tried if np.linalg.norm(a.column) > 0)


def _list_differentiable(problem: ClosedLoopProblem) -> tuple[str, ...]:
    """Return the parameters of loop and log with exact derivatives; a gain of 0 is a choice, not a fault."""
    controller = problem.loop.controller
    numbers = [n for n, v in numbers_of(controller).items() if n == "delay" or (v and math.isfinite(v) and n != LIMIT)]
    return (*numbers, "log_gain", "log_delay")


def _vary_injected_gain(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signature of the injected signal's gain, where the signal is added after the limit."""
    if np.any(problem.experiment.after_limit):
        low, high = (problem.torque(x, partial(_scale_injection, by)) for by in (1 - _STEP, 1 + _STEP))
        raw = (high - low) / (2 * _STEP)
        yield FaultSignature(INJECTED_GAIN, problem.filtered(raw), raw=raw)


def _vary_low_speed_friction(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a friction that is larger, or smaller, at low speed."""
    velocity = problem.simulate(x).motor_velocity
    if velocity.size != problem.experiment.after_limit.size:
        return  # a force at the controller's instants needs the motion there
    for share in _SPEEDS:
        speed = share * float(np.max(np.abs(velocity), initial=0.0))
        if speed > 0:
            force = -np.exp(-((velocity / speed) ** 2)) * np.sign(velocity)
            raw = _simulate_force(problem, x, force)
            column = problem.filtered(raw)
            yield FaultSignature(STRIBECK, column, speed, raw)
            yield FaultSignature(PRESLIDING, -column, speed, -raw)


def _vary_limit(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of lower limits: the whole change of the torque, so a size of 1 is the limit itself."""
    if not hasattr(problem.loop.controller, LIMIT):
        return
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))
    asked, free = float(np.max(np.abs(output))), problem.torque(x)
    for share in _SHARES:
        level = share * asked
        if level < problem.experiment.law.limit:
            cut = problem.torque(x, partial(_apply_limit, level))
            yield FaultSignature(LIMIT, problem.filtered(cut - free), level)


def _simulate_force(problem: ClosedLoopProblem, x: FloatArray, force: FloatArray) -> FloatArray:
    """Return the change of the logged torque by a force on the motor, (periods,), that is not logged itself."""
    size = _FORCE * float(np.max(np.abs(problem.measured)))
    low, high = (problem.torque(x, partial(_apply_force, by * force)) for by in (-size, size))
    change = (high - low) / (2 * size)
    return change - as_logged(problem.experiment, force) if problem.experiment.tap is Tap.MEASURED else change


def _scale_injection(factor: float, experiment: LoopInput) -> LoopInput:
    after, logged = factor * experiment.after_limit, factor * experiment.logged
    return replace(experiment, after_limit=after, logged=logged)


def _apply_limit(level: float, experiment: LoopInput) -> LoopInput:
    return experiment.with_law(experiment.law.limited(level))


def _apply_force(force: FloatArray, experiment: LoopInput) -> LoopInput:
    return replace(experiment, after_limit=experiment.after_limit + force)
