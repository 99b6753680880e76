"""How long work tells what it is doing, without knowing who listens."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str], None]
"""Receives one short sentence each time there is something new to say."""


def silent(message: str) -> None:
    """Say nothing; the default listener."""
