"""Names of controller numbers in words."""

from __future__ import annotations

_LETTERS = {"position_gain": "Kv", "velocity_gain": "Kp"}
"""The letters of a drive's cascade."""


def name_in_words(name: str, *, cascade: bool) -> str:
    """Return a number's name with the letter that drives use for it: "position gain Kv"."""
    letter = _LETTERS.get(name.rpartition(" ")[2]) if cascade else None
    return " ".join(filter(None, (name.replace("_", " "), letter)))
