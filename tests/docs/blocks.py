"""The fenced blocks of a page: its programs, commands, files and what they print.

A block that does not run says so in the line before it, with the reason: ``<!-- not run: it takes four minutes -->``.
"""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_FENCE = re.compile(
    r"(?:^<!-- not run: (?P<reason>[^\n]+?) -->\n+)?"
    r"^(?P<indent> *)```(?P<language>[^\n` ]*)[^\n`]*\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
_NAMED = re.compile(r"# ([\w-]+\.toml)\n")


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        language: after the fence; none for what is printed.
        text: within it.
        line: of the page, from 1.
        reason: why it is not run, if it is not.
        section: of the page, counted by its headings of the second level.
    """

    language: str
    text: str
    line: int
    reason: str | None = None
    section: int = 0

    @property
    def runs(self) -> bool:
        """Whether it is a program or commands, and to be run."""
        return self.language in ("python", "sh") and self.reason is None

    @property
    def file(self) -> str | None:
        """The name of the file that it is: its first line, as a comment."""
        named = _NAMED.match(self.text) if self.language == "toml" else None
        return named[1] if named else None

    def commands(self) -> list[str]:
        """Return the lines of a shell, without comments, those that go on put together."""
        joined = self.text.replace("\\\n", " ")
        return [line.strip() for line in joined.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def pages() -> list[Path]:
    """Return every page that a reader may follow: the README, the documentation, and those of the examples."""
    written = [page for page in (ROOT / "docs").rglob("*.md") if "generated" not in page.parts]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(written), *sorted(ROOT.glob("examples/*/*.md"))]


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page, in their order."""
    text = page.read_text(encoding="utf-8")
    return [_block(found, text[: found.start("language")]) for found in _FENCE.finditer(text)]


def _block(found: re.Match[str], before: str) -> Block:
    line, section = before.count("\n") + 1, before.count("\n## ")
    return Block(found["language"], found["text"], line, found["reason"], section)
