"""The robots of `robots_plants` in MuJoCo, which shares no code with jointid: bodies, friction, springs and stepping.

A flexible joint is a joint of the motor that turns a body of next to no mass, its armature the rotor, and a joint on
the same axis with the spring; friction on the link's side acts on a tendon that is as long as both have turned. Coulomb
friction is MuJoCo's constraint, made hard.
"""

from __future__ import annotations

import mujoco
import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.robots.robot import Robot, RobotJoint

_HARD = 'solreffriction="{0:.17g} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'


def _said(values: FloatArray) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def _friction(name: str, coulomb: float, step: float) -> str:
    return f'{name}="{coulomb:.17g}" {_HARD.format(max(2 * step, 5e-4))}' if coulomb > 0 else ""


def model_of(robot: Robot, step: float) -> mujoco.MjModel:
    """Return a robot whose links follow each other, with revolute joints, for steps of that many seconds."""
    opened, closed, tendons, motors = "", "", "", ""
    for i, (link, joint) in enumerate(zip(robot.links, robot.joints, strict=True)):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, link.rotation.ravel())
        place = f'pos="{_said(link.origin)}" quat="{_said(quaternion)}"'
        mass, centre = link.inertial[0], link.inertial[1:4] / link.inertial[0]
        xx, xy, xz, yy, yz, zz = link.inertial[4:]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about -= mass * ((centre @ centre) * np.eye(3) - np.outer(centre, centre))
        full = _said(about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        body = f'<inertial pos="{_said(centre)}" mass="{mass:.17g}" fullinertia="{full}"/>'
        motor = (
            f'<joint name="m{i}" axis="{_said(link.axis)}" armature="{joint.rotor_inertia:.17g}" '
            f'damping="{joint.viscous:.17g}" {_friction("frictionloss", joint.coulomb, step)}/>'
        )
        if joint.spring is None:
            opened += f"<body {place}>{body}{motor}"
        else:
            spring = joint.spring
            opened += (
                f'<body {place}><inertial pos="0 0 0" mass="1e-9" diaginertia="1e-11 1e-11 1e-11"/>{motor}<body>{body}'
            )
            opened += f'<joint name="s{i}" axis="{_said(link.axis)}" stiffness="{spring.stiffness:.17g}" '
            opened += f'damping="{spring.damping:.17g}"/>'
            tendons += f'<fixed damping="{spring.viscous:.17g}" {_friction("frictionloss", spring.coulomb, step)}>'
            tendons += f'<joint joint="m{i}" coef="1"/><joint joint="s{i}" coef="1"/></fixed>'
            closed += "</body>"
        closed += "</body>"
        motors += f'<motor joint="m{i}"/>'
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" autolimits="false" inertiafromgeom="false" boundmass="0"/>'
        f'<option timestep="{step:.17g}" integrator="Euler" gravity="{_said(robot.gravity)}">'
        '<flag contact="disable" limit="disable"/></option>'
        f"<worldbody>{opened}{closed}</worldbody><tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    )


def simulate_by_mujoco(
    robot: Robot, gains: FloatArray, references: FloatArray, period: float, start: FloatArray, step: float = 1e-4
) -> tuple[FloatArray, FloatArray]:
    """Return torques and motor positions, (periods, n), of a robot under PD laws with backward differences.

    A torque is held for a period; positions are those at its begin.

    Args:
        robot: of revolute joints, one after the other. gains: (n, 2) of position and its difference.
        references: (periods, n). period: s. start: (masses,) where the links rest, then the rotors of flexible joints.
        step: s, of MuJoCo.
    """
    model = model_of(robot, step)
    data = mujoco.MjData(model)
    motors = np.array([model.joint(f"m{i}").qposadr[0] for i in range(len(robot))])
    data.qpos[:] = _coordinates(robot.joints, start)
    error = references[0] - data.qpos[motors] - (references[1] - references[0])
    torques, positions, each = np.empty_like(references), np.empty_like(references), round(period / step)
    for k, reference in enumerate(references):
        positions[k] = data.qpos[motors]
        before, error = error, reference - positions[k]
        torques[k] = data.ctrl[:] = gains[:, 0] * error + gains[:, 1] * (error - before) / period
        mujoco.mj_step(model, data, each)
    return torques, positions


def _coordinates(joints: tuple[RobotJoint, ...], start: FloatArray) -> FloatArray:
    """Return MuJoCo's positions: the motor's and the spring's deflection of each joint."""
    n, found, rotor = len(joints), list[float](), len(joints)
    for i, joint in enumerate(joints):
        if joint.spring is None:
            found.append(start[i])
            continue
        found += [start[rotor], start[i] - start[rotor]]
        rotor += 1
    assert rotor == start.size
    assert n <= len(found)
    return np.array(found)
