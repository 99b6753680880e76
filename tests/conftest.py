"""What all tests share: the real records, which stay outside the project, and how property tests run."""

from __future__ import annotations

import os
from pathlib import Path

# Matrices here are thousands of rows by ten columns: a second thread of the linear algebra only waits for the first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

IN_CI = os.environ.get("CI") == "true"

# Shared machines are slow now and then, and a build that fails must fail again when it is repeated.
settings.register_profile("jointid", deadline=None, derandomize=IN_CI)
settings.load_profile("jointid")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of the real records: where JOINTID_DATA points, or else ../shared/data from the root."""
    named = os.environ.get("JOINTID_DATA")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    places = [Path(named), beside] if named else [beside]
    for place in places:
        if place.is_dir():
            return place
    reason = f"the real records are in none of {', '.join(map(str, places))}; set JOINTID_DATA to their folder"
    if IN_CI:
        pytest.fail(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def bench_dir(data_dir: Path) -> Path:
    """The measuring stick: a plain C version of one loop and an event-driven reference, beside the records."""
    bench = data_dir.parent / "bench"
    if not (bench / "stick.py").is_file():
        reason = f"there is no measuring stick in {bench}"
        if IN_CI:
            pytest.fail(reason)
        pytest.skip(reason)
    return bench


@pytest.fixture(scope="session")
def emps_path(data_dir: Path) -> Path:
    """The public EMPS record: vir [V], qg and qm [m], t [s], at 1 kHz."""
    return data_dir / "emps" / "DATA_EMPS.mat"
