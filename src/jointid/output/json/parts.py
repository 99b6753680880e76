"""Parts that several documents share as JSON: parameters, filtering, initial state, effects beside the joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from jointid.common.errors import MethodError
from jointid.common.transmission import Transmission
from jointid.estimation.result.params import EstimatedParameter, on_other_side
from jointid.models.disturbances import Drift, Effect, PositionHarmonics
from jointid.models.joints import Joint
from jointid.models.refer import OtherSide
from jointid.records.record import Resampled
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Initial

Json = dict[str, Any]

_EFFECTS: Mapping[str, type[PositionHarmonics] | type[Drift]] = {"harmonics": PositionHarmonics, "drift": Drift}


def parameter_answer(p: EstimatedParameter) -> Json:
    """Return a parameter with what is known of it as it is written to JSON."""
    return {
        "symbol": p.symbol,
        "value": p.value,
        "std": p.stderr,
        "unit": p.unit,
        "free": p.free,
        "identifiable": p.identifiable,
        "lower_bound": p.lower_bound,
    }


def transmission_answer(transmission: Transmission | None) -> Json | None:
    """Return what lies between motor and load as it is written to JSON; what else an answer holds is of its `side`."""
    if transmission is None:
        return None
    return {
        "motor_per_load": transmission.motor_per_load,
        "lead": transmission.lead,
        "motor_kind": transmission.motor,
        "load_kind": transmission.load,
        "side": transmission.side,
        "efficiency": 1.0,
    }


def other_side_answer(parameters: Sequence[EstimatedParameter], side: OtherSide | None) -> Json | None:
    """Return the parameters on the other side of a transmission as they are written to JSON."""
    if side is None:
        return None
    there = on_other_side(parameters, side)
    return {"side": side.side, "parameters": {p.name: parameter_answer(p) for p in there}}


def resampled_answer(resampled: Resampled | None) -> Json | None:
    """Return how a record was brought to a uniform clock as it is written to JSON; null where it was logged so."""
    if resampled is None:
        return None
    return {
        "sample_time": resampled.sample_time,
        "longest_gap": resampled.longest_gap,
        "channels": {
            name: {"method": method, "time": resampled.channels[name]} for name, method in resampled.methods.items()
        },
        "clocks": {name: asdict(clock) for name, clock in resampled.clocks.items()},
    }


def filtering_answer(filtering: Filtering) -> Json:
    """Return what a record was filtered with as it is written to JSON."""
    return {
        "position_cutoff": filtering.position_cutoff,
        "cutoff": filtering.cutoff,
        "decimation": filtering.decimation,
        "borders": list(filtering.borders),
        "timing": filtering.timing,
        "aliasing": filtering.aliasing,
    }


def initial_answer(initial: Initial | None) -> Json | None:
    """Return the motor's state at the first sample as it is written to JSON."""
    if initial is None:
        return None
    torque = {} if initial.torque is None else {"torque": initial.torque}
    return {"position": initial.position, "velocity": initial.velocity, **torque}


def gravity_answer(joint: Joint) -> Json | None:
    """Return what decides how the load's gravity follows the position; its numbers are parameters."""
    return None if joint.gravity is None else {"load": joint.gravity.load, "angle": joint.gravity.angle}


def effect_answer(effect: Effect) -> Json:
    """Return an effect beside the joint as it is written to JSON.

    Raises:
        MethodError: the effect is of a kind that JSON has no word for.
    """
    kinds = [kind for kind, made in _EFFECTS.items() if type(effect) is made]
    if not kinds:
        raise MethodError(
            f"An answer has no word for the effect {type(effect).__name__}; it has PositionHarmonics and Drift."
        )
    assert isinstance(effect, PositionHarmonics | Drift)
    return {"kind": kinds[0], **asdict(effect)}


def read_effect(answer: Json) -> Effect:
    """Return the effect that `effect_answer` wrote."""
    return _EFFECTS[answer["kind"]](**{key: value for key, value in answer.items() if key != "kind"})
