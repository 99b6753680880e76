"""The table of a fleet: rows of joints, settings of their own, and faults named by row."""

import shutil
from pathlib import Path

import pytest

from jointid.campaigns.campaign import Case, load_campaign
from jointid.campaigns.run import Outcome, run_case
from jointid.common.errors import JointFileError
from tests.rigid_axis import JOINT

FLEET = '[fleet]\ntable = "line/fleet.csv"\njoint = "joint.toml"\nrecords = "logs/{joint}/{day}.npy"\n'


def listed(place: Path, table: str, campaign: str = FLEET) -> list[Case]:
    (place / "line").mkdir(exist_ok=True)
    (place / "line" / "fleet.csv").write_text(table, encoding="utf-8")
    (place / "campaign.toml").write_text(campaign)
    return list(load_campaign(place / "campaign.toml").cases)


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


def test_a_record_that_has_appeared_is_found_and_a_joint_without_one_is_named(place: Path) -> None:
    before = listed(place, "name\na\nc\n")
    campaign = load_campaign(place / "campaign.toml")
    assert len(campaign.cases) == 2
    assert campaign.left_out == "1 joint of the table have no record yet: c."
    (place / "logs" / "c").mkdir()
    shutil.copy(place / "run.npy", place / "logs" / "c" / "2026-11-03.npy")
    after = list(load_campaign(place / "campaign.toml").cases)
    assert [case.joint for case in after] == ["a", "a", "c"]
    assert hashes(before) < hashes(after)


def test_a_case_is_known_by_what_it_is_and_not_by_where_its_row_stands(place: Path) -> None:
    one = hashes(listed(place, "name,filtering.cutoff,method.tolerance\na,40,1e-6\nb,30,\n"))
    other = hashes(listed(place, "method.tolerance,name,#x,filtering.cutoff\n,b,,30\n\n1e-6,a,,40\n"))
    assert one == other
    assert not one & hashes(listed(place, "name,filtering.cutoff,method.tolerance\na,41,1e-6\nb,31,\n"))


@pytest.mark.parametrize(
    "table",
    [
        "name,method.tolernce\na,3\n", "name;filtering.cutoff\na;40\n;30\n", "name\na\na\n", "name\na,b\n",
        "name,name\na,a\n", "name,my hall\na,a\n", "axis\na\n", "name\n", "", 'name\n"a\nb\n', "name\nc\nd\n",
    ],
)  # fmt: skip
def test_a_faulty_table_is_refused(place: Path, table: str) -> None:
    with pytest.raises(JointFileError):
        listed(place, table)


def test_one_number_out_of_its_bounds_among_many_is_a_refused_case(place: Path) -> None:
    assert run_case(listed(place, "name,filtering.cutoff\na,40\nb,-1\n")[-1]).outcome is Outcome.REFUSED


def test_a_joint_has_a_file_of_its_own(place: Path) -> None:
    (place / "b.toml").write_text(JOINT + "[filtering]\ncutoff = 40.0\n")
    own = FLEET.replace("joint.toml", "{joint}.toml")
    assert all("[filtering]" in case.joint_file for case in listed(place, "name\nb\n", own))
    with pytest.raises(JointFileError):
        listed(place, "name\na\nb\n", own)


def test_a_fleet_is_swept(place: Path) -> None:
    found = listed(place, "name,filtering.cutoff\na,40\n", FLEET + '[sweep]\n"method.tolerance" = [1e-6, 1e-7]\n')
    assert len(hashes(found)) == 4
