"""Definition of a fault, its test, and the hypothesis that corrects it.

A fault is tested as a small deviation by its signatures, and as a large one by hypotheses that correct it. All that is
particular to a fault is a field of `Fault`; the tests, the search for causes and the report read these fields.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import numbers_of, unit_of_number, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

if TYPE_CHECKING:
    from jointid.diagnostics.hypothesis_fits import Fit

Meaning: TypeAlias = "tuple[Fault, str, float | None]"
"""A fault that a corrected hypothesis stands for, its words, and its value."""


MICROSECOND = 1e-6
"""Seconds: a shorter time is not given in ms."""


class Measure(StrEnum):
    """Unit in which a table shows the size of a fault."""

    SHARE = "%"
    TIME = "ms"
    TORQUE = "torque"
    POSITION = "position"
    DECLARED = "% of the declared value"


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of the loop, the log, the record or the mechanics: one row of one table, for joint and robot.

    As a suspect it is tested by small columns; as a cause it is corrected, and the joint identified again.

    Attributes:
        name: its code.
        title: noun phrase of a table, without an article.
        called: noun phrase of a sentence; "a" and the title if empty.
        says: clause that states it: with {size}, or its ends {by} and {of}, {shape}, {value}, the first of its `senses`
            of a positive size as {sense}, and {torque}, {position} and {velocity} as units; see `words.state`.
        senses: of a positive size, and of a negative one.
        remedy: what else to declare, as the end of a sentence, with {shape}.
        columns: returns what it adds to the torque of an axis, in each of its shapes.
        tried: number of shapes that each of its columns is the best of.
        parts: numbers that are fitted for a column: 2 of a wave of any phase.
        declared: value without the fault; None for a number of the controller, whose value is declared.
        one_sided: whether its size can only be positive.
        least: smallest size that is named: less is within what such a part is known to.
        mechanical: whether it is a fault of the joint's model, not of loop or log.
        last: whether it is named only where no other fault is collinear.
        kin: group of faults that describe one effect; after one is found, the others are not tested.
        measure: unit of its size in a table.
        reason: code of the verdict.
        table: table of the joint file that declares a law with it.
        laws: names of these laws.
        correct: yields hypotheses in which it is corrected.
        clause: of a sentence that states it as a cause: with the number found as {value}, {ms} or {fine} of a time, and
            {name}, {shown} and {declared} with their units.
        meanings: yields the faults that a corrected hypothesis stands for, where these are several.
        negligible: whether a value differs too little from the declaration to be a cause.
        must_leave: share of the declared error that a cause leaves at most.
        more_than_responses: times what free linear responses leave: a cause that leaves more is not all that is wrong.
        judge: returns its value and what is left, by a problem of its own; None where it is no cause. It gets the drive
            as declared, the best fit and the least error of the others.
    """

    name: str
    title: str
    called: str = ""
    says: str = ""
    senses: tuple[str, str] = ("larger", "smaller")
    remedy: str = ""
    columns: Callable[[Seen], Columns] | None = None
    tried: int = 1
    parts: int = 1
    declared: float | None = 0.0
    one_sided: bool = False
    least: float = 0.0
    mechanical: bool = False
    last: bool = False
    kin: str = ""
    measure: Measure = Measure.DECLARED
    reason: Reason = Reason.LOOP_NOT_AS_DECLARED
    table: Literal["", "spring", "friction"] = ""
    laws: tuple[str, ...] = ()
    correct: Callable[[Hypothesis], Iterable[Hypothesis]] | None = None
    clause: str = ""
    meanings: Callable[[float | None, ClosedLoop], Iterable[Meaning]] | None = None
    negligible: Callable[[float | None, ClosedLoop, float], bool] | None = None
    must_leave: float = 0.85
    more_than_responses: float = 1.15
    judge: Callable[[Hypothesis, Fit | None, float], tuple[float | None, float] | None] | None = None

    @property
    def of_model(self) -> bool:
        """True of a fault of the joint's mechanics or friction, False of one of loop and log."""
        return self.mechanical or bool(self.table)

    @property
    def phrase(self) -> str:
        """Noun phrase of a sentence."""
        return self.called or f"a {self.title}"

    def __str__(self) -> str:
        return self.name

    def explain(self, value: float | None, loop: ClosedLoop) -> Iterable[Meaning]:
        """Return its meanings as a cause: several faults if no record distinguishes them."""
        if self.meanings is not None:
            return self.meanings(value, loop)
        known, shown, declared = value or 0.0, "", ""
        if "{shown}" in self.clause:
            if value is None:
                return ((self, f"the declared {name_number(self.name)} is not there", value),)
            shown, declared = (
                _show(self.name, one, loop) for one in (value, numbers_of(loop.controller).get(self.name, 0.0))
            )
        clause = self.clause.format(
            value=number(value, 2), ms=milliseconds(known), fine=f"{1e3 * known:.4g}", name=call_number(self.name),
            shown=shown, declared=declared,
        )  # fmt: skip
        return ((self, clause, value),)


def _show(name: str, value: float, loop: ClosedLoop) -> str:
    """Return a number of a law with its unit; a time in ms."""
    if name.endswith(("delay", "filter")):
        return f"{milliseconds(value)} ms"
    unit = unit_of_number(loop.controller, name, POSITION_UNIT[loop.joint.kind], loop.joint.force_unit)
    return f"{number(value, 3) if value else 0} {unit}".rstrip()


@dataclass(frozen=True, slots=True, eq=False)
class FaultSignature:
    """Change of the torque by one fault.

    Attributes:
        fault: that makes it.
        column: (rows,) change of the filtered torque per unit of its size: a derivative, or a secant.
        shape: the level of a limit, a Stribeck speed, a gap or a frequency; None without a shape.
        raw: (samples,) the column before the filter, if no parameter of the problem stands for the fault.
        axis: that has it.
        trial: the problem of the joint with it, and (free,) a start, if a law of the joint has it.
    """

    fault: Fault
    column: FloatArray
    shape: float | None = None
    raw: FloatArray | None = None
    axis: int = 0
    trial: tuple[ClosedLoopProblem, FloatArray] | None = None


@dataclass(frozen=True, slots=True)
class FaultTest:
    """Test of one fault.

    Attributes:
        fault: that is tested.
        alike: faults that no record of this loop can distinguish from it.
        declared: value; 0 for what is not declared at all.
        size: value less the declared one; of a limit, the observed share of what it cuts off.
        std: standard deviation of the size, autocorrelation-robust.
        statistic: their ratio.
        p_value: adjusted for all tests of the record together.
        shape: the level of a limit in the torque's unit, or a Stribeck speed.
        opposite: those of `alike` whose size has the opposite sign.
        axis: that has it.
    """

    in_json = "name -fault -alike -opposite -axis"
    fault: Fault
    alike: tuple[Fault, ...]
    declared: float
    size: float
    std: float
    statistic: float
    p_value: float
    shape: float | None = None
    opposite: tuple[Fault, ...] = ()
    axis: int = 0

    @property
    def name(self) -> str:
        """Code of the fault."""
        return self.fault.name

    @property
    def label(self) -> str:
        """Codes of the fault and of those it cannot be distinguished from."""
        return " or ".join(one.name for one in (self.fault, *self.alike))

    @property
    def title(self) -> str:
        """Titles of the fault and of those it cannot be distinguished from."""
        return " or ".join(one.title for one in (self.fault, *self.alike))

    @property
    def strength(self) -> float:
        """The absolute statistic; at least 0 for a fault that can only be positive."""
        return max(self.statistic, 0.0) if self.fault.one_sided else abs(self.statistic)


def name_number(name: str) -> str:
    """Return a number's name in words, also a filter's: "time constant of the velocity filter"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"{last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"{last} of the {owner[0]}" if owner else last


def call_number(name: str) -> str:
    """Return a number's name as a sentence calls it."""
    return f"the {name_number(name)}"


def milliseconds(seconds: float) -> str:
    """Return a time in ms; one that no drive keeps is 0."""
    return "0" if abs(seconds) < MICROSECOND else number(1e3 * seconds, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One fault corrected, or none.

    A number of the controller that is not known is free, and the search begins from several loops.

    Attributes:
        fault: that is corrected; None for the declared drive.
        record: corrected.
        loops: corrected, one for each start of the unknown number.
        filtering: resolved for this record.
        free: name of that number; None without one.
        factor: of the correction of the record, if it is a number; the number that is free comes on top of it.
        beside: names of what the identification finds beside the joint, free as well.
        number: returns the number of a problem that is corrected by the choice of a loop.
    """

    fault: Fault | None
    record: Record
    loops: tuple[ClosedLoop, ...]
    filtering: Filtering
    free: str | None = None
    factor: float | None = None
    beside: tuple[str, ...] = ()
    number: Callable[[ClosedLoopProblem], float] | None = None

    @property
    def controller(self) -> Any:
        """The controller of the first loop."""
        return self.loops[0].controller

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of that controller."""
        return numbers_of(self.controller)

    @property
    def period(self) -> float:
        """The controller's period, s: the torque's where none is declared."""
        assert self.record.torque is not None
        return getattr(self.controller, "period", None) or self.record.torque.sample_time

    def under(self, controllers: Sequence[Any], free: str | None = None) -> Hypothesis:
        """Return the hypothesis with other controllers."""
        return replace(self, loops=tuple(replace(self.loops[0], controller=one) for one in controllers), free=free)

    def starting_at(self, name: str, values: Sequence[float]) -> Hypothesis:
        """Return the hypothesis with a number of the controller free, and its starts."""
        return self.under([with_numbers(self.controller, {name: value}) for value in values], name)


@dataclass(frozen=True, slots=True)
class Explanation:
    """Cause that explains a record.

    Attributes:
        fault: the cause.
        words: clause that states it.
        value: correct number in the unit of the declaration, or a factor of the record; None without a number.
        error: residual share of the filtered torque with it corrected.
    """

    fault: Fault
    words: str
    value: float | None
    error: float
