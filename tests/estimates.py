"""Estimates for tests: without their checks, and with some entries of their parts exchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import jointid as ji
from jointid.estimation.result.parts import EstimateParts

T = TypeVar("T", bound=EstimateParts)

identify = partial(ji.identify, checks=False)
"""Identify without the checks, which take as long as the identification."""


def amended(estimate: T, **parts: Mapping[str, Any]) -> T:
    """Return an estimate with some entries exchanged: ``amended(estimate, checks={"warnings": ()})``."""
    return replace(estimate, **{name: replace(getattr(estimate, name), **entries) for name, entries in parts.items()})
