"""What is recomputed from the printed numbers of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import ROUND_DOWN, Decimal

from jointid import Filtering
from jointid.paper.tables import Cell, PublishedTable, compute_variations, recompute_cells


@dataclass(frozen=True, slots=True)
class PublishedSettings:
    """Settings of the experiment, as the text of section V gives them."""

    sample_rate: float = 1000.0  # Hz, V.A
    natural_frequency: float = 30.0  # Hz, stated as confirmed with the output blocked, V.A
    bandwidth: float = 30.0  # Hz, of the position loop, V.A
    condition_number: float = 30.0  # of W, its scaling not stated, V.A
    rigid_cutoff: float = 5.0  # Hz, of the filters for the rigid model, V.B
    flexible_cutoff: float = 60.0  # Hz, of those for the flexible model, V.C
    decimation: int = 12  # one sample in so many is kept, V.C
    added_mass: float = 10.0  # kg, on the load in the second test, V.D


EXPERIMENT = PublishedSettings()

REGRESSOR = (
    ("v1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "v12", "v12", "sign(v12)"),
)
"""The matrix under (5) as printed, in the letters of `models.joints`; its parameters are those of Table 2."""
REGRESSOR_OF_2 = (
    ("a1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "a12", "v12", "sign(v12)"),
)
"""The regressor of (2), in the letters of `models.joints` and in the order of the parameters of Table 2."""


def agrees(printed: Decimal, recomputed: Decimal | float, rounding: str | None = None) -> bool:
    """Test whether a number rounds to the printed one."""
    return Decimal(recomputed).quantize(printed, rounding) == printed


def find_misprints(table: PublishedTable) -> tuple[Cell, ...]:
    """Cells that do not follow from other printed numbers by any admissible rounding.

    Rounded or cut to the printed digits, rounded to a whole number where a whole one is printed, by any denominator.
    """
    return tuple(
        (column, name)
        for (column, name), candidates in recompute_cells(table).items()
        if not any(_matches_print(table.column(column)[name], candidate) for candidate in candidates)
    )


def _matches_print(printed: Decimal, recomputed: Decimal) -> bool:
    if agrees(printed, recomputed) or agrees(printed, recomputed, ROUND_DOWN):
        return True
    whole = printed.to_integral_value()
    return whole == printed and agrees(whole, recomputed)


def compute_shifts(before: PublishedTable, after: PublishedTable) -> dict[str, float]:
    """Change of each parameter in standard deviations, for independent tables."""
    one, other = before.column("two_sigma"), after.column("two_sigma")
    return {
        name: 2 * float(change) / math.hypot(one[name], other[name])
        for name, change in compute_variations(before, after).items()
    }


def find_largest_decimation(cutoff: float, sample_rate: float) -> int:
    """Largest decimation factor that a filter at `cutoff` Hz allows."""
    thinned = Filtering(cutoff=cutoff).resolve(1 / sample_rate).decimation
    assert thinned is not None
    return thinned


def compute_stiffness(motor_inertia: float, load_inertia: float, free_free: float) -> float:
    """Return ``K12 = mu (2 pi f)^2``, ``mu = ZZ1 ZZ2 / (ZZ1 + ZZ2)``, f free-free in Hz."""
    reduced = motor_inertia * load_inertia / (motor_inertia + load_inertia)
    return reduced * (2 * math.pi * free_free) ** 2


def stops(before: float, after: float, tolerance: float, *, absolute: bool = True) -> bool:
    """Test the stopping rule under (12); print takes no absolute value."""
    change = (after - before) / before
    return (abs(change) if absolute else change) <= tolerance


def find_wrong_entries() -> tuple[tuple[int, str, str], ...]:
    """Regressor entries that contradict (2): column, printed, correct."""
    return tuple(
        (column, old, new)
        for rows in zip(REGRESSOR, REGRESSOR_OF_2, strict=True)
        for column, (old, new) in enumerate(zip(*rows, strict=True), 1)
        if old != new
    )
