"""Plain text as tests look at it."""

from __future__ import annotations


def unwrapped(text: str) -> str:
    """Return a text on one line, each gap one space: where lines end is no part of what they say."""
    return " ".join(text.split())
