"""Changes of a joint between two estimates: which are significant.

The difference of two independent estimates of a quantity has the sum of their variances, and is tested against 0 with
the normal distribution. Many quantities are tested at once, so the p-values are adjusted by Holm (1979): with nothing
changed, the probability that any of them falls below the level is at most the level. Two estimates of one record share
their errors; their differences come from the settings and are shown without a test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jointid.common.document import Document, Documented, Facts, Listing, Table
from jointid.common.errors import MethodError
from jointid.common.text import in_words, number

LEVEL = 0.05
"""Family-wise significance level: largest share of unchanged pairs in which some quantity is called changed."""


@dataclass(frozen=True, slots=True)
class ReportedQuantity:
    """One quantity of an estimate, read from its file.

    Attributes:
        name: in words.
        symbol: or formula, of a sum.
        unit: of the value.
        value: None where it is not identifiable.
        std: None where it was fixed or is not identifiable.
        free: True if it was identified.
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    std: float | None
    free: bool = True


@dataclass(frozen=True, slots=True)
class ReportedEstimate:
    """An estimate, read from its file.

    Attributes:
        label: name of its file.
        record: name of its record or records. fingerprints: of the torque of each; none of a long log.
        model, kind, friction: of the joint; the kind of a robot is its name with its joints.
        side: of the transmission with its ratio, in words; empty without one.
        torque_unit: of the record.
        settings: by name; differences between two estimates become notes.
        error: of the raw torque, a ratio; None of a long log.
        quantities: parameters, those of the initial state left out.
        sums: of both sides of a flexible joint.
    """

    label: str
    record: str
    fingerprints: tuple[str, ...]
    model: str
    kind: str
    friction: str
    side: str
    torque_unit: str
    settings: Mapping[str, str]
    error: float | None
    quantities: tuple[ReportedQuantity, ...]
    sums: tuple[ReportedQuantity, ...]


@dataclass(frozen=True, slots=True)
class QuantityChange:
    """Change of one quantity between two estimates.

    Attributes:
        name, symbol, unit: of the quantity.
        before, after: its values; None where not identifiable.
        difference: after less before; None where there is none.
        std: of the difference; None where it is not tested.
        p_value: of the difference, adjusted for all quantities tested; None where it is not tested.
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
        before, after: the estimates.
        rows: every quantity.
        level: see `LEVEL`.
        notes: limits of the comparison, one sentence each.
    """

    in_json = "same_record changed sentences"
    before: ReportedEstimate
    after: ReportedEstimate
    rows: tuple[QuantityChange, ...]
    level: float
    notes: tuple[str, ...]

    @property
    def same_record(self) -> bool:
        """True if a record of one is also of the other."""
        return not set(self.before.fingerprints).isdisjoint(self.after.fingerprints)

    @property
    def changed(self) -> tuple[QuantityChange, ...]:
        """Significant changes, smallest p-value first."""
        found = [row for row in self.rows if row.p_value is not None and row.p_value <= self.level]
        return tuple(sorted(found, key=lambda row: row.p_value or 0.0))

    @property
    def sentences(self) -> tuple[str, ...]:
        """The result of the tests, then the notes."""
        tested = sum(row.p_value is not None for row in self.rows)
        if not tested:
            why = ", as both estimates share the errors of one record" if self.same_record else ""
            return (f"No difference can be tested{why}.", *self.notes)
        if not self.changed:
            said = f"None of {tested} quantities changed significantly, at a level of {self.level:g} for all together."
            return (said, *self.notes)
        changes = []
        for row in self.changed:
            assert row.difference is not None
            assert row.std is not None
            percent = f" ({100 * row.difference / abs(row.before):+.1f} %)" if row.before else ""
            sense = "rose" if row.difference > 0 else "fell"
            size = f"{number(abs(row.difference), 3)} ± {number(2 * row.std, 2)} {row.unit}"
            changes.append(f"{row.symbol} {sense} by {size}{percent}, {_format_p(row.p_value or 0.0, labelled=True)}")
        return (f"{len(changes)} of {tested} quantities changed significantly: {'; '.join(changes)}.", *self.notes)

    @property
    def sentence(self) -> str:
        """Whether anything changed."""
        return self.sentences[0]

    def to_document(self, *, details: bool = False) -> Document:
        """Return the table and the sentences; there are no further details."""
        del details
        header = ("quantity", "A", "B", "B - A", "2 sigma", "unit", "p", "", "symbol")
        errors = " and ".join(
            "-" if one.error is None else f"{100 * one.error:.2f} %" for one in (self.before, self.after)
        )
        sources = tuple(
            (name, f"{stated.label}, of {stated.record}") for name, stated in (("A", self.before), ("B", self.after))
        )
        rows, short = [], [row.name.partition(" with ")[0] for row in self.rows]
        for row, name in zip(self.rows, short, strict=True):
            p = "-" if row.p_value is None else _format_p(row.p_value)
            mark = "changed" if row in self.changed else row.reason
            spread = "-" if row.std is None else number(2 * row.std, 2)
            values = number(row.before), number(row.after), number(row.difference, 3)
            shown = in_words(name if short.count(name) == 1 else row.name)
            rows.append((shown, *values, spread, row.unit, p, mark, row.symbol))
        table = Table(header, tuple(rows), "p-values adjusted for all quantities together (Holm)", words=(0, 5, 7, 8))
        blocks = Facts((*sources, ("torque error", errors))), table, Listing(self.sentences[1:])
        return Document(self.sentence, blocks)


def compare_estimates(before: ReportedEstimate, after: ReportedEstimate, level: float = LEVEL) -> EstimateComparison:
    """Compare two estimates of the same joint.

    Raises:
        MethodError: they are not of the same model, on the same side and in the same units, or the level is no
            probability.
    """
    if not 0 < level < 1:
        raise MethodError(f"The level of a test is between 0 and 1; received {level}.")
    _require_comparable(before, after)
    found = EstimateComparison(before, after, (), level, ())
    sums = _pair(before.sums, after.sums) if before.sums and after.sums else []  # several records look for none
    pairs = [*_pair(before.quantities, after.quantities), *sums]
    rows = _adjust_p_values([_compare(one, other, found.same_record) for one, other in pairs])
    notes = []
    if found.same_record:
        notes.append(
            "Both are of the same record and share its errors: differences come from the settings and are not tested."
            if set(before.fingerprints) == set(after.fingerprints)
            else "A record of one is also of the other, and they share its errors: differences are not tested."
        )
    if not (before.fingerprints and after.fingerprints):
        notes.append("A log states no SHA-256 of its torque: the tests hold where both estimates are of other records.")
    for name, value in before.settings.items():
        other = after.settings.get(name, "none")
        if value != other:
            notes.append(f"They differ in {name}, {value} in A and {other} in B, which alone may change the values.")
    return replace(found, rows=rows, notes=tuple(notes))


def _require_comparable(before: ReportedEstimate, after: ReportedEstimate) -> None:
    system = "robot" if before.model == "robot" else "joint"
    for what, one, other in (
        ("model", before.model, after.model),
        ("kind", before.kind, after.kind),
        ("friction law", before.friction, after.friction),
        ("transmission", before.side or "none", after.side or "none"),
        ("torque unit", before.torque_unit, after.torque_unit),
    ):
        if one != other:
            raise MethodError(
                f"{before.label} and {after.label} do not describe the same {system}: the {what} is {one} in "
                f"the one and {other} in the other; identify both with the same {system} file and options."
            )
    units = {q.name: q.unit for q in before.quantities}
    wrong = [q for q in after.quantities if units.get(q.name, q.unit) != q.unit]
    if wrong:
        raise MethodError(
            f"{wrong[0].name} is in {units[wrong[0].name]} in {before.label} and in {wrong[0].unit} in {after.label}; "
            "identify both with the same joint file and options."
        )


def _pair(
    before: Sequence[ReportedQuantity], after: Sequence[ReportedQuantity]
) -> list[tuple[ReportedQuantity, ReportedQuantity]]:
    """Return each quantity of either estimate with its counterpart, which may lack a value."""
    here, there = ({q.name: q for q in group} for group in (before, after))
    every = here | {name: q for name, q in there.items() if name not in here}
    lacking = {name: replace(q, value=None, std=None) for name, q in every.items()}
    return [(here.get(name, without), there.get(name, without)) for name, without in lacking.items()]


def _compare(before: ReportedQuantity, after: ReportedQuantity, same: bool) -> QuantityChange:
    found = QuantityChange(before.name, before.symbol, before.unit, before.value, after.value, None, None)
    if before.value is None or after.value is None:
        lost = [name for name, q in (("A", before), ("B", after)) if q.value is None]
        return replace(found, reason=f"not identified in {' and '.join(lost)}")
    difference = after.value - before.value
    found = replace(found, difference=difference)
    fixed = [name for name, q in (("A", before), ("B", after)) if not q.free or q.std is None]
    if before.std is None or after.std is None or fixed:
        return replace(found, reason=f"fixed in {' and '.join(fixed)}")
    std = math.hypot(before.std, after.std)
    if same or not std > 0:
        return replace(found, reason="same record: not tested" if same else "standard deviation 0: not tested")
    return replace(found, std=std, p_value=math.erfc(abs(difference) / std / math.sqrt(2)))


def _adjust_p_values(rows: Sequence[QuantityChange]) -> tuple[QuantityChange, ...]:
    """Return the changes with p-values adjusted by Holm's method."""
    tested = sorted((row.p_value, i) for i, row in enumerate(rows) if row.p_value is not None)
    found, largest = list(rows), 0.0
    for rank, (p, i) in enumerate(tested):
        largest = max(largest, min((len(tested) - rank) * p, 1.0))
        found[i] = replace(rows[i], p_value=largest)
    return tuple(found)


def _format_p(p_value: float, *, labelled: bool = False) -> str:
    if p_value < 1e-6:
        return "p < 1e-6" if labelled else "< 1e-6"
    return f"p = {number(p_value, 2)}" if labelled else number(p_value, 2)
