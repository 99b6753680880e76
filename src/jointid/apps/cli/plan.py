"""`jointid design`: the next test, planned from the record there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Options, deliver, show, spare
from jointid.apps.cli.results import require_goal
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import require_room

if TYPE_CHECKING:
    from jointid import Record
    from jointid.common.arrays import FloatArray
    from jointid.config import JointFile
    from jointid.config.contents import File
    from jointid.config.robot_file import RobotFile
    from jointid.planning.designed import Design


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Rough:
    """Known values of a joint and the noise of a test, without identification.

    Attributes:
        noise_log: standard deviation of white noise on each logged torque, N or N m.
        noise_force: that of a white force on the motor, held over each period of the controller.
        estimate: what identify --json wrote: values and intervals; without it the values of [parameters], all of them.
        within: percent of each value, by which it may be off; 2 sigma: limits and intervals hold for joints or robots
            drawn from that. Without it the intervals of the estimate of a joint, or 0.
        sample_time: of the test's log, s; without it that of the record.
    """

    noise_log: float = 0.0
    noise_force: float = 0.0
    estimate: Path | None = None
    within: float | None = None
    sample_time: float | None = None

    @property
    def stated(self) -> bool:
        """Whether nothing is to be identified.

        Raises:
            MethodError: something is given that only counts then.
        """
        if self.noise_log or self.noise_force:
            return True
        beside = {"--estimate": self.estimate, "--sample-time": self.sample_time}
        if given := [name for name, value in beside.items() if value is not None]:
            raise MethodError(
                f"{given[0]} counts where nothing is identified from a record; add --noise-log or --noise-force, or "
                "leave it out."
            )
        return False

    def of_robot(self, joints: int) -> dict[str, Any]:
        """Return the noise of each joint's log, and the sample time.

        Raises:
            MethodError: something is given that is of a joint alone.
        """
        if self.noise_force:
            raise MethodError("--noise-force is of a joint; a robot's noise is that of its logs: give --noise-log.")
        found: dict[str, Any] = {"noise": [self.noise_log] * joints} if self.noise_log else {}
        return found if self.sample_time is None else found | {"sample_time": self.sample_time}

    def plan(self, file: JointFile, record: Path | None, asked: Mapping[str, Any]) -> Design:
        """Plan a test from the stated values; only the motion of a record is read.

        Raises:
            JointidError: a value or a limit is missing, or no test could be simulated.
        """
        from jointid import Noise, design

        loop = file.loop
        if loop is None:
            raise MethodError(
                "A test is planned for the joint under its controller; add [controller] to the joint file."
            )
        free = [p.name for p in loop.joint.parameters if file.parameters.get(p.name, p).free]
        values, covariance = self._values(file, free)
        named = record is not None or file.source.first is not None
        present = file.record(record) if named else None
        fixed = {p.name: p.fix(values[p.name]) for p in loop.joint.parameters if p.name not in free}
        return design(
            loop, present, values=values, noise=Noise(log=self.noise_log, force=self.noise_force),
            covariance=covariance, sample_time=self.sample_time, filtering=file.filtering, parameters=fixed,
            name=file.name or "", **asked,
        )  # fmt: skip

    def _values(self, file: JointFile, free: Sequence[str]) -> tuple[dict[str, float], FloatArray | None]:
        """Return the value of every parameter, and the covariance of the free ones where it is known."""
        from jointid.output.json import reading

        if self.estimate is not None:
            identified = reading.load_estimate(self.estimate, file).identified
            return identified.values, reading.read_covariance(self.estimate, free)
        stated = {name: p.start for name, p in file.parameters.items() if p.start is not None}
        missing = [p.name for p in file.joint.parameters if p.name not in stated]
        if missing:
            raise MethodError(
                f"A test that is planned without a record needs a value of every parameter; {', '.join(missing)} "
                f"{'have' if len(missing) > 1 else 'has'} none: give them in the table parameters, or name an answer "
                "by --estimate."
            )
        return stated, None


NOTHING_ROUGH = Rough()


def design(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    rough: Rough = NOTHING_ROUGH,
    goal: str = "all",
    duration: float | None = None,
    injection: bool = True,
    search_time: float = 60.0,
    motion: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> None:
    """Plan the next test within the limits of the axis.

    It is the one that tells most of the joint.
    The joint, or the robot, is identified from the record. Tests that a drive can play are then searched for, of a
    joint also at others of its interval. Ctrl-C ends the search and keeps the best test there is. With --noise-log or
    --noise-force nothing is identified, and no record is needed: the joint is as an earlier answer, or [parameters],
    says.

    Args:
        joint: the joint file (TOML), whose method is didim; or a robot file, which has the table [robot]: the motion
            that tells most of it within the limits of its [[joints]], beside that of its record.
        options: those that most commands have.
        rough: what is known of the joint and of the noise, where it is not identified from a record.
        goal: what the test is to tell: a parameter, a sum or a difference as "motor_viscous - load_viscous", or
            "all".
        duration: of the test, in s; without it that of the record.
        injection: whether the drive can add a signal to the torque.
        search_time: that the search may take, in s.
        motion: a test of your own, predicted in the place of a search: a past record, or a table with its columns; of
            a joint also a table with the columns t (s), reference (m or rad) and, if a signal is added to the torque,
            injected (N, N m, or the torque's unit).
        out: also write the test into this folder: a CSV file in the columns, units and sides of the joint file, a page
            on how to run it, and, without a signal on the torque, the motion as a ROS 2 JointTrajectory (YAML).
        figure: also save reference, torque and spectrum as PNG, SVG or PDF.
    """
    from jointid import design as run
    from jointid import figures
    from jointid.config import JointFile
    from jointid.output.test_layout import lay_out

    figures.require_format(figure)
    outputs = [options.json, figure]
    if out is not None:
        require_room(out)
        outputs += [out / "test.csv"] if out.is_dir() else []  # the only one that may be a record
    spare(outputs, motion, rough.estimate)
    file = options.load(joint, *outputs)
    asked: dict[str, Any] = {
        "goal": goal, "duration": duration, "search_time": search_time, "injection": injection,
        "progress": options.progress, "within": rough.within,
    }  # fmt: skip
    if isinstance(file, JointFile):
        file = options.load_joint(joint, what="Planning", method="didim")
        require_goal(file, goal)
        asked |= {"limits": file.limits, "motion": None if motion is None else _read(motion, file)}
        if rough.stated:
            found = rough.plan(file, options.record, asked)
        else:
            options = replace(options, record=_choose_record(file, options.record))
            file = file.of_record(options.record)
            record, estimate = options.identify(file, checks=False, whole=True)
            found = run(estimate, record, **asked)
    else:
        asked |= {"limits": file.limits, **rough.of_robot(len(file.joints))}
        found = _plan_robot(file, options, rough, asked, None if motion is None else file.driving(motion))
    found = lay_out(file, found)
    deliver(found, options.json, (figure, figures.draw))
    if out is not None:
        paths = found.write(out)
        show(f"\nWritten to {out}: {', '.join(path.name for path in paths)}")


def _choose_record(file: File[Any], record: Path | None) -> Path | None:
    """Return the record that a test is planned from: the named one, or of a list the first."""
    if record is not None or not file.only_lists:
        return record
    show(f"Planned from {file.runs[0].file}, the first of [[records]]; name another by --record.")
    return file.listed[0]


def _plan_robot(
    file: RobotFile, options: Options, rough: Rough, asked: dict[str, Any], motion: tuple[Record, ...] | None
) -> Design:
    """Plan the test of a robot from a record, from an earlier estimate, or from its model alone.

    Raises:
        MethodError: the robot is not identified from the record that the file names.
    """
    from jointid import design
    from jointid.output.json.reading import load_estimate

    # Of a motion that was never played nothing is logged: such a robot is predicted without.
    feed_forward = "none" if file.feed_forward == "logged" else file.feed_forward
    asked = file.design_settings | asked | {"motion": motion, "feed_forward": feed_forward}
    enough = motion is not None or all({"lower", "upper", "speed"} <= one.stated.keys() for one in asked["limits"])
    if rough.estimate is not None and options.record is not None:
        raise MethodError("A robot is known from --record or from --estimate, and both are given; leave one out.")
    named = options.record is not None or not enough or file.source.first is not None or file.only_lists
    if rough.estimate is None and named:
        said = "The record that the robot file names is not used, and the robot is as its model says"
        try:
            records = file.record(_choose_record(file, options.record))
            estimate = file.identify(records, options.progress, checks=False)
        except RecordError as error:  # references to simulate, or a log that is still to be made
            if options.record is not None or not enough:
                raise
            show(f"{said}: {error}")
        except MethodError as error:
            if options.record is not None or not (enough and rough.noise_log):
                raise MethodError(
                    f"{error} Or state the noise of the logs by --noise-log: the test is then planned for the robot as "
                    "its model says, or as an earlier --estimate does."
                ) from error
            show(f"{said}: {error}")
        else:
            return design(estimate, records, **asked)
    chosen = asked.pop("sample_time", None) or file.source.sample_time
    sample_time = chosen if motion is None else None
    known = file.robot if rough.estimate is None else load_estimate(rough.estimate, file)
    return design(known, sample_time=sample_time, **asked)


def _read(motion: Path, file: JointFile) -> Record:
    """Read a test of the user's own, or a past record: one of a drive has other columns beside those of a test.

    Raises:
        RecordError: it is neither.
    """
    from jointid import Column, inspect, read
    from jointid.common.parameters import POSITION_UNIT

    joint, known = file.joint, {one.name for one in inspect(motion).channels}
    try:
        return file.driving(motion)
    except RecordError as error:
        if not {"t", "reference"} <= known <= {"t", "reference", "injected"}:
            raise RecordError(
                f"{error} It was read as a past record, as the joint file says; a test of your own has the columns t, "
                "reference and, if a signal is added, injected, and no others."
            ) from None
    columns = {
        "reference": Column("reference", POSITION_UNIT[joint.kind]),
        "injected": Column("injected", joint.force_unit, optional=True),
    }
    return read(motion, columns, time="t", kind=joint.kind)
