"""Three arms as public URDFs describe them, rounded: joints, axes, masses, centres and sizes of links, and no rotor."""

from dataclasses import replace
from math import pi

import numpy as np

from jointid.estimation.parameters import mass_matrix_at
from jointid.models.robots.inertial import MassProperties, mass_properties
from jointid.models.robots.robot import Robot, RobotJoint

H = pi / 2
ARMS = {
    "panda": [
        ("z", (0, 0, 0.333), (0, 0, 0), 2.8, (0, -0.03, -0.08), (0.15, 0.15, 0.3)),
        ("z", (0, 0, 0), (-H, 0, 0), 2.6, (0, -0.06, 0.03), (0.12, 0.25, 0.12)),
        ("z", (0, -0.316, 0), (H, 0, 0), 2.4, (0.05, 0.02, -0.06), (0.15, 0.13, 0.2)),
        ("z", (0.0825, 0, 0), (H, 0, 0), 2.4, (-0.05, 0.06, 0.03), (0.15, 0.2, 0.13)),
        ("z", (-0.0825, 0.384, 0), (-H, 0, 0), 2.6, (0, 0.04, -0.12), (0.1, 0.12, 0.3)),
        ("z", (0, 0, 0), (H, 0, 0), 1.5, (0.05, 0, -0.01), (0.15, 0.1, 0.1)),
        ("z", (0.088, 0, 0), (H, 0, 0), 1.3, (0.01, 0.01, 0.09), (0.12, 0.12, 0.12)),
    ],
    "irb120": [
        ("z", (0, 0, 0), (0, 0, 0), 3.07, (0, 0, 0.24), (0.16, 0.16, 0.2)),
        ("y", (0, 0, 0.29), (0, 0, 0), 3.91, (0, 0, 0.1), (0.14, 0.14, 0.32)),
        ("y", (0, 0, 0.27), (0, 0, 0), 2.94, (0.006, 0, 0.05), (0.16, 0.14, 0.14)),
        ("x", (0, 0, 0.07), (0, 0, 0), 1.33, (0.22, 0, 0), (0.2, 0.09, 0.09)),
        ("y", (0.302, 0, 0), (0, 0, 0), 0.55, (0, 0, 0), (0.09, 0.08, 0.08)),
        ("x", (0.072, 0, 0), (0, 0, 0), 0.014, (0.007, 0, 0), (0.014, 0.04, 0.04)),
    ],
    "scara": [
        ("z", (0, 0, 0.3), (0, 0, 0), 7.0, (0.14, 0, 0.02), (0.4, 0.14, 0.12)),
        ("z", (0.325, 0, 0), (0, 0, 0), 5.5, (0.09, 0, 0.05), (0.4, 0.13, 0.15)),
        ("slide z", (0.225, 0, 0.1), (0, 0, 0), 1.1, (0, 0, -0.1), (0.03, 0.03, 0.4)),
        ("z", (0, 0, -0.2), (0, 0, 0), 0.4, (0.01, 0, 0), (0.06, 0.06, 0.05)),
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
    loads = np.diag(mass_matrix_at(model.tree, model.inertials, np.zeros(n)))
    rotors = np.maximum(loads * random.uniform(0.2, 2.0, n), loads.max() * random.uniform(0.01, 0.1, n))
    friction = np.maximum(5.0 * loads, 0.3)
    joints = [
        RobotJoint(name, rotor, size * random.uniform(0.1, 0.5), size * random.uniform(0.2, 0.6), 0.05 * size)
        for name, rotor, size in zip(model.names, rotors.tolist(), friction.tolist(), strict=True)
    ]
    return replace(model, links=tuple(links), joints=tuple(joints))
