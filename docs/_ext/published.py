"""What the site says of itself as a whole: its versions, its address, and llms.txt.

The address is `documentation` of `[tool.jointid]` in `pyproject.toml`. A version stands at ADDRESS/VERSION/, and the
list of versions at ADDRESS/versions.json. Without an address a page has no switcher, and asks nothing of the net.
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]

_ROW = re.compile(r"^\| (?P<task>[^|]+) \| (?P<links>.*\]\(.*) \|$", re.MULTILINE)
_LINK = re.compile(r"\[(?P<title>[^\]]+)\]\((?P<page>(?!\.\.)[\w/.-]+)\.md\)")


def address() -> str:
    """Return where the documentation is published; an empty text as long as it is not."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    found: str = settings["tool"]["jointid"]["documentation"]
    return found


def options(place: str, version: str) -> dict[str, Any]:
    """Return the theme's options of the switcher."""
    if not place:
        return {}
    switcher = {"json_url": f"{place}/versions.json", "version_match": version}
    return {"switcher": switcher, "check_switcher": False, "navbar_end": ["version-switcher", "theme-switcher"]}


def versions(changelog: str, place: str) -> list[dict[str, Any]]:
    """Return the entries of the switcher: this version, and each one that was released, the newest first."""
    rows = re.findall(r"^## (\d+\.\d+\.\d+)(.*)$", changelog, re.MULTILINE)
    found = [one for place, (one, said) in enumerate(rows) if place == 0 or said != " (unreleased)"]
    return [
        {"version": one, "name": f"{one} (latest)" if one == found[0] else one, "url": f"{place}/{one}/"}
        | ({"preferred": True} if one == found[0] else {})
        for one in found
    ]


def llms(index: str, base: str) -> str:
    """Return llms.txt: what the package is, and each page of the start page with what it is for.

    Args:
        index: the start page.
        base: address of this version of the site, ending in a slash; empty for relative links.
    """
    title, said = re.findall(r"^# (.+)\n\n((?:.+\n)+)", index)[0]
    lines = [f"# {title}", "", "> " + said.strip().replace("\n", " ").replace("**", "")]
    for section in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        lines += ["", f"## {section.partition(chr(10))[0]}", ""]
        for row in _ROW.finditer(section):
            pages = _LINK.finditer(row["links"])
            lines += [f"- [{one['title']}]({base}{one['page']}.html): {row['task']}" for one in pages]
    return "\n".join(lines) + "\n"


def _write(app: Sphinx, failed: Exception | None) -> None:
    if failed is not None or app.builder.format != "html":
        return
    place, out = address(), Path(app.outdir)
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    (out / "llms.txt").write_text(llms(index, place and f"{place}/{app.config.version}/"), encoding="utf-8")
    if place:
        changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
        (out / "versions.json").write_text(json.dumps(versions(changelog, place), indent=1), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Write both when the site is built."""
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
