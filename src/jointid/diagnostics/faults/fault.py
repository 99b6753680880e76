"""Definition of a fault of one axis, and its test.

A fault is tested as a small deviation by its signatures. All that is particular to it is a field of `Fault`; the tests
and the report read these fields. What corrects a large one is in `changes`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason

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
    """Fault of the loop, the log or the mechanics: one row of one table, for joint and robot.

    Attributes:
        name: its code.
        title: noun phrase, without an article.
        says: clause that states it: with {size}, or its ends {by} and {of}, {shape}, {value}, the first of its `senses`
            of a positive size as {sense}, and {torque}, {position} and {velocity} as units; see `findings`.
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
    """

    name: str
    title: str
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

    @property
    def of_model(self) -> bool:
        """True of a fault of the joint's mechanics or friction, False of one of loop and log."""
        return self.mechanical or bool(self.table)

    def __str__(self) -> str:
        return self.name


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
    def strength(self) -> float:
        """The absolute statistic; at least 0 for a fault that can only be positive."""
        return max(self.statistic, 0.0) if self.fault.one_sided else abs(self.statistic)


def name_number(name: str) -> str:
    """Return a number's name in words, also a filter's: "time constant of the velocity filter"."""
    *owner, last = name.replace("_", " ").split(".")
    if len(owner) == 2:  # one of several, which are counted
        return f"{last} of {owner[0].removesuffix('s')} {owner[1]}"
    return f"{last} of the {owner[0]}" if owner else last


def milliseconds(seconds: float) -> str:
    """Return a time in ms; one that no drive keeps is 0."""
    return "0" if abs(seconds) < MICROSECOND else number(1e3 * seconds, 2)
