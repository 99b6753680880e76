"""Numbers of the joint file that are given with a unit, as ``velocity_gain = "0.8 A s/rad"``.

A number is SI, or in the controller's units; a text is a number with a unit that measures what the setting's
declaration says. The value is taken to SI where it is read, and its words are kept for a file that is written.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from jointid.common import messages, units
from jointid.common.units import Kind, UnitError
from jointid.models.controllers import CONTROLLER_UNITS

OUTPUTS: Mapping[Kind, tuple[str, ...]] = {"prismatic": ("N", "A", "V", "%"), "revolute": ("N m", "A", "V", "%")}
"""Output units of a controller, by the motion of its side."""


@lru_cache(maxsize=256)
def list_units(declared: str, kind: Kind | None = None) -> tuple[str, ...]:
    """List the units of a declaration; "N m s/rad" and others for controller units per rad/s.

    Args:
        declared: of the setting: "1/s", "m/s or rad/s", "controller units per m/s or rad/s".
        kind: how the side moves; None for both.
    """
    if in_controller_units(declared):
        kinds: tuple[Kind, ...] = ("prismatic", "revolute") if kind is None else (kind,)
        below = declared.removeprefix(CONTROLLER_UNITS).removeprefix(" per ").split(" or ")
        found = (units.per(output, below[-(one == "revolute")]) for one in kinds for output in OUTPUTS[one])
        return tuple(dict.fromkeys(found))
    choices = [unit.strip() for unit in declared.replace(",", " or ").split(" or ")]
    if len(choices) == 2 and kind is not None:  # straight, then turning
        choices = [choices[kind == "revolute"]]
    return tuple(filter(_is_unit, choices))


def _is_unit(unit: str) -> bool:
    try:
        units.parse_unit(unit)
    except UnitError:
        return False
    return True


def output_of(text: str, declared: str, kind: Kind) -> str | None:
    """Return the controller's output unit (N, N m, A, V or %) in a text; None without one."""
    if not in_controller_units(declared):
        return None
    stated = units.parse_quantity(text)
    known = zip(OUTPUTS[kind], list_units(declared, kind), strict=True)
    return next((output for output, unit in known if units.convert(*stated, unit) is not None), None)


def in_controller_units(declared: str) -> bool:
    """Return True for a declaration in controller units, possibly per another unit."""
    return declared.startswith(CONTROLLER_UNITS)


def is_quantity(text: str) -> bool:
    """Return True for a number followed by a unit, known or not."""
    stated = units.QUANTITY.fullmatch(text)
    return stated is not None and stated["unit"].strip() != ""


def to_si(text: str, declared: str, kind: Kind | None = None) -> float:
    """Return the SI value of a number with a unit of its declaration; arguments as of `list_units`.

    Raises:
        UnitError: it has another unit; the message is the rest of a sentence.
    """
    known = list_units(declared, kind)
    try:
        stated = units.parse_quantity(text)
    except UnitError as error:
        raise UnitError(f" is {messages.format_value(text)}; {error}.") from None
    values = [value for unit in known if (value := units.convert(*stated, unit)) is not None]
    if not values:
        raise UnitError(f" is {messages.format_value(text)}; expected a number in {' or '.join(known)}: correct it.")
    return float(values[0])
