"""An estimate of one record, of several, or of a long log as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from jointid.estimation.result.drift import DriftTest
from jointid.estimation.result.estimate import Estimate, law_fingerprint
from jointid.estimation.result.params import EstimatedParameter, bounds_on_other_side, known_on_other_side
from jointid.estimation.result.parts import Iteration, RecordFit
from jointid.estimation.result.summary import describe_drift
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
from jointid.uncertainty.verdict import StiffnessBound, Verdict

ESTIMATE_SCHEMA = "jointid.estimate/1"
TOGETHER_SCHEMA = "jointid.together/1"
LONG_SCHEMA = "jointid.long/1"


def estimate_answer(estimate: Estimate) -> Json:
    """Return an estimate as it is written to JSON: of one record, of several, or of a long log.

    Percentages are of the measured torque's norm.
    """
    if estimate.data.records:
        return _of_several(estimate)
    return _of_record(estimate) if estimate.data.windows is None else _of_log(estimate)


def _of_record(estimate: Estimate) -> Json:
    conditioning = estimate.fit.conditioning
    return {
        "schema": ESTIMATE_SCHEMA,
        "method": estimate.settings.method,
        "variant": estimate.settings.variant,
        "model": estimate.settings.joint.model,
        "kind": estimate.settings.joint.kind,
        "friction": estimate.settings.joint.friction.name,
        "gravity": gravity_answer(estimate.settings.joint),
        "transmission": transmission_answer(estimate.settings.joint.transmission),
        "record": {
            "name": estimate.data.record,
            "samples": int(estimate.fit.measured.size),
            "sample_time": estimate.data.sample_time,
            "torque_unit": estimate.data.torque_unit,
            "torque_sha256": estimate.data.fingerprint,
            "resampled": resampled_answer(estimate.data.resampled),
        },
        "channels": list(estimate.data.channels),
        "parameters": {p.name: parameter_answer(p) for p in estimate.params},
        "other_side": _other_side(estimate),
        "relative_error_percent": 100 * estimate.fit.relative_error,
        "filtered_error_percent": 100 * estimate.fit.filtered_error,
        "compared": estimate.fit.compared,
        "samples_left_out": list(estimate.fit.borders),
        "rows": estimate.fit.rows,
        "condition_numbers": None
        if conditioning is None
        else {"raw": conditioning.raw, "normalised": conditioning.normalised, "scaled": conditioning.scaled},
        "filtering": filtering_answer(estimate.settings.filtering),
        "delay": estimate.settings.delay,
        "controller_sha256": None if estimate.settings.loop is None else law_fingerprint(estimate.settings.loop),
        "iterations": estimate.fit.iterations,
        "simulations": estimate.fit.simulations,
        "converged": estimate.fit.converged,
        "stop": estimate.fit.stop,
        "intervals": estimate.params.basis,
        "trace": [_iteration(line) for line in estimate.fit.trace],
        "tests": [asdict(test) for test in estimate.checks.tests],
        "effects": [effect_answer(effect) for effect in estimate.settings.effects],
        "warnings": list(estimate.checks.warnings),
        "verdicts": [_verdict(v) for v in estimate.checks.verdicts],
        "combinations": None if estimate.checks.known is None else combinations_answer(estimate.checks.known),
        "residuals": None if estimate.fit.residuals is None else _residuals(estimate.fit.residuals),
        "stiffness_bounds": [_bound(bound) for bound in estimate.checks.bounds],
    }


def _other_side(estimate: Estimate) -> Json | None:
    """Return what an estimate says of the other side of its transmission."""
    answer = other_side_answer(estimate.params, estimate.other)
    if answer is None:
        return None
    physical = (
        () if estimate.checks.known is None else known_on_other_side(estimate.checks.known.physical, estimate.other)
    )
    bounds = [_bound(bound) for bound in bounds_on_other_side(estimate.checks.bounds, estimate.other)]
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
        "kind": str(one.combination.kind),
        "weights": dict(one.combination.weights),
        "value": one.value,
        "std": one.std,
        "unit": one.combination.unit,
        "known": one.verdict,
    }


def _verdict(v: Verdict) -> Json:
    reasons = [reason.to_dict() for reason in v.reasons]
    return {"subject": str(v.subject), "good": v.good, "said": v.said, "status": str(v.status), "reasons": reasons}


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


def _of_several(estimate: Estimate) -> Json:
    """Return what several records say together as it is written to JSON."""
    agreement = estimate.checks.agreement
    assert agreement is not None
    return {
        "schema": TOGETHER_SCHEMA,
        "model": estimate.settings.joint.model,
        "kind": estimate.settings.joint.kind,
        "friction": estimate.settings.joint.friction.name,
        "gravity": gravity_answer(estimate.settings.joint),
        "torque_unit": estimate.data.torque_unit,
        "transmission": transmission_answer(estimate.settings.joint.transmission),
        "parameters": {p.name: parameter_answer(p) for p in estimate.params},
        "other_side": other_side_answer(estimate.params, estimate.other),
        "records": [
            _share(record, own) for record, own in zip(estimate.data.records, estimate.params.own, strict=True)
        ],
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
        "free": list(estimate.params.names),
        "correlation": [[float(value) for value in row] for row in estimate.params.correlation],
        "simulations": estimate.fit.simulations,
        "converged": estimate.fit.converged,
        "stop": estimate.fit.stop,
        "weighting": estimate.settings.weighting,
        "intervals": estimate.params.basis,
        "warnings": list(estimate.checks.warnings),
    }


def _share(record: RecordFit, own: Sequence[EstimatedParameter]) -> Json:
    return {
        "name": record.name,
        "samples": int(record.measured.size),
        "sample_time": record.sample_time,
        "torque_sha256": record.fingerprint,
        "resampled": resampled_answer(record.resampled),
        "channels": list(record.channels),
        "added_inertia": record.added_inertia,
        "parameters": {p.name: parameter_answer(p) for p in own},
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


def _of_log(estimate: Estimate) -> Json:
    """Return what a long record says as it is written to JSON; percentages are of the measured torque's norm."""
    checks, windows = estimate.checks, estimate.data.windows
    assert checks.known is not None and checks.repeatable is not None and checks.drift is not None
    assert windows is not None and estimate.settings.loop is not None
    return {
        "schema": LONG_SCHEMA,
        "model": estimate.settings.joint.model,
        "kind": estimate.settings.joint.kind,
        "friction": estimate.settings.joint.friction.name,
        "gravity": gravity_answer(estimate.settings.joint),
        "transmission": transmission_answer(estimate.settings.joint.transmission),
        "record": {
            "name": estimate.data.record,
            "sample_time": estimate.data.sample_time,
            "torque_unit": estimate.data.torque_unit,
        },
        "channels": list(estimate.data.channels),
        "parameters": {p.name: parameter_answer(p) for p in estimate.params},
        "other_side": other_side_answer(estimate.params, estimate.other),
        "combinations": combinations_answer(checks.known),
        "correlation": [[float(value) for value in row] for row in estimate.params.correlation],
        "repeatable": {
            "rms": checks.repeatable.rms,
            "share_percent": 100 * checks.repeatable.share,
            "p": checks.repeatable.p_value,
        },
        "drift": _drift(checks.drift) | {"sentence": describe_drift(checks.drift, estimate.params)},
        "window": windows.length,
        "settling": windows.settling,
        "windows": windows.count,
        "windows_without_motion": windows.still,
        "duration": windows.duration,
        "rows": estimate.fit.rows,
        "filtered_error_percent": 100 * estimate.fit.filtered_error,
        "filtering": filtering_answer(estimate.settings.filtering),
        "at_limit": estimate.fit.at_limit,
        "controller_sha256": law_fingerprint(estimate.settings.loop),
        "passes": estimate.fit.passes,
        "simulations": estimate.fit.simulations,
        "converged": estimate.fit.converged,
        "stop": estimate.fit.stop,
        "interrupted": estimate.fit.interrupted,
        "intervals": estimate.params.basis,
        "warnings": list(checks.warnings),
    }


def _drift(drift: DriftTest) -> Json:
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
        "stretches": [
            {
                "begin": s.begin,
                "end": s.end,
                "windows": s.windows,
                "values": dict(s.values),
                "std": dict(s.std),
                "filtered_error_percent": 100 * s.filtered_error,
            }
            for s in drift.segments
        ],
    }
