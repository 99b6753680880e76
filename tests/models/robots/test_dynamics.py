"""Torque, mass matrix and regressor against MuJoCo on random trees, and against each other."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.models.robots.dynamics import inverse_dynamics, regressor, regressor_of
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


@SEEDS
def test_regressor_times_parameters_is_the_torque(seed: int) -> None:
    robot = random_robot(seed)
    q, v, a = motion_of(seed, len(robot))
    torque = np.array([equations(robot, *one)[1] for one in zip(q, v, a, strict=True)])
    columns = regressor_of(robot.tree, q, v, a)
    assert difference(inverse_dynamics(robot.tree, robot.inertials, q, v, a), torque) < 1e-12
    assert difference(columns @ robot.inertials.ravel(), torque) < 1e-12
    one = np.empty((6, 60))
    regressor(robot.tree, q[2], v[2], a[2], one)
    assert np.array_equal(one, columns[2])


@SEEDS
def test_mass_matrix_times_acceleration_is_what_it_adds_to_the_torque(seed: int) -> None:
    robot = random_robot(seed)
    q, v, a = motion_of(seed, len(robot))
    matrix, _ = equations(robot, q[0], v[0], a[0])
    tree, bodies = robot.tree, robot.inertials
    added = inverse_dynamics(tree, bodies, q, v, a) - inverse_dynamics(tree, bodies, q, v, 0 * a)
    assert difference(matrix @ a[0], added[0]) < 1e-12
    assert np.linalg.eigvalsh(matrix)[0] > 0


def test_power_of_a_free_fall_is_the_change_of_energy() -> None:
    """The torque does the work that kinetic energy and height take up, whatever the motion."""
    robot = random_robot(4)
    tree, bodies = robot.tree, robot.inertials
    t = np.linspace(0.0, 1.0, 20001)[:, np.newaxis]
    rates = np.linspace(1.0, 3.0, 6)
    q, v, a = np.sin(rates * t), rates * np.cos(rates * t), -(rates**2) * np.sin(rates * t)
    torque = inverse_dynamics(tree._replace(gravity=np.zeros(3)), bodies, q, v, a)
    kinetic = [0.5 * v[k] @ equations(robot, q[k], v[k], a[k])[0] @ v[k] for k in (0, -1)]
    work = np.trapezoid(np.sum(torque * v, axis=1), t[:, 0])
    assert work == pytest.approx(kinetic[1] - kinetic[0], rel=1e-6)
