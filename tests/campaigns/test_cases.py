"""Cases, the campaign file that lists them, and the row that each becomes."""

import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from jointid.campaigns.campaign import Case, load_campaign
from jointid.campaigns.run import Outcome, open_store, run_case
from jointid.common.errors import JointFileError
from tests.campaigns.conftest import FLEET
from tests.rigid_axis import JOINT, run


def campaign(place: Path, text: str) -> list[Case]:
    (place / "campaign.toml").write_text(text)
    return list(load_campaign(place / "campaign.toml").cases)


def test_the_same_case_has_the_same_hash_and_any_other_another() -> None:
    case = Case("a", "[joint]", "a.csv", "1 2")
    others = (
        replace(case, joint="b"), replace(case, joint_file=""), replace(case, record="b.csv"),
        replace(case, stamp="1 3"), replace(case, day="2026-11-23"), replace(case, changes=("x=1",)),
        replace(case, program="0"),
    )  # fmt: skip
    assert len({one.content_hash for one in (case, *others)}) == 1 + len(others)
    again = pickle.loads(pickle.dumps(case))
    assert again == case and again.content_hash == case.content_hash and len(case.content_hash) == 64


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
    assert run_case(found[0]).outcome is Outcome.IDENTIFIED


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "missing"),
        (FLEET + '[monte_carlo]\njoint = "joint.toml"\nruns = 1\n', "unknown"),
        ("[fleet]\n", "missing"),
        ('[fleet]\njoint = 3\nrecords = "run.npy"\n', "value"),
        ('[fleet]\njoint = "joint.toml"\nrecords = "logs/{axis}/*.npy"\n', "contradiction"),
        ('[fleet]\njoint = "joint.toml"\nrecords = "none/*.npy"\n', None),
        ('[fleet]\njoint = "no.toml"\nrecords = "logs/{joint}/*.npy"\n', None),
        (FLEET + '[sweep]\n"filtering.cutof" = [1.0]\n', "unknown"),
        (FLEET + "[sweep]\ncutoff = []\n", "value"),
        (FLEET + "[sweep]\nmethod.frequency = 20\n", "value"),
        ("name = \n", None),
    ],
)
def test_a_faulty_campaign_file_is_refused(place: Path, text: str, code: str | None) -> None:
    with pytest.raises(JointFileError) as caught:
        campaign(place, text)
    assert code in (None, *(one.code for one in caught.value.faults))


def test_a_file_without_a_date_is_left_out_and_named(place: Path) -> None:
    (place / "logs" / "a" / "notes.npy").write_bytes(b"")
    (place / "campaign.toml").write_text(FLEET)
    found = load_campaign(place / "campaign.toml")
    assert len(found.cases) == 4
    assert "notes.npy" in found.left_out


def test_a_spoiled_record_a_spoiled_joint_file_and_a_fault_of_ours_are_rows(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = campaign(place, FLEET)[0]
    Path(case.record).write_bytes(b"")
    for spoiled in (case, replace(case, joint_file="[joint]"), replace(case, program="0.0.1")):
        row = run_case(spoiled)
        assert (row.outcome, row.found) == (Outcome.REFUSED, {})
    monkeypatch.setattr("jointid.campaigns.run.digest", lambda _: 1 / 0)
    assert run_case(case).outcome is Outcome.FAILED


def test_a_record_that_is_gone_or_has_an_odd_name_fails_its_own_case_alone(place: Path) -> None:
    (place / "logs" / "a" / "2026-11-03.npy").symlink_to(place / "gone.npy")
    odd = os.fsdecode(b"logs/\xe4/2026-11-01.npy")
    (place / odd).parent.mkdir()
    (place / "logs/a/2026-11-01.npy").rename(place / odd)
    found = campaign(place, FLEET)
    rows = [run_case(case) for case in found if case.joint not in "ab" or case.day == "2026-11-03"]
    assert sorted(row.outcome for row in rows) == [Outcome.IDENTIFIED, Outcome.REFUSED]
    with open_store(place / "results.jsonl") as store:
        for row in rows:
            store.add(row)
    with open_store(place / "results.jsonl") as store:
        assert list(store.rows_of(row.content_hash for row in rows)) == sorted(rows, key=lambda row: row.place)


@pytest.mark.parametrize(
    "records",
    ["./logs/{joint}/{day}.npy", "logs//{joint}/{day}.npy", "logs/{joint}/{day}*.npy", "x/../logs/{joint}/{day}.*"],
)
def test_another_spelling_of_a_pattern_means_the_same(place: Path, records: str) -> None:
    (place / "x").mkdir()
    same = [case.content_hash for case in campaign(place, FLEET)]
    found = campaign(place, FLEET.replace("logs/{joint}/{day}.npy", records))
    assert [case.content_hash for case in found] == same
    assert [case.content_hash for case in load_campaign(place / "x" / ".." / "campaign.toml").cases] == same


@pytest.fixture
def fleet(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The small fleet, one of whose records is spoiled, in the current folder."""
    (place / "logs" / "b" / "2026-11-02.npy").write_bytes(b"")
    (place / "campaign.toml").write_text(FLEET)
    monkeypatch.chdir(place)
    return place


def test_a_campaign_is_run_goes_on_and_is_told(
    fleet: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By threads, which begin sooner than the processes of `test_losses`."""
    monkeypatch.setattr("jointid.campaigns.run.ProcessPoolExecutor", lambda count, *_: ThreadPoolExecutor(count))
    command = ("campaign", "campaign.toml", "--workers", 1, "-q")
    assert run(*command) == 0
    assert "Run now: 4 of 4." in capsys.readouterr().out
    before = (fleet / "campaign.jsonl").read_bytes()
    assert run(*command, "--html", "page.html") == 0
    assert "Run now: 0 of 4." in capsys.readouterr().out
    assert (fleet / "campaign.jsonl").read_bytes() == before
    assert "<h2" in (fleet / "page.html").read_text()
    text = (fleet / "campaign.jsonl").read_text()
    (fleet / "campaign.jsonl").write_text(text.replace('"identified"', '"not reliable"', 1))
    assert run(*command, "--again") == 0
    assert "Run now: 1 of 4." in capsys.readouterr().out, "an answer that is not reliable stays"
    (fleet / "campaign.jsonl").write_text(text)
    (fleet / "logs/b/2026-11-02.npy").write_bytes((fleet / "logs/b/2026-11-01.npy").read_bytes())
    assert run(*command) == 0
    assert "Run now: 1 of 4." in capsys.readouterr().out
    joint = fleet / "joint.toml"
    joint.write_text(joint.read_text().replace("velocity_gain = 2000.0\n", ""))  # which the sweep gives
    (fleet / "campaign.toml").write_text(FLEET + '[sweep]\n"controller.velocity_gain" = [2000.0]\n')
    assert run(*command) == 0


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    "words",
    [
        "none.toml",
        "campaign.toml --workers -1",
        "campaign.toml --workers 2 --dask tcp://10.0.0.1:1",
        "campaign.toml --out campaign.toml",
        "campaign.toml --out logs",
        "campaign.toml --false-alarm 0",
        "campaign.toml --html r.jsonl --out r.jsonl",
    ],
)
def test_a_mistake_is_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("campaign", *words.split()) == 2
    assert capsys.readouterr().out == ""
    assert not list(Path().glob("*.jsonl"))
