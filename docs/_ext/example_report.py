"""The report that the gallery leads to: made at the end of a build, of the simulated axis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import jointid as ji

if TYPE_CHECKING:
    from sphinx.application import Sphinx

NAME = "example-report.html"


def _write(app: Sphinx, failed: Exception | None) -> None:
    if failed is None and app.builder.format == "html":
        axis = ji.twin("L19")
        estimate = ji.identify(axis.record, axis.loop, ji.DIDIM(frequency=30.0))
        estimate.report(axis.record, name="simulated axis").save(Path(app.outdir) / NAME)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register it."""
    app.connect("build-finished", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
