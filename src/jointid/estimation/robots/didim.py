"""Search of a robot's parameters, by DIDIM or on the drive side.

The robot is simulated (`problems.simulated`), and the torque error of all joints is made least by steps of Levenberg
and Marquardt with derivatives by variation. The joints are weighted by their errors, which are estimated anew until
they settle; the covariance is robust to autocorrelation (`uncertainty.covariance`). Viscous and Coulomb friction are
not let below 0. Under its controllers the robot is at rest at the first sample, or moving as its references do.

**Rigid joints** begin at the inverse model's estimate on the motion that the records imply. Valid for rigid joints, or
below about a fifth of the first resonance.

**Flexible joints**, with rotors' inertias and stiffnesses on a logarithmic scale:

1. The robot of rigid joints, split into rotors, springs and links (`spring_search`).
2. A frequency for each spring, given or the best of a row of them; and a rough descent from there.
3. If that fails: rough descents from one frequency of all springs, and from stiff springs. Of 200 random
   robots four, split into wrong rotors, were best at wrong frequencies, and all converged from one frequency of all.
4. If no spring is visible then, the answer is that none is shown. A further search would take minutes along
   undetermined directions.
5. A close descent, and fine ones. A search may leave a wrong minimum after the joint that led it there has less weight.

Each joint is tested for a visible spring by its compliance c = 1/K, which is 0 for a rigid joint. The spring
is shown if c is more than four of its standard deviations above 0, with the spring not at the
stiffest of the search. Otherwise the stiffness is refused, and ``1 / (c + 2 std)`` is its lower bound. Valid
for springs that are linear and tie each rotor to its own link, and rotors that turn fast against the links: their
gyroscopic torques are left out [Spong 1987].

**Laws that are not linear**, and free delays of the torques, are searched from the end with linear ones, axis by axis.
As for one joint (`estimation.descent`) every start of an axis's laws is followed for a few steps, and the best is kept.
The axes before it have their laws then, those after it lines. Finally all are searched together to the full tolerance.
Free delays come before the laws: a law is found only if torque and motion are in time. If no delay is declared,
that search begins at the best rigid robot of several delays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.common.text import join, pluralise
from jointid.estimation.descent import ROUGH, History, Solved, law_starts
from jointid.estimation.methods import Method, default_method
from jointid.estimation.parameters import (
    DELAYS,
    Parameters,
    add_delays,
    apply_constraints,
    find_free_delays,
    name_in_robot,
    robot_parameters,
    with_delays,
)
from jointid.estimation.problems.inverse_model import Records, each_log
from jointid.estimation.problems.simulated import Runs, Simulated, outcome_of, pose_robot
from jointid.estimation.rigid_starts import start_rigid_robot
from jointid.estimation.spring_search import LITTLE, STIFFEST, SplitRobot
from jointid.models.controllers import numbers_of
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import DELAY, values_of_joint
from jointid.simulation.simulate import Outcome
from jointid.solvers.solve import LevenbergMarquardt, Status
from jointid.uncertainty.covariance import INTERVAL, SHOWN, Covariance, Influence, white
from jointid.uncertainty.identifiability import find_separable

SLOW = Filtering(cutoff=4.0)
"""Below the modes, where a robot is as good as rigid."""

_NONE = 1e-9  # N m: bounds of an undetermined torque
_ROUGH, _CLOSE = (3e-2, 1e-2), (1e-3, 1e-4)  # tolerance, and what a step is to promise: shares of the criterion


@dataclass(frozen=True, slots=True, eq=False)
class RobotFit:
    """The fit of a robot to the records of its joints.

    Attributes:
        problem: solved, weighted by the joints' filtered errors.
        x: (free,) search variables at the end.
        runs: simulations at x.
        slopes: (rows, free) derivatives of their filtered torques by the search variables, not weighted.
        covariance: of the errors of `values`.
        relative_error: (n,) of the filtered torques, a share each.
        iterations: their number.
        converged: whether the search settled.
        springs: of each flexible joint by name, None if the records show its spring, else a lower bound of its
            stiffness; the intervals of that one, and of its joint's two sides, are invalid.
    """

    problem: Simulated
    x: FloatArray
    runs: Runs
    slopes: FloatArray
    covariance: Covariance
    relative_error: FloatArray
    iterations: int
    converged: bool
    springs: Mapping[str, float | None]

    @property
    def parameters(self) -> Parameters:
        """Parameters of the identified problem."""
        return self.problem.parameters

    @property
    def values(self) -> FloatArray:
        """The parameters, (parameters,)."""
        return self.parameters.values(self.x)

    def value(self, name: str) -> tuple[float, float]:
        """Return a parameter and its standard deviation."""
        at = self.parameters.names.index(name)
        return float(self.values[at]), float(self.covariance.std[at])


def conclude(end: Solved, made: int, most: float = 1.0 / SHOWN) -> RobotFit:
    """Fit at the end of a search; for `most` see `_judge_springs`.

    Raises:
        MethodError: the robot cannot be simulated there, or explains none of the torque; or a friction that grows with
            the torque is not told from others, see `find_separable`.
    """
    problem, x, runs = end.problem, end.x, end.problem.run(end.x)
    if (outcome := outcome_of(runs)) is not Outcome.FINISHED:
        raise MethodError(
            f"The search led to where the robot cannot be simulated: {outcome.value}. Record a livelier motion, "
            "name a livelier log first, leave out springs of stiff joints, or declare simpler laws."
        )
    error, J = linearise_again(end)
    left = problem.norms(error) / problem.sizes
    if np.all(left > 1.0):
        raise MethodError(
            f"The search ended at a robot that leaves {100 * float(np.min(left)):.3g} % or more of the torque of every "
            "joint, more than one without any torque: check units and signs, or record a livelier motion."
        )
    names, scales = [p.name for p in problem.free], problem.parameters.scales(x)
    together = [name for name, separable in zip(names, find_separable(J), strict=True) if not separable]
    if any(name.endswith("friction_per_torque") for name in together):
        raise MethodError(
            f"The records do not show {join(together)} apart: where the torque never brakes, a share of it scales them "
            "all. Identify records with other known loads in one fit, or brake harder."
        )
    problem = problem.reweight(error, x.size)
    influence = Influence(problem.weigh(J), problem.weigh(error), None, len(problem.sigma), problem.series)
    covariance = influence.robust()
    if problem.log.motion_measured:
        covariance = influence.widen_for_motion(covariance)
    known = zip(names, covariance.std, strict=True)
    if untold := [n for n, s in known if n.endswith(f".{DELAY}") and not INTERVAL * s < DELAYS[-1]]:
        raise MethodError(
            f"The records do not show {join(untold)}: two standard deviations are more than {1e3 * DELAYS[-1]:g} ms. "
            "Move faster, record longer, or state the delay in [controller] and do not free it."
        )
    springs = _judge_springs(problem, x, covariance.std, most)
    covariance = replace(covariance, std=covariance.std * scales)
    return RobotFit(problem, x, runs, J, covariance, left, made, end.solution.status.converged, springs)


def _judge_springs(problem: Simulated, x: FloatArray, std: FloatArray, most: float) -> dict[str, float | None]:
    """Judge whether the records show the spring of each flexible joint, see `RobotFit`.

    A spring is shown if its stiffness is off its bound and its relative deviation, like the compliance's, is small.
    Else the stiffness is at least that of two standard deviations more of its compliance.

    Args:
        problem: of the robot.
        x: (free,) search variables, stiffnesses on a logarithmic scale.
        std: (free,) its deviations.
        most: largest relative deviation of a stiffness.
    """
    found = dict[str, float | None]()
    for parameter, place, value, share in zip(problem.free, problem.parameters.keys, x, std, strict=True):
        if place.name == "stiffness":
            shown = 0.0 < share < most and value < parameter.upper - 1e-3  # off its bound
            least = math.exp(value) / (1.0 + INTERVAL * float(share))
            found[parameter.name.rpartition(".")[0]] = None if shown else least
    return found


def linearise_again(end: Solved) -> tuple[FloatArray, FloatArray]:
    """Unweighted error, (rows,), and torque derivatives, (rows, free), at an end."""
    weights = end.problem.weigh(np.ones(end.solution.residual.size))
    return end.solution.residual / weights, -end.solution.jacobian / weights[:, np.newaxis]


def search_robot(
    setup: Robot | RobotLoop,
    records: Records,
    filtering: Filtering | None = None,
    settings: Method | None = None,
    *,
    known: Mapping[str, Parameter] | None = None,
    progress: Progress = ignore_progress,
) -> RobotFit:
    """Identify a robot from torques and references, or along its motors' motion.

    For the arguments see `robots.simulated.identify_simulated_robot`; records are of one log or several. Of the robot's
    numbers only the links' places and gravity are read. To show a spring the motion must excite its mode, as a
    multisine on top of it does.

    Raises:
        RecordError: a record lacks a channel, or has the wrong clock or unit.
        MethodError: the records do not determine the parameters, nothing can be simulated at the start, a frequency is
            missing, a robot of rigid joints explains the torques better than the identified springs, or one of
            several logs along a motion begins in motion.
    """
    how: Any = settings or default_method(setup)
    history = History(progress, evaluations=how.evaluations)
    return _Search(setup, how.simulates == "motion", records, filtering, how, dict(known or {}), history).search()


@dataclass(slots=True)
class _Search:
    """Search of a robot with counted evaluations; arguments as of `search_robot`."""

    setup: Any
    along: bool
    records: Records
    filtering: Filtering | None
    how: Any
    known: dict[str, Parameter]
    history: History

    def pose(
        self, under: Any, through: Filtering | None, freed: Sequence[int] = (), *, rigid: bool = False
    ) -> Simulated:
        """Problem of a robot with some free delays, and stated log delay."""
        records = self.records
        stated = all(record.torque.stated for log in each_log(records) for record in log if record.torque is not None)
        parameters = robot_parameters(under.robot, offsets=self.how.offsets, logarithmic=True, whole=not self.along)
        parameters = add_delays(apply_constraints(parameters, self.known), under, freed)
        delay = self.how.log_delay if self.along and not rigid else 0.0
        return pose_robot(under, records, parameters, through, delay, stated=stated)

    def search(self) -> RobotFit:
        """Fit rigid joints or springs with linear laws, then delays and laws."""
        robot = self.setup.robot
        if self.along:
            robot.require_linear("The drive side of a robot takes", 'identify the robot by "didim"', springs=True)
            return self.find_springs(self.setup)
        late, near = find_free_delays(self.setup, self.how.free), replace(self.setup, robot=robot.linear)
        if any(robot.flexible):
            found = self.find_springs(near)
        else:
            found, near = self.find_near_delay(near, late)
        return self.find_laws(found, near, late) if late or robot.linear.joints != robot.joints else found

    def find_near_delay(self, near: RobotLoop, late: tuple[int, ...]) -> tuple[RobotFit, RobotLoop]:
        """Best rigid robot and its loop, at several delays if undeclared."""
        undeclared = [j for j in late if not numbers_of(near.controllers[j]).get(DELAY)]
        ends, failures = list[tuple[RobotFit, RobotLoop]](), list[MethodError]()
        for one in DELAYS if undeclared else (0.0,):
            try:
                under = with_delays(near, dict.fromkeys(undeclared, one))
                ends.append((self.find_rigid(under, self.filtering), under))
            except MethodError as error:  # no robot is stable with such a delay
                failures.append(error)
        if not ends:
            raise failures[0]
        return min(ends, key=lambda end: float(np.linalg.norm(end[0].relative_error)))

    def find_rigid(self, under: Any, through: Filtering | None, turns: int = 4) -> RobotFit:
        """Return the fit of rigid joints, reweighted `turns` times at most.

        Raises:
            MethodError: the robot cannot be simulated there, or the records do not determine its parameters.
        """
        problem = self.pose(under, through, rigid=True)
        if not self.along and any(one is not None and one.axis.law.integrates for one in problem.log.seen):
            # No position shows a constant torque: the integral takes whatever is added.
            hidden = {p.name: replace(p, lower=-_NONE, upper=_NONE) for p in problem.free if p.name.endswith(".offset")}
            problem = replace(problem, parameters=apply_constraints(problem.parameters, hidden))
        if self.along:
            # To leave rows out is to multiply by what switches, and that brings the modes, which this robot has not,
            # down to what is slow: of a twin of six joints it left 23 % of a joint's torque, and 4 % with the rows.
            problem = problem.map_logs(lambda log: log.with_rows(np.ones_like(log.motion.moving)))
            x = np.zeros(len(problem.free))
        else:
            x = start_rigid_robot(problem, under, each_log(self.records)[0])
        return _settle(problem, _descend(problem, x, _ROUGH, self.history), self.history, turns)

    def find_springs(self, near: Any) -> RobotFit:
        """Search the flexible robot of least torque error from the rigid one.

        Raises:
            MethodError: nothing can be simulated at the start, or a robot of rigid joints explains the torques better.
        """
        problem = self.pose(near, self.filtering)
        _require_springs(near.robot, self.how.frequencies, problem.sample_time)
        rigid = near.robot.rigid
        rigid = self.find_rigid(rigid if self.along else replace(near, robot=rigid), SLOW, 1)
        problem = problem.reweight(problem.error(rigid.runs), rigid.x.size)
        found = self.find_springs_from(problem, problem.roughly(), rigid)
        if self.along and problem.roughly() is not problem and None not in found.springs.values():
            self.history.progress("no spring is seen by the beginning of the record; searching along all of it")
            return self.find_springs_from(problem, problem, rigid)
        return found

    def find_springs_from(self, problem: Simulated, rough: Simulated, rigid: RobotFit) -> RobotFit:
        """Search the springs of a robot from a rigid one, roughly first."""
        history, names, given = self.history, self.setup.robot.names, self.how.frequencies
        start = SplitRobot.of(rough, rigid)
        hertz = np.array([given.get(name, 0.0) for name in names]) if given else start.search()
        for i in np.flatnonzero([] if given else hertz):
            history.progress(f"{names[i]}: its mode is searched from {hertz[i]:.3g} Hz")
        problem, rough = start.bound(problem), start.bound(rough)
        error = rough.error(rough.runs_of(rigid.problem.numbers(rigid.x)))
        without = float(np.linalg.norm(rough.weigh(error)))

        def begin(hertz: FloatArray | float) -> Solved:
            x = rough.parameters.to_search_variables(start.values(hertz))
            return _descend(rough, x, _ROUGH, history, 12)  # evaluations of a rough descent, mostly enough

        end = begin(hertz)
        if end.solution.status is Status.NOT_EVALUABLE:
            raise MethodError(
                f"The robot cannot be simulated where its search begins: {outcome_of(rough.run(end.x)).value}. "
                "Give other frequencies, or a record in which all joints move more."
            )
        for common in 11.25, 16.875, 25.3125:  # Hz of all springs, where the first descent leads nowhere
            trace, left = end.solution.trace, end.problem.norms(linearise_again(end)[0])
            falls = not end.solution.status.converged and len(trace) > 1 and trace[-1] < 0.7 * trace[-2]
            leads_on = falls or np.all(left <= LITTLE * end.problem.sizes)
            if common < start.stiff and not leads_on and end.norm <= without:
                end = min(end, begin(common), key=lambda one: one.norm)
        lost = not end.solution.status.converged and end.norm > without
        if lost:  # no better than without springs: one that has none, or high modes, is found from stiff ones
            end = begin(start.stiff)
        known = white(end.solution.jacobian, end.solution.residual)
        hopeful = None in _judge_springs(end.problem, end.x, known.std, 1.0 / INTERVAL).values()
        if not hopeful or (lost and end.norm > without):  # a longer search would find none
            with suppress(MethodError):
                seen = _go_on(replace(problem, sigma=rough.sigma), end, _CLOSE, history, evaluations=1)
                seen = seen._replace(solution=replace(seen.solution, status=end.solution.status))
                return conclude(seen, history.counted.evaluations, most=0.0)
        fit = _settle(problem, _go_on(_reweight(end), end, _CLOSE, history), history)
        if np.all(problem.norms(problem.error(fit.runs)) >= problem.norms(problem.error(rigid.runs))):
            raise MethodError(
                "A robot of rigid joints explains the torque of every joint better than the one that the search of "
                "springs ended at; leave the springs out of the robot file, or excite their modes by a multisine."
            )
        return fit

    def find_laws(self, linear: RobotFit, near: RobotLoop, late: tuple[int, ...]) -> RobotFit:
        """Search free delays, then nonlinear laws by axis, from linear ones.

        Raises:
            MethodError: an axis cannot be simulated at any start of its laws, or where the search ends.
        """
        robot, sigma, history = self.setup.robot, linear.problem.sigma, self.history
        given = dict(self.known)
        self.known |= {p.name: p for p in linear.parameters.parameters}  # springs have bounds that a search gave them
        numbers, values = linear.problem.numbers(linear.x), linear.problem.values(linear.x)
        changed = [i for i, joint in enumerate(robot.joints) if joint.linear != joint]
        for i in (*([-1] if late else []), *changed):
            joints = (*robot.joints[: i + 1], *(other.linear for other in robot.joints[i + 1 :]))
            problem = self.pose(replace(near, robot=replace(robot, joints=joints)), self.filtering, late)
            problem = replace(problem, sigma=sigma)
            values |= {p.name: p.start for p in problem.free if p.name not in values and p.start is not None}
            starts, what = [values], "delays of the torques"
            if i >= 0:
                joint = robot.joints[i]
                what, full = f"laws of {joint.name}", partial(name_in_robot, joint.name)
                stated = {p.name: given[full(p.name)].start for p in joint.model.parameters if full(p.name) in given}
                at = values_of_joint(numbers, i)
                each = law_starts(joint.model, joint.linear.model, at, linear.runs[0], i, stated)
                starts = [values | {full(name): x for name, x in one.items()} for one in each]
            history.progress(f"looking for the {what}, from {pluralise(len(starts), 'start')}")
            rough = problem.roughly()
            best = history.search(rough, map(rough.vector, starts), ROUGH)
            if not best.solution.jacobian.any():
                raise MethodError(
                    f"The robot cannot be simulated where the search of the {what} begins: "
                    f"{outcome_of(rough.run(best.x)).value}. Declare simpler laws, or state starts of "
                    "their parameters."
                )
            values, numbers = problem.values(best.x), problem.numbers(best.x)
            sigma = _reweight(best).sigma
        return _settle(problem, _go_on(_reweight(best), best, _CLOSE, history), history)


# Descents


def _go_on(
    problem: Simulated, end: Solved, aim: tuple[float, float], history: History, evaluations: float = math.inf
) -> Solved:
    """Descend from an end, with other weights or simulated finer."""
    if problem.logs is end.problem.logs:  # it is linearised there
        error, slopes = linearise_again(end)
        history.counted.problem = problem
        history.counted.remember(end.x, problem.weigh(error), problem.weigh(-slopes))
    return _descend(problem, end.x, aim, history, evaluations)


def _descend(
    problem: Simulated, x: FloatArray, aim: tuple[float, float], history: History, evaluations: float = math.inf
) -> Solved:
    """Descend to a tolerance or predicted gain, in steps of limited size."""
    (tolerance, worth), limit = aim, int(min(evaluations, history.evaluations))
    reach, exact = problem.parameters.reach(problem.parameters.values(x)), problem.floor / float(np.max(problem.sigma))
    return history.solve(problem, x, LevenbergMarquardt(tolerance, limit, reach, worth, exact))


def _settle(problem: Simulated, end: Solved, history: History, turns: int = 4) -> RobotFit:
    """Descend to full tolerance, re-estimating the joints' errors until they settle."""
    for _ in range(turns):
        weighed = replace(problem, sigma=_reweight(end).sigma)
        # A step worth less than a tenth, in units of the noise, moves all parameters by 0.3 deviations.
        end = _go_on(weighed, end, (3e-5, 0.1 / end.solution.residual.size), history)
        if not end.solution.status.converged or np.all(np.abs(np.log(_reweight(end).sigma / weighed.sigma)) < 0.4):
            break
    else:  # the errors still change
        end = end._replace(solution=replace(end.solution, status=Status.EVALUATION_LIMIT))
    return conclude(end, history.counted.evaluations)


def _reweight(end: Solved) -> Simulated:
    """The problem reweighted by the errors at an end."""
    problem: Simulated = end.problem
    return problem.reweight(linearise_again(end)[0], end.x.size)


# Springs


def _require_springs(robot: Robot, frequencies: Mapping[str, float], sample_time: float) -> None:
    """Refuse robots without springs, and frequencies, Hz, missing or out of range."""
    flexible = [joint.name for joint in robot.joints if joint.spring is not None]
    if not flexible:
        raise MethodError(
            "No joint of this robot has a spring; give one a JointSpring, [joints.spring] of a robot file, or identify "
            "it as rigid, by idim or didim."
        )
    highest = STIFFEST / sample_time
    if frequencies and not (set(frequencies) == set(flexible) and all(0 < f <= highest for f in frequencies.values())):
        raise MethodError(
            f"frequencies has a number for each of {join(flexible)}, above 0 and up to {highest:g} Hz, of which a "
            f"record of this sample time shows something; received {dict(frequencies)}: correct it, or give none at "
            "all to have them searched."
        )
