"""Simulator actuators: a joint's rotor inertia and friction under its PD law.

Isaac Lab and mjlab model the link as a body of its own, without a spring in series. A joint, and each joint of a robot,
has one actuator.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeAlias

from jointid.models.friction import Friction
from jointid.output.export.bodies import Body, Model, require_timestep, robot_bodies
from jointid.output.export.joint_model import PDLaw, in_steps, number

_TIMESTEP = 5e-3  # s, of the physics
_RISING = Friction("stribeck")
_NO_LAW = PDLaw(
    0.0, 0.0, 1.0, math.inf, 0.0, 0.0,
    ("the gains: no law of position and velocity is declared, and the actuator takes torques",),
)  # fmt: skip


_Configure: TypeAlias = Callable[[Body, PDLaw, float, int], tuple[str, dict[str, Any]]]
"""Returns the class and the keys of an actuator: of a joint, its law, Stribeck's force, and the steps of the simulator
by which commands are late."""


def isaac_lab(model: Model, *, timestep: float = _TIMESTEP) -> tuple[str, list[str]]:
    """Python file with a dict of Isaac Lab actuators, and its losses."""

    def configure(one: Body, law: PDLaw, force: float, steps: int) -> tuple[str, dict[str, Any]]:
        keys: dict[str, Any] = {
            "joint_names_expr": [re.escape(one.joint)], "stiffness": law.stiffness, "damping": law.damping,
            "armature": one.armature, "friction": one.friction + max(force, 0.0), "dynamic_friction": one.friction,
            "viscous_friction": one.damping,
        }  # fmt: skip
        if law.limit < math.inf:
            keys["effort_limit" if steps else "effort_limit_sim"] = law.limit
        if steps:
            return "DelayedPDActuatorCfg", keys | {"min_delay": steps, "max_delay": steps}
        return "ImplicitActuatorCfg", keys

    rise = "the speed over which friction rises towards standstill"
    return _write(model, timestep, configure, "isaaclab.actuators", rise, keyed=True)


def mjlab(model: Model, *, timestep: float = _TIMESTEP) -> tuple[str, list[str]]:
    """Python file with a tuple of mjlab actuators, and its losses."""

    def configure(one: Body, law: PDLaw, force: float, steps: int) -> tuple[str, dict[str, Any]]:
        del force
        keys: dict[str, Any] = {
            "target_names_expr": (re.escape(one.joint),), "stiffness": law.stiffness, "damping": law.damping,
            "armature": one.armature, "frictionloss": one.friction, "viscous_damping": one.damping,
        }  # fmt: skip
        keys |= {"effort_limit": law.limit} if law.limit < math.inf else {}
        keys |= {"delay_min_lag": steps, "delay_max_lag": steps} if steps else {}
        return "IdealPdActuatorCfg" if law.share else "BuiltinPositionActuatorCfg", keys

    rise = f"{_RISING.adds}; {_RISING.instead} is written"
    return _write(model, timestep, configure, "mjlab.actuator", rise, keyed=False)


def _write(
    model: Model,
    timestep: float,
    configure: _Configure,
    module: str,
    rise: str,
    *,
    keyed: bool,
) -> tuple[str, list[str]]:
    """Python file of one actuator configuration per joint, and its losses.

    Args:
        model: a joint or a robot.
        timestep: of the physics, s; a delay is a number of steps.
        configure: makes the configuration of a joint.
        module: of the configurations.
        rise: the loss where friction rises towards standstill.
        keyed: True for a dict by joint name, False for a tuple.

    Raises:
        MethodError: the time step is out of range, or no such actuator can have these numbers.
    """
    require_timestep(timestep)
    kinds, lines, lost, alone, force = set[str](), list[str](), list[str](), model.alone, 0.0
    robot = model.robot("" if alone is None else alone.name)
    bodies = robot_bodies(robot)
    if alone is not None:
        bodies = [replace(bodies[0], armature=alone.masses["motor"].inertia)]
        rises = alone.joint.friction == _RISING and not alone.flexible
        force = alone.values["stribeck_force"] if rises else 0.0
    for body, law in zip(bodies, model.laws or (None,) * len(robot), strict=True):
        known = law or _NO_LAW
        kind, keys = configure(body, known, force, in_steps(known.command_delay, timestep)[0])
        kinds.add(kind)
        lost += _losses(model, known, rise if force else "", timestep)
        said = (f"{key}={number(value) if isinstance(value, float) else ascii(value)}" for key, value in keys.items())
        name = f"{body.joint!a}: " if keyed else ""
        lines += [f"    {name}{kind}(", *(f"        {key}," for key in said), "    ),"]
    lost = [*dict.fromkeys(lost)]
    head = [f"# {line}" for line in model.remarks(lost, bodies=False)]
    begin, end = "{}" if keyed else "()"
    text = [*head, "", f"from {module} import {', '.join(sorted(kinds))}", "", f"ACTUATORS = {begin}", *lines, end, ""]
    return "\n".join(text), lost


def _losses(model: Model, law: PDLaw, rise: str, timestep: float) -> Iterator[str]:
    alone = model.alone
    yield from model.lost("coulomb", "law of the spring", *(["law of friction"] if rise else []))
    if rise:
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
