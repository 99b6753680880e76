"""The estimate of a robot back from its JSON: the file has the numbers, the robot file has the geometry.

The names and sums of the parameters are computed anew from that geometry, and must be those of the file.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.messages import Message
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.registry import METHODS
from jointid.estimation.problems.base import LOG_DELAY, log_delay
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, Params, Settings
from jointid.estimation.result.robot import IdentifiedRobot, SpringVerdict
from jointid.estimation.robots.drive_side import of_record
from jointid.estimation.robots.idim import InverseModelRobot, friction_formulas
from jointid.estimation.robots.numbers import RobotParameters, apply_constraints, robot_parameters
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.estimation.unknown_timing import read_timing
from jointid.models.robots.base_parameters import base_parameters
from jointid.models.robots.friction_terms import friction_terms
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.verdict import Reason, Status, Subject, Verdict

RobotSystem = Robot | RobotLoop | RobotDriveSide

_DIGITS = 2e-3  # of the numbers in a sum, which has four
_NUMBER = re.compile(r"(?<= \* )[0-9.e+-]+")


def build_robot_estimate(answer: dict[str, Any], system: RobotSystem) -> Estimate:
    """Return the estimate of a document of a robot.

    Args:
        answer: the document.
        system: the robot; under its controllers for an estimate by didim.

    Raises:
        RecordError: the robot is another one, has no controllers where they are needed, or a value is refused.
        KeyError, TypeError, ValueError: the document is damaged.
    """
    robot = system if isinstance(system, Robot) else system.robot
    if (stated := list(answer["robot"]["joints"])) != list(robot.names):
        raise RecordError(
            f"it is of the joints {', '.join(map(str, stated))}, and this robot has {', '.join(robot.names)}"
        )
    method = answer["method"]
    if method not in tuple(METHODS):
        raise ValueError
    rows = tuple(_row(name, one) for name, one in answer["parameters"].items())
    if refused := [row.name for row in rows if row.value is None]:
        raise RecordError(f"it refuses {', '.join(refused)}, so it predicts no torque; identify these joints as rigid")
    part = _part(answer, system, robot, rows)
    free, given, number = tuple(answer["free"]), answer["filtering"], _finite
    if free != tuple(row.name for row in rows if row.free):
        raise ValueError
    kept = [i for i, row in enumerate(rows) if row.free]
    named = ("position_cutoff", "cutoff", "decimation", "timing", "aliasing")
    filtering = Filtering(borders=tuple(given["borders"]), **{name: given[name] for name in named})
    record, said = answer["record"], answer["robot"]
    empty = np.zeros((0, len(robot)))
    return Estimate(
        params=Params(rows, free, part.covariance.correlation[np.ix_(kept, kept)], str(answer["intervals"])),
        fit=Fit(
            measured=empty,
            predicted=empty,
            borders=filtering.borders,
            relative_error=number(answer["relative_error_percent"]) / 100,
            filtered_error=number(answer["filtered_error_percent"]) / 100,
            rows=int(answer["rows"]),
            simulations=int(answer["simulations"]),
            stop=str(answer["stop"]),
            converged=bool(answer["converged"]),
            axis_errors=dict(zip(robot.names, map(number, said["left"]), strict=True)),
        ),
        checks=Checks(verdicts=tuple(map(_verdict, answer["verdicts"])), warnings=tuple(map(str, answer["warnings"]))),
        data=Data(
            record=str(record["name"]),
            channels=tuple(map(str, answer["channels"])),
            sample_time=number(record["sample_time"]),
            torque_unit=str(record["torque_unit"]),
            fingerprint=str(record["torque_sha256"]),
            logs=tuple(map(str, record.get("logs_sha256", ()))),
        ),
        settings=Settings(
            method, str(answer["variant"]), system=robot, loop=None, filtering=filtering, timing=read_timing(answer)
        ),
        robot=part,
    )


def _part(
    answer: dict[str, Any], system: RobotSystem, robot: Robot, rows: Sequence[EstimatedParameter]
) -> IdentifiedRobot:
    """Return the robot-only content."""
    names, said = tuple(row.name for row in rows), answer["robot"]
    one = answer["parameters"]
    formulas = tuple(str(one[name]["formula"]) for name in names)
    std = np.array([0.0 if row.stderr is None else row.stderr for row in rows])
    correlation, free = np.eye(len(rows)), [i for i, row in enumerate(rows) if row.free]
    if answer["correlation"] is not None:
        found: FloatArray = np.array(answer["correlation"], dtype=np.float64)
        if found.shape != (len(free), len(free)) or not np.all(np.isfinite(found)):
            raise ValueError
        correlation[np.ix_(free, free)] = found
    common: dict[str, Any] = {
        "names": names,
        "values": np.array([row.value for row in rows], dtype=np.float64),
        "covariance": Covariance(std, correlation, 0),
        "nominal": np.array([_finite(one[name]["nominal"]) for name in names]),
        "nominal_errors": np.array([np.inf if e is None else _finite(e) for e in said["nominal_left"]]),
        "formulas": formulas,
        "springs": tuple(SpringVerdict(**spring) for spring in said.get("springs", ())),
    }
    if answer["method"] == "idim":
        base = base_parameters(robot)
        own = (*base.names, *(term.name(robot) for term in friction_terms(robot)))
        _require_same(names, formulas, own, (*base.formulas, *friction_formulas(robot, base)))
        return InverseModelRobot(setup=system if isinstance(system, RobotLoop) else robot, base=base, **common)
    if answer["method"] == "didim" and not isinstance(system, RobotLoop):
        raise RecordError("it was identified under controllers, and this robot has none; add the [controller] tables")
    parameters = _parameters(robot, rows, said, _finite(answer["record"]["sample_time"]))
    kept = (*parameters.names, *(p.name for p in parameters.fixed))
    _require_same(names, formulas, kept, (*parameters.formulas(robot), *(p.symbol for p in parameters.fixed)))
    setup = system if isinstance(system, RobotLoop) and answer["method"] == "didim" else RobotDriveSide(robot)
    return SimulatedRobot(setup=setup, parameters=parameters, **common)


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
    delay = said.get("log_delay")
    if delay is None:
        return parameters
    log = log_delay(None if LOG_DELAY.name in names else _finite(delay), sample_time)
    resting = np.array([f"{name}.initial_link_position" not in names for name in robot.names])
    return of_record(parameters, robot, resting, log)


def _require_same(names: Sequence[str], formulas: Sequence[str], own: Sequence[str], computed: Sequence[str]) -> None:
    """Require the parameters of a document to be those of the robot.

    Raises:
        RecordError: they are not.
    """
    if tuple(names) != tuple(own):
        other = ", ".join(sorted(set(names) ^ set(own))) or "their order"
        raise RecordError(f"its parameters are not those of this robot, which differ in {other}")
    for name, stated, formula in zip(names, formulas, computed, strict=True):
        alike = _NUMBER.sub("", stated) == _NUMBER.sub("", formula)
        weights = [list(map(float, _NUMBER.findall(text))) for text in (stated, formula)]
        if not alike or not np.allclose(weights[0], weights[1], rtol=_DIGITS):
            raise RecordError(f"there {name} is {stated}, and of this robot {formula}")


def _row(name: str, one: dict[str, Any]) -> EstimatedParameter:
    def optional(key: str) -> float | None:
        return None if one[key] is None else _finite(one[key])

    return EstimatedParameter(
        name=name,
        symbol=str(one["symbol"]),
        unit=str(one["unit"]),
        value=optional("value"),
        stderr=optional("std"),
        free=bool(one["free"]),
        identifiable=bool(one["identifiable"]),
        lower_bound=optional("lower_bound"),
        of_joint=bool(one["axis"]) and ".initial_" not in name,
        at_bound=optional("at_bound"),
        lack_of_fit=_finite(one["lack_of_fit"]),
        axis=str(one["axis"]),
    )


def _verdict(one: dict[str, Any]) -> Verdict:
    reasons = (Message(Reason(of["code"]), str(of["words"]), dict(of["values"])) for of in one["reasons"])
    return Verdict(Subject(one["subject"]), Status(one["status"]), tuple(reasons))


def _finite(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError
    return float(value)
