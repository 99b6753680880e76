"""A robot written as URDF and MJCF comes back with the same torque."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.config.robot_model import read_robot
from jointid.models.robots.robot import JointSpring, Robot
from jointid.models.springs import Spring
from jointid.output.export import export
from tests.estimation.robots.twin import arm, identified, records_of
from tests.models.robots.trees import by_mujoco, inverse_dynamics, random_robot

mujoco = pytest.importorskip("mujoco", reason="reads models with MuJoCo, which is not installed")
DOWN = np.array([0.0, 0.0, -9.81])


def torque(robot: Robot, names: tuple[str, ...]) -> np.ndarray:
    order = [names.index(name) for name in robot.names]
    q, v, a = (np.ascontiguousarray(one[:, order]) for one in np.random.default_rng(1).normal(size=(3, 6, len(names))))
    found = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
    return found[:, [robot.names.index(name) for name in names]]


@pytest.mark.parametrize("robot", [arm(), *map(random_robot, range(4))], ids=lambda robot: robot.name)
@pytest.mark.parametrize("name", ["found.urdf", "found.xml"])
def test_what_is_written_has_the_same_torque(robot: Robot, name: str) -> None:
    robot = replace(robot, gravity=DOWN)
    made = export(robot, Path(name).suffix)
    text, lost = made.text, made.lost
    found, _ = read_robot(text)
    expected = torque(robot, robot.names)
    assert np.abs(torque(found, robot.names) - expected).max() < by_mujoco(1e-9) * np.abs(expected).max()
    assert found.of_joints("viscous").sum() == robot.of_joints("viscous").sum()
    if name == "found.xml":
        assert found.of_joints("rotor_inertia").sum() == pytest.approx(robot.of_joints("rotor_inertia").sum())
    assert any("rotors" in one for one in lost) == (name == "found.urdf")


@pytest.mark.slow
def test_a_rotor_that_noise_makes_negative_is_written_as_one_that_may_be() -> None:
    bare = replace(arm(3), joints=tuple(replace(one, rotor_inertia=0.0) for one in arm(3).joints))
    estimate = identified(arm(3), records_of(bare, 3, noise=0.05))
    assert estimate["joint3.rotor_inertia"].value < 0.0
    found, _ = read_robot(ji.export(estimate, "mjcf").text)
    assert np.all(found.of_joints("rotor_inertia") >= 0.0)


def test_what_is_lost_is_said() -> None:
    robot = arm()
    coupled = replace(robot.joints[5], coupling={"joint5": 0.2})
    uneven = replace(robot.joints[0], coulomb_backwards=9.0, stribeck_force=2.0, stribeck_speed=0.1)
    joints = (uneven, *robot.joints[1:5], coupled)
    assert len(export(replace(robot, joints=joints, gravity=-DOWN), "urdf").lost) == 6


def test_a_time_step_and_a_name_are_written() -> None:
    text = export(arm(), "mjcf", name="other", timestep=5e-4).text
    assert 'model="other"' in text and 'timestep="0.0005"' in text


def test_what_is_refused() -> None:
    robot = arm()
    hollow = replace(robot, links=(replace(robot.links[0], inertial=-robot.links[0].inertial), *robot.links[1:]))
    asked: list[tuple[Robot, str, dict[str, Any]]] = [
        (robot, "state-space", {}), (robot, "urdf", {"timestep": 1e-3}), (robot, "mjcf", {"side": "motor"}),
        (hollow, "mjcf", {}), (robot, "mjcf", {"control": "pd"}),
    ]  # fmt: skip
    for model, language, settings in asked:
        with pytest.raises(MethodError):
            export(model, language, **settings)


@pytest.mark.parametrize("law", [Spring(), Spring("backlash"), Spring("backlash-cubic")], ids=lambda law: law.name)
def test_a_robot_with_a_spring_moves_in_mujoco_as_ours_does(law: Spring) -> None:
    robot = arm(2)
    gap = {p.name: {"gap": 0.02, "cubic_stiffness": 1e5}[p.name] for p in law.parameters[1:-1]}
    soft = replace(robot.joints[1], spring=JointSpring(5000.0, 3.0, law=law), numbers=gap, viscous=0.0, coulomb=0.0)
    robot = replace(robot, joints=(robot.joints[0], soft))
    model = mujoco.MjModel.from_xml_string(export(robot, "mjcf").text)
    data = mujoco.MjData(model)
    link, motor = (model.joint(name).qposadr[0] for name in ("joint2", "joint2_motor"))
    data.qpos[link], data.qpos[motor] = 0.5, 0.53
    mujoco.mj_forward(model, data)
    dof = model.joint("joint2_motor").dofadr[0]
    pull = 5000.0 * (0.03 if law.linear else 0.02)  # of the gap half lies on each side
    assert data.qacc[dof] == pytest.approx(-pull / soft.rotor_inertia, rel=1e-6)


@pytest.mark.skipif(not hasattr(mujoco.MjModel, "actuator_delay"), reason="this MuJoCo has no delays")
def test_a_robot_is_driven_by_the_law_of_its_controllers() -> None:
    law = ji.controller.PD(position_gain=500.0, derivative_gain=20.0, limit=30.0, reference_delay=6e-3)
    robot = replace(arm(2), gravity=np.zeros(3))
    made = export(robot, "mjcf", controllers=[law, law], control="pd", timestep=2e-3)
    model = mujoco.MjModel.from_xml_string(made.text)
    data = mujoco.MjData(model)
    data.actuator("joint2_position").ctrl, data.actuator("joint2_velocity").ctrl = 0.04, 0.1
    seen = []
    for _ in range(5):
        mujoco.mj_step(model, data)
        seen.append(float(data.qfrc_actuator[1]))
    assert seen[:3] == [0.0, 0.0, 0.0]
    assert seen[3] == pytest.approx(500.0 * 0.04 + 20.0 * 0.1)
    data.actuator("joint2_torque").ctrl = 100.0
    mujoco.mj_step(model, data)
    assert data.qfrc_actuator[1] == pytest.approx(30.0)
    with pytest.raises(MethodError):
        export(robot, "mjcf", control="speed", controllers=[law, law])
