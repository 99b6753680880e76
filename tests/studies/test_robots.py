"""Random robots from no start: some of those on which a search once began where nothing could be simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.estimation.robots.didim import identify_rigid_robot
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.problem import robot_problem
from jointid.estimation.starts.robot_springs import StartOfSprings
from jointid.records.signals.filtering import Filtering
from studies.robots import drives, judge, summarise


def test_a_rigid_robot_ends_at_the_noise() -> None:
    found = judge(6, flexible=False)
    assert found is not None
    assert found.at_noise
    assert found.prismatic == 2
    assert np.mean(np.abs(found.z) < 2) > 0.85


@pytest.mark.slow
def test_a_flexible_robot_whose_rotors_the_rigid_one_hardly_tells_ends_at_the_noise() -> None:
    found = judge(11, flexible=True)
    assert found is not None
    assert found.error == ""
    assert found.at_noise
    assert found.spring_shown == found.springs == 2
    said = summarise([found, replace(found, seed=12, left=2.0)])
    assert "1 at the noise; not: 12 (2)" in said


@pytest.mark.parametrize("seed", [72, 77])
def test_a_search_of_springs_begins_where_the_rigid_robot_moves(seed: int) -> None:
    """On stiff springs: also where only a sum of two inertias is known, or a weight acts as a constant torque."""
    made = drives(seed, flexible=True)
    assert made is not None
    loop = made.unknown
    rigid = identify_rigid_robot(loop, made.records, Filtering(cutoff=4.0))
    parameters = robot_parameters(loop.robot, logarithmic=True)
    problem = robot_problem(loop, made.records, parameters)
    start = StartOfSprings.of(problem, rigid, loop.robot.names)
    stiff = problem.run(parameters.to_search_variables(start.all_at(start.stiff)))
    before, after = (np.linalg.norm(problem.by_joint(problem.error(run)), axis=1) for run in (rigid.run, stiff))
    assert np.all(after < 1.05 * before)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [26, 72, 74])
def test_a_search_ends_at_the_noise(seed: int) -> None:
    """The first of them only after the joints' weights were estimated again, the last from other frequencies."""
    found = judge(seed, flexible=True)
    assert found is not None
    assert found.at_noise


@pytest.mark.parametrize("flexible", [False, True])
def test_nothing_but_the_geometry_is_given_away(flexible: bool) -> None:
    made = drives(3, flexible)
    assert made is not None
    robot = made.unknown.robot
    assert not robot.has_masses
    assert not np.any(robot.of_joints("viscous"))
    assert robot.flexible == made.loop.robot.flexible
