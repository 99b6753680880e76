"""Random plants identified from nothing, or from wrong starts: whether the search ends at the noise, and its cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.errors import JointidError
from jointid.common.parameters import Parameter
from jointid.diagnostics.identify import identify
from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Record
from tests.plants import Case, prismatic, rotary

FAMILIES = {"prismatic": prismatic, "rotary": rotary}
NOISE = 0.04


@dataclass(frozen=True, slots=True)
class PlantRun:
    """How one plant went.

    Attributes:
        ratio: of the criterion at the end over that at the truth; infinite where there is no stiffness.
        simulations: of the search up to its last step.
        error: what was raised.
    """

    ratio: float
    simulations: int
    error: str = ""

    @property
    def at_noise(self) -> bool:
        """True if the search ended at the noise."""
        return self.ratio <= 1.01


def judge(seed: int, family: Literal["prismatic", "rotary"], spread: float = 0.0) -> PlantRun:
    """Identify a plant, from nothing or from starts within a factor of the truth."""
    case = FAMILIES[family](seed)
    record = case.noisy(NOISE, seed)
    starts: dict[str, Parameter] = {}
    if spread:
        rng = np.random.default_rng([seed, 3])
        starts = {
            p.name: replace(p, start=case.truth[p.name] * spread ** rng.uniform(-1, 1))
            for p in case.loop.joint.parameters
            if p.name != "offset"
        }
    try:
        estimate = identify(record, case.loop, parameters=starts, checks=False)
    except JointidError as error:
        return PlantRun(math.inf, 0, repr(error))
    return PlantRun(cost(case, record, estimate), estimate.fit.simulations)


def cost(case: Case, record: Record, estimate: Estimate) -> float:
    """Return the criterion at the end over the criterion at the truth, on the band of the estimate."""
    problem = torque_problem(record, case.loop, estimate.settings.filtering, case.loop.joint.parameters)
    found = {p.name: p.value for p in estimate.rows}
    if None in found.values():
        return math.inf
    assert record.reference is not None
    truth = case.truth | {"initial_position": float(record.reference.values[0]), "initial_velocity": 0.0}
    ends = [float(np.sum(problem.residual(problem.vector(v)) ** 2)) for v in (found, truth)]  # type: ignore[arg-type]
    return ends[0] / ends[1]
