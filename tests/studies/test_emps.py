"""The residuals of the EMPS records that the documentation shows, computed again."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.emps import residuals

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
