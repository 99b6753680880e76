"""What the attacks share: a folder of the demo, with all that is compiled loaded."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from jointid.records.formats import Table, write_table
from tests.rigid_axis import run


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the demo's record, joint file and estimate, another format of the record, and a small table."""
    import scipy.io  # noqa: F401 - all are loaded here, once, and not in every copy

    from jointid.simulation.warm_up import warm_up

    folder = tmp_path_factory.mktemp("demo")
    assert run("demo", folder, "-q") == 0
    (folder / "torque.png").unlink()
    record = folder / "record.csv"  # a third of it, to have more moments in the same time
    record.write_text("".join(record.read_text(encoding="utf-8").splitlines(keepends=True)[:8001]), encoding="utf-8")
    warm_up()
    rows = np.arange(400)
    write_table(folder / "table.csv", Table({"t": rows * 1e-3, "i": np.sin(rows), "q": np.cos(rows)}))
    return folder


@pytest.fixture
def place(demo: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    shutil.copytree(demo, tmp_path / "place")
    return tmp_path / "place"
