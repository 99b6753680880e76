"""The problem of a robot: its parameters in, the filtered errors of all joints' torques and their derivatives out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parallel import in_threads, threads
from jointid.common.parameters import Parameter
from jointid.estimation.problems.inverse_model import join_rows
from jointid.estimation.robots.numbers import RobotParameters
from jointid.estimation.robots.regression import require_one_log, require_torques
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.dynamics import IntArray
from jointid.models.robots.robot import Tree
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimate_all, drop_ends, noise_limit_of_computed
from jointid.simulation.controller_torque import SeenPosition, seen_position
from jointid.simulation.derivatives import differentiate
from jointid.simulation.drive_side import DriveSideRun
from jointid.simulation.loop_input import LoopInput, RobotLoop, prepare
from jointid.simulation.robot_numbers import NumberPlace, RobotNumbers
from jointid.simulation.simulate import COARSE, FINE, Outcome, Run, motion_at, run_loop


@dataclass(frozen=True, slots=True, eq=False)
class RobotRuns:
    """One candidate's runs along several logs.

    Attributes:
        each: run of each log.
    """

    each: tuple[Run | DriveSideRun, ...]

    @property
    def numbers(self) -> RobotNumbers:
        """Numbers of the candidate."""
        numbers: RobotNumbers = self.each[0].numbers
        return numbers

    @property
    def outcome(self) -> Outcome:
        """Outcome of the first unfinished run; FINISHED without any."""
        failed = (run.outcome for run in self.each if run.outcome is not Outcome.FINISHED)
        return next(failed, Outcome.FINISHED)


AnyRun = TypeVar("AnyRun", Run, DriveSideRun, RobotRuns)
"""Of one candidate, by whatever simulates it."""

_FEWEST = 16  # parameters whose derivatives are worth a thread
EXACT = 1e-6  # of the torques: an error that the simulation itself may have
_FAILED = 1e3  # times the measured torques: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RobotProblem(ABC, Generic[AnyRun]):
    """The torques of a robot's records against a simulation of it.

    Rows are those of one joint after the other, which share their instants, each divided by the joint's `sigma`.

    Attributes:
        measured: (samples, n) torques.
        filtering: resolved.
        parameters: what is identified.
        sigma: (n,) of the joints' errors, by which they are weighted.
    """

    measured: FloatArray
    filtering: Filtering
    parameters: RobotParameters
    sigma: FloatArray

    @property
    @abstractmethod
    def tree(self) -> Tree:
        """Of the links, as kernels read it."""

    @property
    @abstractmethod
    def sample_time(self) -> float:
        """Of the log, s."""

    @property
    @abstractmethod
    def poses(self) -> FloatArray:
        """Approximate positions of the shafts, (samples, n)."""

    @property
    def motion_measured(self) -> bool:
        """True if the motors move as measured; a force in the loop then biases least squares."""
        return False

    @property
    def integrates(self) -> bool:
        """True if torques are computed under an integral, whose content hides a constant torque."""
        return False

    @abstractmethod
    def simulate(self, numbers: RobotNumbers, *, keep: bool = True) -> AnyRun:
        """Simulate a robot, and keep what its derivatives need."""

    @abstractmethod
    def predict(self, run: AnyRun) -> FloatArray:
        """Return the torque of a run as the log shows it, (samples, n)."""

    def error(self, run: AnyRun) -> FloatArray:
        """Return the filtered error of a run, measured less predicted, (rows,), not weighted."""
        return self.decimate(self.measured - self.predict(run))

    @abstractmethod
    def slopes(self, run: AnyRun, x: FloatArray) -> FloatArray:
        """Return the derivatives of a run's filtered torques by what is searched, (rows, free), not weighted."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters, with bounds of what is searched."""
        return self.parameters.parameters

    def roughly(self) -> Self:
        """Return the problem with longer integration steps, for the start of a search."""
        return self

    def with_sigma(self, sigma: FloatArray) -> Self:
        """Return the problem with other standard deviations of the joints' errors."""
        return replace(self, sigma=sigma)

    def reweight(self, left: FloatArray, count: int, floor: float | None = None) -> Self:
        """Return the problem weighted by the residual, (rows,), of a fit of `count` parameters."""
        rows = self.by_joint(left)
        degrees = max(rows.size - count, 1) / rows.size
        least = (self.floor if floor is None else floor) / math.sqrt(rows.shape[1])
        return self.with_sigma(np.maximum(np.sqrt(np.mean(rows**2, axis=1) / degrees), least))

    def run(self, x: FloatArray, *, keep: bool = True) -> AnyRun:
        """Simulate a candidate."""
        return self.simulate(self.parameters.numbers(self.parameters.values(x)), keep=keep)

    def run_of(self, numbers: RobotNumbers, *, keep: bool = True) -> AnyRun | None:
        """Simulate a robot with these numbers; None if it cannot be simulated."""
        run = self.simulate(numbers, keep=keep)
        return run if run.outcome is Outcome.FINISHED else None

    def error_of(self, numbers: RobotNumbers) -> FloatArray | None:
        """Return the filtered error of a robot with these numbers, (rows,); None if it cannot be simulated."""
        run = self.run_of(numbers, keep=False)
        return None if run is None else self.error(run)

    def decimate_each(self, each: Sequence[FloatArray]) -> FloatArray:
        """Return signals of each joint, (samples,) or (samples, columns), filtered, one after the other."""
        rows = in_threads(lambda one: decimate_all([one], self.filtering, self.sample_time)[0], each)
        return np.concatenate([self.drop_ends(one, len(each[0])) for one in rows])

    def decimate(self, signals: FloatArray) -> FloatArray:
        """Return signals, (samples, n), filtered, one joint after the other, (rows,), not weighted."""
        return self.decimate_each(list(signals.T))

    def decimate_columns(self, parts: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
        """Return the columns of each joint, as `columns_of` gives them, filtered, (rows, parameters), not weighted."""
        count = len(self.parameters.places)

        def filter_joint(j: int) -> FloatArray:
            own, columns = parts[j]
            seen = self.decimate_joint(j, columns)
            rows = np.zeros((len(seen), count))
            rows[:, own] = seen
            return rows

        return np.concatenate(in_threads(filter_joint, range(len(parts))))

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Return columns of one joint, (samples, columns), filtered, (rows, columns)."""
        del joint
        return self.drop_ends(decimate_all([columns], self.filtering, self.sample_time)[0], len(columns))

    def drop_ends(self, rows: FloatArray, samples: int) -> FloatArray:
        """Return the filtered rows of a joint, without the ends of a computed torque."""
        del samples
        return rows

    def by_joint(self, rows: FloatArray) -> FloatArray:
        """Return rows as (n, instants)."""
        return rows.reshape(self.sigma.size, -1)

    def norms(self, rows: FloatArray) -> FloatArray:
        """Return the norms of the joints' rows, (n,)."""
        return np.asarray(np.linalg.norm(self.by_joint(rows), axis=1))

    @property
    def filtered_torque(self) -> FloatArray:
        """Measured torques, filtered, (rows,)."""
        return self.decimate(self.measured)

    @property
    def sizes(self) -> FloatArray:
        """Norms of the joints' filtered torques, (n,)."""
        return self.norms(self.filtered_torque)

    @property
    def size(self) -> float:
        """Norm of the weighted torques."""
        seen = self.filtered_torque
        return float(np.linalg.norm(seen * self.weights(seen.size)))

    @property
    def floor(self) -> float:
        """Norm of an error that the simulation itself may have: no joint's is taken for smaller."""
        return EXACT * float(np.max(self.sizes))

    def weights(self, rows: int) -> FloatArray:
        """Return one over the size of each row's error, (rows,)."""
        return np.repeat(1.0 / self.sigma, rows // self.sigma.size)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,); large where the candidate cannot be simulated."""
        run = self.run(x, keep=False)
        if run.outcome is not Outcome.FINISHED:
            return self._failure_residual()
        error = self.error(run)
        return np.asarray(error * self.weights(error.size))

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free); 0 of what cannot be simulated."""
        run = self.run(x)
        if run.outcome is not Outcome.FINISHED:
            error = self._failure_residual()
            return error, np.zeros((error.size, x.size))
        error = self.error(run)
        weights = self.weights(error.size)
        return error * weights, -self.slopes(run, x) * weights[:, np.newaxis]

    def _failure_residual(self) -> FloatArray:
        seen = self.filtered_torque
        return _FAILED * seen * self.weights(seen.size)

    @staticmethod
    def in_blocks(of: Callable[[tuple[NumberPlace, ...]], FloatArray], places: Sequence[NumberPlace]) -> FloatArray:
        """Return columns of parameters, (rows, parameters), some at a time in threads."""
        share = max(math.ceil(len(places) / threads()), _FEWEST)
        return np.column_stack(in_threads(of, [tuple(places[i : i + share]) for i in range(0, len(places), share)]))

    def by_search_variables(self, columns: FloatArray, x: FloatArray) -> FloatArray:
        """Convert derivatives by the parameters, (rows, free), to those by the search variables."""
        return np.asarray(columns * np.where(self.parameters.logarithmic, self.parameters.values(x), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class RobotLoopProblem(RobotProblem[Run]):
    """The torques of a robot's records against its loops, simulated from their references.

    Attributes:
        experiment: what the loops are driven with.
        stride: rad of the fastest motion in one step of the integrator.
        seen: of each joint, what takes a motor position to a torque that was computed; None where it was logged. The
            derivatives are those of the controller's output, the same but for what a faster controller sees between.
    """

    experiment: LoopInput
    stride: float = FINE
    seen: tuple[SeenPosition | None, ...] = ()

    @property
    def tree(self) -> Tree:
        """Of the links."""
        assert self.experiment.tree is not None
        return self.experiment.tree

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.experiment.clock.sample_time

    @property
    def poses(self) -> FloatArray:
        """The references, (samples, n)."""
        return self.experiment.references

    @property
    def integrates(self) -> bool:
        """Whether a controller of computed torques has an integral."""
        return any(seen is not None and seen.axis.law.integrates for seen in self.seen)

    def simulate(self, numbers: RobotNumbers, *, keep: bool = True) -> Run:
        """Simulate a robot."""
        return run_loop(self.experiment, numbers, keep=keep or any(self.seen), stride=self.stride)

    def roughly(self) -> Self:
        """Return the problem simulated in steps twice as long."""
        return replace(self, stride=COARSE)

    def drop_ends(self, rows: FloatArray, samples: int) -> FloatArray:
        """Return filtered rows of a joint, without the ends if a torque of the log is computed from positions."""
        return drop_ends(rows, self.filtering, samples) if any(self.seen) else rows

    def predict(self, run: Run) -> FloatArray:
        """Return the torque of a run as the log shows it, or as it is computed from its positions, (samples, n)."""
        torque = run.torque
        if any(self.seen) and run.outcome is Outcome.FINISHED:
            position = motion_at(run, run.experiment.clock.log_index).position[:, run.numbers.rotors]
            for j, seen in enumerate(self.seen):
                if seen is not None:
                    torque[:, j] = seen.torque(position[:, j])[: len(torque)]
        return torque

    def slopes(self, run: Run, x: FloatArray) -> FloatArray:
        """Return the derivatives of a run's filtered torques by what is searched, (rows, free), not weighted."""
        return self.by_search_variables(
            self.in_blocks(lambda some: self.decimate_each(differentiate(run, some)[0]), self.parameters.places),
            x,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SumOfRobotProblems(RobotProblem[RobotRuns]):
    """The torques of several logs of one robot, with the same parameters.

    The rows of a joint are those of all logs, so that each joint has one size of its error.

    Attributes:
        parts: problem of each log.
    """

    parts: tuple[RobotProblem[Any], ...]

    @property
    def tree(self) -> Tree:
        """Of the links."""
        return self.parts[0].tree

    @property
    def motion_measured(self) -> bool:
        """Whether the motors move as measured."""
        return self.parts[0].motion_measured

    @property
    def integrates(self) -> bool:
        """Whether torques of a log are computed under an integral."""
        return any(part.integrates for part in self.parts)

    @property
    def sample_time(self) -> float:
        """Of the first log, s."""
        return self.parts[0].sample_time

    @property
    def poses(self) -> FloatArray:
        """Poses of all logs, (samples, n)."""
        return np.vstack([part.poses for part in self.parts])

    def roughly(self) -> Self:
        """Return the problem simulated in longer steps where there is a choice."""
        return replace(self, parts=tuple(part.roughly() for part in self.parts))

    def simulate(self, numbers: RobotNumbers, *, keep: bool = True) -> RobotRuns:
        """Simulate a robot along all logs."""
        return RobotRuns(tuple(part.simulate(numbers, keep=keep) for part in self.parts))

    def predict(self, run: RobotRuns) -> FloatArray:
        """Return the torques of the runs as the logs show them, one after the other, (samples, n)."""
        return np.vstack([part.predict(one) for part, one in zip(self.parts, run.each, strict=True)])

    def error(self, run: RobotRuns) -> FloatArray:
        """Return the filtered error of a run, measured less simulated, (rows,), not weighted."""
        return self._join(part.error(one) for part, one in zip(self.parts, run.each, strict=True))

    def slopes(self, run: RobotRuns, x: FloatArray) -> FloatArray:
        """Return the derivatives of a run's filtered torques by what is searched, (rows, free), not weighted."""
        return self._join(part.slopes(one, x) for part, one in zip(self.parts, run.each, strict=True))

    @property
    def filtered_torque(self) -> FloatArray:
        """Measured torques, filtered, (rows,)."""
        return self._join(part.filtered_torque for part in self.parts)

    def _join(self, each: Iterable[FloatArray]) -> FloatArray:
        return join_rows(list(each), self.sigma.size)


@dataclass(frozen=True, slots=True, eq=False)
class SolvedRobot:
    """The problem of a robot's log with its run at the estimate.

    Attributes:
        problem: that was solved, or is evaluated anew.
        run: at the estimate.
        slopes: (rows, free) of its filtered torques by what is searched, not weighted.
    """

    problem: RobotProblem[Any]
    run: Run | DriveSideRun
    slopes: FloatArray


def add_problems(parts: Sequence[RobotProblem[Any]]) -> RobotProblem[Any]:
    """Return the problem of all logs, with the parameters and the filtering of the first."""
    first = parts[0]
    if len(parts) == 1:
        return first
    measured = np.vstack([part.measured for part in parts])
    sigma = np.std(measured, axis=0) + 1e-300
    return SumOfRobotProblems(measured, first.filtering, first.parameters, sigma, tuple(parts))


def robot_problem(
    loop: RobotLoop, records: Sequence[Record], parameters: RobotParameters, filtering: Filtering | None = None
) -> RobotLoopProblem:
    """Return the problem of reproducing the torques of a robot's records by simulating its loops.

    Raises:
        RecordError: a record lacks a channel that is needed.
        MethodError: see `prepare`; or the filtering is impossible.
    """
    require_one_log(records)
    for record in records:
        record.require(("torque",), "DIDIM of a robot")
    experiment = prepare(loop, records)
    samples = experiment.clock.samples
    measured = np.column_stack([r.torque.values[:samples] for r in records if r.torque is not None])
    axes = zip(records, loop.robot.links, loop.controllers, strict=True)
    seen = tuple(seen_position(record, ClosedLoop(RigidJoint(link.kind), law)) for record, link, law in axes)
    for j, (one, record) in enumerate(zip(seen, records, strict=True)):
        if one is not None and record.motor_position is not None:
            measured[:, j] = one.torque(record.motor_position.values)[:samples]
    require_torques(loop.robot, measured.T)
    model = "flexible" if any(loop.robot.flexible) else "rigid"
    sample_time = experiment.clock.sample_time
    resolved = (filtering or Filtering()).resolve(sample_time, model, noise_limit_of_computed(records, sample_time))
    return RobotLoopProblem(measured, resolved, parameters, np.std(measured, axis=0) + 1e-300, experiment, seen=seen)
