"""The controllers of a robot on one clock, whose step divides all their periods and delays, and the log's.

A controller acts on every so many steps and its output is held in between. A step is cut where a torque changes within
it, which is where a delay ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.models.linear import SNAP
from jointid.models.robots.dynamics import IntArray
from jointid.simulation.kernels.robot_loop import Clock, Controllers
from jointid.simulation.loop_input import LoopInput

_FINEST = 16  # steps of the shortest period, at most: the time of a simulation grows with them


@dataclass(frozen=True, slots=True, eq=False)
class RobotClock:
    """The clock of a robot's controllers.

    Attributes:
        steps: that are simulated.
        lengths: (parts,) s, of a step: in none does a torque change.
        lags: (n, parts) how many steps ago the output that acts there was put out, or a later one that is held.
        every: (n,) steps of each controller's period.
        sample_time: of the log, s.
        log_index: (samples,) which of all parts, step after step, begin at the log's instants.
        torque_index: (n, samples) those at which the newest torque of each joint, as the log shows it, begins to act.
    """

    steps: int
    lengths: FloatArray
    lags: IntArray
    every: IntArray
    sample_time: float
    log_index: IntArray
    torque_index: IntArray

    @property
    def timing(self) -> Clock:
        """Clock of the kernels."""
        return Clock(self.lengths, self.lags, self.every)

    @property
    def samples(self) -> int:
        """Of the log."""
        return self.log_index.size

    def repeat(self, joint: int, values: FloatArray) -> FloatArray:
        """Return values of a controller's periods at every step of the clock, (steps,)."""
        return np.repeat(values, self.every[joint])[: self.steps]

    def own(self, joint: int, values: FloatArray, periods: int) -> FloatArray:
        """Return values of every step at a controller's own periods, (periods, ...), the last one held."""
        every = int(self.every[joint])
        if every == 1 and len(values) == periods:
            return values
        return np.asarray(values[np.minimum(np.arange(periods) * every, (len(values) - 1) // every * every)])


def common_clock(alone: Sequence[LoopInput], names: Sequence[str]) -> RobotClock:
    """Return the clock of controllers that were prepared each alone.

    Raises:
        MethodError: logs differ in rate or length, or the periods have no common step that is worth simulating.
    """
    sample_time = alone[0].sample_time
    periods = np.array([each.law.period for each in alone])
    lasts = np.array([each.periods for each in alone]) * periods
    longest = max(float(np.max(periods)), sample_time)
    other = [
        name
        for name, each, last in zip(names, alone, lasts, strict=True)
        if abs(each.sample_time - sample_time) > SNAP * sample_time or abs(last - lasts[0]) > (1 + SNAP) * longest
    ]
    if other:
        raise MethodError(
            f"A robot is simulated along one log; the records of {join(other)} differ from that of {names[0]} in "
            "sample time or length: give all joints the same."
        )
    shortest = min(float(np.min(periods)), sample_time)
    ratios = np.array([*periods, sample_time]) / shortest
    finest = (n for n in range(1, _FINEST + 1) if np.allclose(n * ratios, np.round(n * ratios), rtol=SNAP, atol=0.0))
    step = next((shortest / n for n in finest), None)
    if step is None:
        said = join([f"{name} {1e3 * period:.6g} ms" for name, period in zip(names, periods, strict=True)])
        raise MethodError(
            f"A robot's controllers share a clock, of which each period is so many steps; received {said}, and no step "
            f"of a {_FINEST}th of the shortest or more divides them: correct the periods."
        )
    every = np.array([round(period / step) for period in periods], dtype=np.int64)
    late = np.array([each.law.delay / step for each in alone])
    whole = np.floor(late + SNAP)
    within = np.where(late - whole < SNAP, 0.0, late - whole)
    cuts = [0.0]
    for cut in sorted(within):
        if cut - cuts[-1] > SNAP:
            cuts.append(float(cut))
    lengths = np.diff([*cuts, 1.0]) * step
    lags = (whole[:, np.newaxis] + (np.array(cuts) < within[:, np.newaxis] - SNAP)).astype(np.int64)
    steps, parts = int(min(each.periods * n for each, n in zip(alone, every, strict=True))), len(cuts)
    samples = min(each.samples for each in alone)
    at = np.arange(samples) * round(sample_time / step)
    newest = np.argmin(lags, axis=1)
    started = [
        np.minimum(at // every[j] * every[j] + lags[j, newest[j]], steps - 1) * parts + newest[j]
        for j in range(len(alone))
    ]
    return RobotClock(steps, lengths, lags, every, sample_time, at * parts, np.array(started))


def pack_laws(alone: Sequence[LoopInput]) -> tuple[Controllers, FloatArray]:
    """Return the controllers filled up to equal sizes, and their answers to everything but the positions.

    States that are filled up stay 0, as elements do; the answers are (n, elements, periods), each of its own periods.
    """
    kernels = [each.kernel for each in alone]
    phases = math.lcm(*(len(kernel.A) for kernel in kernels))
    states, elements = max(k.A.shape[1] for k in kernels), max(k.limits.size for k in kernels)
    sizes = {"z": states, "e": elements}

    def pack(name: str, axes: str) -> FloatArray:
        out = np.zeros((len(kernels), phases, *(sizes[axis] for axis in axes)))
        for j, kernel in enumerate(kernels):
            values = getattr(kernel, name)
            values = np.tile(values, (phases // len(values), *(1,) * len(axes)))
            inside: tuple[int | slice, ...] = (j, slice(None), *(slice(size) for size in values.shape[1:]))
            out[inside] = values
        return out

    periods, driven = max(each.periods for each in alone), any(kernel.driven.size for kernel in kernels)
    into = np.zeros((len(kernels), periods if driven else 0, states))
    limits, gates = np.full((len(kernels), elements), np.inf), np.full((len(kernels), elements), -1)
    feedforward = np.zeros((len(kernels), elements, periods))
    for j, (kernel, each) in enumerate(zip(kernels, alone, strict=True)):
        limits[j, : kernel.limits.size], gates[j, : kernel.limits.size] = kernel.limits, kernel.gates
        feedforward[j, : kernel.limits.size, : each.periods] = each.feedforward
        if kernel.driven.size:
            into[j, : each.periods, : kernel.driven.shape[1]] = kernel.driven
    shapes = {"A": "zz", "Bq": "z", "F": "ze", "C": "ez", "D": "e", "E": "ee"}
    A, Bq, F, C, D, E = (pack(name, axes) for name, axes in shapes.items())
    outputs, taps = np.array([kernel.output for kernel in kernels]), np.array([kernel.tap for kernel in kernels])
    return Controllers(A, Bq, F, C, D, E, limits, gates, into, outputs, taps), feedforward
