"""IDIM: inverse dynamic model regressed on measured positions, by several estimators.

Torque and columns are those of `problems.inverse_model`, of a joint or of all joints of a robot at once; the estimators
are those of `problems.regression`. A robot has base parameters and friction.

**Instruments** come from the closed loop simulated at the estimate itself [Janot, Vandanjon, Gautier 2014]. The
simulated motion is driven by the reference and the known signal alone, so noise and disturbances of the record do not
reach it; positions go through the same filters as the measured ones, and their columns are the instruments Z of
``Z' (Y - W x) = 0``. The next estimate is simulated in turn until nothing changes: two to five simulations. Instruments
need not be perfect, only free of the record's noise: values outside their bounds are simulated at the bound.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parameters import Bounds, Parameter
from jointid.common.settings import add_settings_to_docstring, setting
from jointid.common.text import join, pluralise
from jointid.estimation.methods import Method, Task
from jointid.estimation.parameters import robot_parameters
from jointid.estimation.problems.inverse_model import (
    ENCODER_OFFSET,
    POSITIONS,
    Inverse,
    MeasuredMotion,
    filter_motion,
    inverse_of_joint,
    inverse_of_robot,
    through_window,
    turn,
)
from jointid.estimation.problems.regression import Estimator, Instruments, Solution, solve_rows
from jointid.estimation.problems.simulated import require_free
from jointid.estimation.result.estimate import Estimate, Settings, build_estimate, build_rows
from jointid.estimation.result.verdict import Check, Reason, Subject, check_of
from jointid.estimation.robots.simulated import IdentifiedRobot, rows_of_robot
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, describe_noise_limit
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome, motion_at, run_loop
from jointid.simulation.start import Initial
from jointid.uncertainty.covariance import LEVEL, SHOWN
from jointid.uncertainty.identifiability import conditioning
from jointid.uncertainty.model_tests import durbin_wu_hausman

VARIANTS = {  # how it was run
    "ols": "IDIM by ordinary least squares",
    "weighted": "IDIM by weighted least squares, each joint and record by the size of its error",
    "iv": "IDIM by instrumental variables from the simulated loop",
}


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class IDIM(Method):
    """Settings of IDIM."""

    name = "idim"
    title = "IDIM"
    default_for = Joint, Robot
    robots = Robot, RobotLoop
    stacks = True

    estimator: Estimator | None = setting(
        None,
        "ols, ordinary least squares; weighted, each record and each joint of a robot by the size of its error; "
        "iv, instruments from the simulated loop, for which the controller is needed; without it ols for one record "
        "of a joint, else weighted",
    )

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from torque, motor position and, if flexible, load position.

        The standard deviations are those of the regression, robust to autocorrelation. They do not cover errors that
        repeat with the motion. Only instruments cover noise and disturbances in the positions.

        Raises:
            RecordError: a channel is missing or cannot be used.
            MethodError: the record does not determine the parameters, or instruments have no loop to come from.
        """
        record, joint, loop = task.record, task.joint, task.loop
        record.require(("torque",), "IDIM")
        assert record.torque is not None
        require_free(task.parameters)
        delay = loop.controller.law(record.torque.sample_time).delay if loop else 0.0
        inverse, known = inverse_of_joint(joint, delay, task.parameters), {p.name: p for p in task.parameters}
        read = ["torque", *(loop.controller.channels if loop and self.estimator == "iv" else ())]
        read += [*POSITIONS[: len(joint.sides)], *(("injected",) if record.injected is not None else ())]

        def state(solved: Solution) -> dict[str, Any]:
            stated = [p for p in solved.fix(inverse.parameters.parameters) if p.free or p.name in known]
            pair = solved.values, solved.covariance.std
            values, std = (dict(zip(solved.rows.names, one.tolist(), strict=True)) for one in pair)
            return {"rows": build_rows(stated, values, std, joint.unit, known, solved.held)}

        logs = [[one] for one in (record, *task.others)]
        return self._regress(inverse, loop, logs, task.filtering, known, state, channels=read)

    def identify_robot(
        self, model: Robot | RobotLoop, logs: Sequence[Sequence[Record]], filtering: Filtering,
        known: Mapping[str, Parameter], progress: Progress,
    ) -> Estimate:  # fmt: skip
        """Identify a robot's base parameters and friction from motor positions and torques.

        Valid for joints that are rigid in the band of the filter: below about a fifth of the first resonance.

        Args:
            model: its geometry, gravity and coupling are taken as known; its masses serve only for comparison.
                With controllers it is simulated by the estimator "iv".
            logs: of each joint a record, with torque and motor position behind the gear, on one clock.
            filtering: of positions and rows.
            known: values and bounds of friction to keep, by name as "joint1.viscous".
            progress: receives nothing.

        Raises:
            MethodError: the records do not determine all base parameters; the sentence names those involved. Or "iv"
                has no loop, or cannot simulate it.
            RecordError: a channel is missing, or the joints' records have not one clock.
        """
        declared = model.robot
        declared.require_linear("IDIM of a robot takes", 'identify the robot by "didim"')
        if of_links := [name for name in known if ".link_" in name]:
            raise MethodError(
                f"{join(of_links)} is of the link's side, and to IDIM a joint is rigid, with the friction of both "
                "sides: leave it out."
            )
        warnings, robot = list[str](), declared.rigid
        if soft := [joint.name for joint in declared.joints if joint.spring is not None]:
            warnings.append(
                f"The robot file has springs at {join(soft)}, and to IDIM every joint is rigid: that holds below a "
                "fifth of the modes; lower filtering.cutoff to it, or identify by didim or drive_side."
            )
        loop = replace(model, robot=robot) if isinstance(model, RobotLoop) else None
        parameters = robot_parameters(robot, whole=False)

        def state(solved: Solution) -> dict[str, Any]:
            found = replace(parameters, parameters=solved.fix(parameters.parameters))
            part = IdentifiedRobot(loop or robot, found, solved.values)
            rows, masses, nominal = solved.rows, found.inertial, found.group(Numbers.of(robot))
            # The identified friction makes up for identified inertias: beside nominal ones it is fitted anew.
            left = rows.Y - rows.W[:, masses] @ nominal[masses]
            nominal[~masses] = np.linalg.lstsq(rows.W[:, ~masses], left, rcond=None)[0]
            return {
                "rows": rows_of_robot(part, solved.covariance.std, solved.held, {}, nominal),
                "robot": part,
                "nominal": rows.relative_errors(nominal),
            }

        return self._regress(inverse_of_robot(robot, parameters), loop, logs, filtering, known, state, warnings)

    def _regress(
        self,
        inverse: Inverse,
        loop: ClosedLoop | RobotLoop | None,
        logs: Sequence[Sequence[Record]],
        filtering: Filtering,
        known: Mapping[str, Parameter],
        state: Callable[[Solution], dict[str, Any]],
        warnings: Sequence[str] = (),
        **parts: Any,
    ) -> Estimate:
        """Estimate of a joint or robot; `state` makes rows and other parts."""
        estimator: Estimator = self.estimator or ("weighted" if inverse.driven * len(logs) > 1 else "ols")
        motions, make, solved = [inverse.measure(log, filtering) for log in logs], None, None
        common = min((motion.filtering for motion in motions), key=lambda one: one.cutoff or np.inf)
        if any(motion.filtering != common for motion in motions):
            motions = [inverse.measure(log, common) for log in logs]
        if estimator == "iv" and loop is not None:
            make = simulate_columns(inverse, loop, logs, motions)
        rows = inverse.rows(motions if make else [part for motion in motions for part in motion.split()])
        rows = rows if len(logs) > 1 else replace(rows, series=())  # of several, parts of long ones count as records
        if ENCODER_OFFSET in inverse.parameters:
            with suppress(MethodError):  # nothing separates it from the other forces
                solved = solve_rows(rows, estimator, {**known, ENCODER_OFFSET.name: ENCODER_OFFSET}, make)
        slight = 1e-3 * float(np.sqrt(np.mean(rows.Y**2)))  # as much is left by filters
        if solved is None or not abs(solved.values[-1]) > max(SHOWN * solved.covariance.std[-1], slight):
            solved = solve_rows(rows, estimator, {**known, ENCODER_OFFSET.name: ENCODER_OFFSET.fix(0.0)}, make)
        free, values = solved.free, solved.values
        limit, model = min(one.limit for one in motions), "flexible" if rows.equations > rows.driven else "rigid"
        noted = describe_noise_limit(common, limit, motions[0].sample_time, model)
        torques, motions = torques_along(inverse, motions, solved), []  # motions of long records take much memory
        end = "settled" if solved.converged else "still changing"
        made = build_estimate(
            records=[record for log in logs for record in log],
            correlation=solved.covariance.correlation[np.ix_(free, free)],
            torques=torques,
            error=solved.rows.relative_errors(values),
            fitted=solved.residual.size,
            end=(f"{end} after {pluralise(solved.turns, 'solution')}", solved.converged),
            simulations=solved.turns if make else 0,
            checks=() if solved.instruments is None else (_compare_instruments(solved, solved.instruments),),
            settings=Settings(
                self.name, VARIANTS[estimator], inverse.system, None, common, inverse.delay, timing=solved.timing
            ),
            warnings=(*solved.said, *noted, *warnings),
            **state(solved),
            **parts,
        )
        return replace(made, fit=replace(made.fit, conditioning=conditioning(rows.W[:, free], values[free])))


def _compare_instruments(solved: Solution, Z: FloatArray) -> Check:
    """Check whether least squares would agree with the instruments."""
    rows, free, per_row = solved.rows, solved.free, solved.scale[:, np.newaxis]
    W, left = rows.W[:, free] / per_row, solved.residual / solved.scale
    p_value = durbin_wu_hausman(W, left + W @ solved.values[free], Z / per_row, rows.equations)
    rejected = p_value < LEVEL
    said = "columns are correlated with errors" if rejected else "nothing speaks against least squares"
    said = f"{said} (p = {p_value:.2g}): its values {'are biased' if rejected else 'agree with these'}"
    return check_of(Subject.INSTRUMENTS, not rejected, Reason.MOTION_MEASURED, said, {"p_value": p_value})


def torques_along(inverse: Inverse, motions: list[MeasuredMotion], found: Solution) -> tuple[FloatArray, FloatArray]:
    """Measured and modelled torques of the motors as logged, (samples, n) each."""
    n, measured, predicted = inverse.driven, list[FloatArray](), list[FloatArray]()
    for motion in (part for whole in motions for part in whole.split()):
        predicted.append(through_window(inverse.columns(motion)[:, :n] @ found.values, motion.filtering))
        measured.append(motion.read_as(found.timing).torque[:, :n])
    return np.vstack(measured), np.vstack(predicted)


def simulate_columns(
    inverse: Inverse, loop: ClosedLoop | RobotLoop, logs: Sequence[Sequence[Record]], motions: Sequence[MeasuredMotion]
) -> Instruments:
    """Function that computes instruments: columns along a candidate's simulated motion.

    Parameters outside of their bounds are simulated at the bound. Rows at which a measured mass rests or reverses
    are left out, as in the measured columns; the motor of a joint begins in its measured state.

    Raises:
        RecordError: a record lacks a channel that its controller reads, or a clock does not divide the controllers'.
        MethodError: controllers or logs share no clock.
    """
    bounds, experiments = Bounds.of(inverse.parameters.parameters), [prepare(loop, log) for log in logs]

    def instruments(values: FloatArray) -> FloatArray:
        numbers, each = inverse.parameters.numbers(bounds.clip(values)), list[FloatArray]()
        for experiment, motion in zip(experiments, motions, strict=True):
            initial = Initial(float(motion.q[0, 0]), float(motion.v[0, 0])) if experiment.tree is None else None
            run = run_loop(experiment, numbers, initial, keep=True)
            if run.outcome is not Outcome.FINISHED:
                raise MethodError(
                    f"The instruments of IV come from a simulation, but with these values {run.outcome.value}; check "
                    "the controllers' gains, or use another estimator."
                )
            size, positions = len(motion.q), motion_at(run, experiment.clock.log_index).position[: len(motion.q)]
            whole = np.pad(positions, ((0, size - len(positions)), (0, 0)), "edge")
            q, v, a = filter_motion(whole, motion.sample_time, motion.filtering)
            each.append(inverse.columns(turn(inverse.system, replace(motion, q=q, v=v, a=a))))
        return inverse.rows(motions, each).W

    return instruments
