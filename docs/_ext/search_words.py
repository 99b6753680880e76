"""The words of drives that a reader may search for: the glossary has each beside ours, and the built index knows it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

GLOSSARY = Path(__file__).resolve().parents[1] / "glossary.md"

WORDS = MappingProxyType(
    {
        "Kv": "position gain",
        "Kp": "velocity gain",
        "Tn": "integral gain",
        "notch": 'kind = "notch"',
        "following error": "tracking error",
        "Schleppfehler": "tracking error",
        "two-mass system": 'model = "flexible"',
        "resonance": "free-free mode",
        "antiresonance": "motor-locked mode",
        "backlash": "gap",
        "Nachstellzeit": "integral gain",
        "stiffness c": "K12",
        "damping d": "F12",
        "inertia J": "ZZ",
    }
)
"""By a word of the drives or of the field, ours or what we have to say of it."""


def rows(word: str) -> list[str]:
    """Return the rows of the glossary that have a word or words, whole, whatever their case."""
    whole = re.compile(rf"(?<!\w){re.escape(word)}(?!\w)", re.IGNORECASE)
    lines = GLOSSARY.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line.startswith("|") and whole.search(line)]


def _check(app: Sphinx, failed: Exception | None) -> None:
    """Warn of each word that no page is found by."""
    from sphinx.util import logging  # the tests read this module where no Sphinx is

    index = Path(app.outdir) / "searchindex.js"
    if failed is not None or app.builder.format != "html" or not index.is_file():
        return
    found = json.loads(index.read_text(encoding="utf-8").removeprefix("Search.setIndex(").removesuffix(")"))
    known = {*found["terms"], *found["titleterms"]}
    stem = app.builder.indexer.lang.stem
    for word in {part.lower() for words in WORDS for part in re.findall(r"\w\w+", words)}:
        if stem(word) not in known:
            logging.getLogger(__name__).warning("the search finds no page by %s", word)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the check."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
