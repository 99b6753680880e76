"""Starts for a flexible joint: a grid of stiffnesses and load shares, judged by one simulation each.

What a drive is known by before anything is identified is its loop: it crosses over where the torque it asks for a
deviation is the torque the inertia needs to follow. A mode of the joint that mattered to whoever tuned the loop lies
not far from there, whatever the joint's size and the rate of the log. So the grid of free-free frequencies is measured
by the crossover frequency. Half of it is an unstable loop, and the rest has local minima.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import Quantity
from jointid.estimation.descent import History
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.starts.inverse_controller import reconstructed_position, torque_behind_limit
from jointid.models.controllers import REFERENCE, SampledLaw
from jointid.models.joints import FlexibleJoint, acts_on_whole, split_by_mode, spring_at

FASTEST = 0.22  # of the sampling frequency: a mode faster than about a fifth is not followed by the log

_LOWEST, _HIGHEST = 0.5, 12.0  # times the crossover: the modes that are searched
_RATIO = 1.25  # of neighbouring frequencies of the grid
_HALF, _SHARES = 0.5, (0.25, 0.75)  # of the load in the inertia: first the halves of (13), then at the best frequencies
_NARROWED = 3  # frequencies at which other shares are tried
_FAR_BELOW, _FAR_ABOVE, _WIDE_COUNT = 0.2, 4.0, 10  # times the crossover: the modes of the wide grid
_INERTIAS = (0.4, 0.7, 1.0, 1.5, 2.5)  # of that grid, times the rigid joint's
_WIDE_SHARES = (0.15, 0.5, 0.85)  # of the load in them


class Candidate(NamedTuple):
    """A start: its cost, infinite where the loop is as good as unstable; its free-free frequency, Hz; its values."""

    cost: float
    frequency: float
    values: dict[str, float]


def crossover(law: SampledLaw, inertia: float) -> float:
    """Return the frequency in Hz up to which the law asks for more torque per position than the inertia takes."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float) -> list[float]:
    """Return free-free frequencies in Hz, from below the crossover to where a log cannot follow, slow ones first."""
    middle = crossover(law, inertia)
    low, high = _LOWEST * middle, min(_HIGHEST * middle, FASTEST / sample_time)
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(_RATIO)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def explore(
    problem: ClosedLoopProblem, rigid: Mapping[str, float] | None, frequency: float | None, history: History
) -> list[Candidate]:
    """Judge a row of frequencies, and starts at antiresonances; return the candidates, best first.

    Args:
        problem: of the flexible joint, on a wide band.
        rigid: values of a rigid joint; None where the record shows none, and only antiresonances are tried.
        frequency: the only one to try, Hz; then antiresonances are tried without a rigid joint alone.
        history: of the search.

    Raises:
        MethodError: no start can be simulated.
    """
    law, sample_time = problem.experiment.law, problem.experiment.sample_time
    row, others = list[float](), list[dict[str, float]]()
    if rigid is not None:
        row = [frequency] if frequency else frequencies_to_try(law, rigid["inertia"], sample_time)
    if not frequency or rigid is None:
        others = [_inside(problem, values) for values in antiresonance_starts(problem)]
    count = len(row) + min(len(row), _NARROWED) * len(_SHARES) + len(others)
    given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}

    def on_grid(points: list[tuple[float, float]]) -> list[Candidate]:
        return _judge(problem, [(f, start_with_mode(problem, rigid or {}, f, share)) for f, share in points], history)

    grid = on_grid([(f, _HALF) for f in row])
    best = sorted(grid, key=lambda one: one.cost)[:_NARROWED]
    grid += on_grid([(one.frequency, share) for one in best for share in _SHARES])
    beside = _judge(problem, [(frequency_of(values), values) for values in others], history)
    if not any(one.cost < math.inf for one in (*grid, *beside)):
        raise MethodError(
            "No start could be simulated: every flexible joint tried makes this loop unstable; check the controller's "
            "gains, its delay and the unit of the torque."
        )
    if len(row) > 1:  # at frequencies apart: a start beside another leads nowhere new
        grid = [min((one for one in grid if one.frequency == f), key=lambda one: one.cost) for f in row]
    ways = [sorted(way, key=lambda one: one.cost) for way in (grid, beside)]
    ways.sort(key=lambda way: way[0].cost if way else math.inf)
    # Of both ways in turn: where one of them is misled the other is not.
    found = [one for pair in itertools.zip_longest(*ways) for one in pair if one is not None]
    history.progress(f"searching from a mode near {found[0].frequency:.3g} Hz, the best of {count} that were tried")
    found = [one for one in found if one.cost < math.inf]
    if given:  # starts that come with the parameters are tried first, and are no reason to try no others
        values = _inside(problem, found[0].values | given)
        own = _judge(problem, [(frequency_of(values), values)], history)
        found = [one for one in own if one.cost < math.inf] + found
    return found


def explore_widely(problem: ClosedLoopProblem, rigid: Mapping[str, float], history: History) -> list[Candidate]:
    """Judge a grid that trusts neither the rigid joint's inertia nor the loop's bandwidth; return it, best first.

    A mode inside the bandwidth makes the rigid joint another than the sum of both sides: so the inertia is tried, too,
    with loads from small to nearly all of it, and modes from far below the crossover.

    Raises:
        MethodError: no start can be simulated.
    """
    middle, fastest = crossover(problem.experiment.law, rigid["inertia"]), FASTEST / problem.experiment.sample_time
    row = np.geomspace(_FAR_BELOW * middle, min(_FAR_ABOVE * middle, fastest), _WIDE_COUNT)
    grid = [
        (frequency, start_with_mode(problem, {**rigid, "inertia": times * rigid["inertia"]}, frequency, share))
        for times, share, frequency in itertools.product(_INERTIAS, _WIDE_SHARES, map(float, row))
    ]
    history.progress(f"trying {len(grid)} flexible joints of other inertias")
    found = sorted((one for one in _judge(problem, grid, history) if one.cost < math.inf), key=lambda one: one.cost)
    if not found:
        raise MethodError("No start could be simulated: every flexible joint tried makes this loop unstable.")
    return found


def start_with_mode(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], frequency: float, share: float
) -> dict[str, float]:
    """Return the start (13) for the free parameters, within their bounds, with the fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free or p.name in INITIAL}
    nothing = {p.name: p.start or 0.0 for p in problem.parameters}
    return _inside(problem, nothing | pseudo_regular(rigid, frequency, share) | fixed)


def pseudo_regular(rigid: Mapping[str, float], frequency: float, share: float = _HALF) -> dict[str, float]:
    """Return the start (13): rigid values divided between the sides, the spring from the free-free frequency, Hz.

    The load has a share of the inertia; the frictions are halved.
    """
    start = {}
    for name, value in rigid.items():
        if acts_on_whole(name):
            start[name] = value
        else:
            start |= {f"{side}_{name}": 0.5 * value for side in ("motor", "load")}
    return start | split_by_mode(rigid["inertia"], share, frequency)


def frequency_of(values: Mapping[str, float]) -> float:
    """Return the free-free frequency of a joint's values, Hz."""
    return FlexibleJoint.frequencies(values)["free_free"]


def _inside(problem: ClosedLoopProblem, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values a little inside their bounds, by a thousandth of their size or of what would be one."""
    found = dict(values)
    force = float(np.std(problem.measured))
    rate = 2 * math.pi * frequency_of(values)
    inertia = values["motor_inertia"] + values["load_inertia"]
    typical = {Quantity.FORCE: force, Quantity.VISCOUS: inertia * rate, Quantity.STIFFNESS: inertia * rate**2}
    for p in problem.free:
        inside = 1e-3 * (abs(values[p.name]) or typical.get(p.quantity, inertia))
        low = p.lower + inside if math.isfinite(p.lower) else p.lower
        found[p.name] = min(max(values[p.name], low), max(p.upper - inside, p.lower))
    return found


def _judge(
    problem: ClosedLoopProblem, starts: Sequence[tuple[float, dict[str, float]]], history: History
) -> list[Candidate]:
    """Simulate starts, free-free frequency and values, in threads, and return them with their costs."""
    most = 10 * problem.size

    def judge(start: tuple[float, dict[str, float]]) -> Candidate:
        cost = float(np.linalg.norm(problem.residual(problem.vector(start[1]))))
        return Candidate(cost if cost < most else math.inf, *start)

    history.tally.evaluations += len(starts)
    return in_threads(judge, starts)


_MOST, _WIDER, _SHARE = 0.99, 4.0, 0.2  # the band: times that holds so much of the torque, or of the sampling frequency
_SLOWEST, _FASTEST, _COUNT = 0.015, 0.75, 36  # of the band, antiresonances that are tried
_SAMPLES = 5.0  # of the band kept per second
_DAMPING = 0.03  # damping of the load against the motor
_ENDS = 5.0  # periods of the band at both ends that the filters spoil
_RESTING = 1e-3  # of the largest speed
_SHORTEST = 100  # samples: of fewer nothing is said
_KEPT = 4  # starts by least squares, and as many by instruments


def antiresonance_starts(problem: ClosedLoopProblem) -> list[dict[str, float]]:
    """Return starts, every parameter by name, the best first; none where the controller cannot be inverted.

    The motor's motion is reconstructed by the inverse of the controller (`inverse_controller`). Along a known motion of
    the motor, the load of a spring with antiresonance f_a and little damping moves as a filter of second order says,
    ``q12 = G(f_a) q1``, and what is left is linear::

        tau = ZZ1 a1 + ZZ2 a12 + Fv (v1 + v12) / 2 + Fc sign(v1) + offset,     K12 = ZZ2 (2 pi f_a)^2

    It is solved for each f_a of a grid, by least squares, and with the same columns along the reference as instruments:
    where the loop answers to noise or to forces, the reconstructed motion is no independent one. A rigid joint need not
    explain anything for that: it works where the mode lies inside the loop's bandwidth.
    """
    try:
        position = reconstructed_position(problem)
    except MethodError:  # the log does not show the output, or the law cannot be turned round
        return []
    experiment = problem.experiment
    law, sample_time = experiment.law, problem.sample_time
    reference = experiment.inputs[:: experiment.every, REFERENCE][: position.size]
    at = np.arange(position.size) * sample_time
    acting = np.interp(at - law.delay - 0.5 * law.period, at, torque_behind_limit(problem))
    motions = np.column_stack([position, reference, acting])[law.order // experiment.every + 2 :]
    if len(motions) < _SHORTEST or not (np.all(np.isfinite(motions)) and np.ptp(motions[:, 2]) > 0):
        return []
    first = {"initial_torque": float(problem.measured[0])}
    if all(p.name != "initial_velocity" for p in problem.free):  # where the motor moves, the problem has its start
        first |= {"initial_position": float(motions[0, 0]), "initial_velocity": 0.0}
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free}
    starts = []
    for values in _solve_row(*_resample(motions, sample_time)):
        # A friction law may have a coefficient for each direction, which begin alike.
        known = {
            p.name: value
            for base, value in (values | first).items()
            for p in problem.parameters
            if f"{p.name}_".startswith(f"{base}_")
        }
        starts.append({p.name: p.start or 0.0 for p in problem.parameters} | known | fixed)
    return starts


def _resample(motions: FloatArray, sample_time: float) -> tuple[FloatArray, float, float]:
    """Return motions below a band that holds most of the torque, their sample time, and the band in Hz."""
    from scipy.signal import butter, sosfiltfilt

    energy = np.cumsum(np.abs(np.fft.rfft(motions[:, 2] - motions[:, 2].mean())) ** 2)
    most = float(np.searchsorted(energy, _MOST * energy[-1])) / (len(motions) * sample_time)
    band = min(_WIDER * most, _SHARE / sample_time)
    low_pass = butter(4, band, fs=1 / sample_time, output="sos")
    every = max(math.floor(1.0 / (_SAMPLES * band * sample_time)), 1)
    return np.asarray(sosfiltfilt(low_pass, motions, axis=0)[::every]), every * sample_time, band


def _solve_row(seen: FloatArray, step: float, band: float) -> Iterator[dict[str, float]]:
    """Yield the values that explain the torque best, by least squares and by instruments in turn.

    The motions are (samples, 3) motor position, reference and torque, below a band in Hz.
    """
    ends = max(round(_ENDS / (band * step)), 2)
    inside, torque = slice(ends, -ends), seen[ends:-ends, 2]
    found: tuple[list[tuple[float, dict[str, float]]], ...] = ([], [])
    for frequency in np.geomspace(_SLOWEST * band, _FASTEST * band, _COUNT):
        W, R = (_columns(seen[:, i], float(frequency), step)[inside] for i in (0, 1))
        for kind, Z in enumerate((W, R)):
            of_Z, of_W = (np.maximum(np.linalg.norm(M, axis=0), 1e-300) for M in (Z, W))
            x = np.asarray(np.linalg.lstsq((Z / of_Z).T @ (W / of_W), (Z / of_Z).T @ torque)[0] / of_W)
            if x[0] > 0 and x[1] > 0:
                found[kind].append((float(np.linalg.norm(torque - W @ x)), _values(x, float(frequency))))
    ranked = [sorted(kind, key=lambda one: one[0])[:_KEPT] for kind in found]
    for place in range(_KEPT):
        for best in ranked:
            yield from (values for _, values in best[place : place + 1])


def _columns(position: FloatArray, frequency: float, step: float) -> FloatArray:
    """Return the columns of the module's equation along a motion of the motor, (samples, 5)."""
    from scipy.signal import lfilter

    # (damped s + square) / (s^2 + damped s + square) by the bilinear rule; SciPy's takes longer than all other work.
    rate, twice = 2 * math.pi * frequency, 2.0 / step
    damped, square = 2 * _DAMPING * rate * twice, rate**2
    whole = twice**2 + damped + square
    numerator = np.array([square + damped, 2 * square, square - damped]) / whole
    denominator = np.array([whole, 2 * (square - twice**2), twice**2 - damped + square]) / whole
    rest = np.array([1.0 - numerator[0], numerator[2] - denominator[2]]) * position[0]
    load = lfilter(numerator, denominator, position, zi=rest)[0]
    motor_velocity, load_velocity = np.gradient(position, step), np.gradient(load, step)
    return np.column_stack(
        [
            np.gradient(motor_velocity, step),
            np.gradient(load_velocity, step),
            0.5 * (motor_velocity + load_velocity),
            # At rest the sign would be that of rounding.
            np.sign(motor_velocity) * (np.abs(motor_velocity) > _RESTING * np.max(np.abs(motor_velocity))),
            np.ones(position.size),
        ]
    )


def _values(x: FloatArray, frequency: float) -> dict[str, float]:
    """Return a solution as the parameters of a flexible joint, with both sides' frictions halved."""
    motor, load, viscous, coulomb, offset = map(float, x)
    values = {"motor_inertia": motor, "load_inertia": load, "offset": offset, **spring_at(frequency, load, _DAMPING)}
    for side in ("motor", "load"):
        values |= {f"{side}_viscous": max(0.5 * viscous, 0.0), f"{side}_coulomb": max(0.5 * coulomb, 0.0)}
    return values
