"""The process that reads files of others: it serves several, and however a file ends it, that is one sentence."""

from __future__ import annotations

import multiprocessing
import os
import select
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from jointid.common.errors import ExtraError, RecordError
from jointid.records.formats import Block, Csv, Npy, Table, read_blocks, read_table, reader_process, write_table
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


def test_a_path_is_that_of_the_folder_one_is_in(
    log: Path, fresh: reader_process._Idle, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (log.parent, log.parent.parent):
        monkeypatch.chdir(folder)
        assert read_table(log.relative_to(folder)).source == "run.h5"
    (number,) = numbers_of_waiting(fresh)
    if sys.platform == "linux":  # a disk that a process stands on cannot be taken away
        assert not Path(f"/proc/{number}/cwd").resolve().is_relative_to(log.parent.parent)
    fresh.end()


@pytest.mark.parametrize(
    ("error", "said"),
    [(MemoryError(), r"run\.npy \(.*\) takes more than the 2 GiB"), (OSError(5, "Input/output error"), "input/output")],
)
def test_a_block_that_cannot_be_read_is_one_sentence(
    error: Exception, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read when it is asked for, long after the file was opened."""

    def fail(_: int) -> Table:
        raise error

    write_table(tmp_path / "run.npy", Table({"q": np.arange(5.0)}))
    monkeypatch.setattr(Npy, "blocks", lambda *_: iter([Block(5, fail)]))
    (block,) = read_blocks(tmp_path / "run.npy", 5)
    with pytest.raises(RecordError, match=said):
        block.table()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux copies a process safely")
def test_a_copy_made_while_another_file_was_taken_does_not_wait_for_it(
    log: Path, fresh: reader_process._Idle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fresh, "owner", -1)
    with fresh.lock:  # as it is copied
        assert fresh.take() is None
        assert read_table(log).rows == POSITION.size


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


def test_a_process_that_ends_under_a_later_file_is_replaced(log: Path, fresh: reader_process._Idle) -> None:
    """What an earlier file left behind is not the fault of the next one."""
    read_table(log)
    (waiting,) = fresh.waiting
    waiting.process.kill()
    waiting.process.wait()
    np.testing.assert_array_equal(read_table(log).columns["axis/q"], POSITION)
    assert numbers_of_waiting(fresh) != [waiting.process.pid]
    fresh.end()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux copies a process safely")
def test_a_copy_of_this_process_has_a_reader_of_its_own(log: Path, fresh: reader_process._Idle) -> None:
    read_table(log)
    context = multiprocessing.get_context("fork")
    copies = [context.Process(target=read_table, args=(log,)) for _ in range(2)]
    for copy in copies:
        copy.start()
    np.testing.assert_array_equal(read_table(log).columns["axis/q"], POSITION)
    for copy in copies:
        copy.join()
    assert [copy.exitcode for copy in copies] == [0, 0]
    fresh.end()


ASKING = """
import sys
from jointid.records.formats.reader_process import ReaderProcess
reader = ReaderProcess.start()
print(reader.process.pid, flush=True)
reader.ask({"do": "read", "path": sys.argv[1], "options": {}, "seconds": 600}, 600.0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="waits for a process that is not its own by what only Linux has")
def test_a_process_that_is_busy_ends_with_the_one_it_reads_for_however_that_ends(tmp_path: Path) -> None:
    pipe = tmp_path / "run.h5"  # from which it waits for bytes that never come, and looks at no order meanwhile
    os.mkfifo(pipe)
    with subprocess.Popen([sys.executable, "-c", ASKING, pipe], stdout=subprocess.PIPE, text=True) as asking:
        assert asking.stdout is not None
        reader = os.pidfd_open(int(asking.stdout.readline()))
        writer = os.open(pipe, os.O_WRONLY)  # returns once the process is at it
        assert not select.select([reader], [], [], 0)[0]
        asking.kill()
    assert select.select([reader], [], [], 20)[0], "it lives on"
    os.close(writer)
    os.close(reader)


def test_a_package_that_is_missing_there_is_named_here() -> None:
    told = {"error": {"kind": "ExtraError", "faults": ["Reading HDF5 needs the package h5py."]}}
    with pytest.raises(ExtraError, match="needs the package h5py"):
        reader_process._require_good(told)
    with pytest.raises(RecordError, match=r"a fault of ours"):
        reader_process._require_good({"error": {"kind": "KeyError", "faults": ["x"]}})


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
