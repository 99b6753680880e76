"""A designed test as the drives play it: in the columns, units and sides of the joint file or the robot file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT
from jointid.common.transmission import Side
from jointid.config import Axis, File
from jointid.planning.designed import Design, Layout, PlayedAxis
from jointid.records.columns import Column, unit_of_column
from jointid.records.formats import format_of
from jointid.records.record import Channel, Record, Timing

_SMALL = 1e-3  # of a position and a torque, whose columns say the factors: no column wraps there
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
    played = tuple(_say_axis(axis, len(file.axes) > 1) for axis in file.axes)
    return replace(design, layout=Layout(played, columns, source.options if text else {}))


def _add_columns(file: Axis, record: Record, several: bool) -> Axis:
    """Return an axis of the file with a column of every channel, and with the clock of the test."""
    columns = dict(file.columns)
    for name in record.channels:
        if name not in columns and file.drive.traces is None:
            columns[name] = file.column_like(_LIKE.get(name, ""), f"{file.name}.{name}" if several else name)
    own_clock = file.source.sample_time in (None, next(iter(record.items()))[1].sample_time)
    source = file.source if own_clock else replace(file.source, sample_time=None)
    return replace(file, columns=columns, source=source)


def _say_axis(file: Axis, several: bool) -> PlayedAxis:
    """Return how an axis of the file says positions and torques."""
    small, joint, gear = np.array([0.0, _SMALL]), file.joint, file.joint.transmission
    position = Channel(small, POSITION_UNIT[joint.kind], 1e-3)
    torque = Channel(small, joint.force_unit, 1e-3, Timing.HELD)
    said: dict[str, tuple[float, str]] = {}
    sides: dict[str, Side] = {}
    for name, record in (("reference", Record(reference=position)), ("torque", Record(torque=torque))):
        named = _add_columns(file, record, several)
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
