"""Signatures of faults of loop and log, and the score test of each alone, and of those of `mechanics_faults`.

For a solved problem, the signature of a fault is one column, the derivative of the filtered torque by the size of the
fault, the joint's parameters held:

- numbers of the law (``position_gain``, ``velocity_gain``, ``gain``, ..., ``delay``), ``log_gain`` and
  ``log_delay``: exact derivatives;
- ``injected_gain``: the known signal is larger than the record says;
- ``offset``: a constant force, where the joint is declared without one;
- ``limit``: the law's output is cut off below its declared limit, at some shares of the largest torque it asks for;
- ``stribeck``: the motor's friction is larger by ``S exp(-(v / vs)^2)`` at low speed, for some vs: a force on the
  simulated motion, through the loop; ``presliding``: it is smaller by that.

A wrong ``drive_gain`` is none of them: it scales the whole record, and with it the joint, so it is not identifiable. A
gain that applies to one part only is: the law's (``gain``, ``velocity_gain``), the log's (``log_gain``),
or that of a signal of known size (``injected_gain``).

The test is one Gauss-Newton step on the whitened residual. With J the sensitivities of the free parameters and c the
column of a fault, the residual e of the problem is regressed on both. The last coefficient is the size of the fault,
and its ratio to its deviation the statistic. Before that, e, J and c go through one filter that makes the noise nearly
white: the prediction error of an autoregressive model of the part of e that no fault explains. So the statistic is
nearly that of the likelihood, which distinguishes the gains of a law from each other and from one of the log where
plain least squares, in a loop that shapes the noise, does not.
The model need not be right: the deviation is the autocorrelation-robust one of
`uncertainty`, widened where the remaining residual is position-dependent (`position_dependent_error`). It is of the
residual as it was before the fit took its share, frequency by frequency: a slow motion has few of them, and what a
dozen columns leave there is too little to judge another one by.
Where a random force acts in the loop, a fault is as likely as its size beside those that such forces alone show, each
simulated, where these are clearly larger: what they do where friction holds the motor is no small noise of each row by
itself.

All tests of loop and log are one family, and all of the mechanics another, at a tenth of its level: p-values are
multiplied by the number of faults in it, and of shapes tried for one (Bonferroni). Faults whose columns are collinear,
given the joint's parameters, are one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.diagnostics.fault_signature import FaultSignature
from jointid.diagnostics.mechanics_faults import COGGING, MECHANICS, ONE_SIDED, vary_mechanics
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of
from jointid.models.friction import PreslidingFriction, StribeckFriction
from jointid.records.record import Tap
from jointid.simulation.loop_input import to_log
from jointid.uncertainty.covariance import robust, smoothed_spectrum
from jointid.uncertainty.position_dependent_error import Cells, widen

STRIBECK, PRESLIDING, LIMIT, OFFSET, INJECTED_GAIN = "stribeck", "presliding", "limit", "offset", "injected_gain"

_ONE_SIDED = (STRIBECK, PRESLIDING, LIMIT, *ONE_SIDED)  # faults whose size can only be positive
_SPEEDS = (0.02, 0.04, 0.08)  # of the largest speed: the Stribeck speeds that are tried
_SHARES = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly
_STEP = 1e-4  # of the known signal
_ORDER, _FLOOR = 16, 1e-2  # of the autoregressive model; of its variance, white: a stop band is not to be blown up
_RANK = 1e-10  # of the largest singular value of columns
_COLLINEAR = 1e-12  # of the square of a column: a smaller remainder beside the joint's parameters is rounding
_SAME = 0.999  # cosine of two collinear columns
_LAST = ("gain", INJECTED_GAIN)  # named only where no other fault is collinear
_KEPT = 0.25  # of a frequency at least: what a fit takes nearly all of is not known from the remainder
_WIDENED = 0.05  # a test with a larger p-value is not significant, however its deviation is widened
_RARER = 10  # times as rarely as one of the loop, a fault of the mechanics is found where there is none
_MORE = 1.2  # times the deviation: what 32 forces show is so much more in one of twenty by chance

Filter: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class FaultTest:
    """Test of one fault.

    Attributes:
        name: "position_gain", "delay", "log_gain", ...: see the module.
        alike: faults that no record of this loop can distinguish from it.
        declared: value; 0 for what is not declared at all.
        size: value less the declared one; of a limit, the observed share of what it cuts off.
        std: standard deviation of the size, autocorrelation-robust.
        statistic: their ratio.
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
    """

    name: str
    alike: tuple[str, ...]
    declared: float
    size: float
    std: float
    statistic: float
    p_value: float
    shape: float | None = None

    @property
    def label(self) -> str:
        """Its name, and those of the faults it cannot be distinguished from."""
        return " or ".join((self.name, *self.alike))

    @property
    def strength(self) -> float:
        """The absolute statistic; at least 0 for a fault that can only be positive."""
        return max(self.statistic, 0.0) if self.name in _ONE_SIDED else abs(self.statistic)


def compute_signatures(
    problem: ClosedLoopProblem, x: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
    """Return the residual, the columns of the free parameters, (rows, free), and the signatures of all faults.

    Args:
        problem: solved; its free parameters are no faults.
        x: its parameters.
    """
    taken = {p.name for p in problem.free}
    numbers = numbers_of(problem.loop.controller).items()  # a gain of 0 is a choice, not a fault
    wanted = [n for n, v in numbers if n == "delay" or (v and math.isfinite(v) and n != LIMIT)]
    names = [name for name in (*wanted, "log_gain", "log_delay") if name not in taken]
    wider = problem.freeing(*names)
    bare = [p for p in wider.parameters if p.name == OFFSET and not p.free and (p.start or 0.0) == 0.0]
    wider = wider.changed({p.name: replace(p, free=True) for p in bare})
    residual, slopes = wider.linearise(wider.vector(problem.values(x)))
    columns = dict(zip((p.name for p in wider.free), -slopes.T, strict=True))
    own = np.column_stack([columns[p.name] for p in problem.free])
    found = [
        *(FaultSignature(name, columns[name]) for name in (*names, *(p.name for p in bare))),
        *_vary_injected_gain(problem, x),
        *_vary_low_speed_friction(problem, x),
        *vary_mechanics(problem, x),
        *([] if LIMIT in taken else _vary_limit(problem, x)),
    ]
    return residual, own, tuple(a for a in found if np.linalg.norm(a.column) > 0)


def _vary_injected_gain(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signature of the injected signal's gain, where the signal is added after the limit."""
    if not np.any(problem.experiment.after_limit):
        return

    def scaled(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    raw = (scaled(1 + _STEP) - scaled(1 - _STEP)) / (2 * _STEP)
    yield FaultSignature(INJECTED_GAIN, problem.filtered(raw), raw=raw)


def _vary_low_speed_friction(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a friction that is larger, or smaller, at low speed."""
    if isinstance(problem.joint.friction, StribeckFriction | PreslidingFriction):  # its own law has that
        return
    velocity = problem.simulate(x).motor_velocity
    if velocity.size != problem.experiment.after_limit.size:
        return  # a force at the controller's instants needs the motion there
    small = _FORCE * float(np.max(np.abs(problem.measured)))

    def forced(force: FloatArray) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=e.after_limit + force))

    for share in _SPEEDS:
        speed = share * float(np.max(np.abs(velocity), initial=0.0))
        if speed > 0:
            force = -np.exp(-((velocity / speed) ** 2)) * np.sign(velocity)
            raw = (forced(small * force) - forced(-small * force)) / (2 * small)
            if problem.experiment.tap is Tap.MEASURED:
                raw = raw - to_log(problem.experiment, force)  # the force itself is not logged
            column = problem.filtered(raw)
            yield FaultSignature(STRIBECK, column, speed, raw)
            yield FaultSignature(PRESLIDING, -column, speed, -raw)


def _vary_limit(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of lower limits: the whole change of the torque, so a size of 1 is the limit itself."""
    if not hasattr(problem.loop.controller, LIMIT):
        return
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))
    asked, free = float(np.max(np.abs(output))), problem.torque(x)

    def limited(level: float) -> FloatArray:
        return problem.torque(x, lambda e: e.with_law(e.law.with_limit(level)))

    for share in _SHARES:
        level = share * asked
        if level < problem.experiment.law.limit:
            yield FaultSignature(LIMIT, problem.filtered(limited(level) - free), level)


@dataclass(frozen=True, slots=True, eq=False)
class _Step:
    """One Gauss-Newton step along the signature of a fault.

    Attributes:
        signature: with the best of its shapes.
        shapes: how many there were.
        size: of the step.
        gain: decrease of the squared residual.
        alone: (rows,) its whitened column, orthogonal to the other columns.
    """

    signature: FaultSignature
    shapes: int
    size: float
    gain: float
    alone: FloatArray


def score_signatures(
    residual: FloatArray,
    own: FloatArray,
    signatures: Sequence[FaultSignature],
    declared: Mapping[str, float],
    where: Callable[[], Cells],
    by_forces: Callable[[], Sequence[FloatArray]] = tuple,
) -> tuple[FaultTest, ...]:
    """Test each fault alone, the strongest first of those that are significant.

    Args:
        residual: (rows,) of a solved problem, in the order of time.
        own: (rows, free) columns of its free parameters, and of faults already corrected.
        signatures: of all faults: none of them is noise.
        declared: value, by the name of each fault to be tested.
        where: returns the rows' cells; called only where a test is significant, as is the next.
        by_forces: returns residuals, (rows,) each, that random forces in the loop would leave alone.
    """
    basis = _find_basis(np.column_stack([own, *(a.column for a in signatures)]))
    whiten = fit_whitener(_give_back(residual - basis @ (basis.T @ residual), _share_taken(basis)))
    basis, error = _find_basis(whiten(own)), whiten(residual)
    left = error - basis @ (basis.T @ error)
    steps = [_choose_step([a for a in signatures if a.name == name], whiten, basis, left) for name in declared]
    groups = _group_identical(steps)

    @cache
    def forced() -> FloatArray:
        return np.array([whiten(one) for one in by_forces()]).reshape(-1, residual.size)

    taken = _share_taken(basis)
    of_mechanics = [group[0].signature.name in MECHANICS for group in groups]
    families = [of_mechanics.count(mechanics) * (_RARER if mechanics else 1) for mechanics in of_mechanics]
    found = [
        _test_group(group, left, taken, family, declared, where, forced)
        for group, family in zip(groups, families, strict=True)
    ]
    return rank_tests(found, _WIDENED)


def rank_tests(tests: Iterable[FaultTest], level: float) -> tuple[FaultTest, ...]:
    """Return tests, the strongest first of those that are significant, then the others by their p-values."""
    return tuple(sorted(tests, key=lambda test: (max(test.p_value, level), -strength_of(test))))


def strength_of(test: FaultTest) -> float:
    """Return the strength of a test beside others.

    A ripple's period is searched for among so many that the best of them is strong by chance: it is as strong as a
    single test of its p-value.
    """
    from scipy.stats import norm

    if test.name != COGGING or test.p_value <= 0.0:
        return test.strength
    return min(test.strength, float(norm.isf(0.5 * test.p_value)))


def fit_whitener(residual: FloatArray) -> Filter:
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


def _share_taken(basis: FloatArray) -> FloatArray:
    """Return the share of each frequency, (rows // 2 + 1,), that a fit of orthonormal columns takes of a residual."""
    taken = np.sum([smoothed_spectrum(column, column.size)[0] for column in basis.T], axis=0)
    return np.concatenate([taken[:1], taken])


def _give_back(residual: FloatArray, taken: FloatArray) -> FloatArray:
    """Return a residual, (rows,), as large at each frequency as it was before a fit took a share of it.

    Columns of a slow motion take all that they take at its few frequencies: there the spectrum of the remainder is far
    too small, and so would be the deviation of a fault, which acts there, too.
    """
    return np.fft.irfft(np.fft.rfft(residual) / np.sqrt(np.maximum(1 - taken, _KEPT)), residual.size)


def _find_basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis, (rows, rank), of columns that may be collinear."""
    left, sizes, _ = np.linalg.svd(columns / column_norms(columns), full_matrices=False)
    return np.asarray(left[:, sizes > _RANK * sizes[0]])


def _choose_step(shapes: Sequence[FaultSignature], whiten: Filter, basis: FloatArray, left: FloatArray) -> _Step:
    """Return the step with the shape of a fault that decreases the residual most.

    `basis`, (rows, rank), spans the other columns; `left`, (rows,), is the residual orthogonal to them.
    """
    steps = []
    for signature in shapes:
        column = whiten(signature.column)
        alone = column - basis @ (basis.T @ column)
        square = float(alone @ alone)
        # A column in the span of the joint's parameters is not identifiable.
        size = float(alone @ left) / square if square > _COLLINEAR * float(column @ column) else 0.0
        gain = size * size * square if size > 0 or signature.name not in _ONE_SIDED else 0.0
        steps.append(_Step(signature, sum(one.tried for one in shapes), size, gain, alone))
    return max(steps, key=lambda step: step.gain)


def _group_identical(steps: Sequence[_Step]) -> list[list[_Step]]:
    """Return the steps in groups with collinear columns."""
    groups: list[list[_Step]] = []
    for step in sorted(steps, key=lambda step: step.signature.name in _LAST):
        size = float(np.linalg.norm(step.alone))
        for group in groups:
            other = group[0].alone
            cosine = float(step.alone @ other) / max(size * float(np.linalg.norm(other)), np.finfo(float).tiny)
            if step.signature.name not in _ONE_SIDED and abs(cosine) > _SAME:
                group.append(step)
                break
        else:
            groups.append([step])
    return groups


def _test_group(
    group: Sequence[_Step],
    left: FloatArray,
    taken: FloatArray,
    family: int,
    declared: Mapping[str, float],
    where: Callable[[], Cells],
    forced: Callable[[], FloatArray],
) -> FaultTest:
    """Return the test of a fault by its size and the autocorrelation-robust deviation of it.

    Regressing the parts orthogonal to the other columns is the regression on all columns (Frisch and Waugh). The
    p-value is adjusted for all tests of the family together.
    """
    from scipy.stats import t

    step, name = group[0], group[0].signature.name
    alone = step.alone[:, np.newaxis]
    after = _give_back(left - step.size * step.alone, taken + _share_taken(alone / column_norms(alone)))
    alike = tuple(other.signature.name for other in group[1:])

    def judge(std: float, degrees: float = math.inf) -> FaultTest:
        ratio = step.size / std if std > 0 else 0.0
        tail = t.sf(ratio, degrees) if name in _ONE_SIDED else 2 * t.sf(abs(ratio), degrees)
        p_value = min(float(tail) * step.shapes * family, 1.0)
        return FaultTest(name, alike, declared[name], step.size, std, ratio, p_value, step.signature.shape)

    covariance = robust(alone, alone, after)
    test = judge(float(covariance.std[0]))
    if test.p_value > _WIDENED:
        return test
    test = judge(float(widen(covariance, alone, alone, after, where())[0].std[0]))
    if test.p_value > _WIDENED or not forced().size:
        return test
    shown = forced() @ step.alone / float(step.alone @ step.alone)  # (forces,) sizes
    # A spectrum tells the size of a force roughly; forces that leave less than what is left are too small.
    larger = max(1.0, float(np.linalg.norm(after)) / math.sqrt(float(np.mean(np.sum(forced() ** 2, axis=1)))))
    spread = larger * float(np.sqrt(np.mean(shown**2)))
    # A fault of another kind may look like a force: so its size stands, and its place among those that are significant.
    return replace(test, p_value=judge(spread, shown.size).p_value) if spread > _MORE * test.std else test
