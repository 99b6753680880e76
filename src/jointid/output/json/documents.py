"""Results as JSON: one walk over their fields, by the shapes in `SHAPES` where a document differs from its class.

Every document has `schema` at its top level. A number that does not exist is null, never NaN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from jointid import Record
from jointid.common.errors import MethodError
from jointid.config import controller_text
from jointid.models.controllers import Controller, numbers_of
from jointid.models.joints import Joint
from jointid.models.robots.robot import Robot
from jointid.output.json.estimates import Json, Shape, always, estimate_shape, named, percent, same, take

REPORT_SCHEMA = "jointid.report/1"
REPORT_ELEMENT = "jointid-answer"
"""The id of the element of a page that carries the document of its report."""


def _initial(state: Any) -> Json:
    """Return the motor's state at the first sample; its torque where it is known."""
    torque = {} if state.torque is None else {"torque": state.torque}
    return {"position": state.position, "velocity": state.velocity, **torque}


def _margins(found: Any) -> Json:
    """Return the margins of a loop; one that is not stable has none."""
    shape: dict[str, Shape] = {
        "gain": "gain",
        "reduction": "reduction",
        "phase_degrees": lambda margins: math.degrees(margins.phase),
        "delay": "delay",
        "distance_from_minus_one": "modulus",
    }
    return {"stable": found.stable} | (take(found, shape) if found.stable else dict.fromkeys(shape))


def _law(controller: Controller) -> Json:
    return {"name": type(controller).__name__, "numbers": numbers_of(controller)}


SHAPES: Mapping[str, Shape] = {
    # Estimates
    "Estimate": estimate_shape,
    "EstimatedParameter": {
        **same("symbol", "value"),
        "std": "stderr",
        **same("unit", "free", "identifiable", "lower_bound", "at_bound", "lack_of_fit"),
    },
    "Gravity": same("load", "angle"),  # its numbers are parameters
    "Transmission": {
        **same("motor_per_load", "lead"),
        "motor_kind": "motor",
        "load_kind": "load",
        "side": "side",
        "efficiency": always(1.0),
    },
    "PositionHarmonics": {"kind": always("harmonics"), **same("period", "harmonics", "side")},
    "Drift": {"kind": always("drift"), **same("of", "side")},
    "EncoderOffset": {"kind": always("encoder_offset"), **same("side")},
    "Initial": _initial,
    "Resampled": {
        **same("sample_time", "longest_gap"),
        "channels": lambda resampled: {
            name: {"method": method, "time": resampled.channels[name]} for name, method in resampled.methods.items()
        },
        "clocks": "clocks",
    },
    "Iteration": {
        "iteration": "number",
        **same("values", "residual_norm"),
        "residual_change": "change",
        "largest_step": "step",
        **same("simulations", "gain_scale"),
    },
    "Message": same("code", "values", "words"),
    "Verdict": same("subject", "good", "said", "status", "reasons"),
    "Identifiability": lambda known: [*known.physical, *known.directions],
    "Known": {
        "name": "combination.name",
        "formula": "combination.formula",
        "kind": "combination.kind",
        "weights": "combination.weights",
        **same("value", "std"),
        "unit": "combination.unit",
        "known": "verdict",
    },
    "StiffnessBound": {"load_share": "share", "stiffness": "stiffness", "free_free_hz": "frequency"},
    "ResidualReport": {
        "relative_percent": percent("relative"),
        "mean_removed_percent": percent("centred"),
        **same("rms", "mean", "unit", "bands"),
        "against_rigid_percent": percent("against_rigid"),
        "whiteness_p": "whiteness.p_value",
        "repeatable": "repeatable",
    },
    "ResidualBand": {
        "low_hz": "low",
        "high_hz": "high",
        "error_percent": percent("error"),
        "share_percent": percent("share"),
    },
    "Repeatable": {"rms": "rms", "share_percent": percent("share"), "p": "p_value"},
    "Agreement": {
        "sentence": str,
        "differs": "differs",
        "chi_square": "statistic",
        "degrees_of_freedom": "degrees",
        "p_value": "p_value",
        "parameters": named("parameters"),
    },
    "Scatter": {
        "records": "records",
        "chi_square": "statistic",
        **same("p_value", "differs"),
        "std_between": "between",
        "unit": "unit",
    },
    "Segment": {
        **same("begin", "end", "windows", "values", "std"),
        "filtered_error_percent": percent("filtered_error"),
    },
    # Diagnostics
    "Validation": {
        "schema": always("jointid.validation/1"),
        **same("test", "method", "transmission", "record", "resampled", "identified_from", "channels"),
        "relative_error_percent": percent("relative_error"),
        "filtered_error_percent": percent("filtered_error"),
        "attainable_error_percent": percent("attainable_error"),
        **same("answer"),
        "tracking_error_percent": percent("tracking_error"),
        "samples_left_out": "borders",
        **same("autocorrelation", "white_band"),
        "outside_band_percent": percent("outside_band"),
        **same("initial", "simulations", "warnings"),
    },
    "MethodComparison": {
        "schema": always("jointid.comparison/1"),
        **same("record", "model", "methods", "disagreements"),
    },
    "SpringComparison": {
        "schema": always("jointid.springs/1"),
        **same("record", "transmission", "declared"),
        "shown": "shown.name",
        **same("answer"),
        "springs": "laws",
    },
    "FrictionComparison": {
        "schema": always("jointid.frictions/1"),
        **same("record", "transmission", "declared"),
        "shown": "shown.name",
        **same("answer"),
        "frictions": "laws",
    },
    "JudgedLaw": {
        **same("name", "parameters", "values", "std"),
        "fitted_error_percent": percent("fitted"),
        "kept_error_percent": percent("kept"),
        **same("worse"),
        "worse_std": "error",
        **same("predicts_as_well", "refusal"),
    },
    "Design": {
        "schema": always("jointid.design/1"),
        **same("record", "goal", "sentence", "description", "transmission", "tests", "reached", "limits", "passed"),
        **same("present_passes", "from_present", "floor", "modes", "interrupted"),
    },
    "Goal": same("name", "weights"),
    "Foretold": {**same("name", "values", "std", "units"), "correlation": "covariance.correlation"},
    "Examination": {
        "schema": always("jointid.examination/1"),
        **same("record", "healthy", "sentence", "logged", "transmission"),
        "questions": "looked",
        **same("parameters", "changes"),
    },
    "Looked": same("question", "good", "said", "fault"),
    "Determined": {**same("name", "symbol", "unit"), "two_sigma_percent": "percent", "known": "remark"},
    "LoopCheck": {
        "schema": always("jointid.loop/1"),
        **same("as_declared", "level", "sentences", "reasons", "findings", "undecided"),
        "suspects": "tests",
    },
    "Finding": {"suspect": "test", **same("value", "rivals", "changes")},
    "FaultTest": {
        **same("name", "alike", "declared"),
        "more_than_declared": "size",
        **same("std", "statistic", "p_value", "shape"),
    },
    "Advice": {
        "schema": always("jointid.advice/1"),
        **same("record", "noise", "transmission"),
        "parameters": lambda advice: {
            name: {"symbol": advice.symbols[name], "unit": advice.units[name], "std": std}
            for name, std in advice.std.items()
        },
        **same("sensors", "tests", "sentences"),
    },
    "Prediction": {
        "name": "name",
        "described": "description",
        "std": lambda prediction: dict(prediction.std) or None,
    },
    "StiffnessTestDesign": {
        "schema": always("jointid.revealing/1"),
        **same("record", "transmission"),
        "pulses": {"height": "height", "width": "width", "told": "pulses"},
        "load_encoder": {"step": "step", "told": "encoder"},
        "sentence": str,
    },
    "DetectableMode": {
        "load_share": "share",
        "excluded_below_hz": "softest",
        "relative_std": lambda mode: mode.deviation if math.isfinite(mode.deviation) else None,
        "told_below_hz": "mode",
    },
    "EstimateComparison": {
        "schema": always("jointid.drift/1"),
        "a": "before",
        "b": "after",
        **same("same_record", "level"),
        "quantities": lambda comparison: {
            row.name: {
                "symbol": row.symbol,
                "unit": row.unit,
                "a": row.before,
                "b": row.after,
                "difference": row.difference,
                "std": row.std,
                "p_value": row.p_value,
                "changed": row in comparison.changed,
                "said": row.reason or None,
            }
            for row in comparison.rows
        },
        "sentences": "sentences",
    },
    "ReportedEstimate": {"file": "label", "record": "record", "torque_sha256": "fingerprint"},
    # Controller and tuning
    "LearnedLoop": {
        "schema": always("jointid.learned_loop/1"),
        **same("record", "resampled"),
        "structure": lambda learned: str(learned.structure),
        "law": lambda learned: _law(learned.controller),
        **same("numbers", "correlation"),
        "in_drive": lambda learned: [
            {
                **{name: getattr(one, name) for name in ("name", "value", "lower", "upper", "unit", "declared")},
                "percent_from_declared": None if one.difference is None else 100 * one.difference,
            }
            for one in learned.in_drive
        ],
        "equivalent": "equivalent_laws",
        "alternatives": "alternatives",
        "sentences": lambda learned: [str(one) for one in learned.limitations],
        "residual": {"rms": "rms", "percent": percent("share"), "unit": "torque_unit"},
        "regression_percent": percent("regression_share"),
        "noise": {"torque": "torque_noise", "position": "position_noise", "heard_up_to_hz": "band"},
        "table": lambda learned: controller_text(learned.controller, learned.transmission),
    },
    "Alternative": {
        "structure": lambda alternative: str(alternative.structure),
        "law": lambda alternative: _law(alternative.controller),
        "worse": "worse",
        "apart_percent": percent("apart"),
        "alike": "alike",
    },
    "Tuned": {
        "schema": always("jointid.tuning/1"),
        **same("record", "model", "transmission", "interval"),
        "asked": {
            "gain_margin": "settings.gain_margin",
            "phase_margin_degrees": "settings.phase_margin",
            "distance_from_minus_one": "settings.modulus",
            "confidence": "settings.confidence",
        },
        **same("present", "proposed", "gains", "notch", "feedforward", "detectable", "notes"),
    },
    "Gain": {
        **same("key", "formula", "unit", "before", "after"),
        "in_drive": lambda gain: dict(zip(("name", "before", "after", "unit"), gain.in_drive, strict=True)),
    },
    "FeedForward": {
        **same("key", "formula", "value", "std", "unit", "before", "after", "after_std", "drive", "drive_unit"),
        "in_drive": lambda one: dict(zip(("before", "after", "after_std", "unit"), one.in_drive, strict=True)),
    },
    "LoopMargins": {
        **same("estimate", "worst"),
        "crossover_hz": "crossover",
        "response": {
            "hertz": "response.hertz",
            "size": lambda loop: abs(loop.response.nominal),
            "smallest": lambda loop: loop.response.size[0],
            "largest": lambda loop: loop.response.size[1],
            "phase_lowest_degrees": lambda loop: [math.degrees(angle) for angle in loop.response.phase[0]],
            "phase_highest_degrees": lambda loop: [math.degrees(angle) for angle in loop.response.phase[1]],
        },
    },
    "Margins": _margins,
    "ProposedNotch": {
        "frequency": "notch.frequency",
        "bandwidth": "notch.bandwidth",
        "depth": "notch.depth",
        **same("period", "numerator", "denominator"),
    },
    "MinimumDetectableChange": same("false_alarm", "power", "changes"),
    # Robots
    "RobotEstimate": {
        "schema": always("jointid.robot_estimate/1"),
        "robot": "robot.name",
        "joints": "robot.names",
        "estimator": "settings.estimator",
        "converged": "converged",
        "parameters": "rows",
        "left": "joint_errors",
        "nominal_left": "nominal_errors",
    },
    "RobotTorqueEstimate": {
        "schema": always("jointid.robot_torque_estimate/1"),
        "robot": "robot.name",
        "joints": "robot.names",
        "converged": "fit.converged",
        "parameters": "rows",
        "left": "joint_errors",
        "nominal_left": "nominal_errors",
    },
    "RobotValidation": {
        "schema": always("jointid.robot_validation/1"),
        "robot": "robot.name",
        "joints": "robot.names",
        "better_than_nominal": "better",
        "bodies_better_than_nominal": "bodies_better",
        "left": "joint_errors",
        "nominal_left": "nominal_errors",
        "bodies_left": "body_errors",
    },
    "RobotDiagnosis": {
        "schema": always("jointid.robot_diagnosis/1"),
        "robot": "robot.name",
        **same("method", "answer", "explained", "as_declared", "feed_forward", "sentences", "joints"),
    },
    "JointDiagnosis": {
        **same("name", "left", "explained"),
        "white": "whiteness.white",
        "follows": lambda joint: None if joint.follows is None else joint.follows[0],
        "follows_share": lambda joint: None if joint.follows is None else joint.follows[1].explained,
        **same("travel", "speed", "moving", "law_holds"),
        "law": "law",
        "parameters": lambda joint: {one.name: one for one in joint.parameters},
    },
    "ParameterOfJoint": same("value", "std", "unit", "nominal", "formula", "known", "at_least"),
    "LawOnPosition": same("left", "gain", "late", "left_in_time", "noise"),
    "RobotDesign": {
        "schema": always("jointid.robot_design/1"),
        "robot": "robot.name",
        "joints": "robot.names",
        **same("sentence", "sample_time"),
        "samples": lambda design: len(design.reference),
        **same("parameters", "noise", "of_record", "limits", "reached", "passed", "modes", "tried"),
    },
    "RobotSimulation": {
        "samples": lambda simulation: len(simulation.torque),
        "sample_time": "sample_time",
        "outcome": lambda simulation: simulation.outcome.name.lower(),
        "explanation": "outcome.value",
        "events": "events",
        "peak_torque": lambda simulation: [float(one) for one in abs(simulation.torque).max(axis=0)],
        "peak_speed": lambda simulation: [float(one) for one in abs(simulation.motor_velocity).max(axis=0)],
    },
    "JointLimits": same("lower", "upper", "speed", "acceleration", "torque"),
    "WeighedPayload": {
        "schema": always("jointid.payload/1"),
        "link": "link",
        "parameters": "rows",
        "ways_agree": "agrees",
        "body_possible": "possible",
    },
    "DriveGains": {"schema": always("jointid.drive_gains/1"), "gains": "rows"},
    # Files and reports
    "Inspection": {
        "schema": always("jointid.inspection/1"),
        **same("file", "format"),
        "bytes": "size",
        **same("channels", "scalars"),
        "not_read": "passed",
    },
    "InspectedChannel": {
        "name": "name",
        "rows": "outline.rows",
        "unit": "unit",
        "minimum": "outline.minimum",
        "maximum": "outline.maximum",
        "missing": "outline.missing",
        **same("time", "sample_time", "jitter"),
    },
    "Simulation": {
        "samples": "torque.size",
        "sample_time": "sample_time",
        "outcome": lambda simulation: simulation.outcome.name.lower(),
        "explanation": "outcome.value",
        "events": "events",
        "at_limit_percent": percent("at_limit"),
        "peak_torque": lambda simulation: float(abs(simulation.torque).max()),
    },
    "ProfileInterval": {
        **same("name", "formula", "unit", "estimate", "level", "interval", "reached"),
        "values": "points",
        **same("rise", "threshold"),
        "estimate_was_minimum": lambda profile: not profile.improved,
    },
}
"""By the name of the class: what a document has of an object of it."""


def to_dict(result: object) -> Json:
    """Return a result as a dict of numbers, words, lists and dicts, with its `schema`: what `--json` writes.

    Args:
        result: of `identify`, `validate`, `compare_methods`, `compare_springs`, `compare_frictions`, `check_loop`,
            `advise`, `design_stiffness_test`, `tune`, `learn_loop`, `inspect`, `compare_estimates`.

    Raises:
        MethodError: it is no such result.

    Example:
        >>> import jointid as ji
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(position_gain=100.0, velocity_gain=2000.0))
        >>> reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
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


def simulation_answer(simulation: object, joint: Joint, values: Mapping[str, float], record: Record) -> Json:
    """Return what a simulation was and how it ended as it is written to JSON; the signals go into a record."""
    parameters = {
        p.name: {"symbol": p.symbol, "value": values[p.name], "unit": joint.unit(p)} for p in joint.parameters
    }
    document: Json = plain(
        {
            "schema": "jointid.simulation/1",
            "model": joint.model,
            "transmission": joint.transmission,
            "record": record.name,
            "resampled": record.resampled,
            "parameters": parameters,
        }
    )
    document.update(plain(simulation))
    return document


def robot_simulation_answer(robot: Robot, simulation: object, strays: Mapping[int, float]) -> Json:
    """Return what a robot's simulation was and how it ended as it is written to JSON; the signals go into a record."""
    said: Json = {"schema": "jointid.robot_simulation/1", "robot": robot.name, "joints": list(robot.names)}
    return {**said, **plain(simulation), "strays": {robot.names[k]: off for k, off in strays.items()}}


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
