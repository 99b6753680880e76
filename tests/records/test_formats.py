"""Every format: what its own library writes is read, what is written comes back, what is spoiled is one sentence."""

import os
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jointid as ji
from jointid.output.json import dumps, to_dict
from jointid.records.formats import Table, read_blocks, read_table, write_table
from tests.records.logged import LOGGED, POSITION, ROWS, TIME, TORQUE, Logged

PACKAGES = {"hdf5": "h5py", "mat73": "h5py", "parquet": "pyarrow", "tdms": "nptdms", "mcap": "rosbags"}


def made(name: str, folder: Path) -> Path:
    path = folder / f"run{LOGGED[name].suffix}"
    LOGGED[name].write(path)
    return path


@pytest.mark.parametrize("name", LOGGED)
def test_what_the_formats_own_library_writes_is_read_and_inspected(name: str, tmp_path: Path) -> None:
    """At once; in blocks where there are rows one after the other."""
    path = made(name, tmp_path)
    table = read_table(path)
    time, position, torque = (table.columns[column] for column in LOGGED[name].names)
    np.testing.assert_allclose(time, TIME, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(position, POSITION)
    np.testing.assert_array_equal(torque, TORQUE)
    assert table.source == path.name
    if name not in ("csv", "npy", "parquet"):
        with pytest.raises(ji.RecordError):
            next(iter(read_blocks(path, 10)))
    inspection = ji.inspect(path)
    channels = {channel.name: channel for channel in inspection.channels}
    clock, moved, pulled = (channels[column] for column in LOGGED[name].names)
    assert moved.time == pulled.time == clock.name
    assert (moved.rows, moved.sample_time, moved.maximum) == (ROWS, pytest.approx(1e-3), pytest.approx(1.0, abs=1e-4))
    assert ("rad" in str(inspection)) == (name in ("hdf5", "parquet", "tdms"))
    assert f'"{clock.name}"' in dumps(to_dict(inspection))


values = st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=5)


@pytest.mark.parametrize("suffix", [".mat", ".parquet", ".npy"])
@settings(max_examples=10)  # some of them start a process for each
@given(data=st.data())
def test_what_is_written_is_read_to_the_last_bit(
    suffix: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"round{suffix}"
    size = data.draw(st.integers(2, 5))
    exact = st.lists(st.floats(allow_nan=True), min_size=size, max_size=size)
    names = data.draw(st.lists(st.sampled_from(["t", "q", "tau", "x_1"]), min_size=1, max_size=3, unique=True))
    columns = {name: np.array(data.draw(values if suffix == ".mat" else exact)) for name in names}
    units = {names[0]: "mm"} if suffix == ".parquet" else {}
    write_table(path, Table(columns, units=units))
    again = read_table(path)
    for name, column in columns.items():
        assert column.tobytes() == again.columns[name].tobytes() or np.isnan(column).any()
        np.testing.assert_array_equal(again.columns[name], column)
    assert dict(again.units) == units


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("x.csv", Table({"a": np.zeros(2), "b": np.zeros(3)})),
        ("x.csv", Table({"2": np.zeros(2)})),
        ("x.csv", Table({"a\nb": np.zeros(2)})),
        ("x.csv", Table({"=1+1": np.zeros(2)})),
        ("x.csv", Table({})),
        ("x.mat", Table({"t [s]": np.ones(2), "rec.q": np.ones(2)})),
        ("x.mat", Table({"1": np.zeros(2)})),
        ("x.mat", Table({"end": np.zeros(2)})),
        ("x.mat", Table({"a" * 64: np.zeros(2)})),
        ("x.parquet", Table({"a": np.ones(2), "b": np.ones(3)})),
        ("x.h5", Table({"a": np.ones(2)})),
        ("x.csv.gz", Table({"a": np.ones(2)})),
        ("none/x.csv", Table({"a": np.ones(2)})),
    ],
)
def test_what_a_format_cannot_hold_is_refused(name: str, table: Table, tmp_path: Path) -> None:
    with pytest.raises(ji.RecordError):
        write_table(tmp_path / name, table)
    assert not (tmp_path / name).exists()
    with pytest.raises(ji.RecordError):
        ji.read(table)  # as of pandas


@pytest.mark.parametrize("name", PACKAGES)
def test_a_missing_package_is_named_with_its_extra(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = made(name, tmp_path)
    for module in [m for m in sys.modules if m.partition(".")[0] == PACKAGES[name]]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, PACKAGES[name], None)
    with pytest.raises(ji.JointidError, match=rf'needs the package {PACKAGES[name]}.*pip install "jointid\[logs\]"'):
        read_table(path)


def test_a_thousand_columns_of_npy_come_back_and_more_than_are_read_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "wide.npy"
    write_table(path, Table({f"channel {k}": np.arange(3.0) for k in range(1000)}))
    assert list(read_table(path).columns)[::999] == ["channel 0", "channel 999"]
    np.save(path, np.zeros((10_002, 10_001), dtype="u1"))
    with pytest.raises(ji.RecordError):
        read_table(path)
    with path.open("wb") as file:  # a byte each in the file, and eight in memory
        header = {"descr": [("q", "|u1")], "fortran_order": False, "shape": (2**28,)}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 2**28)
    with pytest.raises(ji.RecordError):
        read_table(path)
    assert next(read_blocks(path, 100)).rows == 100


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe has no path")
def test_a_pipe_is_not_called_empty(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run.csv")
    with pytest.raises(ji.RecordError):
        read_table(tmp_path / "run.csv")


def recorded(path: Path, logged: Logged, **how: Any) -> Any:
    time, position, torque = logged.names
    return ji.read(path, {"torque": torque, "reference": position}, time=time, kind="revolute", **how)


def test_the_unit_of_the_file_counts_where_none_is_stated(tmp_path: Path) -> None:
    path, logged = made("hdf5", tmp_path), LOGGED["hdf5"]
    with h5py.File(path, "r+") as file:
        file["axis/q"].attrs["units"] = "°"
        file["t"].attrs["units"] = "ms"
        file["t"][...] = TIME * 1000
    record = recorded(path, logged)
    np.testing.assert_allclose(record.reference.values, POSITION * np.pi / 180)
    np.testing.assert_array_equal(record.torque.values, TORQUE)
    assert record.torque.sample_time == pytest.approx(1e-3)
    stated = {"torque": "axis/tau", "reference": ji.Column("axis/q", unit="rad")}
    said = ji.read(path, stated, time="t", kind="revolute")
    np.testing.assert_array_equal(said.reference.values, POSITION)


def test_clocks_of_different_lengths_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    columns = {"a/time": np.arange(9) / 10, "a/q": np.ones(9), "b/time [ms]": np.arange(5.0), "b/q": np.ones(5),
               "c/time": np.array([0.0, 1.0, 0.5]), "c/q": np.ones(3)}  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values
    inspection = ji.inspect(path)
    found = {channel.name: (channel.time, channel.sample_time) for channel in inspection.channels}
    assert found["a/q"] == ("a/time", pytest.approx(0.1))
    assert found["b/q"] == ("b/time [ms]", pytest.approx(1e-3))
    assert found["c/q"] == (None, None)  # its clock runs back


def test_hostile_names_are_shown_escaped(tmp_path: Path) -> None:
    path = tmp_path / "run.npy"
    hostile = "\x1b[2J\x07q\n\u202ex$^_{$"
    write_table(path, Table({hostile: np.arange(3.0), "<script>": np.ones(3)}))
    inspection = ji.inspect(path)
    text = str(inspection)
    assert all(character.isprintable() or character == "\n" for character in text)
    assert "\\x1b[2J\\x07q\\n\\u202ex" in text
