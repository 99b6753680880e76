"""The problem of a robot: its parameters in, the filtered errors of all joints' torques and their derivatives out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parallel import threads
from jointid.common.parameters import Parameter
from jointid.estimation.robots.numbers import RobotParameters
from jointid.models.robots.dynamics import IntArray
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, decimate_all
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.robot_columns import columns_of
from jointid.simulation.robot_numbers import NumberPlace
from jointid.simulation.robot_sensitivities import differentiate_torques
from jointid.simulation.robots import RobotInput, RobotLoop, RobotOutcome, RobotRun, motion_at, prepare_robot, run_robot

_FEWEST = 16  # parameters whose derivatives are worth a thread
_FAILED = 1e3  # times the measured torques: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RobotProblem:
    """The torques of a robot's records against its loops, simulated from their references.

    Rows are those of one joint after the other, which share their instants, each divided by the joint's `sigma`.

    Attributes:
        experiment: what the loops are driven with.
        measured: (samples, n) torques.
        filtering: resolved.
        parameters: what is identified.
        sigma: (n,) of the joints' errors, by which they weigh.
    """

    experiment: RobotInput
    measured: FloatArray
    filtering: Filtering
    parameters: RobotParameters
    sigma: FloatArray

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters, with bounds of what is searched."""
        return self.parameters.parameters

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.experiment.clock.sample_time

    def weighted(self, sigma: FloatArray) -> RobotProblem:
        """Return the problem with other sizes of the joints' errors."""
        return replace(self, sigma=sigma)

    def run(self, x: FloatArray, *, keep: bool = True) -> RobotRun:
        """Simulate a candidate."""
        return run_robot(self.experiment, self.parameters.numbers(self.parameters.values(x)), keep=keep)

    def decimated(self, signals: FloatArray) -> FloatArray:
        """Return signals, (samples, n), filtered, one joint after the other, (rows,), not weighted."""
        return np.concatenate(decimate_all(list(signals.T), self.filtering, self.sample_time))

    def decimated_columns(self, parts: Sequence[tuple[IntArray, FloatArray]]) -> FloatArray:
        """Return the columns of each joint, as `columns_of` gives them, filtered, (rows, parameters), not weighted."""
        count = len(self.parameters.places)

        def filtered(part: tuple[IntArray, FloatArray]) -> FloatArray:
            (seen,) = decimate_all([part[1]], self.filtering, self.sample_time)
            rows = np.zeros((len(seen), count))
            rows[:, part[0]] = seen
            return rows

        return np.concatenate(in_threads(filtered, parts))

    def by_joint(self, rows: FloatArray) -> FloatArray:
        """Return rows as (n, instants)."""
        return rows.reshape(self.sigma.size, -1)

    def weights(self, rows: int) -> FloatArray:
        """Return one over the size of each row's error, (rows,)."""
        return np.repeat(1.0 / self.sigma, rows // self.sigma.size)

    def error(self, run: RobotRun) -> FloatArray:
        """Return the filtered error of a run, measured less simulated, (rows,), not weighted."""
        return self.decimated(self.measured - run.torque)

    def slopes(self, run: RobotRun, x: FloatArray) -> FloatArray:
        """Return the derivatives of a run's filtered torques by what is searched, (rows, free), not weighted."""
        places = self.parameters.places
        share = max(math.ceil(len(places) / threads()), _FEWEST)

        def of(some: tuple[NumberPlace, ...]) -> FloatArray:
            each = differentiate_torques(run, some)
            return np.concatenate(decimate_all(each, self.filtering, self.sample_time))

        J = np.column_stack(in_threads(of, [places[i : i + share] for i in range(0, len(places), share)]))
        return np.asarray(J * np.where(self.parameters.logarithmic, self.parameters.values(x), 1.0))

    def regressor(self, run: RobotRun) -> FloatArray:
        """Return the columns of the motors' equations on the simulated motion, filtered, (rows, free), not weighted."""
        begun, rotors = self.experiment.clock.begun, run.numbers.rotors
        left, parts = list(range(rotors.size)), dict[int, tuple[IntArray, FloatArray]]()
        while left:  # torques that begin to act together
            together = [j for j in left if np.array_equal(begun[j], begun[left[0]])]
            motion = motion_at(run, begun[together[0]])
            found = columns_of(self.experiment.tree, run.numbers, self.parameters.places, motion, rotors[together])
            parts |= dict(zip(together, found, strict=True))
            left = [j for j in left if j not in together]
        return self.decimated_columns([parts[j] for j in range(rotors.size)])

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual, (rows,); large where the candidate cannot be simulated."""
        run = self.run(x, keep=False)
        if run.outcome is not RobotOutcome.FINISHED:
            return self._failed()
        error = self.error(run)
        return np.asarray(error * self.weights(error.size))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted residual, (rows,), and its derivatives, (rows, free); 0 of what cannot be simulated."""
        run = self.run(x)
        if run.outcome is not RobotOutcome.FINISHED:
            error = self._failed()
            return error, np.zeros((error.size, x.size))
        error = self.error(run)
        weights = self.weights(error.size)
        return error * weights, -self.slopes(run, x) * weights[:, np.newaxis]

    def _failed(self) -> FloatArray:
        seen = self.decimated(self.measured)
        return _FAILED * seen * self.weights(seen.size)


def robot_problem(
    loop: RobotLoop, records: Sequence[Record], parameters: RobotParameters, filtering: Filtering | None = None
) -> RobotProblem:
    """Return the problem of reproducing the torques of a robot's records by simulating its loops.

    Raises:
        RecordError: a record lacks a channel that is needed.
        MethodError: see `prepare_robot`; or the filtering is impossible.
    """
    for record in records:
        record.require(("torque",), "DIDIM of a robot")
    experiment = prepare_robot(loop, records)
    samples = experiment.clock.samples
    measured = np.column_stack([r.torque.values[:samples] for r in records if r.torque is not None])
    if not np.all(np.any(measured != 0.0, axis=0)):
        dead = [loop.robot.joints[j].name for j in np.flatnonzero(~np.any(measured != 0.0, axis=0))]
        raise MethodError(f"The torque of {', '.join(dead)} is 0 throughout; log it, or leave its joint out.")
    model = "flexible" if any(loop.robot.flexible) else "rigid"
    resolved = (filtering or Filtering()).resolved(experiment.clock.sample_time, model)
    return RobotProblem(experiment, measured, resolved, parameters, np.std(measured, axis=0) + 1e-300)
