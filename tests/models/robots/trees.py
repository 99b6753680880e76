"""Random robots, and the same as MuJoCo's model."""

from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from jointid.models.robots.dynamics import regressor_of
from jointid.models.robots.inertial import MassProperties, mass_properties
from jointid.models.robots.robot import Link, Robot, RobotJoint, Tree

Array = NDArray[np.float64]


def _is_old() -> bool:
    """True of MuJoCo before 4."""
    try:
        return int(version("mujoco").split(".")[0]) < 4
    except PackageNotFoundError:
        return False


def by_mujoco(asked: float) -> float:
    """Return the difference that is allowed: MuJoCo before 4 takes inertias to their axes within some 1e-9."""
    return max(asked, 1e-6) if _is_old() else asked


def full_mass_matrix(mujoco: Any, model: Any, data: Any) -> Array:
    """Return MuJoCo's mass matrix, (n, n); before 4 it was made of its sparse one."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, *((full, data.qM) if _is_old() else (data, full)))
    return full


def random_body(random: np.random.Generator) -> Array:
    """Return the inertial parameters of eight points of mass."""
    masses, points = random.uniform(0.1, 1.0, 8), random.normal(0.0, 0.2, (8, 3))
    mass = float(masses.sum())
    centre = masses @ points / mass
    apart = points - centre
    inertia = sum(
        (m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, apart, strict=True)), np.zeros((3, 3))
    )
    return MassProperties(mass, centre, inertia).inertial


def random_robot(seed: int, size: int = 6) -> Robot:
    """Return a tree of revolute and prismatic joints, placed at random, with gravity that is turned."""
    random = np.random.default_rng(seed)
    links, joints = [], []
    for i in range(size):
        axis = random.normal(size=3)
        links.append(
            Link(
                f"link{i}",
                int(random.integers(-1, i)) if i else -1,
                "revolute" if random.random() < 0.6 else "prismatic",
                axis / np.linalg.norm(axis),
                Rotation.random(random_state=seed * 100 + i).as_matrix(),
                random.normal(0.0, 0.5, 3),
                random_body(random),
            )
        )
        joints.append(RobotJoint(f"joint{i}", rotor_inertia=float(random.uniform(0.0, 2.0))))
    return Robot(tuple(links), tuple(joints), random.normal(0.0, 6.0, 3), f"tree{seed}")


def chain(size: int = 3) -> Robot:
    """Return an arm in which every joint turns about its own axis, bodies at random."""
    robot = random_robot(7, size)
    links = (replace(link, parent=i - 1, kind="revolute") for i, link in enumerate(robot.links))
    return Robot(tuple(links), robot.joints, np.array([0.0, 0.0, -9.81]))


def _text(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def as_mjcf(robot: Robot) -> str:
    """Return the robot as MJCF, by hand."""

    def body(i: int) -> str:
        link, joint = robot.links[i], robot.joints[i]
        solid = mass_properties(link.inertial)
        inertia = solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        x, y, z, w = Rotation.from_matrix(link.rotation).as_quat()
        kind, rotor = ("hinge" if link.kind == "revolute" else "slide"), f"{joint.rotor_inertia:.17g}"
        inner = "".join(body(j) for j, one in enumerate(robot.links) if one.parent == i)
        return (
            f'<body name="{link.name}" pos="{_text(link.origin)}" quat="{_text(np.array([w, x, y, z]))}">'
            f'<inertial pos="{_text(solid.centre)}" mass="{solid.mass:.17g}" fullinertia="{_text(inertia)}"/>'
            f'<joint name="{joint.name}" type="{kind}" axis="{_text(link.axis)}" armature="{rotor}"/>'
            f"{inner}</body>"
        )

    roots = "".join(body(i) for i, link in enumerate(robot.links) if link.parent < 0)
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{_text(robot.gravity)}"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


def order_in_mujoco(mujoco: Any, model: Any, robot: Robot) -> list[int]:
    """Return the place of each joint of the robot among MuJoCo's, which go down one branch first."""
    return [int(model.jnt_dofadr[model.joint(name).id]) for name in robot.names]


def inverse_dynamics(tree: Tree, inertials: Array, q: Array, v: Array, a: Array) -> Array:
    """Return torques of a motion, (samples, n); inertials are (n, 10)."""
    return np.asarray(regressor_of(tree, q, v, a) @ inertials.ravel())


def torque_by_regressor(tree: Tree, inertials: Array, q: Array, v: Array, a: Array) -> Array:
    """Return the torque of one motion, (n,), from the regressor: it shares nothing with `equations`."""
    return np.ravel(inverse_dynamics(tree, inertials, *(one[np.newaxis] for one in (q, v, a))))


def mass_matrix_by_regressor(tree: Tree, inertials: Array, q: Array) -> Array:
    """Return the mass matrix, (n, n), from torques of unit accelerations without gravity."""
    weightless, still = tree._replace(gravity=np.zeros(3)), np.zeros(q.size)
    return np.array([torque_by_regressor(weightless, inertials, q, still, unit) for unit in np.eye(q.size)])
