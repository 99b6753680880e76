"""Restore an estimate of a joint or robot from JSON and model.

Names and sums of a robot's parameters are computed from its geometry, and must be those of the file.
"""

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods import METHODS, method_of
from jointid.estimation.parameters import LOG_DELAY, add_delays, apply_constraints, log_delay, robot_parameters
from jointid.estimation.problems.inverse_model import ENCODER_OFFSET
from jointid.estimation.problems.simulated import of_record
from jointid.estimation.result.agreement import Agreement, Alone
from jointid.estimation.result.estimate import Data, Estimate, EstimatedParameter, Fit, Settings
from jointid.estimation.result.fields import finite, read
from jointid.estimation.result.verdict import Check, StiffnessBound, judged
from jointid.estimation.robots.simulated import IdentifiedRobot, at_estimate
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.base_parameters import name_of
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.simulation.plant import DELAY
from jointid.uncertainty.covariance import covariance_of
from jointid.uncertainty.identifiability import Identifiability

RobotSystem = Robot | RobotLoop
System = Joint | ClosedLoop | RobotSystem

_DIGITS = 2e-3  # of the numbers in a sum, which has four
_TERM = re.compile(r"(?:^|([+-]) )(\S+)(?: \* ([0-9.e+-]+))?")  # sign, symbol and weight in a sum


def restore_estimate(answer: dict[str, Any], system: RobotSystem | Joint, loop: ClosedLoop | None = None) -> Estimate:
    """Return the estimate of a document.

    Args:
        answer: the document.
        system: the joint, or the robot; under its controllers for an estimate by didim.
        loop: of a joint, used where its method simulates one.

    Raises:
        RecordError: the robot is another one, has no controllers where they are needed, or a value is refused.
        KeyError, TypeError, ValueError, ...: the document is damaged.
    """
    settings, fit, robot, part = answer["settings"], answer["fit"], None, None
    rows = {key: read(EstimatedParameter, one, name=key) for key, one in answer["parameters"].items()}
    if settings["method"] not in METHODS:
        raise ValueError
    if isinstance(system, Joint):
        known = {p.name for p in system.parameters} | {ENCODER_OFFSET.name}
        if beyond := [name for name, row in rows.items() if row.of_joint and name.partition("@")[0] not in known]:
            raise RecordError(f"it has {', '.join(beyond)}, and this joint has not; declare the same joint")
        if loop is not None:  # with the numbers of the controller that were identified beside the joint
            freed = {name: row.value for name, row in rows.items() if row.free and row.value is not None}
            of_law = freed.keys() & numbers_of(loop.controller).keys()
            loop = replace(loop, controller=with_numbers(loop.controller, {name: freed[name] for name in of_law}))
    else:
        robot = system.robot
        part = _restore_robot(answer, system, rows)
        if [*fit["axis_errors"]] != [*robot.names]:
            raise ValueError
    shares = {name: _share(fit[name]) for name in ("relative_error", "filtered_error")}
    of_axes = {key: {name: _share(one) for name, one in fit[key].items()} for key in ("axis_errors", "nominal_errors")}
    empty = np.zeros((0,) if robot is None else (0, len(robot)))
    law = loop if method_of(settings["method"]).simulates == "loop" else None
    said = {name: read(tuple[str, ...], answer[name]) for name in ("warnings", "notes")}
    if (agreement := answer.get("agreement")) is not None:  # without correlations
        spread = [covariance_of(np.diag(np.square([*one["std"].values()]))) for one in agreement["parts"]]
        parts = (read(Alone, one, covariance=own) for one, own in zip(agreement["parts"], spread, strict=True))
        agreement = read(Agreement, agreement, parts=tuple(parts))
    found = Estimate(
        tuple(rows.values()),
        _correlation(answer, sum(row.free for row in rows.values()), robot is not None),
        read(Fit, fit, measured=empty, predicted=empty, **shares, **of_axes),
        read(Data, answer["data"]),
        read(Settings, settings, system=robot or system, loop=law, controller=str(answer["controller_sha256"])),
        read(tuple[Check, ...], answer["checks"]), read(Identifiability | None, answer.get("known")),
        read(tuple[StiffnessBound, ...], answer["bounds"]), agreement,
        robot=part, **said,
    )  # fmt: skip
    found = judged(found)
    found.summary(details=True)  # what cannot be described is damaged
    return found


def _share(value: object) -> float:
    """Return an error; infinite if unknown."""
    return math.inf if value is None else finite(value)


def _restore_robot(answer: dict[str, Any], system: RobotSystem, rows: dict[str, EstimatedParameter]) -> IdentifiedRobot:
    """Robot of a document with known geometry, which must give equal sums.

    Raises:
        RecordError: it is another one, has no controllers where they are needed, or a value is refused.
    """
    settings, robot = answer["settings"], system.robot
    simulates = method_of(settings["method"]).simulates
    setup: RobotSystem = robot
    if (stated := [str(one["name"]) for one in settings["system"]["joints"]]) != list(robot.names):
        raise RecordError(f"it is of the joints {', '.join(stated)}, and this robot has {', '.join(robot.names)}")
    refused, searched = [name for name, row in rows.items() if row.value is None], answer.get("values")
    if refused and searched is None:
        raise RecordError(f"it refuses {', '.join(refused)}, so it predicts no torque; identify these joints as rigid")
    if not simulates:
        robot = robot.rigid
        setup = replace(system, robot=robot) if isinstance(system, RobotLoop) else robot
        parameters = robot_parameters(robot, whole=False)
    else:
        fixed = [row for row in rows.values() if not row.free]
        known = {row.name: Parameter(row.name, row.symbol, Quantity.FORCE).fix(row.value or 0.0) for row in fixed}
        offsets = any(f"{name}.offset" in rows for name in robot.names)
        parameters = robot_parameters(robot, offsets=offsets, logarithmic=True, whole=simulates == "loop")
        parameters = apply_constraints(parameters, known)  # as the search has them: along a motion the laws are lines
    if simulates == "loop":
        if not isinstance(system, RobotLoop):
            raise RecordError("it was identified under controllers, and this robot has none; add [controller] tables")
        free = [j for j, one in enumerate(robot.names) if name_of(DELAY, one) in rows]
        setup, parameters = system, add_delays(parameters, system, free)
    elif (late := settings["log_delay"]) is not None:
        log = log_delay(None if LOG_DELAY.name in rows else finite(late), finite(answer["data"]["sample_time"]))
        resting = np.array([f"{name}.initial_link_position" not in rows for name in robot.names])
        parameters = of_record(parameters, robot, resting, log)
    if [*rows] != [*parameters.names]:
        other = ", ".join(sorted(rows.keys() ^ {*parameters.names})) or "their order"
        raise RecordError(f"its parameters are not those of this robot, which differ in {other}; identify again")
    for (name, row), formula in zip(rows.items(), parameters.formulas(robot), strict=True):
        there, here = (
            {symbol: float(f"{sign}{weight or 1}") for sign, symbol, weight in _TERM.findall(text)}
            for text in (row.formula, formula)
        )
        if there.keys() != here.keys() or not np.allclose([there[one] for one in here], [*here.values()], rtol=_DIGITS):
            raise RecordError(f"there {name} is {row.formula}, and of this robot {formula}; identify again")
    values = np.array(searched or [row.value for row in rows.values()], dtype=np.float64)
    if isinstance(setup, RobotLoop):
        setup = at_estimate(setup, parameters, values)
    return IdentifiedRobot(setup, parameters, values)


def _correlation(answer: dict[str, Any], size: int, whole: bool) -> FloatArray:
    """Correlation of the free parameters, or of the joint's; empty if unknown."""
    found: FloatArray = np.array(answer["correlation"], dtype=np.float64)
    if not found.size or np.any(np.isnan(found)):
        return np.zeros((0, 0))
    most = min(len(found), size)  # the joint's come first
    if found.shape != (2 * (size if whole else most,)) or not np.all(np.abs(found) < 1.01):
        raise ValueError
    return found
