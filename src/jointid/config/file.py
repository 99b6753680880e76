"""The contents of a joint file or robot file.

A joint file has one axis and no robot, a robot file an axis for each joint.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid.common.arrays import FloatArray
from jointid.common.errors import Fault, MethodError, RecordError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.config.axis import Axis
from jointid.config.tables import FeedForward, Run, Source
from jointid.config.toml import Change
from jointid.estimation.methods import Method
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.joints import Joint
from jointid.models.limits import AxisLimits
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.chunks import Log, begin_together
from jointid.records.formats import format_of, read_table
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write_columns

if TYPE_CHECKING:
    from jointid.planning.designed import Design


@dataclass(frozen=True, slots=True, kw_only=True)
class File:
    """A joint file or robot file: system, record and method.

    Attributes:
        axes: the axes; a joint file has one.
        robot: robot of a robot file, with the file's joint data and the gravity of the mounted base.
        method: with its settings.
        filtering: how signals are filtered.
        parameters: changed parameters by name, for `identify`.
        feed_forward: torque that the drives receive in addition to the controllers' output.
        in_motion: whether the records of a robot begin while it moves.
        model_path: the file of the robot's model.
        locked: positions of the model's locked joints by name, rad or m.
        path: of the file; `joint.toml` for a text.
        name: of the joint or robot in reports.
        runs: listed records, for one fit of all.
        together: further quantities that such a fit identifies.
        text: of the file. changes: those applied by `load`, which the text does not contain.

    Example:
        >>> from jointid.config import loads
        >>> file = loads('''
        ... [joint]
        ... kind = "revolute"
        ... [record.channels]
        ... torque = { column = "i_q", unit = "A" }
        ... motor_position = { column = "pos [deg]" }
        ... ''')
        >>> print(file.method.name, file.joint.torque_unit)
        idim A
    """

    axes: tuple[Axis, ...]
    robot: Robot | None = field(default=None, compare=False)
    method: Method
    filtering: Filtering = field(default_factory=Filtering)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    feed_forward: FeedForward = "none"
    in_motion: bool = False
    model_path: Path | None = field(default=None, compare=False)
    locked: Mapping[str, float] = field(default_factory=dict)
    path: Path = field(default=Path("joint.toml"), compare=False)
    name: str | None = None
    runs: tuple[Run, ...] = ()
    together: tuple[str, ...] = ()
    text: str = field(default="", compare=False, repr=False)
    changes: tuple[Change, ...] = field(default=(), compare=False, repr=False)

    def __repr__(self) -> str:
        system = f"{self.joint.model} joint" if self.robot is None else f"robot of {len(self.axes)} joints"
        return f"File({str(self.path)!r}: {system} by {self.method.name}, record {str(self.source.file)!r})"

    @property
    def axis(self) -> Axis:
        """The axis of a joint file.

        Raises:
            MethodError: it is a robot file.
        """
        if self.robot is not None:
            raise MethodError(f"{self.path} is a robot file, and this is for one joint; name one of them by --axis.")
        return self.axes[0]

    @property
    def joint(self) -> Joint:
        """The joint of a joint file."""
        return self.axis.joint

    @property
    def controller(self) -> Controller | None:
        """Controller of a joint file, referred to the joint through its transmission."""
        return self.axis.controller

    @property
    def controllers(self) -> tuple[Controller | None, ...]:
        """Controller of each axis; None if unknown."""
        return tuple(axis.controller for axis in self.axes)

    @property
    def source(self) -> Source:
        """The file of the record."""
        return self.axes[0].source

    @property
    def limits(self) -> AxisLimits | tuple[AxisLimits, ...]:
        """Test limits of the joint, or of each joint of a robot."""
        return self.axis.limits if self.robot is None else tuple(axis.limits for axis in self.axes)

    @property
    def loop(self) -> Any:
        """The joint or robot with its controllers; None without a joint's controller.

        Raises:
            MethodError: a joint of a robot has no controller.
        """
        if self.robot is None:
            return self.axis.loop
        if missing := [str(axis.name) for axis in self.axes if axis.controller is None]:
            raise MethodError(
                f"A robot is simulated under its controllers; without one: {', '.join(missing)}. Add a controller to "
                "the [[joints]] table, or identify by idim from motor positions."
            )
        return RobotLoop(self.robot, tuple(one for one in self.controllers if one is not None), self.in_motion)

    @property
    def setup(self) -> Any:
        """System that the method identifies: closed loop, joint or robot."""
        if self.robot is None:
            return self.loop or self.joint
        return self.loop if self._simulates else self.robot

    @property
    def _simulates(self) -> bool:
        """True if the method simulates the closed loop."""
        return self.method.simulates == "loop" or getattr(self.method, "estimator", None) == "iv"

    def record(self, path: str | os.PathLike[str] | None = None, *, driving: bool = False) -> Any:
        """Read the record for `identify`; for a robot, one per joint.

        A channel that the method does not need may be absent, except a declared injected signal: without it the torque
        would be attributed to the controller. A computed feed-forward is added if the method simulates, or if every
        axis has a controller and a reference.

        Args:
            path: of the record, instead of the declared one.
            driving: whether it drives a simulation, which needs reference and injection only.

        Raises:
            RecordError: the file is missing or contradicts the declaration; `faults` has a
                sentence for each missing column, gap, jump of the clock, impossible scale, constant torque, and
                torque at the controller's limit; for a robot, each names its joint.
            MethodError: the feed-forward needs references of one rate.
        """
        found = self.records(path, driving=driving)
        whole = None not in self.controllers and all(one.reference is not None for one in found)
        if driving or whole or self._simulates or any(axis.computes_torque for axis in self.axes):
            found = self._fed_forward(found)
        if not driving and any(axis.computes_torque for axis in self.axes):
            from jointid.simulation.controller_torque import compute_controller_torque as compute

            pairs = zip(self.axes, found, strict=True)
            found = tuple(compute(one, axis.loop) if axis.computes_torque and axis.loop else one for axis, one in pairs)
        return found[0] if self.robot is None else found

    def records(self, path: str | os.PathLike[str] | None = None, *, driving: bool = False) -> tuple[Record, ...]:
        """Read all axes' records from one file; all begin at one time."""
        table = read_table(path := self.record_path(path), **self.source.options)
        found, faults = list[Record](), dict[Fault, list[str]]()
        for axis in self.axes:
            try:
                found.append(axis.read_record(table, Path(path).stem, driving=driving))
            except RecordError as error:
                for fault in error.faults:
                    faults.setdefault(fault, []).append(str(axis.name))
        if faults:
            every = len(self.axes)
            raise RecordError(f if len(names) == every else f"{', '.join(names)}: {f}" for f, names in faults.items())
        if payload := self._run(path).payload:  # carried by the last link
            found[-1] = replace(found[-1], payload=payload)
        return begin_together(found)

    def _fed_forward(self, found: tuple[Record, ...]) -> tuple[Record, ...]:
        """Return the records with feed-forward, either computed or logged."""
        mode, injected = self.feed_forward, [one.injected is not None for one in found]
        if mode == "none" or (mode == "logged" and all(injected)):
            return found
        if mode == "logged" or any(injected):
            raise RecordError(
                f'robot.feed_forward is "{mode}", and {sum(injected)} of {len(found)} joints have an injected channel; '
                'expected "logged" with the channel of each joint, or a computed one without any: correct one of both.'
            )
        from jointid.simulation.synthesis import add_feed_forward

        return add_feed_forward(self.loop, found, mode)

    def identify(self, record: Any, progress: Progress = ignore_progress, **asked: Any) -> Estimate:
        """Identify the joint or robot as declared; see `jointid.identify`.

        Args:
            record: result of `record`, or a list of them for several logs of a robot in one fit.
            progress: is called with each step.
            asked: further arguments of `jointid.identify`, such as checks.

        Raises:
            JointidError: see `jointid.identify`.
        """
        # Imported late: it loads the compiled kernels, which a check of the file does not need.
        from jointid.diagnostics.identify import identify

        return identify(
            record, self.setup, self.method, filtering=self.filtering, parameters=self.parameters, progress=progress,
            **asked,
        )  # fmt: skip

    def identify_together(
        self, paths: Sequence[str | os.PathLike[str]] = (), progress: Progress = ignore_progress
    ) -> Estimate:
        """Identify from several records in one fit, each with its declared load.

        Args:
            paths: of the records, instead of the listed ones.
            progress: is called with each step.

        Raises:
            JointidError: see `jointid.identify`.
        """
        pairs = self.each(paths)
        each = [part.record(path) for part, path in pairs]
        if self.robot is not None or len(each) == 1:
            return self.identify(each if len(each) > 1 else each[0], progress)
        runs, gear = [self._run(path) for _, path in pairs], self.joint.transmission
        to_joint = 1.0 if gear is None else gear.torque("load") ** 2
        added = [to_joint * run.added_inertia for run in runs]
        several = {"added_inertia": added, "own": [run.own for run in runs], "free": self.together}
        return self.identify(each, progress, several=several)

    def each(self, paths: Sequence[str | os.PathLike[str]] = ()) -> list[tuple[File, str | os.PathLike[str]]]:
        """Return pairs of `File` and path for each part of each record."""
        cuts = [replace(self.source, start=begin, stop=end, parts=()) for begin, end in self.source.parts]
        files = [replace(self, axes=tuple(replace(axis, source=one) for axis in self.axes)) for one in cuts] or [self]
        return [(file, path) for path in paths or self.listed or [self.record_path()] for file in files]

    @property
    def learn_settings(self) -> dict[str, Any]:
        """Arguments of `jointid.learn_controller`, in the units of the declared gain."""
        gain: float = getattr(self.controller, "gain", self.axis.units.plain_gain)
        gear = self.joint.transmission
        if gain != 1.0:  # refer the motor's torque to the joint, as the record's
            gain *= abs(getattr(self.controller, "ratio", 1.0 if gear is None else gear.torque("motor")))
        return {"gain": gain, "transmission": gear, "declared": self.controller}

    def log(self, path: str | os.PathLike[str] | None = None) -> Log:
        """Return the joint's record as a log in chunks; see `record`.

        Raises:
            RecordError: a channel has a separate sample time, or no record is named.
        """
        return Log(self.record_path(path), self.axis.channels, self.axis.reading, self.source.options)

    @property
    def listed(self) -> list[Path]:
        """Paths of the records that the file lists."""
        return [self.path.parent / run.file for run in self.runs]

    @property
    def only_lists(self) -> bool:
        """True if the file declares only lists of records or parts."""
        return bool(self.source.parts) or (bool(self.runs) and self.source.file is None)

    def record_path(self, path: str | os.PathLike[str] | None = None) -> str | os.PathLike[str]:
        """Return the given path, or else that of the declared record.

        Raises:
            RecordError: the file declares none.
        """
        if path is not None:
            return path
        if self.source.file is None:
            raise RecordError(f"{self.path} names no record in [record]; add file to it, or name one by --record.")
        return self.path.parent / self.source.file

    def inputs(self, record: Path | None = None) -> tuple[Path, ...]:
        """Return the files to read: a robot's model and the records."""
        named = record if record is not None or self.source.file is None else self.path.parent / self.source.file
        found = self.listed if record is None and self.runs else [named]
        return tuple(path for path in (self.model_path, *found) if path is not None)

    def write(self, record: Any, path: str | os.PathLike[str]) -> None:
        """Write a record on the joints' side, readable by `record`.

        A robot's channel without a declared column is written as JOINT.CHANNEL. If the file declares the sample time,
        the time is written to a column "t", which reading ignores.

        Raises:
            RecordError: the file cannot be written, or could not be read back.
        """
        table: dict[str, FloatArray] = {}
        each: Sequence[Record] = (record,) if self.robot is None else record
        for axis, one in zip(self.axes, each, strict=True):
            for name, values in axis.columns_to_write(one).items():
                undeclared = name in one.channels and all(name != column.column for column in axis.columns.values())
                table[f"{axis.name}.{name}" if undeclared and len(self.axes) > 1 else name] = values
        untimed = self.source.time is None and self.source.sample_time is not None
        if untimed and not any(name == "t" or name.isdecimal() for name in table):
            (_, first), *_ = each[0].items()
            table = {"t": first.time, **table}  # for human readers
        write_columns(table, path, **self.source.options)

    def lay_out(self, design: Design) -> Design:
        """Return a design with the columns, units and sides of this file.

        Of several axes a column that the file does not name begins with the joint's name.
        """
        columns: dict[str, FloatArray] = {}
        for axis, record in zip(self.axes, design.records(), strict=True):
            wide = axis.with_columns_of(record, f"{axis.name}." if len(self.axes) > 1 else "")
            columns |= wide.columns_to_write(record)
        is_text = self.source.file is not None and format_of(self.source.file).name == "CSV"
        return replace(design, columns=columns, options=self.source.options if is_text else {})

    def _run(self, path: str | os.PathLike[str]) -> Run:
        """Return the entry of the record at a path."""
        at = Path(path).resolve()
        return next((run for run, one in zip(self.runs, self.listed, strict=True) if one.resolve() == at), Run(""))
