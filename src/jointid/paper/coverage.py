"""How often an interval holds the truth: the paper's statistics against those of the output sensitivities.

Many noisy runs of the twin are identified from torque alone by least squares. Each time two intervals of 2 sigma are
formed about the same estimate, and it is counted how often each holds the truth. An honest one does in about 95 % of
the runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.progress import Progress, silent
from jointid.data.record import FloatArray
from jointid.data.signals import Filtering
from jointid.estimation.flexible import inverse_model_covariance, refined_least_squares
from jointid.estimation.problem import Problem, torque_problem
from jointid.inference.uncertainty import sandwich
from jointid.paper.twin import twin
from jointid.simulation.closed_loop import in_threads

_ENOUGH = 1e-6  # relative: far below a deviation


@dataclass(frozen=True, slots=True)
class Coverage:
    """How often 2-sigma intervals held the truth, by parameter.

    Attributes:
        runs: how many.
        inverse_model: share by the paper's statistics.
        sensitivities: share by the output sensitivities, robust to autocorrelation.
        spread: standard deviation of the estimates over the runs, relative to the truth.
        bias: mean error over the runs, in those standard deviations.
    """

    runs: int
    inverse_model: Mapping[str, float]
    sensitivities: Mapping[str, float]
    spread: Mapping[str, float]
    bias: Mapping[str, float]


def coverage(runs: int, loop: Literal["L19", "L30"] = "L19", seed: int = 1, progress: Progress = silent) -> Coverage:
    """Identify the twin from its torque many times, with white noise on the log that gives the paper's 8 %.

    Args:
        runs: how many.
        loop: of the twin.
        seed: of the first run's noise; the others follow.
        progress: is told every hundredth run.
    """
    axis, noisy = twin(loop, noise="none"), twin(loop, noise="white")
    record = axis.record.without("motor_position", "load_position")
    clean = torque_problem(record, axis.loop, Filtering(), axis.loop.joint.parameters)
    still = tuple(p.fixed(0.0) if p.name == "initial_velocity" else p for p in clean.parameters)
    clean = replace(clean, parameters=still)
    names = [p.name for p in clean.free_joint]
    truth = np.array([axis.truth[name] for name in names])

    def one(number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        noise = noisy.noise * np.random.default_rng(seed + number).standard_normal(clean.measured.size)
        problem = replace(clean, measured=clean.measured + noise)
        if number % 100 == 99:
            progress(f"{number + 1} of {runs} runs")
        return _estimated(problem, np.append(truth, 0.0), len(names))

    found = in_threads(one, range(runs))
    estimates, paper, honest = (np.array(column) for column in zip(*found, strict=True))
    error = estimates - truth
    scatter = error.std(axis=0, ddof=1)

    def share(std: FloatArray) -> dict[str, float]:
        return dict(zip(names, map(float, np.mean(np.abs(error) <= 2 * std, axis=0)), strict=True))

    return Coverage(
        runs,
        share(paper),
        share(honest),
        dict(zip(names, map(float, scatter / np.abs(truth)), strict=True)),
        dict(zip(names, map(float, error.mean(axis=0) / scatter), strict=True)),
    )


def _estimated(problem: Problem, start: FloatArray, joint: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the estimate and both its deviations, of the joint's parameters."""
    x, J = refined_least_squares(problem, start, _ENOUGH)
    error = problem.residual(x)
    paper = inverse_model_covariance(problem, x, error)
    return x[:joint], paper.std, sandwich(J, J, error).std[:joint]
