"""Cases, the campaign file that lists them, and the row that each becomes."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from jointid.campaigns.campaign_file import load_campaign
from jointid.campaigns.cases import Case, Found, Outcome, Row
from jointid.campaigns.folder import read_results
from jointid.campaigns.report import export_rows, table_of
from jointid.campaigns.run import run_case
from jointid.campaigns.shards import Shard, open_shard
from jointid.campaigns.store import open_database
from jointid.common.errors import JointFileError, MethodError, RecordError
from tests.campaigns.conftest import FLEET, JOINT


def campaign(place: Path, text: str) -> list[Case]:
    (place / "campaign.toml").write_text(text)
    return list(load_campaign(place / "campaign.toml").cases())


def test_the_same_case_has_the_same_hash_and_any_other_another() -> None:
    case = Case("a", "[joint]", "a.csv", "1 2")
    others = (
        replace(case, joint="b"), replace(case, joint_file=""), replace(case, record="b.csv"),
        replace(case, stamp="1 3"), replace(case, day="2026-11-23"), replace(case, changes=("x=1",)),
        replace(case, program="0"),
    )  # fmt: skip
    assert len({one.content_hash for one in (case, *others)}) == 1 + len(others)
    again = pickle.loads(pickle.dumps(case))
    assert again == case
    assert again.content_hash == case.content_hash
    assert len(case.content_hash) == 64


def test_a_fleet_has_a_case_for_each_record_with_its_joint_and_day(place: Path) -> None:
    found = campaign(place, FLEET)
    assert [(case.joint, case.day) for case in found] == [
        ("a", "2026-11-01"), ("a", "2026-11-02"), ("b", "2026-11-01"), ("b", "2026-11-02"),
    ]  # fmt: skip
    assert all(case.joint_file == JOINT for case in found)


def test_a_record_that_is_replaced_is_another_case(place: Path) -> None:
    before = campaign(place, FLEET)
    path = Path(before[0].record)
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**9))
    after = campaign(place, FLEET)
    assert [a.content_hash == b.content_hash for a, b in zip(before, after, strict=True)] == [False, True, True, True]


def test_a_sweep_is_every_combination(place: Path) -> None:
    found = campaign(place, FLEET + '[sweep]\n"filtering.cutoff" = [20.0, 40.0]\njoint.friction = ["symmetric"]\n')
    assert len(found) == 8
    assert {case.changes for case in found} == {
        (f"filtering.cutoff={cutoff}", 'joint.friction="symmetric"') for cutoff in (20.0, 40.0)
    }
    assert {run_case(case).outcome for case in found[::4]} == {Outcome.IDENTIFIED}


@pytest.mark.parametrize(
    ("text", "refusal", "code"),
    [
        ("", JointFileError, "missing"),
        (FLEET + '[monte_carlo]\njoint = "joint.toml"\nruns = 1\n', JointFileError, "unknown"),
        ("[fleet]\n", JointFileError, "contradiction"),
        ('[fleet]\njoint = "joint.toml"\nrecords = "logs/{axis}/*.npy"\n', JointFileError, "contradiction"),
        ('[fleet]\njoint = "joint.toml"\nrecords = "none/*.npy"\n', JointFileError, None),
        ('[fleet]\njoint = "no.toml"\nrecords = "logs/{joint}/*.npy"\n', JointFileError, None),
        (FLEET + '[sweep]\n"filtering.cutof" = [1.0]\n', JointFileError, "unknown"),
        (FLEET + "[sweep]\ncutoff = []\n", JointFileError, "contradiction"),
        ("name = \n", JointFileError, None),
    ],
)
def test_a_faulty_campaign_file_is_refused(place: Path, text: str, refusal: type, code: str | None) -> None:
    with pytest.raises(refusal) as caught:
        campaign(place, text)
    assert code in (None, *(getattr(one, "code", None) for one in caught.value.faults))


def test_a_file_without_a_date_is_left_out_and_named(place: Path) -> None:
    (place / "logs" / "a" / "notes.npy").write_bytes(b"")
    (place / "campaign.toml").write_text(FLEET)
    found = load_campaign(place / "campaign.toml")
    assert len(list(found.cases())) == 4
    assert "notes.npy" in found.left_out


def test_a_spoiled_record_a_spoiled_joint_file_and_a_fault_of_ours_are_rows(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = campaign(place, FLEET)[0]
    Path(case.record).write_bytes(b"")
    row = run_case(case)
    assert (row.outcome, row.found) == (Outcome.REFUSED, {})
    assert row.sentence.endswith("is empty (0 bytes); log or copy it again.")
    assert run_case(replace(case, joint_file="[joint]")).sentence.startswith("joint.kind is missing")
    assert "was described by jointid 0.0.1" in run_case(replace(case, program="0.0.1")).sentence
    monkeypatch.setattr("jointid.campaigns.run.digest", lambda _: 1 / 0)
    row = run_case(case)
    assert row.outcome is Outcome.FAILED
    assert row.sentence == "jointid failed, which is a fault of ours (ZeroDivisionError: division by zero)."


def test_a_row_is_read_as_it_was_written(place: Path) -> None:
    row = run_case(campaign(place, FLEET)[0])
    assert Row.read(row.text()) == row
    for spoiled in ("", "{}", "[]", "null", row.text()[:-5], row.text().replace('"std":', '"std":"x","s":'),
                    row.text().replace('"identified"', '"found"')):  # fmt: skip
        with pytest.raises(ValueError, match=r"row|JSON|Expecting|delimiter|Outcome|Unterminated"):
            Row.read(spoiled)


def test_a_shard_has_each_case_once() -> None:
    hashes = [Case(str(n), "", "", "").content_hash for n in range(200)]
    parts = [[one for one in hashes if Shard(k, 4).has(one)] for k in (1, 2, 3, 4)]
    assert sorted(one for part in parts for one in part) == sorted(hashes)
    assert all(30 < len(part) < 70 for part in parts)
    for text in ("0/4", "5/4", "1", "a/b", "1/0", ""):
        with pytest.raises(MethodError, match=r"^--shard is .*; expected its number"):
            Shard.of(text)


def rows(count: int = 4) -> list[Row]:
    found = {"stiffness": Found(8e5, 3e3, "N/m"), "offset": Found(0.1 + 0.2, None, "N")}
    case = Case("=1+1", "", "a,b.csv", "")
    return [
        Row.of(replace(case, day=f"2026-11-{n + 1:02}"), Outcome.IDENTIFIED, 'says "yes"', found=found)
        for n in range(count)
    ]


def test_a_table_is_written_as_csv_and_parquet(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    export_rows(rows(), tmp_path / "a.csv")
    export_rows(rows(), tmp_path / "a.parquet")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert len(lines) == 5
    assert ",800000.0,3000.0," in lines[1]
    assert "0.30000000000000004" in lines[1]
    assert '"says ""yes"""' in lines[1]
    table = parquet.read_table(tmp_path / "a.parquet").to_pydict()
    assert table == table_of(rows())
    assert {"joint", "stiffness [N/m]", "stiffness std [N/m]", "case sha256", "joint file sha256"} <= set(table)
    with pytest.raises(RecordError, match=r"a.xlsx ends in no known format; expected .csv or .parquet"):
        export_rows(rows(), tmp_path / "a.xlsx")


def test_a_record_that_is_gone_or_has_an_odd_name_fails_its_own_case_alone(place: Path) -> None:
    (place / "logs" / "a" / "2026-11-03.npy").symlink_to(place / "gone.npy")
    odd = os.fsdecode(b"logs/\xe4/2026-11-01.npy")
    (place / odd).parent.mkdir()
    (place / "logs/a/2026-11-01.npy").rename(place / odd)
    found = campaign(place, FLEET)
    rows = [run_case(case) for case in found]
    assert sorted(row.outcome for row in rows) == [Outcome.IDENTIFIED] * 4 + [Outcome.REFUSED]
    with open_database(place) as database:
        database.add(rows)
    assert {row.record for row in read_results(place).rows} == set()  # none is listed yet
    assert Row.read(rows[-1].text()) == rows[-1]


@pytest.mark.parametrize(
    "records",
    ["./logs/{joint}/{day}.npy", "logs//{joint}/{day}.npy", "logs/{joint}/{day}*.npy", "x/../logs/{joint}/{day}.*"],
)
def test_another_spelling_of_a_pattern_means_the_same(place: Path, records: str) -> None:
    (place / "x").mkdir()
    same = [case.content_hash for case in campaign(place, FLEET)]
    found = campaign(place, FLEET.replace("logs/{joint}/{day}.npy", records))
    assert [case.content_hash for case in found] == same
    there = load_campaign(place / "x" / ".." / "campaign.toml")
    assert [case.content_hash for case in there.cases()] == same


def test_no_cell_of_a_table_is_a_formula(tmp_path: Path) -> None:
    case = Case("=1+1", "[joint]", "@x.npy", "")
    export_rows([Row.of(case, Outcome.REFUSED, "+no")], tmp_path / "out.csv")
    cells = (tmp_path / "out.csv").read_text().splitlines()[1].split(",")
    assert cells[0] == "'=1+1" and cells[2] == "'@x.npy" and "'+no" in cells


def test_a_shard_belongs_to_one_process_and_knows_what_others_finished(tmp_path: Path) -> None:
    rows = [Row.of(Case(name, "", "", ""), Outcome.IDENTIFIED, "found") for name in "ab"]
    with open_shard(tmp_path, Shard(1, 2)) as first:
        first.add(rows[:1])
        program = (
            "from pathlib import Path; from jointid.campaigns.shards import *\n"
            f"with open_shard(Path({str(tmp_path)!r}), Shard(1, 2)): pass"
        )
        beside = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert "Another process is at work on" in beside.stderr
    with open_shard(tmp_path, Shard(1, 1)) as other:
        assert other.has_result(rows[0].content_hash)
        assert not other.has_result(rows[1].content_hash)
    with pytest.raises(RecordError, match="has the results of shards; name another folder"), open_database(tmp_path):
        pass
    (tmp_path / "database").mkdir()
    with open_database(tmp_path / "database"):
        pass
    assert read_results(tmp_path / "database").cases == 0
    with (
        pytest.raises(RecordError, match="has the results of campaign run; name another"),
        open_shard(tmp_path / "database", Shard(1, 1)),
    ):
        pass
