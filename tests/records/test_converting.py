"""From one format to another: every number to the last bit, what has no place told, and one answer from all of them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from jointid.apps.cli import main
from jointid.common.errors import RecordError
from jointid.config import load
from jointid.records.formats import Table, read_table, write_table
from jointid.records.writing import convert
from tests.records.logged import LOGGED

ROOT = Path(__file__).resolve().parents[2]
TARGETS = [".h5", ".parquet", ".tdms", ".mcap", ".db3", ".csv", ".npy", ".mat", ".npz", ".json"]


@pytest.mark.parametrize("name", LOGGED)
@pytest.mark.parametrize("suffix", TARGETS)
def test_every_format_becomes_every_other(name: str, suffix: str, tmp_path: Path) -> None:
    (tmp_path / "from").mkdir()
    source, target = tmp_path / "from" / f"run{LOGGED[name].suffix}", tmp_path / f"run{suffix}"
    LOGGED[name].write(source)
    conversion = convert(source, target)
    before, after = read_table(source), read_table(target)
    assert conversion.columns.keys() == before.columns.keys()
    for old, new in conversion.columns.items():
        values, again = before.columns[old], after.columns[new]
        rounding = 1e-14 if old.endswith("/time") and suffix in (".mcap", ".db3") else 0
        np.testing.assert_allclose(again[: values.size], values, rtol=rounding, atol=0)
        assert np.isnan(again[values.size :]).all()
    notes = " ".join(conversion.notes)
    assert ("no place for single numbers" in notes) == bool(before.scalars and not after.scalars)
    assert ("no place for units" in notes) == bool(
        set(before.units) and suffix in (".csv", ".npy", ".mat", ".mcap", ".db3", ".npz", ".json")
    )
    assert ("whose time" in notes) == bool(before.clocks and suffix not in (".mcap", ".db3"))
    assert ("Renamed" in notes) == any(old != new for old, new in conversion.columns.items())


def test_names_that_fall_together_are_kept_apart(tmp_path: Path) -> None:
    source = tmp_path / "run.npy"
    write_table(source, Table({"a b": np.array([1.0, 2]), "a.b": np.array([3.0, 4]), "a_b": np.array([5.0, 6])}))
    conversion = convert(source, tmp_path / "run.mat")
    assert conversion.columns == {"a b": "a_b_2", "a.b": "a_b_3", "a_b": "a_b"}
    assert str(conversion) == (
        "run.npy (NPY) -> run.mat (MAT): 3 columns.\n"
        'Renamed for MAT: "a b" is "a_b_2".\nRenamed for MAT: "a.b" is "a_b_3".'
    )
    np.testing.assert_array_equal(read_table(tmp_path / "run.mat").columns["a_b_3"], [3, 4])


def test_long_names_that_are_cut_to_one_are_kept_apart(tmp_path: Path) -> None:
    source, target = tmp_path / "run.csv", tmp_path / "run.mat"
    names = [f"{'x' * 70}{i}" for i in range(12)]
    write_table(source, Table({name: np.array([i, 2.0]) for i, name in enumerate(names)}))
    made = convert(source, target).columns
    assert len(set(made.values())) == 12
    assert made[names[11]] == f"{'x' * 60}_12"
    assert all(read_table(target).columns[made[name]][0] == i for i, name in enumerate(names))


def test_only_the_columns_that_are_asked_for_are_taken(tmp_path: Path) -> None:
    source = tmp_path / "run.h5"
    LOGGED["hdf5"].write(source)
    conversion = convert(source, tmp_path / "run.csv", ["axis/tau", "t"])
    assert list(read_table(tmp_path / "run.csv").columns) == ["axis/tau", "t"]
    assert "axis/tau in N·m" in str(conversion) and "kp = 2.5" in str(conversion)
    with pytest.raises(RecordError, match=r'run\.h5 has no column "x"; it has "'):
        convert(source, tmp_path / "run.csv", ["x"])


def test_the_source_is_never_written_over(tmp_path: Path) -> None:
    source = tmp_path / "run.csv"
    LOGGED["csv"].write(source)
    before = source.read_bytes()
    (tmp_path / "same.csv").symlink_to(source)
    for target in (source, tmp_path / "same.csv", tmp_path / ".." / tmp_path.name / "run.csv"):
        with pytest.raises(RecordError, match="is the file that is read, and is not written over"):
            convert(source, target)
    assert source.read_bytes() == before


@pytest.mark.slow
def test_emps_is_the_same_record_in_every_format(emps_path: Path, tmp_path: Path) -> None:
    file = load(ROOT / "examples" / "emps" / "joint.toml")

    def fingerprint(path: Path) -> list[str]:
        record = file.record(path)
        return [hashlib.sha256(channel.values.tobytes()).hexdigest() for _, channel in record.items()]

    wanted = fingerprint(emps_path)
    for suffix in TARGETS:
        target = tmp_path / f"emps{suffix}"
        convert(emps_path, target)
        assert fingerprint(target) == wanted, suffix
    convert(emps_path, tmp_path / "emps73.mat", writing={"version": "7.3"})
    assert fingerprint(tmp_path / "emps73.mat") == wanted


def test_the_commands_print_what_the_verbs_return(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, target = tmp_path / "run.h5", tmp_path / "run.mat"
    LOGGED["hdf5"].write(source)
    for words, code in (
        (["data", "inspect", source, "--json", tmp_path / "run.json", "--figure", tmp_path / "run.svg"], 0),
        (["data", "convert", source, target, "--columns", "t", "--columns", "axis/q", "--mat-version", "7.3"], 0),
        (["data", "convert", source, source], 2),
        (["data", "inspect", tmp_path / "none.h5"], 2),
        (["data", "inspect", source, "--decimal", ","], 2),
    ):
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        assert end.value.code == code
    said = capsys.readouterr()
    assert "axis/q" in said.out and "2 columns" in said.out and 'Renamed for MAT: "axis/q" is "axis_q".' in said.out
    assert said.err.count("jointid: ") == 3 and "Traceback" not in said.err
    assert target.read_bytes()[512:516] == b"\x89HDF"
    assert (tmp_path / "run.json").stat().st_size > 300 and (tmp_path / "run.svg").stat().st_size > 3000
