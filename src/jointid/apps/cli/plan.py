"""`jointid design`: the next test, planned from the record there is."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from jointid.apps.cli.console import DEFAULTS, Options, deliver, show
from jointid.apps.cli.places import Outputs
from jointid.common.errors import RecordError

if TYPE_CHECKING:
    from jointid import AxisLimits, Record
    from jointid.config import JointFile


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What the axis may do, on the side and in the units of the joint (m, rad, N, N m); else as [limits] says.

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
        """Return the limits that a joint file states, with those that are given here in their place."""
        given = {name: getattr(self, name) for name in self.__slots__}
        return replace(stated, **{name: limit for name, limit in given.items() if limit is not None})


NO_LIMITS = Limits()


def design(
    joint: Path,
    /,
    *,
    options: Options = DEFAULTS,
    limits: Limits = NO_LIMITS,
    goal: str = "all",
    duration: float | None = None,
    seconds: float = 60.0,
    motion: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
) -> None:
    """Plan the next test from a first record: the one that tells most of the joint within what its axis may do.

    The joint is identified from the record by didim; tests that a drive can play are then looked for, at the joint as
    it was found and at others of its interval. Ctrl-C ends the search and keeps the best test there is.

    Args:
        joint: the joint file (TOML); its method is didim.
        options: those that most commands have.
        limits: of the axis, in the place of those that [limits] of the joint file states.
        goal: what the test is to tell: a parameter, a sum or a difference as "motor_viscous - load_viscous", "weakest"
            (what is known worst) or "all".
        duration: of the test, in s; without it that of the record.
        seconds: that the search may take.
        motion: a test of your own, foretold in the place of one that is looked for: a table with the columns t (s),
            reference (m or rad) and, if a signal is added to the torque, injected (N, N m, or the torque's unit); or a
            past record, logged as the joint file says.
        out: also write the test into this folder: a CSV, a MAT file, and a page on how to run it.
        figure: also save reference, torque and spectrum as PNG, SVG or PDF.
    """
    from jointid import figures
    from jointid.planning.design import plan_from_estimate

    outputs = Outputs({"--json": options.json}, {"--figure": figure}, {"--out": out})
    outputs.spare("--motion", motion)
    file = options.load(joint, outputs, method="didim")
    allowed = limits.beside(file.limits)
    record, estimate = options.identify(file)
    found = plan_from_estimate(
        estimate,
        record,
        goal=goal,
        limits=allowed,
        duration=duration,
        seconds=seconds,
        motion=None if motion is None else _read(motion, file),
        progress=options.progress,
    )
    deliver(found, options.json, (figure, figures.draw))
    if out is not None:
        paths = found.write(out)
        show(f"\nWritten to {out}: {', '.join(path.name for path in paths)}")


def _read(motion: Path, file: JointFile) -> Record:
    """Read a test of the user's own, or a past record."""
    from jointid import Column, read
    from jointid.common.parameters import POSITION_UNIT

    joint = file.joint
    columns = {
        "reference": Column("reference", POSITION_UNIT[joint.kind]),
        "injected": Column("injected", joint.force_unit, optional=True),
    }
    try:
        return read(motion, columns, time="t")
    except RecordError:
        with contextlib.suppress(RecordError):
            return file.record(motion)
        raise
