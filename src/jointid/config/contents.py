"""The contents of a joint file: the objects that the verbs take."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from jointid.common.errors import JointFileError, MethodError, RecordError
from jointid.common.progress import Progress, silent
from jointid.config import serialise
from jointid.config.consistency import change_parameter, choose_method, needed_channels, torque_unit
from jointid.config.draft import list_channels
from jointid.config.schema_record import Run, Source, Together
from jointid.config.validation import check_tables
from jointid.estimation.identify import identify
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.methods.registry import Method
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller, with_numbers
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.checks import check_record
from jointid.records.chunks import Log
from jointid.records.columns import Column
from jointid.records.drives.drive import Drive
from jointid.records.reading import read
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write
from jointid.simulation.loop_input import ClosedLoop


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
        path: of the joint file; a text is taken to stand in `joint.toml`.

    Example:
        >>> from jointid.config import loads
        >>> file = loads('''
        ... [joint]
        ... kind = "revolute"
        ... [record.channels]
        ... torque = { column = "i_q", unit = "A" }
        ... motor_position = { column = "pos [deg]" }
        ... ''')
        >>> print(file.method, file.joint.torque_unit)
        IDIM(estimator='ols', effects=()) A
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
    path: Path = field(default=Path("joint.toml"), compare=False)

    @classmethod
    def of(cls, tables: Mapping[str, Any], path: Path = Path("joint.toml")) -> Self:
        """Return what the tables of a joint file say.

        Args:
            tables: the file's tables by name, as `tomllib` reads them.
            path: of the joint file.

        Raises:
            JointFileError: with one sentence for each fault.
        """
        file = check_tables(tables)
        channels, gear, drive = file.record.channels.given(), file.transmission, file.drive.build()
        transmission = gear.transmission(file.joint.kind) if gear else None
        joint = file.joint.joint(torque_unit(channels, file.joint.kind, gear, drive), transmission, file.gravity)
        named = list_channels(channels, drive)
        method = choose_method(file.method.name, named, file.controller is not None, joint.model)
        assert method is not None
        known = {parameter.name: parameter for parameter in joint.parameters}
        return cls(
            joint=joint,
            columns={name: table.build() for name, table in channels.items()},
            method=file.method.method(method, joint.model),
            controller=file.controller.refer(transmission) if file.controller else None,
            filtering=file.filtering.build(),
            parameters={name: change_parameter(known[name], table) for name, table in file.parameters.items()},
            drive=drive,
            source=file.record.build(),
            name=file.joint.name,
            runs=tuple(table.build() for table in file.records),
            together=file.together.build(),
            path=path,
        )

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
        record = read(path, self._columns, **self._reading, **self._clock, **self.source.options)
        controller, torque = self.controller, record.torque
        limit = controller.law(torque.sample_time).limit if controller is not None and torque is not None else None
        gear = self.joint.transmission
        check_record(record, limit=limit, side=None if gear is None else gear.side)
        return record

    def identify(self, record: Record, progress: Progress = silent) -> Estimate:
        """Identify the joint from a record, as the file says.

        Args:
            record: what `record` gave.
            progress: is told each step.

        Raises:
            JointidError: see `jointid.estimation.identify.identify`.
        """
        model = self.loop or self.joint
        return identify(
            record, model, self.method, filtering=self.filtering, parameters=self.parameters, progress=progress
        )

    @property
    def tells_of_its_loop(self) -> bool:
        """True if a check of the loop may begin at its estimate.

        The paper's search need not end where least squares would, and its loop would be blamed for that.
        """
        return not isinstance(self.method, FlexibleDIDIM) or self.method.minimiser == "least-squares"

    def log(self, path: str | os.PathLike[str] | None = None) -> Log:
        """Return the record as one that is read in chunks, when it is asked for; see `record`.

        Raises:
            RecordError: a channel has a sample time of its own, or no record is named.
        """
        return Log(self.record_path(path), self._columns, self._reading | self._clock, self.source.options)

    def write(self, record: Record, path: str | os.PathLike[str]) -> None:
        """Write a record, on the joint's side of its transmission, as this file reads it: `record(path)` gives it back.

        Raises:
            RecordError: see `jointid.records.writing.write`.
        """
        write(record, path, self.columns, **self._reading, **self.source.options)

    def record_path(self, path: str | os.PathLike[str] | None = None) -> str | os.PathLike[str]:
        """Return the path of the record: that one, or the one this file names.

        Raises:
            RecordError: this file names none.
        """
        if path is not None:
            return path
        if self.source.file is None:
            raise RecordError(f"{self.path} names no record; add file to [record], or name one by --record.")
        return self.path.parent / self.source.file

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
        """Return this file once for each record that is identified together, as if it were of that record alone.

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
                "start under [parameters], or identify the joint first."
            )
        return {p.name: float(p.start) for p in parameters if p.start is not None}

    def tables(self) -> dict[str, Any]:
        """Return the tables that say the same, as `of` takes them; what is at its default is left out.

        Raises:
            JointFileError: a joint file has no word for the friction or the controller, or the method is for the other
                model.
        """
        model = {parameter.name: parameter for parameter in self.joint.parameters}
        channels = {name: serialise.settings(column) for name, column in self.columns.items()}
        parameters = {name: serialise.parameter_table(p, model.get(name, p)) for name, p in self.parameters.items()}
        record = {**serialise.settings(self.source, "options"), **self.source.options, "channels": channels}
        tables = {
            "joint": serialise.joint_table(self.joint, self.name),
            "transmission": serialise.transmission_table(self.joint.transmission),
            "gravity": serialise.gravity_table(self.joint.gravity, self.joint.transmission),
            "record": record,
            "drive": serialise.settings(self.drive),
            "controller": {}
            if self.controller is None
            else serialise.controller_table(self.controller, self.joint.transmission),
            "filtering": serialise.filtering_table(self.filtering),
            "method": serialise.method_table(self.method, self.joint.model),
            "parameters": parameters,
            "records": [serialise.settings(run) for run in self.runs],
            "together": serialise.settings(self.together),
        }
        return {name: table for name, table in tables.items() if table}
