"""What was identified, from one record or from several, as JSON."""

from __future__ import annotations

from dataclasses import asdict

from jointid.estimation.result.estimate import Estimate, Iteration, law_fingerprint
from jointid.estimation.result.estimated import bounds_on_other_side, known_on_other_side
from jointid.estimation.several_records.common_estimate import CommonEstimate, RecordShare
from jointid.output.json.parts import (
    Json,
    effect_answer,
    filtering_answer,
    gravity_answer,
    initial_answer,
    other_side_answer,
    parameter_answer,
    resampled_answer,
    transmission_answer,
)
from jointid.uncertainty.identifiability import Identifiability, Known
from jointid.uncertainty.residual_tests import ResidualReport
from jointid.uncertainty.verdict import StiffnessBound

ESTIMATE_SCHEMA = "jointid.estimate/1"
TOGETHER_SCHEMA = "jointid.together/1"


def estimate_answer(estimate: Estimate) -> Json:
    """Return an estimate as it is written to JSON; percentages are of the measured torque's norm."""
    conditioning = estimate.conditioning
    return {
        "schema": ESTIMATE_SCHEMA,
        "method": estimate.method,
        "variant": estimate.variant,
        "model": estimate.joint.model,
        "kind": estimate.joint.kind,
        "friction": estimate.joint.friction.name,
        "gravity": gravity_answer(estimate.joint),
        "transmission": transmission_answer(estimate.joint.transmission),
        "record": {
            "name": estimate.record,
            "samples": int(estimate.measured.size),
            "sample_time": estimate.sample_time,
            "torque_unit": estimate.torque_unit,
            "torque_sha256": estimate.fingerprint,
            "resampled": resampled_answer(estimate.resampled),
        },
        "channels": list(estimate.channels),
        "parameters": {p.name: parameter_answer(p) for p in estimate.parameters},
        "other_side": _other_side(estimate),
        "relative_error_percent": 100 * estimate.relative_error,
        "filtered_error_percent": 100 * estimate.filtered_error,
        "compared": estimate.compared,
        "samples_left_out": list(estimate.borders),
        "rows": estimate.rows,
        "condition_numbers": None
        if conditioning is None
        else {"raw": conditioning.raw, "normalised": conditioning.normalised, "scaled": conditioning.scaled},
        "filtering": filtering_answer(estimate.filtering),
        "delay": estimate.delay,
        "controller_sha256": None if estimate.loop is None else law_fingerprint(estimate.loop),
        "iterations": estimate.iterations,
        "simulations": estimate.simulations,
        "converged": estimate.converged,
        "stop": estimate.stop,
        "intervals": estimate.intervals,
        "trace": [_iteration(line) for line in estimate.trace],
        "tests": [asdict(test) for test in estimate.tests],
        "effects": [effect_answer(effect) for effect in estimate.effects],
        "warnings": list(estimate.warnings),
        "verdicts": [{"subject": v.subject, "good": v.good, "said": v.said} for v in estimate.verdicts],
        "combinations": None if estimate.known is None else combinations_answer(estimate.known),
        "residuals": None if estimate.residuals is None else _residuals(estimate.residuals),
        "stiffness_bounds": [_bound(bound) for bound in estimate.bounds],
    }


def _other_side(estimate: Estimate) -> Json | None:
    """Return what an estimate says of the other side of its transmission."""
    answer = other_side_answer(estimate.parameters, estimate.other)
    if answer is None:
        return None
    physical = () if estimate.known is None else known_on_other_side(estimate.known.physical, estimate.other)
    bounds = [_bound(bound) for bound in bounds_on_other_side(estimate.bounds, estimate.other)]
    return answer | {"combinations": [_combination(one) for one in physical], "stiffness_bounds": bounds}


def _bound(bound: StiffnessBound) -> Json:
    return {"load_share": bound.share, "stiffness": bound.stiffness, "free_free_hz": bound.frequency}


def combinations_answer(known: Identifiability) -> list[Json]:
    """Return what is known of several parameters together as it is written to JSON."""
    return [_combination(one) for one in (*known.physical, *known.directions)]


def _combination(one: Known) -> Json:
    return {
        "name": one.combination.name,
        "formula": one.combination.formula,
        "weights": dict(one.combination.weights),
        "value": one.value,
        "std": one.std,
        "unit": one.combination.unit,
        "known": one.verdict,
    }


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


def together_answer(estimate: CommonEstimate) -> Json:
    """Return what several records say together as it is written to JSON."""
    agreement = estimate.agreement
    return {
        "schema": TOGETHER_SCHEMA,
        "model": estimate.joint.model,
        "kind": estimate.joint.kind,
        "friction": estimate.joint.friction.name,
        "gravity": gravity_answer(estimate.joint),
        "torque_unit": estimate.torque_unit,
        "transmission": transmission_answer(estimate.joint.transmission),
        "parameters": {p.name: parameter_answer(p) for p in estimate.parameters},
        "other_side": other_side_answer(estimate.parameters, estimate.other),
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


def _share(record: RecordShare) -> Json:
    return {
        "name": record.name,
        "samples": int(record.measured.size),
        "sample_time": record.sample_time,
        "torque_sha256": record.fingerprint,
        "resampled": resampled_answer(record.resampled),
        "channels": list(record.channels),
        "added_inertia": record.added_inertia,
        "parameters": {p.name: parameter_answer(p) for p in record.parameters},
        "alone": {p.name: parameter_answer(p) for p in record.alone},
        "values": dict(record.values),
        "initial": initial_answer(record.initial),
        "residual_level": record.level,
        "repeatable": {
            "rms": record.repeatable.rms,
            "share": record.repeatable.share,
            "p_value": record.repeatable.p_value,
        },
        "filtering": filtering_answer(record.filtering),
        "rows": record.rows,
        "relative_error_percent": 100 * record.relative_error,
        "filtered_error_percent": 100 * record.filtered_error,
        "filtered_error_alone_percent": 100 * record.alone_error,
    }
