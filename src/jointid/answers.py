"""Answers as JSON, with versioned schemas, and back as far as a later command needs them.

Every answer has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal, get_args

from jointid.assessment.advice import Advice, Prediction
from jointid.assessment.comparison import Comparison
from jointid.assessment.loopcheck import LoopCheck, Suspect
from jointid.assessment.revealing import Revealing, Told
from jointid.assessment.validation import Validation
from jointid.common.errors import MethodError, RecordError
from jointid.data.signals import Filtering
from jointid.estimation.estimate import (
    Estimate,
    EstimatedParameter,
    IdentifiedJoint,
    Iteration,
    MethodName,
    law_fingerprint,
)
from jointid.inference.identifiability import Identifiability
from jointid.inference.residuals import ResidualReport
from jointid.model.effects import Drift, Effect, PositionHarmonics, effect_parameters
from jointid.model.joints import Joint
from jointid.simulation.closed_loop import Initial, Simulation
from jointid.simulation.experiment import ClosedLoop
from jointid.together.common_estimate import CommonEstimate, RecordShare

ESTIMATE_SCHEMA = "jointid.estimate/1"
TOGETHER_SCHEMA = "jointid.together/1"
VALIDATION_SCHEMA = "jointid.validation/1"
COMPARISON_SCHEMA = "jointid.comparison/1"
LOOP_SCHEMA = "jointid.loop/1"
SIMULATION_SCHEMA = "jointid.simulation/1"
ADVICE_SCHEMA = "jointid.advice/1"
REVEALING_SCHEMA = "jointid.revealing/1"

Json = dict[str, Any]

_EFFECTS: Mapping[str, type[PositionHarmonics] | type[Drift]] = {"harmonics": PositionHarmonics, "drift": Drift}


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
        "compared": estimate.compared,
        "samples_left_out": list(estimate.borders),
        "rows": estimate.rows,
        "condition_numbers": None
        if conditioning is None
        else {"raw": conditioning.raw, "normalised": conditioning.normalised, "scaled": conditioning.scaled},
        "filtering": _filtering(estimate.filtering),
        "delay": estimate.delay,
        "controller_sha256": None if estimate.loop is None else law_fingerprint(estimate.loop),
        "iterations": estimate.iterations,
        "simulations": estimate.simulations,
        "converged": estimate.converged,
        "stop": estimate.stop,
        "intervals": estimate.intervals,
        "trace": [_iteration(line) for line in estimate.trace],
        "tests": [asdict(test) for test in estimate.tests],
        "effects": [_effect(effect) for effect in estimate.effects],
        "warnings": list(estimate.warnings),
        "verdicts": [{"subject": v.subject, "good": v.good, "said": v.said} for v in estimate.verdicts],
        "combinations": None if estimate.known is None else _combinations(estimate.known),
        "residuals": None if estimate.residuals is None else _residuals(estimate.residuals),
        "stiffness_bounds": [
            {"load_share": bound.share, "stiffness": bound.stiffness, "free_free_hz": bound.frequency}
            for bound in estimate.bounds
        ],
    }


def advice_answer(advice: Advice) -> Json:
    """Return what sensors and motions would do to an estimate as it is written to JSON."""
    return {
        "schema": ADVICE_SCHEMA,
        "record": advice.record,
        "noise": advice.noise,
        "parameters": {
            name: {"symbol": advice.symbols[name], "unit": advice.units[name], "std": std}
            for name, std in advice.std.items()
        },
        "sensors": [_prediction(one) for one in advice.sensors],
        "tests": [_prediction(one) for one in advice.tests],
        "sentences": list(advice.sentences),
    }


def revealing_answer(found: Revealing) -> Json:
    """Return which tests would show a refused stiffness as it is written to JSON."""

    def told(test: tuple[Told, ...]) -> list[Json]:
        return [
            {
                "load_share": one.share,
                "excluded_below_hz": one.softest,
                "relative_std": one.deviation if math.isfinite(one.deviation) else None,
                "told_below_hz": one.mode,
            }
            for one in test
        ]

    return {
        "schema": REVEALING_SCHEMA,
        "record": found.record,
        "pulses": {"height": found.height, "width": found.width, "told": told(found.pulses)},
        "load_encoder": {"step": found.step, "told": told(found.encoder)},
        "sentence": str(found),
    }


def _prediction(one: Prediction) -> Json:
    return {"name": one.name, "described": one.described, "std": dict(one.std) or None}


def _combinations(known: Identifiability) -> list[Json]:
    return [
        {
            "name": one.combination.name,
            "formula": one.combination.formula,
            "weights": dict(one.combination.weights),
            "value": one.value,
            "std": one.std,
            "unit": one.combination.unit,
            "known": one.verdict,
        }
        for one in (*known.physical, *known.directions)
    ]


def _residuals(report: ResidualReport) -> Json:
    repeats = report.repeatable
    return {
        "relative_percent": 100 * report.relative,
        "mean_removed_percent": 100 * report.centred,
        "rms": report.rms,
        "mean": report.mean,
        "unit": report.unit,
        "bands": [
            {
                "low_hz": band.low,
                "high_hz": band.high,
                "error_percent": None if band.error is None else 100 * band.error,
                "share_percent": 100 * band.share,
            }
            for band in report.bands
        ],
        "against_rigid_percent": None if report.against_rigid is None else 100 * report.against_rigid,
        "whiteness_p": None if report.whiteness is None else report.whiteness.p_value,
        "repeatable": None
        if repeats is None
        else {"rms": repeats.rms, "share_percent": 100 * repeats.share, "p": repeats.p_value},
    }


def together_answer(estimate: CommonEstimate) -> Json:
    """Return what several records say together as it is written to JSON."""
    agreement = estimate.agreement
    return {
        "schema": TOGETHER_SCHEMA,
        "model": estimate.joint.model,
        "kind": estimate.joint.kind,
        "friction": "symmetric" if estimate.joint.friction.symmetric else "asymmetric",
        "torque_unit": estimate.torque_unit,
        "parameters": {p.name: _parameter(p) for p in estimate.parameters},
        "records": [_share(record) for record in estimate.records],
        "agreement": {
            "sentence": str(agreement),
            "differs": agreement.differs,
            "chi_square": agreement.statistic,
            "degrees_of_freedom": agreement.degrees,
            "p_value": agreement.p_value,
            "parameters": {
                p.name: {
                    "records": p.records,
                    "chi_square": p.statistic,
                    "p_value": p.p_value,
                    "differs": p.differs,
                    "std_between": p.between,
                    "unit": p.unit,
                }
                for p in agreement.parameters
            },
        },
        "free": list(estimate.names),
        "correlation": [[float(value) for value in row] for row in estimate.correlation],
        "simulations": estimate.simulations,
        "converged": estimate.converged,
        "stop": estimate.stop,
        "weighting": estimate.weighting,
        "intervals": estimate.intervals,
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


def comparison_answer(comparison: Comparison) -> Json:
    """Return a comparison as it is written to JSON: the whole answer of each method that ran."""
    return {
        "schema": COMPARISON_SCHEMA,
        "record": comparison.record,
        "model": comparison.model,
        "methods": [
            {
                "name": method.name,
                "estimate": None if method.estimate is None else estimate_answer(method.estimate),
                "refusal": method.refusal,
                "seconds": method.seconds,
            }
            for method in comparison.methods
        ],
        "disagreements": list(comparison.disagreements),
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
    except (KeyError, TypeError, ValueError, MethodError):
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
    effects = tuple(_read_effect(effect) for effect in answer.get("effects", []))
    every = (*joint.parameters, *effect_parameters(effects))
    values = {p.name: float(found[p.name]["value"]) for p in every}
    given = answer["filtering"]
    filtering = Filtering(
        given["position_cutoff"],
        given["cutoff"],
        given["decimation"],
        tuple(given["borders"]),
        given["timing"],
        given["aliasing"],
    )
    method: MethodName = answer["method"]
    if method not in get_args(MethodName):
        raise ValueError
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
        effects,
    )


def _effect(effect: Effect) -> Json:
    kinds = [kind for kind, made in _EFFECTS.items() if type(effect) is made]
    if not kinds:
        raise MethodError(
            f"An answer has no word for the effect {type(effect).__name__}; it has PositionHarmonics and Drift."
        )
    assert isinstance(effect, PositionHarmonics | Drift)
    return {"kind": kinds[0], **asdict(effect)}


def _read_effect(answer: Json) -> Effect:
    return _EFFECTS[answer["kind"]](**{key: value for key, value in answer.items() if key != "kind"})


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


def _share(record: RecordShare) -> Json:
    return {
        "name": record.name,
        "samples": int(record.measured.size),
        "sample_time": record.sample_time,
        "torque_sha256": record.fingerprint,
        "channels": list(record.channels),
        "added_inertia": record.added_inertia,
        "parameters": {p.name: _parameter(p) for p in record.parameters},
        "alone": {p.name: _parameter(p) for p in record.alone},
        "values": dict(record.values),
        "initial": _initial(record.initial),
        "residual_level": record.level,
        "repeatable": {
            "rms": record.repeatable.rms,
            "share": record.repeatable.share,
            "p_value": record.repeatable.p_value,
        },
        "filtering": _filtering(record.filtering),
        "rows": record.rows,
        "relative_error_percent": 100 * record.relative_error,
        "filtered_error_percent": 100 * record.filtered_error,
        "filtered_error_alone_percent": 100 * record.alone_error,
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
