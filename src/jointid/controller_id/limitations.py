"""Undetermined properties of a learned law, and equivalent forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import StrEnum, auto
from typing import Any

from jointid.common.messages import Message
from jointid.common.text import number
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.regression import LAGS, BesideRegression
from jointid.controller_id.structures import VELOCITY, Structure
from jointid.models.controllers import Controller, numbers_of, with_numbers
from jointid.records.record import Tap


class Equivalence(StrEnum):
    """Another form of the same equation, its gains combined otherwise."""

    PD = auto()
    PD_ON_DIFFERENCE = auto()
    VISCOUS_FEEDFORWARD = auto()
    PID_ON_DIFFERENCE = auto()
    REFERENCE_VELOCITY_WEIGHT = auto()


class LimitationCode(StrEnum):
    """Properties of the controller that a record does not determine."""

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


def list_equivalents(structure: Structure) -> Iterator[Message]:
    """Yield the equivalent forms of a law, with their gains."""
    code, velocity, gains = (
        Equivalence,
        structure.reference_velocity,
        "its position_gain = kp kv and derivative_gain = kv",
    )
    plain = velocity == "full" and structure.velocity_filter == "none" and structure.every == 1
    if structure.law == "P-P" and velocity == "none" and structure.every == 1:
        yield Message(code.PD, f'PD with reference_velocity = "none", {gains}')
    if structure.law == "P-P" and plain:
        yield Message(code.PD_ON_DIFFERENCE, f'PD with reference_velocity = "difference", {gains}')
    if structure.law == "P-P" and velocity == "share":
        yield Message(code.VISCOUS_FEEDFORWARD, "P-P with viscous_feedforward = kv velocity_feedforward instead")
    if structure.law == "P-PI" and plain:
        gains = "its gains kv (kp + ki), kv (1 - ki T) and kv kp ki"
        yield Message(code.PID_ON_DIFFERENCE, f'PID with reference_velocity = "difference", {gains}')
    if not structure.cascade and VELOCITY in structure.feedforward and velocity == "difference":
        yield Message(code.REFERENCE_VELOCITY_WEIGHT, "the same with a larger weight of the reference's velocity")


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
    if not structure.integrates:
        yield Message(
            code.NO_INTEGRAL,
            "No integral action is visible in this record: it contributes less than 0.1 % of the torque, or there is "
            "none.",
        )
    if not structure.limited:
        assert log.record.torque is not None
        largest, unit = float(abs(log.torque).max()), log.record.torque.unit
        yield Message(
            code.LIMIT_NOT_REACHED,
            f"The limit is not reached in this record; it is above {number(largest, 4)} {unit}, the largest torque.",
            {"torque": largest, "unit": unit},
        )
    elif structure.integrates:
        yield Message(
            code.ANTI_WINDUP_NOT_TESTED,
            "The behaviour of the integral at the limit (anti_windup) was not tested; it is assumed to stop.",
        )
    if structure.torque_filter == "none":
        yield Message(code.TORQUE_FILTER_HIDDEN, "A torque filter whose effect is below the noise cannot be detected.")
    if log.record.tap is Tap.COMMAND:
        yield Message(
            code.DELAY_NOT_VISIBLE,
            'A delay between the controller\'s output and the acting torque is not visible at the tap "command"; take '
            "delay from the drive's documentation.",
        )
        if structure.late:
            yield Message(
                code.TORQUE_LOGGED_LATE,
                f"The log shows the torque {structure.late} samples later than the position it depends on; declare "
                'tap = "measured" for the torque, so that the delay is visible in it, or shift the log.',
                {"samples": structure.late},
            )
    if structure.rate > 1 or any(other.rate != structure.rate for other in alike):
        yield Message(
            code.PERIOD_UNCERTAIN,
            "The loop's period follows only from the lag of its velocity; a velocity filter may have the same effect.",
        )
        yield Message(
            code.INTERPOLATION_ASSUMED,
            "Between the log's samples the reference is assumed to follow the controller's interpolation, and the "
            "position a cubic spline. Where that is wrong, the errors are larger than the intervals.",
        )
    if alike:
        said = f"This record does not distinguish this law from: {'; '.join(map(str, alike))}."
        yield Message(code.INDISTINGUISHABLE, said, {"structures": alike})
