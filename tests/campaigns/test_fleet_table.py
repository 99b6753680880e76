"""The table of a fleet: rows of joints or of records, settings of their own, and faults named by row."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from jointid.campaigns.campaign import Case, load_campaign
from jointid.campaigns.run import run_case
from jointid.campaigns.store import Outcome
from jointid.common.errors import JointFileError
from tests.campaigns.conftest import JOINT

FLEET = '[fleet]\ntable = "line/fleet.csv"\n'
ALL = FLEET + 'joint = "joint.toml"\nrecords = "logs/{joint}/{day}.npy"\n'


def listed(place: Path, table: str, campaign: str = ALL) -> list[Case]:
    (place / "line").mkdir(exist_ok=True)
    (place / "line" / "fleet.csv").write_text(table, encoding="utf-8")
    (place / "campaign.toml").write_text(campaign)
    return list(load_campaign(place / "campaign.toml").cases())


def hashes(cases: list[Case]) -> set[str]:
    return {case.content_hash for case in cases}


def test_a_row_is_a_joint_whose_settings_are_its_own(place: Path) -> None:
    found = listed(place, "name,filtering.cutoff,joint.friction,#hall\nb,,,north\na,40.0,asymmetric,=1+1\n")
    assert [(case.joint, case.day) for case in found] == [
        ("b", "2026-11-01"), ("b", "2026-11-02"), ("a", "2026-11-01"), ("a", "2026-11-02"),
    ]  # fmt: skip
    assert [case.settings for case in found[1:3]] == [(), ("filtering.cutoff=40.0", "joint.friction=asymmetric")]
    assert {case.joint_file for case in found} == {JOINT}
    plain, own = run_case(found[0]), run_case(found[2])
    assert {plain.outcome, own.outcome} == {Outcome.IDENTIFIED}
    assert "coulomb" in plain.found and "coulomb" not in own.found, "the law of friction is the row's"


def test_paths_are_taken_from_the_folder_of_the_table_and_a_cell_comes_before_what_is_said_for_all(place: Path) -> None:
    (place / "line").mkdir()
    (place / "line" / "own.toml").write_text(JOINT + "[filtering]\ncutoff = 40.0\n")
    table = 'name;joint;records\na;own.toml;../logs/{joint}/{day}.npy\n"b, the other";../joint.toml;../logs/b/*.npy\n'
    found = listed(place, table, FLEET)
    assert [case.joint for case in found] == ["a", "a", "b, the other", "b, the other"]
    assert [("[filtering]" in case.joint_file) for case in found] == [True, True, False, False]
    assert hashes(found[:2]) == hashes(listed(place, "name,joint,records\na,own.toml,\nb,,\n")[:2])


def test_a_row_is_a_record_with_its_day(place: Path) -> None:
    found = listed(place, "name,record,day\na,../run.npy,2026-11-05\na,../logs/a/2026-11-01.npy,\na,later.npy,\n")
    assert [case.day for case in found][0::2] == ["2026-11-05", ""]
    late = run_case(found[2])
    assert (late.outcome, late.joint) == (Outcome.REFUSED, "a")
    assert "later.npy cannot be opened (no such file" in late.sentence
    shutil.copy(place / "run.npy", place / "line" / "later.npy")
    after = list(load_campaign(place / "campaign.toml").cases())
    assert [a.content_hash == b.content_hash for a, b in zip(found, after, strict=True)] == [True, True, False]


def test_a_record_that_has_appeared_is_found_and_a_joint_without_one_is_named(place: Path) -> None:
    before = listed(place, "name\na\nc\n")
    campaign = load_campaign(place / "campaign.toml")
    assert len(list(campaign.cases())) == 2
    assert campaign.left_out == "1 joint of the table have no record yet: c."
    (place / "logs" / "c").mkdir()
    shutil.copy(place / "run.npy", place / "logs" / "c" / "2026-11-03.npy")
    after = list(load_campaign(place / "campaign.toml").cases())
    assert [case.joint for case in after] == ["a", "a", "c"]
    assert hashes(before) < hashes(after)


def test_a_case_is_known_by_what_it_is_and_not_by_where_its_row_stands(place: Path) -> None:
    one = hashes(listed(place, "name,filtering.cutoff,method.tolerance\na,40,1e-6\nb,30,\n"))
    other = hashes(listed(place, "method.tolerance,name,#x,filtering.cutoff\n,b,,30\n\n1e-6,a,,40\n"))
    assert one == other
    assert not one & hashes(listed(place, "name,filtering.cutoff,method.tolerance\na,41,1e-6\nb,31,\n"))


def test_parquet_says_what_csv_does(place: Path) -> None:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    csv = listed(place, "name,filtering.cutoff,joint.friction\na,40,\nb,,asymmetric\n")
    columns = {"name": ["a", "b"], "filtering.cutoff": [40.0, None], "joint.friction": ["", "asymmetric"]}
    parquet.write_table(pyarrow.table(columns), place / "line" / "fleet.parquet")
    assert hashes(listed(place, "", ALL.replace(".csv", ".parquet"))) == hashes(csv)
    parquet.write_table(pyarrow.table(columns | {"name": [["a"], ["b"]]}), place / "line" / "fleet.parquet")
    with pytest.raises(JointFileError):
        load_campaign(place / "campaign.toml")
    (place / "line" / "fleet.parquet").write_bytes(b"PAR1 or not")
    with pytest.raises(JointFileError):
        load_campaign(place / "campaign.toml")


@pytest.mark.parametrize(
    ("table", "rows"),
    [
        ("name,filtering.cutoff,method.tolernce\na,=1+1,\nb,30,3\n", ["row 2", "row 3"]),
        ("name,joint,records\na,no.toml,\n,../joint.toml,\nb,,x/{axis}.npy\n", ["row 2", "row 3", "fleet.records"]),
        ("name,record,records,day\na,x,y,\nb,,,2026-11-01\nc,x,,today\n", ["row 2", "row 3", "row 4"]),
        ("name\na\na\n", ["row 3"]),
        ("name\na,b\n", ["row 2"]),
        ("name,name\na,a\n", ["columns name"]),
        ("name,my hall\na,a\n", ['"my hall"']),
        ("axis\na\n", ["axis"]),
        ("name\n", ["fleet.csv"]),
        ("", ["fleet.csv"]),
        ('name\n"a\nb\n', ["fleet.csv"]),
        ("name\nc\nd\n", ["fleet.csv"]),
    ],
)
def test_faults_are_told_all_at_once_with_their_rows(place: Path, table: str, rows: list[str]) -> None:
    with pytest.raises(JointFileError) as caught:
        listed(place, table)
    assert len(caught.value.faults) == len(rows)
    assert all(where in said for said, where in zip(caught.value.faults, rows, strict=True))


def test_one_number_out_of_its_bounds_among_many_is_a_refused_case(place: Path) -> None:
    found = listed(place, "name,record,filtering.cutoff\na,../run.npy,40\nb,../run.npy,-1\n")
    assert run_case(found[1]).outcome is Outcome.REFUSED


def test_what_is_too_large_is_not_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jointid.campaigns.campaign._MOST_CELLS", 10)
    with pytest.raises(JointFileError, match="cells"):
        listed(place, "name\n" + "a\n" * 30)
    monkeypatch.setattr("jointid.campaigns.campaign._LARGEST", 10)
    with pytest.raises(JointFileError, match="11 bytes"):
        listed(place, "name\n" + "a\n" * 30)


def test_a_key_is_swept_or_in_the_table(place: Path) -> None:
    found = listed(place, "name,filtering.cutoff\na,40\n", ALL + '[sweep]\n"method.tolerance" = [1e-6, 1e-7]\n')
    assert len(hashes(found)) == 4
    with pytest.raises(JointFileError, match=r"filtering\.cutoff"):
        listed(place, "name,filtering.cutoff\na,40\n", ALL + '[sweep]\n"filtering.cutoff" = [30]\n')
