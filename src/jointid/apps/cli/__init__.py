"""The command line: one file per command, each a thin call of a verb."""

from __future__ import annotations

from jointid.apps.cli.app import main

__all__ = ["main"]
