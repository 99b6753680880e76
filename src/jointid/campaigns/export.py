"""Export results to CSV or Parquet, one row per case, reproducibly."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jointid.campaigns.cases import Row
from jointid.common.errors import RecordError, extra
from jointid.common.files import beside, write_whole

ENDINGS = (".csv", ".parquet")


def export_rows(rows: Sequence[Row], path: Path) -> None:
    """Write results as CSV or Parquet, by file suffix."""
    require_ending(path)
    columns = table_of(rows)
    if path.suffix.lower() == ".csv":
        made = io.StringIO(newline="")
        writer = csv.writer(made, lineterminator="\n")
        writer.writerow(map(_harmless, columns))
        writer.writerows(map(_harmless, row) for row in zip(*columns.values(), strict=True))
        write_whole(path, made.getvalue())
        return
    pyarrow = extra("pyarrow", "logs", "A Parquet file")
    parquet = extra("pyarrow.parquet", "logs", "A Parquet file")
    with beside(path) as fresh:
        parquet.write_table(pyarrow.table({name: pyarrow.array(column) for name, column in columns.items()}), fresh)


def _harmless(cell: Any) -> Any:
    """Quote a cell that a spreadsheet would take for a formula."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r")) else cell


def require_ending(path: Path) -> None:
    """Refuse unsupported file suffixes."""
    if path.suffix.lower() not in ENDINGS:
        raise RecordError(f"{path} ends in no known format; expected {' or '.join(ENDINGS)}: name it so.")
    if path.suffix.lower() == ".parquet":
        extra("pyarrow", "logs", "A Parquet file")


def table_of(rows: Sequence[Row]) -> dict[str, list[Any]]:
    """Columns of results by name: case, answer, settings, hashes and versions.

    A parameter has columns for value and standard deviation, with the unit in the name, and for the truth if simulated.
    """
    columns: dict[str, list[Any]] = {
        "joint": [row.joint for row in rows],
        "day": [row.day for row in rows],
        "record": [row.record for row in rows],
        "kind": [row.kind for row in rows],
        "seed": [row.seed for row in rows],
        "changes": ["; ".join(row.changes) for row in rows],
        "settings": ["; ".join(row.settings) for row in rows],
        "outcome": [str(row.outcome) for row in rows],
        "sentence": [row.sentence for row in rows],
        "trust": [row.trust for row in rows],
        "converged": [row.converged for row in rows],
        "error [%]": [row.error_percent for row in rows],
        "simulations": [row.simulations for row in rows],
    }
    for name, unit in sorted({(name, one.unit) for row in rows for name, one in row.found.items()}):
        found = [one if (one := row.found.get(name)) is not None and one.unit == unit else None for row in rows]
        columns[f"{name} [{unit}]"] = [None if one is None else one.value for one in found]
        columns[f"{name} std [{unit}]"] = [None if one is None else one.std for one in found]
        truth = [None if one is None else row.truth.get(name) for row, one in zip(rows, found, strict=True)]
        if any(value is not None for value in truth):
            columns[f"{name} truth [{unit}]"] = truth
    columns |= {
        "case sha256": [row.content_hash for row in rows],
        "record sha256": [row.record_sha256 for row in rows],
        "joint file sha256": [row.joint_file_sha256 for row in rows],
    }
    for name in sorted({name for row in rows for name in row.versions}):
        columns[name] = [row.versions.get(name, "") for row in rows]
    return columns
