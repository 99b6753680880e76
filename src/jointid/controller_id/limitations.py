"""Equivalent laws, and what a record leaves open about the controller: codes with their values, and their words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum, auto
from typing import TypeAlias

from jointid.common.text import number
from jointid.controller_id.fitting import FittedLaw, Task
from jointid.controller_id.structures import VELOCITY, Structure
from jointid.records.record import Tap

ALIKE = 10.0  # of the criterion: a smaller difference does not distinguish two laws

Value: TypeAlias = float | int | str | Mapping[str, float] | tuple[Structure, ...]


class Equivalence(StrEnum):
    """Another form of the same equation, its gains combined otherwise."""

    PD = auto()
    PD_ON_DIFFERENCE = auto()
    VISCOUS_FEEDFORWARD = auto()
    PID_ON_DIFFERENCE = auto()
    REFERENCE_VELOCITY_WEIGHT = auto()

    @property
    def description(self) -> str:
        """The law, and its gains in terms of those that were found."""
        return _FORMS[self]


_FORMS: Mapping[Equivalence, str] = {
    Equivalence.PD: 'PD with reference_velocity = "none", its kp = kp kv and kd = kv',
    Equivalence.PD_ON_DIFFERENCE: 'PD with reference_velocity = "difference", its kp = kp kv and kd = kv',
    Equivalence.VISCOUS_FEEDFORWARD: "P-P with viscous_feedforward = kv velocity_feedforward instead",
    Equivalence.PID_ON_DIFFERENCE: (
        'PID with reference_velocity = "difference", its kp = kv (kp + ki), kd = kv (1 - ki T), ki = kv kp ki'
    ),
    Equivalence.REFERENCE_VELOCITY_WEIGHT: "the same with a larger weight of the reference's velocity",
}


class LimitationCode(StrEnum):
    """What a record leaves open about the controller."""

    NO_INTEGRAL = auto()
    LIMIT_NOT_REACHED = auto()
    ANTI_WINDUP_NOT_TESTED = auto()
    TORQUE_FILTER_HIDDEN = auto()
    DELAY_NOT_VISIBLE = auto()
    TORQUE_LOGGED_LATE = auto()
    PERIOD_UNCERTAIN = auto()
    INTERPOLATION_ASSUMED = auto()
    INDISTINGUISHABLE = auto()
    AS_DECLARED = auto()


_SENTENCES: Mapping[LimitationCode, str] = {
    LimitationCode.NO_INTEGRAL: (
        "No integral action is visible in this record: it contributes less than 0.1 % of the torque, or there is none."
    ),
    LimitationCode.LIMIT_NOT_REACHED: (
        "The limit is not reached in this record; it is above {torque} {unit}, the largest torque."
    ),
    LimitationCode.ANTI_WINDUP_NOT_TESTED: (
        "The behaviour of the integral at the limit (anti_windup) was not tested; it is assumed to stop."
    ),
    LimitationCode.TORQUE_FILTER_HIDDEN: "A torque filter whose effect is below the noise cannot be detected.",
    LimitationCode.DELAY_NOT_VISIBLE: (
        'A delay between the controller\'s output and the acting torque is not visible at the tap "command"; take '
        "delay from the drive's documentation."
    ),
    LimitationCode.TORQUE_LOGGED_LATE: (
        "The log shows the torque {samples} samples later than the position it depends on; declare "
        'tap = "measured" for the torque, so that the delay is visible in it, or shift the log.'
    ),
    LimitationCode.PERIOD_UNCERTAIN: (
        "The loop's period follows only from the lag of its velocity; a velocity filter may have the same effect."
    ),
    LimitationCode.INTERPOLATION_ASSUMED: (
        "Between the log's samples the reference is assumed to follow the controller's interpolation, and the position "
        "a cubic spline. Where that is wrong, the errors are larger than the intervals."
    ),
    LimitationCode.INDISTINGUISHABLE: "This record does not distinguish this law from: {structures}.",
    LimitationCode.AS_DECLARED: "As declared, and not from this record: {numbers}.",
}


@dataclass(frozen=True, slots=True)
class Limitation:
    """One thing that a record leaves open about the controller.

    Attributes:
        code: what it is.
        values: that belong to it, by name.
    """

    code: LimitationCode
    values: Mapping[str, Value] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the sentence."""
        return _SENTENCES[self.code].format(**{name: _text(value) for name, value in self.values.items()})


def _text(value: Value) -> str:
    if isinstance(value, Mapping):
        return " and ".join(f"{name} = {one:g}" for name, one in value.items())
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    return number(value, 4) if isinstance(value, float) else str(value)


def list_equivalents(structure: Structure) -> Iterator[Equivalence]:
    """Yield the other forms of a law: the same equation with its gains combined otherwise."""
    plain = structure.velocity_filter == "none" and structure.every == 1
    if structure.law == "P-P" and structure.reference_velocity == "none" and structure.every == 1:
        yield Equivalence.PD
    if structure.law == "P-P" and structure.reference_velocity == "full" and plain:
        yield Equivalence.PD_ON_DIFFERENCE
    if structure.law == "P-P" and structure.reference_velocity == "share":
        yield Equivalence.VISCOUS_FEEDFORWARD
    if structure.law == "P-PI" and structure.reference_velocity == "full" and plain:
        yield Equivalence.PID_ON_DIFFERENCE
    if not structure.cascade and VELOCITY in structure.feedforward and structure.reference_velocity == "difference":
        yield Equivalence.REFERENCE_VELOCITY_WEIGHT


def list_limitations(task: Task, best: FittedLaw, alike: tuple[Structure, ...]) -> Iterator[Limitation]:
    """Yield what a record leaves open about a law.

    Args:
        task: the record.
        best: the law.
        alike: the structures that the record does not distinguish from it.
    """
    structure, log, code = best.structure, task.log, LimitationCode
    if not structure.integrates:
        yield Limitation(code.NO_INTEGRAL)
    if not structure.limited:
        unit = log.record.torque.unit if log.record.torque is not None else ""
        yield Limitation(code.LIMIT_NOT_REACHED, {"torque": float(abs(log.torque).max()), "unit": unit})
    elif structure.integrates:
        yield Limitation(code.ANTI_WINDUP_NOT_TESTED)
    if structure.torque_filter == "none":
        yield Limitation(code.TORQUE_FILTER_HIDDEN)
    if log.record.tap is Tap.COMMAND:
        yield Limitation(code.DELAY_NOT_VISIBLE)
        if structure.late:
            yield Limitation(code.TORQUE_LOGGED_LATE, {"samples": structure.late})
    if structure.rate > 1 or any(other.rate != structure.rate for other in alike):
        yield Limitation(code.PERIOD_UNCERTAIN)
        yield Limitation(code.INTERPOLATION_ASSUMED)
    if alike:
        yield Limitation(code.INDISTINGUISHABLE, {"structures": alike})
