"""The search for a controller takes long: it is made once for each record, or finds the law that it is told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from jointid.common.messages import Progress, ignore_progress
from jointid.controller_id import learn
from jointid.controller_id.fitting import FittedLaw, Task, fit
from jointid.controller_id.structures import Structure


def search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a search end at once where one with the same gain, torque and channels was made in this test."""
    search, found = learn.search, dict[tuple[object, ...], Any]()

    def searched(task: Task, progress: Progress = ignore_progress) -> Any:
        channels = ((name, one.sample_time, one.values.tobytes()) for name, one in task.log.record.items())
        key = (task.gain, task.log.period, task.log.torque.tobytes(), task.log.kept.tobytes(), *channels)
        if key not in found:
            found[key] = search(task, progress)
        return found[key]

    monkeypatch.setattr(learn, "search", searched)


def find_law(monkeypatch: pytest.MonkeyPatch, structure: Structure, near: Mapping[str, float]) -> None:
    """Let a search find a structure at once, with its numbers fitted to the record from those given."""

    def found(task: Task, *_: object) -> tuple[FittedLaw, tuple[()], bool]:
        law = fit(task, structure, near, task.noise(structure, near), steps=12)
        assert law is not None
        return law, (), True

    monkeypatch.setattr(learn, "search", found)
