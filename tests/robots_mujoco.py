"""The robots of `robots_plants` in MuJoCo, whose bodies, friction, springs and steps share no code with ours."""

import mujoco
import numpy as np

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Robot


def simulate_by_mujoco(
    robot: Robot, gains: FloatArray, references: FloatArray, period: float, start: FloatArray, step: float = 1e-4
) -> tuple[FloatArray, FloatArray]:
    """Return torques and motor positions, (periods, n), of a robot under PD laws with backward differences.

    A torque is held for a period; positions are those at its begin. Gains, (n, 2), are of position and its difference.
    The start, (masses,), is where links rest, then rotors of flexible joints.
    """
    model = mujoco.MjModel.from_xml_string(ji.export(robot, "mjcf", timestep=step).text)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.dof_solref[:] = max(2 * step, 5e-4), 1.0  # Coulomb friction is MuJoCo's constraint, made hard
    model.dof_solimp[:] = 0.9999, 0.9999, 0.001, 0.5, 2.0
    data = mujoco.MjData(model)
    rotors = [f"{joint.name}_motor" for joint in robot.joints if joint.spring is not None]
    for name, position in zip((*robot.names, *rotors), start, strict=True):
        data.joint(name).qpos[:] = position
    driven = [f"{name}_motor" if f"{name}_motor" in rotors else name for name in robot.names]
    motors = np.array([model.joint(name).qposadr[0] for name in driven])
    pushed = np.array([model.joint(name).dofadr[0] for name in driven])
    error = references[0] - data.qpos[motors] - (references[1] - references[0])
    torques, positions, each = np.empty_like(references), np.empty_like(references), round(period / step)
    for k, reference in enumerate(references):
        positions[k] = data.qpos[motors]
        before, error = error, reference - positions[k]
        torques[k] = data.qfrc_applied[pushed] = gains[:, 0] * error + gains[:, 1] * (error - before) / period
        mujoco.mj_step(model, data, each)
    return torques, positions
