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
from jointid.models.controllers import numbers_of
from jointid.models.joints import Joint
from jointid.models.robots.robot import Robot
from jointid.output.json.estimates import (
    PARAMETER,
    Json,
    Shape,
    always,
    by_name,
    document_shape,
    estimate_shape,
    keys,
    take,
)

REPORT_SCHEMA = "jointid.report/1"
REPORT_ELEMENT = "jointid-answer"
"""The id of the element of a page that carries the document of its report."""


def _initial(state: Any) -> Json:
    """Return the motor's state at the first sample; its torque where it is known."""
    torque = {} if state.torque is None else {"torque": state.torque}
    return {"position": state.position, "velocity": state.velocity, **torque}


def _margins(found: Any) -> Json:
    """Return the margins of a loop; one that is not stable has none."""
    shape = keys("gain reduction delay distance_from_minus_one=modulus")
    shown = take(found, shape) | {"phase_degrees": math.degrees(found.phase)}
    return {"stable": found.stable} | (shown if found.stable else dict.fromkeys(shown))


def _law(learned: Any) -> Json:
    return {"name": type(learned.controller).__name__, "numbers": numbers_of(learned.controller)}


_ERRORS = (
    "relative_error_percent=100*relative_error filtered_error_percent=100*filtered_error "
    "attainable_error_percent=100*attainable_error nominal_error_percent=100*nominal_error"
)

SHAPES: Mapping[str, Shape] = {
    # Estimates
    "Estimate": estimate_shape,
    "EstimatedParameter": PARAMETER,
    "Gravity": keys("load angle"),  # its numbers are parameters
    "Transmission": {
        **keys("motor_per_load lead motor_kind=motor load_kind=load side"),
        "efficiency": always(1.0),
    },
    "PositionHarmonics": {"kind": always("harmonics"), **keys("period harmonics side")},
    "Drift": {"kind": always("drift"), **keys("of side")},
    "EncoderOffset": {"kind": always("encoder_offset")},
    "Initial": _initial,
    "Resampled": {
        **keys("sample_time longest_gap clocks"),
        "channels": lambda resampled: {
            name: {"method": method, "time": resampled.channels[name]} for name, method in resampled.methods.items()
        },
    },
    "Iteration": keys("iteration=number values residual_norm residual_change=change largest_step=step simulations"),
    "Message": keys("code values words"),
    "Verdict": keys("subject good said status reasons"),
    "Identifiability": lambda known: [*known.physical, *known.directions],
    "Known": keys(
        "combination.name combination.formula combination.kind combination.weights value std combination.unit "
        "known=verdict"
    ),
    "StiffnessBound": keys("load_share=share stiffness free_free_hz=frequency"),
    "ResidualReport": keys(
        "relative_percent=100*relative mean_removed_percent=100*centred rms mean unit bands "
        "against_rigid_percent=100*against_rigid whiteness_p=whiteness.p_value repeatable"
    ),
    "ResidualBand": keys("low_hz=low high_hz=high error_percent=100*error share_percent=100*share"),
    "Repeatable": keys("rms share_percent=100*share p=p_value"),
    "Agreement": {
        **keys("differs chi_square=statistic degrees_of_freedom=degrees p_value"),
        "sentence": str,
        "parameters": by_name("parameters"),
    },
    "Scatter": keys("records chi_square=statistic p_value differs std_between=between unit"),
    "Segment": keys("begin end windows values std filtered_error_percent=100*filtered_error"),
    # Diagnostics
    "Validation": document_shape(
        "jointid.validation/2",
        f"test method record resampled identified_from channels answer {_ERRORS} "
        "better_than_nominal=better samples_left_out=borders initial "
        "simulations warnings causes axes",
    ),
    "ValidatedAxis": keys(
        f"name unit position_unit transmission answer=prediction {_ERRORS} autocorrelation white_band "
        "outside_band_percent=100*outside_band"
    ),
    "SpringComparison": document_shape(
        "jointid.springs/1", "record transmission declared shown=shown.name answer springs=laws"
    ),
    "FrictionComparison": document_shape(
        "jointid.frictions/1", "record transmission declared shown=shown.name answer frictions=laws"
    ),
    "JudgedLaw": keys(
        "name parameters values std fitted_error_percent=100*fitted kept_error_percent=100*kept worse worse_std=error "
        "predicts_as_well refusal"
    ),
    "Design": document_shape(
        "jointid.design/2",
        "record=source goal sentence description axes tests noise passed peaks floor modes tried interrupted",
    ),
    "DesignedAxis": keys(
        "name position_unit torque_unit transmission limits=limits.stated reached passed present_passes from_record"
    ),
    "PredictedTest": keys("name values std units covariance.correlation"),
    "Examination": document_shape(
        "jointid.examination/1",
        "record healthy sentence logged transmission questions=answers parameters diagnosis laws",
    ),
    "Determined": keys("name symbol unit two_sigma_percent=percent known=remark"),
    "Diagnosis": document_shape(
        "jointid.diagnosis/1",
        "name method answer explained as_declared feed_forward cause sentences reasons axes",
    ),
    "RobotCause": keys("name joints words value"),
    "AxisDiagnosis": {
        **keys(
            "name left explained white=whiteness.white travel speed moving as_declared law_holds law "
            "level=faults.level findings=faults.findings undecided=faults.undecided suspects=faults.tests"
        ),
        "follows": lambda axis: None if axis.follows is None else axis.follows[0],
        "follows_share": lambda axis: None if axis.follows is None else axis.follows[1].explained,
        "parameters": by_name("parameters"),
    },
    "AxisParameter": keys("symbol value std unit nominal formula known at_least"),
    "Finding": {
        **keys("suspect=test value changes"),
        "rivals": lambda finding: [test.label for test in finding.rivals],
    },
    "Fault": str,
    "FaultTest": keys("name alike declared more_than_declared=size std statistic p_value shape"),
    "EstimateComparison": document_shape(
        "jointid.drift/1",
        "a=before b=after same_record level sentences",
        quantities=lambda comparison: {
            row.name: take(row, keys("symbol unit a=before b=after difference std p_value"))
            | {"changed": row in comparison.changed, "said": row.reason or None}
            for row in comparison.rows
        },
    ),
    "ReportedEstimate": {
        **keys("file=label record records_sha256=fingerprints"),
        "torque_sha256": lambda one: one.fingerprints[0] if len(one.fingerprints) == 1 else None,
    },
    # Controller and tuning
    "LearnedController": document_shape(
        "jointid.learned_loop/1",
        "record resampled numbers correlation in_drive alternatives regression_percent=100*regression_share",
        structure=lambda learned: str(learned.structure),
        law=_law,
        sentences=lambda learned: [str(one) for one in learned.limitations],
        residual=keys("rms percent=100*share unit=torque_unit"),
        noise=keys("torque=torque_noise position=position_noise heard_up_to_hz=band"),
        table=lambda learned: controller_text(learned.controller, learned.transmission),
    ),
    "NumberInDrive": keys("name value lower upper unit declared percent_from_declared=100*difference"),
    "Alternative": {
        **keys("worse apart_percent=100*apart alike"),
        "structure": lambda alternative: str(alternative.structure),
        "law": _law,
    },
    "Tuned": document_shape(
        "jointid.tuning/1",
        "record model transmission interval present proposed gains notch feedforward notes",
        asked=keys(
            "settings.gain_margin phase_margin_degrees=settings.phase_margin "
            "distance_from_minus_one=settings.modulus settings.confidence"
        ),
    ),
    "Gain": {
        **keys("key formula unit before after"),
        "in_drive": lambda gain: dict(zip(("name", "before", "after", "unit"), gain.in_drive, strict=True)),
    },
    "FeedForward": {
        **keys("key formula value std unit before after after_std drive drive_unit"),
        "in_drive": lambda one: dict(zip(("before", "after", "after_std", "unit"), one.in_drive, strict=True)),
    },
    "LoopMargins": keys("estimate worst crossover_hz=crossover response"),
    "ResponseBand": {
        "hertz": "hertz",
        "size": lambda band: abs(band.nominal),
        "smallest": lambda band: band.size[0],
        "largest": lambda band: band.size[1],
        "phase_lowest_degrees": lambda band: np.degrees(band.phase[0]),
        "phase_highest_degrees": lambda band: np.degrees(band.phase[1]),
    },
    "Margins": _margins,
    "ProposedNotch": keys("notch.frequency notch.bandwidth notch.depth period numerator denominator"),
    # Robots
    "RobotSimulation": {
        **keys("sample_time explanation=outcome.value events"),
        "samples": lambda simulation: len(simulation.torque),
        "outcome": lambda simulation: simulation.outcome.name.lower(),
        "peak_torque": lambda simulation: abs(simulation.torque).max(axis=0),
        "peak_speed": lambda simulation: abs(simulation.motor_velocity).max(axis=0),
    },
    "Payload": document_shape(
        "jointid.payload/1", "link parameters=rows ways_agree=agrees body_possible=possible warnings"
    ),
    # Files and reports
    "Inspection": document_shape(
        "jointid.inspection/1", "file format bytes=size channels scalars not_read=passed recognised"
    ),
    "Recognised": keys("profile=profile.name sentence axes"),
    "LoggedAxis": keys("name channels gains"),
    "InspectedChannel": keys("name rows unit minimum maximum missing time sample_time jitter"),
    "Simulation": {
        **keys("samples=torque.size sample_time explanation=outcome.value events at_limit_percent=100*at_limit"),
        "outcome": lambda simulation: simulation.outcome.name.lower(),
        "peak_torque": lambda simulation: float(abs(simulation.torque).max()),
    },
    "ProfileInterval": {
        **keys("name formula unit estimate level interval reached values=points rise threshold"),
        "estimate_was_minimum": lambda profile: not profile.improved,
    },
}
"""Keys of the documents by the name of the class; a class that is not here has all its fields."""


def to_dict(result: object) -> Json:
    """Return a result as a dict of numbers, words, lists and dicts, with its `schema`: what `--json` writes.

    Args:
        result: of `identify`, `validate`, `compare`, `diagnose`, `tune`, `learn_controller`, `inspect`.

    Raises:
        MethodError: it is no such result.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
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
    """Return the document of a simulation, without its signals."""
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


def robot_simulation_answer(robot: Robot, simulation: object, deviations: Mapping[int, float]) -> Json:
    """Return the document of a robot's simulation, without its signals."""
    said: Json = {"schema": "jointid.robot_simulation/1", "robot": robot.name, "joints": list(robot.names)}
    return {**said, **plain(simulation), "strays": {robot.names[k]: off for k, off in deviations.items()}}


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
