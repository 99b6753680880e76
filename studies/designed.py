"""Designed tests made: what a proposed test tells beside what was foretold of it, and whether it keeps the limits.

A first record of the paper's twin is identified, and a test designed from it within the stroke, the time, the peak and
the root mean square of the force of that record. Then the test is made on many twins whose parameters are drawn from
the first interval, each with new noise, and identified by least squares. A search for a test ends by the clock, so that
the one it found is kept beside the runs of it, and found again with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np

import jointid as ji
from jointid.estimation.descent import descend
from jointid.estimation.problems.simulated import torque_problem
from jointid.models.limits import find_excess
from jointid.paper.twin import SAMPLE_TIME, twin
from jointid.simulation.loop_input import prepare

_ENOUGH = 1e-6  # relative: far below a deviation

LoopName: TypeAlias = Literal["L19", "L30"]
NoiseName: TypeAlias = Literal["white", "disturbance"]


@dataclass(frozen=True, slots=True)
class ProposedTest:
    """A designed test, and what is to be known of it to make it and to judge it.

    Attributes:
        description: of the test.
        before, foretold, floor: standard deviation of the goal by the first record, by this test, and the least that
            any has within the limits, where that is known.
        weights: of the goal, by parameter.
        limits: that it keeps.
        values: of the joint's parameters, found from the first record, by name.
        covariance: of these, in their order.
        reference, injected: the test itself, a number for each sample.
    """

    description: str
    before: float
    foretold: float
    floor: float | None
    weights: dict[str, float]
    limits: dict[str, float]
    values: dict[str, float]
    covariance: list[list[float]]
    reference: list[float]
    injected: list[float] | None


def propose(loop: LoopName, noise: NoiseName, goal: str, search_time: float) -> ProposedTest:
    """Return the test that is designed from the twin's first record."""
    axis = twin(loop, noise=noise)
    record = axis.record.without("motor_position", "load_position")
    estimate = ji.identify(record, axis.loop, filtering=ji.Filtering(cutoff=60.0), checks=False)
    known = {"log": axis.noise} if noise == "white" else {"force": axis.noise}
    design = ji.design(estimate, record, noise=known, goal=goal, search_time=search_time)
    told = design.proposed
    played = design.records()[0]
    assert design.present is not None and played.reference is not None
    own = [p.name for p in axis.loop.joint.parameters]
    rows = [p.name for p in estimate.rows if p.free and p.of_joint]
    return ProposedTest(
        design.description, design.present.std_of(design.goal.weights), told.std_of(design.goal.weights), design.floor,
        dict(design.goal.weights), design.axes[0].limits.stated, {name: float(estimate.values[name]) for name in own},
        estimate.covariance_of(rows).matrix.tolist(), played.reference.values.tolist(),
        None if played.injected is None else played.injected.channel.values.tolist(),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class MadeTest:
    """Errors of the joint's parameters by one test that was made, and by what it passed a limit, as a share."""

    errors: list[float]
    over: float


@dataclass(frozen=True, slots=True)
class JudgedDesign:
    """A designed test that was made once.

    Attributes:
        z: error of the goal, in predicted deviations.
        share: predicted deviation of the goal, as a share of that by the first record.
        over: by what the test passed a limit, as a share.
    """

    z: float
    share: float
    over: float


def judge_design(seed: int, loop: LoopName, noise: NoiseName, goal: str, search_time: float) -> JudgedDesign:
    """Design a test, once for each process, and make it once."""
    test = _proposed(loop, noise, goal, search_time)
    made = make_test(seed, loop, noise, test)
    errors = dict(zip(test.values, made.errors, strict=True))
    error = sum(weight * errors[name] for name, weight in test.weights.items())
    return JudgedDesign(error / test.foretold, test.foretold / test.before, made.over)


_proposed = lru_cache(maxsize=None)(propose)


def make_test(seed: int, loop: LoopName, noise: NoiseName, asked: ProposedTest) -> MadeTest:
    """Make the test once, on a twin that is drawn from the first interval, and identify that by least squares."""
    axis = twin(loop, noise=noise)
    reference, own = np.array(asked.reference), list(asked.values)
    rng = np.random.default_rng([seed, 20])
    drawn = rng.multivariate_normal(list(asked.values.values()), np.array(asked.covariance), method="eigh")
    truth = {n: v if n == "offset" else max(v, 0.0) for n, v in zip(own, map(float, drawn), strict=True)}
    white = axis.noise * rng.standard_normal(reference.size)
    record = ji.simulated_record(
        axis.loop, reference, truth, sample_time=SAMPLE_TIME,
        injected=None if asked.injected is None else np.array(asked.injected),
        torque_noise=white if noise == "white" else None, disturbance=white if noise == "disturbance" else None,
    )  # fmt: skip
    assert record.torque is not None
    run = ji.simulate(axis.loop, prepare(axis.loop, record), truth)
    assert run.load_position is not None
    places, torque = np.concatenate([reference, run.motor_position, run.load_position]), record.torque.values
    found = {"stroke": np.ptp(places), "torque": np.abs(torque).max(), "rms_torque": np.sqrt(np.mean(torque**2))}
    over = max(find_excess(ji.AxisLimits(**asked.limits), found).values(), default=0.0)
    problem = torque_problem(record, axis.loop, ji.Filtering(cutoff=60.0), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    start = problem.vector({**truth, "initial_position": float(reference[0])})
    x = descend(problem, start, _ENOUGH).x
    return MadeTest([float(x[k]) - truth[name] for k, name in enumerate(own)], float(over))
