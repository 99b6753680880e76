"""`jointid design`: the next test, planned from the record there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Options, deliver, make_folder, show
from jointid.apps.cli.places import Outputs
from jointid.apps.cli.results import require_goal
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import write_whole

if TYPE_CHECKING:
    from jointid import AxisLimits, Record
    from jointid.common.arrays import FloatArray
    from jointid.config import JointFile
    from jointid.config.robot_file import RobotFile
    from jointid.planning.joint_design import Design


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of the axis, in the joint's units (m, rad, N, N m); default [limits].

    Attributes:
        stroke: of the position, from one end to the other; without a limit that of the record.
        torque: the largest, with what is injected; without a limit that of the record.
        rms_torque: root mean square over the test; without a limit that of the record.
        speed: the largest, of motor and load; without a limit up to twice that of the record is tried.
        acceleration: the largest of the reference, likewise.
        jerk: the largest of the reference.
        windup: the largest of the spring, in which it rings.
        lowest: frequency of a chirp or of sines, Hz; without a limit 0.1.
        highest: frequency, likewise; without a limit the cut-off of the filter.
    """

    stroke: float | None = None
    torque: float | None = None
    rms_torque: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None
    windup: float | None = None
    lowest: float | None = None
    highest: float | None = None

    def beside(self, stated: AxisLimits) -> AxisLimits:
        """Return the limits of a joint file, overridden by the given ones."""
        given = {name: getattr(self, name) for name in self.__slots__}
        return replace(stated, **{name: limit for name, limit in given.items() if limit is not None})


NO_LIMITS = Limits()


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Rough:
    """Known values of a joint and the noise of a test, without identification.

    Attributes:
        noise_log: standard deviation of white noise on each logged torque, N or N m.
        noise_force: that of a white force on the motor, held over each period of the controller.
        estimate: what identify --json wrote: values and intervals; without it the values of [parameters], all of them.
        within: percent of each value, by which it may be off; 2 sigma. Without it the intervals of the estimate, or 0.
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
        beside = {"--estimate": self.estimate, "--within": self.within, "--sample-time": self.sample_time}
        if given := [name for name, value in beside.items() if value is not None]:
            raise MethodError(
                f"{given[0]} counts where nothing is identified from a record; add --noise-log or --noise-force, or "
                "leave it out."
            )
        return False

    def plan(self, file: JointFile, record: Path | None, asked: Mapping[str, Any]) -> Design:
        """Plan a test from the stated values; only the motion of a record is read.

        Raises:
            JointidError: a value or a limit is missing, or no test could be simulated.
        """
        import numpy as np

        from jointid import Noise, design

        loop = file.loop
        if loop is None:
            raise MethodError(
                "A test is planned for the joint under its controller; add [controller] to the joint file."
            )
        free = [p.name for p in loop.joint.parameters if file.parameters.get(p.name, p).free]
        values, covariance = self._values(file, free)
        if self.within is not None:
            deviations = np.array([0.005 * self.within * abs(values[name]) for name in free])
            covariance = np.diag(deviations**2)
        named = record is not None or file.source.file is not None
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
            identified = reading.read_identified(self.estimate, file.joint, file.loop)
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
    limits: Limits = NO_LIMITS,
    rough: Rough = NOTHING_ROUGH,
    goal: str = "all",
    duration: float | None = None,
    seconds: float = 60.0,
    motion: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> None:
    """Plan the next test from a first record: the one that tells most of the joint within what its axis may do.

    The joint is identified from the record by didim; tests that a drive can play are then searched for, at the joint as
    it was found and at others of its interval. Ctrl-C ends the search and keeps the best test there is. With
    --noise-log or --noise-force nothing is identified, and no record is needed: the joint is as an earlier answer, or
    [parameters], says.

    Args:
        joint: the joint file (TOML), whose method is didim; or a robot file, which has the table [robot]: the motion
            that tells most of it within the limits of its [[joints]], beside that of --record.
        options: those that most commands have.
        limits: of the axis, in the place of those that [limits] of the joint file states.
        rough: what is known of the joint and of the noise, where it is not identified from a record.
        goal: what the test is to tell: a parameter, a sum or a difference as "motor_viscous - load_viscous", "weakest"
            (what is known worst) or "all".
        duration: of the test, in s; without it that of the record.
        seconds: that the search may take.
        motion: a test of your own, predicted in the place of a search: a table with the columns t (s),
            reference (m or rad) and, if a signal is added to the torque, injected (N, N m, or the torque's unit); or a
            past record, logged as the joint file says.
        out: also write the test into this folder: a CSV, a MAT file, and a page on how to run it; of a robot a CSV as
            its file reads references, and the page.
        figure: also save reference, torque and spectrum as PNG, SVG or PDF.
    """
    from jointid import design as run
    from jointid import figures
    from jointid.config import JointFile

    outputs = Outputs({"--json": options.json}, {"--figure": figure}, {"--out": out})
    outputs.spare("--motion", motion)
    outputs.spare("--estimate", rough.estimate)
    file = options.load(joint, outputs)
    if not isinstance(file, JointFile):
        given = [name for one in (limits, rough) for name in one.__slots__ if getattr(one, name)]
        if given or goal != "all":
            options_given = [f"--{name.replace('_', '-')}" for name in given] + ["--goal"] * (goal != "all")
            raise MethodError(
                f"A robot's test tells all parameters within the limits of each of its [[joints]]; "
                f"{', '.join(options_given)} is for a joint file: leave it out."
            )
        _design_robot(file, options, duration, seconds, motion, out, figure)
        return
    file = options.load_joint(joint, outputs, method="didim")
    require_goal(file, goal)
    asked: dict[str, Any] = {
        "goal": goal,
        "limits": limits.beside(file.limits),
        "duration": duration,
        "seconds": seconds,
        "motion": None if motion is None else _read(motion, file),
        "progress": options.progress,
    }
    if rough.stated:
        found = rough.plan(file, options.record, asked)
    else:
        record, estimate = options.identify(file, checks=False)
        found = run(estimate, record, **asked)
    deliver(found, options.json, (figure, figures.draw))
    if out is not None:
        paths = found.write(out)
        show(f"\nWritten to {out}: {', '.join(path.name for path in paths)}")


def _design_robot(
    file: RobotFile, options: Options, duration: float | None, seconds: float, motion: Path | None, out: Path | None,
    figure: Path | None,
) -> None:  # fmt: skip
    """Plan the most informative motion of a robot, compared with a first record if any."""
    from jointid import IDIM, figures
    from jointid import design as run

    loop = None if isinstance(file.method, IDIM) else file.loop
    asked: dict[str, Any] = {
        "limits": file.limits, "duration": duration, "filtering": file.filtering, "seconds": seconds,
        # Of a motion that was never played nothing is logged: such a robot is predicted without.
        "feed_forward": "none" if file.feed_forward == "logged" else file.feed_forward, "progress": options.progress,
    }  # fmt: skip
    complete = all({"lower", "upper", "speed"} <= one.stated.keys() for one in file.limits)
    if motion is not None:
        asked["motion"] = file.driving(motion)
    if motion is not None and options.record is None:
        found = run(loop or file.robot, **asked)
    elif options.record is None and complete:
        found = run(loop or file.robot, sample_time=file.source.sample_time, **asked)
    else:
        records = file.record(options.record)
        found = run(file.identify(records, options.progress), records, loop=loop, **asked)
    deliver(found, options.json, (figure, figures.draw))
    if out is not None:
        make_folder(out, "--out")
        file.write(found.records(), out / "motion.csv")
        write_whole(out / "design.md", found.to_document().markdown())
        show(f"\nWritten to {out}: motion.csv, design.md")


def _read(motion: Path, file: JointFile) -> Record:
    """Read a test of the user's own, or a past record: one of a drive has other columns beside those of a test.

    Raises:
        RecordError: it is neither.
    """
    from jointid import Column, inspect, read
    from jointid.common.parameters import POSITION_UNIT

    joint = file.joint
    columns = {
        "reference": Column("reference", POSITION_UNIT[joint.kind]),
        "injected": Column("injected", joint.force_unit, optional=True),
    }
    found = {one.name for one in inspect(motion).channels}
    if {"t", "reference"} <= found <= {"t", *columns}:
        return read(motion, columns, time="t", kind=joint.kind)
    try:
        return file.record(motion)
    except RecordError as error:
        raise RecordError(
            f"{error} It was read as a past record, as the joint file says; a test of your own has the columns t, "
            "reference and, if a signal is added, injected, and no others."
        ) from None
