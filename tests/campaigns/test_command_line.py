"""`jointid campaign`: it runs what is missing, and reports; mistakes are refused before anything is written."""

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


def test_a_campaign_is_run_goes_on_and_is_told(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    good = (fleet / "logs" / "b" / "2026-11-01.npy").read_bytes()
    (fleet / "logs" / "b" / "2026-11-02.npy").write_bytes(good)
    assert run(*command) == 0
    assert "Run now: 1 of 4." in capsys.readouterr().out


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
