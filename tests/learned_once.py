"""Learned laws for tests: run as a drive runs them, searched once for each record, or found where they are told."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.messages import Progress, ignore_progress
from jointid.controller_id import learn
from jointid.controller_id.fitting import FittedLaw, Fitter
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.search import Rival
from jointid.controller_id.structures import INTEGRAL, Structure, controller
from jointid.models.controllers import POSITION, run


def run_law(log: LoopRecord, structure: Structure, numbers: Mapping[str, float]) -> FloatArray:
    """Torque of a law as it is run on the logged reference and position, (samples,), as logged."""
    rate, law = structure.rate, controller(structure, numbers, log.period, 1.0).law(log.period)
    inputs = log.inputs(rate, structure.interpolation, structure.average)
    position = inputs[: 5 * rate + 1, POSITION]
    slope = float(position[-1] - position[0]) / (5 * log.period)
    state = law.known_memory(inputs) + law.memory(POSITION, float(position[0]), slope)
    integral = law.integral()
    state = state if integral is None else state + integral * numbers.get(INTEGRAL, 0.0)
    shown = log.to_log(run(law, inputs, state)[:, np.newaxis], rate)[:, 0] + log.added
    late = structure.late
    return np.concatenate([np.repeat(shown[:1], late), shown[: shown.size - late]]) - log.added


def search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a search end at once where one with the same torque and channels was made in this test."""
    search, found = learn.search, dict[tuple[object, ...], Any]()

    def searched(log: LoopRecord, progress: Progress = ignore_progress) -> Any:
        channels = ((name, one.sample_time, one.values.tobytes()) for name, one in log.record.items())
        key = (log.period, log.torque.tobytes(), log.kept.tobytes(), *channels)
        if key not in found:
            found[key] = search(log, progress)
        return found[key]

    monkeypatch.setattr(learn, "search", searched)


def find_law(monkeypatch: pytest.MonkeyPatch, structure: Structure, near: Mapping[str, float], *rivals: Rival) -> None:
    """Let a search find a structure at once, with its numbers near those given, and its rivals."""

    def found(log: LoopRecord, *_: object) -> tuple[Fitter, FittedLaw, list[Rival]]:
        fitter = Fitter(log)
        return fitter, fitter.law(structure, near), list(rivals)

    monkeypatch.setattr(learn, "search", found)
