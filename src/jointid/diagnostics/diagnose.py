"""The verb `diagnose`: whether record, controllers and model agree, and what to do if not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from jointid.common.errors import MethodError
from jointid.diagnostics.check_loop import LoopTests, check_loop
from jointid.diagnostics.faults.findings import LoopCheck
from jointid.diagnostics.robots.diagnose import FeedForwardName, RobotDiagnosis, diagnose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.records.record import Record


@overload
def diagnose(
    estimate: Estimate, record: Record, *, tests: LoopTests | None = None, shown: Sequence[DriveNumber] = ()
) -> LoopCheck: ...


@overload
def diagnose(
    estimate: Estimate,
    record: Sequence[Record],
    *,
    controllers: Sequence[Controller | None] = (),
    feed_forward: FeedForwardName = "none",
) -> RobotDiagnosis: ...


def diagnose(
    estimate: Estimate,
    record: Record | Sequence[Record],
    *,
    tests: LoopTests | None = None,
    shown: Sequence[DriveNumber] = (),
    controllers: Sequence[Controller | None] = (),
    feed_forward: FeedForwardName = "none",
) -> LoopCheck | RobotDiagnosis:
    """Test whether an estimate's loop and log are as declared, and name the faults.

    For a joint, each possible fault of loop and log is tested by its effect on the torque. For a robot, each joint's
    residual is tested for what it correlates with, each parameter for its significance, and each controller by the
    torque that it makes of the logged position.

    Args:
        estimate: of a joint by DIDIM, of this record; of a robot by any method.
        record: that it was identified from; of a robot the record of each joint.
        tests: settings of the tests of a joint's loop, see `LoopTests`.
        shown: how the drive shows the numbers of a joint's controller, as `JointFile.declared_numbers` has it; without
            it they are in percent of the declared values.
        controllers: of each joint of a robot as declared, None where one is not known; those of the estimate's loop if
            none are given.
        feed_forward: kind of the injected signals of a robot's records; with "none", whether the controllers leave less
            with a feed-forward is tested.

    Raises:
        MethodError: the estimate of a joint did not simulate a loop, is of another record, or has a parameter that is
            not identifiable.
        RecordError: as of the identification of a robot.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> record = axis.record.without("motor_position", "load_position")
        >>> estimate = ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0))
        >>> ji.diagnose(estimate, record).as_declared
        True
    """
    if estimate.robot is None:
        if isinstance(record, Sequence):
            raise MethodError("The estimate of a joint is diagnosed on its own record; give that one alone.")
        if controllers or feed_forward != "none":
            raise MethodError("The arguments controllers and feed_forward are for a robot; leave them out for a joint.")
        return check_loop(estimate, record, tests, shown=shown)
    if not isinstance(record, Sequence):
        raise MethodError("The estimate of a robot is diagnosed on the record of each joint; give them in order.")
    if tests is not None or shown:
        raise MethodError("The arguments tests and shown are for a joint; leave them out for a robot.")
    return diagnose_robot(estimate, record, controllers, feed_forward=feed_forward)
