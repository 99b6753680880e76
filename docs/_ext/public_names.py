"""Names in docstrings and signatures: what they mean, and where they lead.

A type of a signature leads to the public name it is, whatever folder of the package that lives in.
"""

from __future__ import annotations

import inspect
import re
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any

from docutils import nodes
from pages import DOTTED
from sphinx.domains.python import PyObject, PythonDomain

if TYPE_CHECKING:
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment


_SEVERAL = re.compile(r"^(\s+)((?:\w+|\.\.\.)(?:, (?:\w+|\.\.\.))+): ")


def several(_: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Keep arguments of one line, `kp, kd: ...`, together: Sphinx takes all words before the last for a type."""
    for i, line in enumerate(lines):
        lines[i] = _SEVERAL.sub(lambda found: found[0].replace(", ", ",\u200b"), line)


def spaced(_: Sphinx, doctree: nodes.document) -> None:
    """Part again, for the reader, what `several` kept together."""
    for text in list(doctree.findall(nodes.Text)):
        if "\u200b" in text:
            text.parent.replace(text, nodes.Text(text.replace("\u200b", " ")))


def told_above(_: Sphinx, what: str, name: str, thing: object, skip: bool, options: object) -> bool | None:
    """Leave out of a class's entries the fields that its own text has told: only what computes and the choices stay."""
    computes = inspect.isroutine(thing) or isinstance(thing, (property, cached_property, Enum))
    return None if what != "class" or (computes and not inspect.ismemberdescriptor(thing)) else True


def resolved(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, contnode: nodes.TextElement
) -> nodes.Element | None:
    """Return the link to a public name; the bare text of a type that is of another library, or not public."""
    if node.get("refdomain") != "py":
        return None
    name = str(node["reftarget"]).rpartition(".")[2]
    if name in DOTTED:
        domain = env.get_domain("py")
        assert isinstance(domain, PythonDomain)
        found = domain.resolve_xref(env, node["refdoc"], app.builder, "obj", f"jointid.{DOTTED[name]}", node, contnode)
        if found is not None:
            return found
    # Text that was written as a reference must lead somewhere; a type of a signature need not.
    return None if node.get("refexplicit") else contnode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register them; an attribute's name in its own class's list is no reference to another class's."""
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label, field.rolename = "Attributes", ""
    app.connect("missing-reference", resolved)
    app.connect("autodoc-process-docstring", several, priority=100)  # before it is parsed
    app.connect("autodoc-skip-member", told_above)
    app.connect("doctree-read", spaced)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
