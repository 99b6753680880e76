"""Starts for a flexible joint from the controller turned round: near the truth, none where the torque is still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.starts.flexible_joint import antiresonance_starts, frequency_of
from jointid.models.friction import AsymmetricFriction
from jointid.records.signals.filtering import Filtering
from tests.plants import prismatic


@pytest.mark.parametrize("changes", [0, 2])
def test_a_torque_that_stays_gives_no_start(changes: int) -> None:
    """Whether from the first sample on, or from one that the memory of the law needs."""
    case = prismatic(0)
    torque = case.clean.torque
    assert torque is not None
    record = replace(case.clean, torque=replace(torque, values=(np.arange(torque.values.size) < changes) * 1.0))
    record = replace(record, injected=None)
    assert antiresonance_starts(torque_problem(record, case.loop, Filtering(), case.loop.joint.parameters)) == []


@pytest.mark.parametrize("seed", [1, 2])
def test_without_a_simulation_the_best_start_is_near_the_truth(seed: int) -> None:
    """The friction is told whole, and begins in halves; the offset is told, and the motion begins where it does."""
    case = prismatic(seed)
    problem = torque_problem(case.clean, case.loop, Filtering(), case.loop.joint.parameters)
    starts = antiresonance_starts(problem)
    assert len(starts) == 8
    best, truth = starts[0], case.truth
    assert best.keys() == {p.name for p in problem.parameters}
    assert frequency_of(best) == pytest.approx(frequency_of(truth), rel=0.1)
    for name, within in (("stiffness", 0.3), ("motor_inertia", 0.1), ("load_inertia", 0.35), ("offset", 0.02)):
        assert best[name] == pytest.approx(truth[name], rel=within), name
    for name in ("viscous", "coulomb"):
        assert best[f"motor_{name}"] == best[f"load_{name}"]
        whole = truth[f"motor_{name}"] + truth[f"load_{name}"]
        assert 2 * best[f"motor_{name}"] == pytest.approx(whole, rel=0.05)


def test_parameters_that_are_known_stay_and_frictions_by_direction_begin_alike() -> None:
    case = prismatic(2)
    joint = replace(case.loop.joint, friction=AsymmetricFriction())
    parameters = tuple(p.fix(123.0) if p.name == "damping" else p for p in joint.parameters)
    loop = replace(case.loop, joint=joint)
    for start in antiresonance_starts(torque_problem(case.clean, loop, Filtering(), parameters)):
        assert start["damping"] == 123.0
        assert start["load_coulomb_forwards"] == start["load_coulomb_backwards"] > 0
