"""Parquet and TDMS: kinds of columns, nulls, instants, waveforms, and what they declare."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from nptdms import ChannelObject, TdmsWriter

from jointid.common.errors import RecordError
from jointid.records.formats import read_blocks, read_table, table


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
