"""Joint files for logs with columns of a known profile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit

from jointid.common.errors import RecordError
from jointid.common.text import show
from jointid.records.inspection import InspectedChannel, Inspection, LoggedAxis

_ASKED = """
# The controller's numbers are not in the log: remove the marks, and give law, gains and units of the drive.
# [controller]
# law = "{}"
# position_gain = "? N m/rad"
# derivative_gain = "? N m s/rad"
"""
_CHANNELS = """
[record.channels]
# torque = { column = "?", unit = "N m" }
# reference = { column = "?", unit = "rad" }
# motor_position = { column = "?", unit = "rad" }
"""


def describe_log(found: Inspection, file: str, axis: str | None = None) -> str:
    """Return the text of a joint file that reads an inspected log; what no log states is a remark.

    The file is the log's path from the joint file's folder, the axis the number or name of one of several.
    """
    log = found.recognised
    if log is None:
        names = ", ".join(show(channel.name) for channel in found.channels)
        text = tomlkit.dumps({"joint": {"kind": "revolute"}, "record": {"file": file}})
        return f"# No profile of a drive knows these columns: {names}.\n\n{text}{_CHANNELS}{_ASKED.format('pd')}"
    axes = {axis.name: axis for axis in log.axes}
    axes |= {str(one.place["axis"]): one for one in log.axes if "axis" in one.place}
    if axis is None and len(log.axes) == 1:
        axis = log.axes[0].name
    if axis not in axes:
        got = "" if axis is None else f"; got {axis}"
        raise RecordError(f"{found.file} has the axes {', '.join(map(show, axes))}{got}: name one of them (axis).")
    chosen, columns = axes[axis], {channel.name: channel for channel in found.channels}
    alone = {} if "torque" in chosen.channels else {"torque": "from_controller"}
    tables = {
        "joint": {"kind": "revolute"},
        "record": {"file": file, **alone, **_clock(columns, chosen)},
        "drive": {"profile": log.profile.name, **{key: value for key, value in chosen.place.items() if key != "index"}},
    }
    said = "".join(f"# {text}\n" for text in (log.sentence, *log.profile.assumed))
    return f"{said}\n{tomlkit.dumps(tables)}{_ASKED.format(log.profile.law or 'pd')}"


def _clock(columns: Mapping[str, InspectedChannel], axis: LoggedAxis) -> dict[str, Any]:
    """Return the keys of [record] for several or restarting clocks."""
    every = [columns[name] for name in axis.channels.values()]
    times = {channel.time: channel.sample_time for channel in every if channel.time and channel.sample_time}
    if len(times) > 1:
        return {"resample": {"sample_time": float(f"{min(times.values()):.3g}"), "method": "linear"}}
    return {"part": 0} if any(columns[name].stalls for name in times) else {}
