"""`design`: the most informative test of a joint or robot within limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import Parameter
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import ClosedLoop
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.planning.designed import Design
from jointid.planning.joints import RUNS, JointModel, joint_model
from jointid.planning.predict import Noise, parse_goal
from jointid.planning.robots import FeedForward, RobotModel, robot_model
from jointid.planning.search import ASTRAY, Objective, complete, find_best
from jointid.records.record import Record, takes_record
from jointid.records.signals.filtering import Filtering

_FEWEST = 200  # samples of a test
_DURATION, _SAMPLE_TIME = 10.0, 1e-3  # s, of a robot's test where nothing states them
_DOUBTFUL = "at some joints of the interval it cannot be simulated, or shows nothing of a parameter"

One = TypeVar("One")


@one_thread
@takes_record
def design(
    model: Estimate | ClosedLoop | Robot | RobotLoop,
    record: Record | Sequence[Record] | None = None,
    *,
    values: Mapping[str, float] | None = None,
    noise: Mapping[str, Any] | Sequence[float] | FloatArray | None = None,
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
    feed_forward: FeedForward = "none",
    search_time: float = 60.0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Design:
    """Search for the most informative test within the limits of the axes.

    Args:
        model: an estimate, of a joint by DIDIM with every parameter identified; or a joint in its loop, a robot or a
            robot in its loop that is roughly known. A robot in its loop is planned a test by DIDIM, a robot alone one
            by IDIM. Of an estimate of a robot the bodies nearest to the model are used, with its friction and springs.
        record: the test there is already, which an estimate was identified from. Its motion is compared; it states the
            limits of stroke and torque that are not given, of a robot those of positions and speed. Of a robot one for
            each joint.
        values: every parameter of a joint that is roughly known, by name; an estimate has its own.
        noise: standard deviations {"log": of white noise on the torque, "force": of a white force on the motor}; by
            default the residual of the record. Of a robot one for each joint; without a record 1 % of the torque.
        goal: a parameter, a sum or a difference of parameters, or "all" (the volume of all intervals).
        limits: of the axis; of a robot those of each joint, completed by its model's where no record is given.
        motion: a test of your own, or a past record, which is predicted instead of a search; of a robot one for each
            joint.
        within: tolerance of each value in percent, 2 sigma: limits are kept, and intervals predicted, for
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

    A joint's test is one of several families (see `planning.plans`), a robot's a Fourier series of all joints with a
    multisine about the mode of each spring. Neither knows obstacles: play it slowly first.

    Raises:
        MethodError: a limit is missing, the test is too short, the goal is no quantity of this joint, a robot with
            springs has no controllers, a setting is not read, or no test could be simulated.
        RecordError: the record lacks a channel that the controller reads.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.design(
        ...     axis.loop, axis.record, values=axis.truth, noise={"log": axis.noise}, goal="stiffness",
        ...     duration=4.0, search_time=1.0,
        ... )
        >>> found.floor < found.proposed.std["stiffness"]
        True
    """
    times = {"duration": duration, "sample time": sample_time, "time of the search": search_time}
    wrong = [f"{what} {size:g} s" for what, size in times.items() if size is not None and not 0.0 < size < math.inf]
    if wrong or (within is not None and not 0.0 <= within < math.inf):
        said = ", ".join([*wrong, *([] if within is None else [f"tolerance {within:g} %"])])
        raise MethodError(f"Times are positive, and a tolerance is 0 or more; received {said}.")
    present, played, bounds = _as_tuple(record), _as_tuple(motion), _as_tuple(limits)
    for one in played:
        one.require(("reference",), "A test of your own")
    part = model.robot if isinstance(model, Estimate) else model
    declared = part if isinstance(part, Robot) else getattr(part, "model", getattr(part, "robot", None))
    count = 1 if declared is None else len(declared)
    sizes = len(present), len(played), len(bounds)
    if {*sizes} - {0, count}:
        raise MethodError(f"A test of {count} axes has as many records, motions and limits, or none; received {sizes}.")
    of_joint: dict[str, Any] = {"values": values, "parameters": parameters}
    bounds = bounds or (AxisLimits(),) * count
    common: dict[str, Any] = {"within": within, "filtering": filtering, "seed": seed}
    known: JointModel | RobotModel
    if isinstance(model, ClosedLoop) or (isinstance(model, Estimate) and model.robot is None):
        own = of_joint | {"filtering": filtering} if isinstance(model, Estimate) else {}
        _refuse_unread("joint", own | {"loop": loop, "feed_forward": None if feed_forward == "none" else feed_forward})
        at = _read_times(present, played, duration, sample_time)
        if noise is not None and not (isinstance(noise, Mapping) and noise.keys() <= {"log", "force"}):
            raise MethodError(f'Noise of a joint is {{"log": ..., "force": ...}}; received {noise!r}: give these.')
        common |= of_joint | {"noise": None if noise is None else Noise(**noise), "injection": injection}
        known = joint_model(model, present, at, **common)
    else:
        _refuse_unread("robot", of_joint)
        at = _read_times(present, played, duration, sample_time, (_DURATION, _SAMPLE_TIME))
        common |= {"loop": loop, "feed_forward": feed_forward}
        known = robot_model(model, present, at, noise=None if noise is None else np.asarray(noise), **common)
        if not present:
            bounds = tuple(one.complete(link.limits) for one, link in zip(bounds, known.robot.links, strict=True))
    return _design(known, goal, bounds, played, (search_time, seed), progress)


def _read_times(
    present: Sequence[Record], played: Sequence[Record], duration: float | None, sample_time: float | None,
    usual: tuple[float | None, float | None] = (None, None),
) -> tuple[int, float]:  # fmt: skip
    """Samples and sample time of a test: given, a record's or usual."""
    known, lasts = (*present, *played), (*played, *present)
    if known and sample_time is None:
        sample_time = next(one.sample_time for one in (known[0].torque, known[0].reference) if one is not None)
    duration = (lasts[0].duration if lasts and duration is None else duration) or usual[0]
    sample_time = sample_time or usual[1]
    if duration is None or sample_time is None:
        raise MethodError("A test has a duration and a sample time; give both, or the record of an earlier test.")
    samples = math.floor(duration / sample_time + 1e-9)
    if samples < _FEWEST:
        raise MethodError(f"A test of {samples} samples is too short; expected {_FEWEST} or more: plan a longer one.")
    return samples, sample_time


def _design(
    known: JointModel | RobotModel, goal: str, given: tuple[AxisLimits, ...], played: tuple[Record, ...],
    search: tuple[float, int], progress: Progress,
) -> Design:  # fmt: skip
    """Judge a motion that is given, or search for the best one."""
    wanted, limits, interrupted = parse_goal(goal, known.units), given, False
    before = next(known.predict(known.present, RUNS)) if known.present else None
    families: Sequence[Any] = ()
    floor: float | None = None
    if not played:
        limits = complete(given, known.names, known.needed, known.kept, None if before is None else before.reached)
        families, floor = known.families(limits, wanted, before)
    tests = Objective(known, wanted, limits, families)
    if played:
        best = tests.judge(None, known.predict(played))
    else:
        best, interrupted = find_best(tests, *search, progress)
        assert best.plan is not None
        played = known.records(best.plan)
    predicted = {} if before is None else {"present": before}
    predicted["proposed"] = next(known.predict(played, RUNS))
    if any(np.any(one != best.stds[0]) for one in best.stds):
        with np.errstate(invalid="ignore"):  # of what no joint or robot determines
            factors = np.nan_to_num(np.max(best.stds, axis=0) / best.stds[0], nan=1.0, posinf=np.inf)
        known_one = predicted["proposed"].covariance
        widest = replace(known_one, std=known_one.std * factors)
        predicted["at worst"] = replace(predicted["proposed"], covariance=widest)
    doubtful = (_DOUBTFUL,) if best.score >= ASTRAY else ()
    return Design(
        wanted, known.describe(played, best.plan), known.axes(played, limits, given, best.reached), predicted,
        known.noise, floor, interrupted, (*doubtful, *known.doubts), from_shafts=known.from_shafts,
    )  # fmt: skip


def _as_tuple(given: One | Sequence[One] | None) -> tuple[One, ...]:
    """Return the given values of each axis."""
    return () if given is None else tuple(given) if isinstance(given, Sequence) else (given,)


def _refuse_unread(kind: str, given: Mapping[str, object]) -> None:
    if unread := [name for name, stated in given.items() if stated is not None]:
        raise MethodError(f"The test of a {kind} does not read {', '.join(unread)}; leave it out.")
