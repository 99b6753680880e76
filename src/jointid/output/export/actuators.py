"""Actuators of simulators: a joint as a rotor's inertia with friction, under its law of position and velocity.

Isaac Lab and mjlab have the link as a body of their own, and no spring in series. They take the same of a joint and of
each joint of a robot.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from jointid.models.friction import StribeckFriction
from jointid.output.export.bodies import Model, require_timestep, robot_bodies
from jointid.output.export.joint_model import number
from jointid.output.export.pd_law import PDLaw, in_steps

_TIMESTEP = 5e-3  # s, of the physics
_NO_LAW = PDLaw(
    0.0, 0.0, 1.0, math.inf, 0.0, 0.0,
    ("the gains: no law of position and velocity is declared, and the actuator takes torques",),
)  # fmt: skip


class Actuator(NamedTuple):
    """An actuator of a simulator, in SI units.

    Attributes:
        name: of the joint.
        armature: inertia of the rotor; of a rigid joint alone also that of its load.
        viscous, coulomb: friction of both sides, the mean of both directions.
        rise: Stribeck's force; 0 without.
        law: of the controller.
        steps: of the simulator, by which commands are late.
    """

    name: str
    armature: float
    viscous: float
    coulomb: float
    rise: float
    law: PDLaw
    steps: int


def isaac_lab(model: Model, *, timestep: float = _TIMESTEP) -> tuple[str, list[str]]:
    """Return a dict of actuators of Isaac Lab as a Python file, and its losses."""

    def configure(one: Actuator) -> tuple[str, dict[str, Any]]:
        keys: dict[str, Any] = {
            "joint_names_expr": [re.escape(one.name)], "stiffness": one.law.stiffness, "damping": one.law.damping,
            "armature": one.armature, "friction": one.coulomb + max(one.rise, 0.0), "dynamic_friction": one.coulomb,
            "viscous_friction": one.viscous,
        }  # fmt: skip
        if one.law.limit < math.inf:
            keys["effort_limit" if one.steps else "effort_limit_sim"] = one.law.limit
        if one.steps:
            return "DelayedPDActuatorCfg", keys | {"min_delay": one.steps, "max_delay": one.steps}
        return "ImplicitActuatorCfg", keys

    rise = "the speed over which friction rises towards standstill"
    return _write(model, timestep, configure, "isaaclab.actuators", rise, keyed=True)


def mjlab(model: Model, *, timestep: float = _TIMESTEP) -> tuple[str, list[str]]:
    """Return a tuple of actuators of mjlab as a Python file, and its losses."""

    def configure(one: Actuator) -> tuple[str, dict[str, Any]]:
        keys: dict[str, Any] = {
            "target_names_expr": (re.escape(one.name),), "stiffness": one.law.stiffness, "damping": one.law.damping,
            "armature": one.armature, "frictionloss": one.coulomb, "viscous_damping": one.viscous,
        }  # fmt: skip
        keys |= {"effort_limit": one.law.limit} if one.law.limit < math.inf else {}
        keys |= {"delay_min_lag": one.steps, "delay_max_lag": one.steps} if one.steps else {}
        return "IdealPdActuatorCfg" if one.law.share else "BuiltinPositionActuatorCfg", keys

    rise = f"{StribeckFriction.adds}; {StribeckFriction.instead} is written"
    return _write(model, timestep, configure, "mjlab.actuator", rise, keyed=False)


def _write(
    model: Model,
    timestep: float,
    configure: Callable[[Actuator], tuple[str, dict[str, Any]]],
    module: str,
    rise: str,
    *,
    keyed: bool,
) -> tuple[str, list[str]]:
    """Return a Python file that builds a configuration of each joint, and no more; and the losses.

    Args:
        model: a joint or a robot.
        timestep: of the physics in s, of which a delay is a number.
        configure: returns a configuration, its class and keys.
        module: that the configurations come from.
        rise: the loss where friction rises towards standstill.
        keyed: whether it is a dict by the joints' names, or a tuple.

    Raises:
        MethodError: the time step is out of range, or no such actuator can have these numbers.
    """
    require_timestep(timestep)
    kinds, lines, lost = set[str](), list[str](), list[str]()
    for one in _actuators(model, timestep):
        kind, keys = configure(one)
        kinds.add(kind)
        lost += _losses(model, one, rise, timestep)
        said = (f"{key}={number(value) if isinstance(value, float) else ascii(value)}" for key, value in keys.items())
        name = f"{one.name!a}: " if keyed else ""
        lines += [f"    {name}{kind}(", *(f"        {key}," for key in said), "    ),"]
    lost = [*dict.fromkeys(lost)]
    head = [f"# {line}" for line in model.remarks(lost, bodies=False)]
    begin, end = "{}" if keyed else "()"
    text = [*head, "", f"from {module} import {', '.join(sorted(kinds))}", "", f"ACTUATORS = {begin}", *lines, end, ""]
    return "\n".join(text), lost


def _actuators(model: Model, timestep: float) -> Iterator[Actuator]:
    robot, alone = model.robot("" if model.alone is None else model.alone.name), model.alone
    for one, law in zip(robot_bodies(robot), model.laws or (None,) * len(robot), strict=True):
        armature, rise, known = one.armature, 0.0, law or _NO_LAW
        if alone is not None:
            armature = alone.masses["motor"].inertia
            rises = alone.joint.friction == StribeckFriction() and not alone.flexible
            rise = alone.values["stribeck_force"] if rises else 0.0
        steps, _ = in_steps(known.command_delay, timestep)
        yield Actuator(one.joint, armature, one.damping, one.friction, rise, known, steps)


def _losses(model: Model, one: Actuator, rise: str, timestep: float) -> Iterator[str]:
    alone, law = model.alone, one.law
    yield from model.lost("coulomb", "law of the spring", *(["law of friction"] if one.rise else []))
    if one.rise:
        yield rise
    if alone is not None and alone.flexible:
        yield "the inertia of the load, which is that of the body in the simulator's model"
    elif alone is not None:
        yield "the share of the link: armature is the whole inertia; take off what the simulator's body has"
    yield from law.lost
    if law is not _NO_LAW and law.limit == math.inf:
        yield "the effort limit, which no controller.limit declares: the simulator does not limit the torque"
    yield from in_steps(law.command_delay, timestep)[1]
    if law.share != 1.0:
        yield f"the share {law.share:g} of velocity commands that the law takes: scale them by it"
