"""Columns in a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointid.records.formats import Table, write_table


@pytest.fixture
def saved(tmp_path: Path) -> Callable[..., Path]:
    """Write columns into a file, whose path is returned: ``saved(".csv", t=time, q=position)``."""

    def save(suffix: str = ".mat", **columns: Any) -> Path:
        path = tmp_path / f"run{suffix}"
        write_table(path, Table({name: np.asarray(values, dtype=float) for name, values in columns.items()}))
        return path

    return save
