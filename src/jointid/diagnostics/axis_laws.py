"""Other ways of the references of a robot's joints: held, by lines, by cubics, late, or averaged by the drive.

One joint of a robot is taken as a joint alone: its problem is that of the whole robot, its controller and record are
its own. So the laws of `faults.other_laws`, and their tests, are those of a joint. All joints are screened by the same
few simulations, in each of which every controller runs the same other law. Only a joint whose own torque shows one is
solved for again.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.parameters import Parameter
from jointid.diagnostics.axis_faults import places_of
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.check_loop import choose_undecided, find_other_law
from jointid.diagnostics.faults.fault import FaultSignature
from jointid.diagnostics.faults.findings import AxisFaults, Finding, OtherLaw
from jointid.diagnostics.faults.other_laws import (
    AVERAGED,
    INTERPOLATIONS,
    OTHER_LAWS,
    other_interpolations,
    screen_mean,
)
from jointid.diagnostics.law_tests import Proof, choose_law, may_matter, test_interpolations, without_excluded
from jointid.diagnostics.model_free import LawOnPosition
from jointid.diagnostics.search_state import LoopTests, SearchState, TestResults
from jointid.estimation.problems.base import surrounding
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.robots.problem import RobotLoopProblem
from jointid.estimation.robots.simulated import SimulatedRobot, identify_simulated_robot, problem_of
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.loop_input import LoopInput
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.position_dependent_error import cells

_WAY = "interpolation", "reference_delay", "reference_average"  # numbers of a controller
_FAR_OFF = 0.1  # of a torque, that the model leaves: one step from there shows no law


@dataclass(frozen=True, slots=True, eq=False)
class AxisProblem:
    """The problem of a robot, with the members of a joint's problem that tests of laws ask for.

    Attributes:
        axis: number of the joint.
        setup: the robot under its controllers. records: of each joint.
        whole: the problem of the robot, each joint weighted by its error.
        freed: numbers of the joint's controller that are free beside the parameters of the robot.
        alike: joints whose references go the same way as its own.
    """

    axis: int
    setup: RobotLoop
    records: tuple[Record, ...]
    whole: RobotLoopProblem
    freed: tuple[Parameter, ...] = ()
    alike: tuple[int, ...] = ()

    @property
    def loop(self) -> ClosedLoop:
        """The joint under its controller."""
        return ClosedLoop(RigidJoint(self.setup.robot.links[self.axis].kind), self.setup.controllers[self.axis])

    @property
    def experiment(self) -> LoopInput:
        """The input of its controller."""
        return self.whole.experiment.experiments[self.axis]

    @property
    def sample_time(self) -> float:
        """Of the log, s."""
        return self.whole.sample_time

    @property
    def size(self) -> float:
        """Norm of the weighted torques."""
        return self.whole.size

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """The parameters of the robot."""
        return self.whole.free

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Those, and the numbers of the controller that are free."""
        return (*self.free_joint, *self.freed)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return the free parameters by name, as they are searched."""
        return dict(zip((p.name for p in self.free), x.tolist(), strict=True))

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`; a number that is not there is as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the weighted residual of all joints, (rows,)."""
        return self.whole.residual(x)

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, and its derivatives; by numbers of the controller as they change over one period."""
        own, period = x[: len(self.free_joint)], self.experiment.law.period
        residual, slopes = self.whole.linearise(own)
        law: Any = self.loop.controller
        later = (with_numbers(law, {p.name: numbers_of(law)[p.name] + period}) for p in self.freed)
        changed = [(self.under(one).residual(own) - residual) / period for one in later]
        return residual, np.column_stack([slopes, *changed])

    def freeing(self, name: str) -> Self:
        """Return the problem with a time of the controller free."""
        return replace(self, freed=(surrounding(name, self.loop.controller, self.experiment.law.period),))

    def under(self, controller: Controller, record: Record | None = None) -> Self:
        """Return the problem with another controller of the joint and those alike, and maybe another record.

        Raises:
            RecordError, MethodError: see `prepare_robot`.
        """
        k, laws, records = self.axis, list[Any](self.setup.controllers), self.records
        way = {name: getattr(controller, name) for name in _WAY} if self.alike else {}
        for j in self.alike:
            laws[j] = replace(laws[j], **way)
        laws[k] = controller
        setup = replace(self.setup, controllers=tuple(laws))
        records = (*records[:k], record or records[k], *records[k + 1 :])
        return replace(self, setup=setup, records=records, whole=_pose(setup, records, self.whole))


def _pose(setup: RobotLoop, records: Sequence[Record], like: RobotLoopProblem) -> RobotLoopProblem:
    """Return the problem of a robot with the parameters, filter and weights of another one."""
    found = problem_of(setup, records, like.parameters, like.filtering)
    assert isinstance(found, RobotLoopProblem)
    return replace(found, parameters=like.parameters, sigma=like.sigma)


def list_axes(
    part: SimulatedRobot, setup: RobotLoop, records: Sequence[Record], filtering: Filtering, torques: AxisTorques
) -> tuple[AxisProblem, ...]:
    """Return the problem of each joint of a robot that was simulated under its controllers."""
    problem = problem_of(setup, records, part.parameters, filtering)
    assert isinstance(problem, RobotLoopProblem)
    sigma = np.sqrt(np.mean(torques.error**2, axis=1))
    whole = replace(problem, parameters=part.parameters, sigma=np.where(sigma > 0.0, sigma, 1.0))
    return tuple(AxisProblem(k, setup, tuple(records), whole) for k in range(len(setup.robot)))


def screen_laws(axes: Sequence[AxisProblem], x: FloatArray, torques: AxisTorques) -> AxisTorques:
    """Return torques with what each other way of the references adds to each joint's among their shapes.

    Args:
        axes: of all joints.
        x: (free,) as they are searched.
        torques: of the same robot.
    """
    ways = [{law.fault: law.controller for law in _list_ways(axis)} for axis in axes]
    shapes = list(torques.shapes)
    for fault in dict.fromkeys(fault for one in ways for fault in one):
        controllers = (one.get(fault, axis.loop.controller) for axis, one in zip(axes, ways, strict=True))
        with contextlib.suppress(JointidError):  # a log that such a controller cannot have
            problem = _pose(replace(axes[0].setup, controllers=tuple(controllers)), axes[0].records, axes[0].whole)
            run = problem.run(x, keep=False)
            if run.outcome is Outcome.FINISHED:
                columns = problem.by_joint(problem.decimate(problem.predict(run))) - torques.predicted
                for k, one in enumerate(ways):
                    shapes[k] = (*shapes[k], *[FaultSignature(fault, columns[k])] * (fault in one))
    return replace(torques, shapes=tuple(shapes))


def _list_ways(axis: AxisProblem) -> list[OtherLaw]:
    """Return the other ways of a joint's reference, with a short mean in the place of all that are late."""
    problem = cast("ClosedLoopProblem", axis)  # of which it has what laws ask for
    mean = screen_mean(problem)
    return [*other_interpolations(problem, axis.records[axis.axis]), *([] if mean is None else [mean])]


def _identify_anew(problem: ClosedLoopProblem) -> FloatArray:
    """Return the parameters of a robot under another law, as they are searched, from its own start."""
    axis = cast("AxisProblem", problem)
    parameters = axis.whole.parameters
    part = identify_simulated_robot(axis.setup, axis.records, filtering=axis.whole.filtering).robot
    values = {} if part is None else dict(zip(part.names, part.values.tolist(), strict=True))
    return parameters.to_search_variables(np.array([values.get(p.name, p.start or 0.0) for p in parameters.parameters]))


@dataclass(frozen=True, slots=True, eq=False)
class AxisLaws:
    """Ways of a robot's references, as far as its record shows others than those declared.

    Attributes:
        axes: the joints under the ways that were found.
        x: (free,) of the robot then, as they are searched.
        found: of each joint, the way that was found. undecided: one that is possible, and matters.
    """

    axes: tuple[AxisProblem, ...]
    x: FloatArray
    found: tuple[Finding | None, ...]
    undecided: tuple[Finding | None, ...]


def search_laws(
    axes: Sequence[AxisProblem],
    x: FloatArray,
    torques: AxisTorques,
    faults: Sequence[AxisFaults],
    known: Mapping[str, float],
    along: Sequence[LawOnPosition | None],
) -> AxisLaws:
    """Return the ways of the references that the record shows, joint by joint, the most significant first.

    Args:
        axes: of all joints.
        x: (free,) as they are searched.
        torques: of the same robot, with what each way adds among its shapes.
        faults: of each joint, with the tests of these ways.
        known: deviations of the parameters as they are searched, by name.
        along: of each joint, what the declared law leaves of the torque along the logged position.
    """
    settings, found, undecided = LoopTests(), dict[int, Finding](), dict[int, Finding | None]()
    sigma = axes[0].whole.sigma[:, np.newaxis]
    own = (torques.own / sigma[:, :, np.newaxis]).reshape(torques.error.size, -1)
    results = TestResults((torques.error / sigma).ravel(), own, (), (), lambda: cells(*places_of(torques)), list)
    ways = {k: [test for test in one.tests if test.fault in OTHER_LAWS] for k, one in enumerate(faults)}
    left = np.linalg.norm(torques.error, axis=1) / np.linalg.norm(torques.measured, axis=1)
    open_ones = [k for k, each in ways.items() if any(test.fault in INTERPOLATIONS.values() for test in each)]
    far_off = sorted((k for k in open_ones if left[k] > _FAR_OFF), key=lambda k: -left[k])
    order = sorted(ways, key=lambda k: -max((test.strength for test in ways[k]), default=0.0))
    # An identification anew is dear: one of all joints that are far off, as drives of a robot are alike, and one of the
    # worst.
    first = [(far_off[0], tuple(far_off[1:]))] if len(far_off) > 1 else []
    axis, far_off = axes[0], far_off[:1]
    for k, alike in (*first, *((k, ()) for k in dict.fromkeys((*far_off, *order)))):
        if k in found:
            continue
        axis = replace(axis, axis=k, alike=alike)
        state = SearchState(cast("ClosedLoopProblem", axis), x)
        rivals = {one.test.fault for one in faults[k].findings}  # what else is significant explains little
        tests = (one for one in faults[k].tests if one.fault in rivals or one.p_value > settings.level)
        here = replace(results, tests=tuple(one for one in tests if one not in ways[k]))
        columns = {one.fault: np.zeros_like(torques.error) for one in torques.shapes[k]}
        for one in torques.shapes[k]:
            columns[one.fault][k] = one.column / sigma[k]
        if k not in far_off and not any(
            test.p_value <= settings.level
            if test.fault is AVERAGED
            else may_matter(state, here, test, columns[test.fault].ravel(), known)
            for test in ways[k]
        ):
            continue
        evident = k in far_off or any(test.p_value <= settings.level for test in ways[k])
        if not evident and any(undecided.values()):  # one is said: each takes another solution of the robot
            continue
        position, record = along[k], axis.records[k]
        laws = without_excluded(
            test_interpolations(state, here, settings, known, record, begin=_identify_anew if k in far_off else None),
            Proof(record, axis.loop) if position is not None and position.holds else None,
        )
        stated = choose_law([one for one in laws if one.explains(here.tests, settings.level)])
        if stated is None:
            possible = [one for one in laws if one.possible and one.test.fault in INTERPOLATIONS.values()]
            undecided[k] = choose_undecided(
                [find_other_law(state, one, here, settings.level, known) for one in possible]
            )
            continue
        others = [one for one in laws if one is not stated and one.possible and one.as_likely([stated])]
        finding = find_other_law(state, stated, here, settings.level, known, others)
        found |= dict.fromkeys((k, *alike), finding)
        axis, x = cast("AxisProblem", stated.refit.problem), stated.refit.x
        residual, slopes = axis.linearise(x)
        results = replace(results, residual=residual, own=-slopes)
        far_off = []
    every = range(len(axes))
    corrected = tuple(replace(axis, axis=k, alike=()) for k in every)
    return AxisLaws(corrected, x, tuple(map(found.get, every)), tuple(map(undecided.get, every)))
