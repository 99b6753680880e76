"""Find the positions of other axes in a log: columns whose names differ from this axis's by its number."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping

_NUMBER = re.compile(r"\d+")
_POSITIONS = ("motor_position", "reference")


def find_other_axes(channels: Mapping[str, str], names: Collection[str]) -> tuple[str, ...]:
    """Return the position columns of other axes, in the log's order.

    An axis has its number in several names: `pos[2]` and `torque[2]` beside `pos[0]` and `torque[0]`. One name with a
    number tells nothing: `data[0]` and `data[1]` may be anything.

    Args:
        channels: the column of each channel of this joint.
        names: of all columns.
    """
    numbered = {channel: dict(_axis_numbers(column, names)) for channel, column in channels.items()}
    position = next((channel for channel in _POSITIONS if channel in channels), None)
    if position is None:
        return ()
    for number, others in numbered[position].items():
        alike = [channel for channel, found in numbered.items() if number in found]
        if len({numbered[channel][number] for channel in alike}) > 1:
            return tuple(name for name in names if name in others and name not in channels.values())
    return ()


def _axis_numbers(column: str, names: Collection[str]) -> Iterator[tuple[int, frozenset[str]]]:
    """Yield each number in a column's name for which there are columns with another one, and those columns."""
    for match in _NUMBER.finditer(column):
        alike = re.compile(re.escape(column[: match.start()]) + r"\d+" + re.escape(column[match.end() :]))
        others = frozenset(name for name in names if name != column and alike.fullmatch(name))
        if others:
            yield int(match[0]), others
