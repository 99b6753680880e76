"""The process that reads files of others: it serves several, and however a file ends it, that is one sentence."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.records.formats import Csv, Table, read_blocks, read_table, reader_process, write_table
from tests.records.logged import LOGGED, POSITION


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.h5"
    LOGGED["hdf5"].write(path)
    return path


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> reader_process._Idle:
    """No process waits for a file, and those of this test end with it."""
    idle = reader_process._Idle()
    monkeypatch.setattr(reader_process, "_idle", idle)
    return idle


def numbers_of_waiting(idle: reader_process._Idle) -> list[int]:
    return [reader.process.pid for reader in idle.waiting]


def test_one_process_reads_file_after_file(log: Path, fresh: reader_process._Idle) -> None:
    read_table(log)
    first = numbers_of_waiting(fresh)
    with pytest.raises(RecordError, match="cannot be read as HDF5"):
        read_table(spoil(log))
    with pytest.raises(RecordError, match=r"gone\.h5 cannot be opened \(no such file"):
        read_table(log.with_name("gone.h5"))
    np.testing.assert_array_equal(read_table(log).columns["axis/q"], POSITION)
    assert numbers_of_waiting(fresh) == first != []
    fresh.end()


def spoil(path: Path) -> Path:
    spoiled = path.with_name("spoiled.h5")
    spoiled.write_bytes(path.read_bytes()[:700])
    return spoiled


def test_what_is_sent_is_what_was_read(log: Path) -> None:
    """Blocks are tables of their own, and the numbers of a table cannot be changed."""
    rows = log.with_suffix(".parquet")
    LOGGED["parquet"].write(rows)
    blocks = [block.table() for block in read_blocks(rows, 100)]
    assert [block.rows for block in blocks] == [100, 100, 100]
    np.testing.assert_array_equal(np.concatenate([block.columns["q"] for block in blocks]), POSITION)
    whole = read_table(log)
    assert dict(whole.units) == {"axis/q": "rad", "axis/tau": "N\u00b7m"} and dict(whole.scalars) == {"kp": 2.5}
    assert not whole.columns["t"].flags.writeable


@pytest.mark.parametrize("program", ["while True: pass", "import os; os.abort()", "print('half', end='')"])
def test_a_file_that_ends_what_reads_it_or_keeps_it_busy_is_one_sentence(
    program: str, log: Path, fresh: reader_process._Idle, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    reader = tmp_path / "reader.py"
    reader.write_text(program)
    monkeypatch.setattr(reader_process, "_PROGRAM", reader)
    if "while" in program:
        monkeypatch.setattr(reader_process, "_BUSY", 0.03)
    said = r"not read within 11 s, the time for a file of its size" if "while" in program else r"ended what reads it"
    with pytest.raises(RecordError, match=rf"run\.h5 .*{said}.*\.$"):
        read_table(log)
    assert not fresh.waiting


@pytest.fixture(params=["bounded by the system", "bounded by its own watch"])
def bounds(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader has the module of the system's bounds, or as on Windows it has none."""
    if "watch" in request.param:
        (tmp_path / "without").mkdir()
        (tmp_path / "without" / "resource.py").write_text("raise ImportError")
        monkeypatch.syspath_prepend(tmp_path / "without")


@pytest.mark.slow
@pytest.mark.usefixtures("bounds")
def test_the_time_of_the_processor_is_bounded(
    tmp_path: Path, fresh: reader_process._Idle, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:  # millions of chunks, each of which is looked for
        file.create_dataset("q", shape=(2**26,), dtype="f8", chunks=(16,))
    monkeypatch.setattr(reader_process, "SECONDS", 0.5)
    with pytest.raises(
        RecordError, match=r"run\.h5 \(.* KiB\) is not read within 1 s, the time for a file of its size"
    ):
        read_table(path)
    assert not fresh.waiting


@pytest.mark.usefixtures("bounds")
def test_memory_is_bounded(tmp_path: Path, fresh: reader_process._Idle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader_process, "MEMORY", 2**20)
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("q", shape=(2**26,), dtype="f8", chunks=(2**16,), compression="gzip")
    with pytest.raises(
        RecordError, match=r"run\.h5 \(.* KiB\) takes more than the .* of memory that reading a file may"
    ):
        read_table(path)
    fresh.end()


def test_a_short_text_and_rows_of_numpy_need_no_process(tmp_path: Path, fresh: reader_process._Idle) -> None:
    for name in ("run.csv", "run.npy"):
        write_table(tmp_path / name, Table({"q": np.arange(5.0)}))
        assert read_table(tmp_path / name).rows == 5
    assert not fresh.waiting
    long = tmp_path / "long.csv"
    long.write_text("q\n" + f"{1.25:.22f}\n" * 90_000)
    assert read_table(long, delimiter=";").rows == Csv(delimiter=";").read(long).rows == 90_000
    assert fresh.waiting
    fresh.end()
