"""Springs in pieces, identified from torque and reference; and where they are refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.estimation.descent import History, Solved
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.models.springs import Spring
from studies.mechanics import Spoiled, spoiled
from tests.estimates import identify
from tests.plants import sprung_axis, with_spring


def test_the_search_goes_on_from_the_best_start_of_the_law(monkeypatch: pytest.MonkeyPatch) -> None:
    case, record = sprung_axis()
    ends, solve = list[Solved](), History.solve

    def watch(history: History, problem: ClosedLoopProblem, x: np.ndarray, solver: Any = None) -> Solved:
        if problem.joint != case.loop.joint:
            return solve(history, problem, x, solver)
        if solver is None:  # it goes on to the end
            (here,) = (end for end in ends if end.x is x)
            assert here.norm <= (1 + 1e-5) * min(end.norm for end in ends) < ends[0].norm
            raise MethodError("enough")
        end = solve(history, problem, x, solver)
        if not ends:  # all starts may reach one end: the first is made a worse one
            end = end._replace(solution=replace(end.solution, residual=1e3 * end.solution.residual))
        ends.append(end)
        return end

    monkeypatch.setattr(History, "solve", watch)
    with pytest.raises(MethodError, match="enough"):
        identify(record, case.loop, ji.DIDIM(frequency=case.mode))


@pytest.mark.slow
@pytest.mark.parametrize("spring", ["backlash", "cubic-hysteretic", "backlash-cubic"])
def test_a_spring_is_found_with_the_inertias_beside_it(spring: str) -> None:
    case, record = sprung_axis(spring)
    found = identify(record, case.loop, ji.DIDIM(frequency=case.mode))
    for name in ("load_inertia", "motor_inertia", *(p.name for p in Spring(spring).parameters[:-1])):
        row = found[name]
        assert abs(row.value - case.truth[name]) < 3 * row.stderr, name
        assert row.stderr < 0.05 * row.value, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "spring", "seed"), [("backlash", Spring("backlash"), 0), ("spring in pieces", Spring("three-piece"), 0)]
)
def test_recovers_the_spring_of_another_simulator(fault: str, spring: Spring, seed: int) -> None:
    made = spoiled(seed, fault, 8.0)
    linear = identify(made.record, made.axis.loop)
    found = identify(made.record, with_spring(made.axis.loop, spring))
    truth = of_pieces(made, spring)
    for name, value in truth.items():
        row = found[name]
        assert abs(row.value - value) < 3 * row.stderr, name
    off = linear["stiffness"].value
    assert abs(off / truth["stiffness"] - 1) > 0.2
    assert found.fit.filtered_error < 0.3 * linear.fit.filtered_error


def of_pieces(made: Spoiled, spring: Spring) -> dict[str, float]:
    """The parameters of the spring that a drive of the study has."""
    truth = made.truth
    K = truth["stiffness"]
    if spring.name == "backlash":
        return {"stiffness": K, "gap": 2 * truth["gap"]}
    second, torque = K + truth["more"], K * truth["bend"]
    then = torque + second * (truth["next_bend"] - truth["bend"])
    third = second + truth["still_more"]
    return {"stiffness": K, "stiffness_2": second, "stiffness_3": third, "torque_1": torque, "torque_2": then}
