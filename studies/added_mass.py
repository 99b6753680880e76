"""Two records of the twin, the second with 10 kg on its load: what they add, and the gain of a drive that they tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from jointid.diagnostics.identify import identify
from jointid.estimation.identify_several import SOLVER, by_itself, whiten_fit
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.problems.base import INITIAL_STATE
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.several_records import SeveralRecords, several
from jointid.models.joints import ClosedLoop
from jointid.paper.twin import Twin, twin
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record
from jointid.solvers.solve import solve

Noise = Literal["disturbance", "white", "none"]

KILOGRAMS = 10.0
GAIN = 1.03
FRICTION = ("motor_viscous", "motor_coulomb", "load_viscous", "load_coulomb")
QUICK = DIDIM(frequency=30.0)


@cache
def twins(noise: Noise) -> Twin:
    """Return the twin with that noise."""
    return twin(noise=noise)


def heavier(truth: Mapping[str, float]) -> dict[str, float]:
    """Return the twin with 10 kg on the load, and nothing else changed; Table 4 changes all of it a little."""
    return {**truth, "load_inertia": truth["load_inertia"] + KILOGRAMS}


def logged(loop: ClosedLoop, values: Mapping[str, float], noise: Noise = "none", seed: int = 0) -> Record:
    """Return a run of a twin with the noise of the paper's 8 %, as its drive logs it."""
    axis = twins(noise)
    reference, injected = axis.record.reference, axis.record.injected
    assert reference is not None
    assert injected is not None
    random = axis.noise * np.random.default_rng(seed).standard_normal(len(reference))
    record = simulated_record(
        loop, reference.values, values, sample_time=1e-3, injected=injected.channel.values,
        disturbance=random if noise == "disturbance" else None, torque_noise=random if noise == "white" else None,
        name=f"run {seed}",
    )  # fmt: skip
    return record.without("motor_position", "load_position")


def problem_of(record: Record, loop: ClosedLoop) -> ClosedLoopProblem:
    """Return the problem of a record that begins at rest."""
    state = (INITIAL_STATE[0], INITIAL_STATE[1].fix(0.0))
    return torque_problem(record, loop, Filtering(), loop.joint.parameters, state)


def judge_difference(seed: int, noise: Noise) -> dict[str, float]:
    """Return the errors of the added mass, kg, by fits of each record alone, and of both with all else shared.

    From the truth, where the search of every run ends; every fit is run to its end.
    """
    axis = twins(noise)
    truths = [dict(axis.truth), heavier(axis.truth)]
    problems = [problem_of(logged(axis.loop, t, noise, 2 * seed + k), axis.loop) for k, t in enumerate(truths)]
    alone = [by_itself(problem, values) for problem, values in zip(problems, truths, strict=True)]
    apart = alone[1].values["load_inertia"] - alone[0].values["load_inertia"]
    alone = [whiten_fit(one) for one in alone]
    criterion = several(problems, [("load_inertia",)] * 2).weighing([one.weights for one in alone])
    end = solve(criterion, SOLVER, criterion.vector([one.end.x for one in alone]))
    found = dict(zip([p.name for p in criterion.free], end.x, strict=True))
    together = float(found["load_inertia@2"] - found["load_inertia@1"])
    return {"apart": apart - KILOGRAMS, "together": together - KILOGRAMS}


@dataclass(frozen=True, slots=True)
class GainRun:
    """The gain of a drive whose torque is 3 % more than its log says, friction free in each record.

    Attributes:
        error: relative. z: in its deviations. differs: whether the records are said to disagree, which they do not.
    """

    error: float
    z: float
    differs: bool


def judge_gain(seed: int, noise: Noise) -> GainRun:
    """Identify the gain of a drive by a known mass."""
    axis = twins(noise)
    loaded = heavier(axis.truth) | {"motor_coulomb": 11.0, "load_coulomb": 12.0, "load_viscous": 130.0}
    records = [
        logged(axis.loop, {name: value / GAIN for name, value in truth.items()}, noise, 2 * seed + k)
        for k, truth in enumerate((axis.truth, loaded))
    ]
    shared = SeveralRecords(added_inertia=[0.0, KILOGRAMS], own=[(), FRICTION], free=["drive_gain"])
    found = identify(records, axis.loop, several=shared, method=QUICK)
    told, agreement = found["drive_gain"], found.checks.agreement
    assert told.value is not None and told.stderr is not None and agreement is not None
    error = told.value - GAIN
    return GainRun(error / GAIN, error / told.stderr, agreement.differs)
