"""The numbers of a drive that take its own units to SI: counts of an encoder, shares of a rated torque, ampere.

A drive logs positions in counts and the torque as a share of a rated one (CiA 402: object 6077h, per mille of object
6076h) or as a current. Which numbers those are is known from the drive's parameters, not from its log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from jointid.common import units
from jointid.common.errors import RecordError
from jointid.common.settings import check_settings, documented, setting
from jointid.records.drives.profiles import Profile, load_profile, profile_names

_AGREES = 0.05  # of a rated torque: nameplates are rounded, and peak and rms ampere differ by 41 %

_TORQUE = {"prismatic": "N", "revolute": "N m"}
_POSITION = {"prismatic": "m", "revolute": "rad"}
_COUNTS = {"prismatic": "counts_per_metre", "revolute": "counts_per_turn"}


@documented
@dataclass(frozen=True, slots=True)
class Drive:
    """Profile of a drive's traces, and the drive parameters behind its units.

    Raises:
        RecordError: there is no such profile, a number is not positive and finite, the axis is not a whole number from
            1 on, or the rated torque is not rated current x torque constant where all three are given.
    """

    profile: str | None = setting(
        None,
        "whose names, units, timing and tap the channels have that the file does not declare; what it declares wins",
        accept=load_profile,
        choices=profile_names(),
    )
    axis: int | None = setting(
        None, "which axis, where a trace has several and the profile's names number them", at_least=1
    )
    rated_torque: float | None = setting(
        None, "what per mille and per cent of a torque are a share of", unit="N or N m", above=0
    )
    rated_current: float | None = setting(
        None, "the same as a current, in place of it, beside the torque constant", unit="A", above=0
    )
    torque_constant: float | None = setting(None, "takes a torque in A to N m or N", unit="N/A or N m/A", above=0)
    counts_per_turn: float | None = setting(None, "of a revolute joint's encoder", unit="counts", above=0)
    counts_per_metre: float | None = setting(None, "of a prismatic joint's encoder", unit="counts", above=0)
    load_counts_per_turn: float | None = setting(
        None,
        "of the load's encoder, load_position, where it is another one; behind a gear it is needed, because the "
        "other is the motor's",
        unit="counts",
        above=0,
    )
    load_counts_per_metre: float | None = setting(None, "the same of one that moves straight", unit="counts", above=0)

    def __post_init__(self) -> None:
        check_settings(self, RecordError)
        if self.rated_torque is not None and self._from_current is not None:
            ratio = self._from_current / self.rated_torque
            if abs(ratio - 1) > _AGREES:
                raise RecordError(
                    f"The drive's rated_torque is {self.rated_torque:g}, and rated_current x torque_constant "
                    f"{self._from_current:g}, {ratio:.3g} times as much (peak and rms ampere differ by 1.41); correct "
                    "one, or leave rated_current out."
                )

    @property
    def traces(self) -> Profile | None:
        """The profile, None without one."""
        return None if self.profile is None else load_profile(self.profile)

    @property
    def _from_current(self) -> float | None:
        if self.rated_current is None or self.torque_constant is None:
            return None
        return self.rated_current * self.torque_constant

    def resolve_unit(self, unit: units.Unit, kind: str, *, of_load: bool = False, geared: bool = False) -> units.Unit:
        """Return a unit with its factor to SI; one that is no drive's own as it is.

        Args:
            unit: of a channel.
            kind: of the side on which the channel is measured.
            of_load: True if it is measured by the load's own encoder.
            geared: True if the load moves by another amount than the motor, whose counts then do not apply.

        Raises:
            UnitError: a number is missing; the message is the end of a sentence that begins with what has the unit.
        """
        traces = self.traces
        if unit.dimension == units.COUNTS:
            name = _COUNTS[kind]
            counts = getattr(self, name)
            if of_load:
                counts = getattr(self, f"load_{name}") or (None if geared else counts)
            if counts is None and of_load and geared:
                raise units.UnitError(
                    f"which behind a transmission needs the drive's load_{name}, of the load's own encoder ({name} is "
                    "the motor's): give it, or gain and another unit"
                )
            if counts is None:
                said = "" if traces is None or kind == "prismatic" else f" ({traces.counts})"
                raise units.UnitError(f"which needs the drive's {name}{said}: give it, or gain and another unit")
            turn = 2 * math.pi if kind == "revolute" else 1.0
            return units.Unit(unit.name, units.POSITION_UNITS[kind][0], turn / counts, _POSITION[kind])
        if unit.dimension == units.SHARE:
            rated = self.rated_torque or self._from_current
            if rated is None:
                said = "" if traces is None else f" ({traces.rated_torque})"
                raise units.UnitError(
                    f"a share of the rated torque, which needs the drive's rated_torque{said}: give it, or "
                    "rated_current and torque_constant"
                )
            return units.Unit(unit.name, units.TORQUE_UNITS[kind][0], unit.factor * rated, _TORQUE[kind])
        if unit.dimension == "current" and self.torque_constant is not None:
            dimension = units.TORQUE_UNITS[kind][0]
            return replace(unit, dimension=dimension, factor=unit.factor * self.torque_constant, si=_TORQUE[kind])
        return unit
