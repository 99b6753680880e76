"""The names of a robot's parameters: each says of which sum it is."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.parameters import robot_parameters
from jointid.models.robots.robot import Robot
from tests.estimation.robots.twin import arm
from tests.public_arms import urdf_of
from tests.robots_plants import six, two


def public_arm(name: str, place: Path) -> Robot:
    pytest.importorskip("mujoco")
    (place / "arm.urdf").write_text(urdf_of(name))
    return ji.robots.load_robot(place / "arm.urdf")


@pytest.mark.parametrize(
    "plant", [lambda _: two().robot, lambda _: six().robot,
              *(lambda place, name=name: public_arm(name, place) for name in ("irb120", "panda", "scara"))],
)  # fmt: skip
def test_only_a_rotor_alone_has_its_name(plant: Callable[[Path], Robot], tmp_path: Path) -> None:
    robot = plant(tmp_path)
    found = robot_parameters(robot)
    for name, formula in zip(found.names, found.formulas(robot), strict=True):
        assert not name.endswith("rotor_inertia") or (formula.startswith("Ia") and len(formula.split()) == 1)


def test_a_rotor_with_a_link_about_a_skew_axis_is_no_rotor() -> None:
    first, second = arm(2).links
    robot = replace(arm(2), links=(replace(first, axis=np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)), second))
    by_simulation = robot_parameters(robot)
    found = dict(zip(by_simulation.names, by_simulation.formulas(robot), strict=True))
    assert "joint1.rotor_inertia" not in found
    assert {"Ixx1 * 0.2000", "Ixy1 * 0.8000", "Iyy1 * 0.8000"} <= {*found["joint1.inertia"].split(" + ")}
