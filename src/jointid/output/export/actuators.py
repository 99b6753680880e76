"""Actuators of simulators: a joint as a rotor's inertia with friction, under its law of position and velocity.

Isaac Lab and mjlab have the link as a body of their own, and no spring in series. They take the same of a joint and of
each joint of a robot.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from jointid import __version__
from jointid.common.text import number as shown
from jointid.models.friction import StribeckFriction
from jointid.models.robots.robot import Robot
from jointid.output.export.bodies import (
    losses_of_drives,
    require_mechanical,
    require_timestep,
    rigid_sums,
    robot_bodies,
)
from jointid.output.export.joint_model import JointModel, number, one_line, remarks
from jointid.output.export.pd_law import PDLaw

_TIMESTEP = 5e-3  # s, of the physics
_NO_LAW = PDLaw(
    0.0, 0.0, 1.0, math.inf, 0.0, 0.0,
    ("the gains: no law of position and velocity is declared, and the actuator takes torques",),
)  # fmt: skip

Written = tuple[str, tuple[str, ...]]
Entry = tuple[str, dict[str, Any], list[str]]
"""What a language calls an actuator, its keys, and a sentence for each loss."""


@dataclass(frozen=True, slots=True)
class Actuator:
    """An actuator of a simulator, in SI units.

    Attributes:
        name: of the joint.
        armature: inertia of the rotor; of a rigid joint alone also that of its load.
        viscous, coulomb: friction of both sides, the mean of both directions.
        rise: Stribeck's force; 0 without.
        law: of the controller.
        lost: a sentence for each part of the joint that is not here.
    """

    name: str
    armature: float
    viscous: float
    coulomb: float
    rise: float
    law: PDLaw
    lost: tuple[str, ...]


def _isaac_lab(one: Actuator, steps: int) -> Entry:
    """Return a `DelayedPDActuatorCfg` where commands are late by steps, else an `ImplicitActuatorCfg`."""
    rise, suffix = max(one.rise, 0.0), "" if steps else "_sim"
    keys: dict[str, Any] = {
        "joint_names_expr": [re.escape(one.name)], "stiffness": one.law.stiffness, "damping": one.law.damping,
        "armature": one.armature, "friction": one.coulomb + rise, "dynamic_friction": one.coulomb,
        "viscous_friction": one.viscous,
    }  # fmt: skip
    keys |= {f"effort_limit{suffix}": one.law.limit} if one.law.limit < math.inf else {}
    keys |= {"min_delay": steps, "max_delay": steps} if steps else {}
    lost = ["the speed over which friction rises towards standstill"] if rise else []
    return "DelayedPDActuatorCfg" if steps else "ImplicitActuatorCfg", keys, lost


def _mjlab(one: Actuator, steps: int) -> Entry:
    """Return a `BuiltinPositionActuatorCfg` where no velocity is commanded, else an `IdealPdActuatorCfg`."""
    keys: dict[str, Any] = {
        "target_names_expr": (re.escape(one.name),), "stiffness": one.law.stiffness, "damping": one.law.damping,
        "armature": one.armature, "frictionloss": one.coulomb, "viscous_damping": one.viscous,
    }  # fmt: skip
    keys |= {"effort_limit": one.law.limit} if one.law.limit < math.inf else {}
    keys |= {"delay_min_lag": steps, "delay_max_lag": steps} if steps else {}
    lost = [f"{StribeckFriction.adds}; {StribeckFriction.instead} is written"] if one.rise else []
    return "IdealPdActuatorCfg" if one.law.share else "BuiltinPositionActuatorCfg", keys, lost


def isaac_lab(model: JointModel | Robot, laws: Sequence[PDLaw | None] = (), *, timestep: float = _TIMESTEP) -> Written:
    """Return a dict of actuators of Isaac Lab as a Python file; see `_write`."""
    return _write(model, laws, timestep, "isaaclab.actuators", _isaac_lab, keyed=True)


def mjlab(model: JointModel | Robot, laws: Sequence[PDLaw | None] = (), *, timestep: float = _TIMESTEP) -> Written:
    """Return a tuple of actuators of mjlab as a Python file; see `_write`."""
    return _write(model, laws, timestep, "mjlab.actuator", _mjlab, keyed=False)


def _write(
    model: JointModel | Robot,
    laws: Sequence[PDLaw | None],
    timestep: float,
    module: str,
    entry: Callable[[Actuator, int], Entry],
    *,
    keyed: bool,
) -> Written:
    """Return a Python file that builds a configuration of each joint, a dict by the names or a tuple, and no more.

    Args:
        model: a joint or a robot.
        laws: of the joints of a robot, as far as they are known.
        timestep: of the physics in s, of which a delay is a number.
        module: that the configurations come from.
        entry: returns one of them, by the delay of its commands in steps.
        keyed: whether it is a dict.

    Raises:
        MethodError: the time step is out of range, or no such actuator can have these numbers.
    """
    require_timestep(timestep)
    actuators = _of_robot(model, laws) if isinstance(model, Robot) else [_of_joint(model)]
    kinds, entries, lost = set[str](), list[str](), list[str]()
    for one in actuators:
        steps, late = _delay_in_steps(one.law, timestep)
        kind, keys, more = entry(one, steps)
        kinds.add(kind)
        lost += [*one.lost, *late, *more]
        said = (f"{key}={number(value) if isinstance(value, float) else ascii(value)}" for key, value in keys.items())
        name = f"{one.name!a}: " if keyed else ""
        entries += [f"    {name}{kind}(", *(f"        {key}," for key in said), "    ),"]
    lost = [*dict.fromkeys(lost)]
    if isinstance(model, Robot):
        head = f"{model.name}: a robot, written by jointid {__version__}; all numbers are behind the gears"
        lines = [one_line(line) for line in (head, *(f"Lost: {sentence}" for sentence in lost))]
    else:
        lines = remarks(model, lost)
    text = [*(f"# {line}" for line in lines), "", f"from {module} import {', '.join(sorted(kinds))}", ""]
    text += ["ACTUATORS = {" if keyed else "ACTUATORS = (", *entries, "}" if keyed else ")", ""]
    return "\n".join(text), tuple(lost)


def _of_robot(robot: Robot, laws: Sequence[PDLaw | None]) -> list[Actuator]:
    lost, each = losses_of_drives(robot), [law or _NO_LAW for law in laws or (None,) * len(robot)]
    return [
        Actuator(one.joint, one.armature, one.damping, one.friction, 0.0, law, (*lost, *law.lost, *_limit_lost(law)))
        for one, law in zip(robot_bodies(robot), each, strict=True)
    ]


def _of_joint(model: JointModel) -> Actuator:
    require_mechanical(model, "An actuator of a simulator")
    mass, constant, lost = rigid_sums(model)
    law, weight, rise = model.law or _NO_LAW, model.weight, 0.0
    lost.append(
        "the inertia of the load, which is that of the body in the simulator's model"
        if model.flexible
        else "the share of the link: armature is the whole inertia; take off what the body in the simulator's model has"
    )
    if constant:
        lost.append(f"a constant force of {shown(constant)} {model.torque_unit}")
    if weight is not None and weight.turns:
        lost.append("the weight of the link, which is that of the body in the simulator's model")
    if weight is not None and weight.rate:
        lost.append("the spring of the counterbalance")
    if type(model.joint.friction) is StribeckFriction and not model.flexible:
        rise = model.values["stribeck_force"]
        lost += model.lost()
    else:
        lost += model.lost("friction")
    lost += [*law.lost, *_limit_lost(law)]
    return Actuator(model.name, model.motor.inertia, mass.viscous, mass.coulomb, rise, law, tuple(lost))


def _limit_lost(law: PDLaw) -> list[str]:
    """Return a sentence on an effort limit that no controller declares."""
    if law is _NO_LAW or law.limit < math.inf:
        return []
    return ["the effort limit, which no controller.limit declares: the simulator does not limit the torque"]


def _delay_in_steps(law: PDLaw, timestep: float) -> tuple[int, list[str]]:
    """Return the delay of commands in steps, and sentences on the losses."""
    steps, lost = round(law.command_delay / timestep), list[str]()
    if abs(steps * timestep - law.command_delay) > 1e-9:
        written = f"{steps} steps of {1e3 * timestep:.4g} ms are written"
        lost.append(f"a part of the command delay of {1e3 * law.command_delay:.4g} ms: {written}")
    if law.share != 1.0:
        lost.append(f"the share {law.share:g} of velocity commands that the law takes: scale them by it")
    if law.delay:
        lost.append(f"the delay of {1e3 * law.delay:.4g} ms from position to torque: commands alone are late")
    return steps, lost
