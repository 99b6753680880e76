"""Identification of a joint without controller, along its measured motor motion.

Torque and motor position are enough, without a load encoder. The motor's motion comes from the record, filtered, and is
prescribed; the load is simulated behind it (`simulation.drive_side`), and the resulting torque is compared with the
measured one, equally filtered. The prediction is delayed by ``log_delay``, if that is free. A delay of
the measurement would let a fit shrink both sides to nothing. While the motor rests, its friction is
undetermined, and the torque not informative; these samples have no weight, on both sides and before the filter,
which would smear them. Nor have those about reversals of a rigid joint.

The search is that of a joint under its controller, along another run. Of a rigid joint the torque is linear in all but
the delay, so that any start will do; a flexible one begins at a rigid one below the resonance
(`spring_search`), and its search goes along the beginning of a long record.

A motor in a closed loop responds to disturbances, so its measured motion is correlated with the error, and least
squares is biased: the intervals are widened for that (`Influence.widen_for_motion`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.estimation.descent import ROUGHLY, History, Solved
from jointid.estimation.methods import EVALUATIONS, FREQUENCIES, OFFSETS, Method, Task
from jointid.estimation.parameters import LOG_DELAY, Parameters, log_delay
from jointid.estimation.problems.inverse_model import (
    SAID,
    MeasuredMotion,
    motion_along,
    moving_weights,
    steady_weights,
    torque_and_positions,
)
from jointid.estimation.problems.simulated import ClosedLoopProblem, MotionLog, require_free
from jointid.estimation.result.estimate import Estimate, Settings, build_estimate, rows_of_problem
from jointid.estimation.robots.simulated import identify_simulated_robot
from jointid.estimation.spring_search import FASTEST, is_followed, rigid_cutoff, row_of_frequencies, search_spring
from jointid.models.joints import Joint
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, describe_noise_limit
from jointid.simulation.drive_side import PARTS, prescribe
from jointid.simulation.plant import LOAD_STATE
from jointid.uncertainty.covariance import Influence

_LOAD_PARAMETERS = (
    Parameter(LOAD_STATE[0], "dq12(0)", Quantity.POSITION),
    Parameter(LOAD_STATE[1], "dv12(0)", Quantity.VELOCITY),
)


def motion_problem(
    records: Sequence[Record],
    joint: Joint,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    delay: Parameter,
) -> ClosedLoopProblem:
    """Problem of records' torques along measured motor motion, late by ``log_delay``."""
    require_free(parameters)
    if joint.ripple is not None and joint.ripple.side == "load":
        raise MethodError("The drive side takes a ripple of the motor; received one of the load: identify by DIDIM.")
    logs = [_motion_log(record, joint, filtering) for record in records]
    moves = [bool(moving_weights(log.motion.v[:, 0])[0]) for log in logs if joint.springs]
    if len(moves) > 1 and any(moves):
        raise MethodError(
            f"The motor moves at the first sample of record {moves.index(True) + 1}; expected that each of several "
            "begins at rest, of a flexible joint: cut it where the motor rests."
        )
    # A load at rest rests where it was left.
    first = tuple(replace(p, free=moves[0], start=0.0) for p in (_LOAD_PARAMETERS if moves else ()))
    every = Parameters.of_joint(joint, (*parameters, *first, delay))
    return ClosedLoopProblem(tuple(logs), every, np.ones((1, len(logs))), joint)


def _motion_log(record: Record, joint: Joint, filtering: Filtering) -> MotionLog:
    torque, (position,) = torque_and_positions(record, joint, ("motor_position",), "Drive-side identification")
    # How late the log shows the torque is searched, so its timing is taken as it is.
    stated, counts = [replace(torque, stated=True)], record.counts(position.size, torque.sample_time)[:, np.newaxis]
    motion = motion_along(stated, position[:, np.newaxis], filtering, model=joint.model, counts=counts)
    weights = moving_weights((motion.v * motion.counts)[:, 0])[:, np.newaxis]
    # The rounding of an encoder would have the load of a motor that rests begin where Coulomb friction drags it.
    prescribed = prescribe(motion.q, torque.sample_time, PARTS, resting=not weights[0, 0])
    if joint.model == "rigid":  # a spring smooths the jump of the load's acceleration at a reversal
        weights = steady_weights(motion)[1]
    motion = replace(motion, moving=weights * motion.counts, told=-math.inf)  # faint rows count, too
    return MotionLog(motion.torque, motion.filtering, motion, prescribed, PARTS)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class DriveSideFit(Method):
    """Settings of the drive-side identification."""

    name = "drive_side"
    title = "the drive-side method"
    robots = (Robot,)
    simulates = "motion"
    stacks = True

    log_delay: float | None = setting(
        None,
        "how much later than it acts the log shows the torque, negative for a command that comes first; without it "
        "estimated",
        unit="s",
    )
    offsets: bool = OFFSETS
    evaluations: int = EVALUATIONS
    frequencies: Mapping[str, float] = FREQUENCIES

    identify_robot = identify_simulated_robot

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque and motor position, whatever its controller.

        The position's cut-off should be five times the free-free frequency or more, the other one above it.

        Raises:
            RecordError: a channel is missing, or at another rate.
            MethodError: no start gives a joint with positive inertias.
        """
        records, history = (task.record, *task.others), History(task.progress)
        task.record.require(("torque", "motor_position"), "Drive-side identification")
        torque: Any = task.record.torque
        delay = log_delay(self.log_delay, torque.sample_time, stated=torque.stated)
        problem = motion_problem(records, task.joint, task.filtering, task.parameters, delay)
        motions: list[MeasuredMotion] = [_keep_reversals(log).motion for log in problem.logs]
        if task.joint.springs:
            found = _search_spring(records, problem, history).solution
        else:
            try:
                found = _fit_rigid(problem, history).solution
            except MethodError:  # of a light joint in noise only the reversals may show its inertia
                problem = problem.map_logs(_keep_reversals)
                found = _fit_rigid(problem, history).solution
        if len(records) > 1:
            left = np.split(found.residual, np.cumsum(problem.series)[:-1])
            pairs = zip(left, (float(np.sum(one.moving)) or 1.0 for one in motions), strict=True)
            sizes = [max(float(np.linalg.norm(e)), problem.floor) / math.sqrt(moving) for e, moving in pairs]
            problem = replace(problem, sigma=np.array([sizes]) / min(sizes))
            found = history.solve(problem, found.x).solution
        x, J, error = found.x, found.jacobian, found.residual
        influence = Influence(J, error, series=problem.series)
        covariance = influence.widen_for_motion(influence.widen_for_bands(influence.by_time()))
        # What moves nothing has no deviation, which is no deviation of 0; where nothing can be simulated, all of it.
        idle = np.asarray(~J.any(axis=0), dtype=np.bool_)
        covariance = replace(covariance, std=np.where(idle, np.nan, covariance.std))
        limit, resting = min(one.limit for one in motions), 1 - np.mean(np.vstack([one.moving for one in motions]))
        rests = f"the motor rests in {100 * resting:.0f} % of the record, where its torque says nothing of it"
        noise = describe_noise_limit(problem.filtering, limit, problem.sample_time, task.joint.model)
        late = -problem.values(x)[LOG_DELAY.name]
        return build_estimate(
            records, rows_of_problem(problem, x, covariance, error, J), covariance.correlation,
            (problem.measured, problem.predict(problem.run(x))), problem.filtered_error(error), error.size,
            (found.message, found.status.converged), history.counted.evaluations,
            Settings(self.name, "drive-side by least squares", problem.joint, None, problem.filtering, late),
            ("torque", "motor_position"), warnings=(*noise, *[rests] * bool(resting > SAID)),
        )  # fmt: skip


def _keep_reversals(log: Any) -> Any:
    return log.with_rows(moving_weights((log.motion.v * log.motion.counts)[:, 0])[:, np.newaxis])


def _search_spring(records: Sequence[Record], problem: ClosedLoopProblem, history: History) -> Solved:
    """Search from a rigid joint below the resonance; return the end."""
    joint, slow, delay = problem.joint, Filtering(cutoff=max(map(rigid_cutoff, records))), problem.around[-1]
    rigid = motion_problem(records, joint.rigid, slow, joint.rigid.parameters, delay)
    values, cutoff = _fit_rigid(rigid, replace(history, tolerance=ROUGHLY)).values, problem.filtering.cutoff or 0.0
    row = row_of_frequencies(0.05 * cutoff, min(1.5 * cutoff, FASTEST / problem.sample_time))
    near = search_spring(problem.roughly(), [(values, row)], problem.filtering, history)
    return replace(history, admits=partial(is_followed, problem)).solve(problem, near.x)


def _fit_rigid(problem: ClosedLoopProblem, history: History) -> Solved:
    """Return the fit of a rigid joint.

    Raises:
        MethodError: its inertia is not positive.
    """
    delay = problem.around[-1]
    linear = problem.keeping({delay.name: delay.start or 0.0})  # a torque of the wrong sign could be one far too late
    x = linear.vector({"inertia": 1.0})
    error, slopes = linear.linearise(x)
    values = linear.values(x - np.linalg.lstsq(slopes, error, rcond=None)[0])
    if values["inertia"] <= 0.0:
        raise MethodError(
            "Torque and motor position give no joint with positive inertias: one of them has the wrong sign (reverse "
            "record.channels.torque.sign), or they do not belong together."
        )
    return history.solve(problem, problem.vector(values))
