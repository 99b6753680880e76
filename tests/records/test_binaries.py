"""MAT, HDF5, Parquet and TDMS files: what is stored in them, and files that are damaged or declare too much."""

import datetime
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_blocks, read_table, table
from tests.records.logged import matlab_dataset, matlab_header


def read_variables(path: Path, variables: dict[str, Any], **how: Any) -> Table:
    savemat(path, variables, **how)
    return read_table(path)


def test_vectors_are_columns_and_single_numbers_of_one_row(tmp_path: Path) -> None:
    table = read_variables(
        tmp_path / "run.mat",
        {"t": np.arange(3.0)[:, None], "q": np.arange(4)[None, :], "position_gain": 160.18, "on": np.array([[True]])},
    )
    np.testing.assert_array_equal(table.columns["t"], [0, 1, 2])
    np.testing.assert_array_equal(table.columns["q"], [0, 1, 2, 3])
    assert table.columns["q"].dtype == np.float64
    assert [table.columns[name].tolist() for name in ("position_gain", "on")] == [[160.18], [1.0]]
    assert table.source == "run.mat"


def test_fields_of_structures_are_found_by_their_path(tmp_path: Path) -> None:
    axes = np.array([(np.arange(2.0), 1), (np.arange(3.0), 2)], dtype=[("q", object), ("n", object)])
    table = read_variables(tmp_path / "run.mat", {"rec": {"motor": {"q": np.arange(3.0)}, "dt": 0.004}, "axis": axes})
    assert list(table.columns) == ["rec.motor.q", "rec.dt", "axis[0].q", "axis[0].n", "axis[1].q", "axis[1].n"]
    np.testing.assert_array_equal(table.columns["axis[1].q"], [0, 1, 2])


def test_what_is_no_real_number_is_passed_over(tmp_path: Path) -> None:
    others = {
        "text": "a remark",
        "cell": np.array([np.arange(3.0), "x"], dtype=object),
        "phasor": np.array([1j, 2j]),
        "none": np.zeros((0, 3)),
        "cube": np.zeros((2, 2, 2)),
    }
    table = read_variables(tmp_path / "run.mat", {"q": np.arange(3.0), **others})
    assert list(table.columns) == ["q"]
    assert set(table.passed) == {"text", "cell", "phasor", "none", "cube"}
    with pytest.raises(RecordError):
        read_variables(tmp_path / "run.mat", others)


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def matrix(name: bytes, dimensions: bytes, kind: int = 5) -> bytes:
    flags = element(6, struct.pack("<II", 6, 0))
    return element(14, flags + element(kind, dimensions) + element(1, name) + element(9, np.ones(5).tobytes()))


HEAD = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
FIVE = struct.pack("<ii", 5, 1)


def test_two_variables_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    path.write_bytes(HEAD + matrix(b"q", FIVE) + matrix(b"r", FIVE))
    assert list(read_table(path).columns) == ["q", "r"]
    path.write_bytes(HEAD + matrix(b"q", FIVE) + matrix(b"q", FIVE))
    with pytest.raises(RecordError):
        read_table(path)


def test_matrices_and_records_give_a_column_for_each_part(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    rows = np.zeros(4, dtype=[("q", "<f8"), ("n", ">i4"), ("text", "S3")])
    rows["q"], rows["n"] = np.arange(4) / 3, range(4)
    with h5py.File(path, "w") as file:
        file["a/tall"] = np.arange(6.0).reshape(3, 2)
        file["a/wide"] = np.arange(6.0).reshape(2, 3)
        file["a/one"] = np.arange(3)[:, None]
        file["a/b/log"] = rows
        file["a/on"] = np.array([True, False])
        file[b"half \xff"] = np.arange(3, dtype="f2")  # no UTF-8
    table = read_table(path)
    assert set(table.columns) == {
        "a/tall[0]", "a/tall[1]", "a/wide[0]", "a/wide[1]", "a/one", "a/b/log.q", "a/b/log.n", "a/on", "half \ufffd",
    }  # fmt: skip
    np.testing.assert_array_equal(table.columns["a/tall[1]"], [1, 3, 5])
    np.testing.assert_array_equal(table.columns["a/wide[1]"], [3, 4, 5])
    np.testing.assert_array_equal(table.columns["a/b/log.n"], range(4))
    np.testing.assert_array_equal(table.columns["a/on"], [1, 0])


def test_what_is_no_number_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["q"] = np.arange(3.0)
        file["text"] = ["a", "b"]
        file["phasor"] = np.array([1j, 2j])
        file["none"] = h5py.Empty("f8")
        file["empty"] = np.zeros((0, 2))
        file["cube"] = np.zeros((2, 2, 2))
        file["picture"] = np.zeros((1200, 1100), dtype="u1")
    table = read_table(path)
    assert list(table.columns) == ["q"]
    assert set(table.passed) == {"text", "phasor", "none", "empty", "cube", "picture"}


def test_nothing_outside_the_file_is_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["key"] = np.arange(5.0)
    np.arange(5.0).tofile(tmp_path / "raw.bin")
    path = tmp_path / "run.h5"
    layout = h5py.VirtualLayout(shape=(5,), dtype="f8")
    layout[:] = h5py.VirtualSource(secret, "key", shape=(5,))
    with h5py.File(path, "w") as file:
        file["q"] = np.arange(3.0)
        file["linked"] = h5py.ExternalLink(secret.name, "/key")
        file["soft"] = h5py.SoftLink("/linked")
        file["loop"] = file["/"]
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("stored", (5,), "f8", external=[(str(tmp_path / "raw.bin"), 0, h5py.h5f.UNLIMITED)])
    table = read_table(path)
    assert list(table.columns) == ["q"]
    assert set(table.passed) == {"virtual", "stored"}
    with h5py.File(path, "r+") as file:
        del file["q"]
    with pytest.raises(RecordError):
        read_table(path)


def test_a_terabyte_that_is_only_declared_is_refused_before_there_is_memory_for_it(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("bomb", shape=(2**37,), dtype="f8", chunks=(2**16,), compression="gzip")
    assert path.stat().st_size < 10_000
    tracemalloc.start()
    with pytest.raises(RecordError, match="declares"):
        read_table(path)
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


def test_matlabs_own_layout_is_read_as_version_7_is(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    matrix = np.arange(12.0).reshape(6, 2)
    square = np.arange(4.0).reshape(2, 2)
    with h5py.File(path, "w", userblock_size=512) as file:
        matlab_dataset(file, "q", matrix)
        matlab_dataset(file, "square", square)
        matlab_dataset(file, "position_gain", np.array([[160.18]]), "single")
        matlab_dataset(file, "on", np.array([[True], [False]]).astype("u1"), "logical").attrs["MATLAB_int_decode"] = 1
        matlab_dataset(file, "remark", np.array([[114, 117, 110]], dtype="u2"), "char")
        matlab_dataset(file, "none", np.array([0, 3], dtype="u8")).attrs["MATLAB_empty"] = 1
        file.create_dataset("phasor", data=np.zeros((1, 3), dtype=[("real", "f8"), ("imag", "f8")]))
        file["phasor"].attrs["MATLAB_class"] = np.bytes_("double")
        hidden = file.create_group("#refs#")
        matlab_dataset(hidden, "q0", np.arange(3.0)[:, None])
        axis = file.create_group("axis")
        axis.attrs["MATLAB_class"] = np.bytes_("struct")
        axis.create_dataset("q", data=np.array([[hidden["q0"].ref]], dtype=h5py.ref_dtype))
        cell = file.create_dataset("cell", data=np.array([[hidden["q0"].ref]], dtype=h5py.ref_dtype))
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        sparse = file.create_group("sparse")
        sparse.attrs["MATLAB_class"], sparse.attrs["MATLAB_sparse"] = np.bytes_("double"), 3
        sparse["data"] = np.ones(3)
    matlab_header(path)
    table = read_table(path)
    assert set(table.columns) == {"q[0]", "q[1]", "square[0]", "square[1]", "on", "position_gain"}
    np.testing.assert_array_equal(table.columns["q[1]"], matrix[:, 1])
    np.testing.assert_array_equal(table.columns["square[1]"], square[:, 1])
    assert set(table.passed) == {"axis.q", "cell", "none", "phasor", "remark", "sparse.data"}


def test_every_kind_of_number_is_a_column(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    begin = datetime.datetime(2024, 3, 4, tzinfo=datetime.UTC)
    stamps = [begin + datetime.timedelta(microseconds=1500 * i) for i in range(3)]
    pq.write_table(
        pa.table(
            {
                "when": pa.array(stamps),
                "held": pa.array([0, 2_000_000, 3_000_000], pa.duration("us")),
                "count": pa.array([1, None, 3], pa.int32()),
                "on": pa.array([True, False, None]),
                "joint": pa.array([{"q": 1.0, "name": "a"}, {"q": 2.5, "name": "b"}, {"q": None, "name": "c"}]),
                "wrench": pa.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], pa.list_(pa.float32(), 2)),
                "word": pa.array([7, 7, 9]).dictionary_encode(),
                "text": ["x", "y", "z"],
                "lists": [[1.0], [1.0, 2.0], []],
            }
        ),
        path,
    )
    table = read_table(path)
    found = {name: values.tolist() for name, values in table.columns.items()}
    nan = pytest.approx(np.nan, nan_ok=True)
    assert found == {
        "when": [0, 0.0015, 0.003], "held": [0, 2, 3], "count": [1, nan, 3], "on": [1, 0, nan],
        "joint.q": [1, 2.5, nan], "wrench[0]": [1, 3, 5], "wrench[1]": [2, 4, 6], "word": [7, 7, 9],
    }  # fmt: skip
    assert dict(table.units) == {"when": "s", "held": "s"}
    assert set(table.passed) == {"text", "joint.name", "lists"}
    pieces = [block.columns["when"] for block in read_blocks(path, 1)]
    assert np.concatenate(pieces).tolist() == [0, 0.0015, 0.003]


@pytest.mark.parametrize("suffix", [".parquet", ".tdms"])
def test_more_than_is_read_at_once_is_refused_by_its_size(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"run{suffix}"
    if suffix == ".parquet":  # a constant column packs a million rows into a few bytes
        pq.write_table(pa.table({"q": np.zeros(1_000_000)}), path)
        assert path.stat().st_size < 30_000
    else:
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("g", "q", np.zeros(1_000_000))])
    monkeypatch.setattr(table, "WHOLE", 2**20)
    with pytest.raises(RecordError):
        read_table(path)


def test_a_waveform_gets_the_time_it_has_no_column_for(tmp_path: Path) -> None:
    path = tmp_path / "run.tdms"
    fast = {"wf_increment": 0.5, "wf_start_offset": 1.0, "unit_string": "V"}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("drive", "q", np.arange(3.0), fast),
                ChannelObject("drive", "i", np.arange(3, dtype=np.int16), fast),
                ChannelObject("load", "fast", np.arange(4.0), {"wf_increment": 0.1}),
                ChannelObject("load", "slow", np.arange(2.0), {"wf_increment": 0.2}),
                ChannelObject("Untitled", "remark", ["a", "b"]),
                ChannelObject("Untitled", "when", np.array(["2024-01-01", "2024-01-01T00:00:00.0015"], "M8[us]")),
            ]
        )
    table = read_table(path)
    found = {name: values.tolist() for name, values in table.columns.items()}
    assert found["drive/time"] == [1.0, 1.5, 2.0]
    assert found["load/fast/time"] == pytest.approx([0, 0.1, 0.2, 0.3])
    assert found["load/slow/time"] == [0, 0.2]
    assert found["when"] == pytest.approx([0, 0.0015], abs=1e-9)
    assert found["drive/i"] == [0, 1, 2]
    assert "remark" not in found and "Untitled/remark" not in found
    assert table.units["drive/i"] == "V"


@pytest.mark.parametrize("suffix", [".parquet", ".tdms"])
def test_instants_of_several_columns_keep_their_distance(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    early = np.datetime64("2026-01-01T00:00:00.000000") + np.arange(3) * np.timedelta64(1, "ms")
    late = early + np.timedelta64(250, "ms")
    if suffix == ".parquet":
        pq.write_table(pa.table({"a": pa.array(early), "b": pa.array(late.astype("datetime64[ms]"))}), path)
    else:
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("", "a", early), ChannelObject("g", "b", late)])
    found = list(read_table(path).columns.values())
    np.testing.assert_allclose(found, [[0, 0.001, 0.002], [0.25, 0.251, 0.252]], rtol=1e-12)


def test_a_waveform_that_began_later_has_a_later_clock(tmp_path: Path) -> None:
    path = tmp_path / "run.tdms"
    begin = np.datetime64("2026-01-01T00:00:00.000000")
    with TdmsWriter(path) as writer:
        for name, start in (("trq", begin), ("pos", begin + np.timedelta64(250, "ms"))):
            properties = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_start_time": start}
            writer.write_segment([ChannelObject("g", name, np.zeros(3), properties=properties)])
    table = read_table(path)
    assert dict(table.clocks) == {"g/trq": "g/trq/time", "g/pos": "g/pos/time"}
    assert table.columns["g/trq/time"][0] == 0
    np.testing.assert_allclose(table.columns["g/pos/time"], [0.25, 0.251, 0.252], rtol=1e-12)
