"""One vocabulary of a robot's parameters: the same name by IDIM and by simulation is the same sum."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from jointid.estimation.robots.numbers import robot_parameters
from jointid.models.robots.base_parameters import base_parameters
from jointid.models.robots.friction_terms import friction_terms
from jointid.models.robots.robot import Robot
from tests.robots_plants import Twin, six, two


def sums_by_idim(robot: Robot) -> dict[str, str]:
    """Return the sums of base parameters and friction by their names."""
    base, terms = base_parameters(robot), friction_terms(robot)
    found = dict(zip(base.names, base.formulas, strict=True)) | {one.name(robot): one.symbol for one in terms}
    offsets = (one.name(robot) for one in terms if one.number == "offset")
    return found | dict(zip(offsets, base.offset_formulas, strict=True))


def weights_of(formula: str) -> dict[str, float]:
    """Return the weights of a sum by symbol, whose order the first parameter decides."""
    terms = [term.partition(" * ") for term in formula.replace("- ", "+ -").split(" + ")]
    return {symbol: float(weight or 1.0) for symbol, _, weight in terms}


@pytest.mark.parametrize(("plant", "turning"), [(two, "Iyy1"), (six, "Izz1")])
def test_the_same_name_is_the_same_sum_by_both_methods(plant: Callable[[], Twin], turning: str) -> None:
    robot = plant().robot
    by_simulation = robot_parameters(robot)
    found = dict(zip(by_simulation.names, by_simulation.formulas(robot), strict=True))
    stated = sums_by_idim(robot)
    assert found.keys() == stated.keys()
    for name, formula in found.items():
        assert weights_of(formula) == pytest.approx(weights_of(stated[name]), rel=1e-3), name
    assert weights_of(found[turning])["Ia1"] == 1.0, "a rotor with its link is named after the sum"
    assert "joint1.rotor_inertia" not in found
