"""Measured and predicted torques of axes, with equally filtered columns."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.parallel import in_threads
from jointid.diagnostics.changes import AVERAGED, OF_REFERENCE, SCREENED, list_variants
from jointid.diagnostics.seen import Seen
from jointid.diagnostics.suspects import FAULTS, Fault, FaultSignature, list_signatures
from jointid.estimation.problems.inverse_model import MeasuredMotion, decimate_each, inverse_of_robot
from jointid.estimation.problems.simulated import ClosedLoopProblem, Simulated, pose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.simulated import IdentifiedRobot, solve_again
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import find_noise_limit, lowpass
from jointid.simulation.simulate import Simulation
from jointid.uncertainty.model_tests import Whiteness, whiteness

_LEFT = 0.03  # of a torque: what is left, if it is not white, is worth a sentence
_SURE = 0.001  # of white noise that is taken for coloured: rare in all axes of a robot together
_TURN = 1e-4  # rad or m: step of a derivative
_OF_ROBOT = 0.5  # of a change: less shows that a robot's drive runs no such law
_ROTORS = (0.0, 0.25, 0.5, 0.75)  # shares of a joint's own inertia that its rotor may have


@dataclass(frozen=True, slots=True, eq=False)
class AxisTorques:
    """Filtered and decimated torques of all axes, for an estimate and record.

    Attributes:
        time: (rows,) instants of the rows, by the log's own clock [s].
        sample_time, cutoff: s between rows, and Hz of the filter.
        measured, predicted: (n, rows) N m or N, behind the gear.
        seen: (n, rows) False where a motor rests or reverses, where the friction is undetermined.
        position, velocity: (n, rows) of the motors behind their gears, rad or m, and per s.
        own: (n, rows, free) columns of the free parameters.
        shapes: effect of each fault on the torque of each axis along its motion, (rows,) each, or on the torques of all
            axes, (n, rows).
        along_measured_motion: whether the positions are those of the log.
    """

    time: FloatArray
    sample_time: float
    cutoff: float
    measured: FloatArray
    predicted: FloatArray
    seen: NDArray[np.bool_]
    position: FloatArray
    velocity: FloatArray
    own: FloatArray
    shapes: tuple[tuple[FaultSignature, ...], ...]
    along_measured_motion: bool = False

    @property
    def error(self) -> FloatArray:
        """Measured less predicted, (n, rows)."""
        return self.measured - self.predicted

    @property
    def sigma(self) -> FloatArray:
        """RMS errors in the seen rows, (n,); 1 without an error."""
        each = np.sqrt(np.sum(self.error**2 * self.seen, axis=1) / np.maximum(np.sum(self.seen, axis=1), 1))
        return np.where(each > 0.0, each, 1.0)

    @property
    def rows(self) -> list[slice]:
        """Place of each axis among the rows of all that are seen."""
        ends = np.cumsum([0, *np.sum(self.seen, axis=1)]).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    def judge(self, axis: int, rest: FloatArray | None = None) -> tuple[float, Whiteness | None, float | None]:
        """Residual share, whiteness and frequency, Hz, of an axis's torque, or of a `rest`."""
        whole = float(np.linalg.norm(self.measured[axis])) or 1.0
        left = self.error[axis] if rest is None else self.sigma[axis] * rest
        white = whiteness(left[self.seen[axis]] if rest is None else left, self.sample_time, self.cutoff)
        power = np.abs(np.fft.rfft(left)) ** 2
        top = int(np.argmax(power))
        most = top >= 10 and 2.0 * np.sum(power[math.floor(0.9 * top) : math.ceil(1.1 * top) + 1]) > np.sum(power)
        return float(np.linalg.norm(left)) / whole, white, top / (left.size * self.sample_time) if most else None

    def stack(self, each: FloatArray) -> FloatArray:
        """Stack compared rows of all axes, (n, rows, ...), scaled by error."""
        return np.concatenate([part[s] / size for part, s, size in zip(each, self.seen, self.sigma, strict=True)])

    @property
    def places(self) -> tuple[FloatArray, FloatArray]:
        """Position and velocity of seen rows, (rows,), with axes separated by range."""

        def scale(values: FloatArray) -> FloatArray:
            return values / (float(np.max(np.abs(values), initial=0.0)) or 1.0)

        where = [3.0 * k + scale(q[s]) for k, (q, s) in enumerate(zip(self.position, self.seen, strict=True))]
        speed = [scale(v[s]) for v, s in zip(self.velocity, self.seen, strict=True)]
        return np.concatenate(where), np.concatenate(speed)

    def place(self, axis: int, column: FloatArray) -> FloatArray:
        """Expand columns of one axis to the rows of all axes."""
        everywhere = np.zeros_like(self.error)
        everywhere[axis if column.ndim == 1 else slice(None)] = column
        return self.stack(everywhere)


def is_noise(left: float, white: Whiteness | None) -> bool:
    """Test whether a residual is small, or not significantly coloured."""
    return left < _LEFT or white is None or white.white or white.p_value > _SURE


def torques_of_loop(problem: ClosedLoopProblem, x: FloatArray) -> AxisTorques:
    """Measured and simulated torque of a solved joint problem, without fault shapes."""
    run, (error, slopes) = problem.simulate(x), problem.linearise(x)
    measured = problem.filter(problem.measured)
    path = problem.filter(np.column_stack([run.motor_position, run.motor_velocity]))
    step, rows = problem.sample_time * (problem.filtering.decimation or 1), measured.size
    return AxisTorques(
        np.asarray(problem.sample_time * problem.log.kept), step, problem.filtering.cutoff or math.inf,
        measured[np.newaxis], (measured - error)[np.newaxis], np.ones((1, rows), dtype=np.bool_),
        path[np.newaxis, :, 0], path[np.newaxis, :, 1], -slopes[np.newaxis], ((),),
    )  # fmt: skip


def torques_of_robot(estimate: Estimate, records: Sequence[Record]) -> AxisTorques:
    """Torques of a robot's records, with those predicted by its estimate.

    Raises:
        RecordError, MethodError: as of the identification.
    """
    part, settings = estimate.require_robot(), estimate.settings
    robot, n = part.model, len(part.model)
    known: list[list[FaultSignature]] = [[] for _ in robot.names]
    source: Any  # of the filter and the sample time
    motion: MeasuredMotion | None
    if not settings.simulates:
        inverse = inverse_of_robot(robot, part.parameters)
        source = motion = inverse.measure(records, settings.filtering).read_as(settings.timing)
        columns, torque, decimate = inverse.columns(source), source.torque, source.decimate_columns
        rows, followed = inverse.rows([source], [columns]), columns @ part.values
        measured, predicted, own = rows.Y, rows.W @ part.values, rows.W
    else:
        solved = estimate.solved or solve_again(part, records, settings.filtering)
        source = problem = solved.problem
        motion, torque, own = getattr(problem.log, "motion", None), problem.measured, solved.slopes
        measured, followed = problem.filtered_torque, problem.predict(solved.runs)
        predicted = measured - problem.error(solved.runs)

        def decimate(columns: FloatArray) -> FloatArray:
            return decimate_each(problem.log, list(np.moveaxis(columns, 1, 0)))

    def thin(columns: FloatArray) -> FloatArray:
        """Filter columns, (samples, n, columns), to (n, rows, columns)."""
        return np.asarray(decimate(columns)).reshape(n, -1, columns.shape[2])

    measured, predicted = measured.reshape(n, -1), predicted.reshape(n, -1)
    if motion is None:  # under controllers
        moved, rotors = Simulation.of(solved.runs[0]).motion, part.numbers().motors
        q, v, a = (one[:, rotors] for one in (moved.position, moved.velocity, moved.acceleration))
        known = _list_reference_laws(part, records, problem, predicted)
    else:
        q, v, a = (one @ robot.coupling.T for one in (motion.q, motion.v, motion.a))
    if not settings.simulates:
        bends = np.moveaxis(thin(_bend(part, source)), 2, 0).reshape(n, len(_ROTORS), n, -1)
        bent = FAULTS["compliance"]
        known = [[FaultSignature(bent, *each) for each in zip(one, _ROTORS, strict=True)] for one in bends]

    def list_faults(k: int) -> list[FaultSignature]:
        others = {name: (v[:, i], a[:, i]) for i, name in enumerate(robot.names) if i != k}
        motor, asked = (q[:, k], v[:, k], a[:, k]), torque[:, k]
        axis = Seen(*motor, asked, followed[:, k], asked, source.sample_time, np.negative, others=others)
        return [*list_signatures(axis)]

    found = in_threads(list_faults, range(n))
    columns = thin(np.stack([np.column_stack([one.column for one in all_of]) for all_of in found], axis=1))
    shapes = tuple(
        (*(replace(one, column=columns[k, :, i]) for i, one in enumerate(all_of)), *known[k])
        for k, all_of in enumerate(found)
    )
    path, step = thin(np.stack([q, v], axis=2)), source.sample_time * source.filtering.decimation
    time = step * np.arange(measured.shape[1]) if motion is not None else source.sample_time * source.log.kept
    judged = np.ones(measured.shape)
    if motion is not None:  # a row beside an excluded sample contains some of it, and less noise
        judged = motion.decimate_columns(np.ones((*motion.q.shape, 1)))[:, 0].reshape(n, -1)
    return AxisTorques(
        records[0].on_clock(time), step, source.filtering.cutoff, measured, predicted,
        judged > 0.9, path[:, :, 0], path[:, :, 1],
        own.reshape(n, -1, own.shape[1]), shapes, along_measured_motion=motion is not None,
    )  # fmt: skip


def _bend(part: IdentifiedRobot, motion: MeasuredMotion) -> FloatArray:
    """Torques per unit compliance of each joint, (samples, n, n shares).

    A compliance lets the links turn back under their torque, while the motors keep their motion. The rotor's share of
    the joint's inertia is unknown if both are one base parameter, so several shares are tried.
    """
    n = len(part.model)
    sums = part.parameters  # a rotor may begin a sum with its link
    of_links = sums.inertial & np.any(sums.of_standard[:, : len(SYMBOLS) * n], axis=1)
    values = np.where(of_links, part.values, 0.0)

    def through(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return np.asarray(sums.columns(part.model, q, v, a) @ values)

    q, v, a, raw = motion.q, motion.v, motion.a, motion.raw
    still, found = through(q, v, a), []
    for k, unit in enumerate(np.eye(n)):
        limit = find_noise_limit([raw[:, k]], motion.sample_time, derivative=4)
        own = (through(q, v, a + unit) - still)[:, k]
        for share in _ROTORS:  # the rotor's own torque does not wind the spring
            back = [lowpass(share * own * a[:, k] - still[:, k], limit, motion.sample_time)]
            for _ in range(2):
                back.append(np.gradient(back[-1], motion.sample_time))
            by = _TURN / (float(np.max(np.abs(back[0]))) or 1.0)
            turned, turning, pushed = (by * np.outer(one, unit) for one in back)
            moved = (through(q + turned, v + turning, a + pushed) - still) / by
            found.append(moved - share * np.outer(own * back[2], unit))
    return np.stack(found, axis=2)


def _list_reference_laws(
    part: IdentifiedRobot, records: Sequence[Record], problem: Simulated, predicted: FloatArray
) -> list[list[FaultSignature]]:
    """Torque changes by other uses of a joint's reference, per size, (rows,).

    One simulation of each use serves all joints at once, since a joint's reference hardly affects another's torque.
    `predicted` has the filtered torques of the problem, (n, rows).
    """
    setup, log, each = cast("RobotLoop", part.setup), problem.sample_time, list[dict[Fault, Any]]()
    for law, record, read in zip(setup.controllers, records, problem.log.experiment.axes, strict=True):
        variants = (first for first, *_ in list_variants(law, record, log, read.law.period))
        each.append({one.fault: one.controller for one in variants if one.fault in OF_REFERENCE})
    found: list[list[FaultSignature]] = [[] for _ in each]
    for fault in dict.fromkeys(fault for laws in each for fault in laws):
        laws = tuple(own.get(fault, law) for own, law in zip(each, setup.controllers, strict=True))
        with contextlib.suppress(JointidError):  # a log that such a controller cannot have
            other = pose_robot(replace(setup, controllers=laws), records, problem.parameters, problem.filtering)
            if (run := other.run_of(part.numbers(), keep=False)) is None:
                continue
            moved = other.by_joint(decimate_each(other.log, list(other.predict(run).T))) - predicted
            shown, size = replace(fault, one_sided=True, least=_OF_ROBOT), 1.0
            if fault is AVERAGED:
                shown, size = replace(fault, one_sided=True, measure="ms"), SCREENED * log
            for k in (k for k, own in enumerate(each) if fault in own):
                found[k].append(FaultSignature(shown, moved[k] / size))
    return found
