"""Tables that are made when the documentation is built: options of the commands, errata, shares, files.

A page says where: ``<!-- table: errata -->`` is replaced. Each section of a command ends in its options.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sphinx.util import logging

from jointid.apps.cli.app import app
from jointid.paper.reproduce import ERRATA

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # of the studies

from studies.registry import STUDIES
from studies.stored import make_table, read_entries

if TYPE_CHECKING:
    from cyclopts import App, Argument
    from sphinx.application import Sphinx

_LOGGER = logging.getLogger(__name__)
_SECTION = re.compile(r"^## `jointid (?P<name>[a-z -]+[a-z])[^`]*`\n(?P<text>.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)


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


def options(name: str) -> str:
    """Return the table of a command: what it takes, what may stand there, what it is if left out, and what it means."""
    command = app
    for word in name.split():
        command = command[word]
    rows = ["| option | values | default | meaning |", "|---|---|---|---|"]
    rows += [_row(one) for one in command.assemble_argument_collection(parse_docstring=True) if one.show]
    return "\n".join(rows) + "\n"


def _row(argument: Argument) -> str:
    words = [word for word in argument.names if word.startswith("-")]
    shown = ", ".join(f"`{word}`" for word in words) or f"`{argument.names[0].upper()}`"
    said = " ".join((argument.parameter.help or "").split()).removesuffix(".").replace("|", "\\|")
    return f"| {shown} | {_values(argument)} | {_default(argument)} | {said} |"


def _values(argument: Argument) -> str:
    if choices := argument.get_choices():
        return ", ".join(f"`{choice}`" for choice in choices)
    hint = re.sub(r"<class '(?:\w+\.)*(\w+)'>", r"\1", str(argument.hint))
    for found, word in (("bool", "—"), ("Path", "path"), ("float", "number"), ("int", "whole number"), ("str", "text")):
        if found in hint:
            return f"{word}, may be repeated" if "list" in hint or "tuple" in hint else word
    raise ValueError(f"{argument.name} takes {hint}: say in docs/_ext/tables.py what that is in words.")


def _default(argument: Argument) -> str:
    default = argument.field_info.default
    if argument.required:
        return "required"
    return "—" if default in (None, False, (), argument.field_info.empty) else f"`{default}`"


def _with_options(page: str) -> str:
    """Return the page of the commands with the options of each at the end of its section.

    A command without a section, and a section of no command, are warned of.
    """
    there, documented = set(names()), {found["name"] for found in _SECTION.finditer(page)}
    for name in sorted(there ^ documented):
        _LOGGER.warning("docs/commands.md: %s", f"{name} {'has no section' if name in there else 'is no command'}")

    def filled(section: re.Match[str]) -> str:
        return f"{section[0].rstrip()}\n\n{options(section['name']) if section['name'] in there else ''}\n"

    return _SECTION.sub(filled, page)


def errata() -> str:
    """Return a section for each finding in the paper."""
    section = (
        "## {}. {item}\n\n*{where}*\n\n- **printed:** {printed}\n- **recomputed:** {recomputed}\n"
        "- **jointid:** {what_we_do}\n"
    )
    return "\n".join(section.format(i, **one) for i, one in enumerate(ERRATA, 1))


def files() -> str:
    """Return the table of the package's files, each with the first line of its docstring."""
    package, rows = Path(__file__).resolve().parents[2] / "src" / "jointid", ["| file | what it holds |", "|---|---|"]
    for path in sorted(package.rglob("*.py")):
        if said := ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))):
            said = said.splitlines()[0].replace("|", "\\|")
            rows.append(f"| `{path.relative_to(package).as_posix()}` | {said} |")
    return "\n".join(rows) + "\n"


TABLES = {"errata": errata, "files": files, "studies": lambda: make_table(STUDIES, read_entries())}


def _fill(_: Sphinx, docname: str, source: list[str]) -> None:
    if docname == "commands":
        source[0] = _with_options(source[0])
    source[0] = re.sub(r"<!-- table: (\w+) -->", lambda found: TABLES[found[1]](), source[0])


def setup(sphinx: Sphinx) -> dict[str, Any]:
    """Fill the tables in when a page is read."""
    sphinx.connect("source-read", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
