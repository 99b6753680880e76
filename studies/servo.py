"""The twin's axis under a servo drive of today: fast loops, a slow log, and the force in per mille.

The paper's loop is a proportional cascade that runs, and is logged, at 1 kHz. Here the velocity loop is a PI that runs
every 125 us, behind a filter of the velocity and before a notch; the position loop runs every 1 ms, with full velocity
feed-forward; the command comes every 2 ms and is filled in by lines, an acceleration feed-forward acts on the force;
and what is logged, every 2 ms, is the command and the force, in per mille of the rated one. All numbers are ours; the
axis, its motion and its pulses are those of `twin`.

`accuracy` identifies it many times from force and command alone, and sets the scatter beside what the output
sensitivities foretell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.flexible import refined_least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.models.controllers import Cascade, FirstOrder, Notch
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.paper.twin import DURATION, RESIDUAL, TABLE_2, Twin
from jointid.records.record import Channel, Injection, Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import simulate_torque
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulated import require_finished
from studies.seeds import judge_seeds

LOG = 2e-3
"""Seconds between the samples of the log, and between the commands."""

RATED = 1000.0
"""N: the rated force; the log resolves a thousandth of it."""

SERVO = Cascade(
    position_gain=80.0,
    velocity_gain=8557.0,
    integral_gain=40.0,
    velocity_filter=FirstOrder(0.5e-3),
    velocity_feedforward=1.0,
    acceleration_feedforward=60.0,
    torque_filters=(Notch(180.0, 60.0, 0.1),),
    limit=RATED,
    period=125e-6,
    position_period=1e-3,
    delay=125e-6,
    interpolation="linear",
)
"""The drive; its controller unit is the newton."""

FILTERING = Filtering(cutoff=60.0)
"""Twice the resonance, as for the paper's axis; a log of 500 Hz would by default be compared below 30 Hz."""

_ENOUGH = 1e-6  # relative: far below a deviation
_DRAWS = 1000  # of the log's noise, through the filter and the pseudo-inverse: 2 % of a deviation


def servo_twin(*, residual: float = RESIDUAL, seed: int = 1) -> Twin:
    """Return one seeded run: force and command, with white noise on the log that gives that share of the force."""
    loop = ClosedLoop(FlexibleJoint(), SERVO)
    reference = trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, LOG, duration=DURATION)
    known = pulses(reference.size, LOG, height=150.0, width=0.02, every=0.4, seed=0)

    def logged(force: FloatArray) -> Record:
        step = RATED / 1000
        return Record(
            torque=Channel(step * np.round(force / step), "N", LOG, Timing.HELD),
            reference=Channel(reference, "m", LOG),
            injected=Injection(Channel(known, "N", LOG, Timing.HELD)),
            name="servo twin",
        )

    driven = logged(np.zeros(reference.size))
    clean = require_finished(simulate_torque(loop, prepare(loop, driven), TABLE_2)).torque
    white = np.random.default_rng(seed).standard_normal(reference.size)
    sd = residual * float(np.linalg.norm(_seen(clean)) / np.linalg.norm(_seen(white)))
    return Twin(logged(clean + sd * white), loop, dict(TABLE_2), sd)


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How far the estimates of many runs scatter, by parameter, beside what was foretold.

    Attributes:
        runs: how many.
        spread: standard deviation over the runs. foretold: by the output sensitivities at the truth. Both relative.
        bias: mean error over the runs, in those deviations.
    """

    runs: int
    spread: Mapping[str, float]
    foretold: Mapping[str, float]
    bias: Mapping[str, float]


def accuracy(runs: int, seed: int = 1, out: Path | None = None) -> Accuracy:
    """Identify the servo's twin from force and command many times; runs are kept in a folder, and found again."""
    found = np.array(list(judge_seeds("studies.servo:judge", range(seed, seed + runs), {}, out=out)))
    axis = servo_twin(seed=seed)
    problem = _problem(axis)
    names = [p.name for p in problem.free_joint]
    truth = np.array([axis.truth[name] for name in names])
    spread = found.std(axis=0, ddof=1)
    return Accuracy(
        runs,
        _by_name(names, spread / np.abs(truth)),
        _by_name(names, _foretold(problem, axis.noise) / np.abs(truth)),
        _by_name(names, (found.mean(axis=0) - truth) / spread),
    )


def judge(seed: int) -> list[float]:
    """Return the joint's parameters by least squares that begins at the truth."""
    problem = _problem(servo_twin(seed=seed))
    x, _ = refined_least_squares(problem, _truth(problem), _ENOUGH)
    return [float(one) for one in x[: len(problem.free_joint)]]


def _foretold(problem: ClosedLoopProblem, noise: float) -> FloatArray:
    """Return the deviations of the joint's parameters under white noise of that size, and rounding, on the log."""
    J = problem.linearised(_truth(problem))[1]
    whole = float(np.hypot(noise, RATED / 1000 / np.sqrt(12)))
    draws = np.random.default_rng(0).standard_normal((problem.measured.size, _DRAWS))
    answers = np.linalg.pinv(J) @ problem.filtered(whole * draws)
    return np.asarray(answers.std(axis=1)[: len(problem.free_joint)])


def _problem(axis: Twin) -> ClosedLoopProblem:
    problem = torque_problem(axis.record, axis.loop, FILTERING, axis.loop.joint.parameters)
    still = tuple(p.fixed(0.0) if p.name == "initial_velocity" else p for p in problem.parameters)
    return replace(problem, parameters=still)


def _truth(problem: ClosedLoopProblem) -> FloatArray:
    return problem.vector({**TABLE_2, "initial_position": 0.0})


def _seen(force: FloatArray) -> FloatArray:
    return FILTERING.resolved(LOG, "flexible").decimate(force, LOG)


def _by_name(names: list[str], values: FloatArray) -> dict[str, float]:
    return dict(zip(names, map(float, values), strict=True))
