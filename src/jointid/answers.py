"""Answers as JSON, with versioned schemas, and back as far as a later command needs them.

Every answer has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal

from jointid.assessment.validation import Validation
from jointid.common.errors import RecordError
from jointid.data.signals import Filtering
from jointid.estimation.estimate import Estimate, EstimatedParameter, IdentifiedJoint, Iteration, MethodName
from jointid.estimation.loopcheck import LoopCheck, Suspect
from jointid.model.joints import Joint
from jointid.simulation.closed_loop import Initial, Simulation
from jointid.simulation.experiment import ClosedLoop

ESTIMATE_SCHEMA = "jointid.estimate/1"
VALIDATION_SCHEMA = "jointid.validation/1"
LOOP_SCHEMA = "jointid.loop/1"
SIMULATION_SCHEMA = "jointid.simulation/1"

Json = dict[str, Any]


def estimate_answer(estimate: Estimate) -> Json:
    """Return an estimate as it is written to JSON; percentages are of the measured torque's norm."""
    conditioning = estimate.conditioning
    return {
        "schema": ESTIMATE_SCHEMA,
        "method": estimate.method,
        "variant": estimate.variant,
        "model": estimate.joint.model,
        "kind": estimate.joint.kind,
        "friction": "symmetric" if estimate.joint.friction.symmetric else "asymmetric",
        "record": {
            "name": estimate.record,
            "samples": int(estimate.measured.size),
            "sample_time": estimate.sample_time,
            "torque_unit": estimate.torque_unit,
            "torque_sha256": estimate.fingerprint,
        },
        "channels": list(estimate.channels),
        "parameters": {p.name: _parameter(p) for p in estimate.parameters},
        "relative_error_percent": 100 * estimate.relative_error,
        "filtered_error_percent": 100 * estimate.filtered_error,
        "samples_left_out": list(estimate.borders),
        "rows": estimate.rows,
        "condition_numbers": None
        if conditioning is None
        else {"raw": conditioning.raw, "normalised": conditioning.normalised, "scaled": conditioning.scaled},
        "filtering": _filtering(estimate.filtering),
        "delay": estimate.delay,
        "controller_sha256": estimate.identified.controller or None,
        "iterations": estimate.iterations,
        "simulations": estimate.simulations,
        "converged": estimate.converged,
        "stop": estimate.stop,
        "intervals": estimate.intervals,
        "trace": [_iteration(line) for line in estimate.trace],
        "warnings": list(estimate.warnings),
    }


def validation_answer(validation: Validation) -> Json:
    """Return a validation as it is written to JSON."""
    tracking = validation.tracking_error
    return {
        "schema": VALIDATION_SCHEMA,
        "test": validation.test,
        "method": validation.method,
        "record": validation.record,
        "identified_from": validation.identified_from,
        "channels": list(validation.channels),
        "relative_error_percent": 100 * validation.relative_error,
        "filtered_error_percent": 100 * validation.filtered_error,
        "tracking_error_percent": None if tracking is None else 100 * tracking,
        "samples_left_out": list(validation.borders),
        "autocorrelation": [float(value) for value in validation.autocorrelation],
        "white_band": validation.white_band,
        "outside_band_percent": 100 * validation.outside_band,
        "initial": _initial(validation.initial),
        "simulations": validation.simulations,
        "warnings": list(validation.warnings),
    }


def loop_answer(check: LoopCheck) -> Json:
    """Return the check of a loop as it is written to JSON."""
    return {
        "schema": LOOP_SCHEMA,
        "as_declared": check.as_declared,
        "level": check.level,
        "sentences": list(check.sentences),
        "findings": [
            {
                "suspect": _suspect(finding.suspect),
                "value": finding.value,
                "rivals": list(finding.rivals),
                "changes": {name: {"by": c.by, "sigmas": c.sigmas} for name, c in finding.changes.items()},
            }
            for finding in check.findings
        ],
        "suspects": [_suspect(suspect) for suspect in check.suspects],
    }


def simulation_answer(simulation: Simulation, joint: Joint, values: dict[str, float], record: str) -> Json:
    """Return what a simulation was and how it ended as it is written to JSON; the signals go into a record."""
    units = {p.name: joint.unit(p) for p in joint.parameters}
    return {
        "schema": SIMULATION_SCHEMA,
        "model": joint.model,
        "record": record,
        "parameters": {
            p.name: {"symbol": p.symbol, "value": values[p.name], "unit": units[p.name]} for p in joint.parameters
        },
        "samples": int(simulation.torque.size),
        "sample_time": simulation.sample_time,
        "outcome": simulation.outcome.name.lower(),
        "explanation": simulation.outcome.value,
        "events": simulation.events,
        "at_limit_percent": 100 * simulation.at_limit,
        "peak_torque": float(abs(simulation.torque).max()),
    }


def dumps(answer: Json) -> str:
    """Return an answer as JSON text, the same bytes for the same answer."""
    return json.dumps(_finite(answer), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write(answer: Json, path: str | Path) -> None:
    """Write an answer as JSON.

    Raises:
        RecordError: the file cannot be written.
    """
    try:
        Path(path).write_text(dumps(answer), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path} cannot be written ({error.strerror}); choose another place.") from None


def read_identified(path: str | Path, joint: Joint, loop: ClosedLoop | None) -> IdentifiedJoint:
    """Return the identified joint of an estimate written by `write`.

    Args:
        path: of the JSON file.
        joint: the model the values belong to.
        loop: the closed loop; used when the estimate came from DIDIM.

    Raises:
        RecordError: the file is no estimate, or belongs to another model.
    """
    answer = _read(path)
    try:
        return _identified(answer, joint, loop)
    except (KeyError, TypeError, ValueError):
        raise RecordError(
            f"{path} is no estimate of schema {ESTIMATE_SCHEMA} for a {joint.kind} {joint.model} joint with these "
            "parameters in these units; identify with this joint file first."
        ) from None


def read_friction(path: str | Path) -> Literal["symmetric", "asymmetric"]:
    """Return the friction law of an estimate written by `write`.

    Raises:
        RecordError: the file is no estimate.
    """
    friction = _read(path).get("friction")
    if friction not in ("symmetric", "asymmetric"):
        raise RecordError(
            f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; give the file that identify --json wrote."
        )
    return "asymmetric" if friction == "asymmetric" else "symmetric"


def _read(path: str | Path) -> Json:
    remedy = "give the file that identify --json wrote"
    try:
        answer = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordError(f"{path} cannot be read ({error.strerror}); {remedy}.") from None
    except (ValueError, RecursionError):
        raise RecordError(f"{path} is no JSON file; {remedy}.") from None
    if not isinstance(answer, dict):
        raise RecordError(f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; {remedy}.")
    return answer


def _identified(answer: Json, joint: Joint, loop: ClosedLoop | None) -> IdentifiedJoint:
    found = answer["parameters"]
    same = answer["schema"] == ESTIMATE_SCHEMA and (answer["model"], answer["kind"]) == (joint.model, joint.kind)
    if not same or any(found[p.name]["unit"] != joint.unit(p) for p in joint.parameters):
        raise ValueError
    values = {p.name: float(found[p.name]["value"]) for p in joint.parameters}
    given = answer["filtering"]
    filtering = Filtering(
        given["position_cutoff"],
        given["cutoff"],
        given["decimation"],
        tuple(given["borders"]),
        given["timing"],
        given["aliasing"],
    )
    method: MethodName = "didim" if answer["method"] == "didim" else "idim"
    record = answer["record"]
    return IdentifiedJoint(
        method,
        joint,
        loop if method == "didim" else None,
        values,
        filtering,
        float(answer["delay"]),
        str(record["name"]),
        str(record["torque_sha256"]),
        str(answer["controller_sha256"] or ""),
    )


def _parameter(p: EstimatedParameter) -> Json:
    return {
        "symbol": p.symbol,
        "value": p.value,
        "std": p.std,
        "unit": p.unit,
        "free": p.free,
        "identifiable": p.identifiable,
        "lower_bound": p.lower_bound,
    }


def _suspect(s: Suspect) -> Json:
    return {
        "name": s.name,
        "alike": list(s.alike),
        "declared": s.declared,
        "more_than_declared": s.size,
        "std": s.std,
        "statistic": s.statistic,
        "p_value": s.p_value,
        "shape": s.shape,
    }


def _iteration(line: Iteration) -> Json:
    return {
        "iteration": line.number,
        "values": line.values,
        "residual_norm": line.residual_norm,
        "residual_change": line.change,
        "largest_step": line.step,
        "simulations": line.simulations,
        "gain_scale": line.gain_scale,
    }


def _filtering(filtering: Filtering) -> Json:
    return {
        "position_cutoff": filtering.position_cutoff,
        "cutoff": filtering.cutoff,
        "decimation": filtering.decimation,
        "borders": list(filtering.borders),
        "timing": filtering.timing,
        "aliasing": filtering.aliasing,
    }


def _initial(initial: Initial | None) -> Json | None:
    return None if initial is None else {"position": initial.position, "velocity": initial.velocity}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
