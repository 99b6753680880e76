"""What methods do in windows: DIDIM and the inverse model of a joint, IDIM of a robot, and a robot that is simulated.

Each takes the rows of a window from the code that takes those of a whole record: the loop of a joint
(`problems.closed_loop`), the inverse model of a joint (`problems.inverse_model`), that of a robot
(`robots.regression`), and a robot that is simulated (`robots.simulated`), whose window begins in motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter, Quantity, adjust_parameters
from jointid.common.text import join
from jointid.estimation.identify_log import Solved, Start, Told, Windowed
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM, InverseModelRobot, drives, identify_robot
from jointid.estimation.methods.registry import Method, default_method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.inverse_model import ENCODER_OFFSET, MeasuredMotion, joint_columns, motion_of
from jointid.estimation.problems.log_windows import (
    InverseWindow,
    LoopWindow,
    NotSimulatedError,
    Regression,
    Seen,
    WindowModel,
    commanded,
    is_braked,
    moves,
    ringing,
    speeds_of,
    window_problem,
)
from jointid.estimation.problems.several_records import RecordLayout, RecordsProblem, several
from jointid.estimation.result.build_result import build_params, build_rows, list_loop_channels
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.estimation.result.parts import EstimatedParameter, Params, RecordFit, Settings
from jointid.estimation.robots.problem import RobotProblem
from jointid.estimation.robots.regression import base_columns, motion_of_robot
from jointid.estimation.robots.simulated import (
    SimulatedRobot,
    identify_simulated_robot,
    nominal_numbers,
    problem_of,
)
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import InMemory, cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimated_at, drop_ends
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance

_COMPARED = 16  # windows at least in which the nominal robot is compared, where there are as many
_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_TOLD = 1e-4  # of the torque: less is never told


# DIDIM of a joint


def loop_in_windows(
    loop: ClosedLoop,
    method: Method | None,
    filtering: Filtering,
    changes: Mapping[str, Parameter],
    layout: RecordLayout | None = None,
) -> Windowed:
    """Return the windows of a record under this loop.

    Args:
        loop: joint and controller.
        method: how a window is identified.
        filtering: as declared.
        changes: to the parameters of a window.
        layout: of several records, of which this is one; None of one.

    Raises:
        MethodError: it is not identified in windows.
    """
    chosen = method or default_method(loop)()
    if not isinstance(chosen, DIDIM):
        raise MethodError("A long record is identified by simulating its loop; give the method didim.")
    if loop.joint.friction.follows_time:
        raise MethodError(
            f"{loop.joint.friction.name.capitalize()} friction changes with the time from the first sample, and "
            'each window would begin it anew; identify the record whole, or with friction = "symmetric", whose '
            "windows show the drift."
        )
    free = chosen.free

    def pose(records: Sequence[Record], fit: Estimate) -> tuple[WindowModel, FloatArray]:
        wanted = adjust_parameters(loop.joint.parameters, changes)
        window = window_problem(records[0], loop, filtering, wanted, free)
        return LoopWindow(window), window.vector({p.name: p.value for p in fit.params.rows if p.value is not None})

    def together(starts: Sequence[Start]) -> RecordsProblem:
        assert layout is not None
        return several([_problem(start) for start in starts], layout)

    def answer(solved: Solved) -> Told:
        window, x = _problem(solved.starts[0]), solved.x
        of = partial(build_params, x=x, covariance=solved.covariance, lost=solved.lost, held=solved.held)
        records: tuple[RecordFit, ...] = ()
        if layout is None:
            params = of(window, fixed=False)
        else:
            both = together(solved.starts)
            params = of(both, records=len(solved.starts))
            records = tuple(_tell_record(k, solved, both) for k in range(len(solved.starts)))
        found = window.loop_at(x[solved.problem.members[0].at])
        delay = found.controller.law(window.sample_time).delay
        settings = Settings("didim", "DIDIM in windows", window.joint, found, window.filtering, delay)
        return Told(params, settings, records=records)

    return Windowed(
        _fit_joint(loop, chosen, filtering, changes), pose, answer, filtering, "records", (loop,),
        None if layout is None else together,
    )  # fmt: skip


def records_in_windows(
    layout: RecordLayout, method: Method | None, filtering: Filtering, parameters: Mapping[str, Parameter]
) -> list[Windowed]:
    """Return the windows of each of several records.

    Raises:
        MethodError: they are not identified in windows.
    """
    if layout.free:
        raise MethodError(f"{join(layout.free)} of several records is identified from all rows at once.")
    return [
        loop_in_windows(loop, method, filtering, layout.changes(parameters, k, acting=True), layout)
        for k, loop in enumerate(layout.loops)
    ]


def _fit_joint(
    model: ClosedLoop | Joint, method: Method, filtering: Filtering, changes: Mapping[str, Parameter]
) -> Any:
    """Return how a window of a joint is identified."""
    return lambda records, progress: identify_record(records[0], model, method, filtering, changes, progress)


def _problem(start: Start) -> ClosedLoopProblem:
    return cast("LoopWindow", start.model).problem


def _tell_record(number: int, solved: Solved, both: RecordsProblem) -> RecordFit:
    """Return one of several records."""
    member, problem, layout = solved.problem.members[number], _problem(solved.starts[number]), both.layout
    record = cast("InMemory", member.log[0]).record
    assert record.torque is not None
    names = {p.name for p in problem.joint.parameters}
    square, size, rows = solved.found.sizes[number, 0]
    alone: tuple[EstimatedParameter, ...] = ()
    if solved.segments:
        said = solved.segments[number]
        free = [p for p in both.of_record(number) if p.name in said.values]
        alone = build_rows(free, said.values, said.std, layout.unit, names)
    return RecordFit(
        name=record.name,
        fingerprint=fingerprint(record.torque.values),
        channels=list_loop_channels(problem.loop, record),
        added_inertia=sum(layout.added[number].values()),
        alone=alone,
        level=math.sqrt(square / max(rows, 1)),
        rows=int(rows),
        relative_error=math.nan,
        filtered_error=math.sqrt(square / size) if size > 0 else 0.0,
        alone_error=math.nan,
    )


# IDIM of a joint


def joint_in_windows(
    model: object, method: Method | None, filtering: Filtering, changes: Mapping[str, Parameter]
) -> Windowed:
    """Return the windows of a joint's record.

    Raises:
        MethodError: it is not identified in windows.
    """
    by_idim = isinstance(method, IDIM) or (method is None and isinstance(model, Joint))
    if isinstance(model, ClosedLoop) and not by_idim:
        return loop_in_windows(model, method, filtering, changes)
    if not (by_idim and isinstance(model, ClosedLoop | Joint)):
        raise MethodError(
            f"Windows identify a joint by DIDIM or IDIM; received {type(model).__name__}: leave windows out."
        )
    joint, idim = model if isinstance(model, Joint) else model.joint, method if isinstance(method, IDIM) else IDIM()
    _require_sums(idim, (None, "ols"))

    def pose(records: Sequence[Record], fit: Estimate) -> tuple[WindowModel, FloatArray]:
        found = {row.name: row for row in fit.params.rows}
        zeros = ENCODER_OFFSET.name in found
        wanted = (*adjust_parameters(joint.parameters, changes), *((ENCODER_OFFSET,) if zeros else ()))
        kept = np.array([0.0 if p.free else p.start or 0.0 for p in wanted])
        free = [i for i, p in enumerate(wanted) if p.free]

        def regress(records: Sequence[Record]) -> Regression:
            motion = motion_of(records[0], fit.settings.delay, fit.settings.filtering, joint)
            return _regress(motion, joint_columns(joint, motion.q, motion.v, motion.a, zeros=zeros))

        rings = ringing(fit.settings.filtering, fit.data.sample_time)
        window = InverseWindow(tuple(wanted[i] for i in free), free, kept, regress, speeds_of(regress(records)), rings)
        return window, np.array([found[wanted[i].name].value for i in free], dtype=np.float64)

    def answer(solved: Solved) -> Told:
        fit, names = solved.starts[0].fit, [p.name for p in solved.starts[0].model.free]
        params = _tell(fit.params.rows, names, solved.x, solved.covariance, solved.held)
        return Told(params, _windows_of(fit.settings))

    return Windowed(_fit_joint(model, idim, filtering, changes), pose, answer, filtering)


def _require_sums(method: IDIM, estimators: Sequence[str | None]) -> None:
    """Refuse what needs all rows at once.

    Raises:
        MethodError: the estimator weighs single rows or simulates instruments.
    """
    if method.estimator not in estimators:
        raise MethodError(f"IDIM by {method.estimator} needs all rows at once; identify a part of the record.")


def _regress(motion: MeasuredMotion, columns: FloatArray) -> Regression:
    """Return the regression of a window, from columns of its motion, (samples, n, parameters)."""
    n, filtering = columns.shape[1], motion.filtering
    assert filtering.decimation is not None
    return Regression(
        motion.thinned_torque().reshape(n, -1),
        motion.decimate_columns(columns).reshape(n, -1, columns.shape[2]),
        motion.rows_at(),
        len(motion.q),
        filtering.decimation,
        list(zip(motion.q.T, motion.v.T, strict=True)),
    )


# Robots


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
        return _by_inverse_model(model, method or IDIM(), filtering, known)
    if not isinstance(method, DIDIM | DriveSideFit | None):
        raise MethodError(f"{method.title} is not for a robot that is simulated; give DIDIM or DriveSideFit.")
    if isinstance(method, DIDIM) and method.free:
        raise MethodError(
            "DIDIM.free of a robot is not identified in windows; choose a part of the record by start and stop, or "
            "leave it out."
        )
    return _by_simulation(model, method, filtering, known)


def _by_inverse_model(
    model: Robot | RobotLoop, method: IDIM, filtering: Filtering, known: Mapping[str, Parameter]
) -> Windowed:
    """Return the windows of IDIM of a robot."""
    _require_sums(method, (None, "weighted"))

    def fit_window(records: Sequence[Record], progress: Progress) -> Estimate:
        del progress
        return identify_robot(model, records, method, filtering=filtering, known=known)

    def pose(records: Sequence[Record], fit: Estimate) -> tuple[WindowModel, FloatArray]:
        part = cast("InverseModelRobot", fit.robot)
        # What a bound held in a window may be off it in all of them.
        fixed = {row.name: row.value or 0.0 for row in fit.params.rows if not row.free and row.name not in known}
        fixed |= {name: one.start for name, one in known.items() if not one.free and one.start is not None}
        free = [i for i, name in enumerate(part.names) if name not in fixed]
        kept = np.array([fixed.get(name, 0.0) for name in part.names])
        rows = fit.params.rows
        parameters = tuple(
            known.get(part.names[i]) or Parameter(part.names[i], rows[i].symbol, Quantity.RATIO) for i in free
        )

        def regress(records: Sequence[Record]) -> Regression:
            motion = motion_of_robot(part.model, records, fit.settings.filtering)
            return _regress(motion, base_columns(part.model, part.base, motion.q, motion.v, motion.a))

        rings = ringing(fit.settings.filtering, fit.data.sample_time)
        return InverseWindow(parameters, free, kept, regress, speeds_of(regress(records)), rings), part.values[free]

    def answer(solved: Solved) -> Told:
        fit, window = solved.starts[0].fit, cast("InverseWindow", solved.starts[0].model)
        part = cast("InverseModelRobot", fit.robot)
        values, places = window.kept.copy(), np.array(window.places)
        values[places] = solved.x
        # The model's own masses, with the friction that fits best beside them.
        step, sums = part.nominal[places] - solved.x, solved.found.sums
        friction, masses = places >= len(part.base), places < len(part.base)
        target = sums.b[friction] + sums.A[np.ix_(friction, masses)] @ step[masses]
        step[friction] = -np.linalg.lstsq(sums.A[np.ix_(friction, friction)], target, rcond=None)[0]
        nominal = values.copy()
        nominal[places] += step
        std, correlation = np.zeros(values.size), np.eye(values.size)
        std[places], correlation[np.ix_(places, places)] = solved.covariance.std, solved.covariance.correlation
        part = replace(
            part,
            values=values,
            covariance=Covariance(std, correlation),
            nominal=nominal,
            nominal_errors=_errors_of(solved, solved.x + step),
        )
        negative = [name for k, name in enumerate(part.model.names) if drives(part, k)]
        names = [p.name for p in window.free]
        params = _tell(fit.params.rows, names, solved.x, solved.covariance, solved.held)
        return Told(params, _windows_of(fit.settings), part, negative=negative)

    return Windowed(fit_window, pose, answer, filtering, "equations")


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
    simulates: bool = True

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
        if run.outcome is not Outcome.FINISHED:
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

    def settling(self, records: Sequence[Record], x: FloatArray) -> int:
        """Return the number of samples after which two beginnings agree."""
        whole = self.look(records, x)
        assert whole is not None
        first = whole.samples // (4 * whole.keep) * whole.keep
        later = self.look([cut(record, first, whole.samples) for record in records], x)
        if later is None:
            return first
        both: tuple[NDArray[np.intp], ...] = np.intersect1d(whole.at - first, later.at, return_indices=True)[1:]
        of_whole, of_later = both
        apart = np.abs(whole.error[:, of_whole] - later.error[:, of_later])
        least = _TOLD * np.sqrt(np.mean(whole.measured**2, axis=1, keepdims=True))
        far = apart > np.maximum(_FORGOTTEN * np.max(apart, axis=1, keepdims=True), least)
        # What lies beside a window's end rings as long as what lies beside its beginning.
        rows = np.flatnonzero(np.any(far[:, later.at[of_later] < later.samples // 2], axis=0))
        return int(later.at[of_later][rows[-1]]) + later.keep if rows.size else later.keep


def _by_simulation(
    model: RobotLoop | RobotDriveSide,
    method: DIDIM | DriveSideFit | None,
    filtering: Filtering,
    known: Mapping[str, Parameter],
) -> Windowed:
    """Return the windows of DIDIM or the drive side of a robot."""

    def fit_window(records: Sequence[Record], progress: Progress) -> Estimate:
        under = model  # the first window of all begins as the model says, any other in motion
        if isinstance(under, RobotLoop) and records[0].begin > 0:
            under = replace(under, in_motion=True)
        return identify_simulated_robot(under, records, method, filtering=filtering, known=known, progress=progress)

    def pose(records: Sequence[Record], fit: Estimate) -> tuple[WindowModel, FloatArray]:
        del records
        part = cast("SimulatedRobot", fit.robot)
        x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
        return SimulatedRobotWindow(part, fit.settings.filtering, isinstance(model, RobotDriveSide)), x

    def answer(solved: Solved) -> Told:
        fit = solved.starts[0].fit
        part = cast("SimulatedRobot", fit.robot)
        parameters, size = part.parameters, solved.x.size
        values, covariance = parameters.values(solved.x), solved.covariance
        of_values = np.where(parameters.logarithmic, values, 1.0)
        nominal = parameters.group(nominal_numbers(part.model, parameters.numbers(values)))
        nominal = np.where(parameters.of_robot, nominal, values)  # what is of the record is as it was found
        covariance = replace(covariance, std=covariance.std * of_values)
        part = replace(
            part,
            setup=model,
            values=np.concatenate([values, part.values[size:]]),
            covariance=covariance.append_constants(part.values.size - size),
            nominal_errors=_errors_of(solved, parameters.to_search_variables(nominal)),
        )
        params = _tell(fit.params.rows, parameters.names, values, covariance, solved.held)
        return Told(params, _windows_of(fit.settings), part, by_logarithm=bool(np.any(parameters.logarithmic)))

    loops = model.loops if isinstance(model, RobotLoop) else ()
    return Windowed(fit_window, pose, answer, filtering, "equations", loops)


def _errors_of(solved: Solved, x: FloatArray) -> FloatArray:
    """Return the share of each joint's torque that other values leave in some windows, (n,)."""
    try:
        for every in (max(solved.found.count // _COMPARED, 1), 1):  # where all that are taken rest, all
            if (found := solved.problem.pass_over(x, every)).count:
                return found.relative_errors()
    except NotSimulatedError:
        pass
    return np.full(solved.errors.size, np.inf)


def _tell(
    rows: Sequence[EstimatedParameter],
    names: Sequence[str],
    values: FloatArray,
    covariance: Covariance,
    held: Sequence[str],
) -> Params:
    """Return the table of a window with the values of all; what a bound held in the window may be free in all."""
    found = {name: (float(x), float(s)) for name, x, s in zip(names, values, covariance.std, strict=True)}
    told = tuple(
        replace(
            row, value=found[row.name][0], stderr=found[row.name][1], free=True,
            at_bound=found[row.name][0] if row.name in held else None,
        )
        if row.name in found and row.value is not None
        else row
        for row in rows
    )  # fmt: skip
    return Params(told, tuple(names), covariance.correlation)


def _windows_of(settings: Settings) -> Settings:
    return replace(settings, variant=f"{settings.variant}, in windows")
