"""Optima of searches from many starts, and how many searches reached each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from jointid.campaigns.rows import Outcome, Row
from jointid.common.document import Block, Heading, Table
from jointid.common.text import counted, number

_ALIKE = 0.1  # stated deviations, by which two ends may differ and be one
_ALIKE_WITHOUT = 1e-4  # relative, of a parameter without a deviation


@dataclass(frozen=True, slots=True)
class SearchEnd:
    """An optimum and the searches that reached it.

    Attributes:
        changes: swept settings that these searches have in common.
        best: the search of them that has the least error.
    """

    changes: tuple[str, ...]
    best: Row
    searches: tuple[Row, ...]


def ends_of(rows: Sequence[Row]) -> tuple[tuple[SearchEnd, ...], ...]:
    """Optima of every combination of settings, by error."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        if row.outcome is Outcome.IDENTIFIED:
            groups.setdefault(row.changes, []).append(row)
    return tuple(_group(changes, runs) for changes, runs in sorted(groups.items()))


def _group(changes: tuple[str, ...], runs: list[Row]) -> tuple[SearchEnd, ...]:
    ends: list[list[Row]] = []
    for row in sorted(runs, key=lambda row: (_error(row), row.place)):
        there = next((end for end in ends if _largest_distance(end[0], row)[0] <= 1), None)
        if there is None:
            ends.append([row])
        else:
            there.append(row)
    return tuple(SearchEnd(changes, end[0], tuple(end)) for end in ends)


def _error(row: Row) -> float:
    return float("inf") if row.error_percent is None else row.error_percent


def _largest_distance(best: Row, row: Row) -> tuple[float, str]:
    """Largest parameter difference of two optima, relative to tolerance, and its name."""
    most = (0.0, "")
    for name in {**best.found, **row.found}:
        one, other = best.found.get(name), row.found.get(name)
        values = [each.value for each in (one, other) if each is not None and each.value is not None]
        if len(values) < 2:  # refused in one of the two; in both it is alike
            if values:
                return float("inf"), name
            continue
        assert one is not None
        scale = _ALIKE * one.std if one.std else _ALIKE_WITHOUT * abs(values[0])
        apart = abs(values[1] - values[0])
        most = max(most, (apart / scale if scale else float("inf") if apart else 0.0, name))
    return most


def summarise_ends(groups: Sequence[Sequence[SearchEnd]]) -> tuple[str, bool | None]:
    """State how many searches reached the best fit, and whether all did."""
    if not groups:
        return "No search has come to an answer.", None
    alike = sum(len(ends[0].searches) for ends in groups)
    total = sum(len(end.searches) for ends in groups for end in ends)
    said = f"{alike} of {counted(total, 'search', 'searches')} ended at the best fit"
    return (f"{said}." if alike == total else f"{said}, the others elsewhere."), alike == total


def end_blocks(groups: Sequence[Sequence[SearchEnd]], most: int | None) -> Iterator[Block]:
    """Yield the parameters of the best fit, and the optima side by side."""
    for ends in groups:
        best = ends[0].best
        of = f": {'; '.join(ends[0].changes)}" if len(groups) > 1 else ""
        yield Heading(f"Best of the starts{of}")
        found = ((name, number(one.value), number(one.std, 3), one.unit) for name, one in best.found.items())
        yield Table(("parameter", "value", "std", "unit"), tuple(found), "", (0, 3))
        yield Heading(f"Where the searches ended{of}")
        rows = []
        for end in ends[:most]:
            apart, name = _largest_distance(best, end.best)
            far = "-" if end.best is best else f"{number(_ALIKE * apart, 3)} in {name}"
            error = "-" if end.best.error_percent is None else number(end.best.error_percent)
            rows.append((str(len(end.searches)), error, f"seed {end.best.seed}", far))
        yield Table(("searches", "error %", "first", "deviations from the best"), tuple(rows), "", (2, 3))
