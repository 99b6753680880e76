"""Alternatives to an identified delay.

A delay turns the phase of a loop, as do a filter of velocity or torque, another derivative gain, and a spring behind
the motor. So an identified delay is held at what is declared, each of these is freed in its place, and the joint is
solved for again. The J test of two laws (`faults.other_laws`) decides: the residual is regressed on the change of the
torque, whose coefficient is 0 with the delay, and 1 without. What the record does not exclude is said, and the
intervals hold the shifts of the parameters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.diagnostics.fault_tests import score_signatures
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Hypothesis, milliseconds
from jointid.diagnostics.faults.numbers import DELAY, TORQUE_FILTER, VELOCITY_FILTER, number_fault
from jointid.diagnostics.faults.other_laws import under
from jointid.diagnostics.faults.record import FLEXIBLE
from jointid.diagnostics.hypothesis_fits import fit_flexible
from jointid.diagnostics.search_state import RIVAL
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.assemble import Widening
from jointid.models.controllers import FirstOrder, numbers_of
from jointid.models.joints import FlexibleJoint, RigidJoint, of_whole
from jointid.records.record import Record
from jointid.uncertainty.covariance import robust
from jointid.uncertainty.position_dependent_error import cells

_SOLVED = 1e-5  # far below a deviation
_SHOWN = 2.0  # deviations: a delay that may be none stands for nothing
_GAIN = "derivative_gain"
_TIMES = {VELOCITY_FILTER: "velocity_filter.time_constant", TORQUE_FILTER: "torque_filters.0.time_constant"}


def compare_with_delay(
    problem: ClosedLoopProblem, x: FloatArray, record: Record
) -> tuple[list[Widening], dict[str, str]]:
    """Return the shifts by alternatives to an identified delay, and the excluded ones.

    The latter are clauses by the names of the faults. Both are empty without a free delay.

    Args:
        problem: of a joint.
        x: (free,) its solution.
        record: of the problem.
    """
    moved, said, excluded, better = dict[str, float](), list[str](), dict[str, str](), False
    if DELAY.name not in (p.name for p in problem.free):
        return [], excluded
    values, (residual, slopes), run = problem.values(x), problem.linearise(x), problem.simulate(x)
    at = [p.name for p in problem.free].index(DELAY.name)
    if values[DELAY.name] < _SHOWN * robust(slopes, slopes, residual).std[at]:
        return [], excluded
    own = np.delete(-slopes, at, axis=1)  # without the delay, in whose place the others are
    where = problem.filter(np.column_stack([run.motor_position, run.motor_velocity]))
    for fault, other, end in _solve_others(problem, values, record):
        signature = FaultSignature(fault, residual - other.residual(end), raw=np.zeros(0))
        (test,) = score_signatures(
            residual, own, [signature], {fault: 0.0}, lambda: cells(where[:, 0], where[:, 1]), widened=1.0
        )
        likelier = (2 * test.size - 1) / test.std**2 if test.std > 0 else -np.inf
        if likelier <= -RIVAL:
            excluded[fault.name] = "a spring" if fault is FLEXIBLE else f"a {fault.title}"
            continue
        there = other.values(end)
        whole = {p.name: of_whole(p, there) for p in problem.free_joint if p.name not in there}
        off = {name: abs(one - values[name]) for name, one in (there | whole).items() if name in values}
        off |= {DELAY.name: values[DELAY.name]}
        moved = {name: max(one, moved.get(name, 0.0)) for name, one in off.items()}
        better = better or likelier > RIVAL
        said.append(_describe(fault, there, problem))
    if not said:
        return [], excluded
    why = " or ".join(said)
    delay = f"the delay of {milliseconds(values[DELAY.name])} ms"
    words = (
        f"{why} explains the record better than {delay}" if better else f"{why} explains the record as well as {delay}"
    )
    words += ": declare the one that the drive has"
    by = {name: 0.5 * one for name, one in moved.items()}  # two deviations hold it
    return [Widening(by, words)], excluded


def _solve_others(
    problem: ClosedLoopProblem, values: Mapping[str, float], record: Record
) -> Iterator[tuple[Fault, ClosedLoopProblem, FloatArray]]:
    """Yield each fault, the problem with it in the place of the delay, and its solution, (free,)."""
    law: Any = problem.loop.controller
    without = replace(problem, parameters=tuple(p for p in problem.parameters if p.name != DELAY.name))
    size, others = max(values[DELAY.name], problem.experiment.law.period), dict[Fault, ClosedLoopProblem]()
    if getattr(law, "velocity_filter", None) == (1.0,):
        others[VELOCITY_FILTER] = under(without, replace(law, velocity_filter=FirstOrder(size)))
    if getattr(law, "torque_filters", None) == ():
        others[TORQUE_FILTER] = under(without, replace(law, torque_filters=(FirstOrder(size),)))
    if numbers_of(law).get(_GAIN):
        others[number_fault(_GAIN)] = without
    for fault, other in others.items():
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # a loop that is unstable with it
            wider = other.freeing(_TIMES.get(fault, fault.name))
            yield fault, wider, descend(wider, wider.vector(values), _SOLVED).x
    if isinstance(problem.joint, RigidJoint):
        loop = replace(problem.loop, joint=problem.joint.flexible)
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):
            for fit in fit_flexible((Hypothesis(None, record, (loop,), problem.filtering),), loop)[:1]:
                yield FLEXIBLE, fit.problem, descend(fit.problem, fit.x, _SOLVED).x


def _describe(fault: Fault, values: Mapping[str, float], problem: ClosedLoopProblem) -> str:
    """Describe an alternative to a delay, with its size."""
    if fault is FLEXIBLE:
        return f"a spring with its mode near {number(FlexibleJoint.frequencies(values)['free_free'], 2)} Hz"
    if fault in _TIMES:
        return f"a {fault.title} of {milliseconds(values[_TIMES[fault]])} ms"
    times = values[fault.name] / numbers_of(problem.loop.controller)[fault.name]
    return f"a {fault.title} {number(times, 2)} times as large"
