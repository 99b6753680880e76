"""A solved problem of a joint in the search for its faults, with the tests of what it leaves."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.model_free import excludes
from jointid.diagnostics.score import LEVEL, score
from jointid.diagnostics.seen import see_loop
from jointid.diagnostics.suspects import (
    DELAY,
    FAULTS,
    LOG_DELAY,
    LOG_GAIN,
    Fault,
    FaultSignature,
    FaultTest,
    ParameterShift,
    list_signatures,
    number_fault,
)
from jointid.estimation.methods.force_in_loop import find_force, simulate_with_force
from jointid.estimation.parameters import surrounding
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.uncertainty.model_tests import whiteness
from jointid.uncertainty.position_dependent_error import Cells

MOST = 3
"""Faults of one axis, at most."""
RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
INTERVAL = 2.0  # deviations: half an interval
_FORCES = 32  # independent ones: the deviation of what they show is known to an eighth
_LAWS = 7  # other laws of a controller, that are tested beside the faults
_AT_MOST = 0.5  # of a declared number: what a larger change of it shows is seen at this one


@dataclass(frozen=True, eq=False)
class Tested:
    """A solved problem, and the tests of the faults that are not named yet.

    Attributes:
        problem: of a joint's loop.
        x: (free,) its solution.
        std: standard errors of the joint's parameters by name, in which shifts are given.
        record: of the problem, None if no other law is searched for.
        proved: the declared loop, if its law makes the logged torque of the record's motor position.
        corrected: faults taken off the torque, for which the problem has no parameter.
        named: faults that are not tested again.
        beside: the parameters, by name, as they are beside the last fault, where a law of the joint has it.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    std: Mapping[str, float] = field(default_factory=dict)
    record: Record | None = None
    proved: ClosedLoop | None = None
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()
    beside: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def _shown(self) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
        return compute_signatures(self.problem, self.x)

    @property
    def residual(self) -> FloatArray:
        """Residual of the problem, (rows,)."""
        return self._shown[0]

    @property
    def signatures(self) -> tuple[FaultSignature, ...]:
        """Signatures of all faults."""
        return self._shown[2]

    @cached_property
    def own(self) -> FloatArray:
        """Columns of the free parameters and of the faults that are corrected, (rows, columns)."""
        return np.column_stack([self._shown[1], *(one.column for one in self.corrected)])

    @cached_property
    def _where(self) -> Cells:
        return self.problem.cells(self.problem.simulate(self.x))

    @cached_property
    def _forced(self) -> list[FloatArray]:
        """Residuals, (rows,), of random forces and noise like those of the record; none of a white residual.

        A force colours the residual by the answer of the loop. The spectrum of white noise alone has a part that looks
        so.
        """
        problem, x, cutoff = self.problem, self.x, self.problem.filtering.cutoff
        step = problem.sample_time * (problem.filtering.decimation or 1)
        white = whiteness(self.residual, step, cutoff) if cutoff else None
        if white is not None and white.white:
            return []
        run = problem.simulate(x)
        force = find_force(problem, x, run, problem.measured - run.torque)
        if force is None:
            return []
        random = np.random.default_rng(1)
        return [
            problem.filter(one - run.torque + force.noise * random.standard_normal(one.size))
            for one in simulate_with_force(problem, x, force, _FORCES, (1.0,))
        ]

    @cached_property
    def _all_tests(self) -> tuple[FaultTest, ...]:
        controller, known = self.problem.loop.controller, {*self.named}
        declared = {
            fault: surrounding(fault.name, controller).start or 0.0 if fault.declared is None else fault.declared
            for fault in dict.fromkeys(one.fault for one in self.signatures)
            if not {fault.name, fault.kin} & known
        }
        return score(self.residual, self.own, self.signatures, declared, self._where, lambda: self._forced)

    @cached_property
    def excluded(self) -> tuple[FaultTest, ...]:
        """Significant tests of faults that the motor position excludes."""
        record, loop = self.record, self.proved
        if record is None or loop is None:
            return ()
        return tuple(one for one in self._all_tests if one.p_value <= LEVEL and excludes_fault(record, loop, one))

    @cached_property
    def tests(self) -> tuple[FaultTest, ...]:
        """Tests of the faults, the likeliest first, without those that the motor position excludes."""
        return tuple(one for one in self._all_tests if one not in self.excluded)

    @property
    def values(self) -> dict[str, float]:
        """The parameters by name, with the last fault corrected."""
        return {**self.problem.values(self.x), **self.beside}

    def test_law(self, fault: Fault, moved: FloatArray) -> FaultTest:
        """Return the test of another law, which moves the torque by `moved`, (rows,), beside the faults."""
        signatures = [*self.signatures, FaultSignature(fault, moved, raw=np.zeros(0))]
        test = score(self.residual, self.own, signatures, {fault: 0.0}, self._where, lambda: self._forced)[0]
        return replace(test, p_value=min((len(self.tests) + _LAWS) * test.p_value, 1.0))

    def list_rivals(self, test: FaultTest) -> tuple[FaultTest, ...]:
        """Return the significant tests of other faults that are not far less likely."""
        least = test.strength**2 - RIVAL
        likely = (one for one in self.tests if one.p_value <= LEVEL and one.strength**2 > least)
        return tuple(one for one in likely if one is not test)

    def shifts_to(self, values: Mapping[str, float]) -> dict[str, ParameterShift]:
        """Return the shifts of the joint's parameters to other values."""
        found = {}
        for p, x in zip(self.problem.free_joint, self.x.tolist(), strict=False):
            by, std = values[p.name] - x, self.std.get(p.name, 0.0)
            found[p.name] = ParameterShift(by, by / std if std > 0 else 0.0, p.symbol, self.problem.units[p.name])
        return found


def compute_signatures(
    problem: ClosedLoopProblem, x: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
    """Return the residual, the columns of the free parameters, (rows, free), and the signatures of all faults.

    Those of numbers of the law and the log are exact derivatives. A wrong ``drive_gain`` scales the whole record, and
    with it the joint, so it is not identifiable.
    """
    taken = {p.name for p in problem.free}
    numbers = numbers_of(problem.loop.controller).items()  # a gain of 0 is a choice, not a fault
    apart = {fault.name for fault in FAULTS.values() if fault.columns and fault is not LOG_DELAY}
    wanted = [n for n, v in numbers if n == DELAY.name or (v and math.isfinite(v) and n not in apart)]
    of_log = () if any(problem.log.seen) else (LOG_GAIN.name, LOG_DELAY.name)  # no torque was logged
    names = [name for name in (*wanted, *of_log) if name not in taken]
    wider = problem.freeing(*names)
    residual, slopes = wider.linearise(wider.vector(problem.values(x)))
    columns = dict(zip((p.name for p in wider.free), -slopes.T, strict=True))
    own = np.column_stack([columns[p.name] for p in problem.free])
    along = list_signatures(see_loop(problem, x, residual, own))
    found = [
        *(FaultSignature(number_fault(name), columns[name]) for name in names),
        *(replace(one, column=problem.filter(one.column)) for one in along),
    ]
    return residual, own, tuple(a for a in found if np.linalg.norm(a.column) > 0)


def excludes_fault(record: Record, loop: ClosedLoop, test: FaultTest) -> bool:
    """Test whether a record's motor position excludes a fault of this size of a loop whose law holds."""
    controller, size = loop.controller, test.size
    if test.fault in (LOG_GAIN, LOG_DELAY):
        return excludes(record, loop, controller, **{"gain" if test.fault is LOG_GAIN else "late": size})
    if (declared := numbers_of(controller).get(test.name)) is None or test.name == "limit":
        return False
    most = _AT_MOST * abs(declared) or abs(size)
    try:
        other = with_numbers(controller, {test.name: declared + max(-most, min(size, most))})
        return excludes(record, loop, other)
    except JointidError:  # no law has such a number
        return False
