"""The verb `compare`: which quantities of a joint changed between two estimates.

The difference of two independent estimates of a quantity has the sum of their variances, and is tested against 0 with
the normal distribution. The p-values are adjusted for all quantities together by Holm (1979). Two estimates of one
record share their errors: their differences are shown without a test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from jointid.common.document import Document, Documented, Facts, Table
from jointid.common.errors import MethodError, RecordError
from jointid.common.text import in_words, join, number
from jointid.estimation.result.estimate import EstimatedParameter
from jointid.estimation.result.fields import read
from jointid.uncertainty.covariance import LEVEL


@dataclass(frozen=True, slots=True)
class QuantityChange:
    """Change of one quantity between two estimates.

    Attributes:
        name, symbol, unit: of the quantity.
        before, after: its values; None if not identifiable.
        difference: after less before; None if a value is missing.
        std: of the difference; None if it is not tested.
        p_value: of the difference, adjusted for all quantities tested; None if it is not tested.
        reason: why it is not tested.
    """

    name: str
    symbol: str
    unit: str
    before: float | None
    after: float | None
    difference: float | None
    std: float | None
    p_value: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class EstimateComparison(Documented):
    """Changes between two estimates.

    Attributes:
        records: the names of their records.
        same_record: True if a record of one is also of the other.
        rows: every quantity.
        level: of the family: the largest share of unchanged pairs in which some quantity is called changed.
    """

    in_json = "changed sentence"
    records: tuple[str, str]
    same_record: bool
    rows: tuple[QuantityChange, ...]
    level: float = LEVEL

    @property
    def changed(self) -> tuple[QuantityChange, ...]:
        """Significant changes, smallest p-value first."""
        found = [row for row in self.rows if row.p_value is not None and row.p_value <= self.level]
        return tuple(sorted(found, key=lambda row: row.p_value or 0.0))

    @property
    def sentence(self) -> str:
        """Whether anything changed."""
        tested = sum(row.p_value is not None for row in self.rows)
        if not tested:
            why = ", as both estimates share the errors of one record" if self.same_record else ""
            return f"No difference can be tested{why}."
        if not self.changed:
            return f"None of {tested} quantities changed significantly, at a level of {self.level:g} for all together."
        changes = []
        for row in self.changed:
            change = row.difference or 0.0
            size = f"{number(abs(change), 3)} ± {number(2 * (row.std or 0.0), 2)} {row.unit}"
            percent = f" ({100 * change / abs(row.before):+.1f} %)" if row.before else ""
            sense = "rose" if change > 0 else "fell"
            changes.append(f"{row.symbol} {sense} by {size}{percent}, p = {number(row.p_value, 2)}")
        return f"{len(changes)} of {tested} quantities changed significantly: {'; '.join(changes)}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the table; there are no further details."""
        del details
        rows = []
        for row in self.rows:
            mark, spread = "changed" if row in self.changed else row.reason, None if row.std is None else 2 * row.std
            values = number(row.before), number(row.after), number(row.difference, 3), number(spread, 2)
            rows.append((in_words(row.name), *values, row.unit, number(row.p_value, 2), mark, row.symbol))
        header = ("quantity", "A", "B", "B - A", "2 sigma", "unit", "p", "", "symbol")
        table = Table(header, tuple(rows), "p-values adjusted for all quantities together (Holm)", words=(0, 5, 7, 8))
        return Document(self.sentence, (Facts(tuple(zip("AB", self.records, strict=True))), table))


def compare(before: Mapping[str, Any], after: Mapping[str, Any]) -> EstimateComparison:
    """Compare two estimates of one joint, and test each difference.

    Args:
        before: the first estimate, as `to_dict` returns it.
        after: the second.

    Raises:
        MethodError: they are not of the same model, on the same side and in the same units.
        RecordError: one is no document of an estimate.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="white")
        >>> found = ji.to_dict(ji.identify(axis.record, axis.loop, checks=False))
        >>> print(ji.compare(found, found).sentence)
        No difference can be tested, as both estimates share the errors of one record.
    """
    both = before, after
    try:
        here, there = map(_describe_system, both)
        for what, one in here.items():
            if one != there.get(what):
                raise MethodError(
                    f"A and B are not of the same system: the {what} is {one} in A and {there.get(what)} in B; "
                    "identify both with the same file and options."
                )
        records = [{*map(str, one["data"]["fingerprints"])} for one in both]  # of the torques
        same = not records[0].isdisjoint(records[1])
        sums = [_sums(one) for one in both]
        parts = [[_quantities(one) for one in both], *([sums] if all(sums) else [])]  # several records look for none
        rows = [_compare(name, a.get(name), b.get(name), same) for a, b in parts for name in dict.fromkeys((*a, *b))]
        first, second = (str(one["data"]["record"]) for one in both)
        return EstimateComparison((first, second), same, _adjust_p_values(rows))
    except (LookupError, TypeError, ValueError, AttributeError):
        raise RecordError(
            "One of these is no estimate, or a damaged one; give what `to_dict` or `read_report` returned of each."
        ) from None


def _describe_system(answer: Mapping[str, Any]) -> dict[str, str]:
    """Properties that two estimates must share; for a robot, also its sums."""
    system = answer.get("settings", {})["system"]  # an estimate that is no document has no `get`
    gear, unit = system.get("transmission"), str(answer["data"]["torque_unit"])
    if "joints" in system:
        names = ", ".join(str(one["name"]) for one in system["joints"])
        sums = ", ".join(sorted(str(one["formula"]) for one in answer["parameters"].values()))
        return {"model": "robot", "robot": f"{system['name']} of {names}", "torque unit": unit, "list of sums": sums}
    said = {"model": system["model"], "kind": system["kind"], "friction law": system["friction"]["name"]}
    side = "none" if gear is None else f"{gear['side']} side, {gear['motor_per_load']:g} motor per load"
    return said | {"transmission": side, "torque unit": unit}


def _quantities(answer: Mapping[str, Any]) -> dict[str, EstimatedParameter]:
    """Parameters by name, without those of the initial state."""
    rows = {name: read(EstimatedParameter, raw) for name, raw in answer["parameters"].items()}
    of_motion = {name for name in rows if name.rpartition(".")[2].startswith("initial_")}
    if "joints" in answer["settings"]["system"]:
        of_motion |= {name for name, row in rows.items() if not row.axis}
    return {name: row for name, row in rows.items() if name not in of_motion}


def _sums(answer: Mapping[str, Any]) -> dict[str, EstimatedParameter]:
    """Return the sums of both sides of a flexible joint, by name."""
    stated = [{"free": True} | one | one["combination"] for one in (answer["known"] or {"physical": ()})["physical"]]
    rows = [read(EstimatedParameter, one | {"symbol": one["formula"], "stderr": one["std"]}) for one in stated]
    return {row.name: row for row in rows}


def _compare(
    name: str, before: EstimatedParameter | None, after: EstimatedParameter | None, same: bool
) -> QuantityChange:
    """Change of a quantity, which either may lack; p-value not adjusted.

    Raises:
        MethodError: its unit is another one.
    """
    both = {which: one for which, one in zip("AB", (before, after), strict=True) if one is not None}
    known, *others = both.values()
    if any(one.unit != known.unit for one in others):
        raise MethodError(f"{name} is not in {known.unit} in both A and B; identify both with one file.")
    first, second = (None if one is None else one.value for one in (before, after))
    difference = None if first is None or second is None else second - first
    lost = [which for which in "AB" if which not in both or both[which].value is None]
    kept = [which for which, one in both.items() if not one.free or one.stderr is None]
    std, p_value, spread = None, None, math.hypot(*(one.stderr or 0.0 for one in both.values()))
    reason = f"not identified in {join(lost)}" if lost else f"fixed in {join(kept)}" if kept else ""
    if same or not spread > 0:
        reason = reason or ("same record: not tested" if same else "standard deviation 0: not tested")
    elif difference is not None and not reason:
        std, p_value = spread, math.erfc(abs(difference) / spread / math.sqrt(2))
    return QuantityChange(name, known.symbol, known.unit, first, second, difference, std, p_value, reason)


def _adjust_p_values(rows: Sequence[QuantityChange]) -> tuple[QuantityChange, ...]:
    """Return the changes with p-values adjusted by Holm's method."""
    tested = sorted((row.p_value, i) for i, row in enumerate(rows) if row.p_value is not None)
    found, largest = list(rows), 0.0
    for rank, (p, i) in enumerate(tested):
        largest = max(largest, min((len(tested) - rank) * p, 1.0))
        found[i] = replace(rows[i], p_value=largest)
    return tuple(found)
