"""What is made of a drive: of its controller, of what is declared of it, and of its log.

An edit changes a namespace: `law` is the controller that runs, `declared` the one that is told, `edits` are made of the
record that is logged.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from jointid.records.record import Channel, Record

Edit: TypeAlias = Callable[[Any], None]


def law(**factors: float) -> Edit:
    """Let the true controller have numbers that are so many times as large as declared."""
    return lambda one: setattr(
        one, "law", replace(one.law, **{name: by * getattr(one.law, name) for name, by in factors.items()})
    )


def has(**parts: Any) -> Edit:
    """Let the true controller have parts that are not declared; a function is of what was drawn."""
    return lambda one: setattr(one, "law", replace(one.law, **_resolved(parts, one)))


def declares(**parts: Any) -> Edit:
    """Declare parts of the controller that it has not; a function is of what was drawn."""
    return lambda one: setattr(one, "declared", replace(one.declared, **_resolved(parts, one)))


def _resolved(parts: dict[str, Any], one: Any) -> dict[str, Any]:
    return {name: value(one) if callable(value) else value for name, value in parts.items()}


def changes(edit: Callable[[Record], Record]) -> Edit:
    """Edit the record."""
    return lambda one: one.edits.append(edit)


def log(channel: str, edit: Callable[[Any], Any]) -> Edit:
    """Edit the values of a channel of the log."""

    def change(logged: Record) -> Record:
        given = getattr(logged, channel)
        return logged.with_channels({channel: replace(given, values=edit(given.values))})

    return changes(change)


def all_channels(edit: Callable[[Channel], Channel]) -> Edit:
    """Edit every channel of the log."""
    return changes(lambda logged: logged.with_channels({name: edit(channel) for name, channel in logged.items()}))


def slower(factor: float) -> Edit:
    """Log samples that are so many times as far apart."""
    return all_channels(lambda channel: replace(channel, sample_time=factor * channel.sample_time))


def swap(logged: Record) -> Record:
    """Exchange torque and reference."""
    torque, reference = logged.torque, logged.reference
    assert torque is not None and reference is not None
    pair = {"torque": replace(torque, values=reference.values), "reference": replace(reference, values=torque.values)}
    return logged.with_channels(pair)


def late_by(samples: int) -> Callable[[Any], Any]:
    """Shift values by some samples."""
    return lambda x: np.concatenate([np.full(samples, x[0]), x[:-samples]])
