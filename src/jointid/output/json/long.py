"""What a long record says of a joint, as JSON."""

from __future__ import annotations

from jointid.estimation.result.estimate import law_fingerprint
from jointid.estimation.streaming.long_estimate import LongEstimate
from jointid.estimation.streaming.segments import Drift
from jointid.output.json.estimates import combinations_answer
from jointid.output.json.parts import (
    Json,
    filtering_answer,
    gravity_answer,
    other_side_answer,
    parameter_answer,
    transmission_answer,
)

LONG_SCHEMA = "jointid.long/1"


def long_answer(estimate: LongEstimate) -> Json:
    """Return what a long record says as it is written to JSON; percentages are of the measured torque's norm."""
    return {
        "schema": LONG_SCHEMA,
        "model": estimate.joint.model,
        "kind": estimate.joint.kind,
        "friction": estimate.joint.friction.name,
        "gravity": gravity_answer(estimate.joint),
        "transmission": transmission_answer(estimate.joint.transmission),
        "record": {"name": estimate.record, "sample_time": estimate.sample_time, "torque_unit": estimate.torque_unit},
        "channels": list(estimate.channels),
        "parameters": {p.name: parameter_answer(p) for p in estimate.parameters},
        "other_side": other_side_answer(estimate.parameters, estimate.other),
        "combinations": combinations_answer(estimate.known),
        "correlation": [[float(value) for value in row] for row in estimate.correlation],
        "repeatable": {
            "rms": estimate.repeatable.rms,
            "share_percent": 100 * estimate.repeatable.share,
            "p": estimate.repeatable.p_value,
        },
        "drift": _drift(estimate.drift) | {"sentence": estimate.drift_sentence},
        "window": estimate.window,
        "settling": estimate.settling,
        "windows": estimate.windows,
        "windows_without_motion": estimate.still,
        "duration": estimate.duration,
        "rows": estimate.rows,
        "filtered_error_percent": 100 * estimate.filtered_error,
        "filtering": filtering_answer(estimate.filtering),
        "at_limit": estimate.at_limit,
        "controller_sha256": law_fingerprint(estimate.loop),
        "passes": estimate.passes,
        "simulations": estimate.simulations,
        "converged": estimate.converged,
        "stop": estimate.stop,
        "interrupted": estimate.interrupted,
        "intervals": estimate.intervals,
        "warnings": list(estimate.warnings),
    }


def _drift(drift: Drift) -> Json:
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
            for s in drift.stretches
        ],
    }
