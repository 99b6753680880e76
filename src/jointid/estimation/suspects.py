"""Is the loop as declared, and what is wrong with this record? Each alternative tested alone, the likeliest named.

With J the sensitivities of the free parameters and c the column of an alternative (`alternatives`), the residual e of a
solved problem is regressed on both: one Gauss-Newton step from where nothing is wrong. Its last coefficient is the size
of the fault, and its ratio to its deviation the statistic t.

Before that, e, J and c go through one filter that makes the residual nearly white: the prediction error of an
autoregressive model of the residual (order 16). So the statistic is nearly that of the likelihood, which tells kp from
kv or a gain of the log where plain least squares, in a loop that shapes the noise, does not. The model need not be
right: the deviation is the autocorrelation-robust one of `uncertainty`, widened for what repeats with the motion.

All tests of a record together are one family: p-values are multiplied by the number of suspects, and of shapes tried
for one (Bonferroni), so that of records with nothing wrong at most 5 % are suspected at all. The largest statistic is
named; what is nearly as likely, by the ratio of the likelihoods, is named with it. Then the problem is solved again
with the fault taken in, and what is left is tested again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import silent
from jointid.data.record import FloatArray
from jointid.estimation.alternatives import (
    INJECTED_GAIN,
    LIMIT,
    OFFSET,
    ONE_SIDED,
    PRESLIDING,
    STRIBECK,
    Alternative,
    sensitivities,
)
from jointid.estimation.descent import Descent, refined
from jointid.estimation.loopcheck import Change, Finding, LoopCheck, Suspect
from jointid.estimation.problem import Problem
from jointid.estimation.repeatable import Cells, by_place, cells, repeatable
from jointid.estimation.surroundings import surrounding, with_numbers
from jointid.estimation.uncertainty import larger, robust
from jointid.model.parameters import Quantity, unit_of

_ORDER, _FLOOR = 16, 1e-2  # of the autoregressive model; of its variance, white: a stop band is not to be blown up
_RANK = 1e-10  # of the largest singular value of columns
_SAME = 0.999  # the cosine of two columns that are one
_LAST = ("gain", INJECTED_GAIN)  # whose fault it is called only where it is not also another's
_NEARLY = 6.0  # twice the logarithm of a likelihood ratio of 20
_WIDENED = 0.05  # a test with a larger p-value names nothing, however wide its interval
_TOLERANCE = 1e-6  # of the refinement with a fault taken in: far below a deviation

Filter: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class LoopTests:
    """Settings of the check of a loop.

    Attributes:
        level: the share of records with nothing wrong in which something is suspected, at most.
        most: faults named at most, one after another.
        suspects: names of those to test; all that a record can have when None.
    """

    level: float = 0.05
    most: int = 3
    suspects: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not (0 < self.level < 1 and self.most >= 1):
            raise MethodError(
                f"A check has a level between 0 and 1 and names at least 1 fault; received {self.level} and "
                f"{self.most}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A solved problem as the tests see it.

    `beside` are faults taken in that no parameter of the problem stands for; `named` are all names that are settled.
    """

    problem: Problem
    x: FloatArray
    beside: tuple[Alternative, ...] = ()
    named: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Tested:
    """The residual and the columns of a state, (rows, ...), its alternatives, and their tests, the likeliest first."""

    residual: FloatArray
    own: FloatArray
    alternatives: tuple[Alternative, ...]
    suspects: tuple[Suspect, ...]

    def column(self, suspect: Suspect) -> FloatArray:
        """Return the column a suspect was tested with."""
        return next(a.column for a in self.alternatives if (a.name, a.shape) == (suspect.name, suspect.shape))


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """An alternative taken in by one step: its size, what the residual loses by it, and its column without the rest."""

    alternative: Alternative
    shapes: int
    size: float
    gain: float
    alone: FloatArray


def suspected(problem: Problem, x: FloatArray, settings: LoopTests | None = None) -> LoopCheck:
    """Return what of a loop and its log is not as declared.

    Args:
        problem: with what was identified free; what is free is not suspected.
        x: (free,) where it was solved.
        settings: see `LoopTests`.

    Raises:
        MethodError: no suspect has one of the names asked for.
    """
    settings = settings or LoopTests()
    state = _State(problem, np.asarray(x, dtype=np.float64))
    findings: list[Finding] = []
    first: tuple[Suspect, ...] | None = None
    while len(findings) < settings.most:
        tested = _tested(state, settings)
        first = tested.suspects if first is None else first
        if not tested.suspects or tested.suspects[0].p_value > settings.level:
            break
        after = _taken_in(state, tested)
        findings.append(_finding(state, after, tested, settings.level))
        state = after
    joint = problem.loop.joint
    units = {p.name: joint.unit(p) for p in joint.parameters}
    force = units[OFFSET]
    units |= {"torque": force, "velocity": unit_of(Quantity.VELOCITY, joint.kind, force)}
    symbols = {p.name: p.symbol for p in joint.parameters}
    return LoopCheck(tuple(findings), first or (), settings.level, symbols, units)


def _tested(state: _State, settings: LoopTests) -> _Tested:
    """Test every alternative of a state, each alone."""
    residual, own, alternatives = sensitivities(state.problem, state.x)
    known = dict.fromkeys(a.name for a in alternatives)
    wrong = [name for name in settings.suspects or () if name not in (*known, *state.named)]
    if wrong:
        raise MethodError(
            f"No suspect of this record is called {', '.join(wrong)}; those that can be tested are {', '.join(known)}."
        )
    asked = [n for n in known if n not in state.named and (settings.suspects is None or n in settings.suspects)]
    whiten = whitener(_noise(state, residual, own, alternatives))
    basis, error = _basis(whiten(_own(state, own))), whiten(residual)
    left = error - basis @ (basis.T @ error)
    steps = [_best([a for a in alternatives if a.name == name], whiten, basis, left) for name in asked]
    groups = _grouped(steps)
    suspects = [_judged(state, group, left, len(groups)) for group in groups]
    return _Tested(residual, own, alternatives, tuple(sorted(suspects, key=lambda s: -_strength(s))))


def _noise(state: _State, residual: FloatArray, own: FloatArray, alternatives: Sequence[Alternative]) -> FloatArray:
    """Return the residual without all that any of the alternatives could explain: a fault is no noise."""
    columns = np.column_stack([_own(state, own), *(a.column for a in alternatives)])
    return _without(columns, residual)


def _without(columns: FloatArray, signal: FloatArray) -> FloatArray:
    """Return a signal less its regression on columns that may be collinear."""
    basis = _basis(columns)
    return np.asarray(signal - basis @ (basis.T @ signal))


def _basis(columns: FloatArray) -> FloatArray:
    norms = np.linalg.norm(columns, axis=0)
    left, sizes, _ = np.linalg.svd(columns / np.where(norms > 0, norms, 1.0), full_matrices=False)
    return np.asarray(left[:, sizes > _RANK * sizes[0]])


def whitener(residual: FloatArray) -> Filter:
    """Return the filter that makes a residual nearly white, of signals (rows,) or (rows, columns) alike.

    It is the prediction error of an autoregressive model of order 16, by Yule and Walker, of the residual with 1 % of
    its variance added as white noise.

    Args:
        residual: (rows,), in the order of time.
    """
    from scipy.linalg import solve_toeplitz
    from scipy.signal import lfilter

    rows = residual.size
    order = min(_ORDER, rows // 4)
    products = np.array([residual[lag:] @ residual[: rows - lag] for lag in range(order + 1)]) / rows
    if not products[0] > 0:
        return lambda signals: signals
    products[0] *= 1 + _FLOOR
    weights = solve_toeplitz(products[:-1], products[1:])
    scale = math.sqrt(products[0] - weights @ products[1:])
    taps = np.concatenate([[1.0], -weights]) / scale
    return lambda signals: np.asarray(lfilter(taps, [1.0], signals, axis=0))


def _own(state: _State, own: FloatArray) -> FloatArray:
    return np.column_stack([own, *(a.column for a in state.beside)])


def _best(shapes: Sequence[Alternative], whiten: Filter, basis: FloatArray, left: FloatArray) -> _Step:
    """Return the step with the shape of an alternative that takes most from the residual.

    `basis`, (rows, rank), is that of the other columns, `left`, (rows,), what they leave of the residual.
    """
    steps = []
    for alternative in shapes:
        column = whiten(alternative.column)
        alone = column - basis @ (basis.T @ column)
        square = float(alone @ alone)
        # What the joint's parameters do as well is no fault that shows.
        size = float(alone @ left) / square if square > 1e-12 * float(column @ column) else 0.0
        gain = size * size * square if size > 0 or alternative.name not in ONE_SIDED else 0.0
        steps.append(_Step(alternative, len(shapes), size, gain, alone))
    return max(steps, key=lambda step: step.gain)


def _grouped(steps: Sequence[_Step]) -> list[list[_Step]]:
    """Return the steps, those together whose columns are one."""
    groups: list[list[_Step]] = []
    for step in sorted(steps, key=lambda step: step.alternative.name in _LAST):
        size = float(np.linalg.norm(step.alone))
        for group in groups:
            other = group[0].alone
            if step.alternative.name not in ONE_SIDED and abs(float(step.alone @ other)) > _SAME * size * float(
                np.linalg.norm(other)
            ):
                group.append(step)
                break
        else:
            groups.append([step])
    return groups


def _judged(state: _State, group: Sequence[_Step], left: FloatArray, family: int) -> Suspect:
    """Return the test of an alternative, by its size and the autocorrelation-robust deviation of that.

    A regression of what the other columns leave of both is the regression on all of them (Frisch and Waugh).
    """
    from scipy.stats import norm

    step = group[0]
    a, alone = step.alternative, step.alone[:, np.newaxis]
    after = left - step.size * step.alone
    covariance = robust(alone, alone, after)

    def chance(std: float) -> float:
        ratio = step.size / std if std > 0 else 0.0
        tail = norm.sf(ratio) if a.name in ONE_SIDED else 2 * norm.sf(abs(ratio))
        return min(float(tail) * step.shapes * family, 1.0)

    if chance(covariance.std[0]) <= _WIDENED:
        where = _cells(state)
        if repeatable(after, where).significant:
            covariance = larger(covariance, by_place(alone, alone, after, where))
    std = float(covariance.std[0])
    statistic, p_value = step.size / std if std > 0 else 0.0, chance(std)
    alike = tuple(other.alternative.name for other in group[1:])
    return Suspect(a.name, alike, _declared(state, a.name), step.size, std, statistic, p_value, a.shape)


def _cells(state: _State) -> Cells:
    """Return where and how the axis was at each row."""
    run = state.problem.simulate(state.x)
    motion = state.problem.filtered(np.column_stack([run.motor_position, run.motor_velocity]))
    return cells(motion[:, 0], motion[:, 1])


def _strength(suspect: Suspect) -> float:
    """Return how much a suspect explains: its statistic, of one that can only be positive nothing below 0."""
    return max(suspect.statistic, 0.0) if suspect.name in ONE_SIDED else abs(suspect.statistic)


def _declared(state: _State, name: str) -> float:
    if name in (STRIBECK, PRESLIDING, LIMIT, OFFSET):
        return 0.0
    return 1.0 if name == INJECTED_GAIN else surrounding(name, state.problem.loop.controller).start or 0.0


def _taken_in(state: _State, tested: _Tested) -> _State:
    """Return the state with the likeliest fault taken in: its parameter free and the problem solved again.

    Where no parameter stands for it, or its search leads nowhere better, its column is set beside those of the joint.
    """
    suspect, problem = tested.suspects[0], state.problem
    named = (*state.named, suspect.name, *suspect.alike)
    beside = Alternative(suspect.name, tested.column(suspect), suspect.shape)
    if suspect.name not in (STRIBECK, PRESLIDING, INJECTED_GAIN):
        wider, start = _freed(problem, suspect)
        begin = wider.vector(problem.values(state.x) | {suspect.name: start})
        descent = Descent(wider, silent)
        x = np.asarray(refined(descent, begin, _TOLERANCE).x)
        if np.linalg.norm(wider.residual(x)) < np.linalg.norm(tested.residual):
            return _State(wider, x, state.beside, named)
    return _State(problem, state.x, (*state.beside, beside), named)


def _freed(problem: Problem, suspect: Suspect) -> tuple[Problem, float]:
    """Return the problem with a suspect free, and where that begins."""
    start = suspect.declared + suspect.size
    if suspect.name == OFFSET:
        parameters = tuple(replace(p, free=p.free or p.name == OFFSET) for p in problem.parameters)
        return replace(problem, parameters=parameters), start
    if suspect.name == LIMIT:  # what is declared may be infinite, where no search can begin
        start = (suspect.shape or 0.0) / getattr(problem.loop.controller, "gain", 1.0)
        loop = with_numbers(problem.loop, {LIMIT: start})
        law = loop.controller.law(problem.experiment.sample_time)
        problem = replace(problem, loop=loop, experiment=problem.experiment.with_law(law))
    wider = problem.freeing(suspect.name)
    p = next(p for p in wider.parameters if p.name == suspect.name)
    return wider, max(start, p.lower)


def _finding(state: _State, after: _State, tested: _Tested, level: float) -> Finding:
    suspect = tested.suspects[0]
    best = _strength(suspect) ** 2
    rivals = tuple(s.words for s in tested.suspects[1:] if s.p_value <= level and best - _strength(s) ** 2 < _NEARLY)
    own = _own(state, tested.own)
    names = [p.name for p in state.problem.free_joint]
    std = robust(own, own, tested.residual).std
    if after.beside == state.beside:
        found = after.problem.values(after.x)
        value: float | None = found[suspect.name]
        moved = np.array([found[name] for name in names]) - state.x[: len(names)]
    else:
        value = None
        both = np.column_stack([own, tested.column(suspect)])
        norms = np.where((sizes := np.linalg.norm(both, axis=0)) > 0, sizes, 1.0)
        steps = [np.linalg.lstsq(J, tested.residual, rcond=1e-10)[0] for J in (both / norms, own / norms[:-1])]
        moved = ((steps[0][:-1] - steps[1]) / norms[:-1])[: len(names)]
    changes = {
        name: Change(float(by), float(by / s) if s > 0 else 0.0)
        for name, by, s in zip(names, moved, std[: len(names)], strict=True)
    }
    if value is None:
        return Finding(suspect, None, rivals, changes)
    if suspect.name == LIMIT:
        return Finding(suspect, value * getattr(state.problem.loop.controller, "gain", 1.0), rivals, changes)
    slopes = _own(after, after.problem.linearised(after.x)[1])
    at = [p.name for p in after.problem.free].index(suspect.name)
    refined_std = float(robust(slopes, slopes, after.problem.residual(after.x)).std[at])
    return Finding(replace(suspect, size=value - suspect.declared, std=refined_std), value, rivals, changes)
