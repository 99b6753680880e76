"""Names in docstrings and signatures: what they mean, and where they lead.

A type of a signature leads to the public name it is, whatever room of the package that lives in.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sphinx.domains.python import PyObject, PythonDomain

import jointid

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment


_SEVERAL = re.compile(r"^(\s+)((?:\w+|\.\.\.)(?:, (?:\w+|\.\.\.))+): ")


def several(_: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Keep arguments that are told in one line, `kp, kd: ...`, together: Sphinx takes words before the last for a type."""
    for i, line in enumerate(lines):
        lines[i] = _SEVERAL.sub(lambda found: found[0].replace(", ", ",\u200b"), line)


def resolved(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, contnode: nodes.TextElement
) -> nodes.Element | None:
    """Return the link to a public name; the bare text of a type that is of another library, or not public."""
    if node.get("refdomain") != "py":
        return None
    name = str(node["reftarget"]).rpartition(".")[2]
    if name in jointid.__all__:
        domain = env.get_domain("py")
        assert isinstance(domain, PythonDomain)
        found = domain.resolve_xref(env, node["refdoc"], app.builder, "obj", f"jointid.{name}", node, contnode)
        if found is not None:
            return found
    # Text that was written as a reference must lead somewhere; a type of a signature need not.
    return None if node.get("refexplicit") else contnode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register both; an attribute's name in its own class's list is no reference to another class's."""
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.rolename = ""
    app.connect("missing-reference", resolved)
    app.connect("autodoc-process-docstring", several, priority=100)  # before it is parsed
    return {"parallel_read_safe": True, "parallel_write_safe": True}
