"""A designed test as the drives play it: in the columns, units and sides of the joint file or the robot file."""

from __future__ import annotations

from dataclasses import replace

from jointid.common.arrays import FloatArray
from jointid.config import Axis, File
from jointid.planning.designed import Design
from jointid.records.formats import format_of
from jointid.records.record import Record

_LIKE = {"reference": "motor_position", "injected": "torque"}


def lay_out(file: File, design: Design) -> Design:
    """Return a design whose files have the columns, units and sides of a joint file or a robot file.

    A channel that the test has and the file does not name is in the unit of the motor's position, or of the torque. Of
    several axes such a column begins with the joint's name.
    """
    columns, source = dict[str, FloatArray](), file.axes[0].source
    for axis, record in zip(file.axes, design.records(), strict=True):
        columns |= _add_columns(axis, record, len(file.axes) > 1).columns_to_write(record)
    text = source.file is not None and format_of(source.file).name == "CSV"
    return replace(design, columns=columns, options=source.options if text else {})


def _add_columns(file: Axis, record: Record, several: bool) -> Axis:
    """Return an axis of the file with a column of every channel, and with the clock of the test."""
    columns = dict(file.columns)
    for name in record.channels:
        if name not in columns and file.drive.traces is None:
            columns[name] = file.column_like(_LIKE.get(name, ""), f"{file.name}.{name}" if several else name)
    own_clock = file.source.sample_time in (None, next(iter(record.items()))[1].sample_time)
    source = file.source if own_clock else replace(file.source, sample_time=None)
    return replace(file, columns=columns, source=source)
