"""The verb `identify`: one record, several, or a log too long for memory in; an estimate and its checks out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.diagnostics.run_checks import run_checks
from jointid.estimation.identify import fit as fit_records
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.problems.several_records import SeveralRecords
from jointid.estimation.result.assemble import CheckResults, assemble
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.chunks import LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.prescribed import DriveSide, OpenLoop
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.verdict import Subject, skip_test


def identify(
    record: Record | Sequence[Record] | Sequence[Sequence[Record]] | LongRecord,
    model: ClosedLoop | DriveSide | OpenLoop | Joint | Sequence[ClosedLoop] | Robot | RobotLoop | RobotDriveSide,
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    several: SeveralRecords | None = None,
    windows: Windowing | None = None,
    checks: bool = True,
    shown: Sequence[DriveNumber] = (),
    torque_constant: str = "",
    unchecked: Callable[[Estimate], None] | None = None,
    progress: Progress = ignore_progress,
) -> Estimate:
    """Identify a joint, or a robot, from what its drives logged.

    Args:
        record: a record; or several of one joint, each with the torque and what its controller reads, in one fit; or a
            `Log` that is read in chunks, identified in windows in bounded memory. Of a robot the records of its joints,
            on one clock; or those of several logs, in one fit, which is not checked.
        model: the loop (joint and controller), or the joint alone when the controller is not known; `DriveSide` to
            prescribe the motor's motion and simulate the load; `OpenLoop` to prescribe the torque. For several records
            a loop, or one for each record: of one joint under different gains. A `Robot` alone, a `RobotLoop` with its
            controllers, or a `RobotDriveSide` along the motors' motion.
        method: `DIDIM`, `IDIM`, `DriveSideFit` or `OpenLoopFit` with its settings; by default
            DIDIM when the controller is known, even where the record has a motor position, which is then not read; that
            of a `DriveSide` or an `OpenLoop`; otherwise IDIM. Several records and a log are identified by DIDIM. A
            robot likewise, but there is no `OpenLoopFit`.
        filtering: see `Filtering`; its defaults follow the sample time.
        parameters: changes to the joint's parameters by name: fixed values, starts, bounds; for several records, of the
            joint without anything added. Of a robot values and bounds of friction, as "joint1.viscous".
        several: what the records share, and what was added to the load; see `SeveralRecords`.
        windows: of a log; see `Windowing`. With it a record in memory is identified in windows, too.
        checks: whether to check controller and log, what else may cause a misfit, and what the model lacks: of one
            record, by a DIDIM that ends at the least squares. The checks of a rigid joint take several times as
            long as its identification.
            Without them, the verdict on the loop says so. Those of a robot are made by `diagnose`.
        shown: how the drive shows the numbers of its controller, see `diagnose`.
        torque_constant: with its unit, where all values are proportional to it, see `Estimate.data`.
        unchecked: called with the estimate before its checks.
        progress: called with each step in a sentence.

    An interrupt of the last passes over a log ends them, and the estimate is of what was read: `Fit.interrupted`.

    Raises:
        RecordError: the record lacks a channel the method needs; the sentence says which, and which method does not;
            or it shows nothing (a constant torque or reference), or cannot be in the units it is said to be in; or a
            chunk of a log cannot be read.
        MethodError: the method does not fit the model, the record does not determine the parameters, or it gives an
            inertia that is not positive; records are one only, or one twice, or the lists about them are not as long.

    A parameter that comes out outside its bounds is kept at the bound, with a warning, and the others identified anew.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> round(ji.identify(record, loop).params["inertia"].value, 6)
        30.0

        Two records, the second with 10 kg on the load and a friction of its own:

        >>> heavier = ji.simulated_record(loop, reference, truth | {"inertia": 40.0, "coulomb": 18.0}, sample_time=1e-3)
        >>> shared = ji.SeveralRecords(added_inertia=(0.0, 10.0), own=((), ("coulomb",)))
        >>> both = ji.identify([record, heavier], loop, several=shared)
        >>> round(both.params["inertia"].value, 4), round(both.params["coulomb@2"].value, 4)
        (30.0, 18.0)

        A minute, in windows of six seconds:

        >>> reference = ji.excitation.trapezoids((0.1, 0.2), 2.0, 0.1, 1e-3, duration=60.0)
        >>> minute = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> estimate = ji.identify(minute, loop, windows=ji.Windowing(length=6.0))
        >>> round(estimate.params["inertia"].value, 3), estimate.data.windows.count
        (30.0, 10)
    """
    fit = fit_records(
        record, model, method, filtering=filtering, parameters=parameters, several=several, windows=windows,
        progress=progress,
    )  # fmt: skip
    of_joint = fit.record is not None and fit.problem is not None
    to_check = fit.robot is not None or (of_joint and (method is None or method.tells_of_its_loop))
    if not to_check:
        return assemble(fit, torque_constant=torque_constant)
    if not checks:
        return assemble(fit, _left_out("not checked: the checks were left out"), torque_constant=torque_constant)
    if unchecked is not None:
        unchecked(assemble(fit, _left_out("not checked yet"), torque_constant=torque_constant))
    return assemble(fit, run_checks(fit, progress, shown), torque_constant=torque_constant)


def _left_out(why: str) -> CheckResults:
    return CheckResults((skip_test(Subject.LOOP, why),))
