"""The robot file: its model, and an axis for each joint.

Each of [[joints]] is the table of a joint, with the other tables of a joint file below it. In a column's name
``{joint}`` is the joint's name, ``{axis}`` its number in the file from 1, ``{index}`` its number from 0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jointid.common import messages
from jointid.common.errors import Fault, JointFileError, JointidError, MethodError
from jointid.common.parameters import Parameter
from jointid.common.text import join
from jointid.config.axis import Axis, build_axis
from jointid.config.declaration import fault_at, keys_of
from jointid.config.robot_model import load_robot, reorder_joints
from jointid.config.tables import Values, make_method
from jointid.estimation.methods import Method
from jointid.estimation.parameters import name_in_robot
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint
from jointid.records.columns import Column

_UPRIGHT = 1e-3  # rad, tolerance of an upright base
_NUMBERS = keys_of(RobotJoint, without=("spring", "coupling"))
_AS_MOTOR = {"inertia": "rotor_inertia", "viscous_forwards": "viscous", "coulomb_forwards": "coulomb"}
"""Names of joint parameters in the robot's motor data, where they differ."""

_OF_ROBOT = {"inertia": "rotor_inertia", "motor_inertia": "rotor_inertia"}
"""Names of joint parameters among those of a robot, where they differ."""

_OF_SPRING = ("stiffness", "damping", "load_viscous", "load_coulomb")
"""Joint parameters that belong to a robot's spring."""


def build_robot(file: Values, axes: Sequence[Values], folder: Path) -> Values:
    """Return the fields of `File` for a robot, from tables of `read_tables`."""
    stated, name, bare = file["robot"], _choose_method(file, axes), _read_model(file["robot"], axes, folder)
    method = make_method(name, file["method"], "robot")
    made = tuple(_build_axis(own, number, bare, name, {})[0] for number, own in enumerate(axes))
    joints = [_build_joint(*each) for each in zip(axes, made, bare.joints, strict=True)]
    if faults := list(_find_faults(axes, made)):
        raise JointFileError(faults)
    try:
        robot = replace(bare, joints=tuple(joints))
    except MethodError as error:
        raise JointFileError(f"joints: {error}") from error
    own = {one: stated[one] for one in ("feed_forward", "in_motion", "locked", "name")}
    parameters, path = _keep_parameters(made), folder / stated["model"]
    return {**own, "axes": made, "robot": robot, "method": method, "parameters": parameters, "model_path": path}


def build_joint_of_robot(file: Values, axes: Sequence[Values], folder: Path, joint: str) -> tuple[Axis, Method]:
    """Return one joint of a robot, with the others at rest.

    Arguments as for `build_robot`. The method is that of `joints.method`, or the robot's with default settings.
    """
    name, bare = _choose_method(file, axes), _read_model(file["robot"], axes, folder)
    if joint not in bare.names:
        raise MethodError(f"The axis{messages.no_choice(joint, bare.names)}")
    number = bare.names.index(joint)
    return _build_axis(axes[number], number, bare, name, axes[number]["method"])


def _choose_method(file: Values, axes: Sequence[Values]) -> str:
    """Return the robot's declared method, or the default for its channels."""
    if name := file["method"].get("name"):
        return str(name)
    channels = {channel for own in axes for channel in own["channels"]}
    controlled = all(own["controller"] is not None for own in axes)
    logged = "torque" in channels or file["drive"].profile is not None or file["record"][0].torque == "logged"
    # Without a torque DIDIM fits motor positions; it needs the controllers of all joints.
    if controlled and not (logged and "motor_position" in channels):
        return "didim"
    return "drive_side" if any(own["model"] == "flexible" for own in axes) else "idim"


def _read_model(stated: Values, axes: Sequence[Values], folder: Path) -> Robot:
    """Load the model, with mounted gravity and joints in the file's order."""
    names = [own["name"] for own in axes]
    ordered = reorder_joints(load_robot(folder / stated["model"], stated["locked"]), names)
    if list(ordered.names) != names:
        raise JointFileError(
            f"joints lists {', '.join(names)}; expected {', '.join(ordered.names)}, each after its parent: name "
            f"those that stand still, as robot.locked = {{ {messages.format_value(ordered.names[-1])} = 0.0 }}."
        )
    ordered = ordered.turn(np.array([float(own["zero"]) for own in axes]))
    down = -np.linalg.norm(ordered.gravity) * np.array([0.0, 0.0, 1.0])
    if any(stated["base"]) and np.linalg.norm(ordered.gravity - down) > _UPRIGHT * np.linalg.norm(down):
        raise JointFileError(
            f"robot.base turns the model, whose own gravity, {ordered.gravity} m/s2, is turned already; expected "
            "one of both: leave base out, or set the gravity to 0 0 -9.81."
        )
    turned = Rotation.from_euler("xyz", stated["base"]).as_matrix().T @ ordered.gravity
    # A base angle of 3.1416 means upside down: remove the sideways gravity due to rounding.
    turned = np.where(np.abs(turned) < _UPRIGHT * np.linalg.norm(turned), 0.0, turned)
    return replace(ordered, gravity=turned, name=stated["name"] or ordered.name)


def _build_axis(own: Values, number: int, robot: Robot, method: str, given: Mapping[str, Any]) -> tuple[Axis, Method]:
    """Build one joint's axis with its shared columns, and its own method.

    A robot's joint is not identified by that method; it only determines the required channels.
    """
    kind, drive = robot.links[number].kind, own["drive"]
    if own["kind"] not in (None, kind):
        rest = f' is "{own["kind"]}", but the model says "{kind}": leave it out, or correct the model.'
        raise JointFileError(fault_at(own["at"]("kind"), rest))
    if drive.profile is not None:
        drive = replace(drive, axis=drive.axis or number + 1, joint=drive.joint or own["name"])
    columns = {channel: _fill_placeholders(one, own["name"], number) for channel, one in own["channels"].items()}
    if method != "didim":
        method = "drive_side" if own["model"] == "flexible" else "idim"
    return build_axis(own | {"channels": columns, "drive": drive}, kind, {"name": method, **given})


def _fill_placeholders(column: Column, name: str, number: int) -> Column:
    """Replace the placeholders in a column's names by name and number."""

    def fill(text: str) -> str:
        return text.replace("{joint}", name).replace("{axis}", f"{number + 1}").replace("{index}", f"{number}")

    return replace(column, column=fill(column.column), time=None if column.time is None else fill(column.time))


def _build_joint(own: Values, axis: Axis, joint: RobotJoint) -> RobotJoint:
    """Return a joint of the model with the file's numbers and laws."""
    friction, at = axis.joint.friction, own["at"]
    motor, spring, laws = dict(own["numbers"]), dict[str, Any](own["link"]), dict[str, float]()
    for name, parameter in axis.parameters.items():
        key = name.removeprefix("motor_")
        key = _AS_MOTOR.get(key, key)
        of_spring = key not in _NUMBERS and name in _OF_SPRING
        if parameter.start is not None and of_spring:
            spring[name.removeprefix("load_")] = float(parameter.start)
        elif parameter.start is not None:
            (motor if key in _NUMBERS else laws)[key if key in _NUMBERS else name] = float(parameter.start)
    needed = {at("spring", "stiffness"): own["model"] != "flexible" or "stiffness" in spring}
    speeds = [name.replace("force", "speed") for name in laws if name.endswith("stribeck_force")]
    needed |= {at("parameters", speed): speed in laws for speed in speeds}
    needed[at("stribeck_speed")] = not friction.name.endswith("stribeck") or "stribeck_speed" in motor
    if lacking := [one for one, there in needed.items() if not there]:
        rest = " is missing; expected a positive number, where a search begins: add it."
        raise JointFileError(fault_at(one, rest, "missing") for one in lacking)
    if friction.stepped:
        motor["friction"] = friction
    if friction.name.startswith("asymmetric") and not {"viscous_backwards", "coulomb_backwards"} & {*motor}:
        motor["viscous_backwards"] = motor.get("viscous", joint.viscous)
    try:
        if isinstance(axis.joint, FlexibleJoint):
            motor["spring"] = JointSpring(**spring, law=axis.joint.spring)
        return replace(joint, **motor, numbers=laws)
    except JointidError as error:
        raise JointFileError(fault_at(at(), f": {error}")) from error


def _find_faults(tables: Sequence[Values], axes: Sequence[Axis]) -> Iterator[Fault]:
    """Yield faults of joints that lack or share too much."""
    units = {str(axis.name): axis.joint.torque_unit for axis in axes if axis.joint.torque_unit}
    if units:
        raise MethodError(
            f"The torque of {join(list(units))} is in {join(list(dict.fromkeys(units.values())))}; the joints of a "
            "robot share inertias, so expected N m or N: give each torque_constant (1.0 for parameters per A)."
        )
    for own, axis in zip(tables, axes, strict=True):
        gear, at = axis.joint.transmission, own["at"]
        if axis.joint.gravity is not None or axis.joint.ripple is not None:
            yield fault_at(
                at(), " has gravity or ripple, which a robot has by its masses, or not at all: leave it out."
            )
        if gear is not None and gear.side == "motor":
            rest = ' is "motor"; all numbers of a robot are behind its gears: leave it out.'
            yield fault_at(at("transmission", "side"), rest)
    named = [axis.columns.items() for axis in axes if axis.drive.traces is None]
    uses = Counter((channel, column.column) for columns in named for channel, column in columns if column.column)
    for (channel, name), count in uses.items():
        if count > 1:
            yield Fault(f'{count} joints share the column "{name}" as {channel}; give each its own, as with {{axis}}.')


def _keep_parameters(axes: Sequence[Axis]) -> dict[str, Parameter]:
    """Return declared values and bounds, by a robot's parameter names."""
    found = dict[str, Parameter]()
    for axis in axes:
        known = {parameter.name: parameter for parameter in axis.joint.parameters}
        lines = {parameter.name for parameter in axis.joint.linear.parameters}
        for name, stated in axis.parameters.items():
            own = name_in_robot(str(axis.name), _OF_ROBOT.get(name, name))
            if name not in lines:
                found[own] = stated
            elif stated != replace(known[name], start=stated.start):
                # The initial value of a linear parameter is part of the robot, not of the search.
                found[own] = replace(stated, start=None) if stated.free else stated
    return found
