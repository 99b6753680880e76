"""Units as users write them, and clocks and units that are said twice."""

from __future__ import annotations

import pytest

from jointid.common.units import UnitError, normalise_unit, parse_quantity
from jointid.config import loads
from jointid.records.columns import Column, known_units
from tests.joint_files import SMALLEST, faults


@pytest.mark.parametrize(
    ("said", "unit"),
    [("inc", "counts"), ("U/min", "rpm"), ("1/min", "rpm"), ("°", "deg"), ("%", "%"), ("mNm", "mNm"), ("mm/s", "mm/s")],
)
def test_an_ordinary_unit_is_known(said: str, unit: str) -> None:
    assert normalise_unit(said) == unit
    known = (*known_units("reference", "revolute"), *known_units("reference_velocity", "revolute"), "%", "mNm", "mm/s")
    assert Column("q", unit=said).stated_unit(known) == unit
    assert Column(f"q [{said}]").stated_unit(known) == unit


def test_a_declared_unit_and_that_of_the_name_are_said_with_both() -> None:
    turning = SMALLEST.replace('"prismatic"', '"revolute"')
    (fault,) = faults(turning.replace('"r"', '"pos [deg]", unit = "rad"'))
    assert fault.place == ("record", "channels", "reference", "unit")
    assert loads(turning.replace('"r"', '"pos [deg]", unit = "°"'))


@pytest.mark.parametrize("text", ["0.8", "A", "3 foo", "3 A)", "3 (A", "3 A/", "3 A/rad s", "0,8 A", ""])
def test_what_is_no_quantity_is_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_quantity(text)
