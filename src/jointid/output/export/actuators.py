"""Actuators of simulators: a joint as a rotor's inertia with friction, under its law of position and velocity.

Isaac Lab and mjlab have the link as a body of their own, and no spring in series. They take the same of a joint and of
each joint of a robot.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from jointid import __version__
from jointid.common.errors import MethodError
from jointid.common.text import number as shown
from jointid.common.units import Kind
from jointid.models.friction import StribeckFriction
from jointid.models.robots.robot import Robot
from jointid.output.export.joint_model import (
    JointModel,
    effects_left_out,
    friction_left_out,
    number,
    one_line,
    remarks,
    ripple_left_out,
)
from jointid.output.export.pd_law import PDLaw
from jointid.output.export.robot_model import losses_of_drives, simplify_joints
from jointid.output.export.robots import require_mechanical, require_timestep, rigid_sums

_TIMESTEP = 5e-3  # s, of the physics
_NO_LAW = PDLaw(
    0.0, 0.0, 1.0, math.inf, 0.0, 0.0,
    ("the gains: no law of position and velocity is declared, and the actuator takes torques",),
)  # fmt: skip

Written = tuple[str, tuple[str, ...]]
Entry = tuple[str, dict[str, Any], list[str]]
"""What a language calls an actuator, its keys, and a sentence for each loss."""
Writer = Callable[[JointModel | Robot, Sequence["Actuator"], float], Written]
"""From a joint or a robot, its actuators and a time step."""


@dataclass(frozen=True, slots=True)
class Actuator:
    """An actuator of a simulator, in SI units.

    Attributes:
        name: of the joint.
        kind: "revolute" or "prismatic".
        armature: inertia of the rotor; of a rigid joint alone also that of its load.
        viscous, coulomb: friction of both sides, the mean of both directions.
        rise: Stribeck's force and speed; None without.
        law: of the controller.
        lost: a sentence for each part of the joint that is not here.
        peak: torque at standstill and speed without torque of the motor; None where they were not given.
    """

    name: str
    kind: Kind
    armature: float
    viscous: float
    coulomb: float
    rise: tuple[float, float] | None
    law: PDLaw
    lost: tuple[str, ...]
    peak: tuple[float, float] | None = None


def _isaac_lab(one: Actuator, timestep: float) -> Entry:
    """Return the configuration of an actuator of Isaac Lab.

    A `DelayedPDActuatorCfg` where commands are late, a `DCMotorCfg` where the torque falls with the speed, else an
    `ImplicitActuatorCfg`.
    """
    law, (steps, lost) = one.law, _commands(one.law, timestep)
    rise = one.rise[0] if one.rise and one.rise[0] > 0 else 0.0
    keys: dict[str, Any] = {
        "joint_names_expr": [re.escape(one.name)], "stiffness": law.stiffness, "damping": law.damping,
        "armature": one.armature, "friction": one.coulomb + rise, "dynamic_friction": one.coulomb,
        "viscous_friction": one.viscous,
    }  # fmt: skip
    if rise:
        lost.append("the speed over which friction rises towards standstill")
    limit = {"effort_limit": law.limit} if law.limit < math.inf else {}
    if one.peak is not None:
        if steps:
            lost.append(f"the command delay of {1e3 * law.command_delay:.4g} ms, beside a torque-speed curve")
        motor = {"saturation_effort": one.peak[0], "velocity_limit": one.peak[1]}
        return "DCMotorCfg", keys | motor | (limit or {"effort_limit": one.peak[0]}), lost
    if steps:
        return "DelayedPDActuatorCfg", keys | limit | {"min_delay": steps, "max_delay": steps}, lost
    return "ImplicitActuatorCfg", keys | {f"{key}_sim": value for key, value in limit.items()}, lost


def _mjlab(one: Actuator, timestep: float) -> Entry:
    """Return the configuration of an actuator of mjlab.

    A `DcMotorActuatorCfg` where the torque falls with the speed, a `BuiltinPositionActuatorCfg` where the law takes no
    velocity of the reference, else an `IdealPdActuatorCfg`.
    """
    law, (steps, lost) = one.law, _commands(one.law, timestep)
    keys: dict[str, Any] = {
        "target_names_expr": (re.escape(one.name),), "stiffness": law.stiffness, "damping": law.damping,
        "armature": one.armature, "frictionloss": one.coulomb, "viscous_damping": one.viscous,
    }  # fmt: skip
    keys |= {"effort_limit": law.limit} if law.limit < math.inf else {}
    keys |= {"delay_min_lag": steps, "delay_max_lag": steps} if steps else {}
    lost += _rise_lost(one)
    if one.peak is not None:
        motor = {"saturation_effort": one.peak[0], "velocity_limit": one.peak[1]}
        return "DcMotorActuatorCfg", {"effort_limit": one.peak[0]} | keys | motor, lost
    return "IdealPdActuatorCfg" if law.share else "BuiltinPositionActuatorCfg", keys, lost


# What the languages share


def _actuators(
    model: JointModel | Robot,
    laws: Sequence[PDLaw | None],
    language: str,
    timestep: float,
    stall_torque: float | None,
    no_load_speed: float | None,
) -> tuple[Actuator, ...]:
    """Return every joint as an actuator."""
    require_timestep(timestep)
    peak = None
    if stall_torque is not None or no_load_speed is not None:
        if isinstance(model, Robot) or not all(
            one is not None and 0 < one < math.inf for one in (stall_torque, no_load_speed)
        ):
            raise MethodError(
                f"The torque at standstill and the speed without torque are two positive numbers of one joint's motor; "
                f"received {stall_torque} and {no_load_speed}" + (" for a robot." if isinstance(model, Robot) else ".")
            )
        assert stall_torque is not None and no_load_speed is not None
        peak = (stall_torque, no_load_speed)
    if isinstance(model, Robot):
        lost = losses_of_drives(model)
        each = [law or _NO_LAW for law in laws or (None,) * len(model)]
        return tuple(
            Actuator(
                joint.name, link.kind, joint.rotor_inertia, joint.viscous, joint.coulomb, None, law,
                (*lost, *law.lost, *_limit_lost(law, None)),
            )
            for joint, link, law in zip(simplify_joints(model), model.links, each, strict=True)
        )  # fmt: skip
    require_mechanical(model, language)
    mass, constant, lost = rigid_sums(model)
    law, weight = model.law or _NO_LAW, model.weight
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
    rise = None
    if type(model.joint.friction) is StribeckFriction and not model.flexible:
        rise = (model.values["stribeck_force"], model.values["stribeck_speed"])
    else:
        lost += friction_left_out(model)
    lost += [*ripple_left_out(model), *effects_left_out(model), *law.lost, *_limit_lost(law, peak)]
    return (
        Actuator(model.name, model.kind, model.motor.inertia, mass.viscous, mass.coulomb, rise, law, tuple(lost), peak),
    )


def _limit_lost(law: PDLaw, peak: tuple[float, float] | None) -> list[str]:
    """Return a sentence on an effort limit that no controller and no motor declares."""
    if law is _NO_LAW or law.limit < math.inf or peak is not None:
        return []
    return ["the effort limit, which no controller.limit declares: the simulator does not limit the torque"]


def _commands(law: PDLaw, timestep: float) -> tuple[int, list[str]]:
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


def _rise_lost(one: Actuator) -> list[str]:
    return [f"{StribeckFriction.adds}; {StribeckFriction.instead} is written"] if one.rise else []


def _remarks(model: JointModel | Robot, lost: Iterable[str]) -> list[str]:
    """Return the lines of a comment."""
    if isinstance(model, JointModel):
        return remarks(model, [*lost])
    head = f"{model.name}: a robot, written by jointid {__version__}; all numbers are behind the gears"
    return [one_line(line) for line in (head, *(f"Lost: {sentence}" for sentence in lost))]


def _python(module: str, entry: Callable[[Actuator, float], Entry], *, keyed: bool) -> Writer:
    """Return the writer of a Python file that builds a configuration, a dict by the names or a tuple, and no more."""

    def write(model: JointModel | Robot, actuators: Sequence[Actuator], timestep: float) -> Written:
        made = [(one, *entry(one, timestep)) for one in actuators]
        lost = [*dict.fromkeys(sentence for one, _, _, more in made for sentence in (*one.lost, *more))]
        lines = [f"# {line}" for line in _remarks(model, lost)]
        lines += ["", f"from {module} import {', '.join(sorted({kind for _, kind, _, _ in made}))}", ""]
        lines += ["ACTUATORS = {" if keyed else "ACTUATORS = ("]
        for one, kind, keys, _ in made:
            said = (f"{key}={number(one) if isinstance(one, float) else ascii(one)}" for key, one in keys.items())
            name = f"{one.name!a}: " if keyed else ""
            lines += [f"    {name}{kind}(", *(f"        {key}," for key in said), "    ),"]
        return "\n".join([*lines, "}" if keyed else ")", ""]), tuple(lost)

    return write


def _language(called: str, write: Writer) -> Callable[..., Written]:
    """Return the function of a language of actuators.

    Its arguments are a joint or a robot, and of the robot the laws of its joints, as far as they are known. Its
    settings are the `timestep` of the physics in s, of which a delay is a number, and of a joint the torque of its
    motor at standstill and its speed without torque, behind the gear. It raises a `MethodError` where a setting is
    out of range, or no such actuator can have these numbers.
    """

    def language(
        model: JointModel | Robot,
        laws: Sequence[PDLaw | None] = (),
        *,
        timestep: float = _TIMESTEP,
        stall_torque: float | None = None,
        no_load_speed: float | None = None,
    ) -> Written:
        return write(model, _actuators(model, laws, called, timestep, stall_torque, no_load_speed), timestep)

    return language


isaac_lab = _language("Isaac Lab", _python("isaaclab.actuators", _isaac_lab, keyed=True))
mjlab = _language("mjlab", _python("mjlab.actuator", _mjlab, keyed=False))
