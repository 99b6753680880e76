"""Axis limits of a test, and how far a test exceeds them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace

from jointid.common.errors import MethodError
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.text import number

_ENDS = {"lower": -1.0, "upper": 1.0}  # positions, and the direction beyond them
_SLACK = 1e-9  # relative: what rounding passes a limit by


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Joint-side limits of one axis in a test; None is unlimited.

    A torque is in A or V where the joint is identified per ampere or volt.

    Raises:
        MethodError: a limit is not positive, or there is no room between the positions or the frequencies.
    """

    lower: float | None = setting(None, "position that the reference does not come below", unit="m or rad")
    upper: float | None = setting(None, "position that the reference does not come above", unit="m or rad")
    stroke: float | None = setting(None, "of the position, from one end to the other", unit="m or rad", above=0)
    speed: float | None = setting(None, "largest, of motor and load", unit="m/s or rad/s", above=0)
    acceleration: float | None = setting(None, "largest of the reference", unit="m/s2 or rad/s2", above=0)
    jerk: float | None = setting(None, "largest of the reference", unit="m/s3 or rad/s3", above=0)
    torque: float | None = setting(None, "largest, with what is injected", unit="N, N m, A or V", above=0)
    rms_torque: float | None = setting(
        None, "root mean square of the torque over the test", unit="N, N m, A or V", above=0
    )
    windup: float | None = setting(None, "largest wind-up of the spring, in which it rings", unit="m or rad", above=0)
    lowest: float = setting(0.1, "lowest frequency of a multisine", unit="Hz", above=0)
    highest: float | None = setting(
        None, "highest frequency of a multisine; by default the identification's cut-off", unit="Hz", above=0
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.highest is not None and self.highest <= self.lowest:
            raise MethodError(
                f"The highest frequency is above the lowest; received {self.highest:g} and {self.lowest:g} Hz."
            )
        if self.lower is not None and self.upper is not None and self.upper <= self.lower:
            raise MethodError(
                f"The upper position is above the lower one; received {self.lower:g} and {self.upper:g}: exchange them."
            )

    @property
    def stated(self) -> dict[str, float]:
        """Given limits by name, but those of a frequency; the stroke is at most `upper - lower`."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("lowest", "highest")}
        if self.lower is not None and self.upper is not None:
            found["stroke"] = min(self.stroke or math.inf, self.upper - self.lower)
        return {name: value for name, value in found.items() if value is not None}

    def complete(self, others: AxisLimits) -> AxisLimits:
        """Add other limits of sizes and positions that are not given."""
        return replace(self, **{name: size for name, size in others.stated.items() if name not in self.stated})


def find_excess(limits: AxisLimits, found: Mapping[str, float]) -> dict[str, float]:
    """Factors by which limits are exceeded; for positions 1 plus the distance."""
    known = {name: limit for name, limit in limits.stated.items() if name in found}
    sizes = {name: found[name] / limit for name, limit in known.items() if name not in _ENDS}
    over = sizes | {name: 1.0 + _ENDS[name] * (found[name] - known[name]) for name in _ENDS if name in known}
    return {name: factor for name, factor in over.items() if factor > 1 + _SLACK}


def describe_excess(
    limits: AxisLimits, found: Mapping[str, float], units: Mapping[str, str], axis: str = ""
) -> Iterator[str]:
    """Yield a clause for each exceeded limit of an axis."""
    for name in find_excess(limits, found):
        unit = units.get(name, "")
        allowed = number(limits.stated[name], 3)
        reached = f"{name.replace('_', ' ')} {number(found[name], 3)} {unit}"
        yield f"{axis or 'it'} passes a limit, {reached} of {allowed} allowed"


def units_of_limits(q: str, u: str) -> dict[str, str]:
    """Units of the limited quantities, from those of position and torque."""
    return {
        "lower": q, "upper": q, "stroke": q, "speed": f"{q}/s", "acceleration": f"{q}/s2", "jerk": f"{q}/s3",
        "torque": u, "rms_torque": u, "windup": q,
    }  # fmt: skip
