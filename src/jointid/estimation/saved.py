"""The estimate of a joint or a robot back from its JSON: the file has the numbers, the model the equations.

Of a robot the names and sums of the parameters are computed anew from its geometry, and must be those of the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.registry import METHODS, method_of
from jointid.estimation.problems.base import DELAY, LOG_DELAY, log_delay
from jointid.estimation.problems.inverse_model import ENCODER_OFFSET
from jointid.estimation.problems.simulated import of_record
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.fields import finite, read
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, Params, Settings
from jointid.estimation.result.verdict import SpringVerdict, judged
from jointid.estimation.robots.numbers import RobotParameters, add_delays, apply_constraints, robot_parameters
from jointid.estimation.robots.simulated import IdentifiedRobot, at_estimate
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.names import name_of
from jointid.models.robots.robot import Robot
from jointid.simulation.drive_side import DriveSide, RobotDriveSide
from jointid.simulation.loop_input import RobotLoop
from jointid.uncertainty.covariance import Covariance

RobotSystem = Robot | RobotLoop | RobotDriveSide
System = Joint | ClosedLoop | DriveSide | RobotSystem

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
    settings, fit, checks, data, params = (answer[part] for part in ("settings", "fit", "checks", "data", "params"))
    method = method_of(settings["method"]) if settings["method"] in METHODS else None
    if method is None:
        raise ValueError
    rows = tuple(replace(read(EstimatedParameter, one), name=key) for key, one in answer["parameters"].items())
    shares = {
        name: math.inf if fit[name] is None else finite(fit[name]) for name in ("relative_error", "filtered_error")
    }
    robot, part, names = None, None, read(tuple[str, ...], params["names"])
    if isinstance(system, Joint):
        known = {p.name for p in system.parameters} | {ENCODER_OFFSET.name}
        if beyond := [row.name for row in rows if row.of_joint and row.name.partition("@")[0] not in known]:
            raise RecordError(f"it has {', '.join(beyond)}, and this joint has not; declare the same joint")
        if loop is not None:  # with the numbers of the controller that were identified beside the joint
            freed = {row.name: row.value for row in rows if row.free and row.value is not None}
            of_law = freed.keys() & numbers_of(loop.controller).keys()
            loop = replace(loop, controller=with_numbers(loop.controller, {name: freed[name] for name in of_law}))
    else:
        robot = system if isinstance(system, Robot) else system.robot
        if (stated := [str(one["name"]) for one in settings["system"]["joints"]]) != list(robot.names):
            raise RecordError(f"it is of the joints {', '.join(stated)}, and this robot has {', '.join(robot.names)}")
        if refused := [row.name for row in rows if row.value is None]:
            raise RecordError(
                f"it refuses {', '.join(refused)}, so it predicts no torque; identify these joints as rigid"
            )
        kept, sums = _compute_sums(answer, system, robot, rows)
        _require_same(dict(zip(answer["robot"]["names"], answer["robot"]["formulas"], strict=True)), sums)
        rows = tuple(Params(rows, (), np.zeros((0, 0)))[name] for name in sums)
        if {*names} != {row.name for row in rows if row.free} or {*fit["axis_errors"]} != {*robot.names}:
            raise ValueError
        part = _part(answer, system, kept, rows)
    empty = np.zeros((0,) if robot is None else (0, len(robot)))
    logs = [str(one["fingerprint"]) for one in data["records"]] or [*map(str, data["logs"])]
    found = judged(
        Estimate(
            Params(rows, names, _correlation(params, len(names), robot is not None)),
            read(Fit, fit, measured=empty, predicted=empty, residuals=None, conditioning=None, **shares),
            read(Checks, {name: checks[name] for name in ("verdicts", "warnings", "notes")}),
            read(Data, data, resampled=None, records=(), windows=None, logs=tuple(logs)),
            read(
                Settings, settings, system=robot or system, loop=loop if method.needs_controller else None,
                controller=str(answer["controller_sha256"]),
            ),
            part,
        )
    )  # fmt: skip
    found.summary(details=True)  # what cannot be described is damaged
    return found


def _part(
    answer: dict[str, Any],
    system: RobotSystem,
    own: RobotParameters,
    rows: Sequence[EstimatedParameter],
) -> IdentifiedRobot:
    """Return the robot-only content, its parameters in the order of the rows."""
    said, free = answer["robot"], [i for i, row in enumerate(rows) if row.free]
    order = [said["names"].index(row.name) for row in rows]
    std = np.array([row.stderr or 0.0 for row in rows])
    correlation, names = np.eye(len(rows)), answer["params"]["names"]
    if (found := _correlation(answer["params"], len(free), whole=True)).size:
        at = [names.index(rows[i].name) for i in free]
        correlation[np.ix_(free, free)] = found[np.ix_(at, at)]
    common: dict[str, Any] = {
        "names": tuple(row.name for row in rows),
        "values": np.array([row.value for row in rows], dtype=np.float64),
        "covariance": Covariance(std, correlation),
        "nominal": np.array([finite(said["nominal"][i]) for i in order]),
        "nominal_errors": np.array([np.inf if e is None else finite(e) for e in said["nominal_errors"]]),
        "formulas": tuple(str(said["formulas"][i]) for i in order),
        "springs": read(tuple[SpringVerdict, ...], said["springs"]),
    }
    robot, method, setup = system if isinstance(system, Robot) else system.robot, answer["settings"]["method"], system
    if method == "idim":
        setup = replace(system, robot=robot.rigid) if isinstance(system, RobotLoop) else robot.rigid
    elif method == "didim" and isinstance(system, RobotLoop):
        setup = at_estimate(system, own, common["values"])
    else:
        setup = RobotDriveSide(robot)
    return IdentifiedRobot(setup=setup, parameters=own, **common)


def _compute_sums(
    answer: dict[str, Any], system: RobotSystem, robot: Robot, rows: Sequence[EstimatedParameter]
) -> tuple[RobotParameters, dict[str, str]]:
    """Return the parameters of the robot, and their sums as text by name."""
    method = answer["settings"]["method"]
    if method == "idim":
        found = robot_parameters(robot.rigid, whole=False)
        return found, dict(zip(found.names, found.formulas(robot.rigid), strict=True))
    if method == "didim" and not isinstance(system, RobotLoop):
        raise RecordError("it was identified under controllers, and this robot has none; add the [controller] tables")
    found = _parameters(robot, rows, answer["robot"], finite(answer["data"]["sample_time"]))
    if isinstance(system, RobotLoop):
        stated = {row.name for row in rows}
        found = add_delays(found, system, [j for j, one in enumerate(robot.names) if name_of(DELAY, one) in stated])
    fixed = {p.name: p.symbol for p in found.fixed}
    return found, dict(zip(found.names, found.formulas(robot), strict=True)) | fixed


def _parameters(
    robot: Robot, rows: Sequence[EstimatedParameter], said: dict[str, Any], sample_time: float
) -> RobotParameters:
    """Return the parameters of a search as the document has them."""
    names = {row.name for row in rows}
    known = {
        row.name: Parameter(row.name, row.symbol, Quantity.FORCE).fix(row.value or 0.0) for row in rows if not row.free
    }
    offsets = any(f"{name}.offset" in names for name in robot.names)
    # The numbers of a law are all parameters where it was searched, and its linear part where lines were enough.
    for whole in (True, False):
        parameters = apply_constraints(robot_parameters(robot, offsets=offsets, whole=whole), known)
        if names >= {*parameters.names}:
            break
    delay = said["log_delay"]
    if delay is None:
        return parameters
    log = log_delay(None if LOG_DELAY.name in names else finite(delay), sample_time)
    resting = np.array([f"{name}.initial_link_position" not in names for name in robot.names])
    return of_record(parameters, robot, resting, log)


def _require_same(stated: dict[str, str], sums: dict[str, str]) -> None:
    """Require the parameters of a document, sums by name, to be those of the robot in any order.

    Raises:
        RecordError: they are not.
    """
    if other := stated.keys() ^ sums.keys():
        names = ", ".join(sorted(other))
        raise RecordError(f"its parameters are not those of this robot, which differ in {names}; identify again")
    for name, formula in sums.items():
        there, here = (
            {symbol: float(f"{sign}{weight or 1}") for sign, symbol, weight in _TERM.findall(text)}
            for text in (stated[name], formula)
        )
        if there.keys() != here.keys() or not np.allclose([there[one] for one in here], [*here.values()], rtol=_DIGITS):
            raise RecordError(f"there {name} is {stated[name]}, and of this robot {formula}; identify again")


def _correlation(params: dict[str, Any], size: int, whole: bool) -> FloatArray:
    """Return the correlation of the free parameters, or of the joint's alone; empty where it is not known."""
    found: FloatArray = np.array(params["correlation"], dtype=np.float64)
    if not found.size or np.any(np.isnan(found)):
        return np.zeros((0, 0))
    most = min(len(found), size)  # the joint's come first
    if found.shape != (2 * (size if whole else most,)) or not np.all(np.abs(found) < 1.01):
        raise ValueError
    return found
