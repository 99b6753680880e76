"""The least deviations that an unbiased estimator has on the twin, which a study compares with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import fftconvolve

from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.twin import twin
from jointid.records.signals.filtering import Filtering
from studies.registry import LEAST


def deviations(cutoff: float) -> np.ndarray:
    """Return the deviations of least squares under white noise on the log, from the sensitivities at the truth."""
    axis, noise = twin("L19", noise="none"), twin("L19", noise="white").noise
    record = axis.record.without("motor_position", "load_position")
    problem = torque_problem(record, axis.loop, Filtering(cutoff=cutoff), axis.loop.joint.parameters)
    still = tuple(p.fix(0.0) if p.name == "initial_velocity" else p for p in problem.parameters)
    problem = replace(problem, parameters=still)
    _, J = problem.linearise(problem.vector({**axis.truth, "initial_position": 0.0}))
    # Of rows so far apart, white noise of 1 leaves the covariance of the filter's answers to single samples.
    keep, samples = problem.filtering.decimation or 1, problem.measured.size
    impulses = np.zeros((samples, keep))
    impulses[samples // 2 + np.arange(keep), np.arange(keep)] = 1.0
    answers = problem.filter(impulses)
    by_lag = sum(np.correlate(answer, answer, "full") for answer in answers.T)
    norms = np.linalg.norm(J, axis=0)
    inverse = np.linalg.pinv(J / norms)
    filtered = np.array([fftconvolve(row, by_lag, "same") for row in inverse])
    return np.asarray(noise * np.sqrt(np.sum(inverse * filtered, axis=1)) / norms)[: len(problem.free_joint)]


def test_no_wider_band_would_tell_the_inertias_or_the_stiffness_better() -> None:
    """White noise is fitted best on the whole band (Gauss and Markov); 60 Hz leave little of that out."""
    best = deviations(400.0)
    assert np.all(deviations(60.0) <= 1.03 * best)
    names = [p.name for p in twin("L19", noise="none").loop.joint.parameters]
    for name, least in LEAST.items():
        assert best[names.index(name)] == pytest.approx(least, rel=0.01), name
