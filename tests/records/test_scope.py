"""TwinCAT Scope's export, written here as that program writes it.

The layout is that of exports that TwinCAT 3 Scope View made (tabs or semicolons, a header of 17 rows, a blank in each
cell that is missing); no such file is among the real records.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import RecordError
from jointid.records.formats import Table, read_table

START = 132959733843760000  # a FILETIME: 2 May 2022
HEADER = (
    "SymbolComment",
    "Data-Type",
    "SampleTime[ms]",
    "SymbolName",
    "Offset",
    "ScaleFactor",
    "Unit",
    "Unit ScaleFactor",
)
MOTION = np.arange(40.0)

Group = tuple[float, dict[str, np.ndarray]]


def scope_text(
    groups: list[Group],
    mark: str = "\t",
    point: str = ",",
    *,
    said: dict[str, dict[str, str]] | None = None,
    filetime: bool = False,
    end: str = "EOF\r\n",
) -> str:
    """Write groups of channels, each with its sample time in ms and its own time column, as the scope does."""
    said = said or {}
    defaults = {"Data-Type": "REAL64", "Offset": "0", "ScaleFactor": "1", "Unit": "(None)", "Unit ScaleFactor": "1"}

    def row(key: str) -> str:
        cells: list[str] = []
        for period, channels in groups:
            usual = {"Name": None, "SampleTime[ms]": f"{period:g}".replace(".", ","), **defaults}
            cells += [key, *(said.get(name, {}).get(key) or usual.get(key, "") or (name if key == "Name" else "")
                             for name in channels)]  # fmt: skip
        return mark.join(cells)

    def cell(value: float) -> str:
        return f"{value:.12g}".replace(".", point)

    preamble = [
        f"Name{mark}axis",
        f"File{mark}C:\\axis.csv",
        f"Starttime of export{mark}{START}{mark}Montag, 2. Mai 2022{mark}15:56:24.376",
        f"Endtime of export{mark}{START + 10**7}{mark}Montag, 2. Mai 2022{mark}15:56:25.376",
        "", "",
    ]  # fmt: skip
    rows = []
    for k in range(max(next(iter(channels.values())).size for _, channels in groups)):
        cells: list[str] = []
        for period, channels in groups:
            there = k < next(iter(channels.values())).size
            stamp = str(START + round(k * period * 10_000)) if filetime else cell(k * period)
            cells += [stamp if there else " ", *(cell(v[k]) if there else " " for v in channels.values())]
        rows.append(mark.join(cells).rstrip(f" {mark}"))
    return "\r\n".join([*preamble, row("Name"), *map(row, HEADER), "", *rows, end])


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., Table]:
    def read_text(text: str, **options: object) -> Table:
        path = tmp_path / "axis.csv"
        path.write_text(text, encoding="utf-8", newline="")
        return read_table(path, **options)

    return read_text


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


def test_each_channel_becomes_one_of_its_own_rate(tmp_path: Path) -> None:
    path = tmp_path / "axis.csv"
    path.write_text(scope_text(TWO_CLOCKS), encoding="utf-8")
    record = ji.read(path, {"torque": "Slow", "motor_position": ji.Column("ActPos", unit="mm")}, kind="prismatic")
    assert record.torque is not None
    assert record.motor_position is not None
    assert (record.torque.sample_time, record.motor_position.sample_time) == (2e-3, 1e-3)
    np.testing.assert_allclose(record.motor_position.values, MOTION / 3e3, rtol=1e-11)


def test_the_unit_is_used_and_the_offset_is_not_added(read: Callable[..., Table]) -> None:
    said = {
        "ActPos": {"Unit": "mm (Length)", "Offset": "5"},
        "SetPos": {"Unit": "° (Angle)"},
        "Torque": {"Unit": "dV (Voltage)", "Unit ScaleFactor": "-10"},
    }
    table = read(scope_text(ONE_CLOCK, said=said))
    assert list(table.columns)[1:] == ["ActPos [mm]", "SetPos [deg]", "Torque [dV, drawn times -10]"]
    np.testing.assert_allclose(table.columns["ActPos [mm]"], MOTION / 3, rtol=1e-11)


def test_what_is_scaled_for_drawing_must_be_told_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "axis.csv"
    path.write_text(scope_text(ONE_CLOCK, said={"Torque": {"ScaleFactor": "2"}}), encoding="utf-8")
    name = "Torque [no unit, drawn times 2]"
    with pytest.raises(RecordError, match='is in "no unit, drawn times 2"; expected one of N,'):
        ji.read(path, {"torque": name}, kind="prismatic")
    assert ji.read(path, {"torque": ji.Column(name, unit="N")}, kind="prismatic").torque is not None


def test_rows_that_were_filled_with_the_ones_before_are_left_out(read: Callable[..., Table]) -> None:
    text = scope_text([(1.0, {"Fast": MOTION}), (2.0, {"Slow": np.arange(20.0)})], point=".")
    head, rows = text.split("\r\n\r\n", 2)[0], text.split("\r\n\r\n", 2)[2]
    middle = text.split("\r\n\r\n", 2)[1]
    filled = [f"{k}\t{k}\t{k // 2 * 2}\t{k // 2}" for k in range(40)]
    assert rows.startswith("0\t0\t0\t0")
    table = read("\r\n\r\n".join([head, middle, "\r\n".join(filled)]))
    np.testing.assert_array_equal(table.columns["Slow"], np.arange(20.0))
    np.testing.assert_array_equal(table.columns["time of Slow [ms]"], np.arange(20) * 2.0)
