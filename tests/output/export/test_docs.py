"""docs/exports.md lists every language; its programs run with those of all pages."""

from __future__ import annotations

from pathlib import Path

from jointid.output.export import LANGUAGES

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "exports.md").read_text(encoding="utf-8")


def test_the_page_has_every_language_with_its_endings() -> None:
    for made in LANGUAGES:
        endings = ", ".join(f"`{suffix}`" for suffix in made.suffixes)
        assert f"| {endings} | `{made.name}` |" in PAGE
