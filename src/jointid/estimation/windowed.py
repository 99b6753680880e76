"""Windows of inverse models and robots; those of DIDIM of a joint are in `identify_log`.

Each takes the rows of a window from the code that takes those of a whole record: the inverse model of a joint
(`methods.idim`), that of a robot (`robots.regression`), and a robot that is simulated (`robots.simulated`), whose
window begins in motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter, Quantity, adjust_parameters
from jointid.estimation.identify_log import LoopWindows, Solved, Windowed
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.inverse_model import motion_of
from jointid.estimation.problems.log_windows import (
    InverseWindow,
    NotSimulatedError,
    Regression,
    Seen,
    Weighted,
    WindowModel,
    commanded,
    is_braked,
    moves,
    ringing,
    speeds_of,
)
from jointid.estimation.result.assemble import FitResult
from jointid.estimation.result.robot import IdentifiedRobot
from jointid.estimation.robots.idim import InverseModelRobot, drives, identify_robot
from jointid.estimation.robots.problem import RobotProblem
from jointid.estimation.robots.regression import base_rows, motion_of_robot
from jointid.estimation.robots.simulated import (
    SimulatedRobot,
    identify_simulated_robot,
    nominal_numbers,
    problem_of,
)
from jointid.models.disturbances import Effect, effect_parameters
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimated_at, drop_ends
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop, RobotOutcome
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.verdict import Subject, axes_verdict, bounds_verdict, friction_verdict, solver_verdict

_COMPARED = 16  # windows at least in which the nominal robot is compared, where there are as many


def _require_sums(method: IDIM, estimators: Sequence[str | None]) -> None:
    """Refuse what needs all rows at once.

    Raises:
        MethodError: the estimator weighs single rows or simulates instruments, or there are effects.
    """
    if method.estimator not in estimators:
        raise MethodError(f"IDIM by {method.estimator} needs all rows at once; identify a part of the record.")
    if method.effects:
        raise MethodError("IDIM with effects needs all rows at once; identify a part of the record.")


@dataclass(frozen=True, slots=True, eq=False)
class InverseJoint:
    """IDIM of a joint in windows.

    Attributes:
        joint: that moves. loop: around it, where it is known.
        method: by which a window is identified. filtering: as declared. changes: to the parameters.
    """

    joint: Joint
    loop: ClosedLoop | None
    method: IDIM
    filtering: Filtering
    changes: Mapping[str, Parameter]
    loops: Sequence[ClosedLoop] = ()
    weighted: Weighted = "none"

    def __post_init__(self) -> None:
        of_joint = (None, "ols") if self.joint.model == "flexible" else (None, "ols", "weighted")
        _require_sums(self.method, of_joint)

    def fit(self, records: Sequence[Record], progress: Progress) -> FitResult:
        """Return the fit of a window."""
        model = self.loop or self.joint
        return identify_record(
            records[0], model, self.method, filtering=self.filtering, parameters=self.changes, progress=progress
        )

    def pose(self, records: Sequence[Record], fit: FitResult) -> tuple[WindowModel, FloatArray]:
        """Return the inverse model, and the values of a window."""
        effects, found = fit.settings.effects, {row.name: row for row in fit.params.rows}
        wanted = (*adjust_parameters(self.joint.parameters, self.changes), *effect_parameters(effects))
        kept = np.array([0.0 if p.free else p.start or 0.0 for p in wanted])
        free = [i for i, p in enumerate(wanted) if p.free]
        regress = partial(_regress_joint, self.joint, fit.settings.delay, fit.settings.filtering, effects)
        rings = ringing(fit.settings.filtering, fit.data.sample_time)
        model = InverseWindow(tuple(wanted[i] for i in free), free, kept, regress, speeds_of(regress(records)), rings)
        return model, np.array([found[wanted[i].name].value for i in free], dtype=np.float64)

    def answer(self, solved: Solved) -> FitResult:
        """Return parameters and settings."""
        fit, model = solved.starts[0].fit, solved.starts[0].model
        names = tuple(p.name for p in model.free)
        # What a bound held in a window may be off it in all of them.
        rows = tuple(replace(row, free=row.name in names) for row in fit.params.rows)
        fit = replace(fit, params=replace(fit.params, rows=rows, names=names))
        made = _with_values(fit, solved, solved.x, solved.covariance)
        values = {row.name: row.value or 0.0 for row in made.params.rows}
        verdicts = (solver_verdict(solved.stop, solved.converged), bounds_verdict(solved.held))
        others = (one for one in fit.checks.verdicts if one.subject is Subject.STIFFNESS)
        return replace(
            made,
            checks=replace(made.checks, verdicts=(*verdicts, *others)),
            at_bounds={name: values[name] for name in solved.held},
        )


def _regress_joint(
    joint: Joint, delay: float, filtering: Filtering, effects: Sequence[Effect], records: Sequence[Record]
) -> Regression:
    """Return the regression of a window; effects are those of a whole record, without its time."""
    (record,) = records
    assert record.torque is not None and filtering.decimation is not None
    model, sample_time = motion_of(record, delay, filtering, joint, effects), record.torque.sample_time
    equations, samples, parameters = model.columns.shape
    Y, W = model.decimate(filtering, sample_time, np.zeros(parameters))
    sides = [model.motor, *([] if model.load is None else [model.load])]
    return Regression(
        Y.reshape(equations, -1),
        W.reshape(equations, -1, parameters),
        model.rows_at(filtering, sample_time),
        samples,
        filtering.decimation,
        [(side.position, side.velocity) for side in sides],
    )


@dataclass(frozen=True, slots=True, eq=False)
class InverseRobot:
    """IDIM of a robot in windows.

    Attributes:
        model: robot, or robot and controllers, which are not read. method: by which a window is identified.
        filtering: as declared. known: of friction, by name.
    """

    model: Robot | RobotLoop
    method: IDIM
    filtering: Filtering
    known: Mapping[str, Parameter]
    loops: Sequence[ClosedLoop] = ()
    weighted: Weighted = "equations"

    def __post_init__(self) -> None:
        _require_sums(self.method, (None, "weighted"))

    def fit(self, records: Sequence[Record], progress: Progress) -> FitResult:
        """Return the fit of a window."""
        del progress
        return identify_robot(self.model, records, self.method, filtering=self.filtering, known=self.known)

    def pose(self, records: Sequence[Record], fit: FitResult) -> tuple[WindowModel, FloatArray]:
        """Return the inverse model, and the values of a window."""
        part = fit.robot
        assert isinstance(part, InverseModelRobot)
        fixed = {row.name: row.value or 0.0 for row in fit.params.rows if not row.free and row.name not in self.known}
        fixed |= {name: one.start for name, one in self.known.items() if not one.free and one.start is not None}
        free = [i for i, name in enumerate(part.names) if name not in fixed]
        kept = np.array([fixed.get(name, 0.0) for name in part.names])
        rows = fit.params.rows
        parameters = tuple(
            self.known.get(part.names[i]) or Parameter(part.names[i], rows[i].symbol, Quantity.RATIO) for i in free
        )
        regress = partial(_regress_robot, part, fit.settings.filtering)
        rings = ringing(fit.settings.filtering, fit.data.sample_time)
        return InverseWindow(parameters, free, kept, regress, speeds_of(regress(records)), rings), part.values[free]

    def answer(self, solved: Solved) -> FitResult:
        """Return parameters, robot and settings."""
        fit, model = solved.starts[0].fit, solved.starts[0].model
        part = fit.robot
        assert isinstance(part, InverseModelRobot) and isinstance(model, InverseWindow)
        values, places = model.kept.copy(), np.array(model.places)
        values[places] = solved.x
        # The model's own masses, with the friction that fits best beside them.
        step, sums = part.nominal[places] - solved.x, solved.found.sums
        friction, masses = places >= len(part.base), places < len(part.base)
        target = sums.b[friction] + sums.A[np.ix_(friction, masses)] @ step[masses]
        step[friction] = -np.linalg.lstsq(sums.A[np.ix_(friction, friction)], target, rcond=None)[0]
        nominal = values.copy()
        nominal[places] += step
        part = replace(
            part,
            values=values,
            covariance=_spread(solved.covariance, model.places, values.size),
            nominal=nominal,
            nominal_errors=_errors_of(solved, solved.x + step),
        )
        negative = [name for k, name in enumerate(part.model.names) if drives(part, k)]
        # What a bound held in a window may be off it in all of them.
        rows = tuple(replace(row, free=i in model.places) for i, row in enumerate(fit.params.rows))
        fit = replace(fit, params=replace(fit.params, rows=rows, names=tuple(p.name for p in model.free)))
        return _with_robot(fit, solved, part, negative)


def _regress_robot(part: InverseModelRobot, filtering: Filtering, records: Sequence[Record]) -> Regression:
    """Return the regression of a window."""
    robot = part.model
    motion = motion_of_robot(robot, records, filtering)
    rows, n = base_rows(robot, part.base, motion), len(robot)
    W, samples = rows.W.reshape(n, -1, rows.W.shape[1]), len(motion.q)
    assert filtering.decimation is not None
    at = decimated_at(W.shape[1], motion.inside.stop, filtering)
    axes = list(zip(motion.q.T, motion.v.T, strict=True))
    return Regression(rows.by_equation(rows.Y), W, at, samples, filtering.decimation, axes)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobotWindow:
    """A robot that is simulated, as it is compared with one window.

    Attributes:
        part: what a window by itself told, with its parameters.
        filtering: resolved.
        motion_measured: whether it is simulated along the motors' motion.
    """

    part: SimulatedRobot
    filtering: Filtering
    motion_measured: bool

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters, with bounds of what is searched."""
        return self.part.parameters.parameters

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a window; see `WindowModel`."""
        if not any(map(moves, records)) or is_braked(records):
            return None
        parameters, setup = self.part.parameters, self.part.setup
        if isinstance(setup, RobotLoop):
            setup = replace(setup, in_motion=True)
        problem: RobotProblem[Any] = replace(
            problem_of(setup, records, parameters, self.filtering), parameters=parameters
        )
        run = problem.run(x)
        if run.outcome is not RobotOutcome.FINISHED:
            raise NotSimulatedError.of(records[0], f"{run.outcome.value}")
        error = problem.by_joint(problem.error(run))
        samples, keep = len(problem.measured), self.filtering.decimation
        assert keep is not None
        at = decimated_at(-(-samples // keep), samples, self.filtering)
        if error.shape[1] < at.size:  # the torque is computed from positions
            at = drop_ends(at, self.filtering, samples)
        asked = [commanded(record) for record in records]
        poses = [one.values[:samples] for one in asked if one is not None]
        return Seen(
            error,
            -problem.slopes(run, x).reshape(*error.shape, -1),
            problem.by_joint(problem.filtered_torque),
            at,
            samples,
            keep,
            [(pose, np.gradient(pose, problem.sample_time)) for pose in poses],
        )


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobots:
    """DIDIM or the drive side of a robot in windows.

    Attributes:
        model: under its controllers, or along its motors' motion. method: by which a window is identified.
        filtering: as declared. known: values and bounds, by name.
    """

    model: RobotLoop | RobotDriveSide
    method: DIDIM | DriveSideFit | None
    filtering: Filtering
    known: Mapping[str, Parameter]
    weighted: Weighted = "equations"

    @property
    def loops(self) -> Sequence[ClosedLoop]:
        """Of the joints."""
        return self.model.loops if isinstance(self.model, RobotLoop) else ()

    def fit(self, records: Sequence[Record], progress: Progress) -> FitResult:
        """Return the fit of a window; the first of all begins as the model says, any other in motion."""
        model = self.model
        if isinstance(model, RobotLoop) and records[0].begin > 0:
            model = replace(model, in_motion=True)
        return identify_simulated_robot(
            model,
            records,
            self.method,
            filtering=self.filtering,
            known=self.known,
            progress=progress,
        )

    def pose(self, records: Sequence[Record], fit: FitResult) -> tuple[WindowModel, FloatArray]:
        """Return the simulation, and the values of a window."""
        part = fit.robot
        assert isinstance(part, SimulatedRobot)
        x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
        along = isinstance(self.model, RobotDriveSide)
        return SimulatedRobotWindow(part, fit.settings.filtering, along), x

    def answer(self, solved: Solved) -> FitResult:
        """Return parameters, robot and settings."""
        fit = solved.starts[0].fit
        part = fit.robot
        assert isinstance(part, SimulatedRobot)
        parameters, size = part.parameters, solved.x.size
        values, covariance = parameters.values(solved.x), solved.covariance
        of_values = np.where(parameters.logarithmic, values, 1.0)
        nominal = parameters.group(nominal_numbers(part.model, parameters.numbers(values)))
        nominal = np.where(parameters.of_robot, nominal, values)  # what is of the record is as it was found
        covariance = replace(covariance, std=covariance.std * of_values)
        part = replace(
            part,
            setup=self.model,
            values=np.concatenate([values, part.values[size:]]),
            covariance=covariance.append_constants(part.values.size - size),
            nominal_errors=_errors_of(solved, parameters.to_search_variables(nominal)),
        )
        return _with_robot(fit, solved, part)


def joint_in_windows(
    model: object, method: Method | None, filtering: Filtering | None, changes: Mapping[str, Parameter] | None
) -> Windowed:
    """Return the windows of a joint's record.

    Raises:
        MethodError: it is not identified in windows.
    """
    by_idim = isinstance(method, IDIM) or (method is None and isinstance(model, Joint))
    if by_idim and isinstance(model, ClosedLoop | Joint):
        joint, loop = (model.joint, model) if isinstance(model, ClosedLoop) else (model, None)
        return InverseJoint(
            joint, loop, method if isinstance(method, IDIM) else IDIM(), filtering or Filtering(), changes or {}
        )
    if not isinstance(model, ClosedLoop):
        raise MethodError(
            f"Windows identify a joint by DIDIM or IDIM; received {type(model).__name__}: leave windows out."
        )
    return LoopWindows.of(model, method, filtering, changes)


def robot_in_windows(
    model: Robot | RobotLoop | RobotDriveSide,
    method: Method | None,
    filtering: Filtering,
    known: Mapping[str, Parameter],
) -> Windowed:
    """Return the windows of a robot's log.

    Raises:
        MethodError: it is not identified in windows.
    """
    if isinstance(model, Robot) or isinstance(method, IDIM):
        if isinstance(model, RobotDriveSide) or not isinstance(method, IDIM | None):
            raise MethodError("IDIM is for a Robot; give the method that the model is for.")
        return InverseRobot(model, method or IDIM(), filtering, known)
    if not isinstance(method, DIDIM | DriveSideFit | None):
        raise MethodError(f"{method.title} is not for a robot that is simulated; give DIDIM or DriveSideFit.")
    if isinstance(method, DIDIM) and method.free:
        raise MethodError(
            "DIDIM.free of a robot is not identified in windows; choose a part of the record by start and stop, or "
            "leave it out."
        )
    return SimulatedRobots(model, method, filtering, known)


def _with_robot(fit: FitResult, solved: Solved, part: IdentifiedRobot, negative: Sequence[str] = ()) -> FitResult:
    """Return the fit of a window with what all windows say of the robot."""
    left = dict(zip(part.model.names, map(float, solved.errors), strict=True))
    bounds = friction_verdict(negative) if negative else bounds_verdict(solved.held)
    verdicts = (solver_verdict(solved.stop, solved.converged), axes_verdict(left), bounds)
    others = (one for one in fit.checks.verdicts if one.subject is Subject.STIFFNESS)
    made = _with_values(fit, solved, part.values, part.covariance)
    values = {row.name: row.value or 0.0 for row in made.params.rows}
    return replace(
        made,
        robot=part,
        checks=replace(made.checks, verdicts=(*verdicts, *others)),
        at_bounds={name: values[name] for name in solved.held},
    )


def _errors_of(solved: Solved, x: FloatArray) -> FloatArray:
    """Return the share of each joint's torque that other values leave in some windows, (n,)."""
    try:
        for every in (max(solved.found.count // _COMPARED, 1), 1):  # where all that are taken rest, all
            if (found := solved.problem.pass_over(x, every)).count:
                return found.relative_errors()
    except NotSimulatedError:
        pass
    return np.full(solved.errors.size, np.inf)


def _with_values(fit: FitResult, solved: Solved, values: FloatArray, covariance: Covariance) -> FitResult:
    """Return the fit of a window with the values of all: of the free rows, or of every row."""
    rows = fit.params.rows
    at = range(len(rows)) if len(rows) == values.size else [i for i, row in enumerate(rows) if row.free]
    found = dict(zip(at, zip(values, covariance.std, strict=True), strict=True))
    told = tuple(
        replace(row, value=float(found[i][0]), stderr=float(found[i][1]), at_bound=None)
        if i in found and row.free and row.value is not None
        else row
        for i, row in enumerate(rows)
    )
    free = [i for i, row in enumerate(rows) if row.free]
    some = [list(at).index(i) for i in free]
    correlation = covariance.correlation[np.ix_(some, some)]
    return replace(
        fit,
        params=replace(fit.params, rows=told, correlation=correlation, basis=solved.basis),
        settings=replace(fit.settings, variant=f"{fit.settings.variant}, in windows"),
        at_bounds={},
        before=(),
        after=(),
    )


def _spread(covariance: Covariance, places: Sequence[int], size: int) -> Covariance:
    """Return the covariance of all parameters, 0 for those that are not free."""
    std, correlation = np.zeros(size), np.eye(size)
    std[list(places)] = covariance.std
    correlation[np.ix_(places, places)] = covariance.correlation
    return Covariance(std, correlation, covariance.bandwidth)
