"""The shapes of an estimate in JSON: of one record, of several, and of a long log; and how a shape is said.

A shape has the keys of a document, and where the value of each is found in an object: by the path of an attribute, by a
function of the object, or in a part with keys of its own. Where something on a path is None the value is null.
Percentages are of the measured torque's norm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from jointid.common.errors import MethodError
from jointid.estimation.result.estimate import Estimate, law_fingerprint
from jointid.estimation.result.parts import bounds_on_other_side, known_on_other_side, on_other_side
from jointid.estimation.result.summary import describe_drift
from jointid.models.disturbances import Drift, Effect, EncoderOffset
from jointid.models.ripple import PositionHarmonics

Json: TypeAlias = dict[str, Any]
Shape: TypeAlias = "str | Callable[[Any], object] | Mapping[str, Shape]"


def take(value: Any, shape: Shape) -> Any:
    """Return what a shape finds in an object."""
    if callable(shape):
        return shape(value)
    if isinstance(shape, Mapping):
        return {key: take(value, part) for key, part in shape.items()}
    for name in shape.split("."):
        value = None if value is None else getattr(value, name)
    return value


def always(value: object) -> Callable[[Any], object]:
    """Return a function to a value that every document has."""
    return lambda _: value


def same(*names: str) -> dict[str, str]:
    """Return the part of a shape whose keys are the attributes' own names."""
    return dict(zip(names, names, strict=True))


def percent(path: str) -> Callable[[Any], float | None]:
    """Return a function to a share in percent."""

    def found(value: Any) -> float | None:
        share = take(value, path)
        return None if share is None else 100 * share

    return found


def named(path: str) -> Callable[[Any], Json]:
    """Return a function to several parts, by their names."""
    return lambda value: {part.name: part for part in take(value, path)}


ESTIMATE_SCHEMA = "jointid.estimate/1"
TOGETHER_SCHEMA = "jointid.together/1"
LONG_SCHEMA = "jointid.long/1"

EFFECTS: dict[str, type[PositionHarmonics] | type[Drift] | type[EncoderOffset]] = {
    "harmonics": PositionHarmonics,
    "drift": Drift,
    "encoder_offset": EncoderOffset,
}
"""The effects beside a joint, by what documents call them."""


def _other_side(estimate: Estimate) -> Json | None:
    """Return the parameters on the other side of a transmission."""
    side = estimate.other
    if side is None:
        return None
    return {"side": side.side, "parameters": {p.name: p for p in on_other_side(estimate.params, side)}}


def _all_of_other_side(estimate: Estimate) -> Json | None:
    """Return all that an estimate says of the other side of its transmission."""
    found, known = _other_side(estimate), estimate.checks.known
    if found is None:
        return None
    return found | {
        "combinations": () if known is None else known_on_other_side(known.physical, estimate.other),
        "stiffness_bounds": bounds_on_other_side(estimate.checks.bounds, estimate.other),
    }


def _effects(estimate: Estimate) -> tuple[Effect, ...]:
    """Return the effects beside the joint, each of a kind that JSON has a word for."""
    for effect in estimate.settings.effects:
        if type(effect) not in EFFECTS.values():
            raise MethodError(
                f"An answer has no word for the effect {type(effect).__name__}; it has PositionHarmonics, Drift "
                "and EncoderOffset."
            )
    return estimate.settings.effects


def _controller_sha256(estimate: Estimate) -> str | None:
    loop = estimate.settings.loop
    return None if loop is None else law_fingerprint(loop)


def estimate_shape(estimate: Estimate) -> Json:
    """Return what an estimate has in JSON: of one record, of several, or of a long log."""
    if estimate.data.records:
        shape = _OF_SEVERAL_RECORDS
    else:
        shape = _OF_ONE_RECORD if estimate.data.windows is None else _OF_A_LOG
    found: Json = take(estimate, shape)
    return found


def _records(estimate: Estimate) -> list[Json]:
    """Return each of several records, with the parameters that are its own."""
    return [
        take(record, _RECORD) | {"parameters": {p.name: p for p in own}}
        for record, own in zip(estimate.data.records, estimate.params.own, strict=True)
    ]


def _drift(estimate: Estimate) -> Json:
    """Return what changes over a long log."""
    drift = estimate.checks.drift
    assert drift is not None
    judged = drift.agreement
    return {
        "differs": None if judged is None or judged.p_value is None else judged.differs,
        "p_value": None if judged is None else judged.p_value,
        "parameters": {
            trend.name: {
                "p_value": judged[trend.name].p_value,
                "differs": judged[trend.name].differs,
                "std_between": judged[trend.name].between,
                "per_hour": trend.per_hour,
                "per_hour_std": trend.std,
            }
            for trend in drift.trends
            if judged is not None
        },
        "stretches": drift.segments,
        "sentence": describe_drift(drift, estimate.params),
    }


_JOINT: dict[str, Shape] = {
    "model": "settings.joint.model",
    "kind": "settings.joint.kind",
    "friction": "settings.joint.friction.name",
    "spring": lambda estimate: estimate.settings.joint.spring_name,
    "gravity": "settings.joint.gravity",
    "ripple": "settings.joint.ripple",
}

_OF_ONE_RECORD: Shape = {
    "schema": always(ESTIMATE_SCHEMA),
    "method": "settings.method",
    "variant": "settings.variant",
    "answer": "answer",
    **_JOINT,
    "transmission": "settings.joint.transmission",
    "record": {
        "name": "data.record",
        "samples": "fit.measured.size",
        "sample_time": "data.sample_time",
        "torque_unit": "data.torque_unit",
        "torque_sha256": "data.fingerprint",
        "resampled": "data.resampled",
    },
    "channels": "data.channels",
    "parameters": named("params"),
    "free": "params.names",
    "correlation": lambda estimate: (
        estimate.params.correlation if np.all(np.isfinite(estimate.params.correlation)) else None
    ),
    "other_side": _all_of_other_side,
    "relative_error_percent": percent("fit.relative_error"),
    "filtered_error_percent": percent("fit.filtered_error"),
    "compared": "fit.compared",
    "samples_left_out": "fit.borders",
    "rows": "fit.rows",
    "condition_numbers": "fit.conditioning",
    "filtering": "settings.filtering",
    "delay": "settings.delay",
    "controller_sha256": _controller_sha256,
    "iterations": "fit.iterations",
    "simulations": "fit.simulations",
    "converged": "fit.converged",
    "stop": "fit.stop",
    "intervals": "params.basis",
    "trace": "fit.trace",
    "tests": "checks.tests",
    "effects": _effects,
    "warnings": lambda estimate: (*estimate.checks.warnings, *estimate.checks.notes),
    "verdicts": "checks.verdicts",
    "combinations": "checks.known",
    "residuals": "fit.residuals",
    "stiffness_bounds": "checks.bounds",
}

_OF_SEVERAL_RECORDS: Shape = {
    "schema": always(TOGETHER_SCHEMA),
    "answer": "answer",
    **_JOINT,
    "torque_unit": "data.torque_unit",
    "transmission": "settings.joint.transmission",
    "parameters": named("params"),
    "other_side": _other_side,
    "records": _records,
    "agreement": "checks.agreement",
    "free": "params.names",
    "correlation": "params.correlation",
    "simulations": "fit.simulations",
    "converged": "fit.converged",
    "stop": "fit.stop",
    "weighting": "settings.weighting",
    "intervals": "params.basis",
    "warnings": lambda estimate: (*estimate.checks.warnings, *estimate.checks.notes),
}

_OF_A_LOG: Shape = {
    "schema": always(LONG_SCHEMA),
    "answer": "answer",
    **_JOINT,
    "transmission": "settings.joint.transmission",
    "record": {"name": "data.record", "sample_time": "data.sample_time", "torque_unit": "data.torque_unit"},
    "channels": "data.channels",
    "parameters": named("params"),
    "other_side": _other_side,
    "combinations": "checks.known",
    "correlation": "params.correlation",
    "repeatable": "checks.repeatable",
    "drift": _drift,
    "window": "data.windows.length",
    "settling": "data.windows.settling",
    "windows": "data.windows.count",
    "windows_without_motion": "data.windows.still",
    "duration": "data.windows.duration",
    "rows": "fit.rows",
    "filtered_error_percent": percent("fit.filtered_error"),
    "filtering": "settings.filtering",
    "at_limit": "fit.at_limit",
    "controller_sha256": _controller_sha256,
    "passes": "fit.passes",
    "simulations": "fit.simulations",
    "converged": "fit.converged",
    "stop": "fit.stop",
    "interrupted": "fit.interrupted",
    "intervals": "params.basis",
    "warnings": lambda estimate: (*estimate.checks.warnings, *estimate.checks.notes),
}

_RECORD: Shape = {
    "name": "name",
    "samples": "measured.size",
    "sample_time": "sample_time",
    "torque_sha256": "fingerprint",
    **same("resampled", "channels", "added_inertia"),
    "parameters": always(None),
    "alone": named("alone"),
    **same("values", "initial"),
    "residual_level": "level",
    "repeatable": {"rms": "repeatable.rms", "share": "repeatable.share", "p_value": "repeatable.p_value"},
    **same("filtering", "rows"),
    "relative_error_percent": percent("relative_error"),
    "filtered_error_percent": percent("filtered_error"),
    "filtered_error_alone_percent": percent("alone_error"),
}
