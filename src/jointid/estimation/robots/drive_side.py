"""The drive side of a robot: its flexible joints from motor torques and motor positions, whatever its controllers are.

The motors' positions are filtered and prescribed, the links simulated on their springs, and the torques that this takes
compared with those that were logged (`simulation.drive_side`), through one window and one filter. The positions'
own filter goes over the torques and over the direction of friction, too: of random robots, logged at 500 Hz, it left
twice the noise otherwise. Where a motor rests or turns round its row is left out, as in IDIM. The search is that of the
closed loop (`robots.didim`), started from a robot of rigid joints, which here is a regression on the measured motion.

Beside the robot's parameters two of the record are searched: by how much the log shows the torques late, one number for
all joints, which else would be taken for the springs' damping; and where motors move at the first sample the links'
position and velocity there, beside those of steady motion.

Noise of the positions is not modelled: what the filter leaves of it pulls the values, as in IDIM by least squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.base import log_delay as delay_of_log
from jointid.estimation.problems.inverse_model import MeasuredMotion, moving_weights
from jointid.estimation.robots.didim import SLOW, require_springs, search_springs
from jointid.estimation.robots.fit import Descents, RobotFit
from jointid.estimation.robots.numbers import RobotParameters, apply_constraints, robot_parameters
from jointid.estimation.robots.problem import RobotProblem, add_problems
from jointid.estimation.robots.regression import Records, each_log, motion_of_robot
from jointid.models.robots.names import symbol_of
from jointid.models.robots.robot import Robot, Tree
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, lowpass, window_parts
from jointid.simulation.drive_side import (
    PARTS_OF_ROBOT,
    DriveSideRun,
    PrescribedMotion,
    differentiate_drive_side,
    moves_links,
    prescribe,
    run_drive_side,
)
from jointid.simulation.robot_numbers import Bools, NumberOf, NumberPlace, RobotNumbers, with_values
from jointid.simulation.simulate import Outcome

_BEGINNINGS = 3  # steps to where the links are at the first sample, which the torques depend on nearly in a line
_MOVES = 0.05  # of the samples: a motor that moves less determines nothing
_STILL = 20  # samples in a row, from the first on: a motor that rests there
_SMEAR = 1.0  # periods of the position filter, which rings about a reversal, and no more at the same instant in both
_BEGINNING = 4.0  # s of a record, along which the search begins
_SHORTER = 0.7  # of a record: a beginning that saves time
_DELAY = NumberPlace(NumberOf.LOG, 0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class RobotDriveSideProblem(RobotProblem[DriveSideRun]):
    """The torques of a robot's records along its motors' own motion.

    Attributes:
        motion: as it was measured. prescribed: the motors' motion.
        thorough: whether the start of a search takes the whole record, too.
    """

    motion: MeasuredMotion
    prescribed: PrescribedMotion
    thorough: bool = False

    def roughly(self) -> Self:
        """Return the problem of the record's beginning, up to its share of each motor's acceleration, squared.

        Less does to find springs: of six joints and 45 s at 1 kHz a search took seven times as long along the whole.
        """
        samples = len(self.motion.a)
        least = math.ceil(_BEGINNING / self.sample_time)
        if self.thorough or least >= samples:
            return self
        moved = np.cumsum(np.square(self.motion.a), axis=0)
        size = max(least, 1 + int(np.max(np.argmax(moved >= least / samples * moved[-1], axis=0))))
        if size > _SHORTER * samples:
            return self
        return replace(
            self,
            measured=self.measured[:size],
            motion=self.motion.begin(size),
            prescribed=self.prescribed.begin((size - 1) * PARTS_OF_ROBOT),
            thorough=True,
        )

    @property
    def tree(self) -> Tree:
        """Of the links."""
        assert self.prescribed.tree is not None
        return self.prescribed.tree

    @property
    def motion_measured(self) -> bool:
        """Whether the motors move as measured: they do."""
        return True

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.motion.sample_time

    @property
    def poses(self) -> FloatArray:
        """The motors' positions, (samples, n)."""
        return self.prescribed.position[::PARTS_OF_ROBOT]

    def simulate(self, numbers: RobotNumbers, *, keep: bool = True) -> DriveSideRun:
        """Simulate a robot; its tape is kept anyway."""
        del keep
        return run_drive_side(self.prescribed, numbers)

    def predict(self, run: DriveSideRun) -> FloatArray:
        """Return the torque of a run as the log shows it, (samples, n)."""
        return self.show_in_log(run, run.torque)

    def run_of(self, numbers: RobotNumbers, *, keep: bool = True) -> DriveSideRun | None:
        """Simulate a robot with these numbers; None if it cannot be simulated.

        Where its links are at the first sample is of the record: it is fitted, of any robot alike.
        """
        del keep
        places = tuple(place for place in self.parameters.places if place.of is NumberOf.BESIDE)
        numbers = replace(numbers, beside=self.parameters.base.beside)
        run = self.simulate(numbers)
        if run.outcome is not Outcome.FINISHED:
            return None
        error = self.error(run)
        weights = self.weights(error.size)
        for _ in range(_BEGINNINGS if places else 0):
            J = self._moved_by(run, places) * weights[:, np.newaxis]
            norms = column_norms(J)
            step = np.linalg.lstsq(J / norms, error * weights, rcond=None)[0] / norms
            for share in (1.0, 0.3, 0.1):
                there = np.array([place.read(run.numbers) for place in places]) + share * step
                tried = self.simulate(with_values(run.numbers, places, there))
                left = self.error(tried) if tried.outcome is Outcome.FINISHED else None
                if left is not None and np.linalg.norm(left * weights) < np.linalg.norm(error * weights):
                    break
            else:
                break
            run, error = tried, left
        return run

    def slopes(self, run: DriveSideRun, x: FloatArray) -> FloatArray:
        """Return the derivatives of a run's filtered torques by what is searched, (rows, free), not weighted."""
        places, columns = self.parameters.places, self.regressor(run)
        moving = [c for c, place in enumerate(places) if moves_links(place, run.numbers)]
        if moving:
            columns[:, moving] += self.in_blocks(partial(self._moved_by, run), [places[c] for c in moving])
        if _DELAY in places:
            columns[:, places.index(_DELAY)] = self.decimate(self.show_in_log(run, run.torque, 1) / self.sample_time)
        return self.by_search_variables(columns, x)

    def _moved_by(self, run: DriveSideRun, places: tuple[NumberPlace, ...]) -> FloatArray:
        """Return the derivatives of the filtered torques by numbers that move the links, (rows, places)."""
        moved = differentiate_drive_side(run, places)
        return self.decimate_each([self.show_in_log(run, moved[:, j]) for j in range(moved.shape[1])])

    def regressor(self, run: DriveSideRun) -> FloatArray:
        """Return the columns of the motors' equations on the run's motion, filtered, (rows, free), not weighted."""
        parts = run.columns(self.parameters.places)
        return self.decimate_columns([(own, self.show_in_log(run, columns)) for own, columns in parts])

    def decimate_each(self, each: Sequence[FloatArray]) -> FloatArray:
        """Return signals of each joint, (samples,) or (samples, columns), filtered, one after the other, 0 at rest."""
        rows = [self.decimate_joint(j, one.reshape(len(one), -1)) for j, one in enumerate(each)]
        return np.concatenate([row[:, 0] if one.ndim == 1 else row for row, one in zip(rows, each, strict=True)])

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Return columns of one joint, (samples, columns), filtered, (rows, columns), 0 at rest."""
        return self.motion.decimate_joint(joint, columns)

    def show_in_log(self, run: DriveSideRun, parts: FloatArray, order: int = 0) -> FloatArray:
        """Return means over the parts, (parts, columns), through the torques' window, as late as the log shows them."""
        late = float(run.numbers.log[0, 0]) / self.sample_time if run.numbers.log.size else 0.0
        return window_parts(parts, PARTS_OF_ROBOT, late, order, curved=True)


def drive_side_problem(
    robot: Robot,
    records: Sequence[Record],
    parameters: RobotParameters,
    filtering: Filtering | None = None,
    delay: float | None = 0.0,
    *,
    stated: bool = True,
) -> RobotDriveSideProblem:
    """Return the problem of reproducing the torques of a robot's records along its motors' motion.

    Args:
        robot: that moves.
        records: of each joint, with torque and motor position behind the gear, on one clock.
        parameters: of the robot.
        filtering: of positions and torques.
        delay: s, by which the log shows the torques late; None to search it.
        stated: whether the torques' timing is, which a known delay counts from; see `log_delay`.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: a motor hardly moves, a torque is 0 throughout, the delay is none, or the log's timing is not used.
    """
    if filtering is not None and filtering.timing == "as_sampled":
        raise MethodError(
            'filtering.timing is "as_sampled"; on the drive side of a robot when a torque acts matters: leave it out.'
        )
    if records[-1].payload:
        raise MethodError(
            "A payload of a record is taken by IDIM and DIDIM; received one on the drive side: leave it out."
        )
    model = "flexible" if any(robot.flexible) else "rigid"
    motion = motion_of_robot(robot, records, filtering or Filtering(), "The drive side of a robot", model, _SMEAR)
    still = [name for name, share in zip(robot.names, np.mean(motion.moving, axis=0), strict=True) if share < _MOVES]
    if still:
        raise MethodError(
            f"The motor of {', '.join(still)} rests, or turns round, nearly all the time; expected a motion of every "
            "motor: move it, or leave its joint out of the model."
        )
    most = delay_of_log(None, motion.sample_time).upper
    if delay is not None and not abs(delay) <= most:
        raise MethodError(
            f"log_delay is {delay:g} s; expected at most {most:g} s either way, twenty samples: give it in s, or leave "
            "it out to have it identified."
        )
    resting = np.array([moving_weights(each, _STILL, 0)[0] == 0.0 for each in (motion.v @ robot.coupling.T).T])
    prescribed = prescribe(motion.q @ robot.coupling.T, motion.sample_time, PARTS_OF_ROBOT, robot.tree, resting)
    # What the filter takes from the motion it is to take from the torques, too, and from friction's own.
    cutoff, parts = motion.filtering.position_cutoff, prescribed.direction
    assert cutoff is not None
    motion = replace(motion, torque=lowpass(motion.torque, cutoff, motion.sample_time))
    prescribed = replace(prescribed, direction=lowpass(parts, cutoff, prescribed.step))
    sigma = np.std(motion.torque, axis=0) + 1e-300
    parameters = of_record(parameters, robot, resting, delay_of_log(delay, motion.sample_time, stated=stated))
    return RobotDriveSideProblem(motion.torque, motion.filtering, parameters, sigma, motion, prescribed)


def of_record(parameters: RobotParameters, robot: Robot, resting: Bools, delay: Parameter) -> RobotParameters:
    """Return parameters with those of the record: the log's delay, and the links' first state where motors move."""
    n = len(robot)
    more = [(delay, _DELAY)] if delay.free else []
    for j in np.flatnonzero(np.array(robot.flexible) & ~resting):
        for column, (word, quantity) in enumerate((("position", Quantity.POSITION), ("velocity", Quantity.VELOCITY))):
            name = f"{robot.joints[j].name}.initial_link_{word}"
            more.append(
                (
                    Parameter(name, symbol_of(f"initial_link_{word}", int(j)), quantity),
                    NumberPlace(NumberOf.BESIDE, int(j), column),
                )
            )
    log = np.array([[delay.start]])
    base = replace(parameters.base, beside=np.zeros((n, 2)), log=log)
    return replace(parameters.add(*more), base=base)


def _require_one_beginning(robot: Robot, parts: Sequence[RobotDriveSideProblem]) -> None:
    """Require that several logs begin at rest: the links' first state is one for all of them.

    Raises:
        MethodError: a motor of a flexible joint moves at the first sample of one of several logs.
    """
    for count, part in enumerate(parts if len(parts) > 1 else (), start=1):
        moving = {robot.joints[place.row].name for place in part.parameters.places if place.of is NumberOf.BESIDE}
        if moving:
            raise MethodError(
                f"The motor of {', '.join(sorted(moving))} moves at the first sample of log {count}; expected that "
                "each of several logs begins at rest: cut it by record.start, or identify it alone."
            )


def identify_flexible_drive_side(
    robot: Robot,
    records: Records,
    filtering: Filtering | None = None,
    *,
    frequencies: Mapping[str, float] | None = None,
    offsets: bool = True,
    evaluations: int = 60,
    delay: float | None = None,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = lambda _: None,
) -> RobotFit:
    """Identify a robot, of which some joints are flexible, from motor torques and positions; references are not read.

    Args:
        robot: whose joints with a spring are flexible. Of its numbers only the links' places and gravity are read.
        records: one for each joint, with torque and motor position behind the gear, of one log, or those of several;
            to show a spring the motion must excite its mode, as a multisine on top of it does.
        filtering: of positions and torques; the torques' cut-off above the modes, the positions' five times that.
        frequencies: Hz, see `DIDIM`.
        offsets: whether each motor has a constant torque that is identified, too.
        evaluations: simulations with derivatives, at most, of each search.
        delay: s, by which the log shows torques later than positions; None to identify it.
        known: values and bounds to keep, by name; see `apply_constraints`.
        progress: receives the steps.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: as of `search_robot`, or one of several logs begins in motion.
    """
    instead = 'identify the robot by "didim"'
    robot.require_linear("The drive side of a robot takes", instead, springs=True)
    stiff, known = robot.rigid, known or {}
    parameters = apply_constraints(robot_parameters(robot, offsets=offsets, logarithmic=True, whole=False), known)
    logs = each_log(records)
    stated = all(record.torque.stated for log in logs for record in log if record.torque is not None)
    parts = [drive_side_problem(robot, log, parameters, filtering, delay, stated=stated) for log in logs]
    _require_one_beginning(robot, parts)
    problem = add_problems(parts)
    require_springs(robot, frequencies, problem.sample_time)
    of_stiff = apply_constraints(robot_parameters(stiff, offsets=offsets, whole=False), known)
    slow_parts = [drive_side_problem(stiff, log, of_stiff, SLOW) for log in logs]
    # To leave rows out is to multiply by what switches, and that brings the modes, which this robot has not, down to
    # what is slow: of a twin of six joints it left 23 % of a joint's torque, and 4 % with the rows.
    slow = add_problems(
        [replace(one, motion=replace(one.motion, moving=np.ones_like(one.motion.moving))) for one in slow_parts]
    )
    rigid = Descents(evaluations, progress).settle(slow, np.zeros(len(slow.free)))

    def search(problem: RobotProblem[Any]) -> RobotFit:
        return search_springs(problem, robot, rigid, frequencies, evaluations, progress)

    found = search(problem)
    if any(one.shown for one in found.springs) or all(one.roughly() is one for one in parts):
        return found
    progress("no spring is seen by the beginning of the record; searching along all of it")
    return search(add_problems([replace(one, thorough=True) for one in parts]))
