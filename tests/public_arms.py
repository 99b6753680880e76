"""Ten arms as public URDFs describe them, rounded: joints, axes, masses, centres and sizes of links, and no rotor."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from jointid.estimation.robots.consistent import mass_matrix_at
from jointid.models.robots.inertial import MassProperties, mass_properties
from jointid.models.robots.robot import Robot, RobotJoint
from jointid.records.record import Record
from tests.estimation.robots.twin import records_of

H = pi / 2
ARMS = {
    "ur3": [
        ("z", (0, 0, 0.152), (0, 0, 0), 2.0, (0, -0.02, 0), (0.12, 0.12, 0.14)),
        ("y", (0, 0.12, 0), (0, H, 0), 3.42, (0, 0, 0.122), (0.1, 0.1, 0.3)),
        ("y", (0, -0.093, 0.244), (0, 0, 0), 1.26, (0, 0, 0.107), (0.08, 0.08, 0.26)),
        ("y", (0, 0, 0.213), (0, H, 0), 0.8, (0, 0.1, 0), (0.08, 0.1, 0.08)),
        ("z", (0, 0.104, 0), (0, 0, 0), 0.8, (0, 0, 0.08), (0.08, 0.08, 0.1)),
        ("y", (0, 0, 0.085), (0, 0, 0), 0.35, (0, 0.06, 0), (0.06, 0.05, 0.06)),
    ],
    "ur5": [
        ("z", (0, 0, 0.0892), (0, 0, 0), 3.7, (0, -0.02, 0), (0.15, 0.15, 0.18)),
        ("y", (0, 0.136, 0), (0, H, 0), 8.39, (0, 0, 0.28), (0.12, 0.12, 0.5)),
        ("y", (0, -0.12, 0.425), (0, 0, 0), 2.28, (0, 0, 0.25), (0.1, 0.1, 0.42)),
        ("y", (0, 0, 0.392), (0, H, 0), 1.22, (0, 0.09, 0), (0.09, 0.12, 0.09)),
        ("z", (0, 0.093, 0), (0, 0, 0), 1.22, (0, 0, 0.09), (0.09, 0.09, 0.12)),
        ("y", (0, 0, 0.095), (0, 0, 0), 0.19, (0, 0.065, 0), (0.075, 0.035, 0.075)),
    ],
    "ur10": [
        ("z", (0, 0, 0.127), (0, 0, 0), 7.78, (0, -0.02, 0), (0.2, 0.2, 0.18)),
        ("y", (0, 0.221, 0), (0, H, 0), 12.93, (0, 0, 0.306), (0.15, 0.15, 0.65)),
        ("y", (0, -0.172, 0.612), (0, 0, 0), 3.87, (0, 0, 0.286), (0.12, 0.12, 0.6)),
        ("y", (0, 0, 0.572), (0, H, 0), 1.96, (0, 0.115, 0), (0.1, 0.12, 0.1)),
        ("z", (0, 0.115, 0), (0, 0, 0), 1.96, (0, 0, 0.116), (0.1, 0.1, 0.12)),
        ("y", (0, 0, 0.116), (0, 0, 0), 0.2, (0, 0.09, 0), (0.09, 0.04, 0.09)),
    ],
    "panda": [
        ("z", (0, 0, 0.333), (0, 0, 0), 2.8, (0, -0.03, -0.08), (0.15, 0.15, 0.3)),
        ("z", (0, 0, 0), (-H, 0, 0), 2.6, (0, -0.06, 0.03), (0.12, 0.25, 0.12)),
        ("z", (0, -0.316, 0), (H, 0, 0), 2.4, (0.05, 0.02, -0.06), (0.15, 0.13, 0.2)),
        ("z", (0.0825, 0, 0), (H, 0, 0), 2.4, (-0.05, 0.06, 0.03), (0.15, 0.2, 0.13)),
        ("z", (-0.0825, 0.384, 0), (-H, 0, 0), 2.6, (0, 0.04, -0.12), (0.1, 0.12, 0.3)),
        ("z", (0, 0, 0), (H, 0, 0), 1.5, (0.05, 0, -0.01), (0.15, 0.1, 0.1)),
        ("z", (0.088, 0, 0), (H, 0, 0), 1.3, (0.01, 0.01, 0.09), (0.12, 0.12, 0.12)),
    ],
    "iiwa7": [
        ("z", (0, 0, 0.15), (0, 0, 0), 3.45, (0, -0.03, 0.12), (0.13, 0.14, 0.28)),
        ("z", (0, 0, 0.19), (H, 0, pi), 3.48, (0, 0.059, 0.042), (0.13, 0.25, 0.14)),
        ("z", (0, 0.21, 0), (H, 0, pi), 4.06, (0, 0.03, 0.13), (0.13, 0.14, 0.3)),
        ("z", (0, 0, 0.19), (H, 0, 0), 3.48, (0, 0.067, 0.034), (0.13, 0.25, 0.14)),
        ("z", (0, 0.21, 0), (-H, pi, 0), 2.16, (0, 0.021, 0.076), (0.12, 0.12, 0.25)),
        ("z", (0, 0.061, 0.19), (H, 0, 0), 2.35, (0, 0.001, 0.0004), (0.13, 0.14, 0.14)),
        ("z", (0, 0.081, 0.061), (-H, pi, 0), 3.13, (0, 0, 0.02), (0.12, 0.12, 0.08)),
    ],
    "gen3": [
        ("z", (0, 0, 0.156), (pi, 0, 0), 1.38, (0, -0.01, -0.076), (0.09, 0.09, 0.2)),
        ("z", (0, 0.005, -0.128), (H, 0, 0), 1.26, (0, -0.11, 0.018), (0.09, 0.28, 0.09)),
        ("z", (0, -0.41, 0), (pi, 0, 0), 0.93, (0, -0.06, -0.017), (0.08, 0.2, 0.08)),
        ("z", (0, 0.208, -0.006), (H, 0, 0), 0.68, (0, 0.008, -0.064), (0.07, 0.08, 0.16)),
        ("z", (0, 0, -0.106), (-H, 0, 0), 0.68, (0, -0.064, 0.009), (0.07, 0.16, 0.07)),
        ("z", (0, -0.106, 0), (H, 0, 0), 0.36, (0, 0.01, -0.045), (0.07, 0.07, 0.1)),
    ],
    "irb120": [
        ("z", (0, 0, 0), (0, 0, 0), 3.07, (0, 0, 0.24), (0.16, 0.16, 0.2)),
        ("y", (0, 0, 0.29), (0, 0, 0), 3.91, (0, 0, 0.1), (0.14, 0.14, 0.32)),
        ("y", (0, 0, 0.27), (0, 0, 0), 2.94, (0.006, 0, 0.05), (0.16, 0.14, 0.14)),
        ("x", (0, 0, 0.07), (0, 0, 0), 1.33, (0.22, 0, 0), (0.2, 0.09, 0.09)),
        ("y", (0.302, 0, 0), (0, 0, 0), 0.55, (0, 0, 0), (0.09, 0.08, 0.08)),
        ("x", (0.072, 0, 0), (0, 0, 0), 0.014, (0.007, 0, 0), (0.014, 0.04, 0.04)),
    ],
    "puma": [
        ("z", (0, 0, 0.66), (0, 0, 0), 13.0, (0, -0.05, -0.1), (0.2, 0.2, 0.4)),
        ("y", (0, 0.24, 0), (0, 0, 0), 17.4, (0.068, 0.006, -0.016), (0.5, 0.15, 0.2)),
        ("y", (0.432, -0.09, 0), (0, 0, 0), 4.8, (0, -0.07, 0.014), (0.12, 0.12, 0.4)),
        ("z", (0.02, 0, 0.1), (0, 0, 0), 0.82, (0, 0, 0.2), (0.09, 0.09, 0.2)),
        ("y", (0, 0, 0.33), (0, 0, 0), 0.34, (0, 0, 0), (0.06, 0.06, 0.08)),
        ("z", (0, 0, 0.05), (0, 0, 0), 0.09, (0, 0, 0.032), (0.05, 0.05, 0.03)),
    ],
    "scara": [
        ("z", (0, 0, 0.3), (0, 0, 0), 7.0, (0.14, 0, 0.02), (0.4, 0.14, 0.12)),
        ("z", (0.325, 0, 0), (0, 0, 0), 5.5, (0.09, 0, 0.05), (0.4, 0.13, 0.15)),
        ("slide z", (0.225, 0, 0.1), (0, 0, 0), 1.1, (0, 0, -0.1), (0.03, 0.03, 0.4)),
        ("z", (0, 0, -0.2), (0, 0, 0), 0.4, (0.01, 0, 0), (0.06, 0.06, 0.05)),
    ],
    "widowx": [
        ("z", (0, 0, 0.072), (0, 0, 0), 0.8, (0, 0, 0.02), (0.08, 0.07, 0.08)),
        ("y", (0, 0, 0.039), (0, 0, 0), 0.81, (0.012, 0, 0.2), (0.07, 0.05, 0.3)),
        ("y", (0.05, 0, 0.2), (0, 0, 0), 0.77, (0.11, 0, 0), (0.22, 0.05, 0.05)),
        ("x", (0.2, 0, 0), (0, 0, 0), 0.32, (0.04, 0, 0), (0.1, 0.05, 0.05)),
        ("y", (0.1, 0, 0), (0, 0, 0), 0.12, (0.03, 0, 0), (0.07, 0.05, 0.04)),
        ("x", (0.07, 0, 0), (0, 0, 0), 0.2, (0.02, 0, 0.01), (0.1, 0.08, 0.05)),
    ],
}
"""Of each joint and its link: axis, place and turn of the joint, mass, centre, and the box that has its inertia."""


def urdf_of(name: str) -> str:
    """Return the URDF of an arm."""

    def text(values: object) -> str:
        return " ".join(map(repr, np.ravel(np.asarray(values, dtype=float)).tolist()))

    lines = [f'<robot name="{name}">', '  <link name="base_link"/>']
    carrier = "base_link"
    for k, (axis, place, turn, mass, centre, box) in enumerate(ARMS[name], 1):
        square = np.square(box)
        xx, yy, zz = (mass / 12 * (square.sum() - square)).tolist()
        kind = "prismatic" if axis.startswith("slide") else "revolute"
        lines += [
            f'  <joint name="joint{k}" type="{kind}">',
            f'    <parent link="{carrier}"/><child link="link{k}"/>',
            f'    <origin xyz="{text(place)}" rpy="{text(turn)}"/>',
            f'    <axis xyz="{text([axis[-1] == one for one in "xyz"])}"/>',
            '    <limit lower="-2.9" upper="2.9" effort="150" velocity="3.1"/>',
            "  </joint>",
            f'  <link name="link{k}">',
            f'    <inertial><origin xyz="{text(centre)}"/><mass value="{mass}"/>',
            f'      <inertia ixx="{xx!r}" ixy="0" ixz="0" iyy="{yy!r}" iyz="0" izz="{zz!r}"/></inertial>',
            "  </link>",
        ]
        carrier = f"link{k}"
    return "\n".join([*lines, "</robot>", ""])


def real_arm(model: Robot, seed: int, share: float = 0.3) -> Robot:
    """Return the arm behind a model: bodies that are off by a share, with rotors and friction."""
    random, links, n = np.random.default_rng(seed), [], len(model)
    for link in model.links:
        body = mass_properties(link.inertial)
        size = np.sqrt(np.trace(body.inertia) / body.mass)
        factor, stretch = random.uniform(1 - share, 1 + share), np.diag(random.uniform(1 - share, 1 + share, 3) ** 0.5)
        second = stretch @ (0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia) @ stretch
        inertia = factor * (np.trace(second) * np.eye(3) - second)
        centre = body.centre + 0.5 * share * size * random.uniform(-1, 1, 3)
        links.append(replace(link, inertial=MassProperties(factor * body.mass, centre, inertia).inertial))
    loads = np.diag(mass_matrix_at(model, np.zeros(n)))
    rotors = np.maximum(loads * random.uniform(0.2, 2.0, n), loads.max() * random.uniform(0.01, 0.1, n))
    friction = np.maximum(5.0 * loads, 0.3)
    joints = [
        RobotJoint(name, rotor, size * random.uniform(0.1, 0.5), size * random.uniform(0.2, 0.6), 0.05 * size)
        for name, rotor, size in zip(model.names, rotors.tolist(), friction.tolist(), strict=True)
    ]
    return replace(model, links=tuple(links), joints=tuple(joints))


def logs_of(robot: Robot, seed: int, noise: float) -> tuple[Record, ...]:
    """Return the record of each joint; the noise is white, a share of each torque."""
    random, found = np.random.default_rng(seed + 100), []
    for k, record in enumerate(records_of(robot, seed)):
        assert record.torque is not None and record.motor_position is not None
        values = record.torque.values
        values = values + noise * float(np.std(values)) * random.normal(size=values.size)
        torque = replace(record.torque, values=values, unit=robot.torque_unit(k))
        found.append(
            replace(record, torque=torque, motor_position=replace(record.motor_position, unit=robot.position_unit(k)))
        )
    return tuple(found)
