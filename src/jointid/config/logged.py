"""Joint and robot files for logs with columns of a known profile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit

from jointid.common.errors import RecordError
from jointid.common.text import show
from jointid.records.inspection import InspectedChannel, Inspection
from jointid.records.recognition import LoggedAxis, Recognised

_MODEL = "robot.urdf"
_ASKED = """
# The controller's numbers are not in the log: remove the marks, and give law, gains and units of the drive.
# [{0}controller]
# law = "{1}"
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
    """Return the text of a file that reads a log: of a joint, or of a robot where the log has several axes.

    Gains that the log holds and that are constant become the controller's; what no log states is a remark.

    Args:
        found: what `inspect` gave.
        file: path of the log, from the folder of the file.
        axis: number or name of the axis to read alone.

    Raises:
        RecordError: there is no such axis.
    """
    log = found.recognised
    if log is None:
        names = ", ".join(show(channel.name) for channel in found.channels)
        text = tomlkit.dumps({"joint": {"kind": "revolute"}, "record": {"file": file}})
        return f"# No profile of a drive knows these columns: {names}.\n\n{text}{_CHANNELS}{_ASKED.format('', 'pd')}"
    axes = {axis.name: axis for axis in log.axes}
    axes |= {str(one.place["axis"]): one for one in log.axes if "axis" in one.place}
    if axis is not None and axis not in axes:
        raise RecordError(f"{found.file} has no axis {axis!r}; expected {', '.join(map(show, axes))}.")
    chosen = axes[axis] if axis is not None else log.axes[0] if len(log.axes) == 1 else None
    columns = {channel.name: channel for channel in found.channels}
    moving = [any(_moves(columns[name]) for name in one.channels.values()) for one in log.axes]
    last = max((k for k, moves in enumerate(moving) if moves), default=len(moving) - 1)
    every = log.axes[: last + 1]  # messages have more slots than a robot has motors
    used = every if chosen is None else (chosen,)
    alone = all("torque" not in one.channels for one in used)
    record = {"file": file, **({"torque": "from_controller"} if alone else {}), **_clock(columns, used)}
    said = [f"# {text}" for text in (log.sentence, *log.profile.assumed)]
    drive: dict[str, Any] = {"profile": log.profile.name}
    if chosen is not None:
        drive |= {key: value for key, value in chosen.place.items() if key != "index"}
        tables = {"joint": {"kind": "revolute"}, "record": record, "drive": drive, **_controller(log, chosen, columns)}
    else:
        said.append(f"# {_MODEL} is the robot's model; its joints are named here in the log's order: correct both.")
        joints = [{"name": one.name, **_controller(log, one, columns)} for one in every]
        tables = {"robot": {"model": _MODEL}, "record": record, "drive": drive, "joints": joints}
    text = "\n".join(said) + "\n\n" + tomlkit.dumps(tables)
    known = all("controller" in table for table in (tables.get("joints") or [tables]))
    return text if known else text + _ASKED.format("joints." if chosen is None else "", log.profile.law or "pd")


def _moves(channel: InspectedChannel) -> bool:
    return channel.minimum != channel.maximum


def _clock(columns: Mapping[str, InspectedChannel], axes: tuple[LoggedAxis, ...]) -> dict[str, Any]:
    """Return the keys of [record] for several or restarting clocks."""
    every = [columns[name] for axis in axes for name in axis.channels.values()]
    times = {channel.time: channel.sample_time for channel in every if channel.time and channel.sample_time}
    if len(times) > 1:
        return {"resample": {"sample_time": float(f"{min(times.values()):.3g}"), "method": "linear"}}
    return {"part": 0} if any(columns[name].stalls for name in times) else {}


def _controller(log: Recognised, axis: LoggedAxis, columns: Mapping[str, InspectedChannel]) -> dict[str, Any]:
    """Return [controller] of a known law whose logged gains are constant."""
    gains = {gain.key: (columns[name], gain.units[0]) for name, gain in axis.gains.items()}
    if not log.profile.law or len(gains) < 2 or any(_moves(columns[name]) for name in axis.gains):
        return {}
    said: dict[str, Any] = {key: f"{column.maximum:.9g} {unit}" for key, (column, unit) in gains.items()}
    if velocity := axis.channels.get("reference_velocity"):
        driven = _moves(columns[velocity]) or columns[velocity].minimum != 0
        said["reference_velocity"] = "channel" if driven else "none"
    return {"controller": {"law": log.profile.law, **said}}
