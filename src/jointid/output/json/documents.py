"""Results as JSON: one walk over their fields, by the shapes of `shapes` where a document differs from its class.

Every document has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.models.joints import Joint
from jointid.output.json.estimates import estimate_shape
from jointid.output.json.keys import Json, take
from jointid.output.json.shapes import SHAPES
from jointid.records.record import Resampled


def to_dict(result: object) -> Json:
    """Return a result as a dict of numbers, words, lists and dicts, with its `schema`: what `--json` writes.

    Args:
        result: of `identify`, `validate`, `compare_methods`, `check_loop`, `advise`, `design_stiffness_test`, `tune`,
            `learn_loop`, `inspect`, `compare_estimates`.

    Raises:
        MethodError: it is no such result.

    Example:
        >>> import jointid as ji
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=100.0, kv=2000.0))
        >>> reference = ji.trapezoids(speeds=(0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> ji.to_dict(ji.identify(record, loop))["schema"]
        'jointid.estimate/1'
    """
    shape = SHAPES.get(type(result).__name__)
    if shape is not estimate_shape and not (isinstance(shape, Mapping) and "schema" in shape):
        raise MethodError(
            f"Only a result is written as JSON; received {type(result).__name__}: give what a verb returned."
        )
    document: Json = plain(result)
    return document


def simulation_answer(
    simulation: object, joint: Joint, values: Mapping[str, float], record: str, resampled: Resampled | None = None
) -> Json:
    """Return what a simulation was and how it ended as it is written to JSON; the signals go into a record."""
    parameters = {
        p.name: {"symbol": p.symbol, "value": values[p.name], "unit": joint.unit(p)} for p in joint.parameters
    }
    document: Json = plain(
        {
            "schema": "jointid.simulation/1",
            "model": joint.model,
            "transmission": joint.transmission,
            "record": record,
            "resampled": resampled,
            "parameters": parameters,
        }
    )
    document.update(plain(simulation))
    return document


def plain(value: Any) -> Any:
    """Return a value as JSON has it: a data class by its shape or by its fields, an array or a tuple as a list."""
    if is_dataclass(value):
        shape = SHAPES.get(type(value).__name__) or {field.name: field.name for field in fields(value)}
        return plain(take(value, shape))
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, StrEnum) else value
