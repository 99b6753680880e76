"""Pages that are written from the program and the repository before each build, into docs/reference/generated."""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import sys
from collections.abc import Iterator
from itertools import groupby, starmap
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drive_profiles
import joint_file_keys

import jointid

if TYPE_CHECKING:
    from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
FOLDER = DOCS / "reference" / "generated"

REPOSITORY = {
    "README.md": "readme",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
    "CODE_OF_CONDUCT.md": "conduct",
    "SECURITY.md": "security",
    "examples/emps/README.md": "example-emps",
    "examples/actuator/README.md": "example-actuator",
    "examples/kr300/README.md": "example-kr300",
    "examples/motorbench/README.md": "example-motorbench",
}
"""Files of the repository that are pages, too, and what their pages are called."""

BY_MODULE = (
    "models.position_forces.PositionHarmonics",
    "models.linear.frequency_response",
    "common.parameters.Parameter",
    "config.file.Axis",
    "config.file.File",
    "diagnostics.validation.Validation",
    "output.json.read_report",
    "records.record.Injection",
    "records.record.InjectionPoint",
    "records.record.Tap",
    "records.record.Timing",
    "records.resampling.Resampling",
    "simulation.start.Initial",
    "simulation.loop_input.prepare",
)
"""Names that fewer programs need: they are imported from their module, and stand on its folder's page."""

_LINK = re.compile(r"\[(?P<text>[^\]\[]*)\]\((?!https?:|#|mailto:)(?P<target>[^)#\s]+)(?P<anchor>#[^)]*)?\)")


def written() -> dict[str, str]:
    """Return every generated page by its file name."""
    pages = {"joint-file-keys.md": joint_file_keys.page(), "drive-profiles.md": drive_profiles.page(), **_api()}
    for source, name in REPOSITORY.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        pages[f"{name}.md"] = relinked(text, (ROOT / source).parent, FOLDER)
    return pages


def relinked(text: str, here: Path, there: Path) -> str:
    """Return a page whose links, true where it is, are true of the site as seen from another folder."""

    def moved(link: re.Match[str]) -> str:
        target = Path(os.path.normpath(here / link["target"]))
        if target.is_dir():  # which a site does not list
            return link["text"]
        name = REPOSITORY.get(target.relative_to(ROOT).as_posix())
        if name is not None:
            target = FOLDER / f"{name}.md"
        return f"[{link['text']}]({Path(os.path.relpath(target, there)).as_posix()}{link['anchor'] or ''})"

    return _LINK.sub(moved, text)


def _imports(path: Path) -> Iterator[tuple[str, str]]:
    """Yield each name that a file imports and the module of it, empty for the package itself."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            yield from ((alias.name, (node.module or "").removeprefix("jointid.")) for alias in node.names)


def find_homes() -> dict[str, str]:
    """Return the module of every public name: `Record`, or `friction.Friction` of a namespace."""
    package = Path(jointid.__file__).parent
    homes = {}
    for name, module in _imports(package / "__init__.pyi"):
        if module:
            homes[name] = module
        else:
            homes |= {f"{name}.{own}": home for own, home in _imports(package / f"{name}.py")}
    return homes


HOMES = find_homes()
DOTTED = {name.rpartition(".")[2]: name for name in HOMES}
"""Public names by their last part."""


def _thing(name: str) -> Any:
    return attrgetter(name)(jointid)


def _api() -> dict[str, str]:
    """Return a page for each folder that has public names, in their order."""
    rooms = groupby(sorted(HOMES, key=lambda name: HOMES[name]), lambda name: HOMES[name].split(".")[0])
    pages = {}
    for room, names in rooms:
        public = sorted(names, key=str.lower)
        said = inspect.cleandoc(importlib.import_module(f"jointid.{room}").__doc__ or "").split("\n\n")[0]
        pages[f"api-{room}.md"] = _api_page(room, said.replace("\n", " "), public)
    return pages


def _api_page(room: str, said: str, names: list[str]) -> str:
    things = {name: _thing(name) for name in names}
    for name in BY_MODULE:
        if name.startswith(f"{room}."):
            module, _, own = name.rpartition(".")
            things[name] = getattr(importlib.import_module(f"jointid.{module}"), own)
    rows = "\n".join(
        f"| {{py:obj}}`{name} <{_target(name, thing)}>` | {_first_line(thing)} |" for name, thing in things.items()
    )
    further = {name: None for name in (*_bases(room, names), *_results(room)) if name[8:] not in BY_MODULE}
    directives = [*starmap(_directive, things.items()), *(f".. autoclass:: {name}" for name in further)]
    entries = "\n".join(f"```{{eval-rst}}\n{directive}\n```\n" for directive in directives)
    return (
        f"# `{room}`\n\n{said}\n\n| name | what it is |\n|---|---|\n{rows}\n\n"
        f"```{{eval-rst}}\n.. currentmodule:: jointid\n```\n\n{entries}"
    )


def _bases(room: str, names: list[str]) -> list[str]:
    """Return the bases that public classes of a folder have there and that are no public names themselves."""
    classes = [thing for name in names if isinstance(thing := _thing(name), type)]
    found = {
        f"{base.__module__}.{base.__qualname__}": None
        for made in classes
        for base in made.__mro__[1:]
        if base.__module__.startswith(f"jointid.{room}.") and base.__name__ not in DOTTED and base.__doc__
    }
    return list(found)


def _results(room: str) -> list[str]:
    """Return the classes of a folder that public functions return, and the parts of an estimate, not public by name."""
    actions = [thing for name in HOMES if inspect.isroutine(thing := _thing(name))]
    said = [(thing.__globals__, str(thing.__annotations__.get("return"))) for thing in actions]
    for made in (jointid.Estimate,):
        said += [(vars(sys.modules[made.__module__]), str(hint)) for hint in made.__annotations__.values()]
    found = dict.fromkeys(known.get(word) for known, hint in said for word in re.findall(r"\w+", hint))
    return [
        f"{made.__module__}.{made.__qualname__}"
        for made in found
        if isinstance(made, type) and made.__module__.startswith(f"jointid.{room}.") and made.__name__ not in DOTTED
    ]


def _first_line(thing: object) -> str:
    said = inspect.getdoc(thing) or ""
    return said.split("\n\n")[0].replace("\n", " ").replace("``", "`").replace("|", "\\|")


def _target(name: str, thing: object) -> str:
    """Return what a link to a public name leads to: a module is documented under its own name."""
    return thing.__name__ if inspect.ismodule(thing) else f"jointid.{name}"


def _directive(name: str, thing: object) -> str:
    if inspect.ismodule(thing):
        return f".. automodule:: {thing.__name__}"
    if inspect.isfunction(thing):
        return f".. autofunction:: jointid.{name}"
    if isinstance(thing, type):
        kind = "autoexception" if issubclass(thing, BaseException) else "autoclass"
        return f".. {kind}:: jointid.{name}"
    return f".. autodata:: jointid.{name}"


def _write(_: Sphinx) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    pages = written()
    for name, text in pages.items():
        path = FOLDER / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:  # else Sphinx would read it again
            path.write_text(text, encoding="utf-8")
    for path in FOLDER.glob("*.md"):
        if path.name not in pages:
            path.unlink()


def _relink(app: Sphinx, docname: str, source: list[str]) -> None:
    """Lead links that leave the documentation to the repository's pages."""
    here = (Path(app.srcdir) / docname).parent
    if here != FOLDER:
        source[0] = relinked(source[0], here, here)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both."""
    app.connect("builder-inited", _write)
    app.connect("source-read", _relink)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
