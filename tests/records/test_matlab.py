"""MAT files: exact round trips, what MATLAB stores in them, and files that are damaged or of another kind."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_table


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
