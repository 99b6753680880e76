"""The commands of the program, those within another one, too."""

from __future__ import annotations

from collections.abc import Iterator

from cyclopts import App
from cyclopts.argument import ArgumentCollection

from jointid.apps.cli.app import app


def commands() -> dict[str, ArgumentCollection]:
    """Return every command by its words, with the arguments it takes."""
    return {" ".join(words): one.assemble_argument_collection(parse_docstring=True) for words, one in _within(app, ())}


def _within(parent: App, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], App]]:
    for name in parent:
        if not name.startswith("-"):
            inner = list(_within(parent[name], (*above, name)))
            if not inner or parent[name].default_command is not None:
                yield (*above, name), parent[name]
            yield from inner
