"""The tables of docs/commands.md, from the commands themselves: what `--help` says is what the page says.

python docs/_ext/commands.py        writes them again; a test holds the page to them
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.apps.cli.app import app

if TYPE_CHECKING:
    from cyclopts import App, Argument

PAGE = Path(__file__).resolve().parents[1] / "commands.md"

_SECTION = re.compile(r"^## `jointid ((?:data |diagnose |campaign )?[a-z-]+)", re.MULTILINE)
_TABLE = re.compile(r"^\| option \|.*\n(?:\|.*\n)*", re.MULTILINE)


def names() -> list[str]:
    """Return the commands there are, in the order of their help."""
    return [" ".join(path) for path in _commands(app)]


def _commands(parent: App, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name in parent:
        if not name.startswith("-"):
            inner = list(_commands(parent[name], (*above, name)))
            if not inner or parent[name].default_command is not None:
                yield (*above, name)
            yield from inner


def arguments(name: str) -> list[Argument]:
    """Return what a command takes, as its help shows it."""
    return [one for one in _command(name).assemble_argument_collection(parse_docstring=True) if one.show]


def _command(name: str) -> App:
    found = app
    for word in name.split():
        found = found[word]
    return found


def table(name: str) -> str:
    """Return the table of a command: what it takes, what may stand there, what it is if left out, and what it means."""
    rows = ["| option | values | default | meaning |", "|---|---|---|---|", *map(_row, arguments(name))]
    return "\n".join(rows) + "\n"


def written(page: str) -> str:
    """Return the page with every section's table as its command has it.

    Raises:
        ValueError: a section is of no command, or has no table.
    """
    starts = list(_SECTION.finditer(page))
    ends = [*(start.start() for start in starts[1:]), len(page)]
    parts = [page[: starts[0].start()]]
    for start, end in zip(starts, ends, strict=True):
        section = page[start.start() : end]
        if start[1] not in names() or not _TABLE.search(section):
            raise ValueError(
                f"docs/commands.md: {start[1]} is no command, or has no table that begins with | option |."
            )
        new = table(start[1])
        parts.append(_TABLE.sub(lambda _, new=new: new, section, count=1))
    return "".join(parts)


def _row(argument: Argument) -> str:
    options = [word for word in argument.names if word.startswith("-")]
    shown = ", ".join(f"`{word}`" for word in options) or f"`{argument.names[0].upper()}`"
    said = " ".join((argument.parameter.help or "").split()).removesuffix(".").replace("|", "\\|")
    return f"| {shown} | {_values(argument)} | {_default(argument)} | {said} |"


def _values(argument: Argument) -> str:
    if choices := argument.get_choices():
        return ", ".join(f"`{choice}`" for choice in choices)
    hint = re.sub(r"<class '(?:\w+\.)*(\w+)'>", r"\1", str(argument.hint))
    for found, word in (("bool", "—"), ("Path", "path"), ("float", "number"), ("int", "whole number"), ("str", "text")):
        if found in hint:
            return f"{word}, may be repeated" if "list" in hint or "tuple" in hint else word
    raise ValueError(f"{argument.name} takes {hint}: say in docs/_ext/commands.py what that is in words.")


def _default(argument: Argument) -> str:
    default = argument.field_info.default
    if argument.required:
        return "required"
    return "—" if default in (None, False, (), argument.field_info.empty) else f"`{default}`"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
