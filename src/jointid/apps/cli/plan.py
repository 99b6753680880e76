"""`jointid design`: the next test, planned from the record there is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.apps.cli.console import DEFAULTS, Options, deliver, show, spare
from jointid.common.errors import RecordError
from jointid.common.files import require_room

if TYPE_CHECKING:
    from jointid.config import File
    from jointid.planning.designed import Design


def design(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    goal: str = "all",
    duration: float | None = None,
    injection: bool = True,
    search_time: float = 60.0,
    within: float | None = None,
    motion: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> None:
    """Plan the next test within the limits of the axis.

    It is the one that tells most of the joint.
    The joint, or the robot, is identified from the record. Tests that a drive can play are then searched for, of a
    joint also at others of its interval. Ctrl-C ends the search and keeps the best test there is.

    Args:
        joint: the joint file (TOML), whose method is didim; or a robot file, which has the table [robot]: the motion
            that tells most of it within the limits of its [[joints]], beside that of its record.
        options: those that most commands have.
        goal: what the test is to tell: a parameter, a sum or a difference as "motor_viscous - load_viscous", or
            "all".
        duration: of the test, in s; without it that of the record.
        injection: whether the drive can add a signal to the torque.
        search_time: that the search may take, in s.
        within: percent of each value, by which it may be off; 2 sigma: limits and intervals hold for joints or robots
            drawn from that. Without it the intervals of the estimate of a joint, or 0.
        motion: a test of your own, predicted in the place of a search: a past record, or a table with its columns and
            "injected", in the torque's unit, if a signal is added to the torque.
        out: also write the test into this folder: a CSV file in the columns, units and sides of the joint file, a page
            on how to run it, and, without a signal on the torque, the motion as a ROS 2 JointTrajectory (YAML).
        figure: also save reference, torque and spectrum as PNG, SVG or PDF.
    """
    from jointid import design as run
    from jointid import figures
    from jointid.output.test_layout import lay_out

    figures.require_format(figure)
    outputs = [figure]
    if out is not None:
        require_room(out)
        outputs += [out / "test.csv"] if out.is_dir() else []  # the only one that may be a record
    spare((options.json, *outputs), motion)
    file = options.load(joint, *outputs, method="didim")
    if file.robot is None:
        _require_goal(file, goal)
    asked: dict[str, Any] = {
        "goal": goal, "duration": duration, "search_time": search_time, "injection": injection, "within": within,
        "progress": options.progress, "limits": file.limits,
        "motion": None if motion is None else file.record(motion, driving=True),
    }  # fmt: skip
    if file.robot is None:
        record, estimate = options.identify(file, checks=False, whole=True)
        found = run(estimate, record, **asked)
    else:
        found = _plan_robot(file, options, asked)
    found = lay_out(file, found)
    deliver(found, options.json, (figure, lambda one: one.plot()))
    if out is not None:
        paths = found.write(out)
        show(f"\nWritten to {out}: {', '.join(path.name for path in paths)}")


def _require_goal(file: File, goal: str) -> None:
    """Raise a `MethodError` if no test can be planned for this goal, before the record is read."""
    from jointid.planning.predict import parse_goal

    own = [file.parameters.get(p.name, p) for p in file.joint.parameters]
    parse_goal(goal, {p.name: file.joint.unit(p) for p in own if p.free})


def _plan_robot(file: File, options: Options, asked: dict[str, Any]) -> Design:
    """Plan the test of a robot from a record, or from its model alone."""
    from jointid import design

    # Of a motion that was never played nothing is logged: such a robot is predicted without.
    asked |= {"filtering": file.filtering, "loop": None if file.method.name == "idim" else file.loop}
    asked |= {"feed_forward": file.feed_forward.replace("logged", "none")}
    known = all({"lower", "upper", "speed"} <= one.stated.keys() for one in asked["limits"])
    if options.record is not None or file.source.file is not None or not (known or asked["motion"]):
        try:
            records = file.record(options.record)
            return design(file.identify(records, options.progress, checks=False), records, **asked)
        except RecordError as error:  # references to simulate, or a log that is still to be made
            if options.record is not None or not (known or asked["motion"]):
                raise
            show(f"The record that the robot file names is not used, and the robot is as its model says: {error}")
    assert file.robot is not None
    return design(file.robot, sample_time=None if asked["motion"] else file.source.sample_time, **asked)
