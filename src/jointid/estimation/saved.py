"""The estimate of a joint or a robot back from its JSON: the file has the numbers, the model the equations.

Of a robot the names and sums of the parameters are computed anew from its geometry, and must be those of the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from typing import Any, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import finite, optional_number
from jointid.common.errors import RecordError
from jointid.common.messages import Message
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.registry import METHODS, method_of
from jointid.estimation.problems.base import DELAY, LOG_DELAY, log_delay
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Checks, Data, EstimatedParameter, Fit, Params, Settings
from jointid.estimation.result.robot import IdentifiedRobot, SpringVerdict
from jointid.estimation.robots.drive_side import of_record
from jointid.estimation.robots.idim import InverseModelRobot, friction_formulas
from jointid.estimation.robots.numbers import RobotParameters, add_delays, apply_constraints, robot_parameters
from jointid.estimation.robots.simulated import SimulatedRobot, at_estimate
from jointid.estimation.unknown_timing import read_timing
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.disturbances import effect_parameters
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.base_parameters import BaseParameters, base_parameters
from jointid.models.robots.friction_terms import friction_terms
from jointid.models.robots.names import name_of
from jointid.models.robots.robot import Robot
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.verdict import Reason, Status, Subject, Verdict

RobotSystem = Robot | RobotLoop | RobotDriveSide
System = Joint | ClosedLoop | DriveSide | RobotSystem

_DIGITS = 2e-3  # of the numbers in a sum, which has four
_CODES: dict[str, StrEnum] = {str(code): code for code in Reason}  # of others, as of faults, the text is enough
_TERM = re.compile(r"(?:^|([+-]) )(\S+)(?: \* ([0-9.e+-]+))?")  # sign, symbol and weight in a sum


def build_estimate(
    answer: dict[str, Any], system: RobotSystem | Joint, loop: ClosedLoop | None = None, **settings: Any
) -> Estimate:
    """Return the estimate of a document.

    Args:
        answer: the document.
        system: the joint, or the robot; under its controllers for an estimate by didim.
        loop: of a joint, used where its method simulates one.
        settings: of a joint, what `Settings` has beside its model and method.

    Raises:
        RecordError: the robot is another one, has no controllers where they are needed, or a value is refused.
        KeyError, TypeError, ValueError: the document is damaged.
    """
    method, number = answer["method"], finite
    if method not in tuple(METHODS):
        raise ValueError
    rows = tuple(_row(name, one) for name, one in answer["parameters"].items())
    robot, part, left, positions = None, None, dict[str, float](), {"": answer.get("position_rms")}
    if isinstance(system, Joint):
        alone: Joint | Robot = system
        own = {p.name for p in (*system.parameters, *effect_parameters(settings["effects"]))}
        rows = tuple(replace(row, of_joint=row.name in own) for row in rows)
        if loop is not None:  # with the numbers of the controller that were identified beside the joint
            freed = {row.name: row.value for row in rows if row.free and row.value is not None}
            names = freed.keys() & numbers_of(loop.controller).keys()
            loop = replace(loop, controller=with_numbers(loop.controller, {name: freed[name] for name in names}))
    else:
        alone = robot = system if isinstance(system, Robot) else system.robot
        if (stated := list(answer["robot"]["joints"])) != list(robot.names):
            raise RecordError(
                f"it is of the joints {', '.join(map(str, stated))}, and this robot has {', '.join(robot.names)}"
            )
        if refused := [row.name for row in rows if row.value is None]:
            raise RecordError(
                f"it refuses {', '.join(refused)}, so it predicts no torque; identify these joints as rigid"
            )
        kept, sums = _compute_sums(answer, system, robot, rows)
        _require_same({name: str(one["formula"]) for name, one in answer["parameters"].items()}, sums)
        answer = _reorder(answer, list(sums))  # of an older file, which has the rotors behind their links
        rows = tuple(_row(name, one) for name, one in answer["parameters"].items())
        part = _part(answer, system, kept, rows)
        left = dict(zip(robot.names, map(_size, answer["robot"]["left"]), strict=True))
        positions = answer["robot"].get("position_rms", {})
        if not {*positions} <= {*robot.names}:
            raise ValueError
    free, given = tuple(map(str, answer.get("free") or ())), answer["filtering"]
    if robot is not None and free != tuple(row.name for row in rows if row.free):
        raise ValueError
    named = ("position_cutoff", "cutoff", "decimation", "timing", "aliasing")
    filtering = Filtering(borders=tuple(given["borders"]), **{name: given[name] for name in named})
    record, each = answer["record"], answer.get("records") or ()
    empty = np.zeros((0,) if robot is None else (0, len(robot)))
    found = Estimate(
        params=Params(
            rows, free, _correlation(answer, len(free)), str(answer.get("intervals")),
            tuple(tuple(_row(name, one) for name, one in of["parameters"].items()) for of in each),
        ),
        fit=Fit(
            measured=empty,
            predicted=empty,
            borders=filtering.borders,
            relative_error=_share(answer["relative_error_percent"]),
            filtered_error=_share(answer["filtered_error_percent"]),
            rows=int(answer.get("rows") or 0),
            simulations=int(answer.get("simulations") or 0),
            stop=str(answer.get("stop")),
            converged=_flag(answer["converged"]),
            axis_errors=left,
            position_rms={str(name): _size(rms) for name, rms in positions.items() if rms is not None},
        ),
        checks=Checks(
            verdicts=tuple(map(_verdict, answer["verdicts"])),
            warnings=tuple(map(str, answer["warnings"])),
        ),
        data=Data(
            record=str(record["name"]),
            channels=tuple(map(str, answer.get("channels") or ())),
            sample_time=number(record["sample_time"]),
            torque_unit=str(record["torque_unit"]),
            fingerprint=str(record["torque_sha256"] or ""),
            logs=tuple(str(one) for one in record.get("logs_sha256") or [of["torque_sha256"] for of in each]),
        ),
        settings=Settings(
            method, str(answer["variant"]), alone, loop if method_of(method).needs_controller else None, filtering,
            delay=number(answer.get("delay", 0.0)), timing=read_timing(answer), **settings,
        ),
        robot=part,
    )  # fmt: skip
    found.summary(details=True)  # what cannot be described is damaged
    return found


def _part(
    answer: dict[str, Any],
    system: RobotSystem,
    own: BaseParameters | RobotParameters,
    rows: Sequence[EstimatedParameter],
) -> IdentifiedRobot:
    """Return the robot-only content."""
    names, said = tuple(row.name for row in rows), answer["robot"]
    one = answer["parameters"]
    formulas = tuple(str(one[name]["formula"]) for name in names)
    std = np.array([0.0 if row.stderr is None else row.stderr for row in rows])
    correlation, free = np.eye(len(rows)), [i for i, row in enumerate(rows) if row.free]
    if (found := _correlation(answer, len(free))).size:
        correlation[np.ix_(free, free)] = found
    common: dict[str, Any] = {
        "names": names,
        "values": np.array([row.value for row in rows], dtype=np.float64),
        "covariance": Covariance(std, correlation, 0),
        "nominal": np.array([finite(one[name]["nominal"]) for name in names]),
        "nominal_errors": np.array([np.inf if e is None else finite(e) for e in said["nominal_left"]]),
        "formulas": formulas,
        "springs": tuple(SpringVerdict(**spring) for spring in said.get("springs", ())),
    }
    robot = system if isinstance(system, Robot) else system.robot
    if isinstance(own, BaseParameters):
        return InverseModelRobot(setup=system if isinstance(system, RobotLoop) else robot, base=own, **common)
    under = isinstance(system, RobotLoop) and answer["method"] == "didim"
    setup = at_estimate(system, own, common["values"]) if under else RobotDriveSide(robot)  # type: ignore[arg-type]
    return SimulatedRobot(setup=setup, parameters=own, **common)


def _compute_sums(
    answer: dict[str, Any], system: RobotSystem, robot: Robot, rows: Sequence[EstimatedParameter]
) -> tuple[BaseParameters | RobotParameters, dict[str, str]]:
    """Return the parameters of the robot, and their sums as text by name."""
    if answer["method"] == "idim":
        base = base_parameters(robot)
        names = (*base.names, *(term.name(robot) for term in friction_terms(robot)))
        return base, dict(zip(names, (*base.formulas, *friction_formulas(robot, base)), strict=True))
    if answer["method"] == "didim" and not isinstance(system, RobotLoop):
        raise RecordError("it was identified under controllers, and this robot has none; add the [controller] tables")
    found = _parameters(robot, rows, answer["robot"], finite(answer["record"]["sample_time"]))
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
    delay = said.get("log_delay")
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
    if stated.keys() != sums.keys():
        other = ", ".join(sorted(stated.keys() ^ sums.keys()))
        raise RecordError(f"its parameters are not those of this robot, which differ in {other}; identify again")
    for name, formula in sums.items():
        there, here = (_weights(text) for text in (stated[name], formula))
        if there.keys() != here.keys() or not np.allclose([there[one] for one in here], [*here.values()], rtol=_DIGITS):
            raise RecordError(f"there {name} is {stated[name]}, and of this robot {formula}; identify again")


def _weights(formula: str) -> dict[str, float]:
    """Return the weights of a sum by symbol."""
    return {symbol: float(f"{sign}{weight or 1}") for sign, symbol, weight in _TERM.findall(formula)}


def _reorder(answer: dict[str, Any], names: list[str]) -> dict[str, Any]:
    """Return the document with its parameters in the order of these names."""
    free = [*map(str, answer.get("free") or ())]
    order = sorted(range(len(free)), key=lambda i: names.index(free[i]))
    changed: dict[str, Any] = {"free": [free[i] for i in order]}
    if (found := _correlation(answer, len(free))).size:
        changed["correlation"] = found[np.ix_(order, order)].tolist()
    return answer | {"parameters": {name: answer["parameters"][name] for name in names}} | changed


def _correlation(answer: dict[str, Any], size: int) -> FloatArray:
    """Return the correlation of the free parameters, or of the joint's alone; empty where it is not known."""
    if not (stated := answer.get("correlation")):
        return np.zeros((0, 0))
    found: FloatArray = np.array(stated, dtype=np.float64)
    whole = size if answer.get("model") == "robot" else len(found)
    if found.shape != (whole, whole) or not np.all(np.abs(found) < 1.01):  # nor where one is NaN
        raise ValueError
    return found


def _share(percent: object) -> float:
    """Return an error as a share; null stands for one that is not finite."""
    return math.inf if percent is None else _size(percent) / 100


def _size(value: object) -> float:
    if (found := finite(value)) < 0.0:
        raise ValueError
    return found


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def _row(name: str, one: dict[str, Any]) -> EstimatedParameter:
    def optional(key: str) -> float | None:
        return optional_number(one.get(key))

    return EstimatedParameter(
        name=name,
        symbol=str(one["symbol"]),
        unit=str(one["unit"]),
        value=optional_number(one["value"]),
        stderr=None if one.get("std") is None else _size(one["std"]),
        free=bool(one.get("free", True)),
        identifiable=bool(one.get("identifiable", True)),
        lower_bound=optional("lower_bound"),
        of_joint=bool(one.get("axis")) and ".initial_" not in name and not name.endswith(f".{DELAY}"),
        at_bound=optional("at_bound"),
        lack_of_fit=optional("lack_of_fit") or 0.0,
        axis=str(one.get("axis", "")),
    )


def _verdict(one: dict[str, Any]) -> Verdict:
    reasons = (
        Message(_CODES.get(str(of["code"]), cast("StrEnum", str(of["code"]))), str(of["words"]), dict(of["values"]))
        for of in one["reasons"]
    )
    return Verdict(Subject(one["subject"]), Status(one["status"]), tuple(reasons))
