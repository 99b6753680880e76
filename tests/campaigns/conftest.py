"""A small fleet, noise-free: two rigid joints, two days each."""

import shutil
from pathlib import Path

import pytest

from tests.rigid_axis import write_axis

FLEET = '[fleet]\njoint = "joint.toml"\nrecords = "logs/{joint}/{day}.npy"\n'


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Two rigid joints, two days each, and their joint file."""
    joint = write_axis(tmp_path, noise=0.0)
    for name in ("a/2026-11-01", "a/20261102", "b/2026-11-01", "b/2026-11-02"):
        path = tmp_path / "logs" / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(joint.with_name("run.npy"), path)
    return tmp_path


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log"
