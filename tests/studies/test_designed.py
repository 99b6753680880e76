"""The test that a search found, and the runs of it, are kept together and found again."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.designed import made


@pytest.mark.slow
def test_a_designed_test_and_its_runs_are_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = made("L19", "disturbance", "stiffness", 3, 4.0, tmp_path)
    assert isinstance(first["before"], float) and isinstance(first["foretold"], float)
    assert isinstance(first["scatter"], float)
    assert first["foretold"] < first["before"]
    assert 0.1 < first["scatter"] / first["foretold"] < 3.0, "of three runs"
    monkeypatch.setattr("studies.designed.propose", None)
    monkeypatch.setattr("jointid.campaigns.engines.LocalProcesses.open", None)
    assert made("L19", "disturbance", "stiffness", 3, 4.0, tmp_path) == first
