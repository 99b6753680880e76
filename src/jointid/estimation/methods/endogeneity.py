"""Is a prescribed motion correlated with the error, and what does the record say if it is: instrumental variables.

In a closed loop the motor answers to what disturbs it. Its measured motion, and the sensitivities J that are simulated
along it, are then correlated with the torque error e, and least squares, ``J' e = 0``, is biased. Two stages mend that:

1. the motion that the known signals alone would have made: the measured one regressed on the reference's velocity and
   its direction, and on the injected signal, each through a response of its own to the past (`known_motions`). A
   regression also explains some of the noise, a quarter of a narrow-band disturbance on the paper's axis; so each half
   of the record takes the responses that the other half gave;
2. ``Z' e = 0`` with Z the sensitivities along *that* motion, while e keeps the measured one.

The contrast of the two estimates is the test of Durbin, Wu and Hausman: without correlation they differ by no more than
noise, whose covariance follows from the difference of their influences, robust to autocorrelation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Detail, Progress
from jointid.common.parameters import Parameter
from jointid.estimation.problems.prescribed import DriveSideProblem
from jointid.records.record import Record
from jointid.simulation.prescribed import LOAD_STATE, PARTS, prescribed_motion
from jointid.solvers.regression import InstrumentalSolution, InstrumentalVariables, projection
from jointid.solvers.solve import Solution, solve
from jointid.uncertainty.covariance import (
    Covariance,
    bandwidth,
    bartlett_sum,
    sandwich,
    with_bands,
    with_measured_motion,
)
from jointid.uncertainty.verdict import MOTION_MEASURED

_MEMORY = 40  # rows of the filtered torque that a response goes back
_ACCEPTED = 0.01  # a contrast that noise alone would reach less often is none of noise
_BLIND = 0.05  # of a parameter: a bias that a test should be able to see
_ANY = 10.0  # of a parameter: a larger bias is of any size
_PHYSICAL = ("inertia", "motor_inertia", "stiffness", "load_inertia")


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Verdict of the instruments.

    Attributes:
        covariance: of the estimate; of least squares it is widened by the difference of both estimates, or where the
            instruments do not tell that, for a force in the loop (`with_measured_motion`).
        x: of the instrumental estimate, where it is preferred; None keeps least squares.
        warnings: for the answer.
        channels: of the record that served.
        simulations: that it took.
        probability: of so large a contrast if the motion is not correlated with the error; None without a test.
    """

    covariance: Covariance
    x: FloatArray | None = None
    warnings: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    simulations: int = 0
    probability: float | None = None


def judge_endogeneity(
    record: Record, problem: DriveSideProblem, solution: Solution, instruments: str, progress: Progress
) -> Judgement:
    """Test a least-squares estimate for endogeneity, and prefer instruments if it fails.

    Args:
        record: whose reference and injected signal are the instruments.
        problem: that was solved.
        solution: its least-squares solution.
        instruments: "tested", "always" or "never".
        progress: receives the probability.

    Raises:
        MethodError: instruments are demanded, but the record has none.
    """
    channels = tuple(name for name in ("reference", "injected") if getattr(record, name) is not None)
    J, error = solution.jacobian, solution.residual
    least = with_bands(sandwich(J, J, error), J, J, error)
    untested = Judgement(with_measured_motion(least, J, J, error), warnings=(MOTION_MEASURED,))
    if instruments == "never":
        return untested
    if not channels:
        if instruments == "always":
            raise MethodError(
                "Instruments are a reference or an injected signal; this record has "
                f'{", ".join(record.channels)}: log one of them, or use instruments = "never".'
            )
        return untested
    found = solve_with_instruments(InstrumentedProblem.of(record, problem), solution.x)
    tested = replace(untested, channels=channels, simulations=3 * len(found.trace))
    if not found.converged or not np.isin([p.name for p in problem.free], _PHYSICAL)[found.moving].any():
        return replace(tested, warnings=(MOTION_MEASURED, _NOT_CONVERGED))
    probability, blind = contrast(problem, solution, found)
    progress(Detail(f"instruments from {' and '.join(channels)}: probability of the contrast {probability:.2g}"))
    biased = probability < _ACCEPTED
    warnings = [_words(problem, solution, found, probability)] if biased else []
    if blind > _BLIND:
        size = f"by {100 * blind:.0f} %" if blind < _ANY else "of any size"
        untold = "" if biased else f", and a bias of least squares {size} would not have been noticed"
        warnings.append(f"the instruments are weak: they know less than least squares{untold}")
    tested = replace(tested, warnings=tuple(warnings), probability=probability)
    if biased or instruments == "always":
        return replace(tested, x=found.x, covariance=_covariance(found))
    if blind > _BLIND:
        return replace(tested, warnings=(MOTION_MEASURED, *warnings))
    # What is not significant may be there: it is widened for.
    bias = np.where(found.moving, solution.x - found.x, 0.0)
    return replace(tested, covariance=replace(least, std=np.hypot(least.std, bias)))


_NOT_CONVERGED = (
    "the instruments are too weak to converge within the bounds; least squares is kept, and whether the motion is "
    "correlated with the error was not tested"
)


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentedProblem:
    """The problem along the measured motion, its instruments along the motions that the known signals explain.

    Attributes:
        problem: along the measured motion.
        halves: along the others; the first holds in the second half of the rows.
    """

    problem: DriveSideProblem
    halves: tuple[DriveSideProblem, DriveSideProblem]

    @classmethod
    def of(cls, record: Record, problem: DriveSideProblem) -> InstrumentedProblem:
        """Return the problem with the instruments that a record's known signals give."""
        motions = [prescribed_motion(known, problem.sample_time) for known in known_motions(record, problem)]
        return cls(problem, (replace(problem, motion=motions[0]), replace(problem, motion=motions[1])))

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the residual, (rows,)."""
        return self.problem.residual(x)

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives, (rows, free), along the measured motion."""
        return self.problem.linearise(x)

    def instruments(self, x: FloatArray) -> FloatArray:
        """Return Z, (rows, free)."""
        first, second = (half.linearise(x)[1] for half in self.halves)
        middle = len(first) // 2
        return np.concatenate([second[:middle], first[middle:]])


def known_motions(record: Record, problem: DriveSideProblem) -> tuple[FloatArray, FloatArray]:
    """Return the motor position that reference and injected signal explain, (samples,): by each half's responses."""
    position, sample_time = problem.motion.position[::PARTS], problem.sample_time
    base, W = _past(record, problem, position)
    seen = problem.filtering.decimate(np.column_stack([position - base, W])[problem.inside], sample_time)
    norms = np.maximum(np.linalg.norm(seen[:, 1:], axis=0), 1e-300)
    middle = len(seen) // 2
    responses = [
        np.linalg.lstsq(half[:, 1:] / norms, half[:, 0], rcond=1e-8)[0] / norms
        for half in (seen[:middle], seen[middle:])
    ]
    return base + W @ responses[0], base + W @ responses[1]


def _past(record: Record, problem: DriveSideProblem, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the direct input of the motor, (samples,), and lags of the known signals, (samples, columns)."""
    size, sample_time = position.size, problem.sample_time
    base, signals = np.full(size, float(np.mean(position))), []
    if record.reference is not None:
        base = _resample(record.reference.values, record.reference.sample_time, size, sample_time)
        velocity = np.gradient(base, sample_time)
        signals += [velocity, np.sign(velocity) * (np.abs(velocity) > 1e-6 * np.max(np.abs(velocity)))]
    if record.injected is not None:
        channel = record.injected.channel
        signals.append(_resample(channel.values, channel.sample_time, size, sample_time))
    spacing = problem.filtering.decimation or 1
    columns = [np.ones(size)]
    hat = np.concatenate([np.arange(1, spacing + 1), np.arange(spacing - 1, 0, -1)]) / spacing**2
    for signal in signals:
        held = np.concatenate([np.full(spacing * (_MEMORY + 1), signal[0]), signal])  # as it was before the record
        smooth = np.convolve(held, hat)[spacing - 1 : spacing - 1 + held.size]
        offset = held.size - size
        columns += [smooth[offset - lag * spacing :][:size] for lag in range(_MEMORY)]
    return base, np.column_stack(columns)


def _resample(values: FloatArray, period: float, size: int, sample_time: float) -> FloatArray:
    at = np.arange(size) * (sample_time / period)
    return np.asarray(np.interp(at, np.arange(values.size), values), dtype=np.float64)


def solve_with_instruments(problem: InstrumentedProblem, start: FloatArray) -> InstrumentalSolution:
    """Solve ``Z' e = 0`` from a least-squares solution.

    The load's first state is left where least squares has it: a few rows know of it, and they are no instruments.
    """
    names = [p.name for p in problem.free]
    solver = InstrumentalVariables(_deviations, kept=np.isin(names, LOAD_STATE), signed=np.isin(names, _PHYSICAL))
    found = solve(problem, solver, start)
    assert isinstance(found, InstrumentalSolution)
    return found


def _deviations(Z: FloatArray, J: FloatArray, error: FloatArray) -> FloatArray:
    return sandwich(Z, J, error).std


def contrast(problem: DriveSideProblem, solution: Solution, found: InstrumentalSolution) -> tuple[float, float]:
    """Return how probable the contrast of both estimates is by noise alone, and the relative bias it cannot see."""
    from scipy.special import gammaincc

    J, Z, error = found.jacobian[:, found.moving], found.instruments[:, found.moving], found.residual
    influences = (projection(J, J) - projection(Z, J)) * error
    names = np.array([p.name for p in problem.free])[found.moving]
    chosen = np.flatnonzero(np.isin(names, _PHYSICAL))
    scores = influences[chosen].T
    spread = bartlett_sum(scores, bandwidth(len(scores)))
    difference = (solution.x - found.x)[found.moving][chosen]
    scale = np.sqrt(np.diag(spread))
    scaled = spread / np.outer(scale, scale)
    statistic = float((difference / scale) @ np.linalg.pinv(scaled, rcond=1e-8) @ (difference / scale))
    blind = float(np.max(2 * scale / np.abs(found.x[found.moving][chosen])))
    return float(gammaincc(0.5 * chosen.size, 0.5 * statistic)), blind


def _covariance(found: InstrumentalSolution) -> Covariance:
    """Return the covariance of all free parameters; one at a bound has no deviation."""
    Z, J = found.instruments[:, found.moving], found.jacobian[:, found.moving]
    inner = with_bands(sandwich(Z, J, found.residual), Z, J, found.residual)
    whole, together = np.zeros(found.moving.size), np.eye(found.moving.size)
    whole[found.moving] = inner.std
    together[np.ix_(found.moving, found.moving)] = inner.correlation
    return Covariance(whole, together, inner.bandwidth)


def _words(problem: DriveSideProblem, solution: Solution, found: InstrumentalSolution, probability: float) -> str:
    """Return the effect of a failed test on the estimate."""
    names = [p.name for p in problem.free]
    off = [
        f"{name} by {100 * (solution.x[i] / found.x[i] - 1):+.1f} %"
        for i, name in enumerate(names)
        if name in _PHYSICAL and found.moving[i] and found.x[i]
    ]
    return (
        "the motor's motion is correlated with the error, as in a loop that answers to a disturbance "
        f"(Durbin-Wu-Hausman test, probability {probability:.1g}): least squares is off, {', '.join(off)}; the values "
        "are those of the instruments"
    )
