"""What the package says of itself on an index: its addresses, and the README with links that lead there.

Both are made from `[tool.jointid]` in `pyproject.toml`. Without an address an index would break relative links: their
text stays, and pictures are left out.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?!https?:|#)(?P<target>[^)\s]+)\)")


class Published(MetadataHookInterface):
    """The hook that hatchling calls."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Add `readme` and `urls`."""
        root = Path(self.root)
        settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["jointid"]
        repository, text = settings["repository"], (root / "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": published(text, repository and f"{repository}/{{}}/v{metadata['version']}"),
        }
        metadata["urls"] = urls(repository, settings["documentation"])


def published(text: str, place: str) -> str:
    """Return a page of the repository's root as it stands elsewhere.

    Args:
        text: Markdown with links relative to the root.
        place: address of the root, with {} for `blob` (a page) or `raw` (a picture); empty without one.
    """

    def moved(link: re.Match[str]) -> str:
        if not place:
            return "" if link["picture"] else link["text"]
        there = place.format("raw" if link["picture"] else "blob")
        return f"{link['picture']}[{link['text']}]({there}/{link['target']})"

    return re.sub(r"\n{3,}", "\n\n", _LINK.sub(moved, text))


def urls(repository: str, documentation: str) -> dict[str, str]:
    """Return the addresses of the project by their labels; none that does not exist."""
    pages = {"Repository": "", "Issues": "/issues", "Changelog": "/blob/main/CHANGELOG.md"}
    own = {label: repository + page for label, page in pages.items() if repository}
    return ({"Documentation": documentation} if documentation else {}) | own
