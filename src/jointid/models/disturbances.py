"""Disturbance torques beside inertia and friction: ripple over the position (`ripple`), drift over time.

Each effect is linear in its parameters, so that a regression estimates them as further columns. The simulation of a
loop has those that its joint has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.transmission import Side
from jointid.models.joints import Joint
from jointid.models.position_forces import Motion


class Effect(Protocol):
    """The interface of a disturbance in a regression."""

    @property
    def side(self) -> Side:
        """On which side of the joint it acts: in which of its equations its columns stand."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, in the order of its columns."""

    def columns(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return the columns on the motion of its side, (samples, parameters); `time` in s from the first sample."""


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Drift:
    """``df t`` and ``dv t v``: a force, or a viscous friction, that changes linearly in time, as a machine warms up.

    Time counts from the first sample of each record: a cross test takes both records to begin equally warm.
    """

    in_json = "type"
    of: Literal["force", "viscous", "both"] = setting("viscous", "what changes linearly in time")
    side: Side = setting("motor", "on which side of the joint")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Change of the force, and of the viscous friction, per second."""
        prefix, index = ("", "") if self.side == "motor" else ("load_", "2")
        force = Parameter(f"{prefix}force_drift", f"df{index}", Quantity.FORCE_DRIFT)
        viscous = Parameter(f"{prefix}viscous_drift", f"dFv{index}", Quantity.VISCOUS_DRIFT)
        return {"force": (force,), "viscous": (viscous,), "both": (force, viscous)}[self.of]

    def columns(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return t, t v, or both, (samples, parameters)."""
        both = np.column_stack([time, time * motion.velocity])
        return {"force": both[:, :1], "viscous": both[:, 1:], "both": both}[self.of]


@dataclass(frozen=True, slots=True)
class EncoderOffset:
    """``K dq0`` on the load, ``-K dq0`` on the motor: the spring's force by the difference of two encoders' zeros.

    An encoder counts from where it was switched on, or from its own mark. Where the spring is at rest without a load,
    the motor's encoder reads dq0 more than the load's. The difference at a rest of the record is not enough: friction
    may hold the spring wound up there.
    """

    in_json = "type"
    side: ClassVar[Side] = "load"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The force, in the unit of the torque."""
        return (Parameter("encoder_offset", "K dq0", Quantity.FORCE),)

    def columns(self, motion: Motion, time: FloatArray) -> FloatArray:
        """Return ones, (samples, 1)."""
        return np.ones((time.size, 1))


def require_effects(effects: Sequence[Effect], joint: Joint) -> None:
    """Raise a `MethodError` if effects do not fit a joint, or share a name."""
    if joint.model == "rigid" and any(effect.side == "load" for effect in effects):
        raise MethodError('A rigid joint has no load side of its own; use side = "motor".')
    names = [p.name for p in (*joint.parameters, *effect_parameters(effects))]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise MethodError(
            f"{', '.join(twice)} would be there twice; give each effect once for each side, and "
            "none that the joint itself has."
        )


def effect_parameters(effects: Sequence[Effect]) -> tuple[Parameter, ...]:
    """Return the parameters of effects, in the order of their columns."""
    return tuple(p for effect in effects for p in effect.parameters)


def effect_columns(
    effects: Sequence[Effect], motor: Motion, load: Motion | None, sample_time: float, equations: int
) -> FloatArray:
    """Return the columns of effects in the equations of a joint, (equations, samples, parameters)."""
    time = np.arange(motor.position.size, dtype=np.float64) * sample_time
    blocks = [np.zeros((equations, time.size, 0))]
    for effect in effects:
        on_load = effect.side == "load"
        side = load if on_load else motor
        assert side is not None
        columns = effect.columns(side, time)
        block = np.zeros((equations, *columns.shape))
        block[int(on_load)] = columns
        if isinstance(effect, EncoderOffset):  # a spring pushes both masses
            block[1 - int(on_load)] = -columns
        blocks.append(block)
    return np.concatenate(blocks, axis=2)
