"""Every program and every command of the documentation runs, and prints what the page shows."""

import re
import shlex
from pathlib import Path

import pytest

from jointid.apps.cli.app import app
from tests.docs.blocks import ROOT, blocks, pages
from tests.docs.running import README_AXIS, run_page
from tests.learned_once import search_once

RUNNING = [page for page in pages() if any(block.runs for block in blocks(page))]
"""Notebooks are run by `sphinx-build`, where a warning fails."""


@pytest.mark.docs
@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_page_runs(
    page: Path, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    search_once(monkeypatch)
    said = run_page(page, tmp_path, lambda: request.getfixturevalue("data_dir"))
    if page.name == "README.md" and page.parent == ROOT:
        _, *own = re.findall(r"^stiffness +([\d.]+) ± ([\d.]+)", said, re.MULTILINE)  # the first is the demo's
        assert len(own) == 3, "by two commands and by the program"
        for value, two_sigma in own:
            assert abs(float(value) - README_AXIS["stiffness"]) < 1.5 * float(two_sigma) < 1.5e4


def test_every_command_of_a_block_is_parsed() -> None:
    """Also the command lines of blocks that are not run."""
    for block in (block for page in pages() for block in blocks(page) if block.language == "sh"):
        for command in block.commands():
            words = shlex.split(command, comments=True)
            if "jointid" in words:
                app.parse_args(words[words.index("jointid") + 1 :], exit_on_error=False, print_error=False)


def test_the_links_of_the_pages_lead_to_files() -> None:
    for page in (*ROOT.glob("*.md"), *pages()):
        for link in re.findall(r"\]\((?!https?:|#|mailto:)([^)#]+)", page.read_text(encoding="utf-8")):
            there = page.parent / link
            assert "generated" in there.parts or there.exists(), f"{page.name}: {link}"
