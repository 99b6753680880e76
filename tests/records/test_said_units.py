"""Units as users write them, and clocks and units that are said twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointid.common.errors import RecordError
from jointid.common.text import ordinal
from jointid.common.units import UnitError, normalise_unit, parse_quantity
from jointid.config import loads
from jointid.records.columns import Column, known_units
from jointid.records.reading import read
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
    (sentence,) = faults(turning.replace('"r"', '"pos [deg]", unit = "rad"'))
    assert sentence == (
        'record.channels.reference.unit is "rad", but its column "pos [deg]" names the unit "deg"; expected one of '
        "them: leave unit out, or rename the column."
    )
    assert loads(turning.replace('"r"', '"pos [deg]", unit = "°"'))


def write_csv(tmp_path: Path, heading: str, step: float) -> Path:
    rows = "\n".join(f"{step * k!r},{(k % 7) * 0.1}" for k in range(200))
    (tmp_path / "log.csv").write_text(f"{heading},i\n{rows}\n")
    return tmp_path / "log.csv"


@pytest.mark.parametrize(
    ("heading", "step"), [("t [s]", 0.002), ("time [ms]", 2.0), ("t", 0.002), ("t", 2.0), ("t", 1.0), ("k", 0.5)]
)
def test_a_sample_time_beside_a_time_column_that_agrees(tmp_path: Path, heading: str, step: float) -> None:
    record = read(
        write_csv(tmp_path, heading, step), {"torque": Column("i", unit="A")}, sample_time=0.002, kind="prismatic"
    )
    assert record.torque is not None
    assert record.torque.sample_time == 0.002


@pytest.mark.parametrize(("heading", "step", "said"), [("t [s]", 0.001, "0.001 s"), ("time [ms]", 1.0, "1 ms")])
def test_a_sample_time_that_contradicts_the_time_column(tmp_path: Path, heading: str, step: float, said: str) -> None:
    with pytest.raises(RecordError) as caught:
        read(write_csv(tmp_path, heading, step), {"torque": Column("i", unit="A")}, sample_time=0.002, kind="prismatic")
    assert str(caught.value) == (
        f'sample_time is 0.002 s, but the time column "{heading}" has {said} between samples; expected the same: leave '
        "sample_time out, or correct it, or rename the column if it is no time."
    )


@pytest.mark.parametrize("text", ["0.8", "A", "3 foo", "3 A)", "3 (A", "3 A/", "3 A/rad s", "0,8 A", ""])
def test_what_is_no_quantity_is_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_quantity(text)


def test_ordinals_are_those_of_english() -> None:
    assert [ordinal(one) for one in (1, 2, 3, 4, 11, 12, 13, 22, 111)] == [
        "1st", "2nd", "3rd", "4th", "11th", "12th", "13th", "22nd", "111th",
    ]  # fmt: skip
