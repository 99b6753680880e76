"""The shapes of an estimate in JSON, of a joint and of a robot; and how a shape is said.

A shape has the keys of a document, and where the value of each is found in an object: by the path of an attribute, by a
function of the object, or in a part with keys of its own. Where something on a path is None the value is null.
Percentages are of the measured torque's norm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.result.estimate import Estimate, law_fingerprint
from jointid.estimation.result.summary import describe_drift
from jointid.models.disturbances import Drift, Effect, EncoderOffset
from jointid.models.position_forces import PositionHarmonics
from jointid.models.robots.base_parameters import standard_symbols
from jointid.models.robots.inertial import SYMBOLS

Json: TypeAlias = dict[str, Any]
Shape: TypeAlias = "str | Callable[[Any], object] | Mapping[str, Shape]"


def take(value: Any, shape: Shape) -> Any:
    """Return the values of a shape in an object."""
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


def keys(text: str) -> dict[str, Shape]:
    """Return a shape of words: an attribute by its path, or "key=path"; "100*path" is a share in percent.

    Without a key of its own an attribute has the last name of its path.
    """
    shape: dict[str, Shape] = {}
    for word in text.split():
        key, _, path = word.rpartition("=")
        shape[key or path.rpartition(".")[2]] = as_percentage(path[4:]) if path.startswith("100*") else path
    return shape


def document_shape(schema: str, text: str, **others: Shape) -> dict[str, Shape]:
    """Return the shape of a JSON document with a schema, the attributes of `keys` and others."""
    return {"schema": always(schema), **keys(text), **others}


def as_percentage(path: str) -> Callable[[Any], float | None]:
    """Return a function that reads a share and converts it to percent."""

    def read_share(value: Any) -> float | None:
        share = take(value, path)
        return None if share is None else 100 * share

    return read_share


def by_name(path: str) -> Callable[[Any], Json]:
    """Return a function that reads a sequence and keys its items by their names."""
    return lambda value: {part.name: part for part in take(value, path)}


PARAMETER: dict[str, Shape] = keys("symbol value std=stderr unit free identifiable lower_bound at_bound lack_of_fit")
"""The shape of a parameter."""

ESTIMATE_SCHEMA = "jointid.estimate/1"

EFFECTS: dict[str, type[PositionHarmonics] | type[Drift] | type[EncoderOffset]] = {
    "harmonics": PositionHarmonics,
    "drift": Drift,
    "encoder_offset": EncoderOffset,
}
"""The effects beside a joint, by what documents call them."""


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
    return estimate.settings.controller or (None if loop is None else law_fingerprint(loop))


def _correlation(estimate: Estimate) -> FloatArray | None:
    correlation = estimate.params.correlation
    return correlation if np.all(np.isfinite(correlation)) else None


def estimate_shape(estimate: Estimate) -> Json:
    """Return the document of an estimate of one record, several records, a long log or a robot."""
    both: Json = take(estimate, _OF_BOTH)
    own: Json = take(estimate, _OF_A_JOINT if estimate.robot is None else _OF_A_ROBOT)
    return both | own


def _records(estimate: Estimate) -> list[Json] | None:
    """Return each of several records, with the parameters that it has by itself."""
    each = zip(estimate.data.records, estimate.params.own, strict=True)
    return [take(record, _RECORD) | {"parameters": {p.name: p for p in own}} for record, own in each] or None


def _log(estimate: Estimate) -> Json | None:
    """Return the windows of a long log, and its drift."""
    return None if estimate.data.windows is None else take(estimate, _LOG) | {"drift": _drift(estimate)}


def _drift(estimate: Estimate) -> Json | None:
    """Return the drift over a long log; None of several records, whose agreement says as much."""
    drift = estimate.checks.drift
    if drift is None:
        return None
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
        "sentence": describe_drift(drift, estimate.params.rows),
    }


_OF_BOTH: Shape = document_shape(
    ESTIMATE_SCHEMA,
    "answer settings.method settings.variant data.channels free=params.names "
    "relative_error_percent=100*fit.relative_error filtered_error_percent=100*fit.filtered_error "
    "samples_left_out=fit.borders fit.rows settings.filtering torque_timing=settings.timing settings.delay "
    "fit.simulations fit.converged fit.stop intervals=params.basis checks.verdicts",
    correlation=_correlation,
    log=_log,
)

_OF_A_JOINT: Shape = {
    **keys(
        "settings.joint.model settings.joint.kind friction=settings.joint.friction.name "
        "spring=settings.joint.spring_name settings.joint.gravity settings.joint.ripple settings.joint.transmission "
        "condition_numbers=fit.conditioning fit.iterations fit.trace checks.tests combinations=checks.known "
        "fit.residuals stiffness_bounds=checks.bounds settings.weighting checks.agreement"
    ),
    "parameters": by_name("params.rows"),
    "warnings": lambda estimate: (*estimate.checks.warnings, *estimate.checks.notes),
    "record": {
        **keys("name=data.record data.sample_time data.torque_unit data.resampled"),
        "samples": lambda estimate: estimate.fit.measured.size or None,
        "torque_sha256": lambda estimate: estimate.data.fingerprint or None,
    },
    "position_rms": lambda estimate: estimate.fit.position_rms.get(""),
    "controller_sha256": _controller_sha256,
    "effects": _effects,
    "records": _records,
}


def _parameters_of_robot(estimate: Estimate) -> Json:
    """Return each parameter with its axis, its nominal value and the sum that it stands for."""
    part = estimate.require_robot()
    robot, own = part.model, PARAMETER | keys("axis")
    places = [{"link": link.name} for link in robot.links for _ in SYMBOLS] + [{"joint": name} for name in robot.names]
    named = list(zip(standard_symbols(robot), places, strict=True))
    rows = zip(estimate.params.rows, part.nominal, part.formulas, part.of_standard, strict=True)
    return {
        row.name: take(row, own)
        | {
            "nominal": float(nominal),
            "formula": formula,
            "parts": {symbol: of | {"weight": w} for (symbol, of), w in zip(named, weights.tolist(), strict=True) if w},
        }
        for row, nominal, formula, weights in rows
    }


_OF_A_ROBOT: Shape = {
    "model": always("robot"),
    "parameters": _parameters_of_robot,
    "warnings": "checks.warnings",
    "record": keys(
        "name=data.record data.sample_time data.torque_unit torque_sha256=data.fingerprint logs_sha256=data.logs"
    ),
    "robot": {
        **keys(
            "robot.model.name joints=robot.model.names nominal_left=robot.nominal_errors robot.springs robot.log_delay"
        ),
        "left": lambda estimate: [*estimate.fit.axis_errors.values()],
        "position_rms": lambda estimate: dict(estimate.fit.position_rms),
    },
}

_RECORD: Shape = {
    **keys(
        "name samples=measured.size sample_time torque_sha256=fingerprint resampled channels added_inertia values "
        "initial residual_level=level filtering rows relative_error_percent=100*relative_error "
        "filtered_error_percent=100*filtered_error filtered_error_alone_percent=100*alone_error"
    ),
    "alone": by_name("alone"),
    "repeatable": keys("repeatable.rms repeatable.share repeatable.p_value"),
}

_LOG: dict[str, Shape] = keys(
    "window=data.windows.length data.windows.settling windows=data.windows.count "
    "windows_without_motion=data.windows.still data.windows.duration fit.at_limit fit.passes fit.interrupted "
    "checks.repeatable"
)
