"""Delimited text: exact round trips, awkward files, one sentence for each file that cannot be read."""

import gzip
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_blocks, read_table, write_table

NAN = float("nan")
Read = Callable[..., Table]

names = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
values = st.floats(allow_nan=True, allow_infinity=True)


@st.composite
def tables(draw: st.DrawFn, names: st.SearchStrategy[str] = names) -> Table:
    headings = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    rows = draw(st.integers(1, 6))
    column = st.lists(values, min_size=rows, max_size=rows)
    return Table({heading: np.array(draw(column)) for heading in headings})


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Read:
    folder = tmp_path_factory.mktemp("csv")

    def read_text(content: str | bytes, **options: object) -> Table:
        path = folder / "run.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_table(path, **options)

    return read_text


def assert_same(table: Table, columns: dict[str, list[float]]) -> None:
    assert list(table.columns) == list(columns)
    for name, expected in columns.items():
        np.testing.assert_array_equal(table.columns[name], expected)


AWKWARD: dict[str, tuple[str | bytes, dict[str, list[float]]]] = {
    "German spreadsheet": ("sep=;\r\nt;q\r\n0;1,5\r\n0,1;-2,5e3\r\n", {"t": [0, 0.1], "q": [1.5, -2500]}),
    "four whole numbers": ("1,5,2,5\n1,6,2,6\n", {"1": [1, 1], "2": [5, 6], "3": [2, 2], "4": [5, 6]}),
    "whole numbers at the end": ("a;b\n0,5;1\n" + "0;0\n" * 300, {"a": [0.5] + [0] * 300, "b": [1] + [0] * 300}),
    "quoted decimal commas": ('"a","b"\n"1,5","2,5"\n', {"a": [1.5], "b": [2.5]}),
    "quoted names": ('"Motor pos, [mm]";"i ""q"""\n1;2\n', {"Motor pos, [mm]": [1], 'i "q"': [2]}),
    "quoted names, blanks between": ('"motor position" torque\n1 2\n', {"motor position": [1], "torque": [2]}),
    "aligned with blanks": ("   t    q\n   0  1.5\n  10   -2\n", {"t": [0, 10], "q": [1.5, -2]}),
    "comments": ("% run 7\n// drive 3\nt,q\n# s, m\n0,1\n\n# late\n1,2\n", {"t": [0, 1], "q": [1, 2]}),
    "preamble without names": ("Scope export\n0;1\n1;2\n", {"1": [0, 1], "2": [1, 2]}),
    "line of units": ("t;i q;n\n[s];A;\n0;1;2\n", {"t [s]": [0], "i q [A]": [1], "n": [2]}),
    "closed rows": ("t,q,\n0,1,\n1,2,\n", {"t": [0, 1], "q": [1, 2]}),
    "empty last column": ("t,q,x\n0,1,\n1,2,\n", {"t": [0, 1], "q": [1, 2], "x": [NAN, NAN]}),
    "empty cells": ("t,q\n0,\n1, \n2,nan\n3,4\n", {"t": [0, 1, 2, 3], "q": [NAN, NAN, NAN, 4]}),
    "empty cells between tabs": ("t\tq\tx\n0\t\t1\n", {"t": [0], "q": [NAN], "x": [1]}),
    "nameless first column": (",t,q\n0,1,2\n", {"1": [0], "t": [1], "q": [2]}),
    "Latin-1": ("Drehmoment für q;µ\n0;1\n".encode("latin-1"), {"Drehmoment für q": [0], "µ": [1]}),
    "carriage returns": ("t,q\r0,1\r1,2\r", {"t": [0, 1], "q": [1, 2]}),
    "commas and blanks beside decimal commas": ("t, q\n0,5, 1,5\n1,5, 2\n", {"t": [0.5, 1.5], "q": [1.5, 2]}),
    "commas and blanks between whole numbers": ("t, q\n0, 1\n1, 2\n", {"t": [0, 1], "q": [1, 2]}),
    "PicoScope": ("Time,Channel A\n(ms),(V)\n\n0.5,1\n", {"Time [ms]": [0.5], "Channel A [V]": [1]}),
    "Startdrive": (
        '"Time";"p1:r62";"p1:r80"\r\n"ms";"1/min";"Nm"\r\n0,0;1,5;2,0\r\n0,125;2,5;3,0\r\n',
        {"Time [ms]": [0, 0.125], "p1:r62 [1/min]": [1.5, 2.5], "p1:r80 [Nm]": [2, 3]},
    ),
    "a drive's own units": (
        "Time;s_set;i_act;enc\nms;LU;Arms;Inkr\n0;1;2;3\n",
        {"Time [ms]": [0], "s_set [LU]": [1], "i_act [Arms]": [2], "enc [Inkr]": [3]},
    ),
    "units without brackets": ("Zeit;Strom;T\ns;A;°C\n0;1;2\n", {"Zeit [s]": [0], "Strom [A]": [1], "T [°C]": [2]}),
    "names nobody uses": (
        "t,q,Not selected,Not selected\n0,1,0,0\n",
        {"t": [0], "q": [1], "column 3: Not selected": [0], "column 4: Not selected": [0]},
    ),
    "a column of words": ("t,q,state\n0,1,idle\n1,2,run\n", {"t": [0, 1], "q": [1, 2]}),
    "a first column of truth": ("on;t;q\nTrue;0;1,5\nFalse;1;2,5\n", {"t": [0, 1], "q": [1.5, 2.5]}),
    "words with the delimiter in them": ('t,state,q\n0,"a, b",1\n1,"c, d",2\n', {"t": [0, 1], "q": [1, 2]}),
    "events between empty cells": ("t,q,x\n0,1,\n1,2,\n2,3,start\n3,4,\n", {"t": [0, 1, 2, 3], "q": [1, 2, 3, 4]}),
    "words between blanks": ("t state q\n0 idle 1\n1 run 2\n", {"t": [0, 1], "q": [1, 2]}),
    "lists, quoted": ('t;q;n\n0.5;"[1.0, -2e-3]";7\n', {"t": [0.5], "q[0]": [1], "q[1]": [-2e-3], "n": [7]}),
    "lists, of blanks": ("t;q;n\n0.5;[1.0 -2e-3];7\n", {"t": [0.5], "q[0]": [1], "q[1]": [-2e-3], "n": [7]}),
    "two returns, as of Universal Robots": ("t q_0\r\r\n1 2.5\r\r\n2 3.5\r\r\n", {"t": [1, 2], "q_0": [2.5, 3.5]}),
}


@pytest.mark.parametrize("name", AWKWARD)
def test_an_awkward_file_gives_the_right_table(name: str, read: Read) -> None:
    content, columns = AWKWARD[name]
    assert_same(read(content), columns)


STAMPED = {
    "ISO 8601": ("2031-05-06T23:59:59.500,1\n2031-05-07T00:00:00.250,2\n", 0.75),
    "a blank for the T": ("2031-05-06 10:00:00.5,1\n2031-05-06 10:00:01,2\n", 0.5),
    "without hyphens": ("20310506T100000.5,1\n20310506T100002,2\n", 1.5),
    "Greenwich": ("2031-05-06T10:00:00.1Z,1\n2031-05-06T10:00:00.3Z,2\n", 0.2),
    "the zone changes": ("2031-10-26T02:59:59+02:00,1\n2031-10-26T02:00:00+01:00,2\n", 1.0),
    "decimal comma": ("2031-05-06 10:00:00,004;1,5\n2031-05-06 10:00:00,012;2,5\n", 0.008),
    "day first": ("31.01.2031 23:59:59;1\n01.02.2031 00:00:01;2\n", 2.0),
    "month first": ("01/31/2031 11:59:59 PM,1\n02/01/2031 12:00:00 AM,2\n", 1.0),
    "day or month first": ("01/02/2031 23:59:59,1\n02/02/2031 00:00:02,2\n", 3.0),
    "times of day": ("10:00:00.125,1\n10:00:00.375,2\n", 0.25),
    "midnight": ("23:59:59.900,1\n00:00:00.100,2\n", 0.2),
    "milliseconds behind a colon": ("10:00:00:996,1\n10:00:01:004,2\n", 0.008),
    "minutes": ("59:59.5,1\n00:00.5,2\n", 1.0),
    "nanoseconds": ("10:00:00.000000001,1\n10:00:00.000000004,2\n", 3e-9),
}


@pytest.mark.parametrize("name", STAMPED)
@pytest.mark.parametrize("heading", ["t", "Zeitstempel [hh:mm:ss]", None])
def test_instants_are_a_clock_from_the_first(name: str, heading: str | None, read: Read) -> None:
    rows, later = STAMPED[name]
    mark = ";" if ";" in rows else ","
    table = read(rows if heading is None else f"{heading}{mark}q\n{rows}")
    clock, channel = (heading or "1"), ("q" if heading else "2")
    assert table.columns[clock].tolist() == [0.0, later]
    assert table.units == {clock: "s"}
    assert table.clocks == ({} if heading == "t" else {channel: clock})
    assert np.floor(table.columns[channel]).tolist() == [1, 2]


def test_times_of_day_go_on_over_midnight(tmp_path: Path) -> None:
    seconds = [86390 + 10 * k for k in range(20_000)]  # over two midnights
    rows = "".join(f"{s // 3600 % 24:02d}:{s // 60 % 60:02d}:{s % 60:02d},{k}\n" for k, s in enumerate(seconds))
    (tmp_path / "run.csv").write_text(f"t,q\n{rows}")
    np.testing.assert_array_equal(read_table(tmp_path / "run.csv").columns["t"], np.arange(20_000) * 10.0)
    _, second, *_ = (block for block in read_blocks(tmp_path / "run.csv", 2800))
    np.testing.assert_array_equal(second.columns["t"], np.arange(2800, 5600) * 10.0)


@pytest.mark.parametrize("suffix", [".csv.gz", ".TXT.GZ", ".dat.gz"])
def test_a_packed_text_is_read(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_bytes(gzip.compress(b"t;q\n0;1,5\n"))
    assert_same(read_table(path), {"t": [0], "q": [1.5]})
    assert next(read_blocks(path, 5)).rows == 1
    path.write_bytes(gzip.compress(b"t;q\n" + b"0;1\n" * 9000)[:-20])
    with pytest.raises(RecordError):
        read_table(path)


def test_what_is_ambiguous_is_refused_and_settled_by_an_option(read: Read) -> None:
    with pytest.raises(RecordError):
        read("1,5\n2,5\n")
    assert_same(read("1,5\n2,5\n", decimal=","), {"1": [1.5, 2.5]})
    assert_same(read("1,5\n2,5\n", delimiter=","), {"1": [1, 2], "2": [5, 5]})


def test_options_override_what_would_be_found(read: Read) -> None:
    assert_same(read("a:b\n1:2\n", delimiter=":"), {"a": [1], "b": [2]})
    assert_same(read("t,q\n1,2\n", header=False), {"1": [1], "2": [2]})
    assert_same(read("t,7\n1,2\n", header=True), {"t": [1], "7": [2]})


REFUSED: dict[str, tuple[str | bytes, int | None]] = {
    "text in a cell": ("t,q\n0,1\n1,abc\n2,3\n", 3),
    "a number among lists": ("t,q\n0,[1.0]\n1,[2.0]\n2,345\n3,[4.0]\n", 4),
    "text among long numbers": ("t,q\n0.001,10.25\n0.002,11.25\n0.003,x5.5y\n0.004,12.25\n", 4),
    "text in the first row": ("t,q\n0,abc\n1,2\n", None),
    "underscore": ("q\n1\n1_0\n", 3),
    "thousands separators": ("a;b\n1.000,5;2.000,5\n", None),
    "a whole thousands separator": ("a;b\n1,5;2\n1,6;2\n1.000;2\n", 4),
    "cut off": ("t,q,x\n0,1,2\n1,2,3\n2,3\n", 4),
    "a short row": ("t,q\n0,1\n1\n2,3\n", 3),
    "a long row": ("t,q\n0,1\n1,2,3\n2,3\n", 3),
    "a closing remark": ("t,q\n0,1\n1,2\nend of file\n", 4),
    "decimal and delimiting comma": ("t,q\n0,1,5,2\n1,1,5,3\n", None),
    "too few names": ("t;q\n0;1;2\n", None),
    "names only": ("t,q\n", None),
    "prose": ("Dear reader,\nno numbers here.\n", None),
    "comments only": ("# t,q\n# 1,2\n", None),
    "bytes": (b"\x00\x01\x02\x03", None),
    "nothing": ("", None),
    "an endless quoted cell": ('"' + "x" * 200_000, None),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_read_is_one_sentence_with_the_line_at_fault(name: str, read: Read) -> None:
    content, line = REFUSED[name]
    with pytest.raises(RecordError, match="run.csv" if line is None else f"line {line} ") as error:
        read(content)
    (said,) = error.value.faults
    assert said.startswith("run.csv") and "\n" not in said


@pytest.mark.parametrize(
    "options",
    [{"delimiter": ";;"}, {"delimiter": "e"}, {"delimiter": 5}, {"decimal": ";"}, {"header": "yes"}, {"skip": 3},
     {"header": True}],
)  # fmt: skip
def test_an_option_that_cannot_be_is_refused(options: dict[str, object], read: Read) -> None:
    with pytest.raises(RecordError):
        read("0;1\n", **options)


@given(table=tables())
@example(table=Table({";": np.zeros(1)}))
def test_what_is_written_is_read_to_the_last_bit(table: Table, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "round-trip.csv"
    try:
        write_table(path, table)
    except RecordError:  # a name that would not be read back, or that a spreadsheet takes for a formula
        return
    again = read_table(path)
    assert list(again.columns) == list(table.columns)
    for name, values in table.columns.items():
        np.testing.assert_array_equal(again.columns[name], values)
        numbers = ~np.isnan(values)  # the sign of a NaN means nothing
        assert again.columns[name][numbers].tobytes() == values[numbers].tobytes()


MARKS = [p for p in itertools.product(";\t|, ", ".,") if p != (",", ",")]


@given(
    table=tables(st.from_regex(r"[a-hj-m][a-z]{0,4}", fullmatch=True)),
    marks=st.sampled_from(MARKS),
    header=st.booleans(),
    newline=st.sampled_from(["\n", "\r\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    preamble=st.sampled_from(["", "Export\n", "# made by a drive\n\n"]),
)
def test_every_dialect_is_found(
    table: Table, marks: tuple[str, str], header: bool, newline: str, encoding: str, preamble: str, read: Read
) -> None:
    delimiter, decimal = marks
    rows = zip(*(values.tolist() for values in table.columns.values()), strict=True)
    lines = [delimiter.join(table.columns)] if header or (preamble and len(table.columns) == 1) else []
    lines += [delimiter.join(repr(cell).replace(".", decimal) for cell in row) for row in rows]
    text = preamble + "\n".join(lines) + "\n"
    try:
        again = read(text.replace("\n", newline).encode(encoding))
    except RecordError:  # a single column of "1,5" without a name
        assert len(table.columns) == 1 and decimal == ","
        again = read(text.encode(encoding), decimal=",")
    if len(lines) > len(next(iter(table.columns.values()))):
        assert list(again.columns) == list(table.columns)
    for read_values, values in zip(again.columns.values(), table.columns.values(), strict=True):
        np.testing.assert_array_equal(read_values, values)


@pytest.mark.parametrize(
    ("cells", "columns"),
    [
        (("[1, 2]", "[3]", "[4, 5]"), ["t", "x"]),
        (("2024-01-01 00:00:00", "00:00:01", "00:00:02"), ["t", "x"]),
        (("[1, 2]", "[3, 4]", "[4, 5]"), ["t", "c[0]", "c[1]", "x"]),
    ],
)
def test_an_unreadable_column_is_passed_over(cells: tuple[str, ...], columns: list[str], tmp_path: Path) -> None:
    rows = "".join(f'{k},"{cell}",{2 * k}\n' for k, cell in enumerate(cells))
    (tmp_path / "run.csv").write_text(f"t,c,x\n{rows}", encoding="utf-8")
    assert list(read_table(tmp_path / "run.csv").columns) == columns


START = 132959733843760000  # a FILETIME: 2 May 2022
MOTION = np.arange(40.0)
Group = tuple[float, dict[str, np.ndarray]]


def scope_text(
    groups: list[Group],
    mark: str = "\t",
    point: str = ",",
    *,
    said: dict[str, str] | None = None,
    filetime: bool = False,
) -> str:
    """Write groups of channels, each with its sample time in ms and its own time column, as the scope does.

    `said` has what the head says of a channel beside the usual, by the channel's name and the key.
    """

    def cell(value: float) -> str:
        return f"{value:.12g}".replace(".", point)

    head: list[list[str]] = [[] for _ in range(9)]
    columns: list[list[str]] = []
    for period, channels in groups:
        usual = {
            "Name": "", "SymbolComment": "", "Data-Type": "REAL64", "SampleTime[ms]": f"{period:g}".replace(".", ","),
            "SymbolName": "", "Offset": "0", "ScaleFactor": "1", "Unit": "(None)", "Unit ScaleFactor": "1",
        }  # fmt: skip
        for row, (key, value) in zip(head, usual.items(), strict=True):
            told = (said or {}) | {f"{name} Name": name for name in channels}
            row += [key, *(told.get(f"{name} {key}", value) for name in channels)]
        stamps = np.arange(len(next(iter(channels.values())))) * period
        columns.append([str(START + round(stamp * 10_000)) if filetime else cell(stamp) for stamp in stamps])
        columns += [list(map(cell, values)) for values in channels.values()]
    rows = (mark.join(row).rstrip(f" {mark}") for row in itertools.zip_longest(*columns, fillvalue=" "))
    date = f"{mark}Montag, 2. Mai 2022{mark}15:56:24.376"
    preamble = [f"Name{mark}axis", f"File{mark}C:\\axis.csv", f"Starttime of export{mark}{START}{date}", "", ""]
    return "\r\n".join([*preamble, *map(mark.join, head), "", *rows, "EOF\r\n"])


ONE_CLOCK: list[Group] = [(1.0, {"ActPos": MOTION / 3}), (1.0, {"SetPos": MOTION, "Torque": -MOTION})]
TWO_CLOCKS: list[Group] = [
    (2.0, {"Slow": MOTION[:20]}),
    (1.0, {"ActPos": MOTION / 3}),
    (0.5, {"Fast": np.arange(80.0)}),
]


@pytest.mark.parametrize(("mark", "point"), [("\t", ","), ("\t", "."), (";", ","), (";", "."), (",", ".")])
def test_channels_of_one_sample_time_share_their_clock(read: Callable[..., Table], mark: str, point: str) -> None:
    table = read(scope_text(ONE_CLOCK, mark, point))
    assert list(table.columns) == ["time [ms]", "ActPos", "SetPos", "Torque"]
    assert not table.clocks
    np.testing.assert_allclose(table.columns["time [ms]"], MOTION)
    np.testing.assert_allclose(table.columns["ActPos"], MOTION / 3, rtol=1e-11)
    np.testing.assert_array_equal(table.columns["Torque"], -MOTION)


@pytest.mark.parametrize("filetime", [False, True])
def test_groups_end_where_they_end_and_keep_their_clocks(read: Callable[..., Table], filetime: bool) -> None:
    """A FILETIME of 18 digits does not fit a float: 0.5 ms must come out exactly."""
    table = read(scope_text(TWO_CLOCKS, filetime=filetime))
    assert table.clocks == {"Slow": "time of Slow [ms]", "ActPos": "time of ActPos [ms]", "Fast": "time of Fast [ms]"}
    for name, size, period in (("Slow", 20, 2.0), ("ActPos", 40, 1.0), ("Fast", 80, 0.5)):
        np.testing.assert_array_equal(table.columns[table.clocks[name]], np.arange(size) * period)
        assert table.columns[name].size == size


def test_the_unit_is_used_and_the_offset_is_not_added(read: Callable[..., Table]) -> None:
    said = {
        "ActPos Unit": "mm (Length)", "ActPos Offset": "5", "SetPos Unit": "° (Angle)", "Torque Unit": "dV (Voltage)",
        "Torque Unit ScaleFactor": "-10",
    }  # fmt: skip
    table = read(scope_text(ONE_CLOCK, said=said))
    assert list(table.columns)[1:] == ["ActPos [mm]", "SetPos [deg]", "Torque [dV, drawn times -10]"]
    np.testing.assert_allclose(table.columns["ActPos [mm]"], MOTION / 3, rtol=1e-11)


def test_rows_that_were_filled_with_the_ones_before_are_left_out(read: Callable[..., Table]) -> None:
    text = scope_text([(1.0, {"Fast": MOTION}), (2.0, {"Slow": np.arange(20.0)})], point=".")
    filled = [f"{k}\t{k}\t{k // 2 * 2}\t{k // 2}" for k in range(40)]
    table = read(text[: text.index("0\t0\t0\t0")] + "\r\n".join(filled))
    np.testing.assert_array_equal(table.columns["Slow"], np.arange(20.0))
    np.testing.assert_array_equal(table.columns["time of Slow [ms]"], np.arange(20) * 2.0)
