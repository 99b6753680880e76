"""Links from a signature to the public name it means, whatever room of the package the name lives in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sphinx.domains.python import PythonDomain

import jointid

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment


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
    """Register the resolver."""
    app.connect("missing-reference", resolved)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
