"""MAT and HDF5 files: exact round trips, what MATLAB stores in them, and files that are damaged or of another kind."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_table
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


def test_sides_of_one_number_do_not_count(tmp_path: Path) -> None:
    matrix = np.arange(21.0).reshape(3, 7)
    arrays = {"telemetry": matrix[:, None, :], "one": matrix[None, :1, :], "upright": matrix.T[None]}
    table = read_variables(tmp_path / "run.mat", {**arrays, "rec": {"data": matrix[:, None, :]}})
    for name in ("telemetry", "upright", "rec.data"):
        np.testing.assert_array_equal([table.columns[f"{name}[{channel}]"] for channel in range(3)], matrix)
    np.testing.assert_array_equal(table.columns["one"], matrix[0])
    assert not table.passed


def test_the_other_byte_order_is_read(tmp_path: Path) -> None:
    values = np.array([0.5, -1.0, 3.0], dtype=">f8").tobytes()
    path = tmp_path / "run.mat"
    path.write_bytes(struct.pack(">5i", 1000, 3, 1, 0, 2) + b"q\0" + values)
    np.testing.assert_array_equal(read_table(path).columns["q"], [0.5, -1, 3])

    flags, shape = struct.pack(">4I", 6, 8, 6, 0), struct.pack(">2I2i", 5, 8, 3, 1)
    array = flags + shape + struct.pack(">2H", 1, 1) + b"q\0\0\0" + struct.pack(">2I", 9, 24) + values
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    path.write_bytes(header + struct.pack(">2I", 14, len(array)) + array)
    np.testing.assert_array_equal(read_table(path).columns["q"], [0.5, -1, 3])


def test_the_emps_record_is_read(emps_path: Path) -> None:
    table = read_table(emps_path)
    assert set(table.columns) >= {"qm", "qg", "vir", "t"}
    assert {values.size for values in table.columns.values()} == {24841, 1}
    assert table.columns["kp"].tolist() == [160.18]


def test_objects_and_tables_of_rows_are_no_hindrance(data_dir: Path) -> None:
    table = read_table(data_dir / "kr300" / "rec_A.mat")
    assert table.columns["rec.act_pos_mot_deg[5]"].size == 2501
    assert table.columns["time_data.dt"].tolist() == [0.004]


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
        file["half"] = np.arange(3, dtype="f2")
    table = read_table(path)
    assert set(table.columns) == {
        "a/tall[0]", "a/tall[1]", "a/wide[0]", "a/wide[1]", "a/one", "a/b/log.q", "a/b/log.n", "a/on", "half",
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


# MATLAB's layout
# ---------------


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
