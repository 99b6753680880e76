"""The contents of a joint file: the objects that the verbs take."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import TORQUE_UNIT, Parameter
from jointid.common.units import Kind
from jointid.config import serialise
from jointid.config.consistency import (
    change_parameter,
    choose_method,
    find_contradictions,
    needed_channels,
    torque_unit,
)
from jointid.config.controller_gain import controller_gain, unit_faults
from jointid.config.drive_gains import translate_gains
from jointid.config.drive_numbers import drive_numbers
from jointid.config.quantities import Stated, find_quantities
from jointid.config.schema import FileTable, add_gains_of_times
from jointid.config.schema_record import Run, Source, Together
from jointid.estimation.methods.registry import Method
from jointid.estimation.problems.log_windows import Windowing
from jointid.estimation.problems.several_records import SeveralRecords
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller, with_numbers
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.limits import AxisLimits
from jointid.records.checks import check_record
from jointid.records.chunks import Log
from jointid.records.columns import Column, known_units
from jointid.records.drives import Drive
from jointid.records.formats import Table
from jointid.records.reading import RecordReader
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import columns_to_write, write_columns

if TYPE_CHECKING:
    from jointid.controller_id.learned_controller import LearnedController

_MOST = 1000  # keys of a table, records of a file


@dataclass(frozen=True, slots=True)
class JointFile:
    """A joint file: what is identified, from what, and how.

    Attributes:
        joint: the model; its torque is in A or V where the torque's channel is.
        columns: the channels, and where they are found; with a profile of the drive it finds the others.
        method: with its settings.
        controller: the controller's law as the joint sees it through its transmission, None while it is not known.
        filtering: how signals are filtered.
        parameters: changes to the joint's parameters by name, as `identify` takes them.
        drive: whose traces the record is made of, and the numbers behind its units.
        source: the file of the record.
        name: what reports call the joint.
        runs: records that are identified together.
        together: how they are; see `jointid.SeveralRecords`.
        limits: of the axis in a test that is planned; see `jointid.design`.
        path: of the joint file; a text is taken to stand in `joint.toml`.
        stated: numbers that were given with a unit, by the path of their key; a file that is written has them so.
        said: keys of [controller] that the file gives, and the gains that they say in other words.

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

    joint: Joint
    columns: Mapping[str, Column]
    method: Method
    controller: Controller | None = None
    filtering: Filtering = field(default_factory=Filtering)
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    drive: Drive = field(default_factory=Drive)
    source: Source = field(default_factory=Source)
    name: str | None = None
    runs: tuple[Run, ...] = ()
    together: Together = field(default_factory=Together)
    limits: AxisLimits = field(default_factory=AxisLimits)
    path: Path = field(default=Path("joint.toml"), compare=False)
    stated: Mapping[str, Stated] = field(default_factory=dict, compare=False, repr=False)
    said: Collection[str] = field(default=(), compare=False, repr=False)

    @classmethod
    def of(cls, tables: Mapping[str, Any], path: Path = Path("joint.toml")) -> Self:
        """Build a joint file from its tables.

        Args:
            tables: the file's tables by name, as `tomllib` reads them.
            path: of the joint file.

        Raises:
            JointFileError: with one sentence for each fault.
        """
        if crowded := list(_size_faults(tables)):  # each of so many would be a sentence
            raise JointFileError(crowded)
        corrected, misspelt = FileTable.correct_keys(tables)
        file, faults = FileTable.read(translate_gains(corrected))
        return cls.of_table(file, path, [*misspelt, *faults])

    @classmethod
    def of_table(cls, file: FileTable, path: Path, faults: Sequence[str] = ()) -> Self:
        """Build a joint file from checked tables.

        Args:
            file: the tables, without those that are wrong.
            path: of the joint file.
            faults: of the tables that are wrong.

        Raises:
            JointFileError: with these faults, and those between the tables.
        """
        if faults := [*faults, *unit_faults(file), *find_contradictions(file)]:
            raise JointFileError(faults)
        transmission = file.transmission.transmission(file.joint.kind) if file.transmission else None
        joint = file.joint.joint(torque_unit(file, file.joint.kind), transmission, file.gravity, file.ripple)
        method = choose_method(file, file.method.name, joint.model)
        assert method is not None
        known = {parameter.name: parameter for parameter in joint.parameters}
        return cls(
            joint=joint,
            columns={name: table.build() for name, table in file.record.channels.given_values().items()},
            method=file.method.method(method, joint.model),
            controller=file.controller.refer(transmission, controller_gain(file)) if file.controller else None,
            filtering=file.filtering.build(),
            parameters={name: change_parameter(known[name], table) for name, table in file.parameters.items()},
            drive=file.joint.drive(file.drive.build()),
            source=file.record.build(),
            name=file.joint.name,
            runs=tuple(table.build() for table in file.records),
            together=file.together.build(),
            limits=file.limits.build(),
            path=path,
            stated=dict(find_quantities(file)),
            said=add_gains_of_times(file.controller.model_fields_set) if file.controller else (),
        )

    @property
    def torque_per_unit(self) -> float | None:
        """The torque constant: torque per plain number of a controller on the motor's side."""
        return self.drive.torque_constant or self.drive.torque_per_volt

    def drive_numbers(self, learned: Controller) -> tuple[DriveNumber, ...]:
        """Return how the drive shows the numbers of a learned law, beside those that this file declares."""
        return drive_numbers(learned, self.controller, self.said, self.stated, self.joint, self.drive)

    @property
    def declared_numbers(self) -> tuple[DriveNumber, ...]:
        """How the drive shows the numbers of the controller that this file declares.

        The torque constant is one of them where it takes the logged torque, and no gain, to its unit.
        """
        if self.controller is None:
            return ()
        constant = self.torque_per_unit
        if constant is None or self.scale or not self._is_logged_by_unit("torque"):
            return self.drive_numbers(self.controller)
        there = DriveNumber("torque_constant", "torque_constant", self._constant_unit, 1.0, declared=constant)
        return (*self.drive_numbers(self.controller), there)

    @property
    def scale(self) -> str:
        """The torque constant where all values scale with it, as log and controller are in A or V.

        No record then shows an error of the constant. An injected torque, or a gain, would; the text is then empty.
        """
        constant, gear = self.torque_per_unit, self.joint.transmission
        if constant is None or "torque" not in self.columns:
            return ""
        if any(name in self.columns and not self._is_logged_by_unit(name) for name in ("torque", "injected")):
            return ""
        through = 1.0 if gear is None else abs(gear.motor_per_load)
        if getattr(self.controller, "gain", constant) not in (constant, constant * through):
            return ""
        return f"{constant:g} {self._constant_unit}"

    @property
    def _motor(self) -> Kind:
        gear = self.joint.transmission
        return self.joint.kind if gear is None else gear.motor

    @property
    def _constant_unit(self) -> str:
        return f"{TORQUE_UNIT[self._motor]}/{'V' if self.drive.torque_constant is None else 'A'}"

    def _is_logged_by_unit(self, name: str) -> bool:
        """Whether a column is stated in A or V."""
        column = self.columns.get(name)
        unit = None if column is None else column.stated_unit(known_units(name, self._motor))
        return unit is not None and units.unit(unit).dimension in ("current", "voltage")

    @property
    def loop(self) -> ClosedLoop | None:
        """The joint under its controller, None while the controller is not known."""
        return None if self.controller is None else ClosedLoop(self.joint, self.controller)

    def record(self, path: str | os.PathLike[str] | None = None) -> Record:
        """Read the record.

        A channel that the method does not need may be absent, except an injected signal: without it the torque
        would be taken for the controller's.

        Args:
            path: of the record, instead of the one the joint file names.

        Raises:
            RecordError: there is no such file, or it does not hold what the joint file says; `faults` has a
                sentence for each missing column, gap, jump of the clock, impossible scale, constant torque, and
                torque at the controller's limit.
        """
        path = self.record_path(path)
        return self.record_of(self.source.read(path, self.path.parent), Path(path).stem)

    def record_of(self, table: Table, name: str) -> Record:
        """Return the record that a table of columns holds; see `record`.

        Args:
            table: as the file of the record has it.
            name: of the record.
        """
        record = self._reader(self._columns, table).build_record(table, name)
        controller, torque = self.controller, record.torque
        limit = controller.law(torque.sample_time).limit if controller is not None and torque is not None else None
        gear = self.joint.transmission
        check_record(
            record,
            limit=limit,
            side=None if gear is None else gear.side,
            ratio=1.0 if gear is None else abs(gear.motor_per_load),
        )
        return record

    def driving(self, path: str | os.PathLike[str] | None = None) -> Record:
        """Read the signals that drive a simulation: reference and injection, others if present.

        Args:
            path: of the record, instead of the one the joint file names.

        Raises:
            RecordError: there is no such file, or it has no reference.
        """
        path = self.record_path(path)
        return self.driving_of(self.source.read(path, self.path.parent), Path(path).stem)

    def driving_of(self, table: Table, name: str) -> Record:
        """Return the signals that drive a simulation from a table; see `driving`."""
        seen = ("torque", "motor_position", "load_position")
        columns = {name: replace(c, optional=True) if name in seen else c for name, c in self._columns.items()}
        record = self._reader(columns, table).build_record(table, name)
        record.require(("reference",), "a simulation")
        return record

    def _reader(self, columns: Mapping[str, Column], table: Table) -> RecordReader:
        return RecordReader(columns, **{**self._reading, **self._clock, **self.source.reading(table)})

    def identify(
        self,
        record: Record,
        progress: Progress = ignore_progress,
        *,
        checks: bool = True,
        unchecked: Callable[[Estimate], None] | None = None,
    ) -> Estimate:
        """Identify the joint from a record, as the file says; see `jointid.identify`.

        Args:
            record: what `record` gave.
            progress: is called with each step.
            checks: whether to check the estimate.
            unchecked: is called with the estimate before its checks.

        Raises:
            JointidError: see `jointid.identify`.
        """
        # It loads the compiled kernels, which a check of the file does not need.
        from jointid.diagnostics.identify import identify

        return identify(
            record, self.loop or self.joint, self.method, filtering=self.filtering, parameters=self.parameters,
            checks=checks, shown=self.declared_numbers, torque_constant=self.scale, unchecked=unchecked,
            progress=progress,
        )  # fmt: skip

    def identify_together(self, paths: Sequence[Path], progress: Progress = ignore_progress) -> Estimate:
        """Identify the joint from several records in one fit.

        Args:
            paths: of the records, instead of those the file lists.
            progress: is called with each step.

        Raises:
            JointidError: see `jointid.identify`.
        """
        from jointid.diagnostics.identify import identify

        each = self.each(paths)
        loops = [one.loop for one in each if one.loop is not None]
        if not loops:
            raise MethodError(
                "Several records are identified by simulating their loop; add [controller] to the joint file."
            )
        several = SeveralRecords(
            added_inertia=[more for one in each for more in one.added_inertias],
            own=[more.own for one in each for more in one.runs],
            free=self.together.free,
            weighting=self.together.weighting,
        )
        return identify(
            [one.record() for one in each], loops, self.method, several=several, filtering=self.filtering,
            parameters=self.parameters, progress=progress,
        )  # fmt: skip

    def identify_log(self, path: Path | None, windows: Windowing, progress: Progress = ignore_progress) -> Estimate:
        """Identify the joint from a record too long for memory, in windows.

        Args:
            path: of the record, instead of the one the file names.
            windows: their length and settling.
            progress: is called with each step.

        Raises:
            JointidError: see `jointid.identify`.
        """
        from jointid.diagnostics.identify import identify

        if self.loop is None:
            raise MethodError("A long record is identified by simulating its loop; add [controller] to the joint file.")
        return identify(
            self.log(path), self.loop, self.method, windows=windows, filtering=self.filtering,
            parameters=self.parameters, progress=progress,
        )  # fmt: skip

    def learn_controller(self, record: Record, progress: Progress = ignore_progress) -> LearnedController:
        """Learn the controller, in its own units, which the torque constant or the gain of [controller] says.

        Args:
            record: what `record` gave.
            progress: is called with each step.

        Raises:
            JointidError: see `jointid.learn_controller`.
        """
        from jointid.controller_id.learn import learn_controller

        gain: float = getattr(self.controller, "gain", 1.0)
        if gain != 1.0:  # of the motor's torque; the record's is the joint's
            gain *= abs(getattr(self.controller, "ratio", 1.0))
        return learn_controller(
            record, gain=gain, transmission=self.joint.transmission, declared=self.controller, progress=progress
        )

    def log(self, path: str | os.PathLike[str] | None = None) -> Log:
        """Return the record as one that is read in chunks, when it is asked for; see `record`.

        Raises:
            RecordError: a channel has a sample time of its own, or no record is named.
        """
        if self.source.files and path is None:
            raise RecordError(
                "A record in several files is not read in chunks; join them to one file, or leave --window out."
            )
        return Log(self.record_path(path), self._columns, self._reading | self._clock, self.source.options)

    def write(self, record: Record, path: str | os.PathLike[str]) -> None:
        """Write a record, on the joint's side of its transmission, as this file reads it: `record(path)` gives it back.

        Raises:
            RecordError: see `jointid.records.writing.write`.
        """
        write_columns(self.columns_to_write(record), path, **self.source.options)

    def columns_to_write(self, record: Record) -> dict[str, FloatArray]:
        """Return the columns of the file that `write` makes, by their names.

        Raises:
            RecordError: see `jointid.records.writing.columns_to_write`.
        """
        return columns_to_write(record, self.columns, **self._reading)

    @property
    def column_names(self) -> frozenset[str]:
        """Names of the columns that channels are declared by, as the file of the record has them."""
        return frozenset(column.column for column in self.columns.values() if column.column)

    def record_path(self, path: str | os.PathLike[str] | None = None) -> str | os.PathLike[str]:
        """Return the path of the record: that one, or the one this file names.

        Raises:
            RecordError: this file names none.
        """
        if path is not None:
            return path
        if self.source.first is None:
            raise RecordError(f"{self.path} names no record; add file to [record], or name one by --record.")
        return self.path.parent / self.source.first

    def inputs(self, record: Path | None = None) -> tuple[Path, ...]:
        """Return the files that are read: the records that the file names, unless another one takes their place."""
        named = [run.file for run in self.runs] if self.runs else [*self.source.files, self.source.file]
        return tuple(self.path.parent / name for name in named if name) if record is None else (record,)

    @property
    def _columns(self) -> dict[str, Column]:
        """The channels to read: those that the method needs, and others if they are there."""
        needed = {*needed_channels(self.method.name, self.controller, self.joint.model), "injected"}
        columns = {n: c if n in needed else replace(c, optional=True) for n, c in self.columns.items()}
        if self.drive.traces is not None:  # it is to find what the method needs and the file does not name
            columns |= {n: Column() for n in needed if n not in columns and n != "injected"}
        return columns

    @property
    def _reading(self) -> dict[str, Any]:
        """Arguments of reading and writing a record, beside its columns."""
        return {
            "drive": self.drive,
            "time": self.source.time,
            "time_unit": self.source.time_unit,
            "sample_time": self.source.sample_time,
            "kind": self.joint.kind,
            "transmission": self.joint.transmission,
        }

    @property
    def _clock(self) -> dict[str, Any]:
        """Further arguments of reading one."""
        return {"clock_tolerance": self.source.clock_tolerance, "resample": self.source.resample}

    @property
    def added_inertias(self) -> tuple[float, ...]:
        """Inertia that each run adds, given on the load, as it is on the joint's side."""
        gear = self.joint.transmission
        factor = 1.0 if gear is None else gear.torque("load") ** 2
        return tuple(factor * run.added_inertia for run in self.runs)

    def each(self, paths: Sequence[Path] = ()) -> tuple[JointFile, ...]:
        """Return a copy of this file for each record that is identified together.

        Args:
            paths: of the records, instead of those the file lists, in their order.

        Raises:
            JointFileError: the paths are not as many as the records that are listed.
        """
        if paths and self.runs and len(paths) != len(self.runs):
            raise JointFileError(
                f"{self.path} lists {len(self.runs)} records and {len(paths)} are named; name as many, in their order."
            )
        runs = self.runs or tuple(Run(str(path)) for path in paths)
        files = [str(path.absolute()) for path in paths] or [run.file for run in runs]
        return tuple(
            replace(
                self,
                source=replace(self.source, file=file),
                controller=None if self.controller is None else with_numbers(self.controller, run.controller),
                runs=(run,),
            )
            for file, run in zip(files, runs, strict=True)
        )

    def values(self) -> dict[str, float]:
        """Return a value for every parameter of the joint, for a simulation: fixed values and starts.

        Raises:
            MethodError: a parameter has neither.
        """
        parameters = [self.parameters.get(p.name, p) for p in self.joint.parameters]
        missing = [p.name for p in parameters if p.start is None]
        if missing:
            raise MethodError(
                f"A simulation needs a value for every parameter; {', '.join(missing)} has none: give it a value or a "
                "start in the table parameters, or identify the joint first."
            )
        return {p.name: float(p.start) for p in parameters if p.start is not None}

    def tables(self) -> dict[str, Any]:
        """Return the tables that `of` reads back to this file, without defaults.

        Raises:
            JointFileError: a joint file has no word for the friction or the controller, or the method is for the other
                model.
        """
        model, gear = {parameter.name: parameter for parameter in self.joint.parameters}, self.joint.transmission
        channels = {name: serialise.settings(column) for name, column in self.columns.items()}
        parameters = {name: serialise.parameter_table(p, model.get(name, p)) for name, p in self.parameters.items()}
        record = {**serialise.settings(self.source, "options"), **self.source.options, "channels": channels}
        tables = {
            "joint": serialise.joint_table(self.joint, self.name) | serialise.torque_constant(self.drive, self.joint),
            "transmission": {} if gear is None else serialise.settings(gear, "load"),
            "gravity": serialise.gravity_table(self.joint.gravity, gear),
            "ripple": {} if self.joint.ripple is None else serialise.settings(self.joint.ripple),
            "record": record,
            "drive": serialise.settings(self.drive, "torque_constant", "torque_per_volt"),
            "controller": {}
            if self.controller is None
            else serialise.controller_table(self.controller, gear, self.torque_per_unit),
            "filtering": serialise.filtering_table(self.filtering),
            "method": serialise.method_table(self.method, self.joint.model),
            "parameters": parameters,
            "records": [serialise.settings(run) for run in self.runs],
            "together": serialise.settings(self.together),
            "limits": serialise.settings(self.limits),
        }
        return serialise.restore_units({name: table for name, table in tables.items() if table}, self.stated)


def _size_faults(raw: Mapping[str, Any], where: str = "The joint file") -> Iterator[str]:
    """Yield tables with too many keys, and lists with too many tables."""
    if len(raw) > _MOST:
        yield f"{where} has {len(raw)} keys; expected at most {_MOST}: is it another kind of file?"
        return
    for key, value in raw.items():
        if isinstance(value, dict):
            yield from _size_faults(value, key)
        elif isinstance(value, list) and len(value) > _MOST and isinstance(value[0], dict):
            yield f"{key} lists {len(value)} tables; expected at most {_MOST}: split the joint file."
