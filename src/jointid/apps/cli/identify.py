"""The commands `jointid identify`, `learn-controller`, `tune` and `payload`, on a record."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Flag, Options, deliver, save, show, spare
from jointid.common.errors import MethodError


def identify(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    window: float | None = None,
    figure: Path | None = None,
    details: Flag = False,
    no_checks: Flag = False,
) -> None:
    """Identify a joint or a robot from its record.

    Or from several records in one fit, or from hours of a log in bounded memory. The first line is printed before the
    checks, too. The estimate is stored beside the joint file, and other commands begin from it.

    Args:
        joint: the joint file (TOML), or a robot file, which has the table [robot].
        options: those that most commands have.
        window: seconds of a window; identify a log that is too long for memory in windows, and test for drift; a
            joint's is read in chunks, from a format with consecutive rows.
        figure: also save measured, simulated and error torque as PNG, SVG or PDF.
        details: print every verdict with all its reasons, the method's tests, effort and settings.
        no_checks: leave out the checks; the answer then says so.
    """
    from jointid import figures, validate
    from jointid.estimation.result.estimate import IN_WINDOWS

    figures.require_format(figure)
    file = options.load(joint, figure, alone=len(options.records) > 1 and figure is not None)
    if window is not None and figure is not None:
        raise MethodError(IN_WINDOWS)
    if figure is not None and (len(options.records) > 1 or file.runs or file.source.parts):
        options = replace(options, again=True)  # the torque of several records is not kept
    record, found = options.identify(
        file, several=True, whole=figure is not None, window=window, checks=not no_checks,
        first=partial(save, json=options.json),
    )  # fmt: skip
    deliver(found, options.json, details=details)
    if figure is not None:
        figures.save(figures.torque(found if found.fit.measured.size else validate(found, record)), figure)


def learn_controller(joint: Path, /, *, options: Options = DEFAULTS, write: Path | None = None) -> None:
    """Learn the controller from a record.

    The record has reference, motor position and torque.

    Args:
        joint: the joint file (TOML); channels and drive are enough. A [controller] in it provides the gain, and limit
            and delay if the record does not show them.
        options: those that most commands have.
        write: also write the joint file to this file, with the learned [controller] and the given record. Comments and
            all other lines are kept; the paths of records are adapted to another folder.
    """
    from jointid import learn_controller as run
    from jointid.config import controller_text, load, save_with_controller

    if write is not None and options.axis is not None:
        raise MethodError("--write is for a joint file; leave it out, and copy what is printed to [joints.controller].")
    file = load(joint, [*options.changes, 'method={name="didim"}'], axis=options.axis)
    spare((options.json, write), joint, *file.inputs(options.record))
    learned = run(file.record(options.record), progress=options.progress, **file.learn_settings)
    deliver(learned, options.json)
    show(f"\n{controller_text(learned.controller, file.axis).rstrip()}")
    if write is not None:
        save_with_controller(file, learned.controller, write, options.record)
        show(f"Written: {write}")


def tune(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    gain_margin: float = 2.0,
    phase_margin: float = 45.0,
    notch: bool = True,
) -> None:
    """Propose gains, and report the margins of the loop.

    The joint is identified by didim first.

    Args:
        joint: the joint file (TOML).
        options: those that most commands have.
        gain_margin: of the proposed loop in the worst case, a ratio; 2 is 6 dB.
        phase_margin: likewise, degrees.
        notch: whether a notch filter may be proposed.
    """
    from jointid import tune as run

    _, estimate = options.identify(options.load(joint, alone=True, method="didim"))
    tuned = run(estimate, progress=options.progress, gain_margin=gain_margin, phase_margin=phase_margin, notch=notch)
    deliver(tuned, options.json)


def payload(
    robot: Path,
    /,
    *,
    options: Options = DEFAULTS,
    with_: Annotated[Path, Parameter(name="--with")],
    without: Path | None = None,
) -> None:
    """Identify a robot's payload: mass, centre and inertia.

    From a record without the payload and one with it.
    By IDIM from motor positions and torques, by DIDIM from torques and references, or on the drive side from torques
    and motor positions of a flexible robot, as the robot file asks.

    Args:
        robot: the robot file (TOML), which has the table [robot].
        options: those that most commands have.
        with_: the record with the payload.
        without: the record without it, of the same or another motion, instead of the file's.
    """
    from jointid.estimation.robots.bodies import identify_payload

    spare((options.json,), without, with_)
    if options.axis or (options.records and without):
        raise MethodError("A payload is of the whole robot, from one record without it; leave out --axis, or --record.")
    options = options if without is None else replace(options, records=(without,))
    file = options.load(robot)
    if file.robot is None:
        raise MethodError(f"{robot} is no robot file, which has the table [robot]: give one.")
    if file.parameters:
        raise MethodError(f"joints.parameters keeps {', '.join(file.parameters)}; leave it out: a payload frees all.")
    found = identify_payload(
        file.setup, options.identify(file, checks=False)[1], file.record(with_), file.method, filtering=file.filtering,
        progress=options.progress,
    )  # fmt: skip
    deliver(found, options.json)
