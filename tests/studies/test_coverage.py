"""What an estimate says of itself, over hundreds of runs; the seeds are fixed once and never retuned.

Over 1,000 runs the shares of the disturbance are 0.95 to 0.98, too (docs/methods.md); here fewer are made, so that a
share wanders by one more hundredth.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from scipy.signal import fftconvolve

from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.published import SYMBOLS
from jointid.paper.twin import TABLE_2, twin
from jointid.records.signals.filtering import Filtering
from studies.coverage import Coverage, coverage

RUNS, FEWER = 1000, 300


@pytest.fixture(scope="module")
def found() -> Coverage:
    return coverage(RUNS)


@pytest.mark.statistical
def test_the_paper_s_intervals_miss_the_frictions_and_the_reported_ones_hold(found: Coverage) -> None:
    for name in ("motor_viscous", "load_viscous"):
        assert found.inverse_model[name] < 0.5
    for name, share in found.sensitivities.items():
        # The offset is told by the mean alone: few degrees of freedom know its noise, and of two estimates of that the
        # larger counts, so that white noise, of which one would do, is covered too much.
        assert 0.93 <= share <= (0.99 if name == "offset" else 0.975), name


@pytest.mark.statistical
def test_the_estimates_are_unbiased_and_as_sharp_as_they_can_be(found: Coverage) -> None:
    assert all(abs(bias) <= 0.2 for bias in found.bias.values())
    assert found.spread["stiffness"] <= 0.004
    assert found.spread["load_inertia"] * TABLE_2["load_inertia"] <= 0.12
    best = dict(zip(found.spread, deviations(400.0), strict=True))
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        assert found.spread[name] * abs(TABLE_2[name]) <= 1.07 * best[name], name  # of 1,000 runs to 2 % a deviation
    assert found.spread["motor_viscous"] > 0.05  # torque alone does not tell it from the load's


def deviations(cutoff: float) -> np.ndarray:
    """Return the deviations of least squares under white noise on the log, from the sensitivities at the truth."""
    axis, noise = twin("L19", noise="none"), twin("L19", noise="white").noise
    record = axis.record.without("motor_position", "load_position")
    problem = torque_problem(record, axis.loop, Filtering(cutoff=cutoff), axis.loop.joint.parameters)
    still = tuple(p.fixed(0.0) if p.name == "initial_velocity" else p for p in problem.parameters)
    problem = replace(problem, parameters=still)
    _, J = problem.linearised(problem.vector({**axis.truth, "initial_position": 0.0}))
    # Of rows so far apart, white noise of 1 leaves the covariance of the filter's answers to single samples.
    keep, samples = problem.filtering.decimation or 1, problem.measured.size
    impulses = np.zeros((samples, keep))
    impulses[samples // 2 + np.arange(keep), np.arange(keep)] = 1.0
    answers = problem.filtered(impulses)
    by_lag = sum(np.correlate(answer, answer, "full") for answer in answers.T)
    norms = np.linalg.norm(J, axis=0)
    inverse = np.linalg.pinv(J / norms)
    filtered = np.array([fftconvolve(row, by_lag, "same") for row in inverse])
    return np.asarray(noise * np.sqrt(np.sum(inverse * filtered, axis=1)) / norms)[: len(problem.free_joint)]


def test_no_wider_band_would_tell_the_inertias_or_the_stiffness_better() -> None:
    """White noise is fitted best on the whole band (Gauss and Markov); 60 Hz leave little of that out."""
    best = deviations(400.0)
    assert np.all(deviations(60.0) <= 1.03 * best)
    assert best[0] == pytest.approx(0.207, abs=0.002)  # kg: no estimator knows ZZ1 of these records to 0.20


@pytest.mark.statistical
def test_the_viscous_frictions_are_said_to_be_known_by_their_sum(found: Coverage) -> None:
    require_honest_frictions(found, RUNS)


def require_honest_frictions(found: Coverage, runs: int) -> None:
    assert found.viscous_correlation <= -0.93  # the weakest of all runs
    assert found.inseparable >= 0.98
    chance = 2 * float(np.sqrt(0.95 * 0.05 / runs))
    assert 0.94 - chance <= found.viscous_sum <= 0.96 + chance


@pytest.mark.statistical
@pytest.mark.parametrize("loop", ["L19", "L30"])
def test_under_a_disturbance_in_the_loop_the_intervals_hold_and_the_colour_is_flagged(
    loop: Literal["L19", "L30"],
) -> None:
    coloured = coverage(FEWER, loop, "disturbance")
    for name, share in coloured.sensitivities.items():
        assert 0.91 <= share <= 0.99, name
    assert 0.93 <= np.mean(list(coloured.sensitivities.values())) <= 0.98
    assert all(abs(bias) <= 0.2 for bias in coloured.bias.values())
    assert coloured.not_white >= 0.98
    assert coloured.repeats <= 0.08
    require_honest_frictions(coloured, FEWER)


@pytest.mark.statistical
def test_white_noise_is_called_white_and_not_repeatable(found: Coverage) -> None:
    assert found.not_white <= 0.08
    assert found.repeats <= 0.08


@pytest.mark.statistical
def test_the_docs_show_these_numbers(found: Coverage) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    rows = {
        symbol: (int(a), int(b)) for symbol, a, b in re.findall(r"^\| (\w+) \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    }
    for name, share in found.sensitivities.items():
        paper, honest = rows[SYMBOLS.get(name, name)]
        assert abs(paper - 100 * found.inverse_model[name]) <= 1.0, name
        assert abs(honest - 100 * share) <= 1.0, name
