"""Every program and every command of the documentation runs, and prints what the page shows."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from jointid.apps.cli.app import app
from tests.docs.blocks import OTHERS, PROGRAMS, ROOT, blocks, pages
from tests.docs.running import run_page, shown
from tests.learned_once import search_once

NOT_RUN = 20
"""Blocks that are marked as not run; one more is a decision."""

RUNNING = [
    page for page in pages()
    if page != ROOT / "README.md" and any(block.runs and block.language != "{code-cell}" for block in blocks(page))
]  # fmt: skip
"""The README is run by a test that reads what it printed, notebooks by `sphinx-build`, where a warning fails."""


@pytest.mark.docs
@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_page_runs(
    page: Path, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    search_once(monkeypatch)
    run_page(page, tmp_path, lambda: request.getfixturevalue("data_dir"))


def test_every_block_is_run_or_says_why_not() -> None:
    not_run = []
    for page in pages():
        for block in blocks(page):
            place = f"{page.relative_to(ROOT)}:{block.line}"
            assert block.language in (*PROGRAMS, *OTHERS), f"{place}: {block.language} is not collected"
            if block.reason is not None:
                not_run.append(f"{place}: {block.reason}")
            elif not block.language:  # what is printed is no command
                first = block.text.lstrip().split(" ", 1)[0]
                assert first not in ("jointid", "python", "python3", "pip", "uv"), f"{place}: mark the fence as sh"
    assert len(not_run) == NOT_RUN, "\n".join(not_run)


def test_every_command_has_its_options() -> None:
    """The command lines of blocks that are not run, or not drawn, too."""
    parsed = 0
    for block in (block for page in pages() for block in blocks(page) if block.language == "sh"):
        for command in block.commands():
            words = shlex.split(command, comments=True)
            if "jointid" in words:
                app.parse_args(words[words.index("jointid") + 1 :], exit_on_error=False, print_error=False)
                parsed += 1
    assert parsed > 80


def test_no_command_hides_in_an_indented_block() -> None:
    for page in pages():
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            assert not line.startswith(("    jointid ", "    python")), f"{page.name}:{number}: fence it as sh"


def test_what_was_printed_is_told_from_what_was_not() -> None:
    said = "ZZ      inertia               94.903     0.92     0.49  kg\n"
    assert shown("ZZ  inertia  94.9", said)
    assert not shown("ZZ  inertia  89.9", said)
    assert not shown("Fv  inertia  94.9", said)
    assert not shown("ZZ inertia 94.903 0.92 0.49 kg more", said)


def test_dask_serves_http_on_the_loopback_address_alone() -> None:
    """Its HTTP server listens on every address, with --no-dashboard, too."""
    text = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    commands = [line for line in text.splitlines() if line.startswith(("dask scheduler", "dask worker"))]
    assert len(commands) == 4
    assert all("--host" in one or "tls://" in one for one in commands)
    assert all("--dashboard-address 127.0.0.1:0" in one for one in commands)
