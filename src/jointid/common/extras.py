"""Packages that not everybody needs: imported where they are used, and asked for by the extra that brings them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from jointid.common.errors import ExtraError


def extra(module: str, name: str, purpose: str) -> Any:
    """Return a module of an optional package.

    Args:
        module: its dotted name.
        name: of the extra that brings it.
        purpose: what it is needed for, the beginning of the sentence.

    Raises:
        ExtraError: the package is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ExtraError(
            f'{purpose} needs the package {package}, which is not there; install it: pip install "jointid[{name}]".'
        ) from error
