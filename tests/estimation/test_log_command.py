"""`jointid identify --window`: from a text file to the table, its JSON, and how it ends when it cannot go on."""

import json
from pathlib import Path

import pytest

from tests.estimation.test_log import rigid, stored
from tests.rigid_axis import JOINT, run

DAY = JOINT.replace('"run.npy"', '"day.csv"\nsample_time = 0.001')


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("day")
    stored(folder / "day.csv", rigid(80.0))
    path = folder / "joint.toml"
    path.write_text(DAY, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_log_is_identified_and_every_key_documented(
    joint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    assert run("identify", joint, "--window", 4, "--json", out, "--debug") == 0
    said = capsys.readouterr()
    assert "rigid joint, DIDIM by least squares, in windows, of day" in said.out
    assert "20 of 4 s" in said.out
    assert "forgets how it began" in said.err
    answer = json.loads(out.read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.Estimate/2"
    assert answer["parameters"]["inertia"]["value"] == pytest.approx(30.0, abs=0.5)
    assert run("compare", out, out) == 0
    assert "None of 4 quantities changed" in capsys.readouterr().out


def test_a_bad_row_ends_it_with_its_line(joint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (joint.parent / "day.csv").read_text(encoding="utf-8").splitlines()
    lines[54_321] = "1.0,#"
    bad = tmp_path / "bad.csv"
    bad.write_text("\n".join(lines), encoding="utf-8")
    assert run("identify", joint, "--record", bad, "--window", 4, "-q") == 2
    assert "bad.csv: line 54322 has" in capsys.readouterr().err
