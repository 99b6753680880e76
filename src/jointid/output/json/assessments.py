"""Validation, comparison of methods, loop check and experiment advice as JSON."""

from __future__ import annotations

import math

from jointid.diagnostics.check_loop import LoopCheck
from jointid.diagnostics.experiment_design import Advice, DetectableMode, Prediction, StiffnessTestDesign
from jointid.diagnostics.fault_tests import FaultTest
from jointid.diagnostics.method_comparison import MethodComparison
from jointid.diagnostics.validation import Validation
from jointid.output.json.estimates import estimate_answer
from jointid.output.json.parts import Json, initial_answer, resampled_answer, transmission_answer

VALIDATION_SCHEMA = "jointid.validation/1"
COMPARISON_SCHEMA = "jointid.comparison/1"
LOOP_SCHEMA = "jointid.loop/1"
ADVICE_SCHEMA = "jointid.advice/1"
REVEALING_SCHEMA = "jointid.revealing/1"


def validation_answer(validation: Validation) -> Json:
    """Return a validation as it is written to JSON."""
    tracking = validation.tracking_error
    return {
        "schema": VALIDATION_SCHEMA,
        "test": validation.test,
        "method": validation.method,
        "transmission": transmission_answer(validation.transmission),
        "record": validation.record,
        "resampled": resampled_answer(validation.resampled),
        "identified_from": validation.identified_from,
        "channels": list(validation.channels),
        "relative_error_percent": 100 * validation.relative_error,
        "filtered_error_percent": 100 * validation.filtered_error,
        "tracking_error_percent": None if tracking is None else 100 * tracking,
        "samples_left_out": list(validation.borders),
        "autocorrelation": [float(value) for value in validation.autocorrelation],
        "white_band": validation.white_band,
        "outside_band_percent": 100 * validation.outside_band,
        "initial": initial_answer(validation.initial),
        "simulations": validation.simulations,
        "warnings": list(validation.warnings),
    }


def comparison_answer(comparison: MethodComparison) -> Json:
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
        "reasons": [reason.to_dict() for reason in check.reasons],
        "findings": [
            {
                "suspect": _suspect(finding.test),
                "value": finding.value,
                "rivals": list(finding.rivals),
                "changes": {name: {"by": c.by, "sigmas": c.sigmas} for name, c in finding.changes.items()},
            }
            for finding in check.findings
        ],
        "suspects": [_suspect(suspect) for suspect in check.tests],
    }


def _suspect(s: FaultTest) -> Json:
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


def advice_answer(advice: Advice) -> Json:
    """Return what sensors and motions would do to an estimate as it is written to JSON."""
    return {
        "schema": ADVICE_SCHEMA,
        "record": advice.record,
        "noise": advice.noise,
        "transmission": transmission_answer(advice.transmission),
        "parameters": {
            name: {"symbol": advice.symbols[name], "unit": advice.units[name], "std": std}
            for name, std in advice.std.items()
        },
        "sensors": [_prediction(one) for one in advice.sensors],
        "tests": [_prediction(one) for one in advice.tests],
        "sentences": list(advice.sentences),
    }


def revealing_answer(found: StiffnessTestDesign) -> Json:
    """Return which tests would show a refused stiffness as it is written to JSON."""

    def told(test: tuple[DetectableMode, ...]) -> list[Json]:
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
        "transmission": transmission_answer(found.transmission),
        "pulses": {"height": found.height, "width": found.width, "told": told(found.pulses)},
        "load_encoder": {"step": found.step, "told": told(found.encoder)},
        "sentence": str(found),
    }


def _prediction(one: Prediction) -> Json:
    return {"name": one.name, "described": one.description, "std": dict(one.std) or None}
