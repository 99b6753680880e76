"""The verb `design`: the most informative test of a joint or a robot within its limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast, overload

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import ClosedLoop
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import Robot
from jointid.planning.joint_design import Design, design_joint_test
from jointid.planning.predict import Noise
from jointid.planning.robot_design import RobotDesign, design_robot_test, first_record
from jointid.records.record import Record, Tap
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robots import RobotLoop

_DURATION, _SAMPLE_TIME = 10.0, 1e-3  # s, of a robot's test where no record states them


@overload
def design(  # type: ignore[overload-overlap]  # of one estimate the record says which
    model: Estimate | ClosedLoop,
    record: Record | None = None,
    *,
    values: Mapping[str, float] | None = None,
    noise: Noise | None = None,
    goal: str = "all",
    limits: AxisLimits | None = None,
    motion: Record | None = None,
    covariance: FloatArray | None = None,
    duration: float | None = None,
    sample_time: float | None = None,
    tap: Tap | str = Tap.COMMAND,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    encoder: float | None = None,
    seconds: float = 60.0,
    seed: int = 0,
    name: str = "",
    progress: Progress = ignore_progress,
) -> Design: ...


@overload
def design(
    model: Estimate | Robot | RobotLoop,
    record: Sequence[Record] | None = None,
    *,
    noise: Sequence[float] | FloatArray | None = None,
    limits: Sequence[AxisLimits] | None = None,
    motion: Sequence[Record] | None = None,
    duration: float | None = None,
    sample_time: float | None = None,
    filtering: Filtering | None = None,
    loop: RobotLoop | None = None,
    feed_forward: Literal["none", "gravity", "inverse-model"] = "none",
    seconds: float = 60.0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> RobotDesign: ...


def design(
    model: Estimate | ClosedLoop | Robot | RobotLoop,
    record: Record | Sequence[Record] | None = None,
    *,
    values: Mapping[str, float] | None = None,
    noise: Noise | Sequence[float] | FloatArray | None = None,
    goal: str = "all",
    limits: AxisLimits | Sequence[AxisLimits] | None = None,
    motion: Record | Sequence[Record] | None = None,
    covariance: FloatArray | None = None,
    duration: float | None = None,
    sample_time: float | None = None,
    tap: Tap | str = Tap.COMMAND,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    encoder: float | None = None,
    loop: RobotLoop | None = None,
    feed_forward: Literal["none", "gravity", "inverse-model"] = "none",
    seconds: float = 60.0,
    seed: int = 0,
    name: str = "",
    progress: Progress = ignore_progress,
) -> Design | RobotDesign:
    """Search for the test that determines the parameters best within the limits of the axes.

    Args:
        model: an estimate, of a joint by DIDIM with every parameter identified; or a joint in its loop, a robot or a
            robot in its loop that is roughly known. A robot in its loop is planned a test by DIDIM, a robot alone one
            by IDIM.
        record: the test there is already, which an estimate was identified from. Its motion is compared; it states the
            limits of stroke and torque that are not given, of a robot those of positions and speed.
        values: every parameter of the joint by name; those of the estimate by default.
        noise: what will disturb the test; by default the residual of the record. Of a robot the standard deviation of
            white noise on each joint's torque; without a record 1 % of the torque.
        goal: a parameter of the joint, a sum or a difference of parameters, "weakest" (the direction that is known
            worst) or "all" (the volume of all intervals). A robot's goal is "all".
        limits: of the axis; of a robot those of each joint.
        motion: a test of your own, or a past record, which is predicted instead of a search.
        covariance: (free, free) of the joint's free parameters, in their order: other joints are drawn from it.
        duration: of the test, s; that of the record by default.
        sample_time: of its log, s; likewise.
        tap: where the torque of a joint will be logged.
        filtering: of the identification; see `Filtering`.
        parameters: changes to the joint's parameters by name, as for `identify`.
        encoder: steps of the encoders that are predicted beside a joint's test, m or rad; those of the record by
            default, or a millionth of the stroke.
        loop: controllers of a robot that was identified without them, for a test by DIDIM.
        feed_forward: that a robot's drives are given beside the controllers' torque.
        seconds: that the search may take. An interrupt ends it and keeps the best test.
        seed: of the search.
        name: of what is roughly known, for the result.
        progress: receives messages.

    A joint's test is one of several families (see `planning.search`), a robot's a Fourier series of all joints with a
    multisine about the mode of each spring. Neither knows obstacles: play it slowly first.

    Raises:
        MethodError: a limit is missing, the test is too short, the goal is no quantity of this joint, a robot with
            springs has no controllers, or no test could be simulated.
        RecordError: the record lacks what the controller reads.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.design(
        ...     axis.loop, axis.record, values=axis.truth, noise=ji.Noise(log=axis.noise), goal="stiffness",
        ...     duration=4.0, seconds=1.0,
        ... )
        >>> found.floor < found.proposed.std["stiffness"]
        True
    """
    asked: dict[str, Any] = {"filtering": filtering, "seconds": seconds, "seed": seed, "progress": progress}
    asked |= {"duration": duration, "sample_time": sample_time, "noise": noise, "limits": limits, "motion": motion}
    if isinstance(model, ClosedLoop) or (isinstance(model, Estimate) and model.robot is None):
        if any(isinstance(one, Sequence) for one in (record, limits, motion)) or not isinstance(noise, Noise | None):
            raise MethodError("The test of a joint has one record, AxisLimits, one motion and a Noise; give each so.")
        asked |= {"present": record, "goal": goal, "encoder": encoder}
        if isinstance(model, Estimate):
            return design_joint_test(**asked | _read_estimate(model, cast("Record | None", record), noise))
        if values is None or noise is None:
            raise MethodError("A joint that is roughly known has values and a noise; give both, or an estimate.")
        asked |= {"covariance": covariance, "tap": tap, "parameters": parameters, "name": name}
        return design_joint_test(model, values, **asked)
    if goal != "all" or isinstance(record, Record) or isinstance(limits, AxisLimits) or isinstance(motion, Record):
        raise MethodError(
            'The test of a robot has the goal "all", and records, limits and motion of each joint; give each so.'
        )
    return design_robot_test(**_read_robot(model, record, motion, loop, asked), feed_forward=feed_forward)


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
        "tap": record.tap,
        "filtering": estimate.settings.filtering,
        "name": estimate.data.record,
    }


def _read_robot(
    model: Estimate | Robot | RobotLoop,
    records: Sequence[Record] | None,
    motion: Sequence[Record] | None,
    loop: RobotLoop | None,
    asked: Mapping[str, Any],
) -> dict[str, Any]:
    """Prior knowledge of a robot for the design of its test: nominal numbers, controllers and a first record."""
    known = model.require_robot().setup if isinstance(model, Estimate) else model
    robot = known if isinstance(known, Robot) else known.robot
    found: dict[str, Any] = {"sample_time": _SAMPLE_TIME, "duration": _DURATION, "limits": [AxisLimits()] * len(robot)}
    if isinstance(model, Estimate):
        if records is None:
            raise MethodError("A test is designed from the estimate of a robot and its records; give both.")
        first = first_record(model, records)
        found |= {"sample_time": first.sample_time, "duration": first.duration, "noise": first.noise}
        found["present"] = first.motion
        if model.settings.method == "didim" and isinstance(known, RobotLoop):
            loop = loop or known
    elif records is not None:
        raise MethodError("The records of a robot are read with its estimate; give the estimate in place of the robot.")
    elif isinstance(model, RobotLoop):
        loop = model
    if motion is not None:
        played = [one.reference for one in motion if one.reference is not None]
        if len(played) != len(robot):
            raise MethodError(
                f"The motion of a robot has the reference of each joint; received {len(played)} for {len(robot)} "
                "joints: give one for each, in the order of the joints."
            )
        q = np.column_stack([one.values for one in played]) @ np.linalg.inv(robot.coupling).T
        found |= {"motion": q, "sample_time": played[0].sample_time, "duration": len(q) * played[0].sample_time}
    given = {name: asked[name] for name in ("sample_time", "duration", "noise", "limits") if asked[name] is not None}
    return {**asked, **found, **given, "robot": robot, "loop": loop}
