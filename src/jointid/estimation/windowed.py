"""The models of windows: a joint or a robot that is simulated, and the inverse model of either.

Each takes the rows of a window from the code that takes those of a whole record: the loop of a joint
(`problems.closed_loop`), the inverse model of a joint (`problems.inverse_model`), that of a robot
(`robots.regression`), and a robot that is simulated (`robots.simulated`), whose window begins in motion. What all
windows say is told as of the window that the search began with (`WindowModel.tell`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity, adjust_parameters
from jointid.common.text import join
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    REST,
    inverse_of_joint,
    read_as,
)
from jointid.estimation.problems.log_windows import (
    NotSimulatedError,
    Seen,
    WindowModel,
    commanded,
    is_braked,
    moves,
    ringing,
)
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Params, Settings
from jointid.estimation.robots.problem import RobotProblem
from jointid.estimation.robots.regression import inverse_of_robot
from jointid.estimation.robots.simulated import IdentifiedRobot, nominal_numbers, problem_of
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimated_at, drop_ends
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.controller_torque import seen_position
from jointid.simulation.loop_input import prepare
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance

if TYPE_CHECKING:
    from jointid.estimation.identify_log import Solved

_FORGOTTEN = 0.01  # of how far a beginning is off: what is left of it is forgotten
_TOLD = 1e-4  # of the torque: less is never told
_COMPARED = 16  # windows at least in which the nominal robot is compared, where there are as many


def _tell(window: Estimate, names: Sequence[str], values: FloatArray, solved: Solved, **parts: Any) -> Estimate:
    """Return the fit of a window with the values of all; what a bound held in the window may be free in all."""
    found = {name: (float(x), float(std)) for name, x, std in zip(names, values, solved.covariance.std, strict=True)}
    rows = tuple(
        replace(
            row, value=found[row.name][0], stderr=found[row.name][1], free=True,
            at_bound=found[row.name][0] if row.name in solved.held else None,
        )
        if row.name in found and row.value is not None
        else row
        for row in window.params.rows
        if row.name in found or row.of_joint
    )  # fmt: skip
    params = Params(rows, tuple(names), solved.covariance.correlation)
    return replace(window, params=params, settings=_in_windows(window.settings), **parts)


def _in_windows(settings: Settings) -> Settings:
    return replace(settings, variant=f"{settings.variant}, in windows")


# A joint that is simulated


@dataclass(frozen=True, slots=True, eq=False)
class LoopWindow:
    """The loop of a joint that is simulated, as it is compared with one window.

    Attributes:
        problem: of the window that is started from; those of all others are like it.
    """

    problem: ClosedLoopProblem
    motion_measured: bool = False

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return self.problem.free

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a window; see `WindowModel`."""
        (record,) = records
        if not moves(record):
            return None
        problem = begin_window(self.problem, record)
        response, columns = problem.sensitivities(x)
        if response.outcome is not Outcome.FINISHED:
            raise NotSimulatedError.of(record, f"{response.outcome.value}")
        experiment = problem.experiment
        position = experiment.inputs[experiment.log_index // experiment.lengths.size, REFERENCE]
        return Seen(
            problem.error(response)[np.newaxis],
            -problem.filter(columns)[np.newaxis],
            problem.filter(problem.measured)[np.newaxis],
            problem.kept,
            problem.measured.size,
            problem.filtering.decimation or 1,
            [(position, np.gradient(position, experiment.sample_time))],
            response.at_limit,
        )

    def settling(self, records: Sequence[Record], x: FloatArray) -> int:
        """Return how many samples a window takes to forget how it began, and its filter what lies beside it.

        A beginning that is off by the window's whole torque and speed, as no window's is, must show in no later sample
        of the torque by more than a hundredth.
        """
        problem = self.problem
        other = begin_window(problem, records[0], disturbed=1.0)
        apart = np.abs(problem.torque(x) - other.torque(x)) > _FORGOTTEN * float(np.std(problem.measured))
        remembers = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
        return remembers + ringing(problem.filtering, problem.sample_time)

    def tell(self, window: Estimate, solved: Solved) -> Estimate:
        """Return the fit of all windows; see `WindowModel`."""
        loop = self.problem.loop_at(solved.x[solved.problem.members[0].at])
        delay = loop.controller.law(self.problem.sample_time).delay
        window = replace(window, settings=replace(window.settings, loop=loop, delay=delay))
        if solved.together is not None:  # their table is that of several records
            return replace(window, settings=_in_windows(window.settings))
        return _tell(window, [p.name for p in self.free], solved.x, solved)


def begin_window(like: ClosedLoopProblem, record: Record, disturbed: float = 0.0) -> ClosedLoopProblem:
    """Return the problem of a window that is like another one's, with its own state at the first sample.

    Args:
        like: the problem of another window.
        record: the window.
        disturbed: by how much its beginning is to be wrong, as a share of the window's torque and speed.
    """
    assert record.torque is not None
    experiment = prepare(like.loop, record)
    problem = replace(like, measured=record.torque.values[: experiment.samples], experiment=experiment, seen=None)
    # What an integral holds is one constant along the log, and no window's own.
    seen = None if experiment.law.integrates else seen_position(record, like.loop)
    torque = float(problem.filter(problem.measured)[0])  # a single sample has all of the noise
    inputs, period = experiment.inputs, experiment.law.period
    velocity = float(inputs[1, REFERENCE] - inputs[0, REFERENCE]) / period
    torque += disturbed * float(np.std(problem.measured))
    velocity += disturbed * float(np.std(np.diff(inputs[:, REFERENCE]))) / period
    position = beginning_position(replace(problem, measured=np.full(1, torque)), velocity)
    if seen is not None and record.motor_position is not None:
        problem = replace(problem, seen=seen, measured=seen.torque(record.motor_position.values)[: experiment.samples])
    return problem.keeping({"initial_position": position, "initial_velocity": velocity, "initial_torque": torque})


# The inverse model of a joint or a robot


@dataclass(frozen=True, slots=True, eq=False)
class InverseWindow:
    """The inverse model of a joint or a robot, as it is compared with one window.

    Attributes:
        free: the parameters that are identified. places: of them among the columns.
        kept: (parameters,) values of the fixed ones, 0 for the free.
        regress: from the records of a window to their torque, as its error, and columns.
        speeds: (equations,) rms of the window that is started from.
        ringing: samples that its filters ring.
    """

    free: tuple[Parameter, ...]
    places: Sequence[int]
    kept: FloatArray
    regress: Callable[[Sequence[Record]], Seen]
    speeds: FloatArray
    ringing: int
    motion_measured: bool = True

    @classmethod
    def of(
        cls,
        parameters: Sequence[Parameter],
        regress: Callable[[Sequence[Record]], Seen],
        records: Sequence[Record],
        ringing: int,
    ) -> InverseWindow:
        """Return the model with the columns of these parameters, from the window that is started from."""
        free = [i for i, p in enumerate(parameters) if p.free]
        kept = np.array([0.0 if p.free else p.start or 0.0 for p in parameters])
        return cls(tuple(parameters[i] for i in free), free, kept, regress, _speeds_of(regress(records)), ringing)

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a window; see `WindowModel`. One slower than rest is of rest."""
        if not any(map(moves, records)) or is_braked(records):
            return None
        found = self.regress(records)
        if np.all(_speeds_of(found) < REST * self.speeds):
            return None
        W = found.J[..., list(self.places)]
        return replace(found, error=found.error - found.J @ self.kept - W @ x, J=-W)

    def settling(self, records: Sequence[Record], x: FloatArray) -> int:
        """Return how many samples its filters ring."""
        del records, x
        return self.ringing

    def tell(self, window: Estimate, solved: Solved) -> Estimate:
        """Return the fit of all windows; see `WindowModel`."""
        return _tell(window, [p.name for p in self.free], solved.x, solved, robot=self._robot(window, solved))

    def _robot(self, window: Estimate, solved: Solved) -> IdentifiedRobot | None:
        if window.robot is None:
            return None
        part, values, places = window.robot, self.kept.copy(), np.array(self.places)
        values[places] = solved.x
        # The model's own masses, with the friction that fits best beside them.
        step, sums = part.nominal[places] - solved.x, solved.found.sums
        masses = part.parameters.inertial[places]
        friction = ~masses
        target = sums.b[friction] + sums.A[np.ix_(friction, masses)] @ step[masses]
        step[friction] = -np.linalg.lstsq(sums.A[np.ix_(friction, friction)], target, rcond=None)[0]
        nominal = values.copy()
        nominal[places] += step
        std, correlation = np.zeros(values.size), np.eye(values.size)
        std[places], correlation[np.ix_(places, places)] = solved.covariance.std, solved.covariance.correlation
        return replace(
            part,
            values=values,
            covariance=Covariance(std, correlation),
            nominal=nominal,
            nominal_errors=_errors_of(solved, solved.x + step),
        )


def _speeds_of(found: Seen) -> FloatArray:
    """Return the rms speed of each equation's motion, (equations,)."""
    return np.array([np.sqrt(np.mean(velocity**2)) for _, velocity in found.motion])


# A robot that is simulated


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobotWindow:
    """A robot that is simulated, as it is compared with one window.

    Attributes:
        setup: the robot under its controllers, or along its motors' motion.
        part: what a window by itself told, with its parameters.
        filtering: resolved.
    """

    setup: RobotLoop | RobotDriveSide
    part: IdentifiedRobot
    filtering: Filtering

    @property
    def motion_measured(self) -> bool:
        """Whether it is simulated along the motors' motion."""
        return isinstance(self.setup, RobotDriveSide)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters, with bounds of what is searched."""
        return self.part.parameters.parameters

    def look(self, records: Sequence[Record], x: FloatArray) -> Seen | None:
        """Return the rows of a window; see `WindowModel`."""
        if not any(map(moves, records)) or is_braked(records):
            return None
        parameters, setup = self.part.parameters, self.setup
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
        poses = [one.values[:samples] for one in map(commanded, records) if one is not None]
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
        of_whole, of_later = np.intersect1d(whole.at - first, later.at, return_indices=True)[1:]
        apart = np.abs(whole.error[:, of_whole] - later.error[:, of_later])
        least = _TOLD * np.sqrt(np.mean(whole.measured**2, axis=1, keepdims=True))
        far = apart > np.maximum(_FORGOTTEN * np.max(apart, axis=1, keepdims=True), least)
        # What lies beside a window's end rings as long as what lies beside its beginning.
        rows = np.flatnonzero(np.any(far[:, later.at[of_later] < later.samples // 2], axis=0))
        return int(later.at[of_later][rows[-1]]) + later.keep if rows.size else later.keep

    def tell(self, window: Estimate, solved: Solved) -> Estimate:
        """Return the fit of all windows; see `WindowModel`."""
        part, parameters, size = self.part, self.part.parameters, solved.x.size
        values, covariance = parameters.values(solved.x), solved.covariance
        covariance = replace(covariance, std=covariance.std * np.where(parameters.logarithmic, values, 1.0))
        nominal = parameters.group(nominal_numbers(part.model, parameters.numbers(values)))
        nominal = np.where(parameters.of_robot, nominal, values)  # what is of the record is as it was found
        part = replace(
            part,
            setup=self.setup,
            values=np.concatenate([values, part.values[size:]]),
            covariance=covariance.append_constants(part.values.size - size),
            nominal_errors=_errors_of(solved, parameters.to_search_variables(nominal)),
        )
        return _tell(window, parameters.names, values, replace(solved, covariance=covariance), robot=part)


def _errors_of(solved: Solved, x: FloatArray) -> FloatArray:
    """Return the share of each joint's torque that other values leave in some windows, (n,)."""
    try:
        for every in (max(solved.found.count // _COMPARED, 1), 1):  # where all that are taken rest, all
            if (found := solved.problem.pass_over(x, every)).count:
                return found.relative_errors()
    except NotSimulatedError:
        pass
    return np.full(solved.problem.sigma.shape[1], np.inf)


# How a window is taken for all of them


def require_windows(model: object, method: Method | None, free: Sequence[str] = ()) -> None:
    """Refuse what is not identified in windows.

    Args:
        model: of a joint or a robot.
        method: of one window.
        free: what is free around several records.

    Raises:
        MethodError: all rows are needed at once, or the time from the first sample.
    """
    robot = isinstance(model, Robot | RobotLoop | RobotDriveSide)
    if isinstance(method, IDIM) or (method is None and isinstance(model, Joint | Robot)):
        estimator = method.estimator if isinstance(method, IDIM) else None
        if estimator not in (None, "weighted" if robot else "ols"):
            raise MethodError(f"IDIM by {estimator} needs all rows at once; identify a part of the record.")
        return
    if not (robot or (isinstance(model, ClosedLoop) and isinstance(method, DIDIM | None))):
        raise MethodError(
            f"Windows identify a joint by DIDIM or IDIM; received {type(model).__name__}: leave windows out."
        )
    if isinstance(model, ClosedLoop) and model.joint.friction.follows_time:
        raise MethodError(
            f"{model.joint.friction.name.capitalize()} friction changes with the time from the first sample, and "
            'each window would begin it anew; identify the record whole, or with friction = "symmetric", whose '
            "windows show the drift."
        )
    if together := (*free, *(method.free if robot and isinstance(method, DIDIM) else ())):
        raise MethodError(
            f"{join(together)} of several records or of a robot is identified from all rows at once; choose a part of "
            "the record by start and stop, or leave it out."
        )


def pose(
    model: object, records: Sequence[Record], fit: Estimate, known: Mapping[str, Parameter]
) -> tuple[WindowModel, FloatArray]:
    """Return the model of all windows, and where its search starts.

    Args:
        model: of the joint or robot.
        records: of a window.
        fit: of that.
        known: changes to the parameters.
    """
    if fit.problem is not None:
        window = begin_window(fit.problem, records[0])
        start = {row.name: row.value for row in fit.params.rows if row.value is not None}
        return LoopWindow(window), window.vector(start)
    part, settings = fit.robot, fit.settings
    if part is not None and settings.method != "idim":
        assert isinstance(model, RobotLoop | RobotDriveSide)
        x = part.parameters.to_search_variables(part.values[: len(part.parameters.places)])
        return SimulatedRobotWindow(model, part, settings.filtering), x
    found = {row.name: row for row in fit.params.rows}
    if part is not None:
        wanted = [
            replace(known.get(name) or Parameter(name, row.symbol, Quantity.RATIO), start=row.value, free=row.free)
            # What a bound held in a window may be off it in all of them.
            if row.free or name not in known
            else known[name]
            for name, row in found.items()
        ]
        inverse = inverse_of_robot(part.model, part.parameters)
    else:
        joint = model if isinstance(model, Joint) else getattr(model, "joint", None)
        assert isinstance(joint, Joint)
        zeros = ENCODER_OFFSET.name in found
        wanted = [*adjust_parameters(joint.parameters, known), *([ENCODER_OFFSET] if zeros else [])]
        inverse = inverse_of_joint(joint, settings.delay, zeros=zeros)

    def regress(records: Sequence[Record]) -> Seen:
        motion = inverse.measure(read_as(records, settings.timing), settings.filtering)
        rows, keep = inverse.rows([motion]), motion.filtering.decimation
        assert keep is not None
        Y, poses = rows.by_equation(rows.Y), list(zip(motion.q.T, motion.v.T, strict=True))
        return Seen(Y, rows.W.reshape(*Y.shape, -1), Y, motion.rows_at(), len(motion.q), keep, poses)

    rings = ringing(settings.filtering, fit.data.sample_time)
    whole = InverseWindow.of(wanted, regress, records, rings)
    return whole, np.array([found[p.name].value for p in whole.free], dtype=np.float64)
