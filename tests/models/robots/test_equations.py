"""The equations of motion in one pass: MuJoCo's, those of `dynamics`, and derivatives against central differences."""

import numpy as np
import pytest

from jointid.models.robots.equations import ROOM, equations_of_motion, linearised_equations
from tests.models.robots.trees import (
    as_mjcf,
    by_mujoco,
    full_mass_matrix,
    mass_matrix_by_regressor,
    order_in_mujoco,
    random_robot,
    torque_by_regressor,
)

SIZE = 7


@pytest.mark.parametrize("seed", range(20))
def test_torque_and_mass_matrix_are_those_of_mujoco(seed: int) -> None:
    mujoco = pytest.importorskip("mujoco", reason="compares with MuJoCo, which is not installed")
    robot, M, torque = random_robot(seed, SIZE), np.empty((SIZE, SIZE)), np.empty(SIZE)
    model = mujoco.MjModel.from_xml_string(as_mjcf(robot))
    data, order = mujoco.MjData(model), order_in_mujoco(mujoco, model, robot)
    rotors = robot.of_joints("rotor_inertia")
    q, v, a = np.random.default_rng(1000 + seed).normal(size=(3, SIZE)) * np.array([[2.0], [3.0], [10.0]])
    data.qpos[order], data.qvel[order], data.qacc[order] = q, v, a
    mujoco.mj_inverse(model, data)
    full = full_mass_matrix(mujoco, model, data)[np.ix_(order, order)]
    equations_of_motion(robot.tree, robot.inertials, q, v, a, np.empty((SIZE, ROOM)), M, torque, False)
    for found, expected in ((M + np.diag(rotors), full), (torque + rotors * a, data.qfrc_inverse[order])):
        assert np.max(np.abs(found - expected)) < by_mujoco(1e-10) * np.max(np.abs(expected))


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_one_pass_is_inverse_dynamics_and_mass_matrix_and_its_derivatives_are_theirs(seed: int, coupled: bool) -> None:
    """Of coupled motors those of their shafts, to whose positions a matrix takes the joints'."""
    robot, random = random_robot(seed, SIZE), np.random.default_rng(seed)
    q, v, a = random.uniform(-3, 3, SIZE), random.normal(0, 2, SIZE), random.normal(0, 5, SIZE)
    T = np.eye(SIZE) + coupled * random.uniform(-0.3, 0.3, (SIZE, SIZE))
    tree, inertials = robot.tree._replace(joints=T if coupled else np.zeros((0, 0))), robot.inertials
    M, torque, room = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty((SIZE, ROOM))
    for placed in (False, True):  # then the torques alone, of another motion at the same positions
        equations_of_motion(tree, inertials, q, v if placed else -2.0 * v, a * placed, room, M, torque, placed)
    expected = T.T @ mass_matrix_by_regressor(robot.tree, inertials, T @ q) @ T
    assert np.max(np.abs(M - expected)) < 1e-12 * np.max(np.abs(expected))
    whole = T.T @ torque_by_regressor(tree, inertials, T @ q, T @ v, T @ a)
    assert np.max(np.abs(torque - whole)) < 1e-12 * np.max(np.abs(whole))
    by_place, by_speed = np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    linearised_equations(tree, inertials, q, v, a, room, M, by_place, by_speed)
    assert np.max(np.abs(M - expected)) < 1e-12 * np.max(np.abs(expected))
    for j, step in enumerate(1e-6 * np.eye(SIZE)):
        at = [T.T @ torque_by_regressor(tree, inertials, T @ (q + s), T @ v, T @ a) for s in (step, -step)]
        assert by_place[:, j] == pytest.approx((at[0] - at[1]) / 2e-6, abs=2e-8 * np.max(np.abs(whole)))
        at = [T.T @ torque_by_regressor(tree, inertials, T @ q, T @ (v + s), T @ a) for s in (step, -step)]
        assert by_speed[:, j] == pytest.approx((at[0] - at[1]) / 2e-6, abs=2e-8 * np.max(np.abs(whole)))
