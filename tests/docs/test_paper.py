"""The paper for a software journal cites what its list has, and its numbers are those of the documentation."""

from __future__ import annotations

import json
import re

from tests.docs.blocks import ROOT

FOLDER = ROOT / "paper"


def test_the_paper_has_its_form_and_cites_its_list() -> None:
    text = (FOLDER / "paper.md").read_text(encoding="utf-8")
    assert 800 < len(text.split()) < 1250
    _, header, body = text.split("---\n", 2)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(
        re.findall(r"^(\w+):", header, re.MULTILINE)
    )
    assert {"Summary", "Statement of need", "References"} <= set(re.findall(r"^# (.+)$", body, re.MULTILINE))
    listed = set(re.findall(r"^@\w+\{(\w+),", (FOLDER / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"@(\w+)", body)) == listed


def test_the_numbers_of_the_paper_are_those_of_benchmarks_and_studies() -> None:
    body = " ".join((FOLDER / "paper.md").read_text(encoding="utf-8").split())
    studies = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    for study, share, sentence in (
        ("coverage-l19-log", "K12 in the reported 2 sigma", "truth in {} of {} simulated records"),
        ("false-alarms", "nothing is named", "no fault is named in {} of {}."),
        ("faults", "the fault is named first", "named first in {} of {}."),
    ):
        table = studies.partition(f"### {study}\n")[2].partition("<!-- end of studies -->")[0]
        (found,) = re.findall(rf"^\| {share} \| (\d+) \| (\d+) \|", table, re.MULTILINE)
        assert sentence.format(*found) in body
    mistakes = studies.partition("### mistakes\n")[2]
    (found,) = re.findall(r"^\| the right cause is among those named \| (\d+) \| (\d+) \|", mistakes, re.MULTILINE)
    assert f"Of {found[1]} mistakes" in body
    assert f"named in {found[0]}." in body
    loop = json.loads((ROOT / "docs" / "benchmarks.json").read_text(encoding="utf-8"))["loops"][0]
    ratios = {row["peer"]: row["single"]["ratio"]["median"] for row in loop["rows"]}
    assert f"takes {ratios['jax']:.0f} times as long" in body
    assert f"{ratios['mujoco']:,.0f} times" in body
    assert f"takes {ratios['c']:.2f} times as long" in body
