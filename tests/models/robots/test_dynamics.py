"""Torque, mass matrix and regressor against MuJoCo on random trees, and against each other."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.models.robots.equations import ROOM, equations_of_motion
from jointid.models.robots.robot import Robot
from tests.models.robots.trees import (
    Array,
    as_mjcf,
    by_mujoco,
    full_mass_matrix,
    order_in_mujoco,
    random_robot,
)

SEEDS = pytest.mark.parametrize("seed", range(20))
AGREES = 1e-10


def motion_of(seed: int, size: int, samples: int = 5) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(1000 + seed)
    q, v, a = random.normal(size=(3, samples, size)) * np.array([2.0, 3.0, 10.0])[:, np.newaxis, np.newaxis]
    return q, v, a


def equations(robot: Robot, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    size = len(robot)
    matrix, torque = np.empty((size, size)), np.empty(size)
    equations_of_motion(robot.tree, robot.inertials, q, v, a, np.empty((size, ROOM)), matrix, torque)
    return matrix, torque


def difference(found: Array, expected: Array) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@SEEDS
def test_torque_and_mass_matrix_are_those_of_mujoco(seed: int) -> None:
    mujoco = pytest.importorskip("mujoco", reason="compares with MuJoCo, which is not installed")
    robot = random_robot(seed)
    model = mujoco.MjModel.from_xml_string(as_mjcf(robot))
    data, order = mujoco.MjData(model), order_in_mujoco(mujoco, model, robot)
    rotors = robot.of_joints("rotor_inertia")
    for q, v, a in zip(*motion_of(seed, len(robot)), strict=True):
        data.qpos[order], data.qvel[order], data.qacc[order] = q, v, a
        mujoco.mj_inverse(model, data)
        full, (found, torque) = full_mass_matrix(mujoco, model, data), equations(robot, q, v, a)
        assert difference(found + np.diag(rotors), full[np.ix_(order, order)]) < by_mujoco(AGREES)
        assert difference(torque + rotors * a, data.qfrc_inverse[order]) < by_mujoco(AGREES)
