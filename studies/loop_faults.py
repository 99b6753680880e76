"""Faults of loop and log that are named, on the twin with one thing wrong, or nothing, at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.diagnostics.score import SolvedLoop, rank_tests
from jointid.diagnostics.search import search_faults
from jointid.estimation.descent import descend
from jointid.uncertainty.covariance import Influence
from tests.faults import Fault, Loop, Noise, line_7, on, problem, setting, solved

NOTHING = "nothing"
FREED = ("position_gain", "velocity_gain", "delay")
_LEVEL = 0.05


def name_first(seed: int, loop: Loop, noise: Noise, fault: str) -> str:
    """Return what is named first where there is a fault, or `NOTHING`; nothing is solved again, which costs less."""
    where = setting(loop)
    made = problem(where, None if fault == NOTHING else on(loop, fault), noise, seed)
    top = rank_tests(search_faults(SolvedLoop(made, solved(made, where, 1e-4)), most=0).tests, _LEVEL)[0]
    return top.name if top.p_value <= _LEVEL else NOTHING


def judge_fault(seed: int, loop: Loop, noise: Noise, fault: str) -> dict[str, str]:
    """Return the fault that there is, and what is named first."""
    return {"fault": fault, "named": name_first(seed, loop, noise, fault)}


def judge_pair(seed: int, pair: str) -> dict[str, list[str]]:
    """Return the two faults that there are on loop L19 with a force in it, and what is named, in order."""
    where = setting("L19")
    made = problem(where, on("L19", pair), "disturbance", seed)
    found = search_faults(SolvedLoop(made, solved(made, where, 1e-4))).findings
    return {"faults": pair.split(", "), "named": [one.test.name for one in found]}


@dataclass(frozen=True, slots=True)
class Freed:
    """The joint under a wrong loop, identified with the numbers of the loop that are wrong.

    Attributes:
        z: errors of the joint's parameters, in their deviations.
        relative: the same as shares of the truth.
    """

    z: dict[str, float]
    relative: dict[str, float]


def judge_freed(seed: int, noise: Noise) -> Freed:
    """Identify the joint where position_gain +3 %, velocity_gain -4 % and 0.4 ms are not declared, but free."""
    where = setting("L19")
    truth = where.truth | line_7(where.loop)
    made = problem(where, Fault(line_7), noise, seed).freeing(*FREED)
    end = descend(made, made.vector(where.truth), 1e-6)
    x, J = end.x, -end.jacobian
    std = Influence(J, made.residual(x)).by_time().std
    error = {p.name: (float(x[i] - truth[p.name]), float(std[i])) for i, p in enumerate(made.free) if p.name in truth}
    return Freed(
        {name: off / deviation for name, (off, deviation) in error.items()},
        {name: off / np.abs(truth[name]) for name, (off, _) in error.items()},
    )


def is_flagged(seed: int, noise: Noise) -> bool:
    """Return whether something is named where the same loop is wrong, not free, and an offset is not declared."""
    where = setting("L19")
    made = problem(where, Fault(line_7, offset=True), noise, seed)
    return not search_faults(SolvedLoop(made, solved(made, where))).as_declared
