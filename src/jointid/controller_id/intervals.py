"""Numbers of a learned law, with intervals over all indistinguishable laws."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from jointid.controller_id.fitting import FittedLaw, Task, covariance, order_rates
from jointid.controller_id.structures import INTEGRAL, Structure, is_tap
from jointid.models.controllers import Controller, unit_of_number
from jointid.records.record import Record
from jointid.uncertainty.covariance import Covariance


@dataclass(frozen=True, slots=True)
class LearnedNumber:
    """One number of the law.

    Attributes:
        name: as `jointid.models.controllers.numbers_of` has it; "integral" is what an integral holds at the first
            sample, in controller units.
        value: in the law's units.
        std: standard deviation, if this law is the drive's.
        unit: of the value; "" for a number without.
        lower, upper: ends of the interval: 2 deviations either way, in this law and in all that the record does not
            distinguish from it and that have the same number.
    """

    name: str
    value: float
    std: float
    unit: str = ""
    lower: float = math.nan
    upper: float = math.nan

    @property
    def spread(self) -> float:
        """Distance from the value to the further end of its interval."""
        return max(self.upper - self.value, self.value - self.lower)


def numbers_with_intervals(
    task: Task, best: FittedLaw, known: Covariance, alike: Iterable[FittedLaw]
) -> tuple[LearnedNumber, ...]:
    """Numbers of a law, with intervals over all laws that share the number.

    Cascades share numbers, as do PD and PID laws; filters of the same kind share theirs.

    Args:
        task: the record.
        best: the law.
        known: covariance of its numbers.
        alike: laws that the record does not distinguish.
    """
    made = task.controller(best.structure, best.numbers)
    spans = {name: [ends] for name, ends in _intervals(best, known)}
    for other in (order_rates(task, one) for one in alike):
        if other.structure.cascade != best.structure.cascade:
            continue
        for name, ends in _intervals(other, covariance(task, other)):
            if name in spans and _is_same_part(name, best.structure, other.structure) and math.isfinite(ends[0]):
                spans[name].append(ends)
    hulls = [(min(low for low, _ in ends), max(high for _, high in ends)) for ends in spans.values()]
    return tuple(
        LearnedNumber(name, value, float(std), _unit_of(made, name, task.log.record), *hull)
        for (name, value), std, hull in zip(best.numbers.items(), known.std, hulls, strict=True)
    )


def _intervals(one: FittedLaw, known: Covariance) -> Iterator[tuple[str, tuple[float, float]]]:
    for (name, value), std in zip(one.numbers.items(), map(float, known.std), strict=True):
        yield name, (value - 2 * std, value + 2 * std)


def _is_same_part(name: str, one: Structure, other: Structure) -> bool:
    """Test whether a number belongs to the same kind of filter, or none."""
    if name.startswith("velocity_filter"):
        return one.velocity_filter == other.velocity_filter
    return not name.startswith("torque_filters") or one.torque_filter == other.torque_filter


def _unit_of(made: Controller, name: str, record: Record) -> str:
    assert record.torque is not None and record.motor_position is not None
    if is_tap(name):
        return ""
    named = "constant_feedforward" if name == INTEGRAL else name  # both are held in the controller's output
    return unit_of_number(made, named, record.motor_position.unit, record.torque.unit)
