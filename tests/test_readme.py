"""The program in the README runs, and gives what the README says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointid.apps.cli.app import main
from tests.docs.running import run_page

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.docs
def test_the_program_and_the_commands_of_the_readme_run(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    said = run_page(ROOT / "README.md", tmp_path, lambda: request.getfixturevalue("data_dir"))
    assert (tmp_path / "torque.png").is_file()
    for symbol, value in (("ZZ", "94.90"), ("Fv", "207.5"), ("Fc", "20.1")):
        by_command, by_program = re.findall(rf"^{symbol} .*?(\d+\.\d+)", said, re.MULTILINE)
        for found in (by_command, by_program):
            assert round(float(found), len(value.split(".")[1])) == float(value)
        assert value in README


def test_the_links_of_the_documents_lead_somewhere() -> None:
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("examples/*/*.md")]:
        if "generated" in page.parts:
            continue
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8")):
            written = link.startswith("generated/") or "/generated/" in link  # when the site is built
            assert written or (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_table_of_the_readme_is_what_the_demo_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["demo", str(tmp_path / "out"), "-q"])
    rows = re.compile(r"^(\S+) +(-?[\d.]+) +([\d.]+) +(-?[\d.]+)  \S", re.MULTILINE)
    printed = {row[0]: row[1:] for row in rows.findall(capsys.readouterr().out)}
    shown = {row[0]: row[1:] for row in rows.findall(README)}
    assert set(shown) == {"ZZ1", "Fv1", "Fc1", "K12", "F12", "ZZ2", "Fv2", "Fc2", "offset", "Fv1+Fv2", "Fc1+Fc2"}
    for symbol, texts in shown.items():
        for text, expected in zip(texts, printed[symbol], strict=True):
            assert float(text) == pytest.approx(float(expected), rel=0.02)  # another machine rounds elsewhere
