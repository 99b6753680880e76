"""An estimate's file back, as far as a later command needs it."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

from jointid.common.errors import MethodError, RecordError
from jointid.estimation.methods.registry import METHODS, method_of
from jointid.estimation.result.estimate import IdentifiedJoint
from jointid.models.disturbances import effect_parameters
from jointid.models.friction import FRICTIONS
from jointid.models.joints import Joint
from jointid.output.json.estimates import ESTIMATE_SCHEMA
from jointid.output.json.parts import Json, gravity_answer, read_effect, transmission_answer
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop

_LARGEST = 2**26  # bytes


def read_identified(path: str | Path, joint: Joint, loop: ClosedLoop | None) -> IdentifiedJoint:
    """Return the identified joint of an estimate written by `write`.

    Args:
        path: of the JSON file.
        joint: the model the values belong to.
        loop: the closed loop; used when the estimate came from DIDIM.

    Raises:
        RecordError: the file is no estimate, belongs to another model or to another side of its transmission, or
            refuses a value, without which no torque can be predicted.
    """
    answer = read_answer(path)
    if (told := answer.get("transmission")) != (declared := transmission_answer(joint.transmission)):
        raise RecordError(
            f"{path} was identified with {_geared(told)}, and this joint has {_geared(declared)}; correct "
            "[transmission], or identify with this joint file first."
        )
    if refused := _refused(answer, joint):
        raise RecordError(
            f"{path} refuses {', '.join(refused)}, which its record did not tell, so it predicts no torque; identify "
            "the joint as rigid."
        )
    try:
        return _identified(answer, joint, loop)
    except (KeyError, TypeError, ValueError, MethodError):
        raise RecordError(
            f"{path} is no estimate of schema {ESTIMATE_SCHEMA} for a {joint.kind} {joint.model} joint with these "
            "parameters in these units; identify with this joint file first."
        ) from None


def _refused(answer: Json, joint: Joint) -> list[str]:
    """Return the parameters of the joint that an answer has without a value."""
    found = answer.get("parameters")
    told = found if isinstance(found, dict) else {}
    given = {p.name: told.get(p.name) for p in joint.parameters}
    return [name for name, one in given.items() if isinstance(one, dict) and one.get("value", 0.0) is None]


def _geared(transmission: object) -> str:
    """Return a transmission of an answer in words."""
    if not isinstance(transmission, dict):
        return "no transmission"
    ratio, side = transmission.get("motor_per_load"), transmission.get("side")
    return f"a transmission of {ratio} motor per load, on the {side} side"


def read_friction(path: str | Path) -> str:
    """Return the name of the friction law of an estimate written by `write`.

    Raises:
        RecordError: the file is no estimate.
    """
    friction = read_answer(path).get("friction")
    if not isinstance(friction, str) or friction not in FRICTIONS:
        raise RecordError(
            f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; give the file that identify --json wrote."
        )
    return friction


def read_answer(path: str | os.PathLike[str]) -> Json:
    """Return the answer in a JSON file, whatever it is of.

    Raises:
        RecordError: the file cannot be read, or is no JSON object.
    """
    remedy = "give the file that identify --json wrote"
    try:
        if (size := Path(path).stat().st_size) > _LARGEST:
            raise RecordError(f"{path} has {size} bytes, which no answer has (at most {_LARGEST}); {remedy}.")
        answer = json.loads(Path(path).read_text(encoding="utf-8-sig"), parse_constant=_no_number)
    except OSError as error:
        raise RecordError(f"{path} cannot be read ({error.strerror}); {remedy}.") from None
    except (ValueError, RecursionError):
        raise RecordError(f"{path} is no JSON file; {remedy}.") from None
    if not isinstance(answer, dict):
        raise RecordError(f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; {remedy}.")
    return answer


def _no_number(name: str) -> float:
    """Refuse NaN and Infinity, which no answer holds and JSON does not know."""
    raise ValueError(name)


def _identified(answer: Json, joint: Joint, loop: ClosedLoop | None) -> IdentifiedJoint:
    found = answer["parameters"]
    same = answer["schema"] == ESTIMATE_SCHEMA and (answer["model"], answer["kind"]) == (joint.model, joint.kind)
    same = same and answer.get("gravity") == gravity_answer(joint)
    if not same or any(found[p.name]["unit"] != joint.unit(p) for p in joint.parameters):
        raise ValueError
    effects = tuple(read_effect(effect) for effect in answer.get("effects", []))
    every = (*joint.parameters, *effect_parameters(effects))
    values = {p.name: float(found[p.name]["value"]) for p in every}
    if not all(math.isfinite(value) for value in (*values.values(), float(answer["delay"]))):
        raise ValueError
    given = answer["filtering"]
    filtering = Filtering(
        given["position_cutoff"],
        given["cutoff"],
        given["decimation"],
        tuple(given["borders"]),
        given["timing"],
        given["aliasing"],
    )
    method = answer["method"]
    if method not in tuple(METHODS):
        raise ValueError
    record = answer["record"]
    return IdentifiedJoint(
        method,
        joint,
        loop if method_of(method, joint.model).needs_controller else None,
        values,
        filtering,
        float(answer["delay"]),
        str(record["name"]),
        str(record["torque_sha256"]),
        str(answer["controller_sha256"] or ""),
        effects,
    )
