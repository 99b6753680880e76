"""A record in pieces: the same numbers as at once, whatever the length, and one sentence where a row is bad."""

from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.records.chunks import InMemory, Log
from jointid.records.clock import Cut
from jointid.records.formats import Table, read_blocks, read_table, write_table
from jointid.records.formats.table import join_tables
from jointid.records.record import Channel, Injection, Record

CHANNELS = {"torque": "torque", "reference": "reference"}
ROWS, LEFT_OUT = 97, ((0.345, 0.495),)


def numbers(rows: int = ROWS) -> dict[str, np.ndarray]:
    time = np.arange(rows) * 0.01
    return {"t": time, "torque": np.round(np.sin(7 * time), 6), "reference": np.round(0.01 * np.cos(time), 6)}


@pytest.fixture(params=[".csv", ".npy", ".parquet"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    made = tmp_path / f"day{request.param}"
    write_table(made, Table(numbers()))
    return made


@pytest.mark.parametrize("rows", [1, 10, 96, 97, 500])
def test_blocks_together_are_the_whole(path: Path, rows: int) -> None:
    whole, blocks = read_table(path), list(read_blocks(path, rows))
    assert [block.rows for block in blocks[:-1]] == [rows] * (len(blocks) - 1)
    for name, values in whole.columns.items():
        np.testing.assert_array_equal(np.concatenate([b.columns[name] for b in blocks]), values)
        np.testing.assert_array_equal(blocks[0].columns[name][:3], values[: min(3, rows)])


def test_comments_and_empty_lines_are_no_rows(tmp_path: Path) -> None:
    lines = ["# a drive", "t;pos [mm];", "", *(f"{i};{i},5;" for i in range(20))]
    lines[9:9] = ["# paused", "", "  "]
    made = tmp_path / "log.csv"
    made.write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    whole, blocks = read_table(made), list(read_blocks(made, 7))
    assert list(whole.columns) == ["t", "pos [mm]"]
    assert [b.columns["t"].size for b in blocks] == [7, 7, 6]
    np.testing.assert_array_equal(np.concatenate([b.columns["pos [mm]"] for b in blocks]), whole.columns["pos [mm]"])


@pytest.mark.parametrize(("line", "bad"), [(52, "0.5,oops,0.1"), (51, "0.5,0.1"), (98, "0.96,0.1")])
def test_a_bad_row_far_down_is_named_by_its_line(tmp_path: Path, line: int, bad: str) -> None:
    made = tmp_path / "day.csv"
    write_table(made, Table(numbers()))
    lines = made.read_text(encoding="utf-8").splitlines()
    lines[line - 1] = bad
    made.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(ji.RecordError, match=f"line {line} has"):  # row 50 is the last of a block, not of the file
        list(Log(made, CHANNELS).chunks(10, 2))


def test_a_piece_is_a_cut_of_the_record(path: Path) -> None:
    whole, log = ji.read(path, CHANNELS, leave_out=LEFT_OUT), Log(path, CHANNELS, {"cut": Cut(leave_out=LEFT_OUT)})
    counts = whole.counts(ROWS, 0.01)
    assert np.flatnonzero(counts == 0.0).tolist() == list(range(35, 50))
    assert log.sample_time == pytest.approx(0.01)
    assert log.name == "day"
    pieces, same = list(log.chunks(20, 6)), list(InMemory(whole).chunks(20, 6))
    assert [p.number for p in pieces] == [p.number for p in same] == [0, 1, 2, 3, 4]
    assert [p.last for p in pieces] == [p.last for p in same] == [False] * 4 + [True]
    for piece, cut in zip(pieces, same, strict=True):
        first = 20 * piece.number
        for one in (piece.record, cut.record):
            np.testing.assert_array_equal(one.counts(len(one.torque), 0.01), counts[first : first + 26])
        assert piece.record.begin == pytest.approx(cut.record.begin) == pytest.approx(0.01 * first)
        for (_, channel), (_, other), (_, all_of_it) in zip(
            piece.record.items(), cut.record.items(), whole.items(), strict=True
        ):
            np.testing.assert_array_equal(channel.values, all_of_it.values[first : first + 26])
            np.testing.assert_array_equal(channel.values, other.values)
            assert channel.sample_time == log.sample_time
            assert (channel.timing, channel.unit) == (other.timing, other.unit)


@pytest.mark.parametrize(("rows", "overlap", "count"), [(81, 6, 4), (85, 6, 4), (86, 6, 5), (81, 0, 5), (5, 6, 1)])
def test_a_rest_that_is_in_the_piece_before_is_no_piece(tmp_path: Path, rows: int, overlap: int, count: int) -> None:
    """One row too many, with a single stamp of the clock, must not end a day of them."""
    made, clock = tmp_path / "day.npy", {"time": "t"} if overlap else {"sample_time": 0.01}
    write_table(made, Table(numbers(rows)))
    log = Log(made, CHANNELS, clock)
    for pieces in (list(log.chunks(20, overlap)), list(InMemory(ji.read(made, CHANNELS)).chunks(20, overlap))):
        assert [p.last for p in pieces] == [False] * (count - 1) + [True]
        torque = pieces[-1].record.torque
        assert len(torque) == rows - 20 * (count - 1)


def test_what_is_injected_is_cut_too() -> None:
    values = np.arange(30.0)
    whole = Record(torque=Channel(values, "N", 0.01), injected=Injection(Channel(values, "N", 0.01)))
    (_, second, _) = InMemory(whole).chunks(10, 2)
    np.testing.assert_array_equal(second.record.injected.channel.values, values[10:22])
    assert second.record.injected.at is whole.injected.at


def test_a_jump_of_the_clock_is_found_where_it_is(tmp_path: Path) -> None:
    columns = numbers(2000)
    columns["t"] = np.where(np.arange(2000) < 1555, columns["t"], columns["t"] + 3.0)
    made = tmp_path / "day.npy"
    write_table(made, Table(columns))
    with pytest.raises(ji.RecordError, match=r"rows from 1501 on: .*\(t = 15.54 s;"):
        list(Log(made, CHANNELS).chunks(100, 4))


def test_what_cannot_be_read_in_pieces_says_so(tmp_path: Path) -> None:
    with pytest.raises(ji.RecordError):
        Log("day.csv", {**CHANNELS, "torque": ji.Column("torque", sample_time=0.02)})
    with pytest.raises(ji.RecordError):
        list(Log(tmp_path / "none.csv", CHANNELS).chunks(20, 4))


def test_a_column_that_a_block_lacks_is_passed_over_with_its_clock() -> None:
    one, two = np.zeros(2), np.ones(3)
    first = Table({"t": one, "q": one, "state": one}, clocks={"q": "state"})
    whole = join_tables([first, Table({"t": two, "q": two}, passed={"state": "it holds text"})])
    assert list(whole.columns) == ["t", "q"]
    np.testing.assert_array_equal(whole.columns["q"], [0, 0, 1, 1, 1])
    assert (dict(whole.passed), dict(whole.clocks)) == ({"state": "it holds text"}, {})


SHAPED = {
    "rows": lambda m: m, "by columns": np.asfortranarray, "on its side": lambda m: np.ascontiguousarray(m.T),
    "on its side, by columns": lambda m: m.T, "3 x 1 x N": lambda m: np.ascontiguousarray(m.T)[:, None, :],
    "1 x N x 3": lambda m: m[None], "narrow": lambda m: m.astype(np.int16), "truth": lambda m: (m > 7).astype(bool),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPED)
def test_the_samples_of_a_numpy_matrix_run_along_its_longer_side(name: str, tmp_path: Path) -> None:
    made, matrix = tmp_path / "log.npy", np.arange(33.0).reshape(11, 3)
    np.save(made, SHAPED[name](matrix))
    expected = matrix > 7 if name == "truth" else matrix
    table = read_table(made)
    assert list(table.columns) == ["1", "2", "3"]
    np.testing.assert_array_equal(np.stack(list(table.columns.values()), axis=1), expected)
    pieces = join_tables(list(read_blocks(made, 4)))
    np.testing.assert_array_equal(np.stack(list(pieces.columns.values()), axis=1), expected)


def test_numpy_vectors_instants_and_fields_of_arrays(tmp_path: Path) -> None:
    made = tmp_path / "log.npy"
    np.save(made, np.arange(5.0)[None])
    assert read_table(made).columns["1"].tolist() == [0, 1, 2, 3, 4]
    rows = np.zeros(3, dtype=[("t", "M8[us]"), ("q", "f4", (2,)), ("state", "U4"), ("d", "m8[ms]")])
    rows["t"] = np.datetime64("2031-05-06T00:00:00.000250") + np.arange(3) * np.timedelta64(4, "ms")
    rows["q"], rows["d"] = [[1, 2], [3, 4], [5, 6]], [5, 6, 7]
    np.save(made, rows)
    for table in (read_table(made), join_tables(list(read_blocks(made, 2)))):
        assert {name: values.tolist() for name, values in table.columns.items()} == {
            "t": [0, 0.004, 0.008], "q[0]": [1, 3, 5], "q[1]": [2, 4, 6], "d": [0.005, 0.006, 0.007]
        }  # fmt: skip
        assert set(table.passed) == {"state"}
