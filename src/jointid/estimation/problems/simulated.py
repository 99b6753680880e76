"""Simulated joints and robots: filtered torque errors and their derivatives.

A joint is a robot of one axis without a tree. A log moves the motors in a simulation: by controllers that follow its
references (`LoopLog`), or by the motion that its motors made (`MotionLog`). In the latter the links are simulated on
their springs, and the resulting torques compared with the logged ones (`simulation.drive_side`), through one
window and one filter. The positions' own filter goes over the torques and over the direction of friction, too: on
random robots, logged at 500 Hz, it left twice the noise otherwise. Where a motor rests or reverses its row is left
out, as in IDIM. Noise of the positions is not modelled: the part that passes the filter biases the values, as in IDIM
by least squares.

Several logs share the parameters. The rows of a joint are those of all logs, each weighted by the size of its error
in that log.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Self, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads, threads
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.parameters import (
    INITIAL_STATE,
    INITIAL_TORQUE,
    LOG_DELAY,
    OF_LOG,
    Parameters,
    log_delay,
    of_law,
    surrounding,
)
from jointid.estimation.problems.inverse_model import (
    TOLD,
    MeasuredMotion,
    Records,
    decimate_each,
    each_log,
    join_rows,
    measure_motion,
    moving_weights,
    require_torques,
)
from jointid.models.controllers import REFERENCE, Controller, number, with_numbers
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.base_parameters import symbol_of
from jointid.models.robots.robot import Robot, RobotLoop, Tree
from jointid.records.record import Record
from jointid.records.signals.filtering import (
    Filtering,
    find_noise_limit,
    lowpass,
    window_parts,
)
from jointid.simulation.controller_torque import SeenPosition, seen_position
from jointid.simulation.derivatives import differentiate
from jointid.simulation.drive_side import (
    PARTS_OF_ROBOT,
    DriveSideRun,
    PrescribedMotion,
    differentiate_drive_side,
    moves_links,
    prescribe,
    run_drive_side,
)
from jointid.simulation.loop_input import AxisInput, LoopInput, prepare
from jointid.simulation.plant import LOAD_STATE, Bools, Numbers, Place, names_of
from jointid.simulation.simulate import COARSE, FINE, Outcome, Run, Simulation, motion_at, run_loop
from jointid.simulation.start import INITIAL, Initial
from jointid.solvers.solve import LevenbergMarquardt, solve
from jointid.uncertainty.position_dependent_error import Cells, cells

_LATE = Place(0, LOG_DELAY.name)
_ROOM = Room()

Runs: TypeAlias = tuple[Any, ...]
"""Runs of one candidate along several logs, each a `Run` or a `DriveSideRun`."""


def outcome_of(runs: Runs) -> Outcome:
    """Return the outcome of the first unfinished run; FINISHED without any."""
    return next((run.outcome for run in runs if run.outcome is not Outcome.FINISHED), Outcome.FINISHED)


# What moves the motors


@dataclass(frozen=True, slots=True, eq=False)
class LoopLog:
    """A log of motors under their controllers, which follow its references.

    Attributes:
        measured: (samples, n) torques.
        filtering: resolved.
        experiment: inputs of the loops.
        stride: rad of the fastest motion in one step of the integrator.
        seen: of each joint, the map from motor position to computed torque; None for a logged torque. Its derivatives
            are those of the controller's output, except between samples of a faster controller.
        counts: (samples,) 0 at excluded samples, which are simulated too, else 1.
        ends: samples at either end in which there are no rows.
    """

    measured: FloatArray
    filtering: Filtering
    experiment: LoopInput
    counts: FloatArray
    stride: float = FINE
    seen: tuple[SeenPosition | None, ...] = ()
    ends: tuple[int, int] = (0, 0)
    motion_measured: ClassVar[bool] = False

    @property
    def tree(self) -> Tree | None:
        """Of the links."""
        return self.experiment.tree

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.experiment.clock.sample_time

    @property
    def poses(self) -> FloatArray:
        """Approximate positions of the shafts, (samples, n): the references."""
        return self.experiment.references[self.experiment.clock.log_index // self.experiment.clock.lengths.size]

    def roughly(self) -> LoopLog:
        """Return the log simulated in steps twice as long."""
        return replace(self, stride=COARSE)

    def under(self, numbers: Numbers) -> LoopInput:
        """Input of a candidate; for a joint, with its controller numbers."""
        if self.tree is not None:
            return self.experiment
        own, law = names_of(numbers.joints[0]), self.experiment.axis.controller
        changed = {name: x for name, x in numbers.values[0].items() if name not in own and of_law(name)}
        changed = {name: x for name, x in changed.items() if x != number(law, name)}
        return _change_law(self.experiment, tuple(changed.items())) if changed else self.experiment

    def run(
        self,
        numbers: Numbers,
        *,
        keep: bool = True,
        room: Room | None = None,
        driven: Callable[[AxisInput], AxisInput] | None = None,
    ) -> Run:
        """Simulate a candidate; `driven` makes of what drives a joint what might."""
        experiment, initial = self.under(numbers), None
        if driven is not None:
            experiment = experiment.alone(driven(experiment.axis))
        if self.tree is None:
            initial = Initial(*(numbers.values[0].get(name) for name in INITIAL))
        return run_loop(experiment, numbers, initial, keep=keep or any(self.seen), stride=self.stride, room=room)

    def predict(self, run: Run) -> FloatArray:
        """Predict the torque as logged, or as computed from positions, (samples, n)."""
        return _show(self._output(run), run.numbers.values[0], self.sample_time)

    def _output(self, run: Run) -> FloatArray:
        torque = run.torque.reshape(len(self.measured), -1)
        if any(self.seen) and run.outcome is Outcome.FINISHED:
            position = motion_at(run, run.experiment.clock.log_index).position[:, run.numbers.motors]
            for j, seen in enumerate(self.seen):
                if seen is not None:
                    torque[:, j] = seen.torque(position[:, j])[: len(torque)]
        return torque

    def columns(self, run: Run, keys: Sequence[Place]) -> list[FloatArray]:
        """Derivatives of each joint's raw predicted torque, (samples, keys)."""
        if self.tree is not None:
            return differentiate(run, keys)[0]
        values, seen = run.numbers.values[0], self.seen[0] if self.seen else None
        own = [key for key in keys if key.name not in OF_LOG]
        (slopes,), moved = differentiate(run, own, positions=seen is not None)
        shown = _show(slopes if seen is None else seen.slopes(moved[:, 0]), values, self.sample_time)
        if len(own) == len(keys):
            return [shown]
        columns, raw = {key.name: column for key, column in zip(own, shown.T, strict=True)}, self._output(run)
        columns["log_gain"] = _show(raw, {**values, "log_gain": 1.0}, self.sample_time)[:, 0]
        columns["log_delay"] = _show(raw, values, self.sample_time, 1)[:, 0]
        return [np.column_stack([columns[key.name] for key in keys])]

    def slopes(self, run: Run, keys: Sequence[Place]) -> FloatArray:
        """Return the derivatives of a run's filtered torques by parameters, (rows, keys)."""
        return _in_blocks(lambda some: decimate_each(self, self.columns(run, some)), keys)

    @property
    def kept(self) -> NDArray[np.intp]:
        """Samples of the rows, (rows,): decimated from the last, without excluded ones."""
        samples, keep = len(self.measured), self.filtering.decimation or 1
        at = np.arange((samples - 1) % keep, samples, keep)
        inside = (at >= self.ends[0]) & (at < samples - self.ends[1])
        if not np.all(self.counts):
            inside &= self.filtering.decimate(self.counts, self.sample_time) > TOLD
        return at[inside]

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Filter one joint's columns, (samples, ...), in the rows of `kept`."""
        del joint
        every = bool(np.all(self.counts))
        rows = self.filtering.decimate(columns if every else (columns.T * self.counts).T, self.sample_time)
        return rows if every and not any(self.ends) else rows[self.kept // (self.filtering.decimation or 1)]


@lru_cache(maxsize=2)
def _change_law(experiment: LoopInput, numbers: tuple[tuple[str, float], ...]) -> LoopInput:
    """Input with other controller numbers, cached for many runs of a candidate."""
    return experiment.under(with_numbers(experiment.axis.controller, dict(numbers)))


def _show(torques: FloatArray, values: Mapping[str, float], sample_time: float, order: int = 0) -> FloatArray:
    """Apply the log's gain and delay to torques, (samples, columns).

    With order 1, return the derivatives by the log's delay: on a sample, the mean of the slopes on both sides.
    """
    gain, late = values.get("log_gain", 1.0), values.get("log_delay", 0.0) / sample_time
    if order == 0 and late == 0.0:
        return torques if gain == 1.0 else gain * torques
    first = math.floor(late) - (late == 0.0)
    at = np.arange(len(torques))[:, np.newaxis] - [first, math.floor(late) + 1]
    before, after = np.moveaxis(torques[np.clip(at, 0, len(torques) - 1)], 1, 0)
    if order == 1:
        return np.asarray(gain * (after - before) / (sample_time * (math.floor(late) + 1 - first)))
    part = late - first
    return np.asarray(gain * ((1 - part) * before + part * after))


@dataclass(frozen=True, slots=True, eq=False)
class MotionLog:
    """A log with prescribed motion of the motors.

    Attributes:
        measured: (samples, n) torques.
        filtering: resolved.
        motion: as measured.
        prescribed: the motors' motion.
        parts: number of parts of a sample.
    """

    measured: FloatArray
    filtering: Filtering
    motion: MeasuredMotion
    prescribed: PrescribedMotion
    parts: int = PARTS_OF_ROBOT
    motion_measured: ClassVar[bool] = True

    @property
    def tree(self) -> Tree | None:
        """Of the links."""
        return self.prescribed.tree

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.motion.sample_time

    @property
    def poses(self) -> FloatArray:
        """Positions of the shafts, (samples, n)."""
        return self.prescribed.position[:: self.parts]

    def roughly(self) -> MotionLog:
        """The log's beginning, up to its share of each motor's squared acceleration.

        It suffices to find springs: of six joints and 45 s at 1 kHz a search took seven times as long along the whole.
        """
        samples = len(self.motion.a)
        least = 60_000 if self.tree is None else math.ceil(4.0 / self.sample_time)  # samples of a joint, 4 s of a robot
        if least >= samples:
            return self
        moved = np.cumsum(np.square(self.motion.a), axis=0)
        size = max(least, 1 + int(np.max(np.argmax(moved >= least / samples * moved[-1], axis=0))))
        if size > 0.7 * samples:  # of a record: a beginning that saves time
            return self
        prescribed = self.prescribed.begin((size - 1) * self.parts)
        return replace(self, measured=self.measured[:size], motion=self.motion.cut(0, size), prescribed=prescribed)

    def with_rows(self, moving: FloatArray) -> MotionLog:
        """The log with other weighted samples, (samples, n) of 0 and 1."""
        return replace(self, motion=replace(self.motion, moving=moving * self.motion.counts))

    def run(self, numbers: Numbers, *, keep: bool = True, room: Room | None = None) -> DriveSideRun:
        """Simulate a candidate; its tape is kept anyway."""
        del keep, room
        return run_drive_side(self.prescribed, numbers)

    def predict(self, run: DriveSideRun) -> FloatArray:
        """Predict the torque of a run as logged, (samples, n)."""
        return self._show(run, run.torque)

    def slopes(self, run: DriveSideRun, keys: Sequence[Place]) -> FloatArray:
        """Return the derivatives of a run's filtered torques by parameters, (rows, keys)."""
        parts = run.columns(keys)

        def of_joint(j: int) -> FloatArray:
            own, columns = parts[j]
            seen = self.decimate_joint(j, self._show(run, columns))
            rows = np.zeros((len(seen), len(keys)))
            rows[:, own] = seen
            return rows

        def moved_by(some: Sequence[Place]) -> FloatArray:
            moved = differentiate_drive_side(run, some)
            return decimate_each(self, [self._show(run, moved[:, j]) for j in range(moved.shape[1])])

        found = np.concatenate(in_threads(of_joint, range(len(parts))))
        moving = [c for c, key in enumerate(keys) if moves_links(key, run.numbers)]
        if moving:
            found[:, moving] = _in_blocks(moved_by, [keys[c] for c in moving])
        if _LATE in keys:
            late = self._show(run, run.torque, 1) / self.sample_time
            found[:, list(keys).index(_LATE)] = decimate_each(self, list(late.T))
        return found

    def decimate_joint(self, joint: int, columns: FloatArray) -> FloatArray:
        """Filter columns of one joint, (samples, ...), 0 at rest."""
        rows = self.motion.decimate_joint(joint, columns.reshape(len(columns), -1))
        return rows.reshape(len(rows), *columns.shape[1:])

    def _show(self, run: DriveSideRun, parts: FloatArray, order: int = 0) -> FloatArray:
        """Apply the torques' window and log delay to means, (parts, columns)."""
        late = run.numbers.values[0].get(LOG_DELAY.name, 0.0)
        return window_parts(parts, self.parts, late / self.sample_time, order, curved=self.parts == 1)


Log: TypeAlias = LoopLog | MotionLog


def _filter_error(log: Log, run: Any) -> FloatArray:
    """Filtered torque error, (rows,); large for a failed run."""
    error = log.measured - log.predict(run) if run.outcome is Outcome.FINISHED else 1e3 * log.measured
    return decimate_each(log, list(error.T))


def _in_blocks(of: Callable[[Any], FloatArray], keys: Sequence[Place]) -> FloatArray:
    """Return columns of parameters, (rows, keys), some at a time in threads."""
    share = max(math.ceil(len(keys) / threads()), 16)  # parameters whose derivatives are worth a thread
    return np.column_stack(in_threads(of, [tuple(keys[i : i + share]) for i in range(0, len(keys), share)]))


# The problem of all logs


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """The torques of logs against a simulation of their robot.

    Rows are those of one joint after the other, which share their instants, each divided by its `sigma`.

    Attributes:
        logs: each simulated by itself.
        parameters: identified.
        sigma: (n, logs) of the joints' errors, by which they are weighted.
    """

    logs: tuple[Log, ...]
    parameters: Parameters
    sigma: FloatArray

    @classmethod
    def of(cls, logs: Sequence[Log], parameters: Parameters) -> Simulated:
        """Problem of logs, with joints scaled by their torques."""
        sizes = np.std(np.vstack([log.measured for log in logs]), axis=0) + 1e-300
        return cls(tuple(logs), parameters, np.repeat(sizes[:, np.newaxis], len(logs), axis=1))

    @property
    def log(self) -> Any:
        """The first log."""
        return self.logs[0]

    @property
    def measured(self) -> FloatArray:
        """Torques of all logs, one after the other, (samples, n)."""
        return np.vstack([log.measured for log in self.logs])

    @property
    def filtering(self) -> Filtering:
        """Of the first log, resolved."""
        return self.logs[0].filtering

    @property
    def sample_time(self) -> float:
        """Of the first log, s."""
        return self.logs[0].sample_time

    @property
    def step(self) -> int:
        """Samples of the first log from one row to the next."""
        return self.filtering.decimation or 1

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Free parameters, with bounds of the search variables."""
        return self.parameters.free

    def numbers(self, x: FloatArray) -> Numbers:
        """Return the numbers of a candidate."""
        return self.parameters.numbers(self.parameters.values(x))

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        return dict(zip(self.parameters.names, map(float, self.parameters.values(x)), strict=True))

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Search variables, (free,), of values by name; missing ones start as declared."""
        found = [values.get(p.name, p.start or 0.0) for p in self.parameters]
        return self.parameters.to_search_variables(np.array(found))

    def map_logs(self, change: Callable[[Any], Log]) -> Self:
        """Return the problem of changed logs; itself where none changes."""
        logs = tuple(map(change, self.logs))
        return replace(self, logs=logs) if any(a is not b for a, b in zip(logs, self.logs, strict=True)) else self

    def with_log(self, **changes: object) -> Self:
        """Return the problem of another log."""
        return self.map_logs(lambda log: replace(log, **changes))

    def roughly(self) -> Self:
        """The problem with longer steps or shorter logs, to begin a search."""
        return self.map_logs(lambda log: log.roughly())

    def reweight(self, left: FloatArray, count: int) -> Simulated:
        """Reweight by the residual, (rows,), of a fit of `count` parameters."""
        rows = self.by_joint(left)
        degrees = max(rows.size - count, 1) / rows.size
        least = self.floor / math.sqrt(rows.shape[1])
        parts = np.split(rows**2, np.cumsum(self.series)[:-1], axis=1)
        power = np.column_stack([part.mean(axis=1) for part in parts])
        return replace(self, sigma=np.maximum(np.sqrt(power / degrees), least))

    def runs_of(self, numbers: Numbers, *, keep: bool = True) -> Runs:
        """Simulate numbers along all logs, and keep data for derivatives."""
        return tuple(log.run(numbers, keep=keep) for log in self.logs)

    def run(self, x: FloatArray, *, keep: bool = True) -> Runs:
        """Simulate a candidate."""
        return self.runs_of(self.numbers(x), keep=keep)

    def run_of(self, numbers: Numbers, *, keep: bool = True) -> Runs | None:
        """Simulate a robot with these numbers; None if it cannot be simulated.

        Where its links are at the first sample is of the record: it is fitted, of any robot alike.
        """
        numbers = numbers.with_record(self.parameters.base, LOAD_STATE)
        runs, own = self.runs_of(numbers, keep=keep), self.parameters
        if outcome_of(runs) is not Outcome.FINISHED:
            return None
        if not (states := [i for i, place in enumerate(own.places) if place.name in LOAD_STATE]):
            return runs
        beginning = replace(self, parameters=replace(own.select(states), base=numbers))
        return beginning.run(solve(beginning, LevenbergMarquardt(1e-6, 6), np.zeros(len(states))).x)  # nearly linear

    def left_by(self, numbers: Numbers) -> FloatArray:
        """Residual share of each joint's torque, (n,); infinite if simulation fails."""
        runs = self.run_of(numbers, keep=False)
        return np.full(len(self.sigma), np.inf) if runs is None else self.norms(self.error(runs)) / self.sizes

    def predict(self, runs: Runs) -> FloatArray:
        """Predict the torques of all logs, (samples, n), one after the other."""
        return np.vstack([log.predict(run) for log, run in zip(self.logs, runs, strict=True)])

    def error(self, runs: Runs) -> FloatArray:
        """Unweighted filtered error of the runs, measured less predicted, (rows,)."""
        return self._rows([_filter_error(log, run) for log, run in zip(self.logs, runs, strict=True)])

    def by_joint(self, rows: FloatArray) -> FloatArray:
        """Return rows as (n, instants)."""
        return rows.reshape(len(self.sigma), -1)

    def norms(self, rows: FloatArray) -> FloatArray:
        """Return the norms of the joints' rows, (n,)."""
        return np.asarray(np.linalg.norm(self.by_joint(rows), axis=1))

    @property
    def filtered_torque(self) -> FloatArray:
        """Measured torques, filtered, (rows,)."""
        return self._rows([decimate_each(log, list(log.measured.T)) for log in self.logs])

    @property
    def series(self) -> tuple[int, ...]:
        """Rows of each log in one joint's equation."""
        return tuple(len(log.decimate_joint(0, log.measured[:, 0])) for log in self.logs)

    def _rows(self, each: Sequence[FloatArray]) -> FloatArray:
        """Join the rows of all logs."""
        return each[0] if len(each) == 1 else join_rows(each, len(self.sigma))  # a copy of one log's would cost time

    @property
    def sizes(self) -> FloatArray:
        """Norms of the joints' filtered torques, (n,)."""
        return self.norms(self.filtered_torque)

    @property
    def size(self) -> float:
        """Norm of the weighted torques."""
        return float(np.linalg.norm(self.weigh(self.filtered_torque)))

    @property
    def floor(self) -> float:
        """Norm of the simulation's own error, a lower limit for joints' errors."""
        return 1e-7 * float(np.max(self.sizes))  # of the torques: an error that the simulation itself may have

    def weigh(self, rows: FloatArray) -> FloatArray:
        """Divide rows, (rows, ...), by the sizes of their errors."""
        each = self.series if len(self.logs) > 1 else len(rows) // len(self.sigma)
        return np.asarray((rows.T * np.repeat(1.0 / self.sigma, each, axis=1).ravel()).T)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,); large where the candidate cannot be simulated."""
        return self.weigh(self.error(self.run(x, keep=False)))

    def rows(self, log: Log, x: FloatArray) -> tuple[FloatArray, FloatArray, Any]:
        """Unweighted error along a log, its derivatives, and the run."""
        run: Any = log.run(self.numbers(x), room=_ROOM)
        error = _filter_error(log, run)
        if run.outcome is not Outcome.FINISHED:
            return error, np.zeros((error.size, x.size)), run
        return error, log.slopes(run, self.parameters.keys) * -self.parameters.scales(x), run

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted residual, (rows,), and derivatives, (rows, free); 0 if simulation fails.

        The data of a simulation are released before that of the next log.
        """
        errors, slopes, finished = list[FloatArray](), list[FloatArray](), True
        for log in self.logs:
            error, J, run = self.rows(log, x)
            errors.append(error)
            slopes.append(J)
            finished &= run.outcome is Outcome.FINISHED
        J = self._rows(slopes)
        return self.weigh(self._rows(errors)), self.weigh(J if finished else np.zeros_like(J))


# The problem of one joint


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoopProblem(Simulated):
    """The torque of one record against the simulation of one joint.

    Of a loop the filter's borders are left out of the reported error, not of the residual, because the first samples
    contain the information on the initial state and no position is differentiated.

    Attributes:
        system: the simulated loop, or along a motion the joint.
    """

    system: ClosedLoop | Joint

    @property
    def joint(self) -> Joint:
        """The joint."""
        return self.system.joint if isinstance(self.system, ClosedLoop) else self.system

    @property
    def loop(self) -> ClosedLoop:
        """The joint and its controller."""
        return cast("ClosedLoop", self.system)

    @property
    def axis(self) -> AxisInput:
        """The inputs of the joint's controller."""
        experiment: LoopInput = self.log.experiment
        return experiment.axis

    @property
    def measured(self) -> FloatArray:
        """The torque, (samples,)."""
        return np.concatenate([log.measured[:, 0] for log in self.logs])

    @property
    def own(self) -> tuple[Parameter, ...]:
        """The joint's parameters, which come first."""
        return self.parameters.parameters[: len(self.joint.parameters)]

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """The joint's free parameters."""
        return tuple(p for p in self.own if p.free)

    @property
    def around(self) -> tuple[Parameter, ...]:
        """The parameters of what surrounds the joint."""
        return self.parameters.parameters[len(self.joint.parameters) :]

    @property
    def units(self) -> dict[str, str]:
        """Of every parameter, by name."""
        return {p.name: self.joint.unit(p) for p in self.parameters}

    # Other problems

    def replace_parameters(self, changes: Mapping[str, Parameter]) -> ClosedLoopProblem:
        """Replace the parameters of these names; others are not added."""
        changed = (changes.get(p.name, p) for p in self.parameters)
        return replace(self, parameters=Parameters.of_joint(self.joint, changed))

    def keeping(self, values: Mapping[str, float]) -> ClosedLoopProblem:
        """Fix parameters at these values, by name; others are not added."""
        return self.replace_parameters({p.name: p.fix(values[p.name]) for p in self.parameters if p.name in values})

    def freeing(self, *names: str) -> ClosedLoopProblem:
        """Return the same problem with more of what surrounds the joint free.

        Raises:
            MethodError: nothing around the joint has that name.
        """
        new = [surrounding(name, self.loop.controller, self.axis.law.period) for name in names]
        kept = tuple(p for p in self.parameters if p.name not in names)
        return replace(self, parameters=Parameters.of_joint(self.joint, (*kept, *new)))

    def with_joint(self, joint: Joint, own: Sequence[Parameter] | None = None) -> ClosedLoopProblem:
        """The problem of another joint, with shared parameters as in this one."""
        given = {p.name: p for p in self.parameters}
        own = [replace(given.get(p.name, p), symbol=p.symbol) for p in joint.parameters] if own is None else own
        parameters = Parameters.of_joint(joint, (*own, *self.around))
        system = joint if self.log.motion_measured else replace(self.loop, joint=joint)
        return replace(self, system=system, parameters=parameters)

    def under(self, controller: Controller, record: Record | None = None) -> ClosedLoopProblem:
        """The problem with another controller, or with its record prepared for it.

        Raises:
            RecordError, MethodError: the record, or the law, cannot be at that period.
        """
        loop, experiment = replace(self.loop, controller=controller), self.log.experiment
        driven = experiment.under(controller) if record is None else prepare(loop, record)
        return replace(self.with_log(experiment=driven), system=loop)

    # Its answers

    def filter(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), through the problem's own filter, decimated."""
        return np.asarray(self.log.decimate_joint(0, columns))

    def filtered_error(self, error: FloatArray) -> float:
        """Norm of a filtered error, (rows,), relative to the filtered signal's."""
        return float(np.linalg.norm(error) / self.size)

    def axis_at(self, x: FloatArray) -> AxisInput:
        """Inputs of the controller with the numbers of x."""
        experiment: LoopInput = self.log.under(self.numbers(x))
        return experiment.axis

    def loop_at(self, x: FloatArray) -> ClosedLoop:
        """The loop with the controller's numbers of x."""
        return replace(self.loop, controller=self.axis_at(x).controller)

    def simulate(self, x: FloatArray) -> Simulation:
        """Simulate the loop with these parameters; its torque is as logged."""
        (run,) = self.run(x)
        return replace(Simulation.of(run), torque=self.log.predict(run)[:, 0])

    def torque(self, x: FloatArray, driven: Callable[[AxisInput], AxisInput] | None = None) -> FloatArray:
        """Raw logged torque of a loop, (samples,); `driven` changes its inputs."""
        return np.asarray(self.log.predict(self.log.run(self.numbers(x), keep=False, driven=driven))[:, 0])

    def cells(self, simulation: Simulation) -> Cells:
        """Cell of the simulated motor's position and velocity, per residual row."""
        return cells(simulation.motor_position[self.log.kept], simulation.motor_velocity[self.log.kept])


def beginning_position(problem: ClosedLoopProblem, velocity: float = 0.0, torque: float | None = None) -> float:
    """Motor position at which the controller outputs the first logged torque.

    With integral action, or without position feedback, this is the first reference.

    A proportional loop lets a load sag by its torque over the gain. A search that begins elsewhere may not find this
    position, as friction holds the motor where it begins. The torque may differ from
    the first of the log.
    """
    axis = problem.axis
    home, (gain, by_speed) = float(axis.inputs[0, REFERENCE]), axis.by_motion
    if axis.feedback.integrates:  # its integral carries the load, and the motor is where it is asked to be
        return home
    asked = problem.measured[0] if torque is None else torque
    asked -= axis.shown[0] + axis.feedforward[axis.feedback.output, 0] + velocity * by_speed
    return float(asked / gain) if gain != 0.0 else home


def torque_problem(
    record: Record,
    loop: ClosedLoop,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    surroundings: Sequence[Parameter] = INITIAL_STATE,
) -> ClosedLoopProblem:
    """Problem of reproducing a record's torque by simulating the loop.

    Raises:
        RecordError: the record lacks a channel the loop needs.
        MethodError: no parameter of the joint is free, or the filtering is impossible.
    """
    require_free(parameters)
    log = loop_log(loop, [record], loop.joint.model, filtering)
    # Of positions alone the content of an integral is one with a constant torque of the joint.
    lacks = all(p.name != INITIAL_TORQUE.name for p in surroundings) and not any(log.seen)
    first = replace(INITIAL_TORQUE, start=float(log.measured[0, 0]))
    around = (*surroundings, first) if lacks and log.experiment.axis.law.integrates else surroundings
    return ClosedLoopProblem((log,), Parameters.of_joint(loop.joint, (*parameters, *around)), np.ones((1, 1)), loop)


def require_free(parameters: tuple[Parameter, ...]) -> None:
    """Raise a `MethodError` if no parameter of a joint is free."""
    if not any(p.free for p in parameters):
        raise MethodError(
            "Every parameter of the joint is fixed, or of its linear laws, so no search can begin; free one."
        )


# The problem of a robot


def pose_robot(
    setup: Robot | RobotLoop,
    records: Records,
    parameters: Parameters,
    filtering: Filtering | None = None,
    delay: float | None = 0.0,
    *,
    stated: bool = True,
) -> Simulated:
    """Problem of reproducing a robot's torques, by loop or along motor motion.

    Along a motion two numbers of the record are searched, too: the delay of the logged torques, one for all joints,
    which else would appear as damping of the springs; and, if motors move at the first sample, the deviation of the
    links' position and velocity from steady motion.

    Args:
        setup: the robot under its controllers, or along its motion.
        records: of each joint, on one clock; of one log or several.
        parameters: of the robot.
        filtering: of torques, and of measured positions.
        delay: s, of the logged torques along a motion; None to search it.
        stated: whether the torques' timing is stated, from which a known delay counts; see `log_delay`.

    Raises:
        RecordError: a channel is missing, or the joints' records have not one clock.
        MethodError: see `prepare`; the filtering is impossible; or along a motion a motor hardly moves, a torque is 0
            throughout, the delay is none, or one of several logs begins in motion.
    """
    logs = each_log(records)
    robot = setup.robot
    model = "flexible" if any(robot.flexible) else "rigid"
    if isinstance(setup, RobotLoop):
        moved = [loop_log(setup, log, model, filtering) for log in logs]
        for one in moved:
            require_torques(robot, one.measured.T)
        return Simulated.of(moved, parameters)
    found = [_motion_log(robot, log, model, filtering or Filtering()) for log in logs]
    for count, (_, resting) in enumerate(found if len(found) > 1 else (), start=1):
        if moving := [robot.names[j] for j in np.flatnonzero(np.array(robot.flexible) & ~resting)]:
            raise MethodError(
                f"The motor of {', '.join(sorted(moving))} moves at the first sample of log {count}; expected that "
                "each of several logs begins at rest: cut it by record.start, or identify it alone."
            )
    (first, resting), *_ = found
    most = log_delay(None, first.sample_time).upper
    if delay is not None and not abs(delay) <= most:
        raise MethodError(
            f"log_delay is {delay:g} s; expected at most {most:g} s either way, twenty samples: give it in s, or leave "
            "it out to have it identified."
        )
    known = log_delay(delay, first.sample_time, stated=stated)
    return Simulated.of([log for log, _ in found], of_record(parameters, robot, resting, known))


def loop_log(
    loop: ClosedLoop | RobotLoop, records: Sequence[Record], model: str, filtering: Filtering | None
) -> LoopLog:
    """Log of controllers that follow their references, for a joint or robot.

    Records have a torque, or a motor position that determines the controller's output. The filter's cut-off is by
    default that of the model, "rigid" or "flexible".

    Raises:
        RecordError: a channel is missing, or the records have not one clock.
        MethodError: see `prepare`; or the filtering is impossible.
    """
    for one, record in zip(loop.loops, records, strict=False):
        record.require(one.channels, "DIDIM")
    experiment = prepare(loop, records)
    samples, sample_time = experiment.clock.samples, experiment.clock.sample_time
    measured = np.column_stack([r.torque.values[:samples] for r in records if r.torque is not None])
    seen = tuple(map(seen_position, records, loop.loops))
    for j, (law, record) in enumerate(zip(seen, records, strict=True)):
        if law is not None and record.motor_position is not None:
            measured[:, j] = law.torque(record.motor_position.values)[:samples]
    behind = [r.motor_position.values for r in records if r.computed and r.motor_position is not None]
    resolved = (filtering or Filtering()).resolve(sample_time, model, find_noise_limit(behind, sample_time))
    counts = np.min([record.counts(samples, sample_time) for record in records], axis=0)
    # A filter that is padded about the ends holds to a noisy end, which a difference of positions makes large.
    inside = resolved.inside(samples) if any(seen) else slice(0, samples)
    return LoopLog(measured, resolved, experiment, counts, seen=seen, ends=(inside.start, samples - inside.stop))


def _motion_log(robot: Robot, records: Sequence[Record], model: str, filtering: Filtering) -> tuple[MotionLog, Bools]:
    """Log along the motors' motion, and which motors initially rest, (n,)."""
    if records[-1].payload:
        raise MethodError(
            "A payload of a record is taken by IDIM and DIDIM; received one on the drive side: leave it out."
        )
    if filtering.timing == "as_sampled":
        raise MethodError(
            'filtering.timing is "as_sampled"; on the drive side of a robot when a torque acts matters: leave it out.'
        )
    # The position filter rings about a reversal, and no more at the same instant in both, for one of its periods.
    motion = measure_motion(robot, records, filtering, "The drive side of a robot", model=model, smear=1.0)
    still = [name for name, share in zip(robot.names, np.mean(motion.moving, axis=0), strict=True) if share < 0.05]
    if still:
        raise MethodError(
            f"The motor of {', '.join(still)} rests, or turns round, nearly all the time; expected a motion of every "
            "motor: move it, or leave its joint out of the model."
        )
    resting = np.array([moving_weights(each, 20, 0)[0] == 0.0 for each in (motion.v @ robot.coupling.T).T])
    prescribed = prescribe(motion.q @ robot.coupling.T, motion.sample_time, PARTS_OF_ROBOT, robot.tree, resting)
    # What the filter takes from the motion it is to take from the torques, too, and from friction's own.
    cutoff = motion.filtering.position_cutoff
    assert cutoff is not None
    motion = replace(motion, torque=lowpass(motion.torque, cutoff, motion.sample_time))
    prescribed = replace(prescribed, direction=lowpass(prescribed.direction, cutoff, prescribed.step))
    return MotionLog(motion.torque, motion.filtering, motion, prescribed), resting


def of_record(parameters: Parameters, robot: Robot, resting: Bools, delay: Parameter) -> Parameters:
    """Add the log's delay, and moving links' initial state, to parameters."""
    more, states = [(delay, _LATE)] if delay.free else [], list[Place]()
    for j in np.flatnonzero(np.array(robot.flexible) & ~resting).tolist():
        for name, quantity in zip(LOAD_STATE, (Quantity.POSITION, Quantity.VELOCITY), strict=True):
            own = name.replace("load", "link")
            states.append(Place(j, name))
            more.append((Parameter(f"{robot.joints[j].name}.{own}", symbol_of(own, j), quantity), states[-1]))
    base = parameters.base.with_values([_LATE, *states], [delay.start or 0.0, *np.zeros(len(states))])
    return replace(parameters.add(*more), base=base)
