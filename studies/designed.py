"""Designed tests made: what a proposed test tells beside what was foretold of it, and whether it keeps the limits.

A first record of the paper's twin is identified, and a test designed from it within the stroke, the time, the peak and
the root mean square of the force of that record. Then the test is made on many twins whose parameters are drawn from
the first interval, each with new noise, and identified by least squares.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Literal

import numpy as np

import jointid as ji
from jointid.estimation.methods.flexible import refined_least_squares
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.twin import SAMPLE_TIME, twin
from jointid.planning.design import Design, plan_from_estimate
from jointid.planning.limits import passed, reached
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.loop_input import prepare

_ENOUGH = 1e-6  # relative: far below a deviation


def planned(loop: Literal["L19", "L30"], noise: Literal["white", "disturbance"], goal: str, seconds: float) -> Design:
    """Return the test that is designed from the twin's first record."""
    axis = twin(loop, noise=noise)
    record = axis.record.without("motor_position", "load_position")
    estimate = ji.identify(record, axis.loop, filtering=ji.Filtering(cutoff=60.0), loop_check=False)
    known = ji.Noise(log=axis.noise) if noise == "white" else ji.Noise(force=axis.noise)
    return plan_from_estimate(estimate, record, noise=known, goal=goal, seconds=seconds)


def made(
    loop: Literal["L19", "L30"], noise: Literal["white", "disturbance"], goal: str, runs: int, seconds: float
) -> dict[str, object]:
    """Design a test, make it many times, and return how far what was foretold is true."""
    axis = twin(loop, noise=noise)
    record = axis.record.without("motor_position", "load_position")
    filtering = ji.Filtering(cutoff=60.0)
    estimate = ji.identify(record, axis.loop, filtering=filtering, loop_check=False)
    design = planned(loop, noise, goal, seconds)
    told, limits = design.proposed, ji.AxisLimits(**design.limits)
    own = [p.name for p in axis.loop.joint.parameters]
    rows = [i for i, p in enumerate(q for q in estimate.params if q.free) if p.of_joint]
    covariance = estimate.params.covariance[np.ix_(rows, rows)]

    def one(number: int) -> tuple[list[float], float]:
        rng = np.random.default_rng([number, 20])
        drawn = rng.multivariate_normal([estimate.values[name] for name in own], covariance, method="eigh")
        truth = {n: v if n == "offset" else max(v, 0.0) for n, v in zip(own, map(float, drawn), strict=True)}
        white = axis.noise * rng.standard_normal(told.reference.size)
        test = ji.simulated_record(
            axis.loop, told.reference, truth, sample_time=SAMPLE_TIME, injected=told.injected,
            torque_noise=white if noise == "white" else None, disturbance=white if noise == "disturbance" else None,
        )  # fmt: skip
        assert test.torque is not None
        experiment = prepare(axis.loop, test)
        run = ji.simulate(axis.loop, experiment, truth)
        found = reached(run, told.reference, test.torque.values, SAMPLE_TIME)
        over = max(passed(limits, found).values(), default=0.0)
        problem = torque_problem(test, axis.loop, filtering, axis.loop.joint.parameters)
        problem = problem.keeping({"initial_velocity": 0.0})
        start = problem.vector({**truth, "initial_position": float(told.reference[0])})
        x = refined_least_squares(problem, start, _ENOUGH)[0]
        return [float(x[k]) - truth[name] for k, name in enumerate(own)], over

    found = in_threads(one, range(runs))
    errors = np.array([error for error, _ in found])
    w = np.array([design.goal.weights.get(name, 0.0) for name in own])
    scatter = float(np.sqrt(np.mean((errors @ w) ** 2)))
    assert design.present is not None
    before = design.present.std_of(design.goal.weights)
    return {
        "loop": loop, "noise": noise, "goal": goal, "runs": runs, "test": design.description,
        "before": before, "foretold": told.std_of(design.goal.weights), "scatter": scatter, "floor": design.floor,
        "of_what_the_floor_allows": None if design.floor is None else (before - scatter) / (before - design.floor),
        "passed": sum(over > 0 for _, over in found), "worst": max(over for _, over in found),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a line of JSON for each loop, noise and goal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--loop", action="append", choices=("L19", "L30"))
    parser.add_argument("--noise", action="append", choices=("white", "disturbance"))
    given = parser.parse_args(arguments)
    loops: Sequence[Literal["L19", "L30"]] = given.loop or ("L19",)
    noises: Sequence[Literal["white", "disturbance"]] = given.noise or ("disturbance", "white")
    for loop in loops:
        for noise in noises:
            for goal in ("stiffness", "motor_viscous - load_viscous"):
                sys.stdout.write(json.dumps(made(loop, noise, goal, given.runs, given.seconds)) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
