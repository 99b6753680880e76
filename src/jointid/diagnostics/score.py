"""Score test of each single fault, beside a solved problem's parameters.

The residual of the problem is regressed on the sensitivities of its free parameters and on the column of a fault: the
change of the filtered torque per unit of its size. The coefficient is that size. Before that, all go through the
prediction error filter of an autoregressive model of what no fault explains: plain least squares does not distinguish
the gains of a law from each other in a loop that shapes the noise.

The deviation is the autocorrelation-robust one of `uncertainty`, widened for a position-dependent residual, and scaled
to the residual before the fit, frequency by frequency. A fault is also compared with the sizes that simulated forces
and noise show: while friction holds the motor, a random force in the loop is no small noise of each row.

All tests of loop and log are one family, other laws a second, and the mechanics a third, at a tenth of the level:
p-values are multiplied by the number of its faults and shapes (Bonferroni). Faults whose columns are collinear, given
the joint's parameters, are one.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.errors import JointidError
from jointid.common.parameters import find_active_bounds
from jointid.diagnostics.model_free import excludes
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
from jointid.estimation.force_in_loop import find_force, simulate_errors
from jointid.estimation.parameters import surrounding
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.uncertainty.covariance import Influence, smoothed_spectrum
from jointid.uncertainty.model_tests import Filter, fit_whitener, whiteness
from jointid.uncertainty.position_dependent_error import Cells, uncertainty

LEVEL = 0.01  # of the tests of loop and log, and of those of other laws: together they err in 2 % of records
RARER = 10  # times as rarely as one of the loop, a fault of the mechanics is found where there is none
RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
_FORCES, _PUSHED = 32, 2.6  # independent ones: what they show is known to an eighth; deviations, of LEVEL
_LAWS = 7  # other laws of a controller, that are tested beside the faults
_AT_MOST = 0.5  # of a declared number: what a larger change of it shows is seen at this one

_RANK = 1e-10  # of the largest singular value of columns
_COLLINEAR = 1e-12  # of the square of a column: a smaller remainder beside the joint's parameters is rounding
_SAME = 0.999  # cosine of two collinear columns
_MORE = 1.2  # times the deviation: what 32 forces show is so much more in one of twenty by chance
_KEPT = 0.25  # of a frequency at least: what a fit takes nearly all of is not known from the remainder
_OF_WAVE = 2  # numbers of a wave of any phase
_WIDENED = 0.05  # a test with a larger p-value is not significant, however its deviation is widened


class _Step(NamedTuple):
    """A Gauss-Newton step along a signature with the best of its shapes.

    `alone` is its whitened column, (rows,), orthogonal to the other columns, and `gain` the decrease of the squared
    residual.
    """

    signature: FaultSignature
    size: float
    alone: FloatArray
    gain: float


def score(
    residual: FloatArray,
    own: FloatArray,
    signatures: Sequence[FaultSignature],
    declared: Mapping[Fault, float],
    where: Cells,
    by_forces: Callable[[], Sequence[FloatArray]] = tuple,
    fitted: tuple[FloatArray, FloatArray] | None = None,
    widened: float = _WIDENED,
    along_measured_motion: bool = False,
) -> tuple[FaultTest, ...]:
    """Test each fault alone, the strongest first of those that are significant.

    Regressing the parts orthogonal to the other columns is the regression on all columns (Frisch and Waugh).

    Args:
        residual: (rows,) of a solved problem, in the order of time.
        own: (rows, free) columns of its free parameters, and of faults already corrected.
        signatures: of all faults of all axes; their span is excluded from the noise.
        declared: value of each fault to be tested.
        where: cells of the rows.
        by_forces: returns residuals, (rows,) each, that random forces in the loop and noise would leave alone; called
            only where a test is significant.
        fitted: basis of the columns that are excluded instead, and what their fit takes of each frequency.
        widened: largest p-value of a test whose deviation is widened for a residual that repeats with the motion.
        along_measured_motion: whether the columns contain the loop's response to a force; deviations are then widened
            for the possible bias, like those of the estimate (`Influence.widen_for_motion`).
    """
    from scipy.stats import chi2, norm

    every, taken = fitted or _span(own, *(one.column for one in signatures))
    whiten = fit_whitener(_give_back(residual - every @ (every.T @ residual), taken))
    (basis, taken), error = _span(whiten(own)), whiten(residual)
    left = error - basis @ (basis.T @ error)
    best: dict[tuple[int, Fault], _Step] = {}
    shapes: Counter[tuple[int, Fault]] = Counter()
    for one in (one for one in signatures if one.fault in declared):
        key, step = (one.axis, one.fault), _step_along(one, whiten, basis, left)
        shapes[key] += max(one.fault.tried, 1)
        if key not in best or step.gain > best[key].gain:
            best[key] = step
    groups = _group_identical(best.values())
    of_mechanics = [group[0].signature.fault.mechanical for group in groups]

    @cache
    def simulate_forces() -> FloatArray:
        return np.array([whiten(one) for one in by_forces()])

    def test(group: Sequence[_Step]) -> FaultTest:
        (signature, size, column, _), fault = group[0], group[0].signature.fault
        alone, rest = column[:, np.newaxis], left - size * column
        after = _give_back(rest, taken + _span(alone)[1])
        influence = Influence(alone, after)
        same = tuple(other.signature.fault for other in group[1:] if other.signature.axis == signature.axis)
        family = of_mechanics.count(fault.mechanical) * (RARER if fault.mechanical else 1)
        tests = shapes[signature.axis, fault] * family

        def judge(std: float) -> FaultTest:
            ratio = size / std if std > 0 else 0.0
            tail = norm.sf(ratio) if fault.one_sided else 2 * norm.sf(abs(ratio))
            if fault.tried:  # a size that its coefficients make has no sign
                tail = chi2.sf(ratio**2, _OF_WAVE)
            p_value = min(float(tail) * tests, 1.0) if abs(size) >= fault.least else 1.0
            return FaultTest(fault, same, declared[fault], size, std, p_value, signature.shape, signature.axis)

        covariance = influence.robust()
        found = judge(float(covariance.std[0]))
        if found.p_value > widened:
            return found
        covariance = uncertainty(influence, where, covariance).covariance
        if along_measured_motion:
            covariance = Influence(alone, rest).widen_for_motion(covariance)
        found = judge(float(covariance.std[0]))
        if found.p_value > _WIDENED or not simulate_forces().size:
            return found
        # A spectrum shows the size of force and noise roughly, and with them the fault: the rest has their size.
        scale = float(np.linalg.norm(after) / np.linalg.norm(simulate_forces(), axis=1).mean())
        shown = simulate_forces() @ column / float(column @ column)
        spread = scale * float(np.sqrt(np.mean(shown**2)))
        # A fault of another kind may look like a force: so its size and its place among the significant stand.
        return replace(found, p_value=judge(spread).p_value) if spread > _MORE * found.std else found

    return rank_tests(map(test, groups), LEVEL)


def rank_tests(tests: Iterable[FaultTest], level: float) -> tuple[FaultTest, ...]:
    """Sort tests: significant ones by strength, then others by p-value."""
    return tuple(sorted(tests, key=lambda test: (max(test.p_value, level), -test.strength)))


def _span(*columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal basis of columns, and what their fit takes of each frequency."""
    basis = orthonormal_basis(np.column_stack(columns), _RANK)
    return basis, smoothed_spectrum(basis, len(basis))[0]


def _give_back(residual: FloatArray, taken: FloatArray) -> FloatArray:
    """Rescale a residual at each frequency to its size before the fit."""
    shares = np.concatenate([taken[:1], taken])
    return np.fft.irfft(np.fft.rfft(residual) / np.sqrt(np.maximum(1 - shares, _KEPT)), residual.size)


def _step_along(signature: FaultSignature, whiten: Filter, basis: FloatArray, left: FloatArray) -> _Step:
    """Step along a signature; `left`, (rows,), is orthogonal to `basis`."""
    column = whiten(signature.column)
    alone = column - basis @ (basis.T @ column)
    square = float(alone @ alone)
    # A column in the span of the joint's parameters is not identifiable.
    size = float(alone @ left) / square if square > _COLLINEAR * float(column @ column) else 0.0
    gain = 0.0 if signature.fault.one_sided and size < 0.0 else size**2 * square
    return _Step(signature, size, alone, gain)


def _group_identical(steps: Iterable[_Step]) -> list[list[_Step]]:
    ordered, groups = [*steps], dict[int, list[_Step]]()
    units = np.array([one.alone / max(float(np.linalg.norm(one.alone)), np.finfo(float).tiny) for one in ordered])
    same = np.abs(units @ units.T) > _SAME if ordered else np.zeros((0, 0))
    for i, step in enumerate(ordered):
        alike = [] if step.signature.fault.one_sided else [first for first in groups if same[i, first]]
        groups.setdefault(alike[0] if alike else i, []).append(step)
    return list(groups.values())


# Of a joint


@dataclass(frozen=True, eq=False)
class SolvedLoop:
    """A solved problem, and tests of the faults not named yet.

    Attributes:
        problem: of a joint's loop.
        x: (free,) its solution.
        std: standard errors of the joint's parameters by name, in which shifts are given.
        record: of the problem, None if no other law is searched for.
        proved: the declared loop, if its law makes the logged torque of the record's motor position.
        corrected: faults taken off the torque, for which the problem has no parameter.
        named: faults that are not tested again.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    std: Mapping[str, float] = field(default_factory=dict)
    record: Record | None = None
    proved: ClosedLoop | None = None
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()

    @cached_property
    def _shown(self) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
        """Residual, columns of free parameters, (rows, free), and signatures of all faults.

        Those of numbers of the law and the log are exact derivatives. A wrong ``drive_gain`` scales the whole record,
        and with it the joint, so it is not identifiable.
        """
        problem, x = self.problem, self.x
        taken = {p.name for p in problem.free}
        numbers = numbers_of(problem.loop.controller).items()  # a gain of 0 is a choice, not a fault
        apart = {fault.name for fault in FAULTS.values() if fault.columns and fault is not LOG_DELAY}
        wanted = [n for n, v in numbers if n == DELAY.name or (v and math.isfinite(v) and n not in apart)]
        of_log = () if any(problem.log.seen) else (LOG_GAIN.name, LOG_DELAY.name)  # no torque was logged
        # Of those that are collinear the first is named: a gain of the output is the last of them.
        names = sorted((name for name in (*wanted, *of_log) if name not in taken), key=lambda name: name == "gain")
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

    @cached_property
    def _every(self) -> tuple[FloatArray, FloatArray]:
        return _span(self.own, *(one.column for one in self.signatures))

    @cached_property
    def residual(self) -> FloatArray:
        """Residual of the problem, (rows,)."""
        return self.problem.residual(self.x)

    @property
    def signatures(self) -> tuple[FaultSignature, ...]:
        """Signatures of all faults."""
        return self._shown[2]

    @cached_property
    def own(self) -> FloatArray:
        """Columns of free parameters and corrected faults, (rows, columns)."""
        return np.column_stack([self._shown[1], *(one.column for one in self.corrected)])

    @property
    def _without_pushed(self) -> Iterator[FloatArray]:
        """Yield `own` without what a bound holds against the record, if anything: a fault may push there."""
        free, own, error = self.problem.free, self._shown[1], self.residual
        held, influence = find_active_bounds(free, self.x, error, own), Influence(own, error)
        push = np.abs(influence.matrix @ error) > _PUSHED * influence.robust().std
        if out := [k for k, p in enumerate(free) if p.name in held and push[k]]:
            yield np.delete(self.own, out, axis=1)

    @cached_property
    def _where(self) -> Cells:
        return self.problem.cells(self.problem.simulate(self.x))

    @cached_property
    def _forced(self) -> list[FloatArray]:
        """Residuals, (rows,), of simulated random forces and noise; none if white.

        A force colours the residual by the response of the loop. White noise alone may have a similar part of the
        spectrum.
        """
        problem, x, cutoff = self.problem, self.x, self.problem.filtering.cutoff
        step = problem.sample_time * (problem.filtering.decimation or 1)
        white = whiteness(self.residual, step, cutoff) if cutoff else None
        if white is not None and white.white:
            return []
        run = problem.simulate(x)
        force = find_force(problem, x, run, problem.measured - run.torque)
        return [] if force is None else [*simulate_errors(problem, x, force, _FORCES)]

    def _test(self, faults: Iterable[Fault]) -> tuple[FaultTest, ...]:
        controller, known = self.problem.loop.controller, {*self.named}
        declared = {
            fault: surrounding(fault.name, controller).start or 0.0 if fault.declared is None else fault.declared
            for fault in faults
            if not {fault.name, fault.kin} & known
        }
        for own in (self.own, *self._without_pushed):
            found = score(self.residual, own, self.signatures, declared, self._where, lambda: self._forced)
            if any(one.p_value <= LEVEL for one in found):
                break
        return found

    @cached_property
    def _all_tests(self) -> tuple[FaultTest, ...]:
        return self._test(one.fault for one in self.signatures)

    @cached_property
    def excluded(self) -> tuple[FaultTest, ...]:
        """Significant tests of faults that the motor position excludes."""
        return tuple(one for one in self._all_tests if one.p_value <= LEVEL and self._excludes(one))

    def _excludes(self, test: FaultTest) -> bool:
        """Test whether the motor position excludes a fault of this size."""
        if self.record is None or self.proved is None:
            return False
        controller, size = self.proved.controller, test.size
        if of_log := {LOG_GAIN: "gain", LOG_DELAY: "late"}.get(test.fault):
            return excludes(self.record, self.proved, controller, **{of_log: size})
        if (declared := numbers_of(controller).get(test.name)) is None or test.name == "limit":
            return False
        most = _AT_MOST * abs(declared) or abs(size)
        try:
            other = with_numbers(controller, {test.name: declared + max(-most, min(size, most))})
            return excludes(self.record, self.proved, other)
        except JointidError:  # no law has such a number
            return False

    @cached_property
    def tests(self) -> tuple[FaultTest, ...]:
        """Tests of the faults, likeliest first, unless excluded by the motor position."""
        return tuple(one for one in self._all_tests if one not in self.excluded)

    def test_law(self, fault: Fault, moved: FloatArray) -> FaultTest:
        """Test another law, which changes the torque by `moved`, (rows,)."""
        law, (every, taken) = [FaultSignature(fault, moved)], self._every
        beside, more = _span(moved - every @ (every.T @ moved))
        fitted = np.column_stack([every, beside]), taken + more
        (test,) = score(self.residual, self.own, law, {fault: 0.0}, self._where, lambda: self._forced, fitted)
        return replace(test, p_value=min((len(self.tests) + _LAWS) * test.p_value, 1.0))

    def list_alike(self, test: FaultTest) -> tuple[FaultTest, ...]:
        """Tests of the faults that no record distinguishes from this one."""
        return tuple(one for fault in test.alike for one in self._test([fault]) if not self._excludes(one))

    def list_rivals(self, test: FaultTest) -> tuple[FaultTest, ...]:
        """Significant tests of faults that are nearly as likely, and of those alike to them."""
        least = test.strength**2 - RIVAL
        found = [x for x in self.tests if x is not test and x.p_value <= LEVEL and x.strength**2 > least]
        return (*found, *(alike for one in found for alike in self.list_alike(one)))

    def shifts_to(self, *each: Mapping[str, float]) -> dict[str, ParameterShift]:
        """Return the shifts of the joint's parameters to other values, the largest of several."""
        found = {}
        for p, x in zip(self.problem.free_joint, self.x.tolist(), strict=False):
            by, std = max((values[p.name] - x for values in each), key=abs), self.std.get(p.name, 0.0)
            found[p.name] = ParameterShift(by, by / std if std > 0 else 0.0, p.name, self.problem.units[p.name])
        return found
