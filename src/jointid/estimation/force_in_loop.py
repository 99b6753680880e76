"""Uncertainty of least torque error under a random force in the loop.

A cutting force, a ripple or a shaking floor pushes on the motor, and is not in the log. The controller responds to it,
so the torque shows it; and sometimes it makes a motor slide that would rest, or reverse. Averaged over such a force,
Coulomb friction acts less near standstill, and more like viscous friction. Simulations without the force therefore give
too little Coulomb and too much viscous friction: on random servos, under forces of 1 to 6 %, by 2 to 87 %.

**The force** is distinguished from noise on the log by its spectrum. The residual r of the moving samples is
the effect of noise n and force d on the torque, with T the loop's complementary sensitivity::

    S_r(f) = |T(f)|^2 S_d(f) + S_n,      S_d(f) = sum over k of c_k / (1 + (f / f_k)^2),   c_k >= 0

so a flat residual is noise, and one that falls where the loop no longer responds is a force.

**Its bias** is simulated: averaged over pairs of opposite forces of that spectrum, whose linear responses cancel, the
torque changes only by the effect of the force on the friction. Gauss-Newton steps lead from the end of least squares to
the least error of this mean torque, with the force estimated again at each step. That distance is added to the
deviations, as one of its own size. If friction never holds the motor, as on the EMPS axis, there is no bias.

**Its spread** is simulated where the motor rests. It keeps the error of the place where friction stopped it: such noise
has few independent values, of which the fit absorbs most. A simulated error n_k moves the estimate by ``d_k = A n_k``
and leaves ``e_k = n_k - J d_k`` of the residual e; where it clearly exceeds the known covariance, the larger counts::

    cov = sum_k d_k d_k' ||e||^2 / sum_k ||e_k||^2
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.parameters import Bounds
from jointid.common.text import number
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.spring_search import crossover
from jointid.models.linear import frequency_response
from jointid.simulation.loop_input import AxisInput
from jointid.simulation.simulate import Outcome, Simulation
from jointid.uncertainty.covariance import Influence, covariance_of, larger
from jointid.uncertainty.identifiability import Limitation
from jointid.uncertainty.position_dependent_error import RESTING, Uncertainty

MATTERS, TOLD = 0.25, 1.0  # deviations: a smaller shift widens no interval, and a larger one is said
_SPREAD = 1.25  # of the known variance, averaged over directions: more than the chance of few simulations
_PAIRS = 4  # of opposite forces that are simulated
_PASSES = 4  # of the fit of a spectrum, whose weights follow from the fit before
_CORNERS = (0.015, 0.05, 0.15, 0.5, 1.5, 5.0)  # of the crossover, f_k; and a flat one


@dataclass(frozen=True, slots=True, eq=False)
class RandomForce:
    """The spectrum of a force on the motor.

    Attributes:
        hertz, power: (frequencies,), two-sided; the mean power up to half the sampling frequency is the variance.
        noise: standard deviation of the white noise on the log beside it.
    """

    hertz: FloatArray
    power: FloatArray
    noise: float

    @property
    def rms(self) -> float:
        """Its standard deviation, N or N m."""
        return math.sqrt(float(np.mean(self.power)))

    def draw(self, samples: int, sample_time: float, random: np.random.Generator) -> FloatArray:
        """Return a force of this spectrum, (samples,)."""
        from scipy.fft import next_fast_len  # of other lengths a transform takes up to ten times as long

        period = next_fast_len(samples, real=True)
        size = np.sqrt(period * np.interp(np.fft.rfftfreq(period, sample_time), self.hertz, self.power))
        turn = np.exp(2j * math.pi * random.uniform(size=size.size))
        return np.fft.irfft(size * turn, period)[:samples]


def widen_for_force(
    known: Uncertainty, problem: ClosedLoopProblem, x: FloatArray, J: FloatArray
) -> tuple[Uncertainty, tuple[FloatArray, RandomForce] | None]:
    """Widen an uncertainty at x, (free,), for a force in the loop.

    Returns also the shifted x and the force; None without a force, or with shifts below a quarter deviation.
    """
    run, at, bounds = problem.simulate(x), x, Bounds.of(problem.free)
    shown = run.torque  # at the end of least squares the residual moves nothing: only what the force adds does
    for _ in range(8):  # at most
        force = find_force(problem, at, run, problem.measured - run.torque)
        if force is None or force.rms <= 1e-3 * float(np.std(problem.measured)):  # moves nothing that matters
            return known, None
        if at is x and np.mean(run.motor_velocity == 0.0) > 0.005:  # of the samples: a motor that hardly rests has none
            known = _widen_for_spread(known, problem, x, J, force)
        left = problem.filter(shown - simulate_mean(problem, at, force))
        step, std = Influence(J, left).matrix @ left, known.covariance.std
        if not np.all(np.isfinite(step)) or (at is x and not np.any(np.abs(step) > MATTERS * std)):
            return known, None
        at, shown = bounds.clip(at + step), problem.measured
        J, run = -problem.linearise(at)[1], problem.simulate(at)
        if not np.any(np.abs(step) > MATTERS * np.hypot(std, at - x)):
            break
    assert force is not None
    each = zip(problem.free_joint, at, x, std, strict=False)
    moved = {p.name: float(value) for p, value, before, own in each if abs(value - before) > TOLD * own}
    size = f"{number(force.rms, 2)} {problem.joint.force_unit} rms"
    said = f"a random force in the loop, of {size}, lets friction slide and widens the intervals of {', '.join(moved)}"
    stated = (Message(Limitation.FORCE_IN_LOOP, said, {"rms": force.rms, "values": moved}),) if moved else ()
    return replace(known.widened_by(at - x), warnings=(*known.warnings, *stated)), (at, force)


def _widen_for_spread(
    known: Uncertainty, problem: ClosedLoopProblem, x: FloatArray, J: FloatArray, force: RandomForce
) -> Uncertainty:
    """Widen an uncertainty at x, (free,), to the spread of estimates under simulated forces."""
    left, own = problem.residual(x), known.covariance
    A = Influence(J, left).matrix
    for draws in (2 * _PAIRS, 8 * _PAIRS):
        steps, unexplained = [], 0.0
        for error in simulate_errors(problem, x, force, draws):
            steps.append(A @ error)
            unexplained += float(np.sum((error - J @ steps[-1]) ** 2))
        d = np.array(steps) * math.sqrt(left @ left / unexplained)
        scaled = d / np.where(own.std > 0, own.std, 1.0)
        if not np.sum(scaled @ np.linalg.pinv(own.correlation) * scaled) > _SPREAD * x.size:
            return known
    return replace(known, covariance=larger(own, covariance_of(d.T @ d)))


def find_force(problem: ClosedLoopProblem, x: FloatArray, run: Simulation, error: FloatArray) -> RandomForce | None:
    """Random force that a raw residual, (samples,), shows; else None."""
    from scipy.optimize import nnls

    speed = np.abs(run.motor_velocity)
    moving = (speed > RESTING * np.max(speed, initial=0.0)).astype(np.float64)
    if run.outcome is not Outcome.FINISHED or np.mean(moving) < 0.1:  # of the rows have to move
        return None
    values, law = problem.values(x), problem.axis_at(x).law
    middle = crossover(law, sum(values[n] for n in ("inertia", "motor_inertia", "load_inertia") if n in values))
    hertz, power = _spectrum(error, moving, problem.sample_time, 10.0 / middle)  # ten periods
    seen = (hertz >= 0.05 * middle) & (hertz <= 0.4 / problem.sample_time)  # where log and loop show it
    hertz, power = hertz[seen], power[seen]
    if hertz.size < 8 or not np.mean(power) > 0:  # a log far slower than the loop shows nothing of its answer
        return None
    shapes = np.column_stack([1.0 / (1.0 + (hertz / (c * middle)) ** 2) for c in _CORNERS] + [np.ones(hertz.size)])
    late = np.exp(-2j * math.pi * hertz * (law.delay + 0.5 * law.period))
    through = frequency_response(problem.joint, values, hertz, "motor_position") * law.feedback(hertz) * late
    response = np.abs(through / (1.0 - through)) ** 2  # of the controller's torque to a force on the motor
    columns = np.column_stack([shapes * response[:, np.newaxis], np.ones(hertz.size)])
    # A spectrum's deviation is a share of its mean, from the fit: alone it is rough, and in parts negative.
    fitted, level = np.ones(hertz.size), float(np.mean(power))  # the solver sees numbers about 1
    try:
        for _ in range(_PASSES):
            spread = np.maximum(fitted, 1e-2 * max(np.max(fitted), 1.0))
            parts, _ = nnls(columns / spread[:, np.newaxis], power / (level * spread))
            fitted = columns @ parts
    except RuntimeError:  # too many iterations: columns that are alike, or no numbers
        return None
    found = RandomForce(hertz, level * (shapes @ parts[:-1]), math.sqrt(level * parts[-1]))
    return found if found.rms > 0.0 else None


def simulate_mean(problem: ClosedLoopProblem, x: FloatArray, force: RandomForce) -> FloatArray:
    """Mean torque of the loop, (samples,), under pairs of opposite forces."""
    return np.asarray(sum(simulate_with_force(problem, x, force))) / (2 * _PAIRS)


def simulate_errors(problem: ClosedLoopProblem, x: FloatArray, force: RandomForce, draws: int) -> Iterator[FloatArray]:
    """Yield filtered errors of the torque, (rows,), under random forces and the noise beside them."""
    torque, random = problem.torque(x), np.random.default_rng(1)
    for other in simulate_with_force(problem, x, force, draws, pairs=False):
        yield problem.filter(other - torque + force.noise * random.standard_normal(torque.size))


def simulate_with_force(
    problem: ClosedLoopProblem, x: FloatArray, force: RandomForce, draws: int = 2 * _PAIRS, pairs: bool = True
) -> Iterator[FloatArray]:
    """Yield the loop's torque, (samples,), under random forces, by default with the opposite of each."""
    random, samples, pushed = np.random.default_rng(0), problem.measured.size, np.zeros(0)

    def push(added: FloatArray, driven: AxisInput) -> AxisInput:
        held = np.repeat(added, driven.clock.skips)[:: driven.clock.shows][: driven.after_limit.size]
        return driven.push(np.pad(held, (0, driven.after_limit.size - held.size)))

    for k in range(draws):
        pushed = -pushed if pairs and k % 2 else force.draw(samples, problem.sample_time, random)
        yield problem.torque(x, partial(push, pushed))


def _spectrum(signal: FloatArray, chosen: FloatArray, step: float, longest: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies and spectrum of chosen samples, from lags up to `longest`, s."""
    lags = max(min(round(longest / step), signal.size // 4), 2)
    size = 1 << (2 * signal.size - 1).bit_length()
    sums, counts = np.fft.irfft(np.abs(np.fft.rfft([signal * chosen, chosen], size)) ** 2, size)[:, : lags + 1]
    together = sums / np.maximum(counts, 1.0)
    together *= 0.5 * (1.0 + np.cos(math.pi * np.arange(lags + 1) / lags))
    power = np.real(np.fft.rfft(np.concatenate([together, together[-2:0:-1]])))
    return np.arange(power.size) / (2 * lags * step), power
