"""The commands `jointid design`, `simulate` and `reproduce`: planned and simulated tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Flag, Options, Quiet, deliver, listen, ready, show, spare
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import require_room, write_whole

if TYPE_CHECKING:
    from jointid import Estimate
    from jointid.config import File
    from jointid.planning.designed import Design


def design(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    goal: str = "all",
    duration: float | None = None,
    injection: Annotated[bool, Parameter(show=False)] = True,
    search_time: float = 60.0,
    within: Annotated[float | None, Parameter(show=False)] = None,
    motion: Annotated[Path | None, Parameter(show=False)] = None,
    out: Path | None = None,
) -> None:
    """Plan the next test within the limits of the axis.

    The joint, or the robot, is identified from the record. The most informative test that a drive can play is then
    searched for, of a joint also at other values of its interval. Ctrl-C ends the search and keeps the best test.

    Args:
        joint: the joint file (TOML), whose method is didim; or a robot file, which has the table [robot]: the most
            informative motion within the limits of its [[joints]], in addition to that of its record.
        options: those that most commands have.
        goal: quantity to identify: a parameter, a sum or a difference as "motor_viscous - load_viscous", or
            "all".
        duration: of the test, in s; without it that of the record.
        injection: whether the drive can add a signal to the torque.
        search_time: longest time of the search, in s.
        within: uncertainty of each value in percent, 2 sigma: limits and intervals hold for joints or robots drawn from
            it. Without it the intervals of the estimate of a joint, or 0.
        motion: a test of your own, which is predicted instead of a search: a past record, or a table with its columns
            and "injected", in the torque's unit, if a signal is added to the torque.
        out: also write the test into this folder: a CSV file in the columns, units and sides of the joint file, a page
            on how to run it, and, without a signal on the torque, the motion as a ROS 2 JointTrajectory (YAML).
    """
    from jointid import design as run
    from jointid.planning.predict import parse_goal

    if out is not None:
        require_room(out)
    test = out / "test.csv" if out is not None and out.is_dir() else None  # the only one that may be a record
    spare((options.json, test), motion)
    file = options.load(joint, test, method="didim")
    if file.robot is None:
        own = [file.parameters.get(p.name, p) for p in file.joint.parameters]
        parse_goal(goal, {p.name: file.joint.unit(p) for p in own if p.free})  # refused before the record is read
    asked: dict[str, Any] = {
        "goal": goal, "duration": duration, "search_time": search_time, "injection": injection, "within": within,
        "progress": options.progress, "limits": file.limits,
        "motion": None if motion is None else file.record(motion, driving=True),
    }  # fmt: skip
    if file.robot is None:
        record, model = options.identify(file, whole=True)
        if record.torque is not None and None in [p.value for p in model.rows if p.of_joint]:
            # What is refused is planned for by the declared starts, with the noise that the estimate leaves.
            noise = {"log": model.fit.relative_error * float((record.torque.values**2).mean() ** 0.5)}
            asked |= {"values": file.axis.values(), "noise": noise, "parameters": file.parameters}
            model, asked["filtering"] = file.loop, file.filtering
        found = run(model, record, **asked)
    else:
        found = _plan_robot(file, options, asked)
    found = file.lay_out(found)
    deliver(found, options.json)
    if out is not None:
        show(f"\nWritten to {out}: {', '.join(path.name for path in found.write(out))}")


def _plan_robot(file: File, options: Options, asked: dict[str, Any]) -> Design:
    """Plan the test of a robot from a record or its model."""
    from jointid import design

    # A motion that was never played has no logged feed-forward, so it is predicted without.
    asked |= {"filtering": file.filtering, "loop": file.loop if file.method.simulates else None}
    asked |= {"feed_forward": file.feed_forward.replace("logged", "none")}
    assert file.robot is not None
    each = zip(asked["limits"], file.robot.links, strict=True)
    known = all({"lower", "upper", "speed"} <= own.complete(link.limits).stated.keys() for own, link in each)
    if options.record is not None or file.source.file is not None or not (known or asked["motion"]):
        try:
            records, estimate = options.identify(file)
            return design(estimate, records, **asked)
        except RecordError as error:  # the log holds references only, or is not made yet
            if options.record is not None or not (known or asked["motion"]):
                raise
            show(f"The record that the robot file names is not used, and the robot is as its model says: {error}")
    return design(file.robot, sample_time=None if asked["motion"] else file.source.sample_time, **asked)


def simulate(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    identified: Flag = False,
    out: Path | None = None,
) -> None:
    """Simulate a joint or a robot under its controller.

    The reference of --record, and its injected signal if any, drive the loop.
    The signals that the drive would log are written to --out, a summary to --json. The parameters are the fixed values
    and starts of the file.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
        identified: use parameters identified from the file's record, or from the first of two --record, instead.
        out: write torque, reference and positions to this file, of any format, under the names and in the
            units in which the joint file, or its drive's profile, reads them, each on its own side of a transmission.
    """
    from jointid.output.json import dumps

    file = options.load(joint, out)
    own, options = (replace(options, records=one) for one in (options.records[:-1], options.records[-1:]))
    found = own.identify(file, several=True)[1] if identified else None
    simulation, logged, answer = (_simulate_joint if file.robot is None else _simulate_robot)(file, found, options)
    peaks = abs(simulation.torque).reshape(len(simulation.torque), -1).max(axis=0)
    each = zip(file.axes, peaks, strict=True)
    of_each = (f"{axis.name or ''} {peak:.5g} {axis.joint.force_unit}" for axis, peak in each)
    show(
        f"{len(simulation.torque)} samples of {simulation.sample_time:g} s, {simulation.events} reversals, stops and "
        f"starts; peak torque: {', '.join(map(str.lstrip, of_each))}"
    )
    if out is not None:
        file.write(logged, out)
        show(f"Written: {out}")
    if options.json is not None:
        write_whole(options.json, dumps(answer))


def _simulate_joint(file: File, estimate: Estimate | None, options: Options) -> tuple[Any, Any, Any]:
    """Return a joint's simulation, the drive's record, and the summary."""
    from jointid import simulate as run
    from jointid.output.json import simulation_answer
    from jointid.simulation.simulate import require_success

    if file.loop is None:
        raise MethodError("A simulation needs the controller; add a [controller] table to the joint file.")
    # The written record begins at 0, to which a position loop's offset refers.
    driven = replace(file.record(options.record, driving=True), begin=0.0)
    values = file.axis.values() if estimate is None else estimate.require_values()
    ready(options.progress, file, derivatives=False)
    found = require_success(run(file.loop, driven, values))
    show(f"{100 * found.at_limit:.2f} % of the time at the limit")
    stated = {"resampled": driven.resampled, "parameters": values, "at_limit": found.at_limit}
    (logged,) = found.records([driven], file.joint.force_unit)
    return found, logged, simulation_answer(found, driven.name, stated)


def _simulate_robot(file: File, estimate: Estimate | None, options: Options) -> tuple[Any, Any, Any]:
    """Return a robot's simulation, the drives' records, and the summary."""
    from jointid import simulate as run
    from jointid.output.json import simulation_answer
    from jointid.simulation.simulate import require_success
    from jointid.simulation.synthesis import tracking_errors

    loop, driven = file.loop, file.record(options.record, driving=True)
    robot = loop.robot
    if estimate is not None:
        loop = replace(loop, robot=estimate.require_robot().robot())
    found = require_success(run(loop, driven), f"The simulation of {robot.name}")
    astray = tracking_errors(driven, found)
    for k, off in astray.items():
        show(
            f"{robot.names[k]} does not follow its reference: it gets {off:.3g} {robot.position_unit(k)} off it; check "
            "its controller's gains and limit, and its signs."
        )
    stated = {"joints": robot.names, "tracking_errors": {robot.names[k]: off for k, off in astray.items()}}
    return found, found.records(driven), simulation_answer(found, robot.name, stated)


def reproduce(*, out: Path = Path("jointid-reproduction"), seed: int = 1, quiet: Quiet = False) -> None:
    """Run the paper end to end on its digital twin.

    Its tables show printed, recomputed and newly identified values.

    Args:
        out: folder for the HTML page and the figures; it is created if missing.
        seed: of the noise; the same seed gives the same bytes.
        quiet: print no progress.
    """
    from jointid.common.charts import render
    from jointid.output.figures import torque
    from jointid.output.report.sections import save
    from jointid.paper.reproduce import report_reproduction
    from jointid.paper.reproduce import reproduce as run

    require_room(out)
    ready(listen(quiet))
    report = report_reproduction(run(seed, listen(quiet)), lambda answer: render(torque(answer), "png", 100))
    show(f"Written: {', '.join(map(str, save(report, out, 'reproduction')))}")
