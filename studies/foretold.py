"""Foretold intervals beside the scatter of estimates: does a planned test tell what was foretold of it?

The paper's twin is run many times with new noise, each record identified by least squares from the truth, and the
errors set against the deviations that `jointid.planning.predict` says of the test beforehand.
"""

from __future__ import annotations

from functools import cache
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.twin import SAMPLE_TIME, Twin, twin
from jointid.planning.predict import Noise, PredictedTest, planned_record, predict_test
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record

NoiseName: TypeAlias = Literal["white", "disturbance"]
SUMS = ("viscous", "coulomb", "inertia")
"""What both sides have: their sums are compared, too."""

_ENOUGH = 1e-6  # relative: far below a deviation


@cache
def _test(loop: Literal["L19", "L30"], noise: NoiseName) -> tuple[Twin, FloatArray, FloatArray]:
    """Return the twin, its reference and its pulses."""
    axis = twin(loop, noise=noise)
    assert axis.record.reference is not None and axis.record.injected is not None
    return axis, axis.record.reference.values, axis.record.injected.channel.values


@cache
def _foretold(loop: Literal["L19", "L30"], noise: NoiseName, tap: str) -> PredictedTest:
    axis, reference, injected = _test(loop, noise)
    of = Noise(log=axis.noise) if noise == "white" else Noise(force=axis.noise)
    return predict_test(axis.loop, axis.truth, planned_record(axis.loop, reference, SAMPLE_TIME, injected, tap=tap), of)


def judge(seed: int, loop: Literal["L19", "L30"], noise: NoiseName, tap: str) -> dict[str, float]:
    """Make the test once; return the errors of least squares from the truth, in the deviations that are foretold."""
    axis, reference, injected = _test(loop, noise)
    white = axis.noise * np.random.default_rng([1, seed]).standard_normal(reference.size)
    made = simulated_record(
        axis.loop, reference, axis.truth, sample_time=SAMPLE_TIME, injected=injected, tap=tap,
        torque_noise=white if noise == "white" else None, disturbance=white if noise == "disturbance" else None,
    )  # fmt: skip
    problem = torque_problem(made, axis.loop, Filtering(), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    start = problem.vector({**axis.truth, "initial_position": 0.0})
    x = descend(problem, start, _ENOUGH).x
    told = _foretold(loop, noise, tap)
    errors = {name: float(x[i] - start[i]) for i, name in enumerate(told.joint)}
    found = {name: errors[name] / float(told.covariance.std[i]) for i, name in enumerate(told.joint)}
    for name in SUMS:
        for sign, word in ((1.0, "sum"), (-1.0, "difference")):
            weights = {f"motor_{name}": 1.0, f"load_{name}": sign}
            error = sum(weight * errors[one] for one, weight in weights.items())
            found[f"{name} {word}"] = error / told.std_of(weights)
    return found
