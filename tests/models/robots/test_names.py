"""One vocabulary of a robot's parameters: every method has the same names, each of the same sum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.robots.numbers import robot_parameters
from jointid.models.robots.base_parameters import base_parameters
from jointid.models.robots.friction_terms import friction_terms
from jointid.models.robots.robot import Robot
from tests.estimation.robots.twin import arm
from tests.public_arms import urdf_of
from tests.robots_plants import six, two


def sums_by_idim(robot: Robot) -> dict[str, str]:
    """Return the sums of base parameters and friction by their names."""
    base, terms = base_parameters(robot), friction_terms(robot)
    found = dict(zip(base.names, base.formulas, strict=True)) | {one.name(robot): one.symbol for one in terms}
    offsets = (one.name(robot) for one in terms if one.number == "offset")
    return found | dict(zip(offsets, base.offset_formulas, strict=True))


def public_arm(name: str, place: Path) -> Robot:
    pytest.importorskip("mujoco")
    (place / "arm.urdf").write_text(urdf_of(name))
    return ji.robots.load_robot(place / "arm.urdf")


@pytest.mark.parametrize(
    "plant", [lambda _: two().robot, lambda _: six().robot,
              *(lambda place, name=name: public_arm(name, place) for name in ("irb120", "scara", "widowx"))],
)  # fmt: skip
def test_the_same_name_is_the_same_sum_by_both_methods(plant: Callable[[Path], Robot], tmp_path: Path) -> None:
    """Of these wrists one method kept Iyy4 where the other kept Izz4, and Izz1 of a SCARA was two different sums."""
    robot = plant(tmp_path)
    by_simulation = robot_parameters(robot)
    found = dict(zip(by_simulation.names, by_simulation.formulas(robot), strict=True))
    assert found == sums_by_idim(robot)
    for name, formula in found.items():
        assert not name.endswith("rotor_inertia") or (formula.startswith("Ia") and len(formula.split()) == 1)


def test_a_rotor_with_a_link_about_a_skew_axis_is_no_rotor() -> None:
    first, second = arm(2).links
    robot = replace(arm(2), links=(replace(first, axis=np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)), second))
    by_simulation = robot_parameters(robot)
    found = dict(zip(by_simulation.names, by_simulation.formulas(robot), strict=True))
    assert found == sums_by_idim(robot)
    assert "joint1.rotor_inertia" not in found
    assert {"Ixx1 * 0.2000", "Ixy1 * 0.8000", "Iyy1 * 0.8000"} <= {*found["joint1.inertia"].split(" + ")}
