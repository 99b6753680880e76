"""The tables of the EMPS records that the documentation shows, computed again."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.emps import outputs, residuals

PAGE = Path(__file__).parents[2] / "docs" / "how-well-it-works.md"


@pytest.mark.slow
def test_the_table_of_the_documentation_is_what_the_command_prints(emps_path: Path) -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    shown = [row for row in rows if len(row) == 5 and row[1] in ("EMPS", "EMPS_PULSES")]
    found = list(residuals(emps_path.parent))
    assert len(shown) == len(found)
    for (name, record, *cells), (computed, of, left) in zip(shown, found, strict=True):
        assert (name, f"DATA_{record}") == (computed, of)
        for cell, value in zip(cells, left, strict=True):
            assert value is None if not cell else float(cell) == pytest.approx(value, abs=0.02), (name, record)


@pytest.mark.slow
def test_force_and_position_agree_and_are_those_of_the_documentation(emps_path: Path) -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| EMPS")]
    shown = [row for row in rows if len(row) == 9 and row[1] in ("force", "position")]
    found = list(outputs(emps_path.parent))
    assert [row[0] for row in shown] == [record.removeprefix("DATA_") for record, *_ in found]
    for row, (_, _, values, (force, position, driven)) in zip(shown, found, strict=True):
        for cell, (value, band) in zip(row[2:6], values, strict=True):
            printed, width = map(float, cell.split(" ± "))
            assert (printed, width) == pytest.approx((value, band), abs=0.02 * band)
        assert (force, position) == pytest.approx((float(row[6]), float(row[7])), abs=0.02)
        assert driven == pytest.approx(float(row[8]), rel=0.02)
    for (_, _, by_force, errors), (_, _, by_position, others) in zip(found[::2], found[1::2], strict=True):
        assert errors[:2] == pytest.approx(others[:2], rel=0.02)
        for (value, band), (other, _) in zip(by_force, by_position, strict=True):
            assert abs(other - value) < 0.05 * band
