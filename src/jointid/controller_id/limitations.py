"""Undetermined properties of a learned law."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import StrEnum, auto
from typing import Any

from jointid.common.messages import Message
from jointid.common.text import number
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.regression import LAGS, BesideRegression
from jointid.controller_id.structures import Structure
from jointid.models.controllers import Controller, numbers_of, with_numbers


class LimitationCode(StrEnum):
    """Properties of the controller that a record does not determine."""

    LIMIT_NOT_REACHED = auto()
    INDISTINGUISHABLE = auto()
    AS_DECLARED = auto()
    INTERRUPTED = auto()
    ANOTHER_LAW = auto()


INTERRUPTED = Message(
    LimitationCode.INTERRUPTED,
    "The search was interrupted: this is the best law so far, other laws were not compared with it on the whole "
    "record, and the intervals are of this law alone.",
)


def fill_from_declaration(made: Controller, declared: Controller | None) -> tuple[Controller, tuple[Message, ...]]:
    """Take limit and delay from the declaration where the record hides them."""
    said = {} if declared is None else numbers_of(declared)
    if "limit" in said:  # in the units of the law that was learned, which is on the joint's side
        said["limit"] *= abs(_torque_per_unit(declared) / _torque_per_unit(made))
    open_ones = {"limit": math.inf, "delay": 0.0}
    own = numbers_of(made)
    kept = {n: said[n] for n, free in open_ones.items() if n in said and own.get(n) == free != said[n]}
    if not kept:
        return made, ()
    words = f"As declared, and not from this record: {' and '.join(f'{n} = {v:g}' for n, v in kept.items())}."
    return with_numbers(made, kept), (Message(LimitationCode.AS_DECLARED, words, {"numbers": kept}),)


def _torque_per_unit(controller: Any) -> float:
    """Return the torque on the joint's side per unit of a controller."""
    return float(getattr(controller, "gain", 1.0) * getattr(controller, "ratio", 1.0))


def list_limitations(
    log: LoopRecord, structure: Structure, alike: tuple[Structure, ...], beside: BesideRegression
) -> Iterator[Message]:
    """Yield the limitations of a law; `alike` are indistinguishable structures."""
    code = LimitationCode
    if beside.another:
        yield Message(
            code.ANOTHER_LAW,
            f"The best law of the menu, {structure}, leaves {100 * beside.law:.2g} % of the torque, a plain "
            f"regression on {LAGS} samples of reference and position {100 * beside.regression:.2g} %: the drive's law "
            "is another, and what is left is no noise; declare the law from the drive's documentation.",
            {"law": beside.law, "regression": beside.regression},
        )
    if not structure.limited:
        assert log.record.torque is not None
        largest, unit = float(abs(log.torque).max()), log.record.torque.unit
        yield Message(
            code.LIMIT_NOT_REACHED,
            f"The limit is not reached in this record; it is above {number(largest, 4)} {unit}, the largest torque.",
            {"torque": largest, "unit": unit},
        )
    if alike:
        said = f"This record does not distinguish this law from: {'; '.join(map(str, alike))}."
        yield Message(code.INDISTINGUISHABLE, said, {"structures": alike})
