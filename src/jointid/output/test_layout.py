"""A designed test as the drives play it: in the columns, units and sides of the joint file or the robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT
from jointid.common.transmission import Side
from jointid.config import Axis, File
from jointid.planning.designed import Design, PlayedAxis
from jointid.records.columns import Column, unit_of_column
from jointid.records.formats import format_of
from jointid.records.record import Channel, Record, Timing

_SMALL = 1e-3  # of a position and a torque, whose columns say the factors: no column wraps there
_LIKE = {"reference": "motor_position", "injected": "torque"}


@dataclass(frozen=True, slots=True)
class FileLayout:
    """The columns of a test in the words of a file.

    A channel that the test has and the file does not name is in the unit of the motor's position, or of the torque.

    Attributes:
        files: what the file says of each axis; of several, the columns of such channels begin with the joint's name.
    """

    files: tuple[Axis, ...]

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of a text file, where the record is one."""
        source = self.files[0].source
        text = source.file is not None and format_of(source.file).name == "CSV"
        return source.options if text else {}

    @property
    def axes(self) -> tuple[PlayedAxis, ...]:
        """How each axis is said."""
        return tuple(self._axis(file) for file in self.files)

    def columns(self, records: Sequence[Record]) -> dict[str, FloatArray]:
        """Return the columns of a test by their names."""
        found: dict[str, FloatArray] = {}
        for file, record in zip(self.files, records, strict=True):
            found |= self._add_columns(file, record).columns_to_write(record)
        return found

    def _add_columns(self, file: Axis, record: Record) -> Axis:
        """Return the file with a column of every channel, and with the clock of the test."""
        columns = dict(file.columns)
        for name in record.channels:
            if name not in columns and file.drive.traces is None:
                own = f"{file.name}.{name}" if len(self.files) > 1 else name
                columns[name] = file.column_like(_LIKE.get(name, ""), own)
        own_clock = file.source.sample_time in (None, next(iter(record.items()))[1].sample_time)
        source = file.source if own_clock else replace(file.source, sample_time=None)
        return replace(file, columns=columns, source=source)

    def _axis(self, file: Axis) -> PlayedAxis:
        small, joint, gear = np.array([0.0, _SMALL]), file.joint, file.joint.transmission
        position = Channel(small, POSITION_UNIT[joint.kind], 1e-3)
        torque = Channel(small, joint.force_unit, 1e-3, Timing.HELD)
        said: dict[str, tuple[float, str]] = {}
        sides: dict[str, Side] = {}
        for name, record in (("reference", Record(reference=position)), ("torque", Record(torque=torque))):
            named = self._add_columns(file, record)
            named = replace(named, source=replace(named.source, sample_time=None))
            values = list(named.columns_to_write(record).values())[1]  # behind the time
            sides[name], columns = file.drive.side(name, named.columns.get(name)), dict(named.columns)
            traces = file.drive.traces
            kind = joint.kind if gear is None else gear.kind_of(sides[name])
            if traces is not None:
                columns[name] = traces.column(name, columns.get(name), file.drive.place, kind) or Column()
            said[name] = float(values[1]) / _SMALL, unit_of_column(name, columns, kind)
        injected = file.columns.get("injected")
        (position_factor, position_unit), (torque_factor, torque_unit) = said["reference"], said["torque"]
        return PlayedAxis(
            position_factor, torque_factor, position_unit, torque_unit,
            None if gear is None else sides["reference"], None if gear is None else sides["torque"],
            "" if injected is None else injected.column,
        )  # fmt: skip


def lay_out(file: File, design: Design) -> Design:
    """Return a design whose files have the columns, units and sides of a joint file or a robot file."""
    return replace(design, layout=FileLayout(file.axes))
