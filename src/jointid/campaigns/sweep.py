"""The effect of swept settings: each value against the least one, run by run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from jointid.campaigns.cases import Outcome, Row
from jointid.common.document import Block, Heading, Table
from jointid.common.text import format_signed, number

_Run: TypeAlias = tuple[str, str, str, tuple[str, ...]]


def sweep_blocks(rows: Sequence[Row], most: int | None) -> Iterator[Block]:
    """Yield the effect of each value of a swept setting.

    Numbers are relative to the least value: the median over pairs of runs, in per cent and in stated standard
    deviations.
    """
    settings: dict[str, dict[str, dict[_Run, Row]]] = {}
    for row in rows:
        for change in row.changes:
            key, _, value = change.partition("=")
            others = tuple(one for one in row.changes if one != change)
            run = (row.joint, row.record, row.day, others)
            settings.setdefault(key, {}).setdefault(value, {})[run] = row
    ends, effects = list[tuple[str, ...]](), list[tuple[str, ...]]()
    for key, by_value in settings.items():
        values = sorted(by_value, key=_sort_key)
        if len(values) < 2:  # set for all, and not swept
            continue
        for value in values:
            done = [row for row in by_value[value].values() if row.outcome is Outcome.IDENTIFIED]
            errors = [row.error_percent for row in done if row.error_percent is not None]
            error = number(float(np.median(errors))) if errors else "-"
            ends.append((f"{key}={value}", f"{len(done)} of {len(by_value[value])}", error))
        for value in values[1:]:
            effects += _effects(f"{key}={value} for {values[0]}", by_value[values[0]], by_value[value])
    if ends:
        yield Heading("Swept settings")
        yield Table(("setting", "identified", "error %"), tuple(ends), "", (0, 1))
    if effects:
        yield Heading("Effect of each swept setting")
        header = ("setting", "parameter", "effect %", "deviations", "pairs")
        yield Table(header, tuple(effects[:most]), "", (0, 1))


def _sort_key(value: str) -> tuple[float, str]:
    try:
        return float(value), value
    except ValueError:
        return float("inf"), value


def _effects(what: str, before: dict[_Run, Row], after: dict[_Run, Row]) -> Iterator[tuple[str, ...]]:
    """Yield the change of each parameter between two values of a setting."""
    pairs = [(before[run].found, after[run].found) for run in before if run in after]
    for name in dict.fromkeys(name for found, _ in pairs for name in found):
        moved = [
            (other.value - one.value, one.value, one.std)
            for found, again in pairs
            if (one := found.get(name)) and (other := again.get(name))
            and one.value is not None and other.value is not None
        ]  # fmt: skip
        percent = [100 * change / abs(value) for change, value, _ in moved if value]
        deviations = [change / std for change, _, std in moved if std]
        if moved:
            yield (
                what, name, format_signed(float(np.median(percent)), 3) if percent else "-",
                format_signed(float(np.median(deviations)), 2) if deviations else "-", str(len(moved)),
            )  # fmt: skip
