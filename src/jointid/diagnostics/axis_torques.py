"""The torques of a record beside those of an estimate, axis by axis, on the rows that were compared.

Beside them stand shapes: what a part that the model lacks would add to a joint's torque. A friction that is no straight
line, grows with the load or differs by direction; what repeats with the position; a gear that bends, which adds the
second derivative of the acceleration; the motion of each other joint, as coupled motors do. All go through the filter
of the torques.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.parts import EstimateParts
from jointid.estimation.robots.drive_side import RobotDriveSideProblem
from jointid.estimation.robots.idim import InverseModelRobot
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.problem import RobotLoopProblem
from jointid.estimation.robots.regression import base_rows, motion_of_robot
from jointid.estimation.robots.simulated import SimulatedRobot, problem_of
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import simulation_of

_SLOW = 0.1  # of the largest speed: where friction may rise towards standstill
_HARMONICS = 4  # of the travel

FRICTION = "its own speed, by more than a straight line: friction that rises towards standstill, or with the square"
LOAD = "its own torque while it moves: friction that grows with the load"
POSITION = "its own position: a gear that turns unevenly, a cable or a counterbalance"
DIRECTION = "its own speed, in one direction more than in the other: friction that differs by direction"
SPRING = "changes of its acceleration: a gear that bends"


@dataclass(frozen=True, slots=True, eq=False)
class AxisTorques:
    """Torques of all axes, filtered and decimated, on an estimate's own record or another one.

    Attributes:
        time: (rows,) of them, s.
        sample_time, cutoff: s between rows, and Hz of the filter.
        measured, predicted: (n, rows) N m or N, behind the gear.
        nominal: (n, rows) the same of the model's own masses, friction fitted; None where nothing was asked of it.
        seen: (n, rows) False where a motor rests or turns round, so that friction takes what it must.
        position, velocity: (n, rows) of the motors behind their gears, rad or m, and per s; in all rows, seen or not.
        shapes: of each joint, by what they are of, (rows, columns).
    """

    time: FloatArray
    sample_time: float
    cutoff: float
    measured: FloatArray
    predicted: FloatArray
    nominal: FloatArray | None
    seen: NDArray[np.bool_]
    position: FloatArray
    velocity: FloatArray
    shapes: tuple[Mapping[str, FloatArray], ...]

    @property
    def error(self) -> FloatArray:
        """Measured less predicted, (n, rows)."""
        return self.measured - self.predicted


def torques_of_loop(problem: ClosedLoopProblem, x: FloatArray) -> AxisTorques:
    """Return the torque of a joint's solved problem, beside that of its simulation."""
    run = problem.simulate(x)
    q, v = run.motor_position[:, np.newaxis], run.motor_velocity[:, np.newaxis]
    motion = q, v, np.gradient(v, problem.sample_time, axis=0)
    measured = problem.filter(problem.measured)

    def thin(columns: FloatArray) -> FloatArray:
        return problem.filter(columns[:, 0])[np.newaxis]

    return _torques(
        ("",), problem.filtering, problem.sample_time,
        (measured[np.newaxis], (measured - problem.residual(x))[np.newaxis], None),
        np.ones((1, measured.size), dtype=np.bool_), thin(np.stack([q, v], axis=2)),
        motion, problem.measured[:, np.newaxis], thin,
    )  # fmt: skip


def torques_of_robot(estimate: EstimateParts, records: Sequence[Record]) -> AxisTorques:
    """Return the torques of the record that a robot's estimate is from, beside its own.

    Args:
        estimate: of the robot, by any method.
        records: of each joint, that it was identified from.

    Raises:
        RecordError, MethodError: as of the identification.
    """
    part, filtering = estimate.require_robot(), estimate.settings.filtering
    if isinstance(part, InverseModelRobot):
        return _by_inverse_model(part, filtering, records)
    assert isinstance(part, SimulatedRobot)
    return _by_simulation(part, filtering, records)


def _by_inverse_model(part: InverseModelRobot, filtering: Filtering, records: Sequence[Record]) -> AxisTorques:
    robot, motion = part.model, motion_of_robot(part.model, records, filtering)
    rows = base_rows(robot, part.base, motion)
    coupling = robot.coupling.T
    q, v, a = (one @ coupling for one in (motion.q, motion.v, motion.a))
    seen = motion.whole_rows

    def thin(columns: FloatArray) -> FloatArray:
        return motion.decimate_columns(columns).reshape(len(robot), -1, columns.shape[2])

    everywhere = replace(motion, moving=np.ones_like(motion.moving))
    path = everywhere.decimate_columns(np.stack([q, v], axis=2)).reshape(len(robot), -1, 2)
    nominal = rows.by_equation(rows.W @ part.nominal) if robot.has_masses else None
    measured = rows.by_equation(rows.Y)
    return _torques(
        robot.names, motion.filtering, motion.sample_time, (measured, rows.by_equation(rows.W @ part.values), nominal),
        seen, path, (q, v, a), motion.torque, thin,
    )  # fmt: skip


def _by_simulation(part: SimulatedRobot, filtering: Filtering, records: Sequence[Record]) -> AxisTorques:
    robot, numbers = part.model, part.numbers()
    problem = problem_of(part.setup, records, robot_parameters(robot), filtering)
    measured = problem.by_joint(problem.decimate(problem.measured))
    error = problem.error_of(numbers)
    assert error is not None  # it was identified from these records
    predicted = measured - problem.by_joint(error)

    def thin(columns: FloatArray, of: RobotLoopProblem | RobotDriveSideProblem = problem) -> FloatArray:
        rows = of.decimate_each(list(np.moveaxis(columns, 1, 0)))
        return rows.reshape(len(robot), -1, columns.shape[2])

    if isinstance(problem, RobotLoopProblem):
        moved = simulation_of(problem.simulate(numbers)).motion
        motion = moved.position, moved.velocity, moved.acceleration
        q, v, a = (one[:, numbers.rotors] for one in motion)
        seen, whole = np.ones(measured.shape, dtype=np.bool_), thin
    else:
        coupling = robot.coupling.T
        q, v, a = (one @ coupling for one in (problem.motion.q, problem.motion.v, problem.motion.a))
        seen, everywhere = (
            problem.motion.whole_rows,
            replace(problem.motion, moving=np.ones_like(problem.motion.moving)),
        )
        whole = partial(thin, of=replace(problem, motion=everywhere))
    return _torques(
        robot.names, problem.filtering, problem.sample_time, (measured, predicted, None), seen,
        whole(np.stack([q, v], axis=2)), (q, v, a), problem.measured, thin,
    )  # fmt: skip


def _torques(
    axes: Sequence[str],
    filtering: Filtering,
    sample_time: float,
    torques: tuple[FloatArray, FloatArray, FloatArray | None],
    seen: NDArray[np.bool_],
    path: FloatArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    torque: FloatArray,
    thin: Callable[[FloatArray], FloatArray],
) -> AxisTorques:
    """Return torques with the shapes of what a model may lack; motion and torque are (samples, n), as they are.

    The path is positions and velocities of the rows, (n, rows, 2).
    """
    assert filtering.cutoff is not None
    assert filtering.decimation is not None
    q, v, a = motion
    names, columns = _shapes(axes, q, v, a, torque, sample_time)
    widths = [one.shape[2] for one in columns]
    parts = np.split(thin(np.concatenate(columns, axis=2)), np.cumsum(widths)[:-1], axis=2)
    shapes = tuple({names(k, i): part[k] for i, part in enumerate(parts)} for k in range(len(axes)))
    step = sample_time * filtering.decimation
    measured, predicted, nominal = torques
    return AxisTorques(
        np.asarray(step * np.arange(measured.shape[1])), step, filtering.cutoff, measured, predicted, nominal, seen,
        path[:, :, 0], path[:, :, 1], shapes,
    )  # fmt: skip


def _shapes(
    axes: Sequence[str], q: FloatArray, v: FloatArray, a: FloatArray, torque: FloatArray, sample_time: float
) -> tuple[Callable[[int, int], str], list[FloatArray]]:
    """Return a function from joint and place to the name of a shape, and the shapes, (samples, n, columns) each."""
    n, way = len(axes), np.sign(v)
    slow = _SLOW * np.max(np.abs(v), axis=0) + 1e-300
    turns = 2.0 * np.pi * (q - q.min(axis=0)) / (np.ptp(q, axis=0) + 1e-300)
    waves = [wave(m * turns) for m in range(1, _HARMONICS + 1) for wave in (np.sin, np.cos)]
    bent = np.gradient(np.gradient(a, sample_time, axis=0), sample_time, axis=0)
    own = [
        np.stack([way * np.exp(-np.abs(v) / slow), v * np.abs(v)], axis=2),
        (way * np.abs(torque))[:, :, np.newaxis],
        np.stack(waves, axis=2),
        np.abs(v)[:, :, np.newaxis],
        bent[:, :, np.newaxis],
    ]
    others = []
    for place in range(n - 1):
        other = [place + (place >= k) for k in range(n)]
        others.append(np.stack([v[:, other], a[:, other], way[:, other]], axis=2))

    def name(joint: int, place: int) -> str:
        if place < len(own):
            return (FRICTION, LOAD, POSITION, DIRECTION, SPRING)[place]
        other = place - len(own)
        return f"the motion of {axes[other + (other >= joint)]}: motors or gears that are coupled"

    return name, own + others
