"""A joint file checked as a whole, and what is wrong with it said at once.

A file with faults is checked as far as it goes: every table, channel and parameter that is right in itself still
takes part in the checks that need several of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from jointid.common.errors import JointFileError
from jointid.config.consistency import (
    channel_faults,
    choose_method,
    free_faults,
    method_faults,
    parameter_faults,
    record_faults,
    transmission_faults,
)
from jointid.config.draft import Draft, table_at
from jointid.config.schema import FileTable
from jointid.config.table import sentences

_MOST = 1000  # keys of a table, records of a file


def check_tables(raw: Mapping[str, Any]) -> FileTable:
    """Return the tables of a joint file, given as `tomllib` reads them.

    Raises:
        JointFileError: with one sentence for each fault.
    """
    faults = list(_crowded(raw))
    if faults:  # each of so many would be a sentence
        raise JointFileError(faults)
    try:
        file = FileTable.model_validate(raw)
    except ValidationError as error:
        faults += sentences(error)
    faults += _faults(Draft.of(raw))
    if faults:
        raise JointFileError(faults)
    return file


def named_method(raw: Mapping[str, Any]) -> str | None:
    """Return the method that a joint file names, or that it has where it names none; None if that is not known."""
    draft = Draft.of(raw)
    return choose_method(table_at(raw, "method").get("name"), draft.named, draft.controlled, draft.model or "rigid")


def _faults(draft: Draft) -> Iterator[str]:
    """Yield what is wrong between the tables."""
    yield from transmission_faults(draft)
    yield from channel_faults(draft)
    if draft.method is not None:
        yield from method_faults(draft, draft.method)
        yield from free_faults("method.free", draft.method.free, draft.controller)
    if draft.gravity_refusal:
        yield f"gravity{draft.gravity_refusal}"
    yield from parameter_faults(draft)
    yield from record_faults(draft)
    if draft.together is not None:
        yield from free_faults("together.free", draft.together.free, draft.controller)


def _crowded(raw: Mapping[str, Any], where: str = "The joint file") -> Iterator[str]:
    """Yield the tables that have more keys, and the lists that have more tables, than anyone writes."""
    if len(raw) > _MOST:
        yield f"{where} has {len(raw)} keys; expected at most {_MOST}: is it another kind of file?"
        return
    for key, value in raw.items():
        if isinstance(value, dict):
            yield from _crowded(value, key)
        elif isinstance(value, list) and len(value) > _MOST and isinstance(value[0], dict):
            yield f"{key} lists {len(value)} tables; expected at most {_MOST}: split the joint file."
