"""The twin's axis under a servo drive of today: fast loops, a slow log, and the force in per mille.

The paper's loop is a proportional cascade that runs, and is logged, at 1 kHz. Here the velocity loop is a PI that runs
every 125 us, behind a filter of the velocity and before a notch; the position loop runs every 1 ms, with full velocity
feed-forward; the command comes every 2 ms and is filled in by lines, an acceleration feed-forward acts on the force;
and what is logged, every 2 ms, is the command and the force, in per mille of the rated one. All numbers are ours; the
axis, its motion and its pulses are those of `twin`.

It is identified from force and command alone, and the errors are set beside what the output sensitivities foretell.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.models.controllers import Cascade, FirstOrder, Notch
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.paper.twin import DURATION, RESIDUAL, TABLE_2, Twin
from jointid.records.record import Channel, Injection, Record, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import simulate_torque
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulated import require_success

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
    loop = ClosedLoop(FlexibleJoint("prismatic"), SERVO)
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
    clean = require_success(simulate_torque(loop, prepare(loop, driven), TABLE_2)).torque
    white = np.random.default_rng(seed).standard_normal(reference.size)
    sd = residual * float(np.linalg.norm(_seen(clean)) / np.linalg.norm(_seen(white)))
    return Twin(logged(clean + sd * white), loop, dict(TABLE_2), sd)


def judge(seed: int) -> dict[str, float]:
    """Return the errors of least squares from the truth, in the deviations that the sensitivities foretell."""
    problem = _problem(servo_twin(seed=seed))
    truth, names = _truth(problem), [p.name for p in problem.free_joint]
    x = descend(problem, truth, _ENOUGH).x
    return {name: float((x[i] - truth[i]) / _foretold()[i]) for i, name in enumerate(names)}


@cache
def _foretold() -> FloatArray:
    """Return the deviations of the joint's parameters under the twin's white noise, and rounding, on the log."""
    axis = servo_twin()
    problem = _problem(axis)
    J = problem.linearise(_truth(problem))[1]
    whole = float(np.hypot(axis.noise, RATED / 1000 / np.sqrt(12)))
    draws = np.random.default_rng(0).standard_normal((problem.measured.size, _DRAWS))
    answers = np.linalg.pinv(J) @ problem.filter(whole * draws)
    return np.asarray(answers.std(axis=1)[: len(problem.free_joint)])


def _problem(axis: Twin) -> ClosedLoopProblem:
    problem = torque_problem(axis.record, axis.loop, FILTERING, axis.loop.joint.parameters)
    still = tuple(p.fix(0.0) if p.name == "initial_velocity" else p for p in problem.parameters)
    return replace(problem, parameters=still)


def _truth(problem: ClosedLoopProblem) -> FloatArray:
    return problem.vector({**TABLE_2, "initial_position": 0.0})


def _seen(force: FloatArray) -> FloatArray:
    return FILTERING.resolve(LOG, "flexible").decimate(force, LOG)
