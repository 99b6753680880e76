"""The problem an estimator solves: a vector of free parameters in, the filtered torque error and its slopes out.

It owns the record, what closes the loop around the joint, the filter that torque and Jacobian go through alike, and
which parameters are free: those of the joint, then those of what surrounds it (`problems.base`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.estimation.problems.base import (
    DRIVE_AND_LOG,
    FAILED,
    INITIAL,
    INITIAL_STATE,
    INITIAL_TORQUE,
    RecordProblem,
    of_law,
    surrounding,
)
from jointid.models.controllers import POSITION, REFERENCE, Controller, SampledLaw, number
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimate_all, drop_ends, noise_limit_of_computed
from jointid.simulation.controller_torque import SeenPosition, seen_position
from jointid.simulation.derivatives import simulate_sensitivities
from jointid.simulation.loop_input import AxisInput, LoopInput, change_controller, prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome, Run, Simulation, motion_at, run_loop
from jointid.simulation.start import Initial
from jointid.uncertainty.position_dependent_error import Cells, cells


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """A simulation candidate for one vector of parameters."""

    experiment: LoopInput
    numbers: Numbers  # of the joint, per torque of the log
    initial: Initial
    drive_gain: float
    log_gain: float
    log_delay: float

    def run(self, *, keep: bool) -> Run:
        """Simulate it."""
        return run_loop(self.experiment, self.numbers, self.initial, keep=keep)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoopProblem(RecordProblem):
    """The torque of one record against one loop, simulated from its reference.

    The filter's borders are left out of the reported error, not of the residual, because the first samples hold what is
    known of the initial state and no position is differentiated.

    Attributes:
        loop, experiment: what is simulated.
        seen: what takes a motor position to a torque where that is not logged, but computed; None where it is. Measured
            and simulated positions go through it alike, so it does not follow the law of a candidate.
    """

    loop: ClosedLoop
    experiment: LoopInput
    seen: SeenPosition | None = None

    @property
    def joint(self) -> Joint:
        """The joint."""
        return self.loop.joint

    @property
    def axis(self) -> AxisInput:
        """The inputs of the joint's controller."""
        return self.experiment.axis

    @property
    def sample_time(self) -> float:
        """Of the torque, seconds."""
        return self.axis.sample_time

    def freeing(self, *names: str) -> ClosedLoopProblem:
        """Return the same problem with more of what surrounds the joint free.

        Raises:
            MethodError: nothing around the joint has that name.
        """
        new = [surrounding(name, self.loop.controller, self.axis.law.period) for name in names]
        kept = tuple(p for p in self.parameters if p.name not in names)
        return replace(self, parameters=(*kept, *new))

    def driven(self, axis: AxisInput) -> ClosedLoopProblem:
        """Return the problem with other inputs of its controller."""
        return replace(self, experiment=self.experiment.alone(axis))

    def declared(self, controller: Controller) -> ClosedLoopProblem:
        """Return the problem with another controller of the same period and delay."""
        loop = replace(self.loop, controller=controller)
        return replace(self, loop=loop).driven(self.axis.under(controller))

    def under(self, controller: Controller, record: Record) -> ClosedLoopProblem:
        """Return the problem with its record prepared for another controller.

        Raises:
            RecordError, MethodError: the record, or the law, cannot be at that period.
        """
        loop = replace(self.loop, controller=controller)
        return replace(self, loop=loop, experiment=prepare(loop, record))

    def filter(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), through the problem's own filter."""
        return self._filter_all([columns])[0]

    def _filter_all(self, signals: Sequence[FloatArray]) -> list[FloatArray]:
        rows, samples = decimate_all(signals, self.filtering, self.sample_time), len(signals[0])
        return rows if self.seen is None else [drop_ends(one, self.filtering, samples) for one in rows]

    def simulate(self, x: FloatArray) -> Simulation:
        """Return the loop's run with these parameters, its torque as the log should show it."""
        c = self._candidate(x)
        run = c.run(keep=True)
        return replace(Simulation.of(run), torque=self._show_log(self._output(run), c))

    def loop_at(self, x: FloatArray) -> ClosedLoop:
        """Return the loop with the controller's numbers that these parameters say."""
        return replace(self.loop, controller=self._candidate(x).experiment.axis.controller)

    def law_at(self, x: FloatArray) -> SampledLaw:
        """Return the controller's law with the numbers that these parameters say."""
        return self._candidate(x).experiment.axis.law

    def torque(self, x: FloatArray, driven: Callable[[AxisInput], AxisInput] | None = None) -> FloatArray:
        """Return the torque the log should show, raw, (samples,).

        Args:
            x: free parameters.
            driven: from what the loop is driven with, to what it might be.
        """
        return self._respond(x, driven)[0]

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered, decimated torque error, (rows,); of a candidate that fails, something large."""
        return self.filter_error(*self._respond(x))[0]

    def _respond(self, x: FloatArray, driven: Callable[[AxisInput], AxisInput] | None = None) -> tuple[FloatArray, Run]:
        c = self._candidate(x)
        if driven is not None:
            c = replace(c, experiment=c.experiment.alone(driven(c.experiment.axis)))
        run = c.run(keep=self.seen is not None)
        return self._show_log(self._output(run), c), run

    def _output(self, run: Run) -> FloatArray:
        """Return the torque of a run, or what is computed from its motor position, (samples,)."""
        if self.seen is None:
            return run.torque
        return self.seen.torque(motion_at(run, run.experiment.clock.log_index).position[:, 0])

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free), from one run."""
        error, slopes = self.filter_error(*self.sensitivities(x))
        return error, -slopes

    def sensitivities(self, x: FloatArray) -> tuple[FloatArray, Run, FloatArray]:
        """Return the predicted log, its run, and its derivatives by the free parameters, (samples, free), raw.

        Where the candidate cannot be simulated the derivatives are 0.
        """
        c = self._candidate(x)
        own = [p.name for p in self.joint.parameters]
        names = [p.name for p in self.free if p.name not in DRIVE_AND_LOG]
        scaled = any(p.name == "drive_gain" for p in self.free)
        wanted = [*names, *(name for name in own if scaled and name not in names)]
        found = simulate_sensitivities(
            self.loop, c.experiment, c.numbers.values[0], wanted, c.initial, positions=self.seen is not None
        )
        raw, slopes = self._output(found.run), found.torque
        if self.seen is not None:
            slopes = self.seen.slopes(found.motor_position)
        shown = self._show_log(raw, c)
        if len(names) == len(self.free) == len(wanted) and (c.drive_gain, c.log_gain, c.log_delay) == (1.0, 1.0, 0.0):
            return shown, found.run, slopes
        columns = dict(zip(wanted, slopes.T, strict=True))
        if scaled:  # all of the joint's parameters are measured in the torque that acts
            columns["drive_gain"] = -sum((c.numbers.values[0][n] / c.drive_gain) * columns[n] for n in own)
        for name in own:
            if name in columns and c.drive_gain != 1.0:
                columns[name] = columns[name] / c.drive_gain
        if c.log_gain != 1.0 or c.log_delay != 0.0:
            columns = {name: self._show_log(column, c) for name, column in columns.items()}
        columns["log_gain"] = shown / c.log_gain
        columns["log_delay"] = self._slope(raw, c)
        return shown, found.run, np.column_stack([columns[p.name] for p in self.free])

    def filter_error(self, torque: FloatArray, run: Run | Simulation, *columns: FloatArray) -> tuple[FloatArray, ...]:
        """Return the filtered error of a run's torque, (rows,), and raw columns through the same filter, at once."""
        error = self.measured - torque
        if run.outcome is not Outcome.FINISHED:
            # The earlier it failed the worse: a search must see which way to go.
            size = float(np.sqrt(np.mean(self.measured**2)))
            error = np.full_like(error, FAILED * size * (2.0 - run.finished))
        return tuple(self._filter_all([error, *columns]))

    @property
    def kept(self) -> NDArray[np.intp]:
        """The samples that rows of the residual are taken at, (rows,): the last one, if no ends are dropped."""
        samples, keep = self.measured.size, self.filtering.decimation or 1
        rows = np.arange((samples - 1) % keep, samples, keep)
        return rows if self.seen is None else drop_ends(rows, self.filtering, samples)

    def cells(self, simulation: Simulation) -> Cells:
        """Return the cell of position and velocity of the simulated motor for each row of the residual."""
        return cells(simulation.motor_position[self.kept], simulation.motor_velocity[self.kept])

    def regressor(self, simulation: Simulation) -> FloatArray:
        """Return the inverse-dynamic columns of a rigid joint on a run, raw, (samples, free of the joint)."""
        columns = self.joint.regressor(simulation.motor)[0]
        return np.asarray(columns[:, [p.free for p in self.parameters[: len(self.joint.parameters)]]])

    def _candidate(self, x: FloatArray) -> _Candidate:
        values = self.values(x)
        own = {p.name for p in self.joint.parameters}
        gain = values.get("drive_gain", 1.0)
        numbers = {n: v for n, v in values.items() if n not in own and of_law(n)}
        experiment = self.experiment
        if any(v != number(self.loop.controller, n) for n, v in numbers.items()):
            experiment = _change_law(experiment, tuple(numbers.items()))
        joint = Numbers.of_joint(self.joint, {n: values[n] / gain for n in own})
        initial = Initial(*(values.get(name) for name in INITIAL))
        return _Candidate(experiment, joint, initial, gain, values.get("log_gain", 1.0), values.get("log_delay", 0.0))

    def _show_log(self, torque: FloatArray, c: _Candidate) -> FloatArray:
        """Return the torque with the gain of the log, and as much later as its stamps are wrong."""
        if c.log_delay == 0.0:
            return torque if c.log_gain == 1.0 else c.log_gain * torque
        whole = math.floor(c.log_delay / self.sample_time)
        part = c.log_delay / self.sample_time - whole
        return c.log_gain * ((1 - part) * _shift(torque, whole) + part * _shift(torque, whole + 1))

    def _slope(self, torque: FloatArray, c: _Candidate) -> FloatArray:
        """Return the derivative of the shown torque by the log's delay."""
        whole = math.floor(c.log_delay / self.sample_time)
        if c.log_delay == 0.0:  # between two samples the shown torque has one slope, on a sample the mean of two
            return c.log_gain * (_shift(torque, 1) - _shift(torque, -1)) / (2 * self.sample_time)
        return c.log_gain * (_shift(torque, whole + 1) - _shift(torque, whole)) / self.sample_time


@lru_cache(maxsize=2)
def _change_law(experiment: LoopInput, numbers: tuple[tuple[str, float], ...]) -> LoopInput:
    """Return an input with other numbers of its controller, the same for many runs of a candidate."""
    return change_controller(experiment, dict(numbers))


def _shift(signal: FloatArray, samples: int) -> FloatArray:
    """Return a signal so many samples later; its ends last."""
    at = np.clip(np.arange(signal.size) - samples, 0, signal.size - 1)
    return np.asarray(signal[at])


def beginning_position(problem: ClosedLoopProblem, velocity: float = 0.0) -> float:
    """Compute the motor position at which the controller outputs the first logged torque.

    With integral action, or without position feedback, this is the first reference.

    A proportional loop lets a load that weighs something sag by the torque that carries it, over its gain. A search
    that begins beside it may not find it: friction holds the motor where it begins.

    Args:
        problem: with the record's torque.
        velocity: of the motor; at rest without it.
    """
    axis = problem.axis
    law = axis.feedback
    home = float(axis.inputs[0, REFERENCE])
    if law.integrates:  # its integral carries the load, and the motor is where it is asked to be
        return home
    gain = law.C[0, law.output] @ axis.memory[:, 0] + law.D[0, law.output, POSITION]
    asked = problem.measured[0] - axis.shown[0] - axis.feedforward[law.output, 0]
    asked -= velocity * (law.C[0, law.output] @ axis.memory[:, 1])
    return float(asked / gain) if gain != 0.0 else home


def with_torque(surroundings: Sequence[Parameter], axis: AxisInput, measured: FloatArray) -> tuple[Parameter, ...]:
    """Return them with the torque at the first sample, from the log, if the law has an integral and they have none."""
    if not axis.law.integrates or any(p.name == INITIAL_TORQUE.name for p in surroundings):
        return tuple(surroundings)
    return (*surroundings, replace(INITIAL_TORQUE, start=float(measured[0])))


def torque_problem(
    record: Record,
    loop: ClosedLoop,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    surroundings: Sequence[Parameter] = INITIAL_STATE,
) -> ClosedLoopProblem:
    """Return the problem of reproducing a record's torque by simulating the loop from its reference.

    Raises:
        RecordError: the record lacks a channel the loop needs.
        MethodError: no parameter of the joint is free, or the filtering is impossible.
    """
    record.require(loop.channels, "DIDIM")
    assert record.torque is not None
    require_free(parameters)
    experiment = prepare(loop, record)
    measured, seen = record.torque.values[: experiment.clock.samples], seen_position(record, loop)
    if seen is not None and record.motor_position is not None:
        measured = seen.torque(record.motor_position.values)[: measured.size]
    # Of positions alone the content of an integral is one with a constant torque of the joint.
    around = with_torque(surroundings, experiment.axis, measured) if seen is None else surroundings
    return ClosedLoopProblem(
        (*parameters, *around),
        measured,
        filtering.resolve(
            experiment.clock.sample_time,
            loop.joint.model,
            noise_limit_of_computed([record], experiment.clock.sample_time),
        ),
        loop,
        experiment,
        seen,
    )


def require_free(parameters: tuple[Parameter, ...]) -> None:
    """Raise a `MethodError` if no parameter of a joint is free."""
    if not any(p.free for p in parameters):
        raise MethodError("Every parameter of the joint is fixed, so there is nothing to identify; free one of them.")
