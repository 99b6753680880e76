"""The verb `design`: the most informative test of a joint or a robot within its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import Parameter
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import ClosedLoop
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import Robot
from jointid.planning.designed import Design
from jointid.planning.joint_tests import JointTests, joint_tests
from jointid.planning.predict import Noise
from jointid.planning.robot_tests import FirstRecord, RobotTests, combine_with_nominal, first_record, robot_tests
from jointid.planning.search import choose, look
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop

_FEWEST = 200  # samples of a test
_DURATION, _SAMPLE_TIME = 10.0, 1e-3  # s, of a robot's test where nothing states them
_DOUBTFUL = "at some joints of the interval it cannot be simulated, or tells nothing of a parameter"


@one_thread()
def design(
    model: Estimate | ClosedLoop | Robot | RobotLoop,
    record: Record | Sequence[Record] | None = None,
    *,
    values: Mapping[str, float] | None = None,
    noise: Noise | Sequence[float] | FloatArray | None = None,
    goal: str = "all",
    limits: AxisLimits | Sequence[AxisLimits] | None = None,
    motion: Record | Sequence[Record] | None = None,
    within: float | None = None,
    duration: float | None = None,
    sample_time: float | None = None,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    injection: bool = True,
    loop: RobotLoop | None = None,
    feed_forward: Literal["none", "gravity", "inverse-model"] = "none",
    search_time: float = 60.0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Design:
    """Search for the test that determines the parameters best within the limits of the axes.

    Args:
        model: an estimate, of a joint by DIDIM with every parameter identified; or a joint in its loop, a robot or a
            robot in its loop that is roughly known. A robot in its loop is planned a test by DIDIM, a robot alone one
            by IDIM. Of an estimate of a robot the identified bodies, friction and springs are used where the record
            determines them.
        record: the test there is already, which an estimate was identified from. Its motion is compared; it states the
            limits of stroke and torque that are not given, of a robot those of positions and speed. Of a robot one for
            each joint.
        values: every parameter of a joint that is roughly known, by name; an estimate has its own.
        noise: what will disturb the test; by default the residual of the record. Of a robot the standard deviation of
            white noise on each joint's torque; without a record 1 % of the torque.
        goal: a parameter, a sum or a difference of parameters, or "all" (the volume of all intervals).
        limits: of the axis; of a robot those of each joint.
        motion: a test of your own, or a past record, which is predicted instead of a search; of a robot one for each
            joint.
        within: percent of each value, by which it may be off, 2 sigma: limits are kept, and intervals predicted, for
            joints or robots drawn from it. By default the covariance of the estimate of a joint; all else as known.
        duration: of the test, s; that of the record by default.
        sample_time: of its log, s; likewise.
        filtering: of the identification; see `Filtering`. An estimate of a joint has its own, and its parameters.
        parameters: changes to the joint's parameters by name, as for `identify`.
        injection: whether the drive can add a signal to the torque; a robot's test adds none.
        loop: controllers of a robot that was identified without them, for a test by DIDIM.
        feed_forward: that a robot's drives are given beside the controllers' torque.
        search_time: that the search may take, s. An interrupt ends it and keeps the best test.
        seed: of the search.
        progress: receives messages.

    A joint's test is one of several families (see `planning.search`), a robot's a Fourier series of all joints with a
    multisine about the mode of each spring. Neither knows obstacles: play it slowly first.

    Raises:
        MethodError: a limit is missing, the test is too short, the goal is no quantity of this joint, a robot with
            springs has no controllers, a setting is not read, or no test could be simulated.
        RecordError: the record lacks what the controller reads.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.design(
        ...     axis.loop, axis.record, values=axis.truth, noise=ji.Noise(log=axis.noise), goal="stiffness",
        ...     duration=4.0, search_time=1.0,
        ... )
        >>> found.floor < found.proposed.std["stiffness"]
        True
    """
    _require_numbers({"duration": duration, "sample time": sample_time, "time of the search": search_time})
    _require_numbers({"tolerance in percent": within}, 0.0)
    played = None if motion is None else (motion,) if isinstance(motion, Record) else tuple(motion)
    tests: JointTests | RobotTests
    common: dict[str, Any] = {"goal": goal, "within": within, "seed": seed}
    if isinstance(model, ClosedLoop) or (isinstance(model, Estimate) and model.robot is None):
        if any(isinstance(one, Sequence) for one in (record, limits, motion)) or not isinstance(noise, Noise | None):
            raise MethodError("The test of a joint has one record, AxisLimits, one motion and a Noise; give each so.")
        _refuse_unread("joint", loop=isinstance(loop, RobotLoop), feed_forward=feed_forward != "none")
        present = record if isinstance(record, Record) else None
        if isinstance(model, Estimate):
            own = {"values": values, "filtering": filtering, "parameters": parameters}
            _refuse_unread("joint by its estimate", **{name: one is not None for name, one in own.items()})
            known = _read_estimate(model, present, noise)
        elif values is None or noise is None:
            raise MethodError("A joint that is roughly known has values and a noise; give both, or an estimate.")
        else:
            known = {"loop": model, "values": values, "noise": noise, "covariance": None}
            known |= {"parameters": parameters or {}, "filtering": filtering or Filtering()}
        step, samples = _times(present, played, sample_time, duration)
        tests = joint_tests(
            **known, **common, limits=cast("AxisLimits", limits or AxisLimits()), samples=samples, sample_time=step,
            present=present, injection=injection, searched=played is None,
        )  # fmt: skip
    else:
        if any(isinstance(one, Record | AxisLimits | Noise) for one in (record, limits, motion, noise)):
            raise MethodError("The test of a robot has records, limits, noise and motion of each joint; give each so.")
        _refuse_unread("robot", values=values is not None, parameters=parameters is not None)
        robot, loop, first = _read_robot(model, cast("Sequence[Record] | None", record), loop)
        times = () if played is None else [one.reference for one in played if one.reference is not None]
        step = times[0].sample_time if times else sample_time or (_SAMPLE_TIME if first is None else first.sample_time)
        lasts = duration or (_DURATION if first is None else first.duration)
        samples = len(times[0]) if times else _require_samples(round(lasts / step))
        tests = robot_tests(
            robot, loop, **common, limits=cast("Sequence[AxisLimits] | None", limits), samples=samples,
            sample_time=step, first=first, filtering=filtering, feed_forward=feed_forward, motion=played,
            noise=None if noise is None else np.asarray(noise, dtype=np.float64),
        )  # fmt: skip
    if played is not None:
        predicted, best, tried, interrupted = tests.predict(played), tests.take(played), 0, False
    else:
        found, cut = look(tests.rough, tests.begin, search_time, seed, progress)
        best, ended = choose(tests, found, progress)
        tried, interrupted = len(found), cut or ended
        played = tests.record(best.plan)
        predicted = tests.predict(played, best.plan)
    if any(np.any(one != best.stds[0]) for one in best.stds):
        predicted["at worst"] = predicted["proposed"].widen(best.stds)
    design = Design(
        model.data.record if isinstance(model, Estimate) else "", tests.goal, tests.describe(best.plan),
        tests.axes(played, best, predicted["proposed"]), predicted, tests.noise, tried=tried, interrupted=interrupted,
        notes=(_DOUBTFUL,) if math.isinf(best.over) else (),
    )  # fmt: skip
    if isinstance(tests, JointTests):
        return replace(design, floor=None if tests.floor is None else tests.floor.deviation)
    joints = np.asarray(np.linalg.inv(tests.robot.coupling))
    return replace(design, notes=(*design.notes, *tests.doubts), assumed=tests.assumed, from_shafts=joints)


def _require_numbers(given: Mapping[str, float | None], least: float | None = None) -> None:
    for what, value in given.items():
        if (value is not None and not (value > 0.0 if least is None else value >= least)) or value == math.inf:
            said = "a positive number of seconds" if least is None else f"{least:g} or more"
            raise MethodError(f"The {what} is {said}; received {value:g}.")


def _refuse_unread(kind: str, **given: bool) -> None:
    if unread := [name for name, stated in given.items() if stated]:
        raise MethodError(f"The test of a {kind} does not read {', '.join(unread)}; leave it out.")


def _read_estimate(estimate: Estimate, record: Record | None, noise: Noise | None) -> dict[str, Any]:
    """Prior knowledge of a joint for the design of its test."""
    if record is None or estimate.settings.loop is None:
        raise MethodError("A test is designed from an estimate by DIDIM and its record; give both.")
    loop, rows = estimate.settings.loop, [p for p in estimate.params.rows if p.free]
    own = [i for i, p in enumerate(rows) if p.of_joint]
    free = [p.name for p in rows if p.of_joint]
    return {
        "loop": loop,
        "values": estimate.values,
        "noise": noise or Noise.of(estimate, record),
        "covariance": estimate.params.covariance[np.ix_(own, own)],
        "parameters": {p.name: p.fix(estimate.values[p.name]) for p in loop.joint.parameters if p.name not in free},
        "filtering": estimate.settings.filtering,
    }


def _read_robot(
    model: Estimate | Robot | RobotLoop, records: Sequence[Record] | None, loop: RobotLoop | None
) -> tuple[Robot, RobotLoop | None, FirstRecord | None]:
    """Prior knowledge of a robot for the design of its test: its numbers, controllers and a first record."""
    if not isinstance(model, Estimate):
        if records is not None:
            raise MethodError(
                "The records of a robot are read with its estimate; give the estimate in place of the robot."
            )
        own = loop if isinstance(model, Robot) else model
        return model if isinstance(model, Robot) else model.robot, own, None
    part, first = model.require_robot(), None if records is None else first_record(model, records)
    if model.settings.method == "didim" and isinstance(part.setup, RobotLoop):
        loop = loop or part.setup
    robot = combine_with_nominal(part)
    if loop is not None and robot.flexible != loop.robot.flexible:
        robot = _with_springs(robot, loop.robot)  # IDIM knows none
    return robot, None if loop is None else replace(loop, robot=robot), first


def _with_springs(found: Robot, declared: Robot) -> Robot:
    """Return a robot of rigid joints with its declared springs and divided friction."""
    joints = []
    for own, other in zip(found.joints, declared.joints, strict=True):
        spring = other.spring
        left = () if spring is None else (("viscous", spring.viscous), ("coulomb", spring.coulomb))
        friction = {name: max(getattr(own, name) - of_link, 0.0) for name, of_link in left}
        joints.append(replace(own, spring=spring, **friction))
    return replace(found, joints=tuple(joints))


def _times(
    present: Record | None, played: Sequence[Record] | None, sample_time: float | None, duration: float | None
) -> tuple[float, int]:
    """Sample time and samples of a joint's test: those that are given, or of the record that there is."""
    if present is not None:
        present.require(("reference",), "A design from a test there is already")
    motion = played[0] if played else None
    known, lasts = present or motion, motion or present
    if lasts is None and (duration is None or sample_time is None):
        raise MethodError(
            "A test has a duration and a sample time; give both, or the record of a test there is already."
        )
    log = None if known is None else known.torque or known.reference
    step = sample_time or (log.sample_time if log is not None else 0.0)
    return step, _require_samples(math.floor((duration or (0.0 if lasts is None else lasts.duration)) / step + 1e-9))


def _require_samples(samples: int) -> int:
    if samples < _FEWEST:
        raise MethodError(f"A test of {samples} samples tells nothing; expected {_FEWEST} or more: plan a longer one.")
    return samples
