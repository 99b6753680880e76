"""The program in the README runs, and gives what the README says."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from tests.docs.running import README_AXIS, run_page

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import commands  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.docs
def test_the_way_of_the_readme_from_a_csv_to_a_report_is_gone_by_command_and_program(tmp_path: Path) -> None:
    said = run_page(ROOT / "README.md", tmp_path, lambda: pytest.skip("it needs no real record"))
    assert (tmp_path / "report.html").is_file()
    found = re.findall(r"^stiffness +c +([\d.]+) ± ([\d.]+)", said, re.MULTILINE)
    _, *own = found  # the first is the demo's
    assert len(own) == 3, "by two commands and by the program"
    for value, two_sigma in own:
        assert abs(float(value) - README_AXIS["stiffness"]) < 1.5 * float(two_sigma) < 0.1 * README_AXIS["stiffness"]


def test_the_readme_is_short_and_has_one_picture_and_one_table() -> None:
    assert len(README.split()) <= 790, "half of the 1,580 words that it had"
    assert README.count("![") == 1
    assert len(re.findall(r"^\|---", README, re.MULTILINE)) == 1
    row = r"^\| .+ \| `jointid ((?:data |diagnose |campaign )?[\w-]+)[^|]*` \| \["
    found_there = {"demo", "doctor", "simulate", "diagnose", "data convert"}
    found_there |= {f"campaign {name}" for name in ("work", "status", "report", "export")}
    assert set(re.findall(row, README, re.MULTILINE)) == set(commands.names()) - found_there


def test_the_links_of_the_documents_lead_somewhere() -> None:
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("examples/*/*.md")]:
        if "generated" in page.parts:
            continue
        for link in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8")):
            written = link.startswith("generated/") or "/generated/" in link  # when the site is built
            assert written or (page.parent / link).exists(), f"{page.name}: {link}"
