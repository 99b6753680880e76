"""Errata of the paper, and their treatment in jointid.

The findings are data, `errata.toml`. A test recomputes every number from the printed ones. Findings that need a
measurement refer to `jointid reproduce`.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Erratum:
    """One finding.

    Attributes:
        recomputed: from the paper's own numbers and equations.
    """

    item: str
    where: str
    printed: str
    recomputed: str
    what_we_do: str


ERRATA: tuple[Erratum, ...] = tuple(
    Erratum(**one)
    for one in tomllib.loads(files("jointid.paper").joinpath("errata.toml").read_text(encoding="utf-8"))["erratum"]
)
"""Every finding."""
