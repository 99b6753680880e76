"""A headless Chromium for tests of pages; it skips where there is none, and fails in CI."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

IN_CI = os.environ.get("CI") == "true"
_ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync", "--no-first-run"]
_NAMES = ("chromium", "chromium-browser", "google-chrome")


def browser_path() -> str:
    """The path of a Chromium; without one the test is skipped, and in CI fails."""
    for name in _NAMES:
        found = shutil.which(name)
        if found:
            return found
    reason = f"there is no browser: none of {', '.join(_NAMES)} is installed"
    if IN_CI:
        pytest.fail(reason)
    pytest.skip(reason)


@contextmanager
def opened(address: str | Path, **options: Any) -> Iterator[tuple[Any, list[str]]]:
    """A page of a fresh browser on a file or an address, and what it complained of or asked the network for.

    `options` are those of playwright's new_context, as viewport or java_script_enabled.
    """
    path = browser_path()
    from playwright.sync_api import sync_playwright

    url = address.resolve().as_uri() if isinstance(address, Path) else address
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_ARGUMENTS)
        try:
            page = browser.new_context(**options).new_page()
            page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
            page.on("pageerror", lambda error: complaints.append(str(error)))
            local = url.split("/", 3)[:3]
            page.on("request", lambda asked: complaints.append(asked.url) if _elsewhere(asked.url, local) else None)
            page.goto(url)
            yield page, complaints
        finally:
            browser.close()


def _elsewhere(url: str, local: list[str]) -> bool:
    return not url.startswith(("data:", "blob:")) and url.split("/", 3)[:3] != local
