"""The search for a controller, made once for each record: it takes long, and the same numbers give the same law."""

from __future__ import annotations

from typing import Any

import pytest

from jointid.common.messages import Progress, ignore_progress
from jointid.controller_id import learn
from jointid.controller_id.fitting import Task


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
