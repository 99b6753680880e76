"""`jointid campaign`: run, goes on, shards, status, report and export; mistakes are sentences."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.apps.cli.test_commands import run
from tests.campaigns.conftest import FLEET


@pytest.fixture
def fleet(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The small fleet, one of whose records is spoiled, in the current folder."""
    (place / "logs" / "b" / "2026-11-02.npy").write_bytes(b"")
    (place / "campaign.toml").write_text(FLEET)
    monkeypatch.chdir(place)
    return place


@pytest.mark.slow
def test_a_campaign_is_run_goes_on_and_is_told(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 1, "-q") == 0
    assert "4 cases done: 3 identified, 1 refused." in capsys.readouterr().out
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 1, "-q") == 0
    assert "4 cases done, 4 of them before." in capsys.readouterr().out
    good = (fleet / "logs" / "b" / "2026-11-01.npy").read_bytes()
    (fleet / "logs" / "b" / "2026-11-02.npy").write_bytes(good)
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 1, "-q") == 0
    assert "4 cases done, 3 of them before: 1 identified." in capsys.readouterr().out
    assert run("campaign", "status", "out") == 0
    assert "4 of 4 cases: 4 identified" in capsys.readouterr().out
    assert run("campaign", "report", "out", "--html", "page.html", "--markdown", "page.md") == 0
    assert "no joint has eight runs" in capsys.readouterr().out
    assert run("campaign", "report", "out", "--csv", "truth.csv") == 2
    assert "these runs have none that is known" in capsys.readouterr().err
    assert not (fleet / "truth.csv").exists()
    assert "<h2" in (fleet / "page.html").read_text()
    assert "| inertia |" in (fleet / "page.md").read_text()


@pytest.mark.slow
def test_shards_give_the_same_bytes(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 2, "-q") == 0
    for shard in ("1/2", "2/2"):
        assert run("campaign", "work", "campaign.toml", "--shard", shard, "--out", "shared", "-q") == 0
    for folder in ("out", "shared"):
        assert run("campaign", "export", folder, "--out", f"{folder}.csv") == 0
    assert "4 of 4 cases" in capsys.readouterr().out
    assert (fleet / "out.csv").read_bytes() == (fleet / "shared.csv").read_bytes()


def test_again_tries_what_was_refused(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 1, "-q") == 0
    assert run("campaign", "run", "campaign.toml", "--out", "out", "--workers", 1, "--again", "-q") == 0
    assert "4 cases done, 3 of them before: 1 refused." in capsys.readouterr().out


@pytest.mark.usefixtures("fleet")
@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("run none.toml --out out", "none.toml cannot be opened (no such file or directory)"),
        ("run campaign.toml --out out --workers -1", "--workers is -1; expected a whole number, 0 or more"),
        ("run campaign.toml --out out --workers 2 --dask tcp://10.0.0.1:1", "--dask has its own workers"),
        ("run campaign.toml --out campaign.toml", "cannot be"),
        ("work campaign.toml --shard 5/4 --out out", '--shard is "5/4"; expected its number and how many there are'),
        ("status out", "out is no folder of a campaign"),
        ("report out --false-alarm 0", "--false-alarm is 0; expected a chance between 0 and 1"),
        ("export out --out x.txt", "x.txt ends in no known format; expected .csv or .parquet"),
    ],
)
def test_a_mistake_is_a_sentence(command: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("campaign", *command.split()) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err
    assert printed.out == ""
    assert not Path("out").exists()


def test_a_folder_in_a_network_is_refused(
    fleet: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("jointid.campaigns.store._file_system", lambda *_: "nfs4")
    assert run("campaign", "run", "campaign.toml", "--out", "out", "-q") == 2
    assert "is on a disk in a network (nfs4)" in capsys.readouterr().err
    assert not (fleet / "out").exists()


def test_a_damaged_database_is_a_sentence(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (fleet / "out").mkdir()
    (fleet / "out" / "campaign.sqlite").write_bytes(b"no database, but longer than the head of one is" * 100)
    for command in ("run campaign.toml --out out -q", "status out"):
        assert run("campaign", *command.split()) == 2
        assert "is no database of a campaign" in capsys.readouterr().err
