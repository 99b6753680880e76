"""Foretold intervals beside the scatter of estimates: does a planned test tell what was foretold of it?

The paper's twin is run many times with new noise, each record identified by least squares from the truth, and the
standard deviation of the estimates set against what `jointid.planning.foretell` says of the test beforehand.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.flexible import refined_least_squares
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.paper.twin import SAMPLE_TIME, Twin, twin
from jointid.planning.foretell import Noise, foretell, planned_record
from jointid.records.record import Tap
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record
from studies.seeds import judge_seeds

NoiseName: TypeAlias = Literal["white", "disturbance"]
SUMS = ("viscous", "coulomb", "inertia")
"""What both sides have: their sums are compared, too."""

_ENOUGH = 1e-6  # relative: far below a deviation


@dataclass(frozen=True, slots=True)
class Beside:
    """Foretold over empirical standard deviations of one loop, noise and tap, by parameter and by sum."""

    loop: str
    noise: str
    tap: str
    runs: int
    ratio: dict[str, float]


def compare(
    loop: Literal["L19", "L30"], noise: NoiseName, tap: str, runs: int, seed: int = 1, out: Path | None = None
) -> Beside:
    """Foretell the twin's test, make it many times, and compare; runs are kept in a folder, and found again."""
    axis, reference, injected = _test(loop, noise)
    of = Noise(log=axis.noise) if noise == "white" else Noise(force=axis.noise)
    test = planned_record(axis.loop, reference, SAMPLE_TIME, injected, tap=tap)
    told = foretell(axis.loop, axis.truth, test, of)
    settings = {"loop": loop, "noise": noise, "tap": tap, "first": seed}
    found = np.array(list(judge_seeds("studies.foretold:judge", range(runs), settings, out=out)))
    ratio = dict(zip(told.joint, map(float, told.covariance.std / found.std(axis=0, ddof=1)), strict=True))
    for name in SUMS:
        for sign, word in ((1.0, "sum"), (-1.0, "difference")):
            weights = {f"motor_{name}": 1.0, f"load_{name}": sign}
            scatter = found @ np.array([weights.get(one, 0.0) for one in told.joint])
            ratio[f"{name} {word}"] = told.std_of(weights) / float(scatter.std(ddof=1))
    return Beside(loop, noise, tap, runs, ratio)


@cache
def _test(loop: Literal["L19", "L30"], noise: NoiseName) -> tuple[Twin, FloatArray, FloatArray]:
    """Return the twin, its reference and its pulses."""
    axis = twin(loop, noise=noise)
    assert axis.record.reference is not None and axis.record.injected is not None
    return axis, axis.record.reference.values, axis.record.injected.channel.values


def judge(seed: int, loop: Literal["L19", "L30"], noise: NoiseName, tap: str, first: int) -> list[float]:
    """Make the test once, and return the joint's parameters by least squares that begins at the truth."""
    axis, reference, injected = _test(loop, noise)
    white = axis.noise * np.random.default_rng([first, seed]).standard_normal(reference.size)
    made = simulated_record(
        axis.loop, reference, axis.truth, sample_time=SAMPLE_TIME, injected=injected, tap=tap,
        torque_noise=white if noise == "white" else None, disturbance=white if noise == "disturbance" else None,
    )  # fmt: skip
    problem = torque_problem(made, axis.loop, Filtering(), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    start = problem.vector({**axis.truth, "initial_position": 0.0})
    x, _ = refined_least_squares(problem, start, _ENOUGH)
    return [float(one) for one in x[: len(problem.free_joint)]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a line of JSON for each loop, noise and tap."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--loop", action="append", choices=("L19", "L30"))
    parser.add_argument("--noise", action="append", choices=("white", "disturbance"))
    parser.add_argument("--tap", action="append", choices=[str(tap) for tap in Tap])
    parser.add_argument("--out", type=Path, help="folder in which runs are kept, and found again")
    given = parser.parse_args(arguments)
    for loop in given.loop or ("L19", "L30"):
        for noise in given.noise or ("white", "disturbance"):
            for tap in given.tap or [str(tap) for tap in Tap]:
                found = compare(loop, noise, tap, given.runs, out=given.out)
                sys.stdout.write(json.dumps(asdict(found)) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
