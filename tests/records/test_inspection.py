"""What is in a file: its outline, its clocks, and names that steer a terminal."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from jointid.output.json import dumps, to_dict
from jointid.records.formats import Table, write_table
from jointid.records.inspection import inspect
from tests.records.logged import LOGGED, ROWS


def test_thousands_of_columns_are_told_in_a_thousand_lines(tmp_path: Path) -> None:
    write_table(tmp_path / "wide.npy", Table({str(k): np.arange(3.0) for k in range(1, 2503)}))
    inspection = inspect(tmp_path / "wide.npy")
    assert len(inspection.channels) == len(to_dict(inspection)["channels"]) == 2502
    assert len(inspection.summary().splitlines()) < 1020


@pytest.mark.parametrize("name", LOGGED)
def test_every_format_is_inspected(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{LOGGED[name].suffix}"
    LOGGED[name].write(path)
    inspection = inspect(path)
    channels = {channel.name: channel for channel in inspection.channels}
    time, position, torque = (channels[column] for column in LOGGED[name].names)
    assert position.time == torque.time == time.name
    assert position.sample_time == pytest.approx(1e-3)
    assert position.rows == ROWS
    assert position.maximum == pytest.approx(1.0, abs=1e-4)
    text = str(inspection)
    assert "0.001 s" in text
    assert ("rad" in text) == (name in ("hdf5", "parquet", "tdms"))
    assert f'"{time.name}"' in dumps(to_dict(inspection))


def test_clocks_of_different_lengths_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    columns = {"a/time": np.arange(9) / 10, "a/q": np.ones(9), "b/time [ms]": np.arange(5.0), "b/q": np.ones(5),
               "c/time": np.array([0.0, 1.0, 0.5]), "c/q": np.ones(3)}  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file[name] = values
    inspection = inspect(path)
    found = {channel.name: (channel.time, channel.sample_time) for channel in inspection.channels}
    assert found["a/q"] == ("a/time", pytest.approx(0.1))
    assert found["b/q"] == ("b/time [ms]", pytest.approx(1e-3))
    assert found["c/q"] == (None, None)  # its clock runs back


@pytest.mark.parametrize("name", ["t", "time [s]", "Zeit [ms]"])
def test_a_column_called_time_is_the_clock_of_the_others(name: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(f"{name};torque\n0;1,5\n1;2,5\n2;0,5\n")
    time, torque = inspect(tmp_path / "run.csv").channels
    assert time.time == time.name
    assert torque.time == name


def test_hostile_names_are_shown_escaped(tmp_path: Path) -> None:
    path = tmp_path / "run.npy"
    hostile = "\x1b[2J\x07q\n\u202ex$^_{$"
    write_table(path, Table({hostile: np.arange(3.0), "<script>": np.ones(3)}))
    inspection = inspect(path)
    text = str(inspection)
    assert all(character.isprintable() or character == "\n" for character in text)
    assert "\\x1b[2J\\x07q\\n\\u202ex" in text


def test_a_channel_without_numbers_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,q\n0,\n1,\n2,\n", encoding="utf-8")
    inspection = inspect(path)
    assert inspection.channels[1].minimum is None
    assert '"minimum": null' in dumps(to_dict(inspection))
